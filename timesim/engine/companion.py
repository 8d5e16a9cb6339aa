"""The error of a run, estimated from a coarser companion: the same run again, with a tolerance ten times as large.

Steps of a fixed length are twice as long there. A run that repeats another at a finer tolerance has that for companion.

The error of a solution under step size control is nearly proportional to the tolerance (L. F. Shampine, Tolerance
proportionality in ODE codes, Lecture Notes in Mathematics 1386, 1989), also through located transitions. So nearly all
the difference between the two runs is the error of the companion, and that of the run is a known share of it.

Errors of a state are those of the modes normalised to unit mass, displacement and velocity each relative to the largest
in the last cycle. The scale of velocity is at least that of displacement times the frequency of the excitation, so that
a motion which comes to rest away from its origin is not divided by zero.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from timesim.engine.history import CycleTotals, stored_energy
from timesim.engine.status import RunError
from timesim.engine.trajectory import Run
from timesim.model.model import Model
from timesim.model.solver import coarser

PROPORTIONAL = 1e-2
"""Difference of the states up to which it is proportional to the tolerance."""
FIXED = (16.0, 4.0)
"""Errors of twice the length of a step, which is fixed, over those of that length: of order 4, and of order 2 where a
contact opens or closes, since slip turns faster than any such step as n vanishes. At 200 to 1,200 steps a cycle the
true error is 0.1 to 7 times the estimate then; by order 4 it was up to 35 times."""
IMPLICIT = 4.0
"""Error of the companion over that of the run by implicit steps, whose equations both solve to the same tolerance, that
of the run, as it is a part of the compiled program. By ten, one of ten estimates was more than ten times too small."""
ROUNDING = 1e-14
"""Error that rounding leaves of a cycle, which adds up at random."""


def totals_of(run: Run) -> CycleTotals:
    """Totals to gather of a run that has not begun."""
    now = (run.displacement, run.velocity, run.slip, run.state)
    return CycleTotals(run.model, float(stored_energy(run.model, *(part[None] for part in now))[0]))


class End(Protocol):
    """A state at the end of a run: displacement and velocity of its modes, shape (M,)."""

    @property
    def displacement(self) -> np.ndarray: ...

    @property
    def velocity(self) -> np.ndarray: ...


def state_error(model: Model, frequency: float, one: End, other: End, size: np.ndarray) -> float:
    """Largest difference of two states, relative to the size of the motion.

    Args:
        frequency: of the excitation [Hz].
        one, other: states at the same time.
        size: largest displacement and velocity, of `CycleTotals`.
    """
    root = np.sqrt(model.structure.mass)
    whole = (size[0], max(size[1], 2 * np.pi * frequency * size[0]))
    apart = (one.displacement - other.displacement, one.velocity - other.velocity)
    parts = zip(apart, whole, strict=True)
    return max((float(np.max(np.abs(part) * root)) / unit for part, unit in parts if unit > 0), default=0.0)


def amplitude_error(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Largest difference of the amplitudes of each cycle, of shape (cycle, point, axis), by the largest of them."""
    largest = np.max(one, axis=(1, 2), initial=0.0)
    difference = np.max(np.abs(one - other), axis=(1, 2), initial=0.0)
    return np.divide(difference, largest, out=np.zeros_like(largest), where=largest > 0)


@dataclass(frozen=True)
class Estimate:
    """How far a run is from the solution, estimated.

    Attributes:
        state: relative error of the state at the end; NaN where it is not known.
        amplitude: error of the amplitudes of each cycle, relative to the largest of them, shape (cycle,).
        remark: why it is not known, or to be taken with care; empty otherwise.
        proportional: whether the error can be taken as proportional to the tolerance.
    """

    state: float
    amplitude: np.ndarray
    remark: str = ""
    proportional: bool = False


def unknown(totals: CycleTotals, why: str) -> Estimate:
    """No estimate."""
    return Estimate(np.nan, np.full(len(totals.amplitude), np.nan), why)


class Companion:
    """The companion of a run, taken a batch of steps at a time; it takes the same compiled programs.

    Attributes:
        run, totals: the companion, and its totals so far.
        fault: why it ended early; empty otherwise.
    """

    def __init__(self, run: Run):
        """That of a run, from its start."""
        self.run = Run(run.model, run.phases, coarser(run.solver), run.method)
        self.totals, self.fault = totals_of(self.run), ""
        self._batches = self.run.batches()

    def advance(self) -> bool:
        """Take a batch of steps; whether there was one left."""
        try:
            steps = next(self._batches, None)
        except RunError as error:
            self.fault = f"the coarser companion failed: {error}"
            return False
        if steps is not None:
            self.totals.add(steps, self.run.completed)
        return steps is not None


def rounding(run: Run, totals: CycleTotals) -> Estimate:
    """The error of a run in closed form: what rounding does to its natural frequencies, carried through it at once."""
    other = Run(run.model, run.phases, run.solver)
    other.leap(rounded=True)
    apart = state_error(run.model, run.phases[-1].frequency, run, other, totals.size)
    state = max(apart, ROUNDING * np.sqrt(run.num_cycles))
    return Estimate(state, np.full(len(totals.amplitude), state + run.solver.rtol))


def estimate(run: Run, totals: CycleTotals, companion: Companion) -> Estimate:
    """The error of a run from its companion; both have come to their end."""
    if companion.fault:
        return unknown(totals, companion.fault)
    return compared(run, totals, companion.run, companion.totals)


def compared(run: Run, totals: CycleTotals, companion: Run, other: CycleTotals) -> Estimate:
    """The error of a run from a coarser one; both have come to their end."""
    ratio = companion.solver.rtol / run.solver.rtol
    coarser_run = f"at {ratio:.2g} times the tolerance"
    if run.solver.name == "rk4":
        ratio, coarser_run = FIXED[totals.opens], "of steps twice as long"
    if run.solver.name == "kvaerno5" and companion.method is run.method:
        ratio = IMPLICIT
    apart = state_error(run.model, run.phases[-1].frequency, run, companion, totals.size)
    share, remark = 1 / (ratio - 1), ""
    if other.transitions != totals.transitions:
        counts = f"{other.transitions} transitions against {totals.transitions}"
        remark = f"a run {coarser_run} takes {counts}: an order of magnitude at best"
    proportional = not remark and apart < PROPORTIONAL
    if not proportional:
        share = 1 / np.sqrt(ratio - 1)
    relative = amplitude_error(np.array(totals.amplitude), np.array(other.amplitude))
    rounding = ROUNDING * np.sqrt(np.arange(1, relative.size + 1))
    return Estimate(max(share * apart, rounding[-1]), np.maximum(share * relative, rounding), remark, proportional)
