"""A dose: powder from the cone's apex into the container on the balance, by a dosing controller."""

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from scuhand_bt.cell.dose_loop import DoseRun, run_dose
from scuhand_bt.cell.places import over_balance
from scuhand_bt.dosing import CONTROLLERS, DoseRequest, new_controller
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.skill import Cell, Code, Dose, DoseCurve, Milligrams, Reweighed, Skill, SkillFailed, Steps

ASIDE_MM = 2.0
"""The apex is taken to be over the container where it is no farther than this from its place."""
WANDER_DIGITS = 30.0
"""More than noise, and than a sound balance's zero wanders while the arm scoops."""
SCOOP_DOUBT = 0.15
"""How far what a scoop brought may be from what it was expected to bring, as a share of the load limit."""


def _known_controller(name: str) -> str:
    if name and name not in CONTROLLERS:
        raise ValueError(f"no controller is called '{name}'; there are {', '.join(CONTROLLERS)}")
    return name


class Dispense(Skill[Dose]):
    """Dispense a mass from the cone's apex into the container on the balance.

    What is in the container already counts: split doses add up to one target.
    """

    raises = (
        Code.BALANCE_UNSTABLE,
        Code.CONTAINER_MISSING,
        Code.CONTAINER_TOO_SMALL,
        Code.DOSE_NOT_REACHED,
        Code.DOSE_OVERSHOOT,
        Code.DOSE_TOO_SMALL,
        Code.HAND_CONE_EMPTY,
        Code.HAND_NO_FLOW,
    )
    devices = ("hand", "balance")
    typical_s = 30.0
    interrupted = "reweigh"

    mass_mg: Annotated[Milligrams, Field(gt=0)]
    tolerance_mg: Annotated[Milligrams, Field(gt=0)] = 2.0
    controller: Annotated[str, AfterValidator(_known_controller)] = ""
    """A dosing controller by name; the run's, if none is named."""

    def run(self, cell: Cell) -> Steps[Dose]:
        request, empty_mg = self.request(cell), cell.believed.pan_empty_mg
        if empty_mg is None:
            raise SkillFailed(Code.CONTAINER_MISSING, "no container was weighed empty: `tare` comes before `dispense`")
        if cell.believed.dosing.is_unweighed:
            yield from self.settle(cell)
            request = self.request(cell)
        controller = new_controller(self.controller or cell.controller, request)
        before_mg = (yield from cell.balance.next_reading()).value_mg  # no valve opens over a silent balance
        self._require_zero_held(cell, before_mg)
        cell.believed.dosing_towards(self.mass_mg)
        try:
            run = yield from run_dose(controller, cell.hand, cell.balance, cell.clock, cell.record, empty_mg)
        finally:
            gross_mg = cell.balance.latest.value_mg if cell.balance.latest is not None else before_mg
            cell.believed.dosing_ended(gross_mg - before_mg, gross_mg)
        cell.believed.dosed(empty_mg + run.finish.estimate_mg, run.pulses, run.vibration_s)
        self._learn(cell, run)
        dose = self._dose(cell, run, controller.name)
        cell.record.event(dose)
        cell.record.event(DoseCurve(points=run.rows()))
        self._raise_failure(cell, run, dose)
        return dose

    def settle(self, cell: Cell) -> Steps[None]:
        """The apex over the container again; what has arrived since the pan was last weighed has left the cone."""
        believed = cell.believed
        if believed.pan is None or believed.pan_gross_mg is None:
            raise SkillFailed(Code.CONTAINER_MISSING, "no container was weighed before the interruption")
        place, _ = over_balance(cell.spec, believed.pan)
        if math.dist(cell.apex_mm(), cell.places_mm[place]) > ASIDE_MM:
            yield from cell.move_to(place)
        mean = yield from cell.balance.stable_mean()
        arrived_mg = mean.value_mg - believed.pan_gross_mg
        cell.record.event(Reweighed(**dict(mean.written()), arrived_mg=arrived_mg))
        believed.reweighed(mean.value_mg)

    @staticmethod
    def _require_zero_held(cell: Cell, gross_mg: float) -> None:
        """Nothing has come since the pan was weighed: what it shows otherwise would be taken for powder."""
        before_mg, digit_mg = cell.believed.pan_gross_mg, cell.spec.balance.readability_mg
        if before_mg is not None and abs(gross_mg - before_mg) > WANDER_DIGITS * digit_mg:
            raise SkillFailed(
                Code.BALANCE_UNSTABLE,
                f"the pan shows {gross_mg - before_mg:+.1f} mg against its last weighing, and nothing was dosed since",
            )

    def request(self, cell: Cell) -> DoseRequest:
        """What its controller is asked for, by what is known of powder, balance and hand now."""
        hand, balance, container = cell.spec.hand, cell.spec.balance, cell.believed.pan
        if self.tolerance_mg < balance.least_tolerance_mg:
            raise SkillFailed(
                Code.DOSE_TOO_SMALL,
                f"a tolerance of {self.tolerance_mg:g} mg cannot be told with a readability of "
                f"{balance.readability_mg:g} mg",
            )
        source = cell.sources.get(cell.believed.cone_source or "")
        if source is None:
            raise SkillFailed(Code.HAND_CONE_EMPTY, "the cone holds no powder")
        powder = source.powder
        volume_mm3 = self.mass_mg / powder.bulk_density_mg_per_mm3
        if container is not None and volume_mm3 > container.capacity_mm3:
            raise SkillFailed(
                Code.CONTAINER_TOO_SMALL,
                f"{self.mass_mg:g} mg of {powder.name} are {volume_mm3 / 1000:.2f} cm³; "
                f"'{container.id}' holds {container.capacity_mm3 / 1000:.2f} cm³",
            )
        return DoseRequest(
            target_mg=self.mass_mg,
            tolerance_mg=self.tolerance_mg,
            gain=powder.gain,
            max_opening_mm=min(powder.max_opening_mm, hand.max_opening_mm),
            valve_speed_mm_per_s=hand.valve_speed_mm_per_s,
            valve_dead_time_s=hand.valve_dead_time_s,
            readability_mg=balance.readability_mg,
            balance_period_s=balance.period_s,
            cone_mg=cell.believed.cone_mg,
            cone_doubt_mg=SCOOP_DOUBT * powder.load_limit_mg,
            streaming=hand.streaming,
            powder=cell.powder_beliefs.get(source.sheet_key, powder.belief),
            balance=cell.balance_belief,
        )

    def _learn(self, cell: Cell, run: DoseRun) -> None:
        source = cell.sources[cell.believed.cone_source or ""]
        if run.finish.powder is not None:
            cell.powder_beliefs[source.sheet_key] = run.finish.powder
        if run.finish.balance is not None:
            cell.balance_belief = run.finish.balance

    def _dose(self, cell: Cell, run: DoseRun, controller: str) -> Dose:
        so_far = cell.believed.dosing
        net_mg, uncertainty_mg = run.finish.estimate_mg, run.finish.uncertainty_mg
        return Dose(
            target_mg=self.mass_mg,
            tolerance_mg=self.tolerance_mg,
            dispensed_mg=net_mg,
            uncertainty_mg=uncertainty_mg,
            pulses=so_far.pulses,
            vibration_s=so_far.vibration_s,
            duration_s=cell.clock.now_s - so_far.began_s,
            controller=controller,
            verdict=judge(self.mass_mg, self.tolerance_mg, net_mg, uncertainty_mg),
        )

    def _raise_failure(self, cell: Cell, run: DoseRun, dose: Dose) -> None:
        reached = f"{dose.dispensed_mg:.1f} mg of {self.mass_mg:g} mg"
        if run.finish.reason == "empty":
            # What the cone was thought to hold still, and did not, never left the mortar.
            cell.believed.cone_ran_empty()
            raise SkillFailed(Code.HAND_CONE_EMPTY, f"the cone ran empty at {reached}")
        if run.finish.reason == "no_flow":
            raise SkillFailed(Code.HAND_NO_FLOW, f"no powder comes at {reached}, vibrating at full opening")
        if dose.error_mg > self.tolerance_mg:
            raise SkillFailed(Code.DOSE_OVERSHOOT, f"{reached}: {dose.error_mg:.1f} mg too much")
        if run.finish.reason == "step_limit":
            raise SkillFailed(Code.DOSE_NOT_REACHED, f"{reached} after {dose.pulses} pulses")
