"""Pictures of a transient: each function draws one aspect of a result on one set of axes.

``f(data, ax=None) -> ax``, where `data` is the result of a transient or of a jump: without axes it makes a
figure of its own, and ``ax.figure.savefig(...)`` writes it. Keywords choose what is drawn, by the names in
the result; by default what moves, or dissipates, most. `PICTURES` are the figures that a run writes.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from timesim.model.model import SEPARATION, STATE_NAMES
from timesim.picture.style import (
    BLUE,
    SERIES,
    STATE_STYLE,
    VERMILION,
    Picture,
    axes,
    figure,
    heading,
    shared_legend,
    short,
    state_curves,
)

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

LAST_CYCLES = 3
SPECTRUM_CYCLES = 10
HIGHEST_ORDER = 30
MAX_DISPLACEMENTS = 3
MAX_CONTACTS = 3
MAX_BARS = 12
PALE = "0.7"
CLOSE = 0.02  # of the size of a path: nearer than this nothing is told apart


def displacement(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    point: str | None = None,
    axis: str | None = None,
    cycles: int | None = None,
) -> "matplotlib.axes.Axes":
    """Displacement within the envelope of the cycle amplitudes, or the last `cycles` without it."""
    ax = axes(ax)
    if point is None or axis is None:
        point, axis = moving(data)[0]
    part = data if cycles is None else data.isel(time=last_cycles(data, cycles))
    x = part.displacement.sel(point=point, axis=axis).values
    ax.plot(part.time.values, x, color=BLUE, linewidth=0.9, label="displacement")
    if cycles is None:
        _envelope(data, ax, x, data.cycle_amplitude.sel(point=point, axis=axis).values)
    ax.set(xlabel="time [s]", ylabel=f"{point} {axis} [length]")
    return ax


def _envelope(data: "xarray.Dataset", ax: "matplotlib.axes.Axes", x: np.ndarray, amplitude: np.ndarray) -> None:
    """Draw the amplitudes from time 0 on, where the run-up of a jump ends, and a line where the frequency changes."""
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
    middle[:recorded] = middle[recorded] if recorded < len(parts) else 0.0
    for sign, name in ((1, "± amplitude of the cycle"), (-1, None)):
        ax.stairs(middle + sign * amplitude, edges, baseline=None, color=VERMILION, label=name)
    for number, change in enumerate(start[1:][np.abs(np.diff(period)) > 1e-6 * period[0]]):
        label = None if number else "change of frequency"
        ax.axvline(change, color="black", linewidth=1.0, linestyle=":", label=label)


def orbit(
    data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None, *, contact: str | None = None
) -> "matplotlib.axes.Axes":
    """Relative motion of a contact in its plane over the last cycles, the last coloured by state."""
    ax = axes(ax)
    contact = contact or busiest(data, 1)[0]
    part = data.isel(time=last_cycles(data)).sel(contact=contact)
    u, last = part.contact_displacement.values[:, :2], last_cycles(part, 1)
    ax.plot(u[:, 0], u[:, 1], color=PALE, linewidth=0.8, label=_if_seen("cycles before", u, u[last]))
    state = part.contact_state.values[last]
    w = np.where(state[:, None] == SEPARATION, np.nan, part.slip.values[last])
    _slider(ax, w, u[last])
    state_curves(ax, u[last, 0], u[last, 1], state)
    ax.set(xlabel="u1 [length]", ylabel="u2 [length]")
    ax.set_title(contact, fontsize=9, pad=4, loc="right")
    ax.set_aspect("equal", adjustable="datalim")
    return ax


def _slider(ax: "matplotlib.axes.Axes", w: np.ndarray, u: np.ndarray) -> None:
    """The slider's path; a dot where it stays, nothing where the contact is open all the time."""
    known = w[~np.isnan(w).any(axis=1)]
    if not known.size:
        return
    stays = np.ptp(known, axis=0).max() <= CLOSE * np.ptp(u, axis=0).max()
    if stays:
        ax.plot(*known[:1].T, "o", ms=3, color="black", zorder=4, label="slider w")
    else:
        ax.plot(w[:, 0], w[:, 1], color="black", linewidth=0.7, label=_if_seen("slider w", known, u))


