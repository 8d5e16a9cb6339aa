"""What pictures of responses share: names of the further axes, styles of many curves, stable parts, legends, figures.

The further axes of a response are scalars of the scene, named by their key (``contacts.pad.preload``). In a sweep they
are dimensions of the amplitudes; in a harmonic balance each solution has a value of each.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np

from timesim.picture.choice import MAX_ROWS, busiest, left_out, main_axes
from timesim.picture.figure import finish, label_axes, labelled, legend_beside, stacked
from timesim.picture.style import NEUTRAL, SERIES, Axes, Dataset, Figure, Series, is_stop, short, unit
from timesim.result.coordinate import rubs
from timesim.result.label import EVERY, is_scalar_key, told_apart

DIRECTIONS = {"up": "^", "down": "v", "independent": "o"}
PAIRED: dict[str, Any] = {"up": 10, "down": 11, "independent": "o"}
"""Triangles above and below the point, CARETUPBASE and CARETDOWNBASE, which do not cover each other."""
LINES: dict[str, Any] = {"up": "-", "down": (0, (2.5, 1.5)), "independent": "-"}
DASHES = (0, (4, 2))
HALF_TURN = 180.0  # degrees
ROUNDING = 1e-6  # of a quarter turn
PHASE_HEIGHT = 1.4  # inch
MARKERS = "os<>pXPhdH"  # without the diamond, which is a fold


def key_words(key: str) -> str:
    """A scalar's key as words, without the section: ``pad tangential stiffness``; dollars in it make no formula."""
    *names, scalar = (part for part in key.split(".")[1:] if part != EVERY)
    return " ".join([*names, scalar.replace("_", " ")]).replace("$", r"\$")


def axis_label(data: Dataset, name: str) -> str:
    """A variable or a scalar of the scene, with its unit."""
    return (key_words(name) if is_scalar_key(name) else name) + unit(data, name)


def amplitude_label(data: Dataset, point: str, axis: str, name: str = "amplitude") -> str:
    """The amplitude of a point along an axis, with its unit."""
    return f"amplitude of {short(point, 16)} {axis}{unit(data, name)}"


def over_phase(ax: Axes) -> Axes:
    """Label and limit the axes of a phase, at quarters of a turn."""
    low, high = (ax.dataLim.y0, ax.dataLim.y1) if np.isfinite(ax.dataLim.y1) else (-1.0, 0.0)
    first = int(np.floor(low / 90 + ROUNDING))
    last = max(int(np.ceil(high / 90 - ROUNDING)), first + 1)
    ax.set(ylabel="phase [degree]", ylim=(90 * first - 10, 90 * last + 10))
    ax.set_yticks(range(90 * first, 90 * last + 1, 90))
    return ax


def turns(phase: np.ndarray) -> np.ndarray:
    """Positions before which a phase in (-180, 180] has wrapped around, where no line is to be drawn."""
    return np.flatnonzero(np.abs(np.diff(phase)) > HALF_TURN) + 1


def steep(data: Dataset, where: Mapping[str, int]) -> np.ndarray:
    """Frequencies [Hz] at which a sweep jumps, or where jumps were not bisected at which it may as well be steep."""
    if "jump_low" not in data:
        return np.empty(0)
    ends = [data[name].isel(where, missing_dims="ignore").values.ravel() for name in ("jump_low", "jump_high")]
    middle = 0.5 * (ends[0] + ends[1])
    return middle[np.isfinite(middle)]


def jumps(data: Dataset, where: Mapping[str, int]) -> np.ndarray:
    """Positions before which a sweep is known to have jumped to another motion, where no line is to be drawn."""
    known = steep(data, where) if data.attrs.get("jumps_bisected", 1) else np.empty(0)
    place = np.unique(np.searchsorted(data.frequency.values, known))
    return place[(place > 0) & (place < data.sizes["frequency"])]


