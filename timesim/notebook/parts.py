"""Structures, contacts, forces and systems of them from arrays, as the sections of a scene.

Frequencies are in Hz, angles in degrees, the rest in any consistent unit system. Each function raises ValueError where
the type or the shape of an argument is wrong, and `timesim.SceneError` where a value is, naming its key, the value,
what is allowed and what to do.
"""

from __future__ import annotations  # so that help() names the types as they are written here

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from timesim.result.argument import list_of, mapping_of, shown
from timesim.scene.resolution import check_parts
from timesim.study.registry import load_scene

Section = dict[str, Any]
"""A part of a scene with the keys of a scene file; it may be edited or written by hand."""


REAL = {
    "amplitude": "give its magnitude, and its angle in degrees as phase_deg",
    "stiffness": "hysteretic damping has no equivalent in the time domain, give damping or damping_ratio",
}
"""What to give instead of complex values, by the argument."""


def _numbers(name: str, value: ArrayLike) -> np.ndarray:
    if np.ma.is_masked(value):
        raise ValueError(f"{name} is masked in part: give values for all of it, such as {name}.filled(0)")
    try:
        array = np.asarray(value.toarray() if hasattr(value, "toarray") else value)
        if not np.iscomplexobj(array):
            if array.dtype.kind in "bSUmM":
                raise TypeError
            return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be a number or an array of numbers, not {shown(value)}") from None
    instead = REAL.get(name, "take the real part, if the imaginary part is rounding")
    raise ValueError(f"{name} must be of real numbers, not {array.dtype}: {instead}")


def array_of(name: str, value: ArrayLike, shape: tuple[int | str, ...]) -> np.ndarray:
    """The argument as an array; a string in `shape` stands for any length."""
    array = _numbers(name, value)
    known = [(have, want) for have, want in zip(array.shape, shape, strict=False) if isinstance(want, int)]
    if array.ndim != len(shape) or any(have != want for have, want in known):
        sizes = f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
        hint = "reshape or transpose it" if array.ndim else f"give a list, such as [{array:g}]"
        wanted = f"have {sizes}: {hint}" if shape else "be a single number"
        raise ValueError(f"{name} has shape {array.shape}, it must {wanted}")
    return array


def _each(name: str, value: ArrayLike, count: int) -> list[float]:
    """One number for each mode, given as one number for all or one for each."""
    array = _numbers(name, value)
    if array.shape not in {(), (count,)}:
        raise ValueError(f"{name} has shape {array.shape}, it must be a number or one a mode, shape ({count},)")
    return [float(item) for item in np.broadcast_to(array, count)]


def _checked(part: str, section: Section) -> Section:
    """The section itself, after the checks that need no other; they raise `timesim.SceneError`."""
    check_parts({part: section})
    return section


def modes(
    frequency: ArrayLike, damping_ratio: ArrayLike, shapes: Mapping[str, ArrayLike], *, mass: ArrayLike = 1.0
) -> Section:
    """A structure by its modes.

    Args:
        frequency: natural frequencies [Hz], shape (M,).
        damping_ratio: share of critical damping, a number or one a mode, shape (M,).
        shapes: displacement along x, y, z of each point for a unit of each mode, shape (M, 3) by name.
        mass: modal masses, a number or one a mode, shape (M,).
    """
    frequency = array_of("frequency", frequency, ("M",))
    count = len(frequency)
    by_point = mapping_of("shapes", shapes, "a mapping of points, {'tip': [[1, 0, 0]]}")
    rows = {point: array_of(f"shapes[{point!r}]", shape, (count, 3)) for point, shape in by_point.items()}
    columns = {
        "frequency": frequency.tolist(),
        "damping_ratio": _each("damping_ratio", damping_ratio, count),
        "mass": _each("mass", mass, count),
        "shape": [{point: shape[i] for point, shape in rows.items()} for i in range(count)],
    }
    return _checked("structure", {"modes": [{key: part[i] for key, part in columns.items()} for i in range(count)]})


def matrices(
    mass: ArrayLike,
    stiffness: ArrayLike,
    points: Mapping[str, Mapping[str, int]],
    *,
    damping: ArrayLike | None = None,
    damping_ratio: float | Sequence[float] | None = None,
    keep_modes: int | None = None,
) -> Section:
    """A structure by its matrices, whose modes are computed.

    Args:
        mass, stiffness: symmetric, shape (R, R), dense or sparse.
        points: row of each axis ("x", "y", "z") along which a point moves, from 0, by name.
        damping: viscous damping matrix, shape (R, R).
        damping_ratio: share of critical damping instead of a matrix, a number or one for each mode kept.
        keep_modes: how many of the lowest modes are kept; all by default.
    """
    square = (len(array_of("mass", mass, ("R", "R"))),) * 2
    inline: Section = {"mass": array_of("mass", mass, square), "stiffness": array_of("stiffness", stiffness, square)}
    if damping is not None:
        inline["damping"] = array_of("damping", damping, square)
    rule = "a mapping of rows by their axis, {'x': 0}"
    by_point = mapping_of("points", points, "a mapping of points, {'tip': {'x': 0}}")
    inline["points"] = {point: mapping_of(f"points[{point!r}]", rows, rule) for point, rows in by_point.items()}
    whole = {"matrices": inline | given(damping_ratio=damping_ratio)} | given(keep_modes=keep_modes)
    return _checked("structure", whole)


