"""Pictures of response curves by harmonic balance.

``f(data, ax=None) -> ax``, where `data` is the result of an `hbm` study. A curve has a colour for each set of values of
the further axes; it is solid where it is stable and dashed where not, and a diamond marks each fold. `PICTURES` are the
figures that a run writes.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from timesim.picture.style import Picture, axes, figure, heading, short
from timesim.picture.sweep import BESIDE, spoken, styles

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

MAX_CURVES = 12
MAX_ROWS = 3
NEUTRAL = "0.25"
DASHES = (0, (4, 2))


class Family(NamedTuple):
    """The curves of one set of values of the further axes.

    Attributes:
        label: the values; empty where there are none.
        rows: position of each curve's solutions.
        colour, marker: how it is drawn.
    """

    label: str
    rows: list[np.ndarray]
    colour: str
    marker: str


def response(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    point: str | None = None,
    axis: str | None = None,
) -> "matplotlib.axes.Axes":
    """Amplitude of a point along the curves, by default of that and along the axis with the largest."""
    ax = axes(ax)
    point, axis = point or moving(data)[0], axis or main_axis(data, point or moving(data)[0])
    along(data, ax, data.amplitude.sel(point=point, axis=axis).values)
    ax.set_ylim(bottom=0)
    ax.set(xlabel=abscissa(data), ylabel=f"amplitude of {short(point, 16)} {axis} [length]")
    return ax


def share(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    contact: str | None = None,
    state: str = "slip",
) -> "matplotlib.axes.Axes":
    """Share of a period that a contact spends in a state, ``slip`` or ``separation``, along the curves."""
    ax = axes(ax)
    along(data, ax, data[f"{state}_share"].sel(contact=contact or str(data.contact.values[0])).values)
    ax.set(xlabel=abscissa(data), ylabel=f"share in {state} [1]", ylim=(-0.04, 1.04))
    return ax


def harmonics(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    point: str | None = None,
    axis: str | None = None,
) -> "matplotlib.axes.Axes":
    """Harmonic content where each set's curves have their largest amplitude, on a logarithmic axis; 0 is the mean."""
    ax = axes(ax)
    point, axis = point or moving(data)[0], axis or main_axis(data, point or moving(data)[0])
    order, place = data.harmonic.values, data.amplitude.sel(point=point, axis=axis).values
    found, lowest = np.abs(data.harmonic_amplitude.sel(point=point, axis=axis).values), np.inf
    for family in families(data):
        rows = np.concatenate([np.zeros(0, int), *family.rows])
        if rows.size:
            height = found[rows][int(np.argmax(place[rows]))]
            lowest = min(lowest, float(np.min(height[height > 0], initial=np.inf)))
            look: dict[str, Any] = {"color": family.colour, "linewidth": 0.6, "ms": 4}
            ax.plot(order, np.where(height > 0, height, np.nan), marker=family.marker, **look)
    ax.set_yscale("log")
    top = float(found.max(initial=0.0)) or 1.0
    ax.set_ylim(max(top * 1e-9, min(lowest, top) / 2), 2 * top)
    ax.set(xlabel="harmonic", ylabel=f"harmonic of {short(point, 16)} {axis} [length]")
    ax.locator_params(axis="x", integer=True)
    return ax


def along(data: "xarray.Dataset", ax: "matplotlib.axes.Axes", y: np.ndarray) -> None:
    """A quantity along all curves: solid where they are stable, dashed where not, their folds marked."""
    x, stable, fold = data[parameter(data)].values, data.stable.values > 0, data.fold.values > 0
    for family in families(data):
        for rows in family.rows:
            for part, firm in stretches(stable[rows], fold[rows]):
                line: dict[str, Any] = {"linestyle": "-" if firm else DASHES, "linewidth": 1.4 if firm else 1.1}
                ax.plot(x[rows[part]], y[rows[part]], color=family.colour, **line)
            turns = rows[fold[rows]]
            ax.plot(x[turns], y[turns], "D", color=family.colour, markeredgecolor="black", ms=4.5, zorder=4)


def stretches(stable: np.ndarray, fold: np.ndarray) -> list[tuple[slice, bool]]:
    """Parts of a curve that are stable, or not, each with the solutions that bound it.

    A fold belongs to both sides.
    """
    firm = stable.copy()
    for i in np.flatnonzero(fold).tolist():
        firm[i] = firm[i - 1] if i else firm[min(i + 1, firm.size - 1)]
    edges: list[int] = [0, *(np.flatnonzero(firm[1:] != firm[:-1]) + 1).tolist(), firm.size]
    return [(slice(max(a - 1, 0), b), bool(firm[a])) for a, b in pairwise(edges) if b > a]


def families(data: "xarray.Dataset") -> list[Family]:
    """The curves by their values of the further axes, at most `MAX_CURVES` sets of equal spacing."""
    keys, curve = over_keys(data), data.curve.values
    values = np.stack([data[key].values for key in keys], axis=1) if keys else np.zeros((curve.size, 0))
    sets = list(dict.fromkeys(map(tuple, values.tolist())))
    kept = [sets[i] for i in shown(len(sets))]
    made = []
    for look, chosen in zip(styles(len(kept)), kept, strict=True):
        inside = np.all(values == np.array(chosen), axis=1)
        rows = [np.flatnonzero(inside & (curve == number)) for number in np.unique(curve[inside])]
        made.append(Family(named(keys, chosen), rows, look.colour, look.marker))
    return made


def shown(count: int) -> list[int]:
    """Positions of the sets that are drawn, at most `MAX_CURVES` of equal spacing."""
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, MAX_CURVES))})


