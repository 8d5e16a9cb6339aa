"""The derivative of a motion by its start: by products of matrices, by automatic differentiation, in closed form."""

from dataclasses import replace

import numpy as np
import pytest
import zoo
from systems import at_rest, excitation, generated_model, oscillator, pad, structure

from timesim.model.held import springs
from timesim.model.model import GROUND, SEPARATION, SLIP, STICK, Contact, Model, Structure
from timesim.model.solver import Solver
from timesim.orbit import batch
from timesim.orbit.monodromy import disturbed
from timesim.orbit.settling import Chain, first_lane

pytestmark = pytest.mark.long

CYCLES = 3


def coupled(model: Model) -> Model:
    """With a damper between the first two modes."""
    own = np.diag(model.structure.damping)
    whole = own + 0.4 * own.max() * np.outer(*2 * [[1.0, -1.0, *np.zeros(len(own) - 2)]])
    return replace(model, structure=replace(model.structure, damping=whole))


def straight() -> Model:
    """A contact that moves along a line: one axis of the plane is left out."""
    body = structure([30.0, 50.0], [0.2, 0.3], [[1.0, 0.0, 0.8], [1.0, 0.0, 0.6]])
    return Model(body, (pad(0.5, 20.0, 20.0, 3.0),), excitation(1.2, [5.0, 2.0], [0.0, 0.0]), at_rest(2, 1))


def stiff() -> Model:
    """A contact whose direction of slip explicit steps do not resolve: see `test_shooting`."""
    model, base = zoo.structure(425, (2e-2, 0.3), (3, 1))
    load = replace(model.excitation, frequency=0.6 * base, cosine=8 * np.abs(model.excitation.cosine))
    return replace(model, excitation=load)


@pytest.mark.parametrize(
    ("method", "model"),
    [
        pytest.param("tsit5", generated_model(5, 4, 2), id="4x2", marks=pytest.mark.slow),
        pytest.param("rk4", coupled(generated_model(9, 2, 1)), id="coupled", marks=pytest.mark.slow),
        pytest.param("tsit5", straight(), id="straight", marks=pytest.mark.slow),
        pytest.param("tsit5", stiff(), id="stiff"),
        pytest.param("dopri8", oscillator(-1.0, 0.97), id="opens", marks=pytest.mark.slow),
    ],
)
def test_both_ways_give_the_same_derivative(method, model, monkeypatch):
    """Where no mode is taken out of the rates."""
    solver = Solver("rk4", 1e-6, 1e-8, longest=2 * np.pi / 200) if method == "rk4" else Solver(method, 1e-6, 1e-8)
    led, moved = [], disturbed.Disturbed.moved
    monkeypatch.setattr(disturbed.Disturbed, "moved", lambda *args: led.append(1) or moved(*args))
    monkeypatch.setattr(disturbed, "FAST", np.inf)
    lane, found = first_lane(Chain(model, (model.excitation.frequency,)), solver), []
    for many in (0, np.inf):
        monkeypatch.setattr(batch, "MANY", many)
        monkeypatch.setattr(batch, "LOST", np.inf)
        found.append(batch.record([lane], solver, [CYCLES])[0])
        assert bool(led) == (many == 0)
        led.clear()
    products, columns = (one.slope for one in found)
    states = set(found[0].steps.state.ravel().tolist())
    print(found[0].steps.h.size, "steps", states)
    assert {STICK, SLIP} <= states or {SLIP, SEPARATION} <= states
    np.testing.assert_allclose(products, columns, rtol=0, atol=1e-11 * np.abs(columns).max())


def held_by_a_stiff_pad(stiffness: float) -> Model:
    """Two modes and a pad that sticks so stiffly that explicit steps are at the limit of stability all along."""
    natural, points = np.array([10.0, 25.0]), ("tip", "far")
    shape = np.array([[[1.0, 0.5], [0.0, 0.0], [0.3, -0.6]], [[0.2, 1.0], [0.0, 0.0], [0.0, 0.0]]])
    omega = 2 * np.pi * natural
    body = Structure(natural, np.ones(2), 0.02 * omega, points, shape)
    contact = Contact("pad", "tip", GROUND, np.eye(3), 0.5, stiffness * np.eye(2), stiffness, 6000.0)
    return Model(body, (contact,), excitation(8.0, 30 * shape[1, 0], [0.0, 0.0]), at_rest(2, 1))


@pytest.mark.parametrize("method", ["tsit5", pytest.param("dopri8", marks=pytest.mark.slow)])
def test_multipliers_of_a_structure_that_a_stiff_contact_holds(method):
    """Explicit steps of themselves let its fast vibration grow 30,000 times in a cycle, or die out."""
    model = held_by_a_stiff_pad(1e9)
    lane = first_lane(Chain(model, (8.0,)), Solver(method, 1e-6, 1e-8))
    recorded = batch.record([lane], Solver(method, 1e-6, 1e-8), [1])[0]
    assert (recorded.steps.state == STICK).all()
    K, D = np.diag(model.structure.stiffness), np.diag(model.structure.damping)
    K = K + model.contact_shape[0].T @ springs(model.contacts[0]) @ model.contact_shape[0]
    exact = np.exp(np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -D]])) / 8.0)
    np.testing.assert_allclose(np.sort(np.abs(recorded.multipliers)), np.sort(np.abs(exact)), rtol=1e-4)


