"""Pictures of an optimum: the peak of the response against a scalar, and the responses beside the best one."""

from typing import Any, NamedTuple

import numpy as np

from timesim.picture.choice import motion
from timesim.picture.figure import axes, finish, from_zero, labelled, legend_beside, plain_ticks, stacked
from timesim.picture.response import (
    axis_label,
    broken,
    handles,
    has_phase,
    one_way,
    over_phase,
    styles,
    turns,
    with_phase,
)
from timesim.picture.style import BLUE, NEUTRAL, VERMILION, Axes, Dataset, Figure, Picture, Series, short, unit
from timesim.result.label import told_apart, with_unit

MAX_CURVES = 7
FLAT = 1e-4  # share of a peak: the least height magnified, since longer numbers would not fit beside the axis
NEAR = 0.15  # share of the range of the scalar that is magnified, to each side of the optimum
WIDE = 30.0  # largest by smallest value: on a linear axis a value below that is at the foot
STEEP = 2.0  # times the least peak: what is larger is not magnified
BELOW = 1e-3  # share of the least peak: smaller amplitudes are below the foot of a logarithmic axis


def scalar(data: Dataset) -> str:
    """Key of the scalar of the scene."""
    return str(data["peak"].dims[0])


def peak(data: Dataset, ax: Axes | None = None) -> Axes:
    """Peak over the frequencies against the scalar; hollow where it is at an end of them; a star at the least.

    Where the peaks are over more than a factor of `WIDE`, the ordinate is logarithmic.
    """
    return _scaled(_points(data, axes(ax)), data, BELOW * float(data["optimum_peak"]))


def _points(data: Dataset, ax: Axes) -> Axes:
    key = scalar(data)
    x, y, at_end = data[key].values, data["peak"].values, data["peak_at_end"].values > 0
    ax.plot(x, y, color=BLUE, linewidth=1.0)
    ax.plot(x[~at_end], y[~at_end], "o", color=BLUE, ms=4, label="peak")
    if at_end.any():
        ax.plot(x[at_end], y[at_end], "o", color=BLUE, ms=6, fillstyle="none", label="peak at an end of frequency")
    best = float(data["optimum"]), float(data["optimum_peak"])
    place, height = (with_unit(f"{one:.5g}", data[name].attrs) for name, one in zip((key, "peak"), best, strict=True))
    end = ", an end" if best[0] in (x[0], x[-1]) else ""
    _star(ax, *best, f"least: {height}\nat {place}{end}")
    ax.set(xlabel=axis_label(data, key), ylabel=f"peak amplitude of {_whose(data)}{unit(data, 'peak')}")
    return ax


def _one_motion(data: Dataset) -> tuple[str, str] | None:
    """Point and axis of all peaks, in earlier results those of the largest amplitude; None where they differ."""
    moving = {str(name) for name in data["peak_of"].values if name} if "peak_of" in data else set()
    if len(moving) > 1:
        return None
    asked = data.attrs.get("point"), data.attrs.get("axis")
    point, axis = moving.pop().rsplit(" ", 1) if moving else motion(data, *asked)
    return point, axis


def _whose(data: Dataset) -> str:
    """Whose amplitudes the peaks are, in words."""
    if one := _one_motion(data):
        return f"{short(one[0], 16)} {one[1]}"
    only = str(data["point"].values[0]) if data.sizes["point"] == 1 else "any point"
    return f"{short(data.attrs.get('point', only), 16)}, {data.attrs.get('axis', 'any axis')}"


def _star(ax: Axes, x: float, y: float, label: str) -> None:
    if np.isfinite(y):
        ax.plot(x, y, "*", label=label, color=VERMILION, markeredgecolor="black", ms=12, linestyle="", zorder=4)


def _scaled(ax: Axes, data: Dataset, low: float) -> Axes:
    """The ordinate from zero, or logarithmic, and not below `low`, where the least peak would be at its foot."""
    heights = data["peak"].values  # NaN where points failed
    if not 0 < np.nanmin(heights, initial=np.inf) < np.nanmax(heights, initial=0.0) / WIDE:
        from_zero(ax)
        return ax
    ax.set_yscale("log")
    ax.set_ylim(max(0.6 * ax.dataLim.minposy, low), 1.6 * ax.dataLim.y1)
    plain_ticks(ax.yaxis, *ax.get_ylim())
    return ax


def magnified(data: Dataset, ax: Axes | None = None) -> Axes:
    """The same about the least peak."""
    ax = _points(data, axes(ax))
    values, best, reach = data[scalar(data)].values, float(data["optimum"]), _reach(data)
    ax.set_xlim(max(best - reach, values[0] - 0.05 * reach), min(best + reach, values[-1] + 0.05 * reach))
    inside = _inside(data)
    low = inside.min()
    high = min(inside.max(), STEEP * low)
    margin = max(0.1 * (high - low), FLAT * high) or 1.0
    ax.set_ylim(low - margin, high + margin)
    return ax


def _reach(data: Dataset) -> float:
    """Of the magnified part, to both sides of the least peak."""
    return NEAR * float(np.ptp(data[scalar(data)].values))


