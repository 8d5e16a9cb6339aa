"""A steady state: amplitude, states of the contacts, stability, the state from which a run goes on; as arrays too."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np

from timesim.model.model import Model, Start
from timesim.orbit.fourier import HARMONICS

Shares = TypeVar("Shares", bound=Any)
"""An array of numpy or of xarray."""

# A state that lasts for a smaller share of the period does not count: a transition itself is located to 1e-8 of the
# fastest oscillation, and the effect of so short a stay on the motion is far below any tolerance.
BRIEF = 1e-9


@dataclass(frozen=True)
class Orbit:
    """The steady state at a frequency.

    Attributes:
        end: the state at the end of a cycle, from which another run may start.
        amplitude: (max - min) / 2 of each point along x, y, z over a period, shape (P, 3); over the last ten cycles
            where the motion has not settled.
        band: smallest and largest amplitude of one of these cycles, shape (2, P, 3).
        cycles: excitation cycles integrated; 0 where the scene is linear and needs none.
        period: its period in excitation periods; 0 if the motion has not settled.
        slip_share, separation_share: share of the period in these states, shape (C,).
        phasor: harmonics 0 to `HARMONICS` of the excitation's frequency, ``x = Re sum_h phasor_h exp(i h phase)``, over
            all cycles of a longer period, shape (H + 1, P, 3); NaN where the motion has not settled.
        dissipated_power: power lost in each contact, the mean over the cycles that show the motion, shape (C,).
        floquet: Floquet multipliers, largest first, without those of free offsets; NaN where it has not settled.
        settled_to: estimated distance of its state from one that repeats, relative to the largest entry; where the
            motion has not settled, its change over the cycle, or the several cycles, after which it changes least.
        cycle_steps: steps of a cycle, the mean over those that show the motion; 0 where there is none to integrate.
        cycle_transitions: of each contact, the same, shape (C,).
        drift: way by which each point moves on in a cycle, shape (P, 3); zero but for a body that nothing holds, whose
            motion is said to be what one who moves on with it sees.
        irregular: whether it has been marched for long enough to show that it repeats after no number of cycles up to
            `timesim.orbit.threshold.LONGEST`.
        reason: why it could not be computed; None if it was.
    """

    end: Start
    amplitude: np.ndarray
    band: np.ndarray
    cycles: int
    period: int
    slip_share: np.ndarray
    separation_share: np.ndarray
    phasor: np.ndarray
    dissipated_power: np.ndarray
    floquet: np.ndarray
    cycle_steps: float
    cycle_transitions: np.ndarray
    drift: np.ndarray
    settled_to: float = 0.0
    irregular: bool = False
    reason: str | None = None

    @property
    def settled(self) -> bool:
        """Whether the motion repeats."""
        return self.period > 0

    @property
    def largest(self) -> float:
        """Largest amplitude of all points and axes."""
        return float(np.max(np.abs(self.amplitude), initial=0.0))


def without_orbit(model: Model, reason: str, cycles: int = 0) -> Orbit:
    """Placeholder for a steady state that could not be computed."""
    blank = orbit_of(blank_columns(model), (), model.start.phase)
    return replace(blank, end=model.start, cycles=cycles, irregular=False, reason=reason)


# Two motions

SAME = 1e-3
"""Of the amplitude: motions that differ by less are one."""


def distance(one: Orbit, other: Orbit) -> float:
    """Largest difference of amplitude between two motions, over all points and axes.

    The band of a motion that has not settled is subtracted: its amplitude may be any in it.
    """
    loose = sum(orbit.band[1] - orbit.band[0] for orbit in (one, other) if not orbit.settled)
    return float(np.max(np.abs(one.amplitude - other.amplitude) - loose, initial=0.0))


def differ(one: Orbit, other: Orbit) -> bool:
    """Whether two motions are different, by their amplitudes or harmonics; False if one could not be computed.

    The mean does not count: the offset of a contact that sticks moves it.
    """
    if one.reason is not None or other.reason is not None:
        return False
    apart = distance(one, other)
    if one.settled and other.settled:
        apart = max(apart, float(np.max(np.abs(one.phasor - other.phasor)[1:], initial=0.0)))
    return apart > SAME * max(one.largest, other.largest)


# Shares of the states of contacts


def share(duration: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Share of the time spent within a state, shape (C,): exactly 0 or 1 where it never changes.

    ``within``: whether each contact is in it during each step, shape (N, C), of a duration, shape (N,).
    """
    part = duration @ within / duration.sum()
    return np.where(within.all(axis=0), 1.0, np.minimum(part, 1.0))


