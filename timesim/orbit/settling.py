"""Steady states of many scenes side by side: marched until they repeat, or found by shooting.

A motion counts as settled when what is still missing, extrapolated from how fast the change from cycle to cycle falls,
is below the tolerance: a slow drift changes little in a cycle and is yet far from rest. Motions that repeat after two
or three cycles are recognised. Those that have settled make room for the next.

Shooting marches until the motion is near a periodic one, then takes Newton's method on the state after a period, with
the exact derivative of `monodromy`. It goes back to marching where Newton's method does not take over at once,
where it leaves the contact states, and where what it finds is unstable: it finds the motion that marching would.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from timesim.engine.step import Status
from timesim.engine.trajectory import message_of, start_states
from timesim.model.model import Model, Start
from timesim.model.reduction import reduction_of
from timesim.model.solver import Criterion, Solver
from timesim.orbit.batch import SIZES, march, record
from timesim.orbit.lane import Lane, Recorded
from timesim.orbit.linear import linear_orbit

CYCLES_A_ROUND = 8
SIDE_BY_SIDE = 128  # searches that share batches, full ones as long as many are left
LONELY = 256  # cycles after which it pays to compile a march for each of the few searches that are left
PERIODS = (1, 2, 3)
UNSETTLED_CYCLES = 10  # over which the amplitude of a motion that has not settled is taken
STILL_THERE = 0.99  # what is left of an alternation after half a round, if it is not one that decays
DOUBLED = 30.0  # times the tolerance: what goes to and fro by less may be a vibration that dies out in a beat
LEADS_NOWHERE = 3.0  # times the change of a cycle: a drift would have led much farther over two rounds
REST = 1e-13  # a change this small is rounding
FIRST_SHOT = 2 * CYCLES_A_ROUND  # cycles marched before the first attempt at shooting
TAKES_OVER = 0.3  # Newton's method must shrink the change over a period to this share of what it was, or gives up
REACH = 0.5  # of the state: a longer step of Newton's method leads elsewhere
TRIES = 2048  # steps tried in a shot: more mean that it has gone wrong
UNSTABLE = 1 + 1e-6

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Task:
    """A model, started from its own `Start`, at a frequency [Hz]."""

    model: Model
    frequency: float


@dataclass(frozen=True)
class Chain:
    """A model and the frequencies [Hz] it visits one after the other; the motion is carried from each to the next."""

    model: Model
    frequencies: tuple[float, ...]


@dataclass(frozen=True)
class Orbit:
    """The steady state at a frequency.

    Attributes:
        end: the state at the end of a cycle, from which another run may start.
        amplitude: (max - min) / 2 of each point along x, y, z over a period, shape (P, 3); over the last ten cycles
            where the motion has not settled.
        band: smallest and largest amplitude of one of these cycles, shape (2, P, 3).
        settled: whether the motion repeats.
        cycles: excitation cycles integrated; 0 where the scene is linear and needs none.
        period: its period in excitation periods; 0 if it has not settled.
        slip_share, separation_share: share of the period in these states, shape (C,).
        floquet: multipliers of the period, largest first, without those of offsets that nothing moves; NaN where the
            motion has not settled.
        reason: why it could not be computed; None if it was.
    """

    end: Start
    amplitude: np.ndarray
    band: np.ndarray
    settled: bool
    cycles: int
    period: int
    slip_share: np.ndarray
    separation_share: np.ndarray
    floquet: np.ndarray
    reason: str | None = None


@dataclass
class Search:
    """The search for one steady state under way: a lane of a batch, and what is known of it."""

    chain: int
    place: int
    lane: Lane
    sections: list[np.ndarray] = field(default_factory=list)
    cycles: int = 0
    period: int | None = None
    shot: "Shot | None" = None
    next_shot: int = FIRST_SHOT


@dataclass
class Shot:
    """Newton's method under way: the lane that is shot, and the size of the change over a period before."""

    lane: Lane
    change: float = np.inf


def settle(
    tasks: Sequence[Task],
    solver: Solver,
    *,
    tolerance: float = 1e-8,
    max_cycles: int = 2000,
    progress: Progress | None = None,
) -> list[Orbit]:
    """March each task until it settles: `steady_states` of chains of one frequency."""
    chains = [Chain(task.model, (task.frequency,)) for task in tasks]
    return [orbit for (orbit,) in steady_states(chains, solver, Criterion(tolerance, max_cycles), progress)]


