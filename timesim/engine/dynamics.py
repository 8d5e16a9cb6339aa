"""What the event loop integrates: a smooth field while every contact keeps its state, and the motion of the contacts.

Time is an angle, and a cycle has length 2 pi.
"""

import timesim.runtime  # noqa: F401  isort: skip

import abc
from typing import TypeAlias, TypeVar

import equinox as eqx
from jaxtyping import Array, Bool, Float

from timesim.engine.contact_law import ContactLaw, Motion, Plane, State

Path: TypeAlias = tuple[Plane, Plane, Plane]


class ContinuousState(eqx.Module):
    """Where a trajectory is in its continuous state, or the rate of that, or its error over a step.

    Attributes:
        w: slip of the contacts.
    """

    w: eqx.AbstractVar[Plane]

    @abc.abstractmethod
    def size(self) -> Float[Array, ""]:
        """Largest coordinate: what a relative tolerance is relative to."""

    @abc.abstractmethod
    def error(self) -> Float[Array, ""]:
        """Largest entry of an error that the step control looks at."""

    @abc.abstractmethod
    def finite(self) -> Bool[Array, ""]:
        """Whether every coordinate is a number."""


P = TypeVar("P", bound=ContinuousState)


class Dynamics(eqx.Module):
    """A system with contacts.

    Attributes:
        law: the law of its contacts.
    """

    law: eqx.AbstractVar[ContactLaw]

    @abc.abstractmethod
    def field(self, state: State, time: Float[Array, ""], point: P) -> P:
        """Rate of the continuous state, every contact keeping its own."""

    @abc.abstractmethod
    def motion(self, point: P) -> Motion:
        """Relative motion of the contacts and its rates."""

    @abc.abstractmethod
    def path(self, point: P, rate: P) -> Path:
        """Relative motion of the contacts, normal last, with two derivatives; ``rate`` is that of the point."""
