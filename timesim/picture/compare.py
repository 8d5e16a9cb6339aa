"""Pictures of a comparison: the points of the sweep on the curves of the harmonic balance, and how far they are apart.

``f(data, ax=None) -> ax``, where `data` is the DataTree of a comparison, as `open_groups` gives it.
"""

from collections.abc import Iterator
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from timesim.model.model import STATE_NAMES
from timesim.orbit.share import switches
from timesim.picture import hbm as plot_hbm
from timesim.picture.style import SERIES, STATE_STYLE, Picture, axes, figure, heading, shared_legend, short

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

DIRECTIONS = {"up": "^", "down": "v", "independent": "o"}
# Amplitudes of a point along an axis below this share of the largest do not count in the difference that is drawn.
MINOR = 1e-3
FOLD: dict[str, Any] = {"color": "0.6", "linewidth": 0.7, "linestyle": ":"}


class Points(NamedTuple):
    """The points of a sweep with one set of values in one direction.

    Attributes:
        where: positions along the further axes and the direction, for `isel`.
        colour: that of the curves with these values.
        direction: up, down or independent.
    """

    where: dict[str, int]
    colour: str
    direction: str


def overlay(
    data: "xarray.DataTree",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    point: str | None = None,
    axis: str | None = None,
) -> "matplotlib.axes.Axes":
    """Curves of the harmonic balance and points of the sweep; hollow where they have not settled."""
    hbm, sweep = data["hbm"].to_dataset(), data["sweep"].to_dataset()
    point = point or plot_hbm.moving(hbm)[0]
    axis = axis or plot_hbm.main_axis(hbm, point)
    ax = plot_hbm.response(hbm, axes(ax), point=point, axis=axis)
    for points in _points(data):
        part = sweep.isel(points.where)
        y, settled = part.amplitude.sel(point=point, axis=axis).values, part.settled.values > 0
        look: dict[str, Any] = {"color": points.colour, "marker": DIRECTIONS[points.direction], "linestyle": ""}
        ax.plot(part.frequency.values[settled], y[settled], ms=3.2, **look)
        ax.plot(part.frequency.values[~settled], y[~settled], ms=5, fillstyle="none", **look)
    return ax


