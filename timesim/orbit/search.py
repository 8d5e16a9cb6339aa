"""The search for one steady state: what is known of it, and which piece of work comes next.

A search has one of four tasks before it. It marches, a round of cycles at a time; after some rounds it may shoot; once
it has settled, or spent its budget, a period is recorded and measured. What has settled by marching may be unstable all
the same: bodies that are equal, and begin alike, move alike until rounding parts them. It is disturbed, and marched on.
"""

import enum
from dataclasses import dataclass, replace

import numpy as np

from timesim.engine.status import RunError, Status, message_of
from timesim.engine.step import PERIOD
from timesim.model.solver import NEVER, Criterion, Solver
from timesim.orbit import threshold
from timesim.orbit.disturbance import Departure
from timesim.orbit.lane import Lane, Recorded
from timesim.orbit.linear import held_lane, proven_orbit, slowest_decay
from timesim.orbit.recurrence import Recurrence, is_irregular, nearest_period, recurrence_of, without_way
from timesim.orbit.shooting import Converged, Failure, Shot, iterated
from timesim.orbit.steady_state import Orbit, without_orbit


class Task(enum.Enum):
    """Next piece of work of a search."""

    MARCH = enum.auto()
    SHOOT = enum.auto()
    MEASURE = enum.auto()
    DONE = enum.auto()


@dataclass(frozen=True)
class Search:
    """The search for one steady state.

    Attributes:
        chain, place: position of the chain, and of the frequency in it.
        lane: the trajectory after the last round of marching.
        returns: state vectors at the end of the last cycles, as many as show the longest period.
        changes: least change of the state over a period, relative, after each round.
        period: of the motion to be measured; 0 where it has not settled.
        settled_to: as in `Orbit`.
        shot: the iterate of Newton's method where it is to SHOOT.
        attempts: at shooting, so far.
        next_shot: cycle before which there is no further attempt at shooting.
        next_held: the same for a proof that no contact leaves its state any more.
        last: whether its budget is spent, and it is shot for the last time.
        disturbed: whether it had settled on a motion that is unstable, and was moved off it.
    """

    chain: int
    place: int
    lane: Lane
    task: Task = Task.MARCH
    returns: tuple[np.ndarray, ...] = ()
    changes: tuple[float, ...] = ()
    cycles: int = 0
    period: int = 0
    settled_to: float = np.nan
    shot: Shot | None = None
    attempts: int = 0
    next_shot: float = 0
    next_held: float = 0
    last: bool = False
    disturbed: bool = False
    orbit: Orbit | None = None


def after_march(search: Search, lane: Lane, returns: np.ndarray, solver: Solver, criterion: Criterion) -> Search:
    """The search after a round of marching."""
    kept = (*search.returns, *returns)[-threshold.LONGEST - threshold.CYCLES_A_ROUND :]
    cycles = search.cycles + len(returns)
    search = replace(search, lane=lane, returns=kept, cycles=cycles)
    if lane.status != Status.RUNNING:
        return _failed(search, solver)
    latest = _returns(search)[-2 * threshold.CYCLES_A_ROUND :]
    seen = recurrence_of(latest, criterion.tolerance, solver.rtol)
    search = replace(search, settled_to=seen.left, changes=(*search.changes, seen.left), period=seen.period)
    if seen.period and seen.left > criterion.tolerance and criterion.first_shot < NEVER:
        return replace(search, task=Task.SHOOT, shot=Shot(lane, seen.period))
    if seen.period:
        return replace(search, task=Task.MEASURE)
    if cycles >= criterion.max_cycles:
        return _spent(search, criterion)
    may_shoot = cycles >= max(search.next_shot, criterion.first_shot)
    if (may_shoot or cycles >= search.next_held) and lane.quiet > len(returns) * PERIOD:
        search = _held(search, solver, may_shoot=may_shoot)
    if may_shoot and search.task is Task.MARCH:
        # Every other time: a free vibration, too, may nearly repeat after several cycles while it decays.
        period = nearest_period(latest).period if search.attempts % 2 else 1
        return replace(search, task=Task.SHOOT, shot=Shot(lane, period), attempts=search.attempts + 1)
    return search


def _spent(search: Search, criterion: Criterion) -> Search:
    """The search at the end of its budget: what nearly repeats after a long period is shot, or has settled."""
    long = _long_recurrence(search, criterion.tolerance if criterion.first_shot == NEVER else 0.0)
    if criterion.first_shot == NEVER and long.period > max(threshold.PERIODS) and long.left < criterion.tolerance:
        return replace(search, task=Task.MEASURE, period=long.period, settled_to=long.left)
    if criterion.first_shot == NEVER or long.period <= threshold.CYCLES_A_ROUND or long.left > threshold.NEARLY_REPEATS:
        return replace(search, task=Task.MEASURE)
    shot = Shot(search.lane, long.period, count=threshold.MOST_SHOTS - threshold.FEW_SHOTS)
    return replace(search, task=Task.SHOOT, shot=shot, last=True)


