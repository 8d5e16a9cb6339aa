"""Pictures of a transient or of a jump; those of its contacts are drawn by `timesim.picture.contact`."""

from itertools import pairwise
from typing import Any

import numpy as np

from timesim.picture import contact
from timesim.picture.choice import MAX_ROWS, asked, left_out, motions
from timesim.picture.contact import LAST_CYCLES, busiest, last_cycles, recorded_cycles
from timesim.picture.figure import axes, figure, finish, label_axes, labelled, legend_beside, over_decades
from timesim.picture.style import BLUE, SERIES, Axes, Dataset, Figure, Picture, Series, short, unit
from timesim.result.coordinate import rubs

SPECTRUM_CYCLES = 10
HIGHEST_ORDER = 30
REPEATS = 1e-6  # share of the range of a cycle: over ten cycles it leaves a tail of 3e-7/order, at the foot of the axis
MARKED = 60  # cycles of a curve that bear a marker


def displacement(
    data: Dataset,
    ax: Axes | None = None,
    *,
    point: str | None = None,
    axis: str | None = None,
    cycles: int | None = None,
) -> Axes:
    """Displacement within the envelope of the cycle amplitudes, or that of the last `cycles` without the envelope."""
    ax = axes(ax)
    point, axis = asked(moving(data), point, axis)
    part = data if cycles is None else data.isel(time=last_cycles(data, cycles))
    x = part.displacement.sel(point=point, axis=axis).values
    ax.plot(part.time.values, x, color=BLUE, linewidth=0.9, label="displacement")
    if cycles is None:
        _envelope(data, ax, x, data.cycle_amplitude.sel(point=point, axis=axis).values)
    ax.set(xlabel="time [s]", ylabel=f"{short(point)} {axis}{unit(data, 'displacement')}")
    return ax


def _envelope(data: Dataset, ax: Axes, x: np.ndarray, amplitude: np.ndarray) -> None:
    """Draw the amplitudes from time 0, where the run-up of a jump ends, and a line at each change of frequency."""
    start, period = data.cycle_start.values, data.cycle_period.values
    shown = start > -1e-6 * period
    if not shown.any():
        return
    start, period, amplitude = start[shown], period[shown], amplitude[shown]
    edges = np.append(start, start[-1] + period[-1])
    samples = np.searchsorted(data.time.values, edges - 1e-6 * period[0])
    parts = [x[a : b + 1] for a, b in pairwise(samples)]
    recorded = next((number for number, part in enumerate(parts) if part.size > 1), len(parts))
    middle = np.array([(part.max() + part.min()) / 2 if part.size > 1 else np.nan for part in parts])
    middle[:recorded] = (x.max() + x.min()) / 2
    # Of cycles without samples the amplitude is known, but not what it is about.
    for some, line, name in (
        (slice(recorded, None), "-", "middle ± amplitude of the cycle"),
        (slice(recorded), ":", "± amplitude of earlier cycles, about the middle of the samples"),
    ):
        sides, ends = (middle[some] + amplitude[some], middle[some] - amplitude[some]), edges[some.start or 0 :]
        for side, label in zip(sides, (name, None), strict=True) if middle[some].size else ():
            stairs = ax.stairs(side, ends[: side.size + 1], baseline=None, color="black", linestyle=line, label=label)
            stairs.set_snap(False)  # on whole pixels amplitudes that hardly differ make a step
    for change in start[1:][np.abs(np.diff(period)) > 1e-6 * period[0]]:
        ax.axvline(change, color="black", linewidth=1.0, linestyle=":", label="change of frequency")


