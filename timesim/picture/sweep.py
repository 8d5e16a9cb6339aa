"""Pictures of a sweep: response curves, shares of the contact states, peaks against a scalar, stability.

``f(data, ax=None) -> ax``, where `data` is the result of a sweep. Each set of values of the further axes has its
colour and line; up and down are told apart by marker. Filled markers are settled motions, hollow ones are not: a bar
spans the amplitudes of their single cycles. Crosses at the foot are points that failed; nothing is drawn of those that
a run did not come to. `PICTURES` are the figures that a run writes.
"""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from timesim.picture.style import SERIES, Picture, Series, axes, figure, heading, short

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import matplotlib.lines
    import xarray

OWN = ("direction", "frequency", "point", "axis")
DIRECTIONS = {"up": ("-", "^"), "down": ("--", "v"), "independent": ("-", "o")}
TURNS = {"^": 0, "v": 1}  # up and down are marked at different points, lest one cover the other
MARKERS = "osD<>phXPd"
MAX_CURVES = 12
MAX_ROWS = 3
MARKED = 45  # settled points of a curve that bear a marker; a curve of more has some of them marked
NEUTRAL = "0.25"
BESIDE: dict[str, Any] = {"fontsize": 8, "loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "borderaxespad": 0.0}
FEW = 3  # values that a scalar needs at least for a picture of the peaks


class Curve(NamedTuple):
    """One curve over frequency.

    Attributes:
        label: the values of the further axes; empty where there are none.
        where: position along each of these axes and along the direction, for `isel`.
        direction: of the sweep.
        style: how it is drawn.
    """

    label: str
    where: Mapping[str, int]
    direction: str
    style: Series


def response(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    point: str | None = None,
    axis: str | None = None,
) -> "matplotlib.axes.Axes":
    """Amplitude against frequency of a point, by default of that and along the axis with the largest."""
    ax = axes(ax)
    point = point or moving(data)[0]
    axis = axis or main_axis(data, point)
    amplitude = data.amplitude.sel(point=point, axis=axis)
    for curve in curves(data):
        _draw(ax, data, curve, amplitude.isel(curve.where).values)
        _band(ax, data, curve, point, axis)
        for frequency in _jumps(data, curve):
            ax.axvline(frequency, color=curve.style.colour, linestyle=":", linewidth=1.0, label="jump")
    ax.set_ylim(bottom=0)
    ax.set(xlabel="frequency [Hz]", ylabel=f"amplitude of {short(point, 16)} {axis} [length]")
    return ax


def share(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    contact: str | None = None,
    state: str = "slip",
) -> "matplotlib.axes.Axes":
    """Share of a period that a contact spends in a state, ``slip`` or ``separation``, against frequency."""
    ax = axes(ax)
    shares = data[f"{state}_share"].sel(contact=contact or str(data.contact.values[0]))
    for curve in curves(data):
        _draw(ax, data, curve, shares.isel(curve.where).values)
    ax.set(xlabel="frequency [Hz]", ylabel=f"share in {state} [1]", ylim=(-0.04, 1.04))
    return ax


def floquet(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Largest modulus of the Floquet multipliers against frequency; a motion is stable below 1."""
    ax = axes(ax)
    for curve in curves(data):
        _draw(ax, data, curve, data.floquet_max.isel(curve.where).values)
    ax.axhline(1.0, color="black", linewidth=0.8, label="limit of stability")
    ax.set(xlabel="frequency [Hz]", ylabel="largest Floquet multiplier [1]")
    return ax


def peak(
    data: "xarray.Dataset",
    ax: "matplotlib.axes.Axes | None" = None,
    *,
    key: str | None = None,
    point: str | None = None,
    axis: str | None = None,
) -> "matplotlib.axes.Axes":
    """Largest amplitude over the frequencies against a scalar of the scene, by default that with most values.

    A hollow marker is a maximum at the first or last frequency, which may lie outside of them. A value with points that
    are missing has no peak. A star is the least, where no peak is missing.
    """
    ax = axes(ax)
    key = key or most_valued(data)
    point = point or moving(data)[0]
    axis = axis or main_axis(data, point)
    amplitude, order = data.amplitude.sel(point=point, axis=axis), np.argsort(data[key].values)
    value = data[key].values[order]
    least: dict[tuple[float, str], list[tuple[str, str]]] = {}
    for curve in curves(data, without=key):
        largest, at_end = peaks(amplitude.isel(curve.where).transpose(key, "frequency").values[order])
        style, told = curve.style, [curve.label] if curve.label else []
        name = ", ".join(told + ([curve.direction] if data.sizes["direction"] > 1 else []))
        ax.plot(value, largest, color=style.colour, linestyle=style.line, label=name or "peak")
        _marks(ax, value, largest, style, at_end, "peak at an end of the frequencies")
        if np.isfinite(largest).all():
            place = int(np.argmin(largest))
            least.setdefault((value[place], f"{largest[place]:.4g}"), []).append((name, style.colour))
    for (x, y), found in least.items():
        _star(ax, x, y, found, x in (value[0], value[-1]) and value.size > 1)
    ax.set_ylim(bottom=0)
    ax.set(xlabel=_titled(data, key), ylabel=f"peak amplitude of {short(point, 16)} {axis} [length]")
    return ax


def _star(ax: "matplotlib.axes.Axes", x: float, y: str, found: list[tuple[str, str]], at_end: bool) -> None:
    """The least peak, one star for all curves that have it at the same place."""
    names, colours = zip(*found, strict=True)
    of = {1: ": ", 2: f" of {' and '.join(names)}:\n"}.get(len(names), f" of {len(names)} curves:\n")
    look: dict[str, Any] = {"color": colours[0], "markeredgecolor": "black", "ms": 10, "linestyle": "", "zorder": 4}
    ax.plot(x, float(y), "*", label=f"least{of}{y} at {x:.4g}" + (", an end" if at_end else ""), **look)


def peaks(amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest entry of each row, NaN where entries are missing, and whether it is the first or last of several.

    Args:
        amplitude: over the last axis, the frequencies, shape (N, F); NaN where a point is missing.
    """
    known = np.isfinite(amplitude).all(axis=1)
    place = np.argmax(np.where(known[:, None], amplitude, 0.0), axis=1)
    largest = np.where(known, np.take_along_axis(amplitude, place[:, None], axis=1)[:, 0], np.nan)
    last = amplitude.shape[1] - 1
    return largest, known & (last > 0) & ((place == 0) | (place == last))


def curves(data: "xarray.Dataset", without: str | None = None) -> list[Curve]:
    """The curves of a sweep, at most `MAX_CURVES` of equal spacing; those over the scalar `without` count as one."""
    keys = [key for key in over_keys(data) if key != without]
    sets = list(product(*(range(data.sizes[key]) for key in keys)))
    kept = sorted({round(i) for i in np.linspace(0, len(sets) - 1, min(len(sets), MAX_CURVES))})
    names = [str(name) for name in data.direction.values]
    looks = styles(len(kept), shades=len(names) > 1 and len(kept) > 1)
    made = []
    for look, chosen in zip(looks, (sets[i] for i in kept), strict=True):
        values = [f"{data[key].values[i]:.4g}" for key, i in zip(keys, chosen, strict=True)]
        for i, name in enumerate(names):
            line, marker = DIRECTIONS[name]
            colour = look.colour if keys else SERIES[i].colour
            style = (
                look._replace(marker=look.marker if len(names) == 1 else marker)
                if keys
                else Series(colour, line, marker)
            )
            made.append(Curve(", ".join(values), dict(zip(keys, chosen, strict=True)) | {"direction": i}, name, style))
    return made


def styles(count: int, *, shades: bool = False) -> list[Series]:
    """Styles of a number of curves: hues where they are few, else from dark to light in order, or always so.

    Shades and lines stay apart in print where the marker is taken by something else.
    """
    if count <= len(SERIES) and not shades:
        return [style._replace(marker=marker) for style, marker in zip(SERIES[:count], MARKERS, strict=False)]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    colours = [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.86, count))]
    lines = [style.line for style in SERIES]
    return [Series(c, lines[i % len(lines)], MARKERS[i % len(MARKERS)]) for i, c in enumerate(colours)]


