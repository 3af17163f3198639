"""The catalogue of what a check finds: every code with its meaning and remedy. `docs/findings.md` is made of it.

    python -m scuhand_bt.findings docs    # writes docs/findings.md

A code is stable: it stands in `# ok: CODE`, in JSON, and in the address of its section on that page.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Finding:
    """One kind of finding."""

    meaning: str
    remedy: str
    is_warning: bool = False


def _warning(meaning: str, remedy: str) -> Finding:
    return Finding(meaning, remedy, is_warning=True)


FILES = "Files and their form"
RECIPES = "Recipes"
WORKFLOWS = "Workflows"
SKILLS = "Skills"
CELLS = "The cell and its vessels"

SECTIONS: Mapping[str, Mapping[str, Finding]] = {
    FILES: {
        "unreadable": Finding(
            "A file or a folder is missing, empty, too large, not UTF-8 text, or not yours to read.",
            "Save it again, as UTF-8; have its owner let you read it.",
        ),
        "bad-yaml": Finding("A file is not plain YAML.", "Look at the indentation, brackets and quotes at this place."),
        "wrong-shape": Finding("A list, a mapping or a text stands where another should.", "Write what is asked for."),
        "unknown-key": Finding("A key that nothing reads, most often misspelt.", "Take one of the known keys."),
        "missing-key": Finding("A key that is required is missing.", "Add the key."),
        "bad-value": Finding(
            "A value is not accepted: out of its range, or of another kind.", "Write what is allowed."
        ),
        "bad-unit": Finding("A quantity has no unit, or one of another dimension.", 'Write the unit: "50 mg", "2 h".'),
        "unknown-name": Finding(
            "A name that the lab, or the recipe, does not have.", "Take one that it has, or add it."
        ),
        "unknown-code": Finding("A failure code that nothing defines.", "`scuhand-bt explain` lists all of them."),
        "no-lab": Finding("The folder is not a lab.", "A lab has robot/cell.yaml; `scuhand-bt init DIR` makes one."),
        "unused-silencer": _warning(
            "`# ok: CODE` stands on a line that has no such warning.", "Remove it, or correct the code."
        ),
    },
    RECIPES: {
        "bad-id": Finding(
            "A text is not a valid id, or could be mistaken for another.", "Letters of one script, digits, . _ - +."
        ),
        "duplicate-id": Finding("Two samples have one id, or ids that look alike.", "Give each an id of its own."),
        "bad-table": Finding("A CSV file is not a table of samples.", "A header with `id`, then one sample per row."),
        "table-elsewhere": Finding("A table is neither beside the recipe nor in the lab.", "Put it beside the recipe."),
        "uneven-lists": Finding("Lists side by side differ in length, or are empty.", "Give each as many values."),
        "leftover-mixed": Finding("What is left of two lots would go into one vessel.", "Use a recipe for each lot."),
        "bad-repeat": Finding("`repeat` is not a number of samples, or stands beside a list.", "A number, or a list."),
        "too-many-samples": Finding("A recipe has more samples than can be run.", "Split it."),
        "misplaced-default": Finding(
            "`defaults` holds a key of the recipe, or of a sample, that is no input of a workflow.",
            "Write `workflow` at the top of the recipe; `id`, `repeat` and `table` belong to each sample.",
        ),
        "unknown-input": Finding(
            "A sample's key, or a default, that no workflow has as an input.", "Take an input's name."
        ),
        "percent-of-nothing": Finding(
            "A tolerance is in percent, and there is no mass beside it.", "Write it as a mass."
        ),
        "bad-action": Finding(
            "`on_failure` names an action that does not exist.", "flag, skip_sample, redo, ask, stop."
        ),
        "station-taken": Finding("Two sources stand at one station.", "Give each a station of its own."),
        "mortars-overlap": Finding("The mortars of two sources overlap.", "Move a station."),
        "bad-mass": Finding("A mass is zero or less.", "Ask for more than 0."),
        "fine-tolerance": Finding(
            "A tolerance is finer than the balance can show.", "At least two of the balance's digits."
        ),
        "hardly-told": _warning(
            "A tolerance has fewer than five of the balance's digits: good doses are flagged.",
            "A wider tolerance, or a balance with finer digits (docs/weighing.md says what to expect of each).",
        ),
        "wide-tolerance": Finding("A tolerance is as large as its mass.", "A smaller tolerance, or a larger mass."),
        "too-heavy": Finding(
            "A container with its powder, or a check weight, exceeds the balance's maximum.",
            "Less powder, or a lighter container or weight.",
        ),
        "container-overfull": Finding(
            "More goes into a container than it holds.", "Less powder, or a larger container."
        ),
        "source-overfull": Finding(
            "A source's amount does not fit into its mortar.", "Correct the amount or the mortar."
        ),
        "never-opened": Finding(
            "The hand does not open as wide as a powder, by its `belief`, needs to flow, or to bring much.",
            "Correct the powder's `belief` or the hand's `max_opening`.",
        ),
        "small-load": _warning(
            "A powder's `load_limit` is less than scoops can be held to: they may bring several times as much.",
            "A larger `load_limit` in robot/powders.yaml, if the cone may hold that.",
        ),
        "source-short": Finding(
            "A source holds less than its samples need, with losses.",
            "More powder, `refill` for a person to bring it during the run, or fewer samples.",
        ),
        "source-discarded": _warning(
            "A source holds what its samples need, but not the surplus of their scoops, which is discarded.",
            "More powder, `refill`, or `leftover: keep` or `return`; `plan` shows by dry runs what is discarded.",
        ),
        "poor-strokes": _warning(
            "A bowl is so small, or so shallow, or a jar holds so little, that doses take several scoops each.",
            "A deeper mortar, or a larger one; in a jar more powder.",
        ),
        "one-scoop": _warning(
            "A sample takes all its doses from one scoop, but of what the mortar then holds a scoop brings less.",
            "Smaller doses, several samples, or a workflow that scoops again, as `fill` does.",
        ),
        "source-lent": _warning(
            "A source holds what its samples need, but not what others of its lot may take, as the cone keeps powder.",
            "More powder, `refill`, the samples of each source one after the other, or `leftover: return`.",
        ),
        "out-of-reach": Finding(
            "The arm does not reach a place with the cone upright.", "`scuhand-bt reach` draws it."
        ),
        "no-path": Finding(
            "The arm cannot stand at a place, or has no way to it.", "Move the station or the obstacle."
        ),
        "not-asked": Finding(
            "A workflow doses another mass than its sample asks for, or more coarsely.", "Wire $mass and $tolerance."
        ),
        "redo-shifts": _warning(
            "A sample done once more takes the next one's container from the changer, which may be of another kind.",
            "Slots by kind in robot/cell.yaml, or `flag` in place of `redo` and `ask`.",
        ),
        "few-slots": _warning(
            "A sample takes more containers than the changer has slots: a person refills it midway, and a container "
            "that has gone by then and comes again is refused (`container.changed`).",
            "Fewer containers in each sample, or more `slots` in robot/cell.yaml.",
        ),
        "lot-twice": _warning(
            "A dose is repeated, or followed by another of its lot into its container, where they become one.",
            "Write the mass that is wanted in all, or use another lot for one of them, or another container.",
        ),
        "unknown-demand": Finding(
            "How much a sample takes from which of its sources is not known before the run.",
            "Dispense a written mass, an input of the workflow, or one with a bound: min(…, 100 mg).",
        ),
        "unknown-sheet": Finding(
            "Which powder the sheet has touched after a fallback is not known.", "One powder, or a sequence."
        ),
        "unbounded-mass": _warning(
            "What a workflow doses is known only when it runs, and nothing bounds it: room and powder are not checked.",
            "Give it a bound: min(…, 100 mg).",
        ),
        "bad-formula": Finding(
            "A text is not a chemical formula, or can be read in two ways.",
            "Elements, counts and brackets: Li6.5La3Zr1.5Ta0.5O12; water behind a dot: FeC2O4·2H2O.",
        ),
        "not-composing": Finding(
            "A sample has `compose`, but its workflow takes no composed powders.",
            "One with the inputs container: Container, sources: [Source], masses: [Mass], tolerances: [Mass].",
        ),
        "composed-input": Finding(
            "A sample gives an input that its `compose` gives already.",
            "Leave it out, or compose nothing in this sample.",
        ),
        "no-source": Finding("No source of the recipe holds a powder of `from`.", "Add the source, or correct it."),
        "several-sources": Finding("Several sources hold a powder of `from`.", "Write the name of the source."),
        "no-formula": Finding("A powder that is composed has no formula.", "`formula:` in robot/powders.yaml."),
        "no-purity": Finding("A lot that is composed has no purity.", "`purity:` at the source, by its certificate."),
        "lot-assays": Finding(
            "Two sources have the same lot, or none, and their assays differ: a dose may come from either.",
            "A `lot` for each, or one assay.",
        ),
        "bad-excess": Finding("A text is not an excess: (excess 10 %).", "A share, from -50 % to 100 %."),
        "missing-element": Finding("No powder of `from` brings an element of the product.", "Name one that does."),
        "foreign-element": Finding(
            "A powder brings an element that the product does not have, or none that is balanced.",
            "Another powder; or `ignore` what leaves.",
        ),
        "ambiguous-precursors": Finding(
            "Several amounts of the powders make the same product.", "Leave one of the powders out."
        ),
        "unbalanced": Finding("No amounts of the powders make the product.", "Add a powder, or correct a count."),
        "negative-amount": Finding(
            "Nothing of a powder is needed, or less than nothing.", "Leave it out, or take other powders."
        ),
        "uncertain-assay": Finding(
            "The assays of the powders are less certain than the composition should be.",
            "A wider tolerance, or give the uncertainties of a better assay.",
        ),
        "service-workflow": Finding(
            "A workflow that the engine calls has inputs that the engine does not give.", "`source` alone."
        ),
        "needs-person": Finding("A plan that should be unattended needs a person.", "`scuhand-bt plan` lists why."),
        "no-driver": Finding("A device exists only in simulations.", "Another driver, for the real cell."),
        "unlikely": _warning(
            "A powder comes in lumps too large for a sample's tolerance: fewer than 90 % of doses can be in tolerance.",
            "A wider tolerance, or a finer powder. `scuhand-bt plan` shows the odds by dry runs.",
        ),
        "unused-source": _warning("No sample takes from a source.", "Remove it, or name it in a sample."),
        "on-failure-never": _warning(
            "`on_failure` names a code that nothing in this recipe fails with.", "Look for the code that was meant."
        ),
    },
    WORKFLOWS: {
        "bad-node": Finding(
            "Something in a tree is not a node, or does not have a node's form.", "One key with its values."
        ),
        "unknown-parameter": Finding(
            "A call gives a value that the skill or workflow does not take.", "See its parameters."
        ),
        "missing-parameter": Finding("A call lacks a value that must be given.", "Give it."),
        "unknown-value": Finding("`$name` is neither an input nor an earlier result.", "Take a name that exists."),
        "unset-value": Finding(
            "`$name` has a value on another branch only.", "Set it on every branch that leads here."
        ),
        "unknown-attribute": Finding("`$name.attribute`: values of this type have no such attribute.", "See the type."),
        "wrong-type": Finding("A value of one type is wired to a parameter of another.", "Wire what is asked for."),
        "bad-reference": Finding("`result` is a text that does not read a value.", "$name or $name.attribute."),
        "bad-expression": Finding(
            "A text with $ is not a reference, and cannot be calculated.",
            "$name, $name.attribute, or a calculation with them: 0.25 * $dose.dispensed.",
        ),
        "bad-arithmetic": Finding(
            "Values of kinds that do not go together are added, compared or multiplied.",
            "Masses with masses; a mass times a number; two measured values with < or >.",
        ),
        "bad-name": Finding("A text that cannot be a name.", "Letters, digits and _, not beginning with a digit."),
        "name-taken": Finding("A name already means something else.", "Another name."),
        "name-mismatch": Finding("A workflow has another name than its file.", "Name it as its file."),
        "no-result": Finding("`as` keeps the result of something that has none.", "Leave `as` out."),
        "unknown-type": Finding("An input has a type that does not exist.", "Take one of the types."),
        "input-type": Finding("`mass` and `tolerance` are masses.", "Mass, or another name."),
        "circle": Finding("Workflows call each other in a circle.", "Remove one of the calls."),
        "too-large": Finding("A tree has more nodes than can be run.", "Use `repeat`."),
        "parallel-devices": Finding("Two children of a `parallel` command one device.", "Use `sequence`."),
        "parallel-zones": Finding("Two children of a `parallel` move in one zone of the cell.", "Use `sequence`."),
        "parallel-values": Finding(
            "A child of a `parallel` sets or records a value that another sets too, or sets one that another reads.",
            "A name of its own for each result.",
        ),
        "unknown-zone": Finding(
            "Something moves in a zone while the arm moves, and the cell does not say where the zone is.",
            "Describe it under `zones` of robot/cell.yaml, or use `sequence`.",
        ),
        "no-zone": Finding(
            "A skill commands the changer while the arm moves, and leases no zone: nothing keeps the arm away.",
            "Lease it, as `zones` of the skill, or use `sequence`.",
        ),
        "no-condition": Finding("A guard is not a condition.", "Take a condition, such as `cone_holds`."),
        "bad-count": Finding("A count or a duration of zero or less.", "More than 0."),
        "unused-input": _warning("Nothing reads an input.", "Wire it, or leave it out."),
        "unused-result": _warning("Nothing reads a result that `as` keeps.", "Wire it, or leave `as` out."),
        "shadowed-name": _warning(
            "`as`, or `record`, gives a name another value, and the first one is lost.", "A name of its own."
        ),
        "retry-never": _warning(
            "`on` of a `retry` or a `fallback` names a code that nothing below it fails with.",
            "Look for the code that was meant.",
        ),
        "unreachable-branch": _warning(
            "A fallback never gets past a child that never fails.", "Put what can fail first."
        ),
        "short-timeout": _warning("A `timeout` ends before its child can be done.", "A longer time."),
        "no-tare": _warning(
            "A workflow doses into a container that was not weighed empty; the dose will be refused.",
            "`tare:` after `place_container`.",
        ),
        "no-container": _warning(
            "A workflow needs a container on the pan before one was put there; it will be refused.",
            "`place_container:` before it.",
        ),
        "not-over-pan": _warning(
            "A workflow doses, and the arm was not sent over the pan, or away from it again; it will be refused.",
            "`move_over:` right before the dose.",
        ),
        "no-park": _warning("A workflow leaves the arm where its last action was.", "`park:` at the end."),
    },
    SKILLS: {
        "skill-import": Finding("A skill's file cannot be imported.", "Python says why, and in which line."),
        "skill-class": Finding(
            "A skill's file does not have exactly one whole Skill class.", "One class, with `run` or `check`."
        ),
        "skill-docstring": Finding("A skill does not say what it is for.", "One line, in its docstring."),
        "skill-devices": Finding("`devices` or `watches` is not a tuple of devices.", 'devices = ("hand",)'),
        "skill-failures": Finding("A failure code has no explanation.", "Give it in the skill's `failures`."),
        "skill-signature": Finding("A method takes other values than the engine gives.", "def run(self, cell)"),
        "skill-generator": Finding("`run` does not wait for anything: it is not a generator.", "`yield from …`"),
        "skill-yield": Finding("A skill yields something that is not a `Wake`.", "`yield from pause(cell, 1.0)`"),
        "skill-not-waited": Finding("A device's steps are created, but never taken.", "`yield from` before it."),
        "skill-finally": Finding(
            "A skill waits in `finally`, where it may be halted.", "Only send safe commands there."
        ),
        "skill-clock": Finding(
            "A skill uses the computer's clock, which is not the run's.", "`pause`, `cell.clock.now_s`"
        ),
        "skill-endless": Finding(
            "A loop of a skill never ends, and never waits.", "`yield from pause(cell, …)` in it."
        ),
        "skill-halt": Finding("A skill catches what halts it, and goes on.", "`finally:`, or `except SkillFailed:`"),
        "skill-interrupted": Finding("`interrupted` is not a way to resume an action.", '"repeat", "reweigh" or "ask"'),
        "skill-unknown-member": Finding(
            "A device, the cell, or the skill itself, has no such method or value.", "See its interface, or its fields."
        ),
        "skill-unknown-name": Finding(
            "A skill's file uses a name that nothing in it gives a value.", "Import it; look at its spelling."
        ),
        "skill-set": Finding("A skill sets one of its own parameters.", "A name of its own, without `self.`."),
        "skill-condition": Finding(
            "The `check` of a condition returns a value, or waits: the condition would hold whatever the value is.",
            "`raise SkillFailed(…)` where it does not hold.",
        ),
        "skill-arguments": Finding("A method is called with other values than it takes.", "See its interface."),
        "skill-lease": Finding("A skill uses a device that it does not lease.", "Add it to `devices`."),
        "skill-forecast": Finding(
            "A skill's `forecast` breaks, or its `typical_s` is not a number.",
            "`forecast` may be given none, or some, of the inputs.",
        ),
        "skill-default": Finding("A parameter's default is not of its type.", "A value as the type has it."),
        "skill-raises": _warning("A skill fails with a code that its `raises` does not name.", "Add it to `raises`."),
        "skill-fault": _warning(
            "A skill raises another exception than SkillFailed, or ends the program.", "raise SkillFailed(code, why)"
        ),
        "skill-unit": _warning("A number without a unit is a parameter.", "Milligrams, Seconds, …, or Ratio."),
    },
    CELLS: {
        "missing-station": Finding("The cell has no balance, no waste or no park.", "Add the station."),
        "zones-overlap": Finding(
            "Two zones of the cell have one name, or overlap: each is leased by itself; two may move there at once.",
            "Set them apart, or make them one.",
        ),
        "parked-in-zone": Finding(
            "The arm parks in a zone of the cell: whatever else moves there waits for it for ever.",
            "Put the park station farther away, or make the zone smaller.",
        ),
        "pan-in-no-zone": Finding(
            "Over the pan the arm is in none of the zones that a skill leases to change containers: it may be there.",
            "A zone that holds everything that moves there, leased by each such skill.",
        ),
        "port-taken": Finding("Two devices use one port.", "Give each its own."),
        "strained": _warning(
            "At a place the arm holds up more than half of a servo's stall torque, by the URDF's masses.",
            "A lighter hand, or the place nearer to the arm.",
        ),
        "no-slot": Finding(
            "The container changer has slots by kind, and none for a container of this kind.",
            "Give it slots in robot/cell.yaml, or take a kind that has some.",
        ),
        "implausible-size": _warning("A vessel's sizes do not go together.", "Look at the units."),
    },
}

FINDINGS: Mapping[str, Finding] = {code: one for section in SECTIONS.values() for code, one in section.items()}


def page() -> str:
    """The documentation page of all findings."""
    parts = [_HEAD]
    for title, findings in SECTIONS.items():
        parts.append(f"## {title}\n")
        for code, finding in findings.items():
            kind = "Warning. " if finding.is_warning else ""
            parts.append(f"### {code}\n\n{kind}{finding.meaning} What to do: {finding.remedy}\n")
    return "\n".join(parts)


_HEAD = """\
# What `check` finds

Made by `python -m scuhand_bt.findings docs`. `scuhand-bt explain CODE` says the same. How they are shown, silenced and
made strict is in [checking.md](checking.md).
"""


if __name__ == "__main__":
    Path(sys.argv[1], "findings.md").write_text(page(), encoding="utf-8")
