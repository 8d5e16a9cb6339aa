"""Studies by harmonic balance, and its comparison with a sweep, as the scene file writes them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Strict, Tag, model_validator

from timesim.fault import RuleError, nearest
from timesim.hbm.scheme import BalanceError, Scheme, check_excitation
from timesim.model.model import Model
from timesim.result.file import StoreError
from timesim.result.state import Held, ResultSection, held
from timesim.result.waves import result_waves
from timesim.scene.axis import OVER_PARTS, Over
from timesim.scene.contact import ContactSection
from timesim.scene.section import Count, Number, Positive, Section, Text, Whole, refuse
from timesim.scene.study import StudyKind
from timesim.scene.sweep import SweepKeys


class FrequencyRange(Section):
    """Range of frequencies that a curve is followed through."""

    first: Positive = Field(alias="from")
    """Where the curve begins [Hz]; may be the larger end."""
    to: Positive
    """Where it ends [Hz]."""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if self.first == self.to:
            raise refuse("must differ from `from`", key=("to",), value=self.to, hint="a sweep takes one frequency")
        return self


class Ends(Section):
    """Range of a scalar that a curve is followed through."""

    first: Number = Field(alias="from")
    """Where the curve begins; may be the larger end."""
    to: Number
    """Where it ends."""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if self.first == self.to:
            raise refuse("must differ from `from`", key=("to",), value=self.to)
        return self

    def values(self) -> tuple[float, float]:
        """Both ends."""
        return self.first, self.to


def _one_scalar(along: Mapping[str, Ends]) -> Mapping[str, Ends]:
    if len(along) > 1:
        raise refuse(f"must name one scalar, not {len(along)}", hint="the others may be axes of `over`")
    for key in along:
        part = key.partition(".")[0]
        if part not in OVER_PARTS or key == part:
            raise refuse("must be the key of a scalar of the scene", key=(key,), hint=nearest(part, OVER_PARTS))
        if key == "excitation.frequency":
            raise refuse("is the study's own frequency", key=(key,), hint="use frequency with from and to")
    return along


class Continuation(Section):
    """Steps along the curve, as shares of its range and of the size of the response."""

    first_step: Positive | None = None
    """Length of the first step; by default a fifth of the longest."""
    min_step: Positive = 1e-6
    """Step below which the curve is given up."""
    max_step: Positive = 0.05
    """Longest step; shorter ones follow where the curve bends."""
    max_points: Annotated[Whole, Field(ge=2)] = 5000
    """Points after which the curve is given up."""
    tolerance: Annotated[Positive, Field(le=1e-3)] = 1e-9
    """Of the balance at each point, relative to the size of the motion."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        first = self.max_step / 5 if self.first_step is None else self.first_step
        if not self.min_step <= first <= self.max_step:
            hint = f"first_step {first:g}, max_step {self.max_step:g}"
            raise refuse("must be at most first_step, and that at most max_step", key=("min_step",), hint=hint)
        object.__setattr__(self, "first_step", first)
        return self


class ResultStart(ResultSection):
    """The motion that a transient has settled to, or those of a sweep.

    From a transient's motion the curve is followed to both sides of its frequency. With a sweep the linear response is
    followed first, then a curve from each of the points (those of `at`, if it is given) that no curve passes.
    """


def _start_kind(value: Any) -> str | None:
    return "<word>" if isinstance(value, str) else "<result>" if isinstance(value, dict | Section) else None


StartSection = Annotated[
    Annotated[Literal["linear", "both_ends"], Tag("<word>")] | Annotated[ResultStart, Tag("<result>")],
    Discriminator(
        _start_kind,
        custom_error_type="rule",
        custom_error_message="must be linear, both_ends, or a mapping with from: the result of a transient or sweep",
    ),
]


