"""The `optimum` study: the peak of the response over frequency against a scalar, and the value where it is least.

Each value is swept up and down, so that the larger of two motions counts if a sweep comes to it; near the largest
points of both sweeps the peak is sought between their frequencies. The value of least peak is then sought between the
neighbours of the least one by bounded minimisation [1]_, until no value at the distance of the accuracy has a smaller
peak.

.. [1] R. P. Brent, *Algorithms for Minimization Without Derivatives*, Prentice-Hall (1973), chapter 5.
"""

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from xarray import Dataset

from timesim.fault import SceneError
from timesim.model.model import Model
from timesim.model.solver import Solver
from timesim.orbit.settling import Chain, warm_up
from timesim.orbit.steady_state import COLUMNS, Orbit, blank_columns, columns_of
from timesim.result.dataset import Arrays
from timesim.result.file import StoreError
from timesim.result.label import counted
from timesim.scene.resolution import Scene
from timesim.scene.sweep import OptimumPlan
from timesim.study.execution.campaign import INTERRUPTED, Chunk, Execution, Result, carry_through
from timesim.study.execution.progress import Phases
from timesim.study.outcome import Outcome, attributes
from timesim.study.summary.optimum import as_low, optimum_lines
from timesim.study.summary.sweep import failure_line
from timesim.study.sweep import Grid, steady_dataset, steady_of

NEARLY = 0.9  # of the largest amplitude: other maxima above it may be larger between the points of the sweep
FINE = 1e-3  # of a step of the sweep: the frequency of a peak, whose height depends on it in second order only
CHECKS = 6  # times that the search moves on to a smaller peak beside the optimum
FLAT = 0.25  # share of the range searched, over which three values or more have the least peak: it is flat there


FIRST, SEARCH = "values of the range", "search for the least"  # phases of the progress


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


class SearchError(Exception):
    """The search cannot go on, with the reason."""


class FlatError(Exception):
    """The search need not go on: the least peak is the same about it."""


def respond(response: Response, before: Result | None) -> Result:
    """Both sweeps with one value of the scalar, and their peak."""
    model, up = response.model, tuple(map(float, response.plan.sweep.frequency))
    orbits = response.steady(Chain(model, up), Chain(model, up[::-1]))
    orbits[1] = orbits[1][::-1]
    peak = {name: np.array(value + 0) for name, value in _peak(response, orbits)._asdict().items()}
    return columns_of(orbits) | peak


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


