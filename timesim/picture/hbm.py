"""Pictures of response curves by harmonic balance.

A curve has a colour for each set of values of the further axes; it is solid where it is stable and dashed where not,
and a diamond marks each fold.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from timesim.picture import response as shared
from timesim.picture.choice import MAX_CURVES, left_out, motion, spread
from timesim.picture.figure import axes, finish, from_zero, stacked
from timesim.picture.response import amplitude_label, axis_label, draw_branch, values_labels
from timesim.picture.style import Axes, Dataset, Figure, Picture, Series, short, unit
from timesim.result.coordinate import over_keys

NOISE = 1e-9
"""Share of the largest harmonic below which one is rounding, or what is left of settling."""


class DrawnFamily(NamedTuple):
    """The curves of one set of values: the values, the same as text, the rows of each curve, and their style."""

    values: tuple[float, ...]
    label: str
    rows: list[np.ndarray]
    style: Series


def response(data: Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None) -> Axes:
    """Amplitude along the curves, by default of the point and axis with the largest."""
    ax, (point, axis) = axes(ax), motion(data, point, axis)
    _draw(ax, data, data.amplitude.sel(point=point, axis=axis).values)
    from_zero(ax)
    ax.set_ylabel(amplitude_label(data, point, axis))
    return ax


def phase(data: Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None) -> Axes:
    """Phase of the first harmonic along the curves."""
    ax, (point, axis) = axes(ax), motion(data, point, axis)
    _draw(ax, data, data.phase_deg.sel(point=point, axis=axis).values, phase=True)
    return shared.over_phase(ax)


def share(data: Dataset, ax: Axes | None = None, *, contact: str | None = None, state: str = "slip") -> Axes:
    """Share of a period that a contact spends in a state, ``slip`` or ``separation``, along the curves."""
    ax = axes(ax)
    contact = contact or str(data.contact.values[0])
    _draw(ax, data, data[f"{state}_share"].sel(contact=contact).values)
    ax.set(ylabel=shared.share_label(data, contact, state), ylim=(-0.04, 1.04))
    return ax


def _draw(ax: Axes, data: Dataset, y: np.ndarray, *, phase: bool = False) -> None:
    """A quantity along all curves, against the parameter of the continuation; ``phase`` as in `draw_branch`."""
    name = str(data.attrs.get("along", "frequency"))
    x, stable, fold = data[name].values, data.stable.values > 0, data.fold.values > 0
    for family in families(data):
        for rows in family.rows:
            draw_branch(ax, x[rows], y[rows], stable[rows], fold[rows], colour=family.style.colour, phase=phase)
    ax.set_xlabel(axis_label(data, name))


def harmonics(data: Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None) -> Axes:
    """Harmonics at the largest amplitude of each set of values, on a logarithmic axis; harmonic 0 is the mean."""
    ax, (point, axis) = axes(ax), motion(data, point, axis)
    amplitude = data.amplitude.sel(point=point, axis=axis).values
    content, lowest = np.abs(data.harmonic_amplitude.sel(point=point, axis=axis).values), np.inf
    for family in families(data):
        rows = np.concatenate([np.zeros(0, int), *family.rows])
        if rows.size:
            height = content[rows[np.argmax(amplitude[rows])]]
            lowest = min(lowest, float(np.min(height[height > 0], initial=np.inf)))
            known, style = np.where(height > NOISE * height.max(), height, np.nan), family.style
            ax.plot(data.harmonic.values, known, marker=style.marker, color=style.colour, linewidth=0.6, ms=4)
    ax.set(xlabel="harmonic", ylabel=f"harmonic of {short(point, 16)} {axis}{unit(data, 'harmonic_amplitude')}")
    return over_harmonics(ax, data, lowest, float(content.max(initial=0.0)))


def over_harmonics(ax: Axes, data: Dataset, lowest: float, largest: float) -> Axes:
    """Limit the axes to all harmonics of a result, and to those between two sizes that are not rounding."""
    ax.set_xlim(-0.5, data.harmonic.values[-1] + 0.5)
    ax.locator_params(axis="x", integer=True)
    ax.set_yscale("log")
    top = largest or 1.0
    ax.set_ylim(max(top * NOISE, min(lowest, top) / 2), 2 * top)
    return ax


def families(data: Dataset) -> list[DrawnFamily]:
    """The curves of each set of values, of at most `MAX_CURVES` evenly spaced sets."""
    values, curve, every = _values(data), data.curve.values, sets(data)
    kept = [every[i] for i in spread(len(every))]
    drawn = []
    looks = shared.styles(len(kept), shades=len(kept) > 1)  # since lines tell stable parts from unstable ones
    for look, label, chosen in zip(looks, values_labels(kept), kept, strict=True):
        inside = np.all(values == np.array(chosen), axis=1)
        rows = [np.flatnonzero(inside & (curve == number)) for number in np.unique(curve[inside])]
        drawn.append(DrawnFamily(chosen, label, rows, look))
    return drawn


def _values(data: Dataset) -> np.ndarray:
    """Values of the further axes of each solution, shape (N, K)."""
    keys = over_keys(data)
    return np.stack([data[key].values for key in keys], axis=1) if keys else np.zeros((data.sizes["solution"], 0))


def sets(data: Dataset) -> list[tuple[float, ...]]:
    """The sets of values of the further axes that have a curve."""
    return list(dict.fromkeys(map(tuple, _values(data).tolist())))


def legend(axs: Sequence[Axes], data: Dataset, *, markers: bool = False, lines: str = "") -> None:
    """A legend to the right of the first axes: the colours of the values, and what lines and marks mean."""
    drawn = [(family.label, family.style) for family in families(data) if family.label]
    entries = {label: style._replace(line="-", marker=style.marker if markers else "") for label, style in drawn}
    shared.legend(axs, entries, shared.legend_title(data, over_keys(data)), lines=lines)


def hidden(data: Dataset) -> str:
    """A note of how many sets of values are not shown."""
    return left_out(len(sets(data)), MAX_CURVES, "sets of values")


def _harmonics_figure(data: Dataset) -> Figure:
    fig, axs = stacked(1, 3.4)
    harmonics(data, axs[0])
    legend(axs, data, markers=True)
    return finish(fig, data, "harmonic content at the largest response", hidden(data))


def _response_figure(data: Dataset) -> Figure:
    own = f" at {data.frequency.values[0]:.6g} Hz" if "along" in data.attrs else ""
    what = f"response by harmonic balance{own}"
    return shared.response_figure(data, what=what, response=response, phase=phase, **_SHARED)


_SHARED: dict[str, Any] = {"legend": legend, "hidden": hidden}
PICTURES: dict[str, Picture] = {
    "response": _response_figure,
    "harmonics": _harmonics_figure,
    "contact_states": partial(shared.states_figure, share=share, **_SHARED),
}
