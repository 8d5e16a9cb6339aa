"""Recognition of the period of a motion from its state vectors at the ends of consecutive cycles.

A motion has settled when its distance from the limit is below the tolerance, extrapolated from the rate at which the
change from cycle to cycle falls: a slow drift changes little in a cycle and is yet far from its limit. Motions of
period two or three, as after a period doubling, are distinguished from vibrations that nearly repeat while they decay.
"""

import numpy as np

from timesim.orbit.extrapolation import remaining
from timesim.orbit.threshold import CYCLES_A_ROUND, DOUBLED, LEADS_NOWHERE, PERIODS, REST, STILL_THERE

HALF = CYCLES_A_ROUND // 2


def period_of(returns: np.ndarray, tolerance: float, noise: float = 0.0) -> int:
    """Period [cycles] after which the state repeats to the tolerance, extrapolated; 0 if it does not.

    Args:
        returns: the state at the end of consecutive cycles, shape (N, state).
        tolerance: relative to the largest entry.
        noise: tolerance of a step. Changes below it that go to and fro and lead nowhere are those of the step control.
    """
    size = np.max(np.abs(returns), initial=0.0)
    if size == 0:
        return 1
    latest = [np.abs(returns[-1] - returns[-1 - period]).max() for period in PERIODS if period < len(returns)]
    if min(latest, default=0.0) > max(tolerance, noise, REST) * size:
        return 0  # as in most rounds
    for period in PERIODS:
        change = _changes(returns, period) / size
        if change.size < CYCLES_A_ROUND:
            continue
        before, last = _by_halves(change)
        ratio = (last / before) ** (1 / HALF) if before > 0 else 0.0
        if last < noise and len(returns) == 2 * CYCLES_A_ROUND:
            led = np.max(np.abs(returns[-1] - returns[(len(returns) - 1) % period])) / size
            ratio = 0.0 if max(led, before) < LEADS_NOWHERE * last else ratio
            tolerance = max(tolerance, noise) if ratio == 0 else tolerance
        if last < REST or (last < tolerance and remaining(last, ratio) < tolerance):
            earlier, now = _by_halves(_changes(returns, 1) / size)
            if period == 1 or now < tolerance:
                return 1
            if now > DOUBLED * tolerance and now > STILL_THERE * earlier:
                return period
    return 0


def _changes(returns: np.ndarray, period: int) -> np.ndarray:
    """Largest change of an entry over a period, from each cycle on."""
    return np.max(np.abs(returns[period:] - returns[:-period]), axis=1)


def _by_halves(change: np.ndarray) -> tuple[float, float]:
    """Largest change in both halves of the last round."""
    return np.max(change[-2 * HALF : -HALF]), np.max(change[-HALF:])
