"""The study of a response that jumps, as the scene file writes it."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from timesim.fault import RuleError
from timesim.hbm.scheme import BalanceError, check_excitation
from timesim.model.model import Model
from timesim.scene.axis import MAX_POINTS, Frequencies, Over
from timesim.scene.hbm import FrequencyRange, Hbm
from timesim.scene.section import Count, Positive, Section, Whole, refuse
from timesim.scene.study import StudyKind
from timesim.scene.sweep import Settle, Sweep

STEPS = 40  # of a sweep that is told none


class Span(Section):
    """A range of frequencies, ascending."""

    first: Positive = Field(alias="from")
    """Lower end [Hz]."""
    to: Positive
    """Upper end [Hz]."""

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if self.to <= self.first:
            raise refuse("must be larger than from", key=("to",), value=self.to)
        return self


class Bistable(StudyKind):
    """Where a response has two steady motions: sweeps both ways, ends of the range, and which start leads where."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation")

    kind: Literal["bistable"]
    frequency: Span
    """{from, to} [Hz]: where to look."""
    width: Positive = 1e-5
    """Width [Hz] to which each end is bisected."""
    step: Positive | None = None
    """Step [Hz] of the sweeps, by default a fortieth of the range; a range with two motions may be far narrower."""
    over: Over = Field(default_factory=dict)
    """Further axes: scalars of the scene by their key, each with its values."""
    settle: Settle = Settle(max_cycles=5000)
    """When a motion counts as settled; near the end of a range it does so very slowly."""
    periodic: Literal["march", "shoot"] = "march"
    """How a periodic motion is found: marching until it settles, or Newton's method on the state after a period."""
    starts: Annotated[Whole, Field(ge=0, le=101)] = 9
    """Starts at mid-range, as many along each side of a square: sums of the two motions; 5, 9, 13, ..., 0 for none."""
    harmonics: Annotated[Whole, Field(ge=0, le=1000)] = 9
    """Highest harmonic of the branch by harmonic balance that is drawn behind; 0 draws none."""
    time_samples: Annotated[Count, Field(le=10**6)] = 1024
    """Samples of a period that the balance takes."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        span = self.frequency.to - self.frequency.first
        if self.step is None:
            object.__setattr__(self, "step", span / STEPS)
        step = self.step or span / STEPS
        if step > span / 2:
            raise refuse("must be at most half of the range of frequency", key=("step",), value=step)
        if self.starts and (self.starts < 5 or self.starts % 4 != 1):
            hint = "so rest and both motions are among the starts"
            raise refuse("must be 0, or 5, 9, 13, ...", key=("starts",), value=self.starts, hint=hint)
        if self.width > step:
            raise refuse("must be at most the step of the sweeps", key=("width",), value=self.width)
        if span / step > MAX_POINTS:
            raise refuse(f"must leave at most {MAX_POINTS} points", key=("step",), value=step)
        if self.harmonics:
            try:
                self.balance().scheme()
            except BalanceError as error:
                raise refuse(error.rule, key=(error.key,), value=error.value, hint=error.hint) from None
        return self

    def fits(self, model: Model) -> Iterator[RuleError]:
        """The balance can be struck."""
        if self.harmonics:
            try:
                check_excitation(model, self.harmonics)
            except BalanceError as error:
                key = ("excitation",) if error.key == "excitation" else ("study", error.key)
                yield RuleError(key, error.rule, error.hint, error.value)

    def lowest_frequency(self) -> float:
        """The lower end."""
        return self.frequency.first

    def points_told(self) -> str:
        """Those of the sweeps."""
        return f"{self.sweep().points_told()} in the sweeps, and the search for the ends"

    def sweep(self) -> Sweep:
        """The sweeps both ways."""
        assert self.step is not None
        span = self.frequency
        # The last point lies on the upper end, whatever the step.
        num = round((span.to - span.first) / self.step)
        step = (span.to - span.first) / num
        return Sweep(
            kind="sweep",
            frequency=Frequencies.model_validate({"from": span.first, "to": span.to, "step": step}),
            direction="both",
            over=self.over,
            settle=self.settle,
            periodic=self.periodic,
            refine=self.width,
        )

    def balance(self) -> Hbm:
        """The branch of harmonic balance."""
        ends = {"from": self.frequency.first, "to": self.frequency.to}
        return Hbm(
            kind="hbm",
            frequency=FrequencyRange.model_validate(ends),
            over=self.over,
            harmonics=self.harmonics,
            time_samples=self.time_samples,
            start="both_ends",
        )
