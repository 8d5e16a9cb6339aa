"""Steady states of many scenes side by side, by marching until the motion repeats, or by shooting.

A search has one of four tasks before it. It marches, a round of cycles at a time; after some rounds it may shoot; once
it has settled, or spent its budget, a period is recorded and measured. Searches that are done make room for others. The
next task of a search depends on that search alone, so the order and the company do not matter.
"""

import enum
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from timesim.engine.law.table import begin_of
from timesim.engine.status import RunError, Status, message_of
from timesim.engine.step import PERIOD
from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import NEVER, Criterion, Solver
from timesim.orbit import threshold
from timesim.orbit.batch import SIDE_BY_SIDE, Each, march_lanes, record
from timesim.orbit.lane import Lane, Recorded
from timesim.orbit.linear import held_lane, linear_orbit, proven_orbit, slowest_decay
from timesim.orbit.recurrence import Recurrence, is_irregular, nearest_period, recurrence_of, without_way
from timesim.orbit.shooting import Converged, Shot, iterated
from timesim.orbit.steady_state import Orbit, without_orbit


@dataclass(frozen=True)
class Chain:
    """A model and the frequencies [Hz] it visits one after the other; the motion is carried from each to the next."""

    model: Model
    frequencies: tuple[float, ...]


SteadyStates = Callable[[Sequence[Chain]], list[list[Orbit]]]
"""Computes the steady states of chains: `steady_states` with a solver and a criterion."""


class GivenUpError(KeyboardInterrupt):
    """The work on steady states was given up; `orbits`: those of each chain up to then, in its order."""

    def __init__(self, orbits: list[list[Orbit]]):
        super().__init__(orbits)
        self.orbits = orbits


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
        task: next piece of work.
        returns: state vectors at the end of the last cycles, as many as show the longest period.
        changes: least change of the state over a period, relative, after each round.
        cycles: integrated so far.
        period: of the motion to be measured; 0 where it has not settled.
        settled_to: as in `Orbit`.
        shot: the iterate of Newton's method where it is to SHOOT.
        attempts: at shooting, so far.
        next_shot: cycle before which there is no further attempt at shooting.
        next_held: the same for a proof that no contact leaves its state any more.
        last: whether its budget is spent, and it is shot for the last time.
        orbit: the result once it is DONE.
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
    orbit: Orbit | None = None


# Transitions of a search


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
    return replace(search, task=Task.MARCH, shot=None, next_shot=threshold.LATER * search.cycles)


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
    return _done(search, recorded)


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


# Many searches


def steady_states(
    chains: Sequence[Chain],
    solver: Solver,
    criterion: Criterion,
    *,
    halted: Callable[[], bool] = lambda: False,
    count: Callable[[], object] = lambda: None,
    each: Each = map,
) -> list[list[Orbit]]:
    """The steady states of chains of frequencies, those of each in its order; after one that failed it starts anew.

    Args:
        chains: the first motion of each starts from the model's own `Start`.
        solver, criterion: method and tolerances, and when a motion counts as settled.
        halted: asked before each round of cycles; True gives the work up.
        count: called after each steady state that takes cycles.
        each: does the work on batches of them.

    Raises:
        GivenUpError: the work was given up.
    """
    work = _Work(chains, solver, criterion, halted, each)
    orbits: list[list[Orbit]] = [[] for _ in chains]
    groups: dict[tuple[tuple[int, ...], ...], deque[Search]] = {}
    for index, chain in enumerate(chains):
        lane = first_lane(chain, solver)
        orbits[index] = _linear_orbits(chain, lane, solver)
        if not orbits[index]:
            groups.setdefault(lane.shapes, deque()).append(Search(index, 0, lane))
    try:
        for group in groups.values():
            for search in work.settled(group):
                assert search.orbit is not None
                orbits[search.chain].append(search.orbit)
                count()
    except KeyboardInterrupt:
        raise GivenUpError(orbits) from None
    return orbits


