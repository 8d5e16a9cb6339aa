"""Many chunks of work, some after others, on threads, processes or a cluster, with checkpoints.

It knows no physics. The result of a chunk is determined by its payload and the result of the chunk that it comes after,
so a campaign gives the same whoever does the work, in whatever order, and however often it is interrupted and resumed.
"""

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import count
from numbers import Integral
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from timesim.fault import warn_of_run
from timesim.result import checkpoint
from timesim.result.argument import shown
from timesim.result.change import fingerprint
from timesim.result.checkpoint import INTERRUPTED, Checkpoint, Manifest
from timesim.result.file import StoreError
from timesim.result.label import counted, first_few
from timesim.study.execution.processes import LASTS, Processes
from timesim.study.execution.progress import Progress, unwatched
from timesim.study.execution.worker import (
    Chunk,
    ExecutionError,
    Result,
    UnfinishedError,
    Work,
    check_address,
    perform,
    processes,
    threads,
)

LISTED = 4  # failed chunks that a reason names

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")


@dataclass(frozen=True)
class Execution:
    """How a study is carried out.

    Attributes:
        progress: takes in the points done and their number.
        folder: run folder; checkpoints are kept in it while the study runs.
        resume: take up the checkpoints that are there.
        cluster: address of a dask scheduler, or "local" for processes of this machine; None for threads.
        workers: threads, or processes of a local cluster; the processors of this machine by default.
        processes: take over work that lasts from the threads; none by default.
        notice: called with what a user should know at once, such as that a checkpoint is damaged.
    """

    progress: Progress = unwatched
    folder: Path | None = None
    resume: bool = False
    cluster: str | None = None
    workers: int | None = None
    processes: Processes | None = None
    notice: Callable[[str], None] = warn_of_run

    def __post_init__(self) -> None:
        if self.workers is not None and not (isinstance(self.workers, Integral) and self.workers >= 1):
            whole = "" if isinstance(self.workers, Integral) else "a whole number, "
            raise ExecutionError(f"workers must be {whole}at least 1, not {shown(self.workers)}")
        if self.cluster is not None:
            check_address(self.cluster, self.workers)

    @property
    def several(self) -> Processes | None:
        """The processes that may take over work; None where there would be only one, or where a cluster works."""
        own = self.processes
        return own if own is not None and own.workers > 1 and self.cluster is None else None

    def earlier(self, stage: str | None = None) -> float:
        """Seconds spent on the earlier parts of a resumed run, or of one of its stages."""
        return checkpoint.seconds_worked(self.folder, stage) if self.resume and self.folder is not None else 0.0

    @contextmanager
    def checkpoint(
        self, identity: str, parts: Mapping[str, Any], stage: str
    ) -> Iterator[tuple[Checkpoint | None, bool]]:
        """Where finished parts of the work are kept, None without a run folder, and whether there are some to take up.

        Args:
            identity: what the parts belong to: the resolved scene. A checkpoint of another scene is not taken up.
            parts: by the name of each part, what determines its result besides the scene.
            stage: of the study, valid as the name of a folder; empty for the first or only one.

        Raises:
            StoreError: the folder holds something else, or cannot be written; nothing was run.
        """
        if self.folder is None:
            yield None, False
            return
        manifest = Manifest(identity, {name: fingerprint(part) for name, part in parts.items()})
        kept, begun = checkpoint.begin(self.folder, manifest, resume=self.resume, stage=stage)
        try:
            if self.resume and not begun and not stage:
                self.notice(f"there is nothing to resume in {self.folder}: it starts from the beginning")
            yield kept, begun
        finally:
            kept.close()


