"""Response curves of generated structures: they begin, and they reach the end of the range."""

import numpy as np
import pytest
import zoo

from timesim.hbm.curve import hbm_curve
from timesim.hbm.scheme import Scheme

pytestmark = pytest.mark.long


def span_of(seed: int) -> tuple[float, float]:
    """A range around the first mode without contacts and, where it is near, the first one with all of them stuck."""
    model, free = zoo.structure(seed)
    stuck = float(np.min(model.stuck_omega)) / (2 * np.pi)
    return free / 2**0.75, (stuck if stuck <= 3 * free else 1.5 * free) * 2**0.75


@pytest.mark.slow
@pytest.mark.parametrize("full", [False, True], ids=["isotropic", "full"])
@pytest.mark.parametrize("seed", range(24))
def test_a_curve_begins_and_reaches_the_end(seed, full):
    """Where K_u of the contacts is isotropic, and where it is full."""
    model, _ = zoo.structure(seed)
    model = zoo.with_full_stiffness(model, seed) if full else model
    curve = hbm_curve(model, *span_of(seed), scheme=Scheme(9, 256))
    assert curve.complete, curve.message
