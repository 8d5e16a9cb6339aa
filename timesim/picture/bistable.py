"""Pictures of a response that jumps: sweeps over the branch behind, which start leads where, ranges against a scalar.

``f(data, ax=None) -> ax``, where `data` is the DataTree of a `bistable` study, as `open_groups` gives it.
`PICTURES` are the figures that a run writes.
"""

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from timesim.picture import sweep as plot_sweep
from timesim.picture.hbm import DASHES, stretches
from timesim.picture.style import BLUE, VERMILION, Picture, axes, figure, heading, short
from timesim.picture.sweep import BESIDE, DIRECTIONS, NEUTRAL, spoken

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

MAX_RANGES = 4
SHADE = "0.90"
BEHIND = "0.45"
WIDE = 0.05  # of the sweeps: narrower ranges are seen magnified only
AROUND = 0.6  # of a range, shown to both sides of it
COLOURS = {0: BLUE, 1: VERMILION, 2: "0.55", -1: "white"}
LED = {0: "to the smaller motion", 1: "to the larger motion", 2: "to another motion", -1: "did not settle"}


class Place(NamedTuple):
    """One range with two motions: position along the further axes and the jumps, and the values of the axes."""

    where: Mapping[str, int]
    label: str
    low: float
    high: float


def places(data: "xarray.DataTree") -> list[Place]:
    """All ranges, those of the last axis first."""
    keys = over_keys(data)
    ends = data.to_dataset()["range"].transpose(*keys, "jump", "end").values
    made = []
    for index in product(*map(range, ends.shape[:-1])):
        low, high = ends[index]
        if np.isfinite(low):
            told = [f"{spoken(key)} {values(data, key)[i]:.4g}" for key, i in zip(keys, index, strict=False)]
            made.append(Place(dict(zip((*keys, "jump"), index, strict=True)), ", ".join(told), float(low), float(high)))
    return made


def over_keys(data: "xarray.DataTree") -> list[str]:
    """Keys of the further axes, in the scene's order."""
    return [str(name) for name in data.to_dataset()["range"].dims if name not in ("jump", "end")]


def values(data: "xarray.DataTree", name: str) -> np.ndarray:
    """An array of the root."""
    return np.asarray(data.to_dataset()[name].values)


def response(
    data: "xarray.DataTree",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    at: Mapping[str, int] | None = None,
    near: Place | None = None,
    point: str | None = None,
    axis: str | None = None,
) -> "matplotlib.axes.Axes":
    """Both sweeps, what they jump to, and the branch of harmonic balance behind, unstable where it is dashed.

    Args:
        data: the result.
        ax: axes to draw on.

    Keyword Args:
        at: position along the further axes; the first of each by default.
        near: show this range alone, with what lies beside it.
        point, axis: whose amplitude; that and along the axis with the largest by default.
    """
    ax = axes(ax)
    sweep = data.children["sweep"].to_dataset()
    point = point or plot_sweep.moving(sweep)[0]
    axis = axis or plot_sweep.main_axis(sweep, point)
    where = {key: (at or {}).get(key, 0) for key in over_keys(data)}
    here = [place for place in places(data) if all(place.where[key] == i for key, i in where.items())]
    window = None if near is None else _window(near)
    _branch(data, ax, where, (point, axis), window)
    for number, name in enumerate(sweep.direction.values):
        part = sweep.isel(where).isel(direction=number)
        y, settled = part.amplitude.sel(point=point, axis=axis).values, part.settled.values > 0
        colour, marker, x = (BLUE, VERMILION)[number], DIRECTIONS[str(name)][1], part.frequency.values
        shown = np.ones(x.size, bool) if window is None else (x >= window[0]) & (x <= window[1])
        if window is None:
            ax.plot(x, y, color=colour, linewidth=0.8, label="_line")
        for kept, style in ((settled, "full"), (~settled, "none")):
            ax.plot(x[kept & shown], y[kept & shown], marker, color=colour, ms=4, fillstyle=style, label=f"_{name}")
    for place in here if near is None else [near]:
        wide = place.high - place.low > WIDE * float(np.ptp(sweep.frequency.values))
        _range(data, ax, place, (point, axis), middle=wide or near is not None)
    ax.set(xlabel="frequency [Hz]", ylabel=f"amplitude of {short(point, 16)} {axis} [length]")
    if window is None:
        ax.set_ylim(bottom=0)
    else:
        ax.set_xlim(*window)
    return ax


