"""The event loop against the oracle, plain events and itself at other tolerances; and where it gives up."""

import gc
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import systems
from oracle import OracleResult
from oracle import simulate as consult
from oracle_traps import double_crossing_truth, earliest_event_truth, separates, slips
from simulation import FINE, Trace, relative_error, shares, simulate
from systems import GENERATED_CYCLES, generated_model, generated_models, oscillator

import timesim
from timesim.engine import dense_output as hermite
from timesim.engine import event_loop
from timesim.engine.event_loop import BATCH, advance
from timesim.engine.history import sample
from timesim.engine.method import step_method
from timesim.engine.solver import step_control
from timesim.engine.status import RunError, Status
from timesim.engine.step import begin, judged
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run, Steps
from timesim.model.contact_state import contact_loads
from timesim.model.model import SEPARATION, SLIP, STICK, Model, Start
from timesim.model.solver import PRESETS, Solver
from timesim.result.netcdf import save
from timesim.study import transient
from timesim.study.execution.campaign import Execution
from timesim.study.execution.interrupts import Interrupts
from timesim.study.recorder import Recorder
from timesim.study.registry import load_scene
from timesim.study.transient import final_variables, study

pytestmark = pytest.mark.long

CONFIGS = Path(__file__).parents[2] / "configs"
SECONDS_TO_COMPILE = "/jax/core/compile/jaxpr_to_mlir_module_duration"


# --- against the oracle ---


def whole_damping(model: Model) -> Model:
    """The same model with its damping as a matrix: models of one size then share their compiled loop."""
    damping = model.structure.damping
    matrix = np.diag(damping) if damping.ndim == 1 else damping
    return replace(model, structure=replace(model.structure, damping=matrix))


# All with K_u of the general form: two loops to compile, of four models each.
QUICK = [
    *(f"seed{seed}-2modes-1contacts" for seed in (2, 5, 6, 7)),
    *(f"seed{seed}-3modes-2contacts" for seed in (0, 1, 2, 4)),
]


@cache
def compared(name: str) -> tuple[Model, Trace, OracleResult]:
    model = whole_damping(generated_models()[name])
    assert model.excitation.frequency is not None
    true = consult(model, model.excitation.frequency, GENERATED_CYCLES)
    return model, simulate(model, GENERATED_CYCLES, FINE), true


def assert_agrees(name: str) -> None:
    model, trace, true = compared(name)
    frequency = model.excitation.frequency
    assert frequency is not None
    assert relative_error(trace.run.displacement, true.displacement) < 1e-7
    assert relative_error(trace.run.velocity, true.velocity) < 1e-7
    expected = list(zip(true.event_contact, true.event_from, true.event_to, strict=True))
    assert trace.sequence == expected
    np.testing.assert_allclose(trace.log.time * frequency, true.event_time * frequency, atol=1e-7, rtol=0)
    np.testing.assert_array_equal(trace.run.state, true.state)
    share = shares(trace, (GENERATED_CYCLES - 1) / frequency)
    np.testing.assert_allclose(share, true.share, atol=1e-6)
    assert np.any((share[:, SLIP] >= 0.05) & (share[:, SLIP] <= 0.95))
    percent = "; ".join("/".join(f"{100 * part:.0f}" for part in row) for row in share)
    print(f"{name}: {len(expected)} transitions, stick/slip/separation % {percent}")


@pytest.mark.parametrize("name", QUICK)
def test_generated_model(name: str) -> None:
    assert_agrees(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in generated_models() if name not in QUICK])
def test_larger_generated_model(name: str) -> None:
    assert_agrees(name)


def test_generated_models_slip_and_separate() -> None:
    results = [compared(name)[2] for name in QUICK]
    assert all(map(slips, results))
    assert 3 * sum(map(separates, results)) >= len(results) >= 8


# --- the traps of plain events ---


