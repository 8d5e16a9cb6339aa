"""Pictures of the contacts over the last cycles of a transient or a jump: motion, friction, normal load, states."""

from collections.abc import Callable, Sequence

import numpy as np

from timesim.model.model import SEPARATION
from timesim.picture import choice
from timesim.picture.choice import MAX_ROWS, left_out
from timesim.picture.figure import axes, figure, finish, label_axes
from timesim.picture.style import (
    BLUE,
    PALE,
    VERMILION,
    Axes,
    Dataset,
    Figure,
    Picture,
    is_stop,
    shade,
    short,
    state_bar,
    state_curves,
    unit,
)
from timesim.result.coordinate import rubs

LAST_CYCLES = 3
MAX_BARS = 12
CLOSE = 0.02  # share of the size of a path: what is nearer cannot be told apart


def orbit(data: Dataset, ax: Axes | None = None, *, contact: str | None = None) -> Axes:
    """Relative motion of a contact in its plane over the last cycles, the last coloured by state."""
    ax, contact, part, last = axes(ax), *_shown(data, contact)
    u = part.contact_displacement.values[:, :2]
    ax.plot(u[:, 0], u[:, 1], color=PALE, linewidth=0.8, label=_if_seen("cycles before", u, u[last]))
    state = part.contact_state.values[last]
    w = np.where(state[:, None] == SEPARATION, np.nan, part.slip.values[last])
    _slider(ax, w, u[last])
    state_curves(ax, u[last, 0], u[last, 1], state, stop=is_stop(data, contact))
    ax.set(xlabel=f"u1{unit(data, 'contact_displacement')}", ylabel=f"u2{unit(data, 'contact_displacement')}")
    label_axes(ax, short(contact))
    ax.set_aspect("equal", adjustable="datalim")
    return ax


def _shown(data: Dataset, contact: str | None) -> tuple[str, Dataset, slice]:
    """A contact, by default the one that dissipates most, its last cycles, and the samples of the very last one."""
    contact = contact or busiest(data, 1)[0]
    part = data.isel(time=last_cycles(data)).sel(contact=contact)
    return contact, part, last_cycles(part, 1)


def _slider(ax: Axes, w: np.ndarray, u: np.ndarray) -> None:
    """The slider's path, a dot if it stays in place, nothing if the contact is open all the time."""
    known = w[~np.isnan(w).any(axis=1)]
    if not known.size:
        return
    stays = np.ptp(known, axis=0).max() <= CLOSE * np.ptp(u, axis=0).max()
    if stays:
        ax.plot(*known[:1].T, "o", ms=3, color="black", zorder=4, label="slider w")
    else:
        ax.plot(w[:, 0], w[:, 1], color="black", linewidth=0.7, label=_if_seen("slider w", known, u))


