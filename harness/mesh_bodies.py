"""Bodies of triangles: written as STL and OBJ files, read again, and measured, by code of its own.

Triangles are (m, 3, 3), in whatever unit; bodies are closed surfaces, whose sides are named against the clock seen from
outside. They may overlap each other.
"""

import itertools
from pathlib import Path

import numpy as np

from scuhand_bt.motion.kinematics import Floats

_AT_ONCE = 400_000
"""Pairs of a point and a triangle."""
_QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box(size: Floats, centre: Floats) -> Floats:
    """The twelve triangles of a box."""
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * np.asarray(size) / 2 + np.asarray(centre)
    return np.array([corners[list(side)] for a, b, c, d in _QUADS for side in ((a, b, c), (a, c, d))])


def portal(rng: np.random.Generator) -> Floats:
    """Two posts and a beam over them [mm], about the origin on the floor; one goes over it, through it or around."""
    span, high, thick = rng.uniform(150, 300), rng.uniform(150, 380), rng.uniform(15, 35)
    posts = [box((thick, thick, high), (side * span / 2, 0.0, high / 2)) for side in (-1, 1)]
    return np.concatenate([*posts, box((span, thick, thick), (0.0, 0.0, high))])


def write(path: Path, triangles: Floats) -> Path:
    """As an OBJ file, or a binary STL, by its name."""
    if path.suffix == ".obj":
        vertices = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in triangles.reshape(-1, 3)]
        faces = [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(len(triangles))]
        path.write_text("\n".join([*vertices, *faces]) + "\n", encoding="ascii")
        return path
    facets = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    facets["corners"] = triangles
    path.write_bytes(bytes(80) + np.uint32(len(triangles)).tobytes() + facets.tobytes())
    return path


def read(path: Path) -> Floats:
    """The triangles of such a file."""
    if path.suffix == ".obj":
        lines = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
        vertices = np.array([[float(one) for one in line[1:4]] for line in lines if line[0] == "v"])
        faces = [[int(one.split("/")[0]) - 1 for one in line[1:]] for line in lines if line[0] == "f"]
        return np.array([vertices[face] for face in faces])
    data = path.read_bytes()[84:]
    facets = np.frombuffer(data, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    triangles: Floats = facets["corners"].astype(float)
    return triangles


def signed_distance(points: Floats, triangles: Floats, far: float) -> Floats:
    """Of points (n, 3) from closed bodies, negative inside: (n,). What is farther than `far` is only that."""
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    found: Floats = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    near = np.flatnonzero(found < far)
    for some in np.array_split(near, 1 + len(near) * len(triangles) // _AT_ONCE):
        found[some] = _distances(points[some], triangles).min(axis=1)
    within = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    for some in np.array_split(within, 1 + len(within) * len(triangles) // _AT_ONCE):
        found[some] *= np.where(_windings(points[some], triangles) > 0.5, -1.0, 1.0)
    return found


def _distances(points: Floats, triangles: Floats) -> Floats:
    """(n, m): to the plane's nearest point where that is in the triangle, else to the nearest of its edges."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    height = points @ normal.T - (a * normal).sum(axis=1)
    nearest = np.full(height.shape, np.inf)
    is_over = np.ones(height.shape, dtype=bool)
    for begin, end in ((a, b), (b, c), (c, a)):
        edge = end - begin
        inward = np.cross(normal, edge)
        is_over &= points @ inward.T >= (begin * inward).sum(axis=1)
        along = (points @ edge.T - (begin * edge).sum(axis=1)) / (edge * edge).sum(axis=1)
        foot = begin + np.clip(along, 0.0, 1.0)[:, :, None] * edge
        nearest = np.minimum(nearest, np.linalg.norm(points[:, None] - foot, axis=2))
    distances: Floats = np.where(is_over, np.abs(height), nearest)
    return distances


def _windings(points: Floats, triangles: Floats) -> Floats:
    """How many times closed surfaces go around points: (n,), by the solid angles of their triangles.

    A. Van Oosterom and J. Strackee, "The solid angle of a plane triangle", IEEE Trans. Biomed. Eng. 30(2), 1983.
    """
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(one, axis=2) for one in (a, b, c))
    triple = (a * np.cross(b, c)).sum(axis=2)
    rest = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    angles = 2 * np.arctan2(triple, rest)
    return np.asarray(np.abs(angles.sum(axis=1)) / (4 * np.pi))
