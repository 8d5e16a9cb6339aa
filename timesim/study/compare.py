"""The `compare` study: the steady states of a scene by time integration and by harmonic balance, side by side.

Both use one contact law, but share nothing else: time integration locates every transition and marches until the motion
repeats; harmonic balance solves for a truncated Fourier series. Where the contacts only stick, or stay apart, the
motion is linear, so agreement there proves nothing, and the verdict leaves it out.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from xarray import Dataset

from timesim.hbm.curve import HbmCurve, solutions_at
from timesim.orbit.steady_state import switches
from timesim.result.dataset import dataset
from timesim.result.state import held_in
from timesim.scene.hbm import ComparePlan
from timesim.scene.resolution import Scene
from timesim.study.campaign import INTERRUPTED, Means
from timesim.study.compare_cycle import cycle_record
from timesim.study.hbm import followed, left_out
from timesim.study.hbm import summary as hbm_summary
from timesim.study.hbm_curves import Curves
from timesim.study.outcome import Outcome, attributes
from timesim.study.report import jump_lines
from timesim.study.sweep import sweep_record

# Nearer to a fold than this share of its frequency a small error of either method moves the answer much.
NEAR_FOLD = 1e-3
AGREE, NEARLY = 2e-3, 2e-2


@dataclass(frozen=True)
class Sweep:
    """What the comparison reads of a sweep, all further axes made one: V values, D directions, F frequencies.

    Attributes:
        frequency: shape (F,) [Hz].
        amplitude: shape (V, D, F, P, 3).
        settled: whether it repeats after one cycle, shape (V, D, F).
        doubled: whether it repeats after several, shape (V, D, F).
        linear: whether every contact sticks, or stays apart, all the time, shape (V, D, F).
        slip, separation: largest share of a period over the contacts, each by itself, shape (V, D, F).
    """

    frequency: np.ndarray
    amplitude: np.ndarray
    settled: np.ndarray
    doubled: np.ndarray
    linear: np.ndarray
    slip: np.ndarray
    separation: np.ndarray


def read_sweep(record: Dataset) -> Sweep:
    """From the record of a sweep."""

    def array(name: str, own: int) -> np.ndarray:
        values = record[name].values
        return values.reshape(-1, *values.shape[values.ndim - own :])

    period, settled = array("period", 2), array("settled", 2) > 0
    slip, apart = array("slip_share", 3), array("separation_share", 3)
    return Sweep(
        frequency=record["frequency"].values,
        amplitude=array("amplitude", 4),
        settled=settled & (period == 1),
        doubled=settled & (period > 1),
        linear=np.logical_not(switches(slip, apart).any(axis=-1)),
        slip=slip.max(axis=-1, initial=0.0),
        separation=apart.max(axis=-1, initial=0.0),
    )


@dataclass(frozen=True)
class Match:
    """The balance's stable solution nearest to each point of a sweep.

    Attributes:
        amplitude: shape (V, D, F, P, 3), NaN where there is none.
        difference: (hbm - sweep) / sweep, same shape; NaN too along axes that do not move.
        near_fold: whether a fold is close, shape (V, F).
        solution: position in `solutions`, shape (V, D, F), -1 where there is none.
        solutions: those at the sweep's frequencies, one entry for each set of values.
    """

    amplitude: np.ndarray
    difference: np.ndarray
    near_fold: np.ndarray
    solution: np.ndarray
    solutions: list[HbmCurve | None]


# Amplitudes below this share of the largest of a motion are those of axes that do not move.
STILL = 1e-9


def matched(sweep: Sweep, curves: Curves) -> Match:
    """Look for the solution nearest to each point."""
    amplitude = np.full_like(sweep.amplitude, np.nan)
    solution = np.full(amplitude.shape[:3], -1)
    near_fold = np.zeros((len(amplitude), sweep.frequency.size), dtype=bool)
    solutions: list[HbmCurve | None] = []
    for v, values in enumerate(curves.values):
        pieces = [piece for piece in curves.pieces if piece.values == values and piece.curve.frequency.size]
        folds = np.concatenate([np.zeros(0), *(piece.curve.frequency[piece.curve.fold] for piece in pieces)])
        apart = np.abs(sweep.frequency[:, None] - folds)
        near_fold[v] = (apart < NEAR_FOLD * sweep.frequency[:, None]).any(axis=1)
        stability, scheme = curves.plan.stability, curves.scheme
        parts = [
            solutions_at(piece.model_at(0.0), piece.curve, sweep.frequency, scheme=scheme, stability=stability)
            for piece in pieces
        ]
        found = HbmCurve.joined(parts) if parts else None
        solutions.append(found)
        if found is not None:
            _pick(sweep, v, found, amplitude, solution)
    with np.errstate(invalid="ignore", divide="ignore"):
        difference = (amplitude - sweep.amplitude) / sweep.amplitude
    size = np.nanmax(np.where(np.isfinite(sweep.amplitude), sweep.amplitude, 0.0), axis=(3, 4), keepdims=True)
    difference[~(sweep.amplitude > STILL * size)] = np.nan
    return Match(amplitude, difference, near_fold, solution, solutions)


def _pick(sweep: Sweep, v: int, found: HbmCurve, amplitude: np.ndarray, solution: np.ndarray) -> None:
    for d, f in product(range(amplitude.shape[1]), range(amplitude.shape[2])):
        rows = np.flatnonzero(found.stable & (found.frequency == sweep.frequency[f]))
        if rows.size and np.isfinite(sweep.amplitude[v, d, f]).all():
            far = np.abs(found.amplitude[rows] - sweep.amplitude[v, d, f]).max(axis=(1, 2))
            solution[v, d, f] = rows[np.argmin(far)]
            amplitude[v, d, f] = found.amplitude[solution[v, d, f]]


def study(scene: Scene, means: Means) -> Outcome:
    """Run a compare scene; marked incomplete where either method did not come to its end."""
    plan: ComparePlan = scene.plan
    clock = time.perf_counter()
    swept, sweep_reason = sweep_record(scene, plan.sweep, means)
    seconds = time.perf_counter() - clock
    given_up = (sweep_reason or "").startswith(INTERRUPTED)
    balanced, curves, hbm_reason = (
        left_out(scene, plan.balance) if given_up else followed(scene, plan.balance, passing=held_in(swept))
    )
    sweep = read_sweep(swept)
    match = matched(sweep, curves)
    faults = [f"{name}: {why}" for name, why in (("sweep", sweep_reason), ("hbm", hbm_reason)) if why]
    reason = "; ".join(faults) or None
    lines = [*jump_lines(swept), *verdict(sweep, match, curves)]
    lines.append(
        f"time integration: {sweep.settled.size} points in {seconds:.2f} s; harmonic balance: "
        f"{balanced['frequency'].size} solutions in {balanced.attrs['run_seconds']:.2f} s"
    )
    told = attributes(
        scene,
        f"{scene.solver()}; {curves.scheme}",
        balanced.attrs["compile_seconds"] + swept.attrs["compile_seconds"],
        seconds + balanced.attrs["run_seconds"],
        reason,
    )
    dims = tuple(map(str, swept["amplitude"].dims))
    coords = {name: swept[name].values for name in ("direction", "point", "axis")}
    shape = swept["amplitude"].shape
    root = {"relative_difference": (dims, match.difference.reshape(shape))}
    groups = {
        "": dataset(root, coords, told | {"verdict": "\n".join(lines)}),
        "sweep": swept,
        "hbm": balanced,
    }
    looked_at = where_largest(sweep, match)
    if looked_at is not None and reason is None:
        v, d, f = looked_at
        values = curves.values[v]
        found = match.solutions[v]
        assert found is not None
        model = scene.variant(values)
        one = found.at(int(match.solution[v, d, f]))
        groups["cycle"] = cycle_record(model, one, curves.scheme, scene.solver(), values)
    return Outcome(groups, reason, (*hbm_summary(balanced, curves), *lines))


def where_largest(sweep: Sweep, match: Match) -> tuple[int, int, int] | None:
    """The point with slip or separation where the methods differ most; None without such points."""
    size = np.abs(match.difference).max(axis=(3, 4), initial=0.0, where=np.isfinite(match.difference))
    telling = _telling(sweep, match) & ~match.near_fold[:, None]
    if not telling.any():
        return None
    v, d, f = np.unravel_index(np.argmax(np.where(telling, size, -1.0)), size.shape)
    return int(v), int(d), int(f)


def _telling(sweep: Sweep, match: Match) -> np.ndarray:
    """Settled points with slip, or contact for a part of the cycle, that have a solution, shape (V, D, F)."""
    return sweep.settled & (match.solution >= 0) & ~sweep.linear


def verdict(sweep: Sweep, match: Match, curves: Curves) -> Iterator[str]:
    """The comparison in words, a line each."""
    size = np.abs(match.difference).max(axis=(3, 4), initial=0.0, where=np.isfinite(match.difference))
    telling, near = _telling(sweep, match), np.broadcast_to(match.near_fold[:, None], sweep.settled.shape)
    judged = telling & ~near
    if judged.any():
        yield _judgement(sweep, match, curves, size, judged)
    else:
        yield "no point is left where a contact slips or opens within the cycle: nothing is proven of the contacts"
    linear = sweep.settled & sweep.linear & (match.solution >= 0)
    if linear.any():
        yield (
            f"at {linear.sum()} points every contact sticks, or stays apart, all the time: they differ by at most "
            f"{size[linear].max():.1e}, but the motion is linear there, so this proves nothing of the contacts"
        )
    if (telling & near).any():
        worst = size[telling & near].max()
        yield f"{(telling & near).sum()} points within {NEAR_FOLD:g} of a fold's frequency differ by up to {worst:.1e}"
    alone = sweep.settled & (match.solution < 0)
    if alone.any():
        yield f"{alone.sum()} points have no stable solution of the balance: {_places(sweep, curves, alone)}"
    if sweep.doubled.any():
        many = _places(sweep, curves, sweep.doubled)
        yield f"{sweep.doubled.sum()} points repeat after several cycles, which the balance cannot show: {many}"
    lost = ~sweep.settled & ~sweep.doubled
    if lost.any():
        yield f"{lost.sum()} points did not settle and are left out: {_places(sweep, curves, lost)}"


def _judgement(sweep: Sweep, match: Match, curves: Curves, size: np.ndarray, judged: np.ndarray) -> str:
    worst = float(size[judged].max())
    v, d, f = (int(i) for i in np.unravel_index(np.argmax(np.where(judged, size, -1.0)), size.shape))
    word = "agree" if worst <= AGREE else "nearly agree" if worst <= NEARLY else "differ"
    advice = "" if worst <= AGREE else "; study.convergence: true tells whether more harmonics would help"
    values = ", ".join(f"{key} {value:g}" for key, value in curves.values[v].items())
    place = f"{sweep.frequency[f]:g} Hz" + (f" with {values}" if values else "")
    shares = (
        f"a contact {sweep.slip[v, d, f]:.2f} of the cycle in slip, one {sweep.separation[v, d, f]:.2f} in separation"
    )
    middle = f"median {np.median(size[judged]):.1e}, mean shares {sweep.slip[judged].mean():.2f} and "
    return (
        f"the methods {word}: {judged.sum()} points with slip, or contact for a part of the cycle, differ by at most "
        f"{worst:.1e} of the amplitude ({middle}{sweep.separation[judged].mean():.2f}); "
        f"most at {place}, {shares}{advice}"
    )


def _places(sweep: Sweep, curves: Curves, chosen: np.ndarray) -> str:
    """Where points lie, by value."""
    parts = []
    for v, values in enumerate(curves.values):
        at = sweep.frequency[chosen[v].any(axis=0)]
        if at.size:
            told = ", ".join(f"{key} {value:g}" for key, value in values.items())
            span = f"{at[0]:g} Hz" if at.size == 1 else f"{at[0]:g} to {at[-1]:g} Hz"
            parts.append(f"{told} at {span}" if told else span)
    return "; ".join(parts)
