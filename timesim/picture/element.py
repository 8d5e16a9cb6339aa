"""Pictures of a contact under prescribed motion (figures 3 to 6 of the paper), and of its coefficients (7, 8)."""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from timesim.model.model import SEPARATION
from timesim.picture.figure import axes, figure, finish, over_cycle
from timesim.picture.style import (
    BLUE,
    PALE,
    VERMILION,
    Axes,
    Dataset,
    Figure,
    Picture,
    Series,
    shade,
    state_bar,
    state_curves,
    unit,
)
from timesim.result.label import counted

MAX_CIRCLES = 8
ANGLE = "angle θ [degree]"
COEFFICIENTS = {"f_b": "static", "f_s": "in phase", "f_c": "out of phase"}
APART = 0.12  # share of the axes, between labels of contour lines
ROUNDING = 1e-12  # share of the ranges of force and motion below which a loss is zero
NOISE = 1e-6
"""Of the largest coefficient: the steps leave up to 2e-9 of it in one that is zero by symmetry."""
NOTHING = "nothing is computed"


def force_path(data: Dataset, ax: Axes | None = None) -> Axes:
    """Friction force in the contact plane, and its limit: |f| <= mu n, drawn along the force (figures 4 to 6).

    The path of the first cycle, from f = 0, is pale. For each transition the limit circle of that instant is drawn
    thin, and the angle is written beside it.
    """
    ax = axes(ax)
    f, state = _closed(data.force.values), _closed(data.state.values)
    first = data.first_force.values
    limit = data.attrs["friction"] * _closed(data.normal_load.values)
    ax.plot(first[:, 0], first[:, 1], color=PALE, linewidth=0.9, label="first cycle")
    size = np.hypot(*f.T)
    towards = np.divide(f, size[:, None], out=np.full_like(f, np.nan), where=size[:, None] > 0)
    ax.plot(*(towards * limit[:, None]).T, color="black", linewidth=0.8, linestyle="--", label="limit μn")
    state_curves(ax, f[:, 0], f[:, 1], state, stop=data.attrs["friction"] == 0)
    _transition_circles(data, ax)
    ax.set(xlabel=f"f1{unit(data, 'force')}", ylabel=f"f2{unit(data, 'force')}")
    ax.set_aspect("equal", adjustable="datalim")
    return ax


