"""Steady states by marching: many scenes side by side until each repeats itself.

A motion counts as settled when what is still missing, extrapolated from how fast the change from cycle to cycle falls,
is below the tolerance: a slow drift changes little in a cycle and is yet far from rest. Motions that repeat after two
or three cycles are recognised. Those that have settled make room for the next.
"""

import timesim.jax_setup  # noqa: F401  isort: skip

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from timesim.history import Steps, extremes
from timesim.integrate import Status, Trajectory, march_sections
from timesim.model import SEPARATION, SLIP, Model, Start
from timesim.solver import Solver
from timesim.system import System, system_of
from timesim.trajectory import Frame, Phase, Run, RunError

CYCLES_A_ROUND = 8
SLOTS = (4, 16, 64)  # sizes of a batch: few, so that little is compiled
PERIODS = (1, 2, 3)
UNSETTLED_CYCLES = 10  # over which the amplitude of a motion that has not settled is taken
REST = 1e-13  # a change this small is rounding

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Task:
    """A model, started from its own `Start`, to be marched at a frequency [Hz] until it settles."""

    model: Model
    frequency: float


@dataclass(frozen=True)
class Orbit:
    """Where a march has ended.

    Attributes:
        end: the state at the end of a cycle, from which another march may start.
        amplitude: (max - min) / 2 of each point along x, y, z over a period, shape (P, 3).
        settled: whether the motion repeats.
        cycles: excitation cycles marched.
        period: its period in excitation periods; 0 if it has not settled.
        slip_share, separation_share: share of the period in these states, shape (C,).
        reason: why the march failed; None if it did not.
    """

    end: Start
    amplitude: np.ndarray
    settled: bool
    cycles: int
    period: int
    slip_share: np.ndarray
    separation_share: np.ndarray
    reason: str | None = None


@dataclass
class March:
    """One task under way."""

    index: int
    task: Task
    run: Run
    frame: Frame
    system: System
    now: Trajectory
    sections: list[np.ndarray] = field(default_factory=list)
    cycles: int = 0


def settle(
    tasks: Sequence[Task],
    solver: Solver,
    *,
    tolerance: float = 1e-8,
    max_cycles: int = 2000,
    progress: Progress | None = None,
) -> list[Orbit]:
    """March each task until it settles.

    Args:
        tasks: what to march.
        solver: method and tolerances.
        tolerance: of the state from cycle to cycle, relative to its largest entry.
        max_cycles: budget of each.
        progress: called with the tasks done and their number.

    Returns:
        The orbits in the order of the tasks.
    """
    pending = deque(_march(index, task, solver) for index, task in enumerate(tasks))
    found: dict[int, Orbit] = {}
    groups: dict[str, list[March]] = {}
    for march in pending:
        groups.setdefault(_shape_of(march.system), []).append(march)
    for group in groups.values():
        for march, orbit in _settle_group(deque(group), solver, tolerance, max_cycles):
            found[march.index] = orbit
            if progress is not None:
                progress(len(found), len(tasks))
    return [found[index] for index in range(len(tasks))]


def _march(index: int, task: Task, solver: Solver) -> March:
    run = Run(task.model, [Phase(task.frequency, 1)], solver)
    frame = Frame(task.model, run.reduction, task.frequency)
    system = system_of(task.model, task.frequency, run.phase, run.reduction)
    now = frame.begin(system, run, solver.first_step(_stiffest(task)), work=False)
    return March(index, task, run, frame, *jax.tree.map(np.asarray, (system, now)))


def _stiffest(task: Task) -> float:
    return task.model.stuck_rate / (2 * np.pi * task.frequency)


def _shape_of(system: System) -> str:
    return str(jax.tree.map(np.shape, system))


def _settle_group(
    pending: deque[March], solver: Solver, tolerance: float, max_cycles: int
) -> Iterator[tuple[March, Orbit]]:
    method = solver.method()
    active: list[March] = []
    while pending or active:
        slots = next((size for size in SLOTS if size >= len(pending) + len(active)), SLOTS[-1])
        while pending and len(active) < slots:
            active.append(pending.popleft())
        _advance(method, solver, active, slots)
        waiting = []
        for march in active:
            orbit = _judged(march, solver, tolerance, max_cycles)
            if orbit is None:
                waiting.append(march)
            else:
                yield march, orbit
        active = waiting


