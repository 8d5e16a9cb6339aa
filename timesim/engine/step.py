"""One step of the event loop, ended on the earliest transition.

A step is tried with every contact keeping its state. If some contact leaves its state inside the step, the step is
tried again with the length at which the first of them does so; if it then ends on the guard, the transition is
taken there. No inner loop: many trajectories run side by side, and those that are done wait. A step of collocation is
cut there instead, in a loop of its own; such trajectories go one by one. The last remainder of a guard is removed by
one Newton correction of the time, which also makes the derivative with respect to parameters pass through the
transition exactly.
"""

from timesim.runtime import Leaf, tree_class  # isort: skip

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from timesim.engine import guard
from timesim.engine.barrier import apart
from timesim.engine.exponential.collocation import Inside, state_inside
from timesim.engine.lanes import where_needed
from timesim.engine.law.contact_law import AnyState, Dynamics, State
from timesim.engine.law.rule import rule_of
from timesim.engine.method import Method
from timesim.engine.solver import Control, error_size, next_length
from timesim.engine.status import NOBODY, Status
from timesim.engine.tolerance import NO_TIME, SHORTEST, TOGETHER, VIOLATED
from timesim.model.model import SEPARATION, SLIP

PERIOD = 2 * jnp.pi
SHORTER = 0.9  # share of a cut step that ends beyond a guard
UNSOLVED = 10.0  # error over its tolerance of a step whose equations are not solved
MOST_REPEATS = 100  # transitions in a row with no time between them: more are an accumulation


@tree_class
class Trajectory:
    """Everything that a trajectory goes on from.

    Attributes:
        time: phase within the cycle, in [0, 2 pi).
        point, rate: continuous state and its rate.
        length: step the error control asks for.
        limit: length proposed for the step that is tried again; infinite where none is.
        last_error: error of the last accepted step, for the controller.
        since: time since the last transition.
        repeats: transitions in a row with no time between them.
        tried: steps tried in this cycle.
        culprit: contact of the last transition, `NOBODY` before the first.
    """

    cycle: Int[Leaf, ""]
    time: Float[Leaf, ""]
    point: AnyState
    rate: AnyState
    state: State
    length: Float[Leaf, ""]
    limit: Float[Leaf, ""]
    last_error: Float[Leaf, ""]
    since: Float[Leaf, ""]
    repeats: Int[Leaf, ""]
    tried: Int[Leaf, ""]
    status: Int[Leaf, ""]
    culprit: Int[Leaf, ""]


@tree_class
class Step:
    """One accepted step, for dense output and the log of transitions; ``state_after`` differs at a transition."""

    cycle: Int[Leaf, ""]
    time: Float[Leaf, ""]
    h: Float[Leaf, ""]
    start: AnyState
    start_rate: AnyState
    end: AnyState
    end_rate: AnyState
    state: State
    state_after: State
    inside: Inside | None = None


def begin(dynamics: Dynamics, point: AnyState, state: State, length: Float[Array, ""]) -> Trajectory:
    """A trajectory at the start of a cycle."""
    zero, none = jnp.zeros(()), jnp.zeros((), dtype=jnp.int64)
    rate = dynamics.field(state, zero, point)
    one = jnp.ones(())
    return Trajectory(none, zero, point, rate, state, length, one * jnp.inf, one, one, none, none, none, none + NOBODY)


def try_step(
    method: Method, control: Control, dynamics: Dynamics, now: Trajectory
) -> tuple[Trajectory, Step, Bool[Array, ""]]:
    """Try one step; the trajectory after it, the step, and whether it was accepted."""
    asked, reach, last = length_of_try(method, dynamics, now)
    trial = integrated(method, control, dynamics, now, asked, reach)
    h, last = trial.end.h, last & ~trial.early
    landing = landed(control, dynamics, now, trial, last)
    trial = trial._replace(
        error=jnp.where(landing.astray, jnp.maximum(trial.error, UNSOLVED), trial.error),
        precise=trial.precise & ~landing.astray,
    )
    span = h + landing.correction
    end = jax.tree.map(lambda y, dy: y + landing.correction * dy, trial.end.point, trial.end.rate)
    after, state = transition(dynamics, now.state, landing.crossed, end)
    step = Step(now.cycle, now.time, span, now.point, now.rate, end, trial.end.rate, now.state, state, trial.inside)

    length = next_length(control, method.order, (now.length, now.last_error), trial.error, asked, trial.precise)
    inside = trial.precise & (landing.crossing < guard.NONE)  # a contact has left its state: tried again up to there
    limit = jnp.where(inside, jnp.maximum(landing.crossing * h, SHORTEST), jnp.inf)
    early = landing.correction < 0
    moved = advanced(dynamics, now, (after, trial.end.rate), state, span, last & ~early, landing.crossed)
    kept = replace(now, limit=limit)
    result = jax.tree.map(lambda new, old: jnp.where(landing.accepted, new, old), moved, kept)
    result = controlled(control, now, result, trial.error, length, landing.accepted)
    return judged(control, result), step, landing.accepted


