"""Recorded cycles: what is measured of them, whatever their number, and of a body that slides on."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from systems import at_rest, excitation, oscillator, pad, structure

from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import SHOOT, Criterion, Solver
from timesim.orbit.batch import march_lanes, record
from timesim.orbit.lane import Lane
from timesim.orbit.settling import Chain, first_lane, steady_states
from timesim.orbit.threshold import CYCLES_A_ROUND

pytestmark = pytest.mark.long

FINE = Solver("tsit5", 1e-9, 1e-11)


def sled() -> Model:
    """A mass on a plane that is shaken and pushed along it: it creeps ahead in each cycle."""
    body = structure([0.0], [0.0], [[1.0, 0.0, 0.0]])
    return Model(body, (pad(0.3, 100.0, 0.0, 1.0),), excitation(1.0, [0.2], [0.0], [0.25]), at_rest(1, 1))


MODELS = {"slips": lambda: oscillator(3.0, 1.39), "separates": lambda: oscillator(-1.0, 0.97), "slides on": sled}


@cache
def settled_lane(name: str) -> Lane:
    """At the start of a cycle of the steady state."""
    model = MODELS[name]()
    frequency = model.excitation.frequency
    (orbit,) = steady_states([Chain(model, (frequency,))], FINE, Criterion(1e-10, 1500, SHOOT))[0]
    assert orbit.settled
    return Lane.begin(model, reduction_of(model, (frequency,), reduce=True), frequency, FINE, orbit.end)


@pytest.mark.parametrize("name", ["separates", "slides on"])
def test_three_cycles_of_a_motion_show_what_one_does(name: str):
    lane = settled_lane(name)
    one, three = (record([lane], FINE, [cycles])[0].orbit(9, cycles, 0.0) for cycles in (1, 3))
    assert one.drift.any() == (name == "slides on")
    size = one.largest
    for own in ("amplitude", "drift", "phasor"):
        np.testing.assert_allclose(getattr(three, own), getattr(one, own), rtol=0, atol=1e-7 * size, err_msg=own)
    for own in ("dissipated_power", "slip_share", "separation_share", "cycle_transitions"):
        np.testing.assert_allclose(getattr(three, own), getattr(one, own), rtol=1e-6, err_msg=own)
    np.testing.assert_allclose(three.cycle_steps, one.cycle_steps, rtol=0.1)
    np.testing.assert_allclose(np.abs(three.floquet[0]), np.abs(one.floquet[0]) ** 3, rtol=1e-5)


def test_the_amplitude_is_that_of_all_cycles_together():
    """Of a motion that has not settled: one that moves on goes far beyond what it does in a cycle."""
    (recorded,) = record([settled_lane("slides on")], FINE, [6])
    orbit = recorded.orbit(6, 0, np.nan)
    x = recorded.steps.end.q @ recorded.start.frame.shape.T
    np.testing.assert_allclose(orbit.amplitude.ravel(), 0.5 * np.ptp(x, axis=0), rtol=2e-2)
    assert orbit.amplitude[0, 0] > 3 * orbit.band[1, 0, 0] > 0
    assert not orbit.drift.any()


def test_the_state_after_each_recorded_cycle_is_that_after_each_marched_one():
    lane = first_lane(Chain(oscillator(3.0, 1.39), (1.39,)), FINE)
    (recorded,), ((_, returns),) = record([lane], FINE, [4]), march_lanes([lane], FINE, CYCLES_A_ROUND)
    assert recorded.returns.shape == (4, 4)
    np.testing.assert_allclose(recorded.returns, returns[:4, :4], rtol=0, atol=1e-8)


def test_a_motion_is_held_if_no_contact_leaves_its_state_in_between():
    """Not if it is only in the same states again at the end."""
    recorded = record([settled_lane("slips")], FINE, [1])[0]
    np.testing.assert_array_equal(recorded.end.here.state, recorded.start.here.state)
    assert not recorded.is_held
    stuck = replace(FINE, reduce=False)
    lane = first_lane(Chain(oscillator(64.0, 1.3), (1.3,)), stuck)
    assert record([lane], stuck, [1])[0].is_held
    ((after, _),) = march_lanes([lane], stuck, CYCLES_A_ROUND)
    assert after.quiet > CYCLES_A_ROUND * 2 * np.pi


def test_a_contact_that_is_left_out_counts_as_apart_all_the_time():
    """That of a mode of its own, far from what it could touch, beside a mode with a contact that slips."""
    model, shape = oscillator(1.0, 1.0), np.zeros((2, 3, 2))
    shape[0, :, 0], shape[1, :, 1] = [1.0, 1.0, 0.8], [1.0, 0.5, 0.2]
    near = model.contacts[0]
    model = replace(
        model,
        structure=replace(model.structure, points=("tip", "root"), shape=shape),
        contacts=(replace(near, name="far", point="root", preload=-100.0), near),
        start=at_rest(2, 2),
    )
    lane = first_lane(Chain(model, (1.0,)), FINE)
    assert lane.reduction.apart.tolist() == [0]
    orbit = record([lane], FINE, [2])[0].orbit(2, 0, np.nan)
    assert orbit.separation_share[0] == 1
    assert orbit.separation_share[1] < 1
    assert orbit.slip_share[0] == 0 < orbit.slip_share[1]


@pytest.mark.parametrize(("frame", "normal", "count"), [((1.0, 0.5, 0.0), 20.0, 1), ((1.0, 0.5, 0.3), 20.0, 0),
                                                        ((1.0, 0.5, 0.3), 0.0, 1)])  # fmt: skip
def test_a_free_body_may_be_moved_along_its_contacts_and_alters_no_force(frame, normal, count):
    """Its slips move with it; a contact that its motion presses holds it."""
    body = structure([0.0, 40.0], [0.1, 0.2], [list(frame), [0.4, -0.2, 0.3]])
    model = Model(body, (pad(0.3, 100.0, normal, 1.0),), excitation(1.0, [0.2, 0.0], [0.0, 0.0]), at_rest(2, 1))
    start = replace(first_lane(Chain(model, (1.0,)), FINE).start(), displacement=np.array([0.0, 1e-3]))
    lane = Lane.begin(model, reduction_of(model, (1.0,), reduce=False), 1.0, FINE, start)
    assert len(lane.shifts) == count
    for shift in lane.shifts:
        moved = lane.moved(lane.vector + 50.0 * shift)
        assert moved is not None
        assert moved.size == pytest.approx(lane.size)
        before, after = lane.start(), moved.start()
        assert abs(after.displacement[0] - before.displacement[0]) > 1e-3
        assert after.displacement[1] == pytest.approx(before.displacement[1])
        stretch = [model.contact_shape[0, :2] @ one.displacement - one.slip[0] for one in (before, after)]
        np.testing.assert_allclose(stretch[1], stretch[0], rtol=1e-9)


def test_a_contact_of_another_law_holds_a_body_along_its_surface_too():
    """The cone alone has places where it sticks, which move with the body."""
    lane = first_lane(Chain(sled(), (1.0,)), FINE)
    assert len(lane.shifts) == 1
    other = replace(lane.model.contacts[0], law="another")
    assert len(replace(lane, model=replace(lane.model, contacts=(other,))).shifts) == 0
