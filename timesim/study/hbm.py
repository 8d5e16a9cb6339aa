"""The `hbm` study: response curves by harmonic balance, one for each value of the scene's further axes."""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.hbm.continuation import Controls
from timesim.hbm.convergence import Convergence, Place, convergence
from timesim.hbm.curve import HbmCurve, default_controls, hbm_curve
from timesim.model.model import Model
from timesim.result.coordinate import coordinates
from timesim.result.dataset import dataset
from timesim.result.state import Held
from timesim.scene.hbm import HbmPlan
from timesim.scene.resolution import Scene
from timesim.scene.study import combinations
from timesim.study.campaign import Means, Progress
from timesim.study.hbm_curves import Curves, Piece
from timesim.study.outcome import Outcome, attributes


def warmed_up(scene: Scene, plan: HbmPlan) -> float:
    """Seconds that the first points of a curve took, most of them compilation."""
    clock = time.perf_counter()
    model, middle = scene.variant(next(combinations(plan.over))), plan.span[0]
    few = Controls(default_controls().size, max_points=2)
    hbm_curve(model, middle, 1.001 * middle, scheme=plan.scheme, controls=few, stability=plan.stability)
    return time.perf_counter() - clock


def study(scene: Scene, means: Means) -> Outcome:
    """Run an hbm scene; the result is marked incomplete where a curve could not be followed to its end."""
    record, curves, reason = followed(scene, scene.plan, means.progress)
    return Outcome({"": record}, reason, tuple(summary(record, curves)))


def followed(
    scene: Scene, plan: HbmPlan, progress: Progress | None = None, passing: Held | None = None
) -> tuple[Dataset, Curves, str | None]:
    """All curves of a scene, those through the points of a sweep too: the record, they, and why some are not whole."""
    curves = Curves(scene, plan)
    compiling = warmed_up(scene, plan)
    clock = time.perf_counter()
    reason = curves.run(progress, passing)
    found = convergence(places(curves.pieces), curves.scheme) if plan.convergence and reason is None else None
    seconds = time.perf_counter() - clock
    told = attributes(scene, str(curves.scheme), compiling, seconds, reason)
    return record_of(scene.model(), curves, told, found), curves, reason


def left_out(scene: Scene, plan: HbmPlan) -> tuple[Dataset, Curves, str | None]:
    """The same where nothing is to be followed any more."""
    curves, reason = Curves(scene, plan), "not begun"
    told = attributes(scene, str(curves.scheme), 0.0, 0.0, reason)
    return record_of(scene.model(), curves, told), curves, reason


def places(pieces: Sequence[Piece], number: int = 6) -> list[Place]:
    """Stable solutions with slip or separation, spread over all curves, and the largest of them."""
    rows = [
        (piece, i)
        for piece in pieces
        for i in np.flatnonzero(piece.curve.stable & (piece.curve.slip_share + piece.curve.separation_share > 0).any(1))
    ]
    if not rows:
        return []
    spread = set(np.linspace(0, len(rows) - 1, min(number, len(rows))).round().astype(int).tolist())
    largest = int(np.argmax([piece.curve.amplitude[i].max() for piece, i in rows]))
    found = []
    for piece, i in (rows[k] for k in sorted(spread | {largest})):
        curve = piece.curve
        model = piece.model_at(float(curve.parameter[i]))
        found.append(Place(model, float(curve.frequency[i]), curve.contact_motion[i], curve.amplitude[i]))
    return found


def record_of(model: Model, curves: Curves, told: dict[str, Any], found: Convergence | None = None) -> Dataset:
    """The result file: all solutions, one curve after the other."""
    pieces, points, contacts = curves.pieces, len(model.structure.points), model.num_contacts
    order = curves.scheme.harmonics + 1
    shapes = {
        "amplitude": (points, 3),
        "harmonic_amplitude": (order, points, 3),
        "harmonic_cos": (order, points, 3),
        "harmonic_sin": (order, points, 3),
        "slip_share": (contacts,),
        "separation_share": (contacts,),
    }
    scalars = ("frequency", "stable", "fold", "branch", "floquet_max", "closure")
    arrays = {name: _stacked(pieces, name, shapes.get(name, ())) for name in (*scalars, *shapes)}
    for name in ("stable", "fold"):
        arrays[name] = arrays[name].astype(np.int8)
    arrays["branch"] = arrays["branch"].astype(np.int32)
    counts = [piece.curve.frequency.size for piece in pieces]
    arrays["curve"] = np.repeat(np.arange(len(pieces)), counts).astype(np.int32)
    dims = {4: ("harmonic", "point", "axis"), 3: ("point", "axis"), 2: ("contact",), 1: ()}
    variables = {name: (("solution", *dims[array.ndim]), array) for name, array in arrays.items()}
    for key in curves.plan.over:
        variables[key] = (("solution",), np.repeat([piece.values[key] for piece in pieces], counts))
    if (along := curves.plan.along) is not None:
        variables[along.key] = (("solution",), _stacked(pieces, "parameter", ()))
        told = told | {"along": along.key}
    coords = coordinates(variables, model)
    if found is not None:
        coords |= {"harmonics": found.harmonics, "time_samples": found.time_samples}
        variables["change_with_harmonics"] = (("harmonics",), found.with_harmonics)
        variables["change_with_samples"] = (("time_samples",), found.with_samples)
        told = told | {"convergence": "\n".join(found.told())}
    return dataset(variables, coords, told)


