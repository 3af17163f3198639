"""Cut supplies of a cell of wire twins while the real drivers carry out a recipe in real time, and resume it.

The twins are a process of their own (`scuhand-bt twins`), the run is one on the cell (`simulated` by their word alone):
so consent, refusal and resumption are those of a real cell. One supply or all fail at a random moment for a random
time, now and then with the computer's own. Held against the twins' world and never against the journal's word:

* no servo of arm or roller has torque after its supply was off, before a run was begun or resumed with consent,
* the valve is shut when the run has ended, or the run's end says that it is not known to be,
* a resumed run without consent is refused where the arm is limp,
* what is called in tolerance is in the container, and nothing is lost.
"""

import math
import random
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.kill import LOST_MG, journals
from harness.wire_cell import BEGIN_S, LIMP, Run, WireCell
from scuhand_bt.failures import Code
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.sim.wire.hand import BOOT_S

SUPPLIES = ("arm", "arm", "valve", "hand", "balance", "changer", "cell", "cell")
ARM_SERVOS = frozenset(range(2, 10))
COMPUTER_SHARE = 0.3
"""Of the cuts of the whole cell, how many take the computer, too."""
SOON_SHARE, SOON_S, LATE_S = 0.35, 4.0, 25.0
"""How many cuts come soon after a run has begun or was taken up, within how long, and the others."""
SHORTEST_S, LONGEST_S = 0.002, 15.0
GOES_ON_S = 6.0
"""A run that has not ended so long after the power is back goes on."""
END_S = 90.0
"""A run has ended safe within this after a cut."""
LED_SHARE = 0.7
"""How often a person leads an arm that has sunk back to where it was, before it may be held."""
SHUT_MM, SHUTS_S = 0.05, 1.0
TRIES = 10
"""So often a run that ended safe is resumed."""
LOOK_S = 0.03


@dataclass
class Cut:
    """One failure of a supply, and what was seen of it."""

    supply: str
    length_s: float
    known_s: float | None = None
    """From the cut to the first device that was known to be in fault; None where none was."""
    code: str = ""
    idle: float = 0.0
    """Share of this computer's time that nobody used, around the cut."""
    ended: int | str | None = None
    """The run's exit code; None where it went on."""
    ended_s: float | None = None
    """From the cut to the run's end, which waits for what is made safe."""
    skill: str = ""


@dataclass
class Tally:
    """What was seen."""

    cuts: list[Cut] = field(default_factory=list)
    batches: int = 0
    computer_too: int = 0
    refused_without_consent: int = 0
    valve_open_said: int = 0
    """Runs that ended with the valve open, and said that it was not known to be shut."""
    doses: int = 0
    good: int = 0
    flagged: Counter[str] = field(default_factory=Counter)
    stuck: Counter[str] = field(default_factory=Counter)
    worst_error_mg: float = 0.0
    worst_imbalance_mg: float = 0.0
    problems: list[str] = field(default_factory=list)


def cut_until_done(cell: WireCell, rng: random.Random, cuts: int, tally: Tally) -> None:
    """Run a batch, cutting supplies on its way, then let it end, and judge what came of it."""
    begun: Path | None = None
    run, limp, left, tries = Run(cell, None, consent=True), False, cuts, TRIES
    stood: list[float] = []
    while True:
        if left:
            left -= 1
            if not limp:
                stood = cell.say("look")["joints_deg"]
            limp = _cut(cell, run, rng, tally) or limp
        else:
            run.wait(time.monotonic() + 600.0)
        begun = begun or next(journals(cell.runs), None)
        if run.look():
            if not left and tries == 0:
                run.kill()
                tally.problems.append(f"seed {cell.seed}: it does not end")
            continue
        if begun is not None and read_history(begun).is_complete:
            break
        if not left:
            tries -= 1
        if tries < 0:
            break
        if limp and begun is not None:
            _resume_without_consent(cell, begun, tally)
            if rng.random() < LED_SHARE:
                cell.say("lead", *map(str, stood))
        limp = limp or _mend(cell, begun)
        run, limp = Run(cell, begun, consent=limp or begun is None), False
    assert begun is not None
    tally.batches += 1
    _judge(cell, begun, run.code, tally)


