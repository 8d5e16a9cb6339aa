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
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, lu_solve

Array = NDArray[np.float64]


class Residual(Protocol):
    """A system of as many equations as unknowns."""

    def value(self, x: Array, p: float) -> Array:
        """r, shape (n,)."""

    def linearised(self, x: Array, p: float) -> tuple[Array, Array, Array]:
        """r, shape (n,), its derivatives by x, shape (n, n), and by p, shape (n,)."""


@dataclass(frozen=True)
class Controls:
    """How a curve is followed. Lengths of arc are shares of the range of p and of the size of x.

    Attributes:
        size: what counts as a small solution, in the units of x; x is measured by its own norm where that is larger.
        first_step, min_step, max_step: length of arc of a step.
        max_points: points after which the curve is given up.
        tolerance: norm of the residual at a solution, relative to the size of x.
        max_newton: corrections of one point.
        turn: turn of the tangent over a step at which the step is neither lengthened nor shortened [rad].
    """

    size: float
    first_step: float = 0.01
    min_step: float = 1e-6
    max_step: float = 0.05
    max_points: int = 5000
    tolerance: float = 1e-9
    max_newton: int = 8
    turn: float = 0.12

    def __post_init__(self) -> None:
        if not self.size > 0 or not self.tolerance > 0:
            raise ValueError(f"continuation: size and tolerance must be positive, not {self.size} and {self.tolerance}")
        if not 0 < self.min_step <= self.first_step <= self.max_step:
            raise ValueError(
                "continuation: steps must obey 0 < min_step <= first_step <= max_step, "
                f"not {self.min_step}, {self.first_step}, {self.max_step}"
            )
        if self.max_points < 2 or self.max_newton < 1:
            raise ValueError(
                "continuation: max_points must be at least 2 and max_newton at least 1, "
                f"not {self.max_points} and {self.max_newton}"
            )


class Ending(Enum):
    """Why a curve ends; the value tells the user."""

    COMPLETE = "complete: the whole range was followed"
    START = "no solution at the start"
    STEP = "Newton's method fails even at the smallest step; smaller min_step, or a smoother residual, may help"
    POINTS = "the largest number of points is reached; raise max_points or max_step"
    LEFT = "the curve turned back and left the range where it began; begin at the other end of the range"


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
        return self.ending is Ending.COMPLETE


@dataclass(frozen=True)
class _Point:
    """A solution y = (x, p) in units, its unit tangent, and how it was found."""

    y: Array
    tangent: Array
    determinant: int
    corrections: int
    fold: bool = False


class _FailureError(Exception):
    """Newton's method did not converge."""


class _Arc:
    """The residual in units: y = (x / x_unit, p / p_unit)."""

    def __init__(self, residual: Residual, controls: Controls, p_unit: float):
        self.residual, self.controls, self.p_unit = residual, controls, p_unit
        self.x_unit = controls.size

    def resized(self, point: _Point) -> _Point:
        """The point, measured by its own size."""
        x = point.y[:-1] * self.x_unit
        tangent = np.append(point.tangent[:-1] * self.x_unit, point.tangent[-1])
        self.x_unit = max(self.controls.size, float(np.linalg.norm(x)))
        tangent[:-1] /= self.x_unit
        y = np.append(x / self.x_unit, point.y[-1])
        return _Point(y, tangent / np.linalg.norm(tangent), point.determinant, point.corrections, point.fold)

    def small(self, r: Array, y: Array) -> bool:
        size = max(self.controls.size, float(np.linalg.norm(y[:-1])) * self.x_unit)
        return bool(np.linalg.norm(r) <= self.controls.tolerance * size)

    def value(self, y: Array) -> Array:
        return self.residual.value(y[:-1] * self.x_unit, float(y[-1] * self.p_unit))

    def bordered(self, y: Array, border: Array) -> tuple[Array, Array]:
        """r, and the derivatives of r / x_unit with `border` as the last row."""
        r, by_x, by_p = self.residual.linearised(y[:-1] * self.x_unit, float(y[-1] * self.p_unit))
        matrix = np.empty((y.size, y.size))
        matrix[:-1, :-1] = by_x
        matrix[:-1, -1] = by_p * (self.p_unit / self.x_unit)
        matrix[-1] = border
        if not np.isfinite(matrix).all():
            raise _FailureError
        return r, matrix

    def corrected(self, guess: Array, border: Array, *, exact: bool = False) -> _Point:
        """Solution on the plane through the guess with normal `border`, and its tangent, on the side of `border`.

        The derivatives are those at the guess as long as they make the corrections fall fast; with `exact` they are
        taken anew at the solution.
        """
        y, before, stale = guess, np.inf, True
        for count in range(self.controls.max_newton + 1):
            if stale:
                r, matrix = self.bordered(y, border)
                factors = _factorised(matrix)
            else:
                r = self.value(y)
            if self.small(r, y):
                if exact and count:
                    factors = _factorised(self.bordered(y, border)[1])
                return _Point(y, *_direction(factors), count)
            step = lu_solve(factors, np.append(-r / self.x_unit, border @ (guess - y)), check_finite=False)
            size = float(np.linalg.norm(step))
            if not np.isfinite(size) or size > 2 * before:
                break
            y, before, stale = y + step, size, size > CHORD * before
        raise _FailureError

    def forced(self, guess: Array, border: Array) -> _Point:
        """The same where the residual is hardly smooth: derivatives anew each time, and patience with detours."""
        y = guess
        for count in range(MAX_FORCED):
            r, matrix = self.bordered(y, border)
            factors = _factorised(matrix)
            if self.small(r, y):
                return _Point(y, *_direction(factors), count)
            step = lu_solve(factors, np.append(-r / self.x_unit, border @ (guess - y)), check_finite=False)
            size = float(np.linalg.norm(step))
            if not size < MAX_DETOUR:
                break
            y = y + step
        raise _FailureError

    def settled(self, guess: Array, border: Array) -> _Point:
        """The same from a poor guess: corrections are halved until the residual falls."""
        try:
            return self._damped(guess, border)
        except _FailureError:
            return self.forced(guess, border)

    def _damped(self, guess: Array, border: Array) -> _Point:
        y, (r, matrix) = guess, self.bordered(guess, border)
        for count in range(MAX_DAMPED):
            factors = _factorised(matrix)
            if self.small(r, y):
                return _Point(y, *_direction(factors), count)
            step = lu_solve(factors, np.append(-r / self.x_unit, 0.0), check_finite=False)
            for share in 0.5 ** np.arange(12):
                tried = self.value(y + share * step)
                if np.linalg.norm(tried) < (1 - 0.1 * share) * np.linalg.norm(r):
                    break
            else:
                raise _FailureError
            y = y + share * step
            r, matrix = self.bordered(y, border)
        raise _FailureError


