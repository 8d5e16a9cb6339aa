"""The path of a contact between two samples: cubics through the motion and its rates at both, when the contact is
closed on it, and how the direction of slip turns along it.

W. Magnus, On the exponential solution of differential equations for a linear operator, Comm. Pure Appl. Math. 7 (1954)
649-673, for the turn under a weak pull.
"""

import timesim.runtime  # noqa: F401  isort: skip

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool

from timesim.engine.barrier import apart
from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Motion, Plane, Scalar, dot, length, minus, product, scaled, where

# Iterations from a secant or a parabola; one more carries the derivatives, exact at a root.
MAX_NEWTON = 6
# Least load in slip, relative to that at its other end, whose inverse is integrated.
LEAST = 1e-12
# Pull, integrated over time, below which what its turn leaves behind is that of Magnus' series, and about which the
# description changes to that of a strong one.
WEAK, STRONG = 1e-4, 6.0
# Share of the distance of two samples before a contact opens, over which its slip keeps its direction.
LATE = 0.25

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


@apart
def _root(load: Cubic, guess: Scalar, low: Scalar, high: Scalar, sought: Flag) -> Scalar:
    """The place between two where a cubic changes its sign: Newton's method, or bisection where it leaves them."""
    first, last = stop_gradient(low), stop_gradient(high)
    place, low, high = jnp.clip(stop_gradient(guess), first, last), first, last
    rises = load.value(high) > load.value(low)
    for _ in range(MAX_NEWTON):
        value, rate = stop_gradient(load.value(place)), stop_gradient(load.rate(place))
        below = (value > 0) != rises
        low, high = jnp.where(below, place, low), jnp.where(below, high, place)
        better = place - quotient(value, rate)
        place = jnp.where((better >= low) & (better <= high), better, (low + high) / 2)
    rate = load.rate(place)
    step = jnp.where(sought & (rate != 0), quotient(load.value(place), rate), 0.0)
    return jnp.clip(place - step, first, last)


class Path(eqx.Module):
    """Motion over an interval: u since its start, mu n and v; `bend` is the change of the rate of u."""

    u: tuple[Cubic, ...]
    limit: Cubic
    v: Cubic
    bend: Plane

    def at(self, t: Scalar) -> Plane:
        return tuple(u.value(t) for u in self.u)

    def curvature(self, t: Scalar) -> Plane:
        return tuple(u.curvature(t) for u in self.u)

    def rates(self, t: Scalar) -> Motion:
        du, dv = tuple(u.rate(t) for u in self.u), self.v.rate(t)
        return Motion(du, dv, du, dv)


def direction_of(force: Plane, instead: Plane) -> Plane:
    """Unit vector along the one, or along the other where the one vanishes, or anywhere where both do."""
    chosen = where(dot(force, force) < 1e-280, instead, force)
    chosen = where(dot(chosen, chosen) < 1e-280, (jnp.ones_like(chosen[0]),) * 2, chosen)
    return scaled(1 / length(chosen), chosen)


@apart
def turned(law: ConeLaw, path: Path, e: Plane, start: Scalar, end: Scalar) -> Plane:
    """Direction of slip at the end of a part of the interval, from that at its start.

    Where K_u is not isotropic the turn over the whole part errs by the third power of its length, that over both halves
    by a quarter of this, and what follows from the two by the fourth (L. F. Richardson, Phil. Trans. R. Soc. A 210
    (1911) 307-357).

    Right before the contact opens the direction stays as it is. Slip against the pull, kept up by a falling load, lasts
    to the opening along a straight path, but is unstable: next to n = 0 rounding alone would decide where it turns.
    """
    falls = -path.limit.rate(end)
    left = quotient(path.limit.value(end), falls)
    end = jnp.where((falls > 0) & (left < LATE), jnp.maximum(end + left - LATE, start), end)
    if len(law.stiffness) == 1:
        return _turned_at_once(law, path, e, start, end)
    middle = (start + end) / 2

    def onwards(k: Array, found: tuple[Plane, Plane]) -> tuple[Plane, Plane]:
        whole, half = found
        second, begin = k == 2, jnp.where(k == 2, middle, start)
        new = _turned_at_once(law, path, where(second, half, e), begin, jnp.where(k == 1, middle, end))
        return where(k == 0, new, whole), new

    # The whole, the first half and the second, in a loop: each call would be compiled anew.
    whole, halves = jax.lax.fori_loop(0, 3, onwards, (e, e))
    return direction_of(tuple(y + (y - x) / 3 for x, y in zip(whole, halves, strict=True)), halves)


