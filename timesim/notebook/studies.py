"""The studies of a system as functions: a transient, a steady state, a sweep, a curve, a point again, pictures.

Each runs the scene that a file would describe. A scene file, `timesim.run` and these functions therefore share their
checks and their numerics, and give the same bits.
"""

from __future__ import annotations  # so that help() names the types as they are written here

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from timesim.fault import RuleError, warn
from timesim.notebook.parts import Section, array_of, given
from timesim.result.argument import mapping_of, path_of
from timesim.result.folder import made_folder
from timesim.result.label import is_scalar_key
from timesim.study.outcome import DOUBT
from timesim.study.point import point_again
from timesim.study.registry import draw, run

if TYPE_CHECKING:
    import xarray

SETTLED = ["direction", "frequency"]
"""Axes of a sweep that the one point of `settle` has none of."""


def _run(system: Section, study: Section, **more: Any) -> xarray.Dataset:
    """Run a study of a system."""
    rule = "what timesim.system returns (timesim.run runs a scene file)"
    whole = mapping_of("system", system, rule)
    for part in ("structure", "excitation"):
        if not isinstance(whole.get(part), Mapping):
            raise ValueError(f"system has no {part}, its keys are {', '.join(whole) or 'none'}: it must be {rule}")
    return run(whole | more | {"excitation": whole["excitation"] | more.get("excitation", {}), "study": study})


def integrate(
    system: Section,
    frequency: float,
    cycles: int,
    *,
    samples_per_cycle: int = 200,
    record_last: int | None = None,
    initial: str | Section = "rest",
) -> xarray.Dataset:
    """Integrate from a starting state through every transition, as a transient study does.

    Args:
        system: from `system`.
        frequency: of the excitation [Hz].
        cycles: of the excitation.
        samples_per_cycle: samples that are kept of a cycle.
        record_last: cycles of which samples are kept; all by default.
        initial: the section `initial` of a scene: "rest", "static", displacements and velocities of the modes, or
            ``{"from": "end.nc"}``, where a result ended that was saved by ``result.to_netcdf("end.nc")``.

    Returns:
        The variables of a transient's result file, `displacement` of shape (time, point, axis) among them.
    """
    source = initial.get("from") if isinstance(initial, Mapping) and not hasattr(initial, "to_netcdf") else initial
    if hasattr(source, "to_netcdf"):
        raise ValueError('initial is a result: save it, initial.to_netcdf("end.nc"), and give {"from": "end.nc"}')
    study = {"kind": "transient", "cycles": cycles, "samples_per_cycle": samples_per_cycle}
    study |= given(record_last=record_last)
    return _run(system, study, excitation={"frequency": frequency}, initial=initial)


def sweep(
    system: Section,
    frequency: ArrayLike,
    *,
    direction: str = "independent",
    over: Mapping[str, Sequence[float]] | None = None,
    periodic: str = "march",
    refine: float | None = None,
    tolerance: float = 1e-8,
    max_cycles: int = 2000,
) -> xarray.Dataset:
    """Steady states over frequency, by time integration until the motion settles.

    Args:
        system: from `system`.
        frequency: [Hz], shape (F,).
        direction: "independent", each from the start; "up", "down", "both": the motion is carried along.
        over: values of scalars of the scene by their key, ``{"contacts.pad.preload": [1, 2]}``, each a further axis.
        periodic: "march" until the motion repeats, or "shoot": Newton's method on the state after a period early.
        refine: width to which the frequency of each jump is bisected [Hz]; None: jumps are not looked for.
        tolerance: change of the state from cycle to cycle, relative, from which on it counts as settled.
        max_cycles: given to a point at most.

    Returns:
        The variables of a sweep's result file, `amplitude` of shape (..., direction, frequency, point, axis) among
        them; `settled` is 0 where a motion does not repeat.
    """
    study = {
        "kind": "sweep",
        "frequency": {"values": array_of("frequency", frequency, ("F",))},
        "direction": direction,
        "periodic": periodic,
        "settle": {"tolerance": tolerance, "max_cycles": max_cycles},
    }
    if over is not None:
        over = mapping_of("over", over, "a mapping of values by their key, {'contacts.pad.preload': [1, 2]}")
    return _run(system, study | given(over=over, refine=refine))


def settle(system: Section, frequency: float, *, tolerance: float = 1e-8, max_cycles: int = 2000) -> xarray.Dataset:
    """The steady state at one frequency [Hz], from the start of the system; arguments and variables as of `sweep`."""
    single = float(array_of("frequency", frequency, ()))
    result = sweep(system, [single], tolerance=tolerance, max_cycles=max_cycles)
    return result.isel(direction=0, frequency=0)


def follow(
    system: Section, start: float, stop: float, *, harmonics: int | str = "auto", time_samples: int | str = "auto"
) -> xarray.Dataset:
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
    return _run(system, study)


def show(path: str | Path, at: Mapping[str, float | str]) -> xarray.Dataset:
    """Compute the motion at a point of a sweep again, from the state saved in the result; see `timesim show`.

    Args:
        path: result file of a study with a sweep, or the folder of its run.
        at: the point, values along the axes of the sweep by name: ``{"frequency": 0.945, "direction": "up"}``.

    Returns:
        A period of the motion, ten cycles where it has none: the result of a transient.

    Raises:
        ValueError: the result has no such point, or more than one.
        StoreError: no such file, or not a result of timesim.
    """
    at = mapping_of("at", at, "a mapping of values by their axis, {'frequency': 0.945}")
    try:
        point = point_again(path, at)
    except RuleError as error:
        raise ValueError(f"{'.'.join(map(str, error.key)) or path}: {error.rule} ({error.hint})") from None
    for line in point.table:
        if line.startswith(DOUBT):
            warn(line.removeprefix(DOUBT))
    return point.motion


def plot(
    result: xarray.Dataset | xarray.DataTree,
    folder: str | Path,
    *,
    kind: str = "png",
    log: str | Collection[str] = (),
) -> list[Path]:
    """Draw the pictures of a result into a folder, creating it, and return the files; see `timesim plot`.

    Args:
        result: a result in memory.
        folder: created if it does not exist.
        kind: format of the files: png, pdf or svg.
        log: "amplitude", "frequency", or both: axes to be logarithmic.

    Raises:
        ValueError: what is given is no result, or a part of one, which names no study or lacks an axis.
        StoreError: the folder cannot be made, a file cannot be written, or the result lacks what a picture shows.
    """
    if "study" not in getattr(result, "attrs", ()):
        rule = "names no study: it must be a whole result, as a function of timesim or `timesim.open_result` returns it"
        raise ValueError(f"result is a {type(result).__name__} that {rule}")
    swept = result.attrs["study"] == "sweep"  # whose pictures need no axis of a scalar
    axes = (str(name) for name, axis in result.coords.items() if not axis.dims)
    single = [name for name in axes if not (swept and is_scalar_key(name))]
    if set(single) == set(SETTLED):
        result, single = result.expand_dims(SETTLED), []
    if single:
        one = f"{{{single[0]!r}: [...]}}" if is_scalar_key(single[0]) else f"{single[0]}=[...]"
        rule = f"keep it as an axis, by a list of one: result.sel({one})"
        raise ValueError(f"result has a single {' and a single '.join(single)}: {rule}")
    place = path_of("folder", folder, "the path of a folder, which is made if it does not exist")
    return draw(result, made_folder(place), kind=kind, log=[log] if isinstance(log, str) else log)
