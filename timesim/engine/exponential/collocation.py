"""Exponential collocation: the exact flow of the structure, and contact forces that are polynomials through nodes.

Between transitions the structure is linear, so its flow is known (`timesim.engine.exponential.flow`); only the contact
forces are not. They are taken as the polynomial through their values at the start of the step and at the nodes of
Radau's right-hand rule, and found by sweeps: motion of the contacts from the forces, forces from the motion, until they
no longer change. The modes are exact, however fast they are and wherever a step is cut: the dense output is the flow.

The response to the excitation is known too (`timesim.engine.exponential.steady`), except for what is left to the
polynomial: forces at resonance, and the coupling of the modes.

Sources: E. Hairer & G. Wanner, Solving Ordinary Differential Equations II, section IV.5 (Radau IIA); M. Hochbruck &
A. Ostermann, Exponential integrators, Acta Numerica 19 (2010) 209-286, section 2.2 (collocation).
"""

from timesim.runtime import tree_class  # isort: skip

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from timesim.engine.barrier import apart, matmul
from timesim.engine.exponential.flow import Weights, weights
from timesim.engine.exponential.steady import Steady, coupling, diagonals, steady_of
from timesim.engine.law.contact_law import Motion, Nodes, Plane, Reaction, Scalar, State, Within
from timesim.engine.law.rule import Rule
from timesim.engine.system import Point, System, contact_force
from timesim.model.model import SLIP

CONVERGED = 1e-3  # change that sweeps leave undone, in the tolerance of a step
MOST_SWEEPS = 12
ERROR = 0.1  # of what the highest power does: measured, a tolerance of 1e-4 to 1e-8 then leaves about as much after
# 20 cycles of 20 modes with 3 contacts (benchmarks/README.md)
NUM_RUNGS = 64  # of lengths: the shortest is 3e-10 of the longest
ON_RUNG = 1e-6  # of a rung: rounding of its length
SLOWEST = 0.7  # ratio of changes from which on a shorter step costs less than more sweeps


@tree_class
class Flow:
    """Motion of the modes at the nodes of a step, per unit of what it starts from and of the force at each node.

    Attributes:
        h: length of the step.
        q_q, q_p, p_q, p_p: from displacement and velocity at the start, (node, mode).
        q_force, p_force: from the modal force at the start and the nodes, (node, node, mode).
    """

    h: Float[Array, ""]
    q_q: Array
    q_p: Array
    p_q: Array
    p_p: Array
    q_force: Array
    p_force: Array

    @classmethod
    def of(cls, system: System, rule: Rule, h: Float[Array, "*length"]) -> "Flow":
        """For steps of one length, or of many: then that is the first axis of all."""
        nodes = jnp.asarray(rule.nodes[1:])[:, None]
        flow = weights(*diagonals(system), h[..., None, None] * nodes, h[..., None, None], len(rule.nodes))
        by_power = (jnp.stack(part, axis=-2) for part in (flow.q_force, flow.p_force))
        q_force, p_force = (jnp.einsum("...jpm,pk->...jkm", part, jnp.asarray(rule.monomials)) for part in by_power)
        return cls(h, flow.q_q, flow.q_p, flow.p_q, flow.p_p, q_force, p_force)


@tree_class
class Ladder:
    """What steps of a system need, computed once: the motion that the excitation forces, and flows.

    These are for lengths that halve every second rung, longest first; their axis is the first.
    """

    flows: Flow
    steady: Steady

    @classmethod
    def of(cls, system: System, rule: Rule, longest: Float[Array, ""]) -> "Ladder":
        return cls(Flow.of(system, rule, longest * 2.0 ** (-0.5 * jnp.arange(NUM_RUNGS))), Steady.of(system))

    def rung(self, wanted: Float[Array, ""], needed: Float[Array, ""]) -> Flow:
        """The longest flow no longer than wanted, or the shortest one as long as needed where that is shorter."""
        at = 2 * jnp.log2(self.flows.h[0] / jnp.stack([wanted, needed]))
        index = jnp.maximum(jnp.ceil(at[0] - ON_RUNG), jnp.floor(at[1] + ON_RUNG)).astype(int)
        return jax.tree.map(lambda rows: rows[jnp.clip(index, 0, NUM_RUNGS - 1)], self.flows)


