"""What the cone is filled with: what was scooped, what has come of it, and what that tells of the source's scoops."""

from dataclasses import dataclass

BARREN_MG = 30.0
"""A load of which less than this has come in all has brought nothing worth a scoop."""

SURPLUS = 0.1
"""A load of which more has come than was thought to be in it, by this share, is a larger one."""
TELLING = 0.25
"""Doses of more than this share of a load may use it up."""
NEAR_END = (0.1, 0.2)
"""Not by a dose that should leave a share of the load between these: its end may come where the target is, and flows
badly there. Of a smaller share it comes well before, and of a larger one after. A first load is put away then; but a
source whose loads all are is never known.
"""
AS_EXPECTED = 0.25
"""A source whose last load was off by less, of what its scoops should bring, is taken to go on so: looking for the end
of every load costs time. What others bring changes as their bed does."""
HIDDEN = 0.25
"""Of what has come of such a load, the share that is thought to be in it still: it has not given out."""
SHAKEN_SHARE, MOST_REST = 0.05, 0.5
"""Less than the first share of a load that came only shaken may be a drop that hung; more than the second is no rest of
a load: its powder bridges."""
POOR_REST, REST_SHARE = 0.5, 0.15
"""A load of which less than this share has come, of what was thought to be in it, and what is left comes only shaken,
was a poorer one: it held what has come, and this share as its rest. So did one of which far more has come than should.
In dry runs rests were 0.02 of loads of beads, and 0 to 0.35 of MSG."""


@dataclass(frozen=True)
class Load:
    """What the cone was filled with since it was last empty, and what came of it."""

    scooped_mg: float = 0.0
    """What its scoops should have brought, by their geometry; 0 for one that is known otherwise."""
    or_scooped_mg: float = 0.0
    """The same, if what the stroke before had missed was on the way of the last one."""
    not_there_mg: float = 0.0
    """Taken off what its source is believed to hold when it came: loads before it had brought nothing."""
    came_mg: float = 0.0
    """What has arrived on the balance."""
    is_first: bool = False
    """Nothing was scooped from its source before."""
    flowed_mg: float = 0.0
    """What had come when powder last came by itself; what came after that came only shaken."""
    is_rest: bool = False
    """What is left of it comes only shaken."""
    is_larger: bool = False
    """More has come than was thought to be in it: how much there is, only its end tells."""

    @property
    def is_barren(self) -> bool:
        """Nothing worth a scoop has come, until now."""
        return self.came_mg < BARREN_MG

    @property
    def scoops_share(self) -> float:
        """What has come of what its scoops should have brought: the share that they yield, once it has given out.

        ZeroDivisionError where none was made.
        """
        return self.came_mg / self.scooped_mg

    @property
    def shaken_share(self) -> float | None:
        """What came only shaken, as a share of what has come; None where that was no rest of a load."""
        is_rest = not self.is_barren and self.flowed_mg >= (1.0 - MOST_REST) * self.came_mg
        return max(0.0, 1.0 - self.flowed_mg / self.came_mg) if is_rest else None

    def least_rest(self, known: float | None) -> float | None:
        """The share that loads of its source leave as their rest, by what is `known` and by this one's, whose end was
        not seen: at least what came only shaken, and, where nothing else is known, a third of what it could be besides.
        """
        seen = self.shaken_share
        if seen is None or seen <= (SHAKEN_SHARE if known is None else known):
            return known
        return seen if known is not None else seen + (MOST_REST - seen) / 3

    def at_rest_mg(self, held_mg: float, shaken_share: float | None) -> float | None:
        """What was in it, of one whose rest is left, with `held_mg` believed in it; None where it bridges, or no scoop
        tells.

        `shaken_share` is what loads of its source leave at least as their rest, None where none was seen; then one that
        began long before it should have is a poorer load, and one of which far more has come a larger one. Any other
        is what it was thought to be: that one is less tells itself, as it gives out before a dose is full.
        """
        if self.scooped_mg == 0.0 or self.is_barren:
            return None
        if shaken_share is not None and self.flowed_mg > 0.0:
            return max(self.came_mg, self.flowed_mg / (1.0 - shaken_share))
        is_poor = self.came_mg < POOR_REST * (self.came_mg + held_mg)
        if is_poor or self.scoops_share > 1.0 + AS_EXPECTED:
            return self.came_mg / (1.0 - REST_SHARE)
        if self.flowed_mg > 0.0 and self.shaken_share is None:
            return None
        return self.came_mg if self.is_larger else self.came_mg + held_mg

    def may_be_used_up(self, wanted_mg: float, held_mg: float, share: float | None) -> bool:
        """Whether a dose goes on with it until it gives out, whatever is believed to be left (`held_mg`): nothing else
        tells what its source's scoops bring. `share` is what the end of an earlier load has told of that; None where
        none was seen.

        Not a dose that is too small to show it, nor one of a source that brings what it should. And not one that ends
        near the load's end, unless an earlier load was put away without its end, and nobody knows where that comes.
        """
        if self.scooped_mg == 0.0 or wanted_mg <= TELLING * self.scooped_mg:
            return False
        is_near_end = NEAR_END[0] <= (held_mg - wanted_mg) / self.scooped_mg < NEAR_END[1]
        if share is None:
            return not (self.is_first and is_near_end)
        return abs(share - 1.0) >= AS_EXPECTED and not is_near_end