@pytest.mark.parametrize(
    ("model", "cycles", "truth"),
    [
        (systems.two_stops((0.021, 0.020)), 10, earliest_event_truth),
        (systems.grazing_stop(0.999, 1e3), 6, double_crossing_truth),
    ],
    ids=["earliest event", "double crossing"],
)
@pytest.mark.parametrize("accuracy", ["draft", "standard"])
def test_where_plain_events_fail(model: Model, cycles: int, truth: Callable[[], OracleResult], accuracy: str) -> None:
    """That they do, `tests/agreement/test_oracle.py` shows."""
    true, trace = truth(), simulate(model, cycles, PRESETS[accuracy])
    assert relative_error(trace.run.displacement, true.displacement) < {"draft": 1e-3, "standard": 1e-5}[accuracy]
    assert len(trace.log.time) == len(true.event_time) > 2
    np.testing.assert_array_equal(trace.log.contact, true.event_contact)
    np.testing.assert_array_equal(trace.log.after, true.event_to)


@pytest.mark.parametrize("part", [0.9, 0.99, 0.999, 0.9999, 0.99999, 0.999999])
def test_contact_that_hardly_touches(part: float) -> None:
    """The nearer the stop to the amplitude, the shorter the touch: to 4e-4 of a cycle."""
    model = systems.grazing_stop(part, 1e3)
    trace, fine = simulate(model, 3, PRESETS["draft"]), simulate(model, 3, FINE)
    assert trace.sequence == fine.sequence
    assert trace.sequence[:2] == [(0, SEPARATION, SLIP), (0, SLIP, SEPARATION)]


def test_contact_just_out_of_reach() -> None:
    trace = simulate(systems.grazing_stop(1 + 1e-9, 1e3), 3, replace(FINE, reduce=False))
    assert trace.sequence == []
    assert trace.amplitude[-1, 0, 2] == pytest.approx(trace.amplitude[0, 0, 2], rel=1e-9)


def violation(model: Model, cycles: int, solver: Solver) -> float:
    """Largest violation of a contact's own state on the dense output of all steps, over the scale of its force."""
    frequency = model.excitation.frequency
    assert frequency is not None
    x, worst = np.linspace(0, 1, 101)[:, None, None], 0.0
    shape, contacts = model.contact_shape, model.contacts
    preload, normal = np.array([(c.preload, c.normal_stiffness) for c in contacts]).T
    K = np.array([c.tangential_stiffness for c in contacts])
    friction = np.array([c.friction for c in contacts])
    for steps in Run(model, [Phase(frequency, cycles)], solver).batches():
        q, _ = hermite.quintic(x, steps.h[:, None], steps.start, steps.end)
        slips = zip(steps.slip_start, steps.slip_end, strict=True)
        through = hermite.cubic_coefficients(steps.h[:, None, None], *zip(*slips, strict=True))
        w = hermite.evaluate(x[..., None], through)[0]
        moves = np.einsum("cam,xnm->xnca", shape, q)
        n = preload + normal * moves[..., 2]
        f = np.linalg.norm(np.einsum("cab,xncb->xnca", K, moves[..., :2] - w), axis=-1)
        margin = np.select([steps.state == STICK, steps.state == SLIP], [friction * n - f, n], -n)
        scale = np.abs(preload) + (normal + np.abs(K).sum(axis=(1, 2))) * np.abs(moves).max()
        worst = max(worst, float((-margin / scale).max()))
    return worst


@pytest.mark.parametrize("preload", [3.0, -1.0])
def test_no_state_is_left_inside_a_step(preload: float) -> None:
    assert violation(oscillator(preload, 1.2), 20, PRESETS["draft"]) < 1e-9


@pytest.mark.parametrize("part", [0.9999, 0.99999, 0.999999])
def test_no_touch_is_left_inside_a_step(part: float) -> None:
    """Also next to the ends of a step: one that stops just short of a touch is followed by one that begins with it."""
    assert violation(systems.grazing_stop(part, 1e3), 10, PRESETS["draft"]) < 1e-9


# --- order of the methods ---


def errors(solvers: list[Solver]) -> tuple[np.ndarray, np.ndarray]:
    """Steps and error of the final state of six cycles of the oscillator, which slips and sticks.

    Without separation: as n -> 0 the direction of slip turns without bound, which costs every method its order there
    (rk4 is then of third order), though not its events.
    """
    model = oscillator(3.0, 1.39)
    true = simulate(model, 6, Solver("dopri8", 1e-13, 1e-15))
    traces = [simulate(model, 6, solver) for solver in solvers]
    assert all(trace.sequence == true.sequence for trace in traces)
    assert {after for _, _, after in true.sequence} == {STICK, SLIP}
    assert len(true.sequence) > 15
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
        pytest.param("dopri5", 5, np.geomspace(1e-5, 1e-10, 11), marks=pytest.mark.slow),
        ("dopri8", 8, np.geomspace(1e-6, 1e-11, 11)),
        pytest.param("kvaerno5", 5, np.geomspace(1e-5, 1e-9, 9), marks=pytest.mark.slow),
    ],
)
def test_order_of_adaptive_steps(name: str, expected: int, tolerances: np.ndarray) -> None:
    steps, error = errors([Solver(name, rtol, 1e-2 * rtol) for rtol in tolerances])
    print(name, steps, error, order(steps, error))
    assert order(steps, error) > expected - 0.1
    slope = np.polyfit(np.log(tolerances), np.log(error), 1)[0]
    assert 0.7 < slope < 1.3


