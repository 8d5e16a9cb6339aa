"""What explicit steps do to small disturbances of the contacts: the law linearised at their stages and transitions."""

from timesim.runtime import tree_class  # isort: skip

from collections.abc import Callable
from functools import partial
from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from timesim.engine.lanes import batch_first, batch_last, over_lanes
from timesim.engine.law.contact_law import Motion, Plane, State
from timesim.engine.method import Explicit, Tableau, tableau
from timesim.engine.step import Step, transition
from timesim.engine.system import Point, System
from timesim.orbit.monodromy.derivative import ending, felt, vector_of
from timesim.program import program


@tree_class
class Linear:
    """What a step of an explicit method does to small disturbances, but for what the structure alone does.

    A disturbance of a contact is one of (u, v, u', v', w), a rate one of (-f, -n, w'): a law acts on each contact by
    itself.

    Attributes:
        rates: for a unit of each disturbance, at each stage, (stage, disturbance, rate, contact).
        opening, put: w after the transitions at the start and at the end of the step, (disturbance, axis, contact).
        delay: of the transition that ends it; 0 where there is none, (disturbance, contact).
        before, after: rates of the whole state at both sides of it, in the order of `vector_of`.
    """

    rates: Float[Array, "stage disturbance rate contact"]
    opening: Float[Array, "disturbance axis contact"]
    put: Float[Array, "disturbance axis contact"]
    delay: Float[Array, "disturbance contact"]
    before: Float[Array, " state"]
    after: Float[Array, " state"]


def weights_of(own: Tableau) -> np.ndarray:
    """Weights of the slopes at the stages and, last, at the end of a step, a row each; that of the end has none."""
    return np.pad(own.weights[:, :-1], [(1, 0), (0, 0)])


@program
def linear(method: Explicit, system: System, steps: Step) -> Linear:
    """`Linear` of steps, the first axis that of the steps; the system is of one trajectory."""
    weights = jnp.asarray(weights_of(tableau(method.name)))

    def one(step: Step) -> Linear:
        here = step.state, step.time, step.start
        followed = felt(method, system, step)
        slopes = method.slopes(followed, *here, followed.field(*here), step.h)
        moved = jax.tree.map(lambda y, rows: y + step.h * jnp.tensordot(weights, rows[:-1], 1), step.start, slopes)
        points, end = (jax.tree.map(itemgetter(place), moved) for place in (slice(-1), -1))
        rates = jax.vmap(partial(_by_contact, followed, partial(_rates, followed, step.state)))(points)
        before = step.end_rate
        crossed = step.state != step.state_after
        slip = partial(followed.law.slip_at_transition, step.state)
        first = jnp.arange(crossed.size) == (jnp.argmax(crossed) if crossed.size else 0)
        guard = first * _by_contact(followed, lambda motion, w: (ending(followed, step, motion, w)[None],), end)[:, 0]
        falls = (guard * _local(followed, before)).sum()
        at_event = transition(followed, step.state, crossed, end)[0]
        return Linear(
            rates=rates,
            opening=_by_contact(followed, partial(slip, step.state), step.start),
            put=_by_contact(followed, partial(slip, step.state_after), end),
            delay=jnp.where(crossed.any() & (falls != 0), -guard / jnp.where(falls == 0, 1.0, falls), 0.0),
            before=vector_of(before),
            after=vector_of(followed.field(step.state_after, step.time + step.h, at_event)),
        )

    return batch_first(over_lanes(one)(batch_last(steps)))


def _local(system: System, point: Point) -> Float[Array, "disturbance contact"]:
    """Motion of the contacts, its rate, and w."""
    x, dx, _ = system.path(point, point)
    return jnp.stack([*x, *dx, *point.w])


def _rates(system: System, state: State, motion: Motion, w: Plane) -> Plane:
    acts = system.law.reaction(state, motion, w)
    return *(-f for f in acts.f), -acts.n, *acts.dw


def _by_contact(
    system: System, function: Callable[[Motion, Plane], Plane], point: Point
) -> Float[Array, "disturbance row contact"]:
    """Derivatives of what each contact, or one of them, does by itself, by a disturbance of each kind."""
    here, axes = _local(system, point), len(system.shape)

    def of_rows(z: Array) -> Array:
        x, dx, w = (tuple(z[first:last]) for first, last in ((0, axes), (axes, 2 * axes), (2 * axes, len(z))))
        return jnp.stack(function(Motion(x[:-1], x[-1], dx[:-1], dx[-1]), w))

    kinds = jnp.broadcast_to(jnp.eye(len(here))[:, :, None], (len(here), *here.shape))
    return jax.vmap(lambda kind: jax.jvp(of_rows, (here,), (kind,))[1])(kinds)
