"""Newton's method on a plane across a curve of solutions: a point and the tangent there.

The part of `timesim.hbm.continuation` that finds one point. Both x and p are measured in units.
"""

from dataclasses import dataclass
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


@dataclass(frozen=True)
class Point:
    """A solution y = (x, p) in units, its unit tangent, and how it was found."""

    y: Array
    tangent: Array
    determinant: int
    corrections: int
    fold: bool = False


class FailureError(Exception):
    """Newton's method did not converge."""


class Arc:
    """The residual in units: y = (x / x_unit, p / p_unit)."""

    def __init__(self, residual: Residual, controls: Controls, p_unit: float):
        self.residual, self.controls, self.p_unit = residual, controls, p_unit
        self.x_unit = controls.size

    def resized(self, point: Point) -> Point:
        """The point, measured by its own size."""
        x = point.y[:-1] * self.x_unit
        tangent = np.append(point.tangent[:-1] * self.x_unit, point.tangent[-1])
        self.x_unit = max(self.controls.size, float(np.linalg.norm(x)))
        tangent[:-1] /= self.x_unit
        y = np.append(x / self.x_unit, point.y[-1])
        return Point(y, tangent / np.linalg.norm(tangent), point.determinant, point.corrections, point.fold)

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
            raise FailureError
        return r, matrix

    def corrected(self, guess: Array, border: Array, *, exact: bool = False) -> Point:
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
                return Point(y, *_direction(factors), count)
            step = lu_solve(factors, np.append(-r / self.x_unit, border @ (guess - y)), check_finite=False)
            size = float(np.linalg.norm(step))
            if not np.isfinite(size) or size > 2 * before:
                break
            y, before, stale = y + step, size, size > CHORD * before
        raise FailureError

    def forced(self, guess: Array, border: Array) -> Point:
        """The same where the residual is hardly smooth: derivatives anew each time, and patience with detours."""
        y = guess
        for count in range(MAX_FORCED):
            r, matrix = self.bordered(y, border)
            factors = _factorised(matrix)
            if self.small(r, y):
                return Point(y, *_direction(factors), count)
            step = lu_solve(factors, np.append(-r / self.x_unit, border @ (guess - y)), check_finite=False)
            size = float(np.linalg.norm(step))
            if not size < MAX_DETOUR:
                break
            y = y + step
        raise FailureError

    def settled(self, guess: Array, border: Array) -> Point:
        """The same from a poor guess: corrections are halved until the residual falls."""
        try:
            return self._damped(guess, border)
        except FailureError:
            return self.forced(guess, border)

    def _damped(self, guess: Array, border: Array) -> Point:
        y, (r, matrix) = guess, self.bordered(guess, border)
        for count in range(MAX_DAMPED):
            factors = _factorised(matrix)
            if self.small(r, y):
                return Point(y, *_direction(factors), count)
            step = lu_solve(factors, np.append(-r / self.x_unit, 0.0), check_finite=False)
            for share in 0.5 ** np.arange(12):
                tried = self.value(y + share * step)
                if np.linalg.norm(tried) < (1 - 0.1 * share) * np.linalg.norm(r):
                    break
            else:
                raise FailureError
            y = y + share * step
            r, matrix = self.bordered(y, border)
        raise FailureError


# Corrections that fall by less than this ask for new derivatives.
CHORD = 0.1
MAX_DAMPED = 60
MAX_FORCED = 30
# Detour of Newton's method, in units of the solution, that leads nowhere.
MAX_DETOUR = 10.0
Factors = tuple[Array, NDArray[np.int32]]


def _factorised(matrix: Array) -> Factors:
    """LU factors of a bordered matrix.

    Raises:
        FailureError: it is singular.
    """
    factors = lapack.dgetrf(matrix)
    if factors[2] != 0:
        raise FailureError
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
