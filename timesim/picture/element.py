"""Pictures of a contact under prescribed motion (figures 3 to 6 of the paper)."""

from typing import Any

import numpy as np

from timesim.model.model import SEPARATION
from timesim.picture.style import (
    BLUE,
    PALE,
    VERMILION,
    Axes,
    Dataset,
    Figure,
    Picture,
    axes,
    figure,
    finish,
    over_cycle,
    shade,
    state_bar,
    state_curves,
    unit,
)

MAX_CIRCLES = 8
ANGLE = "angle θ [degree]"


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
        beside: dict[str, Any] = {
            "ha": "left" if x > 0.3 else "right" if x < -0.3 else "center",
            "va": "bottom" if y > 0 else "top",
        }
        text = ", ".join(f"{degrees:.1f}°" for degrees in angles)
        ax.annotate(text, (f[0], f[1]), (5 * x, 5 * y), textcoords="offset points", fontsize=7, **beside)


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
    ax.plot(angle, limit, color=BLUE, linewidth=1.4, label="limit μn")
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
    force_path(data, grid[0, 0])
    return finish(fig, data, "friction force in the contact plane, steady cycle")


def _hysteresis_figure(data: Dataset) -> Figure:
    fig, grid = figure(1, 2, width=8.5, height=3.2)
    for ax, tangent in zip(grid[0], ("t1", "t2"), strict=True):
        hysteresis(data, ax, tangent=tangent)
    lost = f"{float(data.dissipation):.4g}{unit(data, 'dissipation')}"
    return finish(fig, data, f"hysteresis, steady cycle: {lost} a cycle")


def _cycle_figure(data: Dataset) -> Figure:
    fig, grid = figure(2, 1, width=8.0, height=1.7, sharex=True, height_ratios=[4, 1])
    friction_limit(data, grid[0, 0]).set_xlabel("")
    contact_states(data, grid[1, 0])
    return finish(fig, data, "normal load, friction force and state over the cycle")


PICTURES: dict[str, Picture] = {
    "force_path": _path_figure,
    "hysteresis": _hysteresis_figure,
    "cycle": _cycle_figure,
}