def difference(data: "xarray.DataTree", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Largest relative difference of a point's amplitudes at each frequency; pale where the motion is linear."""
    ax = axes(ax)
    sweep = data["sweep"].to_dataset()
    moved = sweep.amplitude
    counts = moved > MINOR * moved.max(("point", "axis"))
    size = abs(data["relative_difference"].where(counts.values)).max(("point", "axis"))
    linear = ~switches(sweep.slip_share, sweep.separation_share).any("contact")
    for points in _points(data):
        y, still = size.isel(points.where).values, linear.isel(points.where).values
        x, marker = sweep.frequency.values, DIRECTIONS[points.direction]
        ax.plot(x[~still], y[~still], marker, color=points.colour, ms=3.5)
        ax.plot(x[still], y[still], marker, color=points.colour, ms=3, alpha=0.25)
    for fold in _folds(data):
        ax.axvline(fold, **FOLD)
    ax.set_yscale("log")
    ax.set(xlabel="frequency [Hz]", ylabel="relative difference [1]")
    return ax


def _folds(data: "xarray.DataTree") -> np.ndarray:
    return data["hbm"].frequency.values[data["hbm"].fold.values > 0]


def share(
    data: "xarray.DataTree", ax: "matplotlib.axes.Axes | None" = None, *, state: str = "slip"
) -> "matplotlib.axes.Axes":
    """Share of a period in a state by both methods, of the contact that has most of it."""
    hbm, sweep = data["hbm"].to_dataset(), data["sweep"].to_dataset()
    name = f"{state}_share"
    contact = str(sweep.contact.values[int(np.argmax(hbm[name].sum("solution").values))])
    ax = plot_hbm.share(hbm, axes(ax), contact=contact, state=state)
    for points in _points(data):
        part = sweep.isel(points.where)
        marker = DIRECTIONS[points.direction]
        ax.plot(part.frequency.values, part[name].sel(contact=contact).values, marker, color=points.colour, ms=2.5)
    ax.set_title(short(contact), fontsize=9, pad=3, loc="right")
    return ax


def _points(data: "xarray.DataTree") -> Iterator[Points]:
    hbm, sweep = data["hbm"].to_dataset(), data["sweep"].to_dataset()
    keys = plot_hbm.over_keys(hbm)
    colours = {family.label: family.colour for family in plot_hbm.families(hbm)}
    for where in product(*(range(sweep.sizes[key]) for key in keys)):
        label = plot_hbm.named(keys, [float(sweep[key].values[i]) for key, i in zip(keys, where, strict=True)])
        for d, direction in enumerate(sweep.direction.values):
            if label in colours:
                yield Points(dict(zip(keys, where, strict=True)) | {"direction": d}, colours[label], str(direction))


def _handles(data: "xarray.DataTree", *, hollow: bool) -> list[Any]:
    from matplotlib.lines import Line2D

    names = [str(name) for name in data["sweep"].direction.values]
    look: dict[str, Any] = {"color": plot_hbm.NEUTRAL, "linestyle": "", "ms": 4}
    told = {"up": "time integration, up", "down": "time integration, down", "independent": "time integration"}
    made = [Line2D([], [], marker=DIRECTIONS[name], label=told[name], **look) for name in names]
    if hollow and (data["sweep"].settled.values == 0).any():
        made.append(Line2D([], [], marker=DIRECTIONS[names[0]], fillstyle="none", label="not settled", **look))
    return made


def _fold_handles(data: "xarray.DataTree") -> list[Any]:
    from matplotlib.lines import Line2D

    return [Line2D([], [], label="frequency of a fold", **FOLD)] if _folds(data).size else []


def _overlay_figure(data: "xarray.DataTree") -> "matplotlib.figure.Figure | None":
    hbm = data["hbm"].to_dataset()
    if not hbm.sizes["solution"]:
        return None
    made, grid = plot_hbm.beside(1, 4.6)
    overlay(data, grid[0, 0])
    plot_hbm.legend(grid[0, 0], hbm, extra=_handles(data, hollow=True))
    return plot_hbm.finished(made, _titled(data, hbm), "harmonic balance (lines) and time integration (markers)")


def _difference_figure(data: "xarray.DataTree") -> "matplotlib.figure.Figure | None":
    hbm = data["hbm"].to_dataset()
    if not hbm.sizes["solution"]:
        return None
    shares = ("slip", "separation") if hbm.sizes["contact"] else ()
    made, grid = plot_hbm.beside(1 + len(shares), 2.2)
    difference(data, grid[0, 0])
    for ax, state in zip(grid[1:, 0], shares, strict=True):
        share(data, ax, state=state)
    for ax in grid[:, 0]:
        ax.label_outer()
    plot_hbm.legend(grid[0, 0], hbm, extra=[*_handles(data, hollow=False), *_fold_handles(data)])
    what = "difference of the amplitudes (pale: the contacts only stick or stay apart), and the shares of the states"
    return plot_hbm.finished(made, _titled(data, hbm), what)


def _titled(data: "xarray.DataTree", part: "xarray.Dataset") -> "xarray.Dataset":
    """A part with the attributes of the whole, for the heading."""
    return part.assign_attrs({name: data.attrs[name] for name in ("title", "complete") if name in data.attrs})


def _cycle_figure(data: "xarray.DataTree") -> "matplotlib.figure.Figure | None":
    if "cycle" not in data.children:
        return None
    cycle = data["cycle"].to_dataset()
    names = [str(name) for name in cycle.contact.values][: plot_hbm.MAX_ROWS]
    made, grid = figure(3, 1, width=8.5, height=2.1, gap=0.55)
    waveform(data, grid[0, 0])
    states(data, grid[1, 0])
    content(data, grid[2, 0])
    shared_legend(made)
    heading(made, _titled(data, cycle), f"a cycle by both methods where they differ most: {cycle.attrs['place']}")
    assert names
    return made


def waveform(data: "xarray.DataTree", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Displacement over the cycle by both methods, of the point and along the axis that moves most."""
    ax, (cycle, point, axis) = axes(ax), _cycle(data)
    for method, style in zip(cycle.found_by.values, SERIES, strict=False):
        x = cycle.displacement.sel(found_by=method, point=point, axis=axis).values
        ax.plot(cycle.excitation_angle.values, x, color=style.colour, linestyle=style.line, label=_spoken(method))
    ax.set(ylabel=f"{short(point, 16)} {axis} [length]", xlim=(0, 360), xlabel="phase of the excitation [degree]")
    ax.set_xticks(range(0, 361, 60))
    return ax


def states(data: "xarray.DataTree", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """State of the contacts over the cycle by both methods, as bars."""
    ax, cycle = axes(ax), data["cycle"].to_dataset()
    angle = np.append(cycle.excitation_angle.values, 360.0)
    contacts = cycle.contact.values[: plot_hbm.MAX_ROWS]
    rows = list(product(contacts, cycle.found_by.values))
    for row, (contact, method) in enumerate(rows):
        state = cycle.contact_state.sel(contact=contact, found_by=method).values
        edges = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), state.size]
        for a, b in pairwise(edges):
            style = STATE_STYLE[int(state[a])]
            bars = ax.broken_barh([(angle[a], angle[b] - angle[a])], (row - 0.35, 0.7), facecolor=style.colour)
            bars.set(edgecolor="white", linewidth=0, hatch=style.hatch, label=STATE_NAMES[int(state[a])])
    ax.set(xlim=(0, 360), ylim=(len(rows) - 0.4, -0.6), xlabel="phase of the excitation [degree]")
    ax.set_xticks(range(0, 361, 60))
    ax.set_yticks(range(len(rows)), [f"{short(str(contact), 8)}, {method}" for contact, method in rows])
    ax.grid(False)
    return ax


def content(data: "xarray.DataTree", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Harmonics of the same displacement by both methods, on a logarithmic axis."""
    ax, (cycle, point, axis) = axes(ax), _cycle(data)
    for method, style in zip(cycle.found_by.values, SERIES, strict=False):
        height = np.abs(cycle.harmonic_amplitude.sel(found_by=method, point=point, axis=axis).values)
        look: dict[str, Any] = {"fillstyle": "none", "linestyle": "", "ms": 6 if method == "sweep" else 3.5}
        ax.plot(cycle.harmonic.values, np.where(height > 0, height, np.nan), style.marker, color=style.colour, **look)
    ax.set_yscale("log")
    ax.set(xlabel="harmonic", ylabel="amplitude [length]")
    ax.locator_params(axis="x", integer=True)
    return ax


def _cycle(data: "xarray.DataTree") -> tuple["xarray.Dataset", str, str]:
    cycle = data["cycle"].to_dataset()
    reach = cycle.displacement.max(("found_by", "excitation_angle")) - cycle.displacement.min(
        ("found_by", "excitation_angle")
    )
    point, axis = np.unravel_index(int(np.argmax(reach.values)), reach.shape)
    return cycle, str(cycle.point.values[point]), str(cycle.axis.values[axis])


def _spoken(method: str) -> str:
    return {"sweep": "time integration", "hbm": "harmonic balance"}[str(method)]


PICTURES: dict[str, Picture] = {
    "overlay": _overlay_figure,
    "difference": _difference_figure,
    "cycle": _cycle_figure,
}
