"""What an order carries: the recipe and its tables, as a station would write them."""

import json
from pathlib import Path

import pytest
from fleet_bench import RECIPE, plan_of
from running import make_lab

from scuhand_bt.fleet.order import submission_of, write
from scuhand_bt.problems import SourceError


def test_an_order_carries_the_recipe_and_its_tables_byte_for_byte(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    (lab / "tables").mkdir()
    table = "\ufeffid;mass [mg]\r\nb;30,5\r\n".encode()
    (lab / "tables" / "t.csv").write_bytes(table)
    text = RECIPE.format(count=1).replace("samples: [", "samples: [{table: tables/t.csv}, ")
    made = submission_of(plan_of(lab, text=text), simulated=True)
    write(json.loads(json.dumps(made.files)), tmp_path / "there")
    assert (tmp_path / "there" / "queued.yaml").read_text() == text
    assert (tmp_path / "there" / "tables" / "t.csv").read_bytes() == table


def test_a_recipe_whose_name_no_database_can_keep_is_refused(tmp_path: Path) -> None:
    plan = plan_of(make_lab(tmp_path / "lab"), "b\udcff.yaml")
    with pytest.raises(SourceError, match="are not UTF-8: rename the file"):
        submission_of(plan, simulated=True)


def test_a_table_elsewhere_is_refused_by_who_submits_and_by_who_would_write_it(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    (lab / "t.csv").write_text("id,mass\nb,30 mg\n")
    (lab / "recipes").mkdir()
    text = RECIPE.format(count=1).replace("samples: [", "samples: [{table: ../t.csv}, ")
    plan = plan_of(lab, "recipes/r.yaml", text)
    with pytest.raises(SourceError, match="put the table beside it"):
        submission_of(plan, simulated=True)
    for name in ("../out.csv", "/tmp/out.csv"):
        with pytest.raises(SourceError, match="the recipe's own folder"):
            write({name: ""}, tmp_path / "there")


@pytest.mark.parametrize("table", ["tables/../t.csv", "{lab}/t.csv"])
def test_a_table_that_no_station_would_write_is_refused_before_its_recipe_is_queued(tmp_path: Path, table: str) -> None:
    """It is beside its recipe, but the station's copy would not find it there: the job failed in the night."""
    lab = make_lab(tmp_path / "lab")
    (lab / "tables").mkdir()
    (lab / "t.csv").write_text("id,mass\nb,30 mg\n")
    text = RECIPE.format(count=1).replace("samples: [", f"samples: [{{table: {table.format(lab=lab)}}}, ")
    plan = plan_of(lab, text=text)
    with pytest.raises(SourceError, match=r"queued.yaml:6:\d+: .* from its own folder on"):
        submission_of(plan, simulated=True)