def test_a_mode_whose_shape_is_vague_is_not_taken_out():
    """A critically damped one has one shape for two rates."""
    fast = disturbed.modes_of(np.array([[0.0, 1.0, 0.0], [-4.0, -4.0, 0.0], [0.0, 0.0, -3.0]]))
    np.testing.assert_allclose(fast.rates, [-3.0])
    assert fast.fastest(0).rates.size == 0


@pytest.mark.parametrize(("method", "order"), [("tsit5", 5), ("dopri5", 5), ("dopri8", 8), ("rk4", 4)])
def test_error_of_a_vibration_in_a_step(method, order):
    """It is of an order higher than the method's."""
    angles = np.array([0.4, 0.8])
    errors = disturbed.error_of(method, angles)
    assert np.log2(errors[1] / errors[0]) > order + 0.8
    assert disturbed.error_of("rk4", 0.1) == pytest.approx(0.1**5 / 120, rel=1e-2)


def test_modes_that_are_taken_out_of_the_rates_act_on_slip_as_they_do_within_them(monkeypatch):
    """All of them, over steps that are fine enough for either way."""
    model, solver, found = oscillator(3.0, 1.39), Solver("tsit5", 1e-10, 1e-12), []
    lane = first_lane(Chain(model, (1.39,)), solver)
    monkeypatch.setattr(batch, "MANY", 0)
    for fast in (np.inf, 0.0):
        monkeypatch.setattr(disturbed, "FAST", fast)
        found.append(batch.record([lane], solver, [CYCLES])[0])
    within, taken = (one.slope for one in found)
    assert {STICK, SLIP} <= set(found[0].steps.state.ravel().tolist())
    np.testing.assert_allclose(taken, within, rtol=0, atol=1e-8 * np.abs(within).max())


def opens_and_never_rubs() -> Model:
    """A contact with a full K_u that opens, and a stop that no mode moves along its plane."""
    body = structure([30.0, 50.0], [0.6, 0.8], [[1.0, 0.3, 0.8], [-0.4, 1.0, 0.6]])
    rub = replace(pad(0.4, 1.0, 20.0, 2.0), tangential_stiffness=np.array([[12.0, 3.0], [3.0, 8.0]]))
    shape = np.concatenate([body.shape, [[[0.0, 0.0], [0.0, 0.0], [0.7, -0.5]]]])
    stop = Contact("stop", "end", GROUND, np.eye(3), 0.0, np.zeros((2, 2)), 30.0, -1.0)
    body = replace(body, points=("tip", "end"), shape=shape)
    return Model(body, (rub, stop), excitation(0.9, [6.0, 2.0], [0.0, 1.0]), at_rest(2, 2))


@pytest.mark.parametrize(
    "model",
    [
        pytest.param(opens_and_never_rubs(), id="opens"),
        pytest.param(coupled(generated_model(9, 2, 1)), id="coupled"),
        pytest.param(straight(), id="straight"),
    ],
)
def test_collocation_leads_a_disturbance_as_explicit_steps_do(model, monkeypatch):
    """Through all states of a contact, beside one without any motion along its plane, where damping couples modes."""
    found = []
    monkeypatch.setattr(batch, "MANY", 0)  # products of matrices compile for less
    for method in ("exponential", "tsit5"):
        solver = Solver(method, 1e-10, 1e-12)
        lane = first_lane(Chain(model, (model.excitation.frequency,)), solver)
        found.append(batch.record([lane], solver, [CYCLES])[0])
    assert set(found[0].steps.state[:, -1].tolist()) == {STICK, SLIP, SEPARATION}
    own, other = (one.slope for one in found)
    np.testing.assert_allclose(own, other, rtol=0, atol=1e-7 * np.abs(other).max())


@pytest.mark.parametrize("seed", [7010, 7011, 7025])
def test_collocation_leads_a_disturbed_direction_of_slip_however_long_its_steps(seed):
    """Where a contact opens or has just closed, a disturbed one turns back within a part of a step."""
    model = zoo.driven(seed, (3, 2))[0]
    model = zoo.with_full_stiffness(model, seed) if seed % 2 else model
    chain, fine, coarse = Chain(model, (model.excitation.frequency,)), Solver("dopri8", 1e-10, 1e-12), 1e-6
    lane = batch.march_lanes([first_lane(chain, fine)], fine, 20)[0][0]
    exact = batch.record([lane], fine, [1])[0]
    assert set(exact.steps.state.ravel().tolist()) == {STICK, SLIP, SEPARATION}
    solver = Solver("exponential", coarse, coarse / 100)
    own = batch.record([replace(lane, control=first_lane(chain, solver).control)], solver, [1])[0]
    np.testing.assert_allclose(own.slope, exact.slope, rtol=0, atol=2e-4 * np.abs(exact.slope).max())
