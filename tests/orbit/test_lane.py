"""What a lane is made of: the control of its steps, and where it may be moved to."""

import numpy as np
import pytest
from systems import oscillator

from timesim.model.model import SLIP, STICK, Start
from timesim.model.reduction import reduction_of
from timesim.model.solver import Solver
from timesim.orbit.lane import Lane
from timesim.orbit.settling import Chain, first_lane

FREQUENCY, SOLVER = 1.39, Solver("tsit5", 1e-7, 1e-9)


def lane_of(preload: float = 3.0) -> Lane:
    return first_lane(Chain(oscillator(preload, FREQUENCY), (FREQUENCY,)), SOLVER)


def test_the_control_of_its_steps_knows_how_fast_the_structure_is_beside_the_excitation():
    lane = lane_of()
    assert float(lane.control.stiffest) == pytest.approx(lane.model.stuck_rate / (2 * np.pi * FREQUENCY))


def test_finer_steps_have_both_tolerances_finer():
    """The absolute one would rule alone else: it is a share of the scene's own scale."""
    finer = lane_of().within(1e-11).control
    assert (float(finer.rtol), float(finer.atol)) == pytest.approx((1e-11, 1e-13))
    assert float(finer.stiffest) == float(lane_of().control.stiffest)


def test_a_contact_that_slips_sticks_where_the_cone_runs_ahead_of_its_force():
    """That is where c of (9) is negative, f^T K_u u' < mu^2 n n'; on the cone its force is either way."""
    model, random, states = oscillator(3.0, FREQUENCY), np.random.default_rng(5), []
    contact, along = model.contacts[0], np.array([0.6, 0.8])
    K, mu = contact.tangential_stiffness, contact.friction
    for _ in range(40):
        q, dq = random.normal(scale=0.05, size=2), random.normal(scale=0.5, size=2)
        load = contact.preload + contact.normal_stiffness * (model.contact_shape[0] @ q)[2]
        w = (model.contact_shape[0] @ q)[:2] - np.linalg.solve(K, mu * load * along)
        slips = Start(q, dq, w[None], np.array([SLIP]), 0.0)
        lane = Lane.begin(model, reduction_of(model, (FREQUENCY,), reduce=False), FREQUENCY, SOLVER, slips)
        moved = lane.moved(lane.vector * (1 + random.normal(scale=0.1, size=lane.vector.size)))
        assert moved is not None
        end = moved.start()
        (*u, v), (*du, dv) = (model.contact_shape[0] @ part for part in (end.displacement, end.velocity))
        n, dn = contact.preload + contact.normal_stiffness * v, contact.normal_stiffness * dv
        f = K @ (u - end.slip[0])
        assert np.linalg.norm(f) == pytest.approx(mu * n)
        assert (end.state[0] == SLIP) == (f @ K @ du >= mu**2 * n * dn)
        states.append(int(end.state[0]))
    assert set(states) == {STICK, SLIP}
