"""What the sections of a scene file are made of: kinds of value, and how a rule of one's own is stated."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, AllowInfNan, BaseModel, BeforeValidator, ConfigDict, Field, Strict
from pydantic_core import PydanticCustomError

from timesim.fault import Key
from timesim.model.model import GROUND


def refuse(rule: str, *, key: Key = (), hint: str = "", value: Any = None) -> PydanticCustomError:
    """An error of a validator; the key is relative to what is validated. Rule and hint hold no braces."""
    return PydanticCustomError("rule", "{rule}", {"rule": rule, "key": key, "hint": hint, "value": value})


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _name(text: str) -> str:
    if not text or text != text.strip() or set(".=") & set(text) or text == GROUND:
        rule = f"must be a name without . and = and outer spaces, other than {GROUND}"
        raise refuse(rule, hint="keys such as contacts.pad.preload are made of names")
    return text


def _direction(vector: tuple[float, ...]) -> tuple[float, ...]:
    if not any(vector):
        raise refuse("must not be the zero vector")
    return vector


Number = Annotated[float, Strict(), AllowInfNan(False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Whole = Annotated[int, Strict(), BeforeValidator(_whole), Field(le=10**9)]
Count = Annotated[Whole, Field(ge=1)]
Row = Annotated[Whole, Field(ge=0)]
Text = Annotated[str, Strict()]
Name = Annotated[str, Strict(), AfterValidator(_name)]
Pair = Annotated[tuple[Number, ...], Field(min_length=2, max_length=2)]
Vector = Annotated[tuple[Number, ...], Field(min_length=3, max_length=3)]
Direction = Annotated[Vector, AfterValidator(_direction)]
Matrix = Annotated[tuple[Annotated[tuple[Number, ...], Field(min_length=1)], ...], Field(min_length=1)]
Matrix2 = Annotated[tuple[Pair, ...], Field(min_length=2, max_length=2)]


class Section(BaseModel):
    """A mapping of the scene file: no other keys than these, and nothing changes once it is read."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=False, use_attribute_docstrings=True)


def unit(vector: Sequence[float]) -> np.ndarray:
    """The vector at length 1, however large or small its entries."""
    scaled = np.asarray(vector, dtype=np.float64) / np.max(np.abs(vector))
    return scaled / np.linalg.norm(scaled)
