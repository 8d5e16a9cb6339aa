"""Decisions of an iteration of Newton's method, on maps that are known: end = slope (state - fixed) + fixed."""

from types import SimpleNamespace

import numpy as np
import pytest

from timesim.orbit.lane import Recorded
from timesim.orbit.shooting import Outcome, Shot, iterated
from timesim.orbit.threshold import REACH, TAKES_OVER, UNSTABLE

FIXED = np.array([1.0, -0.5])
TOLERANCE = 1e-8


def at(vector, state=(0,)):
    """A lane at a state vector; it moves anywhere."""
    return SimpleNamespace(vector=np.asarray(vector), here=SimpleNamespace(state=np.array(state)), moved=at)


def near(*aside):
    """A lane that far from the fixed point."""
    return at(FIXED + np.array((*aside, 0.0))[:2])


def cycle(start, slope, *, state=(0,), complete=True):
    """A cycle by a linear map."""
    end = at(FIXED + slope @ (start.vector - FIXED), state)
    return Recorded(start, end, 1, complete, (), 0, slope)


def turning(size, angle=0.3):
    """A linear map with the multipliers size exp(+-i angle)."""
    return size * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def test_one_iteration_leads_to_the_fixed_point_of_a_linear_map():
    start = near(0.01, 0.02)
    led_to = iterated(Shot(start), cycle(start, turning(0.9)), TOLERANCE)
    assert isinstance(led_to, Shot)
    np.testing.assert_allclose(led_to.lane.vector, FIXED, rtol=1e-12)
    change = (turning(0.9) - np.eye(2)) @ [0.01, 0.02]
    assert led_to.residual == pytest.approx(np.abs(change).max() / np.abs(start.vector).max())


@pytest.mark.parametrize(("excess", "outcome"), [(-1e-7, Outcome.CONVERGED), (1e-7, Outcome.UNSTABLE)])
def test_an_unstable_motion_is_refused(excess, outcome):
    start = at(FIXED)
    assert iterated(Shot(start), cycle(start, turning(UNSTABLE + excess)), TOLERANCE) is outcome
    assert UNSTABLE - 1 <= 1e-5


def test_it_has_converged_when_the_step_is_small_beside_the_state():
    for share, converged in ((0.9, True), (1.1, False)):
        start = near(share * TOLERANCE)
        led_to = iterated(Shot(start), cycle(start, turning(0.5)), TOLERANCE)
        assert (led_to is Outcome.CONVERGED) == converged


def test_it_gives_up_where_it_does_not_take_over():
    start = near(0.01)
    recorded = cycle(start, turning(0.5))
    residual = np.abs(recorded.end.vector - start.vector).max() / np.abs(start.vector).max()
    assert iterated(Shot(start, 0.99 * residual / TAKES_OVER), recorded, TOLERANCE) is Outcome.ASTRAY
    assert isinstance(iterated(Shot(start, 1.01 * residual / TAKES_OVER), recorded, TOLERANCE), Shot)


def test_it_gives_up_where_it_leads_far_away_or_into_other_contact_states():
    far = at(FIXED * (1 + 1.1 * REACH / (1 - REACH)))
    assert iterated(Shot(far), cycle(far, turning(0.5)), TOLERANCE) is Outcome.ASTRAY
    start = near(0.01)
    for odd in ({"state": (1,)}, {"complete": False}):
        assert iterated(Shot(start), cycle(start, turning(0.5), **odd), TOLERANCE) is Outcome.ASTRAY


def test_multipliers_come_largest_first_and_free_offsets_are_left_out():
    slope = np.eye(3)
    slope[1:, 1:] = [[0.2, 0.0], [0.1, -0.7]]
    recorded = Recorded(at(np.zeros(3)), at(np.array([0.0, 0.3, 0.2])), 1, True, (), 0, slope)
    np.testing.assert_allclose(recorded.multipliers, [-0.7, 0.2])
    step = recorded.newton_step()
    assert step[0] == 0
    np.testing.assert_allclose((np.eye(2) - slope[1:, 1:]) @ step[1:], [0.3, 0.2])
