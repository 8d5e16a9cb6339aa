"""Values along an axis of a study, as the scene file writes them: ranges, lists, frequencies, scalars of the scene."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from timesim.fault import nearest
from timesim.scene.section import Number, Positive, Section, Text, Whole, refuse

MAX_POINTS = 10**6


def repeated(values: Sequence[float]) -> str:
    """The first value that stands there again, in words; empty if all differ."""
    seen: set[float] = set()
    for value in values:
        if value in seen:
            return f"{value:.10g} stands twice"
        seen.add(value)
    return ""


class Range(Section):
    """Equally spaced values, both ends included."""

    first: Number = Field(alias="from")
    """First value."""
    to: Number
    """Last value."""
    num: Annotated[Whole, Field(ge=2, le=10_000)]
    """How many."""

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if self.to <= self.first:
            raise refuse("must be larger than from", key=("to",), value=self.to)
        return self

    def values(self) -> np.ndarray:
        """The values, shape (num,)."""
        return np.linspace(self.first, self.to, self.num)


def _values_kind(value: Any) -> str | None:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return "<number>"
    return "<list>" if isinstance(value, list | tuple) else "<range>" if isinstance(value, dict | Section) else None


Values = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Annotated[tuple[Number, ...], Field(min_length=1)], Tag("<list>")]
    | Annotated[Range, Tag("<range>")],
    Discriminator(
        _values_kind,
        custom_error_type="rule",
        custom_error_message="must be a number, a list of numbers, or a mapping with from, to and num",
    ),
]


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
        spaced = {"from": self.first, "to": self.to, "step": self.step}
        given = [key for key, value in spaced.items() if value is not None]
        if self.listed is not None:
            if given:
                raise refuse("excludes values", key=(given[0],), hint="give from, to and step, or values")
            if twice := repeated(self.listed):
                raise refuse("must differ from each other", key=("values",), hint=twice)
            return self
        if missing := [key for key in spaced if key not in given]:
            raise refuse("is required", key=(missing[0],), hint="from, to and step, or values")
        if self.count > MAX_POINTS:
            raise refuse(f"must have at most {MAX_POINTS} points, not {self.count}", key=("step",), value=self.step)
        if self.count < 1:
            raise refuse("must not be smaller than from", key=("to",), value=self.to)
        return self

    @property
    def count(self) -> int:
        """How many."""
        if self.listed is not None:
            return len(self.listed)
        assert self.first is not None
        assert self.to is not None
        assert self.step is not None
        return int(np.floor((self.to - self.first) / self.step + 1e-9)) + 1

    def values(self) -> np.ndarray:
        """The frequencies [Hz], ascending, shape (F,)."""
        if self.listed is not None:
            return np.sort(self.listed)
        assert self.first is not None
        assert self.step is not None
        return self.first + self.step * np.arange(self.count)


OVER_PARTS = ("structure", "contacts", "excitation", "initial")


def _scalars(over: Mapping[str, Any]) -> Mapping[str, Any]:
    for key, given in over.items():
        part = key.partition(".")[0]
        if part not in OVER_PARTS or key == part:
            raise refuse("must be the key of a scalar of the scene", key=(key,), hint=nearest(part, OVER_PARTS))
        if key == "excitation.frequency":
            raise refuse("is an axis of its own", key=(key,), hint="use the study's frequency")
        if twice := repeated(axis_values(given)):
            raise refuse("must differ from each other", key=(key,), hint=twice)
    return over


def axis_values(given: float | Sequence[float] | Range) -> tuple[float, ...]:
    """The values of an axis."""
    return tuple(map(float, given.values() if isinstance(given, Range) else np.atleast_1d(np.asarray(given, float))))


Over = Annotated[dict[Text, Values], AfterValidator(_scalars)]
"""Scalars of the scene by their key, each with its values."""
