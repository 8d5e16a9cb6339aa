"""How many harmonics and samples are enough, told from solutions that not every number of them has."""

import numpy as np
import pytest
import systems

from timesim.hbm import convergence
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
    assert found.lost == {"1 harmonics": 1, "3 harmonics": 1}
