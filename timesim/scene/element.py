"""Studies of one contact under prescribed motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from timesim.fault import FROM_SCENE, RuleError
from timesim.model.model import GROUND, Contact
from timesim.scene.contact import NEVER_CARRIES, ContactSection
from timesim.scene.section import AsMapping, AsText, Section, by_form, refuse
from timesim.scene.study import Context, StudySection
from timesim.scene.value import (
    MAX_POINTS,
    ContactName,
    Count,
    FilePath,
    NotNegative,
    Number,
    Switch,
    Text,
    Values,
    Whole,
    axis_values,
)

if TYPE_CHECKING:
    from timesim.element.motion import PrescribedMotion


class PointMotion(Section):
    """The motion of a point relative to another, over the last whole cycle of an earlier transient."""

    source: FilePath = Field(alias="from")
    """Path of its result.nc, relative to the scene."""
    point: Text
    """Point of body 1 in that result."""
    against: Text = GROUND
    """Point of body 2 in it, or ground."""


MotionSource = Annotated[
    AsText[FilePath] | AsMapping[PointMotion],
    by_form("the path of a .csv or .npz file, or a mapping with from, point and against"),
]


class ElementSection(StudySection):
    """A study of one contact alone: it needs no structure, no points and no excitation."""

    requires: ClassVar[tuple[str, ...]] = ()
    cone_only: ClassVar[bool] = True

    contact: ContactName | None = None
    """Name of the contact; may be left out where there is only one."""

    def chosen(self, context: Context) -> ContactSection:
        """The contact that is studied.

        Raises:
            RuleError: there is none, or the name is missing.
        """
        if not context.contacts:
            raise RuleError((), "needs a contact", "list one under contacts")
        if self.contact is None and len(context.contacts) > 1:
            names = ", ".join(item.name for item in context.contacts)
            raise RuleError(("contact",), "is required where there are several contacts", names)
        return next(item for item in context.contacts if self.contact in (None, item.name))


@dataclass(frozen=True, eq=False)
class ElementPlan:
    """A contact under the prescribed motion of body 1 relative to body 2, in its axes; the rest as in `Element`."""

    contact: Contact
    motion: "PrescribedMotion"
    harmonics: int
    principal_axes: bool
    samples: int
    cross_check: bool


class Element(ElementSection):
    """A contact under prescribed motion: u = [A sin θ, B sin(θ + φ)], v = D sin(θ + ψ), or one from a file."""

    uses_solver: ClassVar[bool] = False

    kind: Literal["element"]
    A: NotNegative | None = None
    """Amplitude along t1, 0 by default."""
    B: NotNegative | None = None
    """Amplitude along t2, 0 by default."""
    phi_deg: Number | None = None
    """Phase of the motion along t2, 0 by default."""
    D: NotNegative | None = None
    """Amplitude of the normal motion, 0 by default."""
    psi_deg: Number | None = None
    """Phase of the normal motion, 0 by default."""
    motion: MotionSource | None = None
    """In place of the amplitudes: a file with one cycle of u1, u2 and v, or two points of an earlier result."""
    harmonics: Annotated[Count, Field(le=1000)] = 1
    """Highest harmonic of the friction force that is kept."""
    principal_axes: Switch = False
    """Also give the coefficients along the principal axes of the ellipse."""
    samples: Annotated[Whole, Field(ge=36, le=10**6)] = 720
    """Angles of the cycle that are recorded."""
    cross_check: Switch = True
    """Compute it again by the event loop and compare."""

    @model_validator(mode="after")
    def _one_motion(self) -> Self:
        given = [key for key in ("A", "B", "phi_deg", "D", "psi_deg") if key in self.model_fields_set]
        if self.motion is not None and given:
            raise refuse("excludes motion", key=(given[0],), hint="give one of the two")
        if self.motion is None and not set(given) & {"A", "B", "D"}:
            raise refuse("must name A, B or D, or motion")
        return self if self.motion is not None else self.completed(A=0.0, B=0.0, phi_deg=0.0, D=0.0, psi_deg=0.0)

    def plan(self, context: Context) -> ElementPlan:
        contact = self.chosen(context).build()
        motion = self._motion(context, contact)
        return ElementPlan(contact, motion, self.harmonics, self.principal_axes, self.samples, self.cross_check)

    def _motion(self, context: Context, contact: Contact) -> "PrescribedMotion":
        if self.motion is None:
            from timesim.element.motion import HarmonicMotion

            sizes = (size or 0.0 for size in (self.A, self.B, self.D))
            return HarmonicMotion(*sizes, *(np.deg2rad(phase or 0.0) for phase in (self.phi_deg, self.psi_deg)))
        from timesim.result.file import StoreError
        from timesim.result.motion import read_motion, read_result_motion

        given = self.motion
        try:
            if isinstance(given, PointMotion):
                asked = (context.folder / given.source, given.point, given.against, contact.frame)
                motion = read_result_motion(*asked)
            else:
                motion = read_motion(context.folder / given)
        except (ValueError, StoreError) as error:
            raise RuleError(("motion",), str(error)) from None
        except OSError as error:
            missing = isinstance(error, FileNotFoundError)
            hint = f"does not exist, {FROM_SCENE}" if missing else error.strerror or str(error)
            raise RuleError(("motion",), "must be a file that can be read", hint, given) from None
        context.read.append(motion)
        return motion


# Maps

OF_CONTACT = ("friction", "normal_stiffness", "preload")
"""Parameters of a map that are those of the contact where the map does not give them."""
MAP_AXES = {key: key.lower() for key in ("A", "B", "D", "phi_deg", "psi_deg", *OF_CONTACT)}
"""Parameters over which a map may be computed, and their names in the result."""


@dataclass(frozen=True, eq=False)
class MapPlan:
    """A contact under all pairs of values of two parameters.

    Attributes:
        contact: the contact; `values` take precedence over its own numbers.
        values: of each parameter in `MAP_AXES`: one, or ascending values along an axis.
        axes: the two parameters that are axes.
    """

    contact: Contact
    values: Mapping[str, tuple[float, ...]]
    axes: tuple[str, str]


class ElementMap(ElementSection):
    """The Fourier coefficients of a contact over any two of its parameters, amplitudes A and B as a rule."""

    explicit_only: ClassVar[bool] = True

    kind: Literal["element_map"]
    A: Values = 0.0
    """Amplitude along t1: number, list, or {from, to, num}."""
    B: Values = 0.0
    """Amplitude along t2."""
    phi_deg: Values = 90.0
    """Phase of the motion along t2; 90: u = [a sin θ, b cos θ]."""
    D: Values = 0.0
    """Amplitude of the normal motion."""
    psi_deg: Values = 0.0
    """Phase of the normal motion."""
    friction: Values | None = None
    """In place of the contact's own."""
    normal_stiffness: Values | None = None
    """In place of the contact's own."""
    preload: Values | None = None
    """In place of the contact's own."""

    @model_validator(mode="after")
    def _two_axes(self) -> Self:
        given = self._given()
        axes = self._axes()
        if len(axes) != 2:
            hint = f"a list or a range for two of {', '.join(MAP_AXES)}"
            raise refuse(f"must have two axes, not {len(axes)}", hint=hint)
        for key, values in given.items():
            if key not in ("phi_deg", "psi_deg", "preload") and min(values) < 0:
                raise refuse("must not be negative", key=(key,), value=min(values))
        for key in axes:
            if np.any(np.diff(given[key]) <= 0):
                raise refuse("must ascend, each value once", key=(key,), value=given[key])
        if (count := len(given[axes[0]]) * len(given[axes[1]])) > MAX_POINTS:
            raise refuse(f"must have at most {MAX_POINTS} points, not {count}")
        return self

    def _given(self) -> dict[str, tuple[float, ...]]:
        """Values of the parameters that the map gives itself."""
        return {key: axis_values(getattr(self, key)) for key in MAP_AXES if getattr(self, key) is not None}

    def _axes(self) -> list[str]:
        return [key for key in MAP_AXES if not isinstance(getattr(self, key), float | None)]

    def plan(self, context: Context) -> MapPlan:
        """The contact and the values of the parameters; the bodies must be able to touch at every pair of them."""
        section, given = self.chosen(context), self._given()
        values = {key: (getattr(section, key),) for key in OF_CONTACT} | given
        if min(values["normal_stiffness"]) == 0 and (least := min(values["preload"])) <= 0:
            if "preload" in given:
                raise RuleError(("preload",), "must be > 0 where normal_stiffness is 0", NEVER_CARRIES, least)
            raise RuleError(("normal_stiffness",), f"must be > 0 where preload is {least:g}", NEVER_CARRIES, 0.0)
        if "friction" in given and not np.any(section.stiffness_matrix()):
            raise RuleError(("friction",), "needs a contact with a tangential stiffness")
        if "friction" in given and section.friction == 0:
            raise RuleError(("friction",), "needs a contact with friction", "set contacts' friction above 0")
        first, second = self._axes()
        return MapPlan(section.build(), values, (first, second))
