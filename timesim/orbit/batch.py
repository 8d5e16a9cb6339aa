"""Many trajectories side by side through whole cycles: marched with the state at each cycle's end, or recorded.

A trajectory starts each cycle from its state alone (the step control forgets at a cycle's end), so a batch is made of
states, and what one makes of a cycle does not depend on its neighbours. Inside, the batch is the last axis: the kernels
run along it. Arguments and results have it first.
"""

import timesim.runtime  # noqa: F401  isort: skip

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from timesim.engine.contact_law import State
from timesim.engine.method import Method
from timesim.engine.solver import Control
from timesim.engine.step import Status, Step, Trajectory, begin, try_step
from timesim.engine.system import Point, System
from timesim.model.model import SEPARATION


class Place(eqx.Module):
    """Where trajectories are at the start of a cycle: continuous state and contact states."""

    point: Point
    state: State


def section(place: Place) -> Float[Array, " state"]:
    """A place as one vector (q, q', w); w of a separated contact, which is u, counts as 0."""
    apart = place.state == SEPARATION
    return jnp.concatenate([place.point.q, place.point.p, *(jnp.where(apart, 0.0, w) for w in place.point.w)])


def _last(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), tree)


def _first(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


class Ends(eqx.Module):
    """What marching has led to.

    Attributes:
        place: at the end.
        sections: `section` at the end of each cycle, (batch, cycle, state); 0 for cycles not reached.
        cycles: completed.
        status, culprit: as in `Trajectory`.
    """

    place: Place
    sections: Float[Array, "batch cycle state"]
    cycles: Int[Array, " batch"]
    status: Int[Array, " batch"]
    culprit: Int[Array, " batch"]


@eqx.filter_jit
def march_cycles(method: Method, controls: Control, systems: System, places: Place, num_cycles: int) -> Ends:
    """March a batch by a number of cycles and keep the state at the end of each."""
    controls, systems, places = _last((controls, systems, places))
    start = jax.vmap(begin, in_axes=-1, out_axes=-1)(systems, places.point, places.state, controls.opening)
    attempt = jax.vmap(partial(try_step, method), in_axes=-1, out_axes=-1)
    sections = jax.vmap(lambda now: section(Place(now.point, now.state)), in_axes=-1, out_axes=-1)
    row = jnp.arange(num_cycles)[:, None]

    def running(now: Trajectory) -> Bool[Array, " batch"]:
        return (now.cycle < num_cycles) & (now.status == Status.RUNNING)

    def body(carry: tuple) -> tuple:
        now, kept = carry
        moves = running(now)
        new = attempt(controls, systems, now)[0]
        new = jax.tree.map(lambda a, b: jnp.where(moves, a, b), new, now)
        ended = (row == now.cycle) & (new.cycle > now.cycle)
        return new, jnp.where(ended[:, None], sections(new), kept)

    kept = jnp.zeros((num_cycles, *sections(start).shape))
    end, kept = jax.lax.while_loop(lambda carry: running(carry[0]).any(), body, (start, kept))
    return Ends(_first(Place(end.point, end.state)), jnp.moveaxis(kept, -1, 0), end.cycle, end.status, end.culprit)


def at_start(places: Place, controls: Control) -> Trajectory:
    """Trajectories at the start of a cycle, batch first, as `record_cycles` takes them; made without JAX."""
    zero, one = np.zeros(len(places.state)), np.ones(len(places.state))
    none = np.zeros(len(places.state), dtype=np.int64)
    parts = (none, zero, places.point, places.point, places.state, np.asarray(controls.opening), one * np.inf)
    alone = jax.tree.map(lambda leaf: np.asarray(leaf[0]), (*parts, one, one, none, none, none, none))
    leaves = jax.tree.leaves((*parts, one, one, none, none, none, none))
    made: Trajectory = jax.tree.unflatten(jax.tree.structure(Trajectory(*alone)), leaves)
    return made


@eqx.filter_jit
def record_cycles(
    method: Method, controls: Control, systems: System, now: Trajectory, cycles: Int[Array, " batch"], capacity: int
) -> tuple[Trajectory, Step, Bool[Array, "try batch"], Int[Array, ""]]:
    """Advance a batch, all steps kept, until each has completed its cycles or the record is full.

    Args:
        method: the method.
        controls, systems: of each, batch first.
        now: trajectories as `at_start` or an earlier call gives them, batch first; their rates are found anew.
        cycles: how many each is to complete.
        capacity: tries that the record has room for.

    Returns:
        The trajectories, the steps (try first, batch last), which of them were made, and the number of tries.
    """
    controls, systems, now = _last((controls, systems, now))
    rate = jax.vmap(System.field, in_axes=-1, out_axes=-1)(systems, now.state, now.time, now.point)
    now = eqx.tree_at(lambda t: t.rate, now, rate)
    attempt = jax.vmap(partial(try_step, method), in_axes=-1, out_axes=-1)
    blank = jax.eval_shape(attempt, controls, systems, now)[1]
    record = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), blank)

    def running(now: Trajectory) -> Bool[Array, " batch"]:
        return (now.cycle < cycles) & (now.status == Status.RUNNING)

    def body(carry: tuple) -> tuple:
        now, record, made, count = carry
        moves = running(now)
        new, step, accepted = attempt(controls, systems, now)
        record = jax.tree.map(lambda rows, row: rows.at[count].set(row), record, step)
        made = made.at[count].set(moves & accepted)
        return jax.tree.map(lambda a, b: jnp.where(moves, a, b), new, now), record, made, count + 1

    def goes_on(carry: tuple) -> Bool[Array, ""]:
        return running(carry[0]).any() & (carry[3] < capacity)

    made = jnp.zeros((capacity, *cycles.shape), dtype=bool)
    now, record, made, count = jax.lax.while_loop(goes_on, body, (now, record, made, jnp.zeros((), dtype=jnp.int64)))
    return _first(now), record, made, count
