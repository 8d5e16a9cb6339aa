"""A solution of ``r(x, p) = 0`` at one place of the parameter, by Newton's method on the plane across its axis."""

from collections.abc import Callable

import numpy as np

from timesim.hbm.continuation.bordered import Array
from timesim.hbm.continuation.corrector import Corrector, CurvePoint
from timesim.hbm.continuation.residual import NoSolutionError, Residual
from timesim.hbm.scheme import Controls


def solve(residual: Residual, guess: Array, p: float, controls: Controls) -> tuple[Array, int] | None:
    """Solution near a guess at one value of the parameter, and the sign of det dr/dx; None if Newton's method fails."""
    return _solved(Corrector.damped_newton, residual, guess, p, controls)


def solve_near(residual: Residual, guess: Array, p: float, controls: Controls) -> tuple[Array, int] | None:
    """The same from a good guess, beside which derivatives are kept as long as that converges."""
    return _solved(Corrector.newton_near, residual, guess, p, controls)


def _solved(
    newton: Callable[[Corrector, Array, Array], CurvePoint],
    residual: Residual,
    guess: Array,
    p: float,
    controls: Controls,
) -> tuple[Array, int] | None:
    corrector = Corrector(residual, controls, abs(p) or 1.0, guess)
    try:
        point = newton(corrector, corrector.in_units(guess, p), np.append(np.zeros(guess.size), 1.0))
    except NoSolutionError:
        return None
    return corrector.unscaled(point.y)[0], point.determinant
