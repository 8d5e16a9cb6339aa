"""The event loop against the oracle, against plain events, against itself at other tolerances; and where it gives up."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import numpy as np
import pytest
import systems
from engine import FINE, REFERENCE, Trace, follow, relative_error, shares, simulate
from oracle import OracleResult
from oracle import simulate as consult
from systems import GENERATED_CYCLES, generated_models, oscillator
from test_oracle import double_crossing_trap, earliest_event_trap, separates, slips

import timesim
from timesim.config import load_scene
from timesim.integrate import Status, judged
from timesim.model import SEPARATION, SLIP, STICK, Model
from timesim.solver import PRESETS, Solver
from timesim.trajectory import BATCH, Frame, Phase, Run, RunError
from timesim.transient import study

SECONDS_TO_COMPILE = "/jax/core/compile/jaxpr_to_mlir_module_duration"


# --- against the oracle ---


def whole_damping(model: Model) -> Model:
    """The same model with its damping as a matrix: models of one size then share their compiled loop."""
    damping = model.structure.damping
    matrix = np.diag(damping) if damping.ndim == 1 else damping
    return replace(model, structure=replace(model.structure, damping=matrix))


QUICK = ("2modes-1contacts", "3modes-2contacts")


@cache
def compared(name: str) -> tuple[Model, Trace, OracleResult]:
    model = whole_damping(generated_models()[name])
    assert model.excitation.frequency is not None
    true = consult(model, model.excitation.frequency, GENERATED_CYCLES)
    return model, simulate(model, GENERATED_CYCLES, FINE), true


def agree(name: str) -> None:
    model, trace, true = compared(name)
    frequency = model.excitation.frequency
    assert frequency is not None
    assert relative_error(trace.run.displacement, true.displacement) < 1e-7
    assert relative_error(trace.run.velocity, true.velocity) < 1e-7
    told = list(zip(true.event_contact, true.event_from, true.event_to, strict=True))
    assert trace.sequence == told
    np.testing.assert_allclose(trace.log.time * frequency, true.event_time * frequency, atol=1e-7, rtol=0)
    np.testing.assert_array_equal(trace.run.state, true.state)
    share = shares(trace, (GENERATED_CYCLES - 1) / frequency)
    np.testing.assert_allclose(share, true.share, atol=1e-6)
    assert np.any((share[:, SLIP] >= 0.05) & (share[:, SLIP] <= 0.95))
    told_shares = "; ".join("/".join(f"{100 * part:.0f}" for part in row) for row in share)
    print(f"{name}: {len(told)} transitions, stick/slip/separation % {told_shares}")


@pytest.mark.parametrize("name", [name for name in generated_models() if name.endswith(QUICK)])
def test_generated_model(name: str) -> None:
    agree(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in generated_models() if not name.endswith(QUICK)])
def test_larger_generated_model(name: str) -> None:
    agree(name)


def test_generated_models_slip_and_separate() -> None:
    results = [compared(name)[2] for name in generated_models() if name.endswith(QUICK)]
    assert all(map(slips, results))
    assert 3 * sum(map(separates, results)) >= len(results) >= 8


# --- the traps of plain events ---


@pytest.mark.parametrize(
    ("model", "cycles", "trap"),
    [
        (systems.two_stops((0.021, 0.020)), 10, earliest_event_trap),
        (systems.grazing_stop(0.999, 1e3), 6, double_crossing_trap),
    ],
    ids=["earliest event", "double crossing"],
)
@pytest.mark.parametrize("accuracy", ["draft", "standard"])
def test_where_plain_events_fail(
    model: Model, cycles: int, trap: Callable[[], tuple[OracleResult, OracleResult]], accuracy: str
) -> None:
    plain, true = trap()
    trace = simulate(model, cycles, PRESETS[accuracy])
    assert len(plain.event_time) < len(true.event_time) == len(trace.log.time)
    assert relative_error(plain.displacement, true.displacement) > 0.1
    assert relative_error(trace.run.displacement, true.displacement) < {"draft": 1e-3, "standard": 1e-5}[accuracy]
    np.testing.assert_array_equal(trace.log.contact, true.event_contact)
    np.testing.assert_array_equal(trace.log.after, true.event_to)


@pytest.mark.parametrize("part", [0.9, 0.99, 0.999, 0.9999, 0.99999, 0.999999])
def test_contact_that_hardly_touches(part: float) -> None:
    """The nearer to the amplitude the stop, the shorter the touch between two steps: to 1.4e-3 of a radian."""
    model = systems.grazing_stop(part, 1e3)
    trace, fine = simulate(model, 3, PRESETS["draft"]), simulate(model, 3, FINE)
    assert trace.sequence == fine.sequence
    assert trace.sequence[:2] == [(0, SEPARATION, SLIP), (0, SLIP, SEPARATION)]


def test_contact_just_out_of_reach() -> None:
    trace = simulate(systems.grazing_stop(1 + 1e-9, 1e3), 3, replace(FINE, reduce=False))
    assert trace.sequence == []
    assert trace.amplitude[-1, 0, 2] == pytest.approx(trace.amplitude[0, 0, 2], rel=1e-9)


# --- order of the methods ---


def errors(solvers: list[Solver]) -> tuple[np.ndarray, np.ndarray]:
    """Steps and error of the final state of six cycles of the oscillator, which slips, sticks and separates."""
    model = oscillator(-1.0, 0.97)
    true = simulate(model, 6, Solver("dopri8", 1e-13, 1e-15))
    traces = [simulate(model, 6, solver) for solver in solvers]
    assert all(trace.sequence == true.sequence for trace in traces)
    assert {a for _, _, a in true.sequence} == {STICK, SLIP, SEPARATION}
    return (
        np.array([trace.num_steps for trace in traces]),
        np.array([relative_error(trace.motion, true.motion) for trace in traces]),
    )


def order(steps: np.ndarray, error: np.ndarray) -> float:
    return float(-np.polyfit(np.log(steps), np.log(error), 1)[0])


def test_order_of_fixed_steps() -> None:
    steps = np.array([200, 400, 800])
    _, error = errors([Solver("rk4", 1e-8, 1e-10, 2 * np.pi / count) for count in steps])
    print("rk4", error)
    assert order(steps, error) == pytest.approx(4, abs=0.5)


@pytest.mark.parametrize(
    ("name", "expected", "tolerances"),
    [
        ("tsit5", 5, np.geomspace(1e-5, 1e-10, 11)),
        ("dopri5", 5, np.geomspace(1e-5, 1e-10, 11)),
        ("dopri8", 8, np.geomspace(1e-6, 1e-11, 11)),
        ("kvaerno5", 5, np.geomspace(1e-4, 1e-8, 9)),
    ],
)
def test_order_of_adaptive_steps(name: str, expected: int, tolerances: np.ndarray) -> None:
    steps, error = errors([Solver(name, rtol, 1e-2 * rtol) for rtol in tolerances])
    print(name, steps, error, order(steps, error))
    assert order(steps, error) > expected - 1
    slope = np.polyfit(np.log(tolerances), np.log(error), 1)[0]
    assert 0.7 < slope < 1.3
