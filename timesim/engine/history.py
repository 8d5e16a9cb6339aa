"""What is kept of a run: samples, transitions, amplitudes and energies, from the dense output of its steps.

Plain numpy on the host, in the units of the scene, a batch of steps at a time; nothing grows but what is recorded.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from timesim.engine import dense_output as hermite
from timesim.engine.law.table import law_class
from timesim.engine.trajectory import Steps
from timesim.model.model import SEPARATION, Model

MOST_UNLIKE = 5.0
"""Ratio of the lengths of two steps from which on no polynomial goes through the ends of both."""


class Samples(NamedTuple):
    """Continuous state at given times: q, q' (N, M), w (N, C, 2) and contact states (N, C)."""

    time: np.ndarray
    q: np.ndarray
    p: np.ndarray
    w: np.ndarray
    state: np.ndarray


class Events(NamedTuple):
    """Transitions: time, contact, state before and after, each of shape (N,)."""

    time: np.ndarray
    contact: np.ndarray
    before: np.ndarray
    after: np.ndarray


def sample(steps: Steps, times: np.ndarray) -> Samples:
    """Dense output at times within the steps; at a transition the state after it, at the end the last one."""
    steps = steps.between(times[0], times[-1])
    index = np.clip(np.searchsorted(steps.time, times, side="right") - 1, 0, steps.time.size - 1)
    h = steps.h[index, None]
    x = np.clip((times - steps.time[index])[:, None] / np.where(h > 0, h, 1.0), 0.0, 1.0)
    ends: list[Any] = [tuple(part[index] for part in side) for side in (steps.start, steps.end)]
    q, p = hermite.quintic(x, h, ends[0], ends[1])
    return Samples(times, q, p, _slip(steps, index, x[..., None]), steps.state[index])


def _slip(steps: Steps, index: np.ndarray, x: np.ndarray) -> Any:
    """Slip at fractions x, shape (N, 1, 1), of steps: through both ends, and that of a step beside."""
    (w0, d0), (w1, d1), h = steps.slip_start, steps.slip_end, steps.h
    beside, place = _beside(steps)
    onwards = (place > 0)[:, None, None]
    ends: list[Any] = [np.where(onwards, one[beside], other[beside])[index] for one, other in ((w1, w0), (d1, d0))]
    length, far = (column[index, None, None] for column in (h, place))
    return hermite.through_third(x, length, (w0[index], d0[index]), (w1[index], d1[index]), far, (ends[0], ends[1]))


def _beside(steps: Steps) -> tuple[np.ndarray, np.ndarray]:
    """The step beside each one whose slip goes on as in it, and the place of its far end as a fraction of that one.

    The shorter one in which all contacts keep their states, if it is not far longer or shorter; else the place is NaN.
    """
    row = np.arange(steps.h.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = steps.h[1:] / steps.h[:-1]
        alike = (steps.state[1:] == steps.state[:-1]).all(axis=1) & (np.maximum(ratio, 1 / ratio) < MOST_UNLIKE)
        after = np.append(np.where(alike, ratio, np.inf), np.inf)
        before = np.append(np.inf, np.where(alike, 1 / ratio, np.inf))
    place = np.where(after <= before, 1 + after, -before)
    beside = np.where(after <= before, row + 1, row - 1).clip(0, row.size - 1)
    return beside, np.where(np.isinf(place), np.nan, place)


def joined(parts: list[Any]) -> Any:
    """One record from many of a kind."""
    return type(parts[0])(*map(np.concatenate, zip(*parts, strict=True)))


def events(steps: Steps) -> Events:
    """Transitions of these steps in the order of time."""
    row, contact = np.nonzero(steps.state != steps.state_after)
    return Events((steps.time + steps.h)[row], contact, steps.state[row, contact], steps.state_after[row, contact])


def stored_energy(model: Model, q: np.ndarray, p: np.ndarray, w: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Kinetic and elastic energy of structure and contacts, shape (N,), from states with N as the first axis."""
    structure, law = model.structure, law_class(model.contacts)
    energy = 0.5 * (p**2 @ structure.mass + q**2 @ structure.stiffness)
    shapes = model.contact_shape
    for c in model.summation_order:
        for part in law.stored_energy(model.contacts[c], q @ shapes[c].T, w[:, c], state[:, c]):
            energy = energy + part
    return energy


@dataclass
class CycleTotals:
    """Amplitudes and energies of each completed cycle, gathered from batches of steps.

    Attributes:
        initial: energy stored at the start.
        amplitude: (max - min)/2 of each cycle, of each point along each axis.
        start, end: times of each cycle.
        work: done until the end of each cycle.
        stored: energy stored there.
        peak: largest energy stored at the end of a step.
        size: largest displacement and velocity at the ends of the steps of the last cycle, modes normalised to unit
            mass, shape (2,).
        opens: whether a contact has opened or closed.
    """

    model: Model
    initial: float
    amplitude: list[np.ndarray] = field(default_factory=list)
    start: list[float] = field(default_factory=list)
    end: list[float] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    work: list[np.ndarray] = field(default_factory=list)
    stored: list[float] = field(default_factory=list)
    peak: float = 0.0
    size: np.ndarray = field(default_factory=lambda: np.zeros(2))
    transitions: int = 0
    opens: bool = False
    _low: Any = None
    _high: Any = None
    _open: int = -1
    _taken: int = 0

    def add(self, steps: Steps, completed: int) -> None:
        """Take up a batch of steps; ``completed``: cycles that are complete at its end."""
        if steps.time.size == 0:
            return
        first = np.flatnonzero(np.diff(steps.cycle, prepend=steps.cycle[0] - 1))
        taken, (low, high) = np.diff(first, append=steps.cycle.size), steps.extremes(first)
        if goes_on := bool(steps.cycle[0] == self._open):
            low[0], high[0] = np.minimum(low[0], self._low), np.maximum(high[0], self._high)
            taken[0] += self._taken
        energy = stored_energy(self.model, *steps.reached, steps.state_after)
        self.peak = max(self.peak, float(np.max(np.abs(energy))))
        switched = steps.state != steps.state_after
        self.transitions += int(np.sum(switched))
        self.opens |= bool(np.any(switched & (np.maximum(steps.state, steps.state_after) == SEPARATION)))
        self._measure(steps, first[-1], goes_on=goes_on and first.size == 1)
        done = steps.cycle[first] < completed
        last = np.append(first[1:], steps.cycle.size)[done] - 1
        self.start += steps.time[first[goes_on:]].tolist()
        self.end += (steps.time[last] + steps.h[last]).tolist()
        self.steps += taken[done].tolist()
        self.work += [*steps.work[last]]
        self.stored += energy[last].tolist()
        self.amplitude += [*0.5 * (high - low)[done].reshape(-1, low.shape[1] // 3, 3)]
        self._open, self._taken, self._low, self._high = int(steps.cycle[-1]), int(taken[-1]), low[-1], high[-1]

    def _measure(self, steps: Steps, first: int, *, goes_on: bool) -> None:
        """Take the size of the motion from the last steps on; they may go on with the cycle before."""
        root = np.sqrt(self.model.structure.mass)
        size = np.array([np.max(np.abs(part[first:]) * root) for part in steps.reached[:2]])
        self.size = np.maximum(self.size, size) if goes_on else size