def switches(slip_share: Shares, separation_share: Shares) -> Shares:
    """Whether each contact slips, or is open for a part of the period; where none does the motion is linear."""
    return (slip_share > BRIEF) | ((separation_share > BRIEF) & (separation_share < 1 - BRIEF))


# Steady states as arrays, by chain and place along it

Columns = Mapping[str, np.ndarray]
"""Steady states as arrays by the names of `COLUMNS`."""

START = ("end_displacement", "end_velocity", "end_slip", "end_state")  # in the order of `Start`
SHARES = ("slip_share", "separation_share")
ARRAYS = ("amplitude", "band", *SHARES, "phasor", "dissipated_power", "cycle_transitions", "drift")
NUMBERS = ("cycles", "period", "settled_to", "irregular", "cycle_steps")
COLUMNS = (*ARRAYS, *NUMBERS, "settled", "floquet_max", "reason", *START)


# Dimensions of the quantities of a point after those of the sweep, and values for points that were not computed, where
# these are not NaN.
TAILS = {
    **dict.fromkeys(("amplitude", "phase_deg", "drift"), ("point", "axis")),
    **dict.fromkeys(("phasor", "harmonic_amplitude", "harmonic_cos", "harmonic_sin"), ("harmonic", "point", "axis")),
    "band": ("band", "point", "axis"),
    **dict.fromkeys(("slip_share", "separation_share", "dissipated_power", "cycle_transitions"), ("contact",)),
    **dict.fromkeys(("end_displacement", "end_velocity"), ("mode",)),
    "end_slip": ("contact", "tangent"),
    "end_state": ("contact",),
}
BLANK: dict[str, tuple[Any, type]] = {
    **dict.fromkeys(("settled", "cycles", "period", "irregular"), (0, np.int32)),
    "end_state": (-1, np.int8),
    "phasor": (np.nan, complex),
    "reason": ("", object),
}


def blank_columns(model: Model, *shape: int) -> dict[str, np.ndarray]:
    """Columns of points that were not computed; ``shape`` is that of the points."""
    sizes, arrays = sizes_of(model), dict[str, np.ndarray]()
    for name in COLUMNS:
        fill, kind = BLANK.get(name, (np.nan, float))
        arrays[name] = np.full((*shape, *(sizes[dim] for dim in TAILS.get(name, ()))), fill, dtype=kind)
    return arrays


def sizes_of(model: Model) -> dict[str, int]:
    """Lengths of the dimensions that a model determines, or that are the same everywhere."""
    own = {"point": len(model.structure.points), "contact": model.num_contacts, "mode": model.structure.num_modes}
    return own | {"axis": 3, "band": 2, "tangent": 2, "harmonic": HARMONICS + 1}


def columns_of(orbits: Sequence[Sequence[Orbit]]) -> dict[str, np.ndarray]:
    """Steady states as arrays, by chain and place along it; of the multipliers the largest only."""
    values: dict[str, Callable[[Orbit], Any]] = {
        **{name: attrgetter(name) for name in (*ARRAYS, *NUMBERS, "settled")},
        "floquet_max": lambda orbit: np.max(np.abs(orbit.floquet), initial=0.0),
        "reason": lambda orbit: orbit.reason or "",
        **{name: attrgetter(name.replace("_", ".", 1)) for name in START},
    }
    return {name: np.array([[value(orbit) for orbit in own] for own in orbits]) for name, value in values.items()}


def end_of(columns: Columns, place: tuple[int, ...], phase: float) -> Start:
    """The state at the end of a cycle of one of the steady states, the excitation then at a phase [rad]."""
    displacement, velocity, slip, state = (np.asarray(columns[name][place]) for name in START)
    return Start(displacement, velocity, slip, state, phase)


def orbit_of(columns: Columns, place: tuple[int, ...], phase: float) -> Orbit:
    """The inverse of `columns_of`; of the multipliers the largest only."""
    value = {name: columns[name][place] for name in ARRAYS} | {name: columns[name][place].item() for name in NUMBERS}
    largest, reason = np.array([columns["floquet_max"][place]]), str(columns["reason"][place]) or None
    return Orbit(end=end_of(columns, place, phase), floquet=largest, reason=reason, **value)
