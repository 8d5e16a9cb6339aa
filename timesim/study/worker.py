"""Work in chunks, and the threads of this machine as those who do it."""

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from timesim.result.checkpoint import Result

Work = Callable[[Any, Result | None], Result]
"""``work(payload, before)``: result of a chunk, `before` that of the chunk it starts from; a function of a module."""


@dataclass(frozen=True)
class Chunk:
    """A piece of work that is done in one go.

    Attributes:
        name: unique, and good as the name of a file.
        payload: what is to be worked on; picklable. Together with the result of `after` it determines the result.
        after: name of the chunk whose result it starts from; that one comes before it in a list of chunks.
        size: points in it, for the progress bar.
    """

    name: str
    payload: Any
    after: str | None = None
    size: int = 1


class ExecutionError(ValueError):
    """A study cannot be carried out in the way asked for; the message names it, the reason and what to do."""


def perform(work: Work, chunk: Chunk, before: Result | None) -> Result:
    """Do the work of a chunk; the result is the same whether it is handed on, sent or read from a file."""
    return {str(name): np.asarray(array) for name, array in work(chunk.payload, before).items()}


_HALT: ContextVar[threading.Event | None] = ContextVar("halt", default=None)


def halted() -> bool:
    """Whether the chunk that this thread works on is to be given up; long work asks, and raises KeyboardInterrupt."""
    event = _HALT.get()
    return event is not None and event.is_set()


def default_workers() -> int:
    """Processors that this process may use, by its affinity and by the quota of its control groups."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([count, *map(int, _quotas())]))


def _quotas(processes: Path = Path("/proc/self/cgroup"), groups: Path = Path("/sys/fs/cgroup")) -> Iterator[float]:
    """Processors that each control group (version 2) allows, from that of this process up to the root."""
    with suppress(OSError, ValueError):
        own = groups / processes.read_text().rpartition("0::/")[2].split("\n")[0]
        for group in (own, *own.parents):
            with suppress(OSError, ValueError):
                quota, period = map(float, (group / "cpu.max").read_text().split())
                yield quota / period


@contextmanager
def threads(workers: int | None = None) -> Iterator[Executor]:
    """Threads of this process. Left early, it waits for the chunks under way: a thread cannot be stopped."""
    halt = threading.Event()
    count = default_workers() if workers is None else workers
    executor = ThreadPoolExecutor(count, "timesim", initializer=_HALT.set, initargs=(halt,))
    try:
        yield executor
    finally:
        halt.set()
        executor.shutdown(wait=True, cancel_futures=True)
