"""A study on a Dask cluster: one that is lost, has no worker, or has one of another program."""

import logging
import pickle
import sys
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

import scuhand_bt.study
from scuhand_bt.problems import SourceError
from scuhand_bt.study.pool import all_trials, executor_of
from scuhand_bt.study.trial import Setup


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """In the place of Dask, which is an extra."""
    client = MagicMock()
    client.__exit__.return_value = client.get_executor().__exit__.return_value = False
    killed = type("KilledWorker", (Exception,), {})
    fake_dask = SimpleNamespace(Client=lambda *asked, **how: client, KilledWorker=killed, client=client)
    monkeypatch.setitem(sys.modules, "distributed", fake_dask)
    return fake_dask


def test_a_cluster_that_goes_away_ends_the_study_in_words(
    cluster: SimpleNamespace, caplog: pytest.LogCaptureFixture
) -> None:
    for error in (CancelledError, cluster.KilledWorker):
        with pytest.raises(SourceError, match="--dask tcp://x: the cluster was lost"), executor_of(None, "tcp://x"):
            raise error
    logging.getLogger("distributed.client").error("by a traceback")
    assert not caplog.records


def test_a_cluster_without_a_worker_is_not_waited_for(cluster: SimpleNamespace) -> None:
    cluster.client.wait_for_workers.side_effect = TimeoutError
    with pytest.raises(SourceError, match="--dask tcp://x: the scheduler has no worker"), executor_of(None, "tcp://x"):
        pass


def test_that_all_workers_of_a_cluster_have_gone_is_told_each_time_once(
    cluster: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A study waited without a word for ever."""
    monkeypatch.setattr("scuhand_bt.study.cluster.LOOKS_S", 0.0)
    some, none = {"tcp://a": 1}, dict[str, int]()
    seen = [*[none] * 9, some, *[none] * 30, some, *[none] * 10]
    told, when, is_lost = list[str](), list[int](), threading.Event()

    def nthreads() -> dict[str, int]:
        if not seen:
            is_lost.set()
            raise OSError("the scheduler is gone")
        return seen.pop(0)

    def tell(what: str) -> None:
        told.append(what)
        when.append(len(seen))

    cluster.client.nthreads = nthreads
    with executor_of(None, "tcp://x", tell):
        assert is_lost.wait(10.0)
    assert when == [31, 0]
    assert told[0].startswith("--dask tcp://x: the cluster has no worker any more: it goes on when one comes")
    assert told[0].endswith("Ctrl-C ends it, and the same command continues with what was kept")


NONE = ModuleNotFoundError("No module named 'scuhand_bt'")


def of_none(call: bytes) -> Any:
    raise NONE


def of_another(call: bytes) -> Any:
    """As a worker of another source makes of what it is sent."""
    with pytest.MonkeyPatch.context() as there:
        there.setattr("scuhand_bt.study.cluster.source_digest", lambda: "another")
        return pickle.loads(call)


def run_on(workers: dict[str, Callable[[bytes], Any]]) -> Callable[..., dict[str, Any]]:
    """As `Client.run` with `on_error="return"`."""

    def run(_: Any, call: bytes, **__: Any) -> dict[str, Any]:
        said = {}
        for address, makes_of in workers.items():
            try:
                said[address] = makes_of(call)
            except ImportError as error:
                said[address] = error
        return said

    return run


@pytest.mark.parametrize(
    ("makes_of", "why"), [(of_none, NONE), (of_another, f"it has {scuhand_bt.__version__} from another source")]
)
def test_a_worker_of_another_version_or_without_the_program_is_named(
    cluster: SimpleNamespace, makes_of: Callable[[bytes], Any], why: object
) -> None:
    cluster.client.run.side_effect = run_on({"tcp://a": pickle.loads, "tcp://b": makes_of})
    with pytest.raises(SourceError) as wrong, executor_of(None, "tcp://x"):
        pass
    (problem,) = wrong.value.problems
    assert problem.message.startswith(
        f"the worker tcp://b does not have this scuhand-bt {scuhand_bt.__version__} ({why}): install it there"
    )


@pytest.mark.parametrize("has_left", [False, True])
@pytest.mark.parametrize("makes_of", [of_none, of_another])
def test_a_trial_of_a_worker_that_came_later_and_has_another_program_does_not_count(
    cluster: SimpleNamespace, setup: Setup, makes_of: Callable[[bytes], Any], *, has_left: bool
) -> None:
    workers = {"tcp://a": pickle.loads}
    cluster.client.run.side_effect = run_on(workers)
    threads = ThreadPoolExecutor(1)
    cluster.client.get_executor().__enter__().submit = lambda _, call: threads.submit(makes_of, call)

    def study() -> None:
        with threads, executor_of(None, "tcp://x") as executor:
            workers.update({} if has_left else {"tcp://late": makes_of})
            list(all_trials([(setup, 0)], executor))

    with pytest.raises(SourceError) as wrong:
        study()
    (problem,) = wrong.value.problems
    said = "a worker lacks something that a trial needs" if has_left else "the worker tcp://late does not have this"
    assert problem.message.startswith(said)
    assert problem.message.endswith("the same command continues with what was kept")
