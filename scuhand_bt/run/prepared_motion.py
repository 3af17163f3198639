"""The motion planner of a plan: all places that its samples use, and the ways between them."""

from pathlib import Path

import numpy as np
from platformdirs import user_cache_path

from scuhand_bt.cell.places import Position, all_places
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.motion.patience import LIVE_S
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.ways import prepare_ways, require_first_strokes
from scuhand_bt.specs import ContainerKind


def plans_folder() -> Path:
    """The user's cache of motion plans, shared by all labs, so that the next run in the same geometry need not
    search.
    """
    return user_cache_path("scuhand_bt") / "plans"


def prepared_motion(plan: Plan, lab: Lab, *, for_real: bool = False) -> MotionPlanner:
    """The motion planner with all ways between the plan's places planned and polished.

    `for_real`: also the ways past each container, and all others that the plan will take (`run/ways.py`). A dry run
    plans these when they are needed. Both refuse a mortar from which no scoop would bring anything. Raises SkillFailed
    arm.* for an impossible motion.
    """
    motion = motion_of(plan, lab)
    if for_real:
        prepare_ways(motion, plan, lab.cell, container_kinds(plan))
        motion.patience_s = LIVE_S  # from now on an arm waits
    else:
        require_first_strokes(plan, lab.cell)
        motion.prepare()
    motion.keep_plans()
    return motion


def motion_of(plan: Plan, lab: Lab) -> MotionPlanner:
    """The motion planner with every place of the plan, and no way planned yet."""
    mortars = {source.station: source.mortar for source in plan.recipe.sources.values()}
    motion = lab.motion_planner(mortars, plans_folder())
    for name, position_mm in places_of(plan, lab).items():
        motion.add_place(name, ApexPose(np.array(position_mm) / 1000))
    return motion


def places_of(plan: Plan, lab: Lab) -> dict[str, Position]:
    """Every named place of the plan."""
    return all_places(lab.cell, plan.recipe.sources, container_kinds(plan))


def container_kinds(plan: Plan) -> list[ContainerKind]:
    """Every kind of container that the plan doses into."""
    kinds = [kind for sample in plan.recipe.samples for kind in sample.all_containers]
    return list({kind.name: kind for kind in kinds}.values())