# Corrections that fall by less than this ask for new derivatives.
CHORD = 0.1
MAX_DAMPED = 60
MAX_FORCED = 30
# Detour of Newton's method, in units of the solution, that leads nowhere.
MAX_DETOUR = 10.0
# Lengths of a leap over a place where the residual is not smooth, as shares of the longest step, tried in turn.
LEAPS = (0.02, 0.06, 0.2, 0.6, 1.0)
Factors = tuple[Array, NDArray[np.int32]]


def _factorised(matrix: Array) -> Factors:
    """LU factors of a bordered matrix.

    Raises:
        _FailureError: it is singular.
    """
    factors = lapack.dgetrf(matrix)
    if factors[2] != 0:
        raise _FailureError
    return factors[0], factors[1]


def _direction(factors: Factors) -> tuple[Array, int]:
    """Unit tangent from the factors of a bordered matrix, and the sign of det dr/dx, by Cramer's rule."""
    lu, pivots = factors
    last = np.zeros(len(lu))
    last[-1] = 1.0
    tangent = lu_solve(factors, last, check_finite=False)
    swaps = np.count_nonzero(pivots != np.arange(pivots.size))
    negative = np.count_nonzero(np.diag(lu) < 0) + swaps
    sign = int(np.sign(tangent[-1])) * (-1) ** int(negative)
    return tangent / np.linalg.norm(tangent), sign


def follow(residual: Residual, guess: Array, start: float, stop: float, controls: Controls) -> Curve:
    """Follow the solution near a guess from one value of the parameter to another, around folds.

    Args:
        residual: the equations.
        guess: near a solution at `start`, shape (n,).
        start, stop: range of the parameter; the curve begins at `start`, which may be the larger.
        controls: step lengths and tolerances.

    Returns:
        The curve; where it fails, what it has, with the reason and the place.

    Raises:
        ValueError: the range is empty or the guess is not a finite vector.
    """
    if not np.isfinite([start, stop]).all() or start == stop:
        raise ValueError(f"continuation: the range must have two different finite ends, not {start} and {stop}")
    if guess.ndim != 1 or not np.isfinite(guess).all():
        raise ValueError(f"continuation: the guess must be a vector of finite numbers, not of shape {guess.shape}")
    return _Walk(residual, controls, start, stop).run(guess)


def solve(residual: Residual, guess: Array, p: float, controls: Controls) -> tuple[Array, int] | None:
    """Solution near a guess at one value of the parameter, and the sign of det dr/dx; None if none is found."""
    arc = _Arc(residual, controls, abs(p) or 1.0)
    arc.x_unit = max(controls.size, float(np.linalg.norm(guess)))
    border = np.append(np.zeros(guess.size), 1.0)
    try:
        point = arc.settled(np.append(guess / arc.x_unit, p / arc.p_unit), border)
    except _FailureError:
        return None
    return point.y[:-1] * arc.x_unit, point.determinant


