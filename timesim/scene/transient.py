"""Studies of one run: at one frequency, or through a schedule of frequencies."""

from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from timesim.model.choice import choice
from timesim.model.cost import Work
from timesim.model.model import Model
from timesim.model.solver import Solver
from timesim.result.label import counted
from timesim.scene.section import Section, refuse
from timesim.scene.study import Context, StudySection
from timesim.scene.value import Count, Positive, Switch, Whole

Samples = Annotated[Whole, Field(ge=2)]
MAX_SAMPLES = 10**9
"""Most samples of a run: the times of more would not fit into memory."""


@dataclass(frozen=True)
class Schedule:
    """What is run, and what of it is sampled.

    Attributes:
        phases: frequency [Hz] and cycles of each phase of the run, the run-up included.
        run_up: how many phases come before time 0.
        first: cycle from which samples are kept, counted from 0.
    """

    phases: tuple[tuple[float, int], ...]
    run_up: int
    first: int
    samples_per_cycle: int

    def edges(self) -> np.ndarray:
        """Time at the start of each phase and at the end of the last [s], exactly 0 after the run-up."""
        ends = np.array([0.0, *accumulate(cycles / frequency for frequency, cycles in self.phases)])
        return ends - ends[self.run_up]

    @property
    def num_samples(self) -> int:
        """Samples that are kept, both ends of the recorded cycles included."""
        return (sum(cycles for _, cycles in self.phases) - self.first) * self.samples_per_cycle + 1

    def sample_times(self) -> np.ndarray:
        """Times of the samples [s], both ends of the recorded cycles included."""
        edges, cycle, times = self.edges(), 0, []
        for (frequency, cycles), start in zip(self.phases, edges[:-1], strict=True):
            skipped = min(max(self.first - cycle, 0), cycles)
            ticks = np.arange(skipped * self.samples_per_cycle, cycles * self.samples_per_cycle)
            times.append(start + ticks / (frequency * self.samples_per_cycle))
            cycle += cycles
        return np.concatenate([*times, edges[-1:]])

    def place(self, cycles: int) -> str:
        """Where a run is after a number of cycles, in words."""
        ends = list(accumulate(cycles for _, cycles in self.phases))
        phase = sum(end <= cycles for end in ends[:-1])
        name = f"phase {phase - self.run_up + 1} of {len(ends) - self.run_up}" if phase >= self.run_up else "run-up"
        return f"{name + ', ' if len(ends) > 1 else ''}{cycles} of {counted(ends[-1], 'cycle')}"

    def cycle_frequency(self) -> np.ndarray:
        """Frequency of each cycle [Hz], shape (cycles,)."""
        frequency, cycles = zip(*self.phases, strict=True)
        return np.repeat(frequency, cycles)


class Transient(StudySection):
    """One run at one frequency."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation", "excitation.frequency")
    uses_frequency: ClassVar[bool] = True
    counts: ClassVar[str] = "cycles"

    kind: Literal["transient"]
    cycles: Count
    """Excitation cycles to run."""
    samples_per_cycle: Samples = 200
    """Recorded samples of one cycle."""
    record_last: Count | None = None
    """How many of the last cycles are recorded; all by default."""

    @model_validator(mode="after")
    def _within(self) -> Self:
        if self.record_last is not None and self.record_last > self.cycles:
            rule = f"must be at most the {counted(self.cycles, 'cycle')} of the run"
            raise refuse(rule, key=("record_last",), value=self.record_last)
        _check_samples(self.samples_per_cycle, self.record_last or self.cycles, "record_last")
        return self.completed(record_last=self.cycles)

    def plan(self, context: Context) -> Schedule:
        """One phase, of which the last cycles are sampled."""
        assert context.frequency is not None
        first = self.cycles - (self.record_last or self.cycles)
        return Schedule(((context.frequency, self.cycles),), 0, first, self.samples_per_cycle)


def _check_samples(samples_per_cycle: int, cycles: int, less: str) -> None:
    if samples_per_cycle * cycles > MAX_SAMPLES:
        rule = f"must leave at most {MAX_SAMPLES} samples of the {counted(cycles, 'cycle')} recorded"
        raise refuse(rule, key=("samples_per_cycle",), hint=f"{less} has fewer recorded", value=samples_per_cycle)


@dataclass(frozen=True)
class TradeoffPlan:
    """A run at a frequency [Hz] that is made by many solvers; the rest as in `Tradeoff`."""

    frequency: float
    cycles: int
    error: float
    budget: float
    amplitude: bool

    def preset(self, accuracy: str, model: Model, max_steps: int) -> Solver:
        """The solver that an accuracy would choose for a transient of as many cycles."""
        return choice(accuracy, model, Work.of_run(((self.frequency, self.cycles),), estimated=True), max_steps).solver


class Tradeoff(StudySection):
    """Error against time of one run, over methods, tolerances, modes kept and reductions."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation", "excitation.frequency")
    uses_frequency: ClassVar[bool] = True
    counts: ClassVar[str] = "seconds"

    kind: Literal["tradeoff"]
    cycles: Count = 60
    """Excitation cycles of the run, from the scene's start."""
    error: Annotated[Positive, Field(ge=1e-12, lt=1)] = 1e-6
    """Wanted error of the state at the end, relative to its size."""
    budget: Positive = 60.0
    """Seconds for all runs and their compilation; the cheapest runs come first, and those beyond it are left out."""
    amplitude: Switch = False
    """Judge the settled amplitude, which is what a sweep needs, instead of the state at the end: the runs begin from
    the settled motion, and have more cycles than these where it takes more to come to their own."""

    def plan(self, context: Context) -> TradeoffPlan:
        assert context.frequency is not None
        return TradeoffPlan(context.frequency, self.cycles, self.error, self.budget, self.amplitude)


class FrequencyPhase(Section):
    """A number of cycles at one frequency."""

    frequency: Positive
    """Frequency of the excitation [Hz]."""
    cycles: Count
    """Excitation cycles at it."""


class Jump(StudySection):
    """One run through a schedule of frequencies, the phase of the excitation continuous across its changes."""

    counts: ClassVar[str] = "cycles"

    kind: Literal["jump"]
    phases: Annotated[tuple[FrequencyPhase, ...], Field(min_length=1)]
    """Frequencies one after the other, each with its cycles; time 0 is the start of the first."""
    run_up: tuple[FrequencyPhase, ...] = ()
    """Phases before these, at negative times: their transitions and amplitudes are kept, but no samples."""
    samples_per_cycle: Samples = 200
    """Recorded samples of one cycle."""

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        _check_samples(self.samples_per_cycle, sum(phase.cycles for phase in self.phases), "run_up")
        return self

    def plan(self, context: Context) -> Schedule:
        """All phases; those after the run-up are sampled."""
        phases = tuple((phase.frequency, phase.cycles) for phase in (*self.run_up, *self.phases))
        before = sum(phase.cycles for phase in self.run_up)
        return Schedule(phases, len(self.run_up), before, self.samples_per_cycle)

    def lowest_frequency(self) -> float:
        return min(phase.frequency for phase in (*self.run_up, *self.phases))