def _window(place: Place) -> tuple[float, float]:
    beside = AROUND * (place.high - place.low)
    return place.low - beside, place.high + beside


def _branch(
    data: "xarray.DataTree",
    ax: "matplotlib.axes.Axes",
    where: Mapping[str, int],
    which: tuple[str, str],
    window: tuple[float, float] | None,
) -> None:
    """The curves of harmonic balance with these values, their folds marked."""
    if "hbm" not in data.children:
        return
    # In a tree the root's axes hide the variables of these names; without them points and axes go by number.
    hbm = data.children["hbm"].to_dataset(inherit=False)
    inside = np.ones(hbm.sizes["solution"], bool)
    for key, i in where.items():
        inside &= np.isclose(hbm[key].values, float(values(data, key)[i]))
    row, column = (values(data, dim).tolist().index(name) for dim, name in zip(("point", "axis"), which, strict=True))
    y = hbm.amplitude.isel(point=row, axis=column).values
    x, stable, fold = hbm.frequency.values, hbm.stable.values > 0, hbm.fold.values > 0
    for number in np.unique(hbm.curve.values[inside]):
        rows = np.flatnonzero(inside & (hbm.curve.values == number))
        for part, firm in stretches(stable[rows], fold[rows]):
            own = rows[part]
            if window is not None:
                own = _between(x, own, window)
            ax.plot(x[own], y[own], color=BEHIND, linestyle="-" if firm else DASHES, linewidth=2.2 if firm else 1.4)
        turns = [row for row in rows[fold[rows]] if window is None or window[0] <= x[row] <= window[1]]
        ax.plot(x[turns], y[turns], "D", color=BEHIND, markeredgecolor="black", ms=5, zorder=3)


def _between(x: np.ndarray, rows: np.ndarray, window: tuple[float, float]) -> np.ndarray:
    """Rows inside a window and those next to them, so that a line reaches its edge."""
    inside = (x[rows] >= window[0]) & (x[rows] <= window[1])
    wide = inside | np.append(inside[1:], False) | np.append(False, inside[:-1])
    return rows[wide]


def _range(
    data: "xarray.DataTree", ax: "matplotlib.axes.Axes", place: Place, which: tuple[str, str], *, middle: bool
) -> None:
    """A range shaded, an arrow for each jump, and where there is room the motions at its middle."""
    ax.axvspan(place.low, place.high, color=SHADE, linewidth=0, zorder=0)
    spot = {"point": which[0], "axis": which[1]}
    ends = [data.to_dataset()[name].isel(place.where).sel(spot).values for name in ("jump_from", "jump_to")]
    for frequency, before, after in zip((place.low, place.high), *ends, strict=True):
        if np.isfinite(before):
            arrow = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", (frequency, after), (frequency, before), arrowprops=arrow, zorder=5)
    for name, colour in (("lower", BLUE), ("upper", VERMILION)) if middle else ():
        value = float(data.to_dataset()[f"amplitude_{name}"].isel(place.where).sel(spot))
        ax.plot(0.5 * (place.low + place.high), value, "*", color=colour, markeredgecolor="black", ms=11, zorder=6)


