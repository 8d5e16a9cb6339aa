"""Derivative of steps of any method by automatic differentiation."""

from timesim.runtime import tree_class  # isort: skip

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from timesim.engine.law.contact_law import ContactLaw, Motion, Plane, Scalar, State
from timesim.engine.method import Explicit, Method
from timesim.engine.step import Step, transition
from timesim.engine.system import Point, System
from timesim.model.model import SEPARATION, SLIP, STICK
from timesim.program import program


@tree_class
class HybridState:
    """Continuous state of a trajectory, and the state of each contact."""

    point: Point
    state: State


def vector_of(point: Point, numpy: Any = jnp) -> Any:
    """(q, q', w) as one vector; ``numpy``: the library that the arrays are of."""
    return numpy.concatenate([point.q, point.p, *point.w])


def point_of(vector: Any, like: Point) -> Point:
    """The inverse of `vector_of`, in the shapes of another point."""
    size, contacts, axes = like.q.shape[0], like.w[0].shape[0], len(like.w)
    slip = vector[2 * size :].reshape(axes, contacts)
    return Point(vector[:size], vector[size : 2 * size], tuple(slip[i] for i in range(axes)), None)


def state_vector(point: Point, state: State) -> Float[Array, " state"]:
    """(q, q', w) as one vector; w of a separated contact, which is u, counts as 0."""
    apart = state == SEPARATION
    return jnp.concatenate([point.q, point.p, *(jnp.where(apart, 0.0, w) for w in point.w)])


def margin_at_end(law: ContactLaw, state: State, after: State, motion: Motion, w: Plane) -> Scalar:
    """Margin of each contact that falls to zero where it goes on in another state."""
    force, speed = law.margins(state, motion, w)
    return jnp.where((state == SLIP) & (after == STICK), speed, force)


def _first_guard(system: System, step: Step, vector: Float[Array, " state"]) -> Float[Array, ""]:
    """Margin of the contact that leaves its state at the end of the step; of several at once, of the first."""
    point = point_of(vector, step.end)
    margin = margin_at_end(system.law, step.state, step.state_after, system.motion(point), point.w)
    return margin[jnp.argmax(step.state != step.state_after)] if margin.size else jnp.ones(())


def _image(method: Method, system: System, step: Step, start: Float[Array, " state"]) -> Float[Array, " state"]:
    """Where a start close to that of the step is led to, at the fixed time of its end."""
    point, felt = point_of(start, step.start), _felt(method, system, step)
    rate = felt.field(step.state, step.time, point)
    end = vector_of(method.advance(felt, step.state, step.time, point, rate, step.h).point)
    crossed = step.state != step.state_after
    before, middle = vector_of(step.end_rate), jax.lax.stop_gradient(end)
    guard = partial(_first_guard, system, step)
    falls = jax.jvp(guard, (middle,), (before,))[1]
    falls = jnp.where(falls == 0, jnp.inf, falls)
    delay = jnp.where(crossed.any(), -(guard(end) - guard(middle)) / falls, 0.0)
    at_event = transition(system, step.state, crossed, point_of(end + before * delay, step.end))[0]
    after = vector_of(system.field(step.state_after, step.time + step.h, jax.lax.stop_gradient(at_event)))
    return vector_of(at_event) - after * delay


def _felt(method: Method, system: System, step: Step) -> System:
    """The system as a step of an explicit method follows it with a disturbance."""
    if not isinstance(method, Explicit):
        return system
    ends = [(system.motion(point), point.w) for point in (step.start, step.end)]
    return replace(system, law=system.law.disturbed(step.state, step.h, ends))


@program
def derivative(
    method: Method, system: System, steps: Step, count: Int[Array, ""], opens: Bool[Array, ""]
) -> Float[Array, "state state"]:
    """Product over some steps of the derivative of each, in the order of `vector_of`.

    Args:
        method, system: that of the steps, and that in which they were taken.
        steps: accepted steps in a row, their axis the first.
        count: how many of them there are; rows beyond are empty.
        opens: whether they begin with the state from which the cycles do, which may be moved off the friction cone: w
            of a contact that slips is put back on it.
    """
    own = replace(method, looped=True) if isinstance(method, Explicit) else method

    def on_cone(step: Step) -> Float[Array, "state state"]:
        """Derivative of the state from which the first step starts by that from which its lane does."""
        quiet, start = jnp.zeros(step.state.shape, dtype=bool), vector_of(step.start)
        put = lambda y: vector_of(transition(system, step.state, quiet, point_of(y, step.start))[0])  # noqa: E731
        return jnp.where(opens, jax.jacfwd(put)(start), jnp.eye(start.size))

    def push(index: Array, columns: Float[Array, "state state"]) -> Float[Array, "state state"]:
        step = jax.tree.map(lambda rows: rows[index], steps)
        image, start = partial(_image, own, system, step), vector_of(step.start)
        return jax.vmap(lambda column: jax.jvp(image, (start,), (column,))[1], in_axes=1, out_axes=1)(columns)

    return jax.lax.fori_loop(0, count, push, on_cone(jax.tree.map(lambda rows: rows[0], steps)))
