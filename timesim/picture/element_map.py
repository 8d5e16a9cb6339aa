"""Pictures of the Fourier coefficients of a friction force over two parameters of its motion (figures 7, 8)."""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from timesim.picture.style import Axes, Dataset, Figure, Picture, axes, figure, finish, unit

COEFFICIENTS = {"f_b": "static", "f_s": "in phase", "f_c": "out of phase"}
NOISE = 1e-6
"""Of the largest coefficient: the steps leave up to 2e-9 of it in one that is zero by symmetry."""


def contour(data: Dataset, ax: Axes | None = None, *, name: str = "f_s", tangent: str = "t1") -> Axes:
    """A Fourier coefficient, f_b, f_s or f_c along t1 or t2, over the axes of the map: contour lines on shades."""
    ax, (first, second) = axes(ax), parameters(data)
    x, y, z = data[first].values, data[second].values, _coefficient(data, name, tangent)
    if np.ptp(z) > 0:
        shades = ax.contourf(x, y, z.T, levels=12, cmap="viridis")
        _colour_bar(ax, shades)
        lines = ax.contour(x, y, z.T, levels=list(shades.levels), colors="black", linewidths=0.4)
        ax.clabel(lines, np.asarray(lines.levels)[1::2], fontsize=6, fmt="%.3g")
    else:
        ax.text(0.5, 0.5, f"{z.flat[0]:.4g} everywhere", transform=ax.transAxes, ha="center", fontsize=9)
        ax.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    ax.set(xlabel=_axis_label(data, first), ylabel=_axis_label(data, second))
    ax.set_title(_coefficient_label(data, name, tangent), fontsize=9)
    ax.grid(False)
    return ax


def surface(data: Dataset, ax: Any = None, *, name: str = "f_s", tangent: str = "t1") -> Any:
    """The same as a surface, on axes with projection 3d."""
    ax = figure(subplot_kw={"projection": "3d"})[1][0, 0] if ax is None else ax
    first, second = parameters(data)
    x, y = np.meshgrid(data[first].values, data[second].values, indexing="ij")
    z = _coefficient(data, name, tangent)
    step = [max(1, size // 27) for size in z.shape]
    faces = {"rstride": step[0], "cstride": step[1], "edgecolor": "0.25", "linewidth": 0.25}
    _colour_bar(ax, ax.plot_surface(x, y, z, cmap="viridis", **faces), shrink=0.6, pad=0.1)
    ax.set_xlabel(_axis_label(data, first), fontsize=8, labelpad=0)
    ax.set_ylabel(_axis_label(data, second), fontsize=8, labelpad=0)
    ax.set_title(_coefficient_label(data, name, tangent), fontsize=9, pad=-6)
    ax.tick_params(labelsize=7, pad=0)
    ax.tick_params(axis="z", pad=3)
    ax.locator_params(axis="z", nbins=5)
    ax.view_init(28, -120)
    ax.set_box_aspect(None, zoom=1.05)
    return ax


def _colour_bar(ax: Any, shades: Any, **options: Any) -> None:
    bar = ax.figure.colorbar(shades, ax=ax, **options)
    bar.ax.tick_params(labelsize=7)


def parameters(data: Dataset) -> tuple[str, str]:
    """Names of the two parameters of a map."""
    first, second = (str(dim) for dim in data.dissipation.dims)
    return first, second


def _coefficient(data: Dataset, name: str, tangent: str) -> np.ndarray:
    """A coefficient over both parameters, the same everywhere where its differences are the noise of the steps."""
    z, noise = data[name].sel(tangent=tangent).values, NOISE * max(np.abs(data[part]).max() for part in COEFFICIENTS)
    middle = (z.max() + z.min()) / 2
    return z if np.ptp(z) > noise else np.full_like(z, middle if np.abs(middle) > noise else 0.0)


def _axis_label(data: Dataset, name: str) -> str:
    shown = name.removesuffix("_deg").replace("phi", "φ").replace("psi", "ψ").replace("_", " ")
    return shown if data[name].attrs.get("units", "1") == "1" else shown + unit(data, name)


def _coefficient_label(data: Dataset, name: str, tangent: str) -> str:
    return f"{COEFFICIENTS[name]}, {name}{tangent.removeprefix('t')}{unit(data, name)}"


def _all_coefficients(data: Dataset, draw: Callable[..., Any], **options: Any) -> Figure | None:
    """All coefficients along both axes of the contact; no figure if a parameter has only one value."""
    if min(data.dissipation.shape) < 2:
        return None
    fig, grid = figure(3, 2, **options)
    for ax, (name, tangent) in zip(grid.flat, product(COEFFICIENTS, ("t1", "t2")), strict=True):
        draw(data, ax, name=name, tangent=tangent)
    return finish(fig, data, "Fourier coefficients of the friction force")


_SPACE: dict[str, Any] = {"width": 10.0, "height": 3.4, "gap": 0.2, "left": 0.3, "subplot_kw": {"projection": "3d"}}
PICTURES: dict[str, Picture] = {
    "surfaces": partial(_all_coefficients, draw=surface, **_SPACE),
    "contours": partial(_all_coefficients, draw=contour, width=8.0, height=2.7, gap=0.75),
}
