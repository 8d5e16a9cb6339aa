"""A system in modes that turn: what its undamped modes do by themselves is taken out of its rates.

A disturbance of a mode that is fast over a step then stays what it is; of itself an explicit step would let it grow or
die out, however small the mode is in the motion [1]_. The derivative of a step needs that, the step itself does not:
there the step control sees what grows.

.. [1] J. D. Lawson, Generalized Runge-Kutta processes for stable systems with large Lipschitz constants, SIAM Journal
   on Numerical Analysis 4 (1967) 372-380.
"""

from timesim.runtime import Leaf  # isort: skip

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from timesim.engine.barrier import apart
from timesim.engine.law.contact_law import ContactLaw, Dynamics, Motion, Path, State
from timesim.engine.system import Point, System

FAST = 0.5
"""Angle in a step [rad] from which on a mode turns. Of a slower one Runge-Kutta's error is small; where the force of a
stiff contact and that of the structure nearly cancel it is smaller than here, where each is followed by itself."""


def turned(rate: Any, q: Any, p: Any, time: Any, numpy: Any = jnp) -> tuple[Any, Any]:
    """Displacement and velocity after a time, or before it where it is negative, of modes that turn at these rates.

    A mode whose rate is zero stays where it is.
    """
    cosine, sine = numpy.cos(rate * time), numpy.sin(rate * time)
    return _turned(rate, (cosine, sine), q, p, numpy)


def _turned(rate: Any, angle: tuple[Any, Any], q: Any, p: Any, numpy: Any = jnp) -> tuple[Any, Any]:
    """The same by the cosine and the sine of the angle."""
    cosine, sine = angle
    return cosine * q + sine / numpy.where(rate > 0, rate, 1.0) * p, cosine * p - rate * sine * q


def turning_rates(stiffness: Any, h: Any, numpy: Any = jnp) -> Any:
    """Rates at which modes turn over steps of length h: their own where they are fast, else 0."""
    root = numpy.sqrt(stiffness)
    return numpy.where(root * h > FAST, root, 0.0)


@apart
def _cosine_and_sine(rate: Array, time: Array) -> tuple[Array, Array]:
    return jnp.cos(rate * time), jnp.sin(rate * time)


class Turning(Dynamics):
    """A system whose point is told by where its fast modes were at the start of a step, had they vibrated freely since.

    Attributes:
        system: the system.
        origin: the start.
        rates: of the modes, see `turning_rates`.
    """

    law: ContactLaw
    system: System
    origin: Float[Leaf, ""]
    rates: Float[Leaf, " mode"]

    @classmethod
    def of(cls, system: System, origin: Array, h: Array) -> "Turning":
        """For a step of length h."""
        return cls(system.law, system, origin, turning_rates(system.stiffness, h))

    def real(self, time: Float[Array, ""], point: Point) -> Point:
        """The point as the system has it at a time."""
        return Point(*_turned(self.rates, self._angle(time), point.q, point.p), point.w, None)

    def field(self, state: State, time: Float[Array, ""], point: Point) -> Point:
        turns, (cosine, sine) = self.rates > 0, self._angle(time)
        here = Point(*_turned(self.rates, (cosine, sine), point.q, point.p), point.w, None)
        rate = self.system.field(state, time, here)
        left = jnp.where(turns, 0.0, rate.q), rate.p + jnp.where(turns, self.system.stiffness, 0.0) * here.q
        return Point(*_turned(self.rates, (cosine, -sine), *left), rate.w, None)

    def _angle(self, time: Float[Array, ""]) -> tuple[Array, Array]:
        """Cosine and sine of the angle by which each mode has turned."""
        return _cosine_and_sine(self.rates, time - self.origin)

    def motion(self, point: Point) -> Motion:
        return self.system.motion(point)

    def path(self, point: Point, rate: Point) -> Path:
        return self.system.path(point, rate)
