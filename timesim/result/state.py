"""States that results hold: the end of a run, or the end of a cycle at each point of a sweep."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from timesim.fault import FROM_SCENE, RuleError, nearest
from timesim.model.mode_shapes import ModeShapes
from timesim.model.model import Model, Start
from timesim.model.start import resumed_start
from timesim.orbit.steady_state import switches
from timesim.result.coordinate import BODIES, NAMES
from timesim.result.label import axis_value
from timesim.result.netcdf import result_file

if TYPE_CHECKING:
    from xarray import Dataset

FINAL = {
    "modal_displacement": ("mode",),
    "modal_velocity": ("mode",),
    "slip": ("contact", "tangent"),
    "contact_state": ("contact",),
}
STATE = tuple(FINAL)
"""Parts of a state, with their dimensions."""
SHAPE, FRAME = "mode_shape", "contact_frame"
DRIFT = "drift"
GEOMETRY = {SHAPE: ("point", "axis", "mode"), FRAME: ("contact", "component", "axis"), DRIFT: ("point", "axis")}
"""What tells how coordinates and slips move the points, with its dimensions; results of earlier versions lack some."""
POINT = ("amplitude", "settled", "period", "slip_share", "separation_share", "failure")
LISTED = 12  # values, or points, that a message names
SAME = 1e-9  # share of a value by which one that is asked for may differ from one on the axis
ROUNDING = 4 * np.finfo(float).eps  # share of the largest value on an axis that may be left of a zero


@dataclass(frozen=True)
class SavedStates:
    """States that a result holds, from which a motion may start.

    Attributes:
        contacts: their names.
        arrays: `final_...` of every state, those of `GEOMETRY` unless the result is of an earlier version, and of a
            sweep `POINT` as well, the axes of the sweep first.
        axes: the values along these axes; empty for a single run.
        phase: of the excitation, the same in all these states [rad].
        points: of the structure, at which the shapes of the modes are known.
        bodies: what each contact joins, empty where a result of an earlier version does not say.
        units: names of the units of "length" and "force", where the result says them.
        reason: why the run ended early, empty if it did not.
    """

    contacts: tuple[str, ...]
    arrays: Mapping[str, np.ndarray]
    axes: Mapping[str, np.ndarray]
    phase: float
    points: tuple[str, ...] = ()
    bodies: tuple[tuple[str, str], ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    reason: str = ""

    def at(self, place: tuple[int, ...]) -> dict[str, np.ndarray]:
        """The arrays of one of the states."""
        return {name: array[place] for name, array in self.arrays.items()}

    def places(self, asked: Mapping[str, float | str]) -> dict[str, Sequence[int]]:
        """Positions along each axis: one where a value is asked for, else all.

        Raises:
            RuleError: no such axis, or no such value along it; the key is the name of the axis.
        """
        for name, value in asked.items():
            if name not in self.axes:
                hint = nearest(name, list(self.axes)) if self.axes else "the result is that of one run, not a sweep"
                raise RuleError((name,), "is no axis of the result", hint, value)
        return {
            name: (_position(name, values, asked[name]),) if name in asked else range(len(values))
            for name, values in self.axes.items()
        }

    def one(self, asked: Mapping[str, float | str]) -> dict[str, np.ndarray]:
        """The arrays of the state that is asked for.

        Raises:
            RuleError: no state fits, or more than one does; then the key is the first axis without a value.
        """
        places = self.places(asked)
        for name, positions in places.items():
            if len(positions) > 1:
                raise RuleError((name,), f"must name the {name} of a point of the sweep", self._matches(places))
        arrays = self.at(tuple(positions[0] for positions in places.values()))
        if reason := str(arrays.get("failure", "")):
            raise RuleError((), f"names a point that could not be computed: {reason}", "take another")
        if not np.isfinite(arrays.get(f"final_{STATE[0]}", 0.0)).all():
            raise RuleError((), "names a point that the run did not come to", "resume that run, or take another")
        return arrays

    def _matches(self, places: Mapping[str, Sequence[int]]) -> str:
        """The points at some positions along each axis, in words: all if few, else the values along each axis."""
        free = {name: positions for name, positions in places.items() if len(positions) > 1}
        count = prod(map(len, free.values()))
        if len(free) == 1 or count > LISTED:
            return "; ".join(_listed(self.axes[name], subject=name) for name in free)
        points = (zip(free, place, strict=True) for place in product(*free.values()))
        return f"{count} match: " + "; ".join(
            ", ".join(f"{name} {axis_value(self.axes[name][i])}" for name, i in point) for point in points
        )


SweepPoint = tuple[float, dict[str, np.ndarray]]
"""Frequency [Hz], and the arrays of a point."""


def settled_points(states: SavedStates, asked: Mapping[str, float | str]) -> Iterator[SweepPoint]:
    """Points of a sweep whose motion repeats each cycle, with slip, contact for a part of the cycle, or no contact.

    Where contacts only stick the motion is linear, and their offsets are free. Where all stay apart it is linear too,
    but a curve through it leads to where they meet.
    ``asked``: values along some axes, as for `SavedStates.places`; along the others all points are taken.
    """
    for place in product(*states.places(asked).values()):
        point = states.at(place)
        if str(point["failure"]) or point["settled"] != 1 or point["period"] != 1 or np.any(point.get(DRIFT, 0)):
            continue
        apart = np.all(point["separation_share"] == 1)
        if apart or switches(point["slip_share"], point["separation_share"]).any():
            yield float(states.axes["frequency"][place[-1]]), point


def states_in(data: "Dataset") -> SavedStates:
    """The states in a result; of one run, or of the points of a sweep.

    Raises:
        RuleError: it holds none.
    """
    first = f"final_{STATE[0]}"
    if first not in data:
        raise RuleError((), f"holds no final state ({first} is missing)", "a transient, a jump or a sweep leaves one")
    dims = tuple(map(str, data[first].dims[:-1]))
    names = [f"final_{name}" for name in STATE] + (list(POINT) if dims else [])
    _check_whole(data, dims, [*names, "final_phase_deg"])
    contacts = tuple(map(str, data["contact"].values)) if "contact" in data else ()
    phase = float(np.deg2rad(data["final_phase_deg"].values))
    arrays, axes = ({name: data[name].values for name in own} for own in (names, dims))
    for name, own in GEOMETRY.items():
        if name in data:
            whole = data[name].expand_dims({dim: data.sizes[dim] for dim in dims if dim not in data[name].dims})
            arrays[name] = whole.transpose(*dims, *own).values
    points = tuple(map(str, data["point"].values)) if SHAPE in data else ()
    bodies = tuple(zip(*(map(str, data[name].values) for name in BODIES if name in data.coords), strict=True))
    units = {name: str(data.attrs[f"{name}_unit"]) for name in ("length", "force") if f"{name}_unit" in data.attrs}
    return SavedStates(contacts, arrays, axes, phase, points, bodies, units)


def _check_whole(data: "Dataset", dims: tuple[str, ...], names: Sequence[str]) -> None:
    """Refuse a result that lacks one of these variables, or has states other than timesim writes them."""
    hint = "it is of an earlier version of timesim, or was changed: run it again"
    if missing := [name for name in names if name not in data]:
        raise RuleError((), f"lacks {', '.join(missing)}", hint)
    sizes = {dim: len(NAMES[dim]) for dim in ("axis", "component", "tangent")}
    for name, own in ({f"final_{name}": (*dims, *own) for name, own in FINAL.items()} | GEOMETRY).items():
        if name in data and not (
            data[name].dtype.kind in "iuf"
            and set(own) <= set(data[name].dims) <= {*dims, *own}
            and all(data.sizes[dim] == sizes.get(dim, data.sizes[dim]) for dim in own)
        ):
            raise RuleError((), f"holds no {name} of numbers along {', '.join(own)}", hint)


def _position(name: str, values: np.ndarray, value: float | str) -> int:
    if values.dtype.kind in "US" or isinstance(value, str):
        apart, limit = np.where(values.astype(str) == str(value), 0.0, np.inf), 0.0
    else:
        apart, limit = np.abs(values - value), max(SAME * abs(value), ROUNDING * np.abs(values).max())
    if not apart.min() <= limit:
        article = "an" if name[0] in "aeiou" else "a"
        point = "with a point for the decimals; " if isinstance(value, str) and values.dtype.kind not in "US" else ""
        raise RuleError((name,), f"must be {article} {name} of the result", f"{point}{_listed(values, value)}", value)
    return int(np.argmin(apart))


def _listed(values: np.ndarray, near: float | str | None = None, subject: str = "it") -> str:
    """Values of an axis in words: all if few, else the range and those next to ``near``."""
    words = [axis_value(value) for value in values]
    if len(words) <= LISTED:
        return f"{subject} has {', '.join(words)}"
    next_to = ""
    if near is not None and not isinstance(near, str):
        close = np.sort(np.argsort(np.abs(values - near))[:2])
        next_to = f", next to it {' and '.join(words[i] for i in close)}"
    return f"{subject} has {len(words)} from {words[0]} to {words[-1]}{next_to}"


def saved_states(path: Path) -> SavedStates:
    """The states of a result, by its file or the folder of the run; where it has groups, those of its sweep.

    Raises:
        RuleError: no such file, or a result without states.
    """
    path = result_file(path)
    if not os.path.isfile(path):
        raise RuleError((), "does not exist", FROM_SCENE)
    import xarray

    try:
        groups = xarray.open_groups(path, engine="h5netcdf")
        with groups["/"] as root, groups.get("/sweep", root) as data:
            states = replace(states_in(data), reason=str(root.attrs.get("reason", "")))
    except RuleError:
        raise
    except Exception as error:  # a damaged file raises whatever HDF5 makes of it
        raise RuleError((), f"cannot be read as NetCDF-4 ({' '.join(str(error).split())[:120]})") from None
    return states


def start_of(physics: Model, states: SavedStates, chosen: Mapping[str, np.ndarray]) -> Start:
    """One of the states of a result as the start of a model.

    Raises:
        RuleError: the result is of another structure or of contacts with other bodies or normals, or the state lies
            outside a friction cone.
    """
    displacement, velocity, slip, state = (chosen[f"final_{name}"] for name in STATE)
    end = Start(displacement, velocity, slip, state, states.phase)
    return resumed_start(physics, end, states.contacts, _shapes_of(states, chosen), chosen.get(FRAME), states.bodies)


def _shapes_of(states: SavedStates, chosen: Mapping[str, np.ndarray]) -> ModeShapes | None:
    return ModeShapes(states.points, chosen[SHAPE]) if SHAPE in chosen else None


def start_notes(
    physics: Model, states: SavedStates, chosen: Mapping[str, np.ndarray], units: Mapping[str, str]
) -> tuple[str, ...]:
    """What there is to say of a start that `start_of` gives a model, where the scene names its units."""
    notes, shapes = [], _shapes_of(states, chosen)
    for name, unit in states.units.items():
        if unit != units.get(name, unit):
            notes.append(f"{name} is in {unit} in the result and in {units[name]} in the scene: nothing is converted")
    if states.reason and not states.axes:
        notes.append(f"the run of the result is incomplete ({states.reason}): this one starts where it stopped")
    if shapes is None:
        notes.append("the result does not hold the shapes of its modes, which are taken for those of the scene")
    elif shapes.change(physics.structure) is not None:
        notes.append("the result has other modes than the scene: the motion of its points is carried over")
    return tuple(notes)
