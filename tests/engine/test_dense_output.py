"""Dense output: polynomials of its own degree are met exactly, between the ends and at them."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from timesim.engine import dense_output as hermite

START, H = 0.7, 0.3
X = np.linspace(0, 1, 7)


def test_a_quintic_is_met_exactly():
    p = Polynomial([0.3, -1.0, 0.5, 2.0, -0.7, 1.1])
    ends = [tuple(p.deriv(k)(t) if k else p(t) for k in range(3)) for t in (START, START + H)]
    value, rate = hermite.quintic(X, H, ends[0], ends[1])
    assert value == pytest.approx(p(START + H * X), abs=1e-13)
    assert rate == pytest.approx(p.deriv()(START + H * X), abs=1e-12)


def test_a_cubic_is_met_exactly():
    p = Polynomial([0.3, -1.0, 0.5, 2.0])
    ends = [(p(t), p.deriv()(t)) for t in (START, START + H)]
    assert hermite.cubic(X, H, ends[0], ends[1]) == pytest.approx(p(START + H * X), abs=1e-13)
