"""The summaries of harmonic balance, and of its comparison with a sweep, in words, from the finished results."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from xarray import Dataset

from timesim.hbm.convergence import Convergence, order_of
from timesim.hbm.curve import changes_of_stability, peak
from timesim.orbit.steady_state import switches
from timesim.result.coordinate import over_keys, rubs
from timesim.result.label import counted, in_words, with_unit
from timesim.scene.study import combinations
from timesim.study.outcome import took

# Within this share of a fold's frequency a small error of either method changes the answer much.
NEAR_FOLD = 1e-3
# Differences of the methods relative to the amplitude: up to which they agree, up to which they nearly agree, and from
# which on the cause is looked into.
AGREE, NEARLY, WORTH_ASKING = 2e-3, 2e-2, 5e-4
# Share of the period for which a contact that has crept up to its cone may slip by rounding.
SHAKEN_DOWN = 1e-5


def curve_lines(data: Dataset, notes: Sequence[str]) -> Iterator[str]:
    """Response curves: how many, notes of the study, each curve, and whether harmonics and samples suffice."""
    numbers, attrs = np.unique(data["curve"].values), data.attrs
    solutions, curves = counted(data.sizes["solution"], "solution"), counted(numbers.size, "curve")
    yield f"{solutions} on {curves} by {attrs['method']} {took(attrs)}"
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
    point, axis = np.unravel_index(np.argmax(amplitude.max(axis=0)), amplitude.shape[1:])
    motion = np.stack([curve["harmonic_cos"].values, curve["harmonic_sin"].values], axis=1)
    place, height = peak(along, amplitude[:, point, axis], motion)
    folds = ", ".join(f"{p:.6g}" for p in along[fold])
    turning = f"folds at {folds}" if folds else "no fold"
    changes = ", ".join(f"{p:.6g}" for p in along[changes_of_stability(stable, fold)])
    also = f"; stability changes at {changes} without a fold" if changes else ""
    touching, apart = curve["slip_share"].values, curve["separation_share"].values.max(initial=0.0)
    rub = rubs(curve).values
    slip, closed = (touching[:, own].max(initial=0.0) for own in (rub, ~rub))
    stops = f", a stop closed for {closed:.2f}" if closed else ""
    states = f"at most {slip:.2f} of a period in slip, {apart:.2f} in separation{stops}"
    if slip == apart == closed == 0:
        states = "full stick throughout, which says nothing of friction"
    name = f"{curve['point'].values[point]} {curve['axis'].values[axis]}"
    where = with_unit(f"{place:.6g}", curve[curve.attrs.get("along", "frequency")].attrs)
    return (
        f"peak {with_unit(f'{height:.5g}', curve['amplitude'].attrs)} of {name} at {where}; {turning}{also}; "
        f"{counted(int(np.sum(~stable & ~fold)), 'unstable solution')}; {states}"
    )


def _free_lines(curve: Dataset) -> Iterator[str]:
    """Contacts that stick all along where others work: the balance has chosen one of many motions."""
    slip, apart, rub = curve["slip_share"].values, curve["separation_share"].values, rubs(curve).values
    works = np.any(switches(slip, apart) & (rub | (apart > 0)), axis=1, keepdims=True)
    sticks = rub & (slip == 0) & (apart == 0) & works
    for name, number in zip(curve["contact"].values, sticks.sum(axis=0), strict=True):
        if number:
            where = f"at {counted(int(number), 'solution')} at which others work"
            freedom = "its mean force is not unique, and the motion may depend on it"
            yield f"contact {name} sticks all the time {where}: {freedom}"


def convergence_lines(refined: Convergence) -> list[str]:
    """How the answer depends on harmonics and time samples."""
    if not refined.count:
        return ["convergence: no stable solution slips or separates, so harmonics and samples change nothing"]
    lost = ", ".join(f"{count} with {name}" for name, count in refined.lost.items())
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


@dataclass(frozen=True)
class Points:
    """Points of a sweep compared with the balance: V sets of values, D directions, F frequencies [Hz].

    Attributes:
        values: of the further axes, for each set.
        frequency: [Hz], shape (F,).
        difference: largest absolute value of (balance - sweep) / sweep over points and axes, shape (V, D, F), like all
            that follow.
        solved, followed: whether the balance has a stable solution there; whether it came to its end.
        settled, doubled: whether the motion repeats after one cycle, after several.
        irregular: whether it never repeats.
        linear: whether no contact slips, or opens within the cycle.
        near_fold: whether a fold of the balance is near.
        slip, separation: largest share of a period in the state, over the contacts.
        sticks: whether a contact sticks all the time.
        other_offset: whether the methods differ only because that contact keeps another offset.
        missing: whether the sweep has no motion there.
    """

    values: Sequence[Mapping[str, float]]
    frequency: np.ndarray
    difference: np.ndarray
    solved: np.ndarray
    followed: np.ndarray
    settled: np.ndarray
    doubled: np.ndarray
    irregular: np.ndarray
    linear: np.ndarray
    near_fold: np.ndarray
    slip: np.ndarray
    separation: np.ndarray
    sticks: np.ndarray
    other_offset: np.ndarray
    missing: np.ndarray

    @property
    def judged(self) -> np.ndarray:
        """Points that prove something of the contacts, away from folds, shape (V, D, F)."""
        return self.settled & self.solved & ~self.linear & ~self.near_fold & ~self.other_offset

    @property
    def doubtful(self) -> np.ndarray:
        """Judged points whose difference may be due to the offset of a contact that sticks, shape (V, D, F)."""
        return self.judged & self.sticks & (self.difference > WORTH_ASKING)

    @property
    def worst(self) -> tuple[int, int, int] | None:
        """The judged point where the methods differ most."""
        if not self.judged.any():
            return None
        place = np.argmax(np.where(self.judged, self.difference, -1.0))
        v, d, f = (int(i) for i in np.unravel_index(place, self.difference.shape))
        return v, d, f


def compared_points(sweep: Dataset, hbm: Dataset, relative_difference: np.ndarray) -> Points:
    """The points, from both results and their difference on the axes of the sweep's amplitude."""
    axes = {str(key): tuple(sweep[key].values) for key in sweep["settled"].dims[:-2]}
    values, frequency = list(combinations(axes)), sweep["frequency"].values
    shape = (len(values), sweep.sizes["direction"], frequency.size)
    difference = np.abs(relative_difference).reshape(*shape, -1)
    period, settled = (sweep[name].values.reshape(shape) for name in ("period", "settled"))
    slip, apart = (sweep[f"{name}_share"].values.reshape(*shape, -1) for name in ("slip", "separation"))
    near_fold, rub = np.zeros(shape, dtype=bool), rubs(sweep).values
    for v, own in enumerate(values):
        here = np.all([hbm["fold"].values > 0, *(hbm[key].values == value for key, value in own.items())], axis=0)
        far = np.abs(frequency[:, None] - hbm["frequency"].values[here])
        near_fold[v] = (far < NEAR_FOLD * frequency[:, None]).any(axis=1)
    return Points(
        values=values,
        frequency=frequency,
        difference=difference.max(axis=-1, initial=0.0, where=np.isfinite(difference)),
        solved=np.isfinite(difference).any(axis=-1),
        followed=np.full(shape, hbm.attrs["complete"] > 0),
        settled=(settled > 0) & (period == 1),
        doubled=(settled > 0) & (period > 1),
        irregular=sweep["irregular"].values.reshape(shape) > 0,
        linear=np.logical_not(switches(slip * rub, apart).any(axis=-1)),
        near_fold=near_fold,
        slip=slip[..., rub].max(axis=-1, initial=0.0),
        separation=apart.max(axis=-1, initial=0.0),
        sticks=((slip + apart < SHAKEN_DOWN) & rub).any(axis=-1),
        other_offset=np.zeros(shape, dtype=bool),
        missing=~np.isfinite(sweep["amplitude"].values).all(axis=(-2, -1)).reshape(shape),
    )


