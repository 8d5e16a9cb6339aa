"""The length of a step: the error of every part of the state bounds it, PI control chooses the next one."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from simulation import Trace, simulate
from systems import at_rest, excitation, oscillator, pad, structure

from timesim.engine.companion import state_error
from timesim.engine.solver import Solver, next_length, step_control
from timesim.engine.step import advanced, controlled
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run
from timesim.model.model import SEPARATION, SLIP, STICK, Model
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

RTOL = (1e-4, 1e-5, 1e-6, 1e-7)


def heavy_body_on_a_soft_pad() -> Model:
    """A body driven along an ellipse by forces, which a soft pad hardly feels.

    The pad's force follows the direction of the motion within a hundredth of a cycle, while the body moves smoothly:
    the steps that are short enough for the body are far too long for the slip.
    """
    natural, stiffness = 0.3, 1e-6
    body = structure([natural**2] * 2, [0.02 * natural] * 2, [[1, 0, 0], [0, 1, 0]])
    load = excitation(1 / (2 * np.pi), [1.0, 0.0], [0.0, 0.5])
    contact = pad(0.3, stiffness, 0.0, 0.05 * stiffness / 0.3)
    return Model(body, (contact,), load, at_rest(2, 1))


@pytest.fixture(scope="module")
def exact() -> Trace:
    return simulate(heavy_body_on_a_soft_pad(), 3, Solver("dopri8", 1e-13, 1e-15))


def test_the_body_hardly_feels_the_pad(exact: Trace):
    alone = simulate(replace(heavy_body_on_a_soft_pad(), contacts=(), start=at_rest(2, 0)), 3)
    assert np.abs(exact.motion - alone.motion).max() < 1e-5 * np.abs(exact.motion).max()
    assert exact.run.state.tolist() == [SLIP]


@pytest.mark.parametrize("rtol", RTOL)
def test_the_error_of_the_slip_alone_shortens_the_step(exact: Trace, rtol: float):
    """The dissipation adds up the slip of all steps; the slip at the end forgets earlier errors."""
    found = simulate(heavy_body_on_a_soft_pad(), 3, Solver("tsit5", rtol, rtol / 100))
    dissipated, truth = found.totals.work[-1][2], exact.totals.work[-1][2]
    assert abs(dissipated / truth - 1) < rtol
    assert np.abs(found.run.slip - exact.run.slip).max() < rtol * np.abs(exact.run.slip).max()
    assert found.sequence == exact.sequence


CONTROL = step_control(Solver("tsit5", 1e-6, 1e-8, longest=1.0), 1.0)


def length_after(asked: float, last_error: float, error: float, h: float) -> float:
    """Length after a step of a method of fifth order."""
    before = (jnp.asarray(asked), jnp.asarray(last_error))
    return float(next_length(CONTROL, 5, before, jnp.asarray(error), jnp.asarray(h), jnp.asarray(error <= 1)))


@pytest.mark.parametrize(("error", "last_error"), [(0.3, 0.7), (0.5, 0.02), (0.9, 1.0)])
def test_the_next_length_is_that_of_pi_control(error: float, last_error: float):
    expected = 0.9 * 0.01 * error ** (-0.7 / 5) * last_error ** (0.4 / 5)
    assert length_after(0.01, last_error, error, 0.01) == pytest.approx(expected, rel=1e-12)


def test_the_length_after_a_step_that_is_rejected_or_cut_short():
    assert length_after(0.01, 0.7, 3.0, 0.01) == pytest.approx(0.9 * 0.01 * 3.0 ** (-1 / 5), rel=1e-12)
    assert length_after(0.01, 1.0, 0.9, 0.001) == 0.01
    assert length_after(0.9, 1.0, 1e-9, 0.9) == 1.0


def test_the_control_forgets_at_the_end_of_a_cycle():
    model = oscillator(3.0, 1.39)
    run = Run(model, [Phase(1.39, 5)], Solver("tsit5", 1e-6, 1e-8))
    now = Frame(model, run.reduction, 1.39).begin(system_of(model, 1.39, 0.0, run.reduction), run, 0.01)
    now = replace(now, tried=now.tried + 7)
    ended = replace(now, cycle=now.cycle + 1)
    found = [
        controlled(CONTROL, now, after, jnp.asarray(0.3), jnp.asarray(0.05), jnp.asarray(accepted))
        for after, accepted in ((ended, True), (now, True), (now, False))
    ]
    assert [int(state.tried) for state in found] == [0, 8, 8]
    assert [float(state.length) for state in found] == [CONTROL.opening, 0.05, 0.05]
    assert [float(state.last_error) for state in found] == [1.0, 0.3, now.last_error]


@pytest.mark.parametrize(
    ("before", "after", "accepted", "length"),
    [
        (SEPARATION, SLIP, True, CONTROL.closing),
        (SEPARATION, SLIP, False, 0.05),
        (SEPARATION, STICK, True, 0.05),
        (STICK, SLIP, True, 0.05),
    ],
)
def test_slip_begins_with_a_short_step_where_a_contact_closes(before: int, after: int, accepted: bool, length: float):
    model = oscillator(-1.0, 0.97)
    run = Run(model, [Phase(0.97, 5)], Solver("tsit5", 1e-6, 1e-8))
    now = Frame(model, run.reduction, 0.97).begin(system_of(model, 0.97, 0.0, run.reduction), run, 0.01)
    now, new = (replace(now, state=jnp.asarray([state])) for state in (before, after))
    found = controlled(CONTROL, now, new, jnp.asarray(0.3), jnp.asarray(0.05), jnp.asarray(accepted))
    assert float(found.length) == length


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-6, 1e-7, 1e-8])
def test_the_error_of_slip_that_begins_where_a_contact_closes_follows_the_tolerance(rtol: float):
    """Two contacts, which open 26 times in 20 cycles; long first steps of the slip left errors of 0.06 to 0.4 rtol."""
    columns = {
        "frequency": (0.27503, 0.9468, 1.20454),
        "damping_ratio": (0.01671, 0.01442, 0.04153),
        "mass": (1.66511, 1.09153, 1.58932),
        "p0": ([-0.8806, 0.9068, 0.9681], [0.6447, -0.3408, -0.4116], [0.4859, -0.3657, -0.2508]),
        "p1": ([0.4296, -0.8846, 0.4381], [0.3588, 0.4313, 0.3526], [-0.1836, 0.9513, 0.4481]),
        "p2": ([0.6425, -0.906, -0.5711], [-0.6022, 0.467, -0.7233], [-0.0588, -0.9397, 0.5465]),
    }
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    modes = [{"shape": {point: row.pop(point) for point in ("p0", "p1", "p2")}} | row for row in rows]
    numbers = ("friction", "tangential_stiffness", "normal_stiffness", "preload")
    contacts = [
        {"name": name, "point": name, "normal": normal} | dict(zip(numbers, values, strict=True))
        for name, normal, values in (
            ("p1", [-1.473, 0.824, -0.11], (0.303386, 7.71844, 2.87696, 36.7453)),
            ("p2", [-1.419, -0.056, -0.106], (0.239516, 5.76738, 3.83425, 124.811)),
        )
    ]
    forces = [
        {"point": "p2", "direction": [1.085, 0.713, -0.155], "amplitude": 684.867, "phase_deg": 113.2},
        {"point": "p0", "direction": [1, 0, 0], "amplitude": 236.004, "harmonic": 2},
    ]
    scene = {"structure": {"modes": modes}, "contacts": contacts, "study": {"kind": "transient", "cycles": 20}}
    model = load_scene(scene | {"excitation": {"frequency": 0.357534, "forces": forces}}).model()
    true = simulate(model, 20, Solver("dopri8", 1e-12, 1e-14))
    found = simulate(model, 20, Solver("dopri8", rtol, rtol / 100))
    assert found.sequence == true.sequence
    size = np.abs(true.motion[-200:]).max()
    assert np.abs(found.run.displacement - true.run.displacement).max() < 0.01 * rtol * size


def test_a_fine_tolerance_is_kept_where_slip_begins_as_a_contact_closes() -> None:
    """Two contacts with full K_u. A first step ten times as long erred by 1.5e-8 at any tolerance, and was not seen."""
    scene = load_scene(Path(__file__).parents[1] / "data" / "closing.yaml")
    fine, other = (simulate(scene.model(), 40, Solver(name, 1e-11, 1e-13)) for name in ("dopri8", "tsit5"))
    assert fine.sequence == other.sequence
    assert state_error(scene.model(), 110, fine.run, other.run, fine.totals.size) < 3e-10


@pytest.mark.parametrize(
    ("h", "crossed", "repeats"), [(1e-12, True, 6), (1e-12, False, 5), (0.1, True, 0), (0.1, False, 0)]
)
def test_only_transitions_in_a_row_are_counted_as_repeated(h: float, crossed: bool, repeats: int):
    """Whatever there was before some time has passed: many contacts that switch in pairs are no accumulation."""
    model = oscillator(3.0, 1.39)
    run = Run(model, [Phase(1.39, 5)], Solver("tsit5", 1e-6, 1e-8))
    system = system_of(model, 1.39, 0.0, run.reduction)
    now = replace(
        Frame(model, run.reduction, 1.39).begin(system, run, 0.01), repeats=jnp.asarray(5), since=jnp.zeros(())
    )
    end = (now.point, now.rate)
    after = advanced(system, now, end, now.state, jnp.asarray(h), jnp.asarray(False), jnp.asarray([crossed]))
    assert int(after.repeats) == repeats
    assert float(after.since) == (0.0 if crossed else h)
