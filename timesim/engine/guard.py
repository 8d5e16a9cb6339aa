"""Where inside a step the first transition lies.

Every contact's margins are followed over the step on its dense output, at several points and not only at the end: two
crossings within a step would cancel there. The place of a crossing is a proposal: the event loop takes the step
again up to it, and decides there, on the solution itself.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from timesim.engine import dense_output as hermite
from timesim.engine.barrier import apart, matmul
from timesim.engine.lanes import where_needed
from timesim.engine.law.contact_law import AnyState, Dynamics, Motion, Nodes, Path, Plane, State
from timesim.engine.law.rule import Rule
from timesim.engine.tolerance import AGREEMENT, SHORT, SHORTEST, TOGETHER, VIOLATED

NUM_NODES = 6
NUM_SECANTS = 3
NUM_CORRECTIONS = 8  # of the time at which a step is cut: the force of its polynomial is not quite that of the law, so
# that each leaves a share of what was missing; two or three are the rule
NEARBY = 0.02  # of a step, in which such a correction lies
DOUBT = 0.01
"""Share of the second difference of a margin by which a parabola may err over the long steps of collocation: without it
4 of 22 touches of 1e-6 of the motion went unseen, and 15 of 1e-7."""
NONE = 2.0  # a fraction beyond the step

Margins: TypeAlias = Float[Array, "*node margin contact"]
"""The two margins of each contact, the force in units of its scale."""
Ends: TypeAlias = tuple[AnyState, AnyState]
"""At the start and at the end of a step."""


class Segment(eqx.Module):
    """A step as the contacts see it.

    Attributes:
        margin, slope: margins at both ends and their rates, shape (2, margin, contact).
        path: coefficients of the polynomial of each component of the motion, the normal one last.
        slip: coefficients of that of each component of the slip.
    """

    margin: Margins
    slope: Margins
    path: tuple[tuple[Array, ...], ...]
    slip: tuple[tuple[Array, ...], ...]
    h: Float[Array, ""]


@apart
def segment(dynamics: Dynamics, state: State, points: Ends, rates: Ends, h: Float[Array, ""]) -> Segment:
    """The contacts' view of a step, from the states and rates at its ends."""
    paths, slips = _ends(dynamics, points, rates)

    def change(x0: Array, v0: Array, a0: Array, x1: Array, v1: Array, a1: Array) -> Array:
        smooth, difference = h * (0.5 * (v0 + v1) + h / 12 * (a0 - a1)), x1 - x0
        # In an implicit step of stiff contacts they need not agree, and where the dense output ends beside the
        # solution, a step that overshoots is cut shorter without end.
        agree = jnp.abs(smooth - difference) <= AGREEMENT * (1 + jnp.abs(x1))
        return jnp.where((h < SHORT) & agree, smooth, difference)

    path = tuple(
        hermite.quintic_coefficients(h, row[:3], row[3:], change(*row))
        for row in zip(*paths[0], *paths[1], strict=True)
    )
    slip = tuple(hermite.cubic_coefficients(h, row[:2], row[2:]) for row in zip(*slips[0], *slips[1], strict=True))
    return Segment(*_at_ends(dynamics, state, paths, slips), path, slip, h)


def segment_of_nodes(
    dynamics: Dynamics, state: State, points: Ends, rates: Ends, h: Float[Array, ""], nodes: Nodes, rule: Rule
) -> Segment:
    """The contacts' view of a step that is known at more places than its ends."""
    hermite, monomials = jnp.asarray(rule.hermite), jnp.asarray(rule.monomials)
    integral = np.zeros((len(rule.hermite), len(rule.nodes)))
    integral[1 : len(rule.nodes) + 1] = rule.monomials / np.arange(1, len(rule.nodes) + 1)[:, None]

    def through(x: Array, dx: Array) -> tuple[Array, ...]:
        # In a short step the change of the values has few digits, and its slope none.
        by_values = matmul(hermite, jnp.concatenate([x - x[:1], h * dx]))
        rows = jnp.where(h < SHORT, matmul(jnp.asarray(integral), h * dx), by_values)
        return x[0], *(rows[i] for i in range(1, len(rule.hermite)))

    path = tuple(through(*component) for component in zip(nodes.x, nodes.dx, strict=True))
    slip = tuple(tuple(row for row in matmul(monomials, w)) for w in nodes.w)
    return Segment(*_at_ends(dynamics, state, *_ends(dynamics, points, rates)), path, slip, h)