# --- stiff contacts ---


def stiff(stiffness: float) -> Model:
    """The oscillator with a gap of 0.05 before a pad that is stiffer than its modes by far."""
    model = oscillator(-1.0, 0.97)
    hard = replace(
        model.contacts[0],
        tangential_stiffness=stiffness * np.eye(2),
        normal_stiffness=stiffness,
        preload=-0.05 * stiffness,
    )
    return replace(model, contacts=(hard,))


@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8])
# The program of a tolerance is its own: that of the test below.
@pytest.mark.parametrize("rtol", [pytest.param(1e-4, marks=pytest.mark.slow), 1e-6])
def test_kvaerno5_on_stiff_contacts(stiffness: float, rtol: float) -> None:
    """It steps over what an explicit method must follow, and agrees with it."""
    model = stiff(stiffness)
    trace = simulate(model, 4, Solver("kvaerno5", rtol, 1e-2 * rtol))
    fine = simulate(model, 4, Solver("tsit5", 1e-8, 1e-10, budget=10_000_000))
    assert trace.num_steps < 400
    assert trace.sequence == fine.sequence
    assert relative_error(trace.amplitude[-1], fine.amplitude[-1]) < 100 * rtol


def test_kvaerno5_takes_the_steps_of_explicit_methods_where_nothing_is_stiff() -> None:
    trace = simulate(oscillator(-1.0, 0.97), 6, Solver("kvaerno5", 1e-6, 1e-8))
    true = simulate(oscillator(-1.0, 0.97), 6, FINE)
    assert trace.num_steps < 600
    assert trace.sequence == true.sequence
    assert relative_error(trace.motion, true.motion) < 1e-5


# --- parts of scenes that may be missing ---


@pytest.mark.parametrize("reduce", [True, False])
def test_no_contact_at_all(reduce: bool) -> None:
    model = oscillator(3.0, 1.39)
    free = replace(model, contacts=(), start=replace(model.start, slip=np.zeros((0, 2)), state=np.zeros(0, dtype=int)))
    trace = simulate(free, 400, replace(FINE, reduce=reduce))
    omega, body = 2 * np.pi * 1.39, model.structure
    exact = (1 / (body.omega**2 - omega**2 + 2j * 0.02 * body.omega * omega)).real
    np.testing.assert_allclose(trace.run.displacement, exact, rtol=1e-8)
    assert trace.sequence == []


def test_more_lanes_than_are_marched_together_may_have_no_contact() -> None:
    model, lanes = replace(oscillator(3.0, 1.39), contacts=()), event_loop.SIDE_BY_SIDE + 1
    model = replace(model, start=replace(model.start, slip=np.zeros((0, 2)), state=np.zeros(0, dtype=int)))
    run = Run(model, [Phase(1.39, 1)], FINE)
    system = system_of(model, 1.39, 0.0, run.reduction)
    start = Frame(model, run.reduction, 1.39).begin(system, run, 0.01, work=False)
    each = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes, *jnp.shape(leaf))), (system, start))
    march = partial(event_loop.march, step_method(FINE), step_control(FINE, 1.0))
    end, count = jax.eval_shape(march, *each, jnp.ones(lanes, int))
    assert end.point.q.shape == (lanes, 2)
    assert end.state.shape == (lanes, 0)
    assert count.shape == (lanes,)