def over_keys(data: "xarray.Dataset") -> list[str]:
    """Keys of the scene's scalars that are axes of the sweep, in its order."""
    return [str(name) for name in data.amplitude.dims if name not in OWN]


def most_valued(data: "xarray.Dataset") -> str:
    """The scalar of the scene with most values."""
    return max(over_keys(data), key=lambda key: data.sizes[key])


def moving(data: "xarray.Dataset") -> list[str]:
    """Points with an amplitude, the largest first; the first of all if there is none."""
    names = [str(name) for name in data.point.values]
    largest = _largest(data).max(axis=1)
    order = np.argsort(-largest, kind="stable")
    return [names[i] for i in order if largest[i] > 1e-9 * largest.max()] or names[:1]


def main_axis(data: "xarray.Dataset", point: str) -> str:
    """The axis along which a point has its largest amplitude."""
    row = data.point.values.tolist().index(point)
    return str(data.axis.values[int(np.argmax(_largest(data)[row]))])


def _largest(data: "xarray.Dataset") -> np.ndarray:
    values = data.amplitude.transpose(..., "point", "axis").values
    known = np.where(np.isfinite(values), values, 0.0)
    return known.reshape(-1, *values.shape[-2:]).max(axis=0, initial=0.0)


def spoken(key: str) -> str:
    """A scalar's key as words, without the section: ``pad preload``."""
    return " ".join(key.split(".")[1:])


