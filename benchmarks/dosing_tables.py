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
MARK = "<!-- results -->"


def read(path: Path) -> dict[Key, Figures]:
    kept = {}
    for name, figures in json.loads(path.read_text(encoding="utf-8")).items():
        row, powder, target_mg, controller = name.split(" | ")
        kept[row, powder, float(target_mg), controller] = figures
    return kept


def trials(results: Mapping[Key, Figures], rows: Sequence[str]) -> str:
    counts = sorted({int(figures["trials"]) for key, figures in results.items() if key[0] in rows})
    return " to ".join(map(str, counts[:1] + counts[1:][-1:]))


def calibrated(results: Mapping[Key, Figures]) -> list[str]:
    lines = [
        "As calibrated:",
        "",
        "| powder | target | controller | doses | success (true), 95 % | reported | error [mg] | worst | > 20 mg "
        "| time [s], p95 | of `paper` | of `oracle` |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (row, powder, target_mg, controller), figures in results.items():
        if row != CALIBRATED or controller == UNWAITING:
            continue
        against = [results.get((row, powder, target_mg, name)) for name in ("paper", "oracle")]
        ratios = [f"{figures['mean_s'] / other['mean_s']:.2f}" if other else "" for other in against]
        lines.append(
            f"| {powder} | {target_mg:g} | {controller} | {figures['trials']:g} | {figures['true']:.1f} "
            f"({figures['low']:.1f}–{figures['high']:.1f}) | {figures['reported']:.1f} "
            f"| {figures['mean_mg']:+.2f} ± {figures['sd_mg']:.2f} | {figures['worst_mg']:+.1f} "
            f"| {figures['beyond_20mg']:g} | {figures['mean_s']:.1f}, {figures['p95_s']:.1f} "
            f"| {ratios[0]} | {ratios[1]} |"
        )
    return lines


def redo(results: Mapping[Key, Figures]) -> list[str]:
    lines = [
        "## Dosed again",
        "",
        f"Doses up to 50 mg that were reported out of tolerance are dosed once more into a new container, and their "
        f"times added; {trials(results, [REDO])} doses a cell:",
        "",
        "| powder | target | controller | success (true), 95 % | reported | worst | time [s] |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (row, powder, target_mg, controller), figures in results.items():
        if row == REDO:
            lines.append(
                f"| {powder} | {target_mg:g} | {controller} | {figures['true']:.1f} "
                f"({figures['low']:.1f}–{figures['high']:.1f}) | {figures['reported']:.1f} "
                f"| {figures['worst_mg']:+.1f} | {figures['mean_s']:.1f} |"
            )
    return lines


def robust(results: Mapping[Key, Figures]) -> list[str]:
    rows = list(dict.fromkeys(key[0] for key in results if key[0] not in (CALIBRATED, REDO)))
    lines = [
        "## Robustness",
        "",
        f"`adaptive` with free-flowing powders, told of none of this; success by true (by reported) mass in %, of "
        f"{trials(results, rows)} doses a cell, and the worst overshoot of the row.",
        "",
        "| row | powder | " + " | ".join(f"{target_mg:g} mg" for target_mg in TARGETS_MG) + " | worst [mg] |",
        "| --- | --- | " + "--- | " * (len(TARGETS_MG) + 1),
    ]
    for row in rows:
        for powder in dict.fromkeys(key[1] for key in results if key[0] == row):
            cells = [results[row, powder, target_mg, "adaptive"] for target_mg in TARGETS_MG]
            scores = " | ".join(f"{cell['true']:.1f} ({cell['reported']:.1f})" for cell in cells)
            lines.append(f"| {row} | {powder} | {scores} | {max(cell['worst_mg'] for cell in cells):+.1f} |")
    return lines


def waiting(results: Mapping[Key, Figures]) -> list[str]:
    """What of `paper`'s time is waiting for the balance; none while no such doses were run."""
    cells = [key for key in results if key[0] in WAITING and key[3] == UNWAITING]
    compared = {
        (*cell[:3], name): results[*cell[:3], name] for cell in cells for name in ("paper", UNWAITING, "adaptive")
    }
    lines = [
        "## What waiting for the balance contributes",
        "",
        "`paper` waits 6.3 s after each pulse, as its rig did, and then for the balance to settle; without waiting it "
        "does the latter only. True success in %, mean time in s, and `adaptive`'s time as a share of either; "
        f"{trials(compared, WAITING)} doses a cell:",
        "",
        "| balance | powder | target | `paper` | without waiting | `adaptive` | of `paper` | of it without waiting |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row, powder, target_mg, _ in cells:
        doses = [results[row, powder, target_mg, name] for name in ("paper", UNWAITING, "adaptive")]
        shown = " | ".join(f"{figures['true']:.1f}, {figures['mean_s']:.1f}" for figures in doses)
        ratios = " | ".join(f"{doses[2]['mean_s'] / figures['mean_s']:.2f}" for figures in doses[:2])
        lag = "lag 0.3 s" if row == CALIBRATED else row
        lines.append(f"| {lag} | {powder} | {target_mg:g} | {shown} | {ratios} |")
    return lines if cells else []


def page_with_worth(page: str) -> str:
    """What the law's constants are worth, by `benchmarks.dosing_ablation --listed`."""
    results = json.loads(LISTED_RESULTS.read_text(encoding="utf-8"))
    return filled(page, results, yaml.safe_load(LISTED.read_text(encoding="utf-8")))


def main(arguments: Sequence[str]) -> int:
    """Replace what stands below the benchmark's mark, and the columns of what constants are worth."""
    here = Path(__file__).parent
    source = Path(arguments[0]) if arguments else here / "dosing_results.json"
    docs = Path(arguments[1]) if len(arguments) > 1 else here.parent / "docs"
    results = read(source)
    blocks = [calibrated(results), waiting(results)]
    rows = {key[0] for key in results}
    blocks += [redo(results)] if REDO in rows else []
    blocks += [robust(results)] if rows - {CALIBRATED, REDO} else []
    below = "\n\n".join("\n".join(block).rstrip() for block in blocks if block)
    page = docs / "dosing-benchmark.md"
    page.write_text(page.read_text("utf-8").split(MARK)[0] + MARK + "\n" + below + "\n", "utf-8")
    constants = docs / "dosing-constants.md"
    constants.write_text(page_with_worth(constants.read_text("utf-8")), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
