"""Pseudo-arc-length continuation of the solutions of ``r(x, p) = 0`` in a parameter p, around folds.

Any residual with its derivatives will do. Both x and p are measured in units of their own (see `Controls.size`), so
that a step is a step in either. From a point with unit tangent t the next one is sought on the plane at the distance
s along t: Newton's method on

    r(x, p) = 0,    t . ((x, p) - predicted) = 0

from a predictor of second order. The step follows the turn of the tangent and the convergence. Where the tangent's
share of p changes its sign the curve has a fold; it is located on the arc and is a point of the curve.

H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems (1977); E. L. Allgower and K. Georg,
Introduction to Numerical Continuation Methods (SIAM 2003), chapters 2 and 6.
"""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.corrector import Arc, Array, Controls, FailureError, Point, Residual

__all__ = ["Controls", "Curve", "Ending", "Residual", "follow", "follow_both_ways", "joined", "solve"]

# Lengths of a leap over a place where the residual is not smooth, as shares of the longest step, tried in turn.
LEAPS = (0.02, 0.06, 0.2, 0.6, 1.0)


class Ending(Enum):
    """Why a curve ends; the value tells the user."""

    COMPLETE = "complete: the whole range was followed"
    CLOSED = "complete: the curve is closed, it comes back to where it began"
    START = "no solution at the start"
    STEP = "Newton's method fails even at the smallest step; smaller min_step, or a smoother residual, may help"
    POINTS = "the largest number of points is reached; raise max_points or max_step"
    LEFT = "the curve turned back and left the range where it began; begin at the other end of the range"
    INTERRUPTED = "interrupted"

    @property
    def complete(self) -> bool:
        """Whether the whole range, or the whole of a closed curve, was followed."""
        return self in (Ending.COMPLETE, Ending.CLOSED)


@dataclass(frozen=True)
class Curve:
    """Solutions in the order in which they were found.

    Attributes:
        x: unknowns, shape (S, n).
        p: parameter, shape (S,).
        fold: whether the parameter turns here, shape (S,).
        branch: folds passed before, shape (S,); a fold belongs to the branch that it ends.
        determinant: sign of det dr/dx, 0 at a fold, shape (S,).
        corrections: of each point by Newton's method, shape (S,).
        ending: why it ends.
        message: the same with the place.
    """

    x: Array
    p: Array
    fold: NDArray[np.bool_]
    branch: NDArray[np.int64]
    determinant: NDArray[np.int64]
    corrections: NDArray[np.int64]
    ending: Ending
    message: str

    @property
    def complete(self) -> bool:
        """Whether the whole range was followed."""
        return self.ending.complete

    def point(self, i: int, p: float) -> "Curve":
        """One of the solutions, said to be at another value of the parameter."""
        arrays = ("x", "p", "fold", "branch", "determinant", "corrections")
        parts = {name: getattr(self, name)[i : i + 1] for name in arrays}
        return replace(self, **parts | {"p": np.array([p])})


def follow(
    residual: Residual, guess: Array, start: float, stop: float, controls: Controls, *, behind: float | None = None
) -> Curve:
    """Follow the solution near a guess from one value of the parameter to another, around folds.

    Args:
        residual: the equations.
        guess: near a solution at `start`, shape (n,).
        start, stop: range of the parameter; the curve begins at `start`, which may be the larger.
        controls: step lengths and tolerances.

    Keyword Args:
        behind: the other end of the range where the curve begins inside it; `start` by default. Such a curve may also
            end there, or where it began.

    Returns:
        The curve; where it fails, what it has, with the reason and the place.

    Raises:
        ValueError: the range is empty or the guess is not a finite vector.
    """
    behind = start if behind is None else behind
    if not np.isfinite([start, stop, behind]).all() or stop in (start, behind):
        raise ValueError(f"continuation: the range must have two different finite ends, not {start} and {stop}")
    if guess.ndim != 1 or not np.isfinite(guess).all():
        raise ValueError(f"continuation: the guess must be a vector of finite numbers, not of shape {guess.shape}")
    return _Walk(residual, controls, start, stop, behind).run(guess)


def follow_both_ways(
    residual: Residual, guess: Array, start: float, ends: tuple[float, float], controls: Controls
) -> Curve:
    """Follow the solution near a guess inside a range to both sides: one curve, the second side's points reversed.

    So a curve is found whole that no end of the range leads to; it may be closed. Arguments and errors as `follow`.
    """
    ahead = follow(residual, guess, start, ends[1], controls, behind=ends[0])
    if ahead.ending in (Ending.START, Ending.CLOSED, Ending.INTERRUPTED):
        return ahead
    return joined(follow(residual, ahead.x[0], start, ends[0], controls, behind=ends[1]), ahead)


