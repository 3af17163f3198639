"""The cell as the 3D viewer draws it: the arm's chain, its solids, the cone in several widths, and what stands there.

Everything is taken from the scene that motions are planned in: what is drawn is what is kept clear of.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.report.cell_mesh import shape_mesh
from scuhand_bt.specs import ContainerKind

_DECIMALS = 5


def scene_values(
    planner: MotionPlanner,
    apex_offset_m: float,
    cones_mm: Iterable[float],
    places_m: Mapping[str, Sequence[float] | Floats],
    containers: Iterable[ContainerKind] = (),
    dots: Iterable[tuple[Sequence[float], bool]] = (),
) -> dict[str, Any]:
    """The scene as plain values (`viewer/viewer.js` says which); `dots` are points and whether they are good.

    ValueError for a cone that cannot be made of the sheet.
    """
    planner.set_geometry()
    cones, on_pan, scene = [], [], planner.scene()
    bare = {thing.name for thing in scene.shapes.geometryObjects}
    for diameter_mm in sorted(set(cones_mm)):
        planner.set_geometry(diameter_mm / 1000)
        cones.append({"mm": diameter_mm, "solids": [*_solids(planner.scene(), is_sheet=True)]})
    for kind in containers:
        planner.set_geometry(container=kind)
        on_pan.append({"name": kind.name, "solids": [*_solids(planner.scene(), is_sheet=False, besides=bare)]})
    return {
        "joints": [_joint(scene.model, k) for k in range(1, scene.model.njoints)],
        "solids": [*_solids(scene, is_sheet=False)],
        "cones": cones,
        "containers": on_pan,
        "places": [{"name": name, "at": _plain(place)} for name, place in places_m.items()],
        "dots": [{"at": _plain(at), "tone": "good" if is_good else "bad"} for at, is_good in dots],
        "home": _plain(planner.home()),
        "apex": _plain(planner.tool.act(np.array([0.0, 0.0, apex_offset_m]))),
    }


def _joint(model: pin.Model, k: int) -> dict[str, Any]:
    axis = np.ravel(model.joints[k].createData().S)[3:]
    return {"at": _placement(model.jointPlacements[k]), "axis": _plain(axis)}


def _solids(scene: Scene, *, is_sheet: bool, besides: Container[str] = ()) -> Iterable[dict[str, Any]]:
    """Of the sheet alone, or of all but the sheet and the table, `besides` these.

    The arm's own shapes come first, then the sheet's.
    """
    for k, thing in enumerate(scene.shapes.geometryObjects):
        of_sheet = k >= scene.arm_shapes and thing.parentJoint > 0
        if of_sheet != is_sheet or thing.name == "table" or thing.name in besides:
            continue
        mesh = shape_mesh(thing)
        kind = "standing" if thing.parentJoint == 0 and k >= scene.arm_shapes else "arm"
        yield {
            "name": thing.name,
            "kind": ("cone" if thing.name.startswith("cone") else "hand") if of_sheet else kind,
            "joint": thing.parentJoint,
            "at": _placement(thing.placement),
            "points": _plain(mesh.points_m.ravel()),
            "triangles": mesh.triangles.ravel().tolist(),
            "edges": mesh.edges.ravel().tolist(),
        }


def _placement(placement: pin.SE3) -> list[float]:
    return _plain(np.concatenate([placement.translation, pin.Quaternion(placement.rotation).coeffs()]))


def _plain(values: Floats | Sequence[float]) -> list[float]:
    return [round(float(value), _DECIMALS) + 0.0 for value in values]