def _mend(cell: WireCell, begun: Path | None) -> bool:
    """What a person does whom the run's end tells to; whether the arm was let go by that.

    What touches something is led to where it parks; a balance that was switched on loaded is so again, without a load.
    """
    ended = read_history(begun).ended if begun is not None else None
    if ended is not None and "underload" in ended.reason:
        cell.say("power", "off", "balance")
        time.sleep(0.3)
        cell.say("power", "on", "balance")
    if ended is None or Code.ARM_START_IN_COLLISION not in ended.reason:
        return False
    cell.say("power", "off", "arm")
    cell.say("power", "on", "arm")
    time.sleep(0.5)
    cell.say("lead", *(f"{math.degrees(angle):g}" for angle in cell.motion.home()))
    return True


def _cut(cell: WireCell, run: Run, rng: random.Random, tally: Tally) -> bool:
    """Let one supply fail; whether the arm's did."""
    if not run.wait(time.monotonic() + BEGIN_S, run.has_begun):
        return False
    run.wait(time.monotonic() + rng.uniform(0.0, SOON_S if rng.random() < SOON_SHARE else LATE_S))
    if not run.look():
        return False
    supply = rng.choice(SUPPLIES)
    length_s = math.exp(rng.uniform(math.log(SHORTEST_S), math.log(LONGEST_S)))
    takes_computer = supply == "cell" and rng.random() < COMPUTER_SHARE
    cut = Cut(supply, length_s)
    tally.cuts.append(cut)
    problem = _problems(cell, tally, cut)
    begun = next(journals(cell.runs), None)
    actions = read(begun, "action") if begun is not None else []
    cut.skill = actions[-1]["skill"] if actions else ""
    told, before = len(run.told), cpu_time_s()
    at_s = float(cell.say("power", "off", supply)["at_s"])
    if takes_computer:
        run.kill()
        tally.computer_too += 1
    off_until_s, arm_is_off = at_s + length_s, supply in ("arm", "cell")
    while time.monotonic() < off_until_s:
        _look(cell, arm_is_off, problem)
        time.sleep(max(0.0, min(LOOK_S, off_until_s - time.monotonic())))
    cell.say("power", "on", supply)
    back_s = time.monotonic()
    while run.look() and time.monotonic() < back_s + END_S:
        _look(cell, arm_is_off, problem)
        is_known = any(one.get("code") for one in run.told[told:])
        if not is_known and time.monotonic() > back_s + GOES_ON_S:
            break
        time.sleep(LOOK_S)
        if is_known and time.monotonic() > back_s + GOES_ON_S and not any(_faults(run.told).values()):
            break  # known, sound again, and gone on with
    cut.idle = round(idle_share(before, cpu_time_s()), 2)
    known = [one for one in run.told[told:] if one.get("code")]
    if known:
        cut.known_s, cut.code = round(known[0]["at_s"] - at_s, 4), f"{known[0]['device']}: {known[0]['code']}"
    if arm_is_off and not takes_computer and not known:
        problem("nobody knew of it")
    if run.look() and time.monotonic() >= back_s + END_S:
        problem(f"the run has not ended {END_S:g} s after it")
        run.kill()
    cut.ended = run.code
    if run.code is not None and not takes_computer:
        cut.ended_s = round(run.ended_s - at_s, 1)
    if run.code not in (None, 0, 1, 3, "killed", LIMP):
        problem(f"ended with {run.code}")
    if run.code is not None:
        _settle(cell, arm_is_off, run, problem, tally)
    return arm_is_off


def _faults(told: Sequence[dict[str, Any]]) -> dict[str, str]:
    """The last code of each device."""
    return {one["device"]: one["code"] for one in told if "device" in one}


def _problems(cell: WireCell, tally: Tally, cut: Cut) -> Callable[[str], None]:
    def problem(what: str) -> None:
        said = f"seed {cell.seed}, cut {len(tally.cuts)} ({cut.supply}, {cut.length_s:.3f} s, {cut.skill}): {what}"
        if said not in tally.problems:
            tally.problems.append(said)

    return problem