def steady_states(
    chains: Sequence[Chain],
    solver: Solver,
    criterion: Criterion | None = None,
    progress: Progress | None = None,
    *,
    crowd: int = 0,
    halted: Callable[[], bool] = lambda: False,
) -> list[list[Orbit]]:
    """The steady states of chains of frequencies.

    Args:
        chains: the first motion of each starts from the model's own `Start`.
        solver: method and tolerances.
        criterion: when a motion counts as settled.
        progress: called with the steady states found and their number.

    Keyword Args:
        crowd: chains that the batches are sized for, where more are to follow; one size less is compiled.
        halted: asked now and then; once it says so the work is given up.

    Returns:
        The orbits of each chain in the order of its frequencies. After one that failed the chain starts anew.

    Raises:
        KeyboardInterrupt: the work was given up.
    """
    criterion = criterion or Criterion()
    found: list[list[Orbit]] = [[] for _ in chains]
    total = sum(len(chain.frequencies) for chain in chains)
    groups: dict[tuple[tuple[int, ...], ...], deque[Search]] = {}
    for index, chain in enumerate(chains):
        lane = first_lane(chain, solver)
        linear = _linear_orbits(chain, lane, solver)
        if linear is not None:
            found[index] = linear
        else:
            groups.setdefault(lane.shapes, deque()).append(Search(index, 0, lane))
    done = sum(map(len, found))
    for group in groups.values():
        size = SIZES[max(len(group), crowd) > SIZES[0]]
        for search, orbit in _settle_group(group, chains, solver, criterion, size):
            found[search.chain].append(orbit)
            done += 1
            if halted():
                raise KeyboardInterrupt
            if progress is not None:
                progress(done, total)
    return found


def _linear_orbits(chain: Chain, lane: Lane, solver: Solver) -> list[Orbit] | None:
    """The steady states of a chain in which no contact is left to be modelled; None if it has to be marched."""
    orbits = []
    for frequency in chain.frequencies if not lane.here.state.size else ():
        linear = linear_orbit(lane.at(frequency, begin_of(chain.model), solver))
        if linear is None:
            return None
        amplitude, apart = linear.amplitude, np.zeros(chain.model.num_contacts)
        apart[lane.reduction.apart] = 1.0
        band, none = np.stack([amplitude, amplitude]), np.zeros_like(apart)
        orbits.append(Orbit(linear.lane.start(), amplitude, band, True, 0, 1, none, apart, linear.multipliers))
    return orbits or None


def first_lane(chain: Chain, solver: Solver) -> Lane:
    """The first frequency of a chain, from the start of its model."""
    reduction = reduction_of(chain.model, chain.frequencies, reduce=solver.reduce)
    return Lane.begin(chain.model, reduction, chain.frequencies[0], solver, begin_of(chain.model))


def begin_of(model: Model) -> Start:
    """The start of a model with the state of each contact."""
    return replace(model.start, state=start_states(model))


def _settle_group(
    pending: deque[Search], chains: Sequence[Chain], solver: Solver, criterion: Criterion, size: int
) -> Iterator[tuple[Search, Orbit]]:
    active: list[Search] = []
    while pending or active:
        while pending and len(active) < SIDE_BY_SIDE:
            active.append(pending.popleft())
        going = []
        for search, orbit in _round(active, solver, criterion, size):
            if orbit is None:
                going.append(search)
                continue
            yield search, orbit
            frequencies = chains[search.chain].frequencies
            if search.place + 1 < len(frequencies):
                start = orbit.end if orbit.reason is None else begin_of(chains[search.chain].model)
                lane = search.lane.at(frequencies[search.place + 1], start, solver)
                going.append(Search(search.chain, search.place + 1, lane))
        active = going


def _round(
    active: Sequence[Search], solver: Solver, criterion: Criterion, size: int
) -> list[tuple[Search, Orbit | None]]:
    """Take each search a step further: march it, or shoot it once, and measure those that have settled."""
    marching = [search for search in active if search.shot is None]
    outcome: dict[int, Orbit | None] = {}
    if marching:
        _march(marching, solver, size)
        for search in marching:
            outcome[id(search)] = _after_march(search, solver, criterion)
    shooting = [search for search in active if search.shot is not None]
    shot = record([_shot(search).lane for search in shooting], solver, 1, TRIES, size=size)
    for search, recorded in zip(shooting, shot, strict=True):
        outcome[id(search)] = _after_shot(search, recorded, solver, criterion)
    ready = [search for search in marching if search.period is not None and outcome[id(search)] is None]
    for cycles in sorted({_cycles_to_measure(search) for search in ready}):
        same = [search for search in ready if _cycles_to_measure(search) == cycles]
        lanes = record([search.lane for search in same], solver, cycles, size=size)
        for search, recorded in zip(same, lanes, strict=True):
            outcome[id(search)] = _orbit(search, recorded, solver)
    return [(search, outcome[id(search)]) for search in active]


def _shot(search: Search) -> Shot:
    assert search.shot is not None
    return search.shot


def _cycles_to_measure(search: Search) -> int:
    return search.period or UNSETTLED_CYCLES


def _march(searches: Sequence[Search], solver: Solver, size: int) -> None:
    if len(searches) <= SIZES[0] and min(search.cycles for search in searches) > LONELY:
        size = 1
    done = march([search.lane for search in searches], solver, CYCLES_A_ROUND, size=size)
    for search, (lane, rows) in zip(searches, done, strict=True):
        search.lane = lane
        search.cycles += len(rows)
        search.sections = [*search.sections, *rows][-2 * CYCLES_A_ROUND :]


