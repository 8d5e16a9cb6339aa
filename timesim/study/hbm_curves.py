"""The curves of a study by harmonic balance, one or several for each value of the scene's further axes."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from timesim.fault import RuleError
from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Ending, solve
from timesim.hbm.curve import HbmCurve, crossings, default_controls, hbm_curve, solutions_at
from timesim.hbm.first_guess import unknowns_of_modes
from timesim.hbm.parameter import parameter_curve
from timesim.model.model import Model
from timesim.orbit.cycle import modal_coefficients
from timesim.result.state import Held, SweepPoint, settled_points, start_of
from timesim.scene.hbm import HbmPlan
from timesim.scene.resolution import Scene
from timesim.scene.study import combinations
from timesim.study.campaign import Progress

# Unknowns of two solutions that are one, relative to their size.
SAME = 1e-5
# Difference of amplitudes, relative to the largest, up to which a curve passes through a point.
NEAR = 0.05


@dataclass(frozen=True)
class Piece:
    """One curve of a study.

    Attributes:
        values: of the further axes.
        model_at: the model for a value of the curve's parameter.
        curve: the solutions.
    """

    values: Mapping[str, float]
    model_at: Callable[[float], Model]
    curve: HbmCurve

    @property
    def label(self) -> str:
        """Which curve it is, in words; empty where there is one."""
        return ", ".join(f"{key} = {value:g}" for key, value in self.values.items())


class Curves:
    """The curves of a study; `values` are the combinations of its further axes, one after the other."""

    def __init__(self, scene: Scene, plan: HbmPlan):
        self.scene, self.plan, self.scheme = scene, plan, plan.scheme
        self.values = list(combinations(plan.over))
        self.pieces: list[Piece] = []
        self.faults: list[str] = []
        self.notes: list[str] = []

    def run(self, progress: Progress | None = None, passing: Held | None = None) -> str | None:
        """Follow all curves.

        Args:
            progress: called with the curves followed and their number.
            passing: a sweep whose settled points are to be passed, beside that of the plan's start.

        Returns:
            Why some curves are not whole, if any.
        """
        sweeps = [sweep for sweep in (self.plan.passing, passing and (passing, {})) if sweep]
        try:
            for count, values in enumerate(self.values):
                for piece in self._followed(values):
                    self._take(piece)
                for sweep in sweeps:
                    self._pass(values, *sweep)
                if progress is not None:
                    progress(count + 1, len(self.values))
        except KeyboardInterrupt:
            self.faults.append(f"interrupted at curve {len(self.pieces) + 1}")
        return "; ".join(self.faults) or None

    def _pass(self, values: dict[str, float], found: Held, asked: Mapping[str, float | str]) -> None:
        """Follow a curve from each settled point of a sweep that no other curve passes: an isolated branch, it may be.

        Points without slip or part-time contact are left alone: there the motion is linear.
        """
        own = {key: value for key, value in values.items() if key in found.axes}
        try:
            points = list(settled_points(found, own | dict(asked)))
        except RuleError:
            return  # the sweep was not made for these values
        for piece in self._isolated(values, found, points):
            self.notes.append(_begun(piece))
            self._take(piece)

    def _isolated(self, values: dict[str, float], found: Held, points: list[SweepPoint]) -> Iterator[Piece]:
        """Curves from the points of a sweep that none of those with these values passes."""
        model, (first, last) = self.scene.variant(values), self.plan.span
        low, high = sorted((first, last))
        own = [piece.curve for piece in self.pieces if piece.values == values]
        left = [point for point in points if low < point[0] < high]
        left = [point for point in left if not any(_passes(curve, point) for curve in own)]
        while left:
            # From the middle of what is left: away from the folds at its ends.
            frequency, arrays = left.pop(len(left) // 2)
            try:
                begun = replace(model, start=start_of(model, found, arrays))
            except RuleError as error:
                self.notes.append(f"no curve is begun from the sweep's point at {frequency:g} Hz: it {error.rule}")
                continue
            guess = modal_coefficients(begun, frequency, self.scene.solver())
            if self._known(model, own, frequency, guess):
                continue
            curve = hbm_curve(model, first, last, guess=guess, begin=frequency, **self._options())
            own.append(curve)
            left = [point for point in left if not _passes(curve, point)]
            yield Piece(values, lambda _: model, curve)

    def _known(self, model: Model, curves: list[HbmCurve], frequency: float, guess: np.ndarray) -> bool:
        """Whether a motion leads to a solution that is on one of the curves, or to none."""
        balance = Balance(model, frequency, self.scheme)
        solution = solve(balance, unknowns_of_modes(balance, guess), frequency, default_controls())
        if solution is None:
            return True
        # Not the mean: it may hold the offset of a contact that sticks, which is free.
        waves = balance.coefficients(solution[0])[..., 1:] * balance.length
        return any(
            np.linalg.norm(known[..., 1:] - waves) <= SAME * np.linalg.norm(waves)
            for curve in curves
            for known in solutions_at(model, curve, frequency, scheme=self.scheme, stability=False).contact_motion
        )

    def _take(self, piece: Piece) -> None:
        self.pieces.append(piece)
        if not piece.curve.complete:
            self.faults.append((f"{piece.label}: " if piece.label else "") + piece.curve.message)
        if piece.curve.ending is Ending.INTERRUPTED:
            raise KeyboardInterrupt

    def _followed(self, values: dict[str, float]) -> Iterator[Piece]:
        model, along = self.scene.variant(values), self.plan.along
        if along is not None:
            key = along.key
            model_at: Callable[[float], Model] = lambda p: self.scene.variant({**values, key: p})  # noqa: E731
            guess = self.plan.motion.modal if self.plan.motion else None
            ends = (along.first, along.last)
            curve = parameter_curve(model_at, self.plan.span[0], *ends, guess=guess, **self._options())
            yield Piece(values, model_at, curve)
            return
        for curve in self._in_frequency(model):
            yield Piece(values, lambda _: model, curve)

    def _in_frequency(self, model: Model) -> list[HbmCurve]:
        (first, last), motion = self.plan.span, self.plan.motion
        guess, begin = (motion.modal, motion.frequency) if motion is not None else (None, None)
        whole = hbm_curve(model, first, last, guess=guess, begin=begin, **self._options())
        if not self.plan.both_ends or whole.ending is Ending.INTERRUPTED:
            return [whole]
        back = hbm_curve(model, last, first, **self._options())
        if _same(whole, -1, back, 0) and whole.complete:
            return [whole]
        return [back] if back.complete and _same(whole, 0, back, -1) else [whole, back]

    def _options(self) -> dict[str, Any]:
        controls = replace(default_controls(), **self.plan.steps)
        return {"scheme": self.scheme, "controls": controls, "stability": self.plan.stability}


def _begun(piece: Piece) -> str:
    """A curve that a point of a sweep has led to, in words."""
    at = f"{piece.label}: " if piece.label else ""
    low, high = piece.curve.frequency.min(), piece.curve.frequency.max()
    way = "closed, " if piece.curve.ending is Ending.CLOSED else ""
    return (
        f"{at}a curve of its own, {way}{low:.6g} to {high:.6g} Hz, begun from points of the sweep that no other passes"
    )


def _passes(curve: HbmCurve, point: SweepPoint) -> bool:
    """Whether a curve passes through a point of a sweep, its amplitudes taken straight between its solutions."""
    frequency, arrays = point
    amplitude = arrays["amplitude"]
    for i in crossings(curve.frequency, frequency):
        share = (frequency - curve.frequency[i]) / (curve.frequency[i + 1] - curve.frequency[i])
        here = curve.amplitude[i] + share * (curve.amplitude[i + 1] - curve.amplitude[i])
        if np.max(np.abs(here - amplitude)) <= NEAR * np.max(amplitude):
            return True
    return False


def _same(one: HbmCurve, i: int, other: HbmCurve, j: int) -> bool:
    """Whether two curves share a solution at these positions."""
    if not one.frequency.size or not other.frequency.size or not np.isclose(one.frequency[i], other.frequency[j]):
        return False
    x, y = one.contact_motion[i], other.contact_motion[j]
    return bool(np.linalg.norm(x - y) <= SAME * np.linalg.norm(y))
