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

from timesim.engine.event_loop import Batch, Reached, batches, begun
from timesim.engine.exponential.extremes import extremes
from timesim.engine.exponential.linear import linear_batches, linear_leap
from timesim.engine.exponential.parts import short_steps
from timesim.engine.law.table import begin_of
from timesim.engine.method import Method, step_method
from timesim.engine.solver import step_control
from timesim.engine.status import RunError, Status, message_of
from timesim.engine.step import PERIOD, Trajectory
from timesim.engine.step import Step as LoopStep
from timesim.engine.system import Point, System, Work, contact_axes, held_force, system_of, widened
from timesim.model.contact_state import contact_loads, slip_follows_motion
from timesim.model.model import SEPARATION, STICK, Model, Start
from timesim.model.reduction import Reduction, reduction_of
from timesim.model.scales import Scales, scales_of
from timesim.model.solver import CLOSED_FORM, Solver

ROUNDED = 8 * np.finfo(float).eps  # of a frequency, of the highest where they are found from those of others


@dataclass(frozen=True)
class Phase:
    """A number of cycles at one frequency [Hz]."""

    frequency: float
    cycles: int


@dataclass
class Run:
    """A trajectory under way; iterate over `batches` to advance it.

    Attributes:
        phases: the schedule; the phase of the excitation is continuous across its changes.
        method: what takes the steps, by default that of the solver.
        displacement, velocity, slip, state: the present state, in the units of the scene.
        phase: present phase of the excitation [rad].
        time: time since the start [s].
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
        if self.closed and self.reduction.live.size:
            raise ValueError("contacts that may leave their state have no motion in closed form")
        start = begin_of(self.model)
        self.displacement, self.velocity = start.displacement.copy(), start.velocity.copy()
        self.slip, self.state = start.slip.copy(), start.state
        self.phase, self.time, self.completed = start.phase, 0.0, 0
        self.status = Status.RUNNING
        self.compile_seconds = 0.0
        self.work = np.zeros(2 + self.model.num_contacts)

    @property
    def num_cycles(self) -> int:
        """Cycles of the whole schedule."""
        return sum(phase.cycles for phase in self.phases)

    @property
    def closed(self) -> bool:
        """Whether it is known in closed form."""
        return self.solver.name == CLOSED_FORM

    @property
    def here(self) -> Start:
        """The present state."""
        return Start(self.displacement, self.velocity, self.slip, self.state, self.phase)

    def batches(self) -> "Iterator[Steps]":
        """Advance through the schedule, a batch of steps at a time.

        Raises:
            RunError: the loop ended early; what was yielded before is valid.
        """
        for phase in self.phases:
            yield from self._through(phase)

    def _through(self, phase: Phase) -> "Iterator[Steps]":
        frame, system, origin = self._at(phase)
        start = frame.point(self.here)[0].q
        batches, clock = self._batches(frame, system, phase.cycles), time.perf_counter()
        for loop, done, now in batches:
            if self.compile_seconds == 0.0 and not self.closed:
                self.compile_seconds = time.perf_counter() - clock
            # An interrupt among these finds the run where its last steps have ended.
            work = frame.work(done, origin.work, loop.end.q - start) if loop.h.size else None
            self._go_on(frame, now, origin)
            if work is not None:
                self.work = work[-1]
                yield Steps(frame, system, loop, origin, work, self.solver.rtol)
            self.judge(int(now.status), int(now.culprit))

    def _at(self, phase: Phase) -> "tuple[Frame, System, Origin]":
        """Frame, system and origin of the present state, at the start of a phase."""
        frame = Frame(self.model, self.reduction, phase.frequency)
        system = system_of(self.model, phase.frequency, self.phase, self.reduction)
        return frame, system, Origin(self.time, self.phase, self.completed, self.work.copy())

    def leap(self, *, rounded: bool = False) -> None:
        """Go to the end of the schedule at once, of a run in closed form, without the energies.

        ``rounded``: with natural frequencies that are off by as much as rounding may have changed them.
        """
        for phase in self.phases:
            frame, system, origin = self._at(phase)
            omega = np.sqrt(system.stiffness)
            doubt = ROUNDED * rounded * (omega.max() if self.reduction.stuck.size else omega)
            system = replace(system, stiffness=(omega + doubt) ** 2)
            self._go_on(frame, linear_leap(system, frame.point(self.here)[0], phase.cycles), origin)

    def _batches(self, frame: "Frame", system: System, cycles: int) -> Iterator[Batch]:
        """Steps through some cycles from the present state."""
        if self.closed:
            return linear_batches(system, frame.point(self.here)[0], cycles, self.solver)
        stiffest = self.model.stuck_rate / frame.scales.omega
        system, control = jax.device_put((system, step_control(self.solver, stiffest)))
        now = frame.begin(system, self, self.solver.first_step(stiffest), work=not self.method.collocates)
        return batches(self.method, control, system, now, cycles)

    def _go_on(self, frame: "Frame", now: Reached, origin: "Origin") -> None:
        """Take up the present state of the loop."""
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
        self.status = Status(status)
        if self.status == Status.RUNNING:
            return
        message = message_of(self.model, self.reduction, self.solver, status, culprit)
        raise RunError(f"at time {self.time:.9g} s, in cycle {self.completed + 1}: {message}")


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
        self.turn, self.held = reduction.natural[1], widened(held_force(reduction, self.scales), reduction)

    def begin(self, system: System, run: Run, first_step: float, *, work: bool = True) -> Trajectory:
        """The loop's trajectory from the present state of a run, with or without its energies."""
        point, state = self.point(run.here)
        nothing = Work.none(state.size) if work else None
        return begun(system, Point(point.q, point.p, point.w, nothing), state, np.asarray(first_step))

    def point(self, start: Start) -> tuple[Point, np.ndarray]:
        """The loop's continuous state and contact states (C,) of a start whose contact states are known."""
        scales, modes, live = self.scales, self.reduction.modes, self.reduction.live
        q = start.displacement[modes] / scales.mode[modes]
        p = start.velocity[modes] / (scales.mode[modes] * scales.omega)
        q, p = (q, p) if self.turn is None else (q @ self.turn, p @ self.turn)
        w = np.einsum("cax,ca->xc", self.axes, start.slip[live]) / scales.length
        return Point(widened(q, self.reduction), widened(p, self.reduction), tuple(w), None), start.state[live]

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
        """Displacements in the units of the scene for unit dimensionless modal displacements of a system, (3P, M)."""
        structure, modes = self.model.structure, self.reduction.modes
        shape = structure.shape.reshape(-1, structure.num_modes)[:, modes] * self.scales.mode[modes]
        return widened(shape if self.turn is None else shape @ self.turn, self.reduction)

    def modal(self, x: np.ndarray, unit: float = 1.0) -> np.ndarray:
        """Modal displacements of the scene, or rates of them where a unit of time is given."""
        modes, num = self.reduction.modes, self.model.structure.num_modes
        x = x[..., : modes.size]
        own = (x if self.turn is None else x @ self.turn.T) * (self.scales.mode[modes] * unit)
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

    def work(self, done: Work, before: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Energies put in, lost in modal damping and lost in each contact, shape (..., 2 + C), after those before.

        ``moved``: displacement of the modes since the start of the phase. What contacts that are left out do along it
        is stored in them, not put in.
        """
        friction = self.reduction.of_all(np.asarray(done.friction))
        modal = np.stack([np.asarray(done.input) - moved @ self.held, np.asarray(done.damping)], axis=-1)
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

        ``first`` as of `timesim.engine.dense_output.extremes`.
        """
        return extremes(self.system, self.loop, self.frame.shape, first, self.rtol)

    def between(self, start: float, end: float) -> "Steps":
        """The steps from one time to another, so short that the polynomials through their ends are the motion."""
        first, last = np.searchsorted(self.time, [start, end], side="right") - 1
        rows = slice(max(first, 0), max(last, 0) + 1)
        loop = short_steps(self.system, jax.tree.map(lambda leaf: leaf[rows], self.loop), self.rtol)
        return replace(self, loop=loop)
