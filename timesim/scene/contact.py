"""Section of the scene file that describes a contact."""

from collections.abc import Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, Tag, ValidationInfo, model_validator

from timesim.engine.law.table import LAWS
from timesim.fault import meant, nearest
from timesim.model.model import CONE, GROUND, Contact
from timesim.scene.section import AsList, AsNumber, Section, by_form, form, refuse
from timesim.scene.value import BodyName, Direction, Matrix2, Name, NotNegative, Number, Pair, PointName, Text, unit


def _required(point: str | None, info: ValidationInfo) -> str | None:
    if point is None and (points := (info.context or {}).get("points")) is not None:
        raise refuse("is required", hint=f"points: {', '.join(points)}")
    return point


# Rules between keys of a contact, each at the later one, so that they are listed with all else that is wrong with it.
# `info.data` has the keys before it that are good.


def _other_point(against: str, info: ValidationInfo) -> str:
    if against == info.data.get("point"):
        raise refuse("must be another point than the contact's own")
    return against


def _across(tangent: Sequence[float] | None, info: ValidationInfo) -> Sequence[float] | None:
    normal = info.data.get("normal")
    if tangent is not None and normal is not None and np.linalg.norm(_in_plane(unit(tangent), unit(normal))) < PARALLEL:
        raise refuse("must not be parallel to the normal")
    return tangent


def _definite(stiffness: Any, info: ValidationInfo) -> Any:
    (k11, k12), (k21, k22) = _matrix(stiffness).tolist()
    none = k11 == k12 == k21 == k22 == 0
    if none and info.data.get("friction", 0.0) > 0:
        raise refuse("must be > 0 where friction is", hint="for a frictionless stop set friction: 0", value=0)
    least = min(k11, k22) if k12 == k21 == 0 else np.linalg.eigvalsh([[k11, k12], [k12, k22]])[0]
    if not none and not (abs(k12 - k21) <= 1e-12 * abs(k21) and least > 0):
        raise refuse("must be symmetric positive definite", value=stiffness)
    return stiffness


def _carries(preload: float, info: ValidationInfo) -> float:
    if info.data.get("normal_stiffness") == 0 and preload <= 0:
        raise refuse("must be > 0 where normal_stiffness is 0", hint=NEVER_CARRIES, value=preload)
    return preload


NEVER_CARRIES = "such a contact would never carry; a gap needs a normal_stiffness above 0"
"""Hint where the bodies of a contact neither press on each other at rest nor can come to do so."""

PARALLEL = 1e-6
"""Sine of the angle to the normal below which a direction counts as parallel to it."""


