"""The verdict on two methods, in words, from the finished results of a sweep and of the harmonic balance."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from xarray import Dataset

from timesim.orbit.steady_state import switches
from timesim.result.coordinate import rubs, runs
from timesim.result.label import counted, first_few, in_words
from timesim.scene.study import combinations

# Within this share of a fold's frequency a small error of either method changes the answer much.
NEAR_FOLD = 1e-3
# Differences of the methods relative to the amplitude: up to which they agree, up to which they nearly agree, and from
# which on the cause is looked into.
AGREE, NEARLY, WORTH_ASKING = 2e-3, 2e-2, 5e-4
# Share of the period for which a contact that has crept up to its cone may slip by rounding.
SHAKEN_DOWN = 1e-5
# Share of the largest amplitude below which the verdict says that its difference is that of an axis that hardly moves.
HARDLY = 0.05
ANOTHER_OFFSET = "a contact that sticks all the time keeps another free offset"
RANGES = 5  # ranges of frequency that are named for each set of values


@dataclass(frozen=True)
class Points:
    """Points of a sweep compared with the balance: V sets of values, D directions, F frequencies [Hz].

    Attributes:
        values: of the further axes, for each set.
        frequency: [Hz], shape (F,).
        difference: largest absolute value of (balance - sweep) / sweep over points and axes, shape (V, D, F), like all
            that follow.
        name, share: point and axis of that value, and its amplitude as a share of the largest.
        solved, followed: whether the balance has a stable solution there; whether it came to its end.
        settled, doubled: whether the motion repeats after one cycle, after several.
        irregular: whether it never repeats.
        drifts: whether it repeats but for the way by which the body slides on.
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
    name: np.ndarray
    share: np.ndarray
    solved: np.ndarray
    followed: np.ndarray
    settled: np.ndarray
    doubled: np.ndarray
    irregular: np.ndarray
    drifts: np.ndarray
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


def compared_points(sweep: Dataset, hbm: Dataset, relative_difference: np.ndarray, whole: np.ndarray) -> Points:
    """The points, from both results and their difference on the axes of the sweep's amplitude.

    ``whole``: whether the curves of each set of values came to their end.
    """
    axes = {str(key): tuple(sweep[key].values) for key in sweep["settled"].dims[:-2]}
    values, frequency = list(combinations(axes)), sweep["frequency"].values
    shape = (len(values), sweep.sizes["direction"], frequency.size)
    difference = np.abs(relative_difference).reshape(*shape, -1)
    period, settled = (sweep[name].values.reshape(shape) for name in ("period", "settled"))
    drifts = (np.nan_to_num(sweep["drift"].values) != 0).any(axis=(-2, -1)).reshape(shape)
    slip, apart = (sweep[f"{name}_share"].values.reshape(*shape, -1) for name in ("slip", "separation"))
    size = np.nan_to_num(sweep["amplitude"].values).reshape(*shape, -1)
    most = np.argmax(np.nan_to_num(difference, nan=-1.0), axis=-1, keepdims=True)
    names = np.array([f"{point} {axis}" for point in sweep["point"].values for axis in sweep["axis"].values])
    near_fold, rub = np.zeros(shape, dtype=bool), rubs(sweep).values
    for v, own in enumerate(values):
        here = np.all([hbm["fold"].values > 0, *(hbm[key].values == value for key, value in own.items())], axis=0)
        far = np.abs(frequency[:, None] - hbm["frequency"].values[here])
        near_fold[v] = (far < NEAR_FOLD * frequency[:, None]).any(axis=1)
    return Points(
        values=values,
        frequency=frequency,
        difference=difference.max(axis=-1, initial=0.0, where=np.isfinite(difference)),
        name=names[most[..., 0]],
        share=np.take_along_axis(size, most, axis=-1)[..., 0] / np.maximum(size.max(axis=-1), np.finfo(float).tiny),
        solved=np.isfinite(difference).any(axis=-1),
        followed=np.broadcast_to(whole[:, None, None], shape),
        settled=(settled > 0) & (period == 1) & ~drifts,
        doubled=(settled > 0) & (period > 1) & ~drifts,
        irregular=sweep["irregular"].values.reshape(shape) > 0,
        drifts=drifts,
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
        where = f"at {counted(linear.sum(), 'point')} every contact sticks, or stays apart, all the time"
        but = "but the motion is linear there, which proves nothing of the contacts"
        yield f"{where}: they differ by at most {size[linear].max():.1e}, {but}"
    if close.any():
        near = counted(close.sum(), "point")
        yield f"at {near} within {NEAR_FOLD:g} of a fold's frequency they differ by up to {size[close].max():.1e}"
    if points.other_offset.any():
        number, most = counted(points.other_offset.sum(), "point"), size[points.other_offset].max()
        stays = "time integration that begins from the balance's motion stays there"
        places = _places(points, points.other_offset)
        yield f"at {number} they differ by up to {most:.1e} because {ANOTHER_OFFSET}: {stays}: {places}"
    unsettled = ~(points.settled | points.doubled | points.irregular | points.drifts | points.missing)
    none = points.settled & ~points.solved & points.followed
    for left_out, why in (
        (none & ~points.sticks, "the balance has no stable solution"),
        (none & points.sticks, f"the balance has no stable solution, perhaps only because {ANOTHER_OFFSET} there"),
        (points.settled & ~points.solved & ~points.followed, "the balance has no solution, as it did not get there"),
        (points.doubled, "the motion repeats after several cycles, which the balance cannot show"),
        (points.irregular, "the motion does not repeat, being quasi-periodic or irregular, and is left out"),
        (points.drifts, "the body drifts, as nothing holds it, which the balance cannot show"),
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
    slip, apart = points.slip[place], points.separation[place]
    shares = f"a contact {slip:.2f} of the cycle in slip, one {apart:.2f} in separation"
    if points.share[place] < HARDLY:
        shares = f"along {points.name[place]}, which moves {points.share[place]:.1e} of the largest amplitude, {shares}"
    means = f"{points.slip[judged].mean():.2f} and {points.separation[judged].mean():.2f}"
    where = f"at {counted(judged.sum(), 'point')} with slip, or contact for a part of the cycle"
    spread = f"(median {np.median(size[judged]):.1e}, mean shares {means})"
    most = f"most at {points.frequency[place[2]]:g} Hz{f' with {values}' if values else ''}, {shares}{advice}"
    return f"the methods {word}: {where}, they differ by at most {worst:.1e} of the amplitude {spread}; {most}"


def _places(points: Points, chosen: np.ndarray) -> str:
    """The ranges of frequency of chosen points, for each set of values."""
    parts = []
    for values, own in zip(points.values, chosen, strict=True):
        rows = runs(points.frequency, own.any(axis=0))
        spans = [f"{row[0]:g} Hz" if row.size == 1 else f"{row[0]:g} to {row[-1]:g} Hz" for row in rows]
        if spans:
            listed = first_few(spans, RANGES, lambda left: f"and {left} more")
            parts.append(in_words(values, " at ") + ", ".join(listed))
    return "; ".join(parts)
