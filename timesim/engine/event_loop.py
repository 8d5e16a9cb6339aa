"""The event loop: one compiled loop over steps that ends every step on the earliest transition.

A step is tried with every contact keeping its state. If some contact leaves its state inside the step, the step is
tried again with the length at which the first of them does so; if it then ends on the guard, the transition is
taken there. No inner loop: many trajectories run side by side, and those that are done wait. The last remainder of a
guard is removed by one Newton correction of the time, which also makes the derivative with respect to parameters
pass through the transition exactly.

A call advances by a number of cycles, or until its record of steps is full: memory does not grow with the cycles.
"""

from timesim.runtime import Leaf  # isort: skip

import enum
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from timesim.engine.barrier import apart
from timesim.engine.contact import State, force_scale, slip_at_transition, successor
from timesim.engine.guard import NONE, VIOLATED, Margins, end_margins, first_crossing, segment
from timesim.engine.method import Method
from timesim.engine.system import Point, System, field, motion

PERIOD = 2 * jnp.pi
# A landing closer than this is corrected by an Euler step, whose error is half its square.
LANDING = 1e-8
TOGETHER = 1e-11  # margins this close to zero at a transition are crossed at the same instant
SHORTEST = 1e-13  # steps below it are rounding


class Status(enum.IntEnum):
    """How a trajectory stands. All but RUNNING end it."""

    RUNNING = 0
    ZENO = 1
    TOO_SHORT = 2
    BUDGET = 3
    NOT_FINITE = 4


class Control(eqx.Module):
    """Tolerances of the step size, relative to the largest coordinate and to the scene's scale.

    Attributes:
        rtol, atol: tolerance a step is ``rtol * max|state| + atol``.
        longest: longest step, and the step of a method without error estimate [rad of the excitation].
        opening: first step of each cycle. The control forgets at a cycle's end: what a cycle makes of a state depends
            on that state alone, so a settled motion repeats to rounding, and a run taken up again is the same run.
        budget: most steps tried in a cycle.
        stiffest: highest circular frequency of the structure, in units of the excitation's.
    """

    rtol: Float[Leaf, ""]
    atol: Float[Leaf, ""]
    longest: Float[Leaf, ""]
    opening: Float[Leaf, ""]
    budget: Int[Leaf, ""]
    stiffest: Float[Leaf, ""]


class Trajectory(eqx.Module):
    """Everything that a trajectory goes on from.

    Attributes:
        cycle: cycles completed.
        time: phase within the cycle, in [0, 2 pi).
        point, rate: continuous state and its rate.
        state: state of each contact.
        length: step the error control asks for.
        limit: length proposed for the step that is tried again; infinite where none is.
        last_error: error of the last accepted step, for the controller.
        since: time since the last transition.
        repeats: transitions in a row with no time between them.
        tried: steps tried in this cycle.
        status: see `Status`.
        culprit: contact of the last transition.
    """

    cycle: Int[Leaf, ""]
    time: Float[Leaf, ""]
    point: Point
    rate: Point
    state: State
    length: Float[Leaf, ""]
    limit: Float[Leaf, ""]
    last_error: Float[Leaf, ""]
    since: Float[Leaf, ""]
    repeats: Int[Leaf, ""]
    tried: Int[Leaf, ""]
    status: Int[Leaf, ""]
    culprit: Int[Leaf, ""]


class Step(eqx.Module):
    """One accepted step: what dense output and event log are made from. ``state_after`` differs at a transition."""

    cycle: Int[Array, ""]
    time: Float[Array, ""]
    h: Float[Array, ""]
    start: Point
    start_rate: Point
    end: Point
    end_rate: Point
    state: State
    state_after: State


def begin(system: System, point: Point, state: State, length: Float[Array, ""]) -> Trajectory:
    """A trajectory at the start of a cycle."""
    zero, none = jnp.zeros(()), jnp.zeros((), dtype=jnp.int64)
    rate = field(system, state, zero, point)
    one = jnp.ones(())
    return Trajectory(none, zero, point, rate, state, length, one * jnp.inf, one, one, none, none, none, none)


@apart
def error_size(control: Control, point: Point, error: Point) -> Float[Array, ""]:
    """Error of a step relative to its tolerance."""
    size = jnp.maximum(jnp.abs(point.q).max(), jnp.abs(point.p).max())
    worst = jnp.maximum(jnp.abs(error.q).max(), jnp.abs(error.p).max())
    for w in error.w:
        worst = jnp.maximum(worst, jnp.abs(w).max(initial=0.0))
    return worst / (control.atol + control.rtol * size)