def _ends(dynamics: Dynamics, points: Ends, rates: Ends) -> tuple[tuple[Path, Path], tuple[tuple, tuple]]:
    """Relative motion at both ends of a step with two derivatives, and slip with one."""
    start, end = (dynamics.path(*one) for one in zip(points, rates, strict=True))
    first, last = ((y.w, dy.w) for y, dy in zip(points, rates, strict=True))
    return (start, end), (first, last)


@apart
def margins_inside(dynamics: Dynamics, state: State, part: Segment, x: Float[Array, "*#node #contact"]) -> Margins:
    """Margins on the dense output at fractions x of the step."""
    along = [hermite.evaluate(x, polynomial) for polynomial in part.path]
    value, rate = tuple(u for u, _ in along), tuple(du / part.h for _, du in along)
    w = tuple(hermite.evaluate(x, polynomial)[0] for polynomial in part.slip)
    return _margins(dynamics, state, value, rate, w)


def _margins(dynamics: Dynamics, state: State, x: Plane, dx: Plane, w: Plane) -> Margins:
    force, other = dynamics.law.margins(state, Motion(x[:-1], x[-1], dx[:-1], dx[-1]), w)
    return jnp.stack([force / dynamics.law.scale(state), other], axis=-2)


def _margins_at(dynamics: Dynamics, state: State, path: Path, slip: tuple[Plane, Plane]) -> tuple[Margins, Margins]:
    """Margins at one or several places and their exact rates, from the motion with two derivatives and the slip."""
    (x, dx, ddx), (w, dw) = path, slip
    return jax.jvp(partial(_margins, dynamics, state), (x, dx, w), (dx, ddx, dw))


def _at_ends(dynamics: Dynamics, state: State, paths: tuple, slips: tuple) -> tuple[Margins, Margins]:
    """Margins at both ends of a step and their rates."""
    return _margins_at(dynamics, state, *jax.tree.map(lambda *ends: jnp.stack(ends), *zip(paths, slips, strict=True)))


def first_crossing(
    dynamics: Dynamics,
    state: State,
    part: Segment,
    spared: Bool[Array, "margin contact"] | bool = False,
    *,
    doubt: float = 0.0,
) -> Float[Array, ""]:
    """Fraction of the step at which the first margin falls through zero, `NONE` where none does.

    A margin that only dips below zero between two nodes is proposed as well, judged by a parabola through three of
    them, and next to an end by the rate there: a step that stops just short of a dip is followed by one that begins
    with it. Ending a step there needlessly does no harm.

    ``spared``: margins that are allowed to be negative at the end, because their transition is taken there.
    ``doubt``: share of the second difference of a margin above zero from which a dip is proposed too.
    """
    if state.shape[0] == 0:
        return jnp.asarray(NONE)
    first, last = part.margin
    # A step starts on a guard after each transition: what is there is rounding, and no crossing.
    first, last = jnp.maximum(first, 0.0), jnp.where(spared, jnp.maximum(last, 0.0), last)
    inside = margins_inside(dynamics, state, part, jnp.arange(1, NUM_NODES)[:, None] / NUM_NODES)
    node = jnp.concatenate([first[None], inside, last[None]])
    falls, rises = part.h / NUM_NODES * part.slope
    after, before = _edge_dip(first, falls, node[1], doubt), _edge_dip(last, -rises, node[-2], doubt)
    dips = (_dip(node, doubt), after.min(), jnp.where(before < NONE, 1 - before, NONE).min())
    through = partial(_root, dynamics, state, part, node)
    root = where_needed(dynamics.by_itself, (node[1:] < -VIOLATED).any(), through, jnp.full((), NONE))
    return jnp.stack([root, *dips]).min()


