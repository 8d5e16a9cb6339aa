"""Modes that a system has room for beyond those of the model: they change nothing."""

from typing import Any

import numpy as np
import pytest
from simulation import simulate
from systems import generated_model
from zoo import scene_of, structure

import timesim
from timesim.engine import system
from timesim.engine.system import room_of, system_of
from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import Solver

pytestmark = pytest.mark.long

ROUNDING = 1e-9  # a step of collocation is solved to 1e-10 of the state


def whole(model: Model) -> Any:
    return reduction_of(model, [model.excitation.frequency], reduce=False)


def exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have room for the modes of the model alone."""
    monkeypatch.setattr(system, "room_of", lambda reduction: reduction.modes.size)


def test_there_is_room_for_four_sizes_an_octave_and_for_no_more_where_no_contact_is_left():
    rooms = [room_of(whole(generated_model(1, num, 1))) for num in range(1, 34)]
    assert rooms[:16] == [1, 2, 3, 4, 6, 6, 8, 8, 10, 10, 12, 12, 14, 14, 16, 16]
    assert rooms[16:] == [20] * 4 + [24] * 4 + [28] * 4 + [32] * 4 + [40]
    assert room_of(whole(generated_model(1, 5, 0))) == 5


@pytest.mark.parametrize(
    ("method", "seed", "size"),
    [
        ("tsit5", 1, (5, 1)),
        pytest.param("tsit5", 2, (5, 1), marks=pytest.mark.slow),
        pytest.param("exponential", 3, (9, 2), marks=pytest.mark.slow),
    ],
)
def test_a_run_is_what_it_is_without_them(
    method: str, seed: int, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
):
    """Transitions, motion and energies; damping is a matrix in some."""
    model, solver = generated_model(seed, *size), Solver(method, 1e-7, 1e-10)
    assert system_of(model, 1.0, 0.0, whole(model)).stiffness.size > size[0]
    found = simulate(model, 5, solver)
    exactly(monkeypatch)
    assert system_of(model, 1.0, 0.0, whole(model)).stiffness.size == size[0]
    own = simulate(model, 5, solver)
    assert found.sequence == own.sequence
    assert len(own.sequence) > 5
    # By rounding, a step of collocation may be tried once more.
    assert abs(found.num_steps - own.num_steps) <= (method == "exponential")
    np.testing.assert_allclose(found.motion, own.motion, rtol=0, atol=ROUNDING * np.abs(own.motion).max())
    np.testing.assert_allclose(found.amplitude, own.amplitude, rtol=0, atol=ROUNDING * own.amplitude.max())
    work = np.array([total.totals.work for total in (found, own)])
    np.testing.assert_allclose(work[0], work[1], rtol=0, atol=ROUNDING * np.abs(work).max())


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tsit5", "exponential"])
def test_a_sweep_is_what_it_is_without_them(method: str, monkeypatch: pytest.MonkeyPatch):
    """Shot, with its multipliers: all motions of the model decay faster than those of an idle mode."""
    model, base = structure(23, (0.9, 0.95), (5, 1))
    load = model.excitation.cosine * 8
    scene = scene_of(model) | {
        "study": {"kind": "sweep", "frequency": {"values": [0.9 * base, 1.1 * base]}, "periodic": "shoot"},
        "solver": {"method": method, "rtol": 1e-7, "atol": 1e-10},
    }
    for part, force in zip(scene["excitation"]["modal_force"], load[0], strict=True):
        part["amplitude"] = abs(float(force))
    found = timesim.run(scene)
    exactly(monkeypatch)
    own = timesim.run(scene)
    assert np.all((own.slip_share > 0.05) & (own.slip_share < 0.95))
    assert np.array_equal(found.cycles, own.cycles)
    for name in ("amplitude", "floquet_max", "dissipated_power", "slip_share"):
        # A multiplier is what is left of a disturbance of size one: that of an idle mode would be 2e-3.
        size = 1.0 if name == "floquet_max" else float(np.abs(own[name]).max())
        assert size > 0, name
        np.testing.assert_allclose(found[name], own[name], rtol=0, atol=ROUNDING * size, err_msg=name)
