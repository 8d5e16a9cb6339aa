"""How many harmonics and samples are enough, told from solutions that not every number of them has."""

import numpy as np
import pytest
import systems

from timesim.hbm import convergence
from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Controls, solve
from timesim.hbm.curve import hbm_curve
from timesim.hbm.scheme import Scheme

pytestmark = pytest.mark.long


def test_what_has_no_solution_does_not_count_as_the_same(monkeypatch):
    """With fewer than five harmonics there is none: two numbers that find nothing agree on nothing."""
    model = systems.oscillator(-1.0, 0.97)
    known = convergence.Known(model, 0.97, np.zeros((1, 3, 3)), np.ones((1, 3)))

    def amplitude(known, scheme):
        return np.full((1, 3), np.nan if scheme.harmonics < 5 else 1 + 10.0**-scheme.harmonics)

    monkeypatch.setattr(convergence, "amplitude", amplitude)
    found = convergence.convergence([known], Scheme(9, 256))
    assert found.harmonics.tolist() == [1, 3, 5, 7, 9]
    np.testing.assert_allclose(found.with_harmonics, [np.nan, np.nan, 1e-5, 1e-7, 1e-7], rtol=0.02)
    assert found.lost == {"1 harmonic": 1, "3 harmonics": 1}


def test_the_largest_change_of_any_amplitude_counts(monkeypatch):
    """Relative to the largest amplitude of the motion, which is 2."""
    known = convergence.Known(systems.oscillator(-1.0, 0.97), 0.97, np.zeros((1, 3, 3)), np.array([[1.0, 2.0, 0.5]]))

    def amplitude(known, scheme):
        return known.amplitude + scheme.harmonics**-2.0 * np.array([1.0, 0.0, 0.0])

    monkeypatch.setattr(convergence, "amplitude", amplitude)
    found = convergence.convergence([known], Scheme(9, 256))
    last = found.harmonics[-1]
    np.testing.assert_allclose(found.with_harmonics[:-1], (found.harmonics[:-1] ** -2 - last**-2) / 2)
    exact = np.append(3 * found.harmonics[:-1] ** -2.5, 1e-9)
    assert convergence.order_of(found.harmonics, exact) == pytest.approx(2.5)


@pytest.mark.parametrize(("preload", "frequency"), [(-1.0, 0.97), (1.0, 0.7), (1.0, 1.2), (3.0, 1.39)])
def test_the_error_of_the_samples_is_that_of_solving_anew_with_more(preload, frequency):
    """No less than it, and no more than where the curve is as steep as may be."""
    model, scheme = systems.oscillator(preload, frequency), Scheme(5, 32)
    controls = Controls(max_points=2)
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=scheme, controls=controls, stability=False)
    found = convergence.sampling_error(lambda _: model, curve, [scheme], np.array([0]))
    finer = Balance(model, frequency, Scheme(5, 32 * convergence.FINER))
    x = curve.contact_motion[0].ravel() / finer.length
    solution = solve(finer, x, float(curve.frequency[0]), Controls())
    assert solution is not None
    true = np.linalg.norm(solution[0] - x) / np.linalg.norm(x - finer.centre(x))
    assert true > 1e-5
    assert 0.9 * true < found < 1.1 * true / convergence.STEEPEST
