"""Ranges of frequency with two steady motions: both sweeps, each jump bisected, and the motions at mid-range.

A sweep carries its motion along until the motion is gone, at a fold or where it loses its stability, and jumps. Where
the sweeps up and down are on different motions there are two: such a range begins where the downward sweep loses its
motion, and ends where the upward one does. A jump is sought in every step over which the amplitude changes, and in
those after which both sweeps are on one motion. Halving the step distinguishes a jump from a slope, so ranges far
narrower than the step of the sweeps are resolved.

A motion that does not repeat is not one of two. Where a motion that is carried along loses its period, without a jump,
the range ends too: the place is bisected, and its end says so.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from timesim.model.model import Model, Start
from timesim.orbit.batch import Each
from timesim.orbit.jump import AT_LEAST, Stretch, narrowed
from timesim.orbit.settling import Chain, SteadyStates
from timesim.orbit.steady_state import Columns, Orbit, columns_of, differ, distance, orbit_of, without_orbit

UP, DOWN = 0, 1
WALK = 4  # least number of steps in which a motion is carried to mid-range, and parts of a step of the sweeps
BOTH = 2  # ends of a range
NO_MOTION, SMALLER, LARGER = 0, 1, 2
FURTHER = 6  # times that a motion is followed on where it was lost by the length of a step alone


@dataclass(frozen=True)
class RangeSearch:
    """Where to look for the ends of ranges, each to a width [Hz], by steady states as those of the sweeps.

    ``each`` does the work on both sweeps.
    """

    model: Model
    steady: SteadyStates
    width: float
    each: Each = map

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
        jump: between the last frequency with the motion and the first one without; where shorter steps carry the motion
            to the end of the sweep, that frequency twice.
        of_period: whether it goes on without a period there; then the motion that repeats is the near one, even if the
            sweep comes to it from the other side.
    """

    direction: int
    begin: float
    jump: Stretch
    of_period: bool = False

    @property
    def lives(self) -> bool:
        """Whether only the length of a step has lost it, and it lives to the end of the sweep."""
        return self.jump.near == self.jump.far


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

    def change(self, direction: int) -> np.ndarray:
        """Change of the amplitude over each step, the largest of all points, 0 where one failed; shape (F - 1,)."""
        change = np.abs(np.diff(self.amplitude(direction), axis=0))
        return np.nan_to_num(np.max(change, axis=1, initial=0.0))

    @property
    def apart(self) -> np.ndarray:
        """Whether they are on different motions, shape (F,)."""
        return np.array([differ(*pair) for pair in zip(*self.orbits, strict=True)], dtype=bool)


def suspect_steps(sweeps: Sweeps, direction: int) -> np.ndarray:
    """Steps in which a sweep may jump, by the position of the lower point of each."""
    suspects = set(merging_steps(sweeps, direction))
    large = AT_LEAST * np.nanmax(np.abs(sweeps.amplitude(direction)), initial=0.0)
    suspects |= set(np.flatnonzero(sweeps.change(direction) > large).tolist())
    reason = [orbit.reason for orbit in sweeps.orbits[direction]]
    last = len(reason) - 1
    return np.array(sorted(k for k in suspects if 0 <= k < last and not reason[k] and not reason[k + 1]), dtype=int)


def merging_steps(sweeps: Sweeps, direction: int) -> list[int]:
    """Steps of a sweep after which both are on one motion, by the position of the lower point of each."""
    runs = np.flatnonzero(np.diff(sweeps.apart, prepend=False, append=False)).reshape(-1, 2)
    steps = [(int(end - 1), int(end)) if direction == UP else (int(first - 1),) * 2 for first, end in runs]
    last = sweeps.frequency.size - 1
    return [k for k, beyond in steps if 0 <= k < last and not any(own[beyond].reason for own in sweeps.orbits)]


def losses(search: RangeSearch, sweeps: Sweeps) -> Iterator[Loss]:
    """All jumps of both sweeps, and places where they lose their period without one, bisected."""
    for own in search.each(lambda direction: list(_losses_of(search, sweeps, direction)), (UP, DOWN)):
        yield from own


