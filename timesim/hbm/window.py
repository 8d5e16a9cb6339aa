"""Where a contact is closed between two samples, by the cubics through the motion and its rates at both."""

import timesim.runtime  # noqa: F401  isort: skip

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool

from timesim.engine.barrier import apart
from timesim.engine.law.contact_law import Scalar

# Newton's method from a secant or a parabola; the last step alone carries derivatives, exact at a root.
MAX_NEWTON = 3

Flag = Bool[Array, "*contact"]


class Cubic(eqx.Module):
    """c0 + c1 t + c2 t^2 + c3 t^3 over an interval, t from 0 to 1."""

    c0: Scalar
    c1: Scalar
    c2: Scalar
    c3: Scalar

    def value(self, t: Scalar) -> Scalar:
        return self.c0 + t * (self.c1 + t * (self.c2 + t * self.c3))

    def rate(self, t: Scalar) -> Scalar:
        return self.c1 + t * (2 * self.c2 + 3 * t * self.c3)

    def curvature(self, t: Scalar) -> Scalar:
        return 2 * self.c2 + 6 * t * self.c3

    def scaled(self, factor: Scalar) -> "Cubic":
        return Cubic(factor * self.c0, factor * self.c1, factor * self.c2, factor * self.c3)

    def plus(self, other: "Cubic") -> "Cubic":
        return Cubic(self.c0 + other.c0, self.c1 + other.c1, self.c2 + other.c2, self.c3 + other.c3)


def cubic_through(first: Scalar, change: Scalar, rate0: Scalar, rate1: Scalar) -> Cubic:
    """The cubic with a value at 0, its change up to 1 and the rates at both (Hermite)."""
    return Cubic(first, rate0, 3 * change - 2 * rate0 - rate1, rate0 + rate1 - 2 * change)


def quotient(a: Scalar, b: Scalar) -> Scalar:
    """a / b, and a where b is zero."""
    return a / jnp.where(b == 0, 1.0, b)


def summit(cubic: Cubic) -> tuple[Scalar, Flag]:
    """Where a cubic has its local maximum, and whether this lies between 0 and 1."""
    slope, bend, third = cubic.c1, 2 * cubic.c2, 3 * cubic.c3
    square = bend**2 - 4 * slope * third
    root = jnp.sqrt(jnp.maximum(square, 1e-300))
    place = jnp.where(bend < 0, quotient(2 * slope, root - bend), quotient(-(bend + root), 2 * third))
    inside = (square > 0) & (place > 0) & (place < 1) & ((bend < 0) | (third < 0))
    return jnp.where(inside, place, 0.5), inside


class Window(eqx.Module):
    """When a contact is closed in an interval: for the last time from `start` to `end`, both 1 where it is apart.

    Attributes:
        start, end: shares of the interval.
        closes, opens: whether it closes at `start`, and opens at `gap`.
        gap: where it opens: `end`, or before `start` where it opens for a moment only.
    """

    start: Scalar
    end: Scalar
    closes: Flag
    opens: Flag
    gap: Scalar

    @property
    def separation(self) -> Scalar:
        """Share of the interval spent apart."""
        return jnp.where(self.opens & (self.gap < self.start), self.start - self.gap, 1 - self.end + self.start)


@apart
def window_of(load: Cubic) -> Window:
    """When a contact is closed whose normal load is a cubic where it is positive."""
    load0, load1 = load.c0, load.value(jnp.ones_like(load.c0))
    was, stays = load0 > 0, load1 > 0
    once = was != stays
    # Away from contact, or into it, and back again.
    hump = load.scaled(jnp.where(was, -1.0, 1.0))
    top, inside = summit(hump)
    height = hump.value(top)
    twice = ~once & inside & (height > 0)
    half = jnp.sqrt(quotient(jnp.where(twice, 2 * height, 1.0), jnp.where(twice, -hump.curvature(top), 1.0)))
    first = jnp.where(once, quotient(load0, load0 - load1), top - half)
    first = _root(load, first, jnp.zeros_like(top), jnp.where(once, 1.0, top), once | twice)
    second = _root(load, top + half, top, jnp.ones_like(top), twice)
    start = jnp.where(twice & was, second, jnp.where(was, 0.0, jnp.where(once | twice, first, 1.0)))
    end = jnp.where(twice & ~was, second, jnp.where(was & ~stays, first, 1.0))
    return Window(start, end, (once & stays) | twice, (once & was) | twice, jnp.where(twice & was, first, end))


def _root(load: Cubic, guess: Scalar, low: Scalar, high: Scalar, sought: Flag) -> Scalar:
    place = jnp.clip(stop_gradient(guess), low, high)
    for _ in range(MAX_NEWTON):
        place = stop_gradient(place)
        rate = load.rate(place)
        step = jnp.where(sought & (rate != 0), quotient(load.value(place), rate), 0.0)
        place = jnp.clip(place - step, stop_gradient(low), stop_gradient(high))
    return place
