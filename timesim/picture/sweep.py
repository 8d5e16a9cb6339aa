"""Pictures of a sweep: response curves, shares of the contact states, peaks against a scalar, stability.

Each set of values of the further axes has its own colour; up and down differ by line and marker. A line ends where the
motion is known to jump. Filled markers are settled motions; hollow ones are not settled, and a bar spans the amplitudes
of their single cycles. Crosses at the foot are points that failed; points that the run did not reach are not drawn.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from timesim.picture import response as shared
from timesim.picture.choice import MAX_CURVES, left_out, motion, spread
from timesim.picture.figure import axes, finish, from_zero, labelled, legend_beside, stacked
from timesim.picture.response import DIRECTIONS, PAIRED, amplitude_label, axis_label, values_labels
from timesim.picture.style import NEUTRAL, SERIES, Axes, Dataset, Figure, Picture, Series, short
from timesim.result.coordinate import over_keys
from timesim.result.label import counted, told_apart, with_unit

MARKED = 45  # settled points of a curve with a marker; of more points only some are marked
FEW = 3  # least number of values of a scalar for a picture of the peaks
ALIKE = 1e-4  # relative difference of least peaks that one star marks
NO_GAPS = np.empty(0, int)


class DrawnCurve(NamedTuple):
    """One curve over frequency.

    Attributes:
        label: the values of the further axes; empty if there are none.
        where: position along each of these axes and along the direction, for `isel`.
        beside: whether there is a curve of the other direction too. Triangles above and below the points of both are
            told apart where they coincide; of many points each direction marks others.
    """

    label: str
    where: Mapping[str, int]
    direction: str
    style: Series
    beside: bool


def response(data: Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None) -> Axes:
    """Amplitude against frequency, by default of the point and axis with the largest."""
    ax, (point, axis) = axes(ax), motion(data, point, axis)
    for curve in curves(data):
        _draw(ax, data, curve, data.amplitude.sel(point=point, axis=axis).isel(curve.where).values)
        _band(ax, data, curve, point, axis)
        word = "jump" if data.attrs.get("jumps_bisected", 1) else "jump or slope"
        for frequency in shared.steep(data, curve.where):
            ax.axvline(frequency, color=curve.style.colour, linestyle=":", linewidth=1.0, label=word)
    from_zero(ax)
    ax.set(xlabel="frequency [Hz]", ylabel=amplitude_label(data, point, axis))
    return ax


def phase(data: Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None) -> Axes:
    """Phase of the first harmonic against frequency, for motions that repeat."""
    ax, (point, axis), x = axes(ax), motion(data, point, axis), data.frequency.values
    for curve in curves(data):
        y = data.phase_deg.sel(point=point, axis=axis).isel(curve.where).values
        gaps = np.union1d(shared.turns(y), shared.jumps(data, curve.where))
        _curve(ax, x, y, curve, np.zeros(x.size, dtype=bool), "", "_" + curve.label, gaps)
    ax.set_xlabel("frequency [Hz]")
    return shared.over_phase(ax)


def share(data: Dataset, ax: Axes | None = None, *, contact: str | None = None, state: str = "slip") -> Axes:
    """Share of a period that a contact spends in a state, ``slip`` or ``separation``, against frequency."""
    ax = axes(ax)
    contact = contact or str(data.contact.values[0])
    shares = data[f"{state}_share"].sel(contact=contact)
    for curve in curves(data):
        _draw(ax, data, curve, shares.isel(curve.where).values)
    ax.set(xlabel="frequency [Hz]", ylabel=shared.share_label(data, contact, state), ylim=(-0.04, 1.04))
    return ax


def floquet(data: Dataset, ax: Axes | None = None) -> Axes:
    """Largest modulus of the Floquet multipliers against frequency; a motion is stable below 1."""
    ax = axes(ax)
    for curve in curves(data):
        _draw(ax, data, curve, data.floquet_max.isel(curve.where).values)
    ax.axhline(1.0, color="black", linewidth=0.8, label="limit of stability")
    ax.update_datalim([(frequency, 1.0) for frequency in data.frequency.values[[0, -1]]])
    ax.autoscale_view()
    ax.set(xlabel="frequency [Hz]", ylabel="largest Floquet multiplier [1]")
    return ax


def peak(
    data: Dataset, ax: Axes | None = None, *, key: str | None = None, point: str | None = None, axis: str | None = None
) -> Axes:
    """Largest amplitude over the frequencies against a scalar of the scene, by default the one with most values.

    A hollow marker is a maximum at the first or last frequency; the true peak may lie beyond it. A value with missing
    points has no peak. A star marks the least peak of a curve on which no peak is missing.
    """
    ax, (point, axis), key = axes(ax), motion(data, point, axis), key or most_valued(data)
    amplitude, order = data.amplitude.sel(point=point, axis=axis), np.argsort(data[key].values)
    value = data[key].values[order]
    least: dict[tuple[float, float], list[tuple[str, str]]] = {}
    for curve in curves(data, without=key):
        largest, at_end = peaks(amplitude.isel(curve.where).transpose(key, "frequency").values[order])
        direction = curve.direction if data.sizes["direction"] > 1 else ""
        name = ", ".join(filter(None, (curve.label, direction)))
        _curve(ax, value, largest, curve, at_end, "peak at an end of the frequencies", name or "peak")
        if np.isfinite(largest).all():
            low, x = largest.min(), value[np.argmax(largest <= (1 + ALIKE) * largest.min())]
            low = next((y for at, y in least if at == x and np.isclose(y, low, rtol=ALIKE, atol=0.0)), low)
            least.setdefault((x, low), []).append((name, curve.style.colour))
    texts = dict(zip(value, told_apart(value, 4), strict=True))
    for (x, y), of in least.items():
        height, place = with_unit(f"{y:.4g}", data.amplitude.attrs), with_unit(texts[x], data[key].attrs)
        end = ", an end" if x in (value[0], value[-1]) and value.size > 1 else ""
        _star(ax, (x, y), f"{height} at {place}{end}", of)
    from_zero(ax)
    ax.set(xlabel=axis_label(data, key), ylabel=f"peak {amplitude_label(data, point, axis)}")
    return ax


def _star(ax: Axes, at: tuple[float, float], words: str, curves: Sequence[tuple[str, str]]) -> None:
    """The least peak: one star for all curves, given by name and colour, that have it at the same place."""
    names, colours = zip(*curves, strict=True)
    of = {1: ": ", 2: f" of {' and '.join(names)}:\n"}.get(len(names), f" of {len(names)} curves:\n")
    look: dict[str, Any] = {"color": colours[0], "markeredgecolor": "black", "ms": 10, "linestyle": "", "zorder": 4}
    ax.plot(*at, "*", label=f"least{of}{words}", **look)


def peaks(amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest entry of each row, NaN where entries are missing, and whether it is the first or last of several.

    ``amplitude``: over the last axis, the frequencies, shape (N, F); NaN where a point is missing.
    """
    largest, place, last = amplitude.max(axis=1), np.argmax(amplitude, axis=1), amplitude.shape[1] - 1
    return largest, np.isfinite(largest) & (last > 0) & ((place == 0) | (place == last))


