"""Lanes of a batch in the units of their scenes: marched through cycles, or recorded over a period and measured."""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import jax
import numpy as np

from timesim.engine.event_loop import Control, Status, Step
from timesim.engine.history import between
from timesim.engine.solver import step_control, step_method
from timesim.engine.system import Point, System, system_of
from timesim.engine.trajectory import Frame
from timesim.model.model import SEPARATION, SLIP, STICK, Model, Start
from timesim.model.reduction import Reduction
from timesim.model.solver import Solver
from timesim.orbit.batch import Place, at_start, march_cycles, record_cycles
from timesim.orbit.monodromy import derivative
from timesim.orbit.share import share

SIZES = (4, 16)  # of a batch: few, so that little is compiled
CAPACITY = 256  # tries of a record


@dataclass(frozen=True)
class Told:
    """What the loop is told of a lane: the leaves of its control and system, as arrays.

    Modules of JAX take their time to be built and taken apart; a sweep has thousands of lanes.
    """

    leaves: tuple[np.ndarray, ...]
    structure: Any

    @classmethod
    def of(cls, control: Control, system: System) -> Self:
        """Taken apart."""
        leaves, structure = jax.tree.flatten((control, system))
        return cls(tuple(map(np.asarray, leaves)), structure)

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of all of it: lanes of one batch agree in them."""
        return tuple(leaf.shape for leaf in self.leaves)


@dataclass(frozen=True)
class Lane:
    """A trajectory at the start of a cycle.

    Attributes:
        model, reduction, frequency: what is simulated, at which frequency [Hz].
        frame: between the units of the scene and the dimensionless form.
        system: what is integrated.
        told: the same and the control, as the loop gets them.
        q, p, w, state: where the trajectory is, dimensionless; w by components.
        phase: of the excitation at the start of a cycle [rad].
        status, culprit: as in `timesim.engine.event_loop.Trajectory`.
    """

    model: Model
    reduction: Reduction
    frequency: float
    frame: Frame
    system: System
    told: Told
    q: np.ndarray
    p: np.ndarray
    w: tuple[np.ndarray, ...]
    state: np.ndarray
    phase: float
    status: int = Status.RUNNING
    culprit: int = 0

    @classmethod
    def begin(cls, model: Model, reduction: Reduction, frequency: float, solver: Solver, start: Start) -> Self:
        """A lane at a frequency [Hz] from a start whose contact states are known."""
        frame = Frame(model, reduction, frequency)
        system = system_of(model, frequency, start.phase, reduction)
        told = Told.of(step_control(solver, model.stuck_rate / frame.scales.omega), system)
        point, state = frame.point(start)
        w = tuple(map(np.asarray, point.w))
        return cls(
            model, reduction, frequency, frame, system, told, np.asarray(point.q), np.asarray(point.p), w, state,
            start.phase,
        )  # fmt: skip

    def at(self, frequency: float, start: Start, solver: Solver) -> Self:
        """The same scene at another frequency, from another start."""
        return self.begin(self.model, self.reduction, frequency, solver, start)

    @property
    def shape(self) -> np.ndarray:
        """Displacements in the units of the scene for a unit of each mode of the loop, shape (3P, M)."""
        structure, modes = self.model.structure, self.reduction.modes
        return structure.shape.reshape(-1, structure.num_modes)[:, modes] * self.frame.scales.mode[modes]

    @property
    def apart(self) -> np.ndarray:
        """Entries of `section` that belong to separated contacts."""
        quiet = np.zeros(2 * self.q.size, dtype=bool)
        return np.concatenate([quiet, np.tile(self.state == SEPARATION, len(self.w))])

    @property
    def section(self) -> np.ndarray:
        """(q, q', w) as one vector; w of a separated contact, which is u, counts as 0."""
        return np.where(self.apart, 0.0, np.concatenate([self.q, self.p, *self.w]))

    def start(self) -> Start:
        """The state in the units of the scene."""
        return self.frame.start(Point(self.q, self.p, self.w, None), self.state, self.phase)

    def moved(self, section: np.ndarray) -> "Lane | None":
        """The lane at another place in the same contact states; None if the place does not allow them."""
        size, contacts = self.q.size, self.state.size
        q, p, rest = section[:size], section[size : 2 * size], section[2 * size :]
        w = rest.reshape(len(self.w), contacts)
        law = self.system.law
        u = np.stack([axis @ q for axis in self.system.shape[:-1]]) if contacts else w
        n = law.preload + law.normal_stiffness * (self.system.shape[-1] @ q)
        force = np.stack([law.stiffness[i % len(law.stiffness)] * row for i, row in enumerate(u - w)])
        size_of, limit = np.linalg.norm(force, axis=0), law.friction * n
        stuck, slips = self.state == STICK, self.state == SLIP
        open_ = self.state == SEPARATION
        if np.any(open_ != (n <= 0)) or np.any(stuck & (size_of > limit)) or np.any(slips & (size_of <= 0)):
            return None
        on_cone = force * np.where(slips, limit / np.where(size_of > 0, size_of, 1.0), 1.0)
        kept = np.stack([law.compliance[i % len(law.compliance)] * row for i, row in enumerate(on_cone)])
        w = np.where(open_, u, np.where(slips, u - kept, w))
        return replace(self, q=q, p=p, w=tuple(w))


@dataclass(frozen=True)
class Measure:
    """What a lane does over some cycles.

    Attributes:
        amplitude: (max - min) / 2 of each point along x, y, z, shape (P, 3).
        band: smallest and largest amplitude of one cycle, shape (2, P, 3).
        slip_share, separation_share: share of the time in these states, shape (C,).
    """

    amplitude: np.ndarray
    band: np.ndarray
    slip_share: np.ndarray
    separation_share: np.ndarray


class Path(NamedTuple):
    """What is measured of the steps of a lane: cycle, length, states, and (q, q', q'') at both ends."""

    cycle: np.ndarray
    h: np.ndarray
    state: np.ndarray
    q0: np.ndarray
    p0: np.ndarray
    a0: np.ndarray
    q1: np.ndarray
    p1: np.ndarray
    a1: np.ndarray


PATH: dict[str, Callable[[Step], Any]] = {
    "cycle": lambda step: step.cycle,
    "h": lambda step: step.h,
    "state": lambda step: step.state,
    "q0": lambda step: step.start.q,
    "p0": lambda step: step.start.p,
    "a0": lambda step: step.start_rate.p,
    "q1": lambda step: step.end.q,
    "p1": lambda step: step.end.p,
    "a1": lambda step: step.end_rate.p,
}


@dataclass
class Tape:
    """Record of a batch, as the loop leaves it: tries first, batch last; taken to the host when somebody measures.

    Attributes:
        steps: a part for each time that the record was full.
        made: which tries became steps.
        counts: tries of each part.
    """

    steps: list[Step]
    made: list[Any]
    counts: list[int]

    def lane(self, index: int) -> Path:
        """The steps of one lane."""
        made = self._joined["made"][:, index]
        return Path(**{name: part[made, ..., index] for name, part in self._joined.items() if name != "made"})

    @cached_property
    def _joined(self) -> dict[str, np.ndarray]:
        def joined(pick: Callable[[Step], Any]) -> np.ndarray:
            parts = [np.asarray(pick(part))[:count] for part, count in zip(self.steps, self.counts, strict=True)]
            return np.concatenate(parts)

        flags = [np.asarray(part)[:count] for part, count in zip(self.made, self.counts, strict=True)]
        picked = {name: joined(pick) for name, pick in PATH.items()}
        return {"made": np.concatenate(flags)} | picked


@dataclass(frozen=True)
class Recorded:
    """Some cycles of a lane.

    Attributes:
        start, end: the lane at both ends.
        cycles: how many.
        complete: whether all of them were done.
        tape, index: what it did, step by step: its place in the record of its batch.
        slope: derivative of the state at the end, as `Lane.section`, by that at the start.
    """

    start: Lane
    end: Lane
    cycles: int
    complete: bool
    tape: Tape
    index: int
    slope: np.ndarray

    @property
    def multipliers(self) -> np.ndarray:
        """Floquet multipliers, largest first, those of offsets that nothing moves left out."""
        moves = self._moves
        found = np.linalg.eigvals(self.slope[np.ix_(moves, moves)])
        return np.asarray(found[np.argsort(-np.abs(found))])

    @property
    def _moves(self) -> np.ndarray:
        """Entries of the section but for the offsets of contacts that stick all along: these stay as they are."""
        return ~np.all(self.slope == np.eye(len(self.slope)), axis=1)

    def newton_step(self) -> np.ndarray:
        """From the start of the cycles towards the place that they lead back to; offsets that are free are left."""
        moves, change = self._moves, self.end.section - self.start.section
        step = np.zeros_like(change)
        matrix = np.eye(int(moves.sum())) - self.slope[np.ix_(moves, moves)]
        step[moves] = np.linalg.lstsq(matrix, change[moves], rcond=1e-12)[0]
        return step

    def measure(self) -> Measure:
        """Amplitudes, extremes found on the dense output, and shares of the states."""
        lane, steps = self.start, self.tape.lane(self.index)
        shape = lane.shape
        start = [part @ shape.T for part in (steps.q0, steps.p0, steps.a0)]
        end = [part @ shape.T for part in (steps.q1, steps.p1, steps.a1)]
        low, high = between(np.broadcast_to(steps.h[:, None], start[0].shape), start, end)
        first = np.searchsorted(steps.cycle, np.arange(self.cycles))
        least, most = np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)
        each, place = 0.5 * (most - least), (len(lane.model.structure.points), 3)
        band = np.stack([each.min(axis=0), each.max(axis=0)]).reshape(2, *place)
        amplitude = 0.5 * (most.max(axis=0) - least.min(axis=0)).reshape(place)
        return Measure(amplitude, band, _share(lane, steps, SLIP), _share(lane, steps, SEPARATION))


