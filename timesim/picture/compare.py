"""Pictures of a comparison: the points of the sweep on the curves of harmonic balance, and their difference.

`data` is the DataTree of a `compare` study with the groups `sweep`, `hbm` and, where the contacts did more than stick
or stay apart, `cycle`.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np

from timesim.orbit.steady_state import switches
from timesim.picture import hbm as balance
from timesim.picture.choice import MAX_ROWS, busiest, left_out, motion, motions
from timesim.picture.figure import axes, figure, finish, from_zero, label_axes, over_cycle, over_decades, stacked
from timesim.picture.response import PAIRED, has_phase, several_cycles, with_phase
from timesim.picture.style import (
    SERIES,
    Axes,
    Dataset,
    DataTree,
    Figure,
    Picture,
    Series,
    is_stop,
    short,
    state_bar,
    unit,
)
from timesim.result.coordinate import ALIKE, over_keys, rubs

METHODS = {"sweep": "time integration", "hbm": "harmonic balance"}
SHORT = {"sweep": "in time", "hbm": "balance"}  # beside a bar
PHASE = "phase of the excitation [degree]"
# Amplitudes below this share of the largest are left out of the difference that is drawn.
MINOR = 1e-3
NO_CURVE = Series("0.5", "", "s")  # hollow, so that the legend, which is in one grey, tells it from the others
DOT = {"ms": 3.8}
TRIANGLE = {"ms": 7.0, "markeredgecolor": "white", "markeredgewidth": 0.6}  # beside the point


Points = tuple[dict[str, int], dict[str, Any]]
"""Points of a sweep with one set of values and one direction: the positions along these axes, and the style."""


def overlay(
    data: DataTree,
    ax: Axes | None = None,
    *,
    point: str | None = None,
    axis: str | None = None,
    name: str = "amplitude",
) -> Axes:
    """Curves of harmonic balance and points of the sweep, hollow if not settled, ringed if of several cycles.

    ``name``: amplitude or phase_deg.
    """
    hbm, sweep = _groups(data)
    point, axis = motion(hbm if hbm.sizes["solution"] else sweep, point, axis)
    drawn = balance.response if name == "amplitude" else balance.phase
    ax = drawn(hbm, axes(ax), point=point, axis=axis)
    for where, look in _points(hbm, sweep):
        part = sweep.isel(where)
        y, settled = part[name].sel(point=point, axis=axis).values, part.settled.values > 0
        if np.isfinite(y).any():
            _settled_or_hollow(ax, part.frequency.values, y, settled, look)
        several_cycles(ax, sweep, where, y)
    if name == "amplitude":
        from_zero(ax)
    return ax


def difference(data: DataTree, ax: Axes | None = None) -> Axes:
    """Largest relative difference of a point's amplitudes at each frequency.

    Pale where the motion is linear, hollow where it has not settled, ringed where it repeats after several cycles: the
    balance knows motions of one. Crossed where a contact that sticks has another offset: the verdict leaves it out.
    """
    ax, root, (hbm, sweep) = axes(ax), data.to_dataset(), _groups(data)
    counts = sweep.amplitude > MINOR * sweep.amplitude.max(("point", "axis"))
    size = abs(root["relative_difference"].where(counts.values)).max(("point", "axis"))
    linear = ~switches(sweep.slip_share * rubs(sweep), sweep.separation_share).any("contact")
    for where, look in _points(hbm, sweep):
        x, y, pale = sweep.frequency.values, size.isel(where).values, linear.isel(where).values
        settled = sweep.settled.isel(where).values > 0
        for which, faint in ((~pale, {}), (pale, {"alpha": 0.25})):
            _settled_or_hollow(ax, x[which], y[which], settled[which], look | faint)
        several_cycles(ax, sweep, where, y)
        if "other_offset" in root and (other := root["other_offset"].isel(where).values > 0).any():
            ax.plot(x[other], y[other], "x", color="0.2", ms=4, label="another offset")
    for fold in hbm.frequency.values[hbm.fold.values > 0]:
        ax.axvline(fold, color="0.6", linewidth=0.7, linestyle=":", label="frequency of a fold")
    over_decades(ax)
    ax.set(xlabel="frequency [Hz]", ylabel="relative difference [1]")
    return ax


def _settled_or_hollow(ax: Axes, x: np.ndarray, y: np.ndarray, settled: np.ndarray, look: dict[str, Any]) -> None:
    """Points that have settled as filled markers, the others as larger hollow ones."""
    ax.plot(x[settled], y[settled], **look)
    if not settled.all():
        hollow = look | {"label": "not settled", "fillstyle": "none", "markeredgecolor": look["color"]}
        ax.plot(x[~settled], y[~settled], **hollow | {"ms": 1.5 * look["ms"]})


def share(data: DataTree, ax: Axes | None = None, *, state: str = "slip") -> Axes:
    """Share of a period in a state by both methods, for the contact in which it is largest; of slip, if it can slip."""
    hbm, sweep = _groups(data)
    name, contact = f"{state}_share", _most(data, state)
    ax = balance.share(hbm, axes(ax), contact=contact, state=state)
    for where, look in _points(hbm, sweep):
        part = sweep.isel(where)
        y = part[name].sel(contact=contact).values
        ax.plot(part.frequency.values, y, **look)
        several_cycles(ax, sweep, where, y)
    label_axes(ax, short(contact))
    return ax


def _most(data: DataTree, state: str) -> str:
    """The contact that by the balance is in a state for most of the time, the first of those that are alike."""
    hbm, sweep = _groups(data)
    size = hbm[f"{state}_share"].sum("solution").values * (rubs(sweep).values if state == "slip" else 1)
    return str(sweep.contact.values[int(np.argmax(size >= (1 - ALIKE) * size.max()))])


def _groups(data: DataTree) -> tuple[Dataset, Dataset]:
    return data["hbm"].to_dataset(), data["sweep"].to_dataset()


def _points(hbm: Dataset, sweep: Dataset) -> Iterator[Points]:
    """The points of the sweep in the colours of the curves with the same values; grey if there is no such curve.

    Markers tell the directions, or the values if there are no directions.
    """
    keys = over_keys(hbm)
    styles = {family.values: family.style for family in balance.families(hbm)}
    undrawn = set(balance.sets(hbm)) - set(styles)
    for where in product(*(range(sweep.sizes[key]) for key in keys)):
        values = tuple(float(sweep[key].values[i]) for key, i in zip(keys, where, strict=True))
        if values in undrawn:
            continue
        for i, direction in enumerate(sweep.direction.values):
            alone, style = direction == "independent", styles.get(values, NO_CURVE)
            words = (METHODS["sweep"], "" if alone else direction, "" if values in styles else "no curve")
            look = {"color": style.colour, "marker": style.marker if alone else PAIRED[direction], "linestyle": ""}
            look |= {"label": ", ".join(filter(None, words)), **(DOT if alone else TRIANGLE)}
            if values not in styles:
                look |= {"fillstyle": "none", "markeredgecolor": style.colour}
            if alone and values in styles and len(styles) > 1:
                look["label"] = f"_{METHODS['sweep']}"  # the legend has the markers of the values
            yield dict(zip(keys, where, strict=True)) | {"direction": i}, look


def waveform(data: DataTree, ax: Axes | None = None) -> Axes:
    """Displacement over the cycle by both methods, of the point and axis that move most."""
    ax, (cycle, point, axis) = axes(ax), _cycle(data)
    for method, style in zip(cycle.found_by.values, SERIES, strict=False):
        x = cycle.displacement.sel(found_by=method, point=point, axis=axis).values
        look = style._replace(marker="", beneath=style.line == "-").look()
        ax.plot(cycle.excitation_angle.values, x, label=METHODS[method], **look)
    ax.set_ylabel(f"{short(point, 16)} {axis}{unit(cycle, 'displacement')}")
    return over_cycle(ax, PHASE)


def contact_states(data: DataTree, ax: Axes | None = None) -> Axes:
    """State of the contacts over the cycle by both methods, as bars."""
    ax, cycle = axes(ax), data["cycle"].to_dataset()
    angle = np.append(cycle.excitation_angle.values, 360.0)
    changes = (cycle.contact_state.diff("excitation_angle") != 0).sum(("found_by", "excitation_angle"))
    rows = list(product(busiest(cycle, changes.values), cycle.found_by.values))
    for row, (contact, method) in enumerate(rows):
        state = cycle.contact_state.sel(contact=contact, found_by=method).values
        edges = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), state.size]
        parts = ((angle[a], angle[b], int(state[a])) for a, b in pairwise(edges))
        state_bar(ax, row, parts, stop=is_stop(cycle, contact))
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_yticks(range(len(rows)), [f"{short(str(contact), 10)}\n{SHORT[method]}" for contact, method in rows])
    ax.grid(False)
    return over_cycle(ax, PHASE)


def harmonics(data: DataTree, ax: Axes | None = None) -> Axes:
    """Harmonics of the same displacement by both methods, on a logarithmic axis."""
    ax, (cycle, point, axis) = axes(ax), _cycle(data)
    for method, style in zip(cycle.found_by.values, SERIES, strict=False):
        height = np.abs(cycle.harmonic_amplitude.sel(found_by=method, point=point, axis=axis).values)
        look: dict[str, Any] = {"fillstyle": "none", "linestyle": "", "ms": 6 if method == "sweep" else 3.5}
        known = np.where(height > balance.NOISE * height.max(), height, np.nan)
        ax.plot(cycle.harmonic.values, known, style.marker, color=style.colour, **look)
    content = np.abs(cycle.harmonic_amplitude.sel(point=point, axis=axis).values)
    what = "harmonic (circles: time integration, squares: harmonic balance)"
    ax.set(xlabel=what, ylabel=f"amplitude{unit(cycle, 'harmonic_amplitude')}")
    lowest = float(np.min(content[content > 0], initial=np.inf))
    return balance.over_harmonics(ax, cycle, lowest, float(content.max()))


def _cycle(data: DataTree) -> tuple[Dataset, str, str]:
    """The cycle, and the point and axis that move most in it."""
    cycle = data["cycle"].to_dataset()
    x = cycle.displacement.transpose("point", "axis", ...).values
    return cycle, *motions(cycle, np.ptp(x.reshape(*x.shape[:2], -1), axis=-1))[0]


def _legend(axs: Sequence[Axes], hbm: Dataset, sweep: Dataset) -> None:
    balance.legend(axs, hbm, markers="independent" in sweep.direction.values, lines=METHODS["hbm"])


def _overlay_figure(data: DataTree) -> Figure:
    hbm, sweep = _groups(data)
    fig, axs = with_phase(1, 4.6, has_phase(hbm) and has_phase(sweep))
    for ax, name in zip(axs, ("amplitude", "phase_deg"), strict=False):
        overlay(data, ax, name=name).label_outer()
    _legend(axs, hbm, sweep)
    return finish(fig, data, "harmonic balance (lines) and time integration (markers)", balance.hidden(hbm))


def _difference_figure(data: DataTree) -> Figure | None:
    hbm, sweep = _groups(data)
    if not np.isfinite(np.asarray(data["relative_difference"])).any():
        return None
    exist = {"slip": rubs(sweep).any(), "separation": hbm.sizes["contact"]}
    shares = [state for state, some in exist.items() if some]
    fig, axs = stacked(1 + len(shares), 2.2)
    difference(data, axs[0])
    for ax, state in zip(axs[1:], shares, strict=True):
        share(data, ax, state=state)
    for ax in axs:
        ax.label_outer()
    _legend(axs, hbm, sweep)
    what = "difference of the amplitudes (pale: the contacts only stick or stay apart), shares of the states"
    shown = {_most(data, state) for state in shares}
    note = left_out(sweep.sizes["contact"], len(shown), "contacts", "for less of the time in that state")
    return finish(fig, data, what, note, balance.hidden(hbm))


def _cycle_figure(data: DataTree) -> Figure | None:
    if "cycle" not in data.children:
        return None
    fig, grid = figure(3, 1, width=8.5, height=2.1, gap=0.55)
    waveform(data, grid[0, 0])
    contact_states(data, grid[1, 0])
    harmonics(data, grid[2, 0])
    note = left_out(data["cycle"].sizes["contact"], MAX_ROWS, "contacts", "the least active")
    return finish(fig, data, f"a cycle by both methods where they differ most: {data['cycle'].attrs['place']}", note)


PICTURES: dict[str, Picture] = {"overlay": _overlay_figure, "difference": _difference_figure, "cycle": _cycle_figure}