def spectrum(data: Dataset, ax: Axes | None = None) -> Axes:
    """Amplitude of the harmonics over the last cycles of what moves most, on a logarithmic axis.

    Markers are at the harmonics of the excitation. A thin line joins all orders, so that a motion of another period, or
    one that has not settled, shows between the markers. A label says of the latter that the smooth tail, which the
    jump from its end to its start leaves, is none of its harmonics.
    """
    ax = axes(ax)
    lowest, peak, change = np.inf, 0.0, 0.0
    for (point, axis), style in zip(moving(data)[:MAX_ROWS], SERIES, strict=False):
        x = data.displacement.sel(point=point, axis=axis).values
        order, amplitude = harmonics(data, x)
        whole = np.abs(order - np.round(order)) < 1e-9
        ax.plot(order, amplitude, color=style.colour, linestyle=style.line, linewidth=0.5)
        ax.plot(order[whole], amplitude[whole], style.marker, color=style.colour, ms=4, label=f"{short(point)} {axis}")
        peak = max(peak, float(amplitude.max(initial=0.0)))
        lowest = min(lowest, float(amplitude[whole & (amplitude > 0)].min(initial=np.inf)))
        change = max(change, unsettled(data, x))
    if peak > 0:
        ax.set_yscale("log")
        ax.set_ylim(max(1e-8 * peak, lowest / 2), 3 * peak)
    if change > REPEATS:
        label_axes(ax, f"not settled, by {change:.1g} of the range of a cycle: smooth tails are no harmonics")
    ax.set(xlabel="multiple of the excitation frequency", ylabel=f"displacement amplitude{unit(data, 'displacement')}")
    return ax


