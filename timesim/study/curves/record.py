"""The result file of the curves of a study."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.hbm.convergence import Convergence
from timesim.result.dataset import dataset
from timesim.study.columns import TAILS, sizes_of
from timesim.study.curves.collection import Curves
from timesim.study.summary.curve import convergence_lines

# Quantities by their names in `HbmCurve` and in the result.
OF_SOLUTION = ("frequency", "stable", "fold", "branch", "floquet_max", "floquet_phase_deg", "closure")
OF_MOTION = ("amplitude", "phase_deg", "harmonic_amplitude", "harmonic_cos", "harmonic_sin")
OF_CONTACTS = ("slip_share", "separation_share", "dissipated_power")


def solutions(curves: Curves, attrs: Mapping[str, Any], refined: Convergence | None = None) -> Dataset:
    """The result file: all solutions, one curve after the other."""
    model = curves.any_model
    sizes = sizes_of(model) | {"harmonic": curves.scheme.harmonics + 1}
    names = (*OF_SOLUTION, *OF_MOTION, *OF_CONTACTS)
    arrays = {name: _stacked(curves, name, [sizes[dim] for dim in TAILS.get(name, ())]) for name in names}
    arrays |= {name: arrays[name].astype(np.int8) for name in ("stable", "fold")}
    arrays["branch"] = arrays["branch"].astype(np.int32)
    counts = [one.curve.frequency.size for one in curves.curves]
    arrays["curve"] = np.repeat(np.arange(len(counts)), counts).astype(np.int32)
    for key in curves.plan.over:
        arrays[key] = np.repeat([one.values[key] for one in curves.curves], counts)
    if (along := curves.plan.along) is not None:
        arrays[along.key] = _stacked(curves, "parameter", [])
        attrs = {**attrs, "along": along.key}
    variables = {name: (("solution", *TAILS.get(name, ())), array) for name, array in arrays.items()}
    coords: dict[str, np.ndarray] = {}
    if refined is not None:
        coords = {"harmonics": refined.harmonics, "time_samples": refined.time_samples}
        variables["change_with_harmonics"] = (("harmonics",), refined.with_harmonics)
        variables["change_with_samples"] = (("time_samples",), refined.with_samples)
        attrs = {**attrs, "convergence": "\n".join(convergence_lines(refined))}
    return dataset(variables, coords, attrs, model)


def _stacked(curves: Curves, name: str, shape: Sequence[int]) -> np.ndarray:
    none = np.zeros((0, *shape))
    return np.concatenate([none, *(np.asarray(getattr(one.curve, name), dtype=float) for one in curves.curves)])
