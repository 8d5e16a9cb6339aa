"""Pictures of results: `draw` makes those of a run; what one shows is drawn by `plot_transient` and its like.

Figures are made without pyplot: cheaper to import, no global state. Contact states are told apart by colour
(Okabe and Ito's palette) and, for print and the colour-blind, by line style in curves and by hatching in bars.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from timesim.model import SEPARATION, SLIP, STATE_NAMES, STICK

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9"
DPI = 110


class Series(NamedTuple):
    """How one of several curves is drawn."""

    colour: str
    line: Any
    marker: str


class StateStyle(NamedTuple):
    """How a contact state is drawn."""

    colour: str
    line: Any
    hatch: str


SERIES = (
    Series(BLUE, "-", "o"),
    Series(VERMILION, "--", "s"),
    Series(GREEN, "-.", "D"),
    Series(PURPLE, ":", "^"),
    Series(ORANGE, (0, (5, 1, 1, 1)), "v"),
    Series(SKY, (0, (8, 2)), "x"),
    Series("0.5", (0, (3, 3)), "+"),
)
STATE_STYLE = {
    STICK: StateStyle(BLUE, "-", ""),
    SLIP: StateStyle(VERMILION, (0, (3, 1)), "////"),
    SEPARATION: StateStyle(GREEN, (0, (1, 1)), "...."),
}

Picture = Callable[["xarray.Dataset"], "matplotlib.figure.Figure | None"]


def draw(data: "xarray.Dataset", folder: Path | str) -> list[Path]:
    """Write the pictures of a result into a folder as PNG, replacing earlier ones.

    Args:
        data: the result, as `timesim.store.open_result` gives it.
        folder: an existing folder.

    Returns:
        The files written, in order; none for a study that has no pictures.

    Raises:
        OSError: a file cannot be written.
    """
    written = []
    for name, picture in _pictures(str(data.attrs["study"])).items():
        figure = picture(data)
        if figure is not None:
            written.append(Path(folder) / f"{name}.png")
            figure.savefig(written[-1], dpi=DPI)
    return written


def picture_names(study: str) -> list[str]:
    """Names of the files that `draw` may write for a kind of study."""
    return [f"{name}.png" for name in _pictures(study)]


def _pictures(study: str) -> Mapping[str, Picture]:
    from timesim import plot_transient

    return {"transient": plot_transient.PICTURES, "jump": plot_transient.PICTURES}.get(study, {})


def axes(ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
    """The axes given, or those of a new figure."""
    return figure()[1][0, 0] if ax is None else ax


def figure(
    rows: int = 1, columns: int = 1, *, width: float = 7.0, height: float = 4.0, **options: Any
) -> tuple["matplotlib.figure.Figure", np.ndarray]:
    """A figure that needs no display, and its axes.

    Args:
        rows, columns: of axes.
        width, height: of the figure [inch].
        options: of `matplotlib.figure.Figure.subplots`.

    Returns:
        The figure and its axes, shape (rows, columns).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    grid = made.subplots(rows, columns, squeeze=False, **options)
    for ax in grid.flat:
        ax.ticklabel_format(useOffset=False, scilimits=(-3, 4))
        ax.grid(True, color="0.9", linewidth=0.6)
        ax.set_axisbelow(True)
    return made, grid


def heading(made: "matplotlib.figure.Figure", data: "xarray.Dataset", what: str, left_out: str = "") -> None:
    """Title of a figure: the scene's own and what is shown; at the foot what did not find room."""
    title = str(data.attrs.get("title") or "")
    unfinished = "" if int(data.attrs["complete"]) else " (incomplete run)"
    made.suptitle((f"{title}\n" if title else "") + what + unfinished, fontsize=11)
    if left_out:
        made.supxlabel(left_out, fontsize=8, color="0.35")


def state_curves(ax: "matplotlib.axes.Axes", x: np.ndarray, y: np.ndarray, state: np.ndarray) -> None:
    """Draw a curve in the styles of its states, one artist for each state that occurs.

    Args:
        ax: axes to draw on.
        x, y: the curve, shape (T,).
        state: contact state from each sample to the next, shape (T,).
    """
    for number, style in STATE_STYLE.items():
        inside = state == number
        if inside.any():
            reach = inside.copy()
            reach[1:] |= inside[:-1]
            ax.plot(
                *(_broken(values, inside, reach) for values in (x, y)),
                color=style.colour,
                linestyle=style.line,
                linewidth=1.6,
                label=STATE_NAMES[number],
            )


def _broken(values: np.ndarray, inside: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Values in reach, NaN elsewhere; also NaN between two pieces that meet in one sample of another state."""
    return np.where(reach, values, np.nan)


def state_legend(made: "matplotlib.figure.Figure") -> None:
    """One legend for all axes of a figure, below them, each label once."""
    entries = {}
    for ax in made.axes:
        for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
    if entries:
        order = sorted(entries, key=lambda name: STATE_NAMES.index(name) if name in STATE_NAMES else 9)
        made.legend([entries[name] for name in order], order, loc="outside lower center", ncols=len(order))