class _Walk:
    """A curve on the way: its points in the units of the caller, and the step."""

    def __init__(self, residual: Residual, controls: Controls, start: float, stop: float):
        self.arc = _Arc(residual, controls, abs(stop - start))
        self.controls, self.start, self.stop = controls, start, stop
        self.sign = float(np.sign(stop - start))
        self.points: list[_Point] = []
        self.rows: list[tuple[Array, float, bool, int, int]] = []

    def run(self, guess: Array) -> Curve:
        """From the guess to the end."""
        self.num_unknowns = guess.size
        self.arc.x_unit = max(self.controls.size, float(np.linalg.norm(guess)))
        y = np.append(guess / self.arc.x_unit, self.start / self.arc.p_unit)
        try:
            point = self.arc.settled(y, self._ahead(y.size))
        except _FailureError:
            return self._curve(Ending.START, self.start)
        self._keep(point)
        step, ending = self.controls.first_step, None
        before: tuple[_Point, float] | None = None
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

    def _keep(self, point: _Point) -> None:
        self.points.append(point)
        x, p = point.y[:-1] * self.arc.x_unit, float(point.y[-1] * self.arc.p_unit)
        self.rows.append((x, p, point.fold, point.determinant, point.corrections))

    def _resized(
        self, point: _Point, before: tuple[_Point, float] | None
    ) -> tuple[_Point, tuple[_Point, float] | None]:
        """Units that follow the size of x; the predictor begins anew when they change."""
        ratio = max(float(np.linalg.norm(point.y[:-1])), self.controls.size / self.arc.x_unit)
        return (point, before) if 0.6 < ratio < 1.6 else (self.arc.resized(point), None)

    def _step(
        self, point: _Point, before: tuple[_Point, float] | None, step: float
    ) -> tuple[_Point, float, float] | None:
        """The next point, the length of arc to it, and a length for the one after; None if there is none."""
        while step >= self.controls.min_step:
            try:
                found = self.arc.corrected(_predicted(point, before, step), point.tangent)
            except _FailureError:
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

    def _leap(self, point: _Point) -> tuple[_Point, float, float] | None:
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
                except _FailureError:
                    continue
                far = np.linalg.norm(found.y - point.y)
                if far <= 8 * step and (found.y - point.y)[-1] * ahead[-1] > 0:
                    return found, float(far), step
        return None

    def _rising(self) -> bool:
        """Whether the parameter last went towards the end of the range."""
        return len(self.rows) < 2 or (self.rows[-1][1] - self.rows[-2][1]) * self.sign >= 0

    def _taken(self, before: _Point, point: _Point, step: float) -> Ending | None:
        """Keep a point, with the fold or the end of the range before it; how the curve ends, if it does."""
        if before.tangent[-1] * point.tangent[-1] < 0:
            fold = self._fold(before, point, step)
            if fold is not None:
                self._keep(fold)
        place = point.y[-1] * self.arc.p_unit
        for end, ending, side in ((self.stop, Ending.COMPLETE, 1), (self.start, Ending.LEFT, -1)):
            if side * self.sign * (place - end) >= 0:
                last = self._landed(before, point, end)
                if last is None:
                    return Ending.STEP
                self._keep(last)
                return ending
        self._keep(point)
        return Ending.POINTS if len(self.rows) >= self.controls.max_points else None

    def _landed(self, before: _Point, point: _Point, end: float) -> _Point | None:
        """The point at an end of the range, between two others."""
        share = (end / self.arc.p_unit - before.y[-1]) / (point.y[-1] - before.y[-1])
        guess = before.y + share * (point.y - before.y)
        guess[-1] = end / self.arc.p_unit
        try:
            return self.arc.settled(guess, self._ahead(guess.size))
        except _FailureError:
            return None

    def _fold(self, before: _Point, point: _Point, step: float) -> _Point | None:
        """Where the tangent's share of the parameter vanishes on the arc between two points."""
        found: dict[float, _Point] = {}

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
        except _FailureError:
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


# Share of the parameter in the tangent at which a fold counts as met: its own error is of second order in it.
FLAT = 1e-5
MAX_BISECTIONS = 40


def _predicted(point: _Point, before: tuple[_Point, float] | None, step: float) -> Array:
    """Along the tangent, and its turn since the point before."""
    if before is None:
        return point.y + step * point.tangent
    last, length = before
    return point.y + step * point.tangent + (step**2 / (2 * length)) * (point.tangent - last.tangent)