def _long_recurrence(search: Search, tolerance: float = 0.0) -> Recurrence:
    """How nearly a motion repeats after up to the longest period; one that was marched for less does not count."""
    if len(search.returns) < threshold.LONGEST + threshold.CYCLES_A_ROUND:
        return Recurrence(0, np.inf)
    return nearest_period(_returns(search), threshold.LONGEST, tolerance)


def _returns(search: Search) -> np.ndarray:
    """State vectors at the end of the last cycles, shape (N, state), of a body that slides on without its way."""
    return without_way(np.array(search.returns), search.lane.shifts)


def _held(search: Search, solver: Solver, *, may_shoot: bool) -> Search:
    """The search after a round in which no contact has left its state.

    If it is proven that none ever will, the steady state is known; else that state is tried, where shooting is allowed.
    """
    orbit = proven_orbit(search.lane, solver)
    if orbit is not None:
        return replace(search, task=Task.DONE, orbit=replace(orbit, cycles=search.cycles))
    search = replace(search, next_held=threshold.NEXT_PROOF * search.cycles)
    steady = held_lane(search.lane, solver) if may_shoot else None
    return search if steady is None else replace(search, task=Task.SHOOT, shot=Shot(steady, held=True))


def after_shot(search: Search, recorded: Recorded, criterion: Criterion) -> Search:
    """The search after an iteration of Newton's method."""
    shot = search.shot
    assert shot is not None
    led_to = iterated(shot, recorded, criterion.tolerance)
    search = replace(search, cycles=search.cycles + recorded.cycles)
    if isinstance(led_to, Shot):
        return replace(search, shot=led_to)
    if isinstance(led_to, Converged):
        return _done(replace(search, period=shot.period, settled_to=led_to.settled_to), recorded)
    if search.period or search.last:  # as nearly as marching can tell
        return replace(search, task=Task.MEASURE)
    if shot.held:
        return replace(search, shot=Shot(search.lane))
    off = _off_unstable(search, Departure(recorded, search.lane), criterion) if led_to is Failure.UNSTABLE else None
    if off is not None:
        return off
    return replace(search, task=Task.MARCH, shot=None, next_shot=threshold.LATER * search.cycles)


def _off_unstable(search: Search, departure: Departure, criterion: Criterion) -> Search | None:
    """The search farther off the unstable motion that was shot, if it is there and would stay within its budget."""
    left = criterion.max_cycles - search.cycles
    stays = left > 0 and not departure.ends_within(left)
    return _departed(search, departure) if stays else None


def after_measure(search: Search, recorded: Recorded, solver: Solver, criterion: Criterion) -> Search:
    """The search after the cycles that are measured, whose derivative tells how far a motion that repeats has to go.

    What was extrapolated is the largest change: one that is smaller and falls more slowly hides below it.
    """
    if not recorded.complete:
        done = search.cycles + int(recorded.steps.cycle.max(initial=0))
        return _failed(replace(search, lane=recorded.end, cycles=done), solver)
    search = replace(search, cycles=search.cycles + recorded.cycles)
    may_shoot = search.period and search.shot is None and criterion.first_shot < NEVER
    if may_shoot and recorded.left > criterion.tolerance:
        return replace(search, task=Task.SHOOT, lane=recorded.end, shot=Shot(recorded.end, search.period))
    unstable = search.period and not search.disturbed and recorded.is_unstable
    off = _departed(search, Departure(recorded, recorded.start)) if unstable else None
    return _done(search, recorded) if off is None else off


def _departed(search: Search, departure: Departure) -> Search | None:
    """The search off a motion that is unstable; None where contacts allow no way."""
    lane = next(departure.disturbed(), None)
    if lane is None:
        return None
    lane, later = replace(lane, control=search.lane.control), threshold.LATER * search.cycles
    return Search(
        search.chain,
        search.place,
        lane,
        cycles=search.cycles,
        attempts=search.attempts,
        next_shot=later,
        disturbed=True,
    )


def _done(search: Search, recorded: Recorded) -> Search:
    noise = threshold.NOISY * float(search.lane.control.rtol)
    repeats = search.period > 0 or _long_recurrence(search).left < threshold.VAGUE
    # A motion in which no contact leaves its state decays, however slowly the budget has let it do so.
    wanders = not (repeats or recorded.is_held)
    irregular = wanders and is_irregular(search.changes, slowest_decay(search.lane), noise)
    try:
        orbit = recorded.orbit(search.cycles, search.period, search.settled_to, irregular=irregular)
    except RunError as error:  # its cycles cannot be recorded
        orbit = without_orbit(search.lane.model, f"at {search.lane.frequency:g} Hz: {error}", search.cycles)
    return replace(search, task=Task.DONE, orbit=orbit)


def _failed(search: Search, solver: Solver) -> Search:
    """The search after its trajectory has ended early."""
    lane = search.lane
    reason = message_of(lane.model, lane.reduction, solver, lane.status, lane.culprit)
    where = f"at {lane.frequency:g} Hz, in cycle {search.cycles + 1}"
    return replace(search, task=Task.DONE, orbit=without_orbit(lane.model, f"{where}: {reason}", search.cycles))
