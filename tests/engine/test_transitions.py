"""What follows a transition where the normal load is next to nothing."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from simulation import simulate
from systems import TURN, at_rest, excitation, pad, structure

from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Motion
from timesim.engine.status import Status
from timesim.model.model import SEPARATION, SLIP, STICK, Model, Start
from timesim.model.reduction import reduction_of
from timesim.model.scales import Scales
from timesim.model.solver import Solver
from timesim.orbit.batch import march_lanes
from timesim.orbit.lane import Lane

pytestmark = pytest.mark.long

ONE = Scales(1.0, np.ones(1), 1.0, 1.0, 1.0)
TINY = 1e-10 * (2.0 + 1.0)
"""Load that counts as none of a pad of these stiffnesses."""


def plane(x: float, y: float) -> tuple[jnp.ndarray, jnp.ndarray]:
    return jnp.asarray([x]), jnp.asarray([y])


@pytest.mark.parametrize("n", [-0.1 * TINY, 0.0, 0.5 * TINY, 2 * TINY])
@pytest.mark.parametrize(("before", "after"), [(STICK, SLIP), (SLIP, STICK)])
@pytest.mark.parametrize("rate", [-1.0, 1.0])
def test_a_contact_without_load_opens_only_if_its_load_falls(before: int, after: int, n: float, rate: float):
    """Just after it has touched a contact bears as little, but its load rises. Apart it is open whatever its rate."""
    law = ConeLaw.of([pad(0.4, 2.0, 1.0, 0.0)], ONE)
    motion = Motion(plane(0.0, 0.0), jnp.asarray([n]), plane(1.0, 0.5), jnp.asarray([rate]))
    opens = (rate < 0 and n <= TINY) or n < 0
    found = int(law.successor(jnp.asarray([before]), motion)[0])
    assert found == (SEPARATION if opens else after)


@pytest.mark.parametrize(
    ("n", "rate", "margin"), [(0.5, -1.0, 0.0), (0.5, 1.0, -0.5), (2.0, -1.0, -2.0), (-1.0, -1.0, 1.0)]
)
def test_a_contact_that_has_opened_with_a_load_next_to_nothing_stays_open(n: float, rate: float, margin: float):
    law = ConeLaw.of([pad(0.4, 2.0, 1.0, 0.0)], ONE)
    motion = Motion(plane(0.0, 0.0), jnp.asarray([n * TINY]), plane(1.0, 0.5), jnp.asarray([rate]))
    assert float(law.margins(jnp.asarray([SEPARATION]), motion, motion.u)[0][0]) == pytest.approx(margin * TINY)


@pytest.mark.parametrize("stiffness", [1e2, 1e6, 1e7, 1e8, 1e10])
def test_a_load_that_takes_time_to_fall_is_a_load_however_stiff_the_contact_is_along_its_plane(stiffness: float):
    law = ConeLaw.of([pad(0.4, stiffness, 1.0, 0.0)], ONE)
    motion = Motion(plane(0.0, 0.0), jnp.asarray([5e-5]), plane(1.0, 0.5), jnp.asarray([-1.0]))
    assert int(law.successor(jnp.asarray([STICK]), motion)[0]) == SLIP


@pytest.mark.parametrize("name", ["tsit5", "exponential"])
@pytest.mark.parametrize("preload", [0.3, -0.2])
def test_motion_along_the_normal_is_the_same_however_stiff_the_contact_is_along_its_plane(name: str, preload: float):
    """The size of K_u is none of the load's: at 1e10 times k_v a contact closed and opened late by up to 0.01."""
    body, excited = structure([1.0], [0.02], [[0.0, 0.0, 1.0]]), excitation(1.1 / TURN, [1.0], [0.0])
    soft, *stiff = (
        simulate(Model(body, (pad(0.4, k, 9.0, preload),), excited, at_rest(1, 1)), 6, Solver(name, 1e-8, 1e-10))
        for k in (1.0, 1e8, 1e10, 1e12)
    )
    for trace in stiff:
        np.testing.assert_allclose(trace.motion, soft.motion, rtol=1e-11, atol=0)
        np.testing.assert_allclose(trace.log.time, soft.log.time, rtol=1e-11, atol=0)


@pytest.mark.parametrize("stiffness", [1e2, 1e6, 1e10])
def test_separation_wins_where_a_contact_leaves_cone_and_load_at_once(stiffness: float):
    """In phase with its load, at half of what the friction bears, in straight motion after a contact that sticks."""
    friction, normal = 0.4, 9.0
    body = structure([1.0], [0.02], [[0.5 * friction * normal / stiffness, 0.0, 1.0]])
    model = Model(body, (pad(friction, stiffness, normal, -0.2),), excitation(1.1 / TURN, [1.0], [0.0]), at_rest(1, 1))
    for name in ("tsit5", "exponential"):
        trace = simulate(model, 6, Solver(name, 1e-8, 1e-10))
        assert len(trace.sequence) > 10
        assert {(before, after) for _, before, after in trace.sequence} == {(SEPARATION, STICK), (STICK, SEPARATION)}


