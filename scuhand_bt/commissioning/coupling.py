"""How long the balance rings after the arm has moved, or the motor has shaken: noted, and taken by nothing by itself.

A dose waits for the balance's own word that it is stable, whatever stands here; this tells whether that word comes
late, and is what a bench is compared with after it was moved.
"""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from scuhand_bt.clock import carried_out, pause
from scuhand_bt.commissioning.held_arm import Jogger, held, led
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.devices.connect import Devices
from scuhand_bt.devices.interfaces import Reading

WATCHED_S = 8.0
"""For so long the balance is looked at after each disturbance."""
REST_SHARE = 0.25
"""The last part of that: what it has come to."""
TIMES = 3
JOG_DEG = 3.0
SHAKEN_S = 2.0
STILL_S = 20.0
SIGMAS = 4.0
DIGITS = 2.0


@dataclass(frozen=True)
class Ringing:
    """What a disturbance does to the balance."""

    apart_mg: float
    """The farthest that a reading went from where the balance came to rest, the disturbance itself with it."""
    rings_s: float
    """From its end until all readings stay near to rest."""


def ringing(readings: Sequence[tuple[float, float]], ended_s: float, near_mg: float) -> Ringing:
    """Of readings (time [s], mg) since a disturbance began, which ended at `ended_s`.

    ValueError where the balance does not come to rest, `near_mg` about one value.
    """
    last_s = readings[-1][0] if readings else ended_s
    resting = [value for time_s, value in readings if time_s >= last_s - REST_SHARE * (last_s - ended_s)]
    if last_s <= ended_s or len(resting) < 3:
        raise ValueError("there were too few readings")
    rest_mg = statistics.median(resting)
    if max(abs(value - rest_mg) for value in resting) > near_mg:
        raise ValueError(f"the readings still vary by {max(resting) - min(resting):.1f} mg")
    far = [time_s for time_s, value in readings if time_s >= ended_s and abs(value - rest_mg) > near_mg]
    apart_mg = max(abs(value - rest_mg) for _, value in readings)
    return Ringing(apart_mg, max((time_s - ended_s for time_s in far), default=0.0))


def find_coupling(site: Site) -> Found:
    """How the balance takes it that the arm moves beside it, and that the hand's motor shakes."""
    site.person.ask(
        "Check that the cone and the pan are empty, and that the balance's shield is as it is while dosing."
    )
    led(site, "Lead the apex over the middle of the pan, 5 to 10 cm above it, and hold it there.")
    with held(site) as devices:
        jogger = Jogger(site, devices)
        site.person.ask(
            f"Joint 1 will now turn by itself, by {JOG_DEG:g}° and back, {TIMES} times; then the motor shakes. May "
            "they?",
            ("go", "stop"),
        )

        def jog() -> None:
            jogger.turn(0, JOG_DEG)
            jogger.turn(0, -JOG_DEG)

        def shake() -> None:
            devices.hand.set_vibration(1.0)
            carried_out(pause(site.clock, SHAKEN_S), site.clock)
            devices.hand.set_vibration(0.0)

        still = _heard(site, devices, lambda: None)
        noise_mg = statistics.pstdev([reading.value_mg for reading in still[0]])
        near_mg = max(SIGMAS * noise_mg, DIGITS * site.cell.balance.readability_mg)
        words = {"at rest": f"{noise_mg:.2g} mg of noise"}
        for what, disturb in (("the arm's motion", jog), ("the motor", shake)):
            rung = [_rung(*_heard(site, devices, disturb), near_mg, what) for _ in range(TIMES)]
            rings_s, apart_mg = max(one.rings_s for one in rung), max(one.apart_mg for one in rung)
            words[what] = f"the readings move by up to {apart_mg:.2g} mg, and are at rest {rings_s:.1f} s after it"
    return Found(words)


def _heard(site: Site, devices: Devices, disturb: Callable[[], None]) -> tuple[list[Reading], float]:
    """The readings since it began, and when [s] it had ended."""
    carried_out(devices.balance.stable_mean(STILL_S), site.clock)
    heard: list[Reading] = []
    devices.balance.on_reading = heard.append
    try:
        disturb()
        ended_s = site.clock.now_s
        carried_out(pause(site.clock, WATCHED_S), site.clock)
    finally:
        devices.balance.on_reading = None
    return heard, ended_s


def _rung(heard: Sequence[Reading], ended_s: float, near_mg: float, what: str) -> Ringing:
    try:
        return ringing([(reading.time_s, reading.value_mg) for reading in heard], ended_s, near_mg)
    except ValueError as error:
        raise NotFound(
            f"{WATCHED_S:g} s after {what}, {error}: check what the balance stands on, its shield, and draughts"
        ) from None