class Peaks:
    """The peaks known so far by the value of the scalar; each value of the search is a stage of the campaign."""

    def __init__(self, scene: Scene, execution: Execution):
        plan: OptimumPlan = scene.plan
        self.scene, self.plan, self.execution = scene, plan, execution
        ((self.key, self.values),) = plan.sweep.over.items()
        self.solver, self.frequency = scene.solver(), plan.sweep.frequency
        self.expected = plan.searched
        points = 2 * self.frequency.size
        self.phases = Phases(execution.progress, {FIRST: plan.sweep.size, SEARCH: self.expected * points})
        self.results: dict[float, Result] = {}
        self.stages = 0

    def take(self, values: list[float], stage: str) -> None:
        """Compute the peaks at values.

        Raises:
            SearchError: some are missing, with the reason.
        """
        try:
            models = [self.scene.variant({self.key: value}) for value in values]
        except SceneError as error:
            raise SearchError(str(error)) from None
        chunks = [
            Chunk(f"value-{k:05d}", Response(model, self.plan, self.solver), None, 2 * self.frequency.size)
            for k, model in enumerate(models)
        ]
        identity = self.scene.resolved_yaml()
        execution = replace(self.execution, progress=self._searched if stage else self.phases[FIRST])
        try:
            results, reason = carry_through(chunks, respond, execution, identity=identity, stage=stage)
        except StoreError as error:
            if not stage:
                raise
            raise SearchError(str(error)) from None
        for chunk, value in zip(chunks, values, strict=True):
            if chunk.name in results:
                self.results[value] = results[chunk.name]
        if reason is not None:
            known = len(self.results)
            done = f"{known} of {counted(len(values), 'value')} of {self.key}"
            if stage:
                reason, done = f"{reason} at {self.key} = {values[0]:.6g}", counted(known, "other value")
            raise SearchError(f"{reason}; {done} {'is' if known == 1 else 'are'} done and kept")

    def _searched(self, done: float, number: float, phase: str = "", /) -> None:
        """Take in the progress of a stage of the search, which may need more stages than expected."""
        stages = max(self.expected, self.stages + 1)
        self.phases[SEARCH](self.stages - 1 + done / number, stages, f"{SEARCH}, value {self.stages}")

    def at(self, value: float) -> float:
        """The peak at a value.

        Raises:
            SearchError: it cannot be computed.
        """
        value = float(value)
        if value not in self.results:
            self.stages += 1
            self.take([value], f"search-{self.stages:03d}")
        height = float(self.results[value]["peak"])
        if not np.isfinite(height):
            raise SearchError(f"no steady state was found at {self.key} = {value:g}: {self.failure(value)}")
        return height

    def failure(self, value: float) -> str:
        """The first failure at a value; empty if there is none."""
        return next((str(text) for text in self.results[value]["reason"].ravel() if text), "")

    def least(self) -> float:
        """The value of the least peak known; NaN if none is."""
        known = {value: float(result["peak"]) for value, result in self.results.items()}
        finite = [value for value in known if np.isfinite(known[value])]
        return min(finite, key=lambda value: known[value], default=np.nan)

    def _unless_flat(self, value: float, span: float) -> float:
        """The peak at a value of the search.

        Raises:
            FlatError: about the least peak it is the same over `FLAT` of a span, so that nothing leads on.
            SearchError: it cannot be computed.
        """
        height, values = self.at(value), self._as_low()
        if self.stages > 1 and len(values) > 2 and values[-1] - values[0] > FLAT * span:
            raise FlatError
        return height

    def _as_low(self) -> list[float]:
        """The values about that of the least peak whose peaks equal it, ascending."""
        values = sorted(self.results)
        peaks = np.array([float(self.results[known]["peak"]) for known in values])
        first, last = as_low(peaks, values.index(self.least()))
        return values[first : last + 1]

    def search(self) -> None:
        """Look for the value of least peak between those beside the least one; then beside that, to the accuracy.

        Raises:
            SearchError: it was not found, with the reason.
        """
        self.take(list(self.values), "")
        grid = sorted(self.results)
        if not np.isfinite(self.least()):
            raise SearchError(f"no steady state was found at any value of {self.key}: {self.failure(grid[0])}")
        place = grid.index(self.least())
        low, high = grid[max(place - 1, 0)], grid[min(place + 1, len(grid) - 1)]
        accuracy = self.plan.accuracy
        if high - low > accuracy:
            with suppress(FlatError):
                options, span = {"xatol": accuracy / 2}, (high - low,)
                minimize_scalar(self._unless_flat, args=span, bounds=(low, high), method="bounded", options=options)
        for _ in range(CHECKS):
            here = self.least()
            for value in (here - accuracy, here + accuracy):
                if self.values[0] <= value <= self.values[-1]:
                    self.at(value)
            if here in self._as_low():
                return
        raise SearchError(f"the peak still falls beside {self.key} = {self.least():g}; give a larger accuracy")


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run an optimum scene; the result is incomplete if the least peak was not found or points of a sweep failed."""
    peaks, reason = Peaks(scene, execution), None
    earlier, clock = execution.earlier(), time.perf_counter()
    models = Grid(scene, peaks.plan.sweep).models.values()
    if execution.cluster is None:
        warm_up((Chain(model, tuple(map(float, peaks.frequency))) for model in models), peaks.solver)
    compiling = time.perf_counter() - clock
    execution.progress(0, 1)
    try:
        peaks.search()
    except SearchError as error:
        reason = str(error)
    except KeyboardInterrupt:  # between two campaigns, each of which takes in its own
        reason = f"{INTERRUPTED}; {counted(len(peaks.results), 'value is', 'values are')} done and kept"
    data = data_of(peaks)
    reason = reason or failure_line(data)
    seconds = earlier + time.perf_counter() - clock - compiling
    attrs = attributes(scene, str(peaks.solver), compiling, seconds, reason)
    attrs |= {name: value for name, value in (("point", peaks.plan.point), ("axis", peaks.plan.axis)) if value}
    data = data.assign_attrs(attrs)
    return Outcome({"": data}, reason, tuple(optimum_lines(data, peaks.plan.accuracy)))


def data_of(peaks: Peaks) -> Dataset:
    """The result file: all values that were computed, ascending, and the best of them."""
    key, values, model = peaks.key, sorted(peaks.results), peaks.scene.model()
    columns = blank_columns(model, len(values), 2, peaks.frequency.size)
    for row, value in enumerate(values):
        for name in COLUMNS:
            columns[name][row] = peaks.results[value][name]
    least = peaks.least()
    best = peaks.results.get(least, {})
    found = {name: np.array([peaks.results[value][name] for value in values]) for name in Peak._fields}
    motions = np.array([f"{point} {axis}" for point in model.structure.points for axis in "xyz"])
    found["peak_of"] = np.where(np.isfinite(found["peak"]), motions[found["peak_of"].astype(int)], "")
    own: Arrays = {
        **{name: ((key,), column) for name, column in found.items()},
        "optimum": ((), np.array(least)),
        "optimum_peak": ((), np.array(best.get("peak", np.nan))),
        "optimum_frequency": ((), np.array(best.get("peak_frequency", np.nan))),
    }
    grid = Grid(peaks.scene, replace(peaks.plan.sweep, over={key: tuple(values)}))
    data = steady_dataset(grid, columns, own)
    data["optimum"].attrs |= {name: text for name, text in data[key].attrs.items() if name == "units"}
    return data