def _share(lane: Lane, steps: Path, state: int) -> np.ndarray:
    shares = np.zeros(lane.model.num_contacts)
    shares[lane.reduction.live] = share(steps.h, steps.state == state)
    shares[lane.reduction.apart] = float(state == SEPARATION)
    return shares


def _padded(lanes: Sequence[Lane], size: int) -> list[Lane]:
    """Lanes of a batch, the first repeated until it has its size."""
    return [*lanes, *([lanes[0]] * (size - len(lanes)))]


def _batches(lanes: Sequence[Lane], size: int) -> list[list[Lane]]:
    return [list(lanes[first : first + size]) for first in range(0, len(lanes), size)]


def _stacked(lanes: Sequence[Lane]) -> tuple[Control, System, Place]:
    leaves = [np.stack(rows) for rows in zip(*(lane.told.leaves for lane in lanes), strict=True)]
    control, system = jax.tree.unflatten(lanes[0].told.structure, leaves)
    first = lanes[0]
    alone = jax.tree.structure(Place(Point(first.q, first.p, first.w, None), first.state))
    rows = zip(*((lane.q, lane.p, *lane.w, lane.state) for lane in lanes), strict=True)
    return control, system, jax.tree.unflatten(alone, list(map(np.stack, rows)))


def _moved(lanes: Sequence[Lane], point: Point, state: Any, status: Any, culprit: Any) -> list[Lane]:
    """The lanes at other places, given batch first."""
    q, p, state, status, culprit = map(np.asarray, (point.q, point.p, state, status, culprit))
    w = tuple(map(np.asarray, point.w))
    return [
        replace(
            lane, q=q[i], p=p[i], w=tuple(x[i] for x in w), state=state[i], status=int(status[i]),
            culprit=int(culprit[i]),
        )
        for i, lane in enumerate(lanes)
    ]  # fmt: skip