def _in_plane(direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The part of a direction that is perpendicular to a unit normal."""
    return direction - (direction @ normal) * normal


def _matrix(stiffness: Any) -> np.ndarray:
    K = np.asarray(stiffness, dtype=np.float64)
    return K if K.ndim == 2 else np.diag(np.broadcast_to(K, 2)).copy()


def _stiffness_form(value: Any) -> str | None:
    nested = form(value) == "<list>" and any(isinstance(row, list | tuple) for row in value)
    return "<matrix>" if nested else form(value)


TangentialStiffness = Annotated[
    AsNumber[NotNegative] | AsList[Pair] | Annotated[Matrix2, Tag("<matrix>")],
    by_form("a number, [k1, k2] or [[k11, k12], [k12, k22]]", _stiffness_form),
    AfterValidator(_definite),
]


class LawSection(Section):
    """A contact law by its name, with the parameters that it has in addition to those of every contact."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Number]

    name: Text
    """One of `timesim.engine.law.table.LAWS`."""

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.name not in LAWS:
            hint = meant(self.name, LAWS)
            raise refuse(f"must be one of {', '.join(LAWS)}", key=("name",), hint=hint, value=self.name)
        known = LAWS[self.name].parameters
        for key in self.__pydantic_extra__:
            if key not in known:
                raise refuse(f"is no parameter of the law {self.name}", key=(key,), hint=nearest(key, known))
        if missing := [key for key in known if key not in self.__pydantic_extra__]:
            raise refuse(f"is required for the law {self.name}", key=(missing[0],))
        return self


Law = Annotated[
    LawSection,
    BeforeValidator(
        lambda given: {"name": given} if isinstance(given, str) else given, json_schema_input_type=str | LawSection
    ),
    AfterValidator(lambda law: None if law.name == CONE else law),
]
"""By its name alone where it has no parameters; None for the law of the cone."""


class ContactSection(Section):
    """A frictional contact between a point and the ground or another point."""

    name: Name
    """Its name in results, messages and overrides."""
    point: Annotated[PointName | None, AfterValidator(_required), Field(validate_default=True)] = None
    """Point of body 1; a scene without a structure needs none."""
    against: Annotated[BodyName, AfterValidator(_other_point)] = GROUND
    """Point of body 2, or ground."""
    normal: Direction = (0.0, 0.0, 1.0)
    """Direction from body 1 into body 2 along x, y, z, such as [0, 0, 1]; its length does not count."""
    tangent: Annotated[Direction | None, AfterValidator(_across)] = None
    """First axis in the plane of contact; by default the coordinate axis least parallel to the normal."""
    friction: NotNegative
    """Coefficient of friction."""
    tangential_stiffness: TangentialStiffness
    """Number, [k1, k2] or [[k11, k12], [k12, k22]]; positive definite, or 0 together with friction 0."""
    normal_stiffness: NotNegative
    """0: the normal load stays at the preload."""
    preload: Annotated[Number, AfterValidator(_carries), Field(validate_default=True)] = 0.0
    """Normal load at rest; negative: a gap of -preload/normal_stiffness."""
    law: Law | None = None
    """The contact law by its name, or {name: ..., with its own parameters}; by default the friction cone."""

    def stiffness_matrix(self) -> np.ndarray:
        """K_u as it is written, shape (2, 2)."""
        return _matrix(self.tangential_stiffness)

    def frame(self) -> np.ndarray:
        """Rows t1, t2, normal, with t2 = normal x t1, shape (3, 3)."""
        normal = unit(self.normal)
        axis = unit(self.tangent) if self.tangent is not None else np.eye(3)[np.argmin(np.abs(normal))]
        tangent = unit(_in_plane(_in_plane(axis, normal), normal))  # once more, for what rounding has left
        # For one pair of vectors np.cross takes longer than all other checks of a contact together.
        second = normal[[1, 2, 0]] * tangent[[2, 0, 1]] - normal[[2, 0, 1]] * tangent[[1, 2, 0]]
        return np.stack([tangent, second, normal])

    @property
    def law_name(self) -> str:
        """Name of the law that it obeys."""
        return CONE if self.law is None else self.law.name

    @property
    def idle_stiffness(self) -> bool:
        """Whether K_u has no effect, as under the cone law without friction."""
        return self.law is None and self.friction == 0

    def build(self) -> Contact:
        """The contact in numbers; a K_u that has no effect is set to 0."""
        K = self.stiffness_matrix() * (not self.idle_stiffness)
        return Contact(
            name=self.name,
            point=self.point or "",
            against=self.against,
            frame=self.frame(),
            friction=self.friction,
            tangential_stiffness=(K + K.T) / 2,
            normal_stiffness=self.normal_stiffness,
            preload=self.preload,
            law=self.law_name,
            law_parameters={} if self.law is None else dict(self.law.__pydantic_extra__),
        )


def _together(contacts: tuple[ContactSection, ...]) -> tuple[ContactSection, ...]:
    for i, contact in enumerate(contacts):
        if contact.name in (other.name for other in contacts[:i]):
            raise refuse("must differ from the other contacts'", key=(i, "name"), value=contact.name)
        if contact.law_name != contacts[0].law_name:
            rule = f"must be the same for all contacts, that of {contacts[0].name} is {contacts[0].law_name}"
            raise refuse(rule, key=(i, "law"), value=contact.law_name)
    return contacts


Contacts = Annotated[tuple[ContactSection, ...], AfterValidator(_together)]
