"""Shares of the states of contacts, and what counts as a change of state."""

import numpy as np
import pytest

from timesim.orbit.steady_state import share, switches

pytestmark = pytest.mark.long


def test_a_share_is_exact_where_the_state_never_changes():
    """The sum of rounded durations is not: over some sets of steps it leaves 0.9999999999999999."""
    generator = np.random.default_rng(1)
    sums = []
    for _ in range(200):
        duration = generator.uniform(0.01, 1.0, 97)
        within = np.ones((97, 3), dtype=bool)
        within[:, 1] = False
        within[:40, 2] = False
        found = share(duration, within)
        sums.append(duration @ within[:, 0] / duration.sum())
        assert found[0] == 1
        assert found[1] == 0
        assert 0 < found[2] < 1
    assert min(sums) < 1


def test_no_verdict_stands_on_rounding():
    slip = np.array([0.0, 0.0, 0.0, 1e-15, 0.01, 0.0])
    apart = np.array([0.0, 1.0, np.nextafter(1.0, 0.0), 0.0, 0.0, 0.3])
    assert switches(slip, apart).tolist() == [False, False, False, False, True, True]
