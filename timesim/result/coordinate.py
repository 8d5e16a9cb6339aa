"""Values along the dimensions that mean the same in every result."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from timesim.model.model import Model
from timesim.result.label import is_scalar_key

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

NAMES = {
    "axis": ("x", "y", "z"),
    "component": ("t1", "t2", "n"),
    "tangent": ("t1", "t2"),
    "band": ("smallest", "largest"),
    "end": ("low", "high"),
    "motion": ("lower", "upper"),
}

BODIES = "body_1", "body_2"
"""Along the contacts: the points that each joins, or one of them and the ground."""
FIRST = {"mode": 1, "cycle": 1, "harmonic": 0}
"""First number along the dimensions that count something."""
ALIKE = 1e-6
"""Relative difference up to which amplitudes of different points are one, as of equal bodies that move alike."""


def coordinates(variables: Mapping[str, tuple[Any, ...]], model: Model | None = None) -> dict[str, Any]:
    """Coordinates along those dimensions of variables that the model determines, or that are the same in all results.

    Besides the names of the contacts they hold what these join, and their coefficients of friction: one with 0 is a
    stop. Variables are ``{name: (dimensions, array)}``; the model gives the names of points and contacts.
    """
    sizes = {
        dim: size for dims, array, *_ in variables.values() for dim, size in zip(dims, np.shape(array), strict=False)
    }
    along: dict[str, np.ndarray] = {dim: np.array(names) for dim, names in NAMES.items()}
    along |= {dim: first + np.arange(sizes.get(dim, 0)) for dim, first in FIRST.items()}
    if model is not None:
        along["point"] = np.array(model.structure.points, dtype=str)
        along["contact"] = np.array([contact.name for contact in model.contacts], dtype=str)
    known: dict[str, Any] = {dim: values for dim, values in along.items() if dim in sizes}
    if model is not None and "contact" in known:
        known["friction"] = ("contact",), model.friction
        for name, of in zip(BODIES, ("point", "against"), strict=True):
            known[name] = ("contact",), np.array([getattr(contact, of) for contact in model.contacts], dtype=str)
    return known


def most_friction(models: Iterable[Model]) -> Model:
    """Of the models that a result is over the first with most friction: a contact is a stop of it if it always is."""
    return max(models, key=lambda model: model.friction.sum())


def rubs(data: "Dataset") -> "DataArray":
    """Which contacts of a result have friction; one without is closed in the state in which others slip."""
    known = data.coords.get("friction")
    return data["contact"].notnull() if known is None else known > 0


def place_of_largest(amplitude: np.ndarray) -> tuple[int, int]:
    """Point and axis of the largest of some amplitudes, shape (..., P, 3), the first of those that are alike."""
    size = np.nan_to_num(amplitude, nan=-1.0).reshape(-1, *amplitude.shape[-2:]).max(axis=0)
    point, axis = np.unravel_index(np.argmax(size >= size.max() - ALIKE * abs(size.max())), size.shape)
    return int(point), int(axis)


def largest_motion(amplitude: "DataArray") -> dict[str, str]:
    """Point and axis of the largest of some amplitudes, along any further dimensions."""
    place = place_of_largest(amplitude.transpose(..., "point", "axis").values)
    return {name: str(amplitude[name].values[i]) for name, i in zip(("point", "axis"), place, strict=True)}


def over_keys(data: "Dataset") -> list[str]:
    """Keys of the scalars of the scene that a result varies, in the scene's order."""
    names = dict.fromkeys((*(dim for array in data.data_vars.values() for dim in array.dims), *data.data_vars))
    return [name for name in map(str, names) if is_scalar_key(name) and name != data.attrs.get("along")]


def runs(values: np.ndarray, chosen: np.ndarray) -> list[np.ndarray]:
    """Chosen values along an axis, shape (N,), those together that no value between them parts."""
    index = np.flatnonzero(chosen)
    return [values[row] for row in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1) if row.size]
