"""Monodromy matrix: derivative of the map from the state at a cycle's start to that at its end, from recorded steps.

Each step moves a disturbance, at fixed time, by the derivative of the method's own step. At a transition the time of
the event moves with the disturbance: with the guard m, the rates f-, f+ before and after, and the map T of the state
at the event,

    dy+ = DT (dy- + f- dt) - f+ dt,        dt = -Dm dy- / (Dm f-),

the saltation matrix [1]_ [2]_ [3]_ applied to dy-. The product over the steps is exact for the method's own orbit up
to its tolerance, but for what an explicit step does not resolve of disturbances: directions of slip, see
`timesim.engine.law.cone.felt_direction`, and fast modes, see `timesim.engine.exponential.turning`. Its eigenvalues are
the Floquet multipliers.

.. [1] M. A. Aizerman & F. R. Gantmakher, On the stability of periodic motions, Journal of Applied Mathematics and
   Mechanics 22 (1958) 1065-1078.
.. [2] R. I. Leine & H. Nijmeijer, *Dynamics and Bifurcations of Non-Smooth Mechanical Systems*, Springer (2004).
.. [3] M. di Bernardo, C. J. Budd, A. R. Champneys & P. Kowalczyk, *Piecewise-smooth Dynamical Systems*, Springer
   (2008), section 2.5.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from timesim.engine.exponential.turning import Turning, turned, turning_rates
from timesim.engine.lanes import batch_last, over_lanes
from timesim.engine.law.contact_law import Motion, Plane, State
from timesim.engine.method import Explicit, Looped, Method, Tableau, looped, tableau
from timesim.engine.step import Step, transition
from timesim.engine.system import Point, System
from timesim.model.model import SEPARATION, SLIP, STICK
from timesim.program import program


class HybridState(eqx.Module):
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


def _first_guard(system: System, step: Step, vector: Float[Array, " state"]) -> Float[Array, ""]:
    """Margin of the contact that leaves its state at the end of the step; of several at once, of the first."""
    point = point_of(vector, step.end)
    return _ending(system, step, system.motion(point), point.w)


def _ending(system: System, step: Step, motion: Motion, w: Plane) -> Float[Array, ""]:
    """The same by the motion of the contacts."""
    force, speed = system.law.margins(step.state, motion, w)
    to_stick = (step.state == SLIP) & (step.state_after == STICK)
    margin = jnp.where(to_stick, speed, force)
    return margin[jnp.argmax(step.state != step.state_after)] if margin.size else jnp.ones(())


def _advanced(method: Method, system: System, step: Step, point: Point) -> Point:
    """The end of the step of a method from a point close to the start of a step."""
    here = (step.state, step.time)
    if not isinstance(method, Looped):
        return method.advance(system, *here, point, system.field(*here, point), step.h).point
    turning = Turning.of(system, step.time, step.h)
    end, _ = method.staged(turning, *here, point, turning.field(*here, point), step.h)
    return turning.real(step.time + step.h, end)


def _image(method: Method, system: System, step: Step, start: Float[Array, " state"]) -> Float[Array, " state"]:
    """Where a start close to that of the step is led to, at the fixed time of its end."""
    system = _felt(method, system, step)
    end = vector_of(_advanced(method, system, step, point_of(start, step.start)))
    crossed = step.state != step.state_after
    before, middle = vector_of(step.end_rate), jax.lax.stop_gradient(end)
    guard = partial(_first_guard, system, step)
    falls = jax.jvp(guard, (middle,), (before,))[1]
    falls = jnp.where(falls == 0, jnp.inf, falls)
    delay = jnp.where(crossed.any(), -(guard(end) - guard(middle)) / falls, 0.0)
    at_event = transition(system, step.state, crossed, point_of(end + before * delay, step.end))[0]
    after = vector_of(system.field(step.state_after, step.time + step.h, jax.lax.stop_gradient(at_event)))
    return vector_of(at_event) - after * delay


@program
def derivative(
    method: Method, systems: System, steps: Step, count: Int[Array, " batch"], opens: Bool[Array, " batch"]
) -> Float[Array, "batch state state"]:
    """Products over the steps of the derivative of each, in the order of `vector_of`.

    Args:
        method: that of the steps.
        systems: batch first.
        steps: accepted steps in a row of each, the first axis that of the steps, the last one that of the batch.
        count: how many of them there are; rows beyond are empty.
        opens: whether they begin with the state from which the cycles do, which may be moved off the friction cone: w
            of a contact that slips is put back on it.
    """
    systems = batch_last(systems)

    def on_cone(system: System, step: Step, opens: Bool[Array, ""]) -> Float[Array, "state state"]:
        """Derivative of the state from which the first step starts by that from which its lane does."""
        quiet, start = jnp.zeros(step.state.shape, dtype=bool), vector_of(step.start)
        put = lambda y: vector_of(transition(system, step.state, quiet, point_of(y, step.start))[0])  # noqa: E731
        return jnp.where(opens, jax.jacfwd(put)(start), jnp.eye(start.size))

    def push(system: System, step: Step, columns: Float[Array, "state state"]) -> Float[Array, "state state"]:
        image, start = partial(_image, looped(method), system, step), vector_of(step.start)
        return jax.vmap(lambda column: jax.jvp(image, (start,), (column,))[1], in_axes=1, out_axes=1)(columns)

    def body(carry: tuple) -> tuple:
        index, product = carry
        step = jax.tree.map(lambda rows: rows[index], steps)
        return index + 1, jnp.where(index < count, over_lanes(push)(systems, step, product), product)

    product = over_lanes(on_cone)(systems, jax.tree.map(lambda rows: rows[0], steps), opens)
    begin = jnp.zeros((), dtype=jnp.int64), product
    _, product = jax.lax.while_loop(lambda carry: carry[0] < count.max(), body, begin)
    return jnp.moveaxis(product, -1, 0)


class Linear(eqx.Module):
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


def _felt(method: Method, system: System, step: Step) -> System:
    """The system as a step of an explicit method follows it with a disturbance."""
    if not isinstance(method, Explicit | Looped):
        return system
    ends = [(system.motion(point), point.w) for point in (step.start, step.end)]
    return eqx.tree_at(lambda s: s.law, system, system.law.disturbed(step.h, ends))


def weights_of(own: Tableau) -> np.ndarray:
    """Weights of the slopes at the stages and, last, at the end of a step, a row each; slopes of no weight left out."""
    num = int(np.flatnonzero(own.weights)[-1]) + 1
    rows = [np.pad(row, (0, num))[:num] for row in ((), *own.stages[: num - 1], own.weights)]
    return np.array(rows)


@program
def linear(method: Explicit, system: System, steps: Step) -> Linear:
    """`Linear` of steps, the first axis that of the steps; the system is of one trajectory."""
    last = len(weights_of(tableau(method.name))) - 2  # stages behind the first that have a weight

    def one(step: Step) -> Linear:
        felt = _felt(method, system, step)
        turning, begin = Turning.of(felt, step.time, step.h), (step.state, step.time, step.start)
        end, stages = Looped(method.order, method).staged(turning, *begin, turning.field(*begin), step.h)
        end, nodes = turning.real(step.time + step.h, end), jnp.asarray(tableau(method.name).nodes[:last])
        stages = jax.tree.map(lambda rows: rows[:last], stages)
        stages = jax.vmap(turning.real)(step.time + step.h * nodes, stages)
        points = jax.tree.map(lambda y, rows: jnp.concatenate([y[None], rows]), step.start, stages)
        rates = jax.vmap(partial(_by_contact, felt, partial(_rates, felt, step.state)))(points)
        before = step.end_rate
        crossed = step.state != step.state_after
        slip = partial(felt.law.slip_at_transition, step.state)
        first = jnp.arange(crossed.size) == jnp.argmax(crossed)
        guard = first * _by_contact(felt, lambda motion, w: (_ending(felt, step, motion, w)[None],), end)[:, 0]
        falls = (guard * _local(felt, before)).sum()
        at_event = transition(felt, step.state, crossed, end)[0]
        return Linear(
            rates=rates,
            opening=_by_contact(felt, partial(slip, step.state), step.start),
            put=_by_contact(felt, partial(slip, step.state_after), end),
            delay=jnp.where(crossed.any() & (falls != 0), -guard / jnp.where(falls == 0, 1.0, falls), 0.0),
            before=vector_of(before),
            after=vector_of(felt.field(step.state_after, step.time + step.h, at_event)),
        )

    return jax.vmap(one)(steps)


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


MANY = 80
"""Numbers in a state from which on products of whole matrices are quicker: with 68 they take half as long again."""


class Disturbed:
    """Small disturbances of a trajectory, a column each, led through steps of an explicit method.

    They are multiplied by the same derivatives as in `derivative`, but by products of whole matrices.

    Args:
        method: that of the steps.
        system: of one trajectory, its arrays of numpy.
        columns: disturbances before the first step, in the order of `vector_of`.
    """

    def __init__(self, method: Explicit, system: System, columns: np.ndarray):
        own = tableau(method.name)
        self.weights, self.shape = weights_of(own), np.concatenate(system.shape)
        self.nodes = np.concatenate([[0.0], own.nodes])[: len(self.weights) - 1]
        self.contacts, self.modes = system.shape[0].shape
        self.stiffness, self.damping = np.asarray(system.stiffness)[:, None], np.asarray(system.damping)
        self.columns, size = columns, len(columns)
        self._slopes = np.empty((len(self.weights) - 1, size, size))
        self._local = np.empty((2 * len(self.shape) + size - 2 * self.modes, size))

    def lead(self, steps: Linear, h: np.ndarray, *, opens: bool) -> None:
        """Lead them through some steps of lengths h; ``opens``: whether they are the first, as in `derivative`."""
        if opens and len(h):
            self._put(_on_diagonals(steps.opening[0]))
        flat, stages = self._slopes.reshape(len(self._slopes), -1), len(self._slopes)
        rates = _on_diagonals(steps.rates)
        for k, length in enumerate(h):
            weights, turns = length * self.weights, turning_rates(self.stiffness, length, np)
            for stage in range(stages):
                here = np.dot(weights[stage, :stage], flat[:stage]).reshape(self.columns.shape)
                here += self.columns
                after = length * self.nodes[stage]
                self._turn(turns, here, after)
                self._rate(rates[k, stage], turns, here, self._slopes[stage])
                self._turn(turns, self._slopes[stage], -after)
            self.columns = self.columns + np.dot(weights[-1], flat).reshape(self.columns.shape)
            self._turn(turns, self.columns, length)
            if not steps.delay[k].any():
                self._put(_on_diagonals(steps.put[k]))
                continue
            delay = steps.delay[k].ravel() @ self._of_contacts(self.columns)
            self.columns += np.outer(steps.before[k], delay)
            self._put(_on_diagonals(steps.put[k]))
            self.columns -= np.outer(steps.after[k], delay)

    def _of_contacts(self, columns: np.ndarray) -> np.ndarray:
        """Those of the contacts, rows in the order of the disturbance and the contact."""
        ports, modes = len(self.shape), self.modes
        np.dot(self.shape, columns[:modes], out=self._local[:ports])
        np.dot(self.shape, columns[modes : 2 * modes], out=self._local[ports : 2 * ports])
        self._local[2 * ports :] = columns[2 * modes :]
        return self._local

    def _turn(self, rates: np.ndarray, columns: np.ndarray, time: float) -> None:
        """Let the modes of columns turn, as in `Turning`."""
        if rates.any():
            q, p = columns[: self.modes], columns[self.modes : 2 * self.modes]
            q[:], p[:] = turned(rates, q, p, time, np)

    def _rate(self, blocks: np.ndarray, turns: np.ndarray, columns: np.ndarray, rate: np.ndarray) -> None:
        """Write the rate of columns, but for how modes turn."""
        modes, ports = self.modes, len(self.shape)
        q, p, acts = columns[:modes], columns[modes : 2 * modes], blocks @ self._of_contacts(columns)
        rate[:modes], rate[2 * modes :], own = np.where(turns > 0, 0.0, p), acts[ports:], rate[modes : 2 * modes]
        np.dot(self.shape.T, acts[:ports], out=own)
        own -= np.where(turns > 0, 0.0, self.stiffness) * q
        own -= self.damping[:, None] * p if self.damping.ndim == 1 else self.damping @ p

    def _put(self, blocks: np.ndarray) -> None:
        self.columns[2 * self.modes :] = blocks @ self._of_contacts(self.columns)


def _on_diagonals(blocks: np.ndarray) -> np.ndarray:
    """Rows by columns of all contacts, from (..., column, row, contact)."""
    *before, columns, rows, contacts = blocks.shape
    whole, at = np.zeros((*before, rows, contacts, columns, contacts)), np.arange(contacts)
    whole[..., :, at, :, at] = np.moveaxis(blocks, (-1, -2, -3), (0, -2, -1))
    return whole.reshape(*before, rows * contacts, columns * contacts)
