"""mplib as a peer of the motion benchmark: OMPL's RRT-Connect, simplified, with toppra's time law.

mplib 0.2 needs numpy < 2, so it runs in an environment of its own: `compare` makes one (with venv and
pip) where there is none yet, and runs this very file there, which needs mplib and numpy alone. What
it is given is ours: the arm with its sheet, the cell's solids, the pairs that are checked, the limits,
and for every task the start and the free goal configurations of the closed form. Two things differ: a
capsule is a cylinder with two balls, and the cone a stack of cylinders around it.
"""

import json
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

LINKS = ("base", "shoulder", "upper_root", "upper", "fore_root", "fore", "wrist", "flange")
GOALS = 16
SLICES = 4
SAMPLES_S = 0.005
TIMEOUT_S = 1200


class Sampled:
    """A motion as mplib returns it: positions at times, straight in between."""

    def __init__(self, times_s: list[float], positions: list[list[float]]) -> None:
        self.times_s, self.positions = np.array(times_s), np.array(positions)
        self.duration_s = float(self.times_s[-1])

    def sample(self, time_s: float) -> Any:
        return np.array([np.interp(time_s, self.times_s, column) for column in self.positions.T])


def compare(bench: Any, tasks: list[Any], audit: Any, environment: Path) -> dict[str, Any]:
    """The peer's figures for the tasks, or why there are none."""
    python = environment / "bin" / "python"
    try:
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True, timeout=120)
            wanted = ["mplib>=0.2,<0.3", "numpy<2"]
            subprocess.run([str(python), "-m", "pip", "install", "--quiet", *wanted], check=True, timeout=600)
        with tempfile.TemporaryDirectory() as folder:
            given, found = Path(folder, "given.json"), Path(folder, "found.json")
            given.write_text(json.dumps(problem(bench, tasks)))
            command = [str(python), __file__, str(given), str(found)]
            subprocess.run(command, check=True, timeout=TIMEOUT_S, stdout=subprocess.DEVNULL)
            answers = json.loads(found.read_text())
    except (OSError, subprocess.SubprocessError) as error:
        return {"not compared": str(error)}
    solved = [(task, answer) for task, answer in zip(tasks, answers, strict=True) if answer["times_s"]]
    cpu_ms = [answer["cpu_ms"] for answer in answers]
    return {
        "tasks": len(tasks),
        "failures": len(tasks) - len(solved),
        "touching in the audit": sum(audit.touches(Sampled(a["times_s"], a["positions"])) for _, a in solved),
        "plan_ms, CPU (without IK)": "median {:.3g}, p95 {:.3g}, worst {:.3g} ms".format(
            *np.percentile(cpu_ms, [50, 95, 100])
        ),
        "duration / bound (no jerk limit)": "mean {:.3g}".format(
            np.mean([a["times_s"][-1] / bench.bound_s(task) for task, a in solved])
        ),
    }


def problem(bench: Any, tasks: list[Any]) -> dict[str, Any]:
    """Everything the peer is told, as JSON can hold it."""
    rates, solids = bench.rates, []
    for thing in bench.scene.shapes.geometryObjects:
        if thing.parentJoint == 0 and not thing.name.startswith("base"):
            shape, at = thing.geometry, thing.placement
            box = [2 * half for half in shape.halfSide] if hasattr(shape, "halfSide") else None
            cylinder = None if box else [shape.radius, 2 * shape.halfLength]
            solids.append([thing.name, at.translation.tolist(), box, cylinder])
    wanted = []
    for task in tasks:
        goals = bench.free(task.goal)
        goals[:, 6] = task.start[6]
        nearest = np.argsort(np.abs(goals - task.start).max(axis=1))[:GOALS]
        wanted.append({"start": task.start.tolist(), "goals": goals[nearest].tolist()})
    return {
        "urdf": with_sheet(bench.planner.urdf, bench.scene),
        "srdf": pairs(),
        "solids": solids,
        "speed": rates.speed.tolist(),
        "acceleration": rates.acceleration.tolist(),
        "tasks": wanted,
    }


