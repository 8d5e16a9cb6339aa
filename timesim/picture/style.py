"""How curves look, and how contact states are distinguished.

It is by colour (Okabe and Ito 2008) and, for print and the colour-blind, by the line style of curves and the hatching
of bars.
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


class Series(NamedTuple):
    """How one of several curves is drawn; ``beneath``: wide and pale, so that one that lies on it is seen as well."""

    colour: str
    line: Any
    marker: Any
    beneath: bool = False

    def look(self) -> dict[str, Any]:
        """Keywords of a line."""
        plain = {"color": self.colour, "linestyle": self.line, "marker": self.marker, "linewidth": 1.2}
        if not self.beneath:
            return plain
        from matplotlib.colors import to_hex, to_rgb

        red, green, blue = (0.5 + 0.5 * part for part in to_rgb(self.colour))  # mixed with white
        full = {"markerfacecolor": self.colour, "markeredgecolor": self.colour}
        return plain | full | {"color": to_hex((red, green, blue)), "linewidth": 3.2, "zorder": 1.4}


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
            curve = (values[pieces] for values in gapped)
            ax.plot(*curve, label=name, color=style.colour, linestyle=style.line, linewidth=1.6)


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
