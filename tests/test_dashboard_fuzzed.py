"""The dashboard's interface asked for what nobody thought of: whatever comes, it is answered, and never breaks."""

from pathlib import Path

import pytest
from dashboard_client import serving
from hypothesis import HealthCheck, given, settings
from journal_bench import HEADER

from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.journal.writer import Journal


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # schemathesis' own
def test_whatever_is_asked_it_answers_as_it_says_it_does(tmp_path: Path) -> None:
    schemathesis = pytest.importorskip("schemathesis")
    written = Journal(tmp_path / "runs" / "one.sqlite", durable=False)
    written.event(RunBegun.model_validate(HEADER))
    written.close()
    asked = 0
    with serving(tmp_path) as client:
        schema = schemathesis.openapi.from_dict(client.get("/api/openapi.json").values)
        schema.config.update(base_url=client.origin)
        own = {"Origin": client.origin, "X-Dashboard": client.access.word}
        for found in schema.get_all_operations():
            operation = found.ok()
            if operation.path.endswith("/news"):
                continue  # it goes on for ever

            @settings(max_examples=60, deadline=None, database=None, suppress_health_check=list(HealthCheck))
            def ask(case: object) -> None:
                nonlocal asked
                asked += 1
                for headers in (own, {}):
                    answer = case.call(headers=headers)  # type: ignore[attr-defined]
                    assert answer.status_code < 500, answer.text

            given(case=operation.as_strategy())(ask)()
        for run in ("one", "%00", "a" * 3000):
            for path in (f"/api/runs/{run}", f"/api/runs/{run}?time_s=1e8", f"/api/runs/{run}/scene"):
                assert client.get(path).status in (200, 404, 409)
    assert asked > 200
