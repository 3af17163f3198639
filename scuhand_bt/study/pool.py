"""What runs trials: processes of this computer, or the workers of a Dask cluster."""

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
    """Its processes begin, with their imports, before a Ctrl-C reaches them: else each answers by a traceback."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # a process inherits it, until `_begin`
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held)


@contextmanager
def executor_of(
    workers: int | None, dask: str | None, tell: Callable[[str], None] = lambda what: None
) -> Iterator[Executor]:
    """So many new processes, as many as there are cores if None; or the Dask scheduler at an address.

    `tell` is told, in another thread, what holds up a cluster that was not lost.

    SourceError as `workers_of` it, and where one of the processes was killed.
    """
    if dask is None:
        many, spawn = workers or os.cpu_count() or 1, multiprocessing.get_context("spawn")
        try:
            with _Processes(many, spawn, _begin) as pool, _ends_at_once(pool, cancel_futures=True):
                yield pool
        except BrokenExecutor:
            which, fewer = (f"one of {many} processes", "take fewer, and ") if many > 1 else ("the process", "")
            problem = f"{which} was killed, as for want of memory: {fewer}try again"
            raise SourceError([Problem(Mark("--workers", 0), problem)]) from None
        return
    with workers_of(dask, tell) as cluster, _ends_at_once(cluster):
        yield cluster


@contextmanager
def _ends_at_once(pool: Executor, **cancelling: bool) -> Iterator[None]:
    """What breaks off waits for nothing that was not begun.

    The pool drops that itself: where its tasks were cancelled one by one its own thread would break on them if a
    process ended meanwhile, as each does at a Ctrl-C.
    """
    try:
        yield
    except BaseException:
        pool.shutdown(wait=False, **cancelling)
        raise


def _begin() -> None:
    """In a process of the pool: it ends with its parent, and at a Ctrl-C, which a trial would take for its own.

    Not where its parent goes on at one, as in the background of a shell's script.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _end_with_parent()


def _end_with_parent() -> None:
    """It would wait for ever for work from a program that was killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def end() -> None:
        parent.join()
        os._exit(1)

    Thread(target=end, daemon=True).start()


def all_trials(tasks: Iterable[Task], executor: Executor, store: Store | None = None) -> Iterator[tuple[Task, Trial]]:
    """Every task's trial: first those that were kept, then the others as they end, each of which is kept at once."""
    wanted = dict.fromkeys(tasks)
    if store is not None:
        for task, kept in store.found(tuple(wanted)):
            del wanted[task]
            yield task, kept
    for (setup, seed), one in trials(wanted, executor):
        if store is not None:
            store.keep(setup, one)
        yield (setup, seed), one
