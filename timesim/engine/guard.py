"""Where inside a step the first transition lies.

Every contact's margins are followed over the step on its dense output, at several points and not only at the end: two
crossings within a step would cancel there. The place of a crossing is a proposal: the event loop takes the step
again up to it, and decides there, on the solution itself.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from timesim.engine import dense_output as hermite
from timesim.engine.barrier import apart, matmul
from timesim.engine.law.contact_law import ContinuousState, Dynamics, Motion, Nodes, Path, Plane, State
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

Margins = tuple[Float[Array, "*node contact"], Float[Array, "*node contact"]]


class Segment(eqx.Module):
    """A step as the contacts see it.

    Attributes:
        start, end: relative motion at its ends with two derivatives.
        slip_start, slip_end: slip there with one.
        path: coefficients of the polynomial of each component of the motion, the normal one last.
        slip: coefficients of that of each component of the slip.
        h: length of the step.
    """

    start: Path
    end: Path
    slip_start: tuple[Plane, Plane]
    slip_end: tuple[Plane, Plane]
    path: tuple[tuple[Array, ...], ...]
    slip: tuple[tuple[Array, ...], ...]
    h: Float[Array, ""]


@apart
def segment(
    dynamics: Dynamics,
    points: tuple[ContinuousState, ContinuousState],
    rates: tuple[ContinuousState, ContinuousState],
    h: Float[Array, ""],
) -> Segment:
    """The contacts' view of a step, from the states and rates at its ends."""
    starts, ends = (dynamics.path(*end) for end in zip(points, rates, strict=True))
    slips = [(y.w, dy.w) for y, dy in zip(points, rates, strict=True)]

    def change(x0: Array, v0: Array, a0: Array, x1: Array, v1: Array, a1: Array) -> Array:
        smooth, difference = h * (0.5 * (v0 + v1) + h / 12 * (a0 - a1)), x1 - x0
        # In an implicit step of stiff contacts they need not agree, and where the dense output ends beside the
        # solution, a step that overshoots is cut shorter without end.
        agree = jnp.abs(smooth - difference) <= AGREEMENT * (1 + jnp.abs(x1))
        return jnp.where((h < SHORT) & agree, smooth, difference)

    path = tuple(
        hermite.quintic_coefficients(h, row[:3], row[3:], change(*row)) for row in zip(*starts, *ends, strict=True)
    )
    slip = tuple(hermite.cubic_coefficients(h, row[:2], row[2:]) for row in zip(*slips[0], *slips[1], strict=True))
    return Segment(starts, ends, slips[0], slips[1], path, slip, h)


def segment_of_nodes(
    dynamics: Dynamics,
    points: tuple[ContinuousState, ContinuousState],
    rates: tuple[ContinuousState, ContinuousState],
    h: Float[Array, ""],
    nodes: Nodes,
    rule: Rule,
) -> Segment:
    """The contacts' view of a step that is known at more places than its ends."""
    starts, ends = (dynamics.path(*end) for end in zip(points, rates, strict=True))
    slips = [(y.w, dy.w) for y, dy in zip(points, rates, strict=True)]
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
    return Segment(starts, ends, slips[0], slips[1], path, slip, h)


@apart
def shortened(
    dynamics: Dynamics, part: Segment, end: ContinuousState, rate: ContinuousState, h: Float[Array, ""]
) -> Segment:
    """The segment with another end, at which the state and its rate are known; its polynomials stay those of it all."""
    where = lambda s: (s.end, s.slip_end, s.h)  # noqa: E731
    return eqx.tree_at(where, part, (dynamics.path(end, rate), (end.w, rate.w), h))


@apart
def margins_inside(dynamics: Dynamics, state: State, part: Segment, x: Float[Array, "*#node #contact"]) -> Margins:
    """Margins on the dense output at fractions x of the step, made dimensionless by their scale."""
    along = [hermite.evaluate(x, polynomial) for polynomial in part.path]
    value, rate = tuple(u for u, _ in along), tuple(du / part.h for _, du in along)
    w = tuple(hermite.evaluate(x, polynomial)[0] for polynomial in part.slip)
    return _margins(dynamics, state, value, rate, w)


def _margins(dynamics: Dynamics, state: State, x: Plane, dx: Plane, w: Plane) -> Margins:
    force, speed = dynamics.law.margins(state, Motion(x[:-1], x[-1], dx[:-1], dx[-1]), w)
    return force / dynamics.law.scale(), speed


def _margins_at(dynamics: Dynamics, state: State, ends: Path, slip: tuple[Plane, Plane]) -> tuple[Margins, Margins]:
    """Margins at an end of the step and their exact rates."""
    (x, dx, ddx), (w, dw) = ends, slip
    return jax.jvp(partial(_margins, dynamics, state), (x, dx, w), (dx, ddx, dw))


def end_margins(dynamics: Dynamics, state: State, part: Segment) -> tuple[Margins, Margins]:
    """Margins at the end of the step and their exact rates."""
    return _margins_at(dynamics, state, part.end, part.slip_end)


