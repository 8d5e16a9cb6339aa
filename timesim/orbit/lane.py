"""Lanes: trajectories of scenes at the start of a cycle, and recorded cycles of them."""

from timesim.runtime import with_parts  # isort: skip

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.linalg import null_space, orth

from timesim.engine.exponential.extremes import extremes
from timesim.engine.exponential.parts import short_steps
from timesim.engine.law.contact_law import Motion
from timesim.engine.quadrature import phasors
from timesim.engine.solver import Control, step_control
from timesim.engine.status import NOBODY, Status
from timesim.engine.step import PERIOD, Step, Trajectory
from timesim.engine.system import Point, System, system_of
from timesim.engine.trajectory import Frame
from timesim.model.contact_state import obeys_cone
from timesim.model.model import SEPARATION, SLIP, Model, Start
from timesim.model.reduction import Reduction
from timesim.model.solver import Solver
from timesim.orbit.fourier import HARMONICS
from timesim.orbit.monodromy import HybridState, point_of, vector_of
from timesim.orbit.steady_state import Orbit, share
from timesim.orbit.threshold import UNSTABLE, VAGUE

ROUNDING = 1e-10  # of an entry of a unit vector


def largest(vector: np.ndarray) -> float:
    """Largest size of an entry; 0 if there is none."""
    return float(np.max(np.abs(vector), initial=0.0))


@dataclass(frozen=True)
class Lane:
    """A trajectory at the start of a cycle.

    Attributes:
        model, reduction, frequency: the scene, reduced, at a frequency [Hz].
        frame: converts between the units of the scene and the dimensionless form.
        system, control: dimensionless equations and step control.
        phase: of the excitation at the start of a cycle [rad].
        quiet: time since the last transition, or since the loop was called [rad of the excitation].
        status, culprit: as in `timesim.engine.step.Trajectory`.
    """

    model: Model
    reduction: Reduction
    frequency: float
    frame: Frame
    system: System
    control: Control
    here: HybridState
    phase: float
    quiet: float = 0.0
    status: int = Status.RUNNING
    culprit: int = NOBODY

    @classmethod
    def begin(cls, model: Model, reduction: Reduction, frequency: float, solver: Solver, start: Start) -> Self:
        """A lane at a frequency [Hz] from a start whose contact states are known."""
        frame = Frame(model, reduction, frequency)
        system = system_of(model, frequency, start.phase, reduction)
        control = step_control(solver, model.stuck_rate / frame.scales.omega)
        here = HybridState(*frame.point(start))
        return cls(model, reduction, frequency, frame, system, control, here, start.phase)

    def at(self, frequency: float, start: Start, solver: Solver) -> Self:
        """The same scene at another frequency, from another start."""
        return self.begin(self.model, self.reduction, frequency, solver, start)

    def after(self, now: Trajectory) -> Self:
        """The lane at the end of a loop."""
        here = HybridState(now.point, now.state)
        return replace(self, here=here, quiet=float(now.since), status=int(now.status), culprit=int(now.culprit))

    def within(self, rtol: float) -> Self:
        """The lane with another tolerance of a step."""
        control, share = self.control, rtol / float(self.control.rtol)
        finer = {"rtol": np.asarray(rtol), "atol": np.asarray(control.atol * share)}
        return replace(self, control=replace(control, **finer))

    @cached_property
    def apart(self) -> np.ndarray:
        """Entries of the state vector that belong to separated contacts."""
        point, state = self.here.point, self.here.state
        quiet = np.zeros(2 * point.q.size, dtype=bool)
        return np.concatenate([quiet, np.tile(state == SEPARATION, len(point.w))])

    @cached_property
    def idle(self) -> np.ndarray:
        """Entries of the state vector that are of no mode of the model, see `timesim.engine.system.room_of`."""
        room, num = self.here.point.q.size, self.reduction.modes.size
        return np.flatnonzero(np.tile(np.arange(room) >= num, 2))

    @cached_property
    def vector(self) -> np.ndarray:
        """(q, q', w) as one vector; w of a separated contact, which is u, counts as 0."""
        return np.where(self.apart, 0.0, vector_of(self.here.point, np))

    @cached_property
    def size(self) -> float:
        """Largest entry of the state vector, wherever a body that nothing holds has come."""
        vector, shifts = self.vector, self.shifts
        return max(largest(vector - vector @ shifts.T @ shifts), 1e-300)

    @cached_property
    def shifts(self) -> np.ndarray:
        """Changes of the state vector that alter no force: orthonormal rows, shape (shifts, state).

        A body that nothing holds is moved along the surfaces of all contacts, and with it the places where they stick;
        of other laws than the cone only relative motion counts.
        """
        free = np.flatnonzero(self.system.stiffness == 0)
        if not free.size:
            return np.zeros((0, self.vector.size))
        (*along, across), size = self.system.shape, self.here.point.q.size
        live = self.reduction.live
        other = ~obeys_cone(self.model)[live]
        presses = other | (self.model.normal_stiffness[live] > 0)
        held = np.concatenate([across[presses], *(axis[other] for axis in along)])
        q = np.eye(size)[:, free] @ null_space(held[:, free])
        vectors = np.concatenate([q, np.zeros_like(q), *(axis @ q for axis in along)])
        return np.asarray(orth(np.where(self.apart[:, None], 0.0, vectors)).T)

    def start(self) -> Start:
        """The state in the units of the scene."""
        return self.frame.start(self.here.point, self.here.state, self.phase)

    def moved(self, vector: np.ndarray) -> "Lane | None":
        """The lane at another state vector; None where a contact would not be in its state there, see `placed`."""
        point, (*along, across) = point_of(vector, self.here.point), self.system.shape
        u, du = (tuple(axis @ x for axis in along) for x in (point.q, point.p))
        motion = Motion(u, across @ point.q, du, across @ point.p)
        placed = self.system.law.placed(self.here.state, motion, point.w)
        if placed is None:
            return None
        state, w = placed
        return replace(self, here=HybridState(Point(point.q, point.p, w, None), state))