def _titled(data: "xarray.Dataset", key: str) -> str:
    units = data[key].attrs.get("units")
    return spoken(key) + (f" [{units}]" if units else "")


def _jumps(data: "xarray.Dataset", curve: Curve) -> np.ndarray:
    if "jump_low" not in data:
        return np.empty(0)
    ends = [data[name].isel(curve.where, missing_dims="ignore").values.ravel() for name in ("jump_low", "jump_high")]
    middle = 0.5 * (ends[0] + ends[1])
    return middle[np.isfinite(middle)]


def _draw(ax: "matplotlib.axes.Axes", data: "xarray.Dataset", curve: Curve, y: np.ndarray) -> None:
    """A curve, hollow markers where it has not settled, crosses at the foot where it failed."""
    frequency, settled = data.frequency.values, data.settled.isel(curve.where).values.astype(bool)
    failed, style = data.failure.isel(curve.where).values != "", curve.style
    ax.plot(frequency, y, color=style.colour, linestyle=style.line, linewidth=1.0, label="_" + curve.label)
    _marks(ax, frequency, y, style, ~settled & ~failed, "not settled")
    doubled = settled & (data.period.isel(curve.where).values > 1)
    if doubled.any():
        ring: dict[str, Any] = {"color": "black", "fillstyle": "none", "ms": 8, "linestyle": ""}
        ax.plot(frequency[doubled], y[doubled], "s", label="period of several cycles", **ring)
    if failed.any():
        foot: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "clip_on": False, "linestyle": "", "zorder": 4}
        ax.plot(frequency[failed], np.full(failed.sum(), 0.015), "x", color=style.colour, ms=6, label="failed", **foot)


def _band(ax: "matplotlib.axes.Axes", data: "xarray.Dataset", curve: Curve, point: str, axis: str) -> None:
    """Of motions that have not settled, the amplitudes of their single cycles."""
    if "amplitude_band" not in data:
        return
    low, high = data.amplitude_band.sel(point=point, axis=axis).isel(curve.where).transpose("band", ...).values
    loose = (data.settled.isel(curve.where).values == 0) & np.isfinite(low)
    if loose.any():
        look: dict[str, Any] = {"color": curve.style.colour, "linewidth": 3.0, "alpha": 0.45}
        ax.vlines(data.frequency.values[loose], low[loose], high[loose], **look)


