"""The twin of the carousel: one servo on a line of its own, and the wheel on its shaft."""

from scuhand_bt.device_specs.changer import CarouselOptions
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin
from scuhand_bt.sim.wire.scene import Scene
from scuhand_bt.sim.wire.servo import Servo

STANDS = 0.15
"""A container stands on the pan alone within this distance, in slots, of its place."""


class CarouselTwin(DynamixelTwin):
    """It starts with the pan clear, half a slot before the first slot."""

    STATE = (*DynamixelTwin.STATE, "slot")

    def __init__(self, options: CarouselOptions, scene: Scene) -> None:
        self.pitch = 4096 / scene.slots * options.direction
        self._first, self._slots = options.first_slot_count, scene.slots
        self.shaft = Servo(options.servo_id, position=self._first - 0.5 * self.pitch)
        super().__init__([self.shaft])
        self._scene = scene
        self.slot: int | None = None
        """The slot whose container stands on the pan."""

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Obey, and carry containers along."""
        said = super().hear(data, now_s)
        place = (self.shaft.position - self._first) / self.pitch
        slot = round(place) % self._slots if abs(place - round(place)) < STANDS else None
        if slot != self.slot:
            self.slot = slot
            self._scene.bring(slot)
        return said