@apart
def _turned_at_once(law: ConeLaw, path: Path, e: Plane, start: Scalar, end: Scalar) -> Plane:
    """The same with the part of K_u that is not isotropic as it is midway.

    With the pull p, the direction of z, and ``z`` its integral over time, where the pull is weak ``far``: the direction
    turns towards that of z, and by ``z x dz / 12`` as the pull turns (Magnus' series). Where it is strong, as next to
    n = 0, ``near``: the angle psi between both obeys ``psi' = -(|z| / n) psi - p'`` and decays; what the turn of the
    pull leaves behind is exact for a load that is linear, also where slip begins with contact.
    """
    none = (jnp.zeros_like(start),) * 2
    change, rest = minus(path.at(end), path.at(start)), end - start
    limit0, limit1 = path.limit.value(start), path.limit.value(end)
    sum_of_both = jnp.abs(limit0) + jnp.abs(limit1)
    least = jnp.where(sum_of_both > 0, LEAST * sum_of_both, 1.0)
    limit0, limit1 = jnp.maximum(limit0, least), jnp.maximum(limit1, least)
    inverse, lever = _mean_inverse(limit0, limit1)
    latest, ahead, weight_left = limit1 * inverse, (limit1 - limit0) * inverse, 0.5 - lever / inverse
    # The load is not quite linear: Simpson's rule for what that changes.
    middle = jnp.maximum(path.limit.value((start + end) / 2), least)
    inverse = inverse + (1 / middle - 2 / (limit0 + limit1)) * (2 / 3)
    bend = scaled(rest**2, path.bend)
    change_along = tuple(inverse * x + lever * y for x, y in zip(change, bend, strict=True))
    if len(law.stiffness) == 1:
        z, dz, drift = product(law.stiffness, change_along), scaled(inverse, product(law.stiffness, bend)), none
    else:
        growth = inverse * (limit1 - limit0)
        halfway = _turned_by(e, scaled(_weight(law, e) / 2, minus(change_along, scaled(growth, _drift(law, e)))))
        drift = _drift(law, halfway)
        z = scaled(_weight(law, halfway), minus(change_along, scaled(growth, drift)))
        dz = scaled(inverse * _weight(law, halfway), bend)
    size = length(z)
    decay = jnp.exp(-size)
    late = latest * _mean_decay(size + ahead)
    p0, p1 = (direction_of(minus(path.rates(t).du, scaled(path.limit.rate(t), drift)), e) for t in (start, end))
    strong = 1 / (1 + (STRONG / jnp.maximum(size, 1e-30)) ** 8)
    near = _turned_by(_rotated(e, p0, p1), scaled(size, p1))
    angle = late * jnp.arctan2(p0[0] * p1[1] - p0[1] * p1[0], dot(p0, p1))
    near = _rotated(near, (jnp.cos(angle), jnp.sin(angle)), (jnp.ones_like(angle), jnp.zeros_like(angle)))
    left = decay - late + weight_left * (1 - decay)
    share = jnp.where(size > WEAK, left / jnp.maximum(size, WEAK) ** 2, 1 / 12)
    angle = (z[0] * dz[1] - z[1] * dz[0]) * share
    along = _turned_by(e, z)
    far = (along[0] - angle * along[1], along[1] + angle * along[0])
    mixed = tuple((1 - strong) * x + strong * y for x, y in zip(far, near, strict=True))
    return direction_of(mixed, near)


def _rotated(e: Plane, before: Plane, after: Plane) -> Plane:
    """A vector turned by the angle between two unit vectors."""
    c, s = dot(before, after), before[0] * after[1] - before[1] * after[0]
    return (c * e[0] - s * e[1], s * e[0] + c * e[1])


def _mean_decay(x: Scalar) -> Scalar:
    """(1 - exp(-x)) / x."""
    small = jnp.abs(x) < 1e-5
    return jnp.where(small, 1 - x / 2, -jnp.expm1(-x) / jnp.where(small, 1.0, x))


def _turned_by(e: Plane, z: Plane) -> Plane:
    """Solution of e' = (1 - e e^T) z after a unit of time, z constant."""
    size = length(z)
    loss = -jnp.expm1(-size)
    once, decay = loss / size, 1 - loss
    along, twice = dot(e, z), once * (1 + decay)
    share = twice + along * once**2
    norm = 1 + decay**2 + along * twice
    return tuple((2 * decay * x + share * y) / norm for x, y in zip(e, z, strict=True))


def _weight(law: ConeLaw, e: Plane) -> Scalar:
    """1 / (e_t . C e_t)."""
    across = law.compliance[0] + law.compliance[2] - dot(e, product(law.compliance, e))
    return 1 / jnp.where(across > 0, across, 1.0)


def _drift(law: ConeLaw, e: Plane) -> Plane:
    """C e without the isotropic part of C, which turns nothing."""
    return minus(product(law.compliance, e), scaled((law.compliance[0] + law.compliance[2]) / 2, e))


def _mean_inverse(a: Scalar, b: Scalar) -> tuple[Scalar, Scalar]:
    """Mean of 1/x over x from a to b, ``m = log(b / a) / (b - a)``, and that of t/x, t from -1/2 to 1/2 along with x.

    The latter is ``(1 - m (a + b) / 2) / (b - a)``.
    """
    ratio, total = (b - a) / (b + a), a + b
    small = jnp.abs(ratio) < 1e-2
    square, rise = ratio**2, jnp.where(small, 1.0, b - a)
    series = 1 / 3 + square * (1 / 5 + square * (1 / 7 + square / 9))
    mean = jnp.where(small, (1 + square * series) * 2 / total, jnp.log(b / a) / rise)
    return mean, jnp.where(small, -ratio * series / total, (1 - mean * total / 2) / rise)