def length_of_try(
    method: Method, dynamics: Dynamics, now: Trajectory
) -> tuple[Float[Array, ""], Float[Array, ""], Bool[Array, ""]]:
    """Length of the step to try, how far it is needed, and whether that is the end of the cycle."""
    remaining = PERIOD - now.time
    h = method.length(dynamics, now.length, now.limit, remaining)
    reach = jnp.minimum(h, jnp.minimum(now.limit, remaining))
    last = reach >= remaining * (1 - NO_TIME)
    return h, jnp.where(last, remaining, reach), last


class Trial(NamedTuple):
    """A step with every contact keeping its state: its end, its error over its tolerance, whether it is within that.

    ``early``: whether it has been cut because a contact leaves its state. ``part`` is the step as the contacts see it,
    ``inside`` its dense output, of a method that has its own.
    """

    end: guard.End
    error: Float[Array, ""]
    precise: Bool[Array, ""]
    early: Bool[Array, ""]
    part: guard.Segment
    inside: Inside | None


def integrated(
    method: Method, control: Control, dynamics: Dynamics, now: Trajectory, h: Float[Array, ""], reach: Float[Array, ""]
) -> Trial:
    """The step of the method; one with a dense output of its own is cut where it is needed no longer."""
    tolerance = control.atol + control.rtol * dynamics.size(now.point)
    end, rate, error, solved = method.advance(dynamics, now.state, now.time, now.point, now.rate, h, tolerance)
    size = jnp.zeros(()) if error is None else error_size(control, dynamics.size(end), error)
    if solved is not None:
        size = jnp.where(solved.converged, size, jnp.maximum(size, UNSOLVED))
    size = jnp.where(jnp.isfinite(size), size, 1e9)
    points, rates, whole = (now.point, end), (now.rate, rate), jnp.asarray(False)
    if solved is None:
        part = guard.segment(dynamics, now.state, points, rates, h)
        return Trial(guard.End(h, end, rate, part.margin[1], part.slope[1]), size, size <= 1, whole, part, None)
    rule = rule_of(method.order - 1)
    part = guard.segment_of_nodes(dynamics, now.state, points, rates, h, solved.nodes, rule)
    # A contact that is apart asks for no short step; the guards look at the path, which has to be known as well.
    unseen = jnp.stack([jnp.abs(polynomial[-1]).max(initial=0.0) for polynomial in part.path]).max()
    size = jnp.maximum(size, rule.touch * unseen / tolerance)
    trial = Trial(guard.End(h, end, rate, part.margin[1], part.slope[1]), size, size <= 1, whole, part, solved.inside)
    return cut(control, dynamics, now, trial, reach)


def cut(control: Control, dynamics: Any, now: Trajectory, trial: Trial, reach: Float[Array, ""]) -> Trial:
    """The step up to where it is needed, or to the first transition."""
    inside, part = trial.inside, trial.part
    assert inside is not None

    def at(span: Array) -> tuple[AnyState, AnyState]:
        point = state_inside(dynamics, (now.state, now.time, now.point), inside, span / part.h)
        return point, dynamics.field(now.state, now.time + span, point)

    crossing, needed = guard.first_crossing(dynamics, now.state, part, doubt=guard.DOUBT), reach / part.h
    early = crossing <= needed
    wanted = (jnp.clip(crossing, SHORTEST / part.h, needed) * part.h, early, reach)
    part_of_it = partial(guard.end_on_guard, dynamics, now.state, at, trial.end, wanted, 0.1 * control.landing)
    end = jax.lax.cond(trial.precise & (early | (reach < part.h)), part_of_it, lambda: trial.end)
    return trial._replace(end=end, early=early)


class Landing(NamedTuple):
    """Where a step ends with respect to the guards.

    Attributes:
        crossing: fraction of the step at which a contact leaves its state inside it; `NONE` if none does.
        accepted: whether the step stands: it is precise, and no contact has left its state inside.
        correction: time by which the end is moved onto the guard.
        crossed: contacts that take their transition there.
        astray: whether the step was cut at its very start, where no contact is near a guard: the guards were looked for
            on polynomials that do not follow the slip between its nodes, as under little friction.
    """

    crossing: Float[Array, ""]
    accepted: Bool[Array, ""]
    correction: Float[Array, ""]
    crossed: Bool[Array, " contact"]
    astray: Bool[Array, ""]


