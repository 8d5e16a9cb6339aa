"""The dimensionless system: the force of the excitation at any phase of a cycle, and the power of each force."""

from dataclasses import replace
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from systems import excitation as modal_force
from systems import generated_model, pad, structure

from timesim.engine.barrier import matmul
from timesim.engine.event_loop import one_by_one
from timesim.engine.method import Explicit, step_method, tableau
from timesim.engine.system import Point, Work, excitation, system_of
from timesim.engine.trajectory import Frame
from timesim.model.model import SEPARATION, SLIP, Model, Start
from timesim.model.reduction import reduction_of
from timesim.model.scales import scales_of
from timesim.model.solver import Solver


@pytest.mark.parametrize("phase", [0.0, 0.7])
def test_the_force_is_that_of_the_scene(phase: float):
    model = generated_model(1, 3, 2)
    model = replace(model, excitation=replace(model.excitation, harmonic=np.array([1, 4]), constant=np.arange(3.0)))
    load, scales = model.excitation, scales_of(model, 1.3)
    system = system_of(model, 1.3, phase)
    unit = model.structure.mass * scales.mode * scales.omega**2
    for angle in (0.0, 0.4, 3.0):
        turn = load.harmonic * (angle + phase)
        force = load.constant + np.cos(turn) @ load.cosine + np.sin(turn) @ load.sine
        found = np.asarray(excitation(system, jnp.asarray(angle))) * unit
        np.testing.assert_allclose(found, force, rtol=0, atol=1e-12 * np.abs(force).max())


def test_the_power_of_each_force_is_its_own():
    model = generated_model(1, 3, 2)
    damping = np.array([[3.0, 1.0, 0.5], [1.0, 2.0, -0.4], [0.5, -0.4, 1.0]])
    load = replace(model.excitation, constant=np.array([1.0, -2.0, 0.5]))
    system = system_of(replace(model, structure=replace(model.structure, damping=damping), excitation=load), 1.3)
    q, p, w = np.array([0.3, -0.2, 0.1]), np.array([0.2, 0.5, -0.4]), (np.array([0.1, 0.2]), np.array([-0.3, 0.1]))
    zero, state, time = jnp.zeros(()), jnp.asarray([SLIP, SLIP]), jnp.asarray(0.4)
    point = Point(jnp.asarray(q), jnp.asarray(p), tuple(map(jnp.asarray, w)), Work(zero, zero, jnp.zeros(2)))
    power = system.field(state, time, point).work
    acts = system.law.reaction(state, system.motion(point), point.w)
    assert power is not None
    assert float(power.input) == pytest.approx(float(np.asarray(excitation(system, time)) @ p), rel=1e-12)
    assert float(power.damping) == pytest.approx(p @ np.asarray(system.damping) @ p, rel=1e-12)
    rubbing = np.sum([np.asarray(f) * np.asarray(dw) for f, dw in zip(acts.f, acts.dw, strict=True)], axis=0)
    np.testing.assert_allclose(power.friction, rubbing, rtol=1e-12)


def test_a_contact_that_is_proven_open_gives_its_preload_to_the_structure():
    """Left out, it acts as one that is there and apart: the preload that the structure carries at rest is missing."""
    body = structure([1.0], [0.02], [[0, 0, 1]])
    start = Start(np.array([-9.0]), np.zeros(1), np.zeros((1, 2)), np.array([-1]))
    model = Model(body, (pad(0.5, 1.0, 2.0, 1.0),), modal_force(0.3, [0.0], [0.0], [-6.0]), start)
    reduction = reduction_of(model, [0.3])
    assert (reduction.apart.tolist(), reduction.live.size) == ([0], 0)
    q, p, time = jnp.asarray([-0.7]), jnp.asarray([0.2]), jnp.asarray(0.4)
    rates = []
    for system, w in ((system_of(model, 0.3), jnp.zeros(1)), (system_of(model, 0.3, 0.0, reduction), jnp.zeros(0))):
        state = jnp.full(w.shape, SEPARATION)
        rates.append(system.field(state, time, Point(q, p, (w, w)[: len(system.shape) - 1], None)).p)
    np.testing.assert_allclose(rates[1], rates[0], rtol=1e-13)
    assert np.abs(rates[0]).min() > 0.1


