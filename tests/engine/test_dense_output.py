"""Dense output: polynomials of its own degree are met exactly, between the ends and at them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from systems import oscillator

from timesim.engine import dense_output as hermite
from timesim.engine.history import Samples, joined, sample
from timesim.engine.trajectory import Phase, Run
from timesim.model.model import SLIP
from timesim.model.solver import PRESETS, Solver

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
    assert hermite.evaluate(X, hermite.cubic_coefficients(H, *ends))[0] == pytest.approx(p(START + H * X), abs=1e-13)


@pytest.mark.parametrize("place", [1.4, 3.0, -0.3, -4.0])
def test_a_third_place_makes_the_cubic_a_quintic(place: float):
    p = Polynomial([0.3, -1.0, 0.5, 2.0, -0.7, 1.1])
    start, end, third = ((p(t), p.deriv()(t)) for t in (START, START + H, START + place * H))
    met = hermite.through_third(X, H, start, end, place, third)
    assert met == pytest.approx(p(START + H * X), abs=1e-13)
    alone = hermite.through_third(X, H, start, end, np.nan, (np.nan, np.nan))
    np.testing.assert_array_equal(alone, hermite.evaluate(X, hermite.cubic_coefficients(H, start, end))[0])


def test_extremes_are_those_of_a_dense_evaluation():
    """Of rows of smooth steps, most of which hold no extreme."""
    time, first = np.linspace(0, 12, 61), np.array([0, 17, 40])
    size, phase = np.array([1.0, 0.3, 1e-9]), np.array([0.0, 1.0, 2.0])
    ends = [size * np.cos(time[:, None] + phase + 0.5 * np.pi * k) for k in range(3)]
    ends[0] += 0.2
    start, end = ([part[side] for part in ends] for side in (slice(-1), slice(1, None)))
    quintic = np.diff(time)[:, None], (*start,), (*end,)
    coefficients, within = np.stack(hermite.quintic_coefficients(*quintic)), hermite.quintic_bounds(*quintic)
    np.testing.assert_allclose(within, hermite.bounds(coefficients), rtol=1e-14, atol=1e-15)
    low, high, rows = hermite.extremes(lambda *those: coefficients[:, *those], within, (start[0], end[0]), first)
    assert not rows.size
    x = np.linspace(0, 1, 2001)
    dense = np.array([hermite.evaluate(at, (*coefficients,))[0] for at in x])
    for row, steps in enumerate(np.split(dense, first[1:], axis=1)):
        for found, beyond in ((high[row], steps.max(axis=(0, 1))), (-low[row], -steps.min(axis=(0, 1)))):
            # It is as good as 2001 places in each step, and what lies between them is found as well.
            np.testing.assert_allclose(found, beyond, rtol=0, atol=1e-9)
            assert np.all(found >= beyond * (1 - np.sign(beyond) * 4e-16))


def test_a_step_that_may_hold_an_extreme_is_named_where_it_is_in_doubt():
    line = np.array([[0.0, 1.0, 2.0], [1.0, 1.0, 1.0], [0.0] * 3, [0.0] * 3])[:, :, None]  # three steps from 0 to 3
    ends = line[0], line.sum(axis=0)
    doubts = np.array([0.5, 0.5, 0.5])[:, None]
    lines = (lambda *those: line[:, *those], hermite.bounds(line))
    assert hermite.extremes(*lines, ends, np.array([0]), doubts)[2].tolist() == [0, 2]
    assert hermite.extremes(*lines, ends, np.array([0, 1]), doubts)[2].tolist() == [0, 1, 2]


@pytest.mark.parametrize(("preload", "frequency", "error"), [(3.0, 1.39, 5e-8), (-1.0, 0.97, 2e-7)])
def test_samples_of_slip_are_nearly_as_exact_as_the_states(preload: float, frequency: float, error: float):
    """Against steps twenty times as short, while the contact slips; cubics err by 2e-6 and 1e-6 of the largest."""

    def samples(solver: Solver) -> Samples:
        run, parts, each = Run(oscillator(preload, frequency), [Phase(frequency, 4)], solver), [], 500 * frequency
        for steps in run.batches():
            ends = np.array([steps.time[0], steps.time[-1] + steps.h[-1]])
            parts.append(sample(steps, (np.arange(*np.ceil(ends * each - 0.5)) + 0.5) / each))
        return joined(parts)

    found = samples(PRESETS["reference"])
    fine = samples(replace(PRESETS["reference"], longest=2 * np.pi / 2000))
    np.testing.assert_array_equal(found.time, fine.time)
    slips = found.state == SLIP
    assert 100 < slips.sum() < 0.9 * slips.size
    np.testing.assert_array_equal(found.state, fine.state)
    assert np.abs(found.w - fine.w)[slips].max() < error * np.abs(fine.w[slips]).max()
