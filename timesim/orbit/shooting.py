"""Shooting: Newton's method on the state after a period [1]_, with the exact derivative of `monodromy`.

An iteration is one recorded period. A step that does not lead closer is shortened, where closeness is measured by the
step that would follow with the derivative of the iterate before: the natural test of Deuflhard [2]_. It is not misled
by a slow decay, which makes the change over a period small far away from the fixed point. The offset of a contact that
sticks all along stays as it is. That a body slides on evenly is no matter, as the place where it is alters no force.

An unstable motion is refused, and what was found from where disturbances grow and the motion nearly repeats: there a
march moves away from what Newton's method steps to, slowly and to one motion. What moves fast may come to any.

A cycle is known to the tolerance of its steps, and the fixed point only to that error times what a slow decay makes of
it: 1 / (2 pi zeta), 300 at a damping ratio of 5e-4. Where the iteration comes to rest at that noise, the cycles that
follow are integrated with a finer tolerance; where that does not help, the motion has settled to what was reached.

.. [1] H. B. Keller, *Numerical Methods for Two-Point Boundary-Value Problems*, Blaisdell (1968).
.. [2] P. Deuflhard, *Newton Methods for Nonlinear Problems*, Springer (2004), section 3.3.
"""

import enum
from dataclasses import dataclass, replace

import numpy as np

from timesim.orbit import threshold
from timesim.orbit.lane import Lane, Recorded, largest


class Failure(enum.Enum):
    """How an iteration fails."""

    UNSTABLE = enum.auto()
    ASTRAY = enum.auto()


@dataclass(frozen=True)
class Converged:
    """The end of an iteration: how far from the fixed point it still is, relative to the state."""

    settled_to: float


@dataclass(frozen=True)
class Shot:
    """An iterate of Newton's method.

    Attributes:
        lane: from where the next period is shot.
        period: in cycles.
        held: whether it is the steady state in closed form while no contact leaves its state.
        before: the period shot from the iterate before; None at the first.
        share: of the step from there that has led here.
        count: of the iterations before.
        nearest: shortest step, relative to the state, that any of them has left.
        idle: iterations since one has left a clearly shorter step than all before.
        leaves: whether it began where a march moves away, slowly.
    """

    lane: Lane
    period: int = 1
    held: bool = False
    before: Recorded | None = None
    share: float = 1.0
    count: int = 0
    nearest: float = np.inf
    idle: int = 0
    leaves: bool = False

    @property
    def in_vain(self) -> bool:
        """Whether it has gone on for too long, or come no nearer for too long."""
        most = max(threshold.FEW_IDLE, threshold.MOST_IDLE / self.period)
        return self.count >= threshold.MOST_SHOTS or self.idle >= most


def iterated(shot: Shot, recorded: Recorded, tolerance: float) -> Shot | Converged | Failure:
    """An iteration of Newton's method, by the period from an iterate: the next iterate, or how the iteration ends.

    ``tolerance``: of the step to the next iterate, relative to the state.
    """
    if shot.held:
        return Converged(0.0) if recorded.is_held else Failure.ASTRAY
    if not recorded.closes:
        return _shorter(_compared(shot, np.inf))
    step, size = recorded.newton_step(recorded.change), shot.lane.size
    left, change = largest(step) / size, largest(recorded.change - recorded.drift) / size
    if shot.count == 0 and change < threshold.NEARLY_REPEATS and recorded.is_unstable:
        shot = replace(shot, leaves=True)
    if left < tolerance:
        return _ended(shot, recorded, left)
    shot = _compared(shot, left)
    closer, rtol = _led_closer(shot, recorded), float(shot.lane.control.rtol)
    noisy = shot.before is not None and closer > threshold.QUICK and change < threshold.NOISY * rtol
    if noisy and rtol > threshold.FINEST:
        finer = max(threshold.FINEST, min(threshold.FINER * rtol, threshold.FINER * tolerance * change / left))
        return _counted(replace(shot, lane=shot.lane.within(finer), before=None, idle=0))
    if noisy:
        return _ended(shot, recorded, left) if left < threshold.VAGUE else Failure.ASTRAY
    if closer > 1 - shot.share / 4:
        return _shorter(shot)
    return _moved(replace(shot, before=recorded, share=min(1.0, threshold.REACH / left)), step)


def _led_closer(shot: Shot, recorded: Recorded) -> float:
    """Distance from the fixed point as a share of that before the step to the iterate; 0 at the first.

    By the derivative before or after the step, whichever shows it nearer: a contact may have closed in between.
    """
    if shot.before is None:
        return 0.0
    step, follows = (shot.before.newton_step(one.change) for one in (shot.before, recorded))
    nearer = min(largest(follows), largest(recorded.newton_step(recorded.change)))
    return nearer / max(largest(step), 1e-300)


def _shorter(shot: Shot) -> Shot | Failure:
    """A shorter step from the iterate before."""
    if shot.before is None:
        return Failure.ASTRAY
    return _moved(replace(shot, share=threshold.SHORTER * shot.share), shot.before.newton_step(shot.before.change))


def _moved(shot: Shot, step: np.ndarray) -> Shot | Failure:
    """A share of the step from the iterate before, a smaller one where the contacts do not allow it."""
    assert shot.before is not None
    share, start = shot.share, shot.before.start
    while share >= threshold.SHORTEST_SHARE:
        lane = start.moved(start.vector + share * step)
        if lane is not None:
            return _counted(replace(shot, lane=lane, share=share))
        share *= threshold.SHORTER
    return Failure.ASTRAY


def _compared(shot: Shot, left: float) -> Shot:
    """An iterate that leaves a step of some size, relative to the state, beside those before."""
    if left < threshold.CLEARLY_NEARER * shot.nearest:
        return replace(shot, nearest=left, idle=0)
    return replace(shot, idle=shot.idle + 1)


def _counted(shot: Shot) -> Shot | Failure:
    return Failure.ASTRAY if shot.in_vain else replace(shot, count=shot.count + 1)


def _ended(shot: Shot, recorded: Recorded, left: float) -> Shot | Converged | Failure:
    """The end of an iteration; a motion that repeats within the period is shot once more, over its own."""
    near, end = threshold.VAGUE * shot.lane.size, recorded.returns[-1]
    repeats = [largest(vector - end) < near for vector in recorded.returns]
    period = next(n for n, repeated in enumerate(repeats, 1) if repeated and shot.period % n == 0)
    if period < shot.period:
        return Shot(shot.lane, period, leaves=shot.leaves)
    if recorded.is_unstable:
        return Failure.UNSTABLE
    return Failure.ASTRAY if recorded.strays or shot.leaves else Converged(left)
