"""The relaxation of a powder surface to its angle of repose, compiled: most of the cost of a stroke through a mortar.

`scuhand_bt.sim.bed` explains the model. The N columns of a square grid are stored in one row.
"""

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.compiled import compiled

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@compiled("void(f8[::1], f8[::1], f8[::1], b1[::1], f8[::1], f8, f8, i8[::1], f8[::1], b1[:,:,::1], i8, i8, f8)")
def flow(
    surface_mm: Floats,
    thick_mm: Floats,
    slopes: Floats,
    over: Mask,
    level_mm: Floats,
    up: float,
    height_mm: float,
    ahead: NDArray[np.intp],
    apart_mm: Floats,
    firsts: Mask,
    sweeps: int,
    checked: int,
    at_rest_mm: float,
) -> None:
    """Let the uppermost layers flow; changes surface (N,) and thickness (N,) [mm] in place.

    `slopes` (N,) are the steepest stable slopes (tangents). `over` (N,) marks the columns under the sheet. Powder does
    not pass through the sheet, only over its mouth at `height_mm` along the cone's axis; `up` is the axis's vertical
    component and `level_mm` (N,) the coordinate along the axis at z = 0. Pairs of neighbours are `ahead` (W,) columns
    and `apart_mm` (W,) apart. `firsts` (2, W, N) marks the first column of each pair, in two sets such that no column
    is in two pairs of a set and a direction. The flow ends after `sweeps`, or when no column has changed by
    `at_rest_mm` in a sweep; this is tested every `checked` sweeps.
    """
    count, ways = len(surface_mm), len(ahead)
    pairs, limits_mm = np.empty(firsts.shape, np.int64), np.empty(firsts.shape)
    many = np.zeros((2, ways), np.int64)
    for odd in range(2):
        for way in range(ways):
            for a in range(count - ahead[way]):
                b = a + ahead[way]
                if not firsts[odd, way, a]:
                    continue
                higher = max(surface_mm[a], surface_mm[b])
                beside_mm = level_mm[b] if over[a] else level_mm[a]
                if over[a] != over[b] and beside_mm + up * higher < height_mm:
                    continue
                slope = slopes[a] if surface_mm[a] > surface_mm[b] else slopes[b]
                at = many[odd, way]
                pairs[odd, way, at], limits_mm[odd, way, at] = a, slope * apart_mm[way]
                many[odd, way] += 1
    before_mm = np.empty(count)
    for sweep in range(sweeps):
        is_looked_at = sweep % checked == 0
        if is_looked_at:
            before_mm[:] = thick_mm
        for odd in range(2):
            for way in range(ways):
                for at in range(many[odd, way]):
                    a, limit_mm = pairs[odd, way, at], limits_mm[odd, way, at]
                    b = a + ahead[way]
                    apart = surface_mm[a] - surface_mm[b]
                    goes_mm = 0.5 * (apart - min(max(apart, -limit_mm), limit_mm))
                    goes_mm = max(min(goes_mm, thick_mm[a]), -thick_mm[b])
                    thick_mm[a] -= goes_mm
                    surface_mm[a] -= goes_mm
                    thick_mm[b] += goes_mm
                    surface_mm[b] += goes_mm
        if is_looked_at and np.abs(thick_mm - before_mm).max() < at_rest_mm:
            return