def carry_through(
    chunks: Sequence[Chunk], work: Work, execution: Execution, *, identity: str, stage: str = ""
) -> tuple[dict[str, Result], str | None]:
    """Do the work of all chunks.

    On an interrupt it waits for the threads to finish their chunks, and keeps them; for a cluster it waits some
    seconds. Work that takes long asks `halted`, and may say what there is by an `UnfinishedError`: that is in the
    results, but the chunk begins anew when resumed. A chunk that fails is left out, with all that come after it,
    and the others go on. Once a checkpoint cannot be written, no further chunk begins.

    Args:
        chunks: each one listed below the chunk that it comes after.
        work: computes the result of a chunk.
        identity, stage: as of `Execution.checkpoint`, whose errors it raises.

    Returns:
        Results by the chunk's name, in the order of the chunks, and why some are missing; None if none is.

    Raises:
        ValueError: two chunks of one name, a name that no file can have, or a chunk that comes after none above it.
        ExecutionError: the cluster cannot be used; nothing was run.
    """
    _check(chunks)
    with execution.checkpoint(identity, {chunk.name: chunk for chunk in chunks}, stage) as (kept, begun):
        return _Campaign(chunks, work, execution, kept, first=not stage).outcome(begun)


def _check(chunks: Sequence[Chunk]) -> None:
    above: set[str] = set()
    for chunk in chunks:
        if chunk.name in above or not _NAME.fullmatch(chunk.name):
            raise ValueError(f"name of a chunk must be unique and good as the name of a file, not {chunk.name!r}")
        if chunk.after is not None and chunk.after not in above:
            raise ValueError(f"chunk {chunk.name} comes after {chunk.after!r}, which must be a chunk above it")
        above.add(chunk.name)


