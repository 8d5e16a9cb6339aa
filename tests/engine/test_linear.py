"""Runs of which no contact is left, in closed form: against steps through the whole scene, and exact answers."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulation import Trace, follow, relative_error
from systems import at_rest, excitation, oscillator, provable_model, structure

import timesim
from timesim.engine.companion import rounding
from timesim.engine.status import RunError
from timesim.engine.trajectory import Phase, Run
from timesim.model.held import natural_modes
from timesim.model.model import Model, Start
from timesim.model.reduction import reduction_of
from timesim.model.solver import CLOSED_FORM, Solver
from timesim.scene.report import describe
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

CLOSED = Solver(CLOSED_FORM, 1e-11, 1e-13)
ROOT = Path(__file__).parents[2]
OSCILLATOR = ROOT / "configs" / "oscillator.yaml"
STUCK = {"contacts.pad.preload": 40.0}


def solved(model: Model, cycles: int, frequency: float | None = None, solver: Solver = CLOSED) -> Trace:
    chosen = model.excitation.frequency if frequency is None else frequency
    assert chosen is not None
    return follow(Run(model, [Phase(chosen, cycles)], solver))


# Whole structures


@pytest.mark.parametrize("seed", [326, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(301, 307))])
def test_structures_with_stuck_and_open_contacts_against_steps_through_the_whole_scene(seed: int) -> None:
    """Contacts that stick on an offset, gaps, several harmonics, constant forces, damping that couples the modes."""
    model = provable_model(seed, 1e3)
    frequency = model.excitation.frequency
    assert frequency is not None
    assert not reduction_of(model, [frequency]).live.size
    found, stepped = solved(model, 20), solved(model, 20, solver=Solver("tsit5", 1e-12, 1e-14, reduce=False))
    for mine, other in (("displacement", 1e-11), ("velocity", 1e-11), ("slip", 1e-11)):
        np.testing.assert_allclose(
            getattr(found.run, mine),
            getattr(stepped.run, mine),
            rtol=0,
            atol=other * np.abs(getattr(stepped.run, mine)).max(),
        )
    assert relative_error(found.amplitude, stepped.amplitude) < 3e-9
    for part in ("work", "stored"):
        assert relative_error(np.array(getattr(found.totals, part)), getattr(stepped.totals, part)) < 1e-10
    assert np.array_equal(found.run.state, stepped.run.state)
    assert found.run.time == pytest.approx(stepped.run.time, rel=1e-14)
    assert found.sequence == stepped.sequence == []
    assert max(found.energy_residual, stepped.energy_residual) < 1e-11
    assert rounding(found.run, found.totals).state < 1e-12


@pytest.mark.parametrize("solver", [CLOSED, Solver("tsit5", 1e-10, 1e-12)], ids=str)
def test_energy_of_a_contact_that_is_proven_to_stick_on_an_offset(solver: Solver) -> None:
    """What its spring does by the offset is stored in it: the excitation has not put it in."""
    model = oscillator(40.0, 1.39)
    model = replace(model, start=replace(model.start, slip=np.array([[0.3, -0.1]])))
    whole = solved(model, 3, solver=Solver("tsit5", 1e-10, 1e-12, reduce=False))
    reduced = solved(model, 3, solver=solver)
    assert reduction_of(model, [1.39]).stuck.size == 1
    assert reduced.energy_residual < 1e-9
    np.testing.assert_allclose(reduced.totals.work, whole.totals.work, rtol=1e-8, atol=1e-9 * whole.totals.peak)


def test_natural_frequencies_beside_a_contact_ten_billion_times_as_stiff() -> None:
    """They are the roots of 1 + k sum_i b_i^2 / (w_i^2 - w^2), which keep all digits."""
    body = structure([1.0, 4.0, 9.0], [0.02, 0.02, 0.02], [[1, 0, 1], [0.5, 0, -1], [0.2, 0, 0.7]])
    model = oscillator(3.0, 1.0)
    stiff = replace(model.contacts[0], tangential_stiffness=np.zeros((2, 2)), friction=0.0, normal_stiffness=1e10)
    model = Model(body, (stiff,), excitation(1.0, [1, 0, 0], [0, 0, 0]), at_rest(3, 1))
    omega, turn = natural_modes(model, np.arange(3), np.array([0]))
    row = model.contact_shape[0, 2]
    for low, high, found in ((1.0, 2.0, omega[0]), (2.0, 3.0, omega[1])):
        for _ in range(200):
            middle = 0.5 * (low + high)
            above = 1e-10 + np.sum(row**2 / ((body.omega - middle) * (body.omega + middle))) < 0
            low, high = (low, middle) if not above else (middle, high)
        assert found == pytest.approx(0.5 * (low + high), rel=1e-11)
    assert turn is not None
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-14)


# Single modes


def one_mode(stiffness: float, damping: float, force: float, constant: float, start: tuple[float, float]) -> Model:
    body = structure([stiffness], [damping], [[1, 0, 0]])
    load = excitation(1 / (2 * np.pi), [force], [0.0], [constant])
    begin = Start(np.array([start[0]]), np.array([start[1]]), np.zeros((0, 2)), np.zeros(0, dtype=int))
    return Model(body, (), load, begin)


MODES: dict[str, tuple[Model, Callable[[float], float]]] = {
    "undamped at its resonance": (
        one_mode(1.0, 0.0, 0.2, 0.0, (0.0, 0.0)),
        lambda t: 0.1 * t * np.sin(t),
    ),
    "undamped and free": (
        one_mode(2.25, 0.0, 0.0, 0.0, (0.3, -0.6)),
        lambda t: 0.3 * np.cos(1.5 * t) - 0.4 * np.sin(1.5 * t),
    ),
    "a rigid body that is pushed": (
        one_mode(0.0, 0.0, 0.3, 0.01, (0.1, -0.2)),
        lambda t: 0.1 - 0.2 * t + 0.005 * t**2 + 0.3 * (1 - np.cos(t)),
    ),
    "a rigid body that drags": (
        one_mode(0.0, 0.25, 0.0, 0.5, (0.0, 0.0)),
        lambda t: 2.0 * t + 8.0 * np.expm1(-0.25 * t),
    ),
    "critically damped": (
        one_mode(0.25, 1.0, 0.0, 0.5, (1.0, 1.0)),
        lambda t: 2.0 + (-1.0 + 0.5 * t) * np.exp(-0.5 * t),
    ),
    "overdamped": (
        one_mode(1.0, 1e4 + 1e-4, 0.0, 0.0, (1.0, 0.0)),
        lambda t: (np.exp(-1e-4 * t) - 1e-8 * np.exp(-1e4 * t)) / (1 - 1e-8),
    ),
}


@pytest.mark.parametrize("name", MODES)
@pytest.mark.parametrize("cycles", [1, 7, 300])
def test_a_mode_whose_motion_is_known(name: str, cycles: int) -> None:
    model, exact = MODES[name]
    trace = solved(model, cycles)
    true, size = exact(2 * np.pi * cycles), trace.totals.size[0]
    assert abs(trace.run.displacement[0] - true) < 2e-15 * (10 + cycles) * size
    assert abs(trace.run.displacement[0] - true) < rounding(trace.run, trace.totals).state * size
    assert trace.energy_residual < 1e-12
    leap = Run(model, [Phase(1 / (2 * np.pi), cycles)], CLOSED)
    leap.leap()
    np.testing.assert_allclose(leap.displacement, trace.run.displacement, rtol=0, atol=1e-14 * (10 + cycles) * size)


def test_samples_while_an_overdamped_mode_is_set_in_motion() -> None:
    """It takes the speed that its damper allows within the first of 50 samples a cycle; others move on beside it."""
    mode = {"frequency": 1.0, "mass": 2.0, "shape": {"tip": [1, 0, 0]}}
    modes = [mode | {"damping_ratio": ratio} for ratio in (0.02, 3.0, 40.0, 1000.0)]
    push = {"point": "tip", "direction": [1, 0, 0], "amplitude": 5.0}
    study = {"kind": "transient", "cycles": 2, "samples_per_cycle": 50}
    load = {"frequency": 1.0, "constant_forces": [push]}
    found = timesim.run({"structure": {"modes": modes}, "excitation": load, "study": study})
    assert found.attrs["method"] == "closed form"
    fine = timesim.run({"structure": {"modes": modes[3:]}, "excitation": load, "study": study})
    omega, t = 2 * np.pi, found["time"].values
    for ratio, result, mode in ((3.0, found, 1), (40.0, found, 2), (1000.0, found, 3), (1000.0, fine, 0)):
        fast = omega * (ratio + np.sqrt(ratio**2 - 1))
        slow = omega**2 / fast
        speed = 5.0 / 2.0 * (np.exp(-slow * t) - np.exp(-fast * t)) / (fast - slow)
        creep = 5.0 / 2.0 * (-np.expm1(-slow * t) / slow + np.expm1(-fast * t) / fast) / (fast - slow)
        for name, true in (("displacement", creep), ("velocity", speed)):
            error = np.abs(result[f"modal_{name}"].values[:, mode] - true).max()
            assert error < 1e-7 * float(abs(result[f"modal_{name}"]).max()), (ratio, name)


def test_extremes_between_the_ends_of_steps() -> None:
    """A vibration a hundred times as fast as the excitation, on a slow one."""
    body = structure([1.0, 1e4], [0.0, 0.0], [[1, 0, 0], [1, 0, 0]])
    start = Start(np.array([1.0, 0.2]), np.zeros(2), np.zeros((0, 2)), np.zeros(0, dtype=int))
    model = Model(body, (), excitation(1 / (2 * np.pi), [0, 0], [0, 0]), start)
    t = np.linspace(0, 2 * np.pi, 4_000_001)
    x = np.cos(t) + 0.2 * np.cos(100 * t)
    assert solved(model, 1).amplitude[0, 0, 0] == pytest.approx(np.ptp(x) / 2, rel=1e-10)


def test_a_hundred_thousand_cycles_without_drift() -> None:
    """An undamped vibration keeps its amplitude and its phase, a forced one repeats."""
    body = structure([2.0, 3.0], [0.0, 0.1], [[1, 0, 0], [0, 1, 0]])
    start = Start(np.array([1.0, 0.0]), np.zeros(2), np.zeros((0, 2)), np.zeros(0, dtype=int))
    model = Model(body, (), excitation(1 / (2 * np.pi), [0, 1], [0, 0]), start)
    loose, cycles = replace(CLOSED, rtol=1e-6), 100_000
    trace = solved(model, cycles, solver=loose)
    angle = np.sqrt(2.0) * 2 * np.pi * cycles
    assert trace.run.displacement[0] == pytest.approx(np.cos(angle), abs=1e-8)
    assert trace.amplitude[-1, 0, 0] == pytest.approx(trace.amplitude[1, 0, 0], rel=3e-6)
    steady = 1 / np.hypot(2.0, 0.1)
    assert trace.amplitude[-1, 0, 1] == pytest.approx(steady, rel=1e-6)
    assert np.ptp(np.array(trace.totals.stored)[1000:]) < 1e-9
    assert abs(trace.run.displacement[0] - np.cos(angle)) < rounding(trace.run, trace.totals).state


def test_vibrations_too_many_to_be_recorded_end_a_run_in_words() -> None:
    body = structure([1.0, 1e14], [0.0, 0.0], [[1, 0, 0], [1, 0, 0]])
    start = Start(np.array([1.0, 0.2]), np.zeros(2), np.zeros((0, 2)), np.zeros(0, dtype=int))
    model = Model(body, (), excitation(1 / (2 * np.pi), [0, 0], [0, 0]), start)
    with pytest.raises(RunError, match="in cycle 1: the budget of 100000 steps a cycle is spent"):
        solved(model, 1)


def test_contacts_that_may_leave_their_state_have_no_closed_form() -> None:
    with pytest.raises(ValueError, match="may leave their state"):
        solved(oscillator(3.0, 1.39), 1)


# Scenes


def scene(**changes: Any) -> timesim.Scene:
    study = {"kind": "transient", "cycles": 12, "record_last": 3, "samples_per_cycle": 50}
    return load_scene(OSCILLATOR, STUCK | {"study": study} | changes)


def test_a_transient_says_and_records_the_same_as_by_steps() -> None:
    closed, stepped = timesim.run(scene()), timesim.run(scene(solver={"method": "dopri8", "rtol": 1e-12}))
    assert (closed.attrs["method"], closed.attrs["complete"], closed.attrs["compile_seconds"]) == ("closed form", 1, 0)
    assert closed.attrs["method_choice"].startswith("closed form: no contact ever leaves its state")
    assert not {"rtol", "atol"} & set(closed.attrs)
    assert set(closed.variables) == set(stepped.variables)
    for name in closed.variables:
        mine, other = closed[name].values, stepped[name].values
        assert (mine.dtype, mine.shape) == (other.dtype, other.shape), name
        if mine.dtype.kind == "f" and mine.size and name not in {"energy_residual", "cycle_amplitude_error"}:
            assert np.abs(mine - other).max() <= 3e-8 * max(np.abs(other).max(), 1e-3), name
    assert closed.sizes["time"] == 151
    assert float(abs(closed["energy_residual"]).max()) < 1e-13
    assert 0 < closed.attrs["estimated_error"] < 1e-12
    error = np.abs(closed["cycle_amplitude"] - stepped["cycle_amplitude"]).max() / stepped["cycle_amplitude"].max()
    assert float(error) < float(closed["cycle_amplitude_error"].max()) < 1e-8


@pytest.mark.parametrize("accuracy", ["draft", "standard", "reference"])
def test_samples_keep_what_an_accuracy_promises(accuracy: str) -> None:
    fine = timesim.run(scene(solver={"method": "rk4", "steps_per_cycle": 4000}))
    found = timesim.run(scene(solver={"accuracy": accuracy}))
    for name in ("displacement", "velocity"):
        error = np.abs(found[name] - fine[name]).max() / np.abs(fine[name]).max()
        assert float(error) < 0.1 * found.attrs["promised_error"]


def test_a_jump_goes_through_its_phases() -> None:
    phases = [{"frequency": 1.39, "cycles": 5}, {"frequency": 1.5, "cycles": 7}]
    study = {"kind": "jump", "phases": phases, "run_up": [{"frequency": 1.2, "cycles": 3}]}
    given = {"study": study, "excitation.frequency": None, "contacts.pad.preload": 400.0}
    closed = timesim.run(scene(**given))
    stepped = timesim.run(scene(**given, solver={"method": "dopri8", "rtol": 1e-12}))
    assert closed.attrs["method"] == "closed form"
    for name in ("displacement", "cycle_amplitude", "final_phase_deg", "final_modal_velocity"):
        np.testing.assert_allclose(closed[name], stepped[name], rtol=0, atol=1e-8)


def test_check_says_so() -> None:
    report = describe(scene())
    assert report["method"] == (f"closed form: {scene().choice.why}",)
    assert report["accuracy"] == (
        "promises a relative error of 1e-06 of the state at the end of the run, by closed form",
        "the error at the end is estimated by what rounding does to the natural frequencies",
    )
    assert report["cost"][0].startswith("about 12 cycles of ")


@pytest.mark.parametrize(
    "changes",
    [{"contacts.pad.preload": 3.0}, {"solver": {"method": "tsit5"}}, {"solver": {"reduce": False}}],
    ids=["slips", "method given", "nothing left out"],
)
def test_other_scenes_are_integrated_as_before(changes: dict[str, Any]) -> None:
    assert scene(**changes).solver().name == "tsit5"


def test_without_contacts_nothing_needs_to_be_left_out() -> None:
    assert scene(contacts=[], solver={"reduce": False}).solver().name == CLOSED_FORM
