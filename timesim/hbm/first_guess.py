"""Guesses for the first solution of a curve."""

from collections.abc import Callable, Iterator

import numpy as np

from timesim.hbm.balance import Array, Balance, contact_stiffness
from timesim.hbm.continuation import Controls, Curve, Ending, follow
from timesim.orbit.fourier import to_coefficients


def unknowns_of_modes(balance: Balance, modal: Array) -> Array:
    """Unknowns of a balance from modal Fourier coefficients 1, cos, sin, ..., shape (2K + 1, M)."""
    num_modes = balance.model.structure.num_modes
    if modal.ndim != 2 or modal.shape[0] % 2 == 0 or modal.shape[1] != num_modes:
        raise ValueError(
            "hbm: the guess must hold 1, cos, sin, ... of each mode, an odd number of rows and "
            f"{num_modes} columns, not shape {modal.shape}"
        )
    kept = np.zeros((balance.size, num_modes))
    kept[: len(modal)] = modal[: balance.size]
    shape = balance.model.contact_shape.reshape(3 * balance.num_contacts, -1)
    return np.asarray((shape @ kept.T).ravel() / balance.length)


def curve_near(
    balance: Balance, frequency: float, controls: Controls, guess: Array | None, followed: Callable[[Array], Curve]
) -> Curve:
    """The curve through a solution near a modal guess, or else near the first of `first_guesses` that leads to one."""
    guesses = first_guesses(balance, frequency, controls) if guess is None else [unknowns_of_modes(balance, guess)]
    for first in guesses:
        curve = followed(first)
        if curve.ending is not Ending.START:
            break
    return curve


def first_guesses(balance: Balance, frequency: float, controls: Controls) -> Iterator[Array]:
    """Linear responses with each contact stuck or absent; the last guess is reached under a load that grows from 0."""
    closed = np.array([contact.preload > 0 for contact in balance.model.contacts], dtype=float)
    for stuck in (closed, np.ones_like(closed), np.zeros_like(closed), closed / 2):
        yield _linear_guess(balance, frequency, stuck)
    ramp = follow(_LoadRamp(balance, frequency), np.zeros(balance.num_unknowns), 0.0, 1.0, controls)
    if ramp.complete:
        yield ramp.x[-1]


def _linear_guess(balance: Balance, frequency: float, stuck: Array) -> Array:
    """Linear response with each contact stuck (1), absent (0) or in between."""
    linear, stiffness = balance.linear(frequency), contact_stiffness(balance.model, stuck)
    matrix = np.eye(len(stiffness)) + linear.flexibility @ (stiffness - balance.support)
    try:
        motion = np.linalg.solve(matrix, linear.free[..., None])[..., 0]
    except np.linalg.LinAlgError:
        motion = np.zeros_like(linear.free)
    return np.nan_to_num(to_coefficients(motion.T).ravel() / balance.length, posinf=0.0, neginf=0.0)


class _LoadRamp:
    """A balance at one frequency as a residual in the share p of its excitation."""

    def __init__(self, balance: Balance, frequency: float):
        self.balance, self.frequency = balance, frequency
        self.free = to_coefficients(balance.linear(frequency).free.T).ravel() / balance.length

    def value(self, x: Array, p: float) -> Array:
        return self.balance.value(x, self.frequency) + (1 - p) * self.free

    def linearised(self, x: Array, p: float) -> tuple[Array, Array, Array]:
        r, by_x, _ = self.balance.linearised(x, self.frequency)
        return r + (1 - p) * self.free, by_x, -self.free
