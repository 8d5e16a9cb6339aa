"""Studies of one contact under prescribed motion, as the scene file writes them."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Strict, Tag, model_validator

from timesim.fault import RuleError, nearest
from timesim.model import model
from timesim.scene.axis import Range, Values
from timesim.scene.contact import ContactSection
from timesim.scene.section import Count, Name, NotNegative, Number, Section, Text, Whole, refuse
from timesim.scene.study import StudyKind

if TYPE_CHECKING:
    from timesim.element.motion import Motion


class PointMotion(Section):
    """The motion of a point relative to another, over the last whole cycle of an earlier transient."""

    source: Text = Field(alias="from")
    """Path of its result.nc, relative to the scene."""
    point: Text
    """Point of body 1 in that result."""
    against: Text = model.GROUND
    """Point of body 2 in it, or ground."""

    def build(self, folder: Path, contact: ContactSection) -> "Motion":
        """The motion in the axes of the contact."""
        from timesim.result.motion import read_result_motion

        return read_result_motion(folder / self.source, self.point, self.against, contact.frame())

    def absolute(self, folder: Path) -> Self:
        """The same with a path that does not depend on the folder."""
        return self.model_copy(update={"source": str((folder / self.source).absolute())})


def _motion_kind(value: Any) -> str | None:
    return "<file>" if isinstance(value, str) else "<points>" if isinstance(value, dict | Section) else None


MotionSource = Annotated[
    Annotated[Text, Tag("<file>")] | Annotated[PointMotion, Tag("<points>")],
    Discriminator(
        _motion_kind,
        custom_error_type="rule",
        custom_error_message="must be the path of a .csv or .npz file, or a mapping with from, point and against",
    ),
]


class ElementKind(StudyKind):
    """A study of one contact alone: it needs no structure, no points and no excitation."""

    requires: ClassVar[tuple[str, ...]] = ()
    explicit_only: ClassVar[bool] = True

    contact: Name | None = None
    """Name of the contact; may be left out where there is only one."""

    def problems(self, contacts: Sequence[ContactSection], folder: Path) -> Iterator[RuleError]:
        """The contact is there."""
        names = [item.name for item in contacts]
        if not names:
            yield RuleError((), "needs a contact", "list one under contacts")
        elif self.contact is None and len(names) > 1:
            yield RuleError(("contact",), "is required where there are several contacts", f"{', '.join(names)}")
        elif self.contact is not None and self.contact not in names:
            yield RuleError(("contact",), "must be a contact", nearest(self.contact, names), self.contact)

    def chosen(self, contacts: Sequence[ContactSection]) -> ContactSection:
        """The contact it is about."""
        return next(item for item in contacts if self.contact in (None, item.name))


class Element(ElementKind):
    """A contact under prescribed motion: u = [A sin θ, B sin(θ + φ)], v = D sin(θ + ψ), or one from a file."""

    kind: Literal["element"]
    A: NotNegative = 0.0
    """Amplitude along t1."""
    B: NotNegative = 0.0
    """Amplitude along t2."""
    phi_deg: Number = 0.0
    """Phase of the motion along t2."""
    D: NotNegative = 0.0
    """Amplitude of the normal motion."""
    psi_deg: Number = 0.0
    """Phase of the normal motion."""
    motion: MotionSource | None = None
    """In place of the amplitudes: a file with one cycle of u1, u2 and v, or two points of an earlier result."""
    harmonics: Annotated[Count, Field(le=1000)] = 1
    """Highest harmonic of the friction force that is kept."""
    principal_axes: Annotated[bool, Strict()] = False
    """The coefficients along the principal axes of the ellipse too."""
    samples: Annotated[Whole, Field(ge=36, le=10**6)] = 720
    """Angles of the cycle that are recorded."""
    cross_check: Annotated[bool, Strict()] = True
    """Compute it again by the event loop and compare."""

    @model_validator(mode="after")
    def _one_motion(self) -> Self:
        given = [key for key in ("A", "B", "phi_deg", "D", "psi_deg") if key in self.model_fields_set]
        if self.motion is not None and given:
            raise refuse("excludes motion", key=(given[0],), hint="give one of the two")
        if self.motion is None and not set(given) & {"A", "B", "D"}:
            raise refuse("must name A, B or D, or motion")
        return self

    def build_motion(self, folder: Path, contact: ContactSection) -> "Motion":
        """The motion in numbers.

        Raises:
            RuleError: its file is not one cycle of a smooth motion.
        """
        from timesim.element.motion import HarmonicMotion

        if self.motion is None:
            return HarmonicMotion(self.A, self.B, self.D, np.deg2rad(self.phi_deg), np.deg2rad(self.psi_deg))
        from timesim.result.file import StoreError
        from timesim.result.motion import read_motion

        try:
            if isinstance(self.motion, PointMotion):
                return self.motion.build(folder, contact)
            return read_motion(folder / self.motion)
        except (ValueError, StoreError) as error:
            raise RuleError(("motion",), str(error)) from None
        except OSError as error:
            hint = error.strerror or str(error)
            raise RuleError(("motion",), "must be a file that can be read", hint, self.motion) from None

    def problems(self, contacts: Sequence[ContactSection], folder: Path) -> Iterator[RuleError]:
        """The contact and the motion are there."""
        found = list(super().problems(contacts, folder))
        if self.motion is not None and not found:
            try:
                self.build_motion(folder, self.chosen(contacts))
            except RuleError as error:
                found.append(error)
        yield from found

    def absolute(self, folder: Path) -> Self:
        """The same with the motion's path from the root."""
        if self.motion is None:
            return self
        here = self.motion
        moved = str((folder / here).absolute()) if isinstance(here, str) else here.absolute(folder)
        return self.model_copy(update={"motion": moved})


