"""How every picture looks: figures, margins, colours, legends, and how contact states are distinguished.

Figures are made without pyplot, which is slow to import and whose global state would keep them in memory. Contact
states are distinguished by colour (Okabe and Ito 2008) and, for print and the colour-blind, by the line style of curves
and the hatching of bars.
"""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from timesim.model.model import SEPARATION, SLIP, STATE_NAMES, STICK
from timesim.result.label import attributes, shortened

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from xarray import Dataset, DataTree
else:  # matplotlib is loaded when there is something to draw
    Axes = Figure = Dataset = DataTree = Any

BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9"
PALE, NEUTRAL = "0.7", "0.25"
_HEAD, _FOOT = 0.68, 0.95  # inch
_LABELLED, _PLAIN = 0.27, 0.1  # inch from axes with a label above them, or without one, to the title


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
CLOSED_STYLE = StateStyle(ORANGE, "-", "\\\\\\\\")

CLOSED = "closed"
"""Name of the state of a frictionless stop in which other contacts slip."""

Picture = Callable[[Any], Figure | None]
"""Draws a result, a Dataset or the DataTree of one with groups; gives None where there is nothing to show."""


def axes(ax: Axes | None = None) -> Axes:
    """The axes given, or those of a new figure."""
    return figure()[1][0, 0] if ax is None else ax


