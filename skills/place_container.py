"""Put a container on the balance, and check it by its weight (docs/weighing.md, One dose, step by step: a0 and l0)."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.cell.believed import slots_used
from scuhand_bt.cell.pan_cleared import take_container_away
from scuhand_bt.cell.shown_balance import require_known_delay, seems_to_adapt, shown_step
from scuhand_bt.cell.weighing import changed, is_to_be_weighed_again, note_again, watched, weigh_changed, weighing_of
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.devices.interfaces import StableMean
from scuhand_bt.skill import Cell, Code, Container, ContainerPlaced, Forecast, Skill, SkillFailed, Steps


class PlaceContainer(Skill[None]):
    """Put a container on the pan, taking away the one before, and check by weight that it is the right one."""

    raises = (Code.CONTAINER_CHANGED, Code.CONTAINER_MISSING, Code.CONTAINER_WRONG_MASS, Code.OPERATOR_REFUSED)
    devices = ("changer", "balance")
    zones = ("pan",)
    typical_s = 16.0
    interrupted = "repeat"

    container: Container

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        container = inputs.get("container")
        what = f"{container.name} '{container.id}'" if isinstance(container, Container) else "a container"
        return Forecast.of_change(cell, cls.typical_s, f"put {what} on the pan")

    def run(self, cell: Cell) -> Steps[None]:
        yield from cell.right_of_way.unshaken(self._change(cell))

    def _change(self, cell: Cell) -> Steps[None]:
        believed, exchanging = cell.believed, self._exchanged(cell)
        self._require_known(cell)
        is_by_hand = cell.changer.needs_person or self._short_of(cell) is not None
        bare = yield from cell.right_of_way.undisturbed(exchanging) if is_by_hand else exchanging
        brought_s = cell.clock.now_s
        before = believed.had_gone(self.container.id)
        held_mg = sum(net.mass_mg for net in before.doses.values()) if before is not None else 0.0
        first_slot = cell.spec.changer.first_slot(self.container.name)
        believed.brought(self.container, from_changer=not cell.changer.needs_person, first_slot=first_slot)
        loaded = yield from weigh_changed(cell, bare.value_mg)
        step = cell.came = shown_step(cell, weighing_of(bare), weighing_of(loaded), brought_s)
        mass_mg = loaded.value_mg - bare.value_mg
        container = self.container
        cell.record.event(
            ContainerPlaced(
                container=container.id,
                kind=container.name,
                mass_mg=mass_mg,
                balance=cell.balance.identity,
                bare=bare.written(),
                loaded=loaded.written(),
                delay_s=step.delay_s if step is not None else None,
                slot=believed.slots[container.id] + 1 if container.id in believed.slots else None,
            )
        )
        if mass_mg < container.empty_mass_mg / 10:
            raise SkillFailed(
                Code.CONTAINER_MISSING, f"the pan gained {mass_mg / 1000:.3f} g; no {container.name} stands on it"
            )
        if abs(mass_mg - held_mg - container.empty_mass_mg) > container.empty_mass_tolerance_mg:
            holding = f", and {held_mg / 1000:.3f} g were dosed into this one before" if held_mg > 0.0 else ""
            raise SkillFailed(
                Code.CONTAINER_WRONG_MASS,
                f"'{container.id}' weighs {mass_mg / 1000:.3f} g; a {container.name} weighs "
                f"{container.empty_mass_mg / 1000:.3f} ± {container.empty_mass_tolerance_mg / 1000:.3f} g{holding}",
            )
        seemed_to_adapt = step is not None and seems_to_adapt(cell, step)
        if seemed_to_adapt or is_to_be_weighed_again(cell):
            first = bare, loaded
            bare, _ = yield from changed(cell, cell.changer.take_away(), loaded)
            loaded, step = yield from changed(cell, cell.changer.bring(container), bare)
            cell.came = step
            note_again(cell, container.id, first, bare, loaded)
        if step is not None:
            require_known_delay(cell, step, has_seemed_to_adapt=seemed_to_adapt)
        believed.placed(weighing_of(bare), weighing_of(loaded))

    def _require_known(self, cell: Cell) -> None:
        """Refuse a container that was on the pan before, where its contents or its place are unknown.

        Raises SkillFailed container.changed.
        """
        container, before = self.container.id, cell.believed.had_gone(self.container.id)
        if before is None:
            return
        if not before.doses:
            raise SkillFailed(Code.CONTAINER_CHANGED, f"'{container}' was on the pan before: {before.detail}")
        if not cell.changer.needs_person and container not in cell.believed.slots:
            refilled = "the changer was filled again since then, so its slot holds another container"
            raise SkillFailed(Code.CONTAINER_CHANGED, f"'{container}' was on the pan before: {refilled}")

    def _exchanged(self, cell: Cell) -> Steps[StableMean]:
        """Exchange what is on the pan for this container; returns the weighing of the bare pan before it came (a0)."""
        if not cell.changer.needs_person and not cell.spec.changer.takes(kind := self.container.name):
            raise SkillFailed(Code.CONTAINER_MISSING, f"the changer has no slot for a container of the kind {kind}")
        bare = yield from take_container_away(cell, self.container)
        # The container that just went may be this one, and its weight may have shown that it was changed.
        self._require_known(cell)
        if (short := self._short_of(cell)) is not None:
            yield from self._fill(cell, short)
            bare = yield from cell.right_of_way.stable_mean()
        yield from watched(cell, cell.changer.bring(self.container), weighing_of(bare))
        return bare

    def _kinds(self, cell: Cell) -> list[str]:
        """The kinds that the changer must have without being filled again: all of the sample's at its first container.

        For a later one, only that container's.
        """
        names = [one.id for one in cell.of_job]
        begins = self.container.id in names and not any(name in cell.believed.slots for name in names)
        return [one.name for one in cell.of_job] if begins else [self.container.name]

    def _short_of(self, cell: Cell) -> str | None:
        """The kind that the changer has too few of; None if it has enough, or has this container's slot."""
        if cell.changer.needs_person or self.container.id in cell.believed.slots:
            return None
        changer = cell.spec.changer
        return changer.short_of(slots_used(cell.believed, changer), self._kinds(cell))

    def _fill(self, cell: Cell, kind: str) -> Steps[None]:
        """Have the operator fill all slots, the pan being bare: the slot of a container there is filled, too.

        Raises SkillFailed operator.refused.
        """
        changer, used = cell.spec.changer, slots_used(cell.believed, cell.spec.changer).get(kind, 0)
        slots, of_kind = changer.slots_for(kind), f" {kind}" if kind else ""
        why = f"all {slots}{of_kind} containers are used"
        if used < slots:
            many = sum(not kind or one == kind for one in self._kinds(cell))
            why = f"it has {slots - used} of {slots}{of_kind} containers left, and this sample needs {many}"
        answer = yield from cell.operator.ask(f"Fill the changer, from its first slot on: {why}.")
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, "the changer was not filled")
        cell.believed.slots_refilled()
