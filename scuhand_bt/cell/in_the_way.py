"""What comes into the cell during a run, as the cell's watchers see it, and what the arm does then.

New motions are planned around what is seen. Kept ones are proven free of it, or planned anew. If there is no way, or a
motion that cannot be planned anew would meet it, the arm waits until it has gone. A motion under way that would meet it
stops along its path; if it went from place to place, it is then planned anew from there.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from scuhand_bt.clock import Steps, Wake
from scuhand_bt.devices.instruments import Watcher
from scuhand_bt.devices.interfaces import Trajectory
from scuhand_bt.events.cell import WayObstructed
from scuhand_bt.failures import Code, SkillFailed

if TYPE_CHECKING:
    from scuhand_bt.cell.cell import Cell

LOOK_S = 0.1
"""Interval at which the watchers are looked at."""
TIMEOUT_S = 120.0
"""How long the arm waits for what is in the way."""


class StoppedShort(SkillFailed):
    """A motion was stopped because something came into its way; the arm is at rest."""

    def __init__(self) -> None:
        super().__init__(Code.ARM_NO_PATH, "the arm was stopped: something came into its way")


class InTheWay:
    """What the watchers of one cell see."""

    def __init__(self, cell: "Cell") -> None:
        self._cell = cell
        self._parts: list[Any] = []
        self._points_m: Any = None

    @property
    def _watchers(self) -> Sequence[Watcher]:
        return [self._cell.devices[name] for name in self._cell.spec.watchers]  # type: ignore[misc]

    @property
    def seen(self) -> list[Any]:
        """What the watchers see now, or why they do not; the same objects for as long as that is the same."""
        return [what for one in self._watchers for what in (one.points_m, one.fault)]

    @property
    def points_m(self) -> Any:
        """What is seen now, (n, 3) or None; the same array for as long as it is the same.

        Raises a watcher's fault: an arm that cannot see whether something comes does not move.
        """
        watchers = self._watchers
        for watcher in watchers:
            if watcher.fault is not None:
                raise watcher.fault
        parts = [points for one in watchers if (points := one.points_m) is not None and len(points)]
        if len(parts) != len(self._parts) or any(a is not b for a, b in zip(parts, self._parts, strict=True)):
            self._parts, self._points_m = parts, np.vstack(parts) if parts else None
        return self._points_m

    def followed(self, motion: Trajectory, steps: Steps[None]) -> Steps[None]:
        """Carry out a motion, which `steps` begin and wait for, as long as nothing comes into its way.

        It begins when its way is free. Raises SkillFailed arm.no_path if that takes too long, `StoppedShort` if it had
        to stop.
        """
        if not self._cell.spec.watchers:
            yield from steps
            return
        yield from self._until_free(motion)
        looked_at, begun_s = self.points_m, self._cell.clock.now_s
        try:
            for wake in steps:
                if (seen := self.points_m) is not looked_at:
                    looked_at = seen
                    if not self._is_free(motion, self._cell.clock.now_s - begun_s):
                        break
                yield Wake(min(wake.until_s, self._cell.clock.now_s + LOOK_S), wake.signal, wake.seen)
            else:
                return
        finally:
            steps.close()
        while not (self._cell.arm.is_stopped and self._cell.hand.is_stopped):
            yield Wake.on(self._cell.arm.news, self._cell.clock.now_s + LOOK_S)
        self._cell.record.event(WayObstructed(stopped=True, waited_s=0.0))
        raise StoppedShort

    def gone(self, since_s: float, why: SkillFailed) -> Steps[None]:
        """Wait until something else is seen, or nothing.

        Raises `why` if nothing is seen now, SkillFailed if it stays too long.
        """
        if (seen := self.points_m) is None:
            raise why
        while self.points_m is seen:  # for as long, all plans have the same answer
            if self._cell.clock.now_s >= since_s + TIMEOUT_S:
                words = f"something has been in the way for {TIMEOUT_S:g} s: {why.detail}"
                raise SkillFailed(Code.ARM_NO_PATH, words) from None
            yield Wake(self._cell.clock.now_s + LOOK_S)

    def waited(self, since_s: float) -> None:
        """Record that the arm waited for what was in the way."""
        self._cell.record.event(WayObstructed(stopped=False, waited_s=round(self._cell.clock.now_s - since_s, 3)))

    def _until_free(self, motion: Trajectory) -> Steps[None]:
        since_s = self._cell.clock.now_s
        if self._is_free(motion, 0.0):
            return
        while not self._is_free(motion, 0.0):
            yield from self.gone(since_s, SkillFailed(Code.ARM_NO_PATH, "the arm cannot make this motion around it"))
        self.waited(since_s)

    def _is_free(self, motion: Trajectory, from_s: float) -> bool:
        self._cell.motion.set_occupied(self.points_m)
        is_free: bool = self._cell.motion.keeps_clear(motion, from_s)  # type: ignore[arg-type]
        return is_free
