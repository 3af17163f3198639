"""The worlds that try to make the product say a false 'in tolerance': a name, what is wrong, and what it is made of.

A world with a `limit` has something that no weighing of the container can tell; it is run, and never counted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from harness.bench import Ill
from harness.ills_filters import (
    Adaptive,
    Coarse,
    Delay,
    Figures,
    FromContainer,
    Frozen,
    Hold,
    Later,
    MovingMean,
    Poles,
    Ringing,
    ZeroTracking,
)
from harness.ills_forces import Between, Creep, Decay, Draught, Drift, HandForce, PowderForce, Sine, Span, Step, Walk
from harness.ills_powder import Astray, Drip, Drips, Exchanged, Leak, Leftover, Loss, Sheet, carried, dosed, shaken
from scuhand_bt.sim.mass_ledger import PAN


@dataclass(frozen=True)
class HostileWorld:
    """One of them; `ills` makes them anew for each run, `faults` is a fault file's text (docs/faults.md)."""

    name: str
    summary: str
    ills: Callable[[], Sequence[Ill]] = tuple
    faults: str | None = None
    limit: str | None = None
    """Why no weighing can tell."""


W = HostileWorld
ANY_TIME_S = (0.0, 60.0)
SMALL = ("placed", "opened", "near")
CLOGS = "{fault: powder.clog, probability: 0.2}"
PAPER_MSG = {"packing_variation": 0.4, "surge_share": 0.4, "surge_mg": 1.5}
"""Errors of about the paper's spread (Table I: 1.9 mg at 0.5 g, 1.5 mg at 3 g), shaken or not."""
WORLDS: tuple[HostileWorld, ...] = (
    W("sound", "Nothing is wrong."),
    # The zero jumps.
    W("step-any-time", "0.5 to 5 mg, within a minute of each container", lambda: [Step("placed", ANY_TIME_S)]),
    W("step-after-tare", "0.5 to 5 mg, 4 to 8 s after the container came", lambda: [Step("placed", (4.0, 8.0))]),
    W("step-while-scooping", "0.5 to 5 mg while the cone scoops", lambda: [Step("scooping", (0.0, 4.0))]),
    W("step-before-opening", "0.5 to 5 mg soon after the hand rests over the pan", lambda: [Step("over", (0.0, 5.0))]),
    W("step-while-open", "0.5 to 5 mg in the first seconds of the dose", lambda: [Step("opened", (0.1, 3.0))]),
    W("step-near-end", "0.5 to 5 mg near the dose's end", lambda: [Step("near", (0.0, 4.0))]),
    W("step-at-leaving", "0.5 to 5 mg as the hand leaves", lambda: [Step("leaving", (0.0, 1.0))]),
    W("step-when-left", "0.5 to 5 mg soon after the hand has left", lambda: [Step("gone", (0.0, 8.0))]),
    W("step-bare", "0.5 to 5 mg on the bare pan", lambda: [Step("bare", (0.0, 6.0))]),
    W("step-and-back", "up, and down again seconds later", lambda: [Step("placed", ANY_TIME_S, back_s=(1.0, 20.0))]),
    W("push-in-the-dose", "3 mg from the first opening until the hand leaves", lambda: [Between("opened", "leaving")]),
    W("push-at-the-end", "3 mg from near the dose's end until the hand is away", lambda: [Between("near", "gone")]),
    W(
        "push-until-bare",
        "3 mg from the first opening until the bare pan has nearly come to rest",
        lambda: [Between("opened", "bare", later_s=3.0)],
    ),
    W("steps-small", "0.5 to 1 mg at three moments", lambda: [Step(m, (0, 5), (-1, -0.5, 0.5, 1)) for m in SMALL]),
    W(
        "steps-cancelling",
        "3 mg up or down before the dose, and again about it",
        lambda: [Step("placed", (4.0, 30.0), (-3.0, 3.0)), Step("opened", (0.0, 12.0), (-3.0, 3.0))],
    ),
    W(
        "step-and-back-rarely",
        "up, and down again, at one container of four",
        lambda: [Step("placed", ANY_TIME_S, back_s=(1.0, 30.0), chance=0.25)],
    ),
    W(
        "step-in-the-changer",
        "up on the bare pan, and down again as the container comes, or later",
        lambda: [Step("bare", (0.0, 8.0), back_s=(5.0, 25.0))],
    ),
    W(
        "flickering",
        "three times for each container up, and down again within 3 s",
        lambda: [Step(moment, (0.0, 10.0), (-2.0, 2.0), back_s=(0.5, 3.0)) for moment in SMALL],
    ),
    # The container, or the hand, brings a force.
    W("warm-quick", "warm or cold containers: 2 to 8 mg within 60 to 120 s", lambda: [Decay((2, 8), (60, 120))]),
    W("warm-slow", "warm or cold containers: 2 to 8 mg within 120 to 300 s", lambda: [Decay((2, 8), (120, 300))]),
    W("charged-container", "4 mg within 120 s, hand or no hand", lambda: [Decay((4, 4), (120, 120))]),
    W("charged-hand", "4 mg while the hand is over the pan", lambda: [HandForce(4.0)]),
    W("charged-hand-decaying", "6 mg under the hand, leaking away within 60 s", lambda: [HandForce(6.0, 60.0)]),
    W("charged-powder", "the dose weighs 4 mg off while the hand is above", lambda: [PowderForce(4.0)]),
    W("creep", "the zero creeps by 1 to 4 mg under load", lambda: [Decay((1, 4), (30, 120), lasting=True)]),
    W("creep-after-opening", "2 to 6 mg come within 60 s of the first opening", lambda: [Creep((2, 6), 60.0)]),
    W("eccentric", "powder weighs 0.02 % off, by where the container stands", lambda: [Span(spread=2e-4)]),
    # The zero wanders.
    W("drift-0.02", "0.02 mg/s", lambda: [Drift(0.02)]),
    W("drift-0.05", "0.05 mg/s", lambda: [Drift(0.05)]),
    W("drift-0.1", "0.1 mg/s", lambda: [Drift(0.1)]),
    W("drift-0.3", "0.3 mg/s", lambda: [Drift(0.3)]),
    W("drift-turning", "0.1 mg/s, turning round every 30 s or so", lambda: [Drift(0.1, 30.0)]),
    W("drift-turning-quickly", "0.3 mg/s, turning round every 10 s or so", lambda: [Drift(0.3, 10.0)]),
    W("drift-turning-5", "0.5 mg/s, turning round every 5 s or so", lambda: [Drift(0.5, 5.0)]),
    W("drift-turning-60", "0.05 mg/s, turning round every 60 s or so", lambda: [Drift(0.05, 60.0)]),
    W("walking", "a zero that walks by 0.2 mg in a second, 1.5 mg in a minute", lambda: [Walk(0.2)]),
    W("sine-20", "2 mg with a period of 20 s", lambda: [Sine(2.0, 20.0)]),
    W("sine-60", "3 mg with a period of 60 s", lambda: [Sine(3.0, 60.0)]),
    W("sine-200", "5 mg with a period of 200 s", lambda: [Sine(5.0, 200.0)]),
    W("draught", "bursts of 3 mg every 15 s", lambda: [Draught(3.0, 15.0)]),
    W("draught-steady", "bursts of 3 mg that hardly change", lambda: [Draught(3.0, 15.0, (5.0, 20.0), lean=0.98)]),
    W(
        "draught-long",
        "pushes of 3 mg that hardly change, for 20 to 60 s",
        lambda: [Draught(3.0, 40.0, (20, 60), lean=0.98)],
    ),
    W("draught-small", "bursts of 1 mg that hardly change", lambda: [Draught(1.0, 15.0, (5.0, 20.0), lean=0.98)]),
    W("draught-fault", "the fault file's draught", faults="{fault: balance.draught, probability: 0.2}"),
    # The balance is slow, or thinks for itself.
    W("poles-0.6", "two poles of 0.6 s", lambda: [Figures(lag_s=0.6)]),
    W("poles-1.0", "two poles of 1 s", lambda: [Figures(lag_s=1.0)]),
    W("poles-1.6", "two poles of 1.6 s", lambda: [Figures(lag_s=1.6)]),
    W("poles-3.0", "two poles of 3 s", lambda: [Figures(lag_s=3.0)]),
    W("mean-1", "a moving mean of 1 s", lambda: [MovingMean(1.0)]),
    W("mean-2", "a moving mean of 2 s", lambda: [MovingMean(2.0)]),
    W("mean-4", "a moving mean of 4 s", lambda: [MovingMean(4.0)]),
    W("mean-6", "a moving mean of 6 s", lambda: [MovingMean(6.0)]),
    W("delay-0.3", "readings 0.3 s late", lambda: [Delay(0.3)]),
    W("delay-1", "readings 1 s late", lambda: [Delay(1.0)]),
    W("delay-3", "readings 3 s late", lambda: [Delay(3.0)]),
    W("adaptive-slow", "follows within 4 s what is less than 1 mg off", lambda: [Adaptive(1.0, 4.0)]),
    W("hold-0.3", "holds its display over less than 0.3 mg", lambda: [Hold(0.3)]),
    W("hold-1", "holds its display over less than 1 mg", lambda: [Hold(1.0)]),
    W("hold-3", "holds its display over less than 3 mg, as the load is lifted too", lambda: [Hold(3.0)]),
    W("zero-tracking", "swallows what comes slower than 0.3 mg/s", lambda: [ZeroTracking(1.0, 0.3)]),
    W("ringing", "underdamped: 0.6 Hz, damping 0.12", lambda: [Ringing(0.6, 0.12)]),
    W(
        "ringing-and-back",
        "the same, and the zero up or down in the dose, and back seconds later",
        lambda: [Ringing(0.6, 0.12), Step("opened", (0.1, 8.0), back_s=(1.0, 20.0))],
    ),
    W(
        "ringing-pushed",
        "the same, and 3 mg from the first opening until the hand leaves",
        lambda: [Ringing(0.6, 0.12), Between("opened", "leaving")],
    ),
    W("mean-later", "a moving mean of 6 s from some time on", lambda: [Later(MovingMean(6.0), (20.0, 200.0))]),
    W("hold-later", "a display that holds over 2 mg from some time on", lambda: [Later(Hold(2.0), (20.0, 200.0))]),
    W("poles-between", "0.7 s more a pole from the second container on", lambda: [FromContainer(Poles(0.7), 2)]),
    W("mean-between", "a moving mean of 2 s from the second container on", lambda: [FromContainer(MovingMean(2.0), 2)]),
    W("poles-3.0-between", "two poles of 3 s from the second container on", lambda: [FromContainer(Poles(3.0), 2)]),
    W("noisy", "0.5 mg of noise instead of 0.08", lambda: [Figures(noise_mg=0.5)]),
    W("coarse-0.5", "0.5 mg digits, shown with 0.1 mg", lambda: [Coarse(0.5)]),
    W("coarse-2", "2 mg digits, shown with 0.1 mg", lambda: [Coarse(2.0)]),
    W("frozen-seconds", "frozen for 5 to 20 s within the dose", lambda: [Frozen("opened", (0, 10), (5, 20))]),
    W("frozen-at-end", "frozen near the dose's end, for 10 to 40 s", lambda: [Frozen("near", (0, 2), (10, 40))]),
    W(
        "frozen-until-lifted",
        "frozen from the dose's end until the container is lifted",
        lambda: [Frozen("near", (0, 2), until_lifted=True)],
    ),
    W("frozen-for-ever", "frozen from some moment on, for ever", lambda: [Frozen("placed", (0, 60), chance=0.2)]),
    # Powder goes where, or comes when, nobody told it to.
    W("leak-0.02", "the shut valve leaks 0.02 mg/s", lambda: [Leak(0.02)]),
    W("leak-0.1", "the shut valve leaks 0.1 mg/s", lambda: [Leak(0.1)]),
    W("leak-0.3", "the shut valve leaks 0.3 mg/s", lambda: [Leak(0.3)]),
    W("leak-1", "the shut valve leaks 1 mg/s", lambda: [Leak(1.0)]),
    W("leak-shaken", "leaks 1 mg/s while it is shaken", lambda: [Leak(1.0, shaken)]),
    W("leak-carried", "leaks 3 mg/s while the arm moves", lambda: [Leak(3.0, carried)]),
    W("leak-late", "leaks 0.5 mg/s when the dose is nearly there", lambda: [Leak(0.5, dosed)]),
    W("drips", "lumps of 3 mg every 20 s", lambda: [Drips(20.0, 3.0)]),
    W("drip-after-shutting", "2 mg within 10 s of a shutting", lambda: [Drip("shut", 2.0, (0.3, 10.0), chance=0.3)]),
    W("drip-at-leaving", "20 mg/s for 0.3 s as the hand leaves", lambda: [Drip("leaving", 6.0, (0.0, 0.3))]),
    W("beside-5", "5 % of the powder lands beside the mouth", lambda: [Astray(0.05)]),
    W("beside-sometimes", "at some containers 20 % land beside", lambda: [Astray(0.2, chance=0.3)]),
    W("puff-in-the-dose", "3 to 8 mg fly away while it doses", lambda: [Loss("near", (3, 8), (0.0, 3.0))]),
    W("puff-at-leaving", "3 to 8 mg fly away as the hand leaves", lambda: [Loss("leaving", (3, 8), (0.0, 1.0))]),
    W("knock", "3 to 8 mg jump onto the pan as the hand leaves", lambda: [Loss("leaving", (3, 8), (0, 1), onto=PAN)]),
    # The sheet is wrong.
    W("flow-twice", "twice the flow that the sheet says", lambda: [Sheet(2.0)]),
    W("flow-half", "half the flow that the sheet says", lambda: [Sheet(0.5)]),
    W("paper-spread", "the paper's own spread", lambda: [Sheet(1.0, PAPER_MSG)]),
    W("lumps", "lumps of 6 mg", lambda: [Sheet(1.0, {"surge_share": 0.6, "surge_mg": 6.0})]),
    W("squeezed", "closing squeezes 6 mg/mm out of the slot", lambda: [Sheet(1.0, {"slot_mg_per_mm": 6.0})]),
    W("clogging", "arches, and clogs", lambda: [Sheet(1.0, {"arch_diameter_mm": 0.8})], CLOGS),
    W("slow-valve", "the valve moves at two fifths of its speed", faults="{fault: valve.slow, probability: 0.3}"),
    # Some of all.
    W(
        "all-a-little",
        "a slow balance, drift, small steps, a small leak, noise",
        lambda: [
            Figures(lag_s=0.6, noise_mg=0.15),
            Drift(0.02, 60.0),
            Step("placed", ANY_TIME_S, (-0.5, 0.5)),
            Leak(0.02),
            Sheet(1.3),
        ],
    ),
    W("held-leak", "a display that holds 1 mg, over a leak", lambda: [Hold(1.0), Leak(0.05)]),
    W("tracked-leak", "zero tracking, over a leak", lambda: [ZeroTracking(1.0, 0.3), Leak(0.1)]),
    W(
        "held-drip",
        "a display that holds 3 mg, over drips of 2.5 mg",
        lambda: [Hold(3.0), Drip("shut", 2.5, (0.3, 5.0))],
    ),
    W(
        "frozen-drip",
        "frozen after a shutting, and 4 mg drip",
        lambda: [Frozen("shut", (0.5, 3.0), (10, 60), chance=0.3), Drip("near", 4.0, (1.0, 6.0))],
    ),
    W("slow-drips", "a moving mean of 4 s, over drips", lambda: [MovingMean(4.0), Drips(15.0, 3.0)]),
    # What no weighing of the container can tell.
    W("exchanged", "pairs of containers are exchanged", lambda: [Exchanged()], limit="one container weighs as another"),
    W("leftover", "5 to 50 mg are in the container", lambda: [Leftover((5, 50))], limit="it came with the container"),
    W("outside", "5 % stick to the outside", lambda: [Astray(0.05, outside=True)], limit="it goes with the container"),
    W("span", "powder weighs 0.5 % too much", lambda: [Span(share=0.005)], limit="a check weight tells, no zero"),
    W(
        "touching",
        "the container leans on something from the first opening until it is lifted: 3 mg",
        lambda: [Between("opened", "bare")],
        limit="the force comes with the powder and goes with the container",
    ),
    W(
        "loss-in-the-changer",
        "3 to 8 mg are lost as the changer lifts it",
        lambda: [Loss("gone", (3, 8), (10.0, 14.0))],
        limit="it is lost after its last weighing",
    ),
)
BY_NAME = {world.name: world for world in WORLDS}
