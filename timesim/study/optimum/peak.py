"""The peak of the response over frequency with one value of a scalar.

Each value is swept up and down, so that the larger of two motions counts if a sweep comes to it; near the largest
points of both sweeps the peak is sought between their frequencies. A larger motion to which neither comes is found from
a value beside, of which it is carried over.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from timesim.fault import RuleError
from timesim.model.contact_state import contact_loads
from timesim.model.model import Model, Start
from timesim.model.solver import Solver
from timesim.model.start import resumed_start
from timesim.orbit.settling import Chain
from timesim.orbit.steady_state import COLUMNS, SAME, Orbit, blank_columns, columns_of, orbit_of
from timesim.scene.sweep import OptimumPlan
from timesim.study.execution.campaign import Result
from timesim.study.sweep import steady_of

NEARLY = 0.9  # of the largest amplitude: other maxima above it may be larger between the points of the sweep
FINE = 1e-3  # of a step of the sweep: the frequency of a peak, whose height depends on it in second order only
STARTS = 6  # motions of a value beside that are carried over, of those larger than the peak


class Peak(NamedTuple):
    """The largest amplitude for a value, its frequency [Hz], whether that is an end of the sweep, the kind of motion.

    The names are those of the variables of the result.
    """

    peak: float
    peak_frequency: float = np.nan
    peak_at_end: bool = False
    peak_settled: bool = False
    peak_irregular: bool = False
    peak_of: int = 0
    """Position of its point and axis among those of the scene; their names in the result."""
    peak_carried: bool = False
    """Whether no sweep comes to its motion, which goes on from a value beside."""


@dataclass(frozen=True)
class Response:
    """The scene with one value of the scalar, and the plan, which says whose amplitude counts at which frequencies."""

    model: Model
    plan: OptimumPlan
    solver: Solver

    def size(self, orbit: Orbit) -> float:
        """The amplitude that counts; NaN where the point failed."""
        return float(np.max(orbit.amplitude[self._counts]))

    def place(self, orbit: Orbit) -> int:
        """Position of the point and axis that have it."""
        return int(np.argmax(np.where(self._counts, orbit.amplitude, -1.0)))

    @property
    def _counts(self) -> np.ndarray:
        """Which points and axes count, shape (P, 3)."""
        points, (point, axis) = self.model.structure.points, (self.plan.point, self.plan.axis)
        own = np.array([point in (None, name) for name in points])
        return own[:, None] & np.array([axis in (None, name) for name in "xyz"])

    def steady(self, *chains: Chain) -> list[list[Orbit]]:
        return steady_of(chains, self.solver, self.plan.sweep.criterion)


def respond(response: Response, before: Result | None) -> Result:
    """Both sweeps with one value of the scalar, and their peak."""
    model, up = response.model, tuple(map(float, response.plan.sweep.frequency))
    orbits = response.steady(Chain(model, up), Chain(model, up[::-1]))
    orbits[1] = orbits[1][::-1]
    return columns_of(orbits) | _arrays(_peak(response, orbits))


def _arrays(peak: Peak) -> dict[str, np.ndarray]:
    return {name: np.array(value + 0) for name, value in peak._asdict().items()}


def _peak(response: Response, orbits: list[list[Orbit]]) -> Peak:
    """The largest amplitude of both sweeps, refined between their points."""
    size = np.array([[response.size(orbit) for orbit in own] for own in orbits])
    if not np.isfinite(size).any():
        return Peak(np.nan)
    known = np.where(np.isfinite(size), size, -np.inf)
    best = Peak(-np.inf)
    last = size.shape[1] - 1
    for d, i in np.argwhere(known >= NEARLY * known.max()).tolist():
        if known[d, i] < known[d, max(i - 1, 0) : i + 2].max():
            continue
        frequency, at_end = float(response.plan.sweep.frequency[i]), last > 0 and i in (0, last)
        best = max(best, _peak_at(response, orbits[d][i], frequency, at_end=at_end))
        if d == 1 and np.isclose(size[0, i], size[1, i], rtol=1e-6, atol=0.0):
            continue
        if last > 0:
            best = max(best, _refined(response, orbits[d][i], i))
    return best


def _refined(response: Response, orbit: Orbit, i: int) -> Peak:
    """The peak between the neighbours of a point of the sweep, its motion carried along from the highest one seen.

    A branch that ends at a jump is highest there, and a longer step would lose it, as one of the sweep may have done:
    where it is still rising at the next point of the sweep, it is followed on from there. At an end of the sweep the
    peak is sought only where the response rises from there.
    """
    frequency, last = response.plan.sweep.frequency, response.plan.sweep.frequency.size - 1
    low, here, high = (float(frequency[k]) for k in (max(i - 1, 0), i, min(i + 1, last)))
    seen = [(_peak_at(response, orbit, here, at_end=i in (0, last)), orbit)]
    accuracy = FINE * (high - low) / 2

    def fall(frequency: float) -> float:
        _, highest = max(seen, key=itemgetter(0))
        ((there,),) = response.steady(Chain(replace(response.model, start=highest.end), (float(frequency),)))
        seen.append((_peak_at(response, there, float(frequency)), there))
        return -seen[-1][0].peak

    if here not in (low, high) or -fall(here + FINE * (low + high - 2 * here)) > response.size(orbit):
        minimize_scalar(fall, bounds=(low, high), method="bounded", options={"xatol": accuracy})
    peak, highest = max(seen, key=itemgetter(0))
    beside = [k for k in (i - 1, i + 1) if 0 <= k <= last and abs(frequency[k] - peak.peak_frequency) <= 2 * accuracy]
    return _refined(response, highest, beside[0]) if beside else peak


def _peak_at(response: Response, orbit: Orbit, frequency: float, *, at_end: bool = False) -> Peak:
    """The amplitude of a motion as a peak; one that failed is below all others."""
    size = response.size(orbit)
    height = size if np.isfinite(size) else -np.inf
    return Peak(height, frequency, at_end, orbit.settled, orbit.irregular, response.place(orbit))


# Motions that no sweep comes to


class Motion(NamedTuple):
    """A steady state at a frequency of the sweeps: its amplitude that counts, the position of that, its state."""

    size: float
    place: int
    start: Start


@dataclass(frozen=True)
class Carried:
    """Motions of a value beside that are larger than the peak of a value, to which they are to be carried over."""

    response: Response
    peak: float
    motions: tuple[Motion, ...]


def larger_motions(response: Response, result: Result, least: float) -> tuple[Motion, ...]:
    """At most `STARTS` motions of a result, of its sweeps or carried over to it, that are larger than a peak.

    From the largest on, evenly by their size: a branch ends where it is highest, and of its motions those below may go
    on where the highest does not.
    """
    found = []
    for columns in (result, {name: result.get(f"carried_{name}", result[name][:0]) for name in COLUMNS}):
        for row, place in np.ndindex(columns["cycles"].shape[:2]):
            orbit = orbit_of(columns, (row, place), response.model.start.phase)
            if orbit.settled and (size := response.size(orbit)) > least:
                found.append(Motion(size, place, orbit.end))
    found.sort(key=lambda motion: -motion.size)
    chosen = np.unique(np.linspace(0, len(found) - 1, min(STARTS, len(found))).round().astype(int))
    return tuple(found[i] for i in chosen)


def begin_from(model: Model, end: Start) -> Start:
    """A state of a model with another value of a scalar as the start of this one; forces beyond the cone are on it.

    Raises:
        RuleError: as of `resumed_start`.
    """
    loads = contact_loads(model, end.displacement, end.slip)
    share = np.divide(loads.limit, loads.size, out=np.ones_like(loads.size), where=loads.size > loads.limit)
    slip = loads.motion - share[:, None] * (loads.motion - end.slip)
    return resumed_start(model, replace(end, slip=slip), [contact.name for contact in model.contacts])


def carry_over(carried: Carried, before: Result | None) -> Result:
    """The motions that stay larger than the peak, as columns at the frequencies of the sweep, and their peak."""
    own, frequency = carried.response, carried.response.plan.sweep.frequency
    count, begun = frequency.size, dict[int, Chain]()
    for i, (_, place, end) in enumerate(carried.motions):
        with suppress(RuleError):  # no state of a model of this value
            begun[i] = Chain(replace(own.model, start=begin_from(own.model, end)), (float(frequency[place]),))
    highest: dict[int, Orbit] = {}
    for i, (orbit,) in zip(begun, own.steady(*begun.values()), strict=True):
        place = carried.motions[i].place
        known = own.size(highest[place]) if place in highest else (1 + SAME) * carried.peak
        if orbit.settled and own.size(orbit) > known:
            highest[place] = orbit
    columns = blank_columns(own.model, 1, count)
    peak = Peak(-np.inf)
    for place, orbit in highest.items():
        for name, values in columns_of([[orbit]]).items():
            columns[name][0, place] = values[0, 0]
        at_end = count > 1 and place in (0, count - 1)
        peak = max(peak, _peak_at(own, orbit, float(frequency[place]), at_end=at_end))
    if highest and count > 1:
        place = max(highest, key=lambda place: own.size(highest[place]))
        peak = max(peak, _refined(own, highest[place], place))
    columns["reason"] = columns["reason"].astype(str)  # as it is kept
    arrays = _arrays(peak._replace(peak_carried=True)) if highest else {}
    return {f"carried_{name}": values for name, values in columns.items()} | arrays
