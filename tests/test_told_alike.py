"""What a run came to is told alike by the table, the report, the JSON export, the weighing record and the journal."""

import csv
import io
import json
import random
from pathlib import Path
from typing import Any

import pytest
from daily import first_daily
from page_text import Tables
from rich.box import ASCII
from rich.console import Console
from running import Ran, dry_run, make_lab

from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.reader import open_contents, read
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.quantity import format_mass
from scuhand_bt.report.doses import doses_table
from scuhand_bt.report.run_report import page_of_run
from scuhand_bt.report.weighing_record import weighing_csv

INPUTS = (
    "beads: Source, msg: Source, first: Container, second: Container, "
    "mass: Mass, more: Mass, tolerance: {type: Mass, default: 2 mg}"
)
SOURCES = """
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g, lot: B-1}
  msg: {station: mortar_bay_2, container: small_agate_mortar, powder: monosodium_glutamate, amount: 8 g}
"""
LEFT_STANDING = "workflow: finish_batch\ninputs: {source: Source}\ntree: {return_leftover: {source: $source}}\n"


def fill(powder: str, container: str, mass: str, tolerance: str) -> str:
    return f"fill: {{source: ${powder}, container: ${container}, mass: {mass}, tolerance: {tolerance}}}"


def any_workflow(name: str, chance: random.Random) -> str:
    """One or two powders into one or two containers, in an order by chance; one of the doses is what is asked."""
    places = [(c, p) for c in chance.sample(["first", "second"], chance.randint(1, 2)) for p in ("beads", "msg")]
    places = [place for place in places if chance.random() < 0.7] or places[:1]
    if chance.random() < 0.5:
        places.append(places[-1])  # another dose on the last one
    asked = chance.randrange(len(places))
    steps, container, powder = [], "", ""
    for number, (into, of) in enumerate(places):
        if powder not in ("", of):
            steps.append(f"change_powder: {{source: ${powder}}}")
        if into != container:
            steps += ["park: ", f"place_container: {{container: ${into}}}", "tare: "]
        container, powder = into, of
        if number == asked or places[number] == places[asked]:
            fills = [fill(of, into, "$mass", "$tolerance")]
            if chance.random() < 0.25:  # where the recipe's mass is only the second choice, the run tells
                fills.insert(0, fill(of, into, "17 mg", "2 mg"))
            steps.append(f"fallback: [{', '.join(f'{{{one}}}' for one in fills)}]")
        else:
            masses, tolerances = ["$more", "15 mg"], ["$tolerance", "9 mg", "1 mg"]
            steps.append(fill(of, into, chance.choice(masses), chance.choice(tolerances)))
    steps += [f"return_leftover: {{source: ${powder}}}", "park: ", *(["remove_container: "] * chance.randint(0, 1))]
    tree = "".join(f"    - {step}\n" for step in steps)
    return f"workflow: {name}\ninputs: {{{INPUTS}}}\ntree:\n  sequence:\n{tree}"


def any_run(tmp_path: Path, seed: int) -> Ran:
    chance = random.Random(seed)
    workflows = {f"trees__{name}": any_workflow(name, chance) for name in ("mine", "yours")}
    if seed % 2:
        workflows["trees__finish_batch"] = LEFT_STANDING
    lab = make_lab(tmp_path / "lab", **workflows)
    action = chance.choice(["flag", "skip_sample", "redo"])
    text = f"recipe: any\nsamples:\n{SAMPLES}on_failure: {{dose.overshoot: flag, otherwise: {action}}}\n{SOURCES}"
    return dry_run(tmp_path, text, lab=lab, seed=seed, controller=None)


KINDS = "beads: beads, msg: msg, first: xrd_holder, second: xrd_holder"
SAMPLES = f"""\
  - {{id: a, workflow: mine, {KINDS}, mass: 30 mg, more: 22 mg}}
  - {{id: b, workflow: yours, {KINDS}, mass: 25 mg, more: 31 mg, tolerance: 3 mg}}
"""


def of_table(ran: Ran) -> list[dict[str, str]]:
    """The rows of the table at the end, as they are printed."""
    table = doses_table(ran.result.samples)
    table.box, text = ASCII, io.StringIO()
    Console(file=text, width=400).print(table)
    head, *rows = [[cell.strip() for cell in line.split("|")] for line in text.getvalue().splitlines() if "|" in line]
    return [dict(zip(head, row, strict=True)) for row in rows]