@dataclass(frozen=True)
class Recorded:
    """Some cycles of a lane.

    Attributes:
        start, end: the lane at both ends.
        cycles: how many.
        steps: of which they are made up, numpy arrays, the first axis that of the steps.
        slope: derivative of the state vector at the end by that at the start, of idle modes as if they stayed where
            they are; it may overflow.
        lost: energy lost in each contact of the loop, as a transient counts it, shape (C,).
    """

    start: Lane
    end: Lane
    cycles: int
    complete: bool
    steps: Step
    slope: np.ndarray
    lost: np.ndarray

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Floquet multipliers, largest first, without those of free offsets and of the place of a body that slides.

        NaN where the derivative is not finite.
        """
        if not np.isfinite(self.slope).all():
            return np.full(self.disturbances.shape[1], np.nan)
        values = np.linalg.eigvals(self.slope_of_disturbances)
        return np.asarray(values[np.argsort(-np.abs(values))])

    @property
    def is_unstable(self) -> bool:
        """Whether a disturbance grows over the cycles."""
        return largest(self.multipliers) > UNSTABLE

    @cached_property
    def disturbances(self) -> np.ndarray:
        """Disturbances but those of free offsets and of the place of a body that slides, as columns."""
        moved = np.eye(len(self.slope))[:, self._moves]
        return moved @ null_space(self._along) if len(self._along) else moved

    @property
    def slope_of_disturbances(self) -> np.ndarray:
        """The derivative, as a map of the parts of disturbances."""
        return np.asarray(self.disturbances.T @ self.slope @ self.disturbances)

    @cached_property
    def _moves(self) -> np.ndarray:
        """Which entries of the state vector change over the cycles: all but free offsets and idle modes."""
        return ~np.all(self.slope == np.eye(len(self.slope)), axis=1)

    @cached_property
    def change(self) -> np.ndarray:
        """Change of the state vector over the cycles."""
        return self.end.vector - self.start.vector

    @cached_property
    def returns(self) -> np.ndarray:
        """Modal displacement, without the drift, and velocity at the end of each cycle, shape (cycles, 2 M)."""
        steps = self._seen_along(self.steps, self._rate)
        last = np.searchsorted(steps.cycle, np.arange(self.cycles), side="right") - 1
        return np.concatenate([steps.end.q[last], steps.end.p[last]], axis=1)

    @property
    def closes(self) -> bool:
        """Whether all cycles were done, the contacts that began apart are so again, and the derivative is finite."""
        same = np.array_equal(self.end.apart, self.start.apart)
        return self.complete and same and bool(np.isfinite(self.slope).all())

    @property
    def is_held(self) -> bool:
        """Whether all cycles were done and no contact ever left its state."""
        return self.complete and bool(np.all(self.steps.state_after == self.start.here.state))

    @property
    def left(self) -> float:
        """Distance from the state that repeats over the cycles, relative to the largest entry; 0 where none closes."""
        return largest(self.newton_step(self.change)) / self.start.size if self.closes else 0.0

    def newton_step(self, change: np.ndarray) -> np.ndarray:
        """The step after which a change over the cycles vanishes to first order, but for drift; 0 in free offsets."""
        moves, along = self._moves, self._along
        step, num, none = np.zeros_like(change), int(moves.sum()), np.zeros((len(along), len(along)))
        matrix = np.eye(num) - self.slope[np.ix_(moves, moves)]
        matrix = np.block([[matrix, along.T], [along, none]]) if len(along) else matrix
        step[moves] = np.linalg.lstsq(matrix, np.pad(change[moves], (0, len(along))), rcond=1e-12)[0][:num]
        return step

    @cached_property
    def _along(self) -> np.ndarray:
        """What `Lane.shifts` are of the entries that change over the cycles: a contact that sticks holds a body."""
        moves, shifts = self._moves, self.start.shifts
        if not len(shifts):
            return shifts[:, moves]
        held = np.where(np.abs(shifts[:, ~moves]) > ROUNDING, shifts[:, ~moves], 0.0)
        return np.asarray(null_space(held.T).T @ shifts[:, moves])

    @cached_property
    def drift(self) -> np.ndarray:
        """The part of the change over the cycles that alters no force, if it is not negligible: a body slides on."""
        along = self.start.shifts.T @ (self.start.shifts @ self.change)
        return along if largest(along) > self._negligible else np.zeros_like(along)

    @property
    def strays(self) -> bool:
        """Whether another change is left, as of a body that nothing holds and that is ever faster."""
        return largest(self.change - self.drift) > self._negligible

    @cached_property
    def _rate(self) -> np.ndarray:
        """Velocity of the modes by which they drift, shape (M,)."""
        return self.drift[: self.start.here.point.q.size] / (PERIOD * self.cycles)

    def _seen_along(self, steps: Step, rate: np.ndarray) -> Step:
        """Steps as seen by one who moves along from the body's place; of these what they are inside is not kept.

        ``rate``: velocity of the modes by which they drift, shape (M,); where it is zero they stay as they are.
        """
        if not rate.any():
            return steps
        shifts, since = self.start.shifts, PERIOD * steps.cycle + steps.time
        place = (shifts.T @ (shifts @ self.start.vector))[: rate.size]
        start, end = (
            with_parts(y, q=y.q - place - np.outer(t, rate), p=y.p - rate)
            for y, t in ((steps.start, since), (steps.end, since + steps.h))
        )
        return with_parts(steps, start=start, end=end, inside=None)

    @cached_property
    def _negligible(self) -> float:
        """Change that does not count beside the motion within the cycles; a body may have come far."""
        return float(VAGUE * np.ptp(np.stack([self.steps.end.q, self.steps.end.p]), axis=1).max(initial=0.0))

    def orbit(self, cycles: int, period: int, settled_to: float, *, irregular: bool = False) -> Orbit:
        """The steady state that these cycles show, amplitudes from the extremes of the dense output.

        A body that slides on is seen by one who moves on with it. Arguments as the attributes of `Orbit`.
        """
        lane, multipliers = self.start, self.multipliers
        power = self.lost / (PERIOD * self.cycles) * lane.frame.scales.energy * lane.frame.scales.omega
        switches = np.count_nonzero(self.steps.state_after != self.steps.state, axis=0)
        rtol, shape, rate = float(lane.control.rtol), lane.frame.shape, self._rate if period else 0 * self._rate
        steps = self._seen_along(short_steps(lane.system, self.steps, rtol), rate)
        whole = steps if rate.any() else self.steps
        first = np.searchsorted(whole.cycle, np.arange(self.cycles))
        least, most = extremes(lane.system, whole, shape, first, rtol)
        each, place = 0.5 * (most - least), (len(lane.model.structure.points), 3)
        band = np.stack([each.min(axis=0), each.max(axis=0)]).reshape(2, *place)
        phasor = phasors(lane.system, steps, self.cycles, HARMONICS)
        return Orbit(
            end=self.end.start(),
            amplitude=0.5 * (most.max(axis=0) - least.min(axis=0)).reshape(place),
            band=band,
            cycles=cycles,
            period=period,
            slip_share=self._share(steps, SLIP),
            separation_share=self._share(steps, SEPARATION),
            phasor=(phasor @ shape.T).reshape(-1, *place) if period else np.full((HARMONICS + 1, *place), np.nan + 0j),
            dissipated_power=lane.reduction.of_all(power),
            floquet=multipliers if period else np.full_like(multipliers, np.nan),
            cycle_steps=self.steps.h.size / self.cycles,
            cycle_transitions=lane.reduction.of_all(switches) / self.cycles,
            settled_to=settled_to,
            irregular=irregular,
            drift=PERIOD * (shape @ rate).reshape(place),
        )

    def _share(self, steps: Step, state: int) -> np.ndarray:
        reduction = self.start.reduction
        shares = reduction.of_all(share(steps.h, steps.state == state))
        shares[reduction.apart] = float(state == SEPARATION)
        return shares
