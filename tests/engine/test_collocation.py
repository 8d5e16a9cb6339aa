"""Exponential collocation: against Runge-Kutta, closed forms, and itself; its order, energies and transitions."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from simulation import FINE as RUNGE_KUTTA
from simulation import REFERENCE, relative_error, simulate
from systems import at_rest, excitation, generated_model, generated_models, oscillator, pad, structure
from zoo import driven

from timesim.engine import event_loop
from timesim.engine.event_loop import advance, march
from timesim.engine.exponential.parts import parts_of
from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import ContactLaw
from timesim.engine.law.rule import rule_of
from timesim.engine.method import Exponential, step_method
from timesim.engine.solver import step_control
from timesim.engine.status import RunError
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run
from timesim.model.model import Model
from timesim.model.solver import Criterion, Solver
from timesim.orbit.settling import Chain, steady_states

pytestmark = pytest.mark.long

LOOSE, FINE, FINEST = (Solver("exponential", rtol, 1e-2 * rtol) for rtol in (1e-4, 1e-8, 1e-10))

WHOLE = replace(FINE, reduce=False)
"""Nothing is left out: models of as many modes and contacts share a program."""

COUPLED = "seed0-3modes-2contacts"
"""Full K_u, and a damping matrix that the modes do not diagonalise."""


def test_rule_integrates_and_differentiates_its_polynomials() -> None:
    for num in (1, 3, 5):
        rule = rule_of(num)
        x, powers = rule.nodes, np.arange(num + 1)
        values = x[:, None] ** powers
        np.testing.assert_allclose(rule.monomials @ values, np.eye(num + 1), atol=1e-10)
        np.testing.assert_allclose(rule.slopes @ values, powers * x[1:, None] ** np.maximum(powers - 1, 0), atol=1e-10)
        lower = np.arange(num)
        np.testing.assert_allclose(rule.integrals @ x[1:, None] ** lower, x[1:, None] ** (lower + 1) / (lower + 1))
        # Radau's rule is exact up to degree 2 s - 2.
        high = np.arange(2 * num - 1)
        np.testing.assert_allclose(rule.integrals[-1] @ x[1:, None] ** high, 1 / (high + 1), rtol=1e-12)


def test_more_nodes_where_more_is_asked() -> None:
    nodes = [step_method(Solver("exponential", rtol, rtol)) for rtol in (1e-4, 1e-10)]
    assert [method.num_nodes for method in nodes if isinstance(method, Exponential)] == [3, 5]


@pytest.mark.parametrize(
    "solver",
    [LOOSE, pytest.param(FINE, marks=pytest.mark.slow), pytest.param(FINEST, marks=pytest.mark.slow)],
    ids=["loose", "fine", "finest"],
)
def test_a_generated_model_with_coupled_modes(solver: Solver) -> None:
    model = generated_models()[COUPLED]
    assert model.structure.damping.ndim == 2
    true, trace = simulate(model, 12, REFERENCE if solver is FINEST else RUNGE_KUTTA), simulate(model, 12, solver)
    assert trace.sequence == true.sequence
    assert len(trace.sequence) > 50
    error = relative_error(trace.motion, true.motion)
    print(f"{solver}: error {error:.1e}, energy residual {trace.energy_residual:.1e}, {trace.num_steps} parts")
    assert error < 10 * solver.rtol
    # Ten times as much where the end of a step that is cut is taken from its polynomials.
    assert trace.energy_residual < (0.1 if solver is LOOSE else 10) * solver.rtol
    np.testing.assert_allclose(trace.log.time, true.log.time, rtol=0, atol=100 * solver.rtol)
    assert relative_error(trace.amplitude, true.amplitude) < 10 * solver.rtol
    work = [np.array(t.totals.work) for t in (trace, true)]
    assert relative_error(*work) < 100 * solver.rtol


def test_the_extremes_of_each_step_are_those_of_its_parts() -> None:
    """Also of one that is cut, whose polynomials go on."""
    model = generated_models()[COUPLED]
    steps = next(Run(model, [Phase(model.excitation.frequency or 0.0, 12)], LOOSE).batches())
    assert np.sum(steps.loop.h < 0.9 * steps.loop.inside.h) > 20
    low, high = steps.extremes(np.arange(steps.h.size))
    parts = steps.between(steps.time[0], steps.time[-1])
    first = np.searchsorted(parts.time + 0.5 * parts.h, steps.time)
    for found, true in zip((low, high), parts.extremes(first), strict=True):
        np.testing.assert_allclose(found, true, rtol=0, atol=1e-6 * np.abs(true).max())


def test_what_steps_need_of_the_system_is_computed_once_for_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_loop, "LEAST", 8)
    monkeypatch.setattr(event_loop, "ROOM", 1)
    tables = []

    def watched(method: Exponential, control: Any, dynamics: Any, *args: Any) -> Any:
        tables.append(dynamics.ladder)
        return advance(method, control, dynamics, *args)

    monkeypatch.setattr(event_loop, "advance", watched)
    run = Run(oscillator(3.0, 1.39), [Phase(1.39, 2)], LOOSE)
    assert sum(steps.loop.h.size for steps in run.batches()) > 8 * (len(tables) - 1) > 8
    assert tables[0] is not None
    assert all(one is tables[0] for one in tables)


def test_a_free_body_that_begins_at_rest_beside_a_mode_that_rings() -> None:
    """No vibration bounds the body, whose velocity over a natural frequency of 0 would be no number."""
    stiffness, shapes = [0.0, 1.0, 1e6], [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    body = structure(stiffness, [0.0, 0.01, 0.0], shapes)
    start = replace(at_rest(3, 0), displacement=np.array([0.0, 0.0, 1e-3]))
    model = Model(body, (), excitation(0.1, [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]), start)
    amplitude = np.array(simulate(model, 2, WHOLE).totals.amplitude)
    assert amplitude[-1].max(axis=0)[1] == pytest.approx(1e-3, rel=1e-3)
    assert np.isfinite(amplitude).all()


def test_a_step_of_more_vibrations_than_memory_holds_is_refused() -> None:
    model = generated_models()[COUPLED]
    steps = next(Run(model, [Phase(model.excitation.frequency or 0.0, 12)], LOOSE).batches())
    longer = eqx.tree_at(lambda loop: loop.inside.h, steps.loop, 1e9 * steps.loop.inside.h)
    with pytest.raises(RunError, match="a step holds so many vibrations"):
        parts_of(steps.system, longer, LOOSE.rtol)


@pytest.mark.parametrize("damping", [0.0, 1e-5])
def test_resonance_without_contacts(damping: float) -> None:
    """Excited at its natural frequency from rest: t sin(t) / 2 without damping, which has no steady motion.

    Beside two modes at rest.
    """
    body, none = structure([1.0, 4.0, 9.0], [damping, 0.1, 0.1], np.eye(3).tolist()), np.zeros(3)
    free = Model(body, (), excitation(1 / (2 * np.pi), [1.0, 0.0, 0.0], none), at_rest(3, 0))
    trace = simulate(free, 5, WHOLE)
    t = 10 * np.pi
    decay = np.exp(-0.5 * damping * t)
    turn = np.sqrt(1 - 0.25 * damping**2)
    if damping == 0:
        expected = [0.5 * t * np.sin(t), 0.5 * (np.sin(t) + t * np.cos(t))]
    else:
        # x = (sin t - exp(-d t / 2) sin(turn t) / turn) / d
        sine, cosine = np.sin(turn * t), np.cos(turn * t)
        expected = [(np.sin(t) - decay * sine / turn) / damping]
        expected.append((np.cos(t) - decay * (cosine - 0.5 * damping * sine / turn)) / damping)
    np.testing.assert_allclose(trace.motion, [expected[0], 0.0, 0.0, expected[1], 0.0, 0.0], atol=2e-7)
    assert trace.energy_residual < 1e-7


@pytest.mark.parametrize(
    ("stiffness", "damping"),
    [([0.0, 9.0], [0.0, 30.0]), ([0.0, 4.0], [0.3, 4.0]), ([1.0, 1e6], [0.02, 10.0])],
    ids=["free and overdamped", "critically damped", "fast"],
)
def test_modes_of_any_kind(stiffness: list[float], damping: list[float]) -> None:
    body = structure(stiffness, damping, [[1.0, 0.2, 0.5], [0.3, 1.0, 0.4]])
    contact = pad(0.4, 3.0, 3.0, 0.4)
    force = excitation(0.6 / (2 * np.pi), [0.5, 1.0], [0.2, 0.0])
    model = Model(body, (contact,), force, at_rest(2, 1))
    true, trace = (
        simulate(model, 3, replace(RUNGE_KUTTA, reduce=False)),
        simulate(model, 3, WHOLE),
    )
    assert trace.sequence == true.sequence
    assert len(trace.sequence) > 4
    assert relative_error(trace.run.displacement, true.run.displacement) < 1e-7
    assert trace.energy_residual < 1e-7
    assert relative_error(trace.amplitude, true.amplitude) < 1e-7
    for own, others in zip(np.transpose(trace.totals.work), np.transpose(true.totals.work), strict=True):
        assert relative_error(own, others) < 1e-7


def test_the_amplitude_of_a_motion_on_which_a_fast_mode_rings() -> None:
    """It turns 33 times a cycle, and a step is longer than a turn of it."""
    body = structure([1.0, 400.0], [0.02, 0.05], [[1.0, 0.2, 0.5], [0.3, 1.0, 0.4]])
    start = replace(at_rest(2, 1), displacement=np.array([0.0, 0.02]))
    model = Model(body, (pad(0.4, 3.0, 3.0, 0.4),), excitation(0.6 / (2 * np.pi), [0.5, 1.0], [0.2, 0.0]), start)
    true, trace = (simulate(model, 1, replace(solver, reduce=False)) for solver in (RUNGE_KUTTA, FINE))
    assert relative_error(trace.amplitude, true.amplitude) < 1e-7
    for own, others in zip(trace.totals.work[0], true.totals.work[0], strict=True):
        assert own == pytest.approx(others, rel=1e-6)


@pytest.mark.parametrize(("stiffness", "damping"), [(1.0, 0.02), (0.36, 1e-5)], ids=["off resonance", "at resonance"])
def test_a_run_may_begin_at_any_phase_of_the_excitation(stiffness: float, damping: float) -> None:
    """The same force, counted from another zero of time: the same motion and energies, of slow and of fast modes."""
    body = structure([stiffness, 400.0], [damping, 0.05], [[1.0, 0.2, 0.5], [0.3, 1.0, 0.4]])
    start, angle = replace(at_rest(2, 1), displacement=np.array([0.0, 0.02])), 0.7
    force = np.array([0.5, 1.0]) + 1j * np.array([0.2, 0.0])
    traces = []
    for phase in (0.0, angle):
        turned = force * np.exp(1j * phase)
        load = excitation(0.6 / (2 * np.pi), turned.real.tolist(), turned.imag.tolist())
        model = Model(body, (pad(0.4, 3.0, 3.0, 0.4),), load, replace(start, phase=phase))
        traces.append(simulate(model, 1, WHOLE))
    one, other = traces
    assert one.sequence == other.sequence
    assert relative_error(other.motion, one.motion) < 1e-9
    np.testing.assert_allclose(other.totals.work, one.totals.work, rtol=1e-8)


def settled(model: Model, frequency: float, solver: Solver) -> tuple:
    ((orbit,),) = steady_states([Chain(model, (frequency,))], solver, Criterion())
    return orbit, orbit.amplitude, orbit.slip_share, np.abs(orbit.floquet[:2])


@pytest.mark.slow
def test_steady_states_and_their_multipliers_are_those_of_runge_kutta() -> None:
    model = generated_models()["seed2-2modes-1contacts"]
    frequency = model.excitation.frequency
    assert frequency is not None
    (orbit, *ours), (_, *theirs) = (settled(model, frequency, s) for s in (FINE, Solver("tsit5", 1e-8, 1e-10)))
    assert orbit.settled
    assert 0.05 < orbit.slip_share[0] < 0.95
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-5, atol=1e-7)


@pytest.mark.slow
def test_a_lightly_damped_motion_repeats_to_rounding() -> None:
    """A beam of six modes that slips: explicit steps ride on the stability limit of the sixth; their noise stays."""
    omega = 2 * np.pi * np.array([1.0, 6.27, 17.55, 34.4, 56.8, 84.9])
    shape = np.random.default_rng(5).normal(size=(6, 3)) * [1.0, 1.0, 0.3]
    body = structure(omega**2, 0.004 * omega, shape.tolist())  # 0.2 % of critical damping
    model = Model(body, (pad(0.3, 60.0, 60.0, 0.5),), excitation(1.02, [0.3] * 6, [0.0] * 6), at_rest(6, 1))
    change, transitions = {}, {}
    for name in ("exponential", "tsit5"):
        ends, counts = zip(
            *(after(model, 1.02, cycles, Solver(name, 1e-7, 1e-9)) for cycles in (4000, 4001)), strict=True
        )
        change[name], transitions[name] = relative_error(*ends), counts[1] - counts[0]
    print(change)
    assert transitions == {"exponential": 4, "tsit5": 4}
    assert change["exponential"] < 1e-13
    assert change["tsit5"] > 1e-10


def after(model: Model, frequency: float, cycles: int, solver: Solver) -> tuple[np.ndarray, int]:
    """The modes after a number of cycles, and how many transitions there were."""
    run = Run(model, [Phase(frequency, cycles)], solver)
    frame, method = Frame(model, run.reduction, frequency), step_method(solver)
    stiffest = model.stuck_rate / frame.scales.omega
    system = system_of(model, frequency, 0.0, run.reduction)
    start = frame.begin(system, run, solver.first_step(stiffest), work=False)
    one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (system, start))
    end, count = march(method, step_control(solver, stiffest), *one, jnp.array([cycles]))
    return np.concatenate([np.asarray(end.point.q)[0], np.asarray(end.point.p)[0]]), int(count[0])


@pytest.mark.slow
def test_a_fast_vibration_that_touches_a_stop_between_the_nodes_is_seen() -> None:
    """A contact that is apart asks for no short steps; the crests of a fast mode would touch it unseen."""
    body = structure([1.0, 3600.0], [0.02, 0.0], [[0.2, 0.0, 1.0], [0.1, 0.0, 1.0]])
    contact = pad(0.3, 4.0, 4.0, -4.0 * 0.5)
    start = replace(at_rest(2, 1), displacement=np.array([0.0, 0.05]))
    model = Model(body, (contact,), excitation(0.7 / (2 * np.pi), [0.245, 0.0], [0.0, 0.0]), start)
    true, trace = (simulate(model, 2, replace(solver, reduce=False)) for solver in (RUNGE_KUTTA, LOOSE))
    print(true.sequence, true.log.time, trace.log.time)
    assert len(true.sequence) > 4
    assert trace.sequence == true.sequence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 203])
def test_slip_under_little_friction_comes_to_its_end(seed: int) -> None:
    """Slip turns fast; where its path was not followed between the nodes, steps of 1e-13 never came to an end."""
    model, _ = driven(seed, (4, 2))
    slippery = (replace(own, friction=1e-3 if own.friction else 0.0) for own in model.contacts)
    model = replace(model, contacts=tuple(slippery))
    true, trace = (
        simulate(model, 12, replace(s, reduce=False, budget=2000)) for s in (FINE, Solver("exponential", 1e-5, 1e-7))
    )
    # Such slip amplifies errors: at 1e-7 3e-6 is left of the second.
    assert relative_error(trace.motion, true.motion) < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("size", [(2, 1), (3, 2), (6, 3)])
@pytest.mark.parametrize("seed", range(700, 704))
def test_more_generated_models(seed: int, size: tuple[int, int]) -> None:
    """Seeds chosen after the constants of the method: the error is of the size of the tolerance."""
    model = generated_model(seed, *size)
    damping = model.structure.damping
    whole = np.diag(damping) if damping.ndim == 1 else damping  # models of one size then share their program
    model = replace(model, structure=replace(model.structure, damping=whole))
    true = simulate(model, 12, replace(REFERENCE, reduce=False))
    for solver in (LOOSE, FINE):
        trace = simulate(model, 12, replace(solver, reduce=False))
        # At a loose tolerance a contact that just touches may be passed by: two of 103 transitions of one structure.
        assert trace.sequence == true.sequence or (
            solver is LOOSE and abs(len(trace.log.time) - len(true.log.time)) < 3
        )
        assert relative_error(trace.motion, true.motion) < 10 * solver.rtol
        assert trace.energy_residual < 100 * solver.rtol


class Plain(ConeLaw):
    """The cone as a law that knows nothing better than its reaction: slip by its rate, in place of its angle."""

    inner = ContactLaw.inner
    collocated = ContactLaw.collocated
    slip_inside = ContactLaw.slip_inside


@pytest.mark.slow
def test_a_law_that_only_has_a_reaction_is_collocated_too() -> None:
    model, frequency = oscillator(3.0, 1.39), 1.39
    run = Run(model, [Phase(frequency, 4)], LOOSE)
    frame = Frame(model, run.reduction, frequency)
    system = system_of(model, frequency, 0.0, run.reduction)
    control = step_control(LOOSE, model.stuck_rate / frame.scales.omega)
    start = frame.begin(system, run, LOOSE.first_step(1.0), work=False)
    law = system.law
    assert isinstance(law, ConeLaw)
    plain = Plain(law.friction, law.stiffness, law.compliance, law.normal_stiffness, law.preload)
    ends = []
    for own in (system, replace(system, law=plain)):
        now, steps, count = advance(step_method(LOOSE), control, own, start, jnp.asarray(4), 1024)
        assert int(now.cycle) == 4
        switched = np.asarray(steps.state != steps.state_after)[: int(count)]
        ends.append((np.concatenate([now.point.q, now.point.p]), switched.sum()))
    (mine, count), (theirs, other) = ends
    assert count == other > 8
    assert relative_error(theirs, mine) < 10 * LOOSE.rtol
