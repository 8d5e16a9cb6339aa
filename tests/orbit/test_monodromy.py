"""The derivative of a motion by its start: by products of whole matrices it is the one that is led step by step."""

from dataclasses import replace

import numpy as np
import pytest
import zoo
from systems import at_rest, excitation, generated_model, oscillator, pad, structure

from timesim.model.model import SEPARATION, SLIP, STICK, Model
from timesim.model.solver import Solver
from timesim.orbit import batch
from timesim.orbit.settling import Chain, first_lane

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
        pytest.param("rk4", coupled(generated_model(9, 2, 1)), id="coupled"),
        pytest.param("tsit5", straight(), id="straight"),
        pytest.param("tsit5", stiff(), id="stiff"),
        pytest.param("dopri8", oscillator(-1.0, 0.97), id="opens", marks=pytest.mark.slow),
    ],
)
def test_both_ways_give_the_same_derivative(method, model, monkeypatch):
    solver = Solver("rk4", 1e-6, 1e-8, longest=2 * np.pi / 200) if method == "rk4" else Solver(method, 1e-6, 1e-8)
    led, lead = [], batch.Disturbed.lead
    monkeypatch.setattr(batch.Disturbed, "lead", lambda *args, **options: led.append(1) or lead(*args, **options))
    lane, found = first_lane(Chain(model, (model.excitation.frequency,)), solver), []
    for many in (0, np.inf):
        monkeypatch.setattr(batch, "MANY", many)
        found.append(batch.record([lane], solver, [CYCLES])[0])
        assert bool(led) == (many == 0)
        led.clear()
    products, columns = (one.slope for one in found)
    states = set(found[0].steps.state.ravel().tolist())
    print(found[0].steps.h.size, "steps", states)
    assert {STICK, SLIP} <= states or {SLIP, SEPARATION} <= states
    np.testing.assert_allclose(products, columns, rtol=0, atol=1e-11 * np.abs(columns).max())
