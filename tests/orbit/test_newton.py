"""Decisions of an iteration of Newton's method, on maps that are known: end = slope (state - fixed) + fixed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from timesim.model.model import SEPARATION, STICK
from timesim.orbit.lane import Recorded
from timesim.orbit.shooting import Converged, Failure, Shot, iterated
from timesim.orbit.threshold import (
    FEW_IDLE,
    FINEST,
    MOST_IDLE,
    MOST_SHOTS,
    NOISY,
    REACH,
    SHORTER,
    SHORTEST_SHARE,
    UNSTABLE,
    VAGUE,
)

pytestmark = pytest.mark.long

FIXED = np.array([1.0, -0.5])
SWING = SimpleNamespace(end=SimpleNamespace(q=np.outer([-1, 1], FIXED), p=np.outer([-1, 1], FIXED)))
"""Steps between the fixed point and its opposite."""
TOLERANCE, RTOL = 1e-8, 1e-7


def at(vector, state=(STICK,), rtol=RTOL):
    """A lane at a state vector; it moves anywhere."""
    return SimpleNamespace(
        vector=np.asarray(vector),
        size=max(np.abs(vector)),
        shifts=np.zeros((0, len(vector))),
        apart=np.array(state) == SEPARATION,
        control=SimpleNamespace(rtol=rtol),
        moved=lambda vector: at(vector, state, rtol),
        within=lambda finer: at(vector, state, finer),
    )


def near(*aside, **lane):
    """A lane that far from the fixed point."""
    return at(FIXED + np.array((*aside, 0.0))[:2], **lane)


NOTHING = np.zeros(1)  # lost in the contact


class Cycle(Recorded):
    """A cycle whose state vectors are its returns."""

    @property
    def returns(self):
        return self.end.vector[None]


def cycle(start, slope, *, state=(STICK,), complete=True, noise=0.0):
    """A cycle by a linear map, and an error of it."""
    end = at(FIXED + slope @ (start.vector - FIXED) + noise, state)
    return Cycle(start, end, 1, complete, SWING, slope, NOTHING)


def turning(size, angle=0.3):
    """A linear map with the multipliers size exp(+-i angle)."""
    return size * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def test_one_iteration_leads_to_the_fixed_point_of_a_linear_map():
    start = near(0.01, 0.02)
    led_to = iterated(Shot(start), cycle(start, turning(0.9)), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert (led_to.share, led_to.count) == (1.0, 1)
    np.testing.assert_allclose(led_to.lane.vector, FIXED, rtol=1e-12)


@pytest.mark.parametrize(("excess", "outcome"), [(-1e-7, Converged(0.0)), (1e-7, Failure.UNSTABLE)])
def test_an_unstable_motion_is_refused(excess, outcome):
    start = at(FIXED)
    assert iterated(Shot(start), cycle(start, turning(UNSTABLE + excess)), TOLERANCE) == outcome
    assert UNSTABLE - 1 <= 1e-5


def test_what_is_found_from_where_disturbances_grow_is_refused():
    """Beside an unstable motion that has a stable one on either side, a long step may lead to the wrong one."""
    for aside, outcome in ((0.2, Converged(0.0)), (0.01, Failure.ASTRAY)):  # far away a march may come to any
        start = near(aside)
        led_to = iterated(Shot(start), cycle(start, turning(1.1)), TOLERANCE)
        assert isinstance(led_to, Shot)
        assert iterated(led_to, cycle(at(FIXED), turning(0.9)), TOLERANCE) == outcome
    twice = replace(led_to, lane=at(FIXED), period=2)
    once = iterated(twice, replace(cycle(at(FIXED), turning(0.9)), cycles=2), TOLERANCE)
    assert once == Shot(twice.lane, 1, leaves=True)


def test_disturbances_that_grow_on_the_way_are_no_reason_to_refuse_what_is_found():
    """Only where the first iterate lies, on the march itself, tells whether a march would move away."""
    here = near(0.01)
    led_to = iterated(Shot(here, before=cycle(near(0.2), turning(0.9)), count=1), cycle(here, turning(1.1)), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert not led_to.leaves
    assert iterated(led_to, cycle(at(FIXED), turning(0.9)), TOLERANCE) == Converged(0.0)


def test_a_shortened_step_begins_where_the_step_did():
    before, here = cycle(near(0.0, 0.02), np.diag([0.999, 0.1])), near(0.3)
    led_to = iterated(Shot(here, before=before, count=1), cycle(here, np.diag([0.999, 0.1])), TOLERANCE)
    assert isinstance(led_to, Shot)
    np.testing.assert_allclose(led_to.lane.vector, before.start.vector - SHORTER * np.array([0.0, 0.02]), rtol=1e-9)


def test_steps_are_not_made_finer_while_they_lead_closer_quickly():
    """A change below the noise of the steps that still is a small part of the one before is none."""
    slope = turning(0.5)
    before, here = cycle(near(1e-3), slope), near(1e-6)
    led_to = iterated(Shot(here, before=before, count=1), cycle(here, slope), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert (led_to.lane.control.rtol, led_to.share) == (RTOL, 1.0)
    np.testing.assert_allclose(led_to.lane.vector, FIXED, rtol=1e-12)


def test_a_body_that_is_ever_faster_has_no_steady_state():
    """The first entry is its place, the second its speed, which a constant force raises by as much each cycle."""
    start = at(np.array([0.5, 1.0]))
    start.shifts = np.array([[1.0, 0.0]])
    end = at(start.vector + np.array([1.0, 0.01]))
    recorded = Cycle(start, end, 1, True, SWING, np.array([[1.0, 1.0], [0.0, 1.0]]), NOTHING)
    assert iterated(Shot(start), recorded, TOLERANCE) is Failure.ASTRAY


def test_it_has_converged_when_the_step_is_small_beside_the_state():
    for share, converged in ((0.9, True), (1.1, False)):
        start = near(share * TOLERANCE)
        led_to = iterated(Shot(start), cycle(start, turning(0.5)), TOLERANCE)
        assert isinstance(led_to, Converged) == converged
        assert not converged or led_to.settled_to == pytest.approx(share * TOLERANCE)


def test_a_step_that_does_not_lead_closer_is_shortened_and_given_up_in_the_end():
    """Closer by the step that would follow, not by the change over a cycle, which a slow decay makes small."""
    slow = np.diag([0.999, 0.1])
    before = cycle(near(0.0, 0.02), slow)
    led_to = Shot(near(0.3), before=before, count=1)
    assert np.abs(cycle(led_to.lane, slow).change).max() < np.abs(before.change).max()
    shares = []
    while isinstance(led_to, Shot):
        led_to = iterated(replace(led_to, lane=near(0.3)), cycle(near(0.3), slow), TOLERANCE)
        shares += [led_to.share] if isinstance(led_to, Shot) else []
    assert led_to is Failure.ASTRAY
    assert shares == [SHORTER**n for n in range(1, len(shares) + 1)]
    assert shares[-1] == SHORTEST_SHARE
    closer = iterated(Shot(near(0.01), before=before), cycle(near(0.01), slow), TOLERANCE)
    assert isinstance(closer, Shot)
    assert closer.share == 1.0


@pytest.mark.parametrize(("distance", "share"), [(0.93, 1.0), (0.95, SHORTER**2)])
def test_a_shortened_step_need_lead_closer_by_a_quarter_of_its_share_only(distance, share):
    """By the natural monotonicity test: a quarter of the step leads to three quarters of the distance at best."""
    slope = np.diag([0.5, 0.1])
    shot = Shot(near(distance * 0.1), before=cycle(near(0.1), slope), share=SHORTER, count=1)
    led_to = iterated(shot, cycle(shot.lane, slope), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert led_to.share == share


def test_a_step_that_closes_a_contact_is_judged_by_the_derivative_there():
    """By that before, a decay of a thousandth a cycle, the iterate would be a hundred times farther away."""
    before, here = cycle(near(0.3), np.diag([0.999, 0.1])), near(0.2)
    led_to = iterated(Shot(here, before=before), cycle(here, np.diag([0.5, 0.1])), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert (led_to.share, led_to.before.start) == (1.0, here)


def test_no_step_is_longer_than_half_of_the_state():
    far = at(FIXED * 4)
    led_to = iterated(Shot(far), cycle(far, turning(0.5)), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert np.abs(led_to.lane.vector - far.vector).max() == pytest.approx(REACH * np.abs(far.vector).max())


def test_a_step_that_the_contacts_refuse_is_shortened():
    start = near(0.01)
    allowed = start.moved
    start.moved = lambda vector: allowed(vector) if vector[0] > FIXED[0] + 0.005 else None
    led_to = iterated(Shot(start), cycle(start, turning(0.5)), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert led_to.share == SHORTER
    start.moved = lambda vector: None
    assert iterated(Shot(start), cycle(start, turning(0.5)), TOLERANCE) is Failure.ASTRAY


@pytest.mark.parametrize("odd", [{"state": (SEPARATION,)}, {"complete": False}])
def test_a_cycle_that_ends_early_or_in_other_contact_states_is_no_iterate(odd):
    start = near(0.01)
    assert iterated(Shot(start), cycle(start, turning(0.5), **odd), TOLERANCE) is Failure.ASTRAY
    before = cycle(near(0.02), turning(0.5))
    led_to = iterated(Shot(start, before=before), cycle(start, turning(0.5), **odd), TOLERANCE)
    assert isinstance(led_to, Shot)
    assert led_to.share == SHORTER


def test_it_does_not_go_on_for_ever():
    start = near(0.01)
    recorded = cycle(start, turning(0.5))
    assert isinstance(iterated(Shot(start, count=MOST_SHOTS - 1), recorded, TOLERANCE), Shot)
    assert iterated(Shot(start, count=MOST_SHOTS), recorded, TOLERANCE) is Failure.ASTRAY


@pytest.mark.parametrize(("period", "most"), [(1, MOST_IDLE), (2, FEW_IDLE), (64, FEW_IDLE)])
def test_it_is_given_up_where_it_comes_no_nearer(period, most):
    """For so many cycles; a step that is left by less than half is clearly nearer."""
    start = near(0.01)
    recorded = cycle(start, turning(0.5))
    left = np.abs(recorded.newton_step(recorded.change)).max() / start.size

    def after(idle, nearest):
        return iterated(Shot(start, period, nearest=nearest * left, idle=idle, count=9), recorded, TOLERANCE)

    assert after(most - 1, 1.9) is Failure.ASTRAY
    goes_on, nearer = after(most - 2, 1.9), after(most - 1, 2.1)
    assert (goes_on.idle, goes_on.nearest) == (most - 1, 1.9 * left)
    assert (nearer.idle, nearer.nearest) == (0, left)


def test_a_cycle_that_does_not_close_comes_no_nearer():
    start, before = near(0.01), cycle(near(0.02), turning(0.5))
    shot, odd = Shot(start, before=before, idle=MOST_IDLE - 2), cycle(start, turning(0.5), complete=False)
    led_to = iterated(shot, odd, TOLERANCE)
    assert isinstance(led_to, Shot)
    assert iterated(replace(shot, idle=MOST_IDLE - 1), odd, TOLERANCE) is Failure.ASTRAY


def test_finer_steps_begin_anew():
    """What came no nearer for the noise of the steps was no fault of the iteration."""
    before, here = cycle(near(2e-7), np.diag([0.999, 0.1])), near(1e-7)
    led_to = iterated(Shot(here, before=before, idle=3, nearest=1e-9), cycle(here, np.diag([0.999, 0.1])), 1e-9)
    assert isinstance(led_to, Shot)
    assert (led_to.lane.control.rtol < RTOL, led_to.idle) == (True, 0)


def at_rest_in_noise(rtol, slope, noise):
    """An iteration next to the fixed point in which the noise of the steps is all that is left of the change."""
    before = cycle(near(0.0, rtol=rtol), slope, noise=noise)
    here = near(0.0, rtol=rtol)
    return iterated(Shot(here, before=before), cycle(here, slope, noise=-noise), TOLERANCE)


def test_noise_of_the_steps_makes_them_finer():
    """By what the slow decay of the motion, here a thousandth a cycle, makes of it."""
    led_to = at_rest_in_noise(RTOL, np.diag([0.999, 0.1]), np.array([1e-8, 0.0]))
    assert isinstance(led_to, Shot)
    assert led_to.before is None
    assert FINEST < led_to.lane.control.rtol == pytest.approx(0.1 * TOLERANCE / 1000, rel=1e-6)
    quick = at_rest_in_noise(RTOL, np.diag([0.5, 0.1]), np.array([1e-8, 0.0]))
    assert isinstance(quick, Shot)
    assert quick.lane.control.rtol == pytest.approx(0.05 * TOLERANCE, rel=1e-6)


@pytest.mark.parametrize(("decay", "settled"), [(1e-4, True), (0.1 * NOISY * FINEST / VAGUE, False)])
def test_where_finer_steps_do_not_help_the_motion_has_settled_to_what_is_reached(decay, settled):
    noise = 0.5 * NOISY * FINEST
    led_to = at_rest_in_noise(FINEST, np.diag([1 - decay, 0.1]), np.array([noise, 0.0]))
    assert (led_to == Converged(pytest.approx(noise / decay, rel=1e-4))) == settled
    assert settled or led_to is Failure.ASTRAY
    assert not settled or led_to.settled_to > TOLERANCE


def test_a_steady_state_in_closed_form_holds_if_no_contact_leaves_its_state():
    class Held(Cycle):
        is_held = True

    class Left(Cycle):
        is_held = False

    start = at(FIXED)
    for kind, outcome in ((Held, Converged(0.0)), (Left, Failure.ASTRAY)):
        recorded = kind(start, near(1e-6), 1, True, None, np.diag([0.999, 0.1]), NOTHING)
        assert iterated(Shot(start, held=True), recorded, TOLERANCE) == outcome


@pytest.mark.parametrize(("within", "period"), [(1, 1), (2, 2), (4, 4)])
def test_a_motion_that_repeats_within_the_period_is_shot_over_its_own(within, period):
    class Four(Recorded):
        @property
        def returns(self):
            return np.array([FIXED + (n % within > 0) * 0.1 for n in range(1, 5)])

    start = at(FIXED)
    led_to = iterated(Shot(start, 4), Four(start, at(FIXED), 4, True, SWING, turning(0.5), NOTHING), TOLERANCE)
    assert led_to == (Converged(0.0) if period == 4 else Shot(start, period))


def test_a_motion_that_is_near_after_no_divisor_of_the_period_keeps_it():
    class Three(Recorded):
        @property
        def returns(self):
            return FIXED + 0.1 * np.array([[1.0], [2.0], [0.0], [0.0]])

    start = at(FIXED)
    led_to = iterated(Shot(start, 4), Three(start, at(FIXED), 4, True, SWING, turning(0.5), NOTHING), TOLERANCE)
    assert led_to == Converged(0.0)


def test_multipliers_come_largest_first_and_free_offsets_are_left_out():
    slope = np.eye(3)
    slope[1:, 1:] = [[0.2, 0.0], [0.1, -0.7]]
    recorded = Recorded(at(np.zeros(3)), at(np.array([0.0, 0.3, 0.2])), 1, True, None, slope, NOTHING)
    np.testing.assert_allclose(recorded.multipliers, [-0.7, 0.2])
    step = recorded.newton_step(recorded.change)
    assert step[0] == 0
    np.testing.assert_allclose((np.eye(2) - slope[1:, 1:]) @ step[1:], [0.3, 0.2])


@pytest.mark.parametrize("slid", [0.7, 0.0])
def test_a_body_that_slides_on_repeats_but_for_its_way(slid):
    """The first entry is its place, the second its speed."""
    slope, start = np.array([[1.0, 2.0], [0.0, 0.3]]), near(0.0, 1e-3)
    start.shifts = np.array([[1.0, 0.0]])

    def moved_on(start):
        recorded = cycle(start, slope)
        recorded.end.vector = recorded.end.vector + np.array([slid, 0.0])
        return recorded

    shot = iterated(Shot(start), moved_on(start), TOLERANCE)
    assert isinstance(shot, Shot)
    assert shot.lane.vector[1] == pytest.approx(FIXED[1])
    shot.lane.shifts = start.shifts
    recorded = moved_on(shot.lane)
    assert isinstance(iterated(shot, recorded, TOLERANCE), Converged)
    np.testing.assert_allclose(recorded.drift, [slid, 0.0], atol=1e-12)


def test_noise_of_the_steps_is_told_from_the_way_of_a_body_that_slides_on():
    slope, shifts = np.array([[1.0, 2.0], [0.0, 0.999]]), np.array([[1.0, 0.0]])
    cycles = []
    for noise in (1e-8, -1e-8):
        start = near(0.0, 0.0)
        start.shifts = shifts
        cycles.append(cycle(start, slope, noise=np.array([0.7, noise])))
    led_to = iterated(Shot(cycles[1].start, before=cycles[0]), cycles[1], TOLERANCE)
    assert isinstance(led_to, Shot)
    assert led_to.lane.control.rtol < RTOL


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_derivative_that_overflows_ends_the_iteration_and_nothing_else(value):
    start = at(FIXED)
    recorded = Recorded(start, near(1e-6), 1, True, SWING, np.diag([value, 0.1]), NOTHING)
    assert iterated(Shot(start), recorded, TOLERANCE) is Failure.ASTRAY
    assert np.isnan(recorded.multipliers).all()
    assert recorded.left == 0


def test_a_contact_that_sticks_holds_a_body_that_nothing_else_does():
    """The first entry is the place of the body, the last one that of the contact, which would have to move with it."""
    start = near(0.0, 0.0)
    start.vector, start.shifts = np.zeros(3), np.array([[1.0, 0.0, 1.0]]) / np.sqrt(2)
    for row, held in (([0.2, 0.0, 0.0], False), ([0.0, 0.0, 1.0], True)):
        slope = np.array([[0.9, 0.1, 0.1], [0.0, 0.3, 0.0], row])
        recorded = Recorded(start, at(np.zeros(3)), 1, True, SWING, slope, NOTHING)
        assert recorded.multipliers.size == 2
        if held:
            np.testing.assert_allclose(recorded.multipliers, [0.9, 0.3])
        step = recorded.newton_step(np.array([0.1, 0.2, 0.0]))
        assert (step @ start.shifts[0] == pytest.approx(0.0, abs=1e-12)) != held
