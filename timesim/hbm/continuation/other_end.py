"""The other end of a curve that takes long, followed meanwhile by another process up to the middle between both."""

from collections.abc import Callable
from typing import Protocol, cast

import numpy as np

from timesim.hbm.continuation.bordered import Array
from timesim.hbm.continuation.solutions import Curve, Solution

WORK = 100_000
"""Unknowns of all solutions so far from which on the curve takes long: some eight seconds of work. Not seconds, so that
the same solutions come out each time; another process takes two to start."""


class Elsewhere(Protocol):
    """A curve that another process follows."""

    @property
    def share(self) -> float:
        """Of its range that it has reached."""

    def curve(self) -> Curve | None:
        """The curve once it has ended, None if it failed or the process did not live so long."""

    def give_up(self) -> None:
        """Stop it, if it has not ended; its solutions are not among those of the curve."""


FromEnd = Callable[[float], Elsewhere]
"""Begins to follow the curve from the end of the range to a value of the parameter."""


class OtherEnd:
    """The curve from the other end of a range, once it is worth while.

    Attributes:
        middle: value of the parameter up to which it is followed; None before, and where it does not get there.
        joined: how many of its solutions are among those of the curve.
    """

    def __init__(self, from_end: FromEnd | None, end: float):
        """Of a range that ends there; it is never followed if nothing begins to."""
        self.from_end, self.end = from_end, end
        self.middle: float | None = None
        self.joined = 0
        self._work, self._elsewhere = 0, cast(Elsewhere | None, None)

    @property
    def reached(self) -> float:
        """Length of the range that it has come through."""
        if self.middle is None or self._elsewhere is None:
            return 0.0
        return self._elsewhere.share * abs(self.end - self.middle)

    def count(self, num_unknowns: int, p: float) -> None:
        """Take in a solution, at a value of the parameter, and begin where the work of all so far is long."""
        self._work += num_unknowns
        if self._work >= WORK and self.from_end is not None:
            # Of frequencies the harmonic mean: harmonic k is in resonance at a natural frequency over k, as often over
            # equal differences of 1 / p, and there a curve has most of its solutions.
            self.middle = 2 / (1 / p + 1 / self.end) if min(p, self.end) > 0 else (p + self.end) / 2
            self._elsewhere, self.from_end = self.from_end(self.middle), None

    def rest_from(self, x: Array, p: float, tolerance: float) -> list[Solution] | None:
        """Its solutions from the middle to the end, if the last of it is the one given, within a tolerance; else None.

        It is waited for.
        """
        curve = None if self._elsewhere is None else self._elsewhere.curve()
        if curve is None or not curve.complete or not np.isclose(curve.p[-1], p, rtol=1e-9, atol=0.0):
            self.middle = None
            return None
        if np.linalg.norm(curve.x[-1] - x) > tolerance:
            return None
        rows = zip(curve.x[::-1], curve.p[::-1], curve.fold[::-1], curve.determinant[::-1], strict=True)
        return [(own, float(place), bool(fold), int(sign)) for own, place, fold, sign in rows][1:]

    def give_up(self) -> None:
        """Stop it, unless the curve has its solutions."""
        if self._elsewhere is not None and not self.joined:
            self._elsewhere.give_up()
