"""Ranges of frequency with two steady motions: both sweeps, each jump bisected, and the motions at mid-range.

A sweep carries its motion along until the motion is gone, at a fold or where it loses its stability, and jumps. Where
the sweeps up and down are on different motions there are two: such a range begins where the downward sweep loses its
motion, and ends where the upward one does.

A motion that does not repeat is not one of two. Where a motion that is carried along loses its period, without a jump,
the range ends too: the place is bisected, and its end says so. Where a sweep comes to its motion by a jump from one
that does not repeat, the motion is followed back to where it is lost: there the range begins.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from timesim.orbit.steady_state import Columns, Orbit, columns_of, differ, without_orbit
from timesim.orbit.two_motions.loss import DOWN, UP, WALK, Loss, RangeSearch, Sweeps, losses, traced_back

BOTH = 2  # ends of a range
NO_MOTION, SMALLER, LARGER = 0, 1, 2


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
    settled: tuple[bool, ...]
    irregular: tuple[int, ...]
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
        yield _range(search, sweeps, lost, (low, high), motions)


def _range(
    search: RangeSearch, sweeps: Sweeps, lost: Sequence[Loss], between: tuple[float, float], motions: Sequence[Orbit]
) -> BistableRange:
    """The range about the motions of both sweeps at the middle between two places of losses."""
    ends, at_ends = list(between), list[list[Loss]]()
    for side, direction in enumerate((UP, DOWN)):
        here = _losses_at(lost, between[side])
        if here and all(loss.direction == direction and loss.jump.on.irregular and not loss.of_period for loss in here):
            begun = traced_back(search, sweeps, lost, here[0])
            ends[side] = begun.jump.near
            here = _losses_at([begun, *lost], ends[side])
        at_ends.append(here)
    if sum(ends) != sum(between):  # where an end was followed back, the middle is another one
        old, new = 0.5 * sum(between), 0.5 * sum(ends)
        motions = [_carried(search, sweeps, orbit, old, new) for orbit in motions]
    lower, upper = sorted(motions, key=lambda orbit: orbit.largest)
    number = [SMALLER if orbit is lower else LARGER for orbit in motions]
    none = [np.full_like(lower.amplitude, np.nan)] * 2
    return BistableRange(
        low=ends[0],
        high=ends[1],
        cut=(ends[0] == sweeps.frequency[0], ends[1] == sweeps.frequency[-1]),
        settled=tuple(all(loss.jump.on.settled for loss in here) for here in at_ends),
        irregular=tuple(next((number[x.direction] for x in here if x.of_period), NO_MOTION) for here in at_ends),
        jumped=np.array([[x[0].jump.on.amplitude, x[0].jump.beyond.amplitude] if x else none for x in at_ends]),
        lower=lower,
        upper=upper,
    )


def _losses_at(lost: Sequence[Loss], place: float) -> list[Loss]:
    return [loss for loss in lost if loss.jump.near == place and not loss.lives]


def _at_middle(
    search: RangeSearch, sweeps: Sweeps, lost: Sequence[Loss], direction: int, ends: tuple[float, float]
) -> Orbit:
    """The motion of a sweep at the middle of a range, led there from the nearest place where it is known."""
    sign, middle = (1.0, 0.5 * sum(ends)) if direction == UP else (-1.0, 0.5 * sum(ends))
    own = [loss for loss in lost if loss.direction == direction]
    known = dict(zip(map(float, sweeps.frequency), sweeps.orbits[direction], strict=True))
    for loss in own:
        # Lost by a step that was too long: from there on to the true end the sweep was on another motion.
        way = sign * (loss.jump.near - loss.begin)
        known = {f: orbit for f, orbit in known.items() if not 0 < sign * (f - loss.begin) < way}
        known |= {loss.jump.near: loss.jump.on, loss.jump.far: loss.jump.beyond}
    left = {loss.jump.near for loss in own if not loss.of_period} & {ends[0 if direction == UP else 1]}
    behind = [f for f, orbit in known.items() if sign * (middle - f) >= 0 and f not in left and orbit.reason is None]
    if not behind:
        return without_orbit(search.model, "no motion is known before it")
    nearest = max(behind, key=lambda f: sign * f)
    return _carried(search, sweeps, known[nearest], nearest, middle)


def _carried(search: RangeSearch, sweeps: Sweeps, orbit: Orbit, start: float, stop: float) -> Orbit:
    """A motion led from one frequency to another, in steps shorter than those of the sweeps."""
    step = (sweeps.frequency[1] - sweeps.frequency[0]) / WALK
    num = max(WALK, int(np.ceil(abs(stop - start) / step)))
    return search.along(orbit.end, np.linspace(start, stop, num + 1)[1:].tolist())[-1]


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