def first_crossing(
    dynamics: Dynamics,
    state: State,
    part: Segment,
    end: Margins,
    end_rate: Margins,
    spared: tuple[Bool[Array, " contact"], ...],
    *,
    doubt: float = 0.0,
) -> Float[Array, ""]:
    """Fraction of the step at which the first margin falls through zero, `NONE` where none does.

    Also a margin that only dips below zero between two nodes is proposed, judged by a parabola through three of them,
    and next to an end by the rate there: a step that stops just short of a dip is followed by one that begins with it.
    To end a step there needlessly does no harm.

    Args:
        dynamics: the system.
        state: states of the contacts during the step.
        part: the step.
        end, end_rate: margins at its end and their rates.
        spared: margins that are allowed to be negative at the end, because their transition is taken there.

    Keyword Args:
        doubt: share of the second difference of a margin above zero from which a dip is proposed too.
    """
    if state.shape[0] == 0:
        return jnp.asarray(NONE)
    inner = margins_inside(dynamics, state, part, jnp.arange(NUM_NODES)[:, None] / NUM_NODES)
    _, start_rate = _margins_at(dynamics, state, part.start, part.slip_start)
    nodes, dips = [], []
    for margin, last, spare, falls, rises in zip(inner, end, spared, start_rate, end_rate, strict=True):
        # A step starts on a guard after each transition: what is there is rounding, and no crossing.
        first = [jnp.maximum(margin[0], 0.0), *(margin[i] for i in range(1, NUM_NODES))]
        node = [*first, jnp.where(spare, jnp.maximum(last, 0.0), last)]
        nodes.append(node)
        after = _edge_dip(node[0], part.h / NUM_NODES * falls, node[1], doubt)
        before = _edge_dip(node[-1], -part.h / NUM_NODES * rises, node[-2], doubt)
        dips += [_dip(node, doubt), after, jnp.where(before < NONE, 1 - before, NONE)]
    return jnp.stack([_root(dynamics, state, part, nodes), *(dip.min() for dip in dips)]).min()