def try_step(
    method: Method, control: Control, system: System, now: Trajectory
) -> tuple[Trajectory, Step, Bool[Array, ""]]:
    """Try one step; the trajectory after it, the step, and whether it was accepted."""
    remaining = PERIOD - now.time
    wanted = jnp.minimum(now.length, now.limit)
    last = wanted >= remaining * (1 - 1e-9)
    # The length of a step is no function of the parameters; only what is left of a cycle after an event is.
    h = jnp.where(last, remaining, jax.lax.stop_gradient(wanted))
    end, rate, error = method.advance(partial(field, system, now.state), now.time, now.point, now.rate, h)
    size = jnp.zeros(()) if error is None else error_size(control, end, error)
    size = jnp.where(jnp.isfinite(size), size, 1e9)
    precise = size <= 1

    part = segment(system, (now.point, end), (now.rate, rate), h)
    margin, slope = end_margins(system, now.state, part)
    to_zero, due = arriving(control, margin, slope, h, last)
    crossing = first_crossing(system, now.state, part, margin, slope, due)
    accepted = precise & (crossing >= NONE)
    lands = accepted & (due[0] | due[1]).any()
    soonest = [jnp.where(d, t, jnp.inf).min(initial=jnp.inf) for d, t in zip(due, to_zero, strict=True)]
    correction = jnp.where(lands, jnp.minimum(*soonest), 0.0)
    left = tuple(d & (m + correction * s <= TOGETHER) for d, m, s in zip(due, margin, slope, strict=True))
    crossed = lands & (left[0] | left[1])
    h_full = h + correction
    end = jax.tree.map(lambda y, dy: y + correction * dy, end, rate)
    after, state = transition(system, now.state, crossed, end)
    step = Step(now.cycle, now.time, h_full, now.point, now.rate, end, rate, now.state, state)

    length = next_length(method, control, now, size, h, precise)
    fraction = jnp.where(crossing < NONE, crossing, 1.0)
    limit = jnp.where(precise & (crossing < NONE), jnp.maximum(fraction * h, SHORTEST), jnp.inf)
    moved = advanced(system, now, after, state, h_full, last & ~(lands & (correction < 0)), crossed)
    kept = eqx.tree_at(lambda t: t.limit, now, jnp.where(accepted, jnp.inf, limit))
    result = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), moved, kept)
    ended = accepted & (result.cycle > now.cycle)
    tried = jnp.where(ended, 0, now.tried + 1)
    length = jnp.where(ended, control.opening, length)
    last_error = jnp.where(ended, 1.0, jnp.where(accepted, jnp.maximum(size, 1e-4), now.last_error))
    where = lambda t: (t.length, t.last_error, t.tried)  # noqa: E731
    result = eqx.tree_at(where, result, (length, last_error, tried))
    return judged(control, result), step, accepted


@apart
def arriving(
    control: Control, margin: Margins, slope: Margins, h: Array, last: Array
) -> tuple[Margins, tuple[Bool[Array, " contact"], ...]]:
    """Time from the end of the step to the zero of each margin, and which of them take their transition there.

    A margin that is still violated after the shortest step has jumped through zero: that is a transition too. So is one
    that is negative by no more than rounding and falling, however slowly.
    """
    reach = LANDING / control.stiffest
    times, due = [], []
    for value, rate in zip(margin, slope, strict=True):
        time = -value / jnp.where(rate < 0, rate, -1.0)
        near = (rate < 0) & (jnp.abs(time) <= reach) & ~(last & (time > 0))
        passed = (rate < 0) & (value <= 0) & (value >= -10 * VIOLATED)
        jumped = (h <= 1.01 * SHORTEST) & (value < -VIOLATED)
        times.append(jnp.where(near, time, 0.0))
        due.append(near | passed | jumped)
    return (times[0], times[1]), (due[0], due[1])


@apart
def transition(system: System, state: State, crossed: Bool[Array, " contact"], end: Point) -> tuple[Point, State]:
    """Point and states after the transitions of the contacts that have crossed a guard.

    Of a contact that slips on, w is put back on the cone: its drift, small as it is, would grow beyond the friction
    force itself where n passes close by zero.
    """
    moves = motion(system, end)
    next_state = jnp.where(crossed, successor(system.law, state, moves, tiny=1e-10 * force_scale(system.law)), state)
    w = slip_at_transition(system.law, state, next_state, moves, end.w)
    return Point(end.q, end.p, w, end.work), next_state


def next_length(
    method: Method, control: Control, now: Trajectory, size: Array, h: Array, precise: Array
) -> Float[Array, ""]:
    """Step length for the next try: PI control; a step cut short by an event or a cycle's end slows nothing."""
    floor = jnp.maximum(size, 1e-10)
    power = 1 / method.order
    grown = h * jnp.clip(0.9 * floor ** (-0.7 * power) * now.last_error ** (0.4 * power), 0.2, 8.0)
    shrunk = h * jnp.clip(0.9 * floor ** (-power), 0.1, 0.9)
    cut = h < now.length * (1 - 1e-9)
    length = jnp.where(precise, jnp.where(cut & (grown < now.length), now.length, grown), shrunk)
    return jnp.minimum(length, control.longest)