@tree_class
class Inside:
    """What a step holds between its ends: polynomials of the fraction of its length, coefficients lowest first.

    Attributes:
        force: of the modal force, (power, mode).
        inner: of what the law iterates on, (power, contact).
        h: length of the step as it was taken, however early it was cut.
        q, p: displacement and velocity of the modes at the start and the nodes, (node, mode).
        f, w: friction force and slip of the contacts there, components of shape (node, contact).
        lost: power that they lose otherwise there, see `timesim.engine.law.contact_law.Reaction`.
    """

    force: Float[Array, "power mode"]
    inner: PyTree
    h: Float[Array, ""]
    q: Float[Array, "node mode"]
    p: Float[Array, "node mode"]
    f: Plane
    w: Plane
    lost: Scalar | None


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
        motion: of the contacts.
        acts: forces of the contacts.
        force: modal force that the polynomial begins with, shape (1, mode).
        q, p: displacement and velocity of the modes at the nodes without contact forces, shape (node, mode).
        left: force there that the steady motion leaves to the polynomial.
    """

    state: State
    w: Plane
    motion: Motion
    acts: Reaction
    force: Array
    q: Array
    p: Array
    left: Array


class Guess(NamedTuple):
    """What sweeps improve: modal force at the nodes, and inner values of the contacts at the start and the nodes."""

    force: Float[Array, "node mode"]
    inner: PyTree


def solve(
    system: System,
    flow: Flow,
    state: State,
    time: Float[Array, ""],
    point: Point,
    *,
    rule: Rule,
    tolerance: Float[Array, ""],
) -> Solved:
    """A step with every contact keeping its state, from a time within the cycle and the continuous state there.

    ``tolerance``: error that is allowed.
    """
    start = _start(tuple(rule.nodes.tolist()), system, flow, state, time, point)
    inner = system.law.inner(state, start.motion, point.w)
    constant = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(rule.nodes), *x.shape)), inner)
    guess = Guess(jnp.broadcast_to(start.force, start.q.shape), constant)
    sweep = partial(_sweep, rule, system, flow, start)
    guess, converged = _swept(sweep, guess, tolerance)
    q, p, nodes, within = _at_nodes(rule, system, flow, start, guess)
    power = jnp.asarray(rule.monomials)
    force = matmul(power, jnp.concatenate([start.force, guess.force]))
    first, rest = (point.q, point.p, start.acts.f, start.acts.lost), (q, p, within.f, within.lost)
    q, p, f, lost = jax.tree.map(lambda own, others: jnp.concatenate([own[None], others]), first, rest)
    inner = jax.tree.map(lambda x: matmul(power, x), within.inner)
    inside = Inside(force, inner, flow.h, q, p, f, nodes.w, lost)
    end = Point(q[-1], p[-1], tuple(w[-1] for w in within.w), None)
    return Solved(end, _error(rule, system, flow.h, state, force[-1], nodes.w), converged, nodes, inside)


@apart
def state_inside(system: System, start: tuple[State, Array, Point], inside: Inside, x: Float[Array, ""]) -> Point:
    """The continuous state at a fraction of a step, from its start: state of the contacts, time and point."""
    span = x * inside.h
    flow = weights(*diagonals(system), span, inside.h, inside.force.shape[0])
    q, p = modes_after(system, *start[1:], inside, span, flow)
    return point_inside(system, start, inside, x, q, p)


def modes_after(
    system: System, time: Float[Array, ""], point: Point, inside: Inside, span: Float[Array, ""], flow: Weights
) -> tuple[Array, Array]:
    """Displacement and velocity of the modes at a time after the start of a step, by the flow until there."""
    steady = steady_of(system)
    (q0, p0), (q, p) = (steady.motion(system, t[None]) for t in (time, time + span))
    z, dz = point.q - q0, point.p - p0
    q = q + flow.q_q * z + flow.q_p * dz + sum(w * f for w, f in zip(flow.q_force, inside.force, strict=True))
    p = p + flow.p_q * z + flow.p_p * dz + sum(w * f for w, f in zip(flow.p_force, inside.force, strict=True))
    return q, p


def point_inside(
    system: System, start: tuple[State, Array, Point], inside: Inside, x: Float[Array, ""], q: Array, p: Array
) -> Point:
    """The continuous state at a fraction of a step where the modes are known."""
    state, _, point = start
    here = Point(q, p, point.w, None)
    powers = x ** jnp.arange(inside.force.shape[0])
    inner = jax.tree.map(lambda c: powers @ c, inside.inner)
    return replace(here, w=system.law.slip_inside(state, point.w, system.motion(here), inner))


@partial(apart, static=(0,))
def _start(nodes: tuple[float, ...], system: System, flow: Flow, state: State, time: Array, point: Point) -> Start:
    steady = steady_of(system)
    times = time + flow.h * jnp.asarray(nodes)[:, None]
    q, p = steady.motion(system, times)
    left = steady.remainder(system, times)
    z, dz = point.q - q[0], point.p - p[0]
    motion = system.motion(point)
    acts = system.law.reaction(state, motion, point.w)
    force = _modal_force(system, tuple(f[None] for f in acts.f), acts.n[None], left[:1])
    force = force + coupling(system, point.p[None])
    free_q, free_p = q[1:] + flow.q_q * z + flow.q_p * dz, p[1:] + flow.p_q * z + flow.p_p * dz
    return Start(state, point.w, motion, acts, force, free_q, free_p, left[1:])


def _modal_force(system: System, f: Plane, n: Scalar, left: Array) -> Array:
    """Modal force of the contacts, at one place or at several, and what is left of the excitation."""
    force = jnp.concatenate(contact_force(system, f, n), axis=-1)
    return left + matmul(force, jnp.concatenate(system.shape))


def _at_nodes(rule: Rule, system: System, flow: Flow, start: Start, guess: Guess) -> tuple[Array, Array, Nodes, Within]:
    """Displacements and velocities of modes and contacts at the nodes, and what the contacts do there."""
    force = jnp.concatenate([start.force, guess.force])
    q, p = start.q + (flow.q_force * force).sum(axis=1), start.p + (flow.p_force * force).sum(axis=1)
    moves = matmul(jnp.concatenate([q, p]), jnp.concatenate(system.shape).T)
    parts = jnp.split(moves, len(system.shape), axis=1)
    x, dx = (tuple(part[rows] for part in parts) for rows in (slice(0, len(q)), slice(len(q), None)))
    motion = Motion(x[:-1], x[-1], dx[:-1], dx[-1])
    within = system.law.collocated(start.state, start.w, motion, guess.inner, flow.h, rule)
    first = start.motion
    pairs = (((*first.u, first.v), x), ((*first.du, first.dv), dx), (start.w, within.w))
    whole = (tuple(jnp.concatenate([a[None], b]) for a, b in zip(*pair, strict=True)) for pair in pairs)
    return q, p, Nodes(*whole), within


@apart
def _sweep(rule: Rule, system: System, flow: Flow, start: Start, guess: Guess) -> tuple[Guess, Float[Array, ""]]:
    """A better guess, and how much the velocity changes with it."""
    _, p, _, within = _at_nodes(rule, system, flow, start, guess)
    force = _modal_force(system, within.f, within.n, start.left) + coupling(system, p)
    return Guess(force, within.inner), flow.h * jnp.abs(force - guess.force).max()


def _swept(
    sweep: Callable[[Guess], tuple[Guess, Array]], guess: Guess, tolerance: Array
) -> tuple[Guess, Bool[Array, ""]]:
    """Sweep until nothing changes; and whether that has been reached."""

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


def _error(rule: Rule, system: System, h: Array, state: State, highest: Array, w: Plane) -> Point:
    """What the highest power does in a step to the modes, and what it is in the slip of contacts that slip."""
    stiffness, damping = diagonals(system)
    reach = jnp.maximum(jnp.sqrt(stiffness), damping) * h
    p = ERROR * rule.share * h * jnp.abs(highest) / jnp.maximum(1.0, reach)
    slip = tuple(
        jnp.where(state == SLIP, ERROR * rule.share * (jnp.asarray(rule.monomials[-1]) @ own), 0.0) for own in w
    )
    return Point(jnp.zeros_like(p), p, slip, None)
