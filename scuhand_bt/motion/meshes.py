"""Meshes of what stands in the cell: the triangles of an STL or OBJ file, looked at by coal one by one.

A mesh is its surface, not what is inside. That is enough: the arm comes from outside, and no motion passes a surface
unseen, however thin it is (`collision`).
"""

from functools import lru_cache

import coal
import numpy as np

SMALLEST_M, LARGEST_M = 1e-3, 20.0
"""Across: what is smaller or larger has been read in another unit."""
MOST_TRIANGLES = 200_000


@lru_cache(maxsize=16)
def read_mesh(path: str, unit_m: float, digest: str) -> coal.BVHModelBase:
    """The surface in a file, one of whose units is `unit_m`; `digest` tells files of one name apart.

    ValueError for what is no mesh, or none of a fixture's size.
    """
    del digest
    try:
        surface = coal.MeshLoader().load(path, np.full(3, unit_m))
    except (RuntimeError, ValueError):
        raise ValueError(f"{path} cannot be read as a mesh: export it anew, as STL or OBJ") from None
    if not 0 < surface.num_tris <= MOST_TRIANGLES:
        raise ValueError(f"{path} has {surface.num_tris} triangles; it may have 1 to {MOST_TRIANGLES}")
    surface.computeLocalAABB()
    size_m = np.array(surface.aabb_local.max_) - np.array(surface.aabb_local.min_)
    if not np.isfinite(size_m).all() or not SMALLEST_M <= size_m.max() <= LARGEST_M:
        across = f"{1e3 * size_m.max():g} mm across"
        raise ValueError(f"{path} is {across}: is `mesh_unit` what one unit of the file is?")
    return surface
