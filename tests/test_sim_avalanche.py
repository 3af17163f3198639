"""A surface of powder flows as its rule says, pair by pair of neighbours, and through no sheet."""

import math

import numpy as np
import pytest

from scuhand_bt.sim import avalanche
from scuhand_bt.sim.bed import CELL_MM, _ways

N, UP, HEIGHT_MM = 6, 0.8, 6.0
ASIDE = ((1, 0), (0, 1), (1, 1), (1, -1))


@pytest.mark.parametrize("has_sheet", [False, True])
@pytest.mark.parametrize("sweeps", [1, 4])
def test_of_neighbours_the_higher_gives_half_of_what_is_too_much_and_no_more_than_it_has(
    sweeps: int, *, has_sheet: bool
) -> None:
    rng = np.random.default_rng(5)
    thick, floor = rng.uniform(0.0, 3.0, (N, N)), rng.uniform(0.0, 6.0, (N, N))
    slopes, level_mm = rng.uniform(0.1, 0.6, (N, N)), rng.uniform(-1.0, 4.0, (N, N))
    over = (rng.random((N, N)) < 0.4) & has_sheet
    flowed, surface = thick.copy(), floor + thick
    sheet = over.ravel(), level_mm.ravel(), UP, HEIGHT_MM
    avalanche.flow(surface.reshape(-1), flowed.reshape(-1), slopes.ravel(), *sheet, *_ways(N), sweeps, 100, 0.0)

    def passes(a: tuple[int, int], b: tuple[int, int], top: np.ndarray) -> bool:
        beside = b if over[a] else a  # the one that the sheet is not over
        return bool(over[a] == over[b]) or level_mm[beside] + UP * max(top[a], top[b]) >= HEIGHT_MM

    begun = floor + thick
    pairs = []
    for odd in (0, 1):
        for down, right in ASIDE:
            cells = [(i, j) for i in range(N) for j in range(N) if (i if down else j) % 2 == odd]
            ahead = [((i, j), (i + down, j + right)) for i, j in cells if i + down < N and 0 <= j + right < N]
            apart_mm = CELL_MM * math.hypot(down, right)
            pairs += [
                (a, b, apart_mm * slopes[max(a, b, key=lambda one: begun[one])])
                for a, b in ahead
                if passes(a, b, begun)
            ]
    for _ in range(sweeps):
        for a, b, limit_mm in pairs:
            high, low = (a, b) if floor[a] + thick[a] > floor[b] + thick[b] else (b, a)
            more_mm = floor[high] + thick[high] - floor[low] - thick[low] - limit_mm
            goes_mm = min(max(more_mm, 0.0) / 2.0, thick[high])
            thick[high] -= goes_mm
            thick[low] += goes_mm
    assert flowed == pytest.approx(thick, abs=1e-9)
    assert surface == pytest.approx(floor + thick, abs=1e-9)
    assert np.ptp(thick - (begun - floor)) > 0.5, "it has flowed"
