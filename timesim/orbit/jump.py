"""Jumps along a sweep: the frequency at which the motion leaves its branch, by bisection.

A step over which the amplitude changes is halved, the motion carried from the near end to the middle, and so is each
half over which it still changes. Over a slope the change shrinks with the length; over a jump it stays. So a jump is
narrowed down to the wanted width even where it shares a step with a slope. Two jumps of one size in a step may leave
its halves as even as a slope does, but not the halves of these.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from timesim.model.model import Model
from timesim.orbit.settling import Chain, SteadyStates
from timesim.orbit.steady_state import Orbit, distance

STANDS_OUT = 4.0  # change of the amplitude over a jump, as a multiple of that over the steps beside it
AT_LEAST = 0.03  # least change over a jump, as a share of the amplitude; of the largest where no step is halved
STAYS, HALVINGS = 0.5, 3  # share of the change that a jump keeps over so many halvings; a slope keeps an eighth
EVEN = 0.6  # largest share of the change in one half of a slope
GENTLE = 10.0  # change, as a multiple of the least, up to which one that is even twice in a row is a slope


@dataclass(frozen=True)
class Watched:
    """Steady states of a search, and why some of them could not be computed: it has gone on without these."""

    steady: SteadyStates
    failures: list[str] = field(default_factory=list)

    def __call__(self, chains: Sequence[Chain]) -> list[list[Orbit]]:
        orbits = self.steady(chains)
        self.failures.extend(orbit.reason for own in orbits for orbit in own if orbit.reason is not None)
        return orbits


@dataclass(frozen=True)
class Stretch:
    """Frequencies over which the amplitude changes.

    Attributes:
        near, far: ends, in the direction of the sweep [Hz].
        on, beyond: the motions there.
        least: change of amplitude below which nothing is called a jump.
        before: changes over the stretches that this one is a part of, each by way of its middle, the longest first.
        even: whether the amplitude changes alike over the stretch beside it, its other half or a step of the sweep.
        whole: whether it cannot be halved any more.
    """

    model: Model
    near: float
    far: float
    on: Orbit
    beyond: Orbit
    least: float
    before: tuple[float, ...] = ()
    even: bool = False
    whole: bool = False

    @property
    def change(self) -> float:
        """Change of the amplitude, the largest of all points and axes."""
        return distance(self.on, self.beyond)

    @property
    def middle(self) -> float:
        """Frequency between the ends [Hz]."""
        return 0.5 * (self.near + self.far)

    def jumps(self, width: float) -> bool | None:
        """Whether the motion jumps within it; None as long as it must be halved to tell, or to be as narrow [Hz]."""
        if self.whole or self.middle in (self.near, self.far):
            return True
        if not self.change > self.least:
            return False
        narrow = abs(self.far - self.near) <= width and len(self.before) >= HALVINGS
        return True if narrow and self.change > STAYS * self.before[-HALVINGS] else None

    def halves(self, orbit: Orbit) -> "Iterator[Stretch]":
        """Both halves, given the motion carried to the middle; none of a slope, where the change is small and even.

        Where the motion at the middle could not be computed, the stretch cannot be halved.
        """
        if orbit.reason is not None:
            yield replace(self, whole=True)
            return
        parts = distance(self.on, orbit), distance(orbit, self.beyond)
        even = max(parts) < EVEN * self.change < EVEN * GENTLE * self.least
        if even and self.even:
            return
        # Not the change from end to end: over a peak in between that is less than over a part of the way.
        half = replace(self, before=(*self.before, sum(parts)), even=even)
        yield replace(half, far=self.middle, beyond=orbit)
        yield replace(half, near=self.middle, on=orbit)


def narrowed(stretches: Sequence[Stretch], steady: SteadyStates, width: float) -> list[tuple[int, Stretch]]:
    """The jumps within stretches, each with the position of its stretch and at most as wide as wanted [Hz].

    ``steady`` computes steady states with the solver and criterion of the sweep.
    """
    jumps: list[tuple[int, Stretch]] = []
    left = list(enumerate(stretches))
    while left:
        judged = [(index, stretch, stretch.jumps(width)) for index, stretch in left]
        jumps += [(index, stretch) for index, stretch, jump in judged if jump]
        open_ = [(index, stretch) for index, stretch, jump in judged if jump is None]
        chains = [Chain(replace(part.model, start=part.on.end), (part.middle,)) for _, part in open_]
        middles = steady(chains) if chains else []
        left = []
        for (index, stretch), (orbit,) in zip(open_, middles, strict=True):
            left += [(index, half) for half in stretch.halves(orbit)]
    return _joined(sorted(jumps, key=lambda item: (item[0], abs(item[1].near - stretches[item[0]].near))))


def _joined(jumps: Sequence[tuple[int, Stretch]]) -> list[tuple[int, Stretch]]:
    """Adjacent jumps as one: next to a fold a motion leaves its branch so slowly that it is met on the way."""
    joined: list[tuple[int, Stretch]] = []
    for index, jump in jumps:
        if joined and joined[-1][0] == index and joined[-1][1].far == jump.near:
            joined[-1] = index, replace(joined[-1][1], far=jump.far, beyond=jump.beyond)
        else:
            joined.append((index, jump))
    return joined


def jumps_of(stretches: Sequence[Stretch], steady: SteadyStates, width: float) -> Iterator[tuple[int, float, float]]:
    """The jumps within the steps of sweeps: position of the step, low and high end [Hz]; arguments as `narrowed`.

    Halving takes long steps too, and may lose a motion by their length alone: one that is carried over such a jump is
    followed from there on. If it lives to the end of the step, it was lost only because the step was long, and the jump
    is the whole step. Where the motion of the sweep is lost before that, shorter steps carry another one, which the
    sweep was never on: what it loses at the end is no jump of the sweep.
    """
    found: list[list[Stretch]] = [[] for _ in stretches]
    left, by_length = dict(enumerate(stretches)), set[int]()
    while left:
        steps = list(left)
        jumps = narrowed(list(left.values()), steady, width)
        chains = [Chain(replace(jump.model, start=jump.on.end), (jump.far,)) for _, jump in jumps]
        carried = steady(chains) if chains else []
        ahead: dict[int, Stretch] = {}
        for (position, jump), (orbit,) in zip(jumps, carried, strict=True):
            index = steps[position]
            if index in ahead:  # a jump behind one at which the motion is not lost
                continue
            if jump.whole or not _lives(jump, orbit):
                found[index].append(jump)
                continue
            step = stretches[index]
            lost = _followed(replace(jump, near=jump.far, on=orbit), step.far, steady, width)
            if lost is None:
                by_length.add(index)
            else:
                found[index].append(lost)
            end = step.far if lost is None else lost.far
            beyond = step.beyond if lost is None else lost.beyond
            ahead[index] = replace(step, near=end, on=beyond, before=(), even=False)
        left = {index: rest for index, rest in ahead.items() if rest.near != rest.far}
    for index, step in enumerate(stretches):
        for jump in found[index] or [step] * (index in by_length):
            yield index, min(jump.near, jump.far), max(jump.near, jump.far)


def _followed(jump: Stretch, limit: float, steady: SteadyStates, width: float) -> Stretch | None:
    """Where the motion before a jump is lost however short the steps; None if it lives to the limit [Hz].

    Steps grow until one loses it, and are then halved, down to the wanted width [Hz]; from then on they are at most
    half as long as any that has.
    """
    least = max(width, 4 * float(np.spacing(abs(limit))))
    near, on, size, longest = jump.near, jump.on, least, np.inf
    while near != limit:
        far = near + float(np.copysign(size, limit - near)) if size < abs(limit - near) else limit
        ((orbit,),) = steady([Chain(replace(jump.model, start=on.end), (far,))])
        if _lives(replace(jump, on=on), orbit):
            near, on, size = far, orbit, min(2 * size, longest)
        elif size <= least or orbit.reason is not None:
            return replace(jump, near=near, far=far, on=on, beyond=orbit, whole=orbit.reason is not None)
        else:
            longest = size = max(min(size, abs(far - near)) / 2, least)
    return None


def _lives(jump: Stretch, orbit: Orbit) -> bool:
    """Whether the motion before a jump, carried over it, is still the same."""
    return orbit.reason is None and distance(jump.on, orbit) < STAYS * distance(jump.on, jump.beyond)


def steps_of(model: Model, frequencies: Sequence[float], orbits: Sequence[Orbit]) -> list[Stretch]:
    """The steps of a sweep over which the amplitude changes; frequencies [Hz] and motions in the order of the sweep.

    Where a step beside one has at least half of its change, they are alike, as two halves are.
    """
    done = [one.reason is None and other.reason is None for one, other in pairwise(orbits)]
    change = [distance(*pair) if known else 0.0 for pair, known in zip(pairwise(orbits), done, strict=True)]
    beside = np.maximum([0.0, *change[:-1]], [*change[1:], 0.0])
    steps = []
    for i, known in enumerate(done):
        size = max(float(np.nanmax(orbit.amplitude, initial=0.0)) for orbit in orbits[i : i + 2])
        ends, even = (frequencies[i], frequencies[i + 1]), bool(change[i] <= 2 * beside[i])
        step = Stretch(model, *ends, orbits[i], orbits[i + 1], AT_LEAST * size, even=even)
        if known and step.change > step.least:
            steps.append(step)
    return steps


def suspects(amplitude: np.ndarray) -> np.ndarray:
    """Steps of a sweep over which the amplitude changes by far more than over those beside them.

    Beside the fall from the top of a resonance the amplitude changes much, too, but not by a large factor.

    They go by the positions of the points before them; ``amplitude``: of all points along all axes, shape (F, X).
    """
    if len(amplitude) < 3:
        return np.zeros(0, dtype=int)
    size = np.abs(amplitude).max(axis=1, initial=0.0)
    largest = np.nanmax(size, initial=1e-300)
    change = np.max(np.abs(np.diff(amplitude, axis=0)), axis=1, initial=0.0) / largest
    factor = np.abs(np.diff(np.log(np.maximum(size, AT_LEAST**2 * largest))))
    with np.errstate(invalid="ignore"):
        stands_out = (change >= STANDS_OUT * _beside(change)) | (
            (factor > np.log(STANDS_OUT)) & (factor >= STANDS_OUT * _beside(factor))
        )
        return np.flatnonzero((change > AT_LEAST) & stands_out)


def _beside(change: np.ndarray) -> np.ndarray:
    """The larger change of the steps beside each one; NaN where there is none."""
    around = np.concatenate([[np.nan], change, [np.nan]])
    return np.asarray(np.fmax(around[:-2], around[2:]))
