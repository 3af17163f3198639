"""What a check costs: the static analysis of a workflow of 500 nodes, and the command with 1000 samples.

    python -m benchmarks.check [--json FILE]

The analysis is what `check` does with a workflow once it is read: wires, names, failures, times. The command is timed
by the processor, in a process of its own, without the planning of the arm's ways and with it (the second time, when
they are known).
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.batch import generated_recipe
from benchmarks.figures import show
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.problems import Problems
from scuhand_bt.recipe.plan import SERVICE
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.grammar import read_workflow
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.lint import Lint
from scuhand_bt.tree.workflow import walk
from scuhand_bt.yaml_source import parse

NODES = 500
ROUNDS = 5


def large_workflow(nodes: int) -> str:
    """A workflow of so many nodes, of all kinds, that is right."""
    part = """\
    - retry:
        attempts: 2
        on: [hand.no_flow]
        child:
          sequence:
            - fallback:
                - cone_holds: {powder: $source.powder}
                - scoop: {source: $source}
            - timeout: {duration: 5 min, child: {dispense: {mass: $mass, as: dose_N}}}
            - shake: {duration: $dose_N.lasted}
"""
    count = nodes // 8
    head = "workflow: large\ninputs: {source: Source, container: Container, mass: Mass}\ntree:\n  sequence:\n"
    begin = "    - place_container: {container: $container}\n    - tare:\n"
    return head + begin + "".join(part.replace("_N", f"_{n}") for n in range(count)) + "    - park:\n"


def analysis_s(text: str) -> tuple[float, int]:
    """The best time of some, and the number of nodes."""
    lab = load_lab(starter_lab())
    problems = Problems()
    workflow = read_workflow(parse(text, "large.yaml", "a workflow"), "large", problems)
    assert workflow is not None
    library = Library(
        lab.library.skills, {**lab.library.workflows, "large": workflow}, lab.library.powders, facts=lab.library.facts
    )
    best_s = float("inf")
    for _ in range(ROUNDS):
        began = time.perf_counter()
        check_workflows(library, ["large"], problems)
        Lint(library, lab.cell, SERVICE, problems).check(["large"], ["large"])
        best_s = min(best_s, time.perf_counter() - began)
    problems.raise_any()
    return best_s, sum(1 for _ in walk(workflow.tree))


def command_s(*arguments: str) -> float:
    """What the processor spends on a command, the best of three."""

    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "scuhand_bt", "check", *arguments], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    return min(once() for _ in range(3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    best_s, nodes = analysis_s(large_workflow(NODES))
    figures = {"nodes": float(nodes), "analysis_ms": 1000 * best_s}
    with tempfile.TemporaryDirectory() as name:
        recipe = generated_recipe(Path(name), 1000)
        figures["check_1000_fast_s"] = command_s("--fast", str(recipe))
        figures["check_1000_s"] = command_s(str(recipe))
    limits = {"analysis_ms": "< 100", "check_1000_fast_s": "< 1.5", "check_1000_s": "< 1.5"}
    show("What a check costs", figures, limits, options.json)


if __name__ == "__main__":
    main()
