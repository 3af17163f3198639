"""The simulated container changer: a carousel that puts containers on the pan and takes them away."""

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.sim.world import STEP_S, World
from scuhand_bt.specs import Container


class SimulatedChanger:
    """A carousel beside the balance, half a slot onwards in `swing_s`; see `scuhand_bt.devices.interfaces.Changer`."""

    needs_person = False
    fault = None

    def __init__(self, clock: Clock, world: World, swing_s: float) -> None:
        self._clock = clock
        self._swing_s = swing_s
        self._world = world

    @property
    def news(self) -> Signal:
        return self._world.pan.news

    @property
    def is_stopped(self) -> bool:
        return not self._world.pan.is_swinging

    def stop(self) -> None:
        """It ends the swing it is in: a container is never left hanging."""

    def bring(self, container: Container) -> Steps[None]:
        yield from self._rest()
        if self._world.pan.container_id == container.id:
            return  # the swing that was to bring it went on to its end when nobody waited for it any more
        if self._world.pan.container_id is not None:
            raise SkillFailed(
                Code.CONTAINER_MISSING, f"the pan is not free: '{self._world.pan.container_id}' stands on it"
            )
        self._world.swing(self._clock.now_s + self._swing_s, container)
        yield from self._rest()

    def take_away(self) -> Steps[None]:
        yield from self._rest()
        if self._world.pan.container_id is not None:
            self._world.swing(self._clock.now_s + self._swing_s, None)
            yield from self._rest()

    def _rest(self) -> Steps[None]:
        while self._world.pan.is_swinging:
            yield Wake(max(self._world.pan.swing_ends_s, self._clock.now_s + STEP_S))
