"""The summary of a search for the least peak, in words, from its finished result."""

from collections.abc import Iterator

import numpy as np
from xarray import Dataset

from timesim.orbit.jump import AT_LEAST, STANDS_OUT
from timesim.orbit.threshold import LONGEST
from timesim.result.label import counted, with_unit
from timesim.study.summary.sweep import unusual_lines

TIE = 1e-7  # relative difference of peaks up to which they are equal: the accuracy of the time integration
NOTHING = 1e-8  # of the largest peak: what is left of the search for a steady motion where nothing vibrates


def is_nothing(peak: np.ndarray) -> np.ndarray:
    """Whether each of some peaks is none beside the largest, as of what a clutch that slips all the time isolates."""
    return peak <= NOTHING * np.nanmax(peak)


def as_low(peak: np.ndarray, at: int) -> tuple[int, int]:
    """Positions of the first and last of the adjacent peaks that equal one of them; a missing peak ends them."""
    peak = np.where(is_nothing(peak), 0.0, peak)
    higher = np.flatnonzero(~(peak * (1 - TIE) <= peak[at]))
    return int(higher[higher < at].max(initial=-1)) + 1, int(higher[higher > at].min(initial=len(peak))) - 1


def jumps_beside(values: np.ndarray, peak: np.ndarray, at: int) -> list[int]:
    """Positions beside those as low as one of some peaks to which they jump up: by more a length than from there on."""
    first, last = as_low(peak, at)
    found = []
    for edge, step in ((first, -1), (last, 1)):
        near, far = edge + step, edge + 2 * step
        if not 0 <= far < len(peak):
            continue
        rise = peak[near] - peak[edge]
        beyond = abs(peak[far] - peak[near]) * (values[near] - values[edge]) / (values[far] - values[near])
        if rise > max(AT_LEAST * peak[near], STANDS_OUT * beyond):
            found.append(near)
    return found


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

    def at_value(i: int) -> str:
        return with_unit(f"{values[i]:.6g}", data[key].attrs)

    def height(i: int) -> str:
        return with_unit(f"{peak[i]:.7g}", data["peak"].attrs)

    so_far, vanishes = "" if data.attrs["complete"] else " so far,", bool(is_nothing(peak)[at])
    least = f"{height(at)} of {data['peak_of'].values[at]}{so_far}"
    yield f"least peak {least} at {key} = {at_value(at)}, at {float(data['optimum_frequency']):.6g} Hz"
    beside = [i for value in (best - accuracy, best + accuracy) for i in np.flatnonzero(values == value).tolist()]
    first, last = as_low(peak, at)
    if data.attrs["complete"] and values[last] - values[first] > 3 * accuracy:
        yield f"the peak is the same from {values[first]:.6g} to {at_value(last)}: any value between does as well"
    elif data.attrs["complete"] and beside:
        heights = " and ".join(f"{height(i)} at {at_value(i)}" for i in beside)
        yield f"an accuracy away the peak is not smaller: {heights}"
    for i in jumps_beside(values, peak, at) if data.attrs["complete"] else ():
        higher = f"{height(i)} at {key} = {at_value(i)}, at {data['peak_frequency'].values[i]:.6g} Hz"
        lost = "carried over from there, that motion is lost at the least peak"
        if not data["peak_settled"].values[i]:
            lost = "that motion does not repeat, and is not carried over, so it may go on at the least peak"
        yield f"the peak jumps beside it, to {higher}: {lost}"
    if carried := int(np.count_nonzero(data["peak_carried"].values)):
        yield f"at {counted(carried, 'value')} no sweep comes to the motion of the peak: it goes on from a value beside"
    if data.attrs["complete"] and best in (values[0], values[-1]):
        yield f"it is at an end of the range of {key}, so beyond it the peak may be smaller still"
    if vanishes:
        yield "that is rounding beside the largest peak: nothing vibrates there"
    elif data["peak_at_end"].values[at]:
        yield "its peak is at an end of frequency, so beyond it the response may be larger"
    if data["peak_irregular"].values[at]:
        yield f"its motion does not repeat after up to {LONGEST} cycles: it is quasi-periodic or irregular"
    elif not data["peak_settled"].values[at]:
        yield "its motion had not settled in settle.max_cycles"
    yield from unusual_lines(data)
