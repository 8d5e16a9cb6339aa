"""Trajectories side by side through whole cycles: marched with the state at each cycle's end, or recorded.

A trajectory starts each cycle from its state alone (the step control forgets at a cycle's end), so its cycles do not
depend on its neighbours.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import chain, pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from timesim.engine.event_loop import alone, one_by_one
from timesim.engine.lanes import Over, advance_lanes, batch_first, batch_last, by_itself, over_lanes
from timesim.engine.method import Method, step_method
from timesim.engine.solver import Control
from timesim.engine.status import Status
from timesim.engine.step import Step, Trajectory, begin, try_step
from timesim.engine.system import System
from timesim.model.solver import Solver
from timesim.orbit.lane import Lane, Recorded
from timesim.orbit.monodromy import HybridState, Tries, derivative, state_vector
from timesim.program import program

SIDE_BY_SIDE = 4  # lanes of a batch: of 16 each takes as long; a batch that is not full is filled up
CAPACITY = 256  # tries of one call that records
PIECE = 32  # most steps whose derivative is one piece of work: 16 of them take longer than to prepare them

Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]
"""Does the same work on each of several batches, in their order, as `map` does; threads may share them."""

Problem = tuple[Control, System, Any]
"""Of one trajectory or of a batch: control, system, and where it goes on from."""


def _unfinished(now: Trajectory, cycles: Any) -> Any:
    return (now.cycle < cycles) & (now.status == Status.RUNNING)


@program
def march_cycles(
    method: Method, controls: Control, systems: System, starts: HybridState, num_cycles: int
) -> tuple[Trajectory, Float[Array, "batch cycle state"]]:
    """March a batch, batch first, by a number of cycles.

    Returns:
        the trajectories, and `state_vector` at the end of each cycle, 0 for cycles not reached; batch first.
    """
    problem = (controls, systems, starts)
    if one_by_one(method, systems):
        return jax.lax.map(lambda lane: _marched(method, _alone(method, lane), num_cycles, by_itself), problem)
    end, returns = _marched(method, batch_last(problem), num_cycles, over_lanes)
    return batch_first(end), jnp.moveaxis(returns, -1, 0)


def _alone(method: Method, problem: Problem) -> Problem:
    """The problem of one of a batch that is advanced by itself."""
    control, system, start = problem
    return control, alone(method, control, system), start


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
    return advance_lanes(attempt, partial(_unfinished, cycles=num_cycles), now, returns, keep)


@program
def record_cycles(
    method: Method, controls: Control, systems: System, now: Trajectory, cycles: Int[Array, " batch"], capacity: int
) -> tuple[Trajectory, Tries]:
    """Advance a batch, all steps kept, until each has completed its cycles or the record is full.

    Args:
        method: the method.
        controls, systems: of each, batch first.
        now: trajectories as `Lane.at_start` or an earlier call gives them, batch first; their rates are computed anew.
        cycles: how many each is to complete.
        capacity: tries that the record has room for.
    """
    problem = (controls, systems, now)
    if one_by_one(method, systems):
        one = partial(_kept, method, capacity=capacity, over=by_itself)
        end, (rows, taken, count) = jax.lax.map(lambda lane: one(_alone(method, lane[0]), lane[1]), (problem, cycles))
        return end, Tries(*batch_last((rows, taken)), count.max())
    end, tries = _kept(method, batch_last(problem), cycles, capacity, over_lanes)
    return batch_first(end), Tries(*tries)


def _kept(
    method: Method, problem: Problem, cycles: Array, capacity: int, over: Over
) -> tuple[Trajectory, tuple[Step, Array, Array]]:
    """`record_cycles` with the batch last, or of one trajectory: its end, and the parts of `Tries`."""
    controls, systems, now = problem
    now = eqx.tree_at(lambda t: t.rate, now, over(System.field)(systems, now.state, now.time, now.point))
    attempt = partial(over(partial(try_step, method)), controls, systems)
    blank = jax.eval_shape(attempt, now)[1]
    rows = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), blank)
    none = (rows, jnp.zeros((capacity, *cycles.shape), dtype=bool), jnp.zeros((), dtype=jnp.int64))

    def keep(kept: tuple, moves: Array, before: Trajectory, after: Trajectory, step: Step, accepted: Array) -> tuple:
        rows, taken, count = kept
        rows = jax.tree.map(lambda rows, row: rows.at[count].set(row), rows, step)
        return rows, taken.at[count].set(moves & accepted), count + 1

    return advance_lanes(attempt, partial(_unfinished, cycles=cycles), now, none, keep, lambda kept: kept[2] < capacity)


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

    ``most``: tries after which to give up; the budget of the solver by default.
    """
    pairs = list(zip(lanes, num_cycles, strict=True))
    ends = list(chain.from_iterable(each(partial(_advanced, solver=solver, most=most), _batches(pairs))))
    slopes = _slopes(lanes, step_method(solver), [steps for _, steps in ends], each)
    done = []
    for lane, num, (now, steps), slope in zip(lanes, num_cycles, ends, slopes, strict=True):
        end = lane.after(now)
        slope = np.where(end.apart[:, None] | lane.apart, 0.0, slope)
        done.append(Recorded(lane, end, num, bool(now.cycle >= num), steps, slope))
    return done


def _advanced(batch: list[tuple[Lane, int]], solver: Solver, most: int | None) -> list[tuple[Any, Step]]:
    """The end of each lane of a batch, and its steps, the first axis that of the steps."""
    method, padded = step_method(solver), _padded(batch)
    controls, systems, now = _stacked([(lane.control, lane.system, lane.at_start()) for lane, _ in padded])
    cycles = np.array([num for _, num in padded])
    parts: list[list[Step]] = []  # of the steps that were taken: the tries of a long period would fill the memory
    count = 0
    while count < (most or np.inf):
        now, tries = _on_host(record_cycles(method, controls, systems, now, cycles, CAPACITY))
        parts.append([_of_lane(tries, i) for i in range(len(batch))])
        count += int(tries.count)
        if not _unfinished(now, cycles).any():
            break
    joined = [jax.tree.map(lambda *rows: np.concatenate(rows), *own) for own in zip(*parts, strict=True)]
    return [(_entry(now, i), steps) for i, steps in enumerate(joined)]


def _of_lane(tries: Tries, index: int) -> Step:
    """The steps of one lane of a batch that were taken."""
    taken = tries.accepted[:, index]
    return jax.tree.map(lambda rows: rows[taken, ..., index], tries.step)


def _slopes(lanes: Sequence[Lane], method: Method, steps: Sequence[Step], each: Each) -> list[np.ndarray]:
    """Derivative of the state of each lane after its steps by that before them.

    The steps of each are cut into pieces whose derivatives are computed side by side: no lane waits for a longer one.
    """
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
    return jax.tree.map(lambda *rows: np.stack(rows), *trees)


def _entry(tree: Any, index: int | slice) -> Any:
    """One of a batch, or some."""
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _on_host(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)
