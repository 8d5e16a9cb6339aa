"""Studies of steady states over frequency: sweeps, the ranges with two motions, the scalar of least peak."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import log, sqrt
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from timesim.fault import RuleError
from timesim.hbm.scheme import Controls
from timesim.model.model import CONE, Model
from timesim.scene.hbm import HarmonicsOrNone, HbmPlan, TimeSamples, balance_problems, balanced
from timesim.scene.section import refuse
from timesim.scene.study import ROUNDED, Context, OneKey, Over, Settle, SteadySection, SweepPlan, SweepSection, axes_of
from timesim.scene.value import MAX_POINTS, Ascending, Count, Frequencies, PointName, Positive, Range, Whole, spaced


class Sweep(SweepSection):
    """Steady states over frequency and any scalars of the scene."""

    keeps_failures: ClassVar[bool] = True

    kind: Literal["sweep"]

    def plan(self, context: Context) -> SweepPlan:
        return self.sweep()


# The scalar of least peak


@dataclass(frozen=True, eq=False)
class OptimumPlan:
    """The peak over frequency against a scalar.

    Attributes:
        sweep: up and down at ascending values of the scalar, its only further axis; the least peak is sought between
            the first and the last of them.
        accuracy: of the value of the scalar where the peak is least.
        point, axis: whose amplitude counts; the largest of all where it is None.
    """

    sweep: SweepPlan
    accuracy: float
    point: str | None
    axis: str | None

    @property
    def searched(self) -> int:
        """Values that the search may need: golden sections down to the accuracy, and those beside the least."""
        ((_, values),) = self.sweep.over.items()
        between = 2 * (values[-1] - values[0]) / (len(values) - 1)
        return 3 + round(log(max(between / self.accuracy, 1.0)) / log((1 + sqrt(5)) / 2))


ACCURACY = 1e-3
"""Accuracy of the scalar where none is given, as a share of its range."""
FEWEST = 3  # values, so that one may lie between two others


class Optimum(SteadySection):
    """The peak of the response over frequency against a scalar of the scene, and where it is least."""

    kind: Literal["optimum"]
    along: OneKey[Range]
    """A scalar of the scene by its key, with from, to and num: the values computed before the least is sought."""
    frequency: Frequencies
    """{from, to, step}, {from, to, num} or {values: [...]} [Hz]; swept both ways, the peak sought between points."""
    accuracy: Positive | None = None
    """Accuracy of the value of the scalar where the peak is least; by default a thousandth of its range."""
    point: PointName | None = None
    """Point whose amplitude counts; the largest of all by default."""
    axis: Literal["x", "y", "z"] | None = None
    """Axis along which it counts; the largest of all by default."""

    @model_validator(mode="after")
    def _searchable(self) -> Self:
        if not self.along:
            raise refuse("must name one scalar, not 0", key=("along",))
        ((key, given),) = self.along.items()
        if given.num < FEWEST:
            raise refuse(f"must be at least {FEWEST}", key=("along", key, "num"), value=given.num)
        span = given.to - given.first
        if self.accuracy is not None and self.accuracy > span / 2 * ROUNDED:
            rule = "must be at most half of the range of the scalar"
            raise refuse(rule, key=("accuracy",), value=self.accuracy)
        return self.completed(accuracy=float(f"{ACCURACY * span:.6g}"))  # as a user would write it

    def plan(self, context: Context | None = None) -> OptimumPlan:
        assert self.accuracy is not None
        return OptimumPlan(self.sweep(), self.accuracy, self.point, self.axis)

    def sweep(self) -> SweepPlan:
        """Up and down at each value of the scalar that is computed first."""
        return SweepPlan(self.frequency.values(), ("up", "down"), axes_of(self.along), self.criterion(), None)

    def search(self) -> str:
        return f", and some {self.plan().searched} values more in the search for the least"


# Ranges with two motions


@dataclass(frozen=True)
class BistablePlan:
    """Where a response has two steady motions: sweeps up and down, and the balance, which is None if left out."""

    sweep: SweepPlan
    width: float
    starts: int
    balance: HbmPlan | None


STEPS = 40  # of the sweeps where no step is given


class FrequencyRange(Ascending):
    """A range of frequencies, ascending."""

    first: Positive = Field(alias="from")
    """Lower end [Hz]."""
    to: Positive
    """Upper end [Hz]."""


class SlowSettle(Settle):
    """When a motion counts as settled; near the end of a range it does so very slowly."""

    max_cycles: Count = 5000
    """Excitation cycles from which on a point is given up as not settled: looked at every 8, and those that measure it
    come on top."""


class Bistable(SteadySection):
    """Ranges with two steady motions: sweeps up and down, the ends of a range, and which start leads to which."""

    kind: Literal["bistable"]
    frequency: FrequencyRange
    """{from, to} [Hz]: where to look."""
    width: Positive = 1e-5
    """Width [Hz] to which each end is bisected; by default no more than the step."""
    step: Positive | None = None
    """Step [Hz] of the sweeps, by default a fortieth of the range; a range with two motions may be far narrower."""
    over: Over = Field(default_factory=dict)
    """Further axes: scalars of the scene by their key, each with its values."""
    settle: SlowSettle = SlowSettle()
    """When a motion counts as settled; near the end of a range it does so very slowly."""
    starts: Annotated[Whole, Field(ge=0, le=101)] = 9
    """Starts at mid-range along each side of a square of sums of the two motions: 5, 9, 13, ..., or 0 for none."""
    harmonics: HarmonicsOrNone = "auto"
    """Highest harmonic of the curve by harmonic balance that is drawn behind, or auto; 0 leaves it out."""
    time_samples: TimeSamples = "auto"
    """Samples of a period that the balance takes."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        span = self.frequency.to - self.frequency.first
        step = self.step or span / STEPS
        if step > span / 2 * ROUNDED:
            raise refuse("must be at most half of the range of frequency", key=("step",), value=step)
        if self.starts and (self.starts < 5 or self.starts % 4 != 1):
            hint = "so rest and both motions are among the starts"
            raise refuse("must be 0, or 5, 9, 13, ...", key=("starts",), value=self.starts, hint=hint)
        width = self.width if "width" in self.model_fields_set else min(self.width, step)
        if width > step * ROUNDED:
            hint = "" if self.step else f"study.step is by default a fortieth of the range: give {width:g} or more"
            raise refuse(f"must be at most the step of the sweeps, {step:g} Hz", key=("width",), value=width, hint=hint)
        if span / step > MAX_POINTS:
            raise refuse(f"must leave at most {MAX_POINTS} points", key=("step",), value=step)
        if self.harmonics:
            balanced(self.harmonics, self.time_samples)
        return self.completed(step=step).model_copy(update={"width": width})

    def sweep(self) -> SweepPlan:
        """Up and down; the step is adjusted so that the last point is the upper end."""
        assert self.step is not None
        first, to = self.frequency.first, self.frequency.to
        frequency = spaced(first, to, (to - first) / round((to - first) / self.step))
        return SweepPlan(frequency, ("up", "down"), axes_of(self.over), self.criterion(), self.width)

    def search(self) -> str:
        return " in the sweeps, and the search for the ends"

    def plan(self, context: Context) -> BistablePlan:
        """Sweeps up and down, the search for the ends, the starts at mid-range, and the curve by harmonic balance."""
        sweep, balance = self.sweep(), None
        if self.harmonics:
            span = (self.frequency.first, self.frequency.to)
            scheme, chosen = balanced(self.harmonics, self.time_samples)
            balance = HbmPlan(scheme, span, sweep.over, Controls(), both_ends=True, chosen=chosen)
        return BistablePlan(sweep, self.width, self.starts, balance)

    def problems(self, model: Model) -> Iterator[RuleError]:
        """The harmonic balance, if there is one, must be possible."""
        if not self.harmonics:
            return
        yield from balance_problems(model, self.harmonics)
        for contact in model.contacts:
            if contact.law != CONE:
                rule = f"must be 0 where the law of a contact is not {CONE}"
                yield RuleError(("study", "harmonics"), rule, f"{contact.name} has {contact.law}", self.harmonics)
                return
