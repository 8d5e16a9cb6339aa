"""Where sweeps lose their motion: by a jump, or since it does not repeat any more; each place bisected.

A jump is sought in every step over which the amplitude changes, and in those after which both sweeps are on one motion.
Halving the step distinguishes a jump from a slope, so ranges far narrower than the step of the sweeps are resolved.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from timesim.model.model import Model, Start
from timesim.orbit.batch import Each
from timesim.orbit.jump import AT_LEAST, Stretch, narrowed
from timesim.orbit.settling import Chain, SteadyStates
from timesim.orbit.steady_state import Columns, Orbit, differ, distance, orbit_of

UP, DOWN = 0, 1
WALK = 4  # least number of steps in which a motion is carried to mid-range, and parts of a step of the sweeps
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
        num = columns["settled"].shape[1]
        up, down = ([orbit_of(columns, (direction, k), phase) for k in range(num)] for direction in (UP, DOWN))
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
        if ahead.near == ahead.far:
            return ahead if ahead.near == limit else None
        jump = ahead
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


def traced_back(search: RangeSearch, sweeps: Sweeps, lost: Sequence[Loss], loss: Loss) -> Loss:
    """Where the motion to which a sweep came by a jump is lost if it is followed back, as far as the other sweep's.

    ``lost`` are the losses of both sweeps, ``loss`` is the one with the jump.
    """
    sign, place = (1.0 if loss.direction == UP else -1.0), loss.jump.near
    others = [one.jump.near for one in lost if one.direction != loss.direction]
    limits = [f for f in (*others, *map(float, sweeps.frequency[[0, -1]])) if sign * (place - f) > 0]
    back = replace(loss.jump, near=loss.jump.far, far=place, on=loss.jump.beyond, beyond=loss.jump.on)
    if not limits or back.on.irregular:
        return loss
    longest = float(sweeps.frequency[1] - sweeps.frequency[0]) / WALK
    end = _followed(search, back, max(limits, key=lambda f: sign * f), longest) or back
    way = np.linspace(back.near, end.near, 2 + int(abs(end.near - back.near) / longest)).tolist()
    orbits = [back.on, *search.along(back.on.end, way[1:])]
    for k in range(1, len(way)):
        if orbits[k].irregular:
            step = replace(back, near=way[k - 1], far=way[k], on=orbits[k - 1], beyond=orbits[k])
            return Loss(loss.direction, back.near, _without_period(search, step), of_period=True)
    return Loss(loss.direction, back.near, end)


def _ahead(search: RangeSearch, jump: Stretch, limit: float, longest: float) -> Stretch | None:
    """The next jump at which the motion is lost beyond a jump; None if it is lost at that.

    Without length, at the limit where it lives so far, at the first where it has come down a slope to the one beyond.
    """
    near, on, far, beyond = jump.near, jump.on, jump.far, jump.beyond
    step, way = jump.far - jump.near, list[float]()
    while True:
        (orbit,) = search.along(on.end, [far])
        if orbit.reason is not None:
            return None
        way.append(far)
        if distance(orbit, on) > distance(orbit, beyond):
            if near == jump.near:
                return None
            part = Stretch(search.model, near, far, on, orbit, jump.least)
            if jumps := narrowed([part], search.steady, search.width):
                return jumps[0][1]
            # On a slope it may pass the size that the other motion had at the jump: what that one is here tells.
            beyond, way = search.along(beyond.end, way)[-1], []
            if not differ(orbit, beyond):
                return replace(jump, far=jump.near)
        if far == limit:
            return replace(jump, near=limit, far=limit, on=orbit, beyond=orbit)
        near, on = far, orbit
        step = float(np.copysign(min(2 * abs(step), longest), step))
        far = near + step if abs(step) < abs(limit - near) else limit
