"""The base class of the sections of a scene file, unions resolved by the form of a value, and refusals."""

from collections.abc import Callable
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Tag
from pydantic_core import PydanticCustomError

from timesim.fault import Key

T = TypeVar("T")
AsNumber = Annotated[T, Tag("<number>")]
AsText = Annotated[T, Tag("<text>")]
AsList = Annotated[T, Tag("<list>")]
AsMapping = Annotated[T, Tag("<mapping>")]
"""Members of a union that `by_form` chooses from."""


def refuse(rule: str, *, key: Key = (), hint: str = "", value: Any = None) -> PydanticCustomError:
    """An error for a validator to raise; the key is relative to what is validated. Rule and hint hold no braces."""
    return PydanticCustomError("rule", "{rule}", {"rule": rule, "key": key, "hint": hint, "value": value})


class Section(BaseModel):
    """A mapping of the scene file: no other keys are allowed, and it does not change once it is read."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=False, use_attribute_docstrings=True)

    def completed(self, **defaults: Any) -> Self:
        """The same with defaults, which depend on other keys, for keys that were left out."""
        missing = {key: value for key, value in defaults.items() if getattr(self, key) is None}
        return self.model_copy(update=missing) if missing else self


def form(value: Any) -> str | None:
    """The form in which a value is written, as the tag of a member of a union."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return "<number>"
    if isinstance(value, str):
        return "<text>"
    if isinstance(value, list | tuple):
        return "<list>"
    return "<mapping>" if isinstance(value, dict | Section) else None


def by_form(allowed: str, kind: Callable[[Any], str | None] = form) -> Discriminator:
    """Chooses the member of a union by the form of the value; ``allowed`` says in words what it must be."""
    return Discriminator(kind, custom_error_type="rule", custom_error_message=f"must be {allowed}")


AutoOr = Annotated[AsText[Literal["auto"]] | AsNumber[T], by_form("auto or a whole number")]
