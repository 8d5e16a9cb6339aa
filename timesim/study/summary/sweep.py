"""The summary of a sweep, in words, from its finished result: states, peaks, what is unusual, jumps, failures."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.orbit.jump import suspects
from timesim.orbit.steady_state import SAME
from timesim.orbit.threshold import LONGEST, UNSTABLE
from timesim.result.coordinate import over_keys, place_of_largest, runs
from timesim.result.label import axis_value, counted, first_few, in_words, with_unit
from timesim.study.outcome import DOUBT, took
from timesim.study.summary.transient import largest_step

LINES = 12  # lines on peaks, on ranges with two motions, or on folds
POINTS = 5  # failed points, or spans of points, that are named
SHARP = 0.5  # of a peak: where a point beside it is lower, they do not tell how high it is


def number_of_states(data: Dataset) -> int:
    """Points of a sweep whose motion settled."""
    return int(np.count_nonzero(data["settled"].values == 1))


def sweep_lines(data: Dataset) -> Iterator[str]:
    """The summary of a sweep: its steady states, peaks and jumps."""
    states, cycles = counted(number_of_states(data), "steady state"), counted(data["cycles"].values.sum(), "cycle")
    yield f"{states} by {data.attrs['method']} {took(data.attrs)}, {cycles}"
    yield from peak_lines(data)
    yield from unusual_lines(data)
    yield from jump_lines(data)
    yield from anew_lines(data)


def peak_lines(data: Dataset) -> Iterator[str]:
    """The largest amplitude for each set of values, and the direction that has it where another one has not.

    It is that of a point. Where those beside it are far lower, the response between them may be far higher.
    """
    amplitude, count = np.nan_to_num(data["amplitude"].values, nan=-1.0), data.sizes["frequency"]
    lines = []
    for place in np.ndindex(amplitude.shape[:-4]):
        own = amplitude[place]
        direction, at, *_ = map(int, np.unravel_index(np.argmax(own), own.shape))
        point, axis = place_of_largest(own[direction, at])
        top = own[direction, at, point, axis]
        if top < 0:
            continue
        label = in_words({key: float(data[key].values[i]) for key, i in zip(over_keys(data), place, strict=True)}, ": ")
        height = with_unit(f"{top:.5g}", data["amplitude"].attrs)
        name = f"{data['point'].values[point]} {data['axis'].values[axis]}"
        highest = own[..., point, axis].max(axis=1)
        alone = highest.min(where=highest >= 0, initial=top) < (1 - SAME) * top
        way = f", direction {data['direction'].values[direction]}" if alone else ""
        end = ", not settled" if data["settled"].values[place][direction, at] != 1 else ""
        end += ", an end of the frequencies" if count > 1 and at in (0, count - 1) else ""
        beside = own[direction, max(at - 1, 0) : at + 2, point, axis]
        lowest = beside.min(where=beside >= 0, initial=top)
        if count > 1 and lowest < SHARP * top and not _jumps_beside(data, (*place, direction), at):
            end += f"; beside it {lowest / top:.0%} of that: between the points it may be far higher"
        done = np.count_nonzero(own[direction, :, point, axis] >= 0)
        end += f"; of {done} of {counted(count, 'point')}, the others are missing" if done < count else ""
        what, frequency = "peak" if count > 1 else "amplitude", axis_value(data["frequency"].values[at])
        lines.append(f"{label}{what} {height} of {name} at {frequency} Hz{way}{end}")
    yield from first_few(lines, LINES, lambda left: f"and {counted(left, 'more peak')}, all in the result file")


def _jumps_beside(data: Dataset, chain: tuple[int, ...], at: int) -> bool:
    """Whether a jump that is located lies in a step beside a point."""
    low, high = (data[name].values[chain] for name in ("jump_low", "jump_high"))
    near = data["frequency"].values[max(at - 1, 0) : at + 2]
    return bool(data.attrs.get("jumps_bisected", 0) and np.any((low >= near[0]) & (high <= near[-1])))


def unusual_lines(data: Dataset) -> Iterator[str]:
    """Points of a sweep whose motion repeats after several cycles, is less exact than asked for, or never settles."""
    done, settled = np.isfinite(data["amplitude"].values).all(axis=(-2, -1)), data["settled"].values == 1
    several, irregular, left = data["period"].values > 1, data["irregular"].values == 1, data["settled_to"]
    if several.any():
        points = counted(several.sum(), "of them repeats", "of them repeat")
        yield f"{points} after more than one cycle (variable period): {_spans(data, several)}"
    vague = settled & (left.values > data.attrs["settle_tolerance"])
    if vague.any():
        points = f"{counted(vague.sum(), 'of them is', 'of them are')} settled to {left.values[vague].max():.1e}"
        why = "which is below what the noise of the steps allows (variable settled_to)"
        yield f"{points}, not to settle.tolerance, {why}"
    unknown = settled & np.isnan(data["floquet_max"].values)
    if unknown.any():
        yield f"the multipliers overflow, so stability is not known (floquet_max = NaN): {_spans(data, unknown)}"
    unstable = settled & (data["floquet_max"].values > UNSTABLE)
    if unstable.any():
        points = counted(unstable.sum(), "of them is unstable", "of them are unstable")
        yield f"{DOUBT}{points}, and would be left after a disturbance (floquet_max above 1): {_spans(data, unstable)}"
    if irregular.any():
        points = counted(irregular.sum(), "point does", "points do")
        kind = "the motion is quasi-periodic or irregular (irregular = 1, with the band of its amplitude)"
        yield f"{points} not repeat after up to {LONGEST} cycles: {kind}: {_spans(data, irregular)}"
    way = np.abs(np.nan_to_num(data["drift"].values))
    drifts = way.any(axis=(-2, -1))
    if drifts.any():
        points, moved = counted(drifts.sum(), "point drifts", "points drift"), largest_step(data["drift"], way)
        yield f"{points}, {moved} a cycle, as nothing holds the body (variable drift): {_spans(data, drifts)}"
    lost = done & ~settled & ~irregular
    if lost.any():
        shown = "(settled = 0, with the band of the amplitude)"
        yield f"{DOUBT}{counted(lost.sum(), 'point')} did not settle in settle.max_cycles {shown}: {_spans(data, lost)}"


def jump_lines(data: Dataset) -> Iterator[str]:
    """The jumps of a sweep, or without bisection the steps of frequency over which its amplitude changes most."""
    bisected = data.attrs.get("jumps_bisected", 1)
    ends = np.stack([data["jump_low"].values, data["jump_high"].values], axis=-1)
    for place in map(tuple, np.argwhere(np.isfinite(ends[..., 0]))):
        low, high = ends[place]
        what = "the motion jumps" if bisected else "the amplitude changes steeply"
        hint = "" if bisected else ", over a slope or a jump: study.refine tells which"
        if bisected and np.isin((low, high), data["frequency"].values).all():
            hint = ", a whole step: in shorter ones the motion is not lost within it, or could not be computed"
        yield f"{_chain(data, place[:-1])}{what} between {low:.8g} and {high:.8g} Hz{hint}"
    known, whole = np.isfinite(data["amplitude"].values), data.attrs.get("complete", 1)
    if whole and data.attrs.get("jumps_bisected") and known.any() and not np.isfinite(ends).any():
        where = "no jump" if known.all() else "no jump between the points that were computed"
        yield f"{where}: the amplitude changes along slopes only, as shorter steps show"


def anew_lines(data: Dataset) -> Iterator[str]:
    """The steps over which the amplitude stands out where each point starts anew: another motion may go on there."""
    if data["direction"].values.tolist() != ["independent"]:
        return
    amplitude, lines = data["amplitude"].values, []
    for place in np.ndindex(amplitude.shape[:-3]):
        for k in suspects(amplitude[place].reshape(data.sizes["frequency"], -1)):
            low, high = data["frequency"].values[k : k + 2]
            lines.append(f"{_chain(data, place)}the amplitude changes steeply between {low:.8g} and {high:.8g} Hz")
    why = ", over a slope or a jump: as each point starts anew, study.direction: both tells of another motion"
    yield from first_few([line + why for line in lines], LINES, lambda left: f"and over {counted(left, 'more step')}")


def failure_line(data: Dataset) -> str | None:
    """How many points failed, and the first of them with their reasons; None if none did."""
    dims, reason = data["failure"].dims, data["failure"].values
    failed = np.argwhere(reason != "")
    if not failed.size:
        return None
    named = [f"{', '.join(_where(data, dims, place))}: {reason[place]}" for place in map(tuple, failed)]
    listed = first_few(named, POINTS, lambda left: f"and {left} more, all in the variable failure")
    return f"{len(failed)} of {counted(reason.size, 'point')} failed: {'; '.join(listed)}"


def _spans(data: Dataset, chosen: np.ndarray) -> str:
    """The ranges of frequency of chosen points, for each chain that has some."""
    spans = []
    for place in map(tuple, np.argwhere(chosen.any(axis=-1))):
        rows = runs(data["frequency"].values, chosen[place])
        named = [f"at {row[0]:g} Hz" if row.size == 1 else f"between {row[0]:g} and {row[-1]:g} Hz" for row in rows]
        few = first_few(named, POINTS, lambda left: f"and in {left} more ranges")
        spans.append(_chain(data, place) + ", ".join(few))
    return "; ".join(first_few(spans, POINTS, lambda left: f"and in {counted(left, 'more row')} of the result"))


def _chain(data: Dataset, place: Sequence[int]) -> str:
    """Values that tell a chain from the others, with a colon; empty where there are no others."""
    named = [words for words in _where(data, data["settled"].dims[:-1], place) if words != "direction independent"]
    return f"{', '.join(named)}: " if named else ""


def _where(data: Dataset, dims: Sequence[Any], place: Sequence[int]) -> list[str]:
    """Values along some axes."""
    return [f"{dim} {axis_value(data[dim].values[i])}" for dim, i in zip(dims, place, strict=True)]
