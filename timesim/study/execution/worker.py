"""Work in chunks, and its workers: threads of this process, processes of this machine, or those of a dask cluster."""

import asyncio
import logging
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from threadpoolctl import threadpool_limits

from timesim.fault import meant
from timesim.result.argument import shown
from timesim.result.checkpoint import Result

Work = Callable[[Any, Result | None], Result]
"""``work(payload, before)``: result of a chunk, `before` that of the chunk it starts from; a function of a module."""


@dataclass(frozen=True)
class Chunk:
    """A piece of work that is done in one go.

    Attributes:
        name: unique, and good as the name of a file.
        payload: what is to be worked on; picklable. With the result of `after` it determines the result.
        after: name of the chunk whose result it starts from, which comes before it in a list of chunks.
        size: its number of points, for the progress bar.
    """

    name: str
    payload: Any
    after: str | None = None
    size: int = 1


class UnfinishedError(KeyboardInterrupt):
    """The work on a chunk was given up; `result`: what there is of its result, with so many of its points, `size`."""

    def __init__(self, result: Result, size: int):
        super().__init__(result, size)
        self.result, self.size = result, size


class ExecutionError(ValueError):
    """A study cannot be carried out in the way asked for; the message names it, the reason and what to do."""


def perform(work: Work, chunk: Chunk, before: Result | None, count: Callable[[], object] | None = None) -> Result:
    """Do the work of a chunk; its result is the same whether passed on in memory, sent or read from a file.

    ``count``: called after each of its points; by default what `count_by` has set.
    """
    if count is not None:
        count_by(count)
    return {str(name): np.asarray(array) for name, array in work(chunk.payload, before).items()}


@contextmanager
def one_thread() -> Iterator[None]:
    """Within it numpy and scipy compute a product of matrices on one thread.

    The matrices are small and all processors are used already. On a machine that others use too, the threads of
    OpenBLAS wait for each other and make a curve of harmonic balance eight times slower (measured on two processors
    at load 5: 45 s against 5.7 s). It holds for libraries that are loaded before.
    """
    with threadpool_limits(1, "blas"):
        yield


_HALT: ContextVar[Callable[[], bool]] = ContextVar("halt", default=lambda: False)
_COUNT: ContextVar[Callable[[], object]] = ContextVar("count", default=lambda: None)
_EACH: ContextVar[Callable[..., Iterator[Any]]] = ContextVar("each", default=map)
halt_by = _HALT.set
count_by = _COUNT.set


def halted() -> bool:
    """Whether the chunk that this thread works on is to be given up; long work asks, and raises KeyboardInterrupt."""
    return _HALT.get()()


def point_done() -> None:
    """Count a point of the chunk that this thread works on."""
    _COUNT.get()()


def each(function: Callable[[Any], Any], parts: Sequence[Any]) -> Iterator[Any]:
    """Apply a function to each part of the work of this thread, in order; threads of this process may share them."""
    return _EACH.get()(function, parts)