def starts(
    data: "xarray.DataTree", ax: "matplotlib.axes.Axes | None" = None, *, place: Place | None = None
) -> "matplotlib.axes.Axes":
    """Which start leads to which motion: sums of the two motions at mid-range, as shares of each; rest is (0, 0)."""
    from matplotlib.colors import BoundaryNorm, ListedColormap

    ax = axes(ax)
    place = place or places(data)[0]
    branch = data.to_dataset()["start_branch"].isel(place.where).transpose("share_lower", "share_upper").values
    x, y = values(data, "share_upper"), values(data, "share_lower")
    kinds = sorted(COLOURS)
    look = ListedColormap([COLOURS[kind] for kind in kinds]), BoundaryNorm([-1.5, -0.5, 0.5, 1.5, 2.5], len(kinds))
    ax.pcolormesh(x, y, branch, shading="nearest", cmap=look[0], norm=look[1], alpha=0.55, edgecolor="white")
    for spot, kind, name in (((0, 0), "o", "rest"), ((0, 1), "v", "smaller motion"), ((1, 0), "^", "larger motion")):
        ax.plot(*spot, kind, color="black", fillstyle="none", ms=9, markeredgewidth=1.6, label=name)
    ax.set(xlabel="share of the larger motion [1]", ylabel="share of the smaller motion [1]")
    ax.grid(False)
    ax.set_aspect("equal")
    ax.set_title(", ".join(filter(None, (place.label, f"{0.5 * (place.low + place.high):.6g} Hz"))), fontsize=9)
    return ax


def existence(
    data: "xarray.DataTree", ax: "matplotlib.axes.Axes | None" = None, *, key: str | None = None
) -> "matplotlib.axes.Axes":
    """Where there are two motions: frequency between the ends of the ranges, against a scalar of the scene."""
    ax = axes(ax)
    key = key or over_keys(data)[0]
    for place in places(data):
        value = float(values(data, key)[place.where[key]])
        ax.plot([value, value], [place.low, place.high], color=BLUE, linewidth=5, solid_capstyle="butt", alpha=0.5)
        ax.plot(value, place.low, "v", color=VERMILION, ms=5, label="the sweep down jumps")
        ax.plot(value, place.high, "^", color=BLUE, ms=5, label="the sweep up jumps")
    ends = values(data, key).min(), values(data, key).max()
    margin = 0.05 * (ends[1] - ends[0]) or 1.0
    ax.set_xlim(ends[0] - margin, ends[1] + margin)
    ax.set(xlabel=spoken(key), ylabel="frequency [Hz]")
    return ax


def _handles(data: "xarray.DataTree", ax: "matplotlib.axes.Axes") -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    stars = any(line.get_marker() == "*" for line in ax.get_lines())
    marks: dict[str, Any] = {"linestyle": "", "markeredgecolor": "black", "ms": 10}
    made: list[Any] = [
        Line2D([], [], color=BLUE, marker="^", ms=4, label="sweep up"),
        Line2D([], [], color=VERMILION, marker="v", ms=4, label="sweep down"),
    ]
    if (data.children["sweep"].to_dataset().settled.values == 0).any():
        made.append(
            Line2D([], [], color=NEUTRAL, marker="^", fillstyle="none", linestyle="", ms=4, label="not settled")
        )
    if places(data):
        made += [
            Patch(color=SHADE, label="two motions"),
            Line2D([], [], color="black", marker=r"$\downarrow$", linestyle="", ms=9, label="jump"),
        ]
        if stars:
            made.append(Line2D([], [], color=VERMILION, marker="*", label="larger motion", **marks))
            made.append(Line2D([], [], color=BLUE, marker="*", label="smaller motion", **marks))
    if "hbm" in data.children:
        hbm = data.children["hbm"].to_dataset(inherit=False)
        made.append(Line2D([], [], color=BEHIND, linewidth=2.2, label="harmonic balance"))
        if (hbm.stable.values[hbm.fold.values == 0] == 0).any():
            made.append(Line2D([], [], color=BEHIND, linestyle=DASHES, label="unstable"))
        if hbm.fold.values.any():
            marks |= {"ms": 5, "color": BEHIND, "marker": "D"}
            made.append(Line2D([], [], label="fold", **marks))
    return made


def _sets(data: "xarray.DataTree") -> list[dict[str, int]]:
    keys = over_keys(data)
    return [dict(zip(keys, index, strict=True)) for index in product(*(range(data.sizes[key]) for key in keys))]


def _label(data: "xarray.DataTree", at: Mapping[str, int]) -> str:
    return ", ".join(f"{spoken(key)} {values(data, key)[i]:.4g}" for key, i in at.items())


