"""Whole workflows and recipes put together at random, of what the lab has."""

from collections.abc import Mapping
from typing import Any

import yaml
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from harness.mutants import SOURCES, Mutant

_MASS = st.sampled_from(["$mass"] * 8 + ["5 mg", "50 mg", "20 mg", "$dose.error"])
_TOLERANCE = st.sampled_from(["$tolerance", "$tolerance", "3 mg", "10 mg"])
_LONG = st.sampled_from(["1 s", "30 s", "10 min", "5 s", "1 min", "20 s", "0.01 s", "3 s", "2 h", "0 s"])
_RARELY = st.integers(0, 40).map(lambda number: number == 17)
_CALLS: Mapping[str, Mapping[str, st.SearchStrategy[str]]] = {
    "place_container": {"container": st.just("$container")},
    "tare": {},
    "scoop": {"source": st.just("$source")},
    "move_over": {"container": st.just("$container")},
    "dispense": {"mass": _MASS, "tolerance": _TOLERANCE, "as": st.sampled_from(["dose", "other"])},
    "fill": {
        "source": st.just("$source"),
        "container": st.just("$container"),
        "mass": _MASS,
        "tolerance": _TOLERANCE,
        "as": st.just("dose"),
    },
    "cone_holds": {"powder": st.sampled_from(["$source.powder", "glass_beads", "$powder"]), "at_least": _MASS},
    "return_leftover": {"source": st.just("$source")},
    "discard": {},
    "park": {},
    "remove_container": {},
    "shake": {"duration": _LONG, "level": st.sampled_from(["100 %", "0 %", "30 %"])},
    "wait": {"duration": _LONG},
    "watch_balance": {"duration": _LONG},
    "swap_sheet": {},
    "tour": {},
    "check_valve": {},
    "any": {},
}
"""Skills and workflows, and what they may be given; `any` is the workflow itself."""
_USUAL = ("place_container", "tare", "scoop", "move_over", "dispense", "fill", "return_leftover", "wait", "park")


@st.composite
def _calls(draw: st.DrawFn) -> Any:
    name = draw(st.sampled_from(_USUAL * 3 + tuple(_CALLS)))
    given_ = {key: draw(values) for key, values in _CALLS[name].items() if not draw(_RARELY)}
    return {name: given_ or None}


def _nested(children: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    guards = st.lists(st.just({"cone_holds": {"powder": "$source.powder"}}), min_size=1, max_size=2)
    count = st.sampled_from(["2", "3"] * 6 + ["1", "200", "0", "$mass"])
    beside = st.sampled_from([{"wait": {"duration": "2 s"}}, {"watch_balance": {"duration": "5 s"}}, {"tour": None}])
    codes = st.lists(st.sampled_from(["hand.cone_empty", "hand.no_flow", "dose.overshoot"]), min_size=1, max_size=3)
    several = st.lists(children, min_size=1, max_size=5)
    return st.one_of(
        several.map(lambda c: {"sequence": c}),
        several.map(lambda c: {"sequence": c}),
        several.map(lambda c: {"fallback": c}),
        st.builds(lambda one, other: {"parallel": [one, other]}, children, beside),
        st.builds(lambda g, c: {"while": {"guards": g, "child": c}}, guards, children),
        st.builds(lambda n, on, c: {"retry": {"attempts": n, "on": on, "child": c}}, count, codes, children),
        st.builds(lambda n, c: {"retry": {"attempts": n, "child": c}}, count, children),
        st.builds(lambda n, c: {"repeat": {"times": n, "child": c}}, count, children),
        st.builds(lambda d, c: {"timeout": {"duration": d, "child": c}}, _LONG, children),
        children.map(lambda c: {"invert": c}),
        children.map(lambda c: {"optional": {"child": c}}),
    )


_TREES = st.recursive(_calls(), _nested, max_leaves=12)


_ASKED = st.sampled_from(["mass", "amount", "amount"])
"""What a sample calls its mass: by `mass` it asks for it, and most trees at random do not dose that and are refused."""


@st.composite
def _workflows(draw: st.DrawFn, asked: str) -> str:
    begin = [{"place_container": {"container": "$container"}}, {"tare": None}] if draw(st.booleans()) else []
    inputs = {"source": "Source", "container": "Container", asked: "Mass"}
    inputs["tolerance"] = draw(
        st.sampled_from([{"type": "Mass", "default": value} for value in ("3 mg", "5 mg", "10 mg", "5 %", "1")])
    )  # type: ignore[assignment]
    tree = {"sequence": [*begin, *draw(st.lists(_TREES, min_size=1, max_size=5))]}
    workflow = {"workflow": "any", "inputs": inputs, "tree": tree}
    if draw(st.booleans()):
        workflow["result"] = draw(st.sampled_from(["$dose", "$dose.error", "$mass"]))
    return str(yaml.safe_dump(workflow, sort_keys=False, width=110)).replace("$mass", f"${asked}")


@st.composite
def _samples(draw: st.DrawFn, number: int, asked: str) -> dict[str, Any]:
    sample: dict[str, Any] = {
        "id": f"s{number}",
        "workflow": draw(st.sampled_from(["any", "any", "any", "fill_xrd_holder"])),
    }
    sample["source"] = draw(st.sampled_from(["beads", "msg"]))
    container, mass_mg = draw(
        st.sampled_from([("xrd_holder", 80), ("pellet_die_13mm", 400), ("alumina_crucible", 900)])
    )
    sample["container"] = container
    mass = asked if sample["workflow"] == "any" else "mass"
    sample[mass] = f"{draw(st.integers(15, mass_mg))} mg"
    match draw(st.integers(0, 7)):
        case 0:
            sample["tolerance"] = draw(st.sampled_from(["20 %", "2 mg", "0.05 mg", "10 mg"]))
        case 1:
            sample["id"], sample[mass] = [f"l{number}", f"m{number}"], ["20 mg", sample[mass]]
        case 2:
            sample["repeat"] = draw(st.sampled_from(["2", "1", "2", "x"]))
        case 3 if draw(st.booleans()):
            del sample[draw(st.sampled_from(sorted(sample)))]
    return sample


@st.composite
def _recipes(draw: st.DrawFn, asked: str) -> str:
    recipe: dict[str, Any] = {"recipe": "any", "order": draw(st.sampled_from(["by_powder", "as_written"]))}
    if draw(st.booleans()):
        recipe["controller"] = draw(st.sampled_from(["paper", "adaptive", "direct_pid", "paper", "adaptive", "none"]))
    if draw(st.booleans()):
        recipe["workflow"] = "any"
    recipe["samples"] = [draw(_samples(number, asked)) for number in range(draw(st.integers(1, 2)))]
    actions = st.sampled_from(["flag", "skip_sample", "redo", "ask", "stop"])
    recipe["on_failure"] = {"otherwise": draw(actions), "hand.cone_empty": draw(actions)}
    return SOURCES + str(yaml.safe_dump(recipe, sort_keys=False, width=110))


def structures(first: int, count: int) -> list[Mutant]:
    """Workflows and recipes put together at random, of this number and on."""
    found: list[Mutant] = []

    @seed(first)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(_ASKED.flatmap(lambda asked: st.tuples(_workflows(asked), _recipes(asked))), st.integers(0, 3))
    def collect(texts: tuple[str, str], faults: int) -> None:
        workflow, recipe = texts
        changes = {"trees/any.yaml": workflow.encode(), "recipes/any.yaml": recipe.encode()}
        found.append(Mutant("structure", "any", "recipes/any.yaml", changes, None if faults else "misfortune.yaml"))

    collect()
    return found[:count]
