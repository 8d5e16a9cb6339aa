"""Shares of a period that contacts spend in a state, and what they say of the motion."""

from typing import Any, TypeVar

import numpy as np

Shares = TypeVar("Shares", bound=Any)
"""An array of numpy or of xarray."""

# A visit to a state that lasts for a smaller share of the period is not one: a transition itself is located to 1e-8 of
# the fastest oscillation, and what a visit this short does to a motion is far below any tolerance.
BRIEF = 1e-9


def share(duration: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Share of the time spent within a state: exactly 0 or 1 where it never changes.

    Args:
        duration: of each step, shape (N,).
        within: whether each contact is in the state during each step, shape (N, C).

    Returns:
        shares, shape (C,).
    """
    part = duration @ within / duration.sum()
    return np.where(within.all(axis=0), 1.0, np.minimum(part, 1.0))


def switches(slip_share: Shares, separation_share: Shares) -> Shares:
    """Whether each contact slips, or is open for a part of the period; where none does the motion is linear."""
    return (slip_share > BRIEF) | ((separation_share > BRIEF) & (separation_share < 1 - BRIEF))