def _losses_of(search: RangeSearch, sweeps: Sweeps, direction: int) -> Iterator[Loss]:
    """Those of one sweep."""
    frequency, orbits = sweeps.frequency, sweeps.orbits[direction]
    limit = float(frequency[-1 if direction == UP else 0])
    least = AT_LEAST * np.nanmax(sweeps.amplitude(direction), initial=0.0)
    change = np.pad(sweeps.change(direction), 1)
    even = change[1:-1] < np.maximum(change[:-2], change[2:])
    merging, suspects = merging_steps(sweeps, direction), set(suspect_steps(sweeps, direction).tolist())
    for k in range(frequency.size - 1):
        near, far = (k, k + 1) if direction == UP else (k + 1, k)
        ends = float(frequency[near]), float(frequency[far])
        step = Stretch(search.model, *ends, orbits[near], orbits[far], least, even=bool(even[k]))
        jumps = list(_lost(search, step, limit)) if k in suspects else []
        if not jumps and k in merging:
            jumps = [_merging(search, step)]
        if jumps:
            yield from (Loss(direction, step.near, jump) for jump in jumps)
        elif step.on.settled and step.beyond.irregular:
            yield Loss(direction, step.near, _without_period(search, step), of_period=True)
        elif step.on.irregular and step.beyond.settled:
            back = replace(step, near=step.far, far=step.near, on=step.beyond, beyond=step.on)
            yield Loss(direction, back.near, _without_period(search, back), of_period=True)


def _lost(search: RangeSearch, step: Stretch, limit: float) -> Iterator[Stretch]:
    """Bisect the jumps in a step; a motion that was lost by the length of a step alone is followed beyond it."""
    for _, jump in narrowed([step], search.steady, search.width):
        end = _followed(search, jump, limit, abs(step.far - step.near) / WALK)
        if end is not None:
            yield end


def _followed(search: RangeSearch, jump: Stretch, limit: float, longest: float) -> Stretch | None:
    """The jump at which a motion is lost however short the steps; None if it is lost over a slope.

    Where it lives to the limit, the stretch has no length.
    """
    for _ in range(FURTHER):
        ahead = _ahead(search, jump, limit, longest)
        if ahead is None:
            break
        if ahead.near == limit:
            return ahead
        jumps = narrowed([ahead], search.steady, search.width)
        if not jumps:
            return None
        jump = jumps[0][1]
    return jump


def _merging(search: RangeSearch, step: Stretch) -> Stretch:
    """Bisect a jump that is small beside the slope of the step: there are two motions on its near side only."""
    while abs(step.far - step.near) > search.width and (middle := step.middle) not in (step.near, step.far):
        (ahead,), (back,) = search.along(step.on.end, [middle]), search.along(step.beyond.end, [middle])
        step = replace(step, near=middle, on=ahead) if differ(ahead, back) else replace(step, far=middle, beyond=back)
    return step


def _without_period(search: RangeSearch, step: Stretch) -> Stretch:
    """Bisect the place beyond which a motion does not repeat."""
    while abs(step.far - step.near) > search.width and (middle := step.middle) not in (step.near, step.far):
        (orbit,) = search.along(step.on.end, [middle])
        repeats = orbit.reason is None and not orbit.irregular
        step = replace(step, near=middle, on=orbit) if repeats else replace(step, far=middle, beyond=orbit)
    return step


def _ahead(search: RangeSearch, jump: Stretch, limit: float, longest: float) -> Stretch | None:
    """Where the motion is lost beyond a jump; None if it is lost there. Without length if it lives to the limit."""
    near, on, far = jump.near, jump.on, jump.far
    step = jump.far - jump.near
    while True:
        (orbit,) = search.along(on.end, [far])
        if orbit.reason is not None:
            return None
        if distance(orbit, on) > distance(orbit, jump.beyond):
            return None if near == jump.near else Stretch(search.model, near, far, on, orbit, jump.least)
        if far == limit:
            return replace(jump, near=limit, far=limit, on=orbit, beyond=orbit)
        near, on = far, orbit
        step = float(np.copysign(min(2 * abs(step), longest), step))
        far = near + step if abs(step) < abs(limit - near) else limit


# Ranges


@dataclass(frozen=True)
class BistableRange:
    """A range of frequency with two motions.

    Attributes:
        low, high: its ends [Hz], at which both motions still exist.
        cut: whether it goes on beyond the low and the high end, where the sweeps end.
        settled: whether the motion that is lost there had settled at the low and the high end.
        irregular: the motion that goes on without a period beyond the low and the high end: `NO_MOTION`, `SMALLER` or
            `LARGER`.
        jumped: amplitude before and after the jump at each end, shape (2, 2, P, 3); NaN where it is cut.
        lower, upper: the motions at mid-range, that of the smaller amplitude first.
    """

    low: float
    high: float
    cut: tuple[bool, bool]
    settled: tuple[bool, bool]
    irregular: tuple[int, int]
    jumped: np.ndarray
    lower: Orbit
    upper: Orbit


