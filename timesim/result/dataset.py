"""The result of a study in memory: an xarray Dataset in which every variable has its meaning and units."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from timesim.model.model import Model
from timesim.result import label
from timesim.result.coordinate import coordinates
from timesim.result.file import StoreError

if TYPE_CHECKING:
    import xarray

Dims = tuple[str, ...]
Arrays = dict[str, tuple[Dims, np.ndarray]]
"""Variables by name, which are labelled as `timesim.result.label` says."""
Variables = Mapping[str, tuple[Dims, np.ndarray] | tuple[Dims, np.ndarray, Mapping[str, Any]]]


def dataset(
    variables: Variables, coords: Mapping[str, Any], attrs: Mapping[str, Any], model: Model | None = None
) -> "xarray.Dataset":
    """Dataset with the labels of `timesim.result.label`; flags become integers.

    Args:
        variables: ``{name: (dimensions, array)}``, or with a third item: attributes. A name that
            `timesim.result.label` does not list needs a ``long_name`` of its own there. A dimension may
            have length 0.
        coords: ``{dimension: values}``, or the same as for `variables`; not those of
            `timesim.result.coordinate.coordinates`.
        attrs: attributes of the whole result; those of `timesim.study.outcome.unit_names` give its units.
        model: gives the names of points and contacts.

    Raises:
        StoreError: a variable has no ``long_name``.
        ValueError: an array does not fit its dimensions.
    """
    import xarray

    every = {**coords, **coordinates(variables, model), **coords}  # in the order of those that are given
    along = {name: given if _has_dims(given) else ((name,), given) for name, given in every.items()}
    units = {quantity: attrs[f"{quantity}_unit"] for quantity in label.BASE if f"{quantity}_unit" in attrs}
    return xarray.Dataset(
        {name: _labelled(units, name, *given) for name, given in variables.items()},
        {name: _labelled(units, name, *given) for name, given in along.items()},
        {name: int(value) if isinstance(value, bool | np.bool_) else value for name, value in attrs.items()},
    )


def _has_dims(given: Any) -> bool:
    return isinstance(given, tuple) and len(given) > 1 and isinstance(given[0], tuple)


def _labelled(
    units: Mapping[str, str], name: str, dims: Dims, values: Any, own: Mapping[str, Any] | None = None
) -> tuple[Dims, np.ndarray, dict[str, Any]]:
    array = np.asarray(values)
    if array.dtype.kind == "b":
        array = array.astype(np.int8)
    elif array.dtype.kind in "OT":
        array = array.astype(object).astype(str)
    attrs = {**label.attributes(name, units), **(own or {})}
    if "long_name" not in attrs:
        raise StoreError(f"variable '{name}': give it a long_name of its own, or a line in timesim.result.label")
    if "flag_values" in attrs:  # of the variable's own type, as the CF conventions ask
        attrs["flag_values"] = np.asarray(attrs["flag_values"]).astype(array.dtype)
    return dims, array, attrs