def _if_seen(label: str, path: np.ndarray, above: np.ndarray) -> str:
    """The label of a path, hidden from legends if another path covers all of it."""
    size = np.maximum(np.ptp(path, axis=0), np.ptp(above, axis=0))
    scale = np.where(size > 0, size, 1.0)
    few, all_above = (part[:: 1 + len(part) // 500] / scale for part in (path, above))
    apart = np.linalg.norm(few[:, None] - all_above, axis=-1).min(axis=1)
    return label if apart.max() > CLOSE else f"_{label}"


def hysteresis(data: Dataset, ax: Axes | None = None, *, contact: str | None = None, tangent: str = "t1") -> Axes:
    """Friction force against relative displacement over the last cycles, the last coloured by state."""
    ax, contact, part, last = axes(ax), *_shown(data, contact)
    u, f = (part[name].sel(component=tangent).values for name in ("contact_displacement", "contact_force"))
    loop = np.stack([u, f], axis=1)
    ax.plot(u, f, color=PALE, linewidth=0.8, label=_if_seen("cycles before", loop, loop[last]))
    state_curves(ax, u[last], f[last], part.contact_state.values[last], stop=is_stop(data, contact))
    number = tangent.removeprefix("t")
    length, force = unit(data, "contact_displacement"), unit(data, "contact_force")
    ax.set(xlabel=f"u{number}{length}", ylabel=f"f{number}{force}")
    label_axes(ax, f"{short(contact)}, {tangent}")
    return ax


def normal_load(data: Dataset, ax: Axes | None = None, *, contact: str | None = None) -> Axes:
    """Normal load, friction force and its limit over the last cycles, separations shaded; for a stop only the load."""
    ax, contact, part, _ = axes(ax), *_shown(data, contact)
    time, force = part.time.values, part.contact_force.values
    stays = intervals(data, contact, time[0], time[-1])
    shade(ax, ((start, end) for start, end, state in stays if state == SEPARATION), "separation")
    ax.axhline(0.0, color="black", linewidth=0.8, label="n = 0")
    ax.plot(time, force[:, 2], color=BLUE, linewidth=1.4, label="normal load n")
    stop = is_stop(data, contact)
    if not stop:
        if "friction" in part.coords:
            limit = float(part.friction) * force[:, 2]
            ax.plot(time, limit, color="black", linestyle=(0, (1, 1.5)), linewidth=1.2, label="limit of the cone μn")
        tangential = np.hypot(force[:, 0], force[:, 1])
        ax.plot(time, tangential, color=VERMILION, linestyle="--", linewidth=1.0, label="friction force |f|")
    if not force.any():  # matplotlib would scale rounding of 1e-17 to the height of the axes
        ax.set_ylim(-0.05, 1.0)
    what = "n" if stop else "n, μn, |f|"
    ax.set(xlabel="time [s]", ylabel=what + unit(data, "contact_force"), xlim=(time[0], time[-1]))
    label_axes(ax, short(contact))
    return ax


def contact_states(data: Dataset, ax: Axes | None = None, *, contacts: Sequence[str] | None = None) -> Axes:
    """State of contacts over the last cycles, as bars between the times of the event log."""
    ax, contacts = axes(ax), contacts or busiest(data, MAX_BARS)
    time = data.time.values[last_cycles(data)]
    for row, contact in enumerate(contacts):
        state_bar(ax, row, intervals(data, contact, time[0], time[-1]), stop=is_stop(data, contact))
    starts = data.cycle_start.values
    inside = starts[(starts > time[0]) & (starts < time[-1])]
    for start in inside:
        ax.axvline(start, color="black", linewidth=0.8, linestyle=":")
    rows = len(contacts)
    dotted = ", dotted: start of a cycle" if inside.size else ""
    ax.set(xlabel=f"time [s]{dotted}", xlim=(time[0], time[-1]), ylim=(rows - 0.4, -0.6))
    ax.set_yticks(range(rows), [short(name) for name in contacts])
    ax.grid(False)
    return ax


def busiest(data: Dataset, limit: int, *, rubbing: bool = False) -> list[str]:
    """At most `limit` contacts, those with most friction energy and transitions, in the scene's order.

    ``rubbing``: among those that have friction.
    """
    events = np.bincount(data.event_contact.values.astype(int), minlength=data.sizes["contact"])
    among = np.flatnonzero(rubs(data).values if rubbing else np.ones(events.size, bool))
    activity = data.energy_friction.values.sum(axis=0)[among], events[among]
    return choice.busiest(data[["contact"]].isel(contact=among), *activity, limit=limit)


def last_cycles(data: Dataset, cycles: int = LAST_CYCLES) -> slice:
    """Samples of the last whole cycles that were recorded; all samples where no cycle was finished."""
    start, period = recorded_cycles(data)
    if not start.size:
        return slice(None)
    first = start[-min(cycles, start.size)] - 1e-6 * period[-1]
    return slice(int(np.searchsorted(data.time.values, first)), None)


def recorded_cycles(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Start and period [s] of the cycles up to the last sample: of a part of a result that may be before the end."""
    start, period = data.cycle_start.values, data.cycle_period.values
    whole = start + period < data.time.values.max(initial=-np.inf) + 1e-6 * period
    return start[whole], period[whole]


def intervals(data: Dataset, contact: str, start: float, end: float) -> list[tuple[float, float, int]]:
    """Start, end [s] and state of each interval of a contact within a window, from the event log."""
    index = data.contact.values.tolist().index(contact)
    mine = np.flatnonzero(data.event_contact.values == index)
    before = data.event_from.values[mine[0]] if mine.size else data.contact_state.values[0, index]
    states = [int(before), *data.event_to.values[mine].tolist()]
    times = np.clip([start, *data.event_time.values[mine], end], start, end).tolist()
    return [item for item in zip(times[:-1], times[1:], states, strict=True) if item[1] > item[0]]


def _orbit_figure(data: Dataset, contacts: Sequence[str]) -> Figure | None:
    """Contacts that move along both axes of their plane; the others move to and fro on one of them, or not at all."""
    u = data.contact_displacement.isel(time=last_cycles(data))
    moved = [contact for contact in contacts if np.ptp(u.sel(contact=contact).values[:, :2], axis=0).all()]
    if not moved:
        return None
    fig, grid = figure(1, len(moved), width=1.1 + 3.8 * len(moved), height=3.2)
    for ax, contact in zip(grid[0], moved, strict=True):
        orbit(data, ax, contact=contact)
    return fig


def _hysteresis_figure(data: Dataset, contacts: Sequence[str]) -> Figure | None:
    rubbed = {contact: tangents for contact in contacts if (tangents := _tangents(data, contact))}
    if not rubbed:
        u = data.contact_displacement.isel(time=last_cycles(data)).sel(contact=contacts[0]).values
        if not np.ptp(u, axis=0).any():  # a run in which nothing moves
            return None
        rubbed = {contacts[0]: ["t1"]}
    columns = max(map(len, rubbed.values()))
    fig, grid = figure(len(rubbed), columns, width=7.5 + 0.5 * columns, height=2.2, gap=0.7)
    for row, (contact, tangents) in zip(grid, rubbed.items(), strict=True):
        for ax, tangent in zip(row, tangents, strict=False):
            hysteresis(data, ax, contact=contact, tangent=tangent)
        for ax in row[len(tangents) :]:
            ax.remove()
    return fig


def _tangents(data: Dataset, contact: str) -> list[str]:
    """In-plane axes of a contact along which its friction force changes in the last cycles."""
    span = np.ptp(data.contact_force.isel(time=last_cycles(data)).sel(contact=contact).values, axis=0)
    return [name for name, own in zip(("t1", "t2"), span, strict=False) if own > 1e-9 * span.max()]


def _normal_load_figure(data: Dataset, contacts: Sequence[str]) -> Figure:
    fig, grid = figure(len(contacts), 1, width=8.5, height=1.7, gap=0.3, sharex=True)
    for ax, contact in zip(grid[:, 0], contacts, strict=True):
        normal_load(data, ax, contact=contact).label_outer()
    return fig


def _states_figure(data: Dataset, contacts: Sequence[str]) -> Figure:
    longest = max(len(short(name)) for name in contacts)
    fig, grid = figure(width=8.5, height=0.2 + 0.4 * len(contacts), left=0.4 + 0.075 * longest)
    contact_states(data, grid[0, 0], contacts=contacts)
    return fig


def _of_contacts(
    what: str, drawn: Callable[[Dataset, Sequence[str]], Figure | None], limit: int = MAX_ROWS, *, rubbing: bool = False
) -> Picture:
    """A picture of the last cycles of the busiest contacts, or of those with friction; none if there is no such one."""

    def picture(data: Dataset) -> Figure | None:
        contacts = busiest(data, limit, rubbing=rubbing)
        if not contacts or (fig := drawn(data, contacts)) is None:
            return None
        every = data.sizes["contact"]
        number = int(rubs(data).sum()) if rubbing else every
        kind = "contacts with friction" if number < every else "contacts"
        hidden = left_out(number, len(contacts), kind, "the least active")
        which = "one cycle" if data.sizes["cycle"] == 1 else "last cycles"
        return finish(fig, data, f"{what}, {which}", hidden)

    return picture


PICTURES: dict[str, Picture] = {
    "orbit": _of_contacts("orbit in the contact plane", _orbit_figure, rubbing=True),
    "hysteresis": _of_contacts("friction force against displacement", _hysteresis_figure, rubbing=True),
    "normal_load": _of_contacts("normal load", _normal_load_figure),
    "contact_states": _of_contacts("contact states", _states_figure, MAX_BARS),
}
