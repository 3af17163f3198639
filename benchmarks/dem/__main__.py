"""What planned strokes collect, by discrete elements and by the height field: `python -m benchmarks.dem`.

    --folder DIR    keeps every case and its result there, and runs only those that have none yet
    --only NAME ... these cases alone, beside the rows that the file has
    --json FILE     the figures, `benchmarks/dem_results.json` unless named
    --pictures DIR  `docs` unless named

Needs Debian's `yade` (`apt-get install yade`), which runs in a process of its own: half a minute of the
processor for every stroke. The figures say which version it was, and how many seconds each case took.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.dem.bed import collected_mg
from benchmarks.dem.cases import Case, Way, cases
from benchmarks.dem.pictures import draw

PROGRAM = Path(__file__).parent / "strokes_in_beads.py"
RESULTS = Path(__file__).parent.parent / "dem_results.json"
DOCS = Path(__file__).parent.parent.parent / "docs"


def by_discrete_elements(case: Case, folder: Path) -> dict[str, Any]:
    """Run one case, or read what it came to before."""
    name = "_".join(case.name.replace(",", "").split())
    asked, came = folder / f"{name}.case.json", folder / f"{name}.json"
    written = json.dumps(case.written())
    if not (came.exists() and asked.exists() and asked.read_text() == written):
        asked.write_text(written)
        subprocess.run(
            ["nice", "-n", "4", "yade", "-n", "-x", "-j1", str(PROGRAM), str(asked), str(came)],
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    found: dict[str, Any] = json.loads(came.read_text())
    return found


def figures(case: Case, found: dict[str, Any]) -> dict[str, Any]:
    """A row of the table; masses in mg."""
    collected = [stroke["collected_mg"] for stroke in found["strokes"]]
    left_mg = found["strokes"][-1]["left_mg"]
    field = collected_mg(case, found["fill_mg"])
    return {
        "mortar": case.mortar.name,
        "grain_mm": case.grain_mm,
        "gap_mm": case.gap_mm,
        "jams": case.jams,
        "friction_deg": [case.friction_deg, case.wall_friction_deg],
        "fill_mg": found["fill_mg"],
        "collected_mg": collected,
        "left_mg": left_mg,
        "spilled_mg": found["fill_mg"] - sum(collected) - left_mg,
        "cpu_s": found["cpu_s"],
        "height_field_mg": field.collected_mg,
        "height_field_spilled_mg": field.spilled_mg,
    }


def in_lines(results: dict[str, Any]) -> str:
    """A line for each case, and for each list of poses that one of them has."""
    used = sorted({way for row in results["cases"].values() for way in row["ways"]})
    rows = {name: row | {"ways": [used.index(way) for way in row["ways"]]} for name, row in results["cases"].items()}
    cases = ",\n".join(f"{json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items())
    ways = ",\n".join(json.dumps(results["ways"][way]) for way in used)
    return f'{{"yade": {json.dumps(results["yade"])},\n"cases": {{\n{cases}\n}},\n"ways": [\n{ways}\n]}}\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--json", type=Path, default=RESULTS)
    parser.add_argument("--pictures", type=Path, default=DOCS)
    asked = parser.parse_args()
    every = list(cases())
    if unknown := set(asked.only or []) - {case.name for case in every}:
        parser.error(f"no such case: {', '.join(sorted(unknown))}; there are: {'; '.join(case.name for case in every)}")
    version = subprocess.run(["yade", "--version"], capture_output=True, text=True).stdout.split("\n")[0]
    with tempfile.TemporaryDirectory() as own:
        folder = asked.folder or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        table: dict[str, Any] = {}
        ways: list[Way] = []
        if asked.only is not None:
            kept = json.loads(asked.json.read_text())
            table, ways = kept["cases"], kept["ways"]
        for case in every:
            if asked.only is not None and case.name not in asked.only:
                continue
            found = by_discrete_elements(case, folder)
            ways += [way for way in case.strokes if way not in ways]
            table[case.name] = figures(case, found) | {"ways": [ways.index(way) for way in case.strokes]}
            print(case.name, table[case.name], flush=True)
            asked.json.write_text(in_lines({"yade": version, "cases": table, "ways": ways}))
            if found["pictures"]:
                draw(case, found, asked.pictures / f"scoop-dem-{case.name.split(',')[0].replace(' ', '-')}.png")


if __name__ == "__main__":
    main()
