"""The simulated container changer: a carousel that puts containers on the pan and takes them away."""

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.sim.world import STEP_S, World
from scuhand_bt.specs import Container


class SimulatedChanger:
    """A carousel beside the balance that swings half a slot in `swing_s`; see
    `scuhand_bt.devices.interfaces.Changer`.
    """

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
        """Does nothing: the carousel ends its swing, so that no container is left hanging."""

    def bring(self, container: Container) -> Steps[None]:
        yield from self._rest()
        if self._world.pan.container_id == container.id:
            return  # an earlier, abandoned `bring` has brought it: a swing always goes on to its end
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
