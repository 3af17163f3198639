"""What a sample's workflow does with powder, found before the run: each dose's container, source and mass.

This is an abstract interpretation of the tree. It follows all calls with the values that are known before the run.
Where the branch of an `if` or the rounds of a `for_each` are known, only those are followed; otherwise all of them,
and the results are joined (`_Reached.__or__`). A mass that only the run can know gets bounds: a dose that succeeded is
within its tolerance of its target.

Only types of wires count, not names. A dose is of the `Source`, and into the `Container`, that a call named last
before it. A condition that is given a `Powder` names the sources of that powder.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

from scuhand_bt.events.doses import Dose
from scuhand_bt.failures import Code
from scuhand_bt.problems import Mark, Problems
from scuhand_bt.recipe.known import Names, Ranges, is_known, known, refused
from scuhand_bt.recipe.pour import Flow, Pour, Unfit, Weight, sources_of
from scuhand_bt.skill import Condition, Skill, SkillFailed
from scuhand_bt.specs import Container, Keeping, Powder, Source
from scuhand_bt.tree.build import Scope, bound_inputs, chosen_case
from scuhand_bt.tree.expressions import ANY_NUMBER, Range
from scuhand_bt.tree.library import Library, Percent, parameters_of, resolve_percent
from scuhand_bt.tree.workflow import Argument, Branch, Call, Choice, Decorator, TreeNode, walk
from scuhand_bt.yaml_source import Node

DOSING = {"hand", "balance"}
"""The devices that a skill must command to count as dosing: the valve, and the balance that weighs the powder."""
KEEPING = "keep"
"""The parameter of type `Keeping` of a skill that empties the cone."""
TARGET, TOLERANCE = "mass", "tolerance"
"""The parameters of a dosing skill. Its target may have any other name if it is the only mass that it requires."""


@dataclass(frozen=True)
class _Reached:
    """The abstract state at a place of the tree: what may hold whichever way led there.

    `containers`, `sources`: those that may have been named last. `last`: doses that may be the last of their place;
    `surely`: those of them that are certain. `leaves`: how the cone's content may have been dealt with since it was
    scooped. `scoop`: the number of the scoop that it is from, if that is certain.
    """

    containers: frozenset[str | None]
    sources: frozenset[str | None]
    last: frozenset[Pour] = frozenset()
    surely: frozenset[Pour] = frozenset()
    leaves: frozenset[Keeping | None] = frozenset({None})
    scoop: int | None = None

    def __or__(self, other: "_Reached") -> "_Reached":
        return _Reached(
            self.containers | other.containers,
            self.sources | other.sources,
            self.last | other.last,
            self.surely & other.surely,
            self.leaves | other.leaves,
            self.scoop if self.scoop == other.scoop else None,
        )


def flow_of(workflow: str, inputs: Mapping[str, Any], library: Library, problems: Problems) -> Flow:
    """What a checked workflow doses with these inputs. Reports values that must be known before the run and are not."""
    follower = _Follower(library, {source.name: source for source in sources_of(inputs)}, problems)
    begin = _Reached(frozenset({""}), frozenset(follower.sources if len(follower.sources) == 1 else {""}))
    names = Names(Scope(dict(inputs)), {}, {key: key for key in inputs})
    reached = follower.of(library.workflows[workflow].tree, names, begin, None)
    follower.refuse_mere_scoops()
    return Flow(
        tuple(follower.pours), reached.last, reached.leaves, tuple(follower.unfit.values()), tuple(follower.weights)
    )


class _Follower:
    def __init__(self, library: Library, sources: Mapping[str, Source], problems: Problems) -> None:
        self.sources = sources
        self.pours: list[Pour] = []
        self.unfit: dict[Mark, Unfit] = {}
        self.weights: dict[Weight, None] = {}
        self._library = library
        self._problems = problems
        self._scoops: dict[str, Call] = {}
        """By source: the call in the sample's own workflow that scoops from it."""
        self._scooped = 0
        self._is_try = False

    @property
    def is_mixed(self) -> bool:
        return len(self.sources) > 1

    def of(self, node: TreeNode, names: Names, reached: _Reached, at: Call | None) -> _Reached:
        """The state after a node has succeeded. `at` is the call in the sample's own workflow around it, if any."""
        if isinstance(node, Call):
            return self._of_call(node, names, reached, at or node)
        if isinstance(node, Decorator):
            if node.kind == "for_each":
                return self._of_for_each(node, names, reached, at)
            counts = self._known(node.arguments, names)
            refused = {key: f"'{value:g}' is not accepted; more than 0" for key, value in counts.items() if value <= 0}
            self._note_unfit(node, node.kind, refused, names)
            if node.kind == "retry" and self._may_scoop(node.child):
                return self._of_try(node.child, names, reached, at)
            after = self.of(node.child, names, reached, at)
            if node.kind == "repeat" and counts.get("times") != 1:
                for pour in after.surely - reached.surely:
                    self._warn_of_vain(pour, "from the second round on, this dose")
            return reached | after if node.kind in ("optional", "invert") else after
        if isinstance(node, Choice):
            return self._of_choice(node, names, reached, at)
        if node.kind == "fallback":
            return self._of_fallback(node, names, reached, at)
        for child in node.children:
            reached = self.of(child, names, reached, at)
        return reached

    def _may_scoop(self, node: TreeNode) -> bool:
        library = self._library
        calls = [part.name for part in walk(node) if isinstance(part, Call)]
        return any(
            Code.SOURCE_EMPTY in library.skills[name].raises
            if name in library.skills
            else self._may_scoop(library.workflows[name].tree)
            for name in calls
        )

    def _of_try(self, node: TreeNode, names: Names, reached: _Reached, at: Call | None) -> _Reached:
        """Follow a node that may run again or have an alternative, so that its doses may be from different scoops."""
        before, self._is_try = self._is_try, True
        after = self.of(node, names, reached, at)
        self._is_try = before
        return after

    def _of_fallback(self, node: Branch, names: Names, reached: _Reached, at: Call | None) -> _Reached:
        """Any child may succeed, after those before it have failed at any of their steps."""
        ends: list[_Reached] = []
        lots: list[set[str | None]] = []
        for child in node.children:
            before = len(self.pours)
            ends.append(self._of_try(child, names, reached, at))
            reached |= ends[-1]
            lots.append({pour.lot for pour in self.pours[before:]})
        if sum(bool(of_child) for of_child in lots) > 1:
            self._refuse_unknown_sheet(node, set[str | None]().union(*lots))
        first, *others = ends
        for other in others:
            first |= other
        return first

    def _of_for_each(self, node: Decorator, names: Names, reached: _Reached, at: Call | None) -> _Reached:
        """Each round in turn if the lists are known; else any number of rounds, with any items."""
        lists = self._known(node.arguments, names)
        if lists.keys() != node.arguments.keys():
            return reached | self.of(node.child, names, reached, at)
        counts = {key: len(listed) for key, listed in lists.items()}
        if len(set(counts.values())) > 1:
            said = " and ".join(f"{count} of '{key}'" for key, count in counts.items())
            what = f"the lists of 'for_each' differ in length: there are {said}"
            self._problems.add(node.mark, what, "give each as many values", code="uneven-lists")
        for items in zip(*lists.values(), strict=False):
            within = Scope(dict(zip(lists, items, strict=True)), names.scope)
            reached = self.of(node.child, names.of_round(node, within), reached, at)
        return reached

    def _of_choice(self, node: Choice, names: Names, reached: _Reached, at: Call | None) -> _Reached:
        """The branch that is chosen, if that is known; else any branch, or none."""
        if is_known(node.argument, names.scope):
            try:
                number = chosen_case(node, names.scope, self._library)
            except SkillFailed as failure:
                self._problems.add(node.argument.mark, failure.detail, code="bad-value")
                return reached
            return reached if number is None else self.of(node.cases[number].child, names, reached, at)
        before = self.pours[-1].lot if self.pours else ""
        ends, lots = list[_Reached](), set[str | None]()
        for case in node.cases:
            poured = len(self.pours)
            ends.append(self._of_try(case.child, names, reached, at))
            lots.add(self.pours[-1].lot if len(self.pours) > poured else before)
        if node.kind == "if" and not node.is_exhaustive:
            ends.append(reached)
            lots.add(before)
        self._refuse_unknown_sheet(node, lots)
        first, *others = ends
        for other in others:
            first |= other
        return first

    def _refuse_unknown_sheet(self, node: Branch | Choice, lots: set[str | None]) -> None:
        if self.is_mixed and len(touched := lots - {""}) > 1:
            which = ", ".join(sorted(lot or "?" for lot in touched))
            what = f"which of {which} the sheet has touched after this '{node.kind}' is not known before the run"
            self._problems.add(
                node.mark, what, "use sources of one powder and lot, or a sequence", code="unknown-sheet"
            )

    def _known(self, arguments: Mapping[str, Argument], names: Names, call: Call | None = None) -> dict[str, Any]:
        """The arguments that are known before the run. Reports those that cannot be evaluated."""
        try:
            return known(arguments, names.scope, self._library, call)
        except SkillFailed:
            pass  # the slower way below finds out which ones fail
        found: dict[str, Any] = {}
        for key, argument in arguments.items():
            try:
                found |= known({key: argument}, names.scope, self._library, call)
            except SkillFailed as failure:
                self._problems.add(argument.mark, failure.detail, code="bad-value")
        return resolve_percent(found)

    def _of_call(self, node: Call, names: Names, reached: _Reached, at: Call) -> _Reached:
        library = self._library
        given = self._known(node.arguments, names, node)
        reached = self._named(node, given, reached)
        if node.name in library.skills:
            return self._of_skill(node, names, given, reached, at)
        workflow = library.workflows[node.name]
        ranges = {
            key: names.ranges_of(argument)
            for key, argument in node.arguments.items()
            if key not in given and not isinstance(argument, Node)
        }
        if isinstance(share := given.get(TOLERANCE), Percent):  # a share of a mass that is not known yet
            del given[TOLERANCE]
            ranges[TOLERANCE] = {(): (0.0, share.ratio * ranges.get(TARGET, {}).get((), ANY_NUMBER)[1])}
        inner = Scope(bound_inputs(workflow, given, library, node.arguments.keys() - given.keys()))
        marks = {key: names.mark_in(node, key) for key in workflow.inputs}
        inputs = {key: stems for key in workflow.inputs if (stems := names.input_in(node, key)) is not None}
        within = Names(inner, marks, inputs, ranges)
        reached = self.of(workflow.tree, within, reached, at)
        if node.result is not None and workflow.result is not None:
            names.keep(node.result, within.ranges_of(workflow.result))
        return reached

    def _named(self, node: Call, given: Mapping[str, Any], reached: _Reached) -> _Reached:
        """The state after a call has named its containers, sources and powders."""
        wires = self._library.wires(node)
        containers: set[str | None] = set()
        sources: set[str | None] = set()
        for key in node.arguments:
            python, value = wires[key].python, given.get(key)
            if python is Container:
                containers.add(value.id if isinstance(value, Container) else None)
            elif python is Source:
                sources.add(value.name if isinstance(value, Source) else self._unknown_source(node, key, reached))
            elif python is Powder and isinstance(value, Powder) and issubclass(self._skill(node.name), Condition):
                of_powder = {name for name, source in self.sources.items() if source.powder.name == value.name}
                sources |= of_powder & reached.sources or of_powder
        if not containers and not sources:
            return reached
        return replace(
            reached,
            containers=frozenset(containers) or reached.containers,
            sources=frozenset(sources) or reached.sources,
        )

    def _skill(self, name: str) -> type:
        return self._library.skills.get(name, object)

    def _unknown_source(self, node: Call, key: str, reached: _Reached) -> str | None:
        """None for one of several sources that only the run knows; reported once, where it is wired first."""
        if not self.is_mixed:
            return next(iter(self.sources), None)
        if None not in reached.sources:
            what = f"which source '{node.name}' gets is not known before the run: {node.arguments[key]}"
            remedy = "use an input of this workflow"
            self._problems.add(node.argument_marks[key], what, remedy, code="unknown-demand")
        return None

    def _of_skill(self, node: Call, names: Names, given: Mapping[str, Any], reached: _Reached, at: Call) -> _Reached:
        skill = self._library.skills[node.name]
        wires = self._library.wires(node)
        self._note_unfit(node, node.name, refused(given, wires), names)
        on_pan = [key for key, value in given.items() if isinstance(value, float) and wires[key].is_on_pan]
        for key in on_pan:
            self.weights[Weight(given[key], names.mark_in(node, key), names.input_in(node, key))] = None
        if Code.SOURCE_EMPTY in skill.raises:
            self._scoops.update({source: at for source in reached.sources if source})
            self._scooped += 1
            reached = replace(reached, leaves=frozenset({None}), scoop=self._scooped)
        if skill.empties_cone:
            reached = replace(reached, leaves=self._kept_by(node, given))
        target = _target_of(skill)
        if not DOSING.issubset(skill.devices) or target is None:
            return reached
        defaults = {info.alias or name: info.default for name, info in skill.model_fields.items()}
        values = {key: given.get(key) if key in node.arguments else defaults.get(key) for key in (target, TOLERANCE)}
        mass_mg, tolerance_mg = (value if isinstance(value, float) else None for value in values.values())
        mass_mark, tolerance_mark = (names.mark_in(node, key) for key in values)
        low_mg, high_mg = self._range(node, target, mass_mg, names)
        most_mg = high_mg if math.isfinite(high_mg) else None
        if most_mg is None:
            self._tell_unbounded(node, at, mass_mark, reached)
        stems, share = names.input_in(node, target), values[TOLERANCE]
        beside_mg = share.ratio * high_mg if isinstance(share, Percent) else None
        beside_mg = beside_mg or self._range(node, TOLERANCE, tolerance_mg, names)[1]
        is_one = len(reached.containers) == len(reached.sources) == 1 and mass_mg is not None
        pours = frozenset(
            Pour(
                container,
                source,
                lot=self._lot(source),
                mass_mg=mass_mg,
                most_mg=most_mg,
                tolerance_mg=tolerance_mg,
                mass_mark=mass_mark,
                tolerance_mark=tolerance_mark,
                mass_input=stems,
                tolerance_input=names.input_in(node, TOLERANCE),
                beside_mg=beside_mg if math.isfinite(beside_mg) else 0.0,
                scoop=reached.scoop if is_one and not self._is_try else None,
            )
            for container in reached.containers
            for source in reached.sources
        )
        if node.result is not None and self._library.skills[node.name].result_type() is Dose:
            target_range: Ranges = {("target",): (low_mg, high_mg), ("tolerance",): (0.0, beside_mg)}
            dispensed_range = max(0.0, low_mg - beside_mg), high_mg + beside_mg
            names.keep(node.result, {**target_range, ("dispensed",): dispensed_range})
        self.pours += sorted(pours, key=lambda pour: (pour.container or "", pour.source or ""))
        places = {pour.place for pour in pours}
        if len(places) > 1 or any(None in place for place in places):
            return replace(reached, last=reached.last | pours)
        for pour in pours:
            if any(pour.adds_nothing_to(before) for before in reached.surely):
                self._warn_of_vain(pour, "this dose")
        last, surely = ({pour for pour in had if pour.place not in places} for had in (reached.last, reached.surely))
        return replace(reached, last=pours | last, surely=pours | surely)

    def _warn_of_vain(self, pour: Pour, which: str) -> None:
        """Warn of a dose that an earlier dose of its lot into the same container already fulfils."""
        if pour.mass_mg is not None:
            what = f"{which} adds nothing: its container already holds that much of the lot, which counts"
            self._problems.warn(pour.mass_mark, what, "write the total mass", code="lot-twice")

    def _note_unfit(self, node: Call | Decorator, name: str, refused: Mapping[str, str], names: Names) -> None:
        """Collect values that would fail where they are used. Literals are left to the check of the workflow."""
        for key, why in refused.items():
            argument = node.arguments[key]
            if not isinstance(argument, Node):
                what = f"'{key}' of '{name}': {why}"
                self.unfit[argument.mark] = Unfit(what, argument.mark, names.input_in(node, key))

    def _kept_by(self, node: Call, given: Mapping[str, Any]) -> frozenset[Keeping | None]:
        """Which `Keeping` a skill that empties the cone may get: all of them, if only the run knows."""
        field = self._library.skills[node.name].model_fields.get(KEEPING)
        if field is None:
            return frozenset({"never"})
        if KEEPING in node.arguments and KEEPING not in given:
            return frozenset(get_args(Keeping))
        return frozenset({given.get(KEEPING, field.default)})

    def _range(self, node: Call, key: str, known_value: float | None, names: Names) -> Range:
        """Bounds of a number that a call is given."""
        if known_value is not None:
            return known_value, known_value
        argument = node.arguments.get(key)
        return (
            ANY_NUMBER
            if argument is None or isinstance(argument, Node)
            else names.ranges_of(argument).get((), ANY_NUMBER)
        )

    def _tell_unbounded(self, node: Call, at: Call, mark: Mark, reached: _Reached) -> None:
        """Report a mass without an upper bound.

        With one source it is a warning, as room and powder cannot be checked. With several it is an error, as the plan
        cannot know what each must hold.
        """
        if not self.is_mixed:
            what = (
                "how much is dosed here is not known before the run, and has no bound: room and powder are not checked"
            )
            self._problems.warn(mark, what, "give it a bound: min(…, 100 mg)", code="unbounded-mass")
        elif None not in reached.sources:
            what = f"how much '{at.name}' takes from one of several sources is not known before the run"
            self._problems.add(at.mark, what, TOLD_BEFORE, code="unknown-demand")

    def _lot(self, source: str | None) -> str | None:
        return self.sources[source].sheet_key if source else source

    def refuse_mere_scoops(self) -> None:
        """Report sources, of several, that are scooped from but never dosed: what they lose cannot be planned."""
        dosed = {pour.source for pour in self.pours}
        for source, at in self._scoops.items():
            if self.is_mixed and source not in dosed:
                what = f"how much '{at.name}' takes from one of several sources is not known before the run"
                self._problems.add(at.mark, what, TOLD_BEFORE, code="unknown-demand")


def _target_of(skill: type[Skill[Any]]) -> str | None:
    """The name of a dosing skill's target: `mass`, else the only mass that it requires; None if there is none."""
    parameters = parameters_of(skill).items()
    masses = [key for key, one in parameters if one.wire.name == "Mass" and (one.required or key == TARGET)]
    return TARGET if TARGET in masses else masses[0] if len(masses) == 1 else None


TOLD_BEFORE = "dispense a written mass, an input of the workflow, or one with a bound: min(…, 100 mg)"
