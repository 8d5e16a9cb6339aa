"""The length of a step: the error of every part of the state bounds it, PI control chooses the next one."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from simulation import Trace, simulate
from systems import at_rest, excitation, oscillator, pad, structure

from timesim.engine.solver import Solver, next_length, step_control
from timesim.engine.step import advanced, controlled
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run
from timesim.model.model import SLIP, Model

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
    after = advanced(system, now, now.point, now.state, jnp.asarray(h), jnp.asarray(False), jnp.asarray([crossed]))
    assert int(after.repeats) == repeats
    assert float(after.since) == (0.0 if crossed else h)