@apart
def advanced(
    system: System, now: Trajectory, point: Point, state: State, h: Array, ends: Array, crossed: Array
) -> Trajectory:
    """The trajectory after an accepted step."""
    time = now.time + h
    ends = ends | (time >= PERIOD * (1 - 1e-15))
    time = jnp.where(ends, 0.0, time)
    since = now.since + h
    switched = crossed.any()
    repeats = jnp.where(switched & (since < 1e-9), now.repeats + 1, jnp.where(since < 1e-9, now.repeats, 0))
    return Trajectory(
        cycle=now.cycle + ends,
        time=time,
        point=point,
        rate=field(system, state, time, point),
        state=state,
        length=now.length,
        limit=jnp.full((), jnp.inf),
        last_error=now.last_error,
        since=jnp.where(switched, 0.0, since),
        repeats=repeats,
        tried=now.tried,
        status=now.status,
        culprit=jnp.where(switched, jnp.argmax(crossed) if crossed.size else 0, now.culprit),
    )


@apart
def judged(control: Control, now: Trajectory) -> Trajectory:
    """The trajectory with its status: what ends it early is data here, and a message at the boundary."""
    finite = jnp.isfinite(now.point.q).all() & jnp.isfinite(now.point.p).all()
    status = jnp.where(now.tried >= control.budget, Status.BUDGET, now.status)
    status = jnp.where(now.length < SHORTEST, Status.TOO_SHORT, status)
    status = jnp.where(now.repeats > 100, Status.ZENO, status)
    status = jnp.where(finite, status, Status.NOT_FINITE)
    return eqx.tree_at(lambda t: t.status, now, status)


@eqx.filter_jit
def advance(
    method: Method, control: Control, system: System, start: Trajectory, cycles: Int[Array, ""], capacity: int
) -> tuple[Trajectory, Step, Int[Array, ""]]:
    """Advance one trajectory until it has completed ``cycles`` cycles, ended early, or filled its record.

    Returns:
        The trajectory, the accepted steps (leading axis ``capacity``), and how many there are.
    """
    blank = jax.eval_shape(partial(try_step, method, control, system), start)[1]
    record = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), blank)

    def goes_on(carry: tuple) -> Array:
        now, _, count = carry
        return (now.cycle < cycles) & (now.status == Status.RUNNING) & (count < capacity)

    def body(carry: tuple) -> tuple:
        now, record, count = carry
        now, step, accepted = try_step(method, control, system, now)
        record = jax.tree.map(lambda rows, row: rows.at[count].set(row), record, step)
        return now, record, count + accepted

    return jax.lax.while_loop(goes_on, body, (start, record, jnp.zeros((), dtype=jnp.int64)))


SIDE_BY_SIDE = 32  # trajectories whose numbers stay in the nearest caches, also with many modes and contacts


@eqx.filter_jit
def march(
    method: Method, control: Control, systems: System, start: Trajectory, cycles: Int[Array, " batch"]
) -> tuple[Trajectory, Int[Array, " batch"]]:
    """Advance a batch until each has completed its number of cycles or ended early; nothing is recorded.

    A large batch is marched a part after the other.

    Args:
        method: the method.
        control: its tolerances, the same for all or with the batch as their first axis.
        systems: the systems, batch first.
        start: the trajectories, batch first.
        cycles: cycles that each is to have completed.

    Returns:
        The trajectories, and the number of transitions of each.
    """
    size = cycles.shape[0]
    if size <= SIDE_BY_SIDE:
        return _march_together(method, control, systems, start, cycles)
    lanes = (jnp.arange(-(-size // SIDE_BY_SIDE) * SIDE_BY_SIDE) % size).reshape(-1, SIDE_BY_SIDE)

    def part(chosen: Int[Array, " part"]) -> tuple[Trajectory, Int[Array, " part"]]:
        own = jax.tree.map(lambda leaf: leaf[chosen] if leaf.ndim else leaf, control)
        return _march_together(method, own, *jax.tree.map(lambda leaf: leaf[chosen], (systems, start, cycles)))

    done = jax.lax.map(part, lanes)
    whole: tuple[Trajectory, Array] = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:size], done)
    return whole


def _march_together(
    method: Method, control: Control, systems: System, start: Trajectory, cycles: Int[Array, " batch"]
) -> tuple[Trajectory, Int[Array, " batch"]]:
    """Inside, the batch is the last axis: the kernels run along it."""
    per_run = jax.tree.map(lambda leaf: -1 if leaf.ndim else None, control)
    attempt = jax.vmap(partial(try_step, method), in_axes=(per_run, -1, -1), out_axes=-1)
    systems, start = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), (systems, start))

    def running(now: Trajectory) -> Array:
        return (now.cycle < cycles) & (now.status == Status.RUNNING)

    def body(carry: tuple) -> tuple:
        now, count = carry
        moves = running(now)
        new, step, accepted = attempt(control, systems, now)
        switched = (step.state != step.state_after).sum(axis=0)
        count = count + jnp.where(moves & accepted, switched, 0)
        return jax.tree.map(lambda a, b: jnp.where(moves, a, b), new, now), count

    count = jnp.zeros(cycles.shape, dtype=jnp.int64)
    end, count = jax.lax.while_loop(lambda carry: running(carry[0]).any(), body, (start, count))
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), end), count
