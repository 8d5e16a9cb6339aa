"""Where numbers are very large, very small, equal or just at a border: what is expected there, and why.

All but the slow ones run the oscillator of Table 1 by two methods of different families, so that they share two
compiled programs: an explicit one and collocation.
"""

import signal
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
import systems
from simulation import Trace, follow, relative_error, simulate
from systems import TURN, at_rest, excitation, oscillator

from timesim.engine.status import RunError
from timesim.engine.trajectory import Phase, Run
from timesim.model.model import SEPARATION, SLIP, STICK, Contact, Model, Start, Structure
from timesim.model.solver import NEVER, PRESETS, SHOOT, Criterion, Solver
from timesim.orbit.settling import Chain, steady_states

pytestmark = pytest.mark.long

SECONDS = 600
EXPLICIT, COLLOCATED = (Solver(name, 1e-10, 1e-12, reduce=False) for name in ("tsit5", "exponential"))
METHODS = [pytest.param(EXPLICIT, id="tsit5"), pytest.param(COLLOCATED, id="exponential")]
CASES = ((3.0, 1.39), (-1.0, 0.97), (1.0, 1.1))
"""Preload and frequency: sticks and slips, with a gap, all three states."""


@pytest.fixture(autouse=True)
def _nothing_hangs() -> Iterator[None]:
    def late(*_: Any) -> None:
        raise TimeoutError(f"not done within {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def with_contact(model: Model, **changes: Any) -> Model:
    return replace(model, contacts=(replace(model.contacts[0], **changes),))


def with_ratio(model: Model, damping_ratio: float) -> Model:
    structure = model.structure
    return replace(model, structure=replace(structure, damping=2 * damping_ratio * structure.omega))


def assert_agrees(model: Model, cycles: int, frequency: float, within: float = 1e-8) -> Trace:
    """Both methods find the same transitions and the same end, and close their energy balance; the explicit run."""
    explicit, collocated = (simulate(model, cycles, solver, frequency) for solver in (EXPLICIT, COLLOCATED))
    assert explicit.sequence == collocated.sequence
    assert relative_error(collocated.motion, explicit.motion) < within
    for trace in (explicit, collocated):
        assert np.all(np.isfinite(trace.motion))
        assert trace.energy_residual < 1e-8
    return explicit


# Units


@pytest.mark.slow
@pytest.mark.parametrize("by", [1e-9, 1e9])
@pytest.mark.parametrize("quantity", ["force", "time", "length"])
def test_any_units_by_collocation(quantity: str, by: float):
    """The equations are homogeneous in each of them (explicit: tests/agreement/test_invariants.py)."""
    model, frequency = oscillator(1.0, 1.1), 1.1
    body, load, own = model.structure, model.excitation, model.contacts[0]
    force, time, length = (by if quantity == name else 1.0 for name in ("force", "time", "length"))
    stiffness = 1 / (time * length) ** 2
    scaled = Model(
        replace(body, frequency=body.frequency / time, damping=body.damping / time, shape=body.shape * length),
        (
            replace(
                own,
                tangential_stiffness=own.tangential_stiffness * stiffness,
                normal_stiffness=own.normal_stiffness * stiffness,
                preload=own.preload * force / (time**2 * length),
            ),
        ),
        replace(load, cosine=load.cosine * force / time**2),
        model.start,
    )
    one, other = simulate(model, 8, COLLOCATED, frequency), simulate(scaled, 8, COLLOCATED, frequency / time)
    assert other.sequence == one.sequence
    assert relative_error(other.run.displacement / force, one.run.displacement) < 1e-9


# Stiffness, damping, frequencies


@pytest.mark.parametrize("ratio", [1e-6, 1.0, 1e3])
def test_contact_stiffness_against_that_of_the_structure(ratio: float):
    """A soft contact hardly acts, a stiff one nearly is a wall: both methods locate the same touches."""
    trace = assert_agrees(in_front_of(ratio), 6, 0.97)
    assert {state for step in trace.sequence for state in step[1:]} >= {SEPARATION, SLIP}


@pytest.mark.slow
def test_contact_a_million_times_as_stiff_as_the_structure():
    model = in_front_of(1e6)
    explicit = simulate(model, 3, replace(EXPLICIT, rtol=1e-8, atol=1e-10, budget=10_000_000), 0.97)
    collocated = simulate(model, 3, replace(COLLOCATED, rtol=1e-8, atol=1e-10), 0.97)
    assert collocated.sequence == explicit.sequence
    assert relative_error(collocated.amplitude, explicit.amplitude) < 1e-5
    assert collocated.energy_residual < 1e-5


def in_front_of(ratio: float) -> Model:
    """The oscillator before a gap of 0.05 and a pad so many times as stiff as its first mode."""
    model = oscillator(-1.0, 0.97)
    stiffness = ratio * float(model.structure.stiffness[0])
    return with_contact(
        model, tangential_stiffness=stiffness * np.eye(2), normal_stiffness=stiffness, preload=-0.05 * stiffness
    )


@pytest.mark.parametrize("case", CASES[:2])
@pytest.mark.parametrize("ratio", [0.0, 1.0, 30.0])
def test_damping(case: tuple[float, float], ratio: float):
    """Without damping all energy is lost in the contact; overdamped modes creep, and nothing slips."""
    trace = assert_agrees(with_ratio(oscillator(*case), ratio), 6, case[1])
    lost = trace.totals.work[-1]
    if ratio == 0:
        assert lost[1] == 0
        assert lost[2] > 0
    else:
        assert trace.sequence == []


def test_overdamped_modes_are_followed_in_few_parts():
    """What creeps needs no short parts of a step: a thousand times critical, 100,000 of a cycle were taken."""
    trace = simulate(with_ratio(oscillator(3.0, 1.39), 1e3), 2, COLLOCATED)
    assert trace.num_steps < 40_000
    assert trace.energy_residual < 1e-8


FAST = 9000.0


def with_a_fast_mode() -> Model:
    """The second mode ten thousand times as fast as the first; with its unit mass it is that much stiffer."""
    model = oscillator(1.0, 1.1)
    omega = TURN * np.array([0.9, FAST])
    structure = replace(model.structure, frequency=omega / TURN, damping=0.04 * omega)
    return replace(model, structure=structure)


def test_frequencies_ten_thousand_apart():
    """Collocation knows the fast mode exactly; an explicit method that may not take enough steps says so."""
    collocated = simulate(with_a_fast_mode(), 4, COLLOCATED)
    assert collocated.energy_residual < 1e-8
    alone = simulate(with_a_fast_mode(), 4, replace(COLLOCATED, rtol=1e-12, atol=1e-14))
    assert collocated.sequence == alone.sequence
    assert len(alone.sequence) > 8
    assert relative_error(collocated.motion, alone.motion) < 1e-8
    with pytest.raises(RunError, match=r"the budget of 10000 steps .*solver\.max_steps"):
        simulate(with_a_fast_mode(), 4, replace(EXPLICIT, budget=10_000))


@pytest.mark.slow
def test_frequencies_ten_thousand_apart_by_both_methods():
    collocated = simulate(with_a_fast_mode(), 2, COLLOCATED)
    explicit = simulate(with_a_fast_mode(), 2, replace(EXPLICIT, rtol=1e-9, atol=1e-11, budget=10_000_000))
    assert collocated.sequence == explicit.sequence
    assert relative_error(collocated.run.displacement, explicit.run.displacement) < 1e-7


# Friction


@pytest.mark.parametrize("case", CASES)
def test_friction_of_ten(case: tuple[float, float]):
    """The cone is nearly a half-space: contacts stick, or are apart; slip only as n falls to zero."""
    trace = assert_agrees(with_contact(oscillator(*case), friction=10.0), 6, case[1])
    share = shares_of(trace)
    assert share[SLIP] < 0.05


def shares_of(trace: Trace) -> np.ndarray:
    times = np.r_[0.0, trace.log.time, trace.run.time]
    states = np.r_[trace.log.before, trace.run.state]
    return np.bincount(states, np.diff(times), 3) / trace.run.time


@pytest.mark.parametrize("case", CASES)
def test_friction_that_vanishes(case: tuple[float, float]):
    """Its force is below the tolerance, and its direction turns without bound: none at all acts the same."""
    rough = simulate(with_contact(oscillator(*case), friction=1e-9), 6, COLLOCATED)
    smooth = with_contact(oscillator(*case), friction=0.0, tangential_stiffness=np.zeros((2, 2)))
    start = replace(smooth.start, state=np.array([SLIP if case[0] > 0 else SEPARATION]))
    for solver in (EXPLICIT, COLLOCATED):
        trace = simulate(replace(smooth, start=start), 6, solver)
        assert relative_error(rough.motion, trace.motion) < 1e-7
        assert trace.energy_residual < 1e-8
    assert rough.energy_residual < 1e-8


def test_an_explicit_method_says_that_it_cannot_follow_the_direction_of_a_vanishing_force():
    model = with_contact(oscillator(3.0, 1.39), friction=1e-9)
    with pytest.raises(RunError, match=r"the budget of 5000 steps .*solver\.method: exponential"):
        simulate(model, 6, replace(EXPLICIT, budget=5000))


def test_a_run_that_ends_before_its_first_step():
    """Then there are no steps to hand over: the first one tried is far too long for the tolerance."""
    impatient = replace(COLLOCATED, rtol=1e-13, atol=1e-15, budget=1)
    with pytest.raises(RunError, match=r"at time 0 s, in cycle 1: the budget of 1 steps"):
        simulate(oscillator(3.0, 1.39), 1, impatient)


# Borders


def stuck_motion(preload: float, frequency: float, *, stuck: bool) -> tuple[Model, np.ndarray]:
    """The oscillator in its steady motion with the contact stuck or apart, and the contact's motion over a cycle."""
    model, omega = oscillator(preload, frequency), TURN * frequency
    body, shape, own = model.structure, model.contact_shape[0], model.contacts[0]
    springs = np.zeros((3, 3))
    springs[:2, :2], springs[2, 2] = own.tangential_stiffness, own.normal_stiffness
    matrix = np.diag(body.stiffness) + stuck * (shape.T @ springs @ shape)
    q = np.linalg.solve(matrix - omega**2 * np.eye(2) + 1j * omega * np.diag(body.damping), np.ones(2))
    start = Start(q.real, -omega * q.imag, np.zeros((1, 2)), np.array([STICK if stuck else SEPARATION]))
    turn = np.exp(1j * TURN * np.linspace(0, 1, 200_001))
    return replace(model, start=start), ((shape @ q)[:, None] * turn).real


@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize("beyond", [1e-6, -1e-6, -1e-3])
def test_the_border_of_full_stick(solver: Solver, beyond: float):
    """The load at which the stuck motion just reaches the cone, from its closed form: 8.0134929 at 1.39 Hz.

    Above it nothing slips; below, it slips once a cycle and sticks again, however shortly.
    """
    _, (u1, u2, v) = stuck_motion(10.0, 1.39, stuck=True)
    border = np.max(20.0 * np.hypot(u1, u2) / 0.5 - 20.0 * v)
    assert border == pytest.approx(8.0134929, rel=1e-7)
    model, _ = stuck_motion(border * (1 + beyond), 1.39, stuck=True)
    trace = simulate(model, 6, solver)
    slips, sticks = (0, STICK, SLIP), (0, SLIP, STICK)
    times = 0 if beyond > 0 else len(trace.sequence) // 2
    assert trace.sequence == [slips, sticks] * times
    assert beyond > 0 or times in (5, 6)
    assert trace.energy_residual < 1e-8
    assert relative_error(trace.amplitude[-1], trace.amplitude[0]) < 1e-3


@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize("part", [1 - 1e-4, 1 - 1e-6, 1 + 1e-9])
def test_a_gap_that_just_touches(solver: Solver, part: float):
    """The closed form of the free motion says how far it comes: a touch of 1e-6 of it is seen, a miss is none."""
    free, motion = stuck_motion(-1.0, 0.97, stuck=False)
    gap, body, omega = part * motion[2].max(), free.structure, TURN * 0.97
    for phase in np.linspace(0.1, 6.0, 12):  # each puts the touch at another place of a step
        q = np.exp(1j * phase) / (body.stiffness - omega**2 + 1j * omega * body.damping)
        load = excitation(0.97, [np.cos(phase)] * 2, [-np.sin(phase)] * 2)
        start = replace(free.start, displacement=q.real, velocity=-omega * q.imag)
        trace = simulate(replace(with_contact(free, preload=-20.0 * gap), start=start, excitation=load), 2, solver)
        touches = [step for step in trace.sequence if step[1] == SEPARATION]
        assert len(touches) == (0 if part > 1 else 2), phase


@pytest.mark.parametrize("solver", METHODS)
def test_no_force_and_no_motion(solver: Solver):
    """Nothing moves, to the last bit."""
    model = replace(oscillator(3.0, 1.39), excitation=excitation(1.39, [0.0, 0.0], [0.0, 0.0]))
    trace = simulate(model, 3, solver)
    assert trace.sequence == []
    assert not np.any(trace.motion)
    assert not np.any(trace.amplitude)
    assert not np.any(trace.totals.work)


@pytest.mark.parametrize("solver", METHODS)
def test_a_start_with_the_slip_far_off(solver: Solver):
    """In a cone as large the slip may be anywhere (outside it is refused, tests/scene/test_config.py).

    The motion is that about the equilibrium of the offset, which is 1e5 times as large.
    """
    model, offset = with_contact(oscillator(3.0, 1.39), preload=1e6), np.array([2e4, 1e4])
    far = replace(model, start=replace(model.start, slip=offset[None]))
    shape, own = model.contact_shape[0], model.contacts[0]
    springs = np.diag([20.0, 20.0, own.normal_stiffness])
    stiffness = np.diag(model.structure.stiffness) + shape.T @ springs @ shape
    still = np.linalg.solve(stiffness, shape[:2].T @ own.tangential_stiffness @ offset)
    near = replace(model, start=replace(model.start, displacement=-still))
    one, other = (simulate(start, 6, solver) for start in (far, near))
    assert one.sequence == other.sequence == []
    assert np.abs(one.run.displacement - still - other.run.displacement).max() < 1e-8 * np.abs(still).max()


# The singular direction


@pytest.mark.slow
@pytest.mark.parametrize("left", [0.1, 1e-3, 1e-6, 1e-9, 0.0, -1e-9])
def test_a_normal_load_that_falls_to_next_to_nothing_in_slip(left: float):
    """The direction of slip turns at a rate of 1/n: the steps of a cycle stay bounded, and both methods agree.

    A body driven along an ellipse drags a pad that it does not feel, whose load falls to a share of its mean.
    """
    natural, omega = 0.3, TURN
    force = np.array([1.0, 0.5 - 0.3j, 0.7])
    q = force / (natural**2 - omega**2)
    load = excitation(1.0, force.real, -force.imag)
    body = systems.structure([natural**2] * 3, [0.0] * 3, np.eye(3).tolist())
    own = systems.pad(0.3, 1e-6, 1e-6, 1e-6 * abs(q[2]) * (1 + left))
    velocity = (1j * omega * q).real
    n = own.preload + 1e-6 * q[2].real
    slip = q[:2].real - 0.3 * n / 1e-6 * velocity[:2] / np.linalg.norm(velocity[:2])
    start = Start(q.real, velocity, slip[None], np.array([SLIP]))
    model = Model(body, (own,), load, start)
    explicit, collocated = (simulate(model, 4, solver) for solver in (EXPLICIT, COLLOCATED))
    assert explicit.sequence == collocated.sequence
    assert explicit.num_steps < 1000 * 4
    assert collocated.num_steps < 200 * 4
    dissipated = [trace.totals.work[-1][2] for trace in (explicit, collocated)]
    assert dissipated[0] == pytest.approx(dissipated[1], rel=1e-6)


# Many at once


def in_order(model: Model, order: Sequence[int]) -> Model:
    start = model.start
    moved = replace(start, slip=start.slip[list(order)], state=start.state[list(order)])
    return replace(model, contacts=tuple(model.contacts[i] for i in order), start=moved)


def assert_same_bits(model: Model, order: Sequence[int], cycles: int, solver: Solver) -> Trace:
    """The trace of the model as it is, which is that of the model with its contacts in another order."""
    one, other = simulate(model, cycles, solver), simulate(in_order(model, order), cycles, solver)
    np.testing.assert_array_equal(other.motion, one.motion)
    np.testing.assert_array_equal(other.run.slip, one.run.slip[list(order)])
    np.testing.assert_array_equal(other.log.time, one.log.time)
    np.testing.assert_array_equal(other.totals.stored, one.totals.stored)
    return one


def test_the_order_of_the_contacts_does_not_matter():
    model = systems.scene(Path(__file__).parents[1] / "data" / "many_modes.yaml")
    for order in ([1, 2, 0], [2, 1, 0]):
        trace = assert_same_bits(model, order, 2, PRESETS["standard"])
    assert len(trace.sequence) > 8


@pytest.mark.slow
@pytest.mark.parametrize("first", [SHOOT, NEVER])
def test_the_order_of_the_contacts_does_not_matter_in_a_sweep(first: float):
    """Nor where the motion is shot, by derivatives."""
    model, order = shared_pads(3), [2, 0, 1]
    model = replace(model, contacts=tuple(replace(c, friction=0.3 + 0.2 * i) for i, c in enumerate(model.contacts)))
    chains = [[Chain(each, (1.1, 1.15))] for each in (model, in_order(model, order))]
    (one,), (other,) = (steady_states(chain, PRESETS["draft"], Criterion(1e-5, 500, first)) for chain in chains)
    for here, there in zip(one, other, strict=True):
        assert here.settled
        assert np.all((here.slip_share > 0.05) & (here.slip_share < 0.95))
        np.testing.assert_array_equal(there.amplitude, here.amplitude)
        np.testing.assert_array_equal(there.slip_share, here.slip_share[order])


def ring(num: int) -> Model:
    """Equal blades in a ring, each coupled to its neighbours and on a pad of its own, all forced alike."""
    natural, coupling, names = (TURN * 0.9) ** 2, 5.0, tuple(f"blade{i}" for i in range(num))
    around = np.roll(np.eye(num), 1, axis=0)
    square, modes = np.linalg.eigh((natural + 2 * coupling) * np.eye(num) - coupling * (around + around.T))
    shape = np.stack([modes, np.zeros((num, num)), 0.5 * modes], axis=1)
    body = Structure(np.sqrt(square) / TURN, np.ones(num), 0.04 * np.sqrt(square), names, shape)
    pads = tuple(replace(systems.pad(0.5, 20.0, 20.0, 1.0), name=name, point=name) for name in names)
    return Model(body, pads, excitation(1.1, 2.0 * modes.sum(axis=0), np.zeros(num)), at_rest(num, num))


def shared_pads(num: int) -> Model:
    """The oscillator on a pad that is parted into unequal ones: all of them switch at once."""
    model = oscillator(1.0, 1.1)
    share = np.random.default_rng(1).uniform(0.5, 1.5, num)

    def part(index: int, size: float) -> Contact:
        whole = model.contacts[0]
        return replace(
            whole,
            name=f"pad{index}",
            tangential_stiffness=whole.tangential_stiffness * size,
            normal_stiffness=whole.normal_stiffness * size,
            preload=whole.preload * size,
        )

    pads = tuple(part(i, float(size)) for i, size in enumerate(share / share.sum()))
    return replace(model, contacts=pads, start=at_rest(2, num))


@pytest.mark.slow
@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize("make", [ring, shared_pads])
def test_thirty_contacts_that_switch_at_once(make: Any, solver: Solver):
    """By symmetry, or because one pad is thirty: each transition is thirty, at one instant, in any order of them."""
    trace = assert_same_bits(make(30), np.random.default_rng(2).permutation(30).tolist(), 6, solver)
    assert len(trace.sequence) % 30 == 0
    assert len(trace.sequence) > 300
    for first in range(0, len(trace.sequence), 30):
        own = slice(first, first + 30)
        assert sorted(trace.log.contact[own]) == list(range(30))
        assert len(set(zip(trace.log.before[own], trace.log.after[own], strict=True))) == 1
        assert np.ptp(trace.log.time[own]) < 1e-12
    assert trace.energy_residual < 1e-8
    if make is shared_pads:
        one = simulate(oscillator(1.0, 1.1), 6, solver)
        assert relative_error(trace.motion, one.motion) < 1e-9
        assert len(trace.sequence) == 30 * len(one.sequence)


@pytest.mark.slow
def test_a_hundred_modes_with_a_hundred_contacts():
    """The ring with a force that goes round, so that each contact switches at its own time, by two methods."""
    model = ring(100)
    angle = TURN * np.arange(100) / 100
    modes = model.structure.shape[:, 0]
    load = excitation(1.1, 2.0 * modes.T @ np.cos(angle), 2.0 * modes.T @ np.sin(angle))
    model = replace(model, excitation=load)
    one, other = (simulate(model, 2, Solver(name, 1e-7, 1e-9)) for name in ("tsit5", "exponential"))
    for trace in (one, other):
        assert set(trace.log.contact) == set(range(100))
        assert trace.energy_residual < 1e-5
    assert relative_error(other.motion, one.motion) < 1e-6
    switches = [sorted(zip(trace.log.contact, trace.log.time, strict=True)) for trace in (one, other)]
    np.testing.assert_allclose(switches[1], switches[0], atol=1e-6)
    # A force that goes round moves every blade alike, a hundredth of a cycle after the one before.
    reach = one.amplitude[-1][:, 0]
    assert np.ptp(reach) < 0.5 * reach.max()


# Long, short, late


@pytest.mark.parametrize("solver", METHODS)
def test_one_cycle(solver: Solver):
    whole, one = simulate(oscillator(1.0, 1.1), 2, solver), simulate(oscillator(1.0, 1.1), 1, solver)
    assert one.run.completed == 1
    assert one.run.time == pytest.approx(1 / 1.1, rel=1e-14)
    assert one.sequence == whole.sequence[: len(one.sequence)]
    np.testing.assert_array_max_ulp(one.amplitude[0], whole.amplitude[0], 2)  # as many steps, as wide the program


@pytest.mark.parametrize("solver", METHODS)
def test_a_million_seconds_later(solver: Solver):
    """Time counts within the cycle: late, only the time that is told is rounded, to a spacing of 1.2e-10 s."""
    early = simulate(oscillator(1.0, 1.1), 6, solver)
    run = Run(oscillator(1.0, 1.1), [Phase(1.1, 6)], solver)
    run.time = 1e6
    late = follow(run)
    np.testing.assert_array_equal(late.motion, early.motion)
    np.testing.assert_array_equal(late.amplitude, early.amplitude)
    assert late.sequence == early.sequence
    np.testing.assert_allclose(late.log.time - 1e6, early.log.time, rtol=0, atol=4 * np.spacing(1e6))


@pytest.mark.slow
@pytest.mark.parametrize("solver", [EXPLICIT, COLLOCATED], ids=["tsit5", "exponential"])
def test_a_hundred_thousand_cycles(solver: Solver):
    """A settled motion neither drifts nor grows, and no batch of steps holds more memory than the first."""
    model, held, peaks = systems.jenkins(1.2), [], []
    run = Run(model, [Phase(1.2 / TURN, 100_000)], replace(solver, rtol=1e-6, atol=1e-8, reduce=True))
    last = 0
    for steps in run.batches():
        if run.completed - last > 5000:
            last = run.completed
            held.append(sum(array.nbytes for array in jax.live_arrays()))
            peaks.append(np.abs(steps.end[0]).max())
    assert run.completed == 100_000
    assert max(held) <= 1.1 * held[0]
    # The batches begin at different places of a cycle; each holds the peak of several cycles.
    assert np.ptp(peaks) < 1e-2 * max(peaks)
    state = np.r_[run.displacement, run.velocity]
    again = Run(model, [Phase(1.2 / TURN, 1)], run.solver)
    again.displacement, again.velocity, again.slip, again.state = run.displacement, run.velocity, run.slip, run.state
    next_cycle = follow(again)
    assert relative_error(next_cycle.motion, state) < 1e-12
    assert next_cycle.energy_residual < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("solver", "drift"), [(EXPLICIT, 1e-3), (COLLOCATED, 1e-9)], ids=["tsit5", "exponential"])
