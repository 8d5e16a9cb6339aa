"""The `hbm` study: response curves by harmonic balance, one or several for each set of values of the further axes."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.engine.status import RunError
from timesim.fault import RuleError
from timesim.hbm.branches import SettledMotion, curves_from_ends, isolated_curves
from timesim.hbm.continuation import Controls, Ending
from timesim.hbm.convergence import Convergence, Known, convergence, neglected, with_more_samples
from timesim.hbm.curve import HbmCurve, hbm_curve
from timesim.hbm.parameter import parameter_curve
from timesim.hbm.scheme import NEGLECTED, Scheme
from timesim.model.model import Model
from timesim.orbit.cycle import modal_coefficients
from timesim.orbit.steady_state import switches
from timesim.result.dataset import dataset
from timesim.result.file import StoreError
from timesim.result.label import in_words
from timesim.result.state import SavedStates, SweepPoint, settled_points, start_of
from timesim.scene.hbm import HbmPlan
from timesim.scene.resolution import Scene
from timesim.scene.study import combinations
from timesim.study.execution.campaign import Execution
from timesim.study.execution.progress import Phases
from timesim.study.kept_curves import KeptCurves, kept_curves
from timesim.study.outcome import Outcome, attributes
from timesim.study.verdict import convergence_lines, curve_lines

Sweep = tuple[SavedStates, Mapping[str, float | str]]
"""Points of a sweep by the values along its axes."""

FOLLOWED = 0.6  # of the time of a curve; its multipliers take the rest

REFINED = 6  # solutions that harmonics and samples are refined for, beside the largest


@dataclass(frozen=True)
class StudyCurve:
    """One curve of a study: values of the further axes, the model for a value of its parameter, the solutions."""

    values: Mapping[str, float]
    model_at: Callable[[float], Model]
    curve: HbmCurve

    @property
    def label(self) -> str:
        """Values of the further axes, to begin a message with."""
        return in_words(self.values, ": ")


class Curves:
    """The curves of a study; `values` are the combinations of its further axes, one after the other."""

    def __init__(self, scene: Scene, plan: HbmPlan):
        self.scene, self.plan = scene, plan
        self.schemes = plan.schemes_for(scene.model())
        self.scheme = self.schemes[0]
        self.values = list(combinations(plan.over))
        self.curves: list[StudyCurve] = []
        self.faults: list[str] = []
        self.notes: list[str] = []

    def run(self, execution: Execution, kept: KeptCurves, passing: SavedStates | None = None) -> str | None:
        """Follow all curves; why some are not whole, if any.

        Args:
            execution: takes in the progress, in sets of values.
            kept: the curves that are taken up, and where the others are kept.
            passing: a sweep whose settled points are to be passed, beside that of the plan's start.
        """
        sweeps = [sweep for sweep in (self.plan.passing, passing and (passing, {})) if sweep]
        try:
            for place, values in enumerate(self.values):
                first, notes = len(self.curves), len(self.notes)
                growth = Growth(self, values, execution, kept)
                if (done := kept.load(place)) is None:
                    self._follow(values, sweeps, growth)
                    kept.save(place, [one.curve for one in self.curves[first:]], self.notes[notes:])
                else:
                    self.notes += done[1]
                    for curve in done[0]:
                        self._add(StudyCurve(values, self._model_at(values), curve))
                execution.progress(place + 1, len(self.values), "harmonic balance")
        except KeyboardInterrupt:
            self.faults.append(f"interrupted at curve {len(self.curves) + 1}")
        except StoreError as error:
            self.faults.append(str(error))
        return "; ".join(self.faults) or None

    def _follow(self, values: dict[str, float], sweeps: Sequence[Sweep], growth: "Growth") -> None:
        """The curves of a set of values."""
        curves = list(self._from_ends(values, growth))
        while (finer := self._with_more_samples(curves)) is not None:
            self.schemes = finer
            curves = list(self._from_ends(values, growth))
        if "harmonics" in self.plan.chosen:
            left = max(neglected(own.model_at, own.curve, self.schemes) for own in curves)
            count = max(own.curve.harmonic_cos.shape[1] - 1 for own in curves)
            if left > NEGLECTED:
                self.notes.append(
                    f"{in_words(values, ': ')}auto ends at {count} harmonics: those above would "
                    f"add up to {left:.1e} of the amplitude, where {NEGLECTED:g} is wanted; set harmonics to more"
                )
        for curve in curves:
            self._add(curve)
        for sweep in sweeps:
            for curve in self._through(values, *sweep, growth):
                self.notes.append(_isolated(curve))
                self._add(curve)

    def _with_more_samples(self, curves: Sequence[StudyCurve]) -> tuple[Scheme, ...] | None:
        """With what curves are worth following again, if with anything."""
        endings = [curve.curve.ending for curve in curves]
        if "time_samples" not in self.plan.chosen or Ending.INTERRUPTED in endings:
            return None
        finer = (with_more_samples(own.model_at, own.curve, self.schemes) for own in curves)
        return next((own for own in finer if own is not None), None)

    def with_curve(self, curve: StudyCurve) -> "Curves":
        """With one more, all with the harmonics of the one that has the most: those that it lacks are zero."""
        grown, curves = copy(self), [*self.curves, curve]
        most = max(self.scheme.harmonics, curve.curve.harmonic_cos.shape[1] - 1)
        grown.scheme = next(own for own in self.schemes if own.harmonics >= most)
        grown.curves = [replace(one, curve=one.curve.with_harmonics(grown.scheme.harmonics)) for one in curves]
        return grown

    def _model_at(self, values: dict[str, float]) -> Callable[[float], Model]:
        """The model for a value of the parameter of a curve with these values."""
        if self.plan.along is None:
            model = self.scene.variant(values)
            return lambda _: model
        key = self.plan.along.key
        return lambda p: self.scene.variant({**values, key: p})

    def _add(self, curve: StudyCurve) -> None:
        grown = self.with_curve(curve)
        self.scheme, self.curves = grown.scheme, grown.curves
        if not curve.curve.complete:
            self.faults.append(curve.label + curve.curve.message)
        if curve.curve.ending is Ending.INTERRUPTED:
            raise KeyboardInterrupt

    def _from_ends(self, values: dict[str, float], growth: "Growth") -> Iterator[StudyCurve]:
        """The curves from the ends of the range, or from the motion that the plan gives."""
        plan, along, options = self.plan, self.plan.along, self._options(growth)
        model_at = self._model_at(values)
        guess, begin = (plan.motion.modal, plan.motion.frequency) if plan.motion is not None else (None, None)
        if along is not None:
            curve = parameter_curve(model_at, plan.span[0], along.first, along.last, guess=guess, **options)
            yield StudyCurve(values, model_at, curve)
            return
        model = self.scene.variant(values)
        if guess is None:
            curves = curves_from_ends(model, *plan.span, both=plan.both_ends, **options)
        else:
            curves = [hbm_curve(model, *plan.span, guess=guess, begin=begin, **options)]
        yield from (StudyCurve(values, model_at, curve) for curve in curves)

    def _through(
        self, values: dict[str, float], states: SavedStates, asked: Mapping[str, float | str], growth: "Growth"
    ) -> Iterator[StudyCurve]:
        """Curves from settled points of a sweep that no other curve passes: isolated branches, it may be.

        Points without slip or part-time contact are left alone: there the motion is linear.
        """
        own = {key: value for key, value in values.items() if key in states.axes}
        try:
            points = list(settled_points(states, own | dict(asked)))
        except RuleError:
            return  # the sweep has no such values
        model = self.scene.variant(values)
        motions = [
            SettledMotion(point[0], point[1]["amplitude"], partial(self._coefficients, model, states, point))
            for point in points
        ]
        known = [curve.curve for curve in self.curves if curve.values == values]
        for curve in isolated_curves(model, known, motions, self.plan.span, **self._options(growth)):
            yield StudyCurve(values, self._model_at(values), curve)

    def _coefficients(self, model: Model, states: SavedStates, point: SweepPoint) -> np.ndarray | None:
        """Modal Fourier coefficients of a point of a sweep; None with a note where this model cannot start from it."""
        frequency, arrays = point
        try:
            start = start_of(model, states, arrays)
            return modal_coefficients(replace(model, start=start), frequency, self.scene.solver())
        except RuleError as error:
            reason = f"it {error.rule}"
        except RunError as error:
            reason = str(error)
        self.notes.append(f"no curve is begun from the sweep's point at {frequency:g} Hz: {reason}")
        return None

    def _options(self, growth: "Growth") -> dict[str, Any]:
        steps, stable = Controls(**self.plan.steps), self.plan.stability
        return {"scheme": self.schemes, "controls": steps, "stability": stable, "watch": growth}

    def to_refine(self) -> list[Known]:
        """Stable solutions where a contact switches, spread over all curves, and the largest of them."""
        rows = []
        for one in self.curves:
            works = switches(one.curve.slip_share, one.curve.separation_share).any(axis=1)
            rows += [(one, i) for i in np.flatnonzero(one.curve.stable & works)]
        if not rows:
            return []
        chosen = set(np.linspace(0, len(rows) - 1, min(REFINED, len(rows))).round().astype(int).tolist())
        chosen.add(int(np.argmax([curve.curve.amplitude[i].max() for curve, i in rows])))
        return [_known(*rows[k]) for k in sorted(chosen)]


class Growth:
    """What is shown, and kept, of a curve while it is followed."""

    def __init__(self, curves: Curves, values: Mapping[str, float], execution: Execution, kept: KeptCurves):
        self.curves, self.values, self.execution, self.kept = curves, values, execution, kept
        self.first = len(curves.curves)

    def __call__(self, share: float, so_far: Callable[[], HbmCurve]) -> None:
        curves, plan = self.curves, self.curves.plan
        before = len(curves.curves) - self.first
        # From how many points of a sweep a curve of its own begins is not known.
        expected = max(before + 1, 1 + plan.both_ends)
        sets = curves.values.index(dict(self.values)) + (before + FOLLOWED * share) / expected
        words = f"curve {len(curves.curves) + 1}: {share:.0%} of the range"
        self.execution.progress(sets, len(curves.values), ", ".join(filter(None, (words, in_words(self.values)))))
        self.kept.grow(lambda: self._record(so_far()))

    def _record(self, curve: HbmCurve) -> Dataset:
        """The result so far."""
        scene = self.curves.scene
        grown = self.curves.with_curve(StudyCurve(self.values, lambda _: scene.model(), curve))
        return solutions(scene.model(), grown, attributes(scene, str(grown.scheme), 0.0, 0.0, curve.message))


def _known(curve: StudyCurve, i: int) -> Known:
    solutions = curve.curve
    model = curve.model_at(float(solutions.parameter[i]))
    return Known(model, float(solutions.frequency[i]), solutions.contact_motion[i], solutions.amplitude[i])


def _isolated(curve: StudyCurve) -> str:
    """A curve through points of a sweep, in words."""
    frequency = curve.curve.frequency
    closed = "closed, " if curve.curve.ending is Ending.CLOSED else ""
    span = f"{frequency.min():.6g} to {frequency.max():.6g} Hz" if frequency.size else "without a solution"
    return f"{curve.label}a curve of its own, {closed}{span}, begun from points of the sweep that no other passes"


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run an hbm scene; the result is marked incomplete where a curve could not be followed to its end."""
    data, curves, reason = followed(scene, scene.plan, execution)
    return Outcome({"": data}, reason, tuple(curve_lines(data, curves.notes)))


