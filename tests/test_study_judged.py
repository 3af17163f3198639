"""How trials judge samples by the simulation: of several powders, of several containers, and of what was not run."""

from scuhand_bt.study.trial import SampleTrial, Setup, trial
from tests.conftest import REPOSITORY, LabFolder

SOURCES = """\
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 5 g}
"""
MIXTURE = f"""\
recipe: mixture
workflow: mix_at_ratio
sources:
{SOURCES}
samples: [{{id: mix, first: beads, second: msg, container: alumina_crucible, mass: 400 mg, ratio: 50 %}}]
"""
STOPS = f"""\
recipe: stops
workflow: fill_named
order: as_written
sources:
{SOURCES}
defaults: {{source: beads, container: pellet_die_13mm, amount: 100 mg}}
samples: [{{id: a}}, {{id: b}}, {{id: blank, workflow: weigh_blank}}]
on_failure: {{dose.overshoot: stop}}
"""
FILL_NAMED = """\
workflow: fill_named
inputs: {source: Source, container: Container, amount: Mass, tolerance: {type: Mass, default: 2 mg}}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $source, container: $container, mass: $amount, tolerance: $tolerance}
    - park:
"""
GUSHER = "batch_bench:Gusher"


def tried(lab_folder: LabFolder, recipe: str, plant: str | None = None) -> dict[str, SampleTrial]:
    setup = Setup(lab_folder.write("recipes/mine.yaml", recipe), lab_folder.folder, plant=plant)
    return {sample.id: sample for sample in trial(setup, 1).samples}


def test_a_mixture_is_judged_by_all_that_was_to_come_into_its_container(lab_folder: LabFolder) -> None:
    """600 mg were held against the 400 of its first powder: no mixture was truly good, and `--optimise` found none."""
    mix = tried(lab_folder, MIXTURE)["mix"]
    assert (mix.verdict, mix.good, mix.truly_good) == ("in tolerance", True, True)
    assert mix.target_mg == 400.0
    assert mix.true_mg is not None
    assert abs(mix.true_mg - 600.0) < 5.0


def test_a_mixture_that_has_ended_within_is_not_truly_good(lab_folder: LabFolder) -> None:
    lab_folder.replace("trees/mix_at_ratio.yaml", "    - change_powder: {source: $first}\n", "    - fail_here:\n")
    lab_folder.write(
        "skills/fail_here.py",
        '''"""Fails."""

from scuhand_bt.skill import Cell, Code, Skill, SkillFailed, Steps


class FailHere(Skill[None]):
    """Fail."""

    raises = (Code.OPERATOR_REFUSED,)
    typical_s = 1.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        yield from ()
        raise SkillFailed(Code.OPERATOR_REFUSED, "no more of it")
''',
    )
    mix = tried(lab_folder, MIXTURE + "on_failure: {otherwise: flag}\n")["mix"]
    assert (mix.verdict, mix.code) == ("in tolerance", "operator.refused")
    assert (mix.good, mix.truly_good) == (False, False)


def test_what_was_not_run_is_not_truly_good_though_nobody_knows_its_target(lab_folder: LabFolder) -> None:
    """A mass of another name is no target, and what has none was truly good."""
    lab_folder.write("trees/fill_named.yaml", FILL_NAMED)
    samples = tried(lab_folder, STOPS, GUSHER)
    assert [(one.verdict, one.target_mg, one.truly_good) for one in samples.values()] == [
        ("over", 100.0, False),
        ("not run", None, False),
        ("not run", None, False),
    ]


def test_what_was_to_dose_nothing_and_did_is_truly_good(lab_folder: LabFolder) -> None:
    recipe = "recipe: blank\nworkflow: weigh_blank\nsamples: [{id: a, container: xrd_holder}]\n"
    blank = tried(lab_folder, recipe)["a"]
    assert (blank.verdict, blank.good, blank.truly_good, blank.true_mg) == ("recorded", True, True, 0.0)


def test_composed_samples_that_were_not_run_have_the_target_of_those_that_were(lab_folder: LabFolder) -> None:
    shipped = (REPOSITORY / "recipes" / "cathodes.yaml").read_text(encoding="utf-8")
    two = shipped.split("samples:", maxsplit=1)[0] + "samples: [{id: a, compose: LiCoO2}, {id: b, compose: LiCoO2}]\n"
    whole, stopped = tried(lab_folder, two), tried(lab_folder, two + "overshoot_limit: 1\n", GUSHER)
    assert stopped["b"].verdict == "not run"
    assert stopped["b"].target_mg == whole["b"].target_mg
