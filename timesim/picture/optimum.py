"""Pictures of an optimum: the peak of the response against a scalar, and the responses beside the best one."""

from typing import Any

import numpy as np

from timesim.picture.choice import motion
from timesim.picture.figure import axes, finish, from_zero, labelled, legend_beside, stacked
from timesim.picture.response import amplitude_label, axis_label, over_phase, styles, unwound, with_phase
from timesim.picture.style import BLUE, VERMILION, Axes, Dataset, Figure, Picture, unit
from timesim.result.label import told_apart

MAX_CURVES = 7
FLAT = 1e-4  # share of a peak: the least height magnified, since longer numbers would not fit beside the axis
NEAR = 0.15  # share of the range of the scalar that is magnified, to each side of the optimum


def scalar(data: Dataset) -> str:
    """Key of the scalar of the scene."""
    return str(data["peak"].dims[0])


def peak(data: Dataset, ax: Axes | None = None) -> Axes:
    """Peak over the frequencies against the scalar; hollow where it is at an end of them; a star at the least."""
    ax, key = axes(ax), scalar(data)
    x, y, at_end = data[key].values, data["peak"].values, data["peak_at_end"].values > 0
    ax.plot(x, y, color=BLUE, linewidth=1.0)
    ax.plot(x[~at_end], y[~at_end], "o", color=BLUE, ms=4, label="peak")
    if at_end.any():
        ax.plot(x[at_end], y[at_end], "o", color=BLUE, ms=6, fillstyle="none", label="peak at an end of frequency")
    best = float(data["optimum"]), float(data["optimum_peak"])
    if np.isfinite(best).all():
        name = f"least: {best[1]:.5g} at {best[0]:.5g}"
        ax.plot(*best, "*", color=VERMILION, markeredgecolor="black", ms=12, zorder=4, label=name)
    ax.set(xlabel=axis_label(data, key), ylabel=f"peak amplitude{unit(data, 'peak')}")
    return ax


def magnified(data: Dataset, ax: Axes | None = None) -> Axes:
    """The same about the least peak."""
    ax = peak(data, ax)
    values, heights = data[scalar(data)].values, data["peak"].values
    best, reach = float(data["optimum"]), NEAR * float(np.ptp(values))
    ax.set_xlim(best - reach, best + reach)
    inside = heights[(values >= best - reach) & (values <= best + reach)]
    low, high = np.nanmin(inside), np.nanmax(inside)
    margin = max(0.1 * (high - low), FLAT * high) or 1.0
    ax.set_ylim(low - margin, high + margin)
    return ax


def responses(data: Dataset, ax: Axes | None = None) -> Axes:
    """Amplitude against frequency for some values and the best one, both sweeps; a dot at each peak."""
    ax, (point, axis) = axes(ax), motion(data, data.attrs.get("point"), data.attrs.get("axis"))
    amplitude = data["amplitude"].sel(point=point, axis=axis)
    for row, look in _looks(data):
        _curves(ax, data, amplitude, row, look)
    from_zero(ax)
    ax.set(xlabel="frequency [Hz]", ylabel=amplitude_label(data, point, axis))
    return ax


def phases(data: Dataset, ax: Axes | None = None) -> Axes:
    """Phase of the first harmonic against frequency for the same values."""
    ax, (point, axis) = axes(ax), motion(data, data.attrs.get("point"), data.attrs.get("axis"))
    phase = data["phase_deg"].sel(point=point, axis=axis).transpose(scalar(data), "direction", "frequency").values
    for row, look in _looks(data):
        for y, line in zip(phase[row], ("-", "--"), strict=True):
            ax.plot(*unwound(data["frequency"].values, y), **look | {"linestyle": line})
    ax.set_xlabel("frequency [Hz]")
    return over_phase(ax)


def _looks(data: Dataset) -> list[tuple[int, dict[str, Any]]]:
    """Positions and styles of the values that are shown: some roughly evenly spaced ones, then the best one."""
    values, best = data[scalar(data)].values, float(data["optimum"])
    wanted = np.linspace(values[0], values[-1], MAX_CURVES)
    spread = sorted({int(np.argmin(np.abs(values - value))) for value in wanted})
    rows = [i for i in spread if values[i] != best]
    *texts, least = told_apart([*values[rows], best], 4)
    looks: list[tuple[int, dict[str, Any]]] = [
        (row, {"color": look.colour, "linewidth": 1.0, "label": text})
        for row, look, text in zip(rows, styles(len(rows), shades=True), texts, strict=True)
    ]
    for row in np.flatnonzero(values == best):
        looks.append((int(row), {"color": "black", "linewidth": 2.0, "zorder": 3, "label": f"{least}, the least"}))
    return looks


def _curves(ax: Axes, data: Dataset, amplitude: Any, row: int, style: dict[str, Any]) -> None:
    """Both sweeps with one value of the scalar, and their peak."""
    x = data["frequency"].values
    for i, line in enumerate(("-", "--")):
        ax.plot(x, amplitude.isel({scalar(data): row, "direction": i}).values, linestyle=line, **style)
        style = style | {"label": "_down"}
    top = float(data["peak_frequency"][row]), float(data["peak"][row])
    ax.plot(*top, ".", color=style["color"], ms=7, label="_peak", zorder=style.get("zorder", 2))


def _peak_figure(data: Dataset) -> Figure | None:
    if not np.isfinite(data["peak"].values).any():
        return None
    fig, axs = stacked(2, 2.8, share_x=False)
    from_zero(peak(data, axs[0]))
    axs[0].set_xlabel("")
    magnified(data, axs[1])
    legend_beside(axs[0], labelled(axs[0]).values())
    return finish(fig, data, "peak over the frequencies, below magnified")


def _responses_figure(data: Dataset) -> Figure | None:
    if not np.isfinite(data["peak"].values).any():
        return None
    fig, axs = with_phase(1, 4.0, "phase_deg" in data)
    for ax, draw in zip(axs, (responses, phases), strict=False):
        draw(data, ax).label_outer()
    legend_beside(axs[0], labelled(axs[0]).values(), axis_label(data, scalar(data)))
    return finish(fig, data, "responses, dashed where the sweep down differs; dots: refined peaks")


PICTURES: dict[str, Picture] = {"peak": _peak_figure, "response": _responses_figure}
