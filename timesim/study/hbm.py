"""The `hbm` study: response curves by harmonic balance, one for each value of the scene's further axes."""

import timesim.runtime  # noqa: F401  isort: skip

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.hbm.continuation import Controls
from timesim.hbm.convergence import Convergence, convergence
from timesim.hbm.curve import default_controls, hbm_curve
from timesim.model.model import Model
from timesim.result.coordinate import coordinates
from timesim.result.dataset import dataset
from timesim.result.state import Held
from timesim.scene.hbm import HbmPlan
from timesim.scene.resolution import Scene
from timesim.scene.study import combinations
from timesim.study.campaign import Means, Progress
from timesim.study.hbm_curves import Curves
from timesim.study.outcome import Outcome, attributes
from timesim.study.verdict import convergence_lines, curve_lines


def study(scene: Scene, means: Means) -> Outcome:
    """Run an hbm scene; the result is marked incomplete where a curve could not be followed to its end."""
    data, curves, reason = followed(scene, scene.plan, means.progress)
    return Outcome({"": data}, reason, tuple(curve_lines(data, curves.notes)))


def followed(
    scene: Scene, plan: HbmPlan, progress: Progress | None = None, passing: Held | None = None
) -> tuple[Dataset, Curves, str | None]:
    """All curves of a scene, those through the points of a sweep too: the result, they, and why some are not whole."""
    curves = Curves(scene, plan)
    compiling = _warmed_up(scene, plan)
    clock = time.perf_counter()
    reason = curves.run(progress, passing)
    refined = convergence(curves.to_refine(), curves.scheme) if plan.convergence and reason is None else None
    seconds = time.perf_counter() - clock
    attrs = attributes(scene, str(curves.scheme), compiling, seconds, reason)
    return solutions(scene.model(), curves, attrs, refined), curves, reason


def left_out(scene: Scene, plan: HbmPlan) -> tuple[Dataset, Curves, str | None]:
    """The same where nothing is to be followed any more."""
    curves, reason = Curves(scene, plan), "not begun"
    return solutions(scene.model(), curves, attributes(scene, str(curves.scheme), 0.0, 0.0, reason)), curves, reason


def _warmed_up(scene: Scene, plan: HbmPlan) -> float:
    """Seconds that the first points of a curve took, most of them compilation."""
    clock = time.perf_counter()
    model, frequency = scene.variant(next(combinations(plan.over))), plan.span[0]
    few = Controls(default_controls().size, max_points=2)
    hbm_curve(model, frequency, 1.001 * frequency, scheme=plan.scheme, controls=few, stability=plan.stability)
    return time.perf_counter() - clock


def solutions(model: Model, curves: Curves, attrs: Mapping[str, Any], refined: Convergence | None = None) -> Dataset:
    """The result file: all solutions, one curve after the other."""
    points, contacts, order = len(model.structure.points), model.num_contacts, curves.scheme.harmonics + 1
    shapes = {
        **dict.fromkeys(("frequency", "stable", "fold", "branch", "floquet_max", "closure"), ()),
        "amplitude": (points, 3),
        **dict.fromkeys(("harmonic_amplitude", "harmonic_cos", "harmonic_sin"), (order, points, 3)),
        **dict.fromkeys(("slip_share", "separation_share"), (contacts,)),
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
    coords = coordinates(variables, model)
    if refined is not None:
        coords |= {"harmonics": refined.harmonics, "time_samples": refined.time_samples}
        variables["change_with_harmonics"] = (("harmonics",), refined.with_harmonics)
        variables["change_with_samples"] = (("time_samples",), refined.with_samples)
        attrs = {**attrs, "convergence": "\n".join(convergence_lines(refined))}
    return dataset(variables, coords, attrs)


def _stacked(curves: Curves, name: str, shape: tuple[int, ...]) -> np.ndarray:
    none = np.zeros((0, *shape))
    return np.concatenate([none, *(np.asarray(getattr(one.curve, name), dtype=float) for one in curves.curves)])