def _if_seen(label: str, path: np.ndarray, above: np.ndarray) -> str:
    """The label of a path, hidden from legends where another path is drawn above all of it."""
    size = np.maximum(np.ptp(path, axis=0), np.ptp(above, axis=0))
    scale = np.where(size > 0, size, 1.0)
    few, all_above = (part[:: 1 + len(part) // 500] / scale for part in (path, above))
    apart = np.linalg.norm(few[:, None] - all_above, axis=-1).min(axis=1)
    return label if apart.max() > CLOSE else f"_{label}"


def hysteresis(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    contact: str | None = None,
    tangent: str = "t1",
) -> "matplotlib.axes.Axes":
    """Friction force against relative displacement over the last cycles, the last coloured by state."""
    ax = axes(ax)
    contact = contact or busiest(data, 1)[0]
    part = data.isel(time=last_cycles(data)).sel(contact=contact, component=tangent)
    u, f, last = part.contact_displacement.values, part.contact_force.values, last_cycles(part, 1)
    both = np.stack([u, f], axis=1)
    ax.plot(u, f, color=PALE, linewidth=0.8, label=_if_seen("cycles before", both, both[last]))
    state_curves(ax, u[last], f[last], part.contact_state.values[last])
    number = tangent.removeprefix("t")
    ax.set(xlabel=f"u{number} [length]", ylabel=f"f{number} [force]")
    ax.set_title(f"{contact}, {tangent}", fontsize=9, pad=4, loc="right")
    return ax


def normal_load(
    data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None, *, contact: str | None = None
) -> "matplotlib.axes.Axes":
    """Normal load and friction force of a contact over the last cycles; separations are shaded."""
    ax = axes(ax)
    contact = contact or busiest(data, 1)[0]
    part = data.isel(time=last_cycles(data)).sel(contact=contact)
    time, force = part.time.values, part.contact_force.values
    apart = [span for *span, state in intervals(data, contact, time[0], time[-1]) if state == SEPARATION]
    for number, span in enumerate(apart):
        ax.axvspan(*span, color="0.87", linewidth=0, zorder=0, label=None if number else "separation")
    ax.axhline(0.0, color="black", linewidth=0.8, label="n = 0")
    ax.plot(time, force[:, 2], color=BLUE, linewidth=1.4, label="normal load n")
    tangential = np.hypot(force[:, 0], force[:, 1])
    ax.plot(time, tangential, color=VERMILION, linestyle="--", linewidth=1.0, label="friction force |f|")
    ax.set(xlabel="time [s]", ylabel="n, |f| [force]", xlim=(time[0], time[-1]))
    ax.set_title(contact, fontsize=9, pad=4, loc="right")
    return ax


def contact_states(
    data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None, *, contacts: Sequence[str] | None = None
) -> "matplotlib.axes.Axes":
    """State of contacts over the last cycles, as bars between the times of the event log."""
    ax = axes(ax)
    contacts = contacts or busiest(data, MAX_BARS)
    time = data.time.values[last_cycles(data)]
    for row, contact in enumerate(contacts):
        for start, end, state in intervals(data, contact, time[0], time[-1]):
            style = STATE_STYLE[state]
            bars = ax.broken_barh([(start, end - start)], (row - 0.35, 0.7), facecolor=style.colour, linewidth=0)
            bars.set(edgecolor="white", hatch=style.hatch, label=STATE_NAMES[state])
    starts = data.cycle_start.values
    for start in starts[(starts > time[0]) & (starts < time[-1])]:
        ax.axvline(start, color="black", linewidth=0.8, linestyle=":")
    ax.set(
        xlabel="time [s], dotted: start of a cycle",
        xlim=(time[0], time[-1]),
        ylim=(len(contacts) - 0.4, -0.6),
    )
    ax.set_yticks(range(len(contacts)), [short(name) for name in contacts])
    ax.grid(False)
    return ax


def spectrum(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Amplitude of the harmonics over the last cycles of what moves most, on a logarithmic axis.

    Markers stand on the harmonics of the excitation. A thin line joins all orders: what has another period
    or has not settled shows between the markers.
    """
    ax = axes(ax)
    peak = 0.0
    for (point, axis), style in zip(moving(data)[:MAX_DISPLACEMENTS], SERIES, strict=False):
        order, amplitude = harmonics(data, data.displacement.sel(point=point, axis=axis).values)
        whole = np.abs(order - np.round(order)) < 1e-9
        ax.plot(order, amplitude, color=style.colour, linestyle=style.line, linewidth=0.5)
        ax.plot(order[whole], amplitude[whole], style.marker, color=style.colour, ms=4, label=f"{point} {axis}")
        peak = max(peak, float(amplitude.max(initial=0.0)))
    if peak > 0:
        ax.set_yscale("log")
        ax.set_ylim(1e-8 * peak, 3 * peak)
    ax.set(xlabel="multiple of the excitation frequency", ylabel="displacement amplitude [length]")
    return ax


def energy(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Energy balance of each cycle: input, structural damping, friction a contact, change of the stored energy."""
    ax = axes(ax)
    cycle = data.cycle.values
    terms = {"input": data.energy_input.values, "structural damping": data.energy_damping.values}
    for name in busiest(data, MAX_CONTACTS):
        terms[f"friction {short(name, 16)}"] = data.energy_friction.sel(contact=name).values
    if data.sizes["contact"] > MAX_CONTACTS:
        terms["friction, all contacts"] = data.energy_friction.values.sum(axis=1)
    terms["change of stored"] = data.energy_stored_change.values
    for (name, values), style in zip(terms.items(), SERIES, strict=False):
        ax.plot(cycle, values, style.marker, color=style.colour, linestyle=style.line, ms=3, label=name)
    ax.set_ylabel("energy a cycle [force·length]")
    return _along_cycles(ax)


def energy_residual(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """What the energy balance of each cycle leaves unexplained, beside the input, on a logarithmic axis."""
    ax = axes(ax)
    for name, style in (("input", SERIES[0]), ("residual", SERIES[1])):
        size = np.abs(data[f"energy_{name}"].values)
        shown = size > 0
        if shown.any():
            ax.set_yscale("log")
        ax.plot(
            data.cycle.values[shown],
            size[shown],
            style.marker,
            color=style.colour,
            linestyle="-",
            ms=3,
            label=f"|{name}|",
        )
    ax.set_ylabel("[force·length]")
    return _along_cycles(ax)


def _along_cycles(ax: "matplotlib.axes.Axes") -> "matplotlib.axes.Axes":
    from matplotlib.ticker import MaxNLocator

    ax.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    ax.set_xlabel("cycle")
    return ax


def moving(data: "xarray.Dataset") -> list[tuple[str, str]]:
    """Points and axes that move in the last cycles, largest range first; the first of all if none does."""
    span = np.ptp(data.displacement.values[last_cycles(data)], axis=0)
    order = np.argsort(-span, axis=None, kind="stable")
    kept = [place for place in order if span.flat[place] > 1e-9 * span.max()] or [0]
    rows, columns = np.unravel_index(kept, span.shape)
    return [(str(data.point.values[i]), str(data.axis.values[j])) for i, j in zip(rows, columns, strict=True)]


def busiest(data: "xarray.Dataset", limit: int) -> list[str]:
    """At most `limit` contacts, those with most friction energy and transitions, in the scene's order."""
    names = data.contact.values
    events = np.bincount(data.event_contact.values.astype(int), minlength=names.size)
    work = data.energy_friction.values.sum(axis=0)
    best = np.lexsort((-events, -work))[:limit]
    return [str(names[i]) for i in np.sort(best)]


def last_cycles(data: "xarray.Dataset", cycles: int = LAST_CYCLES) -> slice:
    """Samples of the last whole cycles that were recorded; all samples where no cycle was finished."""
    start, time = data.cycle_start.values, data.time.values
    if not start.size:
        return slice(None)
    first = start[-min(cycles, start.size)] - 1e-6 * data.cycle_period.values[-1]
    return slice(int(np.searchsorted(time, first)), None)


def intervals(data: "xarray.Dataset", contact: str, start: float, end: float) -> list[tuple[float, float, int]]:
    """Start, end [s] and state of each interval of a contact within a window, from the event log."""
    index = data.contact.values.tolist().index(contact)
    mine = np.flatnonzero(data.event_contact.values == index)
    before = data.event_from.values[mine[0]] if mine.size else data.contact_state.values[0, index]
    states = [int(before), *data.event_to.values[mine].tolist()]
    times = np.clip([start, *data.event_time.values[mine], end], start, end).tolist()
    return [item for item in zip(times[:-1], times[1:], states, strict=True) if item[1] > item[0]]


def harmonics(data: "xarray.Dataset", x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spectrum of samples over the last recorded cycles of one frequency, at most `SPECTRUM_CYCLES`.

    Args:
        data: result of a transient.
        x: samples at its times, shape (T,).

    Returns:
        Multiples of the excitation frequency up to `HIGHEST_ORDER`, and the amplitude at each; both empty
        where no cycle was finished.
    """
    start, period, time = data.cycle_start.values, data.cycle_period.values, data.time.values
    slack = 1e-6 * period.min(initial=np.inf)
    same = (np.abs(period - period[-1:]) < slack) & (start > time[0] - slack)
    cycles = int(np.cumprod(same[::-1][:SPECTRUM_CYCLES]).sum())
    if not cycles:
        return np.empty(0), np.empty(0)
    window = np.array([start[-cycles], start[-1] + period[-1]]) - slack
    first, last = np.searchsorted(time, window)
    amplitude = np.abs(np.fft.rfft(x[first:last])) / (last - first)
    amplitude[1:] *= 2
    order = np.arange(amplitude.size) / cycles
    return order[order <= HIGHEST_ORDER], amplitude[order <= HIGHEST_ORDER]


def _displacement_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure":
    shown = moving(data)
    rows = shown[:MAX_DISPLACEMENTS]
    made, grid = figure(len(rows), 2, width=10.0, height=1.6, width_ratios=[2, 1], sharex="col")
    for (left, right), (point, axis) in zip(grid, rows, strict=True):
        displacement(data, left, point=point, axis=axis).label_outer()
        displacement(data, right, point=point, axis=axis, cycles=LAST_CYCLES).set(ylabel="", xlabel="")
    grid[-1, 1].set_xlabel("time [s]")
    shared_legend(made)
    heading(made, data, "displacement", _left_out(len(shown), len(rows), "motions"))
    return made


def _orbit_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    contacts = busiest(data, MAX_CONTACTS)
    if not contacts:
        return None
    made, grid = figure(1, len(contacts), width=1.1 + 3.8 * len(contacts), height=3.2)
    for ax, contact in zip(grid[0], contacts, strict=True):
        orbit(data, ax, contact=contact)
    return _finished(made, data, "orbit in the contact plane", contacts)


def _hysteresis_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    contacts = busiest(data, MAX_CONTACTS)
    if not contacts:
        return None
    rubbed = {contact: tangents for contact in contacts if (tangents := _tangents(data, contact))}
    rubbed = rubbed or {contacts[0]: ["t1"]}
    columns = max(map(len, rubbed.values()))
    made, grid = figure(len(rubbed), columns, width=7.5 + 0.5 * columns, height=2.2, gap=0.7)
    for row, (contact, tangents) in zip(grid, rubbed.items(), strict=True):
        for ax, tangent in zip(row, tangents, strict=False):
            hysteresis(data, ax, contact=contact, tangent=tangent)
        for ax in row[len(tangents) :]:
            ax.remove()
    return _finished(made, data, "friction force against displacement", contacts)


def _tangents(data: "xarray.Dataset", contact: str) -> list[str]:
    """In-plane axes of a contact along which its friction force changes in the last cycles."""
    span = np.ptp(data.contact_force.isel(time=last_cycles(data)).sel(contact=contact).values, axis=0)
    return [name for name, own in zip(("t1", "t2"), span, strict=False) if own > 1e-9 * span.max()]


def _normal_load_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    contacts = busiest(data, MAX_CONTACTS)
    if not contacts:
        return None
    made, grid = figure(len(contacts), 1, width=8.5, height=1.7, gap=0.3, sharex=True)
    for ax, contact in zip(grid[:, 0], contacts, strict=True):
        normal_load(data, ax, contact=contact).label_outer()
    return _finished(made, data, "normal load", contacts)


def _states_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    contacts = busiest(data, MAX_BARS)
    if not contacts:
        return None
    longest = max(len(short(name)) for name in contacts)
    made, grid = figure(width=8.5, height=0.2 + 0.4 * len(contacts), left=0.4 + 0.075 * longest)
    contact_states(data, grid[0, 0], contacts=contacts)
    return _finished(made, data, "contact states", contacts)


def _finished(
    made: "matplotlib.figure.Figure", data: "xarray.Dataset", what: str, contacts: Sequence[str]
) -> "matplotlib.figure.Figure":
    shared_legend(made)
    left_out = _left_out(data.sizes["contact"], len(contacts), "contacts")
    heading(made, data, f"{what}, last cycles", left_out)
    return made


def _spectrum_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure":
    made, grid = figure(width=8.0, height=3.0)
    spectrum(data, grid[0, 0])
    shared_legend(made)
    number = len(moving(data))
    shown = min(number, MAX_DISPLACEMENTS)
    heading(made, data, "harmonics of the last cycles", _left_out(number, shown, "motions"))
    return made


def _energy_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure":
    made, grid = figure(2, 1, width=9.0, height=2.0, right=2.3, sharex=True, height_ratios=[2, 1])
    energy(data, grid[0, 0]).set_xlabel("")
    energy_residual(data, grid[1, 0])
    for ax in grid[:, 0]:
        ax.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    number = data.sizes["contact"]
    left_out = f"{number - MAX_CONTACTS} of {number} contacts shown in the sum only" if number > MAX_CONTACTS else ""
    heading(made, data, "energy balance of each cycle", left_out)
    return made


def _left_out(number: int, shown: int, what: str) -> str:
    return f"{number - shown} of {number} {what} not shown (the least active)" if number > shown else ""


PICTURES: dict[str, Picture] = {
    "displacement": _displacement_figure,
    "orbit": _orbit_figure,
    "hysteresis": _hysteresis_figure,
    "normal_load": _normal_load_figure,
    "contact_states": _states_figure,
    "spectrum": _spectrum_figure,
    "energy": _energy_figure,
}