MAP_AXES = {
    "A": "a",
    "B": "b",
    "D": "d",
    "phi_deg": "phi_deg",
    "psi_deg": "psi_deg",
    "friction": "friction",
    "normal_stiffness": "normal_stiffness",
    "preload": "preload",
}
"""Parameters of a map that may be an axis, and the names of the axes in the result."""
MAX_MAP = 10**6


class ElementMap(ElementKind):
    """The Fourier coefficients of a contact over any two of its parameters, amplitudes A and B as a rule."""

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
        axes = self.axes()
        if len(axes) != 2:
            hint = f"a list or a range for two of {', '.join(MAP_AXES)}"
            raise refuse(f"must have two axes, not {len(axes)}", hint=hint)
        for key in ("A", "B", "D", "friction", "normal_stiffness"):
            if getattr(self, key) is not None and self.values(key).min() < 0:
                raise refuse("must not be negative", key=(key,), value=float(self.values(key).min()))
        for key, values in axes.items():
            if np.any(np.diff(values) <= 0):
                raise refuse("must ascend", key=(key,))
        if (count := np.prod([values.size for values in axes.values()])) > MAX_MAP:
            raise refuse(f"must have at most {MAX_MAP} points, not {count}")
        return self

    def values(self, key: str) -> np.ndarray:
        """Values of a parameter, shape (n,)."""
        given = getattr(self, key)
        return given.values() if isinstance(given, Range) else np.atleast_1d(np.asarray(given, float))

    def axes(self) -> dict[str, np.ndarray]:
        """The parameters that are axes, with their values."""
        kept = [key for key in MAP_AXES if not isinstance(getattr(self, key), float | None)]
        return {key: self.values(key) for key in kept}

    def problems(self, contacts: Sequence[ContactSection], folder: Path) -> Iterator[RuleError]:
        """The contact is there, and there could be contact for every value."""
        found = list(super().problems(contacts, folder))
        yield from found
        if found:
            return
        contact = self.chosen(contacts)
        least = {
            key: getattr(contact, key) if getattr(self, key) is None else self.values(key).min()
            for key in ("friction", "normal_stiffness", "preload")
        }
        if least["normal_stiffness"] == 0 and least["preload"] <= 0:
            key = "preload" if self.preload is not None else "normal_stiffness"
            yield RuleError((key,), "must be > 0 where the other of preload and normal_stiffness is not")
        if self.friction is not None and not np.any(contact.stiffness_matrix()):
            yield RuleError(("friction",), "needs a contact with a tangential stiffness")
        elif self.friction is not None and contact.friction == 0:
            yield RuleError(("friction",), "needs a contact with friction", "set contacts' friction above 0")
