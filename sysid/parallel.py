"""Where many independent candidates are computed: the cores of this process, or a Dask cluster.

`Executor.share` sends the work with all its data once, and what it returns computes rows. Each row's numbers
depend on that row alone, so neither the cluster's size nor the cut into chunks nor a lost worker changes a
bit of a result.
"""

import logging
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack
from math import ceil
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sysid.errors import SysidError
from sysid.journal import tell
from sysid.types import FloatArray

Columns = tuple[NDArray[Any], ...]
# A pure function of rows (P, n) that returns arrays with one entry per row: equal rows give equal numbers
# whatever their neighbours.
Work = Callable[[FloatArray], Columns]

# Least computing time of a chunk [s]: a scheduler spends a millisecond on it, a generation lasts longer.
CHUNK_TIME = 0.06
# Longest computing time of a chunk where few workers have much to do [s]: longer ones save nothing, and a
# lost worker loses more.
LONGEST_CHUNK_TIME = 0.25
# Least number of rows in a chunk: a kernel computes this many side by side on one core.
_LEAST_CHUNK = 8
# Largest number of rows in a caller's first chunks, before the computing time of a row is known.
_FIRST_CHUNK = 16
# Number of chunks per worker: with one chunk each, workers that end early would idle.
_CHUNKS_PER_WORKER = 2
# Largest number of callers that compute in this process at the same time: a single caller would leave cores
# idle at the end of its jobs, and every caller takes memory.
_CALLERS = 2
# Identifiers of the threads that compute now; each has an equal share of the cores.
_computing: set[int] = set()
# Number of shares per thread: shares cost nothing to hand out.
_SHARES = 4
# How often a chunk is submitted before the cluster is given up.
ATTEMPTS = 6
# How long to wait without any worker [s]; they may be on their way from a queue. First it is said.
PATIENCE, SAID_AFTER = 30.0, 10.0
# Loggers whose lines on a lost connection say less than the refusal that follows.
_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado.application", "asyncio")
_LOOK = 2.0


class ClusterError(SysidError):
    """The cluster cannot be reached, or lost the work."""


class ClosedError(RuntimeError):
    """A run that was called off asked for work after the executor had been closed."""


