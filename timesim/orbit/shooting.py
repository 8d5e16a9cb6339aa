"""Shooting: Newton's method on the state after a period [1]_, with the exact derivative of `monodromy`.

An iteration is one recorded cycle. Newton's method is given up where it does not converge at once and where it leaves
the contact states, and an unstable motion is refused: so it converges to the motions to which marching would lead.

.. [1] H. B. Keller, *Numerical Methods for Two-Point Boundary-Value Problems*, Blaisdell (1968).
"""

import enum
from dataclasses import dataclass

import numpy as np

from timesim.orbit.lane import Lane, Recorded
from timesim.orbit.threshold import REACH, TAKES_OVER, UNSTABLE


class Outcome(enum.Enum):
    """How an iteration ends."""

    CONVERGED = enum.auto()
    UNSTABLE = enum.auto()
    ASTRAY = enum.auto()


@dataclass(frozen=True)
class Shot:
    """An iterate of Newton's method.

    Attributes:
        lane: from where the next cycle is shot.
        residual: change over the cycle before, relative to the state.
    """

    lane: Lane
    residual: float = np.inf


def iterated(shot: Shot, recorded: Recorded, tolerance: float) -> Shot | Outcome:
    """An iteration of Newton's method: the next iterate, or how the iteration ends.

    Args:
        shot: the iterate.
        recorded: the cycle from it.
        tolerance: of the step to the next iterate, relative to the state.
    """
    here, end = shot.lane.vector, recorded.end
    if not recorded.complete or not np.array_equal(end.here.state, shot.lane.here.state):
        return Outcome.ASTRAY
    step, size = recorded.newton_step(), max(_largest(here), 1e-300)
    if _largest(step) < tolerance * size:
        unstable = np.max(np.abs(recorded.multipliers), initial=0.0) > UNSTABLE
        return Outcome.UNSTABLE if unstable else Outcome.CONVERGED
    residual = _largest(end.vector - here) / size
    takes_over = residual < TAKES_OVER * shot.residual and _largest(step) / size < REACH
    moved = shot.lane.moved(here + step) if takes_over else None
    return Outcome.ASTRAY if moved is None else Shot(moved, residual)


def _largest(vector: np.ndarray) -> float:
    return float(np.max(np.abs(vector), initial=0.0))
