"""Harmonic balance at one frequency, followed in any scalar of the scene.

The model is built anew at each value. The derivative by the scalar is a difference of second order: it only directs the
steps of the continuation, and the solutions do not depend on it. Steps are to show resonances that contacts hardly feel
(`timesim.hbm.hidden`), by how fast the scalar moves them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from timesim.hbm.adaptive import AdaptiveBalance
from timesim.hbm.balance import Array, Balance, units_of
from timesim.hbm.condensation import Condensation
from timesim.hbm.continuation import Controls, Curve, follow, joined, part_of
from timesim.hbm.curve import HbmCurve, Watch, evaluated, finished, watched
from timesim.hbm.first_guess import curve_near
from timesim.hbm.hidden import SHARE, Hidden
from timesim.hbm.scheme import Scheme
from timesim.model.model import Model

# Difference of the scalar for its derivative, as a share of the range, of which the contacts may work in a small part:
# with 1e-5 a curve over preloads from -200 to 200, where slip begins at 1.4, takes more than 1,000 steps there.
DIFFERENCE = 1e-7


class ParameterBalance:
    """The balance at one frequency as a residual in a scalar p; the unknowns are those of `Balance`.

    Beyond the range, where there may be no model, it is extrapolated straight.
    """

    def __init__(self, model_at: Callable[[float], Model], frequency: float, scheme: Scheme, ends: tuple[float, float]):
        self.model_at, self.frequency, self.scheme = model_at, frequency, scheme
        self.low, self.high = sorted(map(float, ends))
        self.units = units_of(model_at(ends[0]), frequency)
        self.at = lru_cache(maxsize=8)(self._balance)

    def _balance(self, p: float) -> Balance:
        return Balance(self.model_at(min(max(p, self.low), self.high)), self.frequency, self.scheme, self.units)

    def frequency_at(self, p: float) -> float:
        """Frequency of the excitation [Hz]."""
        return self.frequency

    def value(self, x: Array, p: float) -> Array:
        """r in units of length."""
        inside = min(max(p, self.low), self.high)
        r = self.at(inside).value(x, self.frequency)
        return r if inside == p else r + (p - inside) * self._slope(x, inside)

    def linearised(self, x: Array, p: float) -> tuple[Array, Condensation, Array]:
        """r, and its derivatives by the unknowns and by the scalar."""
        inside = min(max(p, self.low), self.high)
        r, by_x, _ = self.at(inside).linearised(x, self.frequency)
        slope = self._slope(x, inside)
        return r + (p - inside) * slope, by_x, slope

    def _slope(self, x: Array, p: float) -> Array:
        first, _, last = around(p, self.low, self.high)
        low, high = (self.at(q).value(x, self.frequency) for q in (first, last))
        return (high - low) / (last - first)


def around(p: float, low: float, high: float) -> tuple[float, float, float]:
    """Values of a scalar in its range for a difference: about p, or next to the end beside it."""
    step = DIFFERENCE * (high - low)
    middle = min(max(p, low + step), high - step)
    return middle - step, middle, middle + step


def steps_to_resolve(
    model_at: Callable[[float], Model], frequency: float, ends: tuple[float, float], balance: AdaptiveBalance
) -> Callable[[float, Array], float]:
    """How far at most a step leads from a value of the scalar and the unknowns there, as along the frequency."""
    low, high = sorted(map(float, ends))
    hidden = lru_cache(maxsize=8)(lambda p: Hidden(model_at(p), balance.schemes[-1].harmonics))

    def longest(p: float, x: Array) -> float:
        p = min(max(p, low), high)
        first, _, last = around(p, low, high)
        one, other = hidden(first), hidden(last)
        moved = np.maximum(np.abs(other.low - one.low), np.abs(other.high - one.high))
        away = hidden(p).away(frequency, lambda: balance.driven(x, p))
        return SHARE * (last - first) * float(np.min(away / np.maximum(moved, 1e-300), initial=np.inf))

    return longest


def parameter_curve(
    model_at: Callable[[float], Model],
    frequency: float,
    start: float,
    stop: float,
    *,
    scheme: Sequence[Scheme],
    controls: Controls,
    guess: Array | None,
    stability: bool,
    watch: Watch,
) -> HbmCurve:
    """Follow the periodic response at one frequency [Hz] through a range of a scalar, around folds.

    ``model_at``: the model for a value of the scalar, which is the `parameter` of the curve. The curve begins at
    `start`; other arguments, of which none has a default, and errors are those of `timesim.hbm.curve.hbm_curve`.
    """
    models, ends = lru_cache(maxsize=8)(model_at), (float(start), float(stop))
    balance = AdaptiveBalance(
        lambda own: ParameterBalance(models, frequency, own, ends), scheme, models(ends[0]).num_contacts
    )
    controls = replace(controls, longest=steps_to_resolve(models, frequency, ends, balance))
    steps = watched(balance, controls, watch, _evaluated)
    curve = curve_near(balance, start, frequency, steps, guess, lambda x: follow(balance, x, start, stop, steps))
    return finished(balance, curve, _evaluated, stability)


def _evaluated(residual: ParameterBalance, curve: Curve, *, stability: bool) -> HbmCurve:
    if not curve.p.size:
        return evaluated(residual.at(residual.low), curve, stability=False)
    here = replace(curve, p=np.full(curve.p.size, residual.frequency))
    points = [
        evaluated(residual.at(float(p)), part_of(here, slice(i, i + 1)), stability=stability)
        for i, p in enumerate(curve.p)
    ]
    return replace(joined(points), parameter=curve.p, branch=curve.branch)
