"""Pictures of a response that jumps: sweeps over the balance, which start leads where, ranges against a scalar.

`data` is the DataTree of a `bistable` study with the groups `sweep` and `hbm`.
"""

from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from timesim.picture import response as shared
from timesim.picture.choice import left_out, motion
from timesim.picture.figure import axes, figure, finish, from_zero, label_axes, labelled, legend_beside, stacked
from timesim.picture.style import BLUE, VERMILION, Axes, Dataset, DataTree, Figure, Picture
from timesim.result.coordinate import largest_motion, over_keys
from timesim.result.label import told_apart

MAX_RANGES = 4
SWEEPS = {"up": BLUE, "down": VERMILION}
SHADE = "0.90"
BEHIND = "0.2"
WIDE = 0.05  # of the sweeps: narrower ranges are seen magnified only
EVERYWHERE = (0.0, np.inf)  # window of frequency [Hz]
AROUND = 0.6  # of a range, shown to both sides of it
LED_TO = {
    -1: ("to no settled motion", "white", ""),
    0: ("to the smaller motion", BLUE, "////"),
    1: ("to the larger motion", VERMILION, ""),
    2: ("to another motion", "0.55", "...."),
    3: ("to one that does not repeat", "0.25", "xxxx"),
}
"""Label, colour and, for print, hatching of the motion that a start leads to."""


class DrawnRange(NamedTuple):
    """A range of frequency with two motions.

    ``at`` is its position along the further axes, ``number`` counts the ranges there; the ends are in Hz.
    """

    at: Mapping[str, int]
    number: int
    label: str
    low: float
    high: float

    @property
    def where(self) -> dict[str, int]:
        """Position along all axes, for `isel`."""
        return {**self.at, "jump": self.number}


def ranges(data: DataTree) -> list[DrawnRange]:
    """All ranges, the last of the further axes varying fastest."""
    ends = data.to_dataset()["range"].transpose(..., "jump", "end").values
    return [
        DrawnRange(at, number, _label(data, at), float(low), float(high))
        for at in _sets(data)
        for number, (low, high) in enumerate(ends[tuple(at.values())])
        if np.isfinite(low)
    ]


def _sets(data: DataTree) -> list[dict[str, int]]:
    """All positions along the further axes."""
    keys = _keys(data)
    return [dict(zip(keys, index, strict=True)) for index in product(*(range(data.sizes[key]) for key in keys))]


def _keys(data: DataTree) -> list[str]:
    return over_keys(data.to_dataset())


def _label(data: DataTree, at: Mapping[str, int]) -> str:
    root = data.to_dataset()
    return ", ".join(f"{shared.key_words(key)} {told_apart(root[key].values)[i]}" for key, i in at.items())


def response(
    data: DataTree,
    ax: Axes | None = None,
    *,
    at: Mapping[str, int] | None = None,
    near: DrawnRange | None = None,
    point: str | None = None,
    axis: str | None = None,
) -> Axes:
    """Both sweeps, what they jump to, and the curves of harmonic balance behind, dashed where they are unstable.

    Args:
        at: position along the further axes; the first of each by default.
        near: show only this range and its surroundings.
        point, axis: whose amplitude is shown; by default those of the summary (`_motion`).
    """
    ax, sweep = axes(ax), data.children["sweep"].to_dataset()
    at = {key: (at or {}).get(key, 0) for key in _keys(data)} if near is None else near.at
    shown = [item for item in ranges(data) if item.at == at] if near is None else [near]
    point, axis = _motion(data, shown, point, axis)
    beside = AROUND * (near.high - near.low) if near else np.inf
    window = (near.low - beside, near.high + beside) if near else EVERYWHERE
    for i, (direction, colour) in enumerate(SWEEPS.items()):
        _sweep(ax, sweep.isel(at).isel(direction=i).sel(point=point, axis=axis), direction, colour, window)
    for item in shown:
        wide = item.high - item.low > WIDE * float(np.ptp(sweep.frequency.values))
        _range(data, ax, item, point, axis, middle=wide or near is not None)
    if "hbm" in data.children:
        _branch(data, ax, at, point, axis, window)
    ax.set(xlabel="frequency [Hz]", ylabel=shared.amplitude_label(sweep, point, axis))
    if near is None:
        from_zero(ax)
    else:
        ax.set_xlim(*window)
    return ax


