"""Where inside a step the first transition lies.

Every contact's margins are followed over the step on its dense output, at several points and not only at the end: two
crossings within a step would cancel there. What is found is a proposal; the event loop steps to it again, and only
there, on the solution itself, decides.
"""

import timesim.jax_setup  # noqa: F401  isort: skip

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from timesim import hermite
from timesim.contact import Motion, State, margins
from timesim.system import Point, System, relative

NUM_NODES = 6
VIOLATED = 1e-12  # of the margin's own scale: below it a margin is rounding
NUM_SECANTS = 5
SHORT = 1e-3  # in shorter steps the change of displacement is better had from the velocities than as a difference
NONE = 2.0  # a fraction beyond the step

Margins = Float[Array, "contact guard"]


class Segment(eqx.Module):
    """A step as the contacts see it: relative motion with two derivatives, and slip with one, at both ends."""

    start: tuple[Array, Array, Array]
    end: tuple[Array, Array, Array]
    jump: Array
    slip_start: tuple[Array, Array]
    slip_end: tuple[Array, Array]
    h: Float[Array, ""]


def segment(system: System, points: tuple[Point, Point], rates: tuple[Point, Point], h: Float[Array, ""]) -> Segment:
    """The contacts' view of a step."""
    ends = [tuple(relative(system, x) for x in (y.q, y.p, dy.p)) for y, dy in zip(points, rates, strict=True)]
    slips = [(y.w, dy.w) for y, dy in zip(points, rates, strict=True)]
    (x0, v0, a0), (x1, v1, a1) = ends
    jump = jnp.where(h < SHORT, h * (0.5 * (v0 + v1) + h / 12 * (a0 - a1)), x1 - x0)
    return Segment((x0, v0, a0), (x1, v1, a1), jump, slips[0], slips[1], h)


def margins_inside(system: System, state: State, part: Segment, x: Float[Array, " contact"]) -> Margins:
    """Margins on the dense output, each contact at its own fraction of the step; of order one."""
    column = x[:, None]
    value, rate = hermite.quintic(column, part.h, part.start, part.end, part.jump)
    w = hermite.cubic(column, part.h, part.slip_start, part.slip_end)
    moves = Motion(value[:, :-1], value[:, -1], rate[:, :-1], rate[:, -1])
    return margins(system.law, state, moves, w) / system.margin_scale


def end_margins(system: System, state: State, part: Segment) -> tuple[Margins, Margins]:
    """Margins at the end of the step and their exact rates."""

    def at(u: Array, du: Array, w: Array) -> Margins:
        moves = Motion(u[:, :-1], u[:, -1], du[:, :-1], du[:, -1])
        return margins(system.law, state, moves, w) / system.margin_scale

    (u, du, ddu), (w, dw) = part.end, part.slip_end
    return jax.jvp(at, (u, du, w), (du, ddu, dw))


def first_crossing(system: System, state: State, part: Segment, end: Margins, spared: Array) -> Float[Array, ""]:
    """Fraction of the step at which the first margin falls through zero, `NONE` where none does.

    Also a margin that only dips below zero between two nodes, judged by a parabola through three of them, is
    proposed: to end a step there needlessly does no harm.

    Args:
        end: margins at the end of the step, shape (C, 2).
        spared: margins that are allowed to be negative at the end, because their transition is taken there.
    """
    if state.shape[0] == 0:
        return jnp.asarray(NONE)
    at = jax.vmap(lambda x: margins_inside(system, state, part, jnp.full(state.shape, x)))
    inner = at(jnp.arange(NUM_NODES) / NUM_NODES)
    # A step starts on a guard after each transition: what is there is rounding, and no crossing.
    start = jnp.maximum(inner[:1], 0.0)
    last = jnp.where(spared, jnp.maximum(end, 0.0), end)
    nodes = jnp.concatenate([start, inner[1:], last[None]])
    below = nodes < -VIOLATED
    first = jnp.argmax(below, axis=0)
    first = jnp.where(below.any(axis=0), first, NUM_NODES + 1)
    guard = jnp.argmin(first, axis=1)
    right = jnp.take_along_axis(first, guard[:, None], axis=1)[:, 0]
    crossing = _root(system, state, part, nodes, guard, right)
    return jnp.minimum(crossing.min(), _dip(nodes))


def _root(system: System, state: State, part: Segment, nodes: Array, guard: Array, right: Array) -> Array:
    """Root of one margin of each contact in the bracket that ends at its node ``right``, by the Illinois rule."""
    found = right <= NUM_NODES
    high_node = jnp.where(found, right, NUM_NODES)

    def pick(node: Array) -> Array:
        chosen = jnp.take_along_axis(nodes, node[None, :, None], axis=0)[0]
        return jnp.take_along_axis(chosen, guard[:, None], axis=1)[:, 0]

    low, high = (high_node - 1) / NUM_NODES, high_node / NUM_NODES
    f_high = jnp.minimum(pick(high_node), -VIOLATED)
    # A left value that is rounding would draw every secant to the left end, and the event would re-fire for ever.
    f_low = jnp.maximum(pick(high_node - 1), 1e-3 * jnp.abs(f_high))
    side = jnp.zeros_like(guard)
    for _ in range(NUM_SECANTS):
        x = low - f_low * (high - low) / (f_high - f_low)
        values = margins_inside(system, state, part, x)
        f = jnp.take_along_axis(values, guard[:, None], axis=1)[:, 0]
        inside = f > 0
        f_high = jnp.where(inside, jnp.where(side == 1, 0.5 * f_high, f_high), jnp.minimum(f, -1e-300))
        f_low = jnp.where(inside, f, jnp.where(side == -1, 0.5 * f_low, f_low))
        low, high = jnp.where(inside, x, low), jnp.where(inside, high, x)
        side = jnp.where(inside, 1, -1)
    x = low - f_low * (high - low) / (f_high - f_low)
    return jnp.where(found, x, NONE)


def _dip(nodes: Array) -> Float[Array, ""]:
    """First interior minimum below zero of the parabolas through three nodes at a time."""
    left, middle, right = nodes[:-2], nodes[1:-1], nodes[2:]
    curvature = left - 2 * middle + right
    slope = right - left
    inside = (middle <= left) & (middle <= right) & (curvature > 0) & (middle >= -VIOLATED) & (left > 0)
    curvature = jnp.where(curvature > 0, curvature, 1.0)
    lowest = middle - slope**2 / (8 * curvature)
    index = jnp.arange(1, NUM_NODES)[:, None, None]
    where = (index - 0.5 * slope / curvature) / NUM_NODES
    return jnp.where(inside & (lowest < -VIOLATED), where, NONE).min()
