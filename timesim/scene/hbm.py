"""Studies by harmonic balance, and the comparison of one with a sweep."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from timesim.fault import RuleError
from timesim.hbm.scheme import BalanceError, Controls, Scheme, check_model, finer_schemes, first_scheme
from timesim.model.model import Model
from timesim.result.file import StoreError
from timesim.result.label import counted
from timesim.result.last_cycle import PeriodicMotion, periodic_motion
from timesim.result.state import SavedStates, saved_states
from timesim.scene.integration import ResultSection
from timesim.scene.section import AsMapping, AsNumber, AsText, AutoOr, Section, by_form, refuse
from timesim.scene.study import Axes, Context, OneKey, Over, StudySection, SweepPlan, SweepSection, axes_of
from timesim.scene.value import Count, Positive, Span, Switch, Whole


@dataclass(frozen=True)
class Along:
    """A scalar of the scene by its key, and its values where the curve begins and ends."""

    key: str
    first: float
    last: float


@dataclass(frozen=True, eq=False)
class HbmPlan:
    """Response curves by harmonic balance.

    Attributes:
        scheme: harmonics and time samples, the first ones tried where the program chooses them.
        chosen: the keys of the scheme that the program raises where it proves too coarse.
        span: first and last frequency of the curves [Hz].
        over: the further axes, a curve or several for each combination of values.
        along: the scalar that the curves run along at the frequency `span[0]`; None: they run along the frequency.
        stability, convergence: as in `BalanceSection`.
        both_ends: whether a curve is begun from either end.
        motion: a motion to begin from; None: the linear response.
        passing: states of a sweep that curves are to pass too, and which of them, by axis.
    """

    scheme: Scheme
    span: tuple[float, float]
    over: Axes
    steps: Controls
    along: Along | None = None
    stability: bool = True
    convergence: bool = False
    both_ends: bool = False
    chosen: tuple[str, ...] = ()
    motion: PeriodicMotion | None = None
    passing: tuple[SavedStates, Mapping[str, float | str]] | None = None

    def schemes_for(self, model: Model) -> tuple[Scheme, ...]:
        """The scheme to begin with, which has all excited harmonics, and those that may be taken after it."""
        if "harmonics" not in self.chosen:
            return (self.scheme,)
        return finer_schemes(self.scheme, model, choose_samples="time_samples" in self.chosen)


class FrequencySpan(Span):
    """Two frequencies: where a curve begins and where it ends."""

    first: Positive = Field(alias="from")
    """Where the curve begins [Hz]; may be the larger end."""
    to: Positive
    """Where it ends [Hz]."""


class Continuation(Section):
    """Steps along the curve, as shares of its range and of the size of the response."""

    first_step: Positive | None = None
    """Length of the first step; by default a fifth of the longest."""
    min_step: Positive = Controls.min_step
    """Step below which the curve is given up."""
    max_step: Positive = Controls.max_step
    """Longest step; shorter ones follow where the curve bends."""
    max_points: Annotated[Whole, Field(ge=2)] = Controls.max_points
    """Points after which the curve is given up."""
    tolerance: Annotated[Positive, Field(le=1e-3)] = Controls.tolerance
    """Tolerance of the balance at each point, relative to the size of the motion."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        fifth = self.max_step / (Controls.max_step / Controls.first_step)
        first = fifth if self.first_step is None else self.first_step
        if not self.min_step <= first <= self.max_step:
            hint = f"first_step {first:g}, max_step {self.max_step:g}"
            raise refuse("must be at most first_step, and that at most max_step", key=("min_step",), hint=hint)
        return self.completed(first_step=first)