def harmonics(data: Dataset, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spectrum of samples x, shape (T,), over the last recorded cycles of one frequency, at most `SPECTRUM_CYCLES`.

    Returns multiples of the excitation frequency up to `HIGHEST_ORDER`, and the amplitude at each; both are empty where
    no cycle was finished.
    """
    cycles, first, last = _window(data)
    if not cycles:
        return np.empty(0), np.empty(0)
    amplitude = np.abs(np.fft.rfft(x[first:last])) / (last - first)
    amplitude[1 : (last - first + 1) // 2] *= 2  # all but the mean, and the half of the rate of samples
    order = np.arange(amplitude.size) / cycles
    return order[order <= HIGHEST_ORDER], amplitude[order <= HIGHEST_ORDER]


def unsettled(data: Dataset, x: np.ndarray) -> float:
    """Least difference of the last of these cycles from another, or of its ends if there is no other, over its range.

    Zero where nothing moves or no cycle was finished; a motion that repeats after several of the cycles has settled.
    """
    cycles, first, last = _window(data)
    size = (last - first) // max(cycles, 1)
    if not size or not np.ptp(x[last - size : last]):
        return 0.0
    each = x[last - cycles * size : last].reshape(cycles, size)
    others = np.abs(each[:-1] - each[-1]).max(axis=1)
    apart = others.min() if cycles > 1 else np.abs(x[min(last, x.size - 1)] - x[first])
    return float(apart / np.ptp(each[-1]))


def _window(data: Dataset) -> tuple[int, int, int]:
    """Number of the last recorded cycles of one frequency, at most `SPECTRUM_CYCLES`, their first sample and end."""
    (start, period), time = recorded_cycles(data), data.time.values
    slack = 1e-6 * period.min(initial=np.inf)
    same = (np.abs(period - period[-1:]) < slack) & (start > time[0] - slack)
    cycles = int(np.cumprod(same[::-1][:SPECTRUM_CYCLES]).sum())
    if not cycles:
        return 0, 0, 0
    first, last = np.searchsorted(time, np.array([start[-cycles], start[-1] + period[-1]]) - slack)
    return cycles, int(first), int(last)


def energy(data: Dataset, ax: Axes | None = None) -> Axes:
    """Energy balance of each cycle: input, structural damping, friction a contact, change of the stored energy."""
    ax, cycle = axes(ax), data.cycle.values
    terms = {"input": data.energy_input.values, "structural damping": data.energy_damping.values}
    for name in busiest(data, MAX_ROWS, rubbing=True):
        terms[f"friction {short(name, 16)}"] = data.energy_friction.sel(contact=name).values
    if rubs(data).sum() > MAX_ROWS:
        terms["friction, all contacts"] = data.energy_friction.values.sum(axis=1)
    terms["change of stored"] = data.energy_stored_change.values
    for (name, values), style in zip(terms.items(), SERIES, strict=False):
        _terms(ax, cycle, values, style, name)
    ax.set_ylabel(f"energy a cycle{unit(data, 'energy_input')}")
    return _along_cycles(ax)


def energy_residual(data: Dataset, ax: Axes | None = None) -> Axes:
    """What the energy balance of each cycle leaves unexplained, beside the input, on a logarithmic axis."""
    ax, cycle = axes(ax), data.cycle.values
    for name, style in (("input", SERIES[0]), ("residual", SERIES[1])):
        size = np.abs(data[f"energy_{name}"].values)
        shown = size > 0
        if shown.any():
            _terms(ax, cycle[shown], size[shown], style._replace(line="-"), f"|{name}|")
    if ax.has_data():
        over_decades(ax)
    ax.set_ylabel(f"energy{unit(data, 'energy_input')}")
    return _along_cycles(ax)


def _terms(ax: Axes, cycle: np.ndarray, values: np.ndarray, style: Series, label: str) -> None:
    """A quantity over the cycles, with a marker at some of them."""
    look: dict[str, Any] = {"color": style.colour, "linestyle": style.line, "marker": style.marker, "ms": 3}
    ax.plot(cycle, values, label=label, markevery=-(-cycle.size // MARKED) or 1, **look)


def _along_cycles(ax: Axes) -> Axes:
    from matplotlib.ticker import MaxNLocator

    ax.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    ax.set_xlabel("cycle")
    return ax


def moving(data: Dataset) -> list[tuple[str, str]]:
    """Points and axes that move in the last cycles, largest range first; the first of all if none does."""
    return motions(data, np.ptp(data.displacement.values[last_cycles(data)], axis=0))


def _displacement_figure(data: Dataset) -> Figure:
    shown = moving(data)[:MAX_ROWS]
    ratios = [2, 1] if data.sizes["cycle"] > LAST_CYCLES else [1]  # else the last cycles are all of them
    fig, grid = figure(len(shown), len(ratios), width=10.0, height=1.6, width_ratios=ratios, sharex="col")
    for row, (point, axis) in zip(grid, shown, strict=True):
        displacement(data, row[0], point=point, axis=axis).label_outer()
        for ax in row[1:]:
            displacement(data, ax, point=point, axis=axis, cycles=LAST_CYCLES).set_xlabel("")
    for ax in grid[-1]:
        ax.set_xlabel("time [s]")
    return finish(fig, data, "displacement", _hidden(data))


def _spectrum_figure(data: Dataset) -> Figure | None:
    if not data.sizes["cycle"]:
        return None
    fig, grid = figure(width=8.0, height=3.0)
    spectrum(data, grid[0, 0])
    return finish(fig, data, "harmonics of the last cycles", _hidden(data))


def _hidden(data: Dataset) -> str:
    return left_out(len(moving(data)), MAX_ROWS, "motions", "the least active")


def _energy_figure(data: Dataset) -> Figure | None:
    if data.sizes["cycle"] < 2:
        return None
    ratios = [2, 1] if data.energy_input.values.any() or data.energy_residual.values.any() else [1]  # all are zero
    fig, grid = figure(len(ratios), 1, width=9.0, height=2.0, right=2.3, sharex=True, height_ratios=ratios)
    energy(data, grid[0, 0]).label_outer()
    if len(ratios) > 1:
        energy_residual(data, grid[1, 0])
    for ax in grid[:, 0]:
        legend_beside(ax, labelled(ax).values())
    number = int(rubs(data).sum())
    hidden = f"{number - MAX_ROWS} of {number} contacts shown in the sum only" if number > MAX_ROWS else ""
    return finish(fig, data, "energy balance of each cycle", hidden)


PICTURES: dict[str, Picture] = {
    "displacement": _displacement_figure,
    **contact.PICTURES,
    "spectrum": _spectrum_figure,
    "energy": _energy_figure,
}
