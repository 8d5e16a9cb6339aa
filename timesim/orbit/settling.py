"""Steady states of many scenes at a time, by marching until the motion repeats, or by shooting.

Searches that are done make room for others. The next task of a search depends on that search alone, so the order and
the company do not matter.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from timesim.engine.law.table import begin_of
from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import Criterion, Solver
from timesim.orbit import threshold
from timesim.orbit.batch import Each, march_lanes, record
from timesim.orbit.lane import Lane
from timesim.orbit.linear import linear_orbit
from timesim.orbit.search import Search, Task, after_march, after_measure, after_shot
from timesim.orbit.steady_state import Orbit


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

    Raises:
        GivenUpError: the work was given up.
    """
    work = _Work(chains, solver, criterion, halted, each)
    orbits: list[list[Orbit]] = [[] for _ in chains]
    pending: deque[Search] = deque()
    for index, chain in enumerate(chains):
        lane = first_lane(chain, solver)
        orbits[index] = _linear_orbits(chain, lane, solver)
        if not orbits[index]:
            pending.append(Search(index, 0, lane))
    try:
        for search in work.settled(pending):
            assert search.orbit is not None
            orbits[search.chain].append(search.orbit)
            count()
    except KeyboardInterrupt:
        raise GivenUpError(orbits) from None
    return orbits


def warm_up(chains: Iterable[Chain], solver: Solver) -> None:
    """Compile the loops, two at a time, before several threads ask for the same."""
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
        """Yield searches, and those that follow along their chains, when each is done.

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
        lanes = [search.lane for search in searches]
        done = march_lanes(lanes, self.solver, threshold.CYCLES_A_ROUND, each=self.each)
        for search, (lane, returns) in zip(searches, done, strict=True):
            yield after_march(search, lane, returns, self.solver, self.criterion)

    def _measured(self, searches: Sequence[Search]) -> Iterator[Search]:
        cycles = [search.period or threshold.UNSETTLED_CYCLES for search in searches]
        done = record([search.lane for search in searches], self.solver, cycles, each=self.each)
        for search, recorded in zip(searches, done, strict=True):
            yield after_measure(search, recorded, self.solver, self.criterion)
