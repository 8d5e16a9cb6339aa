"""What other processes do for a curve that takes long: a part of it, and the evaluation of its solutions."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import suppress
from typing import Any, cast

import numpy as np

from timesim.hbm.continuation import WORK, Controls, Curve, part_of
from timesim.hbm.convergence import TooFewSamplesError, checking_samples
from timesim.hbm.curve import HbmCurve, Piece, Pieces, Signed, Watch, Work, each_here, left_part, part_of_curve
from timesim.hbm.scheme import Scheme
from timesim.model.model import Model
from timesim.study.execution.processes import Processes, unseen
from timesim.study.execution.worker import halted, point_done

PARTS = 100  # into which a process divides its work to count its progress
LOOKED = 16  # solutions of a curve after which a process that has nothing else to do is given more of them


class Aside:
    """Processes that take a part of the work on a curve: a `timesim.hbm.curve.following.Aside`."""

    def __init__(self, processes: Processes, schemes: Sequence[Scheme], controls: Controls, *, checks_samples: bool):
        """For curves by some schemes, in some steps, whose samples may prove too few."""
        self.processes, self.schemes, self.controls = processes, tuple(schemes), controls
        self.checks_samples = checks_samples
        self._parts: list[tuple[Part, Model, float]] = []
        self._evaluation = Evaluation(processes)
        self._look: Callable[[], None] = lambda: None
        self._number = 0

    def part(self, model: Model, start: float, first: float, last: float) -> "Part":
        """Begin `part_of_curve`."""
        asked = (model, start, first, last, self.schemes, self.controls, self.checks_samples)
        part = Part(self.processes, self._wait_for, *asked)
        self._parts.append((part, model, start))
        return part

    def left_of(self, curves: Sequence[HbmCurve], *, stability: bool) -> Iterator[HbmCurve]:
        """What there is of the parts to whose ends some curves, which an interrupt has cut off, have not come."""
        ends = [curve.frequency[place] for curve in curves if curve.frequency.size for place in (0, -1)]
        for part, model, start in self._parts:
            curve = part.left() if part.given_up else None
            if curve is not None and curve.p.size and not np.isclose(curve.p[0], ends).any():
                yield left_part(model, start, curve, self.schemes, stability=stability, aside=self)

    def meanwhile(self, start: float, work: Work, pieces: Pieces, so_far: Callable[[], Curve]) -> None:
        """Evaluate the solutions of the part that is followed elsewhere, once it has ended, and those so far."""

        def look() -> None:
            ended = (part.ended for part, _, begun in self._parts if begun == start)
            # The last one is that of the curve which it meets.
            others = [part_of(curve, slice(None, -1)) for curve in ended if curve is not None]
            theirs = [piece for curve in others for piece in pieces(curve, grows=False)]
            self._evaluation.add(work, theirs + pieces(so_far(), grows=True))

        self._look = look
        self._number += 1
        if self._parts:
            self._use_room(look=self._number % LOOKED == 0)

    def _use_room(self, *, look: bool) -> None:
        """Evaluate where a process has nothing to do, beside this one; look for more to evaluate."""
        room = self.processes.workers - 1 - sum(part.under_way for part, *_ in self._parts)
        if look and room > self._evaluation.under_way:
            self._look()
        with suppress(BrokenExecutor):
            self._evaluation.go_on(room)

    def _wait_for(self, part: Future[Curve]) -> None:
        """Wait for a part, and evaluate meanwhile."""
        if not part.done():
            self._look()
        while not part.done():
            self._use_room(look=False)
            if not self._evaluation.one_here():
                works: list[Future[Any]] = [part, *self._evaluation.running]
                wait(works, return_when=FIRST_COMPLETED)

    def each(self, work: Work, pieces: Sequence[Piece]) -> list[Signed]:
        """The pieces of the whole curve, by processes if that takes long."""
        if len(pieces) < 2 or sum(curve.x.size for _, curve in pieces) < WORK:
            return each_here(work, pieces)
        return self._evaluation.all_of(work, pieces)

    def known(self, work: Work, pieces: Sequence[Piece]) -> list[Signed]:
        """The pieces that have been evaluated, as they are; the others by this process."""
        return [self._evaluation.known(piece) or work(*piece) for piece in pieces]


class Evaluation:
    """The pieces of a curve that processes evaluate, some of them before all are known.

    `running` is what is being evaluated, as far as is known.
    """

    def __init__(self, processes: Processes):
        self.processes = processes
        self.running: set[Future[Signed]] = set()
        self._waiting = deque[tuple[Work, Piece]]()
        self._begun: dict[bytes, Future[Signed]] = {}

    @property
    def under_way(self) -> int:
        """How many are being evaluated."""
        self.running = {future for future in self.running if not future.done()}
        return len(self.running)

    def add(self, work: Work, pieces: Sequence[Piece]) -> None:
        """These are to be evaluated next, instead of those that wait; what has begun is not begun again."""
        self._waiting = deque((work, piece) for piece in pieces)

    def go_on(self, room: int) -> None:
        """Begin to evaluate pieces that wait, so many at a time.

        Raises:
            BrokenExecutor: a process was killed.
        """
        while self.under_way < room and (asked := self._next()) is not None:  # in this order: it forgets those done
            key, (work, piece) = asked
            self._begun[key] = future = self.processes.submit(unseen, work, *piece)
            self.running.add(future)

    def one_here(self) -> bool:
        """Evaluate one of the pieces that wait by this process; False if none does."""
        if (asked := self._next()) is None:
            return False
        key, (work, piece) = asked
        done = Future[Signed]()
        done.set_result(work(*piece))
        self._begun[key] = done
        return True

    def _next(self) -> tuple[bytes, tuple[Work, Piece]] | None:
        """The next of the pieces that wait, and its key, if it has not begun."""
        while self._waiting:
            work, piece = self._waiting.popleft()
            if (key := _key(piece)) not in self._begun:
                return key, (work, piece)
        return None

    def all_of(self, work: Work, pieces: Sequence[Piece]) -> list[Signed]:
        """All of these, by this process as well.

        Raises:
            KeyboardInterrupt: after the processes have stopped.
        """
        try:
            with suppress(BrokenExecutor):
                self.add(work, pieces)
                while self._waiting or self.under_way:
                    self.go_on(self.processes.workers - 1)
                    if not self.one_here():
                        wait(self.running, return_when=FIRST_COMPLETED)
        except KeyboardInterrupt:
            self.processes.give_up(self.running)
            raise
        return [self._result(work, piece) for piece in pieces]

    def known(self, piece: Piece) -> Signed | None:
        """What has come of a piece; None where nothing has."""
        future = self._begun.get(_key(piece))
        if future is None or not future.done() or future.cancelled() or future.exception() is not None:
            return None
        return future.result()

    def _result(self, work: Work, piece: Piece) -> Signed:
        if (future := self._begun.get(_key(piece))) is not None:
            with suppress(BrokenExecutor):
                return future.result()
        return work(*piece)


def _key(piece: Piece) -> bytes:
    """What tells the pieces of a curve apart."""
    _, curve = piece
    return b"".join(array.tobytes() for array in (curve.p, curve.determinant, curve.x))


class Part:
    """The part of the curve of a model between two frequencies: a `timesim.hbm.continuation.Elsewhere`."""

    def __init__(self, processes: Processes, wait_for: Callable[[Future[Curve]], None], *asked: Any):
        """Begin to follow it on one of some processes; what waits for it; arguments as of `followed_part`."""
        self.processes, self.given_up, self._wait_for = processes, False, wait_for
        self._parts, self._future = 0, cast(Future[Curve] | None, None)
        with suppress(BrokenExecutor):
            self._future = processes.submit(self._seen, followed_part, *asked)

    def _seen(self, parts: int) -> None:
        self._parts = parts

    @property
    def share(self) -> float:
        """Of its range that it has reached.

        Raises:
            TooFewSamplesError: its samples have proved too few, so that the whole curve is followed again.
        """
        if self._future is not None and not self.under_way:
            self.curve()
        return self._parts / PARTS

    @property
    def under_way(self) -> bool:
        return self._future is not None and not self._future.done()

    @property
    def ended(self) -> Curve | None:
        """The curve, if it has come to its end by now."""
        curve = self.curve() if self._future is not None and self._future.done() else None
        return curve if curve is not None and curve.complete else None

    def curve(self) -> Curve | None:
        """The curve once it has ended, None if it failed or the process did not live so long.

        Raises:
            TooFewSamplesError: as of `share`.
        """
        if self._future is None:
            return None
        self._wait_for(self._future)
        if isinstance(error := self._future.exception(), TooFewSamplesError):
            raise error
        # Whatever else fails there this process meets itself, on its way along the curve.
        return self._future.result() if error is None else None

    def left(self) -> Curve | None:
        """What there is of it where it was given up."""
        with suppress(TooFewSamplesError):
            return self.curve()
        return None

    def give_up(self) -> None:
        """Stop it, if it has not ended; its solutions are not among those of the curve."""
        self.given_up = True
        if self._future is not None and self.under_way:
            self.processes.give_up([self._future])


def followed_part(
    model: Model,
    start: float,
    first: float,
    last: float,
    schemes: tuple[Scheme, ...],
    controls: Controls,
    checks_samples: bool,
) -> Curve:
    """`part_of_curve` in another process; as far as it has come where it is halted.

    Raises:
        TooFewSamplesError: its samples are checked, and are too few.
    """
    watch: Watch = counting(lambda share: share)
    if checks_samples:
        watch = checking_samples(lambda _: model, schemes, watch)
    return part_of_curve(model, start, first, last, schemes, controls, watch)


def counting(part: Callable[[float], float]) -> Callable[[float, Any], None]:
    """What watches a curve in a process: counts the parts of its work that are done, and ends it where it is halted.

    ``part``: of the work, that is done when a share of the range of the present curve is followed.
    """
    counted = 0

    def watch(share: float, _: Any) -> None:
        nonlocal counted
        while counted < int(PARTS * part(share)):
            point_done()
            counted += 1
        if halted():
            raise KeyboardInterrupt

    return watch
