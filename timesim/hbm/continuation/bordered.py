"""Derivatives of a residual by its unknowns, bordered by a column and a row, with which Newton's method steps.

Where most unknowns follow from a few, the equations are those of the few: `Condensation`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, lu_solve

from timesim.hbm.condensation import Condensation

Array = NDArray[np.float64]
# Share of the parameter in the tangent, each relative to its own size, below which neighbours are not those at the same
# parameter: beside folds there are none. At the peak of a structure with 1 % damping it is 0.01.
STEEPEST = 0.01


class Whole:
    """As `Condensation`, of a matrix: no unknown follows from others."""

    sign = 1

    def __init__(self, matrix: Array):
        self.matrix = matrix
        self.inner, self.outer = np.arange(len(matrix)), np.zeros(0, dtype=np.intp)

    def solve(self, r: Array) -> Array:
        return r

    def others(self, x: Array) -> Array:
        return np.zeros(0)

    def on_others(self, row: Array) -> Array:
        return np.zeros(len(self.inner))


class Bordered:
    """LU factors of the derivatives by the unknowns and a parameter, with one more row."""

    def __init__(self, by_x: Array | Condensation, by_p: Array, row: Array):
        """From the derivatives by the unknowns and by the parameter, shape (n,), and the row, shape (n + 1,).

        Raises:
            numpy.linalg.LinAlgError: they are singular, or not finite.
        """
        self.by_x: Condensation | Whole = Whole(by_x) if isinstance(by_x, np.ndarray) else by_x
        inner, outer = self.by_x.inner, self.by_x.outer
        self.column, self.row = self.by_x.solve(by_p), row
        matrix = np.empty((inner.size + 1,) * 2)
        matrix[:-1, :-1] = self.by_x.matrix
        matrix[:-1, -1] = self.column[inner]
        matrix[-1, :-1] = row[inner] + self.by_x.on_others(row[outer])
        matrix[-1, -1] = row[-1] - row[outer] @ self.column[outer]
        if not np.isfinite(matrix).all():
            raise np.linalg.LinAlgError("not finite")
        self.lu, self.pivots, singular = lapack.dgetrf(matrix)
        if singular:
            raise np.linalg.LinAlgError("singular")

    def solve(self, r: Array, last: float) -> Array:
        """Solution y, shape (n + 1,), for the right sides of the equations, shape (n,), and of the row."""
        inner, outer = self.by_x.inner, self.by_x.outer
        right = self.by_x.solve(r)
        of_few = np.append(right[inner], last - self.row[outer] @ right[outer])
        few = lu_solve((self.lu, self.pivots), of_few, check_finite=False)
        y = np.empty(self.row.size)
        y[inner], y[-1] = few[:-1], few[-1]
        y[outer] = right[outer] - few[-1] * self.column[outer] + self.by_x.others(few[:-1])
        return y

    def tangent(self) -> tuple[Array, int]:
        """Unit tangent, and the sign of det dr/dx: t_p is its ratio to the determinant of the bordered matrix."""
        tangent = self.solve(np.zeros(self.row.size - 1), 1.0)
        swapped = self.pivots != np.arange(self.pivots.size)
        num_negative = np.count_nonzero(np.diag(self.lu) < 0) + np.count_nonzero(swapped)
        sign = self.by_x.sign * int(np.sign(tangent[-1])) * (-1) ** int(num_negative)
        return tangent / np.linalg.norm(tangent), sign


@dataclass(frozen=True)
class Nearby:
    """Solutions of slightly other equations beside one, to first order.

    Attributes:
        factors: by the unknowns and the parameter in their units, about the solution.
        x_unit, p_unit: these units.
        p: the parameter.
    """

    factors: Bordered
    x_unit: float
    p_unit: float
    p: float

    def change(self, r: Array) -> Array:
        """Change of the unknowns, shape (n,), where the equations leave r: at the same parameter but beside folds."""
        step, tangent = self.factors.solve(-r / self.x_unit, 0.0), self.factors.tangent()[0]
        across = step - (step @ tangent) * tangent
        flattest = STEEPEST * abs(self.p) / self.p_unit * float(np.linalg.norm(tangent[:-1]))
        along = -across[-1] * np.sign(tangent[-1]) / max(abs(tangent[-1]), flattest, 1e-300)
        return (across + along * tangent)[:-1] * self.x_unit