class End(NamedTuple):
    """Length of a step; the continuous state at its end, and margins of the contacts there, each with its rate."""

    h: Float[Array, ""]
    point: AnyState
    rate: AnyState
    margin: Margins
    slope: Margins


def end_on_guard(
    dynamics: Dynamics,
    state: State,
    at: Callable[[Array], tuple[AnyState, AnyState]],
    whole: End,
    cut: tuple[Array, Array, Array],
    off: Float[Array, ""],
) -> End:
    """The end of a step that is cut.

    Args:
        dynamics, state: the system, and the states of its contacts during the step.
        at: the continuous state and its rate after a time since the start of the step, as good as at its end.
        whole: the end of the step that is not cut.
        cut: time at which it is to be cut, whether a contact leaves its state there, and how far it may be moved.
        off: time from a guard that is near enough.
    """
    near, leaves, reach = cut

    def goes_on(carry: tuple) -> Array:
        span, end, left, count = carry
        # Held by a bound the end is as near as it can be.
        return (count == 0) | ((jnp.abs(left) > off) & (span != end.h) & (count < NUM_CORRECTIONS))

    def corrected(carry: tuple) -> tuple:
        span, _, _, count = carry
        point, rate = at(span)
        margin, slope = _margins_at(dynamics, state, dynamics.path(point, rate), (point.w, rate.w))
        left = jnp.where(leaves, _time_to_guard(margin, slope, NEARBY * whole.h), 0.0)
        return jnp.clip(span + left, SHORTEST, reach), End(span, point, rate, margin, slope), left, count + 1

    none = jnp.zeros(()), jnp.zeros((), dtype=jnp.int64)
    # One place in the loop where the flow is evaluated: each is compiled anew.
    return jax.lax.while_loop(goes_on, corrected, (near, whole, *none))[1]


def _time_to_guard(margin: Margins, slope: Margins, most: Float[Array, ""]) -> Float[Array, ""]:
    """Time to the first zero of a falling margin that is at most so far ahead or behind; 0 if there is none."""
    time = -margin / jnp.where(slope < 0, slope, -1.0)
    near = (slope < 0) & (jnp.abs(time) <= most)
    soonest = jnp.where(near, time, jnp.inf).min(initial=jnp.inf)
    return jnp.where(jnp.isfinite(soonest), soonest, 0.0)


def indivisible(h: Float[Array, ""]) -> Bool[Array, ""]:
    """Whether a step cannot be cut any shorter."""
    return h <= 1.01 * SHORTEST


@apart
def arriving(
    margin: Margins, slope: Margins, h: Float[Array, ""], last: Bool[Array, ""], reach: Float[Array, ""]
) -> tuple[Margins, Bool[Array, "margin contact"]]:
    """Time from the end of the step to the zero of each margin, and which of them take their transition there.

    A margin that is still violated after the shortest step has jumped through zero: that is a transition too. So is one
    that is negative by no more than rounding and falling, however slowly.

    Args:
        margin, slope: at the end of the step, and their rates.
        last: whether it is to end a cycle, beyond which no transition is taken.
        reach: time from a guard that a correction may span.
    """
    time = -margin / jnp.where(slope < 0, slope, -1.0)
    near = (slope < 0) & (jnp.abs(time) <= reach) & ~(last & (time > 0))
    passed = (slope < 0) & (margin <= 0) & (margin >= -TOGETHER)
    jumped = indivisible(h) & (margin < -VIOLATED)
    return jnp.where(near, time, 0.0), near | passed | jumped


