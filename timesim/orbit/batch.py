"""Trajectories through whole cycles: marched side by side, the state at each cycle's end kept, or recorded by itself.

A trajectory starts each cycle from its state alone (the step control forgets at a cycle's end), so its cycles do not
depend on its neighbours.
"""

from timesim.runtime import with_parts  # isort: skip

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, pairwise
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from timesim.engine.event_loop import advance, alone, begun, capacity, first_rows, one_by_one, unfinished
from timesim.engine.exponential.work import energy_lost
from timesim.engine.lanes import Over, advance_lanes, batch_first, batch_last, by_itself, over_lanes
from timesim.engine.method import Explicit, Method, step_method
from timesim.engine.solver import Control
from timesim.engine.step import Step, Trajectory, begin, try_step
from timesim.engine.system import System, Work
from timesim.model.solver import Solver
from timesim.orbit.lane import Lane, Recorded
from timesim.orbit.monodromy import LOST, MANY, Disturbed, HybridState, derivative, error_of, linear, state_vector
from timesim.program import program

SIDE_BY_SIDE = 4  # lanes of a batch: of 16 each takes as long; a batch that is not full is filled up
CAPACITY = 256  # steps of one call that records, at most
PIECE = 32  # most steps whose derivative is one piece of work: 16 of them take longer than to prepare them

Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]
"""Does the same work on each of several batches, in their order, as `map` does; threads may share them."""

ENDS = ("start", "start_rate", "end", "end_rate")
"""Entries of a step that are points."""
T = TypeVar("T", Trajectory, Step)

Problem = tuple[Control, System, Any]
"""Of one trajectory or of a batch: control, system, and where it goes on from."""


@program
def march_cycles(
    method: Method, controls: Control, systems: System, starts: HybridState, num_cycles: int
) -> tuple[Trajectory, Float[Array, "batch cycle state"]]:
    """March a batch by a number of cycles, all batch first.

    Returns the trajectories, and `state_vector` at the end of each cycle, 0 for cycles not reached.
    """
    problem = (controls, systems, starts)
    if one_by_one(method, systems, systems.phase.size):

        def march_one(lane: Problem) -> tuple[Trajectory, Array]:
            control, system, start = lane
            return _marched(method, (control, alone(method, control, system), start), num_cycles, by_itself)

        return jax.lax.map(march_one, problem)
    end, returns = _marched(method, batch_last(problem), num_cycles, over_lanes)
    return batch_first(end), jnp.moveaxis(returns, -1, 0)


def _marched(method: Method, problem: Problem, num_cycles: int, over: Over) -> tuple[Trajectory, Array]:
    """`march_cycles` with the batch last, or of one trajectory."""
    controls, systems, starts = problem
    now = over(begin)(systems, starts.point, starts.state, controls.opening)
    attempt = partial(over(partial(try_step, method)), controls, systems)
    vectors = over(lambda now: state_vector(now.point, now.state))
    row = jnp.arange(num_cycles).reshape(-1, *(1 for _ in now.cycle.shape))

    def keep(returns: Array, _: Array, before: Trajectory, after: Trajectory, *step: Any) -> Array:
        ended = (row == before.cycle) & (after.cycle > before.cycle)
        return jnp.where(ended[:, None], vectors(after), returns)

    returns = jnp.zeros((num_cycles, *vectors(now).shape))
    return advance_lanes(attempt, partial(unfinished, cycles=num_cycles), now, returns, keep)


def march_lanes(
    lanes: Sequence[Lane], solver: Solver, num_cycles: int, *, size: int = SIDE_BY_SIDE, each: Each = map
) -> list[tuple[Lane, np.ndarray]]:
    """March lanes by a number of cycles: each at the end, and its state vector at the end of each completed cycle."""

    def marched(batch: list[Lane]) -> list[tuple[Lane, np.ndarray]]:
        problem: Problem = _stacked([(lane.control, lane.system, lane.here) for lane in _padded(batch, size)])
        now, returns = _on_host(march_cycles(step_method(solver), *problem, num_cycles))
        return [(lane.after(_entry(now, i)), returns[i, : now.cycle[i]]) for i, lane in enumerate(batch)]

    return list(chain.from_iterable(each(marched, _batches(lanes, size))))


def record(
    lanes: Sequence[Lane], solver: Solver, num_cycles: Sequence[int], most: int | None = None, *, each: Each = map
) -> list[Recorded]:
    """March each lane by its number of cycles and keep its steps.

    ``most``: steps after which to give up; the budget of the solver by default.
    """
    ends = list(each(partial(_recorded, solver=solver, most=most), list(zip(lanes, num_cycles, strict=True))))
    slopes = _slopes(lanes, step_method(solver), [steps for _, steps, _ in ends], each)
    done = []
    for lane, num, (now, steps, lost), slope in zip(lanes, num_cycles, ends, slopes, strict=True):
        end = lane.after(now)
        slope = np.where(end.apart[:, None] | lane.apart, 0.0, slope)
        slope[lane.idle] = np.eye(len(slope))[lane.idle]
        done.append(Recorded(lane, end, num, bool(now.cycle >= num), steps, slope, lost))
    return done