def first_exit(
    dynamics: Dynamics, state: State, part: Segment, reach: Float[Array, ""]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Fraction of a step at which it is to be cut, and whether a contact leaves its state there.

    Args:
        dynamics: the system.
        state: states of the contacts during the step.
        part: the step.
        reach: fraction up to which the step is needed.
    """
    none = jnp.zeros(state.shape, dtype=bool)
    ends = end_margins(dynamics, state, part)
    crossing = first_crossing(dynamics, state, part, *ends, (none, none), doubt=DOUBT)
    return jnp.clip(crossing, SHORTEST / part.h, reach), crossing <= reach


def end_on_guard(
    dynamics: Dynamics,
    state: State,
    at: Callable[[Array], tuple[ContinuousState, ContinuousState]],
    whole: tuple[Array, ContinuousState, ContinuousState],
    cut: tuple[Array, Array, Array],
    off: Float[Array, ""],
) -> tuple[Float[Array, ""], ContinuousState, ContinuousState]:
    """Length of a step that is cut, and the continuous state and its rate there.

    Args:
        dynamics: the system.
        state: states of the contacts during the step.
        at: the continuous state and its rate after a time since the start of the step, as good as at its end.
        whole: what is returned of a step that is not cut.
        cut: time at which it is to be cut, whether a contact leaves its state there, and how far it may be moved.
        off: time from a guard that is near enough.
    """
    near, leaves, reach = cut

    def goes_on(carry: tuple) -> Array:
        _, (span, _, _), (left, count) = carry
        # Held by a bound the end is as near as it can be.
        return (count == 0) | ((jnp.abs(left) > off) & (carry[0] != span) & (count < NUM_CORRECTIONS))

    def corrected(carry: tuple) -> tuple:
        span, _, (_, count) = carry
        end = at(span)
        left = jnp.where(leaves, _time_to_guard(dynamics, state, *end, NEARBY * whole[0]), 0.0)
        return jnp.clip(span + left, SHORTEST, reach), (span, *end), (left, count + 1)

    none = jnp.zeros(()), jnp.zeros((), dtype=jnp.int64)
    # One place in the loop where the flow is evaluated: each is compiled anew.
    end: tuple[Array, ContinuousState, ContinuousState] = jax.lax.while_loop(goes_on, corrected, (near, whole, none))[1]
    return end


def _time_to_guard(
    dynamics: Dynamics, state: State, point: ContinuousState, rate: ContinuousState, most: Float[Array, ""]
) -> Float[Array, ""]:
    """Time to the first zero of a falling margin that is at most so far ahead or behind; 0 if there is none."""
    margin, slope = _margins_at(dynamics, state, dynamics.path(point, rate), (point.w, rate.w))
    soonest = jnp.full((), jnp.inf)
    for value, falls in zip(margin, slope, strict=True):
        time = -value / jnp.where(falls < 0, falls, -1.0)
        near = (falls < 0) & (jnp.abs(time) <= most)
        soonest = jnp.minimum(soonest, jnp.where(near, time, jnp.inf).min(initial=jnp.inf))
    return jnp.where(jnp.isfinite(soonest), soonest, 0.0)


@apart
def arriving(
    margin: Margins, slope: Margins, h: Float[Array, ""], last: Bool[Array, ""], reach: Float[Array, ""]
) -> tuple[Margins, tuple[Bool[Array, " contact"], ...]]:
    """Time from the end of the step to the zero of each margin, and which of them take their transition there.

    A margin that is still violated after the shortest step has jumped through zero: that is a transition too. So is one
    that is negative by no more than rounding and falling, however slowly.

    Args:
        margin, slope: at the end of the step, and their rates.
        h: its length.
        last: whether it is to end a cycle, beyond which no transition is taken.
        reach: time from a guard that a correction may span.
    """
    times, due = [], []
    for value, rate in zip(margin, slope, strict=True):
        time = -value / jnp.where(rate < 0, rate, -1.0)
        near = (rate < 0) & (jnp.abs(time) <= reach) & ~(last & (time > 0))
        passed = (rate < 0) & (value <= 0) & (value >= -TOGETHER)
        jumped = (h <= 1.01 * SHORTEST) & (value < -VIOLATED)
        times.append(jnp.where(near, time, 0.0))
        due.append(near | passed | jumped)
    return (times[0], times[1]), (due[0], due[1])


@apart
def _bracket(node: list[Array]) -> tuple[Array, Array, Array]:
    """Right end of the first bracket (in nodes; beyond the step if none), and the values at its ends."""
    right, low, high = jnp.full(node[0].shape, NONE * NUM_NODES), node[0], node[0]
    for i in range(NUM_NODES, 0, -1):
        below = node[i] < -VIOLATED
        right = jnp.where(below, i, right)
        low, high = jnp.where(below, node[i - 1], low), jnp.where(below, node[i], high)
    return right, low, high


def _root(dynamics: Dynamics, state: State, part: Segment, nodes: list[list[Array]]) -> Float[Array, ""]:
    """First root of each contact's margins in their first bracket; the least of them.

    Illinois method: M. Dowell & P. Jarratt, A modified regula falsi method for computing the root of an equation,
    BIT 11 (1971) 168-174.
    """
    (right, low_a, high_a), (other, low_b, high_b) = (_bracket(node) for node in nodes)
    second = other < right
    right = jnp.where(second, other, right)
    crosses = right <= NUM_NODES
    f_high = jnp.minimum(jnp.where(second, high_b, high_a), -VIOLATED)
    # A left value that is rounding would draw every secant to the left end, and the event would re-fire for ever.
    f_low = jnp.maximum(jnp.where(second, low_b, low_a), -1e-3 * f_high)
    low, high = (right - 1) / NUM_NODES, right / NUM_NODES
    side = jnp.zeros_like(low)
    for _ in range(NUM_SECANTS):
        x = low - f_low * (high - low) / (f_high - f_low)
        force, speed = margins_inside(dynamics, state, part, x)
        f = jnp.where(second, speed, force)
        inside = f > 0
        f_high = jnp.where(inside, jnp.where(side > 0, 0.5 * f_high, f_high), jnp.minimum(f, -1e-300))
        f_low = jnp.where(inside, f, jnp.where(side < 0, 0.5 * f_low, f_low))
        low, high = jnp.where(inside, x, low), jnp.where(inside, high, x)
        side = jnp.where(inside, 1.0, -1.0)
    x = low - f_low * (high - low) / (f_high - f_low)
    return jnp.where(crosses, x, NONE).min()


@partial(apart, static=(1,))
def _dip(node: list[Array], doubt: float) -> Float[Array, " contact"]:
    """First interior minimum below zero, or hardly above, of the parabolas through three nodes at a time."""
    first = jnp.full(node[0].shape, NONE)
    for i in range(NUM_NODES - 1, 0, -1):
        left, middle, right = node[i - 1 : i + 2]
        curvature, slope = left - 2 * middle + right, right - left
        lowest = middle * curvature - slope**2 / 8 < (doubt * curvature - VIOLATED) * curvature
        inside = (middle <= left) & (middle <= right) & (middle >= -VIOLATED) & (left > 0) & (curvature > 0)
        where = (i - 0.5 * slope / jnp.where(curvature > 0, curvature, 1.0)) / NUM_NODES
        first = jnp.where(inside & lowest, where, first)
    return first


@partial(apart, static=(3,))
def _edge_dip(edge: Array, slope: Array, next_node: Array, doubt: float) -> Float[Array, " contact"]:
    """Minimum below zero of the parabola from an end of the step, with its slope there, to the node next to it.

    Or hardly above zero, unless it is no lower than the end itself: a step starts on a guard after each transition.
    """
    curvature = next_node - edge - slope
    inside = (slope < 0) & (-slope < 2 * curvature) & (edge >= 0) & (next_node >= -VIOLATED)
    near = jnp.where(edge > doubt * curvature, doubt * curvature, 0.0) - VIOLATED
    lowest = edge * curvature - 0.25 * slope**2 < near * curvature
    where = -0.5 * slope / jnp.where(inside, curvature, 1.0) / NUM_NODES
    return jnp.where(inside & lowest, where, NONE)
