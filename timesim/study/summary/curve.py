"""The summary of curves of harmonic balance, in words, from their finished result."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.hbm.convergence import Convergence, order_of
from timesim.hbm.stability.multipliers import BORDER
from timesim.orbit.steady_state import switches
from timesim.result.coordinate import over_keys, place_of_largest, rubs
from timesim.result.label import counted, in_words, with_unit
from timesim.study.outcome import took

MOST = 8  # folds and changes of stability that are listed
REAL = 1.0  # degrees from the real axis up to which a multiplier is real


def curve_lines(data: Dataset, notes: Sequence[str]) -> Iterator[str]:
    """Response curves: how many, notes of the study, each curve, and whether harmonics and samples suffice."""
    numbers, attrs = np.unique(data["curve"].values), data.attrs
    solutions, curves = counted(data.sizes["solution"], "solution"), counted(numbers.size, "curve")
    at = f" at {data['frequency'].values[0]:.6g} Hz" if "along" in attrs and data.sizes["solution"] else ""
    yield f"{solutions} on {curves}{at} by {attrs['method']} {took(attrs)}"
    yield from notes
    for number in numbers:
        curve = data.isel(solution=data["curve"].values == number)
        values = in_words({key: curve[key].values[0] for key in over_keys(data)}, ": ")
        yield values + _curve_line(curve)
        yield from (values + line for line in _free_lines(curve))
    if "convergence" in attrs:
        yield from attrs["convergence"].split("\n")


def _curve_line(curve: Dataset) -> str:
    """The peak of a curve, its folds, and how much its contacts slip and separate."""
    amplitude, along = curve["amplitude"].values, curve[curve.attrs.get("along", "frequency")].values
    stable, fold = curve["stable"].values > 0, curve["fold"].values > 0
    point, axis = place_of_largest(amplitude)
    motion = np.stack([curve["harmonic_cos"].values, curve["harmonic_sin"].values], axis=1)
    place, height = peak(along, amplitude[:, point, axis], motion)
    folds, units = "folds" if np.sum(fold) > 1 else "a fold", curve[curve.attrs.get("along", "frequency")].attrs
    turning = f"{folds} at {_first_of([f'{place:.6g}' for place in along[fold]], units)}" if fold.any() else "no fold"
    before = np.flatnonzero(changes_of_stability(stable, fold))
    between = (with_unit(f"{along[i]:.6g} and {along[i + 1]:.6g}", units) for i in before)
    changes = [f"{place}{_beyond(curve, i + stable[i])}" for place, i in zip(between, before, strict=True)]
    also = f"; stability changes without a fold between {_first_of(changes, {})}" if changes else ""
    touching, apart = curve["slip_share"].values, curve["separation_share"].values.max(initial=0.0)
    rub = rubs(curve).values
    slip, closed = (touching[:, own].max(initial=0.0) for own in (rub, ~rub))
    stops = f", a stop closed for {closed:.2f}" if closed else ""
    states = f"at most {slip:.2f} of a period in slip, {apart:.2f} in separation{stops}"
    if slip == apart == closed == 0:
        states = "full stick throughout, which says nothing of friction"
    name = f"{curve['point'].values[point]} {curve['axis'].values[axis]}"
    key = curve.attrs.get("along", "frequency")
    where = with_unit(f"{place:.6g}" if key == "frequency" else f"{key} = {place:.6g}", units)
    where += ", an end of the curve" if place in along[[0, -1]] else ""
    known = np.isfinite(curve["floquet_max"].values)
    only = "" if known.all() else f"{' in part' * bool(known.any())} by folds alone"
    top = with_unit(f"{height:.5g}", curve["amplitude"].attrs)
    unstable = counted(int(np.sum(~stable & ~fold)), "unstable solution")
    return f"peak {top} of {name} at {where}; {turning}{also}; {unstable}{only}; {states}"


def _first_of(places: Sequence[str], units: Mapping[str, Any]) -> str:
    """The first of some places along the curve, and how many there are beside."""
    *others, last = places[:MOST]
    more = f", and {len(places) - MOST} more" if len(places) > MOST else ""
    return ", ".join([*others, with_unit(last, units)]) + more


def _free_lines(curve: Dataset) -> Iterator[str]:
    """Contacts that stick all along where others work: the balance has chosen one of many motions."""
    slip, apart, rub = curve["slip_share"].values, curve["separation_share"].values, rubs(curve).values
    works = np.any(switches(slip, apart) & (rub | (apart > 0)), axis=1, keepdims=True)
    sticks = rub & (slip == 0) & (apart == 0) & works
    number = sticks.sum(axis=0)
    names = curve["contact"].values[number > 0].tolist()
    one = len(names) == 1
    if names:
        who = f"contact {names[0]} sticks" if one else f"contacts {_first_of(names, {})} stick"
        where = f"at {'' if one else 'up to '}{counted(int(number.max()), 'solution')} at which others work"
        force = "its mean force is" if one else "their mean forces are"
        yield f"{who} all the time {where}: {force} not unique, and the motion may depend on {'it' if one else 'them'}"


def convergence_lines(refined: Convergence) -> list[str]:
    """How the answer depends on harmonics and time samples."""
    if not refined.count:
        return ["convergence: no stable solution slips or separates, so harmonics and samples change nothing"]
    lost = ", ".join(f"{counted(count, 'solution')} with {name}" for name, count in refined.lost.items())
    return [
        f"convergence of {counted(refined.count, 'solution')} with slip or separation, change from the finest: "
        + _listed(refined.harmonics, refined.with_harmonics, "harmonics"),
        _listed(refined.time_samples, refined.with_samples, "time samples"),
        *([f"not found: {lost}"] if lost else []),
    ]


def _listed(numbers: np.ndarray, changes: np.ndarray, name: str) -> str:
    parts = ", ".join(f"{int(n)}: {change:.1e}" for n, change in zip(numbers[:-1], changes[:-1], strict=True))
    order = order_of(numbers, changes)
    seen = f"order {order:.1f}" if np.isfinite(order) else "no order yet"
    return f"{name} {parts} ({seen}, and the finest, {int(numbers[-1])}, moved it by {changes[-1]:.1e})"


def _beyond(curve: Dataset, unstable: int) -> str:
    """What becomes of disturbances of a solution, which is that of a curve next to a change of stability."""
    if not curve["floquet_max"].values[unstable] > BORDER:
        return ""
    phase = curve["floquet_phase_deg"].values[unstable]
    if REAL < phase < 180 - REAL:
        return " (a second frequency joins)"
    return " (the period doubles)" if phase > REAL else " (a real multiplier passes 1)"


def changes_of_stability(stable: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Solutions after which a curve gains or loses its stability though it does not turn, shape (S,)."""
    changes = np.zeros(stable.size, dtype=bool)
    changes[:-1] = (stable[1:] != stable[:-1]) & ~fold[1:] & ~fold[:-1]
    return changes


def peak(parameter: np.ndarray, height: np.ndarray, motion: np.ndarray) -> tuple[float, float]:
    """Parameter and value of the largest height of solutions, shape (S,), by a parabola along the curve.

    ``motion``: of the solutions, for the arc length between them, shape (S, ...).
    """
    i = int(np.argmax(height))
    if not 0 < i < height.size - 1:
        return float(parameter[i]), float(height[i])
    rows = slice(i - 1, i + 2)
    near, p = motion[rows].reshape(3, -1), parameter[rows]
    ways = np.linalg.norm(np.diff(near, axis=0), axis=1) / (np.linalg.norm(near[1]) or 1.0)
    steps = np.hypot(np.diff(p) / np.ptp(parameter), ways)
    s = np.array([-steps[0], 0.0, steps[1]])
    bend, slope, middle = np.polyfit(s, height[rows], 2)
    top = float(np.clip(-slope / (2 * bend), s[0], s[2])) if bend < 0 else 0.0
    return float(np.polyval(np.polyfit(s, p, 2), top)), float(np.polyval([bend, slope, middle], top))