def figure(
    rows: int = 1,
    columns: int = 1,
    *,
    width: float = 7.0,
    height: float = 3.0,
    gap: float = 0.25,
    left: float = 0.9,
    right: float = 0.2,
    **options: Any,
) -> tuple[Figure, np.ndarray]:
    """A figure that needs no display, and its axes, with room for a heading above and a legend below.

    Margins are fixed, since computing a layout takes as long as all the drawing (measured).

    Args:
        rows, columns: of axes, the shape of the array returned.
        width: of the figure [inch].
        height, gap: of a row of axes, and between rows [inch].
        left, right: margins [inch].
        options: of `matplotlib.figure.Figure.subplots`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    tall = _HEAD + rows * height + (rows - 1) * gap + _FOOT
    fig = Figure(figsize=(width, tall))
    FigureCanvasAgg(fig)
    edges = {
        "left": left / width,
        "right": 1 - right / width,
        "top": 1 - _HEAD / tall,
        "bottom": _FOOT / tall,
    }
    between = 0.8 / ((width - left - right - (columns - 1) * 0.8) / columns)
    fig.subplots_adjust(hspace=gap / height, wspace=between, **edges)
    grid = fig.subplots(rows, columns, squeeze=False, **options)
    for ax in grid.flat:
        ax.locator_params(nbins=6)
        ax.ticklabel_format(useOffset=False, scilimits=(-3, 4))
        ax.tick_params(labelsize=8)
        ax.grid(True, color="0.9", linewidth=0.6)
        ax.set_axisbelow(True)
    return fig, grid


def stacked(rows: int, height: float, *, share_x: bool = True, **options: Any) -> tuple[Figure, list[Axes]]:
    """Axes of a height [inch] one above the other, with room for a legend on the right.

    Without a common abscissa there is room for the label of each. Options are those of `figure`.
    """
    gap = 0.3 if share_x else 0.8
    fig, grid = figure(rows, 1, width=9.0, height=height, gap=gap, right=2.4, sharex=share_x, **options)
    return fig, list(grid[:, 0])


def finish(fig: Figure, data: Dataset | DataTree, what: str, *notes: str) -> Figure:
    """Add the title just above the axes, notes of what is left out at the foot, and a legend there if no axes have one.

    The title is that of the scene, and what is shown.
    """
    title = short(" ".join(str(data.attrs.get("title") or "").split()), 90)
    unfinished = "" if int(data.attrs["complete"]) else " (incomplete run)"
    tall, heading = fig.get_figheight(), (f"{title}\n" if title else "") + what + unfinished
    above = max(ax.get_position().y1 for ax in fig.axes)
    top = [ax for ax in fig.axes if ax.get_position().y1 > above - 0.01]
    labels = any(ax.get_title(place) for ax in top for place in ("left", "center", "right"))
    foot = above + (_LABELLED if labels else _PLAIN) / tall
    drawn = fig.suptitle(heading.replace(r"\$", "$"), fontsize=10, y=foot, va="bottom", parse_math=False)
    too_wide = drawn.get_window_extent().width / (0.97 * fig.get_figwidth() * fig.dpi)
    drawn.set_fontsize(10 / max(too_wide, 1.0))
    if all(ax.get_legend() is None for ax in fig.axes):
        _legend_below(fig)
    x, y = (0.99, 0.04) if fig.legends else (max(ax.get_position().x1 for ax in fig.axes), 0.3)
    note: dict[str, Any] = {"fontsize": 7, "color": "0.35", "ha": "right", "va": "bottom"}
    fig.text(x, y / tall, "; ".join(filter(None, notes)), **note)
    return fig


def from_zero(ax: Axes) -> None:
    """Begin the ordinate at zero, with some room above what is drawn."""
    top = ax.dataLim.y1
    ax.set_ylim(0, 1.05 * top if 0 < top < np.inf else 1.0)


def over_cycle(ax: Axes, label: str) -> Axes:
    """Label and limit the abscissa of a cycle, an angle [degree]."""
    ax.set(xlim=(0, 360), xlabel=label)
    ax.set_xticks(range(0, 361, 60))
    return ax


def label_axes(ax: Axes, label: str) -> None:
    """Write above the upper right corner which of several things the axes show."""
    ax.set_title(label, fontsize=9, pad=4, loc="right")


def unit(data: Any, name: str) -> str:
    """The unit of a variable or coordinate, in brackets after a space; empty if it has none."""
    units = {**attributes(name), **data[name].attrs}.get("units", "")
    return f" [{units.replace('*', '·')}]" if units else ""


def short(name: str, length: int = 24) -> str:
    """The name, cut to at most ``length`` characters; dollars in it make no formula."""
    return shortened(name, length).replace("$", r"\$")


def is_stop(data: Any, contact: str) -> bool:
    """Whether a contact has no friction, so that it is either open or closed."""
    return "friction" in data.coords and float(data.friction.sel(contact=contact)) == 0


def look_of(state: int, *, stop: bool) -> tuple[str, StateStyle]:
    """Name and style of a contact state."""
    return (CLOSED, CLOSED_STYLE) if stop and state == SLIP else (STATE_NAMES[state], STATE_STYLE[state])


def state_curves(ax: Axes, x: np.ndarray, y: np.ndarray, state: np.ndarray, *, stop: bool = False) -> None:
    """Draw a curve in the styles of its states, one artist for each state that occurs.

    ``state``: from each of the T samples to the next; ``stop``: whether the contact has no friction.
    """
    gapped = [np.append(values, np.nan) for values in (x, y)]
    for number in STATE_STYLE:
        name, style = look_of(number, stop=stop)
        pieces = _pieces(state == number)
        if pieces.size:
            look: dict[str, Any] = {"color": style.colour, "linestyle": style.line, "linewidth": 1.6}
            ax.plot(*(values[pieces] for values in gapped), label=name, **look)


def _pieces(inside: np.ndarray) -> np.ndarray:
    """Positions of the samples of each run of True, with the sample that ends it and -1 for a gap after it."""
    runs = np.flatnonzero(np.diff(inside, prepend=False, append=False)).reshape(-1, 2)
    last = inside.size - 1
    return np.concatenate([np.empty(0, int), *(np.append(np.arange(a, min(b, last) + 1), -1) for a, b in runs)])


def shade(ax: Axes, spans: Iterable[tuple[float, float]], label: str) -> None:
    """Shade the intervals in which a contact is open."""
    for number, span in enumerate(spans):
        ax.axvspan(*span, color="0.87", linewidth=0, zorder=0, label=None if number else label)


def state_bar(
    ax: Axes, row: float, intervals: Iterable[tuple[float, float, int]], height: float = 0.7, *, stop: bool = False
) -> None:
    """Draw intervals, each by its start, end and state, as bars in a row; ``stop`` as for `state_curves`."""
    for start, end, state in intervals:
        name, style = look_of(state, stop=stop)
        bars = ax.broken_barh([(start, end - start)], (row - height / 2, height), facecolor=style.colour, linewidth=0)
        bars.set(edgecolor="white", hatch=style.hatch, label=name)


def labelled(*axs: Axes) -> dict[str, Any]:
    """Everything in some axes that has a label, each label once."""
    handles: dict[str, Any] = {}
    for ax in axs:
        for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(name, handle)
    return handles


def _legend_below(fig: Figure) -> None:
    """One legend for all axes of a figure, the states first."""
    handles = labelled(*fig.axes)
    states = (*STATE_NAMES, CLOSED)
    names = sorted(handles, key=lambda name: states.index(name) if name in states else 9)
    if names:
        place: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 0.16 / fig.get_figheight())}
        fig.legend([handles[name] for name in names], names, ncols=len(names), fontsize=8, **place)


def legend_beside(ax: Axes, handles: Iterable[Any], title: str | None = None) -> None:
    """A legend to the right of the axes, of handles that have their labels."""
    if shown := list(handles):
        place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "borderaxespad": 0.0}
        ax.legend(handles=shown, title=title, title_fontsize=8, fontsize=8, **place)
