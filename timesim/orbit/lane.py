"""Lanes of a batch: trajectories of scenes at the start of a cycle, and recorded cycles of them."""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import jax
import numpy as np

from timesim.engine.history import between
from timesim.engine.law.cone import ConeLaw
from timesim.engine.quadrature import means
from timesim.engine.solver import Control, step_control
from timesim.engine.step import Status, Step, Trajectory
from timesim.engine.system import Point, System, system_of
from timesim.engine.trajectory import Frame
from timesim.model.contact_state import contact_state, slip_follows_motion
from timesim.model.model import SEPARATION, SLIP, STICK, Model, Start
from timesim.model.reduction import Reduction
from timesim.model.solver import Solver
from timesim.orbit.fourier import HARMONICS
from timesim.orbit.monodromy import HybridState, Tries, point_of, vector_of
from timesim.orbit.steady_state import Orbit, share


@dataclass(frozen=True)
class Lane:
    """A trajectory at the start of a cycle.

    Attributes:
        model, reduction, frequency: the scene, reduced, at a frequency [Hz].
        frame: converts between the units of the scene and the dimensionless form.
        system, control: dimensionless equations and step control.
        here: dimensionless state.
        phase: of the excitation at the start of a cycle [rad].
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
    status: int = Status.RUNNING
    culprit: int = 0

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
        return replace(self, here=here, status=int(now.status), culprit=int(now.culprit))

    def at_start(self) -> Trajectory:
        """The trajectory for `record_cycles`; its rate is a placeholder."""
        zero, one, none = np.zeros(()), np.ones(()), np.zeros((), dtype=np.int64)
        return Trajectory(
            cycle=none, time=zero, point=self.here.point, rate=self.here.point, state=self.here.state,
            length=self.control.opening, limit=np.asarray(np.inf), last_error=one, since=one, repeats=none, tried=none,
            status=none, culprit=none,
        )  # fmt: skip

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of the arrays given to the loop; all lanes of a batch have the same."""
        return tuple(np.shape(leaf) for leaf in jax.tree.leaves((self.control, self.system)))

    @property
    def shape(self) -> np.ndarray:
        """Displacements in the units of the scene for unit dimensionless modal displacements, shape (3P, M)."""
        structure, modes = self.model.structure, self.reduction.modes
        return structure.shape.reshape(-1, structure.num_modes)[:, modes] * self.frame.scales.mode[modes]

    @property
    def apart(self) -> np.ndarray:
        """Entries of the state vector that belong to separated contacts."""
        point, state = self.here.point, self.here.state
        quiet = np.zeros(2 * point.q.size, dtype=bool)
        return np.concatenate([quiet, np.tile(state == SEPARATION, len(point.w))])

    @property
    def vector(self) -> np.ndarray:
        """(q, q', w) as one vector; w of a separated contact, which is u, counts as 0."""
        return np.where(self.apart, 0.0, vector_of(self.here.point, np))

    def start(self) -> Start:
        """The state in the units of the scene."""
        return self.frame.start(self.here.point, self.here.state, self.phase)

    def power(self, power: np.ndarray) -> np.ndarray:
        """Power of each contact in the units of the scene, from that of the contacts in the loop, shape (C,)."""
        whole = np.zeros(self.model.num_contacts)
        whole[self.reduction.live] = power * self.frame.scales.energy * self.frame.scales.omega
        return whole

    def moved(self, vector: np.ndarray) -> "Lane | None":
        """The lane at another state vector, contact states kept; None where these or the law do not allow it."""
        point, state, law = point_of(vector, self.here.point), self.here.state, self.system.law
        if not isinstance(law, ConeLaw):
            return None
        w = np.stack(point.w)
        u = np.stack([axis @ point.q for axis in self.system.shape[:-1]]) if state.size else w
        n = law.preload + law.normal_stiffness * (self.system.shape[-1] @ point.q)
        force = np.stack([law.stiffness[i % len(law.stiffness)] * row for i, row in enumerate(u - w)])
        size, limit = np.linalg.norm(force, axis=0), law.friction * n
        follows = slip_follows_motion(state, law.friction)
        slips = (state == SLIP) & ~follows
        outside = ((state == STICK) & (size > limit)) | (slips & (size <= 0))
        if outside.any() or not np.array_equal(contact_state(n, law.friction, state), state):
            return None
        on_cone = force * np.where(slips, limit / np.where(size > 0, size, 1.0), 1.0)
        kept = np.stack([law.compliance[i % len(law.compliance)] * row for i, row in enumerate(on_cone)])
        w = np.where(follows, u, np.where(slips, u - kept, w))
        return replace(self, here=HybridState(Point(point.q, point.p, tuple(w), None), state))


