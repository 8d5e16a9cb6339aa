"""The curves of a study, and how those of one set of values are found."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np
from xarray import Dataset

from timesim.engine.status import RunError
from timesim.fault import RuleError
from timesim.hbm import convergence
from timesim.hbm.branches import SettledMotion, curves_from_ends, isolated_curves
from timesim.hbm.continuation import Ending
from timesim.hbm.curve import HbmCurve, Watch, hbm_curve
from timesim.hbm.parameter import parameter_curve
from timesim.hbm.scheme import NEGLECTED, NOTED, Scheme, highest_excited
from timesim.model.model import Model
from timesim.orbit.cycle import modal_coefficients
from timesim.orbit.steady_state import TAILS, sizes_of, switches
from timesim.result.coordinate import most_friction
from timesim.result.dataset import dataset
from timesim.result.label import counted, in_words
from timesim.result.state import SavedStates, SweepPoint, settled_points, start_of
from timesim.scene.hbm import HbmPlan
from timesim.scene.resolution import Scene
from timesim.scene.study import combinations
from timesim.study.curves.aside import Aside
from timesim.study.curves.kept import Found
from timesim.study.execution.processes import Processes
from timesim.study.outcome import DOUBT
from timesim.study.summary.curve import convergence_lines

Sweep = tuple[SavedStates, Mapping[str, float | str]]
"""The states of a sweep, and the values along its axes that select points."""

OF_SOLUTION = ("frequency", "stable", "fold", "branch", "floquet_max", "floquet_phase_deg", "closure")
OF_MOTION = ("amplitude", "phase_deg", "harmonic_amplitude", "harmonic_cos", "harmonic_sin")
OF_CONTACTS = ("slip_share", "separation_share", "dissipated_power")
"""Quantities by their names in `HbmCurve` and in the result."""
REFINED = 6  # solutions for which harmonics and samples are refined, besides the one of largest amplitude


@dataclass(frozen=True)
class StudyCurve:
    """One curve of a study: values of the further axes, the model for a value of its parameter, the solutions."""

    values: Mapping[str, float]
    model_at: Callable[[float], Model]
    curve: HbmCurve

    @property
    def label(self) -> str:
        """Values of the further axes, for the beginning of a message."""
        return in_words(self.values, ": ")


class Curves:
    """The curves of a study; `values` are the combinations of values of its further axes."""

    def __init__(self, scene: Scene, plan: HbmPlan):
        self.scene, self.plan = scene, plan
        self.values = list(combinations(plan.over))
        self.schemes = plan.schemes_for(max(self._end_models(), key=highest_excited))
        self.scheme = self.schemes[0]
        self.any_model = most_friction(map(scene.variant, self.values))
        self.curves: list[StudyCurve] = []
        self.faults: list[str] = []
        self.notes: list[str] = []

    @property
    def none(self) -> Self:
        """A copy without any curve."""
        empty = copy(self)
        empty.curves, empty.faults, empty.notes = [], [], []
        return empty

    @property
    def whole(self) -> np.ndarray:
        """Whether each set of values has curves, all of which are complete."""
        own = ([one.curve.complete for one in self.curves if one.values == values] for values in self.values)
        return np.array([bool(complete) and all(complete) for complete in own])

    @property
    def found(self) -> Found:
        """The curves alone, the notes, and the schemes."""
        return [one.curve for one in self.curves], self.notes, self.schemes

    def have_samples(self, schemes: tuple[Scheme, ...]) -> None:
        """Take other schemes if they have more samples."""
        if schemes[0].time_samples > self.schemes[0].time_samples:
            self.schemes = schemes

    def follow(
        self, values: Mapping[str, float], sweeps: Sequence[Sweep], watch: Watch, processes: Processes | None = None
    ) -> None:
        """Add the curves of a set of values, including those through points of some sweeps.

        ``processes``: may follow parts of them meanwhile.

        Raises:
            KeyboardInterrupt: it was interrupted; what was followed is added.
        """
        curves: list[StudyCurve] = []
        try:
            finer: tuple[Scheme, ...] | None = self.schemes
            while finer is not None:
                self.schemes = finer
                try:
                    curves = list(self._from_ends(values, watch, processes))
                    finer = self._with_more_samples(curves)
                except convergence.TooFewSamplesError as error:
                    finer = error.schemes
            self.notes += [own.label + own.curve.message for own in curves if own.curve.ending is Ending.BACKWARDS]
            self.notes.extend(self._left_out(values, curves))
        finally:  # where the next ones, or what they leave out, are interrupted too
            self.add(curves)
        for sweep in sweeps:
            useless: dict[str, list[float]] = {}
            try:
                for curve in self._through(values, *sweep, watch, useless):
                    self.notes.append(_isolated(curve))
                    self.add([curve])
            finally:
                self.notes.extend(_not_begun(sweep[0], values, useless))

    def _left_out(self, values: Mapping[str, float], curves: Sequence[StudyCurve]) -> Iterator[str]:
        """What the harmonics, and the samples that the program chose, still leave out."""
        label = f"{DOUBT}{in_words(values, ': ')}"
        left = max(convergence.neglected(own.model_at, own.curve, self.schemes) for own in curves)
        if left > NOTED:
            count = max(own.curve.harmonic_cos.shape[1] - 1 for own in curves)
            more = next((own.harmonics for own in self.schemes if own.harmonics > count), 2 * count)
            taken, hint = f"auto took up to {counted(count, 'harmonic')}", f"set harmonics to more, such as {more}"
            if "harmonics" not in self.plan.chosen:
                taken, hint = f"{counted(count, 'harmonic')} may be too few", "set harmonics to auto, or to more"
            above = f"those above would add to the amplitude, or change it by, up to {left:.1e} of it"
            yield f"{label}{taken}: {above}, where {NEGLECTED:g} is wanted; {hint}"
        if "time_samples" in self.plan.chosen and Ending.INTERRUPTED not in [own.curve.ending for own in curves]:
            left = max(convergence.left_to_samples(own.model_at, own.curve, self.schemes) for own in curves)
            if left > convergence.SAMPLED:
                more = f"{convergence.FINER} times as many would change the contacts' motion by up to {left:.1e}"
                wanted = f"where {convergence.SAMPLED:g} is wanted; set time_samples to more"
                yield f"{label}auto took {self.schemes[0].time_samples:,} time samples: {more}, {wanted}"

    def _with_more_samples(self, curves: Sequence[StudyCurve]) -> tuple[Scheme, ...] | None:
        """Schemes with more samples, if the curves need them and should be followed again."""
        endings = [curve.curve.ending for curve in curves]
        if "time_samples" not in self.plan.chosen or Ending.INTERRUPTED in endings:
            return None
        finer = (convergence.with_more_samples(own.model_at, own.curve, self.schemes) for own in curves)
        return next((own for own in finer if own is not None), None)

    def with_curve(self, curve: StudyCurve) -> "Curves":
        """A copy with one more curve; all curves have as many harmonics as the longest, padded with zeros."""
        grown, curves = copy(self), [*self.curves, curve]
        most = max(self.scheme.harmonics, curve.curve.harmonic_cos.shape[1] - 1)
        grown.scheme = next(own for own in self.schemes if own.harmonics >= most)
        grown.curves = [replace(one, curve=one.curve.with_harmonics(grown.scheme.harmonics)) for one in curves]
        return grown

    def model_at(self, values: Mapping[str, float]) -> Callable[[float], Model]:
        """The model for a value of the parameter of a curve with these values."""
        if self.plan.along is None:
            model = self.scene.variant(values)
            return lambda _: model
        key = self.plan.along.key
        return lambda p: self.scene.variant({**values, key: p})

    def _end_models(self) -> Iterator[Model]:
        """The models at the ends of all curves: a force may vanish in some of them, or have another harmonic."""
        ends = (self.plan.span[0],) if self.plan.along is None else (self.plan.along.first, self.plan.along.last)
        return (self.model_at(values)(end) for values in self.values for end in ends)

    def add(self, curves: Iterable[StudyCurve]) -> None:
        """Add curves.

        Raises:
            KeyboardInterrupt: one of them ends where it was interrupted; all are added.
        """
        endings = []
        for curve in curves:
            grown = self.with_curve(curve)
            self.scheme, self.curves = grown.scheme, grown.curves
            endings.append(curve.curve.ending)
            if not curve.curve.complete:
                self.faults.append(curve.label + curve.curve.message)
        if Ending.INTERRUPTED in endings:
            raise KeyboardInterrupt

    def _from_ends(
        self, values: Mapping[str, float], watch: Watch, processes: Processes | None
    ) -> Iterator[StudyCurve]:
        """The curves from the ends of the range, or from the motion that the plan gives."""
        plan, along, model_at = self.plan, self.plan.along, self.model_at(values)
        chosen = "time_samples" in plan.chosen
        options = self._options(convergence.checking_samples(model_at, self.schemes, watch) if chosen else watch)
        guess, begin = None, None
        if plan.motion is not None:
            structure = model_at(plan.span[0] if along is None else along.first).structure
            guess, begin = plan.motion.guess(structure), plan.motion.frequency
        if along is not None:
            curve = parameter_curve(model_at, plan.span[0], along.first, along.last, guess=guess, **options)
            yield StudyCurve(values, model_at, curve)
            return
        model = self.scene.variant(values)
        if guess is None:
            steps = options["controls"]
            aside = None if processes is None else Aside(processes, self.schemes, steps, checks_samples=chosen)
            curves = curves_from_ends(model, *plan.span, both=plan.both_ends, aside=aside, **options)
            if aside is not None and curves[-1].ending is Ending.INTERRUPTED:
                curves += aside.left_of(curves, stability=plan.stability)
        else:
            curves = [hbm_curve(model, *plan.span, guess=guess, begin=begin, **options)]
        yield from (StudyCurve(values, model_at, curve) for curve in curves)

    def _through(
        self,
        values: Mapping[str, float],
        states: SavedStates,
        asked: Mapping[str, float | str],
        watch: Watch,
        useless: dict[str, list[float]],
    ) -> Iterator[StudyCurve]:
        """Curves from settled points of a sweep that no other curve passes, which may be isolated branches.

        Points at which contacts only stick are skipped. The frequencies of those from which no curve can be begun are
        added to ``useless``, by the reason.
        """
        own = {key: value for key, value in values.items() if key in states.axes}
        try:
            points = list(settled_points(states, own | dict(asked)))
        except RuleError:
            return  # the sweep has no such values
        model = self.scene.variant(values)
        motions = [
            SettledMotion(point[0], point[1]["amplitude"], partial(self._coefficients, model, states, point, useless))
            for point in points
        ]
        known = [curve.curve for curve in self.curves if curve.values == values]
        for curve in isolated_curves(model, known, motions, self.plan.span, **self._options(watch)):
            yield StudyCurve(values, self.model_at(values), curve)

    def _coefficients(
        self, model: Model, states: SavedStates, point: SweepPoint, useless: dict[str, list[float]]
    ) -> np.ndarray | None:
        """Modal Fourier coefficients of a point of a sweep; None, and why, where this model cannot start from it."""
        frequency, arrays = point
        try:
            start = start_of(model, states, arrays)
            return modal_coefficients(replace(model, start=start), frequency, self.scene.solver())
        except RuleError as error:
            reason = f"the result {error.rule}"
        except RunError as error:
            reason = str(error)
        useless.setdefault(reason, []).append(frequency)
        return None

    def _options(self, watch: Watch) -> dict[str, Any]:
        along, stable = self.plan.along, self.plan.stability
        # The name of a contact may hold braces.
        key = "" if along is None else along.key.replace("{", "{{").replace("}", "}}")
        steps = replace(self.plan.steps, place=f"{key} = {{:.10g}}" if key else "{:.10g} Hz")
        return {"scheme": self.schemes, "controls": steps, "stability": stable, "watch": watch}

    def to_refine(self) -> list[convergence.Known]:
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

    def record(self, attrs: Mapping[str, Any], refined: convergence.Convergence | None = None) -> Dataset:
        """The result file: all solutions, one curve after the other."""
        sizes = sizes_of(self.any_model) | {"harmonic": self.scheme.harmonics + 1}
        names = (*OF_SOLUTION, *OF_MOTION, *OF_CONTACTS)
        arrays = {name: self._stacked(name, *(sizes[dim] for dim in TAILS.get(name, ()))) for name in names}
        arrays |= {name: arrays[name].astype(np.int8) for name in ("stable", "fold")}
        arrays["branch"] = arrays["branch"].astype(np.int32)
        counts = [one.curve.frequency.size for one in self.curves]
        arrays["curve"] = np.repeat(np.arange(len(counts)), counts).astype(np.int32)
        for key in self.plan.over:
            arrays[key] = np.repeat([one.values[key] for one in self.curves], counts)
        if (along := self.plan.along) is not None:
            arrays[along.key] = self._stacked("parameter")
            attrs = {**attrs, "along": along.key}
        variables = {name: (("solution", *TAILS.get(name, ())), array) for name, array in arrays.items()}
        coords: dict[str, np.ndarray] = {}
        if refined is not None:
            coords = {"harmonics": refined.harmonics, "time_samples": refined.time_samples}
            variables["change_with_harmonics"] = (("harmonics",), refined.with_harmonics)
            variables["change_with_samples"] = (("time_samples",), refined.with_samples)
            attrs = {**attrs, "convergence": "\n".join(convergence_lines(refined))}
        return dataset(variables, coords, attrs, self.any_model)

    def _stacked(self, name: str, *shape: int) -> np.ndarray:
        own = (np.asarray(getattr(one.curve, name), dtype=float) for one in self.curves)
        return np.concatenate([np.zeros((0, *shape)), *own])


def _known(curve: StudyCurve, i: int) -> convergence.Known:
    solutions = curve.curve
    model = curve.model_at(float(solutions.parameter[i]))
    return convergence.Known(model, float(solutions.frequency[i]), solutions.contact_motion[i], solutions.amplitude[i])


def _isolated(curve: StudyCurve) -> str:
    """A curve through points of a sweep, in words."""
    frequency = curve.curve.frequency
    closed = "closed, " if curve.curve.ending is Ending.CLOSED else ""
    span = f"{frequency.min():.6g} to {frequency.max():.6g} Hz" if frequency.size else "without a solution"
    return f"{curve.label}a curve of its own, {closed}{span}, begun from points of the sweep that no other passes"


def _not_begun(states: SavedStates, values: Mapping[str, float], useless: Mapping[str, Sequence[float]]) -> list[str]:
    """From which points of a sweep no curve could be begun, a note for each reason."""
    label = in_words({key: value for key, value in values.items() if key in states.axes}, ": ")
    notes = []
    for reason, at in useless.items():
        points = "the sweep's point" if len(at) == 1 else f"{len(at)} points of the sweep"
        low, high = (f"{end:g}" for end in (min(at), max(at)))
        where = f"at {low} Hz" if low == high else f"from {low} to {high} Hz"
        notes.append(f"{label}no curve is begun from {points} {where}: {reason}")
    return notes
