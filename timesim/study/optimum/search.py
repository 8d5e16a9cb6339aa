"""The value of a scalar whose peak is least.

It is sought between the neighbours of the least one of given values by bounded minimisation [1]_, until no value at the
distance of the accuracy has a smaller peak. Where the peaks of two neighbours differ by a jump, the larger motion is
carried over to the other one, whose sweeps may only have missed it.

.. [1] R. P. Brent, *Algorithms for Minimization Without Derivatives*, Prentice-Hall (1973), chapter 5.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from timesim.fault import SceneError
from timesim.orbit.jump import AT_LEAST
from timesim.result.file import StoreError
from timesim.result.label import counted
from timesim.scene.resolution import Scene
from timesim.scene.sweep import OptimumPlan
from timesim.study.execution.campaign import Chunk, Execution, Result, carry_through
from timesim.study.execution.progress import Phases
from timesim.study.execution.worker import Work
from timesim.study.optimum.peak import Carried, Motion, Response, carry_over, larger_motions, respond
from timesim.study.summary.optimum import as_low, is_nothing

CHECKS = 6  # times that the search moves on to a smaller peak beside the optimum
FLAT = 0.25  # share of the range searched, over which three values or more have the least peak: it is flat there
FIRST, SEARCH = "values of the range", "search for the least"  # phases of the progress


class SearchError(Exception):
    """The search cannot go on, with the reason."""


class FlatError(Exception):
    """The search need not go on: the least peak is the same about it."""


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
        self.stages, self.carried, self.raised = 0, 0, 0

    def take(self, values: list[float], stage: str) -> None:
        """Compute the peaks at values.

        Raises:
            SearchError: some are missing, with the reason.
        """
        chunks = [
            Chunk(f"value-{k:05d}", self._response(value), None, 2 * self.frequency.size)
            for k, value in enumerate(values)
        ]
        results, reason = self._done(chunks, respond, stage)
        for chunk, value in zip(chunks, values, strict=True):
            if chunk.name in results:
                self.results[value] = results[chunk.name]
        if reason is not None:
            known = len(self.results)
            done = f"{known} of {counted(len(values), 'value')} of {self.key}"
            if stage:
                reason, done = f"{reason} at {self.key} = {values[0]:.6g}", counted(known, "other value")
            raise SearchError(f"{reason}; {done} {'is' if known == 1 else 'are'} done and kept")

    def _response(self, value: float) -> Response:
        try:
            return Response(self.scene.variant({self.key: value}), self.plan, self.solver)
        except SceneError as error:
            raise SearchError(str(error)) from None

    def _done(self, chunks: Sequence[Chunk], work: Work, stage: str) -> tuple[dict[str, Result], str | None]:
        """`carry_through`."""
        execution = replace(self.execution, progress=self._searched if stage else self.phases[FIRST])
        try:
            return carry_through(chunks, work, execution, identity=self.scene.resolved_yaml(), stage=stage)
        except StoreError as error:
            if not stage:
                raise
            raise SearchError(str(error)) from None

    def _searched(self, done: float, number: float, phase: str = "", /) -> None:
        """Take in the progress of a stage of the search, which may need more stages than expected."""
        stage, stages = max(self.stages, 1), max(self.expected, self.stages + 1)
        self.phases[SEARCH](stage - 1 + done / number, stages, f"{SEARCH}, value {stage}")

    def at(self, value: float) -> float:
        """The peak at a value.

        Raises:
            SearchError: it cannot be computed.
        """
        value = float(value)
        if value not in self.results:
            self.stages += 1
            self.take([value], f"search-{self.stages:03d}")
            self._from_beside([value])
        height = float(self.results[value]["peak"])
        if not np.isfinite(height):
            raise SearchError(f"no steady state was found at {self.key} = {value:g}: {self.failure(value)}")
        return height

    def _from_beside(self, values: Iterable[float]) -> None:
        """Carry motions from values beside over to some values and back, and on from where they stay.

        Raises:
            SearchError: it could not be done, with the reason.
        """
        changed, tried = deque(values), set[tuple[float, float, float]]()
        while changed:
            here, known = changed.popleft(), sorted(self.results)
            place = known.index(here)
            for beside in known[max(place - 1, 0) : place] + known[place + 1 : place + 2]:
                for target, source in ((here, beside), (beside, here)):
                    attempt = target, source, float(self.results[source]["peak"])
                    if attempt not in tried and self._stays(target, source):
                        changed.append(target)
                    tried.add(attempt)

    def _stays(self, target: float, source: float) -> bool:
        """Whether a motion of one value goes on at another, with a larger peak; it is the peak there from now on."""
        peak, other = (float(self.results[value]["peak"]) for value in (target, source))
        largest = np.nanmax([float(result["peak"]) for result in self.results.values()])
        if not other > (1 + AT_LEAST) * peak or is_nothing(np.array([other, largest]))[0]:
            return False
        motions = self.motions(source, peak)
        if not motions:
            return False
        self.carried += 1
        found = self.carry(Carried(self._response(target), peak, motions), f"carried-{self.carried:03d}")
        self.results[target] = {**self.results[target], **found}
        self.raised += "peak" in found
        return "peak" in found

    def motions(self, value: float, least: float) -> tuple[Motion, ...]:
        """Motions known at a value that are larger than a peak."""
        return larger_motions(self._response(value), self.results[value], least)

    def carry(self, carried: Carried, stage: str) -> Result:
        """`carry_over`.

        Raises:
            SearchError: it could not be done, with the reason.
        """
        results, reason = self._done([Chunk("motions", carried, None, len(carried.motions))], carry_over, stage)
        if reason is not None:
            raise SearchError(f"{reason}, as a motion was carried on from one value of {self.key} to another")
        return results["motions"]

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

    def _neighbours(self, values: list[float]) -> tuple[float, float]:
        """The values beside that of the least peak, or itself at an end."""
        place = values.index(self.least())
        return values[max(place - 1, 0)], values[min(place + 1, len(values) - 1)]

    def _between(self, low: float, high: float) -> None:
        """Look for the value of least peak between two values."""
        if high - low > self.plan.accuracy:
            with suppress(FlatError):
                options, span = {"xatol": self.plan.accuracy / 2}, (high - low,)
                minimize_scalar(self._unless_flat, args=span, bounds=(low, high), method="bounded", options=options)

    def search(self) -> None:
        """Look for the value of least peak between those beside the least one; then beside that, to the accuracy.

        Raises:
            SearchError: it was not found, with the reason.
        """
        self.take(list(self.values), "")
        grid = sorted(self.results)
        if not np.isfinite(self.least()):
            raise SearchError(f"no steady state was found at any value of {self.key}: {self.failure(grid[0])}")
        self._from_beside(grid)
        self._between(*self._neighbours(grid))
        accuracy = self.plan.accuracy
        for _ in range(CHECKS):
            here, before = self.least(), self.raised
            for value in (here - accuracy, here + accuracy):
                if self.values[0] <= value <= self.values[-1]:
                    self.at(value)
            if here in self._as_low():
                return
            if self.raised > before:  # the least peak was that of sweeps that missed a larger motion
                self._between(*self._neighbours(sorted(self.results)))
        raise SearchError(f"the peak still falls beside {self.key} = {self.least():g}; give a larger accuracy")