def test_energy_and_phase_of_a_free_vibration_after_a_hundred_thousand_cycles(solver: Solver, drift: float):
    """An explicit method loses its tolerance a step; the flow of a mode is exact, and leaves rounding alone."""
    body = systems.structure([1.0], [0.0], [[1, 0, 0]])
    start = Start(np.array([1.0]), np.zeros(1), np.zeros((0, 2)), np.zeros(0, dtype=int))
    still = Model(body, (), excitation(1 / TURN, [0.0], [0.0]), start)
    run = Run(still, [Phase(1 / TURN, 100_000)], replace(solver, reduce=True))
    for _ in run.batches():
        pass
    assert np.hypot(run.displacement, run.velocity)[0] == pytest.approx(1.0, abs=drift)
    assert np.arctan2(-run.velocity, run.displacement)[0] == pytest.approx(0.0, abs=drift)


# Rounding and tolerances


def moved_by_a_bit(model: Model, part: str, towards: float) -> Model:
    own = model.contacts[0]
    if part in ("friction", "preload", "normal_stiffness"):
        return with_contact(model, **{part: float(np.nextafter(getattr(own, part), towards))})
    if part == "tangential_stiffness":
        return with_contact(model, tangential_stiffness=np.nextafter(own.tangential_stiffness, towards) * np.eye(2))
    if part == "force":
        load = model.excitation
        return replace(model, excitation=replace(load, cosine=np.nextafter(load.cosine, towards)))
    body = model.structure
    return replace(model, structure=replace(body, frequency=np.nextafter(body.frequency, towards)))


@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize(
    "part", ["friction", "preload", "normal_stiffness", "tangential_stiffness", "force", "frequency"]
)
def test_a_parameter_moved_by_its_last_bit(solver: Solver, part: str):
    """Away from grazing the transitions are the same, at the same times."""
    one = simulate(oscillator(1.0, 1.1), 8, solver)
    for towards in (-np.inf, np.inf):
        other = simulate(moved_by_a_bit(oscillator(1.0, 1.1), part, towards), 8, solver)
        assert other.sequence == one.sequence
        np.testing.assert_allclose(other.log.time, one.log.time, rtol=0, atol=1e-11)
        assert relative_error(other.motion, one.motion) < 1e-12


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("solver", METHODS)
def test_the_transitions_are_those_of_every_tolerance(solver: Solver, case: tuple[float, float]):
    """From 1e-5 to 1e-12 they are as many, and the energy balance closes as the tolerance asks."""
    for rtol in (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12):
        trace = simulate(oscillator(*case), 8, replace(solver, rtol=rtol, atol=1e-2 * rtol))
        assert len(trace.sequence) == {3.0: 27, -1.0: 14, 1.0: 29}[case[0]], rtol
        assert trace.energy_residual < max(100 * rtol, 1e-10)