def test_the_slip_of_a_contact_without_friction_is_its_motion_also_off_the_line_that_is_modelled() -> None:
    model, zero = oscillator(32.0, 1.39), np.zeros(2)
    stop = replace(model.contacts[0], friction=0.0, tangential_stiffness=np.zeros((2, 2)))
    model = replace(model, contacts=(stop,))
    frame = Frame(model, Run(model, [Phase(1.39, 1)], Solver("tsit5", 1e-6, 1e-8)).reduction, 1.39)
    motion = contact_loads(model, np.array([0.3, -0.2]), np.zeros((1, 2))).motion
    assert np.all(np.abs(motion) > 0.05)
    point, state = frame.point(Start(np.array([0.3, -0.2]), zero, motion, np.array([SLIP])))
    assert len(point.w) == 1
    np.testing.assert_allclose(frame.start(point, state, 0.0).slip, motion, rtol=1e-14)


def test_one_mode_on_a_frictionless_stop() -> None:
    """A mass thrown against a stop without damping: half a period of the pair, then back with the same speed."""
    body = systems.structure([1e-12], [0.0], [[0, 0, 1]])
    start = replace(systems.at_rest(1, 1), displacement=np.array([0.0]), velocity=np.array([1.0]))
    model = Model(body, (systems.pad(0.0, 0.0, 4.0, -8.0),), systems.excitation(0.2, [0.0], [0.0]), start)
    trace = simulate(model, 1, FINE)
    assert trace.sequence == [(0, SEPARATION, SLIP), (0, SLIP, SEPARATION)]
    np.testing.assert_allclose(trace.log.time, [2.0, 2.0 + np.pi / 2], atol=1e-9)
    assert trace.run.velocity[0] == pytest.approx(-1.0, abs=1e-9)


def test_no_preload_at_rest() -> None:
    """n0 = 0 and no motion: n = 0 starts apart, and the first transition is the one of a contact that closes."""
    trace = simulate(oscillator(0.0, 1.1), 3, FINE)
    true = consult(oscillator(0.0, 1.1), 1.1, 3)
    assert trace.sequence[0][1] == SEPARATION
    assert [entry[1:] for entry in trace.sequence] == list(zip(true.event_from, true.event_to, strict=True))
    assert relative_error(trace.run.displacement, true.displacement) < 1e-8


def test_a_run_may_be_cut_anywhere() -> None:
    model = oscillator(-1.0, 0.97)
    whole, first = simulate(model, 12), simulate(model, 5)
    run = first.run
    begin = replace(model.start, displacement=run.displacement, velocity=run.velocity, slip=run.slip, state=run.state)
    rest = simulate(replace(model, start=begin), 7)
    assert first.sequence + rest.sequence == whole.sequence
    assert relative_error(rest.motion, whole.motion) < 1e-9


def test_a_state_on_its_guard_may_start_a_run() -> None:
    """From each transition on, at the instant of it and in the state after it."""
    model = oscillator(3.0, 1.39)
    omega, whole = 2 * np.pi * 1.39, simulate(model, 3)
    run = Run(model, [Phase(1.39, 3)], FINE)
    steps = next(iter(run.batches()))
    for row in np.nonzero(np.any(steps.state != steps.state_after, axis=1))[0]:
        time = steps.time[row] + steps.h[row]
        begin = replace(
            model.start,
            displacement=steps.end[0][row],
            velocity=steps.end[1][row],
            slip=steps.slip_end[0][row],
            state=steps.state_after[row],
            phase=omega * time,
        )
        rest = simulate(replace(model, start=begin), 1)
        later = whole.log.time[(whole.log.time > time + 1e-9) & (whole.log.time < time + 1 / 1.39)]
        np.testing.assert_allclose(rest.log.time[: later.size] + time, later, atol=1e-8)


# --- the derivative with respect to parameters ---


