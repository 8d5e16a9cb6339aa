"""Harmonic balance at one frequency along any scalar of the scene.

The model is built anew at each value. The derivative by the scalar is a difference of second order: it only directs the
steps of the continuation, and the solutions do not depend on it.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from timesim.hbm.balance import Array, Balance
from timesim.hbm.continuation import Controls, Ending, follow
from timesim.hbm.curve import HbmCurve, contact_motion, default_controls, described, first_guesses
from timesim.hbm.setting import Setting
from timesim.model.model import Model
from timesim.model.scales import scales_of

# Difference of the scalar for its derivative, as a share of the range.
DIFFERENCE = 1e-5


class AlongBalance:
    """The balance at one frequency as a residual in a scalar p; the unknowns are those of `Balance`.

    Beyond the range, where there may be no model, it goes on straight.
    """

    def __init__(self, model_at: Callable[[float], Model], frequency: float, setting: Setting, ends: Array):
        self.model_at, self.frequency, self.setting = model_at, frequency, setting
        self.low, self.high = float(ends.min()), float(ends.max())
        self.units = scales_of(model_at(float(ends[0])), frequency)
        self.balance = lru_cache(maxsize=8)(self._balance)

    def _balance(self, p: float) -> Balance:
        return Balance(self.model_at(p), self.frequency, self.setting, self.units)

    def value(self, x: Array, p: float) -> Array:
        """r in units of length."""
        inside = min(max(p, self.low), self.high)
        r = self.balance(inside).value(x, self.frequency)
        return r if inside == p else r + (p - inside) * self._slope(x, inside)

    def linearised(self, x: Array, p: float) -> tuple[Array, Array, Array]:
        """r, and its derivatives by the unknowns and by the scalar."""
        inside = min(max(p, self.low), self.high)
        r, by_x, _ = self.balance(inside).linearised(x, self.frequency)
        slope = self._slope(x, inside)
        return r + (p - inside) * slope, by_x, slope

    def _slope(self, x: Array, p: float) -> Array:
        step = DIFFERENCE * (self.high - self.low)
        middle = min(max(p, self.low + step), self.high - step)
        low, here, high = (self.balance(q).value(x, self.frequency) for q in (middle - step, middle, middle + step))
        return (high - low) / (2 * step) + (high - 2 * here + low) * ((p - middle) / step**2)


def hbm_along(
    model_at: Callable[[float], Model],
    frequency: float,
    start: float,
    stop: float,
    *,
    setting: Setting | None = None,
    controls: Controls | None = None,
    guess: Array | None = None,
    stability: bool = True,
) -> HbmCurve:
    """Follow the periodic response at one frequency through a range of a scalar, around folds.

    Args:
        model_at: the model for a value of the scalar.
        frequency: of the excitation [Hz].
        start, stop: range of the scalar; the curve begins at `start`.

    Keyword Args:
        setting, controls, guess, stability: as in `timesim.hbm.curve.hbm_curve`.

    Returns:
        The curve; its `parameter` is the scalar.

    Raises:
        ValueError: the range, the setting or the excitation does not allow a balance.
    """
    residual = AlongBalance(model_at, frequency, setting or Setting(), np.array([start, stop]))
    controls, balance = controls or default_controls(), residual.balance(start)
    guesses = [contact_motion(balance, guess)] if guess is not None else first_guesses(balance, frequency, controls)
    for first in guesses:
        curve = follow(residual, first, start, stop, controls)
        if curve.ending is not Ending.START:
            break
    rows = [
        described(residual.balance(float(p)), curve.point(i, frequency), stability=stability)
        for i, p in enumerate(curve.p)
    ]
    if not rows:
        return described(balance, curve, stability=False)
    return replace(HbmCurve.joined(rows), parameter=curve.p)
