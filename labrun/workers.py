"""Where many independent things are computed: processes of this machine, or a Dask cluster."""

import multiprocessing
import os
import signal
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from labrun.errors import LabrunError, RequestError

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_REACHING = "30s"
_STOPPING_S = 5.0

Key = TypeVar("Key")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Pool:
    """An executor, and how many jobs it is given at a time: enough that no worker waits, few enough for memory."""

    executor: Executor
    ahead: int


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def pool(workers: int, cluster: str | None) -> Iterator[Pool]:
    """Open processes of this machine, or a cluster where one is named.

    Raises RequestError: dask is not installed, or no scheduler answers.
    """
    if cluster is None:
        with _processes(workers) as executor:
            yield executor
    else:
        with _dask(cluster) as executor:
            yield executor


def spread(
    pool: Pool, jobs: Iterator[tuple[Key, Callable[..., Result], tuple[Any, ...]]]
) -> Iterator[tuple[Key, Result]]:
    """Run jobs, and give each result with its key as it comes. Raises LabrunError: a worker died."""
    pending: dict[Future[Result], Key] = {}
    try:
        while True:
            for key, job, arguments in jobs:
                with _signals_blocked():
                    pending[pool.executor.submit(job, *arguments)] = key
                if len(pending) >= pool.ahead:
                    break
            if not pending:
                return
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                yield pending.pop(future), future.result()
    except BrokenExecutor as error:
        raise LabrunError(
            "a worker process ended without a message; the machine may have run out of memory",
            hint="what is finished is kept, and is not computed again; fewer --workers take less memory",
        ) from error
    finally:
        for future in pending:
            future.cancel()


@contextmanager
def _processes(workers: int) -> Iterator[Pool]:
    others = {child.pid for child in multiprocessing.active_children()}
    # a process that is stopped leaves its files behind: they lie in a folder of this one, which takes it away
    with _one_thread(), TemporaryDirectory(prefix="labrun-", ignore_cleanup_errors=True) as scratch:
        # started anew: threads and locks of this process are not copied, and linear algebra starts with one thread
        context = multiprocessing.get_context("spawn")
        executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(scratch,))
        try:
            yield Pool(executor, 2 * workers)
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            stopped = [child for child in multiprocessing.active_children() if child.pid not in others]
            for child in stopped:
                child.terminate()
            for child in stopped:
                child.join(_STOPPING_S)
            raise
        executor.shutdown()


@contextmanager
def _dask(address: str) -> Iterator[Pool]:
    try:
        from distributed import Client, KilledWorker
        from distributed.comm import CommClosedError
    except ImportError as error:
        raise RequestError(
            "a cluster needs Dask, which is not installed", hint='pip install "labrun[cluster]"'
        ) from error
    try:
        client = Client(address, timeout=_REACHING, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RequestError(
            f"no Dask scheduler answers at {address}: {error}",
            hint="start one with: dask scheduler; and workers, in the same environment, with: dask worker ADDRESS",
        ) from error
    with client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise RequestError(
                f"the Dask scheduler at {address} has no workers",
                hint=f"start some with: dask worker {address}",
            )
        # the same twice is computed twice: no result of an earlier run is taken for it
        executor = client.get_executor(pure=False, retries=0)
        try:
            yield Pool(executor, 2 * threads)
        except (KilledWorker, CommClosedError, CancelledError) as error:
            # a scheduler that goes away cancels everything, without a word
            raise LabrunError(
                f"the cluster at {address} gave up: {str(error).strip() or 'its scheduler is gone'}",
                hint="what is finished is kept, and is not computed again; workers that die may have run out of memory",
            ) from error
        finally:
            executor.shutdown(wait=False)


def _begin(scratch: str) -> None:
    """Leave signals and warnings to the process that asked, and end with it; files go into `scratch`.

    SIGTERM still ends it: that is how a worker that hangs is stopped.
    """
    tempfile.tempdir = scratch
    for number in _NOT_FOR_WORKERS:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    warnings.simplefilter("ignore")
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End once the process that asked is gone.

    If it was killed nobody says so: workers hold both ends of the queue of jobs, and would wait at it for ever.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that start meanwhile compute with one thread: sums come out the same on any number of cores."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_NOT_FOR_WORKERS = (signal.SIGINT, signal.SIGHUP)
"""What a terminal sends to every process in it; the one that asked ends its workers itself."""


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Start a process while Ctrl-C and a closed terminal are blocked, which it inherits; here they come afterwards."""
    resource_tracker.ensure_running()  # it unblocks signals when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _NOT_FOR_WORKERS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
