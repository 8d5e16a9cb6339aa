"""Many trajectories side by side: each goes on until it is done, and then waits for the others.

Inside, the batch is the last axis: the kernels run along it. Arguments and results have it first.
"""

import timesim.runtime  # noqa: F401  isort: skip

import operator
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

Lanes = TypeVar("Lanes")
Kept = TypeVar("Kept")
Tree = TypeVar("Tree")
Over = Callable[..., Callable[..., Any]]
"""`over_lanes` or `by_itself`."""


def batch_last(tree: Tree) -> Tree:
    """The batch moved from the first axis of each leaf to the last."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), tree)


def batch_first(tree: Tree) -> Tree:
    """The batch moved from the last axis of each leaf to the first."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


def over_lanes(function: Callable[..., Any], in_axes: Any = -1) -> Callable[..., Any]:
    """The function of one trajectory for a batch of them."""
    return jax.vmap(function, in_axes=in_axes, out_axes=-1)


def by_itself(function: Callable[..., Any]) -> Callable[..., Any]:
    """In place of `over_lanes` where there is one trajectory: the function itself."""
    return function


def where_needed(alone: bool, needed: Bool[Array, ""], exact: Callable[[], Tree], else_: Tree) -> Tree:
    """What a function gives, where it is needed and of trajectories side by side, of which each takes both branches.

    ``alone``: whether there is one trajectory; ``else_``: what the function gives where it is not needed.
    """
    return jax.lax.cond(needed, exact, lambda: else_) if alone else exact()


def advance_lanes(
    attempt: Callable[[Lanes], tuple[Any, ...]],
    running: Callable[[Lanes], Bool[Array, " batch"]],
    start: Lanes,
    kept: Kept,
    keep: Callable[..., Kept],
) -> tuple[Lanes, Kept]:
    """Advance a batch, or one trajectory, until none of it is running: the trajectories and what is kept at the end.

    Args:
        attempt: tries a step of every trajectory: the trajectories after it, and what else is known of the step.
        running: which trajectories go on.
        kept: what is kept of the steps at the start.
        keep: ``keep(kept, running, before, after, *step)``: what is kept after a step. Trajectories that wait have not
            taken it: they are the same before and after.
    """

    def goes_on(carry: tuple[Lanes, Kept]) -> Bool[Array, ""]:
        return running(carry[0]).any()

    def body(carry: tuple[Lanes, Kept]) -> tuple[Lanes, Kept]:
        now, kept = carry
        moves = running(now)
        tried, *step = attempt(now)
        after = jax.tree.map(lambda new, old: jnp.where(moves, new, old), tried, now)
        return after, keep(kept, moves, now, after, *step)

    return jax.lax.while_loop(goes_on, body, (start, kept))


ROWS = 256  # evaluated at a time: a fixed number, so that a function of rows is compiled once


def by_rows(
    function: Callable[..., Any], common: tuple, columns: tuple, *chosen: tuple[Any, np.ndarray], rows: int = ROWS
) -> Any:
    """A compiled function of rows, of as many at a time as it is compiled for.

    Args:
        function: of what is common, the rows, and the rows that are chosen.
        common: what all rows share.
        columns: rows as they are.
        chosen: rows, and which of them each row has. Chosen a few at a time they stay in the caches.
        rows: how many that is.
    """
    size, found = len(jax.tree.leaves(columns)[0]), []
    for first in range(0, size, rows):
        at = np.minimum(np.arange(first, first + rows), size - 1)
        own = [*jax.tree.map(operator.itemgetter(at), columns)]
        own += [jax.tree.map(operator.itemgetter(index[at]), table) for table, index in chosen]
        found.append(jax.tree.map(np.asarray, function(*common, *own)))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:size], *found)
