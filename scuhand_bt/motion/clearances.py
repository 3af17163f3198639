"""Distances of near pairs and their gradients with respect to the joints, for local optimisation.

Distances [m], negative inside; configurations [rad] (m, n).
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.decomposed import joint_axes
from scuhand_bt.motion.kinematics import Floats

NEAR_M = 0.04
"""Pairs nearer than this are constraints."""
WATCHED_M = 0.1
"""Pairs farther apart than this are ignored until the next `watched`."""
_TOUCHING_M = 1e-6


@dataclass(frozen=True, slots=True)
class Near:
    """Near pairs: index of the configuration (k,), distance (k,), and gradient (k, n)."""

    at: NDArray[np.int_]
    distances_m: Floats
    gradients: Floats


class Clearances:
    """Computes them for one scene."""

    def __init__(self, scene: Scene) -> None:
        self._model, self._shapes = scene.model, scene.shapes
        self._data, self._shape_data = scene.model.createData(), pin.GeometryData(scene.shapes)
        parents = [thing.parentJoint for thing in scene.shapes.geometryObjects]
        self._parents = np.array([(parents[pair.first], parents[pair.second]) for pair in scene.shapes.collisionPairs])
        self._axes = np.array(joint_axes(scene.model))

    def watched(self, q: Floats) -> list[list[int]]:
        """The indices of pairs closer than `WATCHED_M`, for each of the configurations (m, n)."""
        found = []
        for one in q:
            pin.computeDistances(self._model, self._data, self._shapes, self._shape_data, one)
            results = self._shape_data.distanceResults
            found.append([k for k, result in enumerate(results) if result.min_distance < WATCHED_M])
        return found

    def near(self, q: Floats, watched: list[list[int]]) -> Near:
        """Among the watched pairs at each of the configurations (m, n), those that are near."""
        at, pairs = list[int](), list[int]()
        rows, frames = list[list[float]](), list[Floats]()
        results = self._shape_data.distanceResults
        for k, (one, some) in enumerate(zip(q, watched, strict=True)):
            pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._shape_data, one)
            for pair in some:
                pin.computeDistance(self._shapes, self._shape_data, pair)
                result = results[pair]
                if result.min_distance < NEAR_M:
                    at.append(k)
                    pairs.append(pair)
                    points = (*result.getNearestPoint1(), *result.getNearestPoint2(), *result.normal)
                    rows.append([result.min_distance, *points])
            # The first frame is the base's.
            frames.append(np.array([placed.homogeneous for placed in list(self._data.oMi)[1:]]) if some else np.eye(0))
        if not at:
            return Near(np.zeros(0, dtype=int), np.zeros(0), np.zeros((0, q.shape[1])))
        values, placed = np.array(rows), np.stack([frames[k] for k in at])
        return Near(np.array(at), values[:, 0], self._gradients(values, placed, self._parents[pairs]))

    def _gradients(self, values: Floats, placed: Floats, parents: NDArray[np.int_]) -> Floats:
        """Gradients (k, n) of distances, with respect to the joints.

        From distances, nearest points and normals (k, 10), the joints' frames (k, n, 4, 4) and the joints of each pair
        (k, 2).
        """
        distances_m, first, second, normals = values[:, 0], values[:, 1:4], values[:, 4:7], -values[:, 7:]
        apart = first - second
        lengths_m = np.linalg.norm(apart, axis=1)
        is_apart = lengths_m > _TOUCHING_M
        normals[is_apart] = (np.sign(distances_m) / np.maximum(lengths_m, _TOUCHING_M))[is_apart, None] * apart[
            is_apart
        ]
        axes = np.einsum("knij,nj->kni", placed[:, :, :3, :3], self._axes)
        joints = np.arange(1, axes.shape[1] + 1)
        gradients = np.zeros(axes.shape[:2])
        for sign, points, parent in ((1.0, first, parents[:, 0]), (-1.0, second, parents[:, 1])):
            arms = points[:, None] - placed[:, :, :3, 3]
            turned = np.einsum("kni,ki->kn", np.cross(axes, arms), normals)
            gradients += np.where(joints <= parent[:, None], sign * turned, 0.0)
        return gradients
