"""Runs of the program under test, with all that the tests look at."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from timesim.engine.history import CycleTotals, Events, events, stored_energy
from timesim.engine.trajectory import Phase, Run
from timesim.model.model import SLIP, Model
from timesim.model.solver import PRESETS, Solver
from timesim.orbit.batch import march_lanes
from timesim.orbit.lane import Lane
from timesim.orbit.threshold import CYCLES_A_ROUND

FINE = Solver("tsit5", 1e-10, 1e-12)
REFERENCE = PRESETS["reference"]


@dataclass(frozen=True)
class Trace:
    """A run at its end, its transitions, its totals a cycle, and the number of steps that it took."""

    run: Run
    log: Events
    totals: CycleTotals
    num_steps: int

    @property
    def motion(self) -> np.ndarray:
        """Modal displacement and velocity."""
        return np.r_[self.run.displacement, self.run.velocity]

    @property
    def amplitude(self) -> np.ndarray:
        """Of each cycle, shape (cycle, point, axis)."""
        return np.array(self.totals.amplitude)

    @property
    def sequence(self) -> list[tuple[int, int, int]]:
        """Contact, state before and after of each transition."""
        return [
            (int(c), int(b), int(a)) for c, b, a in zip(self.log.contact, self.log.before, self.log.after, strict=True)
        ]

    @property
    def energy_residual(self) -> float:
        """Largest residual of a cycle over the larger of the largest input of a cycle and the peak of the stored."""
        count = len(self.totals.stored)
        work = np.diff(np.vstack([np.zeros(2 + self.run.model.num_contacts), *self.totals.work]), axis=0)
        stored = np.diff(np.array([self.totals.initial, *self.totals.stored]))
        residual = work[:, 0] - work[:, 1:].sum(axis=1) - stored
        assert count == self.run.num_cycles
        return float(np.abs(residual).max() / max(np.abs(work[:, 0]).max(), self.totals.peak))


def simulate(model: Model, cycles: int, solver: Solver = FINE, frequency: float | None = None) -> Trace:
    """March a model through some cycles at its own frequency, or at another [Hz]."""
    chosen = model.excitation.frequency if frequency is None else frequency
    assert chosen is not None
    return follow(Run(model, [Phase(chosen, cycles)], solver))


def follow(run: Run) -> Trace:
    """Carry a run to its end."""
    start: Any = (run.displacement, run.velocity, run.slip, run.state)
    totals = CycleTotals(run.model, float(stored_energy(run.model, *(part[None] for part in start))[0]))
    logs, count = [], 0
    for steps in run.batches():
        totals.add(steps, run.completed)
        logs.append(events(steps))
        count += steps.time.size
    columns = (np.concatenate([getattr(log, name) for log in logs]) for name in ("time", "contact", "before", "after"))
    return Trace(run, Events(*columns), totals, count)


def after_a_cycle(lanes: Sequence[Lane], solver: Solver) -> np.ndarray:
    """State vectors after the first cycle; marched on as settling does, whose program is compiled already."""
    return np.array([returns[0] for _, returns in march_lanes(lanes, solver, CYCLES_A_ROUND)])


def relative_error(found: np.ndarray, true: Any) -> float:
    """Largest difference over the largest entry of the truth."""
    truth = np.asarray(true, dtype=float)
    return float(np.abs(found - truth).max() / np.abs(truth).max())


def shares(trace: Trace, since: float) -> np.ndarray:
    """Share of the time after ``since`` [s] that each contact spends in stick, slip and separation, shape (C, 3)."""
    end, states = trace.run.time, trace.run.state
    share = np.zeros((states.size, 3))
    for c in range(states.size):
        own = trace.log.contact == c
        bounds = np.clip(np.r_[-np.inf, trace.log.time[own], end], since, end)
        visited = np.r_[trace.log.before[own], states[c]]
        np.add.at(share[c], visited, np.diff(bounds) / (end - since))
    return share


def slip_share(trace: Trace, since: float) -> np.ndarray:
    """Share of slip of each contact after ``since`` [s]."""
    return shares(trace, since)[:, SLIP]
