"""A solution of ``r(x, p) = 0`` at one place of the parameter, by Newton's method on the plane across its axis."""

import numpy as np

from timesim.hbm.continuation.bordered import Array
from timesim.hbm.continuation.corrector import Corrector
from timesim.hbm.continuation.residual import NoSolutionError, Residual
from timesim.hbm.scheme import Controls


def solve(
    residual: Residual, guess: Array, p: float, controls: Controls, *, near: bool = False
) -> tuple[Array, int] | None:
    """Solution near a guess at one value of the parameter, and the sign of det dr/dx; None if Newton's method fails.

    ``near``: the guess is good; beside it derivatives are kept as long as that converges.
    """
    corrector = Corrector(residual, controls, abs(p) or 1.0, guess)
    newton = corrector.newton_near if near else corrector.damped_newton
    try:
        point = newton(corrector.in_units(guess, p), np.append(np.zeros(guess.size), 1.0))
    except NoSolutionError:
        return None
    return corrector.unscaled(point.y)[0], point.determinant