class ResultStart(ResultSection):
    """The motion that a transient has settled to, or those of a sweep.

    From the motion of a transient the curve is followed to both sides of its frequency. With a sweep, the curve from
    the linear response is followed first, then one from each point (of those that `at` selects) that no curve passes.
    """

    def begin(self, plan: HbmPlan, context: Context) -> HbmPlan:
        """The plan with the motion to begin from, or the states that curves are to pass.

        Raises:
            RuleError: the result is none of this scene; the key is relative to this section.
        """
        path = context.folder / self.source
        try:
            states = saved_states(path)
            motion = None if states.axes else periodic_motion(path)
        except (RuleError, ValueError, StoreError) as error:
            said = (error.rule, error.hint) if isinstance(error, RuleError) else (str(error),)
            raise self.refused("must be the result of a transient or a sweep", ", ".join(filter(None, said))) from None
        context.read.append(states if motion is None else motion)
        if motion is None:
            self._check_sweep(states, plan, context)
            return replace(plan, passing=(states, self.at))
        low, high = sorted(plan.span)
        if not low * (1 - 1e-9) <= motion.frequency <= high * (1 + 1e-9):
            where = f"from {low:g} to {high:g} Hz" if high > low else f"of {low:g} Hz"
            raise self.refused(f"must be at a frequency {where}", f"it is at {motion.frequency:g} Hz")
        if self.at:
            raise RuleError(("at",), "names a point of a sweep", "the result is that of a transient: leave it out")
        count = motion.modal.shape[1]
        if context.num_modes is not None and count != context.num_modes:
            raise self.refused(f"must have {counted(context.num_modes, 'mode')}, as the scene, not {count}")
        return replace(plan, motion=motion)

    def _check_sweep(self, states: SavedStates, plan: HbmPlan, context: Context) -> None:
        names = [contact.name for contact in context.contacts]
        if sorted(names) != sorted(states.contacts):
            rule = f"must have the contacts of the scene, not {', '.join(states.contacts) or 'none'}"
            raise self.refused(rule, f"the scene has {', '.join(names) or 'none'}")
        if plan.along is not None:
            raise self.refused("must be the result of a transient where the curve runs along another scalar")
        try:
            free = {name for name, places in states.places(self.at).items() if len(places) > 1}
        except RuleError as error:
            raise error.below("at") from None
        for name in sorted(free - {"frequency", "direction"} - set(plan.over)):
            hint = f"the sweep has an axis that is none of this study's `over`: which of its values, {name}: ...?"
            raise RuleError(("at",), f"must name the {name}", hint)


StartSection = Annotated[
    AsText[Literal["linear", "both_ends"]] | AsMapping[ResultStart],
    by_form("linear, both_ends, or a mapping with from: the result of a transient or sweep"),
]
TimeSamples = AutoOr[Annotated[Whole, Field(le=10**6)]]
Harmonics = AutoOr[Annotated[Count, Field(le=1000)]]
HarmonicsOrNone = AutoOr[Annotated[Whole, Field(ge=0, le=1000)]]


def balanced(harmonics: int | Literal["auto"], time_samples: int | Literal["auto"]) -> tuple[Scheme, tuple[str, ...]]:
    """The scheme to begin with, and which of the two numbers the program chooses.

    Raises:
        PydanticCustomError: the scheme is too coarse.
    """
    keys = {"harmonics": harmonics, "time_samples": time_samples}
    try:
        scheme = first_scheme(harmonics, time_samples)
    except BalanceError as error:
        raise refuse(error.rule, key=(error.key,), value=error.value, hint=error.hint) from None
    return scheme, tuple(key for key, value in keys.items() if value == "auto")


def balance_problems(model: Model, harmonics: int | Literal["auto"]) -> Iterator[RuleError]:
    """Why a model cannot be balanced, keys from the root of the scene."""
    try:
        check_model(model, None if harmonics == "auto" else harmonics)
    except BalanceError as error:
        key = (error.key,) if error.key in ("contacts", "excitation") else ("study", error.key)
        yield RuleError(key, error.rule, error.hint, error.value)


