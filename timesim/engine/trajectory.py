"""A run of one trajectory: from a model to steps in the units of the scene, through the dimensionless event loop.

The compiled loop hands over its steps a batch at a time, so device memory does not grow with the cycles.
"""

import timesim.runtime  # noqa: F401  isort: skip

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np

from timesim.engine.event_loop import advance
from timesim.engine.exponential.parts import short_steps
from timesim.engine.history import Steps
from timesim.engine.method import Method, step_method
from timesim.engine.solver import step_control
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

BATCH = 512  # steps handed over at a time
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

    def batches(self) -> Iterator[Steps]:
        """Advance through the schedule, a batch of steps at a time.

        Raises:
            RunError: the loop ended early; what was yielded before is valid.
        """
        for phase in self.phases:
            yield from self._through(phase)

    def _through(self, phase: Phase) -> Iterator[Steps]:
        frame = Frame(self.model, self.reduction, phase.frequency)
        system = system_of(self.model, phase.frequency, self.phase, self.reduction)
        stiffest = self.model.stuck_rate / frame.scales.omega
        method, control = self.method, step_control(self.solver, stiffest)
        now = frame.begin(system, self, self.solver.first_step(stiffest), work=method.integrates_work)
        origin = Origin(self.time, self.phase, self.completed, self.work.copy())
        while self.completed < origin.completed + phase.cycles:
            clock = time.perf_counter()
            first = self.compile_seconds == 0.0
            now, record, count = advance(method, control, system, now, np.asarray(phase.cycles), BATCH)
            loop = first_rows(record, int(count))
            if first:
                self.compile_seconds = time.perf_counter() - clock
            self._go_on(frame, now, origin)
            if loop.h.size:
                in_parts = loop.inside is not None
                yield self._in_parts(frame, system, loop, origin) if in_parts else frame.steps(loop, origin)
            self.judge(int(now.status), int(now.culprit))

    def _in_parts(self, frame: "Frame", system: System, loop: LoopStep, origin: "Origin") -> Steps:
        """Steps of a method that leaves its energies to its dense output."""
        parts = short_steps(system, loop, self.solver.rtol, energies=True)
        steps = frame.steps(parts, replace(origin, work=self.work))
        self.work = np.concatenate([[steps.input[-1], steps.damping[-1]], steps.friction[-1]])
        return steps

    def _go_on(self, frame: "Frame", now: Trajectory, origin: "Origin") -> None:
        """Take up the present state of the loop."""
        now = jax.tree.map(np.asarray, now)
        here = frame.start(now.point, now.state, origin.phase + float(now.time))
        self.displacement, self.velocity = here.displacement, here.velocity
        self.slip, self.state, self.phase = here.slip, here.state, here.phase
        self.completed = origin.completed + int(now.cycle)
        self.time = origin.time + float(PERIOD * now.cycle + now.time) / frame.scales.omega
        if now.point.work is not None:
            self.work = frame.work(now.point.work, origin.work)

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
        displacement, state = self._modal(q), self._states(np.asarray(state))
        # Of a contact along a line, or proven to be apart, the loop does not know all of the motion that w follows.
        loads = contact_loads(self.model, displacement, self._slip(w, self.model.start.slip))
        follows = slip_follows_motion(state, self.model.friction)[:, None]
        slip = np.where(follows, loads.motion, loads.slip)
        return Start(displacement, self._modal(p, self.scales.omega), slip, state, phase)

    def _modal(self, x: np.ndarray, unit: float = 1.0) -> np.ndarray:
        whole = np.zeros((*x.shape[:-1], self.model.structure.num_modes))
        modes = self.reduction.modes
        whole[..., modes] = x * (self.scales.mode[modes] * unit)
        return whole

    def _slip(self, w: Sequence[np.ndarray], fill: np.ndarray, unit: float = 1.0) -> np.ndarray:
        whole = np.broadcast_to(fill, (*w[0].shape[:-1], self.model.num_contacts, 2)).copy()
        for side in (0, 1):  # numpy's einsum takes six times as long over so few components
            own = sum(self.axes[:, side, x] * part for x, part in enumerate(w))
            whole[..., self.reduction.live, side] = own * (self.scales.length * unit)
        return whole

    def _states(self, state: np.ndarray) -> np.ndarray:
        whole = np.full((*state.shape[:-1], self.model.num_contacts), STICK)
        whole[..., self.reduction.apart] = SEPARATION
        whole[..., self.reduction.live] = state
        return whole

    def steps(self, loop: LoopStep, origin: Origin) -> Steps:
        """Steps of the loop in the units of the scene."""
        omega = self.scales.omega
        ends = [
            (self._modal(y.q), self._modal(y.p, omega), self._modal(dy.p, omega**2))
            for y, dy in ((loop.start, loop.start_rate), (loop.end, loop.end_rate))
        ]
        none = np.zeros((self.model.num_contacts, 2))
        slips = [
            (self._slip(y.w, self.model.start.slip), self._slip(dy.w, none, omega))
            for y, dy in ((loop.start, loop.start_rate), (loop.end, loop.end_rate))
        ]
        done = self.work(loop.end.work, origin.work)
        return Steps(
            cycle=loop.cycle + origin.completed,
            time=origin.time + (PERIOD * loop.cycle + loop.time) / omega,
            h=loop.h / omega,
            start=ends[0],
            end=ends[1],
            slip_start=slips[0],
            slip_end=slips[1],
            state=self._states(loop.state),
            state_after=self._states(loop.state_after),
            input=done[..., 0],
            damping=done[..., 1],
            friction=done[..., 2:],
        )

    def work(self, done: Work, before: np.ndarray) -> np.ndarray:
        """Energies put in, lost in modal damping and lost in each contact, shape (..., 2 + C), after those before."""
        friction = np.zeros((*np.shape(done.input), self.model.num_contacts))
        friction[..., self.reduction.live] = done.friction
        modal = np.stack([np.asarray(done.input), np.asarray(done.damping)], axis=-1)
        return before + np.concatenate([modal, friction], axis=-1) * self.scales.energy


def first_rows(record: LoopStep, count: int) -> LoopStep:
    """The filled part of a record, on the host."""
    return jax.tree.map(lambda rows: np.asarray(rows)[:count], record)