def with_sheet(urdf: str, scene: Any) -> str:
    """The URDF with capsules taken apart, and with clamps and cone on the flange."""
    root = ET.fromstring(urdf)
    root.set("version", "1.0")
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            capsule = collision.find("geometry/capsule")
            if capsule is None:
                continue
            radius, length = float(capsule.attrib["radius"]), float(capsule.attrib["length"])
            origin = collision.find("origin")
            assert origin is not None
            xyz = np.array(origin.attrib["xyz"].split(), dtype=float)
            rpy = origin.attrib["rpy"]
            along = np.array([1.0, 0.0, 0.0]) if float(rpy.split()[1]) else np.array([0.0, 0.0, 1.0])
            link.remove(collision)
            add(link, xyz, rpy, "cylinder", radius=radius, length=length)
            for end in (-0.5, 0.5):
                add(link, xyz + end * length * along, "0 0 0", "sphere", radius=radius)
    flange = next(link for link in root.findall("link") if link.get("name") == "flange")
    for thing in scene.shapes.geometryObjects:
        if thing.name not in ("clamps", "cone"):
            continue
        shape, z_m = thing.geometry, float(thing.placement.translation[2])
        slices = 1 if thing.name == "clamps" else SLICES
        length = 2 * shape.halfLength / slices
        for k in range(slices):
            low_m = z_m - shape.halfLength + k * length
            radius = shape.radius if slices == 1 else shape.radius * (1 - k / slices)
            add(flange, np.array([0.0, 0.0, low_m + length / 2]), "0 0 0", "cylinder", radius=radius, length=length)
    return ET.tostring(root, encoding="unicode")


def add(link: ET.Element, xyz: Any, rpy: str, kind: str, **sizes: float) -> None:
    collision = ET.SubElement(link, "collision")
    ET.SubElement(collision, "origin", xyz=" ".join(f"{x:.9g}" for x in xyz), rpy=rpy)
    ET.SubElement(ET.SubElement(collision, "geometry"), kind, {name: f"{size:.9g}" for name, size in sizes.items()})


def pairs() -> str:
    """The SRDF that leaves out what our scene leaves out: links with fewer than two others between."""
    lines = [
        f'<disable_collisions link1="{one}" link2="{other}" reason="Adjacent"/>'
        for k, one in enumerate(LINKS)
        for other in LINKS[k + 1 : k + 3]
    ]
    return '<robot name="crane_x7_scuhand_sv">' + "".join(lines) + "</robot>"


def main(given_file: str, found_file: str) -> None:
    """In mplib's own environment: plan every task, and write what came of it."""
    import mplib  # type: ignore[import-not-found, unused-ignore]
    from mplib.collision_detection import fcl  # type: ignore[import-not-found, unused-ignore]

    given = json.loads(Path(given_file).read_text())
    folder = Path(given_file).parent
    urdf, srdf = folder / "arm.urdf", folder / "arm.srdf"
    urdf.write_text(given["urdf"])
    srdf.write_text(given["srdf"])
    objects = []
    for name, at, box, cylinder in given["solids"]:
        shape = fcl.Box(np.array(box)) if box else fcl.Cylinder(*cylinder)
        objects.append(fcl.FCLObject(name, mplib.Pose(p=at), [fcl.CollisionObject(shape)], [mplib.Pose()]))
    planner = mplib.Planner(
        str(urdf),
        "flange",
        srdf=str(srdf),
        joint_vel_limits=given["speed"],
        joint_acc_limits=given["acceleration"],
        objects=objects,
    )
    allowed = planner.planning_world.get_allowed_collision_matrix()
    for name, *_ in given["solids"]:
        for link in LINKS[:2]:
            allowed.set_entry(link, name, True)
    answers = []
    for task in given["tasks"]:
        start, goals = np.array(task["start"]), [np.array(goal) for goal in task["goals"]]
        begin_s = time.process_time()
        try:
            found = planner.plan_qpos(goals, start, time_step=SAMPLES_S, planning_time=5.0)
        except (RuntimeError, ValueError):
            found = {"status": "failed"}
        cpu_ms = (time.process_time() - begin_s) * 1e3
        done = found["status"] == "Success"
        answers.append(
            {
                "cpu_ms": cpu_ms,
                "times_s": found["time"].tolist() if done else None,
                "positions": found["position"].tolist() if done else None,
            }
        )
    Path(found_file).write_text(json.dumps(answers))


if __name__ == "__main__":
    main(*sys.argv[1:])
