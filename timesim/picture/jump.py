"""Pictures of a jump: the amplitude of each cycle over the schedule of frequencies, and against the frequency."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from timesim.picture import transient
from timesim.picture.choice import MAX_ROWS, asked, left_out, motions
from timesim.picture.figure import axes, figure, finish, from_zero
from timesim.picture.response import amplitude_label
from timesim.picture.style import BLUE, SERIES, VERMILION, Axes, Dataset, Figure, Picture, short, unit

MAX_NUMBERS = 12
ROOM = 0.055  # share of an axis that a frequency takes as text
NEAR = 0.02  # share of the range: ends of phases that are nearer are at one place, and no arrow joins them
LEAST = 1e-3  # share of the amplitude that its axis spans at least: labels of finer ticks reach over the margin
RUN_UP = "0.93"
Place = tuple[float, float]  # frequency and amplitude


class DrawnPhase(NamedTuple):
    """Cycles ``first <= k < end`` at one frequency [Hz], counted from 0, and whether they belong to the run-up."""

    first: int
    end: int
    frequency: float
    run_up: bool


def phases(data: Dataset) -> list[DrawnPhase]:
    """The schedule as far as it was run; successive phases of one frequency count as one."""
    frequency = data.cycle_frequency.values
    before = data.cycle_start.values < -1e-6 * data.cycle_period.values
    changes = np.flatnonzero((np.diff(frequency) != 0) | np.diff(before)) + 1
    bounds = [0, *changes.tolist(), frequency.size] if frequency.size else [0]
    return [DrawnPhase(a, b, float(frequency[a]), bool(before[a])) for a, b in pairwise(bounds)]


def envelope(data: Dataset, ax: Axes | None = None) -> Axes:
    """Amplitude of each cycle for what moves most, the run-up shaded, dotted lines at changes of frequency."""
    ax = axes(ax)
    for (point, axis), style in zip(moving(data)[:MAX_ROWS], SERIES, strict=False):
        amplitude = data.cycle_amplitude.sel(point=point, axis=axis).values
        ax.plot(data.cycle.values, amplitude, color=style.colour, linestyle=style.line, label=f"{short(point)} {axis}")
    from_zero(ax)
    ax.set_ylabel(f"amplitude{unit(data, 'cycle_amplitude')}")
    return _along_schedule(ax, data)


def frequency(data: Dataset, ax: Axes | None = None) -> Axes:
    """Frequency of the excitation over the cycles, the values written where there is room."""
    ax = axes(ax)
    parts = phases(data)
    edges = [0.5, *(part.end + 0.5 for part in parts)]
    ax.stairs([part.frequency for part in parts], edges, baseline=None, color="black", linewidth=1.2)
    for part in parts:
        if part.end - part.first > ROOM * data.sizes["cycle"]:
            middle = (part.first + part.end + 1) / 2
            ax.text(middle, part.frequency, f"{part.frequency:.6g}\n", ha="center", va="center", fontsize=8)
    ax.margins(y=0.35)
    ax.set_ylabel("frequency [Hz]")
    return _along_schedule(ax, data)


def _along_schedule(ax: Axes, data: Dataset) -> Axes:
    from matplotlib.ticker import MaxNLocator

    parts = phases(data)
    before = [part.end for part in parts if part.run_up]
    if before:
        ax.axvspan(0.5, before[-1] + 0.5, color=RUN_UP, linewidth=0, zorder=0, label="run-up")
    for part in parts[1:]:
        ax.axvline(part.first + 0.5, color="0.4", linewidth=0.8, linestyle=":")
    ax.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    ax.set(xlabel="cycle, counted from the start of the run", xlim=(0.5, max(data.sizes["cycle"], 1) + 0.5))
    return ax


def path(data: Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None) -> Axes:
    """Amplitude of each cycle against frequency; arrows join the ends of the phases, which are numbered from 1.

    Of the run-up only the end is shown, where the first arrow begins.
    """
    ax = axes(ax)
    point, axis = asked(moving(data), point, axis)
    amplitude = data.cycle_amplitude.sel(point=point, axis=axis).values
    parts = phases(data)
    recorded = [part for part in parts if not part.run_up]
    first = recorded[0].first if recorded else 0
    ax.plot(data.cycle_frequency.values[first:], amplitude[first:], ".", color=BLUE, ms=2.5, label="a cycle")
    last = parts[len(parts) - len(recorded) - 1 :] if len(recorded) < len(parts) else recorded
    ends = [(part.frequency, amplitude[part.end - 1]) for part in last]
    _arrows(ax, ends)
    if len(last) > len(recorded):
        ax.plot(*ends.pop(0), "D", color="black", fillstyle="none", ms=8, linestyle="", label="end of the run-up")
    ax.plot(*np.array(ends).reshape(-1, 2).T, "o", color=VERMILION, ms=5, label="end of a phase")
    for end, numbers in _numbered(ends if len(ends) <= MAX_NUMBERS else ()).items():
        ax.annotate(", ".join(numbers), end, (7, 5), textcoords="offset points", fontsize=9)
    ax.margins(x=0.15, y=0.12)
    low, high = ax.get_ylim()
    lacks = max(0.0, LEAST * np.abs(amplitude[first:]).max(initial=0.0) - (high - low))
    ax.set_ylim(low - lacks / 2, high + lacks / 2)
    ax.set(xlabel="frequency [Hz]", ylabel=amplitude_label(data, point, axis, "cycle_amplitude"))
    return ax


def _numbered(ends: Sequence[Place]) -> dict[Place, list[str]]:
    """Numbers of the ends of phases by their places; those that fall on one another share a place."""
    least, numbers = _least(ends), dict[Place, list[str]]()
    for number, end in enumerate(ends, 1):
        place = next((known for known in numbers if np.all(np.abs(np.subtract(known, end)) <= least)), end)
        numbers.setdefault(place, []).append(str(number))
    return numbers


def _least(ends: Sequence[Place]) -> np.ndarray:
    """The distance along each axis up to which ends are at one place."""
    return NEAR * (np.ptp(np.array(ends), axis=0) if ends else np.zeros(2))


def _arrows(ax: Axes, ends: Sequence[Place]) -> None:
    least = _least(ends)
    for start, end in pairwise(ends):
        if np.any(np.abs(np.subtract(end, start)) > least):
            ax.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": "0.35", "shrinkA": 4, "shrinkB": 4})


def moving(data: Dataset) -> list[tuple[str, str]]:
    """Points and axes, the largest amplitude first; the first of all if none moves."""
    return motions(data, data.cycle_amplitude.values.max(axis=0, initial=0.0))


def _note(data: Dataset) -> str:
    return left_out(len(moving(data)), MAX_ROWS, "motions", "the least active")


def _envelope_figure(data: Dataset) -> Figure:
    fig, grid = figure(2, 1, width=9.0, height=1.9, gap=0.15, sharex=True, height_ratios=[2.2, 1])
    envelope(data, grid[0, 0]).set_xlabel("")
    frequency(data, grid[1, 0])
    return finish(fig, data, "amplitude of each cycle", _note(data))


def _path_figure(data: Dataset) -> Figure | None:
    if all(part.run_up for part in phases(data)):
        return None
    shown = moving(data)[:MAX_ROWS]
    fig, grid = figure(1, len(shown), width=1.1 + 3.6 * len(shown), height=3.2, left=0.8)
    for ax, (point, axis) in zip(grid[0], shown, strict=True):
        path(data, ax, point=point, axis=axis).locator_params(axis="x", nbins=4)
    return finish(fig, data, "amplitude against frequency, phase by phase", _note(data))


PICTURES: dict[str, Picture] = {
    "displacement": transient.PICTURES["displacement"],
    "envelope": _envelope_figure,
    "path": _path_figure,
    **transient.PICTURES,
}
