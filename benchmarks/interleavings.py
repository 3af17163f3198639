"""Let several processes and all that may befall a lab act on one lab, in random interleavings, and judge what came.

    python -m benchmarks.interleavings [--count 1000] [--seed 0] [--json FILE]     # what the program does
    python -m benchmarks.interleavings --planted all [--json FILE]                 # whether the checker finds its bugs

Three of five interleavings have power cuts that change devices, one of ten a careless skill in the lab. What a seed
does is always the same; `--only SEED` shows it. `harness/interleavings.py` says what may happen, and
`harness/interleaving_judge.py` what may come of it.
"""

import argparse
import json
import random
import sys
import tempfile
from pathlib import Path

from harness.interleaving_judge import Tally, judge
from harness.interleavings import CARELESS, Made, interleave, shared_motion
from harness.planted_bugs import BUGS, SEEDS, Bug
from scuhand_bt.motion import MotionPlanner

OUTAGES_SHARE = 0.6
CARELESS_SHARE = 0.1


def drawn(seed: int, folder: Path, motion: MotionPlanner) -> Made:
    """What this seed's interleaving is."""
    rng = random.Random(f"interleaving {seed}")
    careless = rng.choice(list(CARELESS)) if rng.random() < CARELESS_SHARE else ""
    has_outages = not careless and rng.random() < OUTAGES_SHARE
    return Made(seed, folder, motion, has_outages=has_outages, careless=careless, steps=rng.randint(6, 16))


def find(bug: Bug, motion: MotionPlanner) -> tuple[int, list[str]]:
    """The first seed with which a planted bug shows, and what the checker says of it; -1 where none does."""
    for seed in range(SEEDS):
        with tempfile.TemporaryDirectory() as folder:
            has_outages = bool(bug.only)
            made = Made(seed, Path(folder), motion, bug.plant, has_outages, bug.only, bug.careless, script=bug.at(seed))
            if problems := judge(interleave(made), Tally()):
                return seed, problems
    return -1, []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--only", type=int, help="one seed, and all that happens in it")
    parser.add_argument("--planted", choices=["all", *BUGS], help="plant a bug, and look whether it is found")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        motion = shared_motion(Path(folder))
    if given.planted is not None:
        figures, is_good = _planted(list(BUGS) if given.planted == "all" else [given.planted], motion)
    else:
        seeds = [given.only] if given.only is not None else range(given.seed, given.seed + given.count)
        figures, is_good = _random(seeds, motion, shows=given.only is not None, file=given.json)
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    sys.exit(not is_good)


def _random(
    seeds: "range | list[int]", motion: MotionPlanner, *, shows: bool, file: Path | None
) -> tuple[dict[str, object], bool]:
    tally = Tally()
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            done = interleave(drawn(seed, Path(folder), motion))
            for problem in judge(done, tally):
                print(f"\n{problem}")
            if shows:
                print("\n".join(done.happened))
                for command in done.ended:
                    print(f"--- {' '.join(command.args)}: {command.code}\n{command.text}")
        if file is not None and tally.interleavings % 5 == 0:  # who ends this early has what was seen
            file.write_text(json.dumps(vars(tally), indent=1) + "\n", encoding="utf-8")
        print(f"\r{tally.interleavings} interleavings, {len(tally.problems)} problems", end="", file=sys.stderr)
    print(file=sys.stderr)
    print(
        f"{tally.interleavings} interleavings, {tally.with_power_cuts} with power cuts that change devices: "
        f"{tally.processes} processes, {tally.killed} of them killed"
    )
    print(f"{tally.runs} runs, {tally.complete} complete; the others: {dict(tally.stuck)}")
    print(f"{tally.doses} doses, {tally.good} good; worst recorded against true: {tally.worst_error_mg:.2f} mg")
    print(f"worst imbalance of mass: {tally.worst_imbalance_mg:.1e} mg; {tally.forgeries} forgeries refused")
    return vars(tally), not tally.problems


def _planted(names: list[str], motion: MotionPlanner) -> tuple[dict[str, object], bool]:
    found: dict[str, object] = {}
    for name in names:
        seed, problems = find(BUGS[name], motion)
        said = problems[0].partition(": ")[2] if problems else ""
        found[name] = {
            "what": BUGS[name].what,
            "found_with_seed": seed,
            "directed": bool(BUGS[name].script),
            "said": said,
        }
        print(f"{name}: {f'found with seed {seed}: {said[:150]}' if problems else 'NOT FOUND'}", flush=True)
    return found, all(found[name]["found_with_seed"] >= 0 for name in names)  # type: ignore[index]


if __name__ == "__main__":
    main()