def test_derivative_of_a_run_through_its_transitions() -> None:
    """Forward mode through the compiled loop, against central differences, for four parameters in turn."""
    model, fine = oscillator(1.0, 1.1), Solver("tsit5", 1e-11, 1e-13, reduce=False)
    run = Run(model, [Phase(1.1, 2)], fine)
    frame, system = Frame(model, run.reduction, 1.1), jax.tree.map(jnp.asarray, system_of(model, 1.1))
    place = frame.begin(system, run, 0.01, work=False)
    method, control = step_method(fine), step_control(fine, model.stuck_rate / frame.scales.omega)
    parts = lambda s: (s.law.preload, s.law.friction, s.damping, s.cosine)  # noqa: E731

    def end(factors: jax.Array) -> tuple[jax.Array, Any]:
        changed = eqx.tree_at(parts, system, tuple(x * part for x, part in zip(factors, parts(system), strict=True)))
        start = begin(changed, place.point, place.state, place.length)
        now, steps, count = advance(method, control, changed, start, jnp.asarray(2), 2048)
        return jnp.concatenate([now.point.q, now.point.p]), (now.cycle, steps.state, steps.state_after, count)

    # The end, its derivative and what led to it by one program.
    along_with = jax.jit(lambda factors, along: jax.jvp(end, (factors,), (along,), has_aux=True))
    one, small = jnp.ones(4), 1e-5
    _, _, (cycles, before, after, count) = along_with(one, one)
    assert cycles == 2
    switched = {(int(a), int(b)) for a, b in zip(before[:count, 0], after[:count, 0], strict=True) if a != b}
    assert switched >= {(STICK, SLIP), (SLIP, STICK), (SLIP, SEPARATION), (SEPARATION, SLIP)}
    for along in jnp.eye(4):
        ahead, behind = (along_with(one + sign * small * along, along)[0] for sign in (1, -1))
        assert relative_error(np.asarray(along_with(one, along)[1]), (ahead - behind) / (2 * small)) < 1e-6


# --- giving up ---


def test_budget_spent() -> None:
    run = Run(oscillator(3.0, 1.39), [Phase(1.39, 5)], replace(FINE, budget=150))
    with pytest.raises(RunError, match=r"at time 0\.\d+ s, in cycle 1: the budget of 150 steps .*solver\.max_steps"):
        list(run.batches())
    assert 0 < run.time < 1 / 1.39
    assert np.all(np.isfinite(run.displacement))


def test_phase_where_a_run_has_ended_inside_a_cycle() -> None:
    model = oscillator(3.0, 1.39)
    late = replace(model, start=replace(model.start, phase=1.0))
    run = Run(late, [Phase(1.39, 3), Phase(1.2, 2)], replace(FINE, budget=150))
    with pytest.raises(RunError):
        list(run.batches())
    turned = 360.0 * 1.39 * run.time
    assert 10.0 < turned % 360 < 350.0
    assert float(final_variables(run)["final_phase_deg"][1]) == pytest.approx((np.degrees(1.0) + turned) % 360)
    whole = simulate(late, 2)
    assert float(final_variables(whole.run)["final_phase_deg"][1]) == np.degrees(1.0)


@pytest.mark.parametrize("reduce", [True, False])
def test_the_final_slip_of_a_contact_that_is_apart_is_its_motion(reduce: bool) -> None:
    run = simulate(oscillator(-40.0, 1.39), 2, replace(FINE, reduce=reduce)).run
    assert run.state.tolist() == [SEPARATION]
    motion = run.model.contact_shape[:, :2] @ run.displacement
    assert np.abs(motion).min() > 1e-3
    np.testing.assert_array_equal(final_variables(run)["final_slip"][1], motion)


def test_a_sample_has_the_state_of_its_step() -> None:
    steps = next(iter(Run(oscillator(3.0, 1.39), [Phase(1.39, 3)], FINE).batches()))
    assert np.any(steps.state != steps.state_after)
    np.testing.assert_array_equal(sample(steps, steps.time + 0.5 * steps.h).state, steps.state)
    at = np.flatnonzero(np.any(steps.state[1:] != steps.state[:-1], axis=1)) + 1
    np.testing.assert_array_equal(sample(steps, steps.time[at]).state, steps.state[at])
    np.testing.assert_array_equal(sample(steps, steps.time[at]).state, steps.state_after[at - 1])


def test_no_finite_state() -> None:
    """A damping of the wrong sign: the motion grows until numbers end."""
    model = oscillator(3.0, 1.39)
    wild = replace(model, structure=replace(model.structure, damping=-1e3 * model.structure.damping))
    run = Run(wild, [Phase(1.39, 100)], Solver("rk4", 1e-8, 1e-10, 2 * np.pi / 200, reduce=False))
    with pytest.raises(RunError, match="contact 'pad'"):
        list(run.batches())
    assert run.completed < 100


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"repeats": 101}, Status.ZENO),
        ({"length": 1e-14}, Status.TOO_SHORT),
        ({"tried": FINE.budget}, Status.BUDGET),
        ({"time": 1.0}, Status.RUNNING),
    ],
)
def test_what_is_judged(change: dict[str, float], status: Status) -> None:
    model = oscillator(3.0, 1.39)
    run = Run(model, [Phase(1.39, 5)], FINE)
    frame = Frame(model, run.reduction, 1.39)
    system = system_of(model, 1.39, 0.0, run.reduction)
    now = frame.begin(system, run, 0.01)
    moved = replace(now, **{key: jax.numpy.asarray(value, getattr(now, key).dtype) for key, value in change.items()})
    assert int(judged(step_control(FINE, 1.0), moved).status) == status