def march(
    lanes: Sequence[Lane], solver: Solver, num_cycles: int, *, size: int = SIZES[1]
) -> list[tuple[Lane, np.ndarray]]:
    """March lanes by a number of cycles: each at the end, and its sections at the end of each cycle it completed.

    Args:
        lanes: any number.
        solver: method and tolerances.
        num_cycles: how many cycles.

    Keyword Args:
        size: of the batches.
    """
    done: list[tuple[Lane, np.ndarray]] = []
    for batch in _batches(lanes, size):
        ends = march_cycles(step_method(solver), *_stacked(_padded(batch, size)), num_cycles)
        sections, cycles = np.asarray(ends.sections), np.asarray(ends.cycles)
        moved = _moved(batch, ends.place.point, ends.place.state, ends.status, ends.culprit)
        done += [(lane, sections[i, : cycles[i]]) for i, lane in enumerate(moved)]
    return done


def record(
    lanes: Sequence[Lane], solver: Solver, num_cycles: int, most: int | None = None, *, size: int = SIZES[1]
) -> list[Recorded]:
    """March lanes by a number of cycles and keep their steps.

    Args:
        lanes: any number.
        solver: method and tolerances.
        num_cycles: how many cycles.
        most: tries after which to give up; the budget of the solver by default.

    Keyword Args:
        size: of the batches.
    """
    done: list[Recorded] = []
    for batch in _batches(lanes, size):
        done += _recorded(batch, solver, num_cycles, most, size)
    return done


def _recorded(batch: list[Lane], solver: Solver, num_cycles: int, most: int | None, size: int) -> list[Recorded]:
    method = step_method(solver)
    controls, systems, places = _stacked(_padded(batch, size))
    cycles = np.full(len(places.state), num_cycles)
    now = at_start(places, controls)
    tape, slopes = Tape([], [], []), None
    while sum(tape.counts) < (most or np.inf):
        now, steps, made, count = record_cycles(method, controls, systems, now, cycles, CAPACITY)
        slopes = derivative(method, systems, steps, made, count, slopes)
        tape.steps.append(steps)
        tape.made.append(made)
        tape.counts.append(int(count))
        if np.all((np.asarray(now.cycle) >= num_cycles) | (np.asarray(now.status) != Status.RUNNING)):
            break
    moved = _moved(batch, now.point, now.state, now.status, now.culprit)
    found = []
    for index, (lane, last, done) in enumerate(zip(batch, moved, np.asarray(now.cycle), strict=False)):
        slope = np.where(last.apart[:, None] | lane.apart, 0.0, np.asarray(slopes)[index])
        found.append(Recorded(lane, last, num_cycles, bool(done >= num_cycles), tape, index, slope))
    return found