def _response_figure(data: "xarray.DataTree") -> "matplotlib.figure.Figure":
    every = _sets(data)
    # Those with a range first.
    busy = [{key: i for key, i in place.where.items() if key != "jump"} for place in places(data)]
    kept = sorted(range(len(every)), key=lambda i: every[i] not in busy)[:MAX_RANGES]
    shown = [every[i] for i in sorted(kept)]
    made, grid = figure(len(shown), 1, width=9.0, height=4.0 if len(shown) == 1 else 2.4, gap=0.45, right=2.2)
    for ax, at in zip(grid[:, 0], shown, strict=True):
        response(data, ax, at=at)
        ax.set_title(_label(data, at), fontsize=9, pad=3, loc="right")
    grid[0, 0].legend(handles=_handles(data, grid[0, 0]), **BESIDE)
    return _finished(made, data, "sweeps up and down", len(every) - len(shown), "sets of values")


def _ranges_figure(data: "xarray.DataTree") -> "matplotlib.figure.Figure | None":
    every = places(data)
    shown = every[:MAX_RANGES]
    if not shown:
        return None
    made, grid = figure(len(shown), 1, width=9.0, height=4.0 if len(shown) == 1 else 2.6, gap=0.6, right=2.2)
    for ax, place in zip(grid[:, 0], shown, strict=True):
        response(data, ax, at={key: i for key, i in place.where.items() if key != "jump"}, near=place)
        ax.set_title(", ".join(filter(None, (place.label, f"{place.low:.8g} to {place.high:.8g} Hz"))), fontsize=9)
    grid[0, 0].legend(handles=_handles(data, grid[0, 0]), **BESIDE)
    return _finished(made, data, "where there are two motions", len(every) - len(shown), "ranges")


def _starts_figure(data: "xarray.DataTree") -> "matplotlib.figure.Figure | None":
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    every = places(data)
    shown = every[:MAX_RANGES]
    if not shown or "start_branch" not in data:
        return None
    made, grid = figure(1, len(shown), width=2.6 + 3.6 * len(shown), height=3.6, right=2.0)
    for ax, place in zip(grid[0], shown, strict=True):
        starts(data, ax, place=place)
    seen = set(
        np.unique(
            np.concatenate([data.to_dataset()["start_branch"].isel(place.where).values.ravel() for place in shown])
        )
    )
    patches = [Patch(color=COLOURS[kind], alpha=0.55, label=LED[kind]) for kind in LED if kind in seen]
    marks = [Line2D([], [], **_copy(line)) for line in grid[0, 0].get_lines()]
    grid[0, -1].legend(handles=[*patches, *marks], **BESIDE)
    return _finished(made, data, "which start leads to which motion", len(every) - len(shown), "ranges")


def _copy(line: Any) -> dict[str, Any]:
    return {
        "color": "black", "fillstyle": "none", "linestyle": "", "marker": line.get_marker(), "ms": 8,
        "label": line.get_label(),
    }  # fmt: skip


def _existence_figure(data: "xarray.DataTree") -> "matplotlib.figure.Figure | None":
    keys = [key for key in over_keys(data) if data.sizes[key] > 1]
    if not keys or not places(data):
        return None
    made, grid = figure(len(keys), 1, width=8.0, height=3.2, gap=0.7, right=2.4)
    for ax, key in zip(grid[:, 0], keys, strict=True):
        existence(data, ax, key=key)
    entries = dict(zip(*reversed(grid[0, 0].get_legend_handles_labels()), strict=True))
    grid[0, 0].legend(handles=list(entries.values()), labels=list(entries), **BESIDE)
    return _finished(made, data, "ranges with two motions", 0, "")


def _finished(
    made: "matplotlib.figure.Figure", data: "xarray.DataTree", what: str, hidden: int, of: str
) -> "matplotlib.figure.Figure":
    heading(made, data.to_dataset(), what, f"{hidden} more {of} not shown" if hidden > 0 else "")
    return made


PICTURES: dict[str, Picture] = {
    "response": _response_figure,
    "ranges": _ranges_figure,
    "starts": _starts_figure,
    "existence": _existence_figure,
}