def joined(back: Curve, ahead: Curve) -> Curve:
    """One curve of two that begin at the same point: the first from its end to there, then the second."""
    ending, message = next(
        ((half.ending, half.message) for half in (back, ahead) if not half.complete), (ahead.ending, ahead.message)
    )
    parts = {
        name: np.concatenate([getattr(back, name)[:0:-1], getattr(ahead, name)])
        for name in ("x", "p", "fold", "determinant", "corrections")
    }
    return Curve(**parts, branch=np.cumsum(parts["fold"]) - parts["fold"], ending=ending, message=message)


def solve(residual: Residual, guess: Array, p: float, controls: Controls) -> tuple[Array, int] | None:
    """Solution near a guess at one value of the parameter, and the sign of det dr/dx; None if none is found."""
    arc = Arc(residual, controls, abs(p) or 1.0)
    arc.x_unit = max(controls.size, float(np.linalg.norm(guess)))
    border = np.append(np.zeros(guess.size), 1.0)
    try:
        point = arc.settled(np.append(guess / arc.x_unit, p / arc.p_unit), border)
    except FailureError:
        return None
    return point.y[:-1] * arc.x_unit, point.determinant


class _Walk:
    """A curve on the way: its points in the units of the caller, and the step."""

    def __init__(self, residual: Residual, controls: Controls, start: float, stop: float, behind: float):
        self.arc = Arc(residual, controls, abs(stop - behind))
        self.controls, self.start, self.stop, self.behind = controls, start, stop, behind
        self.sign = float(np.sign(stop - start))
        self.points: list[Point] = []
        self.rows: list[tuple[Array, float, bool, int, int]] = []

    def run(self, guess: Array) -> Curve:
        """From the guess to the end."""
        self.num_unknowns = guess.size
        self.arc.x_unit = max(self.controls.size, float(np.linalg.norm(guess)))
        y = np.append(guess / self.arc.x_unit, self.start / self.arc.p_unit)
        try:
            point = self.arc.settled(y, self._ahead(y.size))
        except FailureError:
            return self._curve(Ending.START, self.start)
        self._keep(point)
        try:
            return self._onwards(point)
        except KeyboardInterrupt:
            return self._curve(Ending.INTERRUPTED, self.rows[-1][1])

    def _onwards(self, point: Point) -> Curve:
        """From the first point to the end."""
        step, ending = self.controls.first_step, None
        before: tuple[Point, float] | None = None
        while ending is None:
            point, before = self._resized(point, before)
            following = self._step(point, before, step)
            if following is None:
                return self._curve(Ending.STEP, self.points[-1].y[-1] * self.arc.p_unit)
            before, point, step = (point, following[1]), following[0], following[2]
            ending = self._taken(before[0], point, before[1])
        return self._curve(ending, self.rows[-1][1])

    def _ahead(self, size: int) -> Array:
        """Normal of the plane on which the parameter is fixed."""
        border = np.zeros(size)
        border[-1] = self.sign
        return border

    def _keep(self, point: Point) -> None:
        self.points.append(point)
        x, p = point.y[:-1] * self.arc.x_unit, float(point.y[-1] * self.arc.p_unit)
        self.rows.append((x, p, point.fold, point.determinant, point.corrections))

    def _resized(self, point: Point, before: tuple[Point, float] | None) -> tuple[Point, tuple[Point, float] | None]:
        """Units that follow the size of x; the predictor begins anew when they change."""
        ratio = max(float(np.linalg.norm(point.y[:-1])), self.controls.size / self.arc.x_unit)
        return (point, before) if 0.6 < ratio < 1.6 else (self.arc.resized(point), None)

    def _step(self, point: Point, before: tuple[Point, float] | None, step: float) -> tuple[Point, float, float] | None:
        """The next point, the length of arc to it, and a length for the one after; None if there is none."""
        while step >= self.controls.min_step:
            try:
                found = self.arc.corrected(_predicted(point, before, step), point.tangent)
            except FailureError:
                step /= 4
                continue
            turn = float(np.arccos(np.clip(point.tangent @ found.tangent, -1.0, 1.0)))
            # A tangent that jumps, as where slip begins, does so however short the step.
            if turn > 4 * self.controls.turn and step > self.controls.max_step / 20:
                step /= 3
                continue
            growth = np.clip(np.sqrt(self.controls.turn / max(turn, 1e-9)), 0.5, 1.6)
            if found.corrections > 4:
                growth = min(growth, 0.7)
            return found, step, min(float(growth) * step, self.controls.max_step)
        return self._leap(point)

    def _leap(self, point: Point) -> tuple[Point, float, float] | None:
        """Over a place where no short step succeeds; a point much farther than asked for is on another curve.

        The derivatives may mean little where it starts: after the tangent, a change of the parameter alone is tried,
        the way it went before, with x a little larger or smaller.
        """
        ahead = self._ahead(point.y.size) * (1 if self._rising() else -1)
        for share in LEAPS:
            step = share * self.controls.max_step
            guesses = [(point.y + step * point.tangent, point.tangent)]
            for swell in (1 + step, 1 - step, 1 + 4 * step):
                guesses.append((np.append(swell * point.y[:-1], point.y[-1] + step / 4 * np.sign(ahead[-1])), ahead))
            for guess, border in guesses:
                try:
                    found = self.arc.forced(guess, border)
                except FailureError:
                    continue
                far = np.linalg.norm(found.y - point.y)
                if far <= 8 * step and (found.y - point.y)[-1] * ahead[-1] > 0:
                    return found, float(far), step
        return None

    def _rising(self) -> bool:
        """Whether the parameter last went towards the end of the range."""
        return len(self.rows) < 2 or (self.rows[-1][1] - self.rows[-2][1]) * self.sign >= 0

    def _taken(self, before: Point, point: Point, step: float) -> Ending | None:
        """Keep a point, with the fold or the end of the range before it; how the curve ends, if it does."""
        if before.tangent[-1] * point.tangent[-1] < 0:
            fold = self._fold(before, point, step)
            if fold is not None:
                self._keep(fold)
        place = point.y[-1] * self.arc.p_unit
        inside = self.behind != self.start
        last = self._back(before, point) if inside else None
        if last is not None:
            self._keep(last)
            return Ending.CLOSED
        out = Ending.COMPLETE if inside else Ending.LEFT
        for end, ending, side in ((self.stop, Ending.COMPLETE, 1), (self.behind, out, -1)):
            if side * self.sign * (place - end) >= 0:
                last = self._landed(before, point, end)
                if last is None:
                    return Ending.STEP
                self._keep(last)
                return ending
        self._keep(point)
        return Ending.POINTS if len(self.rows) >= self.controls.max_points else None

    def _back(self, before: Point, point: Point) -> Point | None:
        """The point where the curve began, if it comes through it again in the same direction."""
        begin = self.start / self.arc.p_unit
        if len(self.rows) < 4 or not (before.y[-1] - begin) * self.sign < 0 <= (point.y[-1] - begin) * self.sign:
            return None
        last = self._landed(before, point, self.start)
        if last is None:
            return None
        first = self.rows[0][0] / self.arc.x_unit
        return last if np.linalg.norm(last.y[:-1] - first) < SAME * np.linalg.norm(last.y[:-1]) else None

    def _landed(self, before: Point, point: Point, end: float) -> Point | None:
        """The point at an end of the range, between two others."""
        share = (end / self.arc.p_unit - before.y[-1]) / (point.y[-1] - before.y[-1])
        guess = before.y + share * (point.y - before.y)
        guess[-1] = end / self.arc.p_unit
        try:
            return self.arc.settled(guess, self._ahead(guess.size))
        except FailureError:
            return None

    def _fold(self, before: Point, point: Point, step: float) -> Point | None:
        """Where the tangent's share of the parameter vanishes on the arc between two points."""
        found: dict[float, Point] = {}

        def share(s: float) -> float:
            found[s] = self.arc.corrected(before.y + s * before.tangent, before.tangent, exact=True)
            return float(found[s].tangent[-1])

        low, high = 0.0, float((point.y - before.y) @ before.tangent)
        at_low, at_high = float(before.tangent[-1]), float(point.tangent[-1])
        try:
            for _ in range(MAX_BISECTIONS):
                s = low + (high - low) * np.clip(at_low / (at_low - at_high), 0.05, 0.95)
                value = share(s)
                if value * at_low > 0:
                    low, at_low = s, value
                else:
                    high, at_high = s, value
                if abs(value) < FLAT or high - low < 1e-3 * FLAT * step:
                    break
        except FailureError:
            if not found:
                return None
        best = min(found.values(), key=lambda item: abs(item.tangent[-1]))
        return replace(best, determinant=0, fold=True)

    def _curve(self, ending: Ending, place: float) -> Curve:
        x, p, fold, determinant, corrections = zip(*self.rows, strict=True) if self.rows else ((),) * 5
        folds = np.array(fold, dtype=bool)
        return Curve(
            x=np.array(x).reshape(len(self.rows), self.num_unknowns),
            p=np.array(p, dtype=float),
            fold=folds,
            branch=np.cumsum(folds) - folds,
            determinant=np.array(determinant, dtype=np.int64),
            corrections=np.array(corrections, dtype=np.int64),
            ending=ending,
            message=f"continuation at {place:.10g}, after {len(self.rows)} points: {ending.value}",
        )


# Distance of two points that are one, relative to their size.
SAME = 1e-5
# Share of the parameter in the tangent at which a fold counts as met: its own error is of second order in it.
FLAT = 1e-5
MAX_BISECTIONS = 40


def _predicted(point: Point, before: tuple[Point, float] | None, step: float) -> Array:
    """Along the tangent, and its turn since the point before."""
    if before is None:
        return point.y + step * point.tangent
    last, length = before
    return point.y + step * point.tangent + (step**2 / (2 * length)) * (point.tangent - last.tangent)
