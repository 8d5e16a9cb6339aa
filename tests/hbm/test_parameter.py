"""The balance as a residual in a scalar of the scene: its derivative, and how it goes on beyond the range."""

from dataclasses import replace

import numpy as np
import pytest
from systems import oscillator

from timesim.hbm.parameter import ParameterBalance
from timesim.hbm.scheme import Scheme
from timesim.model.model import Model

pytestmark = pytest.mark.long

LOW, HIGH = 0.5, 1.5


def of_load(factor: float) -> Model:
    """The oscillator under so many times its load, to the third power: a residual that is curved in it."""
    model = oscillator(3.0, 1.39)
    return replace(model, excitation=replace(model.excitation, cosine=factor**3 * model.excitation.cosine))


def test_the_derivative_by_the_scalar_at_the_ends_and_between_and_the_way_beyond() -> None:
    """The contact forces do not depend on the load: r changes as its third power."""
    balance = ParameterBalance(of_load, 1.39, Scheme(3, 64), (HIGH, LOW))
    x = 0.1 * np.random.default_rng(3).normal(size=balance.at(1.0).num_unknowns)
    load = (balance.value(x, HIGH) - balance.value(x, LOW)) / (HIGH**3 - LOW**3)
    assert np.abs(load).max() > 1e-3
    close = 1e-5 * np.abs(load).max()
    for p in (LOW, 0.9, HIGH):
        r, _, slope = balance.linearised(x, p)
        np.testing.assert_allclose(r, balance.value(x, p), atol=1e-12)
        np.testing.assert_allclose(slope, 3 * p**2 * load, atol=close)
    for end, beyond in ((LOW, 0.4), (HIGH, 1.7)):
        straight = balance.value(x, end) + (beyond - end) * 3 * end**2 * load
        np.testing.assert_allclose(balance.value(x, beyond), straight, atol=close)
        r, _, slope = balance.linearised(x, beyond)
        np.testing.assert_allclose(r, straight, atol=close)
        np.testing.assert_allclose(slope, 3 * end**2 * load, atol=close)