def _motion(
    data: DataTree, shown: list[DrawnRange], point: str | None = None, axis: str | None = None
) -> tuple[str, str]:
    """Point and axis that are asked for; by default where the larger motion in the ranges shown is largest."""
    if point or axis or not shown:
        return motion(data.children["sweep"].to_dataset(), point, axis)
    upper = data.to_dataset()["amplitude_upper"].isel(shown[0].at).isel(jump=[item.number for item in shown])
    place = largest_motion(upper)
    return place["point"], place["axis"]


def _sweep(
    ax: Axes,
    part: Dataset,
    direction: str,
    colour: str,
    window: tuple[float, float] = EVERYWHERE,
    name: str = "amplitude",
) -> None:
    """The points of a sweep inside a window, hollow if not settled, joined by a line if all of them are shown."""
    x, y, settled = part.frequency.values, part[name].values, part.settled.values > 0
    shown = (x >= window[0]) & (x <= window[1])
    style = shared.one_way(direction, colour, shared.PAIRED[direction], beside=True)
    look = (style if shown.all() else style._replace(line="")).look()
    gaps = shared.jumps(part, {})
    gaps = np.union1d(gaps, shared.turns(y)) if name == "phase_deg" else gaps
    marked = np.flatnonzero(np.insert(settled & shown, gaps, False)).tolist()
    if marked or shown.all():
        ax.plot(*shared.broken(x, y, gaps), label=f"sweep {direction}", ms=5, markevery=marked, **look)
    loose = ~settled & shown & np.isfinite(y)
    if loose.any():
        around: dict[str, Any] = {"color": colour, "fillstyle": "none", "marker": style.marker, "linestyle": ""}
        ax.plot(x[loose], y[loose], ms=6, label="not settled", **around)


def _branch(
    data: DataTree,
    ax: Axes,
    at: Mapping[str, int],
    point: str,
    axis: str,
    window: tuple[float, float] = EVERYWHERE,
    name: str = "amplitude",
) -> None:
    """The curves of harmonic balance with these values, their folds marked."""
    # In a tree the coordinates of the root hide variables of the same names; without them points have no names.
    root, hbm = data.to_dataset(), data.children["hbm"].to_dataset(inherit=False)
    inside = np.ones(hbm.sizes["solution"], bool)
    for key, i in at.items():
        inside &= hbm[key].values == root[key].values[i]
    row, column = root["point"].values.tolist().index(point), root["axis"].values.tolist().index(axis)
    for number in np.unique(hbm.curve.values[inside]):
        part = hbm.isel(solution=inside & (hbm.curve.values == number), point=row, axis=column)
        x, fold = part.frequency.values, part.fold.values > 0
        shown = (x >= window[0]) & (x <= window[1])
        # One more solution beyond each edge of the window, so that the line reaches the edge.
        reached = shown | np.append(shown[1:], False) | np.append(False, shown[:-1])
        y = np.where(reached, part[name].values, np.nan)
        look: dict[str, Any] = {"stable_label": "harmonic balance", "widths": (1.6, 1.2), "zorder": 1.5}
        marks = part.stable.values > 0, fold & shown
        shared.draw_branch(ax, x, y, *marks, colour=BEHIND, phase=name == "phase_deg", **look)


def phase(data: DataTree, ax: Axes | None = None, *, at: Mapping[str, int] | None = None) -> Axes:
    """Phase of the same motion in both sweeps; arguments as of `response`."""
    ax, sweep = axes(ax), data.children["sweep"].to_dataset()
    at = {key: (at or {}).get(key, 0) for key in _keys(data)}
    shown = [item for item in ranges(data) if item.at == at]
    point, axis = _motion(data, shown)
    for i, (direction, colour) in enumerate(SWEEPS.items()):
        part = sweep.isel(at).isel(direction=i).sel(point=point, axis=axis)
        _sweep(ax, part, direction, colour, name="phase_deg")
    for item in shown:
        _span(ax, item)
    if "hbm" in data.children and "phase_deg" in data.children["hbm"]:
        _branch(data, ax, at, point, axis, name="phase_deg")
    ax.set_xlabel("frequency [Hz]")
    return shared.over_phase(ax)