@dataclass(frozen=True)
class Recorded:
    """Some cycles of a lane.

    Attributes:
        start, end: the lane at both ends.
        cycles: how many.
        complete: whether all of them were done.
        tries: of the whole batch, one entry a call of the loop.
        index: of the lane in the batch.
        slope: derivative of the state vector at the end by that at the start.
    """

    start: Lane
    end: Lane
    cycles: int
    complete: bool
    tries: Sequence[Tries]
    index: int
    slope: np.ndarray

    @property
    def steps(self) -> Step:
        """The steps of the lane, the first axis that of the steps."""
        taken = [part.accepted[:, self.index] for part in self.tries]

        def joined(*parts: np.ndarray) -> np.ndarray:
            return np.concatenate([rows[own, ..., self.index] for rows, own in zip(parts, taken, strict=True)])

        steps: Step = jax.tree.map(joined, *(part.step for part in self.tries))
        return steps

    @property
    def multipliers(self) -> np.ndarray:
        """Floquet multipliers, largest first, without those of free offsets."""
        moves = self._moves
        values = np.linalg.eigvals(self.slope[np.ix_(moves, moves)])
        return np.asarray(values[np.argsort(-np.abs(values))])

    @property
    def _moves(self) -> np.ndarray:
        """Which entries of the state vector change over the cycles: all but the offsets of stuck contacts."""
        return ~np.all(self.slope == np.eye(len(self.slope)), axis=1)

    def newton_step(self) -> np.ndarray:
        """Newton step from the start towards the fixed point of the map over the cycles; 0 in free offsets."""
        moves, change = self._moves, self.end.vector - self.start.vector
        step = np.zeros_like(change)
        matrix = np.eye(int(moves.sum())) - self.slope[np.ix_(moves, moves)]
        step[moves] = np.linalg.lstsq(matrix, change[moves], rcond=1e-12)[0]
        return step

    def orbit(self, cycles: int, period: int) -> Orbit:
        """The steady state that these cycles show, amplitudes from the extremes of the dense output.

        Args:
            cycles: integrated until their end.
            period: of the motion; 0 where it has not settled.
        """
        lane, steps, multipliers = self.start, self.steps, self.multipliers
        shape = lane.shape
        ends = ((steps.start, steps.start_rate), (steps.end, steps.end_rate))
        start, end = ([part @ shape.T for part in (y.q, y.p, dy.p)] for y, dy in ends)
        low, high = between(np.broadcast_to(steps.h[:, None], start[0].shape), start, end)
        first = np.searchsorted(steps.cycle, np.arange(self.cycles))
        least, most = np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)
        each, place = 0.5 * (most - least), (len(lane.model.structure.points), 3)
        band = np.stack([each.min(axis=0), each.max(axis=0)]).reshape(2, *place)
        phasor, power = means(lane.system, steps, self.cycles, HARMONICS)
        return Orbit(
            end=self.end.start(),
            amplitude=0.5 * (most.max(axis=0) - least.min(axis=0)).reshape(place),
            band=band,
            cycles=cycles,
            period=period,
            slip_share=self._share(steps, SLIP),
            separation_share=self._share(steps, SEPARATION),
            phasor=(phasor @ shape.T).reshape(-1, *place) if period else np.full((HARMONICS + 1, *place), np.nan + 0j),
            dissipated_power=lane.power(power),
            floquet=multipliers if period else np.full_like(multipliers, np.nan),
        )

    def _share(self, steps: Step, state: int) -> np.ndarray:
        lane = self.start
        shares = np.zeros(lane.model.num_contacts)
        shares[lane.reduction.live] = share(steps.h, steps.state == state)
        shares[lane.reduction.apart] = float(state == SEPARATION)
        return shares