def _marks(
    ax: "matplotlib.axes.Axes", x: np.ndarray, y: np.ndarray, style: Series, hollow: np.ndarray, meaning: str
) -> None:
    """Markers on a curve: filled, or hollow and all of them where told."""
    every = max(1, -(-x.size // MARKED))
    if style.marker in TURNS and x.size > 1:
        every = max(2, every)
    filled = ~hollow & (np.arange(x.size) % every == TURNS.get(style.marker, 0) * (every // 2))
    look: dict[str, Any] = {"color": style.colour, "linestyle": "", "marker": style.marker}
    ax.plot(x[filled], y[filled], ms=3.5, label="_settled", **look)
    if hollow.any():
        ax.plot(x[hollow], y[hollow], ms=6, fillstyle="none", label=meaning, **look)


def legend(ax: "matplotlib.axes.Axes", data: "xarray.Dataset") -> None:
    """To the right of the axes: the colours of the values, the markers of the directions, and what marks mean."""
    handles = [*_value_handles(data), *_direction_handles(data), *_mark_handles(ax)]
    if handles:
        ax.legend(handles=handles, title=_names(data, over_keys(data)), title_fontsize=8, **BESIDE)


def _names(data: "xarray.Dataset", keys: list[str]) -> str | None:
    """What the values in a legend are, in their order; None if there are none."""
    return ",\n".join(_titled(data, key) for key in keys) or None


def _value_handles(data: "xarray.Dataset") -> Iterator["matplotlib.lines.Line2D"]:
    several = data.sizes["direction"] > 1
    seen: set[str] = set()
    for curve in curves(data):
        if curve.label and curve.label not in seen:
            seen.add(curve.label)
            yield _handle(curve.style._replace(marker="") if several else curve.style, curve.label)


def _direction_handles(data: "xarray.Dataset") -> Iterator["matplotlib.lines.Line2D"]:
    for curve in curves(data)[: data.sizes["direction"]]:
        if not curve.label:
            yield _handle(curve.style, curve.direction)
        elif data.sizes["direction"] > 1:
            yield _handle(curve.style._replace(colour=NEUTRAL, line=""), curve.direction)


def _mark_handles(ax: "matplotlib.axes.Axes") -> Iterator["matplotlib.lines.Line2D"]:
    """Everything else with a label, once, without the colour of a curve."""
    seen: set[str] = set()
    for handle in ax.get_lines():
        name = str(handle.get_label())
        if not name.startswith("_") and name not in seen:
            seen.add(name)
            made = _handle(Series(NEUTRAL, handle.get_linestyle(), str(handle.get_marker())), name)
            made.set_fillstyle(handle.get_fillstyle())
            yield made


def _handle(style: Series, label: str) -> "matplotlib.lines.Line2D":
    from matplotlib.lines import Line2D

    return Line2D([], [], color=style.colour, linestyle=style.line, marker=style.marker, ms=5, label=label)


def _beside(rows: int, height: float) -> tuple["matplotlib.figure.Figure", np.ndarray]:
    """Axes one above the other with room for a legend on the right."""
    return figure(rows, 1, width=9.0, height=height, gap=0.3, right=2.4, sharex=True)


def _finished(
    made: "matplotlib.figure.Figure", data: "xarray.Dataset", what: str, left_out: str = ""
) -> "matplotlib.figure.Figure":
    for ax in made.axes:
        ax.label_outer()
    sets = int(np.prod([data.sizes[key] for key in over_keys(data)]))
    curves_left = f"{sets - MAX_CURVES} of {sets} sets of values not shown" if sets > MAX_CURVES else ""
    heading(made, data, what, "; ".join(filter(None, (left_out, curves_left))))
    return made


def _response_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure":
    points = moving(data)
    shown = points[:MAX_ROWS]
    made, grid = _beside(len(shown), 3.2 if len(shown) == 1 else 2.2)
    for ax, point in zip(grid[:, 0], shown, strict=True):
        response(data, ax, point=point)
    legend(grid[0, 0], data)
    left_out = f"{len(points) - MAX_ROWS} of {len(points)} points not shown" if len(points) > MAX_ROWS else ""
    return _finished(made, data, "response, each point along its axis of largest amplitude", left_out)


def _states_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    names = [str(name) for name in data.contact.values]
    shown = sorted(sorted(names, key=lambda name: -_activity(data, name))[:MAX_ROWS], key=names.index)
    if not shown:
        return None
    made, grid = _beside(2 * len(shown), 1.9 if len(shown) == 1 else 1.5)
    for i, (contact, state) in enumerate(product(shown, ("slip", "separation"))):
        share(data, grid[i, 0], contact=contact, state=state)
        grid[i, 0].set_title(short(contact), fontsize=9, pad=3, loc="right")
    legend(grid[0, 0], data)
    left_out = f"{len(names) - MAX_ROWS} of {len(names)} contacts not shown" if len(names) > MAX_ROWS else ""
    return _finished(made, data, "shares of a period in slip and in separation", left_out)


def _activity(data: "xarray.Dataset", contact: str) -> float:
    shares = (data.slip_share + data.separation_share).sel(contact=contact).values
    return float(np.nansum(shares))


def _floquet_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    if not np.isfinite(data.floquet_max.values).any():
        return None
    made, grid = _beside(1, 3.0)
    floquet(data, grid[0, 0])
    legend(grid[0, 0], data)
    return _finished(made, data, "stability")


def _peak_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    keys = [key for key in over_keys(data) if data.sizes[key] >= FEW]
    whole = np.isfinite(data.amplitude.values).all(axis=(-2, -1)).all(axis=-1)
    if not keys or not whole.any():
        return None
    made, grid = figure(len(keys), 1, width=9.0, height=3.0, gap=0.7, right=2.4)
    for ax, key in zip(grid[:, 0], keys, strict=True):
        peak(data, ax, key=key)
        others = [other for other in over_keys(data) if other != key]
        entries: dict[str, Any] = {}
        for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
        names = {"labels": list(entries), "title": _names(data, others), "title_fontsize": 8}
        ax.legend(handles=list(entries.values()), **names, **BESIDE)
    point = moving(data)[0]
    what = f"peak over the frequencies of {short(point, 16)} {main_axis(data, point)}, which moves most"
    heading(made, data, what, "" if whole.all() else f"{np.sum(~whole)} peaks not shown: points are missing")
    return made


PICTURES: dict[str, Picture] = {
    "response": _response_figure,
    "peak": _peak_figure,
    "contact_states": _states_figure,
    "stability": _floquet_figure,
}
