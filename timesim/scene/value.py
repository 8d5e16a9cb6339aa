"""Kinds of value that the keys of a scene take: numbers within bounds, names, paths, matrices, values along an axis."""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any, Self, cast

import numpy as np
from pydantic import (
    AfterValidator,
    AllowInfNan,
    BeforeValidator,
    Field,
    PlainSerializer,
    SerializationInfo,
    Strict,
    ValidationInfo,
    model_validator,
)

from timesim.fault import nearest
from timesim.model.model import GROUND
from timesim.model.scales import LARGEST
from timesim.scene.section import AsList, AsMapping, AsNumber, Section, by_form, refuse

MAX_POINTS = 10**6
"""Most points of a study along its own axes: the result of more would not fit into memory."""


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _name(text: str) -> str:
    if not text or text != text.strip() or set(".=") & set(text) or text in (GROUND, "*"):
        rule = f"must be a name without . and = and outer spaces, other than {GROUND} and *"
        raise refuse(rule, hint="keys such as contacts.pad.preload consist of names")
    return text


def _direction(vector: tuple[float, ...]) -> tuple[float, ...]:
    if not any(vector):
        raise refuse("must not be the zero vector")
    return vector


def _rectangular(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if len({len(row) for row in rows}) > 1:
        raise refuse("must have rows of one length")
    return rows


def named(what: str, rule: str, *others: str) -> AfterValidator:
    """Refuses a name that the scene does not define; accepts any where the names of the scene cannot be read.

    Args:
        what: "points" or "contacts", a key of the context in which the scene is validated.
        rule: what the name must be.
        others: further names that are allowed.
    """

    def check(name: str, info: ValidationInfo) -> str:
        names = (info.context or {}).get(what)
        if names is not None and name not in (known := (*names, *others)):
            raise refuse(rule, hint=nearest(name, known))
        return name

    return AfterValidator(check)


def _from_root(path: str, info: SerializationInfo) -> str:
    folder = (info.context or {}).get("folder")
    return path if folder is None else str((folder / path).absolute())


Finite = Annotated[float, Strict(), AllowInfNan(False)]
Number = Annotated[Finite, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[Finite, Field(gt=0, le=LARGEST)]
NotNegative = Annotated[Finite, Field(ge=0, le=LARGEST)]
Whole = Annotated[int, Strict(), BeforeValidator(_whole), Field(le=10**9)]
Count = Annotated[Whole, Field(ge=1)]
Row = Annotated[Whole, Field(ge=0)]
Switch = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
Name = Annotated[str, Strict(), AfterValidator(_name)]
PointName = Annotated[Text, named("points", "must be a point of the structure")]
BodyName = Annotated[Text, named("points", "must be a point of the structure", GROUND)]
ContactName = Annotated[Text, named("contacts", "must be a contact")]
FilePath = Annotated[str, Strict(), PlainSerializer(_from_root)]
"""Path relative to the scene; dumped as an absolute path where the context of the dump names a `folder`."""
Pair = Annotated[tuple[Number, ...], Field(min_length=2, max_length=2)]
Vector = Annotated[tuple[Number, ...], Field(min_length=3, max_length=3)]
Direction = Annotated[tuple[Finite, ...], Field(min_length=3, max_length=3), AfterValidator(_direction)]
Matrix = Annotated[
    tuple[Annotated[tuple[Number, ...], Field(min_length=1)], ...], Field(min_length=1), AfterValidator(_rectangular)
]
Matrix2 = Annotated[tuple[Pair, ...], Field(min_length=2, max_length=2)]


def unit(vector: Sequence[float] | np.ndarray) -> np.ndarray:
    """The vector at length 1, however large or small its entries."""
    scaled = np.asarray(vector, dtype=np.float64) / np.max(np.abs(vector))
    return scaled / np.linalg.norm(scaled)


# Values along an axis


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
        return self.first, self.to


Values = Annotated[
    AsNumber[Number] | AsList[Annotated[tuple[Number, ...], Field(min_length=1)]] | AsMapping[Range],
    by_form("a number, a list of numbers, or a mapping with from, to and num"),
]


def axis_values(given: float | Sequence[float] | Range | Span) -> tuple[float, ...]:
    """The values of an axis."""
    if isinstance(given, Range | Span):
        return given.values()
    return tuple(np.atleast_1d(np.asarray(given, dtype=float)).tolist())


def repeated(values: Sequence[float]) -> str:
    """The first value that occurs more than once, in words; empty if all differ."""
    return next((f"{value:.10g} stands twice" for value, count in Counter(values).items() if count > 1), "")


def num_points(first: float, to: float, step: float) -> float:
    """How many of `first`, `first + step`, ... lie up to `to`, which counts if it lies within 1e-9 step of one.

    A float, since the quotient may be infinite.
    """
    return float(np.floor((to - first) / step + 1e-9)) + 1


WAYS = "from, to and step, or from, to and num, or values"
"""How frequencies may be given."""


class Frequencies(Section):
    """Frequencies of a sweep: from + k step up to `to`, or so many in equal steps, both ends included, or a list."""

    first: Positive | None = Field(None, alias="from")
    """First frequency [Hz]."""
    to: Positive | None = None
    """Last frequency [Hz]; it is one of them if it lies within 1e-9 step of the grid."""
    step: Positive | None = None
    """Step [Hz]."""
    num: Annotated[Whole, Field(ge=2, le=MAX_POINTS)] | None = None
    """How many, instead of a step."""
    listed: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = Field(None, alias="values")
    """The frequencies [Hz] in any order, instead of from, to and a step or a number."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ends, ways = {"from": self.first, "to": self.to}, {"step": self.step, "num": self.num}
        given = [key for key, value in (ends | ways).items() if value is not None]
        if self.listed is not None:
            if given:
                raise refuse("excludes values", key=(given[0],), hint=f"give {WAYS}")
            if twice := repeated(self.listed):
                raise refuse("must differ from each other", key=("values",), hint=twice)
            return self
        if missing := [key for key in ends if key not in given]:
            raise refuse("is required", key=(missing[0],), hint=WAYS)
        if None not in ways.values():
            raise refuse("excludes step", key=("num",), value=self.num, hint=f"give {WAYS}")
        if (key := next((key for key in ways if key in given), None)) is None:
            raise refuse("is required", key=("step",), hint=WAYS)
        self._check_spacing(key, ways[key])
        return self

    def _check_spacing(self, key: str, value: float | None) -> None:
        """That the ends ascend and the frequencies between them, by a step or a number, differ and are not too many."""
        first, to, step = self.spacing
        hint = "from is the smaller; direction: down visits it last"
        if self.num is not None and to <= first:
            raise refuse("must be larger than from", key=("to",), value=to, hint=hint)
        if (count := num_points(first, to, step)) > MAX_POINTS:
            raise refuse(f"must leave at most {MAX_POINTS} points, not {count:.10g}", key=(key,), value=value)
        if count < 1:
            raise refuse("must not be smaller than from", key=("to",), value=to, hint=hint)
        if twice := repeated(spaced(first, to, step).tolist()):
            rule = "must be larger" if self.num is None else "must leave steps larger"
            raise refuse(f"{rule} than the rounding of a frequency", key=(key,), value=value, hint=twice)

    @property
    def spacing(self) -> tuple[float, float, float]:
        """First, last and step, where the frequencies are not listed."""
        first, to = cast(tuple[float, float], (self.first, self.to))
        return first, to, (to - first) / (self.num - 1) if self.num is not None else cast(float, self.step)

    def values(self) -> np.ndarray:
        """The frequencies [Hz], ascending, shape (F,)."""
        return np.sort(self.listed) if self.listed is not None else spaced(*self.spacing)


def spaced(first: float, to: float, step: float) -> np.ndarray:
    """`first`, `first + step`, ... up to `to`; see `num_points`."""
    return first + step * np.arange(int(num_points(first, to, step)))
