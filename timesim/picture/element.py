"""Pictures of a contact under prescribed motion, and of its Fourier coefficients over two parameters.

``f(data, ax=None) -> ax``, as in `timesim.picture.transient`; figures 3 to 8 of the paper.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from timesim.model.model import SEPARATION, STATE_NAMES
from timesim.picture.style import (
    BLUE,
    STATE_STYLE,
    VERMILION,
    Picture,
    axes,
    figure,
    heading,
    shared_legend,
    state_curves,
)

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

PALE = "0.7"
MAX_CIRCLES = 8
COEFFICIENTS = {"f_b": "static", "f_s": "in phase", "f_c": "out of phase"}
LENGTHS = ("a", "b", "d")


def force_path(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Friction force in the contact plane, and its limit: |f| <= mu n, drawn along the force (figures 4 to 6).

    The path of the first cycle, from f = 0, is pale. Where a transition takes place, the limit circle of that
    instant is drawn thin, with the angle.
    """
    ax = axes(ax)
    f, state = _closed(data.force.values), _closed(data.state.values)
    first = data.first_force.values
    limit = data.attrs["friction"] * _closed(data.normal_load.values)
    ax.plot(first[:, 0], first[:, 1], color=PALE, linewidth=0.9, label="first cycle")
    size = np.hypot(*f.T)
    towards = np.divide(f, size[:, None], out=np.full_like(f, np.nan), where=size[:, None] > 0)
    ax.plot(*(towards * limit[:, None]).T, color="black", linewidth=0.8, linestyle="--", label="limit μn")
    state_curves(ax, f[:, 0], f[:, 1], state)
    _transition_circles(data, ax)
    ax.set(xlabel="f1 [force]", ylabel="f2 [force]")
    ax.set_aspect("equal", adjustable="datalim")
    return ax


def _transition_circles(data: "xarray.Dataset", ax: "matplotlib.axes.Axes") -> None:
    turn = np.linspace(0, 2 * np.pi, 181)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for number, (f, angles) in enumerate(_places(data)[:MAX_CIRCLES]):
        radius = np.hypot(*f)
        label = None if number else "limit circle there"
        ax.plot(*(radius * circle), color="0.55", linewidth=0.6, label=label)
        ax.plot(*f, "o", color="black", ms=4, label=None if number else "transition")
        x, y = (12 * (f / radius if radius > 0 else np.array([0.3, -0.95]))).tolist()
        text = ", ".join(f"{degrees:.1f}°" for degrees in angles)
        ax.annotate(text, (f[0], f[1]), (x, y), textcoords="offset points", fontsize=7, ha="center", va="center")


def _places(data: "xarray.Dataset") -> list[tuple[np.ndarray, list[float]]]:
    """Force at each transition, and the angles at which the force is there: several where it vanishes."""
    size = np.abs(data.force.values).max()
    found: list[tuple[np.ndarray, list[float]]] = []
    for degrees, f in zip(data.transition_angle_deg.values, data.transition_force.values, strict=True):
        f = np.where(np.abs(f) < 1e-9 * size, 0.0, f)
        near = [angles for place, angles in found if np.hypot(*(place - f)) < 1e-2 * size]
        if near:
            near[0].append(float(degrees))
        else:
            found.append((f, [float(degrees)]))
    return found


def hysteresis(
    data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None, *, tangent: str = "t1"
) -> "matplotlib.axes.Axes":
    """Friction force against displacement along one axis, coloured by state."""
    ax = axes(ax)
    u, f = (_closed(data[name].sel(tangent=tangent).values) for name in ("u", "force"))
    first, number = data.first_force.sel(tangent=tangent).values, tangent.removeprefix("t")
    ax.plot(u[:-1], first, color=PALE, linewidth=0.9, label="first cycle")
    state_curves(ax, u, f, _closed(data.state.values))
    ax.set(xlabel=f"u{number} [length]", ylabel=f"f{number} [force]")
    return ax