def followed(
    scene: Scene, plan: HbmPlan, execution: Execution, passing: SavedStates | None = None, stage: str = ""
) -> tuple[Dataset, Curves, str | None]:
    """All curves of a scene, those through the points of a sweep too: the result, they, and why some are not whole.

    ``passing``: a sweep whose settled points are to be passed too; ``stage``: as of `Execution.checkpoint`.
    """
    curves = Curves(scene, plan)
    phases = Phases(execution.progress, {"curves": len(curves.values), "convergence": int(plan.convergence)})
    phases["curves"](0, 1, "harmonic balance, compiling")
    compiling = _warmed_up(scene, plan)
    phases["curves"](0, 1, "harmonic balance")
    with kept_curves(execution, scene.resolved_yaml(), _sets(curves), stage) as kept:
        clock = time.perf_counter() - kept.earlier
        reason = curves.run(replace(execution, progress=phases["curves"]), kept, passing)
    if plan.convergence:
        phases["convergence"](0, 1, "convergence of the balance")
    refined = convergence(curves.to_refine(), curves.scheme) if plan.convergence and reason is None else None
    seconds = time.perf_counter() - clock
    attrs = attributes(scene, str(curves.scheme), compiling, seconds, reason)
    if curves.notes:
        attrs["notes"] = "\n".join(curves.notes)
    return solutions(scene.model(), curves, attrs, refined), curves, reason


