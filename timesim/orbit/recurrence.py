"""Recognition of the period of a motion from its state vectors at the ends of consecutive cycles.

A motion has settled when its distance from the limit is below the tolerance, extrapolated from the rate at which the
change from cycle to cycle falls: a slow drift changes little in a cycle and is yet far from its limit. Motions of
period two to four, as after a period doubling, are distinguished from vibrations that nearly repeat while they decay.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from timesim.orbit import threshold
from timesim.orbit.extrapolation import remaining

HALF = threshold.CYCLES_A_ROUND // 2


@dataclass(frozen=True)
class Recurrence:
    """How nearly a motion repeats.

    Attributes:
        period: [cycles] after which the state repeats to the tolerance; 0 if it does not.
        left: estimated distance from the limit relative to the largest entry; where the motion does not repeat, the
            least change over a period.
    """

    period: int
    left: float


def recurrence_of(returns: np.ndarray, tolerance: float, noise: float = 0.0) -> Recurrence:
    """Period after which the state repeats to the tolerance, extrapolated.

    Args:
        returns: the state at the end of consecutive cycles, shape (N, state).
        tolerance: relative to the largest entry.
        noise: tolerance of a step. Changes below it that go to and fro and lead nowhere are those of the step control.
    """
    size = np.max(np.abs(returns), initial=0.0)
    if size == 0:
        return Recurrence(1, 0.0)
    latest = [np.abs(returns[-1] - returns[-1 - period]).max() for period in threshold.PERIODS if period < len(returns)]
    least = min(latest, default=np.inf) / size
    if np.isfinite(least) and least > max(tolerance, noise, threshold.REST):
        return Recurrence(0, least)  # as in most rounds
    for period in threshold.PERIODS:
        change = _changes(returns, period) / size
        if change.size < threshold.CYCLES_A_ROUND:
            continue
        before, last = _by_halves(change)
        ratio = (last / before) ** (1 / HALF) if before > 0 else 0.0
        left = float(remaining(last, ratio))
        if last < noise and len(returns) == 2 * threshold.CYCLES_A_ROUND:
            led = np.max(np.abs(returns[-1] - returns[(len(returns) - 1) % period])) / size
            if max(led, before) < threshold.LEADS_NOWHERE * last:
                left, tolerance = last, max(tolerance, noise)
        left = min(left, last) if last < threshold.REST else left
        if last < threshold.REST or (last < tolerance and left < tolerance):
            own = _own_period(returns / size, period, tolerance)
            if own:
                return Recurrence(own, left)
    return Recurrence(0, least)


def without_way(returns: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """State vectors after consecutive cycles, (N, state), without the way by which a body slides on, if it does.

    ``shifts``: changes of the state that alter no force, orthonormal rows, shape (K, state).
    """
    if not len(shifts):
        return returns
    way = returns @ shifts.T
    within = returns - way @ shifts
    moved = min(np.abs(way[-1] - way[-1 - period]).max() for period in threshold.PERIODS)
    # Of a body that comes to rest, or that a contact holds, its place has to settle as well.
    return within if moved > threshold.VAGUE * np.abs(within).max() else returns


def _own_period(returns: np.ndarray, period: int, tolerance: float) -> int:
    """The shortest divisor of a period over which the state repeats as well; 0 where that is open.

    What alternates while it decays changes less over twice its period than over the period.
    """
    for part in (part for part in range(1, period) if period % part == 0):
        earlier, now = _by_halves(_changes(returns, part))
        if now < tolerance:
            return part
        if not (now > threshold.DOUBLED * tolerance and now > threshold.STILL_THERE * earlier):
            return 0
    return period


def _changes(returns: np.ndarray, period: int) -> np.ndarray:
    """Largest change of an entry over a period, from each cycle on."""
    return np.max(np.abs(returns[period:] - returns[:-period]), axis=1)


def _by_halves(change: np.ndarray) -> tuple[float, float]:
    """Largest change in both halves of the last round."""
    return np.max(change[-2 * HALF : -HALF]), np.max(change[-HALF:])


def nearest_period(returns: np.ndarray, longest: int = threshold.CYCLES_A_ROUND, tolerance: float = 0.0) -> Recurrence:
    """The shortest period over which the state changes little more than over that of the least change.

    Args:
        returns: the state at the end of consecutive cycles, shape (N, state).
        longest: period [cycles] to be looked at; of a short march, that over which its last cycles show a change.
        tolerance: change that counts as none, relative to the largest entry.
    """
    longest = min(longest, len(returns) - HALF)
    size = max(np.max(np.abs(returns)), 1e-300)
    change = np.array([_changes(returns, period)[-HALF:].max() for period in range(1, longest + 1)]) / size
    place = int(np.argmax(change <= max(threshold.NEARLY_LEAST * max(change.min(), threshold.REST), tolerance)))
    return Recurrence(place + 1, float(change[place]))


def is_irregular(changes: Sequence[float], decay: float, noise: float) -> bool:
    """Whether a motion has shown that it does not repeat: its change does not fall where free vibrations decay.

    Args:
        changes: least change over a period, after each round.
        decay: slowest decay of a free vibration, of its logarithm a cycle.
        noise: change that the steps may leave of a motion that repeats.
    """
    quarter = len(changes) // 4
    if not quarter or decay * threshold.CYCLES_A_ROUND * len(changes) < threshold.DECAYED:
        return False
    late = float(np.median(changes[-quarter:]))
    # What finds its way late falls until the middle; from there on the changes of a contact that creeps are slow too.
    for begin, share in ((quarter, 2), (2 * quarter, 8)):
        early = float(np.median(changes[begin : begin + quarter]))
        due = decay * threshold.CYCLES_A_ROUND * (len(changes) - quarter - begin)
        least = min(due, 2 * threshold.CLEARLY) / share
        # What grows leaves an unstable motion, and may come to one that repeats.
        stays = late > max(threshold.VAGUE, noise) and -threshold.CLEARLY < np.log(early / late) < least
        if due > threshold.CLEARLY and stays:
            return True
    return False
