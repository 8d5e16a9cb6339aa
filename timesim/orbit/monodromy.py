"""Derivative of the map from the state at a cycle's start to that at its end, from the steps of the cycle.

Each step moves a disturbance, at fixed time, by the derivative of the method's own step. At a transition the time of
the event moves with the disturbance: with the guard m, the rates f-, f+ before and after, and the map T of the state
at the event,

    dy+ = DT (dy- + f- dt) - f+ dt,        dt = -Dm dy- / (Dm f-),

the saltation of the orbit. The product of both over the steps is exact for the method's own orbit up to its tolerance.

Source: di Bernardo, Budd, Champneys & Kowalczyk, Piecewise-smooth Dynamical Systems, section 2.5.
"""

import timesim.runtime  # noqa: F401  isort: skip

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from timesim.engine.method import Method
from timesim.engine.step import Step, transition
from timesim.engine.system import Point, System
from timesim.model.model import SLIP, STICK


def _vector(point: Point) -> Float[Array, " state"]:
    return jnp.concatenate([point.q, point.p, *point.w])


def _point(vector: Float[Array, " state"], like: Point) -> Point:
    size, contacts, axes = like.q.shape[0], like.w[0].shape[0], len(like.w)
    slip = vector[2 * size :].reshape(axes, contacts)
    return Point(vector[:size], vector[size : 2 * size], tuple(slip[i] for i in range(axes)), None)


def _first_guard(system: System, step: Step, vector: Float[Array, " state"]) -> Float[Array, ""]:
    """Margin of the contact that leaves its state at the end of the step; of several at once, of the first."""
    point = _point(vector, step.end)
    force, speed = system.law.margins(step.state, system.motion(point), point.w)
    to_stick = (step.state == SLIP) & (step.state_after == STICK)
    margin = jnp.where(to_stick, speed, force)
    return margin[jnp.argmax(step.state != step.state_after)] if margin.size else jnp.ones(())


def _image(method: Method, system: System, step: Step, start: Float[Array, " state"]) -> Float[Array, " state"]:
    """Where a start close to that of the step is led to, at the fixed time of its end."""
    rate = partial(system.field, step.state)
    point = _point(start, step.start)
    end = _vector(method.advance(rate, step.time, point, rate(step.time, point), step.h).point)
    crossed = step.state != step.state_after
    before, middle = _vector(step.end_rate), jax.lax.stop_gradient(end)
    guard = partial(_first_guard, system, step)
    falls = jax.jvp(guard, (middle,), (before,))[1]
    falls = jnp.where(falls == 0, jnp.inf, falls)
    delay = jnp.where(crossed.any(), -(guard(end) - guard(middle)) / falls, 0.0)
    at_event = transition(system, step.state, crossed, _point(end + before * delay, step.end))[0]
    after = _vector(system.field(step.state_after, step.time + step.h, jax.lax.stop_gradient(at_event)))
    return _vector(at_event) - after * delay


@eqx.filter_jit
def derivative(
    method: Method,
    systems: System,
    steps: Step,
    made: Bool[Array, "try batch"],
    count: Int[Array, ""],
    before: Float[Array, "batch state state"] | None = None,
) -> Float[Array, "batch state state"]:
    """Product over the steps of the derivative of each, of (q, q', w) in the order of `timesim.orbit.batch.section`.

    Args:
        method: the method that made the steps.
        systems: batch first.
        steps, made, count: a record as `timesim.orbit.batch.record_cycles` gives it: tries first, batch last.
        before: the product up to the first of them; None at the start of a cycle.
    """
    systems = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), systems)

    def on_cone(system: System, step: Step) -> Float[Array, "state state"]:
        """Derivative of what the first step starts from: of a contact that slips, w is a place on the cone."""
        quiet = jnp.zeros(step.state.shape, dtype=bool)
        put = lambda y: _vector(transition(system, step.state, quiet, _point(y, step.start))[0])  # noqa: E731
        return jax.jacfwd(put)(_vector(step.start))

    def push(system: System, step: Step, columns: Float[Array, "state state"]) -> Float[Array, "state state"]:
        _, image = jax.linearize(partial(_image, method, system, step), _vector(step.start))
        return jax.vmap(image, in_axes=1, out_axes=1)(columns)

    def body(carry: tuple) -> tuple:
        index, product = carry
        step = jax.tree.map(lambda rows: rows[index], steps)
        pushed = jax.vmap(push, in_axes=-1, out_axes=-1)(systems, step, product)
        return index + 1, jnp.where(made[index], pushed, product)

    if before is None:
        first = jax.tree.map(lambda rows: rows[0], steps)
        product = jax.vmap(on_cone, in_axes=-1, out_axes=-1)(systems, first)
    else:
        product = jnp.moveaxis(before, 0, -1)
    _, product = jax.lax.while_loop(lambda c: c[0] < count, body, (jnp.zeros((), dtype=jnp.int64), product))
    return jnp.moveaxis(product, -1, 0)
