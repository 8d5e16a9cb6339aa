"""A curve as it is traced: its solutions, the direction of the parameter, and folds where the curve really turns.

Neither a tangent whose parameter changes its sign nor a parameter that goes back for a moment makes a fold: where
contacts begin to slip or to touch, the samples of a period turn a curve to and fro. A fold is where the parameter goes
back from its summit by more than that. Where a solution takes other unknowns, the curve goes on beside the one before:
the change of the parameter from one to the other is no progress along either.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from timesim.hbm.continuation.corrector import Corrector, CurvePoint
from timesim.hbm.continuation.residual import NoSolutionError
from timesim.hbm.continuation.solutions import Solution

# How far the parameter may go back without a fold, as shares of its range and of its value: where slip of the paper's
# oscillator begins it does so by up to 4e-7 Hz at 1.37 Hz, in a range of 0.06 Hz.
NOISE_OF_RANGE, NOISE_OF_VALUE = 1e-5, 1e-6
# Differences of the parameter and of x, relative to them, up to which two folds are one: x is known to the root of p.
SAME_PARAMETER, SAME_FOLD = 1e-7, 1e-3


@dataclass
class _Summit:
    """The farthest point of a branch so far, its place among the solutions, and its neighbours along the curve.

    `way`: the parameter there, less all that other unknowns moved it.
    `between`: whether it is the extreme of the parameter between two solutions, the second of which has that place.
    """

    point: CurvePoint
    way: float
    place: int
    between: bool
    before: CurvePoint | None = None
    after: CurvePoint | None = None


class Trace:
    """Solutions in the order of the curve, folds among them.

    Attributes:
        solutions: so far.
        direction: in which the parameter goes but for noise, 1 or -1.
        again: how many of the last folds in a row the curve had passed before.
    """

    def __init__(self, corrector: Corrector, direction: float):
        self.corrector, self.direction = corrector, direction
        self.solutions: list[Solution] = []
        self.again = 0
        self._summit: _Summit | None = None
        self._last: CurvePoint | None = None
        self._moved = 0.0

    def rescale(self, factor: float) -> None:
        """Take over another unit of x of the corrector, that before in units of it."""
        if self._last is None or self._summit is None:
            return
        summit = self._summit
        self._last, summit.point = self._last.rescaled(factor), summit.point.rescaled(factor)
        summit.before = summit.before and summit.before.rescaled(factor)
        summit.after = summit.after and summit.after.rescaled(factor)

    def add(self, point: CurvePoint, moved: float = 0.0) -> None:
        """Take in the next point, whose parameter other unknowns moved by so much; its tangent points along the curve.

        Where that turns round on the way the extreme of the parameter counts too: of a branch between two folds no
        other point may go back by more than noise.
        """
        last = self._last
        self._moved += moved
        if last is not None and last.tangent[-1] * point.tangent[-1] < 0 and (top := self._extreme(last, point)):
            self._take(top, between=True)
        self._take(point)

    def _take(self, point: CurvePoint, between: bool = False) -> None:
        summit, noise, way = self._summit, False, point.y[-1] - self._moved
        if summit is not None:
            back = self.direction * (summit.way - way)
            least = max(NOISE_OF_RANGE, NOISE_OF_VALUE * abs(summit.point.y[-1]))
            summit.after, noise = summit.after or point, 0 < back <= least
            if back > least:
                self.direction = -self.direction
                self._turn_at(summit)
                self.again = self.again + 1 if self._is_passed_again() else 0
            elif not noise:
                self._forget_noise(summit)
        if not noise:
            self._summit = _Summit(point, way, len(self.solutions), between, self._last)
        if between:
            return
        # Behind a summit that of the branch after a fold, until the summit is passed.
        sign = np.sign(point.orientation) * (-self.direction if noise else self.direction)
        self.solutions.append((*self.corrector.unscaled(point.y), False, int(sign)))
        self._last = point

    def _forget_noise(self, summit: _Summit) -> None:
        """The parameter passes a summit again: what lies behind is of the same branch."""
        for i in range(summit.place + (not summit.between), len(self.solutions)):
            x, p, fold, determinant = self.solutions[i]
            self.solutions[i] = (x, p, fold, -determinant)

    def _turn_at(self, summit: _Summit) -> None:
        """Put a fold where the parameter turns at a summit, or as close to it as one is found."""
        if summit.between:
            self.solutions.insert(summit.place, (*self.corrector.unscaled(summit.point.y), True, 0))
            return
        x, p, _, determinant = self.solutions[summit.place]
        for one, other, side in ((summit.point, summit.after, 1), (summit.before, summit.point, 0)):
            # Between a summit and the solution before it may lie the fold before, an extreme of the other kind.
            top = None if one is None or other is None else self._extreme(one, other)
            if top is not None and self.direction * (summit.point.y[-1] - top.y[-1]) >= 0:
                if side == 0:
                    self.solutions[summit.place] = (x, p, False, -determinant)
                self.solutions.insert(summit.place + side, (*self.corrector.unscaled(top.y), True, 0))
                return
        self.solutions[summit.place] = (x, p, True, 0)

    def _is_passed_again(self) -> bool:
        """Whether the last fold is one of those before."""
        *before, (last, place) = [(x, p) for x, p, fold, _ in self.solutions if fold]
        size, way = SAME_FOLD * self.corrector.size_of(last), SAME_PARAMETER * abs(place)
        return any(abs(p - place) <= way and np.linalg.norm(x - last) <= size for x, p in before)

    def _extreme(self, one: CurvePoint, other: CurvePoint) -> CurvePoint | None:
        """Where the parameter turns between two points, if it does."""
        with suppress(NoSolutionError):
            # Their tangents are those of derivatives beside them, and may be the ones on the other side of the fold.
            one, other = (self.corrector.simplified_newton(own.y, own.tangent, fresh=True) for own in (one, other))
            if one.tangent[-1] * other.tangent[-1] < 0:
                return self.corrector.fold_between(one, other)
        return None