@apart
def _bracket(node: Margins) -> tuple[Array, Array, Array]:
    """Right end of the first bracket (in nodes; beyond the step if none), and the values at its ends."""
    right, low, high = jnp.full(node[0].shape, NONE * NUM_NODES), node[0], node[0]
    for i in range(NUM_NODES, 0, -1):
        below = node[i] < -VIOLATED
        right = jnp.where(below, i, right)
        low, high = jnp.where(below, node[i - 1], low), jnp.where(below, node[i], high)
    return right, low, high


def _root(dynamics: Dynamics, state: State, part: Segment, node: Margins) -> Float[Array, ""]:
    """First root of each contact's margins in their first bracket; the least of them.

    Illinois method: M. Dowell & P. Jarratt, A modified regula falsi method for computing the root of an equation,
    BIT 11 (1971) 168-174.
    """
    bracket = _bracket(node)
    second = bracket[0][1] < bracket[0][0]
    right, f_low, f_high = (jnp.where(second, end[1], end[0]) for end in bracket)
    crosses = right <= NUM_NODES
    f_high = jnp.minimum(f_high, -VIOLATED)
    # A left value that is rounding would draw every secant to the left end, and the event would re-fire for ever.
    f_low = jnp.maximum(f_low, -1e-3 * f_high)

    def secant(low: Array, high: Array, f_low: Array, f_high: Array) -> Array:
        return low - f_low * (high - low) / (f_high - f_low)

    def nearer(_: Array, carry: tuple) -> tuple:
        *ends, side = carry
        low, high, f_low, f_high = ends
        x = secant(*ends)
        force, other = margins_inside(dynamics, state, part, x)
        f = jnp.where(second, other, force)
        inside = f > 0
        f_high = jnp.where(inside, jnp.where(side > 0, 0.5 * f_high, f_high), jnp.minimum(f, -1e-300))
        f_low = jnp.where(inside, f, jnp.where(side < 0, 0.5 * f_low, f_low))
        low, high = jnp.where(inside, x, low), jnp.where(inside, high, x)
        return low, high, f_low, f_high, jnp.where(inside, 1.0, -1.0)

    begin = ((right - 1) / NUM_NODES, right / NUM_NODES, f_low, f_high, jnp.zeros_like(right))
    *ends, _ = jax.lax.fori_loop(0, NUM_SECANTS, nearer, begin)
    return jnp.where(crosses, secant(*ends), NONE).min()


@partial(apart, static=(1,))
def _dip(node: Margins, doubt: float) -> Float[Array, ""]:
    """First interior minimum below zero, or hardly above, of the parabolas through three nodes at a time."""
    left, middle, right = node[:-2], node[1:-1], node[2:]
    curvature, slope = left - 2 * middle + right, right - left
    lowest = middle * curvature - slope**2 / 8 < (doubt * curvature - VIOLATED) * curvature
    inside = (middle <= left) & (middle <= right) & (middle >= -VIOLATED) & (left > 0) & (curvature > 0)
    index = jnp.arange(1, NUM_NODES)[:, None, None]
    where = (index - 0.5 * slope / jnp.where(curvature > 0, curvature, 1.0)) / NUM_NODES
    return jnp.where(inside & lowest, where, NONE).min()


@partial(apart, static=(3,))
def _edge_dip(edge: Margins, slope: Margins, next_node: Margins, doubt: float) -> Margins:
    """Minimum below zero of the parabola from an end of the step, with its slope there, to the node next to it.

    Or hardly above zero, unless it is no lower than the end itself: a step starts on a guard after each transition.
    """
    curvature = next_node - edge - slope
    inside = (slope < 0) & (-slope < 2 * curvature) & (edge >= 0) & (next_node >= -VIOLATED)
    near = jnp.where(edge > doubt * curvature, doubt * curvature, 0.0) - VIOLATED
    lowest = edge * curvature - 0.25 * slope**2 < near * curvature
    where = -0.5 * slope / jnp.where(inside, curvature, 1.0) / NUM_NODES
    return jnp.where(inside & lowest, where, NONE)
