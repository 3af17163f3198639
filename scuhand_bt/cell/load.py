"""What the cone is filled with: what was scooped, what has come of it, and what that tells of the source's scoops."""

from dataclasses import dataclass

BARREN_MG = 30.0
"""A load of which less than this has come in all has brought nothing worth a scoop."""


@dataclass(frozen=True)
class Load:
    """What the cone was filled with since it was last empty, and what came of it."""

    scooped_mg: float = 0.0
    """What its scoops should have brought, by their geometry; 0 for one that is known otherwise."""
    came_mg: float = 0.0
    """What has arrived on the balance."""

    @property
    def is_barren(self) -> bool:
        """Nothing worth a scoop has come, until now."""
        return self.came_mg < BARREN_MG

    @property
    def scoops_share(self) -> float:
        """The share of what its scoops should have brought that has come. ZeroDivisionError where none was made."""
        return min(1.0, self.came_mg / self.scooped_mg)
