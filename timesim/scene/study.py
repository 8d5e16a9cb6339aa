"""What the sections of the studies share: their base class, the scalars of the scene that they vary, and sweeps."""

import abc
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from math import prod
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from timesim.fault import Key, RuleError, nearest
from timesim.model.cost import Work, cycles_to_settle
from timesim.model.model import Model
from timesim.model.solver import SHOOT, SLOW, Criterion
from timesim.result.label import counted
from timesim.scene.contact import ContactSection
from timesim.scene.section import Section, refuse
from timesim.scene.value import Count, Frequencies, Positive, Text, Values, axis_values, repeated

T = TypeVar("T")
Axes = Mapping[str, tuple[float, ...]]
"""Scalars of the scene by their key path, each with its values."""

MAX_COMBINATIONS = 100_000
"""Most combinations of values of the further axes.

Each is checked before anything runs, which takes 0.4 ms where the structure does not change, and each is kept as a
model while the study runs.
"""

ROUNDED = 1 + 1e-9
"""A share of a range may be larger by this factor: 1.4 - 1.3 is less than 0.1."""

PARTS = ("structure", "contacts", "excitation", "initial")
"""Parts of a scene that a study may vary."""


def _scalar(key: str) -> str:
    part = key.partition(".")[0]
    if part not in PARTS or key == part:
        hint = f"such as contacts.pad.preload; {nearest(part, PARTS)}"
        raise refuse("must be the key of a scalar of the scene", hint=hint)
    if "/" in key:
        raise refuse("must not hold a /, which no axis of a result may", hint="give what it names another name")
    if key == "excitation.frequency":
        raise refuse("is an axis of its own", hint="use the study's frequency")
    return key


def _distinct(given: Any) -> Any:
    if twice := repeated(axis_values(given)):
        raise refuse("must differ from each other", hint=twice)
    return given


def _countable(over: Mapping[str, Any]) -> Mapping[str, Any]:
    sizes = [len(axis_values(given)) for given in over.values()]
    if (count := prod(sizes)) > MAX_COMBINATIONS:
        rule = f"must have at most {MAX_COMBINATIONS} combinations of values"
        raise refuse(f"{rule}, not {' x '.join(map(str, sizes))} = {count}")
    return over


def _at_most_one(along: Mapping[str, Any]) -> Mapping[str, Any]:
    if len(along) > 1:
        raise refuse(f"must name one scalar, not {len(along)}")
    return along


Scalar = Annotated[Text, AfterValidator(_scalar)]
"""Key path of a number of the scene, such as contacts.pad.preload; that it is a number is checked by setting it."""
Over = Annotated[dict[Scalar, Annotated[Values, AfterValidator(_distinct)]], AfterValidator(_countable)]
OneKey = Annotated[dict[Scalar, T], AfterValidator(_at_most_one)]
"""A mapping by one scalar of the scene, or empty."""


def axes_of(over: Mapping[str, Any]) -> Axes:
    """The values of each axis."""
    return {key: axis_values(given) for key, given in over.items()}


def combinations(axes: Axes) -> Iterator[dict[str, float]]:
    """All combinations of the values of the axes, the last axis fastest."""
    return (dict(zip(axes, values, strict=True)) for values in product(*axes.values()))


@dataclass(frozen=True)
class Context:
    """What a study may need from the rest of the scene.

    Attributes:
        contacts: the sections of the contacts.
        frequency: of the excitation [Hz]; None where the scene names none.
        folder: where relative paths begin.
        num_modes: of the structure; None where there is none, or it cannot be built.
        read: what a plan has read from other files; each that reads one adds it.
    """

    contacts: tuple[ContactSection, ...]
    frequency: float | None
    folder: Path
    num_modes: int | None = None
    read: list[Any] = field(default_factory=list)


