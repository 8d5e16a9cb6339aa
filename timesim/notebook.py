"""Structures, contacts and forces from arrays, and the studies of them as functions, for notebooks and scripts.

    structure = timesim.modes([0.9, 1.1], 0.02, {"tip": [[1, 1, 0.8], [1, -1, 0.6]]})
    pad = timesim.contact("pad", "tip", friction=0.5, tangential_stiffness=20, normal_stiffness=20, preload=3)
    system = timesim.system(structure, [pad], timesim.modal_forces([1, 1]))
    result = timesim.integrate(system, 1.39, 60)

These functions build, as plain data, the scene that a file would describe. A scene file, `timesim.run` and these
functions therefore share their checks and their numerics, and give the same bits. Frequencies are in Hz, angles in
degrees, the rest in any consistent unit system. Each function raises ValueError where the shape of an argument is
wrong, and `timesim.SceneError` where a value is, naming its key, the value, what is allowed and what to do.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from timesim.fault import RuleError
from timesim.scene.resolution import check_parts
from timesim.study.point import point_again
from timesim.study.registry import draw, load_scene, run

if TYPE_CHECKING:
    import xarray

DRAWN = ("direction", "frequency", "point", "axis", "contact", "time", "cycle", "harmonic")
"""Axes of results that pictures need."""
Section = dict[str, Any]
"""A part of a scene with the keys of a scene file; it may be edited or written by hand."""


def _numbers(name: str, value: ArrayLike) -> np.ndarray:
    try:
        return np.asarray(value.toarray() if hasattr(value, "toarray") else value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number or an array of numbers, not {value!r}") from None


def _array(name: str, value: ArrayLike, shape: tuple[int | str, ...]) -> np.ndarray:
    """The argument as an array; a string in `shape` stands for any length."""
    array = _numbers(name, value)
    known = [(have, want) for have, want in zip(array.shape, shape, strict=False) if isinstance(want, int)]
    if array.ndim != len(shape) or any(have != want for have, want in known):
        wanted = ", ".join(map(str, shape))
        raise ValueError(f"{name} has shape {array.shape}, it must have ({wanted}): reshape or transpose it")
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
    frequency = _array("frequency", frequency, ("M",))
    count = len(frequency)
    rows = {point: _array(f"shapes[{point!r}]", shape, (count, 3)) for point, shape in shapes.items()}
    each = ({point: shape[i] for point, shape in rows.items()} for i in range(count))
    ratios, masses = _each("damping_ratio", damping_ratio, count), _each("mass", mass, count)
    keys = ("frequency", "damping_ratio", "mass", "shape")
    columns = zip(frequency.tolist(), ratios, masses, each, strict=True)
    return _checked("structure", {"modes": [dict(zip(keys, mode, strict=True)) for mode in columns]})


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
    size = len(_array("mass", mass, ("R", "R")))
    square = (size, size)
    inline: Section = {"mass": _array("mass", mass, square), "stiffness": _array("stiffness", stiffness, square)}
    if damping is not None:
        inline["damping"] = _array("damping", damping, square)
    inline["points"] = {point: dict(rows) for point, rows in points.items()}
    whole = {"matrices": inline | _given(damping_ratio=damping_ratio)} | _given(keep_modes=keep_modes)
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
    axis = None if tangent is None else _array("tangent", tangent, (3,))
    section = {
        "name": name,
        "point": point,
        "against": against,
        "normal": _array("normal", normal, (3,)),
        "friction": friction,
        "tangential_stiffness": stiffness,
        "normal_stiffness": normal_stiffness,
        "preload": preload,
    } | _given(tangent=axis)
    check_parts({"contacts": [section]})
    return section


def modal_forces(amplitude: ArrayLike, phase_deg: ArrayLike = 0.0) -> Section:
    """Harmonic forces on the modes, amplitude cos(2 pi f t + phase).

    Args:
        amplitude: of each mode in the order of the structure, shape (M,).
        phase_deg: phases [degrees], a number or one a mode, shape (M,).
    """
    size = _array("amplitude", amplitude, ("M",))
    phases = _each("phase_deg", phase_deg, len(size))
    pairs = zip(size, phases, strict=True)
    forces = [{"amplitude": value, "phase_deg": phase} for value, phase in pairs]
    return _checked("excitation", {"modal_force": forces})


def point_force(
    point: str, direction: ArrayLike, amplitude: float, *, phase_deg: float = 0.0, harmonic: int = 1
) -> Section:
    """A force on a point, amplitude cos(harmonic 2 pi f t + phase) along a direction of shape (3,); constant for 0."""
    force = {"point": point, "direction": _array("direction", direction, (3,)), "amplitude": amplitude}
    if harmonic == 0:
        pull = float(_array("amplitude", amplitude, ()) * np.cos(np.deg2rad(phase_deg)))
        return _checked("excitation", {"constant_forces": [force | {"amplitude": pull}]})
    return _checked("excitation", {"forces": [force | {"phase_deg": phase_deg, "harmonic": harmonic}]})


def system(
    structure: Section,
    contacts: Sequence[Section],
    excitation: Section | Sequence[Section],
    *,
    solver: Section | None = None,
) -> Section:
    """A structure with its contacts under its forces: a scene without a study, checked as one of a transient.

    Args:
        structure: from `modes` or `matrices`.
        contacts: from `contact`.
        excitation: from `modal_forces` or `point_force`, or several of these, which act together.
        solver: the section `solver` of a scene; ``{"accuracy": "standard"}`` by default.
    """
    if not isinstance(excitation, Mapping):
        kinds = dict.fromkeys(kind for part in excitation for kind in part)
        excitation = {kind: [force for part in excitation for force in part.get(kind, ())] for kind in kinds}
    whole = {"structure": structure, "contacts": list(contacts), "excitation": excitation} | _given(solver=solver)
    load_scene(
        whole | {"excitation": {"frequency": 1.0} | dict(excitation), "study": {"kind": "transient", "cycles": 1}}
    )
    return whole


def integrate(
    system: Section,
    frequency: float,
    cycles: int,
    *,
    samples_per_cycle: int = 200,
    record_last: int | None = None,
    initial: str | Section = "rest",
) -> "xarray.Dataset":
    """Integrate from a starting state through every transition, as a transient study does.

    Args:
        system: from `system`.
        frequency: of the excitation [Hz].
        cycles: of the excitation.
        samples_per_cycle: samples that are kept of a cycle.
        record_last: cycles of which samples are kept; all by default.
        initial: the section `initial` of a scene: "rest", "static", or displacements and velocities of the modes.

    Returns:
        The variables of a transient's result file, `displacement` of shape (time, point, axis) among them.
    """
    study = {"kind": "transient", "cycles": cycles, "samples_per_cycle": samples_per_cycle}
    driven = system["excitation"] | {"frequency": frequency}
    scene = system | {"excitation": driven, "initial": initial, "study": study | _given(record_last=record_last)}
    return run(scene)


def sweep(
    system: Section,
    frequency: ArrayLike,
    *,
    direction: str = "independent",
    over: Mapping[str, Sequence[float]] | None = None,
    tolerance: float = 1e-8,
    max_cycles: int = 2000,
) -> "xarray.Dataset":
    """Steady states over frequency, by time integration until the motion settles.

    Args:
        system: from `system`.
        frequency: [Hz], shape (F,).
        direction: "independent", each from the start; "up", "down", "both": the motion is carried along.
        over: values of scalars of the scene by their key, ``{"contacts.pad.preload": [1, 2]}``, each a further axis.
        tolerance: change of the state from cycle to cycle, relative, from which on it counts as settled.
        max_cycles: given to a point at most.

    Returns:
        The variables of a sweep's result file, `amplitude` of shape (..., direction, frequency, point, axis) among
        them; `settled` is 0 where a motion does not repeat.
    """
    study = {
        "kind": "sweep",
        "frequency": {"values": _array("frequency", frequency, ("F",))},
        "direction": direction,
        "settle": {"tolerance": tolerance, "max_cycles": max_cycles},
    }
    return run(system | {"study": study | _given(over=over and dict(over))})


def settle(system: Section, frequency: float, *, tolerance: float = 1e-8, max_cycles: int = 2000) -> "xarray.Dataset":
    """The steady state at one frequency [Hz], from the start of the system; arguments and variables as of `sweep`."""
    result = sweep(system, [frequency], tolerance=tolerance, max_cycles=max_cycles)
    return result.isel(direction=0, frequency=0)


def follow(
    system: Section, start: float, stop: float, *, harmonics: int | str = "auto", time_samples: int | str = "auto"
) -> "xarray.Dataset":
    """Follow periodic responses by harmonic balance from one frequency to another, through folds.

    Args:
        system: from `system`.
        start: frequency where the curve begins [Hz]; may be the larger one.
        stop: frequency where it ends [Hz].
        harmonics: of the displacement, above the mean, a number or auto.
        time_samples: of a period at which the contacts are evaluated, a number or auto.

    Returns:
        The variables of the result file of a harmonic balance, along `solution`, `amplitude` (solution, point, axis)
        and `stable` among them.
    """
    span = {"from": start, "to": stop}
    study = {"kind": "hbm", "frequency": span, "harmonics": harmonics, "time_samples": time_samples}
    return run(system | {"study": study})


def show(path: str | Path, at: Mapping[str, float | str]) -> "xarray.Dataset":
    """Compute the motion at a point of a sweep again, from the state saved in the result; see `timesim show`.

    Args:
        path: result file of a study with a sweep, or the folder of its run.
        at: the point, values along the axes of the sweep by name: ``{"frequency": 0.945, "direction": "up"}``.

    Returns:
        A period of the motion, ten cycles where it has none: the result of a transient.

    Raises:
        ValueError: the result has no such point, or more than one.
    """
    try:
        return point_again(path, at).motion
    except RuleError as error:
        raise ValueError(f"{'.'.join(map(str, error.key)) or path}: {error.rule} ({error.hint})") from None


def plot(
    result: "xarray.Dataset | xarray.DataTree", folder: str | Path, *, kind: str = "png", log: Collection[str] = ()
) -> list[Path]:
    """Draw the pictures of a result into a folder, creating it, and return the files; see `timesim plot`.

    Args:
        result: a result in memory.
        folder: created if it does not exist.
        kind: format of the files: png, pdf or svg.
        log: "amplitude", "frequency", or both: axes to be logarithmic.

    Raises:
        ValueError: what is given is no result, or a part of one, which names no study or lacks an axis.
    """
    if "study" not in getattr(result, "attrs", ()):
        rule = "it must be a whole result, as a function of timesim or `timesim.open_result` returns it"
        raise ValueError(f"result is a {type(result).__name__} that names no study: {rule}")
    if single := [name for name in DRAWN if name in result.coords and not result[name].dims]:
        rule = f"keep it as an axis, by a list of one: result.sel({single[0]}=[...])"
        raise ValueError(f"result has a single {' and a single '.join(single)}: {rule}")
    Path(folder).mkdir(parents=True, exist_ok=True)
    return draw(result, folder, kind=kind, log=log)


def _given(**options: Any) -> Section:
    """The options that are not None."""
    return {name: value for name, value in options.items() if value is not None}