def curves(data: Dataset, without: str | None = None) -> list[DrawnCurve]:
    """The curves of a sweep, of at most `MAX_CURVES` sets of values; all values of `without` count as one set."""
    keys = [key for key in over_keys(data) if key != without]
    sets = list(product(*(range(data.sizes[key]) for key in keys)))
    kept, names = spread(len(sets)), [str(name) for name in data.direction.values]
    looks = shared.styles(len(kept), shades=len(names) > 1 and len(kept) > 1)
    drawn, beside = [], len(names) > 1
    labels = values_labels([[data[key].values[i] for key, i in zip(keys, sets[k], strict=True)] for k in kept])
    for look, label, chosen in zip(looks, labels, (sets[k] for k in kept), strict=True):
        for i, name in enumerate(names):
            if beside or not keys:
                colour = look.colour if keys else SERIES[i].colour
                look = shared.one_way(name, colour, DIRECTIONS[name], beside=beside)
            drawn.append(DrawnCurve(label, dict(zip(keys, chosen, strict=True)) | {"direction": i}, name, look, beside))
    return drawn


def most_valued(data: Dataset) -> str:
    """The scalar of the scene with most values."""
    return max(over_keys(data), key=lambda key: data.sizes[key])


def _draw(ax: Axes, data: Dataset, curve: DrawnCurve, y: np.ndarray) -> None:
    """A curve, with hollow markers where it has not settled and crosses at the foot where it failed."""
    frequency, settled = data.frequency.values, data.settled.isel(curve.where).values.astype(bool)
    failed, style = data.failure.isel(curve.where).values != "", curve.style
    gaps = shared.jumps(data, curve.where)
    _curve(ax, frequency, y, curve, ~settled & ~failed, "not settled", "_" + curve.label, gaps)
    shared.several_cycles(ax, data, curve.where, y)
    if failed.any():
        foot: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "clip_on": False, "linestyle": "", "zorder": 4}
        ax.plot(frequency[failed], np.full(failed.sum(), 0.015), "x", color=style.colour, ms=6, label="failed", **foot)