def _after_march(search: Search, solver: Solver, criterion: Criterion) -> Orbit | None:
    """An orbit if the march has failed; else the search knows what comes next."""
    if search.lane.status != Status.RUNNING:
        return failed(search, solver)
    period = period_of(np.array(search.sections), criterion.tolerance, solver.rtol)
    if period or search.cycles >= criterion.max_cycles:
        search.period = period
    elif criterion.shoot and search.cycles >= search.next_shot:
        search.shot = Shot(search.lane)
    return None


def period_of(sections: np.ndarray, tolerance: float, noise: float = 0.0) -> int:
    """Period after which the sections repeat to the tolerance, extrapolated; 0 if they do not.

    Args:
        sections: the state at the end of consecutive cycles, shape (N, state).
        tolerance: relative to the largest entry.
        noise: tolerance of a step. Changes below it that go to and fro and lead nowhere are those of the step control.
    """
    size = np.max(np.abs(sections), initial=0.0)
    if size == 0:
        return 1
    half = CYCLES_A_ROUND // 2
    latest = [np.abs(sections[-1] - sections[-1 - period]).max() for period in PERIODS if period < len(sections)]
    if min(latest, default=0.0) > max(tolerance, noise, REST) * size:
        return 0  # found at once, as in most rounds
    for period in PERIODS:
        change = np.max(np.abs(sections[period:] - sections[:-period]), axis=1) / size
        if change.size < CYCLES_A_ROUND:
            continue
        last, before = np.max(change[-half:]), np.max(change[-2 * half : -half])
        ratio = (last / before) ** (1 / half) if before > 0 else 0.0
        if last < noise and len(sections) == 2 * CYCLES_A_ROUND:
            led = np.max(np.abs(sections[-1] - sections[(len(sections) - 1) % period])) / size
            ratio = 0.0 if led < LEADS_NOWHERE * last and before < LEADS_NOWHERE * last else ratio
            tolerance = max(tolerance, noise) if ratio == 0 else tolerance
        if last < REST or (ratio < 1 and last < tolerance and last * ratio / (1 - ratio) < tolerance):
            steps = np.max(np.abs(np.diff(sections, axis=0)), axis=1) / size
            now, earlier = np.max(steps[-half:]), np.max(steps[-2 * half : -half])
            if period == 1 or now < tolerance:
                return 1
            if now > DOUBLED * tolerance and now > STILL_THERE * earlier:
                return period  # else it nearly repeats while it decays, as a free vibration may
    return 0


def _next_shot(search: Search) -> int:
    """Cycle of the next attempt: later and later, for a motion that never repeats costs far more shot than marched."""
    return search.cycles + max(CYCLES_A_ROUND, search.cycles // 2)


def _after_shot(search: Search, recorded: Recorded, solver: Solver, criterion: Criterion) -> Orbit | None:
    """One iteration of Newton's method; the orbit once it has converged."""
    shot, search.cycles = _shot(search), search.cycles + 1
    search.shot = None
    if not recorded.complete or not np.array_equal(recorded.end.here.state, shot.lane.here.state):
        search.next_shot = _next_shot(search)
        return None
    here = shot.lane.vector
    change, size = recorded.end.vector - here, max(float(np.max(np.abs(here), initial=0.0)), 1e-300)
    step = recorded.newton_step()
    if np.max(np.abs(step), initial=0.0) < criterion.tolerance * size:
        if np.max(np.abs(recorded.multipliers), initial=0.0) > UNSTABLE:
            search.next_shot = criterion.max_cycles
            return None
        search.period = 1
        return _orbit(search, recorded, solver)
    residual, reach = (float(np.max(np.abs(part), initial=0.0)) / size for part in (change, step))
    moved = shot.lane.moved(here + step) if residual < TAKES_OVER * shot.change and reach < REACH else None
    if moved is None:
        search.next_shot = _next_shot(search)
    else:
        search.shot = Shot(moved, residual)
    return None


def _orbit(search: Search, recorded: Recorded, solver: Solver) -> Orbit:
    if not recorded.complete:
        search.lane = recorded.end
        return failed(search, solver)
    settled, measure = bool(search.period), recorded.measure()
    return Orbit(
        end=recorded.end.start(),
        amplitude=measure.amplitude,
        band=measure.band,
        settled=settled,
        cycles=search.cycles + recorded.cycles,
        period=search.period or 0,
        slip_share=measure.slip_share,
        separation_share=measure.separation_share,
        floquet=recorded.multipliers if settled else np.full_like(recorded.multipliers, np.nan),
    )


def failed(search: Search, solver: Solver) -> Orbit:
    """The orbit of a search that a status has ended."""
    lane = search.lane
    reason = message_of(lane.model, lane.reduction, solver, lane.status, lane.culprit)
    return without_orbit(lane.model, f"at {lane.frequency:g} Hz, in cycle {search.cycles + 1}: {reason}", search.cycles)


def without_orbit(model: Model, reason: str, cycles: int = 0) -> Orbit:
    """What stands for a steady state that could not be computed."""
    nothing = np.full(model.num_contacts, np.nan)
    amplitude = np.full((len(model.structure.points), 3), np.nan)
    band = np.stack([amplitude, amplitude])
    return Orbit(model.start, amplitude, band, False, cycles, 0, nothing, nothing, np.full(1, np.nan), reason)