@pytest.mark.parametrize("status", [Status.ZENO, Status.TOO_SHORT, Status.BUDGET, Status.NOT_FINITE])
def test_what_a_message_says(status: Status) -> None:
    run = Run(oscillator(3.0, 1.39), [Phase(1.39, 5)], FINE)
    with pytest.raises(RunError, match=r"at time .* s, in cycle 1: .*'pad'") as caught:
        run.judge(int(status), 0)
    assert any(hint in str(caught.value) for hint in ("try", "ask for", "Raise", "Check"))


@pytest.mark.parametrize(("solver", "other"), [("exponential", "kvaerno5"), ("kvaerno5", "exponential")])
@pytest.mark.parametrize("status", [Status.TOO_SHORT, Status.BUDGET])
def test_no_message_advises_the_method_that_failed(status: Status, solver: str, other: str) -> None:
    advice = status.message(solver=solver, budget=7, contact=None).split("try solver.method: ")[1]
    assert advice.startswith(other)
    assert solver not in advice


def test_a_message_before_any_transition_names_no_contact() -> None:
    run = Run(oscillator(3.0, 1.39), [Phase(1.39, 5)], replace(FINE, budget=3))
    with pytest.raises(RunError, match="the budget of 3 steps a cycle is spent") as caught:
        list(run.batches())
    assert "switched last" not in str(caught.value)


def test_a_message_names_a_contact_as_it_is() -> None:
    text = Status.BUDGET.message(solver="tsit5", budget=7, contact="{1} {x}")
    assert "contact '{1} {x}' switched last" in text
    assert "budget of 7 steps" in text


def let_go(force: float, displacement: Any, slip: Any, preload: float) -> Model:
    """The oscillator under small forces, let go from a start."""
    model = oscillator(preload, 1.39)
    load = replace(model.excitation, cosine=force * model.excitation.cosine)
    start = replace(model.start, displacement=np.array(displacement), slip=np.array([slip]))
    return replace(model, excitation=load, start=start)


def test_a_start_by_its_slip_alone_has_its_own_scale() -> None:
    """Without a force, at rest, and pulled by its contact: steps relative to a unit of 1 would not see 1e-9."""
    one, other = (
        simulate(let_go(0.0, [0.0, 0.0], [0.04 * size, 0.01 * size], 3.0 * size), 5, replace(FINE, reduce=False))
        for size in (1.0, 1e-9)
    )
    assert relative_error(1e9 * other.motion, one.motion) < 1e-8


@pytest.mark.parametrize("force", [1e-8, 1e-10])
def test_a_force_that_does_nothing_beside_the_start(force: float) -> None:
    """It is no scale for the motion: margins would be lost in rounding, and the loop creep."""
    one, other = (simulate(let_go(own, [1.0, 0.3], [1.3, 0.7], 1e-8), 5) for own in (force, 0.0))
    assert one.sequence == other.sequence
    assert relative_error(one.motion, other.motion) < 1e-6


LONG = {"study.cycles": 400, "study.record_last": 400}


def test_an_interrupt_after_the_last_cycle_leaves_the_run_whole() -> None:
    def impatient(done: float, total: float, phase: str) -> None:
        raise KeyboardInterrupt

    outcome = study(
        load_scene(CONFIGS / "oscillator.yaml", {"study.cycles": 3, "study.record_last": 1}),
        Execution(progress=impatient),
    )
    assert outcome.reason is None
    assert outcome.groups[""].sizes["cycle"] == 3
    assert outcome.groups[""].attrs["estimate_remark"] == "interrupted"