def _look(cell: WireCell, arm_is_off: bool, problem: Callable[[str], None]) -> None:
    if arm_is_off and (holding := ARM_SERVOS & set(cell.say("look")["holding"])):
        problem(f"servos {sorted(holding)} have torque without anybody's consent")


def _settle(cell: WireCell, arm_is_off: bool, run: Run, problem: Callable[[str], None], tally: Tally) -> None:
    """Once the run has ended and the board has begun: the valve is shut within a second, or the end said it is not."""
    time.sleep(BOOT_S + SHUTS_S)
    _look(cell, arm_is_off, problem)
    if (opening_mm := cell.say("look")["opening_mm"]) > SHUT_MM:
        begun = next(journals(cell.runs), None)
        ended = read_history(begun).ended if begun is not None else None
        said = ended.reason if ended is not None else ""
        if run.code == "killed" or "valve" not in said:
            problem(f"the valve is open by {opening_mm:.2f} mm, and the run has ended with {run.code}: '{said}'")
        else:
            tally.valve_open_said += 1


def _resume_without_consent(cell: WireCell, begun: Path, tally: Tally) -> None:
    run = Run(cell, begun, consent=False)
    while run.wait(time.monotonic() + LOOK_S, run.has_begun) and not run.has_begun():
        if ARM_SERVOS & set(cell.say("look")["holding"]):
            break
    run.wait(time.monotonic() + 5.0)
    if run.code == LIMP and not ARM_SERVOS & set(cell.say("look")["holding"]):
        tally.refused_without_consent += 1
    else:
        tally.problems.append(f"seed {cell.seed}: resumed a limp arm without consent: {run.code}, {run.told[-2:]}")
        run.kill()


def _judge(cell: WireCell, begun: Path, code: int | str | None, tally: Tally) -> None:
    history, events = read_history(begun), read(begun, "event")
    if not history.is_complete:
        tally.stuck[history.ended.reason[:60] if history.ended is not None else f"ended with {code}"] += 1
    masses_mg = cell.say("look")["masses_mg"]
    there_mg = sum(source.amount_mg for source in cell.plan.recipe.sources.values())
    imbalance_mg = abs(math.fsum(masses_mg.values()) - there_mg)
    tally.worst_imbalance_mg = max(tally.worst_imbalance_mg, imbalance_mg)
    if imbalance_mg > LOST_MG:
        tally.problems.append(f"seed {cell.seed}: {imbalance_mg} mg lost or made")
    results = {event["payload"]["id"]: event["payload"] for event in events if event["kind"] == "sample"}
    for result in results.values():
        tally.doses += 1
        container = result["doses"][-1]["container"] if result["doses"] else result["id"]
        true_mg = masses_mg.get(f"container:{container}", 0.0)
        failed, verdict = result.get("code"), result["verdict"]
        if failed is not None or verdict != "in tolerance":
            tally.flagged[failed or verdict] += 1
            continue
        tally.good += 1
        tally.worst_error_mg = max(tally.worst_error_mg, abs(true_mg - result["dispensed_mg"]))
        if abs(true_mg - result["target_mg"]) > result["tolerance_mg"]:
            tally.problems.append(
                f"seed {cell.seed}: {result['id']}: 'in tolerance' at {result['dispensed_mg']:.2f} mg, "
                f"{true_mg:.2f} mg true of {result['target_mg']:g} ± {result['tolerance_mg']:g} mg"
            )


def cpu_time_s() -> tuple[float, float]:
    """Time that nobody has used, and all time, of all cores since the computer began."""
    with Path("/proc/stat").open() as stat:
        figures = [float(figure) for figure in stat.readline().split()[1:9]]
    return figures[3] + figures[4], sum(figures)


def idle_share(before: tuple[float, float], after: tuple[float, float]) -> float:
    all_time = after[1] - before[1]
    return (after[0] - before[0]) / all_time if all_time else 1.0
