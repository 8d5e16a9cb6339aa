"""The summary of a search for two motions, in words, from its finished result: ranges, starts, offsets, folds."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from xarray import Dataset

from timesim.orbit.two_motions import LARGER, NO_MOTION, SMALLER
from timesim.orbit.two_motions.basin import ANOTHER, IRREGULAR, LOWER, NONE, UPPER, unique
from timesim.result.coordinate import largest_motion, over_keys
from timesim.result.label import counted, first_few, in_words, with_unit
from timesim.study.summary.sweep import LINES, jump_lines

MOTIONS = ("smaller", "larger")


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
        span, jumps = sweep["frequency"].values, list(jump_lines(sweep))
        none = f"no range with two motions was found from {span[0]:g} to {span[-1]:g} Hz"
        if jumps:
            yield f"{none}: one between jumps is at most {2 * width:g} Hz wide, or has a motion that does not repeat"
            yield from first_few(jumps, LINES, lambda left: f"and {counted(left, 'more jump')}")
        else:
            one_motion = f"both sweeps are on one motion at all {span.size} frequencies"
            wider = "one that begins below it or ends above is not seen: widen frequency to be sure"
            yield f"{none}: {one_motion}, and no jump is left when a step is bisected; {wider}"


def _range_lines(one: Dataset, width: float) -> Iterator[str]:
    """A range with two motions."""
    (low, high), smaller, larger = (one[name].values for name in ("range", "amplitude_lower", "amplitude_upper"))
    shown = largest_motion(one["amplitude_upper"])
    two = (float(one[f"amplitude_{name}"].sel(shown)) for name in ("lower", "upper"))
    either = with_unit(" or ".join(f"{value:.6g}" for value in two), one["amplitude_upper"].attrs)
    middle = f"amplitude of {' '.join(shown.values())} {either} at {0.5 * (low + high):.6g} Hz"
    yield f"two motions from {low:.8g} to {high:.8g} Hz (each end to {width:g} Hz): {middle}"
    for end in one["end"].values[one["range_cut"].values > 0]:
        yield f"the {end} end of it is that of the search, not of the range: widen frequency"
    for motion, period in zip(MOTIONS, one["period"].values, strict=True):
        if period > 1:
            yield f"the {motion} motion repeats after {period} cycles"
    for end, place, loser in zip(one["end"].values, (low, high), one["range_irregular"].values, strict=True):
        if loser > NO_MOTION:
            motion = {SMALLER: "smaller", LARGER: "larger"}[int(loser)]
            beyond = f"beyond {place:.8g} Hz it is quasi-periodic or irregular, and not counted"
            yield f"the {end} end of it is where the {motion} motion loses its period: {beyond}"
    if not one["range_settled"].values.all():
        slow = "the motion had not settled after settle.max_cycles"
        yield f"next to an end of it {slow}, which may move that end by some of the width"
    yield from _stuck_lines(one)
    if "start_branch" in one and (one["start_cycles"].values < 0).any():
        yield "the starts at its middle were not run"
    elif "start_branch" in one:
        yield from _start_lines(one)
        yield from _offset_lines(one, float(max(smaller.max(), larger.max())))


def _stuck_lines(one: Dataset) -> Iterator[str]:
    """Contacts that stick all the time on both motions, which their offsets alone may tell apart."""
    works = (one["slip_share"] + one["separation_share"]).max("motion").values
    for name in one["contact"].values[works == 0]:
        alone = "they may differ by its offset alone, with others between them"
        then = "the ends then hold for the offset that the sweeps left it with"
        yield f"contact {name} sticks all the time on both motions: {alone}, and {then}"


def _start_lines(one: Dataset) -> Iterator[str]:
    """Where the starts at the middle of a range lead."""
    branch, failure = one["start_branch"].values, one["start_failure"].values
    count = {side: int(np.sum(branch == side)) for side in (LOWER, UPPER, ANOTHER, IRREGULAR, NONE)}
    failed = failure[failure != ""]
    count[NONE] -= failed.size
    rest = ((ANOTHER, "to another motion"), (IRREGULAR, "to one that does not repeat"), (NONE, "did not settle"))
    others = "".join(f", {count[side]} {words}" for side, words in rest if count[side])
    lead = counted(count[LOWER], "leads", "lead")
    yield f"of {branch.size} starts {lead} to the smaller motion, {count[UPPER]} to the larger{others}"
    if (line := starts_line(failed)) is not None:
        yield line
    at_rest = np.flatnonzero(np.isclose(one["share_lower"].values, 0.0))
    if at_rest.size:
        led = {LOWER: "the smaller motion", UPPER: "the larger motion", ANOTHER: "another motion"}
        led |= {IRREGULAR: "a motion that does not repeat"}
        rest_at = (at_rest[0], at_rest[0])
        lead_to = led.get(int(branch[rest_at]), "no settled motion")
        yield "where rest leads is not known" if failure[rest_at] else f"rest leads to {lead_to}"


def starts_line(failures: Sequence[str] | np.ndarray) -> str | None:
    """How many starts failed, with the first reason; None if none did."""
    if not len(failures):
        return None
    return f"the motion from {counted(len(failures), 'start')} could not be computed: {failures[0]}"


def _offset_lines(one: Dataset, size: float) -> Iterator[str]:
    """Contacts that stick all the time with an offset that is not unique."""
    low, high = one["offset_low"].values, one["offset_high"].values
    for side, i in np.argwhere(~unique(low, high, size).all(axis=-1)):
        spans = " and ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(low[side, i], high[side, i], strict=True))
        sticks = f"contact {one['contact'].values[i]} sticks all the time on the {MOTIONS[side]} motion"
        lost = "The end at which this motion is lost holds for the offset that the sweep left it with"
        yield f"{sticks}, and its offset is not unique: over the starts w is {spans}. {lost}"


Frequencies = Mapping[tuple[float, ...], np.ndarray]
"""Some for each set of values of the further axes [Hz]."""


def fold_lines(hbm: Dataset, ends: Frequencies, failed: Frequencies, reach: float) -> Iterator[str]:
    """Folds of the balance, to compare with the ends of the ranges, and folds without an end within a reach [Hz].

    That is a step of the sweeps. Where points of these failed, such a fold does not ask for a wider search: beyond each
    a sweep starts anew.
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
        lost = failed.get(values, np.zeros(0))
        for fold in sorted(alone):
            if lost.size:
                nearest = lost[np.argmin(np.abs(lost - fold))]
                why = f"{counted(lost.size, 'point')} of the sweeps failed, the nearest at {nearest:.7g} Hz"
                yield f"{label}near the fold at {fold:.7g} Hz no range ends, perhaps because {why}"
                continue
            beside = "the balance has motions that no sweep came to, one of which may be stable"
            hint = "search wider, or from another start"
            yield f"{label}beside the fold at {fold:.7g} Hz, near which no range ends, {beside}: {hint}"
    if not sets and frequency.size:
        so_far = "" if hbm.attrs["complete"] else " as far as it was followed"
        apart = any(np.isfinite(known).any() for known in ends.values())
        yield f"the branch of the balance has no fold{so_far}{': it does not join the two motions' if apart else ''}"
