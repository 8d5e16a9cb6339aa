"""What explicit steps do to small disturbances of the contacts: the law linearised at their stages and transitions."""

from timesim.runtime import tree_class  # isort: skip

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from timesim.engine.law.contact_law import ContactLaw, Motion, Plane, State
from timesim.engine.method import Explicit, Tableau, tableau
from timesim.engine.step import Step, transition
from timesim.engine.system import Point, System
from timesim.orbit.monodromy.derivative import margin_at_end, vector_of
from timesim.program import program

T = TypeVar("T")


@tree_class
class Ends:
    """What the transitions at both ends of a step do to small disturbances of the contacts.

    A disturbance of a contact is one of (u, v, u', v', w): a law acts on each contact by itself.

    Attributes:
        opening, put: w after the transitions at the start and at the end of the step, (disturbance, axis, contact).
        delay: of the transition that ends it; 0 where there is none, (disturbance, contact).
        before, after: rates of the whole state at both sides of it, in the order of `vector_of`.
    """

    opening: Float[Array, "disturbance axis contact"]
    put: Float[Array, "disturbance axis contact"]
    delay: Float[Array, "disturbance contact"]
    before: Float[Array, " state"]
    after: Float[Array, " state"]


@tree_class
class Linear:
    """What a step of an explicit method does to small disturbances, but for what the structure alone does.

    Attributes:
        rates: (-f, -n, w') for a unit of each disturbance, at each stage, (stage, disturbance, rate, contact).
        ends: the transitions.
    """

    rates: Float[Array, "stage disturbance rate contact"]
    ends: Ends


def weights_of(own: Tableau) -> np.ndarray:
    """Weights of the slopes at the stages and, last, at the end of a step, a row each; that of the end has none."""
    return np.pad(own.weights[:, :-1], [(1, 0), (0, 0)])


@program
def linear(method: Explicit, system: System, steps: Step) -> Linear:
    """`Linear` of steps, the first axis that of the steps; the system is of one trajectory."""
    weights = jnp.asarray(weights_of(tableau(method.name)))

    def at_stages(step: Step) -> Float[Array, "stage disturbance contact"]:
        here = step.state, step.time, step.start
        slopes = method.slopes(system, *here, system.field(*here), step.h)
        moved = jax.tree.map(lambda y, rows: y + step.h * jnp.tensordot(weights[:-1], rows[:-1], 1), step.start, slopes)
        return jax.vmap(partial(local, system))(moved)

    contacts = contacts_of(system, steps)
    contacts = contacts._replace(law=contacts.felt())
    stages = jnp.stack([flattened(rows) for rows in jnp.moveaxis(jax.vmap(at_stages)(steps), 1, 0)])
    law, state = repeated((contacts.law, contacts.state), len(stages))

    def rates(motion: Motion, w: Plane) -> Plane:
        acts = law.reaction(state, motion, w)
        return *(-f for f in acts.f), -acts.n, *acts.dw

    rows = by_contact(rates, flattened(stages))
    rows = jnp.moveaxis(rows.reshape(*rows.shape[:2], len(stages), *steps.state.shape), (3, 2), (0, 1))
    return Linear(rows, ends_of(system, steps, contacts))


class Contacts(NamedTuple):
    """Those of many steps side by side, each an entry of the last axis.

    That is quicker, and traced for less, than a law for each step.

    Attributes:
        law: with their parameters.
        state, after: states during the step and after it.
        h: lengths of the steps.
        start, end: disturbances, of size zero or not, that the start and the end are; see `local`.
    """

    law: ContactLaw
    state: State
    after: State
    h: Array
    start: Float[Array, "disturbance contact"]
    end: Float[Array, "disturbance contact"]

    def felt(self) -> ContactLaw:
        """The law as explicit steps follow it with a disturbance."""
        return self.law.disturbed(self.state, self.h, [parted(self.start), parted(self.end)])


def contacts_of(system: System, steps: Step) -> Contacts:
    """Those of steps, the first axis that of the steps."""
    num, contacts = steps.state.shape
    states = steps.state.ravel(), steps.state_after.ravel()
    start, end = (flattened(jax.vmap(partial(local, system))(point)) for point in (steps.start, steps.end))
    return Contacts(repeated(system.law, num), *states, jnp.repeat(steps.h, contacts), start, end)


def ends_of(system: System, steps: Step, contacts: Contacts) -> Ends:
    """Those of steps, the first axis of all that of the steps."""
    law, state, after, _, start, end = contacts
    both, before, later = repeated((law, state), 2), jnp.concatenate([state, state]), jnp.concatenate([state, after])

    def acts(motion: Motion, w: Plane) -> Plane:
        slip = both[0].slip_at_transition(before, later, motion, w)
        return *slip, margin_at_end(both[0], before, later, motion, w)

    rows = by_contact(acts, jnp.concatenate([start, end], axis=1))
    first, last = jnp.moveaxis(rows.reshape(*rows.shape[:2], 2, *steps.state.shape), (2, 3), (0, 1))
    crossed = steps.state != steps.state_after
    leads = crossed & (jnp.cumsum(crossed, axis=1) == 1)
    guard = jnp.where(leads[:, None], last[:, :, -1], 0.0)
    falls = (guard * jax.vmap(partial(local, system))(steps.end_rate)).sum(axis=(1, 2))[:, None, None]

    def rate_after(step: Step) -> Float[Array, " state"]:
        at_event = transition(system, step.state, step.state != step.state_after, step.end)[0]
        return vector_of(system.field(step.state_after, step.time + step.h, at_event))

    return Ends(
        opening=first[:, :, :-1],
        put=last[:, :, :-1],
        delay=-guard / jnp.where(falls == 0, jnp.inf, falls),
        before=jax.vmap(vector_of)(steps.end_rate),
        after=jax.vmap(rate_after)(steps),
    )


def repeated(tree: T, num: int) -> T:
    """Values of contacts, for so many steps one after the other."""
    return jax.tree.map(lambda values: jnp.tile(values, num), tree)


def flattened(tree: T) -> T:
    """Values of the contacts, the last axis, of steps, the first axis, side by side."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], x.shape[0] * x.shape[-1]), tree)


def local(system: System, point: Point) -> Float[Array, "disturbance contact"]:
    """Motion of the contacts, its rate, and w."""
    x, dx, _ = system.path(point, point)
    return jnp.stack([*x, *dx, *point.w])


def parted(disturbance: Float[Array, "disturbance contact"]) -> tuple[Motion, Plane]:
    """The inverse of `local`."""
    axes = (len(disturbance) + 1) // 3
    x, dx, w = tuple(disturbance[:axes]), tuple(disturbance[axes : 2 * axes]), tuple(disturbance[2 * axes :])
    return Motion(x[:-1], x[-1], dx[:-1], dx[-1]), w


def by_contact(
    function: Callable[[Motion, Plane], Plane], here: Float[Array, "disturbance contact"]
) -> Float[Array, "disturbance row contact"]:
    """Derivatives of what each contact does by itself, by a disturbance of each kind."""
    return derivatives(lambda z: jnp.stack(function(*parted(z))), here)[1]


def derivatives(
    function: Callable[[Array], Array], here: Float[Array, "disturbance contact"]
) -> tuple[Float[Array, "row contact"], Float[Array, "disturbance row contact"]]:
    """What each contact does by itself, and its derivatives by a disturbance of each kind."""
    kinds = jnp.broadcast_to(jnp.eye(len(here))[:, :, None], (len(here), *here.shape))
    value, moved = jax.linearize(function, here)
    return value, jax.vmap(moved)(kinds)
