"""Generated structures with damping ratios from 0.05 to 0.5 %: what repeats settles, the rest is named as irregular.

Each is excited at its first natural frequency with the contacts absent and with all of them stuck, and half a bandwidth
aside, by its own force and by one ten times as large.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import count, islice

import numpy as np
import pytest
from zoo import structure

from timesim.model.model import Model
from timesim.model.solver import PRESETS, SHOOT, Criterion
from timesim.orbit.batch import march_lanes
from timesim.orbit.settling import Chain, first_lane, steady_states
from timesim.orbit.steady_state import Orbit
from timesim.orbit.threshold import CYCLES_A_ROUND, LONGEST

pytestmark = pytest.mark.long

DAMPING = (5e-4, 5e-3)
STANDARD, REFERENCE = PRESETS["standard"], PRESETS["reference"]
FINE = replace(STANDARD, rtol=1e-10, atol=1e-12)
REPEATS = 3e-7  # change of a period by steps a thousand times as fine: what the tolerance of the usual ones leaves


def points(seed: int) -> Iterator[Chain]:
    """The points of a structure."""
    model, base = structure(seed, DAMPING)
    load, ratio = model.excitation, model.structure.damping_ratio[0]
    for force in (1, 10):
        driven = replace(model, excitation=replace(load, cosine=force * load.cosine))
        for natural in (base, model.stuck_omega[0] / (2 * np.pi)):
            for aside in (-1, 0, 1):
                yield Chain(driven, (float(natural * (1 + aside * ratio)),))


def of_one_size(first: int, modes: int, contacts: int) -> Iterator[int]:
    """Seeds, from the first on, of structures with so many modes and contacts: they share their compiled loops."""
    for seed in count(first):
        model: Model = structure(seed, DAMPING)[0]
        if (model.structure.num_modes, model.num_contacts) == (modes, contacts):
            yield seed


def settled(chains: list[Chain], criterion: Criterion) -> list[Orbit]:
    return [orbit for (orbit,) in steady_states(chains, STANDARD, criterion)]


def changes(chains: list[Chain], orbits: list[Orbit]) -> Iterator[float]:
    """Change of each motion over its period, relative to its largest entry, by fine steps from its end.

    Of displacements and velocities: the slip of a contact that does not stick follows from them.
    """
    again = [Chain(replace(c.model, start=o.end), c.frequencies) for c, o in zip(chains, orbits, strict=True)]
    lanes = [first_lane(chain, FINE) for chain in again]
    # As many cycles as settling marches at a time, or more are compiled.
    done = march_lanes(lanes, FINE, max(CYCLES_A_ROUND, *(orbit.period for orbit in orbits)))
    for lane, orbit, (_, returns) in zip(lanes, orbits, done, strict=True):
        size = 2 * lane.here.point.q.size
        start, end = lane.vector[:size], returns[orbit.period - 1][:size]
        yield float(np.abs(end - start).max() / np.abs(start).max())


def least_change(chain: Chain, longest: int) -> float:
    """Least change of the state over a period of up to so many cycles, after 20,000 cycles of fine steps."""
    lane, returns = first_lane(chain, REFERENCE), np.zeros((0, 0))
    for _ in range(100):
        ((lane, returns),) = march_lanes([lane], REFERENCE, 200)
    changes = [np.abs(returns[n:] - returns[:-n]).max() for n in range(1, longest + 1)]
    return float(min(changes) / np.abs(returns).max())


def assert_all_settle(seeds: Iterable[int], criterion: Criterion, share: float) -> tuple[list[int], list[Chain]]:
    """Points either repeat, by fine steps too, or are irregular: at most a share of them.

    Returns:
        cycles of the points where a contact is left to be modelled, and the irregular ones.
    """
    chains = [chain for seed in seeds for chain in points(seed)]
    orbits = settled(chains, criterion)
    for place, orbit in enumerate(orbits):
        if not orbit.settled and not orbit.irregular:  # free vibrations have not decayed: with more cycles it shows
            (orbits[place],) = settled([chains[place]], replace(criterion, max_cycles=3 * criterion.max_cycles))
    irregular = [chain for chain, orbit in zip(chains, orbits, strict=True) if orbit.irregular]
    assert len(irregular) <= share * len(chains)
    for orbit in orbits:
        assert orbit.reason is None
        assert orbit.irregular or orbit.settled_to < criterion.tolerance
    marched = [(chain, orbit) for chain, orbit in zip(chains, orbits, strict=True) if orbit.settled and orbit.cycles]
    if marched:
        assert max(changes(*map(list, zip(*marched, strict=True)))) < REPEATS
    return [orbit.cycles for orbit in orbits if orbit.cycles], irregular


def test_what_repeats_settles_in_few_cycles():
    """Marching, these take 500 to 5,000 cycles, and most do not settle in 2,000."""
    cycles, _ = assert_all_settle(islice(of_one_size(20_000, 2, 1), 3), Criterion(first_shot=SHOOT), 0.0)
    assert len(cycles) >= 12
    assert np.median(cycles) < 50


@pytest.mark.slow
def test_long_periods_are_recognised():
    """After the budget, of motions that repeat after nine and 37 cycles."""
    chains = list(islice(points(41_543), 6, 9))
    orbits = [orbit for (orbit,) in steady_states(chains, STANDARD, Criterion(max_cycles=1000))]
    assert all(8 < orbit.period <= LONGEST and not orbit.irregular for orbit in orbits)
    assert max(changes(chains, orbits)) < 1e-5  # over as many cycles


@pytest.mark.slow
def test_what_does_not_repeat_is_irregular_indeed():
    """At default settings; marched on to 20,000 cycles by fine steps, what is called irregular has no short period."""
    seeds = [*range(1000, 1004), *islice(of_one_size(30_000, 2, 1), 3), *islice(of_one_size(30_000, 4, 1), 1)]
    irregular = []
    for seed in seeds:
        cycles, lost = assert_all_settle([seed], Criterion(), 1.0)
        irregular += lost
        print(f"{seed}: {len(cycles)} points in {sum(cycles)} cycles, {len(lost)} do not repeat")
    # Of all together: 1002 alone has eight of its twelve points so, and is as far from repeating after 20,000 cycles.
    assert 0 < len(irregular) <= 6 * len(seeds)
    for chain in irregular:
        assert least_change(chain, LONGEST) > 1e-6
