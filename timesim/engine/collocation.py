"""Exponential collocation: the exact flow of the structure, and contact forces that are polynomials through nodes.

Between transitions the structure is linear, so its flow is known (`timesim.engine.flow`); only the contact forces are
not. They are taken as the polynomial through their values at the start of the step and at the nodes of Radau's right-hand
rule, and found by sweeps: motion of the contacts from the forces, forces from the motion, until they no longer change.
The modes are exact, however fast they are and wherever a step is cut: the dense output is the flow itself.

The excitation has its own steady motion in every mode, ``a_i cos(i theta) + b_i sin(i theta)``; where that would be far
larger than what the force does in a step (light damping, at resonance), the force is taken into the polynomial instead.
So is what couples the modes: a damping matrix or stuck contacts that they do not diagonalise.

Sources: E. Hairer & G. Wanner, Solving Ordinary Differential Equations II, section IV.5 (Radau IIA); M. Hochbruck &
A. Ostermann, Exponential integrators, Acta Numerica 19 (2010) 209-286, section 2.2 (collocation).
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from timesim.engine.barrier import apart
from timesim.engine.flow import Weights, weights
from timesim.engine.guard import Nodes
from timesim.engine.law.contact_law import Motion, Plane, Scalar, State, Within
from timesim.engine.law.rule import Rule, rule_of
from timesim.engine.system import Point, System, contact_force
from timesim.model.model import SLIP

NEAR_RESONANCE = 1e-3  # of |k - i^2 + i d| in k + i^2: below it the force is taken into the polynomial
CONVERGED = 1e-3  # change that sweeps leave undone, in the tolerance of a step
MOST_SWEEPS = 12
SLOWEST = 0.7  # ratio of changes from which on a shorter step costs less than more sweeps


class Steady(eqx.Module):
    """The motion that each harmonic of the excitation forces on each mode: cosine and sine parts, (harmonic, mode).

    Attributes:
        a, b: cosine and sine part.
        left: 1 where a force has no such motion and is left to the polynomial, else 0.
    """

    a: Float[Array, "harmonic mode"]
    b: Float[Array, "harmonic mode"]
    left: Float[Array, "harmonic mode"]

    @classmethod
    def of(cls, system: System) -> "Steady":
        stiffness, damping = diagonals(system)
        order = system.harmonic[:, None]
        reactance, loss = stiffness - order**2, damping * order
        square, size = reactance**2 + loss**2, (stiffness + order**2) * NEAR_RESONANCE
        near = square < size**2
        inverse = jnp.where(near, 0.0, 1 / jnp.where(near, 1.0, square))
        a = (reactance * system.cosine - loss * system.sine) * inverse
        b = (reactance * system.sine + loss * system.cosine) * inverse
        return cls(a, b, jnp.where(near, 1.0, 0.0))

    def motion(self, system: System, time: Float[Array, "*node 1"]) -> tuple[Array, Array]:
        """Displacement and velocity at times within the cycle."""
        order = system.harmonic[:, None]
        q = p = jnp.zeros((*time.shape[:-1], system.constant.shape[0]))
        for i in range(order.shape[0]):
            angle = order[i] * (time + system.phase)
            cosine, sine = jnp.cos(angle), jnp.sin(angle)
            q = q + self.a[i] * cosine + self.b[i] * sine
            p = p + order[i] * (self.b[i] * cosine - self.a[i] * sine)
        return q, p

    def remainder(self, system: System, time: Float[Array, "*node 1"]) -> Array:
        """Modal force at times within the cycle that the steady motion leaves to the polynomial."""
        force = jnp.broadcast_to(system.constant, (*time.shape[:-1], system.constant.shape[0]))
        for i in range(system.harmonic.shape[0]):
            angle = system.harmonic[i] * (time + system.phase)
            force = force + self.left[i] * (system.cosine[i] * jnp.cos(angle) + system.sine[i] * jnp.sin(angle))
        return force


def diagonals(system: System) -> tuple[Array, Array]:
    """Stiffness and damping of the modes that the flow is exact in."""
    return tuple(x if x.ndim == 1 else jnp.diagonal(x) for x in (system.stiffness, system.damping))


def coupling(system: System, q: Float[Array, "*node mode"], p: Float[Array, "*node mode"]) -> Array:
    """Modal force by which stiffness and damping couple the modes: what the matrices add to their diagonals."""
    force = jnp.zeros_like(q)
    for matrix, x in ((system.stiffness, q), (system.damping, p)):
        if matrix.ndim == 2:
            force = force + x @ (matrix - jnp.diag(jnp.diagonal(matrix))).T
    return force


class Inside(eqx.Module):
    """What a step holds between its ends: polynomials of the fraction of its length, coefficients lowest first.

    Attributes:
        force: of the modal force, (power, mode).
        inner: of what the law iterates on, (power, contact).
        h: length of the step as it was taken, however early it was cut.
    """

    force: Float[Array, "power mode"]
    inner: PyTree
    h: Float[Array, ""]


class Solved(NamedTuple):
    """A step: its end, its error, whether the sweeps have converged, and what lies between its ends."""

    end: Point
    error: Point
    converged: Bool[Array, ""]
    nodes: Nodes
    inside: Inside


class Start(NamedTuple):
    """The start of a step.

    Attributes:
        state: of the contacts during the step.
        time: within the cycle.
        point: continuous state.
        motion: of the contacts.
        force: modal force that the polynomial begins with, shape (1, mode).
        free: motion of the nodes without contact forces.
    """

    state: State
    time: Float[Array, ""]
    point: Point
    motion: Motion
    force: Float[Array, "one mode"]
    free: "Free"


class Free(NamedTuple):
    """The nodes of a step without contact forces, arrays of shape (node, mode).

    Attributes:
        q, p: displacement and velocity.
        left: force that the steady motion leaves to the polynomial.
        weights: of the flow from the start.
    """

    q: Array
    p: Array
    left: Array
    weights: Weights


class Guess(NamedTuple):
    """What the sweeps improve: modal force at the nodes, and inner values of the contacts at the start and the nodes."""

    force: Float[Array, "node mode"]
    inner: PyTree


def solve(
    system: System,
    state: State,
    time: Float[Array, ""],
    point: Point,
    h: Float[Array, ""],
    *,
    num_nodes: int,
    tolerance: Float[Array, ""] | None,
) -> Solved:
    """A step with every contact keeping its state.

    Args:
        system: the system.
        state: states of the contacts.
        time: start of the step within the cycle.
        point: continuous state there.
        h: length.

    Keyword Args:
        num_nodes: of the rule.
        tolerance: error that is allowed; None to sweep as often as is needed in any case, so that the derivative is
            that of the solution.
    """
    rule = rule_of(num_nodes)
    start = _start(rule, system, state, time, point, h)
    inner = system.law.inner(state, start.motion, point.w)
    constant = jax.tree.map(lambda x: jnp.broadcast_to(x, (num_nodes + 1, *x.shape)), inner)
    guess = Guess(jnp.broadcast_to(start.force, start.free.q.shape), constant)
    guess, converged = _swept(partial(_sweep, rule, system, start, h), guess, tolerance)
    q, p, nodes, within = _at_nodes(rule, system, start, h, guess)
    power = jnp.asarray(rule.monomials)
    force = power @ jnp.concatenate([start.force, guess.force])
    inside = Inside(force, jax.tree.map(lambda x: power @ x, within.inner), h)
    end = Point(q[-1], p[-1], tuple(w[-1] for w in within.w), None)
    return Solved(end, _error(rule, system, state, force[-1], nodes.w, h), converged, nodes, inside)


@apart
def state_inside(system: System, start: tuple[State, Array, Point], inside: Inside, x: Float[Array, ""]) -> Point:
    """The continuous state at a fraction of a step, from its start: state of the contacts, time and point."""
    state, time, point = start
    span, num = x * inside.h, inside.force.shape[0]
    flow = _weights(*diagonals(system), span, inside.h, num)
    steady = Steady.of(system)
    (q0, p0), (q, p) = (steady.motion(system, t[None]) for t in (time, time + span))
    z, dz = point.q - q0, point.p - p0
    q = q + flow.q_q * z + flow.q_p * dz + sum(w * f for w, f in zip(flow.q_force, inside.force, strict=True))
    p = p + flow.p_q * z + flow.p_p * dz + sum(w * f for w, f in zip(flow.p_force, inside.force, strict=True))
    here = Point(q, p, point.w, None)
    powers = x ** jnp.arange(num)
    inner = jax.tree.map(lambda c: powers @ c, inside.inner)
    return eqx.tree_at(lambda y: y.w, here, system.law.slip_inside(state, point.w, system.motion(here), inner))


@partial(apart, static=(4,))
def _weights(stiffness: Array, damping: Array, t: Array, h: Array, num: int) -> Weights:
    return weights(stiffness, damping, t, h, num, jnp)


@apart
def _start(rule: Rule, system: System, state: State, time: Array, point: Point, h: Array) -> Start:
    steady, nodes = Steady.of(system), jnp.asarray(rule.nodes)[:, None]
    q, p = steady.motion(system, time + h * nodes)
    left = steady.remainder(system, time + h * nodes)
    flow = _weights(*diagonals(system), h * nodes[1:], h, nodes.shape[0])
    z, dz = point.q - q[0], point.p - p[0]
    free = Free(q[1:] + flow.q_q * z + flow.q_p * dz, p[1:] + flow.p_q * z + flow.p_p * dz, left[1:], flow)
    motion = system.motion(point)
    acts = system.law.reaction(state, motion, point.w)
    force = _modal_force(system, acts.f, acts.n, left[0]) - coupling(system, point.q, point.p)
    return Start(state, time, point, motion, force[None], free)


def _modal_force(system: System, f: Plane, n: Scalar, left: Array) -> Array:
    """Modal force of the contacts, at one place or at several, and what is left of the excitation."""
    for axis, force in zip(system.shape, contact_force(system, f, n), strict=True):
        left = left + force @ axis
    return left


def _at_nodes(rule: Rule, system: System, start: Start, h: Array, guess: Guess) -> tuple[Array, Array, Nodes, Within]:
    """Displacements and velocities of modes and contacts at the nodes, and what the contacts do there."""
    force = jnp.asarray(rule.monomials) @ jnp.concatenate([start.force, guess.force])
    q, p = start.free.q, start.free.p
    for power, to_q, to_p in zip(force, start.free.weights.q_force, start.free.weights.p_force, strict=True):
        q, p = q + to_q * power, p + to_p * power
    x, dx = (tuple(y @ axis.T for axis in system.shape) for y in (q, p))
    motion = Motion(x[:-1], x[-1], dx[:-1], dx[-1])
    within = system.law.collocated(start.state, start.point.w, motion, guess.inner, h, rule)
    first = start.motion
    pairs = (((*first.u, first.v), x), ((*first.du, first.dv), dx), (start.point.w, within.w))
    parts = (tuple(jnp.concatenate([a[None], b]) for a, b in zip(*pair, strict=True)) for pair in pairs)
    return q, p, Nodes(*parts), within


@apart
def _sweep(rule: Rule, system: System, start: Start, h: Array, guess: Guess) -> tuple[Guess, Float[Array, ""]]:
    """A better guess, and how much the velocity changes with it."""
    q, p, _, within = _at_nodes(rule, system, start, h, guess)
    force = _modal_force(system, within.f, within.n, start.free.left) - coupling(system, q, p)
    return Guess(force, within.inner), h * jnp.abs(force - guess.force).max()


def _swept(
    sweep: Callable[[Guess], tuple[Guess, Array]], guess: Guess, tolerance: Array | None
) -> tuple[Guess, Bool[Array, ""]]:
    """Sweep until nothing changes, or as often as is needed in any case."""
    if tolerance is None:
        return jax.lax.fori_loop(0, MOST_SWEEPS, lambda _, now: sweep(now)[0], guess), jnp.asarray(True)

    def left(before: Array, change: Array) -> Array:
        """Change that is still to come if each sweep changes less in the ratio of the last two."""
        ratio = jnp.minimum(change / jnp.maximum(before, 1e-300), 1.0)
        return change * ratio / jnp.maximum(1 - ratio, 1e-3)

    def goes_on(carry: tuple) -> Array:
        _, before, change, count = carry
        slow = (count > 3) & (change > SLOWEST * before)
        return (count < 2) | ((left(before, change) > CONVERGED * tolerance) & ~slow & (count < MOST_SWEEPS))

    def body(carry: tuple) -> tuple:
        guess, _, before, count = carry
        guess, change = sweep(guess)
        return guess, before, change, count + 1

    big = jnp.full((), 1e300)
    guess, before, change, _ = jax.lax.while_loop(goes_on, body, (guess, big, big, jnp.zeros((), dtype=jnp.int64)))
    return guess, left(before, change) <= CONVERGED * tolerance


def _error(rule: Rule, system: System, state: State, highest: Array, w: Plane, h: Array) -> Point:
    """What the highest power does in a step to the modes, and what it is in the slip of contacts that slip."""
    stiffness, damping = diagonals(system)
    reach = jnp.maximum(jnp.sqrt(stiffness), damping) * h
    p = rule.share * h * jnp.abs(highest) / jnp.maximum(1.0, reach)
    slip = tuple(jnp.where(state == SLIP, rule.share * (jnp.asarray(rule.monomials[-1]) @ own), 0.0) for own in w)
    return Point(jnp.zeros_like(p), p, slip, None)
