"""The tables of docs/dosing-benchmark.md and docs/dosing-constants.md, from what `benchmarks.dosing` and
`benchmarks.dosing_ablation` kept.

python -m benchmarks.dosing_tables [benchmarks/dosing_results.json] [docs]
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from benchmarks.dosing import CALIBRATED, REDO, TARGETS_MG, WAITING
from benchmarks.dosing_ablation import LISTED, LISTED_RESULTS
from benchmarks.dosing_worth import filled
from benchmarks.rig import UNWAITING

Figures = Mapping[str, float]
Key = tuple[str, str, float, str]
"""Row, powder, target and controller."""
RESULTS = Path(__file__).with_name("dosing_results.json")
COMPARED = ("paper", "adaptive", "oracle")


def read(path: Path) -> dict[Key, Figures]:
    kept = {}
    for name, figures in json.loads(path.read_text(encoding="utf-8")).items():
        row, powder, target_mg, controller = name.split(" | ")
        kept[row, powder, float(target_mg), controller] = figures
    return kept


def shipped(results: Mapping[Key, Figures]) -> list[str]:
    """Each powder and target: three controllers side by side, and of `adaptive` how it errs."""
    lines = [
        "| powder | mg | true [%] | reported [%] | error [mg] | worst, > 20 mg | time [s] | of `paper` | of `oracle` |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for powder, target_mg in dict.fromkeys(key[1:3] for key in results if key[0] == CALIBRATED):
        of = [results.get((CALIBRATED, powder, target_mg, name)) for name in COMPARED]
        ours = results[CALIBRATED, powder, target_mg, "adaptive"]
        true, times = (
            ", ".join(f"{figures[name]:.1f}" if figures else "-" for figures in of) for name in ("true", "mean_s")
        )
        against = (f"{ours['mean_s'] / other['mean_s']:.2f}" if other else "" for other in (of[0], of[2]))
        lines.append(
            f"| {powder} | {target_mg:g} | {true} | {ours['reported']:.1f} "
            f"| {ours['mean_mg']:+.2f} ± {ours['sd_mg']:.2f} | {ours['worst_mg']:+.1f}, {ours['beyond_20mg']:g} "
            f"| {times} | {' | '.join(against)} |"
        )
    return lines


def redo(results: Mapping[Key, Figures]) -> list[str]:
    lines = [
        "| powder | mg | doses | true [%], 95 % | reported [%] | worst [mg] | time [s] |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (row, powder, target_mg, _), figures in results.items():
        if row == REDO:
            lines.append(
                f"| {powder} | {target_mg:g} | {figures['trials']:g} | {figures['true']:.1f} "
                f"({figures['low']:.1f}–{figures['high']:.1f}) | {figures['reported']:.1f} "
                f"| {figures['worst_mg']:+.1f} | {figures['mean_s']:.1f} |"
            )
    return lines


def robust(results: Mapping[Key, Figures]) -> list[str]:
    rows = list(dict.fromkeys(key[0] for key in results if key[0] not in (CALIBRATED, REDO)))
    lines = [
        "| row | powder | " + " | ".join(f"{target_mg:g} mg" for target_mg in TARGETS_MG) + " | worst [mg] |",
        "| --- | --- |" + " --- |" * (len(TARGETS_MG) + 1),
    ]
    for row in rows:
        for powder in dict.fromkeys(key[1] for key in results if key[0] == row):
            cells = [results[row, powder, target_mg, "adaptive"] for target_mg in TARGETS_MG]
            scores = " | ".join(f"{cell['true']:.1f} ({cell['reported']:.1f})" for cell in cells)
            lines.append(f"| {row} | {powder} | {scores} | {max(cell['worst_mg'] for cell in cells):+.1f} |")
    return lines


def waiting(results: Mapping[Key, Figures]) -> list[str]:
    """What of `paper`'s time is waiting for the balance."""
    cells = [key for key in results if key[0] in WAITING and key[3] == UNWAITING]
    lines = [
        "| balance | powder | mg | `paper` | without waiting | `adaptive` | of `paper` | of it without waiting |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row, powder, target_mg, _ in cells:
        doses = [results[row, powder, target_mg, name] for name in ("paper", UNWAITING, "adaptive")]
        shown = " | ".join(f"{figures['true']:.1f}, {figures['mean_s']:.1f}" for figures in doses)
        ratios = " | ".join(f"{doses[2]['mean_s'] / figures['mean_s']:.2f}" for figures in doses[:2])
        lag = "lag 0.3 s" if row == CALIBRATED else row
        lines.append(f"| {lag} | {powder} | {target_mg:g} | {shown} | {ratios} |")
    return lines


def page_with_worth(page: str) -> str:
    """What the law's constants are worth, by `benchmarks.dosing_ablation --listed`."""
    results = json.loads(LISTED_RESULTS.read_text(encoding="utf-8"))
    return filled(page, results, yaml.safe_load(LISTED.read_text(encoding="utf-8")))


def page_with_tables(page: str, results: Mapping[Key, Figures]) -> str:
    """The benchmark's page with each table between its marks."""
    for name, table in {"shipped": shipped, "waiting": waiting, "redo": redo, "robust": robust}.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        before, _, rest = page.partition(begin)
        _, found, after = rest.partition(end)
        if not found:
            raise ValueError(f"the page has no marks for the table '{name}'")
        page = before + begin + "\n".join(table(results)) + "\n" + end + after
    return page


def main(arguments: Sequence[str]) -> int:
    """Replace the benchmark's tables, and the columns of what constants are worth."""
    source = Path(arguments[0]) if arguments else RESULTS
    docs = Path(arguments[1]) if len(arguments) > 1 else Path(__file__).parent.parent / "docs"
    page = docs / "dosing-benchmark.md"
    page.write_text(page_with_tables(page.read_text("utf-8"), read(source)), "utf-8")
    constants = docs / "dosing-constants.md"
    constants.write_text(page_with_worth(constants.read_text("utf-8")), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