def _transition_circles(data: Dataset, ax: Axes) -> None:
    turn = np.linspace(0, 2 * np.pi, 181)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for f, angles in _transition_forces(data)[:MAX_CIRCLES]:
        radius = np.hypot(*f)
        ax.plot(*(radius * circle), color="0.55", linewidth=0.7, linestyle=":", label="limit circle there")
        ax.plot(*f, "o", color="black", ms=4, label="transition")
        x, y = (f / radius if radius > 0 else np.array([0.3, -0.95])).tolist()
        across = "left" if x > 0.3 else "right" if x < -0.3 else "center"
        beside: dict[str, Any] = {"ha": across, "va": "bottom" if y > 0 else "top"}
        text = ", ".join(f"{degrees:.1f}°" for degrees in angles)
        above: dict[str, Any] = {"zorder": 5, "bbox": {"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 0.5}}
        ax.annotate(text, (f[0], f[1]), (6 * x, 6 * y), textcoords="offset points", fontsize=7, **beside, **above)


def _transition_forces(data: Dataset) -> list[tuple[np.ndarray, list[float]]]:
    """Force at the transitions, and the angles of those that have the same force, as where it vanishes."""
    size = np.abs(data.force.values).max()
    forces: list[tuple[np.ndarray, list[float]]] = []
    for degrees, f in zip(data.transition_angle_deg.values, data.transition_force.values, strict=True):
        f = np.where(np.abs(f) < 1e-9 * size, 0.0, f)
        near = [angles for force, angles in forces if np.hypot(*(force - f)) < 1e-2 * size]
        if near:
            near[0].append(float(degrees))
        else:
            forces.append((f, [float(degrees)]))
    return forces


def hysteresis(data: Dataset, ax: Axes | None = None, *, tangent: str = "t1") -> Axes:
    """Friction force against displacement along one axis, coloured by state."""
    ax = axes(ax)
    u, f = (_closed(data[name].sel(tangent=tangent).values) for name in ("u", "force"))
    first, number = data.first_force.sel(tangent=tangent).values, tangent.removeprefix("t")
    ax.plot(u[:-1], first, color=PALE, linewidth=0.9, label="first cycle")
    state_curves(ax, u, f, _closed(data.state.values), stop=data.attrs["friction"] == 0)
    ax.set(xlabel=f"u{number}{unit(data, 'u')}", ylabel=f"f{number}{unit(data, 'force')}")
    return ax


def friction_limit(data: Dataset, ax: Axes | None = None) -> Axes:
    """Limit mu n and friction force over the angle; separations are shaded, transitions dotted."""
    ax = axes(ax)
    angle = np.append(data.angle.values, 360.0)
    limit = data.attrs["friction"] * _closed(data.normal_load.values)
    force = _closed(np.hypot(*data.force.values.T))
    shade(ax, ((start, end) for start, end, state in intervals(data) if state == SEPARATION), "no contact")
    ax.plot(angle, limit, label="limit μn", **Series(BLUE, "-", "", beneath=True).look())
    ax.plot(angle, force, color=VERMILION, linestyle="--", linewidth=1.2, label="friction force |f|")
    for degrees in data.transition_angle_deg.values:
        ax.axvline(degrees, color="0.4", linewidth=0.7, linestyle=":")
    ax.set_ylabel(f"μn, |f|{unit(data, 'force')}")
    return over_cycle(ax, ANGLE)


def contact_states(data: Dataset, ax: Axes | None = None) -> Axes:
    """State over the angle, as a bar between the transitions."""
    ax = axes(ax)
    state_bar(ax, 0, intervals(data), height=0.8, stop=data.attrs["friction"] == 0)
    ax.set_ylim(-0.6, 0.6)
    ax.set_yticks([0], ["state"])
    ax.grid(False)
    return over_cycle(ax, ANGLE)


def intervals(data: Dataset) -> list[tuple[float, float, int]]:
    """Start, end [degree] and state of each interval of the cycle, from 0 to 360."""
    order = np.argsort(data.transition_angle_deg.values, kind="stable")
    angle = np.concatenate([[0.0], data.transition_angle_deg.values[order], [360.0]])
    after = data.transition_to.values[order]
    state = np.concatenate([after[-1:] if after.size else data.state.values[:1], after]).astype(int)
    stays = zip(angle[:-1], angle[1:], state, strict=True)
    return [(float(a), float(b), int(s)) for a, b, s in stays if b > a]


def _closed(values: np.ndarray) -> np.ndarray:
    """The samples of a cycle with the first one repeated at the end."""
    return np.concatenate([values, values[:1]])


def _path_figure(data: Dataset) -> Figure:
    fig, grid = figure(width=8.2, height=5.6)
    ax = force_path(data, grid[0, 0])
    if not (data.force.values.any() or data.first_force.values.any()):
        ax.text(0.5, 0.55, "no friction force at any angle", transform=ax.transAxes, ha="center", fontsize=9)
    return finish(fig, data, "friction force in the contact plane, steady cycle")


def _hysteresis_figure(data: Dataset) -> Figure:
    fig, grid = figure(1, 2, width=8.5, height=3.2)
    for ax, tangent in zip(grid[0], ("t1", "t2"), strict=True):
        hysteresis(data, ax, tangent=tangent)
    least = ROUNDING * np.prod([np.ptp(data[name].values, axis=0) for name in ("u", "force")], axis=0).max()
    energy = float(data.dissipation) if abs(data.dissipation) > least else 0.0
    lost = f"{energy:.4g} {unit(data, 'dissipation').strip(' []')}"
    return finish(fig, data, f"hysteresis, steady cycle, which dissipates {lost}".rstrip())


def _cycle_figure(data: Dataset) -> Figure:
    fig, grid = figure(2, 1, width=8.0, height=1.7, sharex=True, height_ratios=[4, 1])
    friction_limit(data, grid[0, 0]).set_xlabel("")
    contact_states(data, grid[1, 0])
    return finish(fig, data, "limit of the friction force, friction force and state over the cycle")


PICTURES: dict[str, Picture] = {"force_path": _path_figure, "hysteresis": _hysteresis_figure, "cycle": _cycle_figure}


# Fourier coefficients over two parameters of the motion


def contour(data: Dataset, ax: Axes | None = None, *, name: str = "f_s", tangent: str = "t1") -> Axes:
    """A Fourier coefficient, f_b, f_s or f_c along t1 or t2, over the axes of the map: contour lines on shades."""
    ax, (first, second) = axes(ax), parameters(data)
    x, y, z = data[first].values, data[second].values, np.ma.masked_invalid(_coefficient(data, name, tangent))
    if z.count() and z.max() > z.min():
        shades = ax.contourf(x, y, z.T, levels=12, cmap="viridis")
        _colour_bar(ax, shades)
        lines = ax.contour(x, y, z.T, levels=list(shades.levels), colors="black", linewidths=0.4)
        places = _label_places(lines, np.stack([x[[0, -1]], y[[0, -1]]], axis=1))
        ax.clabel(lines, fontsize=6, fmt="%.3g", manual=places)
    else:
        where = "everywhere" if z.count() == z.size else "wherever it is computed"
        said = f"{z.compressed()[0]:.4g} {where}" if z.count() else NOTHING
        ax.text(0.5, 0.5, said, transform=ax.transAxes, ha="center", fontsize=9)
        ax.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    ax.set(xlabel=_axis_label(data, first), ylabel=_axis_label(data, second))
    ax.set_title(_coefficient_label(data, name, tangent), fontsize=9)
    ax.grid(False)
    return ax


def _label_places(lines: Any, corners: np.ndarray) -> list[tuple[float, float]]:
    """The middle of the longest contour line of each second level where there is room for a label.

    ``corners``: of the axes, lower left and upper right.
    """
    (first, last), places = corners, list[np.ndarray]()
    for segments in lines.allsegs[1::2]:
        for longest in sorted((segment for segment in segments if len(segment)), key=len)[-1:]:
            line = (longest - first) / (last - first)
            middle, size = line[len(line) // 2], np.ptp(line, axis=0).max()
            inside = np.all(np.abs(middle - 0.5) < 0.5 - 0.3 * APART)
            if inside and size > 2 * APART and all(np.hypot(*(middle - other)) > APART for other in places):
                places.append(middle)
    return [(float(x), float(y)) for x, y in (first + place * (last - first) for place in places)]


def surface(data: Dataset, ax: Any = None, *, name: str = "f_s", tangent: str = "t1") -> Any:
    """The same as a surface, on axes with projection 3d."""
    ax = figure(subplot_kw={"projection": "3d"})[1][0, 0] if ax is None else ax
    first, second = parameters(data)
    x, y = np.meshgrid(data[first].values, data[second].values, indexing="ij")
    z = _coefficient(data, name, tangent)
    step = [max(1, size // 27) for size in z.shape]
    faces = {"rstride": step[0], "cstride": step[1], "edgecolor": "0.25", "linewidth": 0.25}
    if np.isfinite(z).any():
        # Faces take the colour of their mean, and the bar would span no more than these.
        shades = ax.plot_surface(x, y, z, cmap="viridis", vmin=np.nanmin(z), vmax=np.nanmax(z), **faces)
        _colour_bar(ax, shades, shrink=0.6, pad=0.1)
    else:
        ax.text2D(0.5, 0.5, NOTHING, transform=ax.transAxes, ha="center", fontsize=9)
    ax.set_xlabel(_axis_label(data, first), fontsize=8, labelpad=0)
    ax.set_ylabel(_axis_label(data, second), fontsize=8, labelpad=0)
    ax.set_title(_coefficient_label(data, name, tangent), fontsize=9, pad=-6)
    ax.tick_params(labelsize=7, pad=0)
    ax.tick_params(axis="z", pad=3)
    ax.locator_params(axis="z", nbins=5)
    ax.view_init(28, -120)
    ax.set_box_aspect(None, zoom=1.05)
    return ax


def profile(data: Dataset, ax: Axes | None = None, *, name: str = "f_s", tangent: str = "t1") -> Axes:
    """The same over the one parameter that varies."""
    ax, z = axes(ax), _coefficient(data, name, tangent).ravel()
    varied = max(parameters(data), key=lambda parameter: data.sizes[parameter])
    ax.plot(data[varied].values, z, "o-", color=BLUE, ms=3)
    ax.set(xlabel=_axis_label(data, varied), ylabel=_coefficient_label(data, name, tangent))
    return ax


def _colour_bar(ax: Any, shades: Any, **options: Any) -> None:
    bar = ax.figure.colorbar(shades, ax=ax, **options)
    bar.ax.tick_params(labelsize=7)


def parameters(data: Dataset) -> tuple[str, str]:
    """Names of the two parameters of a map."""
    first, second = (str(dim) for dim in data.dissipation.dims)
    return first, second


def _coefficient(data: Dataset, name: str, tangent: str) -> np.ndarray:
    """A coefficient over both parameters without the noise of the steps: zero, or the same everywhere, but for it.

    NaN where it was not computed, or the cycle is not the steady one.
    """
    z = data[name].where(data["settled"] == 1).sel(tangent=tangent).transpose(*data.dissipation.dims).values
    noise = NOISE * max(float(np.abs(data[part]).max()) for part in COEFFICIENTS)
    z = np.where(np.abs(z) <= noise, 0.0, z)
    known = z[np.isfinite(z)]
    if not known.size or np.ptp(known) > noise:
        return z
    return np.where(np.isnan(z), z, (known.max() + known.min()) / 2)


def _axis_label(data: Dataset, name: str) -> str:
    shown = name.removesuffix("_deg").replace("phi", "φ").replace("psi", "ψ").replace("_", " ")
    return shown if data[name].attrs.get("units", "1") == "1" else shown + unit(data, name)


def _coefficient_label(data: Dataset, name: str, tangent: str) -> str:
    return f"{COEFFICIENTS[name]}, {name}{tangent.removeprefix('t')}{unit(data, name)}"


def _all_coefficients(data: Dataset, draw: Callable[..., Any], varied: int = 2, **options: Any) -> Figure | None:
    """All coefficients along both axes of the contact; no figure if not so many parameters have several values."""
    if sum(size > 1 for size in data.dissipation.shape) != varied:
        return None
    fig, grid = figure(3, 2, **options)
    for ax, (name, tangent) in zip(grid.flat, product(COEFFICIENTS, ("t1", "t2")), strict=True):
        draw(data, ax, name=name, tangent=tangent)
    blank, known = data["settled"].values == 0, np.isfinite(data["dissipation"].values)
    reasons = {"that had not settled": np.sum(blank & known), "not computed": np.sum(blank & ~known)}
    notes = [f"blank: {counted(int(number), 'point')} {why}" for why, number in reasons.items() if number]
    return finish(fig, data, "Fourier coefficients of the friction force", *notes)


_SPACE: dict[str, Any] = {"width": 10.0, "height": 3.4, "gap": 0.2, "left": 0.3, "subplot_kw": {"projection": "3d"}}
MAP_PICTURES: dict[str, Picture] = {
    "surfaces": partial(_all_coefficients, draw=surface, **_SPACE),
    "contours": partial(_all_coefficients, draw=contour, width=8.0, height=2.7, gap=0.75),
    "coefficients": partial(_all_coefficients, draw=profile, varied=1, width=8.0, height=2.3),
}
