"""Limits of slowly converging sequences, extrapolated from their last terms.

Changes that fall by a ratio r from term to term still add up to r / (1 - r) times the last one: Aitken's extrapolation
[1]_. If they fall like a power of the index, as where a contact creeps towards full stick, the ratio itself rises by
q (1 - r)^2 a term, and the sum is larger by a factor 1 / (1 - q).

.. [1] A. C. Aitken, On Bernoulli's numerical solution of algebraic equations, Proceedings of the Royal Society of
   Edinburgh 46 (1926) 289-305.
"""

from typing import Any

import numpy as np

ALIGNED = 0.1  # share of a change across the change before it, up to which both have one direction
SLOW = 0.2  # ratio from which a limit gains more than a term of the sequence does
STEADY = 0.2  # change of the ratio, as a share of 1 - r, up to which it is taken for constant or slowly rising
CREEP = (0.4, 0.8)  # least and largest q: less is a ratio that is constant but for rounding


def remaining(change: Any, ratio: Any) -> Any:
    """Sum of all changes after the given one, if each is `ratio` times the one before; infinite if ratio >= 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(ratio < 1, change * ratio / (1 - ratio), np.inf)


def limits(terms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Limits of sequences of vectors by their last four terms, shape (N, 4, K).

    Returns the limits, shape (N, K), and which sequences have one, shape (N,).
    """
    first, second, third = np.moveaxis(np.diff(terms, axis=1), 1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        before = np.sum(second * first, axis=1) / np.sum(first * first, axis=1)
        ratio = np.sum(third * second, axis=1) / np.sum(second * second, axis=1)
        across = np.linalg.norm(third - ratio[:, None] * second, axis=1)
        aligned = across <= ALIGNED * np.linalg.norm(third, axis=1)
        leads = aligned & (ratio > SLOW) & (ratio < 1) & (np.abs(ratio - before) <= STEADY * (1 - ratio))
        rise = np.minimum((ratio - before) / (1 - ratio) ** 2, CREEP[1])
        rise = np.where(rise > CREEP[0], rise, 0.0)
        far = third * (ratio / (1 - ratio) / (1 - rise))[:, None]
    return np.where(leads[:, None], terms[:, -1] + far, 0.0), leads