def _band(ax: Axes, data: Dataset, curve: DrawnCurve, point: str, axis: str) -> None:
    """The range of amplitudes over single cycles of motions that have not settled."""
    if "amplitude_band" not in data:
        return
    low, high = data.amplitude_band.sel(point=point, axis=axis).isel(curve.where).transpose("band", ...).values
    loose = (data.settled.isel(curve.where).values == 0) & np.isfinite(low)
    if loose.any():
        look: dict[str, Any] = {"color": curve.style.colour, "linewidth": 3.0, "alpha": 0.45}
        ax.vlines(data.frequency.values[loose], low[loose], high[loose], **look)
        ax.plot([], [], label="range over single cycles", **look)


def _curve(
    ax: Axes,
    x: np.ndarray,
    y: np.ndarray,
    curve: DrawnCurve,
    hollow: np.ndarray,
    meaning: str,
    label: str,
    gaps: np.ndarray = NO_GAPS,
) -> None:
    """A curve with filled markers at some of its points, and hollow ones at all points that have a given meaning.

    ``gaps``: positions before which its line is broken.
    """
    style, every = curve.style, max(1, -(-x.size // MARKED))
    paired = {marker: PAIRED[direction] for direction, marker in DIRECTIONS.items()}.get(style.marker, style.marker)
    first = every // 2 if curve.beside and curve.direction == "down" else 0
    filled = np.insert(~hollow & (np.arange(x.size) % every == first), gaps, False)
    look = style._replace(marker=paired if curve.beside and every == 1 else style.marker).look()
    ax.plot(*shared.broken(x, y, gaps), label=label, ms=3.5, markevery=np.flatnonzero(filled).tolist(), **look)
    hollow = hollow & np.isfinite(y)
    if hollow.any():
        ax.plot(x[hollow], y[hollow], label=meaning, ms=6, color=style.colour, fillstyle="none", marker=paired, ls="")


def legend(axs: Sequence[Axes], data: Dataset) -> None:
    """A legend beside the first axes: colours of the values, markers of the directions, and what other marks mean."""
    entries: dict[str, Series] = {}
    several, keys, shown = data.sizes["direction"] > 1, over_keys(data), curves(data)
    for curve in shown:
        style = Series(curve.style.colour, "-", "") if keys and several else curve.style
        entries.setdefault(curve.label or curve.direction, style)
    if not keys and not several and shown[0].direction == "independent":
        entries.clear()  # a single curve, whose axes say what it is
    if keys and several:
        ways = shown[: data.sizes["direction"]]
        entries |= {curve.direction: curve.style._replace(colour=NEUTRAL) for curve in ways}
    shared.legend(axs, entries, shared.legend_title(data, keys))


def _hidden(data: Dataset) -> str:
    """A note of the sets of values that are not shown, and of settled points without a marker."""
    sets, every = int(np.prod([data.sizes[key] for key in over_keys(data)])), -(-data.sizes["frequency"] // MARKED)
    others = ", up and down at different ones" if data.sizes["direction"] > 1 else ""
    thinned = f"markers at one point in {every}{others}" if every > 1 else ""
    return "; ".join(filter(None, (left_out(sets, MAX_CURVES, "sets of values"), thinned)))


def _floquet_figure(data: Dataset) -> Figure | None:
    if not np.isfinite(data.floquet_max.values).any():
        return None
    fig, axs = stacked(1, 3.0)
    floquet(data, axs[0])
    legend(axs, data)
    return finish(fig, data, "stability", _hidden(data))


def _peak_figure(data: Dataset) -> Figure | None:
    keys = [key for key in over_keys(data) if data.sizes[key] >= FEW]
    whole = np.isfinite(data.amplitude.values).all(axis=(-2, -1)).all(axis=-1)
    if not keys or not whole.any():
        return None
    fig, axs = stacked(len(keys), 3.0, share_x=False)
    for ax, key in zip(axs, keys, strict=True):
        others = [other for other in over_keys(data) if other != key]
        legend_beside(ax, labelled(peak(data, ax, key=key)).values(), shared.legend_title(data, others))
    point, axis = motion(data, None, None)
    missing = "" if whole.all() else f"{counted(np.sum(~whole), 'peak')} not shown: points are missing"
    return finish(fig, data, f"peak over the frequencies of {short(point, 16)} {axis}, which moves most", missing)


_SHARED: dict[str, Any] = {"legend": legend, "hidden": _hidden}
PICTURES: dict[str, Picture] = {
    "response": partial(shared.response_figure, what="response", response=response, phase=phase, **_SHARED),
    "peak": _peak_figure,
    "contact_states": partial(shared.states_figure, share=share, **_SHARED),
    "stability": _floquet_figure,
}