class Executor(ABC):
    """Where work is done; it is closed at the end of a ``with`` block."""

    # Callers at the same time that keep every core busy [1].
    at_once: int

    @abstractmethod
    def share(self, work: Work) -> Work:
        """Send the work with its data, once; the result computes rows and may be called from threads."""

    @abstractmethod
    def close(self) -> None:
        """Release cores or connections."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def threads_for(jobs: int, threads: int | None) -> int:
    """Return how many threads compute jobs [1], by default one per core; callers share the cores."""
    cores = threads or os.cpu_count() or 1
    return max(1, min(cores // max(1, len(_computing)), jobs))


def in_threads(kernel: Callable[..., Any], jobs: int, threads: int | None, *arguments: Any) -> None:
    """Call a compiled ``kernel(first, last, *arguments)`` for all its jobs, in threads of this process.

    Its jobs know nothing of each other, and it was compiled to release the interpreter. How many threads:
    `threads_for`. Numba's own parallel loops would take two to three times as long to compile.
    """
    workers = threads_for(jobs, threads)
    # Whatever has to be compiled is compiled in this thread: Ctrl-C ends it here.
    kernel(0, 0 if workers > 1 else jobs, *arguments)
    if workers > 1:
        # Several shares per thread: the first thread that is done takes the next share.
        edges = [jobs * share // (_SHARES * workers) for share in range(_SHARES * workers + 1)]
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(lambda first, last: kernel(first, last, *arguments), edges, edges[1:]))


class LocalThreads(Executor):
    """This process: the work itself spreads rows over the cores that its callers leave to each other."""

    # While one prepares its next rows, the others compute.
    at_once = _CALLERS + 1

    def __init__(self, threads: int | None = None) -> None:
        """Use this many threads, by default one per core."""
        self._count = min(_CALLERS, threads or os.cpu_count() or 1)
        self._places = threading.Semaphore(self._count)
        self._closed = False

    def share(self, work: Work) -> Work:
        """Return the work, which two callers can enter at a time; raises ClosedError after `close`."""

        def in_turn(rows: FloatArray) -> Columns:
            caller = threading.get_ident()
            with self._places:
                if self._closed:
                    raise ClosedError
                try:
                    _computing.add(caller)
                    return work(rows)
                finally:
                    _computing.discard(caller)

        return in_turn

    def close(self) -> None:
        """Refuse later callers and wait for those that compute."""
        self._closed = True
        with ExitStack() as places:
            for _ in range(self._count):
                places.enter_context(self._places)


class DaskCluster(Executor):
    """Workers of a Dask scheduler; each worker process computes one chunk at a time.

    `address` is ``tcp://host:8786``, or ``local`` for one worker process per core of this machine. With
    several callers `at_once` no worker idles while one caller waits for its last chunk. Raises ClusterError
    when the extra is not installed or nothing answers at the address.
    """

    def __init__(self, address: str, at_once: int = 5) -> None:
        try:
            import distributed
        except ImportError:
            raise ClusterError(
                "--dask needs the libraries of the extra 'cluster'; install them with "
                "pip install 'sysid[cluster]'"
            ) from None
        self.at_once = at_once
        self.address = address
        self._cluster: Any = None
        try:
            if address == "local":
                self._cluster = distributed.LocalCluster(
                    n_workers=os.cpu_count() or 1,
                    threads_per_worker=1,
                    dashboard_address=None,
                    preload=[__name__],
                )
            for name in _LOGGERS:
                logging.getLogger(name).setLevel(logging.CRITICAL)
            self._client = distributed.Client(self._cluster or address, timeout=10, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise ClusterError(
                f"no Dask scheduler answers at {address!r} ({error}); start one with 'dask scheduler', "
                "workers with 'dask worker', and give its address as tcp://host:8786"
            ) from error

        try:
            self._await_worker()
        except BaseException:
            self.close()
            raise

    def _await_worker(self) -> None:
        since, said = time.monotonic(), False
        while not self.alive:
            waited = time.monotonic() - since
            start = f"start one with 'dask worker {self.address}'"
            if waited >= PATIENCE:
                raise ClusterError(
                    f"the Dask scheduler at {self.address!r} has had no worker for {PATIENCE:.0f} s; {start}"
                )
            if waited >= SAID_AFTER and not said:
                tell(
                    f"the Dask scheduler at {self.address!r} has no worker; waiting up to "
                    f"{PATIENCE - waited:.0f} s more; {start}"
                )
                said = True
            time.sleep(0.2)

    @property
    def alive(self) -> int:
        """Worker processes at the moment [1]."""
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def share(self, work: Work) -> Work:
        """Send the work to every worker; the result computes rows on them."""
        return _Shared(self, work)

    def close(self) -> None:
        """Disconnect; a local cluster ends."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def lost(self, why: object) -> ClusterError:
        """Return the error that the cluster is gone."""
        first = next(iter(str(why).splitlines()), "no reason given").rstrip(":. ")
        return ClusterError(
            f"the Dask cluster at {self.address!r} lost the work ({first}); bring the scheduler and a worker "
            "back, then continue with --resume"
        )

    @property
    def running(self) -> bool:
        """Whether the scheduler is there."""
        return str(self._client.status) == "running"


def chunk_size(rows: int, callers: int, workers: int, per_row: float | None) -> int:
    """Return how many of a caller's rows make a chunk; `callers` share the workers, this one included.

    `CHUNK_TIME` of work at the computing time `per_row` [s] (None before the first chunk). Where workers are
    few, half of a worker's share up to `LONGEST_CHUNK_TIME`, so that messages do not keep them busy; never
    more than a worker's share.
    """
    share = ceil(rows * callers / workers)
    if per_row is None:
        return max(1, min(share, _FIRST_CHUNK))
    least, longest = (round(wished / max(per_row, 1e-9)) for wished in (CHUNK_TIME, LONGEST_CHUNK_TIME))
    wished = max(_LEAST_CHUNK, least, min(longest, ceil(share / _CHUNKS_PER_WORKER)))
    return max(1, min(share, wished, rows))