def _inside(data: Dataset) -> np.ndarray:
    """The peaks that the magnified part shows."""
    heights = data["peak"].values
    return heights[(np.abs(data[scalar(data)].values - float(data["optimum"])) <= _reach(data)) & np.isfinite(heights)]


def responses(data: Dataset, ax: Axes | None = None) -> Axes:
    """Amplitude against frequency for some values and the best one, both sweeps; a dot at each peak, a star at its.

    Where the peaks are over more than a factor of `WIDE`, the ordinate is logarithmic.
    """
    ax, chosen = axes(ax), {name: data.attrs[name] for name in ("point", "axis") if name in data.attrs}
    if one := _one_motion(data):
        chosen = dict(zip(("point", "axis"), one, strict=True))
    amplitude = data["amplitude"].sel(chosen)
    _both_ways(ax, data, amplitude.max([name for name in ("point", "axis") if name not in chosen], skipna=False))
    for value in _shown(data):
        top = float(data["peak_frequency"][value.row]), float(data["peak"][value.row])
        ax.plot(*top, ".", color=value.colour, ms=7, label="_peak", zorder=3)
    best = float(data["optimum_frequency"]), float(data["optimum_peak"])
    least = with_unit(f"{best[1]:.5g}", data["peak"].attrs)
    _star(ax, *best, f"least peak: {least}\nat {best[0]:.5g} Hz")
    ax.set(xlabel="frequency [Hz]", ylabel=f"amplitude of {_whose(data)}{unit(data, 'amplitude')}")
    return _scaled(ax, data, BELOW * best[1])


def phases(data: Dataset, ax: Axes | None = None) -> Axes:
    """Phase of the first harmonic against frequency for the same values."""
    ax, (point, axis) = axes(ax), _one_motion(data) or motion(data, data.attrs.get("point"), data.attrs.get("axis"))
    _both_ways(ax, data, data["phase_deg"].sel(point=point, axis=axis), phase=True)
    ax.set_xlabel("frequency [Hz]")
    return over_phase(ax)


class ShownValue(NamedTuple):
    """A value of the scalar of which the response is shown; ``widened``: factor of the width of its lines."""

    row: int
    label: str
    colour: str
    widened: float = 1.0


def _shown(data: Dataset) -> list[ShownValue]:
    """Some roughly evenly spaced values, then the best one."""
    values, best = data[scalar(data)].values, float(data["optimum"])
    wanted = np.linspace(values[0], values[-1], MAX_CURVES)
    rows = [i for i in sorted({int(np.argmin(np.abs(values - value))) for value in wanted}) if values[i] != best]
    *texts, least = told_apart([*values[rows], best], 4)
    looks = styles(len(rows), shades=True)
    shown = [ShownValue(row, text, look.colour) for row, text, look in zip(rows, texts, looks, strict=True)]
    return shown + [ShownValue(int(row), f"{least}, the least", "black", 1.5) for row in np.flatnonzero(values == best)]


def _both_ways(ax: Axes, data: Dataset, quantity: Any, *, phase: bool = False) -> None:
    """A quantity of both sweeps against frequency, a phase with a gap where it wraps around."""
    x = data["frequency"].values
    for row, label, colour, widened in _shown(data):
        for i, way in enumerate(("up", "down")):
            y = quantity.isel({scalar(data): row, "direction": i}).values
            look = one_way(way, colour, "", beside=True).look()
            look["linewidth"] *= widened
            ax.plot(*(broken(x, y, turns(y)) if phase else (x, y)), label="_down" if i else label, **look)


def _peak_figure(data: Dataset) -> Figure | None:
    if not np.isfinite(data["peak"].values).any():
        return None
    near = _inside(data).size > 2  # else there is nothing to magnify, as where a search has hardly begun
    fig, axs = stacked(1 + near, 2.8, share_x=False)
    peak(data, axs[0])
    if near:
        magnified(data, axs[1])
    legend_beside(axs[0], labelled(axs[0]).values())
    return finish(fig, data, "peak over the frequencies" + ", below magnified" * near)


def _responses_figure(data: Dataset) -> Figure | None:
    if not np.isfinite(data["peak"].values).any():
        return None
    fig, axs = with_phase(1, 4.0, has_phase(data) and _one_motion(data) is not None)
    for ax, draw in zip(axs, (responses, phases), strict=False):
        draw(data, ax).label_outer()
    ways = {way: one_way(way, NEUTRAL, "", beside=True) for way in ("up", "down")}
    lines = handles({value.label: Series(value.colour, "-", "") for value in _shown(data)} | ways)
    for line, value in zip(lines, _shown(data), strict=False):
        line.set_linewidth(value.widened * line.get_linewidth())
    star = [line for line in axs[0].get_lines() if line.get_marker() == "*"]
    legend_beside(axs[0], [*lines, *star], axis_label(data, scalar(data)))
    return finish(fig, data, "responses, swept up and down; dots: peaks, sought between the points")


PICTURES: dict[str, Picture] = {"peak": _peak_figure, "response": _responses_figure}