def test_interrupt_keeps_what_there_is() -> None:
    scene = load_scene(CONFIGS / "oscillator.yaml", LONG)

    def impatient(done: float, total: float, phase: str) -> None:
        if done >= 20:
            raise KeyboardInterrupt

    outcome = study(scene, Execution(progress=impatient))
    assert outcome.reason is not None
    assert outcome.reason.startswith("interrupted in cycle")
    result = outcome.groups[""]
    whole = timesim.run(scene)
    kept = result.sizes["cycle"]
    assert 20 <= kept < 400
    assert result.attrs["complete"] == 0
    np.testing.assert_array_equal(result["cycle_amplitude"], whole["cycle_amplitude"][:kept])
    count = result.sizes["event"]
    np.testing.assert_array_equal(result["event_time"], whole["event_time"][:count])
    assert np.all(np.isfinite(result["displacement"]))


def test_a_run_that_was_interrupted_goes_on_from_where_it_stopped(tmp_path: Path) -> None:
    def impatient(done: float, total: float, phase: str) -> None:
        raise KeyboardInterrupt

    # Where a full record happens to end with a cycle, so does the run: at most at one of the frequencies.
    for frequency in (1.39, 1.4, 1.41):
        changes = {"solver.accuracy": "reference", "excitation.frequency": frequency}
        scene = load_scene(CONFIGS / "oscillator.yaml", LONG | changes)
        outcome = study(scene, Execution(progress=impatient))
        first = outcome.groups[""]
        if 1 < first["final_phase_deg"] < 359:
            break
    else:
        pytest.fail("no run has stopped within a cycle")
    whole = timesim.run(scene)
    save(outcome.groups, tmp_path / "result.nc")
    rest = load_scene(CONFIGS / "oscillator.yaml", changes | {"initial": {"from": str(tmp_path)}})
    assert rest.model().notes == (
        f"initial.from: the run of the result is incomplete ({outcome.reason}): this one starts where it stopped",
    )
    # Its phase is that of the start.
    stopped = (first.sizes["cycle"] + float(first["final_phase_deg"]) / 360) / frequency
    again, before = timesim.run(rest)["event_time"][:100] + stopped, first.sizes["event"]
    np.testing.assert_allclose(again, whole["event_time"][before : before + 100], rtol=1e-6)


def test_a_failed_run_keeps_what_there_is() -> None:
    changes = {"solver": {"accuracy": "standard", "max_steps": 70}, "study.record_last": 60}
    with pytest.warns(RuntimeWarning, match="the run is incomplete: at time .*max_steps"):
        result = timesim.run(CONFIGS / "oscillator.yaml", changes)
    assert result.attrs["complete"] == 0
    assert "budget" in result.attrs["reason"]
    assert result.sizes["time"] > 1


# --- one compilation, and memory that does not grow ---


def compilations(work: Callable[[], Any]) -> int:
    seen: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(listener := lambda name, seconds, **more: seen.append(name))
    try:
        work()
    finally:
        jax.monitoring.unregister_event_duration_listener(listener)
    return seen.count(SECONDS_TO_COMPILE)