class _Campaign:
    """The chunks of a campaign: what is done, what has failed, what is being worked on.

    ``first``: whether it is the first stage of its study, which alone says what is taken up, as a search has many.
    """

    def __init__(
        self, chunks: Sequence[Chunk], work: Work, execution: Execution, kept: Checkpoint | None, *, first: bool
    ):
        self.chunks, self.work, self.execution, self.kept, self.first = chunks, work, execution, kept, first
        self.following: dict[str | None, list[Chunk]] = {}
        for chunk in chunks:
            self.following.setdefault(chunk.after, []).append(chunk)
        self.total = sum(chunk.size for chunk in chunks)
        self.points = 0
        self.under_way: dict[str, int] = {}
        self.counting = threading.Lock()
        self.results: dict[str, Result] = {}
        self.unfinished: dict[str, UnfinishedError] = {}
        self.failed: dict[str, str] = {}
        self.saved: set[str] = set()
        self.running: dict[Future[Result], Chunk] = {}
        self.waiting: deque[Chunk] = deque()
        self.begun = time.monotonic()
        self.arrived: SimpleQueue[Future[Result]] = SimpleQueue()

    def outcome(self, begun: bool) -> tuple[dict[str, Result], str | None]:
        """Take up and do all chunks; the results by name, and why some are missing."""
        ended = None
        try:
            if begun:
                self._take_up()
            if len(self.results) < len(self.chunks):
                self._work_off()
        except KeyboardInterrupt:
            ended = INTERRUPTED
            with suppress(KeyboardInterrupt):
                self._collect()
        except (StoreError, ConnectionError) as error:
            ended = str(error)
            self._collect()
        found = {name: part.result for name, part in self.unfinished.items()} | self.results
        done = {chunk.name: found[chunk.name] for chunk in self.chunks if chunk.name in found}
        return done, self._reason(ended)

    def _take_up(self) -> None:
        assert self.kept is not None
        for chunk in self.chunks:
            if (result := self.kept.load(chunk.name, self.execution.notice)) is not None:
                self.saved.add(chunk.name)
                self._count(chunk, result)
        if self.first:
            done = f"{len(self.saved)} of {counted(len(self.chunks), 'chunk')}"
            self.execution.notice(f"{done} taken up from {self.kept.folder}")

    def _work_off(self) -> None:
        ready = {None, *self.results}
        left = (chunk for chunk in self.chunks if chunk.name not in self.results)
        self.waiting += [chunk for chunk in left if chunk.after in ready]
        own, several = self.execution, self.execution.several
        room = np.inf if several is None else several.workers
        try:
            with threads(own.workers) if own.cluster is None else processes(own.cluster, own.workers) as executor:
                while self.waiting or self.running:
                    while self.waiting and len(self.running) < room:
                        self._begin(executor, self.waiting.popleft())
                    chunk = self._arrival(self.arrived.get())
                    if chunk.name in self.results:
                        followers = self.following.get(chunk.name, ())
                        self.waiting += [after for after in followers if after.name not in self.results]
                        self._keep(chunk.name)
        finally:
            if several is not None:
                several.give_up(self.running)

    def _begin(self, executor: Executor, chunk: Chunk) -> None:
        before = None if chunk.after is None else self.results[chunk.after]
        future = self._begun_elsewhere(chunk, before)
        if future is None:
            points = count(1)
            tick = None if self.execution.cluster else lambda: self._count_points(chunk, next(points))
            future = executor.submit(perform, self.work, chunk, before, tick)
        self.running[future] = chunk
        future.add_done_callback(self.arrived.put)

    def _begun_elsewhere(self, chunk: Chunk, before: Result | None) -> Future[Result] | None:
        """Give a chunk to a process; None if it is left to a thread, as the only one or one of the first."""
        alone, processes = not self.running and not self.waiting, self.execution.several
        if processes is None or alone or time.monotonic() - self.begun < LASTS:
            return None
        with suppress(BrokenExecutor):
            return processes.submit(partial(self._count_points, chunk), perform, self.work, chunk, before)
        return None

    def _arrival(self, future: Future[Result]) -> Chunk:
        """Take in a chunk that has ended."""
        chunk = self.running[future]
        if future.cancelled():
            raise ConnectionError(f"the connection to the cluster {self.execution.cluster} is lost")
        error = _error(future)
        if isinstance(error, KeyboardInterrupt):
            raise error
        if error is None:
            self._count(chunk, future.result())
        else:
            self.failed[chunk.name] = f"{type(error).__name__}: {error}"
        del self.running[future]
        return chunk

    def _count(self, chunk: Chunk, result: Result) -> None:
        self.results[chunk.name] = result
        with self.counting:
            self.points += chunk.size
            self.under_way.pop(chunk.name, None)
            self._show()

    def _count_points(self, chunk: Chunk, points: int) -> None:
        """Take in how many points of a chunk are done; the last counts when the chunk is, since it may search on."""
        with self.counting:
            if chunk.name not in self.results:
                self.under_way[chunk.name] = min(points, chunk.size - 1)
                self._show()

    def _show(self) -> None:
        self.execution.progress(self.points + sum(self.under_way.values()), self.total)

    def _keep(self, name: str) -> None:
        if self.kept is not None and name not in self.saved:
            self.kept.save(name, self.results[name])
            self.saved.add(name)

    def _collect(self) -> None:
        """Take in the chunks that were finished while the interrupt was handled, and what there is of the others."""
        for future, chunk in self.running.items():
            if not future.done() or future.cancelled():
                continue
            error = _error(future)
            if error is None:
                self.results[chunk.name] = future.result()
            elif isinstance(error, UnfinishedError):
                self.unfinished[chunk.name] = error
        with suppress(StoreError):
            for name in self.results:
                self._keep(name)

    def _reason(self, ended: str | None) -> str | None:
        """Why results are missing."""
        missing = [chunk for chunk in self.chunks if chunk.name not in self.results]
        if not missing:
            return None
        reasons = [f"{name}: {why}" for name, why in self.failed.items()]
        listed = "; ".join(first_few(reasons, LISTED, lambda left: f"and {left} more"))
        failed = f"{len(reasons)} of {counted(len(self.chunks), 'chunk')} failed: {listed}" if reasons else None
        number = sum(chunk.size for chunk in missing) - sum(part.size for part in self.unfinished.values())
        left = f"{len(missing)} of {counted(len(self.chunks), 'chunk')} unfinished, with all points done"
        if number:
            left = f"{number} of {counted(self.total, 'point')} missing"
        return "; ".join(filter(None, (ended, failed, left)))


def _error(future: Future[Any]) -> BaseException | None:
    """Why a chunk has no result; a work on a cluster that is given up returns its KeyboardInterrupt."""
    error = future.exception()
    return future.result() if error is None and isinstance(future.result(), KeyboardInterrupt) else error