def of_report(ran: Ran) -> list[dict[str, str]]:
    """The rows of the report's table."""
    with open_contents(ran.journal) as contents:
        head, *rows = Tables(page_of_run(contents)).found["Doses"]
    return [dict(zip(head, row, strict=True)) for row in rows]


def of_record(ran: Ran) -> list[dict[str, Any]]:
    with open_contents(ran.journal) as contents:
        rows = csv.DictReader(io.StringIO(weighing_csv(contents)))
        return [row for row in rows if row["weighing"] == "result"]


def shown(one: dict[str, Any]) -> dict[str, str]:
    """What the table has of a dose, or of a sample with one."""
    return {
        "target": format_mass(one["target_mg"]),
        "dispensed": format_mass(one["dispensed_mg"]),
        "error mg": f"{one['dispensed_mg'] - one['target_mg']:+.1f} ± {one['uncertainty_mg']:.1f}",
        "tol. mg": f"{one['tolerance_mg']:g}",
    }


def held(one: dict[str, Any]) -> str:
    return format_mass(one["true_mg"])


def row_of(row: dict[str, Any]) -> dict[str, Any]:
    """A dose by its row of the weighing record."""
    lot = f"{row['powder']}/{row['lot']}" if row["lot"] else row["powder"]
    masses = {"net_mg": "dispensed_mg", "standard_uncertainty_mg": "uncertainty_mg"}
    same = ("target_mg", "tolerance_mg", "true_mg")
    numbers = {masses.get(name, name): float(row[name]) for name in (*masses, *same)}
    return {"container": row["container"], "lot": lot, "verdict": row["verdict"], "bracket": row["bracket"], **numbers}


@pytest.mark.parametrize("seed", first_daily(0, 1, 2, 3, 4))
def test_every_dose_of_any_run_is_told_alike_everywhere(tmp_path: Path, seed: int) -> None:
    ran = any_run(tmp_path, seed)
    entries = [row["payload"] for row in read(ran.journal, "entry") if row["kind"] == "sample"]
    samples = {sample["id"]: sample for sample in entries}
    assert [SampleResult.model_validate(samples[one.id]) for one in ran.result.samples] == list(ran.result.samples)
    for exported in json.loads(canonical(ran.journal))["samples"]:
        written = samples[exported["id"]]
        for one, other in zip([exported, *exported["doses"]], [written, *written["doses"]], strict=True):
            numbers = {name: value for name, value in other.items() if isinstance(value, float)}
            assert {name: one[name] for name in numbers} == pytest.approx(numbers, abs=1e-6)
            assert {k: v for k, v in one.items() if k not in (*numbers, "doses")} == {
                k: v for k, v in other.items() if k not in (*numbers, "doses")
            }
    assert of_report(ran) == of_table(ran)
    record, table = of_record(ran), iter(of_table(ran))
    for sample in samples.values():
        doses = sample["doses"]
        rows = [row for row in record if row["sample"] == sample["id"]]
        assert {(row["sample_verdict"], row["failure_code"]) for row in rows} <= {
            (sample["verdict"], sample["code"] or "")
        }
        for row, dose in zip(rows, doses, strict=True):
            assert row_of(row) == {
                k: pytest.approx(v, abs=1e-4) if isinstance(v, float) else v for k, v in dose.items() if k != "lasted_s"
            }
        main = next(table)
        verdict = sample["verdict"] + (f", {sample['code']}" if sample["code"] else "")
        assert (main["id"], main["verdict"]) == (sample["id"], verdict)
        is_one_container = len({one["container"] for one in doses}) == 1
        if len(doses) == 1:
            assert shown(sample).items() <= main.items()
        assert main["holds (sim.)"] == (held(sample) if is_one_container else "")
        for dose in doses if len(doses) > 1 else ():
            row = next(table)
            assert shown(dose).items() <= row.items()
            assert row["id"].endswith(dose["lot"])
            assert row["holds (sim.)"] == ("" if is_one_container else held(dose))
            assert (dose["container"] in row["id"]) == (not is_one_container)
            assert row["verdict"] == dose["verdict"]
        for container in {dose["container"] for dose in doses}:
            into = [dose for dose in doses if dose["container"] == container]
            if {dose["bracket"] for dose in into} == {"closed"}:
                assert sum(dose["dispensed_mg"] for dose in into) == pytest.approx(into[0]["true_mg"], abs=1.0)
    assert next(table, None) is None
