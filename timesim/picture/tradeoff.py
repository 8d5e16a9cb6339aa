"""A picture of a tradeoff: error against time of all runs, the front, the presets and the recommended run."""

from typing import Any

import numpy as np

from timesim.picture.figure import axes, figure, finish, labelled, legend_beside
from timesim.picture.style import PALE, SERIES, VERMILION, Axes, Dataset, Figure, Picture
from timesim.result.label import counted


def error_against_time(data: Dataset, ax: Axes | None = None) -> Axes:
    """All runs, with a curve for each method; hollow with fewer modes, a cross without reductions."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    ax = axes(ax)
    seconds, error = data["seconds_a_cycle"].values * data.attrs["cycles"], data["error"].values
    whole = (data["modes_kept"].values == data.attrs["num_modes"]) & (data["reduced"].values == 1)
    for method, look in zip(dict.fromkeys(data["method"].values.tolist()), SERIES, strict=False):
        own = np.flatnonzero(whole & (data["method"].values == method))
        own = own[np.argsort(-error[own], kind="stable")]
        ax.plot(seconds[own], error[own], label=method, color=look.colour, linewidth=0.8, marker=look.marker, ms=4)
    front = np.flatnonzero(data["pareto"].values > 0)  # runs that no other run beats in both time and error
    front = front[np.argsort(seconds[front], kind="stable")]
    ax.step(seconds[front], error[front], where="post", label="front", color=PALE, linewidth=5, alpha=0.5, zorder=0)
    _beside(ax, data, seconds, error)
    for i in np.flatnonzero(data["preset"].values != ""):
        name = data["preset"].values[i]
        aside = (6, -13) if name == "reference" else (6, 6)  # beside standard, where both are as good as the truth
        ax.annotate(name, (seconds[i], error[i]), aside, textcoords="offset points", fontsize=8, fontweight="bold")
    wanted = data.attrs["error_wanted"]
    ax.axhline(wanted, color=VERMILION, linewidth=0.8, linestyle="--", label=f"wanted, {wanted:.0e}")
    ax.axhspan(0, data.attrs["error_known_to"], color="0.93", linewidth=0, label="not known")
    chosen = data.attrs["recommended_trial"]
    if chosen >= 0:
        star: dict[str, Any] = {"color": VERMILION, "markeredgecolor": "black", "markersize": 14, "linestyle": ""}
        ax.plot(seconds[chosen], error[chosen], "*", label="recommended", zorder=5, **star)
    what = "settled amplitude" if data.attrs["judged_by_amplitude"] else "state at the end"
    ax.set(xscale="log", yscale="log", ylabel=f"relative error, {what}")
    ax.set_xlabel(f"time of {counted(data.attrs['cycles'], 'cycle')}, compiled [s]")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_ylim(0.3 * np.nanmin(error), 3 * np.nanmax(error))
    return ax


def _beside(ax: Axes, data: Dataset, seconds: np.ndarray, error: np.ndarray) -> None:
    """Runs with fewer modes, and one with nothing left out."""
    kept = data["modes_kept"].values
    few = np.flatnonzero(kept < data.attrs["num_modes"])
    if few.size:
        ax.plot(seconds[few], error[few], "o", color="0.3", fillstyle="none", label="fewer modes")
    for i in few:
        ax.annotate(str(kept[i]), (seconds[i], error[i]), xytext=(5, -9), textcoords="offset points", fontsize=7)
    plain = np.flatnonzero(data["reduced"].values == 0)
    if plain.size:
        ax.plot(seconds[plain], error[plain], "X", color="0.3", label="nothing left out")


def _figure(data: Dataset) -> Figure | None:
    if not np.isfinite(data["error"].values).any():
        return None
    fig, grid = figure(1, 1, width=9.0, height=4.6, right=2.4)
    ax = error_against_time(data, grid[0, 0])
    legend_beside(ax, labelled(ax).values())
    return finish(fig, data, "error against time")


PICTURES: dict[str, Picture] = {"tradeoff": _figure}