def ranges(search: RangeSearch, sweeps: Sweeps, lost: Sequence[Loss]) -> Iterator[BistableRange]:
    """The ranges between jumps in which the sweeps are on different motions."""
    first, last = float(sweeps.frequency[0]), float(sweeps.frequency[-1])
    ends = sorted({first, last, *(loss.jump.near for loss in lost)})
    for low, high in pairwise(ends):
        above, below = sweeps.frequency > low, sweeps.frequency < high
        within = sweeps.apart[(above | (low == first)) & (below | (high == last))]
        jumps = int(low != first) + int(high != last)
        if high - low <= 2 * search.width or (jumps < BOTH and not within.any()):
            continue
        motions = [_at_middle(search, sweeps, lost, direction, (low, high)) for direction in (UP, DOWN)]
        if any(orbit.reason is not None or orbit.irregular for orbit in motions) or not differ(*motions):
            continue
        lower, upper = sorted(motions, key=lambda orbit: orbit.largest)
        at_ends = [[loss for loss in lost if loss.jump.near == end and not loss.lives] for end in (low, high)]
        settled = [all(loss.jump.on.settled for loss in here) for here in at_ends]
        number = [SMALLER if orbit is lower else LARGER for orbit in motions]
        irregular = [next((number[one.direction] for one in here if one.of_period), NO_MOTION) for here in at_ends]
        none = [np.full_like(lower.amplitude, np.nan)] * 2
        jumped = [[here[0].jump.on.amplitude, here[0].jump.beyond.amplitude] if here else none for here in at_ends]
        cut, ends_settled, losers = (low == first, high == last), (settled[0], settled[1]), (irregular[0], irregular[1])
        yield BistableRange(low, high, cut, ends_settled, losers, np.array(jumped), lower, upper)


def _at_middle(
    search: RangeSearch, sweeps: Sweeps, lost: Sequence[Loss], direction: int, ends: tuple[float, float]
) -> Orbit:
    """The motion of a sweep at the middle of a range, led there from the nearest place where it is known."""
    sign, middle = (1.0, 0.5 * sum(ends)) if direction == UP else (-1.0, 0.5 * sum(ends))
    own = [loss for loss in lost if loss.direction == direction]
    known = dict(zip(map(float, sweeps.frequency), sweeps.orbits[direction], strict=True))
    for loss in own:
        # Lost by a step that was too long: from there on to the true end the sweep was on another motion.
        known = {
            f: orbit
            for f, orbit in known.items()
            if not 0 < sign * (f - loss.begin) < sign * (loss.jump.near - loss.begin)
        }
        known |= {loss.jump.near: loss.jump.on, loss.jump.far: loss.jump.beyond}
    left = {loss.jump.near for loss in own if not loss.of_period} & {ends[0 if direction == UP else 1]}
    behind = [f for f, orbit in known.items() if sign * (middle - f) >= 0 and f not in left and orbit.reason is None]
    if not behind:
        return without_orbit(search.model, "no motion is known before it")
    nearest = max(behind, key=lambda f: sign * f)
    step = (sweeps.frequency[1] - sweeps.frequency[0]) / WALK
    num = max(WALK, int(np.ceil(abs(middle - nearest) / step)))
    return search.along(known[nearest].end, np.linspace(nearest, middle, num + 1)[1:].tolist())[-1]


def _interval(frequency: np.ndarray, loss: Loss) -> list[float]:
    """Low and high end of a jump [Hz]: the whole step where only its length has lost the motion."""
    if not loss.lives:
        return sorted((loss.jump.near, loss.jump.far))
    near = int(np.searchsorted(frequency, loss.begin))
    return sorted(map(float, (frequency[near], frequency[near + (1 if loss.direction == UP else -1)])))


def ranges_of(search: RangeSearch, sweeps: Columns) -> dict[str, np.ndarray]:
    """The jumps and the ranges of a pair of sweeps, and the motions in the middle of ranges, as arrays."""
    both = Sweeps.of(sweeps, search.model.start.phase)
    lost = list(losses(search, both))
    every = list(ranges(search, both, lost))
    jumps = [(loss.direction, *_interval(both.frequency, loss)) for loss in lost if not loss.of_period]
    ends = np.array([(one.low, one.high) for one in every]).reshape(-1, 2)
    found = {"jumps": np.array(jumps, dtype=float).reshape(-1, 3), "range": ends}
    if not every:
        return found
    jumped = np.array([one.jumped for one in every])
    found |= columns_of([[one.lower, one.upper] for one in every])
    found |= {"jump_from": jumped[:, :, 0], "jump_to": jumped[:, :, 1]}
    marks = ("cut", "settled", "irregular")
    return found | {f"range_{name}": np.array([getattr(one, name) for one in every], dtype=np.int8) for name in marks}
