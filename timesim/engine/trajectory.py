"""A run of one trajectory: from a model to steps in the units of the scene, through the dimensionless event loop.

The compiled loop hands over its steps a batch at a time, so device memory does not grow with the cycles.
"""

import timesim.runtime  # noqa: F401  isort: skip

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import jax
import numpy as np

from timesim.engine.event_loop import advance
from timesim.engine.exponential.extremes import extremes
from timesim.engine.exponential.parts import short_steps
from timesim.engine.exponential.work import has_fast_modes, work_done
from timesim.engine.method import Method, step_method
from timesim.engine.solver import Control, step_control
from timesim.engine.status import Status
from timesim.engine.step import Step as LoopStep
from timesim.engine.step import Trajectory, begin
from timesim.engine.system import Point, System, Work, contact_axes, system_of
from timesim.model.contact_state import contact_loads, slip_follows_motion, start_states
from timesim.model.model import SEPARATION, STICK, Model, Start
from timesim.model.reduction import Reduction, reduction_of
from timesim.model.scales import Scales, scales_of
from timesim.model.solver import Solver
from timesim.program import program

_begin = program(begin)

ROOM = 2**18  # numbers in a batch of steps: what is done once a batch hardly counts, and XLA runs the loop as one
LEAST, BATCH = 64, 2048  # steps handed over at a time, at least and at most
PERIOD = 2 * np.pi


@dataclass(frozen=True)
class Phase:
    """A number of cycles at one frequency [Hz]."""

    frequency: float
    cycles: int


class RunError(Exception):
    """A run that ended early: the message says when, why and what to try."""


@dataclass
class Run:
    """A trajectory under way; iterate over `batches` to advance it.

    Attributes:
        model: what is simulated.
        phases: the schedule; the phase of the excitation is continuous across its changes.
        solver: method and tolerances.
        method: what takes the steps, by default that of the solver.
        displacement, velocity, slip, state: the present state, in the units of the scene.
        phase: present phase of the excitation [rad].
        time: time since the start [s].
        completed: cycles completed.
        compile_seconds: time spent in the first call of each compiled loop, most of it compilation.
    """

    model: Model
    phases: Sequence[Phase]
    solver: Solver
    method: Method = field(default=None)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        self.method = self.method or step_method(self.solver)
        frequencies = sorted({phase.frequency for phase in self.phases})
        self.reduction = reduction_of(self.model, frequencies, reduce=self.solver.reduce)
        start = self.model.start
        self.displacement, self.velocity = start.displacement.copy(), start.velocity.copy()
        self.slip, self.state = start.slip.copy(), start_states(self.model)
        self.phase, self.time, self.completed = start.phase, 0.0, 0
        self.compile_seconds = 0.0
        self.work = np.zeros(2 + self.model.num_contacts)

    @property
    def num_cycles(self) -> int:
        """Cycles of the whole schedule."""
        return sum(phase.cycles for phase in self.phases)

    def batches(self) -> "Iterator[Steps]":
        """Advance through the schedule, a batch of steps at a time.

        Raises:
            RunError: the loop ended early; what was yielded before is valid.
        """
        for phase in self.phases:
            yield from self._through(phase)

    def _through(self, phase: Phase) -> "Iterator[Steps]":
        frame = Frame(self.model, self.reduction, phase.frequency)
        system = system_of(self.model, phase.frequency, self.phase, self.reduction)
        stiffest = self.model.stuck_rate / frame.scales.omega
        method = self.method
        system, control = jax.device_put((system, step_control(self.solver, stiffest)))
        now = frame.begin(system, self, self.solver.first_step(stiffest), work=method.integrates_work)
        origin = Origin(self.time, self.phase, self.completed, self.work.copy())
        room = capacity(system, 0 if method.integrates_work else method.order)
        while self.completed < origin.completed + phase.cycles:
            clock = time.perf_counter()
            first = self.compile_seconds == 0.0
            now, record, count = advance(method, control, system, now, np.asarray(phase.cycles), room)
            loop = first_rows(record, int(count))
            done, before = loop.end.work, origin.work
            if not method.integrates_work:
                done, before = work_of(system, control, record, int(count)), self.work
            if first:
                self.compile_seconds = time.perf_counter() - clock
            self._go_on(frame, now, origin)
            if loop.h.size:
                work = frame.work(done, before)
                self.work = work[-1]
                yield Steps(frame, system, loop, origin, work, self.solver.rtol)
            self.judge(int(now.status), int(now.culprit))

    def _go_on(self, frame: "Frame", now: Trajectory, origin: "Origin") -> None:
        """Take up the present state of the loop."""
        now = jax.tree.map(np.asarray, now)
        here = frame.start(now.point, now.state, origin.phase + float(now.time))
        self.displacement, self.velocity = here.displacement, here.velocity
        self.slip, self.state, self.phase = here.slip, here.state, here.phase
        self.completed = origin.completed + int(now.cycle)
        self.time = origin.time + float(PERIOD * now.cycle + now.time) / frame.scales.omega

    def judge(self, status: int, culprit: int) -> None:
        """Raise what a status of the loop means.

        Raises:
            RunError: the loop has ended early.
        """
        if status == Status.RUNNING:
            return
        message = message_of(self.model, self.reduction, self.solver, status, culprit)
        raise RunError(f"at time {self.time:.9g} s, in cycle {self.completed + 1}: {message}")