def test_friction_losses_stand_under_their_contacts():
    model = generated_model(1, 3, 3)
    reduction = replace(reduction_of(model, [1.3], reduce=False), live=np.array([0, 2]))
    frame = Frame(model, reduction, 1.3)
    energy = frame.scales.energy
    before = np.arange(5.0) * energy
    done = Work(jnp.asarray(1.0), jnp.asarray(2.0), jnp.asarray([3.0, 4.0]))
    found = frame.work(done, before, np.zeros(3))
    np.testing.assert_allclose((found - before) / energy, [1.0, 2.0, 3.0, 0.0, 4.0], rtol=0, atol=1e-12)


def test_a_system_by_itself_has_the_rates_that_it_has_in_a_batch():
    """Its products are others; modes that damping couples, more than are added in one loop."""
    model = generated_model(1, 40, 3)
    assert model.structure.damping.ndim == 2
    system, rng = system_of(model, 1.3), np.random.default_rng(3)
    q, p, w = rng.normal(size=40), rng.normal(size=40), rng.normal(size=(2, 3))
    point, state = Point(jnp.asarray(q), jnp.asarray(p), tuple(map(jnp.asarray, w)), None), jnp.asarray([0, 1, 1])
    found, own = (x.field(state, jnp.asarray(0.4), point) for x in (system, system.single()))
    assert system.single().by_itself
    assert not system.by_itself
    size = np.abs(np.asarray(system.stiffness)).max()
    np.testing.assert_allclose(own.p, found.p, rtol=0, atol=1e-13 * size)
    np.testing.assert_allclose(own.w, found.w, rtol=1e-11)


@pytest.mark.parametrize("shape", [(3, 4, 5), (6, 30, 40)], ids=["summed", "by rows"])
def test_a_product_of_matrices_is_that_of_numpy(shape: tuple[int, int, int]):
    rows, inner, columns = shape
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(rows, inner)), rng.normal(size=(inner, columns))
    np.testing.assert_allclose(matmul(jnp.asarray(a), jnp.asarray(b)), a @ b, rtol=0, atol=1e-13)


def test_many_modes_or_contacts_go_one_after_the_other():
    """Few modes are quicker side by side, whatever the explicit method; collocation never is."""
    tsit5, collocation = (step_method(Solver(name, 1e-6, 1e-8)) for name in ("tsit5", "exponential"))
    for modes, contacts, wide in ((2, 1, False), (10, 2, False), (12, 2, True), (20, 8, True), (40, 1, True)):
        system = system_of(generated_model(1, modes, contacts), 1.3)
        assert one_by_one(tsit5, system, 4) == wide
        assert one_by_one(tsit5, system, 1)
        assert one_by_one(collocation, system, 4)
        batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), system)
        assert batch.wide == wide


@pytest.mark.parametrize("name", ["rk4", "tsit5", "dopri5", "dopri8"])
def test_a_step_whose_stages_are_the_turns_of_a_loop_is_that_of_unrolled_ones(name: str):
    """Also in a structure so large that they are in any case; the tableau ends with the solution."""
    own = tableau(name)
    np.testing.assert_allclose(own.weights.sum(axis=1), own.nodes, atol=1e-15)
    assert own.nodes[-1] == 1
    assert not own.weights[:, -1].any()
    for modes, contacts in ((2, 1), (12, 2)):
        system, rng = system_of(generated_model(1, modes, contacts), 1.3), np.random.default_rng(5)
        q, p, w = rng.normal(size=modes), rng.normal(size=modes), rng.normal(size=(2, contacts))
        point, state = Point(q, p, tuple(w), None), jnp.arange(contacts) % 2
        time, h = jnp.asarray(0.4), jnp.asarray(0.05)
        rate = system.field(state, time, point)
        with patch("timesim.engine.system.WIDE", np.inf):
            unrolled = Explicit(name).advance(system, state, time, point, rate, h)
        for looped in (Explicit(name, looped=True), *([Explicit(name)] if system.wide else [])):
            found = looped.advance(system, state, time, point, rate, h)
            for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(unrolled), strict=True):
                np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * np.abs(other).max(initial=1.0))
