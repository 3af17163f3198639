"""Forecasts what a workflow does, skill by skill, with the values that are known before the run."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problem, SourceError, shorten
from scuhand_bt.recipe.flow import DOSING
from scuhand_bt.recipe.known import is_known, known
from scuhand_bt.specs import Source
from scuhand_bt.tree.build import Scope, bound_inputs, chosen_case
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.workflow import Branch, Call, Choice, Decorator, TreeNode, Workflow, children_of


@dataclass(frozen=True)
class Expected:
    """The forecast of one call of a skill, and where it is called."""

    duration_s: float
    person: str | None
    mark: Mark
    descent: tuple[str, float] | None = None

    def repeated(self, count: int) -> "Expected":
        if count == 1:
            return self
        person = f"{self.person} ({count} times)" if self.person else None
        return replace(self, duration_s=self.duration_s * count, person=person)


class Forecaster:
    """Walks a workflow with the values known before the run, and asks each skill for its forecast."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._library: Library = lab.library
        self._services: dict[tuple[str, str], list[Expected]] = {}
        """Forecasts of workflows between samples, by workflow and source."""
        self._named: Source | None = None
        """The source that the job has named last: the next dose is of its powder."""

    def of(self, workflow: str, inputs: Mapping[str, Any]) -> list[Expected]:
        """The forecasts of a job with this workflow, in order. Raises SourceError if a skill's forecast raises."""
        self._named = None
        return self._of_workflow(self._library.workflows[workflow], dict(inputs))

    def of_service(self, workflow: str, source: Source) -> list[Expected]:
        """As `of`, for a workflow between samples; empty if the lab lacks it."""
        if workflow not in self._library.workflows:
            return []
        if (workflow, source.name) not in self._services:
            self._services[workflow, source.name] = self.of(workflow, {"source": source})
        return self._services[workflow, source.name]

    def _of_workflow(self, workflow: Workflow, inputs: dict[str, Any]) -> list[Expected]:
        return self._of(workflow.tree, Scope(bound_inputs(workflow, inputs, self._library)))

    def _of(self, node: TreeNode, scope: Scope) -> list[Expected]:
        if isinstance(node, Choice) and is_known(node.argument, scope):
            number = chosen_case(node, scope, self._library)
            return [] if number is None else self._of(node.cases[number].child, scope)
        if isinstance(node, Branch | Choice):
            found = [self._of(child, scope) for child in children_of(node)]
            if node.kind == "sequence":
                return [expected for child in found for expected in child]
            # Nothing fails in a forecast, so the first child of a fallback is taken: as a check that the cone holds
            # enough, before the scoop for when it does not.
            goes_on = found[:1] if node.kind == "fallback" else found
            longest = max(goes_on, key=lambda child: sum(expected.duration_s for expected in child))
            others = [expected for child in found if child is not longest for expected in child]
            return [*longest, *(replace(one, duration_s=0.0) for one in others if one.person or one.descent)]
        if isinstance(node, Decorator) and node.kind == "for_each":
            return self._of_for_each(node, scope)
        if isinstance(node, Decorator):
            times = node.arguments.get("times")
            count = 1 if times is None else int(known(node.arguments, scope, self._library).get("times", 1))
            return [expected.repeated(count) for expected in self._of(node.child, scope)]
        inputs = known(node.arguments, scope, self._library, node)
        self._named = next((value for value in inputs.values() if isinstance(value, Source)), self._named)
        if node.name in self._library.skills:
            return [self._of_skill(node, inputs)]
        return self._of_workflow(self._library.workflows[node.name], inputs)

    def _of_for_each(self, node: Decorator, scope: Scope) -> list[Expected]:
        """All rounds if the lists are known, else one round."""
        lists = known(node.arguments, scope, self._library)
        if lists.keys() != node.arguments.keys():
            return self._of(node.child, scope)
        rounds = [Scope(dict(zip(lists, items, strict=True)), scope) for items in zip(*lists.values(), strict=True)]
        return [expected for within in rounds for expected in self._of(node.child, within)]

    def _of_skill(self, node: Call, inputs: dict[str, Any]) -> Expected:
        skill = self._library.skills[node.name]
        if self._named is not None and DOSING.issubset(skill.devices):
            inputs = {"source": self._named, **inputs}
        try:
            forecast = skill.forecast(inputs, self._lab.cell)
            return Expected(forecast.duration_s, forecast.person, node.mark, forecast.descent)
        except (Exception, SystemExit) as error:  # a lab's code may raise anything
            what = f"the forecast of '{node.name}' failed: {type(error).__name__}: {error}"
            raise SourceError([Problem(node.mark, shorten(what, 200), "skill-forecast")]) from error
