"""The cone's load: what was scooped, what has come, and what that tells about the source's scoops
(docs/scoop-belief.md)."""

from dataclasses import dataclass

BARREN_MG = 30.0
"""A load of which less than this has come in all has brought nothing."""

SURPLUS = 0.1
"""A load of which more has come than was believed, by this share, is a larger one."""
TELLING = 0.25
"""A dose of more than this share of a load may use it up."""
NEAR_END = (0.1, 0.2)
"""But not if a share of the load between these would be left: its end may then come near the target, and flows badly
there. With less left the end comes after the target, with more before it. A first load is put away instead; if all
were, their source would never be known."""
AS_EXPECTED = 0.25
"""A share within this of 1 is taken to stay, as looking for the end of every load costs time. Other shares change with
the bed."""
HIDDEN = 0.25
"""Share of what has come of a larger load that is believed to be still in it, until it gives out."""
SHAKEN_SHARE, MOST_REST = 0.05, 0.5
"""Less than SHAKEN_SHARE of a load that came only shaken may be a drop that hung. More than MOST_REST is no rest: the
powder bridges."""
POOR_REST, REST_SHARE = 0.5, 0.15
"""A load whose rest begins before POOR_REST of what was believed has come was a poorer one. It held what has come, and
REST_SHARE as its rest. So did one that brought far more than expected. In dry runs rests were 0.02 of loads of beads,
and 0 to 0.35 of MSG."""


@dataclass(frozen=True)
class Load:
    """What the cone was filled with since it was last empty, and what came of it."""

    scooped_mg: float = 0.0
    """What its scoops should have brought, by their geometry; 0 if it is known otherwise."""
    or_scooped_mg: float = 0.0
    """The same, if the last scoop also found what the stroke before had missed."""
    not_there_mg: float = 0.0
    """What was taken off the source when powder came of this load, as loads before it had brought nothing."""
    came_mg: float = 0.0
    """What has arrived on the balance."""
    is_first: bool = False
    """Whether nothing was scooped from its source before."""
    flowed_mg: float = 0.0
    """What had come when powder last came unshaken; all after that came only shaken."""
    is_rest: bool = False
    """Whether what is left comes only shaken."""
    is_larger: bool = False
    """Whether more has come than was believed; only its end tells how much there is."""

    @property
    def is_barren(self) -> bool:
        """Whether it has brought nothing worth a scoop until now."""
        return self.came_mg < BARREN_MG

    @property
    def scoops_share(self) -> float:
        """The share that its scoops brought of what was expected, once it has given out.

        Raises ZeroDivisionError if no scoop was made.
        """
        return self.came_mg / self.scooped_mg

    @property
    def shaken_share(self) -> float | None:
        """What came only shaken, as a share of what has come; None if that was no rest of a load."""
        is_rest = not self.is_barren and self.flowed_mg >= (1.0 - MOST_REST) * self.came_mg
        return max(0.0, 1.0 - self.flowed_mg / self.came_mg) if is_rest else None

    def least_rest(self, known: float | None) -> float | None:
        """The share of a load that is its rest, by what is `known` of the source and by this load without an end.

        It is at least what came only shaken. If nothing else is known, a third of what it could be besides is added.
        """
        seen = self.shaken_share
        if seen is None or seen <= (SHAKEN_SHARE if known is None else known):
            return known
        return seen if known is not None else seen + (MOST_REST - seen) / 3

    def at_rest_mg(self, held_mg: float, shaken_share: float | None) -> float | None:
        """What was in a load whose rest is left, with `held_mg` believed in it; None if it bridges, or without a scoop.

        `shaken_share` is the least share of rests of its source, None if unknown. Then a rest that began too early
        shows a poorer load, and far more than expected a larger one. Any other load is what was believed: that it is
        less will show, as it gives out before a dose is full.
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
        """Whether a dose goes on with this load until it gives out, whatever is believed to be left (`held_mg`).

        Nothing else tells what the source's scoops bring. `share` is what the end of an earlier load has told about
        that, None if none was seen. A dose too small to show it, or from a source that brings what it should, does not
        use the load up. Nor does one that ends near the load's end; unless an earlier load was put away without its
        end, as then nobody knows where that comes.
        """
        if self.scooped_mg == 0.0 or wanted_mg <= TELLING * self.scooped_mg:
            return False
        is_near_end = NEAR_END[0] <= (held_mg - wanted_mg) / self.scooped_mg < NEAR_END[1]
        if share is None:
            return not (self.is_first and is_near_end)
        return abs(share - 1.0) >= AS_EXPECTED and not is_near_end
