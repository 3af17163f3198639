"""What has come into the cell: space in which something was seen, as cubes of equal size (coal's octree).

Metres, base frame.
"""

import hashlib
from dataclasses import dataclass, field

import coal
import numpy as np

from scuhand_bt.motion.collision import Solid
from scuhand_bt.motion.kinematics import Floats

VOXEL_M = 0.02
"""Default size of a cube."""
MOST_VOXELS = 200_000
SEEN = "what was seen"
"""Its name as a solid."""


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Occupied cubes. Two are equal if their cubes are."""

    digest: str
    voxel_m: float
    centres_m: Floats = field(compare=False, repr=False)
    """Centres of the cubes, shape (n, 3)."""

    @classmethod
    def of(cls, points_m: Floats, voxel_m: float = VOXEL_M) -> "Occupancy":
        """The cubes that contain the seen points (n, 3). Raises ValueError for malformed or too many points."""
        points_m = np.asarray(points_m, dtype=float)
        if points_m.ndim != 2 or points_m.shape[1] != 3 or not len(points_m) or not np.isfinite(points_m).all():
            raise ValueError("occupied space is given by points, three finite numbers in metres each: shape (n, 3)")
        if not 1e-3 <= voxel_m <= 1.0:
            raise ValueError(f"cubes of occupied space are 1 mm to 1 m wide, not {1e3 * voxel_m:g} mm")
        cubes = np.unique(np.floor(points_m / voxel_m).astype(np.int64), axis=0)
        if len(cubes) > MOST_VOXELS:
            raise ValueError(f"{len(cubes)} cubes are occupied, {MOST_VOXELS} at most may be: use wider ones")
        digest = hashlib.blake2b(cubes.tobytes() + str(voxel_m).encode(), digest_size=12).hexdigest()
        return cls(digest, voxel_m, np.array((cubes + 0.5) * voxel_m, dtype=np.float64))

    def solid(self) -> Solid:
        """All cubes as one solid that the arm must not touch."""
        tree = coal.makeOctree(self.centres_m, self.voxel_m)
        tree.computeLocalAABB()
        return Solid(SEEN, (0.0, 0.0, 0.0), mesh=tree)
