"""Studies of steady states over frequency, as the scene file writes them."""

from collections.abc import Mapping
from math import prod
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from timesim.scene.axis import Frequencies, Over, axis_values
from timesim.scene.section import Count, Positive, Section, refuse
from timesim.scene.study import StudyKind


class Settle(Section):
    """When a motion counts as settled."""

    tolerance: Annotated[Positive, Field(le=1e-2)] = 1e-8
    """Of the state from cycle to cycle, relative to its largest entry, extrapolated to all cycles to come."""
    max_cycles: Count = 2000
    """Excitation cycles after which a point is given up as not settled."""


def product_told(frequencies: int, over: Mapping[str, int], directions: int) -> str:
    """A number of points and what makes it up."""
    factors = [f"{frequencies} frequencies", *(f"{number} values of {key}" for key, number in over.items())]
    total = frequencies * prod(over.values()) * directions
    if directions > 1:
        factors.append(f"{directions} directions")
    return f"{' x '.join(factors)} = {total} points" if len(factors) > 1 else f"{total} frequencies"


class SweepKeys(StudyKind):
    """What a study of steady states over frequency is told."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation")

    frequency: Frequencies
    """{from, to, step} or {values: [...]} [Hz]."""
    direction: Literal["up", "down", "both", "independent"] = "independent"
    """up, down, both: the state is carried from one frequency to the next; independent: each starts anew."""
    over: Over = Field(default_factory=dict)
    """Further axes: scalars of the scene by their key, each with its values."""
    settle: Settle = Settle()
    """When a motion counts as settled."""

    periodic: Literal["march", "shoot"] = "march"
    """How a periodic motion is found: marching until it settles, or Newton's method on the state after a period."""
    refine: Positive | None = None
    """Width [Hz] to which the frequency of a jump between two steps of a sweep is bisected; by default it is not."""

    @model_validator(mode="after")
    def _jumps_need_a_direction(self) -> Self:
        if self.refine is not None and self.direction == "independent":
            raise refuse("needs a direction", key=("refine",), hint="set direction to up, down or both")
        return self

    def lowest_frequency(self) -> float:
        """The first."""
        return float(self.frequency.values()[0])

    def points_told(self) -> str:
        """Frequencies, values of the further axes and directions."""
        over = {key: len(axis_values(given)) for key, given in self.over.items()}
        return product_told(self.frequency.count, over, len(self.directions))

    @property
    def directions(self) -> tuple[str, ...]:
        """Labels of the directions in the result."""
        return ("up", "down") if self.direction == "both" else (self.direction,)


class Sweep(SweepKeys):
    """Steady states over frequency and any scalars of the scene."""

    kind: Literal["sweep"]
