"""The summaries of studies by time integration, in words, from their finished results."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.model.promise import MARGIN, tightened
from timesim.model.solver import Solver
from timesim.orbit.basin import ANOTHER, IRREGULAR, LOWER, NONE, UPPER, unique
from timesim.orbit.steady_state import SAME
from timesim.orbit.threshold import LONGEST
from timesim.orbit.two_motions import LARGER, NO_MOTION, SMALLER
from timesim.result.coordinate import over_keys
from timesim.result.label import axis_value, counted, first_few, in_words, with_unit
from timesim.scene.transient import Schedule
from timesim.study.drift import largest_step, step_of_points
from timesim.study.outcome import took

MOTIONS = ("smaller", "larger")
PHASES = 12  # of a schedule at most that are listed
POINTS = 5  # failed points, or spans of points, that are named
SHARP = 0.5  # of a peak: where a point beside it is lower, they do not tell how high it is
TIE = 1e-7  # relative difference of peaks up to which they are equal: the accuracy of the time integration
LINES = 12  # lines on peaks, on ranges with two motions, or on folds


def transient_lines(data: Dataset, plan: Schedule) -> Iterator[str]:
    """A run: its size, how well its energy balance closes, and the phases of its schedule unless they are many.

    Of each phase it gives the amplitude at the end, of the point and axis that move most during the run.
    """
    attrs, amplitude = data.attrs, data["cycle_amplitude"].values
    whole, transitions = counted(len(amplitude), "cycle"), counted(data.sizes["event"], "transition")
    yield f"{whole} by {attrs['method']} {took(attrs)}, {transitions}"
    if not len(amplitude):
        return
    largest = max(np.max(np.abs(data["energy_input"].values)), attrs["peak_stored_energy"])
    residual = np.max(np.abs(data["energy_residual"].values)) / largest if largest > 0 else 0.0
    yield f"energy balance of a cycle closes to {residual:.1e} of the larger of input and stored energy"
    if "estimated_error" in attrs:
        yield from error_lines(data)
    if not 1 < len(plan.phases) <= PHASES:
        return
    _, point, axis = np.unravel_index(np.argmax(amplitude), amplitude.shape)
    name = f"{data['point'].values[point]} {data['axis'].values[axis]}"
    ends = np.cumsum([cycles for _, cycles in plan.phases])
    for number, ((frequency, cycles), end) in enumerate(zip(plan.phases, ends, strict=True), 1 - plan.run_up):
        if end <= len(amplitude):
            which = f"phase {number}" if number > 0 else "run-up"
            reached = with_unit(f"{amplitude[end - 1, point, axis]:.6g}", data["cycle_amplitude"].attrs)
            size = f"amplitude {reached} of {name} at its end"
            yield f"{which}: {counted(cycles, 'cycle')} at {frequency:.6g} Hz, {size}"


def error_lines(data: Dataset) -> Iterator[str]:
    """The estimated error of a run, and the tolerances that might keep its promise if it has not."""
    attrs = data.attrs
    error, remark, promise = attrs["estimated_error"], attrs["estimate_remark"], attrs.get("promised_error", np.inf)
    if not np.isfinite(error):
        yield f"estimated error of the state at the end: not known, {remark}"
        return
    largest = float(data["cycle_amplitude_error"].max())
    sizes = f"{error:.1e} of its size, of the amplitude of a cycle at most {largest:.1e}"
    yield f"estimated error of the state at the end: {sizes}{f' ({remark})' if remark else ''}"
    if error <= promise:
        return
    now = Solver(attrs["method"].partition(",")[0], attrs.get("rtol", 0.0), attrs.get("atol", 0.0))
    better = tightened(now, promise / (MARGIN * error))
    over = f"warning: that is more than the {promise:.0e} that the accuracy promises"
    if "repetition" in attrs:
        yield f"{over}; a repetition with finer tolerances did not reach the end"
    elif better.rtol == now.rtol:
        yield f"{over}, and rounding allows no finer tolerance: the motion amplifies any error"
    else:
        yield f"{over}; try solver: {{method: {now.name}, rtol: {better.rtol:g}, atol: {better.atol:g}}}"


def number_of_states(data: Dataset) -> int:
    """Steady states of a sweep that could be computed."""
    return int(np.isfinite(data["amplitude"].values).all(axis=(-2, -1)).sum())


def sweep_lines(data: Dataset) -> Iterator[str]:
    """The summary of a sweep: its steady states, peaks and jumps."""
    states, cycles = counted(number_of_states(data), "steady state"), counted(data["cycles"].values.sum(), "cycle")
    yield f"{states} by {data.attrs['method']} {took(data.attrs)}, {cycles}"
    yield from peak_lines(data)
    yield from unusual_lines(data)
    yield from jump_lines(data)


def peak_lines(data: Dataset) -> Iterator[str]:
    """The largest amplitude for each set of values, and the direction of the sweep that has it where the other has not.

    It is that of a point. Where those beside it are far lower, the response between them may be far higher.
    """
    amplitude, count = np.nan_to_num(data["amplitude"].values, nan=-1.0), data.sizes["frequency"]
    lines = []
    for place in np.ndindex(amplitude.shape[:-4]):
        own = amplitude[place]
        direction, at, point, axis = map(int, np.unravel_index(np.argmax(own), own.shape))
        top = own[direction, at, point, axis]
        if top < 0:
            continue
        label = in_words({key: float(data[key].values[i]) for key, i in zip(over_keys(data), place, strict=True)}, ": ")
        height = with_unit(f"{top:.5g}", data["amplitude"].attrs)
        name = f"{data['point'].values[point]} {data['axis'].values[axis]}"
        alone = own[..., point, axis].max(axis=1).min() < (1 - SAME) * top
        way = f", direction {data['direction'].values[direction]}" if alone else ""
        end = ", an end of the frequencies" if count > 1 and at in (0, count - 1) else ""
        beside = own[direction, max(at - 1, 0) : at + 2, point, axis]
        if count > 1 and beside.min() < SHARP * top:
            end += f"; beside it {beside.min() / top:.0%} of that: between the points it may be far higher"
        what, frequency = "peak" if count > 1 else "amplitude", axis_value(data["frequency"].values[at])
        lines.append(f"{label}{what} {height} of {name} at {frequency} Hz{way}{end}")
    yield from first_few(lines, LINES, lambda left: f"and {counted(left, 'more peak')}, all in the result file")


def unusual_lines(data: Dataset) -> Iterator[str]:
    """Points of a sweep whose motion repeats after several cycles, is less exact than asked for, or never settles."""
    done, settled = np.isfinite(data["amplitude"].values).all(axis=(-2, -1)), data["settled"].values == 1
    several, irregular, left = int(np.sum(data["period"].values > 1)), data["irregular"].values == 1, data["settled_to"]
    if several:
        yield f"{counted(several, 'of them repeats', 'of them repeat')} after more than one cycle (variable period)"
    vague = settled & (left.values > data.attrs["settle_tolerance"])
    if vague.any():
        yield (
            f"{counted(vague.sum(), 'of them is', 'of them are')} settled to {left.values[vague].max():.1e}, not to "
            "settle.tolerance, which is below what the noise of the steps allows (variable settled_to)"
        )
    if irregular.any():
        points = counted(irregular.sum(), "point does", "points do")
        yield (
            f"{points} not repeat after up to {LONGEST} cycles: the motion is quasi-periodic or irregular "
            f"(irregular = 1, with the band of its amplitude): {_spans(data, irregular)}"
        )
    step = step_of_points(data)
    drifts = done & step.any(axis=(-2, -1))
    if drifts.any():
        points, moved = counted(drifts.sum(), "point drifts", "points drift"), largest_step(data["amplitude"], step)
        yield f"{points}, {moved} a cycle: nothing holds the body (settled = 0): {_spans(data, drifts)}"
    lost = done & ~settled & ~irregular & ~drifts
    if lost.any():
        yield (
            f"{counted(lost.sum(), 'point')} did not settle in settle.max_cycles (settled = 0, with the band of the "
            f"amplitude): {_spans(data, lost)}"
        )


def jump_lines(data: Dataset) -> Iterator[str]:
    """The jumps of a sweep, or without bisection the steps of frequency over which its amplitude changes most."""
    bisected = data.attrs.get("jumps_bisected", 1)
    ends = np.stack([data["jump_low"].values, data["jump_high"].values], axis=-1)
    for place in map(tuple, np.argwhere(np.isfinite(ends[..., 0]))):
        low, high = ends[place]
        what = "the motion jumps" if bisected else "the amplitude changes steeply"
        hint = "" if bisected else ", over a slope or a jump: study.refine tells which"
        yield f"{_chain(data, place[:-1])}{what} between {low:.8g} and {high:.8g} Hz{hint}"
    if data.attrs.get("jumps_bisected") and not np.isfinite(ends).any():
        yield "no jump: the amplitude changes along slopes only, as shorter steps show"


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
    """The range of frequency of chosen points, for each chain that has some."""
    spans = []
    for place in map(tuple, np.argwhere(chosen.any(axis=-1))):
        at = data["frequency"].values[chosen[place]]
        span = f"at {at[0]:g} Hz" if at.size == 1 else f"between {at[0]:g} and {at[-1]:g} Hz"
        spans.append(_chain(data, place) + span)
    return "; ".join(first_few(spans, POINTS, lambda left: f"and in {counted(left, 'more row')} of the result"))


def _chain(data: Dataset, place: Sequence[int]) -> str:
    """Values that tell a chain from the others, with a colon; empty where there are no others."""
    named = [words for words in _where(data, data["settled"].dims[:-1], place) if words != "direction independent"]
    return f"{', '.join(named)}: " if named else ""


def _where(data: Dataset, dims: Sequence[Any], place: Sequence[int]) -> list[str]:
    """Values along some axes."""
    return [f"{dim} {axis_value(data[dim].values[i])}" for dim, i in zip(dims, place, strict=True)]


# Ranges with two motions


def bistable_lines(data: Dataset, sweep: Dataset, width: float) -> Iterator[str]:
    """The ranges with two motions, from the root of the result and its sweeps; each end is bisected to a width [Hz]."""
    *keys, jump, _ = data["range"].dims
    lines = []
    for place in np.argwhere(np.isfinite(data["range"].values).all(axis=-1)):
        one = data[dict(zip((*keys, jump), place, strict=True))]
        label = in_words({str(key): float(one[key]) for key in keys}, ": ")
        lines += [label + line for line in _range_lines(one, width)]
    yield from first_few(lines, LINES, lambda left: f"and {counted(left, 'more line')}, all of it in the result file")
    if not lines and data.attrs["complete"]:
        span = sweep["frequency"].values
        yield (
            f"no range with two motions was found from {span[0]:g} to {span[-1]:g} Hz: both sweeps are on one motion "
            f"at all {span.size} frequencies, and no jump is left when a step is bisected"
        )


def _range_lines(one: Dataset, width: float) -> Iterator[str]:
    """A range with two motions."""
    (low, high), smaller, larger = (one[name].values for name in ("range", "amplitude_lower", "amplitude_upper"))
    place = np.unravel_index(np.argmax(larger), larger.shape)
    name = f"{one['point'].values[place[0]]} {one['axis'].values[place[1]]}"
    either = with_unit(f"{smaller[place]:.6g} or {larger[place]:.6g}", one["amplitude_upper"].attrs)
    yield (
        f"two motions from {low:.8g} to {high:.8g} Hz (each end to {width:g} Hz): amplitude of {name} "
        f"{either} at {0.5 * (low + high):.6g} Hz"
    )
    for end in one["end"].values[one["range_cut"].values > 0]:
        yield f"the {end} end of it is that of the search, not of the range: widen frequency"
    for motion, period in zip(MOTIONS, one["period"].values, strict=True):
        if period > 1:
            yield f"the {motion} motion repeats after {period} cycles"
    for end, place, loser in zip(one["end"].values, (low, high), one["range_irregular"].values, strict=True):
        if loser > NO_MOTION:
            motion = {SMALLER: "smaller", LARGER: "larger"}[int(loser)]
            yield (
                f"the {end} end of it is where the {motion} motion loses its period: beyond {place:.8g} Hz it is "
                "quasi-periodic or irregular, and not counted"
            )
    if not one["range_settled"].values.all():
        yield (
            "next to an end of it the motion had not settled after settle.max_cycles, "
            "which may move that end by some of the width"
        )
    if "start_branch" in one:
        yield from _start_lines(one)
        yield from _offset_lines(one, float(max(smaller.max(), larger.max())))


def _start_lines(one: Dataset) -> Iterator[str]:
    """Where the starts at the middle of a range lead."""
    branch = one["start_branch"].values
    count = {side: int(np.sum(branch == side)) for side in (LOWER, UPPER, ANOTHER, IRREGULAR, NONE)}
    rest = ((ANOTHER, "to another motion"), (IRREGULAR, "to one that does not repeat"), (NONE, "did not settle"))
    others = "".join(f", {count[side]} {words}" for side, words in rest if count[side])
    lead = counted(count[LOWER], "leads", "lead")
    yield f"of {branch.size} starts {lead} to the smaller motion, {count[UPPER]} to the larger{others}"
    at_rest = np.flatnonzero(np.isclose(one["share_lower"].values, 0.0))
    if at_rest.size:
        led = {LOWER: "the smaller motion", UPPER: "the larger motion", ANOTHER: "another motion"}
        led |= {IRREGULAR: "a motion that does not repeat"}
        yield f"rest leads to {led.get(int(branch[at_rest[0], at_rest[0]]), 'no settled motion')}"


def _offset_lines(one: Dataset, size: float) -> Iterator[str]:
    """Contacts that stick all the time with an offset that is not unique."""
    low, high = one["offset_low"].values, one["offset_high"].values
    for side, i in np.argwhere(~unique(low, high, size).all(axis=-1)):
        spans = " and ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(low[side, i], high[side, i], strict=True))
        yield (
            f"contact {one['contact'].values[i]} sticks all the time on the {MOTIONS[side]} motion, and its offset is "
            f"not unique: over the starts w is {spans}. The end at which this motion is lost holds for the offset that "
            "the sweep left it with"
        )


def fold_lines(hbm: Dataset, ends: Mapping[tuple[float, ...], np.ndarray], reach: float) -> Iterator[str]:
    """Folds of the balance, to compare with the ends of the ranges, and folds without an end within a reach [Hz].

    ``ends``: of the ranges of each set of values of the further axes.
    """
    frequency, keys, sets = hbm["frequency"].values, over_keys(hbm), dict[tuple[float, ...], list[float]]()
    for place in np.flatnonzero(hbm["fold"].values):
        values = tuple(float(hbm[key].values[place]) for key in keys)
        sets.setdefault(values, []).append(float(frequency[place]))
    for values, turning in list(sets.items())[:LINES]:
        label = in_words(dict(zip(keys, values, strict=True)), ": ")
        yield f"{label}folds of the balance at {', '.join(f'{place:.7g}' for place in sorted(turning))} Hz"
        known = ends.get(values)
        alone = [] if known is None else [fold for fold in turning if np.abs(known - fold).min(initial=np.inf) > reach]
        for fold in sorted(alone):
            yield (
                f"{label}beside the fold at {fold:.7g} Hz, near which no range ends, the balance has motions that no "
                "sweep came to, one of which may be stable: search wider, or from another start"
            )
    if not sets and frequency.size:
        yield f"the branch of the balance has no fold{'' if hbm.attrs['complete'] else ' as far as it was followed'}"


# The least peak


def as_low(peak: np.ndarray, at: int) -> tuple[int, int]:
    """Positions of the first and last of the adjacent peaks that equal one of them; a missing peak ends them."""
    higher = np.flatnonzero(~(peak * (1 - TIE) <= peak[at]))
    return int(higher[higher < at].max(initial=-1)) + 1, int(higher[higher > at].min(initial=len(peak))) - 1


def optimum_lines(data: Dataset, accuracy: float) -> Iterator[str]:
    """The least peak over a scalar, sought to an accuracy."""
    key = str(data["peak"].dims[0])
    values, peak, cycles = data[key].values, data["peak"].values, counted(data["cycles"].values.sum(), "cycle")
    frequencies = counted(data.sizes["frequency"], "frequency", "frequencies")
    yield f"{counted(values.size, 'value')} of {key}, {frequencies} up and down, {cycles}"
    best = float(data["optimum"])
    if not np.isfinite(best):
        return
    at = int(np.flatnonzero(values == best)[0])
    least, value = (
        with_unit(text, data[name].attrs) for text, name in ((f"{peak[at]:.7g}", "peak"), (f"{best:.6g}", key))
    )
    yield f"least peak {least} at {key} = {value}, at {float(data['optimum_frequency']):.6g} Hz"
    beside = [i for value in (best - accuracy, best + accuracy) for i in np.flatnonzero(values == value)]
    first, last = (float(values[place]) for place in as_low(peak, at))
    if data.attrs["complete"] and last - first > 3 * accuracy:
        yield f"the peak is the same from {first:.6g} to {last:.6g}: any value between does as well"
    elif data.attrs["complete"] and beside:
        heights = " and ".join(f"{peak[i]:.7g} at {values[i]:.6g}" for i in beside)
        yield f"an accuracy away the peak is not smaller: {heights}"
    if data.attrs["complete"] and best in (values[0], values[-1]):
        yield f"it is at an end of the range of {key}, so beyond it the peak may be smaller still"
    if data["peak_at_end"].values[at]:
        yield "its peak is at an end of frequency, so beyond it the response may be larger"
    if data["peak_irregular"].values[at]:
        yield f"its motion does not repeat after up to {LONGEST} cycles: it is quasi-periodic or irregular"
    elif not data["peak_settled"].values[at]:
        yield "its motion had not settled in settle.max_cycles"
    yield from unusual_lines(data)
