"""Pictures of an optimum: the peak of the response against a scalar, and the responses beside the best one.

``f(data, ax=None) -> ax``, where `data` is the result of an `optimum` study; `PICTURES` are the figures that a run
writes.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from timesim.picture.style import BLUE, VERMILION, Picture, axes, figure, heading, short
from timesim.picture.sweep import BESIDE, main_axis, moving, spoken, styles

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

MAX_CURVES = 7
NEAR = 0.15  # of the range of the scalar about the optimum, magnified


def key_of(data: "xarray.Dataset") -> str:
    """The scalar of the scene."""
    return str(data["peak"].dims[0])


def peak(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Peak over the frequencies against the scalar; hollow where it is at an end of them; a star at the least."""
    ax = axes(ax)
    key = key_of(data)
    x, y, at_end = data[key].values, data["peak"].values, data["peak_at_end"].values > 0
    ax.plot(x, y, color=BLUE, linewidth=1.0)
    ax.plot(x[~at_end], y[~at_end], "o", color=BLUE, ms=4, label="peak")
    if at_end.any():
        ax.plot(x[at_end], y[at_end], "o", color=BLUE, ms=6, fillstyle="none", label="peak at an end of frequency")
    best = float(data["optimum"]), float(data["optimum_peak"])
    if np.isfinite(best).all():
        name = f"least: {best[1]:.5g} at {best[0]:.5g}"
        ax.plot(*best, "*", color=VERMILION, markeredgecolor="black", ms=12, zorder=4, label=name)
    ax.set(xlabel=titled(data), ylabel="peak amplitude [length]")
    return ax


def titled(data: "xarray.Dataset") -> str:
    """The scalar with its unit."""
    key = key_of(data)
    units = data[key].attrs.get("units")
    return spoken(key) + (f" [{units}]" if units else "")


def magnified(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """The same about the least peak."""
    ax = peak(data, ax)
    values, heights = data[key_of(data)].values, data["peak"].values
    best, reach = float(data["optimum"]), NEAR * float(np.ptp(values))
    ax.set_xlim(best - reach, best + reach)
    inside = heights[(values >= best - reach) & (values <= best + reach)]
    low, high = np.nanmin(inside), np.nanmax(inside)
    ax.set_ylim(low - 0.1 * (high - low) - 1e-12, high + 0.1 * (high - low) + 1e-12)
    return ax


def responses(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Amplitude against frequency for some values and the best one, both sweeps; a dot at each peak."""
    ax = axes(ax)
    key, point = key_of(data), _point(data)
    axis = str(data.attrs.get("axis", main_axis(data, point)))
    amplitude = data["amplitude"].sel(point=point, axis=axis)
    values, best = data[key].values, float(data["optimum"])
    rows = [i for i in _spread(values) if values[i] != best]
    for row, look in zip(rows, styles(len(rows), shades=True), strict=True):
        _curves(ax, data, amplitude, row, {"color": look.colour, "linewidth": 1.0, "label": f"{values[row]:.4g}"})
    if np.isfinite(best):
        style: dict[str, Any] = {"color": "black", "linewidth": 2.0, "zorder": 3, "label": f"{best:.4g}, the least"}
        _curves(ax, data, amplitude, int(np.flatnonzero(values == best)[0]), style)
    ax.set_ylim(bottom=0)
    ax.set(xlabel="frequency [Hz]", ylabel=f"amplitude of {short(point, 16)} {axis} [length]")
    return ax


def _point(data: "xarray.Dataset") -> str:
    return str(data.attrs.get("point", moving(data)[0]))


def _spread(values: np.ndarray) -> list[int]:
    """Positions of values of about equal distance."""
    wanted = np.linspace(values[0], values[-1], MAX_CURVES)
    return sorted({int(np.argmin(np.abs(values - value))) for value in wanted})


def _curves(
    ax: "matplotlib.axes.Axes", data: "xarray.Dataset", amplitude: "xarray.DataArray", row: int, style: dict[str, Any]
) -> None:
    x = data["frequency"].values
    for i, line in enumerate(("-", "--")):
        ax.plot(x, amplitude.isel({key_of(data): row, "direction": i}).values, linestyle=line, **style)
        style = style | {"label": "_down"}
    top = float(data["peak_frequency"][row]), float(data["peak"][row])
    ax.plot(*top, ".", color=style["color"], ms=7, label="_peak", zorder=style.get("zorder", 2))


def _peak_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    if not np.isfinite(data["peak"].values).any():
        return None
    made, grid = figure(2, 1, width=9.0, height=2.8, gap=0.5, right=2.4)
    peak(data, grid[0, 0]).set_ylim(bottom=0)
    magnified(data, grid[1, 0])
    grid[0, 0].set_xlabel("")
    grid[0, 0].legend(**BESIDE)
    heading(made, data, "peak over the frequencies, below magnified")
    return made


def _responses_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    if not np.isfinite(data["peak"].values).any():
        return None
    made, grid = figure(1, 1, width=9.0, height=4.0, right=2.4)
    responses(data, grid[0, 0]).legend(title=titled(data), title_fontsize=8, **BESIDE)
    heading(made, data, "responses, dashed where the sweep down differs")
    return made


PICTURES: dict[str, Picture] = {"peak": _peak_figure, "response": _responses_figure}