def warm_up(chains: Iterable[Chain], solver: Solver) -> None:
    """Compile the loops, two side by side, before several threads ask for the same."""
    for chain in chains:
        lane = first_lane(chain, solver)
        if lane.here.state.size:
            with ThreadPoolExecutor(1) as beside:
                marched = beside.submit(march_lanes, [lane], solver, threshold.CYCLES_A_ROUND)
                record([lane], solver, [threshold.UNSETTLED_CYCLES])
                marched.result()
            return


def first_lane(chain: Chain, solver: Solver) -> Lane:
    """The first frequency of a chain, from the start of its model."""
    reduction = reduction_of(chain.model, chain.frequencies, reduce=solver.reduce)
    return Lane.begin(chain.model, reduction, chain.frequencies[0], solver, begin_of(chain.model))


def _linear_orbits(chain: Chain, lane: Lane, solver: Solver) -> list[Orbit]:
    """The steady states of a chain in which no contact is left to be modelled; none if it has to be marched."""
    if lane.here.state.size:
        return []
    orbits = [linear_orbit(lane.at(frequency, begin_of(chain.model), solver)) for frequency in chain.frequencies]
    return [orbit for orbit in orbits if orbit is not None] if None not in orbits else []


@dataclass(frozen=True)
class _Work:
    """The work on many searches."""

    chains: Sequence[Chain]
    solver: Solver
    criterion: Criterion
    halted: Callable[[], bool]
    each: Each

    def settled(self, pending: deque[Search]) -> Iterator[Search]:
        """Yield the searches of a group, and those that follow along their chains, when each is done.

        Raises:
            KeyboardInterrupt: the work was given up.
        """
        active: list[Search] = []
        while pending or active:
            if self.halted():
                raise KeyboardInterrupt
            while pending and len(active) < threshold.UNDER_WAY:
                active.append(pending.popleft())
            moved = self._round(active)
            yield from (search for search in moved if search.task is Task.DONE)
            active = [going for search in moved for going in self._going(search)]

    def _going(self, search: Search) -> list[Search]:
        """The search, or, once it is done, that for the next steady state along its chain if there is one."""
        if search.orbit is None:
            return [search]
        chain, place = self.chains[search.chain], search.place + 1
        if place == len(chain.frequencies):
            return []
        start = search.orbit.end if search.orbit.reason is None else begin_of(chain.model)
        return [Search(search.chain, place, search.lane.at(chain.frequencies[place], start, self.solver))]

    def _round(self, active: Sequence[Search]) -> list[Search]:
        """Each search a step further: shot once or marched, and measured where it is ready for it."""
        moved = {search.chain: search for search in active}
        for task, advanced in ((Task.SHOOT, self._shot), (Task.MARCH, self._marched), (Task.MEASURE, self._measured)):
            due = [search for search in moved.values() if search.task is task]
            moved |= {search.chain: search for search in advanced(due)}
        return list(moved.values())

    def _shot(self, searches: Sequence[Search]) -> Iterator[Search]:
        shots = [search.shot for search in searches if search.shot is not None]
        lanes, cycles = [shot.lane for shot in shots], [shot.period for shot in shots]
        done = record(lanes, self.solver, cycles, threshold.TRIES * max(cycles, default=1), each=self.each)
        for search, recorded in zip(searches, done, strict=True):
            yield after_shot(search, recorded, self.criterion)

    def _marched(self, searches: Sequence[Search]) -> Iterator[Search]:
        lonely = len(searches) < SIDE_BY_SIDE and all(search.cycles > threshold.LONELY for search in searches)
        size = 1 if lonely else SIDE_BY_SIDE
        lanes = [search.lane for search in searches]
        done = march_lanes(lanes, self.solver, threshold.CYCLES_A_ROUND, size=size, each=self.each)
        for search, (lane, returns) in zip(searches, done, strict=True):
            yield after_march(search, lane, returns, self.solver, self.criterion)

    def _measured(self, searches: Sequence[Search]) -> Iterator[Search]:
        cycles = [search.period or threshold.UNSETTLED_CYCLES for search in searches]
        done = record([search.lane for search in searches], self.solver, cycles, each=self.each)
        for search, recorded in zip(searches, done, strict=True):
            yield after_measure(search, recorded, self.solver, self.criterion)
