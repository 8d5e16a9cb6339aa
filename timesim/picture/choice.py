"""What a picture shows if there is too much for it: what moves or rubs most, or an even selection of values."""

from collections.abc import Sequence

import numpy as np
from xarray import Dataset

from timesim.result.coordinate import ALIKE

MAX_ROWS = 3  # points or contacts, one above the other
MAX_CURVES = 12  # sets of values of the further axes
STILL = 1e-9  # share of the largest motion below which something does not move


def motions(data: Dataset, size: np.ndarray) -> list[tuple[str, str]]:
    """Points and axes that move, the largest motion first; the first of all if nothing moves.

    ``size``: of the motion of each, shape (P, 3).
    """
    # Bodies that are equal, and move alike, come in the order of the scene.
    order = np.argsort(-np.round(size / max(ALIKE * size.max(), 1e-300)), axis=None, kind="stable")
    kept = [place for place in order if size.flat[place] > STILL * size.max()] or [0]
    rows, columns = np.unravel_index(kept, size.shape)
    return [(str(data.point.values[i]), str(data.axis.values[j])) for i, j in zip(rows, columns, strict=True)]


def responses(data: Dataset) -> list[tuple[str, str]]:
    """Points and axes with an amplitude, the largest first."""
    values = data["amplitude"].transpose(..., "point", "axis").values
    size = np.where(np.isfinite(values), values, 0.0).reshape(-1, *values.shape[-2:]).max(axis=0, initial=0.0)
    return motions(data, size)


def main_axes(data: Dataset) -> dict[str, str]:
    """Points with an amplitude, the largest first, and the axis along which each has its largest."""
    axes: dict[str, str] = {}
    for point, axis in responses(data):
        axes.setdefault(point, axis)
    return axes


def motion(data: Dataset, point: str | None, axis: str | None) -> tuple[str, str]:
    """The point and axis that are asked for, by default those of the largest amplitude."""
    return asked(responses(data), point, axis)


def asked(moving: Sequence[tuple[str, str]], point: str | None, axis: str | None) -> tuple[str, str]:
    """The first of some points and axes at the point, or along the axis, that is asked for."""
    fitting = (own for own in moving if point in (None, own[0]) and axis in (None, own[1]))
    return next(fitting, (point or moving[0][0], axis or moving[0][1]))


def busiest(data: Dataset, *activity: np.ndarray, limit: int = MAX_ROWS) -> list[str]:
    """At most `limit` contacts, the most active by the first measure, ties decided by the next, in the scene's order.

    ``activity``: of each contact, shape (C,).
    """
    best = np.lexsort([-measure for measure in reversed(activity)])[:limit]
    return [str(data.contact.values[i]) for i in np.sort(best)]


def spread(number: int) -> list[int]:
    """Positions of the curves that are shown: all, or `MAX_CURVES` evenly spaced ones with both ends."""
    return sorted({round(i) for i in np.linspace(0, number - 1, min(number, MAX_CURVES))})


def left_out(number: int, shown: int, what: str, which: str = "") -> str:
    """A note of how many things are not shown, and which; empty if all are shown."""
    note = f"{number - shown} of {number} {what} not shown" + (f" ({which})" if which else "")
    return note if number > shown else ""
