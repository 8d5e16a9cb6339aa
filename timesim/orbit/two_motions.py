"""Ranges of frequency with two steady motions: both sweeps, each jump bisected, and the motions at mid-range.

A sweep carries its motion along until it is gone and the motion jumps. Where both sweeps, up and down, are on different
motions there are two: such a range begins where the downward sweep loses its motion, and ends where the upward one
does. Where either jumps is looked for in every step over which the amplitude changes more than beside it, and in those
after which the sweeps are at one; halving the step tells a jump from a slope, so a range far narrower than the step of
the sweeps is found too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from timesim.model.model import Model, Start
from timesim.orbit.jump import AT_LEAST, Stretch, narrowed
from timesim.orbit.settling import Chain, SteadyStates
from timesim.orbit.steady_state import Columns, Orbit, columns_of, differ, distance, orbit_of, without_orbit

UP, DOWN = 0, 1
WALK = 4  # steps from the nearest motion that is known to mid-range
BOTH = 2  # ends of a range
FURTHER = 6  # times that an end is sought again where the motion was lost by too long a step only


@dataclass(frozen=True)
class Search:
    """Where to look for the ends of ranges.

    Attributes:
        model: the scene.
        steady: gives steady states as those of the sweeps.
        width: wanted of each end [Hz].
    """

    model: Model
    steady: SteadyStates
    width: float

    def along(self, start: Start, frequencies: Sequence[float]) -> list[Orbit]:
        """The steady states at frequencies [Hz], carried from each to the next."""
        chain = Chain(replace(self.model, start=start), tuple(map(float, frequencies)))
        return self.steady([chain])[0]


# Jumps


@dataclass(frozen=True)
class Loss:
    """Where a sweep loses its motion.

    Attributes:
        direction: `UP` or `DOWN`.
        begin: last frequency of the sweep with the motion [Hz].
        near, far: last frequency with the motion, first one without [Hz].
        on, beyond: the motions there.
    """

    direction: int
    begin: float
    near: float
    far: float
    on: Orbit
    beyond: Orbit


@dataclass(frozen=True)
class Sweeps:
    """Both sweeps, frequencies ascending: shape (F,) [Hz], and the motions of each."""

    frequency: np.ndarray
    orbits: tuple[list[Orbit], list[Orbit]]

    @classmethod
    def of(cls, columns: Columns, phase: float) -> "Sweeps":
        """From their columns, in the order in which each visits its frequencies."""
        up, down = (
            [orbit_of(columns, (direction, k), phase) for k in range(columns["settled"].shape[1])]
            for direction in (UP, DOWN)
        )
        return cls(columns["frequency"][UP], (up, down[::-1]))

    def amplitude(self, direction: int) -> np.ndarray:
        """Shape (F, X), NaN where a point failed."""
        return np.array([orbit.amplitude.ravel() for orbit in self.orbits[direction]])

    @property
    def apart(self) -> np.ndarray:
        """Whether they are on different motions, shape (F,)."""
        return np.array([differ(*pair) for pair in zip(*self.orbits, strict=True)], dtype=bool)


def suspect_steps(sweeps: Sweeps, direction: int) -> np.ndarray:
    """Steps in which a sweep may jump: positions of the lower point of each."""
    found = set(merging_steps(sweeps, direction))
    amplitude = sweeps.amplitude(direction)
    change = np.max(np.abs(np.diff(amplitude, axis=0)), axis=1, initial=0.0)
    known = np.nan_to_num(np.concatenate([[0.0], change, [0.0]]))
    large = AT_LEAST * np.nanmax(np.abs(amplitude), initial=0.0)
    found |= set(np.flatnonzero((known[1:-1] > large) & (known[1:-1] >= np.maximum(known[:-2], known[2:]))).tolist())
    reason = [orbit.reason for orbit in sweeps.orbits[direction]]
    last = len(reason) - 1
    return np.array(sorted(k for k in found if 0 <= k < last and not reason[k] and not reason[k + 1]), dtype=int)


def merging_steps(sweeps: Sweeps, direction: int) -> list[int]:
    """Steps of a sweep after which it is at one with the other: positions of the lower point of each."""
    runs = np.flatnonzero(np.diff(sweeps.apart, prepend=False, append=False)).reshape(-1, 2)
    steps = [(int(end - 1), int(end)) if direction == UP else (int(first - 1),) * 2 for first, end in runs]
    last = sweeps.frequency.size - 1
    return [k for k, beyond in steps if 0 <= k < last and not any(own[beyond].reason for own in sweeps.orbits)]


def losses(search: Search, sweeps: Sweeps) -> Iterator[Loss]:
    """All jumps of both sweeps, bisected."""
    for direction in (UP, DOWN):
        for k in suspect_steps(sweeps, direction):
            near, far = (k, k + 1) if direction == UP else (k + 1, k)
            ends = float(sweeps.frequency[near]), float(sweeps.frequency[far])
            orbits = sweeps.orbits[direction][near], sweeps.orbits[direction][far]
            loss = _lost(search, sweeps, direction, ends, orbits)
            if loss is None and k in merging_steps(sweeps, direction):
                loss = _merging(search, direction, ends, orbits)
            if loss is not None:
                yield loss


def _lost(
    search: Search, sweeps: Sweeps, direction: int, ends: tuple[float, float], orbits: tuple[Orbit, Orbit]
) -> Loss | None:
    """Bisect a jump. A motion may be lost by the length of a step alone: it is led on from the end that was found."""
    limit = float(sweeps.frequency[-1 if direction == UP else 0])
    least = AT_LEAST * np.nanmax(sweeps.amplitude(direction), initial=0.0)
    step, loss = Stretch(search.model, *ends, *orbits, least), None
    for _ in range(FURTHER + 1):
        found = narrowed([step], search.steady, search.width)
        if not found:
            return None
        jump = found[0][1]
        loss = Loss(direction, ends[0], jump.near, jump.far, jump.on, jump.beyond)
        ahead = _ahead(search, loss, limit, abs(ends[1] - ends[0]) / WALK)
        if ahead is None:
            break
        step = Stretch(search.model, *ahead, least)
    return loss


def _merging(search: Search, direction: int, ends: tuple[float, float], orbits: tuple[Orbit, Orbit]) -> Loss:
    """Bisect a jump that is small beside the slope of the step: at its near side, and there alone, are two motions."""
    (near, far), (on, beyond) = ends, orbits
    while abs(far - near) > search.width and (middle := 0.5 * (near + far)) not in (near, far):
        (ahead,), (back,) = search.along(on.end, [middle]), search.along(beyond.end, [middle])
        if differ(ahead, back):
            near, on = middle, ahead
        else:
            far, beyond = middle, back
    return Loss(direction, ends[0], near, far, on, beyond)


def _ahead(search: Search, loss: Loss, limit: float, longest: float) -> tuple[float, float, Orbit, Orbit] | None:
    """Where the motion is lost beyond the end that was found, as `Stretch` has it; None if it is lost at that end."""
    near, on, far = loss.near, loss.on, loss.far
    step = loss.far - loss.near
    while True:
        (orbit,) = search.along(on.end, [far])
        if orbit.reason is not None:
            return None
        if distance(orbit, on) > distance(orbit, loss.beyond):
            return None if near == loss.near else (near, far, on, orbit)
        if far == limit:
            return None
        near, on = far, orbit
        step = np.sign(step) * min(2 * abs(step), longest)
        far = near + step if abs(step) < abs(limit - near) else limit


# Ranges


@dataclass(frozen=True)
class Range:
    """A range of frequency with two motions.

    Attributes:
        low, high: its ends [Hz]: both motions were found there.
        cut: whether it goes on beyond the low and the high end, where the sweeps end.
        settled: whether the motion that is lost there had settled at the low and the high end.
        jumped: amplitude before and after the jump at each end, shape (2, 2, P, 3); NaN where it is cut.
        lower, upper: the motions at mid-range, that of the smaller amplitude first.
    """

    low: float
    high: float
    cut: tuple[bool, bool]
    settled: tuple[bool, bool]
    jumped: np.ndarray
    lower: Orbit
    upper: Orbit


def ranges(search: Search, sweeps: Sweeps, lost: Sequence[Loss]) -> Iterator[Range]:
    """The ranges between jumps in which the sweeps are on different motions."""
    first, last = float(sweeps.frequency[0]), float(sweeps.frequency[-1])
    ends = sorted({first, last, *(loss.near for loss in lost)})
    for low, high in pairwise(ends):
        within = sweeps.apart[(sweeps.frequency > low) & (sweeps.frequency < high)]
        jumps = (low != first) + (high != last)
        if high - low <= 2 * search.width or (jumps < BOTH and not within.any()):
            continue
        motions = [_at_middle(search, sweeps, lost, direction, (low, high)) for direction in (UP, DOWN)]
        if any(orbit.reason is not None for orbit in motions) or not differ(*motions):
            continue
        lower, upper = sorted(motions, key=lambda orbit: orbit.largest)
        settled = [all(loss.on.settled for loss in lost if loss.near == end) for end in (low, high)]
        cut, jumped = (low == first, high == last), np.array([_jumped(end, lost, lower) for end in (low, high)])
        yield Range(low, high, cut, (settled[0], settled[1]), jumped, lower, upper)


def _jumped(end: float, lost: Sequence[Loss], like: Orbit) -> np.ndarray:
    """Amplitude before and after the jump at an end."""
    here = [loss for loss in lost if loss.near == end]
    return np.array(
        [here[0].on.amplitude, here[0].beyond.amplitude] if here else [np.full_like(like.amplitude, np.nan)] * 2
    )


def _at_middle(
    search: Search, sweeps: Sweeps, lost: Sequence[Loss], direction: int, ends: tuple[float, float]
) -> Orbit:
    """The motion of a sweep at the middle of a range, led there from the nearest place where it is known."""
    sign, middle = (1.0, 0.5 * sum(ends)) if direction == UP else (-1.0, 0.5 * sum(ends))
    own = [loss for loss in lost if loss.direction == direction]
    known = dict(zip(map(float, sweeps.frequency), sweeps.orbits[direction], strict=True))
    for loss in own:
        # Lost by a step that was too long: what the sweep has found from there on to the true end is another motion.
        known = {
            f: orbit for f, orbit in known.items() if not 0 < sign * (f - loss.begin) < sign * (loss.near - loss.begin)
        }
        known |= {loss.near: loss.on, loss.far: loss.beyond}
    left = {loss.near for loss in own} & {ends[0 if direction == UP else 1]}
    behind = [f for f, orbit in known.items() if sign * (middle - f) >= 0 and f not in left and orbit.reason is None]
    if not behind:
        return without_orbit(search.model, "no motion is known before it")
    nearest = max(behind, key=lambda f: sign * f)
    step = (sweeps.frequency[1] - sweeps.frequency[0]) / WALK
    num = max(WALK, int(np.ceil(abs(middle - nearest) / step)))
    return search.along(known[nearest].end, np.linspace(nearest, middle, num + 1)[1:].tolist())[-1]


def ranges_of(search: Search, sweeps: Columns) -> dict[str, np.ndarray]:
    """The jumps and the ranges of a pair of sweeps, and the motions at the middle of each range, as arrays."""
    both = Sweeps.of(sweeps, search.model.start.phase)
    lost = list(losses(search, both))
    every = list(ranges(search, both, lost))
    model, size = search.model, len(every)
    # Of no range the columns have their shapes all the same.
    motions = [[one.lower, one.upper] for one in every] or [[without_orbit(model, "none")] * 2]
    jumped = np.array([one.jumped for one in every]).reshape(size, 2, 2, len(model.structure.points), 3)
    jumps = [(loss.direction, *sorted((loss.near, loss.far))) for loss in lost]
    return {name: array[:size] for name, array in columns_of(motions).items()} | {
        "jumps": np.array(jumps, dtype=float).reshape(-1, 3),
        "jump_from": jumped[:, :, 0],
        "jump_to": jumped[:, :, 1],
        "range": np.array([(one.low, one.high) for one in every]).reshape(-1, 2),
        "range_cut": np.array([one.cut for one in every], dtype=np.int8).reshape(-1, 2),
        "range_settled": np.array([one.settled for one in every], dtype=np.int8).reshape(-1, 2),
    }
