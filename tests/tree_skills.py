"""Skills that note what they do and when, for trees on the bench of `conftest`."""

from typing import Any

from conftest import Bench, wait_until

from scuhand_bt.failures import SkillFailed
from scuhand_bt.skill import Condition, Seconds, Skill, Steps


class Work(Skill[str]):
    """Take some time and note begin, end and halt."""

    name: str = "work"
    duration_s: Seconds = 1.0

    def run(self, cell: Any) -> Steps[str]:
        cell.note(f"{self.name} begins")
        is_done = False
        try:
            yield from wait_until(cell, cell.clock.now_s + self.duration_s)
            is_done = True
        finally:
            cell.note(f"{self.name} ends" if is_done else f"{self.name} halted")
        return self.name


class Arm(Work):
    """Work that commands the arm."""

    devices = ("arm",)


class Hand(Work):
    """Work that commands the hand."""

    devices = ("hand",)


class Fail(Skill[None]):
    """Fail with a code, after some time."""

    code: str = "hand.cone_empty"
    after_s: Seconds = 0.0

    def run(self, cell: Any) -> Steps[None]:
        cell.note(f"fails: {self.code}")
        yield from wait_until(cell, cell.clock.now_s + self.after_s)
        raise SkillFailed(self.code, "as it was told")


class Calm(Condition):
    """Hold until something was noted."""

    watches = ("balance",)

    noted: str = "alarm"

    def check(self, cell: Any) -> None:
        if any(what == self.noted for _, what in cell.log):
            raise SkillFailed("balance.unstable", self.noted)


SKILLS = {"work": Work, "arm": Arm, "hand": Hand, "fail": Fail, "calm": Calm}


def names(bench: Bench) -> list[str]:
    return [what for _, what in bench.log]