def named(keys: Sequence[str], values: Sequence[float]) -> str:
    """A set of values in words."""
    told = [f"{value:.4g}" for value in values]
    return ", ".join(told if len(keys) < 2 else [f"{spoken(key)} {text}" for key, text in zip(keys, told, strict=True)])


def over_keys(data: "xarray.Dataset") -> list[str]:
    """Keys of the further axes, in the scene's order."""
    return [str(name) for name in data.data_vars if "." in str(name) and name != data.attrs.get("along")]


def parameter(data: "xarray.Dataset") -> str:
    """What the curves were followed in."""
    return str(data.attrs.get("along", "frequency"))


def abscissa(data: "xarray.Dataset") -> str:
    """The same as a label."""
    name = parameter(data)
    units = data[name].attrs.get("units")
    return (spoken(name) if "." in name else name) + (f" [{units}]" if units else "")


def moving(data: "xarray.Dataset") -> list[str]:
    """Points with an amplitude, the largest first; the first of all if there is none."""
    names = [str(name) for name in data.point.values]
    largest = _largest(data).max(axis=1)
    return [names[i] for i in np.argsort(-largest, kind="stable") if largest[i] > 1e-9 * largest.max()] or names[:1]


def main_axis(data: "xarray.Dataset", point: str) -> str:
    """The axis along which a point has its largest amplitude."""
    row = data.point.values.tolist().index(point)
    return str(data.axis.values[int(np.argmax(_largest(data)[row]))])


def _largest(data: "xarray.Dataset") -> np.ndarray:
    values = data.amplitude.values
    return np.where(np.isfinite(values), values, 0.0).max(axis=0, initial=0.0)


def legend(
    ax: "matplotlib.axes.Axes", data: "xarray.Dataset", *, kinds: bool = True, extra: Sequence[Any] = ()
) -> None:
    """To the right of the axes: the colours of the values, and what lines and marks mean."""
    from matplotlib.lines import Line2D

    entries = [f for f in families(data) if f.label]
    handles = [Line2D([], [], color=f.colour, marker="" if kinds else f.marker, ms=4, label=f.label) for f in entries]
    if kinds:
        handles.append(Line2D([], [], color=NEUTRAL, label="stable"))
        if (data.stable.values[data.fold.values == 0] == 0).any():
            handles.append(Line2D([], [], color=NEUTRAL, linestyle=DASHES, label="unstable"))
        if data.fold.values.any():
            handles.append(Line2D([], [], color=NEUTRAL, linestyle="", marker="D", ms=4.5, label="fold"))
    keys = over_keys(data)
    title = spoken(keys[0]) if len(keys) == 1 else None
    if handles or extra:
        ax.legend(handles=[*handles, *extra], title=title, title_fontsize=8, **BESIDE)


def beside(rows: int, height: float, *, share_x: bool = True) -> tuple["matplotlib.figure.Figure", np.ndarray]:
    """Axes one above the other with room for a legend on the right."""
    return figure(rows, 1, width=9.0, height=height, gap=0.2 if share_x else 0.7, right=2.4, sharex=share_x)


def finished(
    made: "matplotlib.figure.Figure", data: "xarray.Dataset", what: str, left_out: str = ""
) -> "matplotlib.figure.Figure":
    """The figure with its heading, and at the foot what did not find room."""
    keys = over_keys(data)
    sets = len(set(zip(*(data[key].values.tolist() for key in keys), strict=True))) if keys else 1
    hidden = f"{sets - MAX_CURVES} of {sets} sets of values not shown" if sets > MAX_CURVES else ""
    heading(made, data, what, "; ".join(filter(None, (left_out, hidden))))
    return made


def _response_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    if not data.sizes["solution"]:
        return None
    points = moving(data)
    drawn = points[:MAX_ROWS]
    made, grid = beside(len(drawn), 4.2 if len(drawn) == 1 else 2.4)
    for ax, point in zip(grid[:, 0], drawn, strict=True):
        response(data, ax, point=point)
        ax.label_outer()
    legend(grid[0, 0], data)
    left_out = f"{len(points) - MAX_ROWS} of {len(points)} points not shown" if len(points) > MAX_ROWS else ""
    return finished(
        made, data, "response by harmonic balance, each point along its axis of largest amplitude", left_out
    )


def _harmonics_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    if not data.sizes["solution"]:
        return None
    made, grid = beside(1, 3.4)
    harmonics(data, grid[0, 0])
    legend(grid[0, 0], data, kinds=False)
    return finished(made, data, "harmonic content at the largest response")


def _states_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    names = [str(name) for name in data.contact.values]
    if not names or not data.sizes["solution"]:
        return None
    busy = (data.slip_share + data.separation_share).sum("solution").values
    drawn = [names[i] for i in sorted(np.argsort(-busy, kind="stable")[:MAX_ROWS])]
    made, grid = beside(2 * len(drawn), 1.9 if len(drawn) == 1 else 1.5)
    for i, (contact, state) in enumerate((c, s) for c in drawn for s in ("slip", "separation")):
        share(data, grid[i, 0], contact=contact, state=state)
        grid[i, 0].set_title(short(contact), fontsize=9, pad=3, loc="right")
        grid[i, 0].label_outer()
    legend(grid[0, 0], data)
    left_out = f"{len(names) - MAX_ROWS} of {len(names)} contacts not shown" if len(names) > MAX_ROWS else ""
    return finished(made, data, "shares of a period in slip and in separation", left_out)


PICTURES: dict[str, Picture] = {
    "response": _response_figure,
    "harmonics": _harmonics_figure,
    "contact_states": _states_figure,
}