def a_cycle_in_short_steps(state: int, displacement: float, velocity: float) -> tuple[Lane, np.ndarray]:
    """Of a mass that moves along the normal of a contact, which is as stiff as a hundred of its springs."""
    body, excited = structure([1.0], [0.02], [[0.0, 0.0, 1.0]]), excitation(1 / TURN, [1.0], [0.0])
    start = Start(np.array([displacement]), np.array([velocity]), np.zeros((1, 2)), np.array([state]))
    model, solver = Model(body, (pad(0.4, 99.0, 1.0, 0.0),), excited, start), Solver("tsit5", 1e-7, 1e-9, budget=1000)
    lane = Lane.begin(model, reduction_of(model, [1 / TURN], reduce=False), 1 / TURN, solver, start)
    short = eqx.tree_at(lambda control: control.opening, lane.control, np.array(1e-9))
    ((end, returns),) = march_lanes([replace(lane, control=short)], solver, 1)
    return end, returns


def test_a_run_goes_on_from_a_contact_that_has_opened_with_a_load_next_to_nothing():
    """In steps so short that its load is gone only after several."""
    end, returns = a_cycle_in_short_steps(SEPARATION, 4e-9, -0.5)
    assert end.status == Status.RUNNING
    assert len(returns) == 1


@pytest.mark.parametrize("state", [STICK, SLIP, SEPARATION])
@pytest.mark.parametrize("speed", [-0.5, -1e-7, 1e-7, 0.5])
def test_a_contact_that_begins_beyond_its_guard_goes_on_in_the_state_that_it_has_reached(state: int, speed: float):
    """By some times the tolerance of a guard: every step was cut to nothing until the budget was spent."""
    beyond = 4e-9 if state == SEPARATION else -4e-9
    _, returns = a_cycle_in_short_steps(state, beyond, speed)
    _, right = a_cycle_in_short_steps(STICK if state == SEPARATION else SEPARATION, beyond, speed)
    assert len(returns) == 1
    np.testing.assert_allclose(returns[0][:2], right[0][:2], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("second", "third"), [(5e-12, 2e-11), (8e-12, 3e-11), (8e-12, 1e-10)])
def test_stops_that_close_almost_at_once_all_close(second: float, third: float):
    """The second closes with the first, a little before its time; to the third there is a step shorter than that."""
    body, excited = structure([1.0], [0.02], [[0.0, 0.0, 1.0]]), excitation(1 / TURN, [1.0], [0.0])
    start = Start(np.array([0.0]), np.array([1e-3]), np.zeros((3, 2)), np.full(3, SEPARATION))
    stops = tuple(replace(pad(0.0, 0.0, 1.0, -1e-4 - x), name=str(x)) for x in (0.0, second, third))
    trace = simulate(Model(body, stops, excited, start), 1, Solver("tsit5", 1e-7, 1e-9, budget=1000))
    inside = trace.log.time < 0.1
    state = np.full(3, SEPARATION)
    state[trace.log.contact[inside]] = trace.log.after[inside]
    np.testing.assert_array_equal(state, SLIP)
    assert STICK not in trace.log.after


def test_a_contact_without_friction_has_no_speed_at_which_it_sticks():
    law = ConeLaw.of([pad(0.0, 0.0, 1.0, 1.0)], ONE)
    motion = Motion(plane(0.1, 0.2), jnp.asarray([0.5]), plane(0.03, -0.04), jnp.asarray([0.0]))
    _, speed = law.margins(jnp.asarray([SLIP]), motion, plane(0.1, 0.2))
    assert float(speed[0]) == 1.0


@pytest.mark.parametrize(("speed", "after"), [(0.15, STICK), (0.25, SLIP), (0.45, SLIP)])
def test_a_contact_that_closes_sticks_if_its_force_stays_below_mu_n(speed: float, after: int):
    """|K_u u'| against mu n', not against n' (15 to 17)."""
    law = ConeLaw.of([pad(0.4, 2.0, 1.0, 0.0)], ONE)
    motion = Motion(plane(0.0, 0.0), jnp.asarray([0.0]), plane(0.6 * speed, 0.8 * speed), jnp.asarray([1.0]))
    assert int(law.successor(jnp.asarray([SEPARATION]), motion)[0]) == after