def _span(ax: Axes, item: DrawnRange) -> None:
    ax.axvspan(item.low, item.high, color=SHADE, linewidth=0, zorder=0, label="two motions")


def _range(data: DataTree, ax: Axes, item: DrawnRange, point: str, axis: str, *, middle: bool) -> None:
    """A range shaded, with an arrow for each jump and, where there is room, the motions at its middle."""
    _span(ax, item)
    here = data.to_dataset().isel(item.where).sel(point=point, axis=axis)
    ends = here["jump_from"].values, here["jump_to"].values, here["range_irregular"].values
    for frequency, before, after, loser in zip((item.low, item.high), *ends, strict=True):
        if np.isfinite(before) and not loser:  # a motion that loses its period does not jump
            arrow = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", (frequency, after), (frequency, before), arrowprops=arrow, zorder=5)
            ax.plot([], [], color="black", marker=r"$\downarrow$", linestyle="", ms=9, label="jump")
    star: dict[str, Any] = {"markeredgecolor": "black", "linestyle": "", "ms": 11, "zorder": 6}
    # Where another axis is shown, the motion with the larger amplitude of all may have the smaller one along it.
    middle = middle and bool(here["amplitude_lower"] <= here["amplitude_upper"])
    for name, words, colour in (("lower", "smaller", BLUE), ("upper", "larger", VERMILION)) if middle else ():
        value = float(here[f"amplitude_{name}"])
        ax.plot(0.5 * (item.low + item.high), value, "*", color=colour, label=f"{words} motion", **star)


def starts(data: DataTree, ax: Axes | None = None, *, at: DrawnRange | None = None) -> Axes:
    """Which start leads to which motion: sums of the two motions at mid-range, as shares of each; rest is (0, 0)."""
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import PathPatch

    ax, item, root = axes(ax), at or ranges(data)[0], data.to_dataset()
    branch = root["start_branch"].isel(item.where).transpose("share_lower", "share_upper").values
    colours = ListedColormap([colour for _, colour, _ in LED_TO.values()])
    norm = BoundaryNorm(np.arange(-1.5, len(LED_TO) - 1), colours.N)
    x, y = root["share_upper"].values, root["share_lower"].values
    ax.pcolormesh(x, y, branch, shading="nearest", cmap=colours, norm=norm, alpha=0.55, edgecolor="white")
    for number, (_, _, hatch) in LED_TO.items():
        if hatch and (branch == number).any():
            cells = _cells(x, y, branch == number)
            ax.add_patch(PathPatch(cells, facecolor="none", edgecolor=BEHIND, linewidth=0.0, hatch=hatch))
    for spot, kind, name in (((0, 0), "o", "rest"), ((0, 1), "v", "smaller motion"), ((1, 0), "^", "larger motion")):
        look: dict[str, Any] = {"color": "white", "markeredgecolor": "black", "markeredgewidth": 1.6, "linestyle": ""}
        ax.plot(*spot, kind, ms=9, label=name, **look)
    ax.set(xlabel="share of the larger motion [1]", ylabel="share of the smaller motion [1]")
    ax.grid(False)
    ax.set_aspect("equal")
    ax.set_title(", ".join(filter(None, (item.label, f"{0.5 * (item.low + item.high):.6g} Hz"))), fontsize=9)
    return ax


def _cells(x: np.ndarray, y: np.ndarray, inside: np.ndarray) -> Any:
    """Outline of the cells about some points of a regular grid, of shape (y, x)."""
    from matplotlib.path import Path

    across, up = 0.5 * (x[1] - x[0]), 0.5 * (y[1] - y[0])
    corners = np.array([(-across, -up), (across, -up), (across, up), (-across, up), (-across, -up)])
    middles = (np.array([x[j], y[i]]) for i, j in np.argwhere(inside))
    return Path.make_compound_path(*(Path(corners + middle, closed=True) for middle in middles))


