"""Trajectories through whole cycles: marched, the state at each cycle's end kept, or recorded, with the derivative.

Each goes by itself: side by side, four of two modes and a contact take as long as two, of more modes or contacts as
four, and compile for three times as long.
"""

from timesim.runtime import with_parts  # isort: skip

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from timesim.engine.event_loop import advance, alone, begun, capacity, first_rows, unfinished
from timesim.engine.exponential.work import energy_lost
from timesim.engine.lanes import advance_lanes
from timesim.engine.method import Explicit, Exponential, Method, step_method
from timesim.engine.solver import Control
from timesim.engine.step import Step, Trajectory, begin, try_step
from timesim.engine.system import System, Work
from timesim.model.solver import Solver
from timesim.orbit.lane import Lane, Recorded
from timesim.orbit.monodromy import (
    LOST,
    MANY,
    Collocated,
    Disturbed,
    HybridState,
    derivative,
    error_of,
    linear,
    state_vector,
)
from timesim.program import program

CAPACITY = 1024  # steps of one call that records, at most
PIECE = 128  # most steps whose derivative is one piece of work: to prepare them takes a quarter as long

Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]
"""Does the same work on each of several lanes or pieces, in their order, as `map` does; threads may share them."""

ENDS = ("start", "start_rate", "end", "end_rate")
"""Entries of a step that are points."""
T = TypeVar("T", Trajectory, Step)


@program
def march_cycles(
    method: Method, control: Control, system: System, start: HybridState, num_cycles: int
) -> tuple[Trajectory, Float[Array, "cycle state"]]:
    """March by a number of cycles: the trajectory, and `state_vector` at the end of each, 0 for cycles not reached."""
    system = alone(method, control, system)
    now, row = begin(system, start.point, start.state, control.opening), jnp.arange(num_cycles)

    def keep(returns: Array, _: Array, before: Trajectory, after: Trajectory, *step: Any) -> Array:
        ended = (row == before.cycle) & (after.cycle > before.cycle)
        return jnp.where(ended[:, None], state_vector(after.point, after.state), returns)

    returns = jnp.zeros((num_cycles, state_vector(now.point, now.state).size))
    attempt = partial(try_step, method, control, system)
    return advance_lanes(attempt, partial(unfinished, cycles=num_cycles), now, returns, keep)


def march_lanes(
    lanes: Sequence[Lane], solver: Solver, num_cycles: int, *, each: Each = map
) -> list[tuple[Lane, np.ndarray]]:
    """March lanes by a number of cycles: each at the end, and its state vector at the end of each completed cycle."""
    method = step_method(solver)

    def marched(lane: Lane) -> tuple[Lane, np.ndarray]:
        now, returns = _on_host(march_cycles(method, lane.control, lane.system, lane.here, num_cycles))
        return lane.after(now), returns[: now.cycle]

    return list(each(marched, lanes))


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

    In the loop of a transient, whose program it shares.
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
    elif isinstance(method, Exponential):
        slopes |= enumerate(each(partial(_slope_of_collocation, method), list(zip(lanes, steps, strict=True))))
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


def _slope_of_collocation(method: Exponential, own: tuple[Lane, Step]) -> np.ndarray:
    """The same of one lane by collocation."""
    lane, steps = own
    return Collocated(method, lane.system.single()).moved(steps)


def _slopes_in_pieces(lanes: Sequence[Lane], method: Method, steps: Sequence[Step], each: Each) -> list[np.ndarray]:
    """The same of lanes whose steps are cut into pieces, which threads share."""
    slopes = [np.eye(lane.vector.size) for lane in lanes]
    pieces = []
    for index, own in enumerate(steps):
        num = -(-own.h.size // PIECE)
        ends = [k * own.h.size // num for k in range(num + 1)] if num else []
        pieces += [(index, first, end) for first, end in pairwise(ends)]

    def product(piece: tuple[int, int, int]) -> np.ndarray:
        index, first, end = piece
        rows = jax.tree.map(_filled, _entry(steps[index], slice(first, end)))
        return np.asarray(derivative(method, lanes[index].system, rows, np.array(end - first), np.array(first == 0)))

    for (index, _, _), found in zip(pieces, each(product, pieces), strict=True):
        slopes[index] = found @ slopes[index]
    return slopes


def _filled(rows: np.ndarray) -> np.ndarray:
    """Rows, with empty ones up to the length of a piece."""
    return np.concatenate([rows, np.zeros((PIECE - len(rows), *rows.shape[1:]), rows.dtype)])


def _entry(tree: Any, index: int | slice | np.ndarray) -> Any:
    """One of a batch, or some."""
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _on_host(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)