def normal_load(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """Limit mu n and friction force over the angle; separations are shaded, transitions dotted."""
    ax = axes(ax)
    angle = np.append(data.angle.values, 360.0)
    limit = data.attrs["friction"] * _closed(data.normal_load.values)
    force = _closed(np.hypot(*data.force.values.T))
    for number, (start, end) in enumerate((a, b) for a, b, state in spans(data) if state == SEPARATION):
        ax.axvspan(start, end, color="0.87", linewidth=0, zorder=0, label=None if number else "no contact")
    ax.plot(angle, limit, color=BLUE, linewidth=1.4, label="limit μn")
    ax.plot(angle, force, color=VERMILION, linestyle="--", linewidth=1.2, label="friction force |f|")
    for place in data.transition_angle_deg.values:
        ax.axvline(place, color="0.4", linewidth=0.7, linestyle=":")
    ax.set(ylabel="μn, |f| [force]", xlim=(0, 360))
    ax.set_xticks(range(0, 361, 60))
    return ax


def states(data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """State over the angle, as a bar between the transitions."""
    ax = axes(ax)
    for start, end, state in spans(data):
        style = STATE_STYLE[state]
        bars = ax.broken_barh([(start, end - start)], (-0.4, 0.8), facecolor=style.colour, linewidth=0)
        bars.set(edgecolor="white", hatch=style.hatch, label=STATE_NAMES[state])
    ax.set(xlabel="angle θ [degree]", xlim=(0, 360), ylim=(-0.6, 0.6))
    ax.set_xticks(range(0, 361, 60))
    ax.set_yticks([0], ["state"])
    ax.grid(False)
    return ax


def spans(data: "xarray.Dataset") -> list[tuple[float, float, int]]:
    """Start, end [degree] and state of each stay of the cycle, from 0 to 360."""
    order = np.argsort(data.transition_angle_deg.values, kind="stable")
    angle = np.concatenate([[0.0], data.transition_angle_deg.values[order], [360.0]])
    after = data.transition_to.values[order]
    state = np.concatenate([after[-1:] if after.size else data.state.values[:1], after]).astype(int)
    stays = zip(angle[:-1], angle[1:], state, strict=True)
    return [(float(a), float(b), int(s)) for a, b, s in stays if b > a]


def _closed(values: np.ndarray) -> np.ndarray:
    """With the first sample again at the end: the cycle repeats."""
    return np.concatenate([values, values[:1]])


def contour(
    data: "xarray.Dataset", ax: "matplotlib.axes.Axes | None" = None, *, name: str = "f_s", tangent: str = "t1"
) -> "matplotlib.axes.Axes":
    """A Fourier coefficient over the two axes of a map: contour lines on shades."""
    ax = axes(ax)
    x, y, z = _surface(data, name, tangent)
    if np.ptp(z) > 0:
        shades = ax.contourf(x, y, z.T, levels=12, cmap="viridis")
        lines = ax.contour(x, y, z.T, levels=list(shades.levels), colors="black", linewidths=0.4)
        ax.clabel(lines, np.asarray(lines.levels)[1::2], fontsize=6, fmt="%.3g")
    ax.set_xlabel(_axis_label(data, 0))
    ax.set_ylabel(_axis_label(data, 1))
    ax.set_title(_coefficient_label(name, tangent), fontsize=9)
    ax.grid(False)
    return ax


def surface(data: "xarray.Dataset", ax: Any, *, name: str = "f_s", tangent: str = "t1") -> Any:
    """A Fourier coefficient as a surface over two amplitudes, the half b <= a where a and b are the axes.

    Args:
        data: result of an `element_map`.
        ax: axes with projection 3d.

    Keyword Args:
        name: f_b, f_s or f_c.
        tangent: t1 or t2.
    """
    x, y, z = _surface(data, name, tangent)
    grid = np.meshgrid(x, y, indexing="ij")
    if map_axes(data) == ("a", "b"):
        z = np.where(grid[1] <= grid[0] * (1 + 1e-9), z, np.nan)
    step = [max(1, size // 27) for size in z.shape]
    ax.plot_surface(*grid, z, cmap="viridis", rstride=step[0], cstride=step[1], edgecolor="0.25", linewidth=0.25)
    ax.set_xlabel(_axis_label(data, 0), fontsize=8, labelpad=-3)
    ax.set_ylabel(_axis_label(data, 1), fontsize=8, labelpad=-3)
    ax.set_title(_coefficient_label(name, tangent), fontsize=9, pad=-6)
    ax.tick_params(labelsize=7, pad=-2)
    ax.view_init(28, -120)
    ax.set_box_aspect(None, zoom=0.9)
    return ax


def map_axes(data: "xarray.Dataset") -> tuple[str, str]:
    """Names of the two axes of a map."""
    first, second = (str(dim) for dim in data.dissipation.dims)
    return first, second


def _surface(data: "xarray.Dataset", name: str, tangent: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    first, second = map_axes(data)
    return data[first].values, data[second].values, data[name].sel(tangent=tangent).values


def _axis_label(data: "xarray.Dataset", number: int) -> str:
    name = map_axes(data)[number]
    units = data[name].attrs.get("units", "1")
    shown = name.removesuffix("_deg").replace("phi", "φ").replace("psi", "ψ").replace("_", " ")
    return shown if units == "1" else f"{shown} [{units}]"


def _coefficient_label(name: str, tangent: str) -> str:
    return f"{COEFFICIENTS[name]}, {name}{tangent.removeprefix('t')} [force]"


def _path_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure":
    made, grid = figure(width=8.2, height=5.6)
    force_path(data, grid[0, 0])
    return _finished(made, data, "friction force in the contact plane, steady cycle")


def _hysteresis_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure":
    made, grid = figure(1, 2, width=8.5, height=3.2)
    for ax, tangent in zip(grid[0], ("t1", "t2"), strict=True):
        hysteresis(data, ax, tangent=tangent)
    loss = f"{float(data.dissipation):.4g} [force·length] a cycle"
    return _finished(made, data, f"hysteresis, steady cycle: {loss}")


def _cycle_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure":
    made, grid = figure(2, 1, width=8.0, height=1.7, sharex=True, height_ratios=[4, 1])
    normal_load(data, grid[0, 0]).set_xlabel("")
    states(data, grid[1, 0])
    return _finished(made, data, "normal load, friction force and state over the cycle")


def _finished(made: "matplotlib.figure.Figure", data: "xarray.Dataset", what: str) -> "matplotlib.figure.Figure":
    shared_legend(made)
    heading(made, data, what)
    return made


def _contour_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    if min(data.dissipation.shape) < 2:
        return None
    made, grid = figure(3, 2, width=8.0, height=2.7, gap=0.75)
    for row, name in zip(grid, COEFFICIENTS, strict=True):
        for ax, tangent in zip(row, ("t1", "t2"), strict=True):
            contour(data, ax, name=name, tangent=tangent)
    heading(made, data, "Fourier coefficients of the friction force")
    return made


def _surface_figure(data: "xarray.Dataset") -> "matplotlib.figure.Figure | None":
    if min(data.dissipation.shape) < 2:
        return None
    made, grid = figure(3, 2, width=8.5, height=3.2, gap=0.2, left=0.3, subplot_kw={"projection": "3d"})
    for row, name in zip(grid, COEFFICIENTS, strict=True):
        for ax, tangent in zip(row, ("t1", "t2"), strict=True):
            surface(data, ax, name=name, tangent=tangent)
    heading(made, data, "Fourier coefficients of the friction force")
    return made


PICTURES: dict[str, Picture] = {
    "force_path": _path_figure,
    "hysteresis": _hysteresis_figure,
    "cycle": _cycle_figure,
}
MAP_PICTURES: dict[str, Picture] = {"surfaces": _surface_figure, "contours": _contour_figure}
