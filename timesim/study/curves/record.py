"""The result file of the curves of a study."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.hbm.convergence import Convergence
from timesim.result.dataset import dataset
from timesim.study.curves.collection import Curves
from timesim.study.verdict import convergence_lines


def solutions(curves: Curves, attrs: Mapping[str, Any], refined: Convergence | None = None) -> Dataset:
    """The result file: all solutions, one curve after the other."""
    model, order = curves.any_model, curves.scheme.harmonics + 1
    points, contacts = len(model.structure.points), model.num_contacts
    shapes = {
        **dict.fromkeys(("frequency", "stable", "fold", "branch", "floquet_max", "closure"), ()),
        **dict.fromkeys(("amplitude", "phase_deg"), (points, 3)),
        **dict.fromkeys(("harmonic_amplitude", "harmonic_cos", "harmonic_sin"), (order, points, 3)),
        **dict.fromkeys(("slip_share", "separation_share", "dissipated_power"), (contacts,)),
    }
    arrays = {name: _stacked(curves, name, shape) for name, shape in shapes.items()}
    arrays |= {name: arrays[name].astype(np.int8) for name in ("stable", "fold")}
    arrays["branch"] = arrays["branch"].astype(np.int32)
    counts = [one.curve.frequency.size for one in curves.curves]
    arrays["curve"] = np.repeat(np.arange(len(counts)), counts).astype(np.int32)
    for key in curves.plan.over:
        arrays[key] = np.repeat([one.values[key] for one in curves.curves], counts)
    if (along := curves.plan.along) is not None:
        arrays[along.key] = _stacked(curves, "parameter", ())
        attrs = {**attrs, "along": along.key}
    dims = {4: ("harmonic", "point", "axis"), 3: ("point", "axis"), 2: ("contact",), 1: ()}
    variables = {name: (("solution", *dims[array.ndim]), array) for name, array in arrays.items()}
    coords: dict[str, np.ndarray] = {}
    if refined is not None:
        coords = {"harmonics": refined.harmonics, "time_samples": refined.time_samples}
        variables["change_with_harmonics"] = (("harmonics",), refined.with_harmonics)
        variables["change_with_samples"] = (("time_samples",), refined.with_samples)
        attrs = {**attrs, "convergence": "\n".join(convergence_lines(refined))}
    return dataset(variables, coords, attrs, model)


def _stacked(curves: Curves, name: str, shape: tuple[int, ...]) -> np.ndarray:
    none = np.zeros((0, *shape))
    return np.concatenate([none, *(np.asarray(getattr(one.curve, name), dtype=float) for one in curves.curves)])