def _stacked(pieces: Sequence[Piece], name: str, shape: tuple[int, ...]) -> np.ndarray:
    none = np.zeros((0, *shape))
    return np.concatenate([none, *(np.asarray(getattr(piece.curve, name), dtype=float) for piece in pieces)])


def summary(record: Dataset, curves: Curves) -> Iterator[str]:
    """What a user wants to know of the curves at once."""
    count, seconds = sum(piece.curve.frequency.size for piece in curves.pieces), record.attrs["run_seconds"]
    yield f"{count} solutions on {len(curves.pieces)} curves by {curves.scheme} in {seconds:.2f} s"
    yield from curves.notes
    for piece in curves.pieces:
        if piece.curve.frequency.size:
            yield (f"{piece.label}: " if piece.label else "") + told(piece.curve, curves.scene.model())
    if "convergence" in record.attrs:
        yield from record.attrs["convergence"].split("\n")


def told(curve: HbmCurve, model: Model) -> str:
    """A curve in words: its peak, its folds, and how much of it slips and separates."""
    point, axis = np.unravel_index(np.argmax(curve.amplitude.max(0)), curve.amplitude.shape[1:])
    place, height = peak(curve, int(point), int(axis))
    name = f"{model.structure.points[int(point)]} {'xyz'[int(axis)]}"
    folds = ", ".join(f"{p:.6g}" for p in curve.parameter[curve.fold])
    turning = f"folds at {folds}" if folds else "no fold"
    unstable = int(np.sum(~curve.stable & ~curve.fold))
    slip, apart = curve.slip_share.max(initial=0.0), curve.separation_share.max(initial=0.0)
    states = f"at most {slip:.2f} of a period in slip, {apart:.2f} in separation"
    if slip == apart == 0:
        states = "full stick throughout, which says nothing of friction"
    lost = [f"{curve.parameter[i]:.6g}" for i in np.flatnonzero(changes_of_stability(curve))]
    also = f"; stability changes at {', '.join(lost)} without a fold" if lost else ""
    return f"peak {height:.5g} of {name} at {place:.6g}; {turning}{also}; {unstable} unstable solutions; {states}"


def changes_of_stability(curve: HbmCurve) -> np.ndarray:
    """Solutions after which the curve gains or loses its stability though it does not turn, shape (S,)."""
    stable, fold = curve.stable, curve.fold
    found = np.zeros(stable.size, dtype=bool)
    found[:-1] = (stable[1:] != stable[:-1]) & ~fold[1:] & ~fold[:-1]
    return found


def peak(curve: HbmCurve, point: int, axis: int) -> tuple[float, float]:
    """Parameter and height of the largest amplitude, by a parabola along the curve."""
    height = curve.amplitude[:, point, axis]
    i = int(np.argmax(height))
    if not 0 < i < height.size - 1:
        return float(curve.parameter[i]), float(height[i])
    rows = slice(i - 1, i + 2)
    motion = curve.contact_motion[rows].reshape(3, -1)
    scales = np.ptp(curve.parameter), np.linalg.norm(motion[1]) or 1.0
    steps = np.hypot(
        np.diff(curve.parameter[rows]) / scales[0], np.linalg.norm(np.diff(motion, axis=0), axis=1) / scales[1]
    )
    s = np.array([-steps[0], 0.0, steps[1]])
    bend, slope, middle = np.polyfit(s, height[rows], 2)
    top = float(np.clip(-slope / (2 * bend), s[0], s[2])) if bend < 0 else 0.0
    return float(np.polyval(np.polyfit(s, curve.parameter[rows], 2), top)), float(
        np.polyval([bend, slope, middle], top)
    )
