"""Runs trials on the workers of a Dask cluster. Each worker must have exactly this program.

Workers come and go during a study, so the check is part of each trial. Calls are sent as bytes that only a worker
unpickles. So the scheduler does not need this program, and a worker without it raises an error of its own, where Dask
would drop the connection and wait (distributed 2026.8).
"""

import logging
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from functools import partial
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import scuhand_bt
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.program import source_digest

if TYPE_CHECKING:
    from distributed import Client

P = ParamSpec("P")
T = TypeVar("T")
OURS = f"scuhand-bt {scuhand_bt.__version__}"
GOES_ON = "the same command continues with what was kept"
LOOKS_S, ALONE_LOOKS = 1.0, 10
"""How often it is checked that the cluster has a worker [s], and after how many checks without one that is reported."""


class _Sent:
    """A call that is executed when it is unpickled."""

    def __init__(self, call: bytes) -> None:
        self._call = call

    def __reduce__(self) -> tuple[Callable[[str, bytes], Any], tuple[str, bytes]]:
        return answer, (source_digest(), self._call)


def answer(program: str, call: bytes) -> Any:
    """Execute a call on a worker. Raises ImportError if its program has another source than `program`."""
    if source_digest() != program:
        raise ImportError(f"it has {scuhand_bt.__version__} from another source")
    return pickle.loads(call)()


def _sent(call: Callable[[], Any]) -> bytes:
    return pickle.dumps(_Sent(pickle.dumps(call)))


class _Cluster(Executor):
    """Dask's own executor, with calls sent as bytes."""

    def __init__(self, dask: Executor) -> None:
        self._dask = dask

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        return self._dask.submit(pickle.loads, _sent(partial(fn, *args, **kwargs)))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._dask.shutdown(wait=wait)


@contextmanager
def workers_of(address: str, tell: Callable[[str], None]) -> Iterator[Executor]:
    """The workers of the Dask scheduler at `address`. `tell` is called, in a thread of its own, if all have gone.

    Raises SourceError if Dask is not installed, does not answer, has no worker or goes away. Also for every worker
    that does not have this program: before the first trial, or when one that came later takes a trial.
    """
    mark = Mark(f"--dask {address}", 0)
    try:
        from distributed import Client, KilledWorker

        client = Client(address, timeout="10s")
    except (ImportError, OSError, ValueError) as error:
        problem = (
            f"no Dask scheduler: {error}; `pip install 'scuhand-bt[dask]'`, and start `dask scheduler` and workers"
        )
        raise SourceError([Problem(mark, problem)]) from None
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # it logs tracebacks for a lost cluster
    try:
        with client:
            _require_workers(client, mark)
            try:
                with client.get_executor() as dask, _watched(client, address, tell):
                    yield _Cluster(dask)
            except ImportError as error:
                _require_same(client, mark)
                problem = (
                    f"a worker lacks something that a trial needs ({error}): install {OURS} there again; {GOES_ON}"
                )
                raise SourceError([Problem(mark, problem)]) from None
    except (CancelledError, KilledWorker) as error:
        problem = f"the cluster was lost ({type(error).__name__}); {GOES_ON}"
        raise SourceError([Problem(mark, problem)]) from None


@contextmanager
def _watched(client: "Client", address: str, tell: Callable[[str], None]) -> Iterator[None]:
    """Watch whether there are workers, as Dask waits for the next one forever and in silence."""
    is_over = Event()

    def look() -> None:
        alone = 0
        while not is_over.wait(LOOKS_S):
            try:
                alone = 0 if client.nthreads() else alone + 1
            except (OSError, RuntimeError, CancelledError):  # the cluster was lost, which the trials report
                return
            if alone == ALONE_LOOKS:
                waits = f"the cluster has no worker any more: it goes on when one comes (`dask worker {address}`)"
                tell(f"--dask {address}: {waits}; Ctrl-C ends it, and {GOES_ON}")

    thread = Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join(LOOKS_S)  # before the client is closed


def _require_workers(client: "Client", mark: Mark) -> None:
    try:
        client.wait_for_workers(1, timeout=10)
        _require_same(client, mark)
    except OSError:
        problem = "the scheduler has no worker: start some with `dask worker ADDRESS`"
        raise SourceError([Problem(mark, problem)]) from None


def _require_same(client: "Client", mark: Mark) -> None:
    """Every present worker must have this program; without it no trial works, with another one results differ."""
    said = client.run(pickle.loads, _sent(tuple), on_error="return")
    others = {worker: there for worker, there in said.items() if isinstance(there, BaseException)}
    if others:
        told = [f"the worker {one} does not have this {OURS} ({why}): install it there" for one, why in others.items()]
        raise SourceError([Problem(mark, f"{problem}; {GOES_ON}") for problem in told])