def default_workers() -> int:
    """Processors that this process may use, by its affinity and by the quota of its control groups."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([count, *map(int, _quotas())]))


def _quotas(processes: Path = Path("/proc/self/cgroup"), groups: Path = Path("/sys/fs/cgroup")) -> Iterator[float]:
    """Processors that each control group allows, of version 1 or 2, from that of this process up to the root."""
    with suppress(OSError, ValueError):
        for line in processes.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            own = groups / controllers / path.lstrip("/")
            for group in (own, *own.parents) if {"", "cpu"} & set(controllers.split(",")) else ():
                yield from _quota(group)


def _quota(group: Path) -> Iterator[float]:
    """Processors that a control group allows; nothing where it sets no limit."""
    for names in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        with suppress(OSError, ValueError):
            quota, period = map(float, " ".join((group / name).read_text() for name in names).split())
            if quota > 0:
                yield quota / period


SWITCH = 5e-4
"""Seconds after which a thread gives Python to another; a thread that comes out of a compiled program waits for it. The
usual 5 ms are as long as many such programs last."""


class _Threads(ThreadPoolExecutor):
    """Threads that each do a work, and as many that share its parts where there are fewer works than threads.

    A part has no parts that are shared: they would wait for the threads that wait for them.
    """

    def __init__(self, count: int, halted: Callable[[], bool]):
        super().__init__(count, "timesim", initializer=self._begin, initargs=(halted,))
        self._count, self._works = count, 0
        self._beside = ThreadPoolExecutor(count, "timesim-part")
        self._counting = threading.Lock()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self._counted(1)
        future = super().submit(fn, *args, **kwargs)
        future.add_done_callback(lambda _: self._counted(-1))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        super().shutdown(wait, cancel_futures=cancel_futures)
        self._beside.shutdown(wait)

    def _counted(self, more: int) -> None:
        with self._counting:
            self._works += more

    def _begin(self, halted: Callable[[], bool]) -> None:
        halt_by(halted)
        _EACH.set(self._each)

    def _each(self, function: Callable[[Any], Any], parts: Sequence[Any]) -> Iterator[Any]:
        if len(parts) < 2 or self._works >= self._count:
            return map(function, parts)
        halted, count = _HALT.get(), _COUNT.get()

        def do(part: Any) -> Any:
            halt_by(halted)
            count_by(count)
            return function(part)

        return self._beside.map(do, parts)


@contextmanager
def threads(workers: int | None = None) -> Iterator[Executor]:
    """Threads of this process. If left early, it waits for the chunks under way, since a thread cannot be stopped."""
    halt, interval = threading.Event(), sys.getswitchinterval()
    sys.setswitchinterval(min(interval, SWITCH))
    executor = _Threads(default_workers() if workers is None else workers, halt.is_set)
    try:
        yield executor
    finally:
        halt.set()
        executor.shutdown(wait=True, cancel_futures=True)
        sys.setswitchinterval(interval)


# Processes

LOCAL = "local"
"""Stands for processes of this machine instead of the address of a scheduler."""

RETRIES = 2
"""Times that a failed chunk is tried again; the death of its worker does not count."""

PATIENCE = 15.0  # seconds for a scheduler that does not answer

ANSWER = 10.0
"""Seconds in which the workers of a cluster that are told to give up their works may say what there is."""

_ADDRESS = re.compile(r"[a-z]+://\S+|[^\s:/]+:[0-9]+|\[[0-9a-fA-F:.]+\]:[0-9]+")

# Ctrl-C in a terminal reaches every process, and so does SIGTERM at the time limit of a batch job, but the workers of
# this machine are ended by the one that started them.
_IGNORE_INTERRUPT = "import signal as s; s.signal(s.SIGINT, s.SIG_IGN); s.signal(s.SIGTERM, s.SIG_IGN)"


def check_address(cluster: str, workers: int | None) -> None:
    """Refuse what is neither `LOCAL` nor the address of a scheduler, and a number of workers for the latter.

    Raises:
        ExecutionError: with a suggestion.
    """
    if not isinstance(cluster, str):
        raise ExecutionError(f"cluster must be the address of a scheduler or '{LOCAL}', not {shown(cluster)}")
    if cluster != LOCAL and not _ADDRESS.fullmatch(cluster):
        hint = meant(cluster.lower(), [LOCAL]) or f"give one as tcp://host:8786, or '{LOCAL}'"
        raise ExecutionError(f"cluster {cluster}: is no address of a scheduler; {hint}")
    if cluster != LOCAL and workers is not None:
        raise ExecutionError(f"workers: the cluster {cluster} has its own; leave it out, or give cluster '{LOCAL}'")


@contextmanager
def processes(cluster: str, workers: int | None) -> Iterator[Executor]:
    """The workers of a cluster at an address such as ``tcp://host:8786``, or processes of this machine for `LOCAL`.

    If left early, it gives up the chunks under way, but waits a little for what there is of them. A KeyboardInterrupt
    would end a worker, so a work that raises one returns it instead.

    Raises:
        ExecutionError: dask is not installed, the scheduler does not answer, or its workers cannot do this work.
    """
    try:
        import distributed
    except ImportError:
        hint = "pip install 'timesim[cluster]'"
        raise ExecutionError(f"cluster {cluster}: needs the package distributed; install it with {hint}") from None
    with ExitStack() as stack:
        for name in ("distributed", "distributed.client"):  # a campaign reports in words what they log as tracebacks
            logger = logging.getLogger(name)
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        target: Any = cluster
        if cluster == LOCAL:
            local = distributed.LocalCluster(
                n_workers=default_workers() if workers is None else workers,
                threads_per_worker=1,
                dashboard_address=":0",
                silence_logs=logging.CRITICAL,
                preload=[_IGNORE_INTERRUPT],
            )
            target = stack.enter_context(local)
        try:
            if target is cluster:
                with ThreadPoolExecutor(1) as aside:  # a notebook has an event loop in this thread
                    aside.submit(asyncio.run, _answer(cluster)).result()
            client = stack.enter_context(distributed.Client(target, timeout=PATIENCE, set_as_default=False))
        except Exception as error:  # what is no scheduler may answer anything
            hint = "give the address of a running scheduler, as tcp://host:8786, or 'local'"
            raise ExecutionError(
                f"cluster {target} cannot be reached: {str(error) or 'it does not answer'}; {hint}"
            ) from error
        _check_workers(client, str(target))
        yield stack.enter_context(_Cluster(client))


async def _answer(cluster: str) -> None:
    """Have a scheduler answer. For one that does not, such as its own dashboard, a client would wait without end."""
    import distributed

    secured = distributed.Security().get_connection_args("client")
    async with distributed.rpc(cluster, timeout=PATIENCE, connection_args=secured) as scheduler:
        found = await asyncio.wait_for(scheduler.identity(), PATIENCE)
    if found["type"] != "Scheduler":
        raise ValueError(f"it is a {found['type'].lower()}")


def _check_workers(client: Any, name: str) -> None:
    """Refuse workers with another version of this package."""
    versions = client.run(version, "timesim", on_error="return")
    if not versions:
        raise ExecutionError(f"cluster {name} has no workers; start some with: dask worker ADDRESS")
    own = version("timesim")
    for worker, theirs in versions.items():
        if theirs != own:
            installed = f"has timesim {theirs}" if isinstance(theirs, str) else "has no timesim"
            hint = "install the same on all workers"
            raise ExecutionError(f"cluster {name}: worker {worker} {installed}, this is {own}; {hint}")


class _Cluster(Executor):
    """The workers of a dask client."""

    def __init__(self, client: Any):
        self._client, self._name, self._works = client, uuid4().hex, set[Future[Any]]()
        self._workers = client.get_executor(retries=RETRIES, pure=False)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        work: Future[Any] = self._workers.submit(_until_given_up, self._name, fn, *args, **kwargs)
        self._works.add(work)
        work.add_done_callback(self._works.discard)
        return work

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Give up the works under way; it waits for their answers, but not for long, or until another interrupt."""
        try:
            if works := set(self._works):
                with suppress(Exception):  # one does not answer, and the others have done so meanwhile
                    self._client.run(_give_up, self._name, on_error="ignore", callback_timeout=ANSWER)
                    futures.wait(works, ANSWER)
        finally:
            self._workers.shutdown(wait=False)


# In a worker of a cluster

_GIVEN_UP: set[str] = set()


def _give_up(name: str) -> None:
    """Halt the works of an executor; dask calls it beside them."""
    _GIVEN_UP.add(name)


def _until_given_up(name: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Do a work of an executor, or what can be done of it."""
    halt_by(lambda: name in _GIVEN_UP)
    try:
        return KeyboardInterrupt() if halted() else function(*args, **kwargs)
    except KeyboardInterrupt as error:
        return error
