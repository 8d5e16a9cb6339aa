"""What other processes do for a curve that takes long: a part of it, and the evaluation of its solutions."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import suppress
from typing import Any, cast

import numpy as np

from timesim.hbm.continuation import WORK, Controls, Curve
from timesim.hbm.curve import HbmCurve, Watch, left_part, part_of_curve
from timesim.hbm.scheme import Scheme
from timesim.model.model import Model
from timesim.study.curves.samples import TooFewSamplesError, checking_samples
from timesim.study.execution.processes import Processes, unseen
from timesim.study.execution.worker import halted, point_done

PARTS = 100  # into which a process divides its work to count its progress


class Aside:
    """Processes that take a part of the work on a curve: a `timesim.hbm.curve.Aside`."""

    def __init__(self, processes: Processes, schemes: Sequence[Scheme], controls: Controls, *, checks_samples: bool):
        """For curves by some schemes, in some steps, whose samples may prove too few."""
        self.processes, self.schemes, self.controls = processes, tuple(schemes), controls
        self.checks_samples = checks_samples
        self._parts: list[tuple[Part, Model, float]] = []

    def part(self, model: Model, start: float, first: float, last: float) -> "Part":
        """Begin `part_of_curve`."""
        asked = (model, start, first, last, self.schemes, self.controls, self.checks_samples)
        part = Part(self.processes, *asked)
        self._parts.append((part, model, start))
        return part

    def left_of(self, curves: Sequence[HbmCurve], *, stability: bool) -> Iterator[HbmCurve]:
        """What there is of the parts to whose ends some curves, which an interrupt has cut off, have not come."""
        ends = [curve.frequency[place] for curve in curves if curve.frequency.size for place in (0, -1)]
        for part, model, start in self._parts:
            curve = part.left() if part.given_up else None
            if curve is not None and curve.p.size and not np.isclose(curve.p[0], ends).any():
                yield left_part(model, start, curve, self.schemes, stability=stability)

    def each(self, function: Callable[..., HbmCurve], pieces: Sequence[tuple[Any, Curve]]) -> list[HbmCurve]:
        """A function of a module of some residuals and solutions of each."""
        found: dict[int, HbmCurve] = {}
        if len(pieces) > 1 and sum(curve.x.size for _, curve in pieces) >= WORK:
            with suppress(BrokenExecutor):
                found.update(self.processes.each([(unseen, function, piece) for piece in pieces]))
        return [found[k] if k in found else function(*piece) for k, piece in enumerate(pieces)]


class Part:
    """The part of the curve of a model between two frequencies: a `timesim.hbm.continuation.Elsewhere`."""

    def __init__(self, processes: Processes, *asked: Any):
        """Begin to follow it on one of some processes; arguments as of `followed_part`."""
        self.processes, self.given_up = processes, False
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
        if self._future is not None and self._future.done():
            self.curve()
        return self._parts / PARTS

    def curve(self) -> Curve | None:
        """The curve once it has ended, None if it failed or the process did not live so long.

        Raises:
            TooFewSamplesError: as of `share`.
        """
        if self._future is None:
            return None
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
        if self._future is not None and not self._future.done():
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
