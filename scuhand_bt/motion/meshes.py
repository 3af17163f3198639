"""Meshes of what stands in the cell: triangles of an STL or OBJ file, which coal tests one by one.

A mesh is only a surface, without an inside. That suffices: the arm comes from outside, and no motion passes through a
surface unnoticed, however thin it is (`collision`).
"""

from functools import lru_cache

import coal
import numpy as np

SMALLEST_M, LARGEST_M = 1e-3, 20.0
"""Largest extent of a plausible mesh: from, to. Others were probably read in a wrong unit."""
MOST_TRIANGLES = 200_000


@lru_cache(maxsize=16)
def read_mesh(path: str, unit_m: float, digest: str) -> coal.BVHModelBase:
    """The surface in a file whose unit is `unit_m`; `digest` distinguishes files with the same name in the cache.

    Raises ValueError if it is no mesh, or not of a plausible size.
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