def test_a_long_run_is_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop goes on from what it has returned by the same program: a weak type at its start would be another one."""
    seen: list[list[tuple[str, bool]]] = []
    compiled = event_loop.advance

    def advance(method: Any, control: Any, system: Any, now: Any, *more: Any) -> Any:
        seen.append([(str(leaf.dtype), leaf.weak_type) for leaf in jax.tree.leaves(now)])
        return compiled(method, control, system, now, *more)

    monkeypatch.setattr(event_loop, "advance", advance)
    simulate(oscillator(3.0, 1.39), 60)
    assert len(seen) > 1
    assert all(leaves == seen[0] for leaves in seen)


def test_nothing_compiles_anew() -> None:
    """New parameters, frequencies, cycles, tolerances, starts: one compiled loop."""

    def many() -> None:
        for preload, frequency, cycles in ((3.0, 1.39, 2), (2.5, 1.2, 3), (-1.0, 0.97, 5), (0.0, 1.0, 1)):
            simulate(oscillator(preload, frequency), cycles, FINE)
            simulate(oscillator(preload, frequency), cycles, PRESETS["draft"])

    fresh = compilations(lambda: simulate(oscillator(3.0, 1.39), 1, replace(FINE, name="dopri5")))
    simulate(oscillator(3.0, 1.39), 1, FINE)
    assert compilations(many) == 0
    # That the count can see one: the loop of a method is compiled once at the most.
    jax.clear_caches()
    assert compilations(lambda: simulate(oscillator(3.0, 1.39), 1, FINE)) > 0
    assert fresh >= 0


def test_structures_of_nearly_as_many_modes_share_what_is_compiled() -> None:
    """9 and 10 modes take one program; with 11 it is another."""
    models = {num: whole_damping(generated_model(1, num, 1)) for num in (9, 10, 11)}
    simulate(models[10], 1, FINE)
    assert compilations(lambda: simulate(models[9], 1, FINE)) == 0
    jax.clear_caches()
    assert compilations(lambda: simulate(models[9], 1, FINE)) > 0
    assert compilations(lambda: simulate(models[11], 1, FINE)) > 0


def test_device_memory_does_not_grow() -> None:
    def largest(cycles: int) -> int:
        held = []
        for steps in Run(oscillator(3.0, 1.39), [Phase(1.39, cycles)], FINE).batches():
            assert steps.time.size <= BATCH
            held.append(sum(array.nbytes for array in jax.live_arrays()))
        return max(held)

    gc.collect()
    few = largest(20)
    gc.collect()
    assert largest(200) <= 1.1 * few


def test_an_interrupt_loses_no_steps_that_are_being_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cycle that the reason names is the first one that the result does not hold, and its end the run's."""
    scene, add, done = load_scene(CONFIGS / "oscillator.yaml", LONG), Recorder.add, [0]

    def interrupted(recorder: Recorder, steps: Steps, completed: int) -> None:
        done[0] += 1
        if done[0] == 2:
            os.kill(os.getpid(), signal.SIGINT)
        add(recorder, steps, completed)

    monkeypatch.setattr(Recorder, "add", interrupted)
    outcome = study(scene, Execution())
    result = outcome.groups[""]
    kept = result.sizes["cycle"]
    assert 0 < kept < 400
    assert outcome.reason == f"interrupted in cycle {kept + 1} of 400"
    end = result["time"].values[-1] * result["cycle_frequency"].values[-1]
    assert kept <= end < kept + 1


@pytest.mark.parametrize("batch", [1, 2, 3])
@pytest.mark.parametrize("cycles", [290, 400])
def test_a_signal_while_a_batch_is_computed_loses_none(
    batch: int, cycles: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 290 cycles the second batch is the last: a run that counts as whole once held the first one alone."""
    scene, advance, done = load_scene(CONFIGS / "oscillator.yaml", {"study.cycles": cycles}), event_loop.advance, [0]

    def interrupted(*args: Any) -> Any:
        done[0] += 1
        if done[0] == batch:
            os.kill(os.getpid(), signal.SIGINT)
        return advance(*args)

    monkeypatch.setattr(event_loop, "advance", interrupted)
    outcome = study(scene, Execution())
    kept = outcome.groups[""].sizes["cycle"]
    reasons = {cycles: None}
    assert outcome.reason == reasons.get(kept, f"interrupted in cycle {kept + 1} of {cycles}")
    assert kept > 0
    assert np.isnan(outcome.groups[""].attrs["estimated_error"])


def test_a_signal_while_the_result_is_put_together_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    forces, calls = transient.contact_forces, []

    def interrupted(*args: Any) -> Any:
        calls.append(signal.SIGINT)
        os.kill(os.getpid(), calls[-1])
        return forces(*args)

    monkeypatch.setattr(transient, "contact_forces", interrupted)
    before = signal.getsignal(signal.SIGINT)
    outcome = study(load_scene(CONFIGS / "oscillator.yaml", {"study.cycles": 3, "study.record_last": 1}), Execution())
    assert calls
    assert outcome.reason is None
    assert outcome.groups[""].sizes["cycle"] == 3
    assert signal.getsignal(signal.SIGINT) is before


def test_each_signal_reaches_the_handler_before_once() -> None:
    """That of the command counts them: the third ends it."""
    taken: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: taken.append(number))
    try:
        with Interrupts() as interrupts:
            for count in (1, 2, 3):
                os.kill(os.getpid(), signal.SIGTERM)
                assert interrupts.seen
                assert len(taken) == count
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_second_signal_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    def twice(*_: Any) -> Any:
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(transient, "contact_forces", twice)
    with pytest.raises(KeyboardInterrupt):
        study(load_scene(CONFIGS / "oscillator.yaml", {"study.cycles": 3, "study.record_last": 1}), Execution())