def _advance(method: object, solver: Solver, batch: list[March], slots: int) -> None:
    """March a batch by a round; empty slots repeat its first member."""
    filled = batch + [batch[0]] * (slots - len(batch))
    stack = lambda *leaves: jnp.asarray(np.stack(leaves))  # noqa: E731
    systems, starts = (jax.tree.map(stack, *parts) for parts in zip(*((m.system, m.now) for m in filled), strict=True))
    control = solver.control(max(_stiffest(m.task) for m in batch))
    ends, sections = march_sections(method, control, systems, starts, CYCLES_A_ROUND)
    ends, rows = jax.tree.map(np.asarray, ends), np.asarray(sections)
    for slot, march in enumerate(batch):
        march.now = jax.tree.map(lambda leaf, slot=slot: leaf[slot], ends)
        march.cycles += int(march.now.cycle)
        march.sections = [*march.sections, *rows[slot, : int(march.now.cycle)]][-2 * CYCLES_A_ROUND :]


def _judged(march: March, solver: Solver, tolerance: float, max_cycles: int) -> Orbit | None:
    """The orbit if the march is over."""
    if int(march.now.status) != Status.RUNNING:
        return _failed(march, solver)
    period = _period(np.array(march.sections), tolerance)
    if period == 0 and march.cycles < max_cycles:
        return None
    march.frame.store(march.now, march.run, 0.0, march.run.work)
    return _measured(march, solver, period)


def _period(sections: np.ndarray, tolerance: float) -> int:
    """Period after which the sections repeat to the tolerance, extrapolated; 0 if they do not."""
    size = np.max(np.abs(sections), initial=0.0)
    if size == 0:
        return 1
    half = CYCLES_A_ROUND // 2
    for period in PERIODS:
        change = np.max(np.abs(sections[period:] - sections[:-period]), axis=1) / size
        if change.size < CYCLES_A_ROUND:
            continue
        last, before = np.max(change[-half:]), np.max(change[-2 * half : -half])
        ratio = (last / before) ** (1 / half) if before > 0 else 0.0
        if last < REST or (ratio < 1 and last < tolerance and last * ratio / (1 - ratio) < tolerance):
            # An alternation below the tolerance is no doubling of the period.
            steps = np.max(np.abs(np.diff(sections, axis=0)[-half:])) / size
            return 1 if steps < tolerance else period
    return 0


def _start_of(run: Run) -> Start:
    return Start(run.displacement, run.velocity, run.slip, run.state, run.phase)


def _failed(march: March, solver: Solver) -> Orbit:
    march.frame.store(march.now, march.run, 0.0, march.run.work)
    model = march.task.model
    try:
        march.run.completed = march.cycles
        march.run.judge(int(march.now.status), int(march.now.culprit))
        reason = "failed"
    except RunError as error:
        reason = str(error)
    nothing = np.full(model.num_contacts, np.nan)
    amplitude = np.full((len(model.structure.points), 3), np.nan)
    return Orbit(_start_of(march.run), amplitude, False, march.cycles, 0, nothing, nothing, reason)


def _measured(march: March, solver: Solver, period: int) -> Orbit:
    """One more period, recorded: amplitudes and shares of the states."""
    model = replace(march.task.model, start=_start_of(march.run))
    cycles = period or UNSETTLED_CYCLES
    run = Run(model, [Phase(march.task.frequency, cycles)], replace(solver, reduce=False))
    run.state = march.run.state
    shape = model.structure.shape.reshape(-1, model.structure.num_modes)
    low, high = np.full(len(shape), np.inf), np.full(len(shape), -np.inf)
    shares, length = np.zeros((2, model.num_contacts)), 0.0
    reason = None
    try:
        for steps in run.batches():
            least, most = extremes(steps, shape)
            low, high = np.minimum(low, least.min(axis=0)), np.maximum(high, most.max(axis=0))
            shares += _time_in_states(steps)
            length += float(steps.h.sum())
    except RunError as error:
        reason = str(error)
    slip, apart = shares / length
    amplitude = 0.5 * (high - low).reshape(-1, 3)
    return Orbit(_start_of(run), amplitude, period > 0, march.cycles + cycles, period, slip, apart, reason)


def _time_in_states(steps: Steps) -> np.ndarray:
    return np.stack([steps.h @ (steps.state == state) for state in (SLIP, SEPARATION)])
