"""The simulated container changer: a carousel that puts containers on the pan and takes them away."""

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.failures import SkillFailed
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Container

BRING_S = 6.0
TAKE_S = 4.0


class SimulatedChanger:
    """A carousel beside the balance; see `scuhand_bt.devices.interfaces.Changer`."""

    needs_person = False

    def __init__(self, clock: Clock, world: World) -> None:
        self.news = Signal()
        self._clock = clock
        self._world = world
        self._busy_until_s = 0.0

    @property
    def is_stopped(self) -> bool:
        return self._clock.now_s >= self._busy_until_s

    def stop(self) -> None:
        """It ends the swing it is in: a container is never left hanging."""

    def bring(self, container: Container) -> Steps[None]:
        if self._world.pan is not None:
            raise SkillFailed("container.missing", f"the pan is not free: '{self._world.pan}' stands on it")
        yield from self._swing(BRING_S)
        self._world.place(container)

    def take_away(self) -> Steps[None]:
        if self._world.pan is not None:
            yield from self._swing(TAKE_S)
            self._world.remove()

    def _swing(self, duration_s: float) -> Steps[None]:
        self._busy_until_s = self._clock.now_s + duration_s
        while self._clock.now_s < self._busy_until_s:
            yield Wake(self._busy_until_s)
        self.news.fire()
