"""Processes of this machine for work that lasts, since only one thread of a process runs Python at a time.

Half of the time of a sweep, and three quarters of the time of a curve of harmonic balance, is spent outside compiled
programs. A process takes one to three seconds to start, so short work is left to threads.
"""

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from ctypes import c_bool, c_int64
from multiprocessing import connection
from multiprocessing.sharedctypes import RawArray, RawValue
from typing import Any, Self, TypeVar

from timesim.study.execution.worker import count_by, default_workers, halt_by, one_thread

LASTS = 5.0
"""Seconds of work after which the rest is given to processes."""
MEMORY = 2**30
"""Bytes allowed for a process; a usual scene takes half of them. A quarter of this machine's memory stays free."""
APART = 0.5  # seconds between two looks at their counts
HEARD = 3.0
"""Seconds in which the process that has started those that are told to end halts them, if it is told so too."""
HALTED = 5.0  # seconds that their work may then take to give what there is

T = TypeVar("T")
Seen = Callable[[int], None]
"""Called now and then with the number of points that some work has counted."""


def unseen(points: int, /) -> None:
    """A `Seen` that ignores the count."""


class Processes:
    """Processes that are started when there is work for them, and used again until the context is left.

    `workers` is how many works may be under way at a time.
    """

    def __init__(self, workers: int | None = None):
        """By default as many as the processors and the memory of this machine allow."""
        self.workers = min(default_workers(), _room()) if workers is None else workers
        self._seen: dict[int, Seen] = {}
        self._over = threading.Event()
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._pool is not None:
            self._halt.value = True
            self._pool.shutdown(wait=True, cancel_futures=True)

    def submit(self, seen: Seen, function: Callable[..., Any], *args: Any) -> Future[Any]:
        """Call a function of a module in a process, and count its points.

        Raises:
            BrokenExecutor: a process was killed, or none can be started.
        """
        pool = self._pool or self._started()
        slot = min(set(range(len(self._counts))) - set(self._seen))
        self._counts[slot], self._seen[slot] = 0, seen
        try:
            with _interrupt_blocked():
                future = pool.submit(_counted, slot, function, *args)
        except BaseException:
            del self._seen[slot]
            raise
        future.add_done_callback(lambda _: self._seen.pop(slot))
        return future

    @property
    def begun(self) -> bool:
        return self._pool is not None

    def each(self, works: Iterable[tuple[Seen, Callable[..., T], tuple[Any, ...]]]) -> Iterator[tuple[int, T]]:
        """Do works, each a function of a module with arguments, and yield the place and result of each that is done.

        Raises:
            BrokenExecutor: a process was killed.
            KeyboardInterrupt: after the processes have stopped, and all that they had done was yielded.
        """
        waiting, running, interrupt = deque(enumerate(works)), dict[Future[T], int](), None
        try:
            while waiting or running:
                try:
                    while waiting and len(running) < self.workers:
                        place, (seen, function, arguments) = waiting.popleft()
                        running[self.submit(seen, function, *arguments)] = place
                    done = wait(running, return_when=FIRST_COMPLETED).done
                except KeyboardInterrupt as error:
                    if interrupt is not None:
                        raise
                    interrupt = error
                    waiting.clear()
                    self._halt.value = True
                    continue
                for future in done:
                    yield running.pop(future), future.result()
        except BrokenExecutor:
            if interrupt is None:
                raise  # otherwise the process was stopped too, before it could give what it had
        finally:
            self.give_up(running)
        if interrupt is not None:
            raise interrupt

    def give_up(self, works: Iterable[Future[Any]]) -> None:
        """Halt the works under way, and wait until they have ended, or until another interrupt."""
        if self._pool is None:
            return
        self._halt.value = True
        try:
            wait(works)
        finally:
            self._halt.value = False

    def _started(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        # No Event: its lock is held for ever by a process that is killed while it asks.
        self._halt = RawValue(c_bool)
        # The slot of a work that is done is freed only after those who wait for it are notified, so twice as many.
        self._counts = RawArray(c_int64, 2 * self.workers)
        try:
            self._pool = ProcessPoolExecutor(self.workers, context, _begin, (self._halt, self._counts))
        except OSError as error:  # a container without shared memory
            raise BrokenExecutor(str(error)) from error
        threading.Thread(target=self._look, name="timesim-processes", daemon=True).start()
        return self._pool

    def _look(self) -> None:
        while not self._over.wait(APART):
            for slot, seen in list(self._seen.items()):
                seen(self._counts[slot])


def _room() -> int:
    """Processes that the memory of this machine has room for."""
    try:
        whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not known on every system
        return 1
    return max(1, int(0.75 * whole / MEMORY))


@contextmanager
def _interrupt_blocked() -> Iterator[None]:
    """Ctrl-C in a terminal reaches every process; processes that start meanwhile inherit that it is blocked."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# In a process

_COUNTS: Any = None


def _begin(halt: Any, counts: Any) -> None:
    """Set up a process: the one that has started it stops it, and it ends when that one does."""
    global _COUNTS
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    halt_by(lambda: bool(halt.value))
    _COUNTS = counts
    parent = multiprocessing.parent_process()
    assert parent is not None

    def ended() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    def told_to_end() -> None:
        until = time.monotonic() + HEARD
        while not halt.value and time.monotonic() < until:
            time.sleep(0.1)
        if halt.value:
            time.sleep(HALTED)
        os._exit(1)

    # At its time limit a cluster sends SIGTERM to every process: what there is of the work is given up, not lost.
    signal.signal(signal.SIGTERM, lambda *_: threading.Thread(target=told_to_end, daemon=True).start())
    threading.Thread(target=ended, daemon=True).start()


def _counted(slot: int, function: Callable[..., Any], *args: Any) -> Any:
    def count() -> None:
        _COUNTS[slot] += 1

    count_by(count)
    with one_thread():
        return function(*args)
