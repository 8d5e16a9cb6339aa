"""Kinds of value that the keys of a scene take: numbers within bounds, names, paths, vectors and matrices."""

from collections.abc import Sequence
from typing import Annotated, Any

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
)

from timesim.fault import nearest
from timesim.model.model import GROUND
from timesim.model.scales import LARGEST
from timesim.scene.section import refuse


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _name(text: str) -> str:
    if not text or text != text.strip() or set(".=") & set(text) or text == GROUND:
        rule = f"must be a name without . and = and outer spaces, other than {GROUND}"
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
    """Refuses a name that the scene does not give; where its names cannot be read, any is let through.

    Args:
        what: of what it is a name, "points" or "contacts": a key of the context in which the scene is validated.
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
"""Path relative to the scene; written from the root where the context of the dump names a `folder`."""
Pair = Annotated[tuple[Number, ...], Field(min_length=2, max_length=2)]
Vector = Annotated[tuple[Number, ...], Field(min_length=3, max_length=3)]
Direction = Annotated[tuple[Finite, ...], Field(min_length=3, max_length=3), AfterValidator(_direction)]
Matrix = Annotated[
    tuple[Annotated[tuple[Number, ...], Field(min_length=1)], ...], Field(min_length=1), AfterValidator(_rectangular)
]
Matrix2 = Annotated[tuple[Pair, ...], Field(min_length=2, max_length=2)]


def unit(vector: Sequence[float]) -> np.ndarray:
    """The vector at length 1, however large or small its entries."""
    scaled = np.asarray(vector, dtype=np.float64) / np.max(np.abs(vector))
    return scaled / np.linalg.norm(scaled)