def _sets(curves: Curves) -> list[Any]:
    """What the curves of each set of values are determined by beside the scene: files that it names."""
    plan, states = curves.plan, curves.plan.passing
    arrays = {name: array.astype(str) for name, array in states[0].arrays.items()} if states else {}
    return [(curves.scene.variant(values), plan.motion, arrays) for values in curves.values]


def left_out(scene: Scene, plan: HbmPlan) -> tuple[Dataset, Curves, str | None]:
    """The same where nothing is to be followed any more."""
    curves, reason = Curves(scene, plan), "not begun"
    return solutions(scene.model(), curves, attributes(scene, str(curves.scheme), 0.0, 0.0, reason)), curves, reason


def compile_beside(scene: Scene, plan: HbmPlan) -> None:
    """Begin to compile what `followed` takes, which meets what fails again, while something else runs."""
    ThreadPoolExecutor(1).submit(_warmed_up, scene, plan)


def _warmed_up(scene: Scene, plan: HbmPlan) -> float:
    """Seconds that the first points of a curve took, most of them compilation."""
    clock = time.perf_counter()
    model, frequency, few = scene.variant(next(combinations(plan.over))), plan.span[0], Controls(max_points=2)
    scheme = plan.schemes_for(model)[0]
    hbm_curve(model, frequency, 1.001 * frequency, scheme=scheme, controls=few, stability=plan.stability)
    return time.perf_counter() - clock