class StudySection(Section):
    """What every study section has; `kind` is its tag."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation")
    """Keys that the scene must have."""
    uses_frequency: ClassVar[bool] = False
    """Whether ``excitation.frequency`` is the one it runs at."""
    uses_solver: ClassVar[bool] = True
    """Whether its result depends on the method of time integration."""
    explicit_only: ClassVar[bool] = False
    """Whether ``solver.method`` must be an explicit one."""
    cone_only: ClassVar[bool] = False
    """Whether the contacts must obey the law of the cone."""
    keeps_failures: ClassVar[bool] = False
    """Whether a combination of values that makes no valid scene becomes a failed point beside the others."""

    counts: ClassVar[str] = "points"
    """What its progress is counted in."""

    kind: str

    @abc.abstractmethod
    def plan(self, context: Context) -> Any:
        """What is to be computed, in numbers: a frozen dataclass.

        Raises:
            RuleError: the section does not fit the rest of the scene; the key is relative to the study.
        """

    def problems(self, model: Model) -> Iterator[RuleError]:
        """What is wrong with the study for a model, keys from the root of the scene; nothing by default."""
        yield from ()

    def varied(self) -> Mapping[Key, tuple[float, ...]]:
        """Scalars of the scene that the study varies, by their place in the section: under `over` and `along`."""
        parts = [part for part in ("over", "along") if part in type(self).model_fields]
        return {(part, key): values for part in parts for key, values in axes_of(getattr(self, part)).items()}

    def must_hold(self) -> Axes:
        """Values with which the scene has to be valid, by their key: those varied, and one between those along it."""
        return {
            str(key): values if part == "over" else (*values, values[0] + (values[-1] - values[0]) / np.e)
            for (part, key), values in self.varied().items()
        }

    def lowest_frequency(self) -> float | None:
        """Lowest frequency of its time integration [Hz]; None if it names none."""
        return None

    def extent(self) -> str:
        """How many steady states it computes, in words; empty if none."""
        return ""


class Settle(Section):
    """When a motion counts as settled."""

    tolerance: Annotated[Positive, Field(le=1e-2)] = 1e-8
    """Change of the state, relative to its largest entry, extrapolated over all cycles still to come."""
    max_cycles: Count = 2000
    """Excitation cycles from which on a point is given up as not settled: looked at every 8, and those that measure it
    come on top."""


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """Steady states over frequency and further axes.

    Attributes:
        frequency: [Hz], ascending, shape (F,).
        directions: up, down: the motion is carried from one frequency to the next; independent: each starts anew.
        refine: width [Hz] to which a jump between two frequencies is bisected; None does not bisect.
    """

    frequency: np.ndarray
    directions: tuple[str, ...]
    over: Axes
    criterion: Criterion
    refine: float | None

    @property
    def chained(self) -> bool:
        """Whether the motion is carried along."""
        return self.directions != ("independent",)

    @property
    def size(self) -> int:
        """Number of points."""
        return self.frequency.size * prod(map(len, self.over.values())) * len(self.directions)

    def work(self, model: Model) -> Work:
        """Roughly the cycles that it takes, by the decay of the slowest mode of the model."""
        mean = float(np.mean(self.frequency))
        cycles = self.size * cycles_to_settle(model, self.criterion, mean)
        return Work(((mean, cycles),), float(self.frequency[0]), sweep=True)


class SteadySection(StudySection):
    """A study of steady states by time integration."""

    settle: Settle = Settle()
    """When a motion counts as settled."""
    periodic: Literal["march", "shoot"] = "march"
    """How a periodic motion is sought: by marching, with Newton's method on the state after a period from cycle 256 on,
    or, with shoot, from cycle 16 on."""

    def criterion(self) -> Criterion:
        """When a motion counts as settled, in numbers."""
        return Criterion(self.settle.tolerance, self.settle.max_cycles, SHOOT if self.periodic == "shoot" else SLOW)

    def search(self) -> str:
        """What is searched for after the sweep, in words."""
        return ""

    @abc.abstractmethod
    def sweep(self) -> SweepPlan:
        """The sweep that is the study, or its first part, in numbers."""

    def lowest_frequency(self) -> float:
        return float(self.sweep().frequency[0])

    def extent(self) -> str:
        """Numbers of frequencies, values of the further axes and directions, and what is searched for after them."""
        plan = self.sweep()
        factors = [counted(plan.frequency.size, "frequency", "frequencies")]
        factors += [f"{counted(len(values), 'value')} of {key}" for key, values in plan.over.items()]
        if len(plan.directions) > 1:
            factors.append(f"{len(plan.directions)} directions")
        points = f"{' x '.join(factors)} = {counted(plan.size, 'point')}" if len(factors) > 1 else factors[0]
        return f"{points}{self.search()}"


class SweepSection(SteadySection):
    """The keys of a sweep, on its own or as a part of another study."""

    frequency: Frequencies
    """{from, to, step}, {from, to, num} or {values: [...]} [Hz]."""
    direction: Literal["up", "down", "both", "independent"] = "independent"
    """up, down, both: the state is carried from one frequency to the next; independent: each starts anew."""
    over: Over = Field(default_factory=dict)
    """Further axes: scalars of the scene by their key, each with its values."""
    refine: Positive | None = None
    """Width [Hz] to which the frequency of each jump of the sweep is bisected; by default jumps are not bisected."""

    @model_validator(mode="after")
    def _jumps_need_a_direction(self) -> Self:
        if self.refine is not None and self.direction == "independent":
            raise refuse("needs a direction", key=("refine",), hint="set direction to up, down or both")
        steps = np.diff(self.frequency.values())
        if self.refine is not None and len(steps) and self.refine > steps.min() * ROUNDED:
            raise refuse("must be at most the least step of frequency", key=("refine",), value=self.refine)
        return self

    def sweep(self) -> SweepPlan:
        directions = ("up", "down") if self.direction == "both" else (self.direction,)
        return SweepPlan(self.frequency.values(), directions, axes_of(self.over), self.criterion(), self.refine)

    def search(self) -> str:
        return "" if self.refine is None else ", and the search for jumps"
