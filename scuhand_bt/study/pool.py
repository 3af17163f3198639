"""What runs trials: processes on this computer, or the workers of a Dask cluster."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from threading import Thread
from typing import ParamSpec, TypeVar

from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.study.cluster import workers_of
from scuhand_bt.study.store import Store
from scuhand_bt.study.trial import Task, Trial, trials

P = ParamSpec("P")
T = TypeVar("T")


class _Processes(ProcessPoolExecutor):
    """A pool whose processes ignore Ctrl-C while they start and import; else each would print a traceback."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited by the process, until `_begin`
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held)


@contextmanager
def executor_of(
    workers: int | None, dask: str | None, tell: Callable[[str], None] = lambda what: None
) -> Iterator[Executor]:
    """`workers` new processes (None: as many as there are cores), or the Dask scheduler at the address `dask`.

    `tell` is called, in another thread, if a cluster waits for workers. Raises SourceError as `workers_of`, and if a
    process was killed.
    """
    if dask is None:
        many, spawn = workers or os.cpu_count() or 1, multiprocessing.get_context("spawn")
        try:
            with _Processes(many, spawn, _begin) as pool, _ends_at_once(pool, cancel_futures=True):
                yield pool
        except BrokenExecutor:
            which, fewer = (f"one of {many} processes", "use fewer, and ") if many > 1 else ("the process", "")
            problem = f"{which} was killed, perhaps for lack of memory: {fewer}try again"
            raise SourceError([Problem(Mark("--workers", 0), problem)]) from None
        return
    with workers_of(dask, tell) as cluster, _ends_at_once(cluster):
        yield cluster


@contextmanager
def _ends_at_once(pool: Executor, **cancelling: bool) -> Iterator[None]:
    """If interrupted, do not wait for tasks that have not begun.

    The pool itself drops them. If they were cancelled one by one, the pool's thread would break if a process ended
    meanwhile, as all do at a Ctrl-C.
    """
    try:
        yield
    except BaseException:
        pool.shutdown(wait=False, **cancelling)
        raise


def _begin() -> None:
    """Runs first in each process of the pool: it is to end with its parent, and at a Ctrl-C.

    A trial would handle Ctrl-C as its own run's. Not where the parent ignores it, as in the background of a shell
    script.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _end_with_parent()


def _end_with_parent() -> None:
    """End when the parent is killed; else the process would wait forever for work."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def end() -> None:
        parent.join()
        os._exit(1)

    Thread(target=end, daemon=True).start()


def all_trials(tasks: Iterable[Task], executor: Executor, store: Store | None = None) -> Iterator[tuple[Task, Trial]]:
    """Every task's trial: first those already stored, then the others as they end, each stored at once."""
    wanted = dict.fromkeys(tasks)
    if store is not None:
        for task, kept in store.found(tuple(wanted)):
            del wanted[task]
            yield task, kept
    for (setup, seed), one in trials(wanted, executor):
        if store is not None:
            store.keep(setup, one)
        yield (setup, seed), one