class HbmKeys(StudyKind):
    """What a harmonic balance is told."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation")

    harmonics: Annotated[Count, Field(le=1000)] = 9
    """Highest harmonic of the excitation frequency that is balanced, the mean beside them."""
    time_samples: Annotated[Whole, Field(le=10**6)] = 1024
    """Samples of a period on which the contact forces are evaluated; at least 16, and 4 a harmonic."""
    located: Annotated[bool, Strict()] = False
    """Locate every transition of the contacts instead: slow, a reference."""
    stability: Annotated[bool, Strict()] = True
    """Floquet multipliers of every point; without, only folds tell stable from unstable."""
    start: StartSection = "linear"
    """linear: the linear response with the contacts stuck or apart; both_ends: from both ends; or {from: result.nc},
    a transient's motion, or a sweep's, which reach isolated branches."""
    continuation: Continuation = Continuation()
    """Steps along the curve."""
    convergence: Annotated[bool, Strict()] = False
    """Say how the answer depends on harmonics and time samples."""

    @model_validator(mode="after")
    def _fine_enough(self) -> Self:
        try:
            self.scheme()
        except BalanceError as error:
            raise refuse(error.rule, key=(error.key,), value=error.value, hint=error.hint) from None
        return self

    def scheme(self) -> Scheme:
        """Harmonics and samples in numbers."""
        return Scheme(self.harmonics, self.time_samples, "located" if self.located else "sampled")

    def fits(self, model: Model) -> Iterator[RuleError]:
        """The excitation is periodic, and its harmonics are balanced."""
        try:
            check_excitation(model, self.harmonics)
        except BalanceError as error:
            key = ("excitation",) if error.key == "excitation" else ("study", error.key)
            yield RuleError(key, error.rule, error.hint, error.value)

    def problems(self, contacts: Sequence[ContactSection], folder: Path) -> Iterator[RuleError]:
        """The result to start from is there."""
        if isinstance(self.start, ResultStart):
            try:
                found = held(folder / self.start.source)
                yield from self._sweep_fits(found, contacts) if found.axes else self._transient_fits(folder)
            except (RuleError, ValueError, StoreError) as error:
                what = error.rule if isinstance(error, RuleError) else str(error)
                yield RuleError(
                    ("start", "from"), "must be the result of a transient or a sweep", what, self.start.source
                )

    def _transient_fits(self, folder: Path) -> Iterator[RuleError]:
        assert isinstance(self.start, ResultStart)
        frequency = result_waves(folder / self.start.source).frequency
        low, high = sorted(self.span())
        if not low * (1 - 1e-9) <= frequency <= high * (1 + 1e-9):
            rule = f"must be at a frequency from {low:g} to {high:g} Hz"
            yield RuleError(("start", "from"), rule, f"it is at {frequency:g} Hz", self.start.source)
        if self.start.at:
            yield RuleError(
                ("start", "at"), "names a point of a sweep", "the result is that of a transient: leave it out"
            )

    def _sweep_fits(self, found: Held, contacts: Sequence[ContactSection]) -> Iterator[RuleError]:
        assert isinstance(self.start, ResultStart)
        names = [contact.name for contact in contacts]
        if sorted(names) != sorted(found.contacts):
            rule = f"must have the contacts of the scene, not {', '.join(found.contacts) or 'none'}"
            yield RuleError(("start", "from"), rule, f"the scene has {', '.join(names) or 'none'}", self.start.source)
            return
        if getattr(self, "along", {}):
            rule = "must be the result of a transient where the curve runs along another scalar"
            yield RuleError(("start", "from"), rule, "", self.start.source)
            return
        try:
            free = {name for name, places in found.places(self.start.at).items() if len(places) > 1}
        except RuleError as error:
            yield error.below("start", "at")
            return
        for name in free - {"frequency", "direction"} - set(getattr(self, "over", {})):
            hint = f"the sweep has an axis that is none of this study's `over`: which of its values, {name}: ...?"
            yield RuleError(("start", "at"), f"must name the {name}", hint)

    def span(self) -> tuple[float, float]:
        """First and last frequency [Hz]."""
        raise NotImplementedError

    def absolute(self, folder: Path) -> Self:
        """The same with the result's path from the root."""
        if not isinstance(self.start, ResultStart):
            return self
        return self.model_copy(update={"start": self.start.absolute(folder)})


def _frequency_kind(value: Any) -> str | None:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return "<number>"
    return "<range>" if isinstance(value, dict | Section) else None


class Hbm(HbmKeys):
    """Periodic responses along a curve, through folds, by harmonic balance."""

    kind: Literal["hbm"]
    frequency: Annotated[
        Annotated[Positive, Tag("<number>")] | Annotated[FrequencyRange, Tag("<range>")],
        Discriminator(
            _frequency_kind,
            custom_error_type="rule",
            custom_error_message="must be a mapping with from and to, or with `along` a number",
        ),
    ]
    """{from, to} [Hz]; a number where the curve runs `along` another scalar."""
    along: Annotated[dict[Text, Ends], AfterValidator(_one_scalar)] = Field(default_factory=dict)
    """In place of the frequency: a scalar of the scene by its key, with from and to."""
    over: Over = Field(default_factory=dict)
    """A curve for each value: scalars of the scene by their key."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.along and isinstance(self.frequency, FrequencyRange):
            raise refuse("must be a number where the curve runs along another scalar", key=("frequency",))
        if not self.along and not isinstance(self.frequency, FrequencyRange):
            hint = "or give `along` a scalar of the scene"
            raise refuse("must be a mapping with from and to", key=("frequency",), value=self.frequency, hint=hint)
        if both := set(self.along) & set(self.over):
            raise refuse("is the scalar of `along`", key=("over", both.pop()))
        if self.along and self.start == "both_ends":
            raise refuse("must be linear, or a mapping with from, where `along` is given", key=("start",))
        return self

    def span(self) -> tuple[float, float]:
        """First and last frequency [Hz]."""
        if isinstance(self.frequency, FrequencyRange):
            return self.frequency.first, self.frequency.to
        return self.frequency, self.frequency


class Compare(SweepKeys, HbmKeys):
    """A sweep and the harmonic balance of one scene, side by side."""

    kind: Literal["compare"]

    def span(self) -> tuple[float, float]:
        """First and last frequency of the sweep [Hz]; of a single one, a little beyond."""
        values = self.frequency.values()
        low, high = float(values[0]), float(values[-1])
        return low, high if high > low else 1.001 * low