def existence(data: DataTree, ax: Axes | None = None, *, key: str | None = None) -> Axes:
    """Where there are two motions: frequency between the ends of the ranges, against a scalar of the scene."""
    ax, key, root = axes(ax), key or _keys(data)[0], data.to_dataset()
    scalar = root[key].values
    for item in ranges(data):
        value = float(scalar[item.at[key]])
        ax.plot([value, value], [item.low, item.high], color=BLUE, linewidth=5, solid_capstyle="butt", alpha=0.5)
        here = root[["jump_from", "range_irregular"]].isel(item.where)
        before = here["jump_from"].transpose("end", ...).values, here["range_irregular"].values
        ends = (item.low, "v", VERMILION, "down"), (item.high, "^", BLUE, "up")
        for (end, kind, colour, name), amplitude, loser in zip(ends, *before, strict=True):
            if np.isfinite(amplitude).all() and not loser:  # else it is the end of the search, or no jump
                ax.plot(value, end, kind, color=colour, ms=5, label=f"the sweep {name} jumps")
    margin = 0.05 * np.ptp(scalar) or 1.0
    ax.set_xlim(scalar.min() - margin, scalar.max() + margin)
    ax.set(xlabel=shared.axis_label(root, key), ylabel="frequency [Hz]")
    return ax


def _response_figure(data: DataTree) -> Figure:
    sets, two = _sets(data), [item.at for item in ranges(data)]
    first = sorted(range(len(sets)), key=lambda i: sets[i] not in two)[:MAX_RANGES]
    shown = [response, phase] if shared.has_phase(data.children["sweep"].dataset) else [response]
    fig, axs = shared.with_phase(len(first), 4.0 if len(first) == 1 else 2.4, len(shown) > 1)
    for ax, (i, draw) in zip(axs, product(sorted(first), shown), strict=True):
        label_axes(draw(data, ax, at=sets[i]), _label(data, sets[i]))
        ax.label_outer()
    legend_beside(axs[0], labelled(*axs).values())
    return finish(fig, data, "sweeps up and down", left_out(len(sets), len(first), "sets of values"))


def _ranges_figure(data: DataTree) -> Figure | None:
    shown = ranges(data)[:MAX_RANGES]
    if not shown:
        return None
    fig, axs = stacked(len(shown), 4.0 if len(shown) == 1 else 2.6, share_x=False)
    for ax, item in zip(axs, shown, strict=True):
        response(data, ax, near=item)
        ax.set_title(", ".join(filter(None, (item.label, f"{item.low:.8g} to {item.high:.8g} Hz"))), fontsize=9)
    legend_beside(axs[0], labelled(*axs).values())
    return finish(fig, data, "where there are two motions", left_out(len(ranges(data)), len(shown), "ranges"))


def _starts_figure(data: DataTree) -> Figure | None:
    from matplotlib.patches import Patch

    if "start_branch" not in data:
        return None
    cycles = data.to_dataset()["start_cycles"]
    every = [item for item in ranges(data) if int(cycles.isel(item.where).min()) >= 0]
    if not (shown := every[:MAX_RANGES]):
        return None
    fig, grid = figure(1, len(shown), width=2.6 + 3.6 * len(shown), height=3.6, right=2.0)
    for ax, item in zip(grid[0], shown, strict=True):
        starts(data, ax, at=item)
    led = np.unique([data["start_branch"].isel(item.where).values for item in shown])
    patches = []
    for label, colour, hatch in (LED_TO[kind] for kind in led.tolist()):
        patches.append(Patch(facecolor=colour, edgecolor=BEHIND, alpha=0.55, hatch=hatch, label=label))
    legend_beside(grid[0, -1], [*patches, *labelled(grid[0, 0]).values()])
    return finish(fig, data, "which start leads to which motion", left_out(len(every), len(shown), "ranges"))


def _existence_figure(data: DataTree) -> Figure | None:
    keys = [key for key in _keys(data) if data.sizes[key] > 1]
    if not keys or not ranges(data):
        return None
    fig, axs = stacked(len(keys), 3.2, share_x=False)
    for ax, key in zip(axs, keys, strict=True):
        existence(data, ax, key=key)
    legend_beside(axs[0], labelled(*axs).values())
    return finish(fig, data, "ranges with two motions")


PICTURES: dict[str, Picture] = {
    "response": _response_figure,
    "ranges": _ranges_figure,
    "starts": _starts_figure,
    "existence": _existence_figure,
}