def comparison_lines(points: Points) -> Iterator[str]:
    """The verdict, with a line for each kind of points."""
    size, seen = points.difference, points.settled & points.solved
    if points.judged.any():
        yield _judgement(points)
    else:
        yield "no point is left where a contact slips or opens within the cycle: nothing is proven of the contacts"
    linear, close = seen & points.linear, seen & ~points.linear & points.near_fold
    if linear.any():
        yield (
            f"at {counted(linear.sum(), 'point')} every contact sticks, or stays apart, all the time: they differ by "
            f"at most {size[linear].max():.1e}, but the motion is linear there, which proves nothing of the contacts"
        )
    if close.any():
        near = counted(close.sum(), "point")
        yield f"at {near} within {NEAR_FOLD:g} of a fold's frequency they differ by up to {size[close].max():.1e}"
    if points.other_offset.any():
        number, most = counted(points.other_offset.sum(), "point"), size[points.other_offset].max()
        yield (
            f"at {number} they differ by up to {most:.1e} because a contact that sticks all the time keeps another "
            "offset, which is free: time integration that begins from the balance's motion stays there: "
            f"{_places(points, points.other_offset)}"
        )
    unsettled = ~(points.settled | points.doubled | points.irregular | points.missing)
    for left_out, why in (
        (points.settled & ~points.solved & points.followed, "the balance has no stable solution"),
        (points.settled & ~points.solved & ~points.followed, "the balance has no solution, as it ended before"),
        (points.doubled, "the motion repeats after several cycles, which the balance cannot show"),
        (points.irregular, "the motion does not repeat, being quasi-periodic or irregular, and is left out"),
        (unsettled, "the motion did not settle and is left out"),
        (points.missing, "the sweep has no motion, having failed or ended before"),
    ):
        if left_out.any():
            yield f"at {counted(left_out.sum(), 'point')} {why}: {_places(points, left_out)}"


def _judgement(points: Points) -> str:
    place, judged, size = points.worst, points.judged, points.difference
    assert place is not None
    worst, values = float(size[place]), in_words(points.values[place[0]])
    word = "agree" if worst <= AGREE else "nearly agree" if worst <= NEARLY else "differ"
    advice = "" if worst <= AGREE else "; study.convergence: true tells whether more harmonics would help"
    shares = (
        f"a contact {points.slip[place]:.2f} of the cycle in slip, one {points.separation[place]:.2f} in separation"
    )
    means = f"{points.slip[judged].mean():.2f} and {points.separation[judged].mean():.2f}"
    return (
        f"the methods {word}: at {counted(judged.sum(), 'point')} with slip, or contact for a part of the cycle, they "
        f"differ by at most {worst:.1e} of the amplitude (median {np.median(size[judged]):.1e}, mean shares {means}); "
        f"most at {points.frequency[place[2]]:g} Hz{f' with {values}' if values else ''}, {shares}{advice}"
    )


def _places(points: Points, chosen: np.ndarray) -> str:
    """The ranges of frequency of chosen points, for each set of values."""
    parts = []
    for values, own in zip(points.values, chosen, strict=True):
        at = points.frequency[own.any(axis=0)]
        if at.size:
            span = f"{at[0]:g} Hz" if at.size == 1 else f"{at[0]:g} to {at[-1]:g} Hz"
            parts.append(in_words(values, " at ") + span)
    return "; ".join(parts)