def broken(x: np.ndarray, y: np.ndarray, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve with a gap before each of some positions."""
    return np.insert(x, gaps, np.nan), np.insert(y, gaps, np.nan)


def one_way(direction: str, colour: str, marker: Any, *, beside: bool) -> Series:
    """How the sweep in a direction is drawn.

    ``beside``: whether there is one of the other direction too. Then up is wide and pale, and down dashed on top of it:
    where both coincide, both are seen, in print without colours too.
    """
    return Series(colour, LINES[direction], marker, beside and direction == "up")


def has_phase(data: Dataset) -> bool:
    """Whether any phase is known: of a motion that repeats, and has a first harmonic where that is excited."""
    return "phase_deg" in data and bool(np.isfinite(data["phase_deg"].values).any())


def with_phase(rows: int, height: float, phase: bool) -> tuple[Figure, list[Axes]]:
    """Axes of a height [inch] one above the other, each with axes for the phase below it if ``phase``."""
    if not phase:
        return stacked(rows, height)
    return stacked(2 * rows, (height + PHASE_HEIGHT) / 2, height_ratios=[height, PHASE_HEIGHT] * rows)


def share_label(data: Dataset, contact: str, state: str) -> str:
    """Label of the share of a period in a state; a contact without friction is closed where another slips."""
    return "share closed [1]" if state == "slip" and is_stop(data, contact) else f"share in {state} [1]"


def values_labels(sets: Sequence[Sequence[float]]) -> list[str]:
    """Sets of values of the further axes, each as text of its own; `legend_title` names the axes in the same order."""
    columns = [told_apart(values) for values in zip(*sets, strict=True)]
    return [", ".join(texts) for texts in zip(*columns, strict=True)] if columns else [""] * len(sets)


def legend_title(data: Dataset, keys: Sequence[str]) -> str | None:
    """The further axes in the order of the values in a legend; None if there are none."""
    return ",\n".join(axis_label(data, key) for key in keys) or None


def styles(count: int, *, shades: bool = False) -> list[Series]:
    """Styles of a number of curves: different hues if they are few, else shades from dark to light.

    ``shades``: in any case, as shades and lines differ in print where markers already mean something else.
    """
    if count <= len(SERIES) and not shades:
        return [style._replace(marker=marker) for style, marker in zip(SERIES[:count], MARKERS, strict=False)]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    colours = [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.86, count))]
    lines = [style.line for style in SERIES]
    return [Series(c, lines[i % len(lines)], MARKERS[i % len(MARKERS)]) for i, c in enumerate(colours)]


def stable_parts(stable: np.ndarray, fold: np.ndarray) -> list[tuple[slice, bool]]:
    """Stable and unstable parts of a curve of N solutions, each with those at its ends; a fold belongs to both."""
    firm = stable.copy()
    for i in np.flatnonzero(fold).tolist():
        firm[i] = firm[i - 1] if i else firm[min(i + 1, firm.size - 1)]
    edges: list[int] = [0, *(np.flatnonzero(firm[1:] != firm[:-1]) + 1).tolist(), firm.size]
    return [(slice(max(a - 1, 0), b), bool(firm[a])) for a, b in pairwise(edges) if b > a]


def draw_branch(
    ax: Axes,
    x: np.ndarray,
    y: np.ndarray,
    stable: np.ndarray,
    fold: np.ndarray,
    *,
    colour: str,
    stable_label: str = "stable",
    widths: tuple[float, float] = (1.4, 1.1),
    zorder: float = 2.0,
    phase: bool = False,
) -> None:
    """A curve of solutions: solid where they are stable, dashed where not, a diamond at each fold.

    Args:
        x, y, stable, fold: the curve and its solutions, shape (N,).
        colour, zorder: of its lines; its folds lie above all lines.
        stable_label: what a legend says of its stable parts.
        widths: of its lines where it is stable and where not [point].
        phase: y is a phase [degree], with a gap where it wraps around.
    """
    if phase:
        breaks = turns(y)
        x, y = broken(x, y, breaks)
        stable, fold = np.insert(stable, breaks, stable[breaks]), np.insert(fold, breaks, False)
    solid: dict[str, Any] = {"linestyle": "-", "linewidth": widths[0], "label": stable_label}
    dashed: dict[str, Any] = {"linestyle": DASHES, "linewidth": widths[1], "label": "unstable"}
    for part, firm in stable_parts(stable, fold):
        ax.plot(x[part], y[part], color=colour, zorder=zorder, **(solid if firm else dashed))
    if fold.any():
        ax.plot(x[fold], y[fold], "D", color=colour, label="fold", markeredgecolor="black", ms=4.5, zorder=4, ls="")


def several_cycles(ax: Axes, data: Dataset, where: Mapping[str, int], y: np.ndarray) -> None:
    """Rings around the points of a sweep whose motion repeats after several cycles only, where they are shown."""
    longer = (data.settled.isel(where).values > 0) & (data.period.isel(where).values > 1) & np.isfinite(y)
    if longer.any():
        ring: dict[str, Any] = {"color": "black", "fillstyle": "none", "ms": 8, "linestyle": ""}
        ax.plot(data.frequency.values[longer], y[longer], "s", label="period of several cycles", **ring)


def legend(axs: Iterable[Axes], entries: Mapping[str, Series], title: str | None = None, *, lines: str = "") -> None:
    """A legend to the right of the first axes: the styles of the curves, and in grey whatever else has a label.

    Curves that are stable throughout do not say so, but what ``lines`` are.
    """
    first, *others = axs
    if "unstable" not in labelled(first, *others):
        for line in (line for ax in (first, *others) for line in ax.get_lines() if line.get_label() == "stable"):
            line.set_label(lines or "_stable")
    meanings = handles({name: Series(NEUTRAL, "-", "") for name in labelled(first, *others)})
    for handle, (name, drawn) in zip(meanings, labelled(first, *others).items(), strict=True):
        handle.update_from(drawn)
        handle.set(color=NEUTRAL, label=name, markersize=min(drawn.get_markersize(), 7))
    legend_beside(first, [*handles(entries), *meanings], title)


def handles(entries: Mapping[str, Series]) -> list[Any]:
    """Lines of a legend by their names."""
    from matplotlib.lines import Line2D

    return [Line2D([], [], **style.look(), ms=5, label=name) for name, style in entries.items()]


Legend = Callable[[Sequence[Axes], Dataset], None]


def response_figure(
    data: Dataset,
    *,
    what: str,
    response: Callable[..., Axes],
    phase: Callable[..., Axes],
    legend: Legend,
    hidden: Callable[[Dataset], str],
) -> Figure:
    """The response of each point along its axis of largest amplitude, one above the other, its phase below it."""
    points = list(main_axes(data))
    rows = min(len(points), MAX_ROWS)
    drawn = (response, phase) if has_phase(data) else (response,)
    fig, axs = with_phase(rows, 4.0 if rows == 1 else 2.4, len(drawn) > 1)
    for ax, (point, draw) in zip(axs, product(points, drawn), strict=False):
        draw(data, ax, point=point).label_outer()
    legend(axs, data)
    note = left_out(len(points), rows, "points")
    return finish(fig, data, f"{what}, each point along its axis of largest amplitude", note, hidden(data))


def states_figure(
    data: Dataset, *, share: Callable[..., Axes], legend: Legend, hidden: Callable[[Dataset], str]
) -> Figure | None:
    """The shares of slip and separation of each contact, one above the other; a note names those that are zero.

    A stop without friction has no slip: it is closed when it is not apart.
    """
    shares = data.slip_share * rubs(data) + data.separation_share
    contacts = busiest(data, shares.sum([dim for dim in shares.dims if dim != "contact"]).values)
    if not contacts:
        return None
    states = {contact: ("separation",) if is_stop(data, contact) else ("slip", "separation") for contact in contacts}
    pairs = [(contact, state) for contact in contacts for state in states[contact]]
    occurring = [pair for pair in pairs if data[f"{pair[1]}_share"].sel(contact=pair[0]).values.any()]  # NaN too
    shown = occurring or pairs[:1]
    fig, axs = stacked(len(shown), 1.9 if len(shown) < 3 else 1.5)
    for ax, (contact, state) in zip(axs, shown, strict=True):
        label_axes(share(data, ax, contact=contact, state=state), short(contact))
        ax.label_outer()
    legend(axs, data)
    never = [f"share in {state} of {short(contact)}" for contact, state in pairs if (contact, state) not in occurring]
    zero = f"zero throughout: {', '.join(never)}" if never else ""
    note = left_out(data.sizes["contact"], len(contacts), "contacts")
    words = " and ".join(f"in {state}" for state in ("slip", "separation") if state in {state for _, state in pairs})
    return finish(fig, data, f"shares of a period {words}", zero, note, hidden(data))