def message_of(model: Model, reduction: Reduction, solver: Solver, status: int, culprit: int) -> str:
    """What a status that has ended a trajectory means, and what to try."""
    contact = model.contacts[reduction.live[culprit]].name if reduction.live.size else None
    return Status(status).message(solver=solver.name, budget=solver.budget, contact=contact)


@dataclass(frozen=True)
class Origin:
    """Where the loop has begun to count: time [s], phase of the excitation [rad], cycles and energies until then."""

    time: float
    phase: float
    completed: int
    work: np.ndarray


class Frame:
    """Between the dimensionless form at one frequency, reduced, and the units of the whole scene."""

    def __init__(self, model: Model, reduction: Reduction, frequency: float):
        self.model, self.reduction = model, reduction
        self.scales: Scales = scales_of(model, frequency)
        self.axes = contact_axes(model, reduction)

    def begin(self, system: System, run: Run, first_step: float, *, work: bool = True) -> Trajectory:
        """The loop's trajectory from the present state of a run, with or without its energies."""
        start = Start(run.displacement, run.velocity, run.slip, run.state)
        point, state = self.point(start)
        nothing = Work(np.zeros(()), np.zeros(()), np.zeros(state.size)) if work else None
        return _begin(system, Point(point.q, point.p, point.w, nothing), state, np.asarray(first_step))

    def point(self, start: Start) -> tuple[Point, np.ndarray]:
        """The loop's continuous state and contact states (C,) of a start whose contact states are known."""
        scales, modes, live = self.scales, self.reduction.modes, self.reduction.live
        q = start.displacement[modes] / scales.mode[modes]
        p = start.velocity[modes] / (scales.mode[modes] * scales.omega)
        w = np.einsum("cax,ca->xc", self.axes, start.slip[live]) / scales.length
        return Point(q, p, tuple(w), None), start.state[live]

    def start(self, point: Point, state: np.ndarray, phase: float) -> Start:
        """The inverse of `point`; what the loop does not know is as in the model's own start."""
        q, p, w = np.asarray(point.q), np.asarray(point.p), tuple(map(np.asarray, point.w))
        displacement, state = self.modal(q), self.states(np.asarray(state))
        # Of a contact along a line, or proven to be apart, the loop does not know all of the motion that w follows.
        loads = contact_loads(self.model, displacement, self.slip(w, self.model.start.slip))
        follows = slip_follows_motion(state, self.model.friction)[:, None]
        slip = np.where(follows, loads.motion, loads.slip)
        return Start(displacement, self.modal(p, self.scales.omega), slip, state, phase)

    @property
    def shape(self) -> np.ndarray:
        """Displacements in the units of the scene for unit dimensionless modal displacements, shape (3P, M)."""
        structure, modes = self.model.structure, self.reduction.modes
        return structure.shape.reshape(-1, structure.num_modes)[:, modes] * self.scales.mode[modes]

    def modal(self, x: np.ndarray, unit: float = 1.0) -> np.ndarray:
        """Modal displacements of the scene, or rates of them where a unit of time is given."""
        modes, num = self.reduction.modes, self.model.structure.num_modes
        own = x * (self.scales.mode[modes] * unit)
        if modes.size == num:
            return own
        whole = np.zeros((*x.shape[:-1], num))
        whole[..., modes] = own
        return whole

    def slip(self, w: Sequence[np.ndarray], fill: np.ndarray, unit: float = 1.0) -> np.ndarray:
        """Slip of all contacts, or its rate; ``fill`` is that of the contacts that are left out."""
        whole = np.broadcast_to(fill, (*w[0].shape[:-1], self.model.num_contacts, 2)).copy()
        for side in (0, 1):  # numpy's einsum takes six times as long over so few components
            own = sum(self.axes[:, side, x] * part for x, part in enumerate(w))
            whole[..., self.reduction.live, side] = own * (self.scales.length * unit)
        return whole

    def states(self, state: np.ndarray) -> np.ndarray:
        """States of all contacts."""
        whole = np.full((*state.shape[:-1], self.model.num_contacts), STICK)
        whole[..., self.reduction.apart] = SEPARATION
        whole[..., self.reduction.live] = state
        return whole

    def work(self, done: Work, before: np.ndarray) -> np.ndarray:
        """Energies put in, lost in modal damping and lost in each contact, shape (..., 2 + C), after those before."""
        friction = np.zeros((*np.shape(done.input), self.model.num_contacts))
        friction[..., self.reduction.live] = done.friction
        modal = np.stack([np.asarray(done.input), np.asarray(done.damping)], axis=-1)
        return before + np.concatenate([modal, friction], axis=-1) * self.scales.energy