def solutions(model: Model, curves: Curves, attrs: Mapping[str, Any], refined: Convergence | None = None) -> Dataset:
    """The result file: all solutions, one curve after the other."""
    points, contacts, order = len(model.structure.points), model.num_contacts, curves.scheme.harmonics + 1
    shapes = {
        **dict.fromkeys(("frequency", "stable", "fold", "branch", "floquet_max", "closure"), ()),
        **dict.fromkeys(("amplitude", "phase_deg"), (points, 3)),
        **dict.fromkeys(("harmonic_amplitude", "harmonic_cos", "harmonic_sin"), (order, points, 3)),
        **dict.fromkeys(("slip_share", "separation_share", "dissipated_power"), (contacts,)),
    }
    arrays = {name: _stacked(curves, name, shape) for name, shape in shapes.items()}
    arrays |= {name: arrays[name].astype(np.int8) for name in ("stable", "fold")}
    arrays["branch"] = arrays["branch"].astype(np.int32)
    counts = [one.curve.frequency.size for one in curves.curves]
    arrays["curve"] = np.repeat(np.arange(len(counts)), counts).astype(np.int32)
    for key in curves.plan.over:
        arrays[key] = np.repeat([one.values[key] for one in curves.curves], counts)
    if (along := curves.plan.along) is not None:
        arrays[along.key] = _stacked(curves, "parameter", ())
        attrs = {**attrs, "along": along.key}
    dims = {4: ("harmonic", "point", "axis"), 3: ("point", "axis"), 2: ("contact",), 1: ()}
    variables = {name: (("solution", *dims[array.ndim]), array) for name, array in arrays.items()}
    coords: dict[str, np.ndarray] = {}
    if refined is not None:
        coords = {"harmonics": refined.harmonics, "time_samples": refined.time_samples}
        variables["change_with_harmonics"] = (("harmonics",), refined.with_harmonics)
        variables["change_with_samples"] = (("time_samples",), refined.with_samples)
        attrs = {**attrs, "convergence": "\n".join(convergence_lines(refined))}
    return dataset(variables, coords, attrs, model)


def _stacked(curves: Curves, name: str, shape: tuple[int, ...]) -> np.ndarray:
    none = np.zeros((0, *shape))
    return np.concatenate([none, *(np.asarray(getattr(one.curve, name), dtype=float) for one in curves.curves)])
