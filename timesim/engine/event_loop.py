"""The event loop: compiled loops over steps, of one trajectory with its record, or of many side by side.

A call advances by a number of cycles, or until its record of steps is full: memory does not grow with the cycles.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from timesim.engine.exponential.work import has_fast_modes, work_done
from timesim.engine.lanes import Over, advance_lanes, batch_first, batch_last, by_itself, over_lanes
from timesim.engine.law.contact_law import Dynamics
from timesim.engine.method import Method
from timesim.engine.solver import Control
from timesim.engine.status import Status
from timesim.engine.step import Step, Trajectory, begin, try_step
from timesim.engine.system import Point, System, Work
from timesim.program import program

D = TypeVar("D", bound=Dynamics)
Rows = TypeVar("Rows")
begun = program(begin)
ROOM = 2**18  # numbers in a batch of steps: what is done once a batch hardly counts, and XLA runs the loop as one
LEAST, BATCH = 64, 8192  # steps handed over at a time, at least and at most


class Reached(NamedTuple):
    """Where a trajectory stands, as of `timesim.engine.step.Trajectory`; numpy arrays."""

    cycle: np.ndarray
    time: np.ndarray
    point: Point
    state: np.ndarray
    status: np.ndarray
    culprit: np.ndarray


class Batch(NamedTuple):
    """Accepted steps in a row, their axis the first; energies since the first of all; the trajectory after them."""

    loop: Step
    work: Work
    now: Reached


def batches(method: Method, control: Control, system: System, now: Trajectory, cycles: int) -> Iterator[Batch]:
    """Steps of one trajectory through some cycles from the start of one, or until it ends early."""
    room = capacity(system, method.order if method.collocates else 0)
    fast = has_fast_modes(system, float(control.longest))
    done = Work.none(now.state.size)
    ready = prepared(method, control, system) if method.collocates else system
    while unfinished(now, cycles):
        now, record, count = advance(method, control, ready, now, np.asarray(cycles), room)
        loop = first_rows(record, int(count))
        work = loop.end.work
        if method.collocates:
            each = first_rows(work_done(system, fast, record, count), int(count))
            work = jax.tree.map(lambda before, rows: before + np.cumsum(rows, axis=0), done, each)
            done = jax.tree.map(lambda rows: rows[-1], work) if loop.h.size else done
        here = Reached(now.cycle, now.time, now.point, now.state, now.status, now.culprit)
        yield Batch(loop, work, jax.tree.map(np.asarray, here))


def unfinished(now: Any, cycles: Any) -> Any:
    """Which trajectories have neither completed so many cycles nor ended early."""
    return (now.cycle < cycles) & (now.status == Status.RUNNING)


def first_rows(record: Rows, count: int) -> Rows:
    """The filled part of a record, on the host."""
    return jax.tree.map(lambda rows: np.asarray(rows)[:count], record)


def capacity(system: System, num_nodes: int) -> int:
    """Steps of a batch, a power of two; ``num_nodes``: places at which a step is known, 0 if only at its ends."""
    axes, (contacts, modes) = len(system.shape), system.shape[0].shape
    row = 8 * modes + (4 * axes + 2) * contacts + num_nodes * (3 * modes + (2 * axes + 1) * contacts)
    return int(min(max(2 ** np.ceil(np.log2(ROOM / row)), LEAST), BATCH))


@program
def advance(
    method: Method, control: Control, dynamics: Dynamics, start: Trajectory, cycles: Int[Array, ""], capacity: int
) -> tuple[Trajectory, Step, Int[Array, ""]]:
    """Advance one trajectory until it has completed ``cycles`` cycles, ended early, or filled its record.

    Returns the trajectory, the accepted steps (leading axis ``capacity``), and how many there are.
    """
    dynamics = alone(method, control, dynamics)
    blank = jax.eval_shape(partial(try_step, method, control, dynamics), start)[1]
    record = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), blank)

    def goes_on(carry: tuple) -> Array:
        now, _, count = carry
        return unfinished(now, cycles) & (count < capacity)

    def body(carry: tuple) -> tuple:
        now, record, count = carry
        now, step, accepted = try_step(method, control, dynamics, now)
        record = jax.tree.map(lambda rows, row: rows.at[count].set(row), record, step)
        return now, record, count + accepted

    return jax.lax.while_loop(goes_on, body, (start, record, jnp.zeros((), dtype=jnp.int64)))


SIDE_BY_SIDE = 32  # trajectories whose numbers stay in the nearest caches


def one_by_one(method: Method, dynamics: Dynamics, size: int) -> bool:
    """Whether so many trajectories are advanced one after the other."""
    return size == 1 or method.collocates or dynamics.wide


def alone(method: Method, control: Control, dynamics: D) -> D:
    """The system for a trajectory that is advanced by itself, with what the method needs of it."""
    return method.prepared(dynamics.single(), control.longest)


prepared = program(alone)


@program
def march(
    method: Method, control: Control, dynamics: Dynamics, start: Trajectory, cycles: Int[Array, " batch"]
) -> tuple[Trajectory, Int[Array, " batch"]]:
    """Advance a batch until each has completed its number of cycles or ended early; nothing is recorded.

    A large batch is marched a part after the other. Systems and trajectories are batch first, the control is the same
    for all. Returns the trajectories, and the number of transitions of each.
    """
    size = cycles.shape[0]
    if one_by_one(method, dynamics, size):

        def march_one(lane: tuple) -> tuple[Trajectory, Array]:
            dynamics, start, cycles = lane
            return _marched(method, control, alone(method, control, dynamics), start, cycles, by_itself)

        return jax.lax.map(march_one, (dynamics, start, cycles))
    if size <= SIDE_BY_SIDE:
        return _march_together(method, control, dynamics, start, cycles)
    lanes = (jnp.arange(-(-size // SIDE_BY_SIDE) * SIDE_BY_SIDE) % size).reshape(-1, SIDE_BY_SIDE)

    def part(chosen: Int[Array, " part"]) -> tuple[Trajectory, Int[Array, " part"]]:
        return _march_together(method, control, *jax.tree.map(lambda leaf: leaf[chosen], (dynamics, start, cycles)))

    done = jax.lax.map(part, lanes)
    # Not -1: without contacts there are leaves of no elements, which do not tell.
    return jax.tree.map(lambda leaf: leaf.reshape(lanes.size, *leaf.shape[2:])[:size], done)


def _march_together(
    method: Method, control: Control, dynamics: Dynamics, start: Trajectory, cycles: Int[Array, " batch"]
) -> tuple[Trajectory, Int[Array, " batch"]]:
    over = partial(over_lanes, in_axes=(None, -1, -1))
    end, count = _marched(method, control, *batch_last((dynamics, start)), cycles, over)
    return batch_first(end), count


def _marched(
    method: Method, control: Control, dynamics: Dynamics, start: Trajectory, cycles: Array, over: Over
) -> tuple[Trajectory, Array]:
    """`march` with the batch last, or of one trajectory."""
    attempt = partial(over(partial(try_step, method)), control, dynamics)

    def counted(count: Array, moves: Array, before: Trajectory, after: Trajectory, step: Step, done: Array) -> Array:
        return count + jnp.where(moves & done, (step.state != step.state_after).sum(axis=0), 0)

    none = jnp.zeros(cycles.shape, dtype=jnp.int64)
    return advance_lanes(attempt, partial(unfinished, cycles=cycles), start, none, counted)
