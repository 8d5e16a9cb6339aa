"""Which crossings inside a step are seen, and which transitions are due at its end."""

import jax.numpy as jnp
import numpy as np
import pytest
from simulation import FINE
from systems import at_rest, excitation, pad, structure

from timesim.engine.guard import NONE, arriving, first_crossing, segment
from timesim.engine.solver import step_control
from timesim.engine.system import Point, system_of
from timesim.engine.tolerance import LANDING
from timesim.model.model import SEPARATION, Model

pytestmark = pytest.mark.long


@pytest.mark.parametrize("place", [0.05, 0.4, 0.95])
@pytest.mark.parametrize("touches", [True, False])
def test_a_touch_between_two_looks_at_a_step_is_seen(place: float, touches: bool):
    """An open stop closes for 6 % of a step, also next to its ends: at none of the places looked at is it closed."""
    body = structure([1.0], [0.0], [[0, 0, 1]])
    model = Model(body, (pad(0.0, 0.0, 1.0, -1.0),), excitation(0.2, [1.0], [0.0]), at_rest(1, 1))
    system, h = system_of(model, 0.2), 0.3
    law, unit = system.law, system.law.normal_stiffness * system.shape[-1][0]

    def end(x: float) -> tuple[Point, Point]:
        """Displacement and velocity at a share of the step, and their rates; n = peak - (x - place)^2."""
        load = np.array([(1e-3 if touches else -1e-3) - (x - place) ** 2, -2 * (x - place) / h, -2 / h**2])
        q, p, a = ((n - preload) / unit for n, preload in zip(load, (law.preload, 0.0, 0.0), strict=True))
        none = (jnp.zeros(1),) * 2
        return Point(q, p, none, None), Point(p, a, none, None)

    ends = (end(0.0), end(1.0))
    state = jnp.asarray([SEPARATION])
    part = segment(system, state, *zip(*ends, strict=True), jnp.asarray(h))
    found = float(first_crossing(system, state, part))
    assert found == (pytest.approx(place, abs=1e-3**0.5) if touches else NONE)


def test_the_fastest_motion_bounds_the_time_over_which_a_landing_is_corrected():
    """The error of the Euler step onto the guard is that of the fastest rate: at a hundred times, a hundredth."""
    for stiffest, ahead, due in ((1.0, 0.5, True), (100.0, 0.5, False), (100.0, 0.005, True), (1.0, 2.0, False)):
        margin = jnp.asarray([[ahead * LANDING], [1.0]])
        slope, end = jnp.asarray([[-1.0], [0.0]]), jnp.asarray(False)
        _, (first, _) = arriving(margin, slope, jnp.asarray(0.1), end, step_control(FINE, stiffest).landing)
        assert bool(first[0]) == due, (stiffest, ahead)
