"""Harmonics that follow the solution along a curve, and what is said of those that are left out."""

import numpy as np
import pytest
import systems

from timesim.hbm.adaptive import tail
from timesim.hbm.balance import Balance
from timesim.hbm.curve import hbm_curve, solutions_at
from timesim.hbm.scheme import NEGLECTED, Scheme

SCHEMES = [Scheme(harmonics, 256) for harmonics in (3, 7, 11, 15)]
FINE = Scheme(25, 256)


@pytest.fixture(scope="module")
def model():
    return systems.oscillator(10.0, 1.5)


@pytest.fixture(scope="module")
def curve(model):
    """Through the peak, where the contact slips, from full stick to full stick."""
    return hbm_curve(model, 1.5, 1.75, scheme=SCHEMES, stability=False)


def used(curve):
    """The highest harmonic of each solution."""
    return np.array([np.flatnonzero(own.any(axis=(1, 2)))[-1] for own in curve.harmonic_amplitude])


def test_harmonics_come_and_go_along_a_curve(curve):
    count = used(curve)
    assert curve.complete, curve.message
    assert count[0] <= 3
    assert count[-1] <= 3
    assert count.max() > 3
    assert set(count) <= {1, *(scheme.harmonics for scheme in SCHEMES)}
    assert curve.harmonic_cos.shape[1] == count.max() + 1


def test_the_motion_is_that_of_many_harmonics(curve, model):
    rows = np.flatnonzero(curve.slip_share[:, 0] > 0)[::4]
    fine = solutions_at(
        model, curve.with_harmonics(FINE.harmonics), curve.frequency[rows], scheme=FINE, stability=False
    )
    np.testing.assert_allclose(fine.amplitude, curve.amplitude[rows], rtol=0, atol=NEGLECTED * fine.amplitude.max())


@pytest.mark.parametrize(("preload", "frequency"), [(3.0, 1.39), (-1.0, 0.97)])
def test_the_tail_says_what_few_harmonics_leave_out(preload, frequency):
    """Within a factor of three of the harmonics that a solution with many of them has."""
    model, few = systems.oscillator(preload, frequency), Scheme(3, 256)
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=few, stability=False)
    assert curve.slip_share[0, 0] > 0.05
    balance = Balance(model, frequency, few)
    expected = tail(balance, curve.contact_motion[0].ravel() / balance.length, frequency)
    fine = solutions_at(model, curve.with_harmonics(FINE.harmonics), frequency, scheme=FINE, stability=False)
    size = fine.harmonic_amplitude[0].max(axis=(1, 2))
    for order in (3, 5, 8):
        left = np.sqrt(np.sum(size[order + 1 :] ** 2)) / size[1]
        assert left / 3 < expected[order] < 3 * left