@dataclass(frozen=True)
class Steps:
    """Consecutive accepted steps, in the units of the scene; what is not asked for is not computed.

    Attributes:
        frame: from the dimensionless form.
        system: in which the steps were taken.
        loop: the steps as numpy arrays, the first axis that of the steps, N of them.
        origin: where the loop has begun to count.
        work: energies put in, lost in modal damping and lost in each contact since the start of the run, (N, 2 + C).
        rtol: relative tolerance of the steps.
    """

    frame: Frame
    system: System
    loop: LoopStep
    origin: Origin
    work: np.ndarray
    rtol: float

    @cached_property
    def cycle(self) -> np.ndarray:
        """Cycle of each step, from 0, shape (N,)."""
        return self.loop.cycle + self.origin.completed

    @cached_property
    def time(self) -> np.ndarray:
        """Start [s], shape (N,)."""
        return self.origin.time + (PERIOD * self.loop.cycle + self.loop.time) / self.frame.scales.omega

    @cached_property
    def h(self) -> np.ndarray:
        """Length [s], shape (N,)."""
        return self.loop.h / self.frame.scales.omega

    @cached_property
    def start(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(q, q', q'') at the start, each of shape (N, M)."""
        return self._modes(self.loop.start, self.loop.start_rate)

    @cached_property
    def end(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(q, q', q'') at the end, each of shape (N, M)."""
        return self._modes(self.loop.end, self.loop.end_rate)

    @cached_property
    def slip_start(self) -> tuple[np.ndarray, np.ndarray]:
        """(w, w') at the start, each of shape (N, C, 2)."""
        return self._slips(self.loop.start, self.loop.start_rate)

    @cached_property
    def slip_end(self) -> tuple[np.ndarray, np.ndarray]:
        """(w, w') at the end, each of shape (N, C, 2)."""
        return self._slips(self.loop.end, self.loop.end_rate)

    @cached_property
    def state(self) -> np.ndarray:
        """States of the contacts during the step, shape (N, C)."""
        return self.frame.states(self.loop.state)

    @cached_property
    def state_after(self) -> np.ndarray:
        """States after its end, shape (N, C)."""
        return self.frame.states(self.loop.state_after)

    @cached_property
    def reached(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(q, q', w) at the end, as in `end` and `slip_end`."""
        frame, point = self.frame, self.loop.end
        w = frame.slip(point.w, frame.model.start.slip)
        return frame.modal(point.q), frame.modal(point.p, frame.scales.omega), w

    def _modes(self, point: Point, rate: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        frame, omega = self.frame, self.frame.scales.omega
        return frame.modal(point.q), frame.modal(point.p, omega), frame.modal(rate.p, omega**2)

    def _slips(self, point: Point, rate: Point) -> tuple[np.ndarray, np.ndarray]:
        none = np.zeros((self.frame.model.num_contacts, 2))
        w = self.frame.slip(point.w, self.frame.model.start.slip)
        return w, self.frame.slip(rate.w, none, self.frame.scales.omega)

    def extremes(self, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest displacement of each point along each axis over rows of steps, each of shape (R, 3P).

        Args:
            first: the first step of each row, ascending, 0 the first of them, shape (R,).
        """
        return extremes(self.system, self.loop, self.frame.shape, first, self.rtol)

    def between(self, start: float, end: float) -> "Steps":
        """The steps from one time to another, so short that the polynomials through their ends are the motion."""
        first, last = np.searchsorted(self.time, [start, end], side="right") - 1
        rows = slice(max(first, 0), max(last, 0) + 1)
        loop = short_steps(self.system, jax.tree.map(lambda leaf: leaf[rows], self.loop), self.rtol)
        return replace(self, loop=loop)


def capacity(system: System, num_nodes: int) -> int:
    """Steps of a batch, a power of two; ``num_nodes``: places at which a step is known, 0 if only at its ends."""
    axes, (contacts, modes) = len(system.shape), system.shape[0].shape
    row = 8 * modes + (4 * axes + 2) * contacts + num_nodes * (3 * modes + (2 * axes + 1) * contacts)
    return int(min(max(2 ** np.ceil(np.log2(ROOM / row)), LEAST), BATCH))


def work_of(system: System, control: Control, record: LoopStep, count: int) -> Work:
    """Energies since the first of the steps in a record, of a method that leaves them to its dense output."""
    fast = has_fast_modes(system, float(control.longest))
    each = work_done(system, fast, record, np.asarray(count))
    whole: Work = jax.tree.map(lambda rows: np.cumsum(np.asarray(rows)[:count], axis=0), each)
    return whole


def first_rows(record: LoopStep, count: int) -> LoopStep:
    """The filled part of a record, on the host."""
    return jax.tree.map(lambda rows: np.asarray(rows)[:count], record)
