"""Figures: their margins, titles, notes and legends.

They are made without pyplot, which is slow to import and whose global state would keep them in memory.
"""

from collections.abc import Iterable
from textwrap import fill, wrap
from typing import Any

import numpy as np

from timesim.model.model import STATE_NAMES
from timesim.picture.style import CLOSED, Axes, Dataset, DataTree, Figure, short

DPI = 110  # of an image; the width of text, which is measured here, goes by steps with it
LEAST_DECADES = 2.2  # with two powers of ten at least
MANY_DECADES = 2.5  # from which on a logarithmic axis has ticks at powers of ten only
_HEAD, _FOOT = 0.68, 0.95  # inch
_WIDEST = 0.97  # of the figure, a title, or of the room for them, notes
_LEGEND = 32  # letters of a line of the heading of a legend beside the axes
_LABELLED, _PLAIN = 0.27, 0.1  # inch from axes with a label above them, or without one, to the title


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
    fig = Figure(figsize=(width, tall), dpi=DPI)
    FigureCanvasAgg(fig)
    edges = {"left": left / width, "right": 1 - right / width, "top": 1 - _HEAD / tall, "bottom": _FOOT / tall}
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

    The title is that of the scene, and what is shown. It stands over the middle of the axes, as far as it fits there:
    what is beside them may be empty, and is cut off then.
    """
    title = short(" ".join(str(data.attrs.get("title") or "").split()), 90)
    unfinished = "" if int(data.attrs["complete"]) else " (incomplete run)"
    tall, heading = fig.get_figheight(), (f"{title}\n" if title else "") + what + unfinished
    above = max(ax.get_position().y1 for ax in fig.axes)
    top = [ax for ax in fig.axes if ax.get_position().y1 > above - 0.01]
    labels = any(ax.get_title(place) for ax in top for place in ("left", "center", "right"))
    foot = above + (_LABELLED if labels else _PLAIN) / tall
    drawn = fig.suptitle(heading.replace(r"\$", "$"), fontsize=10, y=foot, va="bottom", parse_math=False)
    for _ in range(2):  # small letters are wider than in proportion
        too_wide = drawn.get_window_extent().width / (_WIDEST * fig.bbox.width)
        drawn.set_fontsize(float(drawn.get_fontsize()) / max(too_wide, 1.0))
    places, room = [ax.get_position() for ax in fig.axes], 0.5 - drawn.get_window_extent().width / fig.bbox.width / 2
    middle = (min(place.x0 for place in places) + max(place.x1 for place in places)) / 2
    drawn.set_x(min(max(middle, 0.5 - room), 0.5 + room))
    if all(ax.get_legend() is None for ax in fig.axes):
        _legend_below(fig)
    x, y = (0.99, 0.04) if fig.legends else (max(ax.get_position().x1 for ax in fig.axes), 0.3)
    below = fig.text(x, y / tall, "; ".join(filter(None, notes)), fontsize=7, color="0.35", ha="right", va="bottom")
    if (too_wide := below.get_window_extent().width / (_WIDEST * x * fig.bbox.width)) > 1:
        below.set_text(fill(below.get_text(), int(0.9 * len(below.get_text()) / too_wide)))
        below.set_y(0.04 / tall)
    return fig


def from_zero(ax: Axes) -> None:
    """Begin the ordinate at zero, with some room above what is drawn."""
    top = ax.dataLim.y1
    ax.set_ylim(0, 1.05 * top if 0 < top < np.inf else 1.0)


def over_decades(ax: Axes) -> None:
    """Make the ordinate logarithmic, over two decades at least: below, all of its ticks are labelled, and at length."""
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    wider = max(LEAST_DECADES / np.log10(high / low), 1.0) if high > low > 0 else 1.0
    middle = np.sqrt(low * high)
    ax.set_ylim(middle * (low / middle) ** wider, middle * (high / middle) ** wider)


def plain_ticks(axis: Any, low: float, high: float) -> None:
    """Ticks of a logarithmic axis as plain numbers: below one decade as on a linear one, over many at powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    decades = np.log10(high / low)
    steps = (1.0, 2.0, 5.0) if decades < MANY_DECADES else (1.0,)
    axis.set_major_locator(MaxNLocator(6) if decades < 1 else LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
    axis.set_minor_locator(NullLocator())


def over_cycle(ax: Axes, label: str) -> Axes:
    """Label and limit the abscissa of a cycle, an angle [degree]."""
    ax.set(xlim=(0, 360), xlabel=label)
    ax.set_xticks(range(0, 361, 60))
    return ax


def label_axes(ax: Axes, label: str) -> None:
    """Write above the upper right corner which of several things the axes show."""
    ax.set_title(label, fontsize=9, pad=4, loc="right")


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
        title = title and "\n".join(wrapped(line, _LEGEND, split=True) for line in title.splitlines())
        ax.legend(handles=shown, title=title, title_fontsize=8, fontsize=8, alignment="left", **place)


def wrapped(text: str, letters: int, *, split: bool = False) -> str:
    """The text on lines of so many letters, its unit in one piece; longer words are only ``split`` if that is asked."""
    name, bracket, unit = text.replace(r"\$", "\0").rpartition(" [")
    whole = name + bracket + unit.replace(" ", "\xa0")
    lines = wrap(whole, letters, break_long_words=split, break_on_hyphens=False)
    return "\n".join(lines).replace("\0", r"\$")
