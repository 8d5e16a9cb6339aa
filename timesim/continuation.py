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

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, lu_factor, lu_solve

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
    min_step: float = 1e-7
    max_step: float = 0.05
    max_points: int = 5000
    tolerance: float = 1e-9
    max_newton: int = 8
    turn: float = 0.12

    def __post_init__(self) -> None:
        if not self.size > 0 or not self.tolerance > 0:
            raise ValueError(
                f"continuation: size and tolerance must be positive, not {self.size} and {self.tolerance}"
            )
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


class _Failure(Exception):
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

    def bordered(self, y: Array, border: Array) -> tuple[Array, Array]:
        """r / x_unit, and its matrix of derivatives with `border` as the last row."""
        r, by_x, by_p = self.residual.linearised(y[:-1] * self.x_unit, y[-1] * self.p_unit)
        matrix = np.empty((y.size, y.size))
        matrix[:-1, :-1] = by_x
        matrix[:-1, -1] = by_p * self.p_unit / self.x_unit
        matrix[-1] = border
        return r, matrix

    def corrected(self, guess: Array, border: Array) -> _Point:
        """Solution on the plane through the guess with normal `border`, and its tangent, on the side of `border`."""
        y, before = guess, np.inf
        for count in range(self.controls.max_newton + 1):
            r, matrix = self.bordered(y, border)
            if not np.isfinite(r).all() or not np.isfinite(matrix).all():
                break
            try:
                factors = lu_factor(matrix, check_finite=False)
            except LinAlgError:
                break
            if self.small(r, y):
                return _Point(y, self._tangent(factors, matrix), _sign(factors, matrix), count)
            step = lu_solve(factors, np.append(-r / self.x_unit, border @ (guess - y)), check_finite=False)
            size = float(np.linalg.norm(step))
            if not np.isfinite(size) or size > 4 * before:
                break
            y, before = y + step, size
        raise _Failure

