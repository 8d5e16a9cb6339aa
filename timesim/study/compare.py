"""The `compare` study: the steady states of a scene by time integration and by harmonic balance, side by side.

Both use one contact law, but share nothing else: time integration locates every transition and marches until the motion
repeats; harmonic balance solves for a truncated Fourier series. Where the contacts only stick, or stay apart, the
motion is linear, so agreement there proves nothing, and the verdict leaves it out.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.hbm.curve import HbmCurve, solutions_at
from timesim.result.dataset import dataset
from timesim.result.state import held_in
from timesim.scene.hbm import ComparePlan
from timesim.scene.resolution import Scene
from timesim.study.campaign import INTERRUPTED, Means
from timesim.study.compare_cycle import NotSettledError, cycle_by_both
from timesim.study.hbm import Curves, followed, left_out
from timesim.study.outcome import Outcome, attributes
from timesim.study.sweep import jumps_told, sweep_record
from timesim.study.verdict import compared_points, comparison_lines, curve_lines

# Amplitudes below this share of the largest of a motion are those of axes that do not move.
STILL = 1e-9


@dataclass(frozen=True)
class Match:
    """The balance's stable solution nearest to each point of a sweep; V sets of values, D directions, F frequencies.

    Attributes:
        difference: (hbm - sweep) / sweep, shape (V, D, F, P, 3); NaN where there is no solution, and along axes that do
            not move.
        solution: position in `solutions`, shape (V, D, F), -1 where there is none.
        solutions: those at the sweep's frequencies, one entry for each set of values.
    """

    difference: np.ndarray
    solution: np.ndarray
    solutions: list[HbmCurve | None]


def matched(amplitude: np.ndarray, frequency: np.ndarray, curves: Curves) -> Match:
    """Find the solution nearest to each point of a sweep.

    Args:
        amplitude: of the sweep, shape (V, D, F, P, 3).
        frequency: of the sweep [Hz], shape (F,).
        curves: of the same sets of values.
    """
    nearest = np.full_like(amplitude, np.nan)
    solution = np.full(amplitude.shape[:3], -1)
    solutions = [_solutions(curves, values, frequency) for values in curves.values]
    for (v, found), d, f in product(enumerate(solutions), range(amplitude.shape[1]), range(frequency.size)):
        if found is None or not np.isfinite(amplitude[v, d, f]).all():
            continue
        rows = np.flatnonzero(found.stable & (found.frequency == frequency[f]))
        if rows.size:
            far = np.abs(found.amplitude[rows] - amplitude[v, d, f]).max(axis=(1, 2))
            solution[v, d, f] = rows[np.argmin(far)]
            nearest[v, d, f] = found.amplitude[solution[v, d, f]]
    with np.errstate(invalid="ignore", divide="ignore"):
        difference = (nearest - amplitude) / amplitude
    size = np.nanmax(np.where(np.isfinite(amplitude), amplitude, 0.0), axis=(3, 4), keepdims=True)
    difference[~(amplitude > STILL * size)] = np.nan
    return Match(difference, solution, solutions)


def _solutions(curves: Curves, values: Mapping[str, float], frequency: np.ndarray) -> HbmCurve | None:
    """Solutions of all curves with these values at some frequencies."""
    options: dict[str, Any] = {"scheme": curves.scheme, "stability": curves.plan.stability}
    parts = [
        solutions_at(one.model_at(0.0), one.curve, frequency, **options)
        for one in curves.curves
        if one.values == values and one.curve.frequency.size
    ]
    return HbmCurve.joined(parts) if parts else None


def study(scene: Scene, means: Means) -> Outcome:
    """Run a compare scene; marked incomplete where either method did not come to its end."""
    plan: ComparePlan = scene.plan
    clock = time.perf_counter()
    sweep, sweep_reason = sweep_record(scene, plan.sweep, means)
    seconds = time.perf_counter() - clock
    given_up = (sweep_reason or "").startswith(INTERRUPTED)
    hbm, curves, hbm_reason = (
        left_out(scene, plan.balance) if given_up else followed(scene, plan.balance, passing=held_in(sweep))
    )
    faults = [f"{name}: {why}" for name, why in (("sweep", sweep_reason), ("hbm", hbm_reason)) if why]
    reason = "; ".join(faults) or None
    amplitude = sweep["amplitude"]
    match = matched(amplitude.values.reshape(-1, *amplitude.shape[-4:]), sweep["frequency"].values, curves)
    points = compared_points(sweep, hbm, match.difference)
    lines = [*jumps_told(sweep), *comparison_lines(points)]
    groups = {"sweep": sweep, "hbm": hbm}
    if points.worst is not None and reason is None:
        try:
            groups["cycle"] = _cycle(scene, plan, curves, match, points.worst)
        except NotSettledError as error:
            lines.append(f"no cycle is shown by both methods: {error}")
    lines.append(
        f"time integration: {points.settled.size} points in {seconds:.2f} s; harmonic balance: "
        f"{hbm.sizes['solution']} solutions in {hbm.attrs['run_seconds']:.2f} s"
    )
    attrs = attributes(
        scene,
        f"{scene.solver()}; {curves.scheme}",
        hbm.attrs["compile_seconds"] + sweep.attrs["compile_seconds"],
        seconds + hbm.attrs["run_seconds"],
        reason,
    )
    variables = {"relative_difference": (tuple(map(str, amplitude.dims)), match.difference.reshape(amplitude.shape))}
    coords = {name: sweep[name].values for name in ("direction", "point", "axis")}
    root = dataset(variables, coords, attrs | {"verdict": "\n".join(lines)})
    return Outcome({"": root, **groups}, reason, (*curve_lines(hbm, curves.notes), *lines))


def _cycle(scene: Scene, plan: ComparePlan, curves: Curves, match: Match, place: tuple[int, int, int]) -> Dataset:
    """A cycle by both methods, of the solution at a point of the sweep."""
    values, solutions = curves.values[place[0]], match.solutions[place[0]]
    assert solutions is not None
    solution = solutions.at(int(match.solution[place]))
    return cycle_by_both(scene.variant(values), solution, curves.scheme, scene.solver(), plan.sweep.criterion, values)
