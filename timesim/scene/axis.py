"""Values along an axis: a list of them, a range, the two ends of a curve, the frequencies of a sweep."""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Self, cast

import numpy as np
from pydantic import Field, Tag, model_validator

from timesim.scene.section import Section, by_form, refuse
from timesim.scene.value import Number, Positive, Whole

MAX_POINTS = 10**6
"""Most points of one study along its own axes: a result of more would not fit into memory."""


class Ascending(Section):
    """Two values, the second one larger."""

    first: Number = Field(alias="from")
    """First value."""
    to: Number
    """Last value."""

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if self.to <= self.first:
            raise refuse("must be larger than from", key=("to",), value=self.to)
        return self


class Range(Ascending):
    """Equally spaced values, both ends included."""

    num: Annotated[Whole, Field(ge=2, le=10_000)]
    """How many."""

    def values(self) -> tuple[float, ...]:
        """The values, ascending."""
        return tuple(np.linspace(self.first, self.to, self.num).tolist())


class Span(Section):
    """Two values of a scalar: where a curve begins and where it ends."""

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
        """The two."""
        return self.first, self.to


Values = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Annotated[tuple[Number, ...], Field(min_length=1)], Tag("<list>")]
    | Annotated[Range, Tag("<mapping>")],
    by_form("a number, a list of numbers, or a mapping with from, to and num"),
]


def axis_values(given: float | Sequence[float] | Range | Span) -> tuple[float, ...]:
    """The values of an axis."""
    if isinstance(given, Range | Span):
        return given.values()
    return tuple(np.atleast_1d(np.asarray(given, dtype=float)).tolist())


def repeated(values: Sequence[float]) -> str:
    """The first value that is there more than once, in words; empty if all differ."""
    return next((f"{value:.10g} stands twice" for value, count in Counter(values).items() if count > 1), "")


def num_points(first: float, to: float, step: float) -> float:
    """How many of `first`, `first + step`, ... lie up to `to`, which is one of them if it is missed by 1e-9 step.

    A float, since the quotient of numbers far apart is infinite.
    """
    return float(np.floor((to - first) / step + 1e-9)) + 1


class Frequencies(Section):
    """Frequencies of a sweep: from + k step up to `to`, or a list."""

    first: Positive | None = Field(None, alias="from")
    """First frequency [Hz]."""
    to: Positive | None = None
    """Last frequency [Hz]; it is one of them if it lies within 1e-9 step of the grid."""
    step: Positive | None = None
    """Step [Hz]."""
    listed: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = Field(None, alias="values")
    """In place of from, to and step: the frequencies [Hz], in any order."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        parts = {"from": self.first, "to": self.to, "step": self.step}
        given = [key for key, value in parts.items() if value is not None]
        if self.listed is not None:
            if given:
                raise refuse("excludes values", key=(given[0],), hint="give from, to and step, or values")
            if twice := repeated(self.listed):
                raise refuse("must differ from each other", key=("values",), hint=twice)
            return self
        if missing := [key for key in parts if key not in given]:
            raise refuse("is required", key=(missing[0],), hint="from, to and step, or values")
        if (count := num_points(*self.spacing)) > MAX_POINTS:
            rule = f"must leave at most {MAX_POINTS} points, not {count:.10g}"
            raise refuse(rule, key=("step",), value=self.step)
        if count < 1:
            raise refuse("must not be smaller than from", key=("to",), value=self.to)
        return self

    @property
    def spacing(self) -> tuple[float, float, float]:
        """First, last and step, where the frequencies are not listed."""
        return cast(tuple[float, float, float], (self.first, self.to, self.step))

    def values(self) -> np.ndarray:
        """The frequencies [Hz], ascending, shape (F,)."""
        return np.sort(self.listed) if self.listed is not None else spaced(*self.spacing)


def spaced(first: float, to: float, step: float) -> np.ndarray:
    """`first`, `first + step`, ... up to `to`; see `num_points`."""
    return first + step * np.arange(int(num_points(first, to, step)))
