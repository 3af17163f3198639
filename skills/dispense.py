"""Dose powder from the cone's apex into the container on the balance, with a dosing controller.

A dose is weighed before and after with the hand in place (g0, g1, g1' of docs/weighing.md). Between the two, the
controller opens and shuts the valve (docs/dosing.md). When no powder comes, `_gave_out` tells why (docs/no-powder.md).
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from scuhand_bt.cell.believed import LAST_LOADS
from scuhand_bt.cell.dose_loop import DoseRun, run_dose
from scuhand_bt.cell.pan_cleared import SCOOP_DOUBT, STOOD_STILL, stands_still, weigh_broken_off
from scuhand_bt.cell.places import fall_s, over_balance
from scuhand_bt.cell.weighing import (
    note_moved,
    require_unchanged,
    weigh_before_dose,
    weigh_until_still,
    weighing_of,
)
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.devices.interfaces import StableMean
from scuhand_bt.dosing import CONTROLLERS, DEFAULT_CONTROLLER, DoseRequest, new_controller
from scuhand_bt.dosing.bracket import (
    Gross,
    Reference,
    dose_between,
    drift_between,
    fallen_mg,
    later_mg,
    significant,
    watch_s,
)
from scuhand_bt.dosing.characteristic import held_mg
from scuhand_bt.dosing.flow import free_flow
from scuhand_bt.dosing.forecast import dose_s, full_flow_s
from scuhand_bt.dosing.hidden_step import fallen_beside_mg
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.quantity import counted, format_mass
from scuhand_bt.skill import (
    BalanceDoubted,
    Cell,
    Code,
    Dose,
    DoseBegun,
    DoseWeighed,
    Forecast,
    Milligrams,
    Skill,
    SkillFailed,
    Source,
    Steps,
)

ASIDE_MM = 2.0
"""The apex counts as over the container if it is no farther than this from its place."""
ALLOWED_SHARE = 0.1
"""Two weighings of one thing agree if they differ by less than this share of the tolerance."""
FINE_S = 12.0
"""Time [s] that a dose takes beside its full flow, for the uncertainty that its controller is given."""
DIFFERENT_READINGS = 12
"""So many different readings are all multiples of two digits apart, by chance, once in 2^(n-1) times."""
FELL_NOISES = 5.0
"""Least fall of the zero that counts, in digits or noises; sound dry runs show two digits at most."""
RINGS_S = 1.0
"""For so long after the motor has stopped, readings may still be disturbed by it."""
FRESH_LOAD_MG = 1000.0
"""With less in the mortar, a fresh load may not be enough for the last of a dose."""
ROUNDS = 4
"""How often a dose is continued that was finished, and was under once it had been watched."""


def _untold(shown_mg: float) -> str:
    """What a failure says of powder that fell, but is no dose because the balance is not to be believed."""
    return f". The balance shows {shown_mg:.1f} mg in the container; this does not count as a dose"


def _known_controller(name: str) -> str:
    if name and name not in CONTROLLERS:
        raise ValueError(f"no controller is called '{name}'; there are {', '.join(CONTROLLERS)}")
    return name


class Dispense(Skill[Dose]):
    """Dispense a mass from the cone's apex into the container on the balance.

    What is in the container already counts: split doses add up to one target.
    """

    raises = (
        Code.ARM_NOT_OVER_PAN,
        Code.BALANCE_COARSE,
        Code.CONTAINER_MISSING,
        Code.CONTAINER_TOO_SMALL,
        Code.DOSE_NOT_REACHED,
        Code.DOSE_OVERSHOOT,
        Code.DOSE_TOO_SMALL,
        Code.HAND_CONE_EMPTY,
        Code.HAND_NO_FLOW,
        Code.SCOOP_NOTHING,
    )
    devices = ("hand", "balance")
    zones = ("pan",)
    typical_s = 15.0
    interrupted = "reweigh"

    mass_mg: Annotated[Milligrams, Field(gt=0)]
    tolerance_mg: Annotated[Milligrams, Field(gt=0)] = 2.0
    controller: Annotated[str, AfterValidator(_known_controller)] = ""
    """The name of a dosing controller; the run's, if none is given."""
    may_scoop_again: bool = False
    """Whether the workflow scoops again on hand.cone_empty; the last of a dose then comes out of a fresh load."""

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        source, mass_mg, tolerance_mg = (inputs.get(name) for name in ("source", "mass", "tolerance"))
        if not (isinstance(source, Source) and mass_mg and tolerance_mg):
            return Forecast(cls.typical_s)
        powder = source.powder
        widest_mm = min(powder.widest_mm(inputs.get("controller") or DEFAULT_CONTROLLER), cell.hand.max_opening_mm)
        return Forecast(dose_s(mass_mg, tolerance_mg, powder, widest_mm))

    def run(self, cell: Cell) -> Steps[Dose]:
        require_unchanged(cell)
        bracket = cell.believed.bracket
        if bracket is None or cell.believed.pan_empty_mg is None:
            raise SkillFailed(Code.CONTAINER_MISSING, "no container was weighed empty: put `tare` before `dispense`")
        self.request(cell)  # refuses what cannot be dosed before anything is weighed
        if cell.believed.dosing.is_unweighed:
            yield from self.settle(cell)
        self._require_over(cell)
        earlier, mean = yield from weigh_before_dose(cell, self._allowed_mg)
        for _ in range(ROUNDS):
            run, reference, earlier, mean = yield from self._dose(cell, earlier, mean)
            dose = self._judged(cell, run)
            if not (run.finish.reason == "reached" and self._is_under(cell, dose, reference)):
                break
        cell.record.event(dose)
        self._raise_failure(cell, run, dose)
        return dose

    def _dose(
        self, cell: Cell, earlier: Gross, empty: StableMean
    ) -> Steps[tuple[DoseRun, Reference, Gross, StableMean]]:
        """Dose, watch the pan and weigh; returns the run, its reference, and the last two weighings."""
        believed, digit_mg, before = cell.believed, cell.spec.balance.readability_mg, weighing_of(empty)
        lot, bracket = self._source(cell).sheet_key, believed.bracket
        assert bracket is not None
        drift = significant(drift_between(earlier, before, digit_mg), digit_mg)
        later = math.inf
        if (self.controller or cell.controller) == DEFAULT_CONTROLLER:
            # Others stop at the tolerance's edge; a later dose of another powder makes this one less certain.
            others = (dosed for other, dosed in bracket.doses.items() if other != lot)
            later = later_mg(bracket.bare, bracket.loaded, others, digit_mg)
        reference = Reference(before, drift, bracket.dosed_mg(lot), digit_mg, later)
        request = self.request(cell)
        flow_s = full_flow_s(request.target_mg, request.powder, request.max_opening_mm)
        then = replace(before, time_s=before.time_s + FINE_S + flow_s)
        request = replace(request, uncertainty_mg=reference.uncertainty_mg(then))
        controller = new_controller(self.controller or cell.controller, request)
        believed.dosing_towards(self.mass_mg, lot, before)
        cell.record.event(DoseBegun(**dict(empty.written()), lot=lot, target_mg=self.mass_mg))
        yield from cell.record.kept()  # before powder falls
        try:
            devices = cell.hand, cell.balance, cell.clock, cell.record
            run = yield from run_dose(controller, request, *devices, reference, came=cell.came)
        finally:
            gross_mg = cell.balance.latest.value_mg if cell.balance.latest is not None else before.gross_mg
            believed.dosing_ended(gross_mg - before.gross_mg, gross_mg)
        shown_mg = run.last.gross_mg - before.gross_mg
        self._require_readability(cell, run, shown_mg)
        self._learn(cell, run)
        for pair in run.watched:
            note_moved(cell, *pair)
        believed.zero_stepped(max(run.stepped_mg, self._fell_mg(cell, run)))
        pause_s = watch_s(before, run.last, self.tolerance_mg)
        after, mean = yield from weigh_until_still(cell, run.last, 0.0, pause_s, may_gain=True)
        self._require_alive(cell, mean.value_mg - before.gross_mg)
        pairs = ((earlier, before), *run.watched, (after, weighing_of(mean)))
        gained, drift = dose_between(pairs, digit_mg)
        believed.dosed(gained, drift, weighing_of(mean), run.pulses, run.vibration_s)
        cell.record.event(
            DoseWeighed(
                **dict(mean.written()),
                lot=lot,
                before=empty.written(),
                gained_mg=gained.mass_mg,
                gained_uncertainty_mg=gained.uncertainty_mg,
                drift_mg_per_s=drift.rate,
            )
        )
        return run, reference, after, mean

    def _is_under(self, cell: Cell, dose: Dose, reference: Reference) -> bool:
        """Whether its verdict, once its container has gone, is likely to be under."""
        assert cell.believed.bracket is not None
        u_mg = reference.in_the_end_mg(dose.uncertainty_mg, cell.believed.bracket.drift)
        return judge(self.mass_mg, self.tolerance_mg, dose.dispensed_mg, u_mg) == "under"

    @staticmethod
    def _fell_mg(cell: Cell, run: DoseRun) -> float:
        """By how much the zero fell in the dose [mg], by readings that no motor disturbs; 0 if chance explains it."""
        times_s, readings_mg, shaken_s = list[float](), list[float](), -math.inf
        for point in run.curve:
            if point.vibration > 0.0:
                shaken_s = point.time_s
            elif not point.stable and point.time_s > shaken_s + RINGS_S:
                times_s.append(point.time_s)
                readings_mg.append(point.net_mg)
        least_mg = FELL_NOISES * max(cell.spec.balance.readability_mg, cell.balance_belief.noise_mg)
        fell_mg = fallen_mg(readings_mg)
        if fell_mg > least_mg and cell.came is not None and cell.believed.pan is not None:
            falls_s = fall_s(cell.believed.pan)
            fell_mg = min(fell_mg, fallen_beside_mg(times_s, readings_mg, cell.came, falls_s))
        return fell_mg if fell_mg > least_mg else 0.0

    @staticmethod
    def _require_readability(cell: Cell, run: DoseRun, shown_mg: float) -> None:
        """Refuse a display that shows no more than multiples of several digits, or that holds what it shows."""
        digit_mg = cell.spec.balance.readability_mg
        readings_mg = [point.net_mg for point in run.curve if not point.stable]
        seen = {round(mg / digit_mg) for mg in readings_mg}
        first = min(seen, default=0)
        step = math.gcd(*(digits - first for digits in seen))
        if len(seen) >= DIFFERENT_READINGS and step > 1:
            raise SkillFailed(
                Code.BALANCE_COARSE,
                f"all {len(seen)} different readings of the dose are multiples of {step * digit_mg:g} mg apart, but "
                f"robot/cell.yaml gives a readability of {digit_mg:g} mg{_untold(shown_mg)}",
            )
        if (held := held_mg(readings_mg, digit_mg)) > 0.0:
            raise SkillFailed(
                Code.BALANCE_COARSE,
                f"the display stood still during the dose, and then jumped by {held:.1f} mg: the balance holds its "
                f"display{_untold(shown_mg)}",
            )

    @staticmethod
    def _require_alive(cell: Cell, shown_mg: float) -> None:
        """Refuse a frozen display: it hides what has come since."""
        if stands_still(cell):
            raise SkillFailed(Code.BALANCE_COARSE, STOOD_STILL + _untold(shown_mg))

    @property
    def _allowed_mg(self) -> float:
        """By how much two weighings of one thing may differ."""
        return ALLOWED_SHARE * self.tolerance_mg

    def settle(self, cell: Cell) -> Steps[None]:
        """Bring the apex back over the container, and count what has arrived since the last weighing.

        Raises SkillFailed container.changed where more has come, or less, than can have.
        """
        require_unchanged(cell)
        container = cell.believed.pan
        if container is None or cell.believed.bracket is None:
            raise SkillFailed(Code.CONTAINER_MISSING, "no container was weighed before the interruption")
        place, _ = over_balance(cell.spec, container)
        if math.dist(cell.apex_mm(), cell.places_mm[place]) > ASIDE_MM:
            yield from cell.move_to(place)
        yield from weigh_broken_off(cell, at_most=True)

    @staticmethod
    def _require_over(cell: Cell) -> None:
        """Refuse to dose beside the mouth: that powder is lost, and looks like powder that does not flow.

        A real arm stands some millimetres off its place, which is inside most mouths.
        """
        container, aside_mm = cell.believed.pan, cell.aside_of_pan_mm()
        if container is not None and aside_mm > container.mouth_mm / 2:
            raise SkillFailed(
                Code.ARM_NOT_OVER_PAN,
                f"the cone's apex is {aside_mm:.0f} mm from the middle of the pan, but the mouth of '{container.id}' "
                f"is only {container.mouth_mm:g} mm wide: put `move_over` before `dispense` in the workflow",
            )

    def request(self, cell: Cell) -> DoseRequest:
        """The controller's task; raises SkillFailed dose.too_small, container.too_small or hand.cone_empty."""
        hand, balance, container = cell.spec.hand, cell.spec.balance, cell.believed.pan
        if self.tolerance_mg < balance.least_tolerance_mg:
            raise SkillFailed(
                Code.DOSE_TOO_SMALL,
                f"a tolerance of {self.tolerance_mg:g} mg is too small for a balance with a readability of "
                f"{balance.readability_mg:g} mg",
            )
        source = self._source(cell)
        powder = source.powder
        volume_mm3 = (self.mass_mg + self.tolerance_mg) / powder.bulk_density_mg_per_mm3
        if container is not None and volume_mm3 > container.capacity_mm3:
            raise SkillFailed(
                Code.CONTAINER_TOO_SMALL,
                f"{self.mass_mg:g} mg of {powder.name} plus the tolerance take up to {volume_mm3 / 1000:.3f} cm³, but "
                f"'{container.id}' holds only {container.capacity_mm3 / 1000:.3f} cm³",
            )
        return DoseRequest(
            target_mg=self.mass_mg,
            tolerance_mg=self.tolerance_mg,
            gain=powder.paper.gain,
            wait_s=powder.paper.wait_s,
            departures=powder.paper.departures,
            max_opening_mm=min(powder.widest_mm(self.controller or cell.controller), hand.max_opening_mm),
            valve_speed_mm_per_s=hand.valve_speed_mm_per_s,
            valve_dead_time_s=hand.valve_dead_time_s,
            readability_mg=balance.readability_mg,
            balance_period_s=balance.period_s,
            cone_mg=cell.believed.cone_mg,
            came_mg=max(0.0, cell.believed.load.came_mg),
            may_scoop_again=self.may_scoop_again and cell.believed.sources_mg[source.name] > FRESH_LOAD_MG,
            cone_doubt_mg=math.inf if cell.believed.is_probing else SCOOP_DOUBT * powder.load_limit_mg,
            streaming=hand.streaming,
            free_flow=free_flow(powder.bulk_density_mg_per_mm3),
            powder=cell.powder_beliefs.get(source.sheet_key, powder.belief),
            balance=cell.balance_belief,
        )

    @staticmethod
    def _source(cell: Cell) -> Source:
        source = cell.sources.get(cell.believed.cone_source or "")
        if source is None:
            raise SkillFailed(Code.HAND_CONE_EMPTY, "the cone holds no powder")
        return source

    def _learn(self, cell: Cell, run: DoseRun) -> None:
        source = self._source(cell)
        if run.finish.shaken_mg is not None:
            cell.believed.flowed(run.finish.shaken_mg)
        if run.finish.powder is not None:
            cell.powder_beliefs[source.sheet_key] = run.finish.powder
        if (doubt := run.finish.doubt) is not None and cell.balance_belief.fits > 0:
            lag_s = cell.balance_belief.lag_s
            cell.record.event(
                BalanceDoubted(difference_mg=doubt.difference_mg, allowed_mg=doubt.allowed_mg, lag_s=lag_s)
            )
        if run.finish.balance is not None:
            cell.balance_belief = run.finish.balance

    def _judged(self, cell: Cell, run: DoseRun) -> Dose:
        """The dose of this powder as weighed so far, and its verdict."""
        believed = cell.believed
        assert believed.bracket is not None
        so_far, lot = believed.dosing, self._source(cell).sheet_key
        net = believed.bracket.dosed_mg(lot)
        return Dose(
            container=believed.bracket.container,
            lot=lot,
            target_mg=self.mass_mg,
            tolerance_mg=self.tolerance_mg,
            dispensed_mg=net.mass_mg,
            uncertainty_mg=net.uncertainty_mg,
            lasted_s=believed.bracket.lasted_s.get(lot, 0.0),
            pulses=so_far.pulses,
            vibration_s=so_far.vibration_s,
            duration_s=cell.clock.now_s - so_far.began_s,
            controller=self.controller or cell.controller,
            verdict=judge(self.mass_mg, self.tolerance_mg, net.mass_mg, net.uncertainty_mg),
        )

    def _raise_failure(self, cell: Cell, run: DoseRun, dose: Dose) -> None:
        """Raise SkillFailed if the load gave out, or the dose is over or was not reached; else return."""
        reached = f"{dose.dispensed_mg:.1f} mg of {self.mass_mg:g} mg"
        if run.finish.reason in ("empty", "no_flow"):
            raise self._gave_out(cell, reached, dose)
        if dose.error_mg > self.tolerance_mg:
            raise SkillFailed(Code.DOSE_OVERSHOOT, f"{reached}: {dose.error_mg:.1f} mg too much")
        if run.finish.reason == "rest":
            cell.believed.rest_left()
            raise SkillFailed(Code.HAND_CONE_EMPTY, f"{reached}; the rest in the cone flows only when it is shaken")
        if run.finish.reason == "step_limit":
            pulses = counted(dose.pulses, "pulse")
            raise SkillFailed(Code.DOSE_NOT_REACHED, f"{reached} after {dose.duration_s / 60.0:.0f} min, in {pulses}")

    def _gave_out(self, cell: Cell, reached: str, dose: Dose) -> SkillFailed:
        """Why no powder comes: an empty cone, a bridge or a poor scoop, or a source that gives nothing.

        A stuck valve is not among them: the hand has reported that as hand.valve_stuck.
        """
        believed, source = cell.believed, self._source(cell)
        came_mg, held_mg = believed.load.came_mg, believed.cone_mg
        # Of a small dose of which nothing has come, all is missing and not only its last milligrams.
        has_begun = dose.dispensed_mg > self.tolerance_mg or not believed.load.is_barren
        lacked_mg = -dose.error_mg if has_begun else math.inf
        believed.gave_out(is_short=self.request(cell).given_up(0.0) == "no_flow", lacked_mg=lacked_mg)
        if source.name in believed.barren_sources:
            left = format_mass(believed.sources_mg.get(source.name, 0.0))
            return SkillFailed(
                Code.SCOOP_NOTHING,
                f"{believed.barren[source.name].loads} loads in a row from '{source.name}' brought nothing. {left} "
                "should be left. If there is less, refill it or correct the recipe's amount. If the powder stands at "
                "the sides, level it; if it bridges, dry or sieve it. Check that the sheet opens and the motor shakes",
            )
        if believed.dosing.in_vain >= LAST_LOADS:
            what = f"{LAST_LOADS} loads in a row brought nothing of the last {lacked_mg:.1f} mg"
            return SkillFailed(Code.DOSE_NOT_REACHED, f"{reached}: {what} (valve open, motor shaking)")
        if not believed.is_load_doubted:
            return SkillFailed(Code.HAND_CONE_EMPTY, f"the cone ran empty at {reached}")
        came = f"{max(came_mg, 0.0):.0f} mg of this load have come, and the cone should hold {held_mg:.0f} mg more"
        return SkillFailed(Code.HAND_NO_FLOW, f"no powder comes at {reached} (valve open, motor shaking): {came}")
