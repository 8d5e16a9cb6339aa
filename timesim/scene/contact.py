"""Section of the scene file that describes a contact."""

from collections.abc import Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Tag, model_validator

from timesim.fault import Key, RuleError, nearest
from timesim.model import model
from timesim.scene.section import (
    Direction,
    Matrix2,
    Name,
    NotNegative,
    Number,
    Pair,
    Section,
    Text,
    by_form,
    form,
    refuse,
    unit,
)


def point_row(name: str, points: Sequence[str], key: Key) -> int:
    """Index of a point by its name.

    Raises:
        RuleError: there is no such point.
    """
    if name not in points:
        raise RuleError(key, "must be a point of the structure", nearest(name, points), name)
    return points.index(name)


def _stiffness_form(value: Any) -> str | None:
    nested = form(value) == "<list>" and any(isinstance(row, list | tuple) for row in value)
    return "<matrix>" if nested else form(value)


TangentialStiffness = Annotated[
    Annotated[NotNegative, Tag("<number>")] | Annotated[Pair, Tag("<list>")] | Annotated[Matrix2, Tag("<matrix>")],
    by_form("a number, [k1, k2] or [[k11, k12], [k12, k22]]", _stiffness_form),
]


class ContactSection(Section):
    """A frictional contact between a point and the ground or another point."""

    name: Name
    """How results, messages and overrides call it."""
    point: Text | None = None
    """Point of body 1."""
    against: Text = model.GROUND
    """Point of body 2, or ground."""
    normal: Direction = (0.0, 0.0, 1.0)
    """Direction from body 1 into body 2; its length does not count."""
    tangent: Direction | None = None
    """First axis in the plane of contact; by default the coordinate axis least parallel to the normal."""
    friction: NotNegative
    """Coefficient of friction."""
    tangential_stiffness: TangentialStiffness
    """Number, [k1, k2] or [[k11, k12], [k12, k22]]; positive definite, or 0 together with friction 0."""
    normal_stiffness: NotNegative
    """0: the normal load stays at the preload."""
    preload: Number = 0.0
    """Normal load at rest; negative: a gap of -preload/normal_stiffness."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        self.frame()
        K = self.stiffness_matrix()
        if self.normal_stiffness == 0 and self.preload <= 0:
            rule = "must be > 0 where normal_stiffness is 0"
            raise refuse(rule, key=("preload",), hint="such a contact would never carry", value=self.preload)
        if not np.any(K) and self.friction > 0:
            hint = "for a frictionless stop set friction: 0"
            raise refuse("must be > 0 where friction is", key=("tangential_stiffness",), hint=hint, value=0)
        if np.any(K) and not (np.allclose(K, K.T, rtol=1e-12, atol=0) and np.linalg.eigvalsh(K)[0] > 0):
            value = self.tangential_stiffness
            raise refuse("must be symmetric positive definite", key=("tangential_stiffness",), value=value)
        return self

    def stiffness_matrix(self) -> np.ndarray:
        """K_u as it is written, shape (2, 2)."""
        K = np.asarray(self.tangential_stiffness, dtype=np.float64)
        return K if K.ndim == 2 else np.diag(np.broadcast_to(K, 2)).copy()

    def frame(self) -> np.ndarray:
        """Rows t1, t2, normal, with t2 = normal x t1, shape (3, 3)."""
        normal = unit(self.normal)
        axis = unit(self.tangent) if self.tangent is not None else np.eye(3)[np.argmin(np.abs(normal))]
        tangent = axis - (axis @ normal) * normal
        if np.linalg.norm(tangent) < 1e-6:
            raise refuse("must not be parallel to the normal", key=("tangent",), value=self.tangent)
        tangent = unit(tangent - (tangent @ normal) * normal)
        # Not np.cross: for one pair of vectors it takes longer than all else that a contact is checked for.
        second = normal[[1, 2, 0]] * tangent[[2, 0, 1]] - normal[[2, 0, 1]] * tangent[[1, 2, 0]]
        return np.stack([tangent, second, normal])

    def check_points(self, points: Sequence[str]) -> None:
        """Refuse a contact on no point, or of a point with itself."""
        if self.point is None:
            raise RuleError(("point",), "is required", f"points: {', '.join(points)}")
        point_row(self.point, points, ("point",))
        if self.against != model.GROUND:
            point_row(self.against, (*points, model.GROUND), ("against",))
        if self.against == self.point:
            raise RuleError(("against",), "must be another point than the contact's own", value=self.against)

    def build(self) -> model.Contact:
        """The contact in numbers; without friction K_u has no effect and is 0."""
        K = self.stiffness_matrix() * (self.friction > 0)
        K = (K + K.T) / 2
        load = (self.normal_stiffness, self.preload)
        return model.Contact(self.name, self.point or "", self.against, self.frame(), self.friction, K, *load)