class _Shared:
    """Work whose data lie on the workers."""

    def __init__(self, cluster: DaskCluster, work: Work) -> None:
        self._cluster = cluster
        self._work = work
        self._lock = threading.Lock()
        self._callers = 0  # that wait for their rows
        self._data: Any = None  # handle of the data on the workers
        self._per_row = 0.0  # mean computing time [s]
        self._rows = 0

    def __call__(self, rows: FloatArray) -> Columns:
        with self._lock:
            self._callers += 1
        try:
            return self._computed(rows)
        finally:
            with self._lock:
                self._callers -= 1

    def _computed(self, rows: FloatArray) -> Columns:
        client = self._cluster._client
        per_row = self._per_row if self._rows else None
        size = chunk_size(len(rows), self._callers, max(1, self._cluster.alive), per_row)
        pending = {first: rows[first : first + size] for first in range(0, len(rows), size)}
        done: dict[int, Columns] = {}
        why: object = "no answer"
        for attempt in range(ATTEMPTS):
            if attempt:
                time.sleep(0.2 * attempt)
            if not self._cluster.running:
                raise self._cluster.lost(why)
            data = None
            try:
                with self._lock:
                    if self._data is None:
                        self._data = client.scatter(self._work, broadcast=True, hash=False)
                    data = self._data
                futures = {
                    first: client.submit(_compute, data, chunk, pure=False)
                    for first, chunk in pending.items()
                }
            except _lost_errors() as error:
                why = error
                self._forget(data)
                continue
            for first, future in futures.items():
                try:
                    spent, columns = self._result(future)
                except _lost_errors() as error:
                    why = error
                    continue
                done[first] = columns
                count = len(pending.pop(first))
                with self._lock:
                    self._rows += count
                    self._per_row += (spent / count - self._per_row) * count / self._rows
            if not pending:
                parts = [done[first] for first in sorted(done)]
                return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
            self._forget(data)
        raise self._cluster.lost(why)

    def _result(self, future: Any) -> tuple[float, Columns]:
        """Wait for a chunk; give up after a while without any worker."""
        since = time.monotonic()
        while True:
            try:
                result: tuple[float, Columns] = future.result(timeout=_LOOK)
                return result
            except TimeoutError:
                if future.done() or not self._cluster.running:
                    raise
                if self._cluster.alive:
                    since = time.monotonic()
                elif time.monotonic() - since > PATIENCE:
                    raise self._cluster.lost(f"no worker for {PATIENCE:.0f} s") from None

    def _forget(self, data: Any) -> None:
        with self._lock:
            if self._data is data:
                self._data = None


def _lost_errors() -> tuple[type[BaseException], ...]:
    """Return the errors of a lost worker, lost data or a lost scheduler."""
    from distributed import KilledWorker
    from distributed.client import FutureCancelledError
    from distributed.comm import CommClosedError

    return (KilledWorker, FutureCancelledError, CancelledError, CommClosedError, OSError, TimeoutError)


def dask_setup(worker: object) -> None:
    """Prepare a worker of this machine: Ctrl-C is for the process that searches, not for its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


_ONE_CHUNK = threading.Lock()


def _compute(work: Work, rows: FloatArray) -> tuple[float, Columns]:
    """Compute a chunk on a worker; return its computing time [s] and its columns."""
    # Two chunks at once would each be timed as both.
    with _ONE_CHUNK:
        began = time.perf_counter()
        columns = work(rows)
        return time.perf_counter() - began, columns


def executor(dask: str | None, at_once: int = 5, threads: int | None = None) -> Executor:
    """Return local `threads`, or the Dask cluster at an address (``tcp://host:8786``, ``local``)."""
    return LocalThreads(threads) if dask is None else DaskCluster(dask, at_once)
