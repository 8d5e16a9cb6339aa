"""The order of the methods through all transitions, by regression over fixed steps."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from simulation import relative_error
from systems import excitation, inclined

from timesim.engine.event_loop import advance
from timesim.engine.method import Advance, Exponential, Method, step_method
from timesim.engine.solver import step_control
from timesim.engine.status import Status
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run
from timesim.model.model import SEPARATION, SLIP, STICK, Model
from timesim.model.solver import Solver

pytestmark = pytest.mark.long

ANY_ERROR = Solver("tsit5", 1e300, 1.0)
"""Tolerances that no step exceeds: its length is the longest that is allowed."""

DECADE = np.array([100, 139, 193, 268, 373, 518, 720, 1000])
"""Steps of a cycle."""

OMEGA = 0.35


def pressed_and_lifted() -> Model:
    """A mass that sticks, slips and lifts off, ten transitions a cycle.

    It moves straight: in a plane the direction of slip turns without bound as n -> 0, which costs every method its
    order there.
    """
    model = inclined(OMEGA)
    contact = replace(model.contacts[0], preload=0.2)
    return replace(model, contacts=(contact,), excitation=excitation(OMEGA / (2 * np.pi), [2.0], [0.0]))


class Swept(Exponential):
    """Collocation whose equations are solved to rounding, whatever error a step may have."""

    def advance(self, *step: Any) -> Advance:
        return super().advance(*step[:-1], jnp.asarray(1e-11))


def in_fixed_steps(method: Method, count: int) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """State after two cycles of so many steps, those cut by a transition apart, and the transitions."""
    model, frequency = pressed_and_lifted(), OMEGA / (2 * np.pi)
    run = Run(model, [Phase(frequency, 2)], ANY_ERROR)
    frame, h = Frame(model, run.reduction, frequency), np.asarray(2 * np.pi / count)
    system = system_of(model, frequency, 0.0, run.reduction)
    control = replace(step_control(ANY_ERROR, model.stuck_rate / frame.scales.omega), longest=h, opening=h, closing=h)
    start = frame.begin(system, run, float(h), work=False)
    now, steps, taken = advance(method, control, system, start, jnp.asarray(2), 4096)
    assert int(now.status) == Status.RUNNING
    assert int(now.cycle) == 2
    before, after = (np.asarray(state)[: int(taken), 0] for state in (steps.state, steps.state_after))
    log = [(int(b), int(a)) for b, a in zip(before, after, strict=True) if b != a]
    assert 2 * count <= int(taken) <= 2 * count + 2 * len(log)
    return np.concatenate([now.point.q, now.point.p]), log


@pytest.mark.parametrize(
    ("name", "lowest", "highest", "steps"),
    [
        ("rk4", 3.75, 4.25, DECADE),
        ("tsit5", 4.75, 5.25, DECADE),
        ("dopri5", 4.75, 5.25, DECADE),
        pytest.param("kvaerno5", 4.75, 5.25, DECADE, marks=pytest.mark.slow),
        ("collocation, 3 nodes", 4.5, 5.25, np.array([30, 42, 58, 80, 112, 155])),
        # Radau's rule is of order 2 s - 1; few steps reach rounding, and how they meet the transitions scatters.
        ("collocation, 5 nodes", 7.5, 10.0, np.array([12, 16, 20, 26, 33])),
        # Rounding comes after half a decade, and errors of eighth order are small beside those of ninth.
        ("dopri8", 7.75, 9.25, np.array([30, 35, 41, 48, 56, 65, 77, 90])),
    ],
)
def test_order_through_transitions(name: str, lowest: float, highest: float, steps: np.ndarray) -> None:
    true, log = in_fixed_steps(step_method(Solver("dopri8", 1e-11, 1e-13)), 1200)
    assert set(log) == {(STICK, SLIP), (SLIP, STICK), (SLIP, SEPARATION), (SEPARATION, SLIP)}
    nodes = {"collocation, 3 nodes": 3, "collocation, 5 nodes": 5}.get(name)
    method = step_method(Solver(name, 1e-11, 1e-13)) if nodes is None else Swept(nodes)
    ends = [in_fixed_steps(method, int(count)) for count in steps]
    assert all(own == log for _, own in ends)
    error = np.array([relative_error(end, true) for end, _ in ends])
    order = -np.polyfit(np.log(steps), np.log(error), 1)[0]
    print(name, error, order)
    assert lowest < order < highest


def test_an_implicit_method_has_a_derivative_in_forward_mode() -> None:
    """That of the return map asks for it, and the loops of its library's own have none."""
    model = pressed_and_lifted()
    run = Run(model, [Phase(OMEGA / (2 * np.pi), 1)], ANY_ERROR)
    frame = Frame(model, run.reduction, OMEGA / (2 * np.pi))
    system = system_of(model, OMEGA / (2 * np.pi), 0.0, run.reduction)
    start, method = frame.begin(system, run, 0.01, work=False), step_method(Solver("kvaerno5", 1e-6, 1e-8))

    def end(velocity: jax.Array) -> jax.Array:
        point = replace(start.point, p=velocity)
        return method.advance(system, start.state, start.time, point, start.rate, jnp.asarray(0.01)).point.p

    derivative = jax.eval_shape(jax.jit(jax.jacfwd(end)), start.point.p)
    assert derivative.shape == (1, 1)