class BalanceSection(StudySection):
    """The keys of a harmonic balance, on its own or as a part of another study."""

    cone_only: ClassVar[bool] = True

    harmonics: Harmonics = "auto"
    """Highest harmonic of the excitation frequency that is balanced, besides the mean; auto: 9, and more at each
    solution where those above would add more than 1e-4 of the amplitude, up to a number that `check` names."""
    time_samples: TimeSamples = "auto"
    """Samples of a period at which the contact forces are evaluated; at least 16, and 4 a harmonic; auto: 256, or more
    from 17 harmonics on, and four times as many where those would change the contacts' motion by over 1e-3."""
    stability: Switch = True
    """Compute the Floquet multipliers of every point; without them only folds tell stable from unstable."""
    start: StartSection = "linear"
    """linear: the linear response with the contacts stuck or apart, else a load that grows from zero while damping
    leaves, else the motion of a time integration; both_ends: the same from both ends; or {from: result.nc}, a
    transient's motion, or a sweep's, which reach isolated branches."""
    continuation: Continuation = Field(default_factory=lambda: Continuation.model_validate({}))
    """Steps along the curve."""
    convergence: Switch = False
    """Compute how the answer depends on harmonics and time samples."""

    @model_validator(mode="after")
    def _fine_enough(self) -> Self:
        balanced(self.harmonics, self.time_samples)
        return self

    def problems(self, model: Model) -> Iterator[RuleError]:
        """There must be contacts and a periodic excitation, whose harmonics must all be balanced."""
        return balance_problems(model, self.harmonics)

    def balance(self, context: Context, span: tuple[float, float], over: Axes, along: Along | None = None) -> HbmPlan:
        """The balance in numbers.

        Raises:
            RuleError: the result to start from is none of this scene.
        """
        scheme, chosen = balanced(self.harmonics, self.time_samples)
        plan = HbmPlan(
            scheme=scheme,
            chosen=chosen,
            span=span,
            over=over,
            along=along,
            steps=Controls(**self.continuation.model_dump()),
            stability=self.stability,
            convergence=self.convergence,
            both_ends=self.start == "both_ends",
        )
        if not isinstance(self.start, ResultStart):
            return plan
        try:
            return self.start.begin(plan, context)
        except RuleError as error:
            raise error.below("start") from None


class Hbm(BalanceSection):
    """Periodic responses along a curve, through folds, by harmonic balance."""

    counts: ClassVar[str] = "curves"

    kind: Literal["hbm"]
    frequency: Annotated[
        AsNumber[Positive] | AsMapping[FrequencySpan], by_form("a mapping with from and to, or with `along` a number")
    ]
    """{from, to} [Hz]; a number where the curve runs `along` another scalar."""
    along: OneKey[Span] = Field(default_factory=dict)
    """A scalar of the scene by its key, with from and to, instead of the frequency."""
    over: Over = Field(default_factory=dict)
    """A curve for each value: scalars of the scene by their key."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.along and isinstance(self.frequency, FrequencySpan):
            raise refuse("must be a number where the curve runs along another scalar", key=("frequency",))
        if not self.along and not isinstance(self.frequency, FrequencySpan):
            hint = "or give `along` a scalar of the scene"
            raise refuse("must be a mapping with from and to", key=("frequency",), value=self.frequency, hint=hint)
        if self.along and self.start == "both_ends":
            raise refuse("must be linear, or a mapping with from, where `along` is given", key=("start",))
        return self

    def plan(self, context: Context) -> HbmPlan:
        span = self.frequency.values() if isinstance(self.frequency, FrequencySpan) else (self.frequency,) * 2
        along = next((Along(key, ends.first, ends.to) for key, ends in self.along.items()), None)
        return self.balance(context, span, axes_of(self.over), along)


@dataclass(frozen=True)
class ComparePlan:
    """A sweep and a harmonic balance of the same scene."""

    sweep: SweepPlan
    balance: HbmPlan


class Compare(SweepSection, BalanceSection):
    """A sweep and the harmonic balance of one scene, side by side."""

    kind: Literal["compare"]

    def plan(self, context: Context) -> ComparePlan:
        """The balance runs from the first to the last frequency of the sweep, or a little beyond a single one."""
        sweep = self.sweep()
        low, high = float(sweep.frequency[0]), float(sweep.frequency[-1])
        return ComparePlan(sweep, self.balance(context, (low, high if high > low else 1.001 * low), sweep.over))


def balance_of(plan: Any) -> HbmPlan | None:
    """The harmonic balance that is the whole or a part of a study."""
    return plan if isinstance(plan, HbmPlan) else getattr(plan, "balance", None)
