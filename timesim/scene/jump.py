"""Schedules of frequency, as the scene file writes them."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from timesim.scene.section import Count, Positive, Section, Whole
from timesim.scene.study import StudyKind


class FrequencyPhase(Section):
    """A number of cycles at one frequency."""

    frequency: Positive
    """Frequency of the excitation [Hz]."""
    cycles: Count
    """Excitation cycles at it."""


Schedule = tuple[FrequencyPhase, ...]


class Jump(StudyKind):
    """One run through a schedule of frequencies, the phase of the excitation continuous across its changes."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation")

    kind: Literal["jump"]
    phases: Annotated[Schedule, Field(min_length=1)]
    """Frequencies one after the other, each with its cycles; time 0 is the start of the first."""
    run_up: Schedule = ()
    """Phases before these, at negative times: no samples of them are kept, but their transitions and amplitudes."""
    samples_per_cycle: Annotated[Whole, Field(ge=2)] = 200
    """Recorded samples of one cycle."""

    def lowest_frequency(self) -> float:
        """Of all phases."""
        return min(phase.frequency for phase in (*self.run_up, *self.phases))