def _recorded(own: tuple[Lane, int], solver: Solver, most: int | None) -> tuple[Trajectory, Step, np.ndarray]:
    """The end of a lane after some cycles, its steps, their axis the first, and the energy lost in each contact.

    By itself, in the loop of a transient: it is the derivative that takes most of the time, and a loop that records
    several side by side is compiled for as long as the one that marches them.
    """
    (lane, num), method = own, step_method(solver)
    room = min(CAPACITY, capacity(lane.system, method.order if method.collocates else 0))
    work = None if method.collocates else Work.none(lane.here.state.size)
    here = replace(lane.here.point, work=work)
    now, parts, count = begun(lane.system, here, lane.here.state, lane.control.opening), [], 0
    while count < (most or np.inf):
        now, rows, taken = advance(method, lane.control, lane.system, now, np.asarray(num), room)
        parts.append(first_rows(rows, int(taken)))
        count += int(taken)
        if not unfinished(now, num):
            break
    now = _on_host(now)
    steps = parts[0] if len(parts) == 1 else jax.tree.map(lambda *rows: np.concatenate(rows), *parts)
    if now.point.work is None:
        return now, steps, energy_lost(steps)
    return _without_work(now, "point", "rate"), _without_work(steps, *ENDS), now.point.work.friction


def _without_work(tree: T, *names: str) -> T:
    """A tree some of whose entries are points, without the energies of these."""
    return with_parts(tree, **{name: with_parts(getattr(tree, name), work=None) for name in names})


def _slopes(lanes: Sequence[Lane], method: Method, steps: Sequence[Step], each: Each) -> list[np.ndarray]:
    """Derivative of the state of each lane after its steps by that before them."""
    slopes: dict[int, np.ndarray] = {}
    if isinstance(method, Explicit):
        own = [i for i, pair in enumerate(zip(lanes, steps, strict=True)) if _by_matrices(method, *pair)]
        found = each(partial(_slope_of_explicit, method), [(lanes[i], steps[i]) for i in own])
        slopes |= zip(own, found, strict=True)
    others = [i for i in range(len(lanes)) if i not in slopes]
    pieces = _slopes_in_pieces([lanes[i] for i in others], method, [steps[i] for i in others], each)
    slopes |= zip(others, pieces, strict=True)
    return [slopes[i] for i in range(len(lanes))]


def _by_matrices(method: Explicit, lane: Lane, steps: Step) -> bool:
    """Whether products of matrices are quicker, or needed, as a mode may be fast over the steps."""
    return lane.vector.size >= MANY or error_of(method.name, _fastest(lane) * steps.h).sum() > LOST


def _fastest(lane: Lane) -> float:
    """Fastest rate of its structure with every contact stuck, dimensionless."""
    return lane.model.stuck_rate / lane.frame.scales.omega


def _slope_of_explicit(method: Explicit, own: tuple[Lane, Step]) -> np.ndarray:
    """The same of one lane by an explicit method, by products of matrices."""
    lane, steps = own
    system, size, pieces = lane.system.single(), steps.h.size, []
    if not size:
        return np.eye(lane.vector.size)
    for first in range(0, size, PIECE):
        rows = np.minimum(np.arange(first, first + PIECE), size - 1)
        pieces.append(_on_host(linear(method, system, _entry(steps, rows))))
    whole = jax.tree.map(lambda *rows: np.concatenate(rows)[:size], *pieces)
    disturbed = Disturbed(method, system, _fastest(lane))
    with np.errstate(over="ignore", invalid="ignore"):
        return disturbed.moved(whole, steps.h, steps.state) @ disturbed.opening(whole)


def _slopes_in_pieces(lanes: Sequence[Lane], method: Method, steps: Sequence[Step], each: Each) -> list[np.ndarray]:
    """The same of lanes whose steps are cut into pieces, some side by side: no lane waits for a longer one."""
    slopes = [np.eye(lane.vector.size) for lane in lanes]
    pieces = []
    for index, own in enumerate(steps):
        num = -(-own.h.size // PIECE)
        ends = [k * own.h.size // num for k in range(num + 1)] if num else []
        pieces += [(index, first, end) for first, end in pairwise(ends)]

    def products(batch: list[tuple[int, int, int]]) -> np.ndarray:
        padded = _padded(batch)
        rows = [_entry(steps[i], slice(first, end)) for i, first, end in padded]
        count, opens = np.array([[end - first, first == 0] for _, first, end in padded]).T
        systems = _stacked([lanes[i].system for i, _, _ in padded])
        return np.asarray(derivative(method, systems, jax.tree.map(_columns, *rows), count, opens.astype(bool)))

    batches = _batches(pieces)
    for batch, found in zip(batches, each(products, batches), strict=True):
        for (i, _, _), product in zip(batch, found, strict=False):
            slopes[i] = product @ slopes[i]
    return slopes


def _columns(*pieces: np.ndarray) -> np.ndarray:
    """Pieces side by side, the batch last, with empty rows up to the length of a piece."""
    whole = np.zeros((PIECE, *pieces[0].shape[1:], len(pieces)), pieces[0].dtype)
    for index, rows in enumerate(pieces):
        whole[: len(rows), ..., index] = rows
    return whole


def _batches(lanes: Sequence[Any], size: int = SIDE_BY_SIDE) -> list[list[Any]]:
    return [list(lanes[first : first + size]) for first in range(0, len(lanes), size)]


def _padded(batch: list[Any], size: int = SIDE_BY_SIDE) -> list[Any]:
    """A batch with its first entry repeated until it has its size."""
    return [*batch, *batch[:1] * (size - len(batch))]


def _stacked(trees: Sequence[Any]) -> Any:
    """Trees of one structure as one, batch first."""
    return jax.tree.map(lambda *rows: np.array(rows), *trees)


def _entry(tree: Any, index: int | slice | np.ndarray) -> Any:
    """One of a batch, or some."""
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _on_host(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)
