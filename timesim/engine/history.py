"""What is kept of a run: samples, transitions, amplitudes and energies, from the dense output of its steps.

Plain numpy on the host, in the units of the scene, a batch of steps at a time; nothing grows but what is recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from timesim.engine import dense_output as hermite
from timesim.engine.law.table import law_class
from timesim.model.model import Model

# A step is a small part of the fastest oscillation; in each quarter of it a velocity changes sign at most once.
PARTS = 4


@dataclass(frozen=True)
class Steps:
    """Consecutive accepted steps, in the units of the scene.

    Attributes:
        cycle: cycle of each step, from 0, shape (N,).
        time: start, shape (N,).
        h: length, shape (N,).
        start, end: (q, q', q'') at both ends, each of shape (N, M).
        slip_start, slip_end: (w, w') at both ends, each of shape (N, C, 2).
        state, state_after: states during the step and after its end, shape (N, C).
        input, damping: work done since the start of the run at the end of the step, shape (N,).
        friction: energy lost in each contact since then, shape (N, C).
    """

    cycle: np.ndarray
    time: np.ndarray
    h: np.ndarray
    start: tuple[np.ndarray, np.ndarray, np.ndarray]
    end: tuple[np.ndarray, np.ndarray, np.ndarray]
    slip_start: tuple[np.ndarray, np.ndarray]
    slip_end: tuple[np.ndarray, np.ndarray]
    state: np.ndarray
    state_after: np.ndarray
    input: np.ndarray
    damping: np.ndarray
    friction: np.ndarray


@dataclass(frozen=True)
class Samples:
    """Continuous state at given times: q, q' (N, M), w (N, C, 2) and contact states (N, C)."""

    time: np.ndarray
    q: np.ndarray
    p: np.ndarray
    w: np.ndarray
    state: np.ndarray


@dataclass(frozen=True)
class Events:
    """Transitions: time, contact, state before and after, each of shape (N,)."""

    time: np.ndarray
    contact: np.ndarray
    before: np.ndarray
    after: np.ndarray


def sample(steps: Steps, times: np.ndarray) -> Samples:
    """Dense output at times within the steps; at a transition the state after it, at the end the last one."""
    index = np.clip(np.searchsorted(steps.time, times, side="right") - 1, 0, steps.time.size - 1)
    h = steps.h[index, None]
    x = np.clip((times - steps.time[index])[:, None] / np.where(h > 0, h, 1.0), 0.0, 1.0)
    ends: list[Any] = [tuple(part[index] for part in side) for side in (steps.start, steps.end)]
    q, p = hermite.quintic(x, h, ends[0], ends[1])
    slips: list[Any] = [tuple(part[index] for part in side) for side in (steps.slip_start, steps.slip_end)]
    w = hermite.cubic(x[..., None], h[..., None], slips[0], slips[1])
    return Samples(times, q, p, w, steps.state[index])


def events(steps: Steps) -> Events:
    """Transitions of these steps in the order of time."""
    row, contact = np.nonzero(steps.state != steps.state_after)
    return Events((steps.time + steps.h)[row], contact, steps.state[row, contact], steps.state_after[row, contact])


def extremes(steps: Steps, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value of some displacements over each step, on the dense output.

    Args:
        steps: the steps.
        shape: the displacements for a unit of each mode, shape (X, M).

    Returns:
        Two arrays of shape (N, X).
    """
    start, end = (tuple(part @ shape.T for part in side) for side in (steps.start, steps.end))
    return between(np.broadcast_to(steps.h[:, None], start[0].shape), start, end)


def between(h: np.ndarray, start: Sequence[np.ndarray], end: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value within steps of length h, from (value, rate, second derivative) at their ends.

    All arrays have one shape, that of the two results.
    """
    nodes = np.linspace(0.0, 1.0, PARTS + 1)
    coefficients = hermite.quintic_coefficients(h, (start[0], start[1], start[2]), (end[0], end[1], end[2]))
    along = [hermite.evaluate(x, coefficients) for x in nodes]
    values = np.stack([value for value, _ in along])
    low, high = values.min(axis=0), values.max(axis=0)
    rates = np.stack([rate for _, rate in along])
    part, *where = np.nonzero(rates[:-1] * rates[1:] < 0)
    if part.size:
        place = tuple(where)
        turning = _turning(nodes[part], nodes[part + 1], rates[part, *place], [c[place] for c in coefficients])
        np.minimum.at(low, place, turning)
        np.maximum.at(high, place, turning)
    return low, high


def _turning(left: np.ndarray, right: np.ndarray, rate: np.ndarray, coefficients: Sequence[np.ndarray]) -> np.ndarray:
    """Value where the rate vanishes between left and right, by bisection: 30 halvings leave a rounding of the value."""
    sign = np.sign(rate)
    for _ in range(30):
        middle = 0.5 * (left + right)
        _, rate = hermite.evaluate(middle, tuple(coefficients))
        before = rate * sign > 0
        left, right = np.where(before, middle, left), np.where(before, right, middle)
    return np.asarray(hermite.evaluate(0.5 * (left + right), tuple(coefficients))[0])


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
        model: what is simulated.
        initial: energy stored at the start.
        amplitude: (max - min)/2 of each cycle, of each point along each axis.
        start, end: times of each cycle.
        work: done until the end of each cycle.
        stored: energy stored there.
        peak: largest energy stored.
        size: largest displacement and velocity in the last cycle, modes normalised to unit mass, shape (2,).
        transitions: how many there were.
    """

    model: Model
    initial: float
    amplitude: list[np.ndarray] = field(default_factory=list)
    start: list[float] = field(default_factory=list)
    end: list[float] = field(default_factory=list)
    work: list[np.ndarray] = field(default_factory=list)
    stored: list[float] = field(default_factory=list)
    peak: float = 0.0
    size: np.ndarray = field(default_factory=lambda: np.zeros(2))
    transitions: int = 0
    _low: Any = None
    _high: Any = None
    _open: int = -1

    def add(self, steps: Steps, completed: int) -> None:
        """Take up a batch of steps; ``completed``: cycles that are complete at its end."""
        if steps.time.size == 0:
            return
        shape = self.model.structure.shape.reshape(-1, self.model.structure.num_modes)
        low, high = extremes(steps, shape)
        energy = stored_energy(self.model, steps.end[0], steps.end[1], steps.slip_end[0], steps.state_after)
        self.peak = max(self.peak, float(np.max(np.abs(energy))))
        self.transitions += int(np.sum(steps.state != steps.state_after))
        root = np.sqrt(self.model.structure.mass)
        size = np.stack([np.max(np.abs(part) * root, axis=1) for part in steps.end[:2]])
        for cycle in np.unique(steps.cycle):
            rows = np.nonzero(steps.cycle == cycle)[0]
            self._extend(int(cycle), float(steps.time[rows[0]]), low[rows].min(axis=0), high[rows].max(axis=0))
            self.size = np.maximum(self.size, size[:, rows].max(axis=1))
            if cycle < completed:
                last = rows[-1]
                self.end.append(float(steps.time[last] + steps.h[last]))
                self.work.append(np.concatenate([[steps.input[last], steps.damping[last]], steps.friction[last]]))
                self.stored.append(float(energy[last]))
                self.amplitude.append(0.5 * (self._high - self._low).reshape(-1, 3))

    def _extend(self, cycle: int, time: float, low: np.ndarray, high: np.ndarray) -> None:
        if cycle != self._open:
            self._open, self._low, self._high = cycle, low, high
            self.size = np.zeros(2)
            self.start.append(time)
        else:
            self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
