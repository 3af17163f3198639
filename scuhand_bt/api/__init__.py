"""scuhand_bt from Python: a lab is opened, recipes are checked, planned and run, and results come as records.

    from scuhand_bt import api

    lab = api.open_lab("my-lab")
    result = lab.dry_run("my-lab/recipes/xrd_holders.yaml", seed=1)
    for dose in result.doses:
        print(dose.sample, dose.dispensed_mg, dose.verdict)

    result = api.resume("last", lab="my-lab")
    table = api.find_run("last", "my-lab").result().rows()

A recipe is the path of a file, or a dict of what would stand in one ("50 mg" as there). Masses are in mg, times in s.
The command line is made of this (`docs/python.md`); what few programs need stands in `api.bench` (twins, doctor),
`api.books` (inventory, what was learnt, persons, the ledger) and `api.content` (skills, workflows, failures).

Everything is done in the thread that calls, and what is made in one thread may be used in another. Threads may each
run their own recipe of one `OpenLab`; a session is run once.
"""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.api.interrupted import Interrupted, resume, take_up
    from scuhand_bt.api.labs import How, HowRun, HowSimulated, OnEvent, OnSample, OpenLab, closing, open_lab
    from scuhand_bt.api.past import NotHeard, PastRun, find_run, runs
    from scuhand_bt.api.results import DoseRecord, Result
    from scuhand_bt.devices.liveness import Hung
    from scuhand_bt.journal.archive import Summary
    from scuhand_bt.journal.export import canonical_parts
    from scuhand_bt.journal.plain import json_parts
    from scuhand_bt.journal.reader import Contents
    from scuhand_bt.journal.results import SampleResult
    from scuhand_bt.journal.telling import RunEvent
    from scuhand_bt.lab import Lab, find_lab, find_state
    from scuhand_bt.problems import Problem, SourceError
    from scuhand_bt.recipe.plan import Plan
    from scuhand_bt.recipe.sample import Sample
    from scuhand_bt.run.checking import Checked
    from scuhand_bt.run.control import Control, Wish
    from scuhand_bt.run.observers import BatchObserver, Observers
    from scuhand_bt.run.operator import Person
    from scuhand_bt.run.options import check_controller
    from scuhand_bt.run.outcome import BatchResult
    from scuhand_bt.run.questions import UNKNOWN, Question, Who
    from scuhand_bt.run.session import Session
    from scuhand_bt.run.simulation import DryRun, Rehearsal
    from scuhand_bt.sim.fault_rules import read_faults
    from scuhand_bt.sim.plant import PlantError
    from scuhand_bt.sim.wire.hand import NoCompiler
    from scuhand_bt.skill import SkillFailed
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "api.interrupted": "Interrupted resume take_up",
            "api.labs": "How HowRun HowSimulated OnEvent OnSample OpenLab closing open_lab",
            "api.past": "NotHeard PastRun find_run runs",
            "api.results": "DoseRecord Result",
            "devices.liveness": "Hung",
            "journal.archive": "Summary",
            "journal.export": "canonical_parts",
            "journal.plain": "json_parts",
            "journal.reader": "Contents",
            "journal.results": "SampleResult",
            "journal.telling": "RunEvent",
            "lab": "Lab find_lab find_state",
            "problems": "Problem SourceError",
            "recipe.plan": "Plan",
            "recipe.sample": "Sample",
            "run.checking": "Checked",
            "run.control": "Control Wish",
            "run.observers": "BatchObserver Observers",
            "run.operator": "Person",
            "run.options": "check_controller",
            "run.outcome": "BatchResult",
            "run.questions": "UNKNOWN Question Who",
            "run.session": "Session",
            "run.simulation": "DryRun Rehearsal",
            "sim.fault_rules": "read_faults",
            "sim.plant": "PlantError",
            "sim.wire.hand": "NoCompiler",
            "skill": "SkillFailed",
        },
    )

__all__ = [
    "UNKNOWN",
    "BatchObserver",
    "BatchResult",
    "Checked",
    "Contents",
    "Control",
    "DoseRecord",
    "DryRun",
    "How",
    "HowRun",
    "HowSimulated",
    "Hung",
    "Interrupted",
    "Lab",
    "NoCompiler",
    "NotHeard",
    "Observers",
    "OnEvent",
    "OnSample",
    "OpenLab",
    "PastRun",
    "Person",
    "Plan",
    "PlantError",
    "Problem",
    "Question",
    "Rehearsal",
    "Result",
    "RunEvent",
    "Sample",
    "SampleResult",
    "Session",
    "SkillFailed",
    "SourceError",
    "Summary",
    "Who",
    "Wish",
    "canonical_parts",
    "check_controller",
    "closing",
    "find_lab",
    "find_run",
    "find_state",
    "json_parts",
    "open_lab",
    "read_faults",
    "resume",
    "runs",
    "take_up",
]