def landed(control: Control, dynamics: Dynamics, now: Trajectory, trial: Trial, last: Array) -> Landing:
    """Follow the margins over a step: the first crossing inside, else the transitions that are due at its end."""
    h, _, _, margin, slope = trial.end
    to_zero, due = guard.arriving(margin, slope, h, last, control.landing)
    if trial.inside is None:
        # The shortest step stands: a margin that was below zero at its start is so at each of its nodes.
        first = guard.first_crossing(dynamics, now.state, trial.part, due)
        crossing = jnp.where(guard.indivisible(h), guard.NONE, first)
    else:  # It was cut at the first crossing; where its end is beyond one after all, a little less is taken of it.
        crossing = jnp.where(((margin < -VIOLATED) & ~due).any(), SHORTER, guard.NONE)
    astray = trial.early & guard.indivisible(h) & (margin.min(initial=jnp.inf) > TOGETHER)
    accepted = trial.precise & (crossing >= guard.NONE) & ~astray
    on_guard = accepted & due.any()
    soonest = jnp.where(due, to_zero, jnp.inf).min(initial=jnp.inf)
    correction = jnp.where(on_guard, soonest, 0.0)
    crossed = on_guard & (due & (margin + correction * slope <= TOGETHER)).any(axis=0)
    return Landing(crossing, accepted, correction, crossed, astray)


@apart
def transition(
    dynamics: Dynamics, state: State, crossed: Bool[Array, " contact"], end: AnyState
) -> tuple[AnyState, State]:
    """Point and states at the end of a step, after the transitions of the contacts that have crossed a guard.

    Of a contact that slips on, w is put back on the cone: its drift, small as it is, would grow beyond the friction
    force itself where n passes close by zero.
    """
    law, moves = dynamics.law, dynamics.motion(end)
    after = jnp.where(crossed, law.successor(state, moves), state)
    w = law.slip_at_transition(state, after, moves, end.w)
    return replace(end, w=w), after


@apart
def advanced(
    dynamics: Dynamics,
    now: Trajectory,
    end: tuple[AnyState, AnyState],
    state: State,
    h: Array,
    ends: Array,
    crossed: Array,
) -> Trajectory:
    """The trajectory after an accepted step, from the point at its end and the rate before any transition there."""
    point, rate = end
    time = now.time + h
    ends = ends | (time >= PERIOD * (1 - 1e-15))
    time = jnp.where(ends, 0.0, time)
    since = now.since + h
    switched = crossed.any()
    repeats = jnp.where(switched & (since < NO_TIME), now.repeats + 1, jnp.where(since < NO_TIME, now.repeats, 0))
    return replace(
        now,
        cycle=now.cycle + ends,
        time=time,
        point=point,
        # To put w back on the cone changes no rate: the force follows its direction alone.
        rate=where_needed(dynamics.by_itself, switched | ends, partial(dynamics.field, state, time, point), rate),
        state=state,
        limit=jnp.full((), jnp.inf),
        since=jnp.where(switched, 0.0, since),
        repeats=repeats,
        culprit=jnp.where(switched, jnp.argmax(crossed) if crossed.size else 0, now.culprit),
    )


def controlled(
    control: Control, now: Trajectory, new: Trajectory, error: Array, length: Array, accepted: Array
) -> Trajectory:
    """The trajectory after a try with what the step control goes on with; it forgets at the end of a cycle.

    Slip that starts at n = 0 begins with a short step. In a long one all stages lie where w is too far off the cone to
    give a direction and take that of u' instead, which is so smooth that the error estimate sees nothing: now and
    then errors of many tolerances were left, the same at any tolerance.
    """
    ended = accepted & (new.cycle > now.cycle)
    tried = jnp.where(ended, 0, now.tried + 1)
    closed = accepted & ((now.state == SEPARATION) & (new.state == SLIP)).any()
    length = jnp.where(closed, jnp.minimum(length, control.closing), length)
    length = jnp.where(ended, control.opening, length)
    last_error = jnp.where(ended, 1.0, jnp.where(accepted, jnp.maximum(error, 1e-4), now.last_error))
    return replace(new, length=length, last_error=last_error, tried=tried)


@apart
def judged(control: Control, now: Trajectory) -> Trajectory:
    """The trajectory with its status: what ends it early is data here, and a message at the boundary."""
    finite = now.point.finite()
    status = jnp.where(now.tried >= control.budget, Status.BUDGET, now.status)
    status = jnp.where(now.length < SHORTEST, Status.TOO_SHORT, status)
    status = jnp.where(now.repeats > MOST_REPEATS, Status.ZENO, status)
    status = jnp.where(finite, status, Status.NOT_FINITE)
    return replace(now, status=status)