def contact(
    name: str,
    point: str,
    *,
    friction: float,
    tangential_stiffness: ArrayLike,
    normal_stiffness: float,
    preload: float = 0.0,
    against: str = "ground",
    normal: ArrayLike = (0.0, 0.0, 1.0),
    tangent: ArrayLike | None = None,
) -> Section:
    """A contact with friction between a point of the structure and the ground or another point.

    Args:
        name: how results name it.
        point: its point of body 1.
        friction: coefficient of friction.
        tangential_stiffness: a number, two, or a matrix of shape (2, 2) [force/length].
        normal_stiffness: [force/length]; 0: the normal load stays at the preload.
        preload: normal load at rest [force]; negative: a gap of -preload/normal_stiffness.
        against: the point of body 2.
        normal: direction from body 1 into body 2, shape (3,).
        tangent: first axis of the plane of contact, shape (3,); by default the coordinate axis least parallel to the
            normal.
    """
    stiffness = _numbers("tangential_stiffness", tangential_stiffness)
    if stiffness.shape not in {(), (2,), (2, 2)}:
        rule = "it must be a number, two, or a matrix of shape (2, 2)"
        raise ValueError(f"tangential_stiffness has shape {stiffness.shape}, {rule}")
    axis = None if tangent is None else array_of("tangent", tangent, (3,))
    section = {
        "name": name,
        "point": point,
        "against": against,
        "normal": array_of("normal", normal, (3,)),
        "friction": friction,
        "tangential_stiffness": stiffness,
        "normal_stiffness": normal_stiffness,
        "preload": preload,
    } | given(tangent=axis)
    check_parts({"contacts": [section]})
    return section


def modal_forces(amplitude: ArrayLike, phase_deg: ArrayLike = 0.0) -> Section:
    """Harmonic forces on the modes, amplitude cos(2 pi f t + phase).

    Args:
        amplitude: of each mode in the order of the structure, shape (M,).
        phase_deg: phases [degrees], a number or one a mode, shape (M,).
    """
    size = array_of("amplitude", amplitude, ("M",))
    pairs = zip(size, _each("phase_deg", phase_deg, len(size)), strict=True)
    return _checked("excitation", {"modal_force": [{"amplitude": value, "phase_deg": phase} for value, phase in pairs]})


def point_force(
    point: str, direction: ArrayLike, amplitude: float, *, phase_deg: float = 0.0, harmonic: int = 1
) -> Section:
    """A force on a point, amplitude cos(harmonic 2 pi f t + phase) along a direction of shape (3,); constant for 0."""
    size = array_of("amplitude", amplitude, ())
    force = {"point": point, "direction": array_of("direction", direction, (3,)), "amplitude": amplitude}
    if array_of("harmonic", harmonic, ()) != 0:
        return _checked("excitation", {"forces": [force | {"phase_deg": phase_deg, "harmonic": harmonic}]})
    check_parts({"excitation": {"forces": [force | {"phase_deg": phase_deg}]}})
    pull = float(size * np.cos(np.deg2rad(phase_deg)))
    return _checked("excitation", {"constant_forces": [force | {"amplitude": pull}]})


def system(
    structure: Section,
    contacts: Sequence[Section],
    excitation: Section | Sequence[Section],
    *,
    solver: Section | None = None,
) -> Section:
    """A structure with its contacts under its forces: a scene without a study, checked as one of a transient.

    It is a mapping with the sections of a scene: ``system["units"] = {"length": "mm", "force": "N"}`` names the units
    in results and pictures.

    Args:
        structure: from `modes` or `matrices`.
        contacts: from `contact`.
        excitation: from `modal_forces` or `point_force`, or several of these, which act together;
            of `modal_forces` one.
        solver: the section `solver` of a scene; ``{"accuracy": "standard"}`` by default.

    Raises:
        ValueError: contacts are no list, the excitation is no force and no list, or has several `modal_forces`.
    """
    pads = list_of("contacts", contacts, "a list, of one contact too: [timesim.contact(...)], or [] without contacts")
    if not isinstance(excitation, Mapping):
        rule = "from timesim.modal_forces or timesim.point_force"
        listed = enumerate(list_of("excitation", excitation, f"{rule}, or a list of these, [] without forces"))
        parts = [mapping_of(f"excitation[{i}]", part, rule) for i, part in listed]
        if sum("modal_force" in part for part in parts) > 1:
            raise ValueError(
                "excitation has several modal_forces: give one, its amplitudes and phases those of the sum"
            )
        kinds = dict.fromkeys(kind for part in parts for kind in part)
        excitation = {kind: [force for part in parts for force in part.get(kind, ())] for kind in kinds}
    whole = {"structure": structure, "contacts": pads, "excitation": excitation} | given(solver=solver)
    transient = {"excitation": {"frequency": 1.0} | dict(excitation), "study": {"kind": "transient", "cycles": 1}}
    load_scene(whole | transient)
    return whole


def given(**options: Any) -> Section:
    """The options that are not None."""
    return {name: value for name, value in options.items() if value is not None}
