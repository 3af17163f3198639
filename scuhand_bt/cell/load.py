"""What the cone is filled with: what was scooped, what has come of it, and what that tells of the source's scoops."""

from dataclasses import dataclass

BARREN_MG = 30.0
"""A load of which less than this has come in all has brought nothing worth a scoop."""

SURPLUS = 0.1
"""A load of which more has come than was thought to be in it, by this share, is a larger one."""
TELLING = 0.3
"""Doses of more than this share of a load go on with it to its end: of a smaller one it would come near the target,
where what flows badly overshoots, and takes long.
"""
HIDDEN = 0.25
"""Of what has come of such a load, the share that is thought to be in it still: it has not given out."""


@dataclass(frozen=True)
class Load:
    """What the cone was filled with since it was last empty, and what came of it."""

    scooped_mg: float = 0.0
    """What its scoops should have brought, by their geometry; 0 for one that is known otherwise."""
    came_mg: float = 0.0
    """What has arrived on the balance."""
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
