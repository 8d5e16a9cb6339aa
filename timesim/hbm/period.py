"""Contact forces through one period of a given relative motion, on equal time samples.

The law is that of `engine.law.cone`. Between two samples the path of (u, v) is taken as straight; along it the law is
solved without further error, so the scheme is of second order, and of third in slip under constant load, where the turn
of the path is put right. With the elastic displacement ``d = u - w``, the
friction force ``f = K_u d`` and primes for rates along the interval,

    stick       d' = u'; the cone |K_u d| = mu n is reached at the root of a quadratic
    slip        K_u d = mu n e,   e' = (1 - e e^T) z / (mu n),   z = (u' - mu n' C e) / (e_t . C e_t),   C = K_u^-1
    separation  d = 0; n = 0 is reached at the root of a linear function, and slip starts along the incipient direction

where ``e_t`` is normal to ``e``. For an isotropic K_u the direction of slip follows in closed form: ``z = K_u u'``, and
over an interval ``e`` turns towards it without further error, however small n is. For others the part of C that is not
isotropic is evaluated midway. Along a straight path the slip speed never falls, so slip ends at a sample, where its
speed and the error of doing so vanish together.

A contact that can stick all along does, with the offset of `timesim.hbm.stuck_offset`. Any other begins the period with
``w = 0``, put on the cone where it would lie outside, and the period is repeated until the elastic displacement at its
end is that at its start.
"""

import timesim.runtime  # noqa: F401  isort: skip

from dataclasses import dataclass
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from timesim.engine.law.cone import ConeLaw, incipient_direction, normal_load
from timesim.engine.law.contact_law import Motion, Plane, Scalar, dot, length, minus, product, scaled, where
from timesim.hbm.stuck_offset import Offset, stuck_offset
from timesim.orbit.fourier import fourier_basis

MAX_PASSES = 100
# Change of d over a period, relative to the largest d, that counts as none; rounding adds to it with |u|.
CLOSED = 1e-12
ROUNDING = 1e-14
# An interval that slips but for less than this share of it slips all along: the time at which slip begins is rounded.
WHOLE = 1 - 1e-9
# Relative excess of |f|^2 over (mu n)^2 up to which a contact at rest on its cone does not slip: rounding.
GRAZING = 1e-11


@dataclass(frozen=True)
class Basis:
    """Harmonic functions 1, cos, sin, ..., cos H theta, sin H theta at the samples, the last one at 2 pi.

    Attributes:
        value: shape (N, 2H + 1).
        project: Fourier coefficients from samples, shape (2H + 1, N).
    """

    value: NDArray[np.float64]
    project: NDArray[np.float64]


@lru_cache(maxsize=64)
def basis_of(harmonics: int, time_samples: int) -> Basis:
    """The functions of H harmonics on N equal samples."""
    theta = 2 * np.pi * np.arange(1, time_samples + 1) / time_samples
    value = fourier_basis(theta, 2 * harmonics + 1)
    weight = np.append(1.0, np.full(2 * harmonics, 2.0)) / time_samples
    return Basis(value, weight[:, None] * value.T)


class Interval(eqx.Module):
    """Motion from one sample to the next: change of u, the change of this change, and v at both ends."""

    change: Plane
    bend: Plane
    v0: Scalar
    v1: Scalar


class IntervalEnd(eqx.Module):
    """Elastic displacement at the end of an interval, and the shares of it spent in slip and in separation."""

    d: Plane
    slip: Scalar
    separation: Scalar


def intervals_of(motion: Motion) -> Interval:
    """The intervals that end at each sample of a periodic motion, shape (N, C)."""
    change = tuple(change_of(u) for u in motion.u)
    return Interval(change, tuple(bend_of(c) for c in change), jnp.roll(motion.v, 1, axis=0), motion.v)


def change_of(u: Array) -> Array:
    """From the sample before to each sample, along the first axis, of a period."""
    return u - jnp.roll(u, 1, axis=0)


def bend_of(change: Array) -> Array:
    """The change over an interval of the change from sample to sample."""
    return (jnp.roll(change, -1, axis=0) - jnp.roll(change, 1, axis=0)) / 2


def _turned_by(e: Plane, z: Plane) -> Plane:
    """Solution of e' = (1 - e e^T) z after a unit of time, z constant."""
    size = length(z)
    loss = -jnp.expm1(-size)
    once, decay = loss / size, 1 - loss
    along, twice = dot(e, z), once * (1 + decay)
    share = twice + along * once**2
    norm = 1 + decay**2 + along * twice
    return tuple((2 * decay * x + share * y) / norm for x, y in zip(e, z, strict=True))


def _pull(law: ConeLaw, e: Plane, growth: Scalar) -> tuple[Scalar, Plane]:
    """z mu n = weight (u' - drift), without the isotropic part of C in the drift, which turns nothing."""
    ce = product(law.compliance, e)
    trace = law.compliance[0] + law.compliance[2]
    return 1 / (trace - dot(e, ce)), scaled(growth, minus(ce, scaled(trace / 2, e)))


def _veered(e: Plane, z: Plane, dz: Plane) -> Plane:
    """Direction corrected for a z that changes by dz over the interval: the commutator of Magnus' series.

    For a small |z| the angle is z x dz / 12; for a large one, where e is that of z at the end, z x dz / (2 |z|^2).
    """
    if len(e) == 1:
        return e
    angle = (z[0] * dz[1] - z[1] * dz[0]) / (12 + 2 * dot(z, z))
    turned = (e[0] - angle * e[1], e[1] + angle * e[0])
    return scaled(1 / jnp.sqrt(1 + angle**2), turned)


def _turned(law: ConeLaw, e: Plane, interval: Interval, growth: Scalar, span: Scalar, rest: Scalar) -> Plane:
    """Direction of slip over the `rest` of an interval; `span` is the integral of 1 / (mu n) over it."""
    if len(law.stiffness) == 1:
        z = scaled(span, product(law.stiffness, interval.change))
        return _veered(_turned_by(e, z), z, scaled(span * rest, product(law.stiffness, interval.bend)))
    weight, bare = _pull(law, e, growth)
    middle = _turned_by(e, scaled(span / 2 * weight, minus(interval.change, bare)))
    weight, bare = _pull(law, middle, growth)
    z = scaled(span * weight, minus(interval.change, bare))
    return _veered(_turned_by(e, z), z, scaled(span * rest * weight, interval.bend))


def _mean_inverse(a: Scalar, b: Scalar) -> Scalar:
    """Mean of 1/x over x from a to b: log(b / a) / (b - a)."""
    ratio = (b - a) / (b + a)
    small = jnp.abs(ratio) < 1e-2
    square = ratio**2
    series = 1 + square * (1 / 3 + square * (1 / 5 + square * (1 / 7 + square / 9)))
    return jnp.where(small, series * 2 / (a + b), jnp.log(b / a) / jnp.where(small, 1.0, b - a))


def _cone_exit(rise: Scalar, half_slope: Scalar, start: Scalar) -> Scalar:
    """Root of ``rise t^2 + 2 half_slope t + start`` through which it rises, given start <= 0 and a positive end."""
    root = jnp.sqrt(jnp.maximum(half_slope**2 - rise * start, 1e-300))
    ahead = half_slope > 0
    late = (root - half_slope) / jnp.where(ahead, 1.0, rise)
    early = -start / jnp.where(ahead, half_slope + root, 1.0)
    return jnp.clip(jnp.where(ahead, early, late), 0.0, 1.0)


def advance(law: ConeLaw, d: Plane, interval: Interval) -> IntervalEnd:
    """The law over one interval, from the elastic displacement at its start."""
    load0, load1 = normal_load(law, interval.v0), normal_load(law, interval.v1)
    limit0, limit1 = law.friction * load0, law.friction * load1
    root = load0 / jnp.where(load0 == load1, 1.0, load0 - load1)
    was, stays, rubs = load0 > 0, load1 > 0, law.friction > 0
    closed, leave = _in_contact(law, d, interval, limit0, limit1)
    fresh, grips = _touching(law, interval, root, limit0, limit1)
    d = where(was, closed, fresh)
    d = where(stays & rubs, d, (jnp.zeros_like(limit1),) * len(d))
    leave = jnp.where(was, leave, jnp.where(grips, 1.0, root))
    first = jnp.where(was, 0.0, jnp.where(stays, root, 1.0))
    last = jnp.where(was & ~stays, root, 1.0)
    slip = jnp.maximum(last - jnp.where(rubs, jnp.maximum(leave, first), first), 0.0)
    return IntervalEnd(d, slip, first + 1 - last)


def _in_contact(law: ConeLaw, d: Plane, interval: Interval, limit0: Scalar, limit1: Scalar) -> tuple[Plane, Scalar]:
    """From contact to contact: d at the end, and where along the interval slip began (1 in stick)."""
    growth = limit1 - limit0
    force, pull = product(law.stiffness, d), product(law.stiffness, interval.change)
    rise, half_slope = dot(pull, pull) - growth**2, dot(force, pull) - limit0 * growth
    start = jnp.minimum(dot(force, force) - limit0**2, 0.0)
    slides = rise + 2 * half_slope + start > GRAZING * limit1**2
    leave = _cone_exit(rise, half_slope, start)
    on_cone = tuple(f + leave * p for f, p in zip(force, pull, strict=True))
    span = (1 - leave) * _mean_inverse(limit0 + leave * growth, limit1)
    e = _turned(law, scaled(1 / length(on_cone), on_cone), interval, growth, span, 1 - leave)
    stuck = tuple(x + y for x, y in zip(d, interval.change, strict=True))
    end = where(slides, product(law.compliance, scaled(limit1, e)), stuck)
    return end, jnp.where(slides | (limit1 <= 0), leave, 1.0)


def _touching(
    law: ConeLaw, interval: Interval, root: Scalar, limit0: Scalar, limit1: Scalar
) -> tuple[Plane, Bool[Array, "*contact"]]:
    """From separation to contact at `root`: d at the end, and whether it sticks (15) or slips in one direction (17)."""
    rates = Motion(interval.change, interval.v1, interval.change, interval.v1 - interval.v0)
    pull = product(law.stiffness, interval.change)
    grips = length(pull) < limit1 - limit0
    slid = product(law.compliance, scaled(limit1, incipient_direction(law, rates)))
    return where(grips, scaled(1 - root, interval.change), slid), grips


def onto_cone(law: ConeLaw, d: Plane, v: Scalar) -> Plane:
    """An elastic displacement, shortened to the cone where its force lies outside; zero in separation."""
    limit = law.friction * jnp.maximum(normal_load(law, v), 0.0)
    force = length(product(law.stiffness, d))
    return scaled(jnp.where(force > limit, limit / force, jnp.where(law.friction > 0, 1.0, 0.0)), d)


class ClosedPeriod(eqx.Module):
    """A period at whose end the elastic displacement is that at its start; N samples, C contacts.

    Attributes:
        start: elastic displacement at the start, shape (C,).
        ends: the same at the end of each interval, and its shares, shape (N, C).
        force: (f1, f2, n) at the samples, n not less the preload, shape (N, C, 3).
        slip, separation: shares of the period, shape (C,).
        closure: change of d over the period over the tolerated one, at most 1 where it closed, shape (C,).
        passes: through the period.
        stuck: which contacts stick all along, and the offset of their force.
    """

    start: Plane
    ends: IntervalEnd
    force: Float[Array, "sample contact 3"]
    slip: Float[Array, " contact"]
    separation: Float[Array, " contact"]
    closure: Float[Array, " contact"]
    passes: Int[Array, ""]
    stuck: Offset


def one_pass(law: ConeLaw, start: Plane, intervals: Interval) -> tuple[Plane, IntervalEnd]:
    """Through the period: d at its end, and the ends of all intervals."""

    def step(d: Plane, interval: Interval) -> tuple[Plane, IntervalEnd]:
        end = advance(law, d, interval)
        return end.d, end

    return jax.lax.scan(step, start, intervals)


class _Passes(eqx.Module):
    """Passes so far: where the next one starts, and start, end and intervals of the last one."""

    next_start: Plane
    start: Plane
    end: Plane
    path: IntervalEnd
    closure: Scalar
    count: Scalar


@jax.jit
def closed_period(law: ConeLaw, motion: Motion) -> ClosedPeriod:
    """Pass through a periodic motion, shape (N, C), until d closes, at most `MAX_PASSES` times.

    A contact that can stick all along enters with the offset of `timesim.hbm.stuck_offset` and does. The others are
    accelerated from the third pass on (D. G. Anderson, J. ACM 12 (1965) 547, with one pass remembered): slip maps the
    plane on a curve, so the change over a pass has one direction. One program serves any number of harmonics.
    """
    intervals = intervals_of(motion)
    stuck = stuck_offset(law, motion)
    elastic = tuple(u[-1] + c for u, c in zip(motion.u, product(law.compliance, stuck.force), strict=True))
    first_start = onto_cone(law, elastic, motion.v[-1])
    reach = jnp.max(length(motion.u), axis=0)

    def again(last: _Passes) -> _Passes:
        start = last.next_start
        end, path = one_pass(law, start, intervals)
        change, before = minus(end, start), minus(last.end, last.start)
        tolerated = CLOSED * jnp.max(length(path.d), axis=0) + ROUNDING * reach
        closure = length(change) / jnp.maximum(tolerated, 1e-300)
        bend = minus(change, before)
        ratio = dot(change, bend) / jnp.maximum(dot(bend, bend), 1e-300)
        usable = (last.count >= 2) & (dot(change, change) < dot(before, before))
        leap = scaled(jnp.where(usable, ratio, 0.0), minus(end, last.end))
        next_start = onto_cone(law, minus(end, leap), motion.v[-1])
        return _Passes(next_start, start, end, path, closure, last.count + 1)

    path = IntervalEnd(motion.u, motion.v, motion.v)
    none = _Passes(first_start, first_start, first_start, path, jnp.full_like(reach, jnp.inf), jnp.asarray(0))
    last = jax.lax.while_loop(lambda last: jnp.any(last.closure > 1) & (last.count < MAX_PASSES), again, none)
    force = jnp.stack([*product(law.stiffness, last.path.d), jnp.maximum(normal_load(law, motion.v), 0.0)], axis=2)
    shares = _share(last.path.slip), _share(last.path.separation)
    return ClosedPeriod(last.start, last.path, force, *shares, last.closure, last.count, stuck)


def _share(part: Float[Array, "sample contact"]) -> Float[Array, " contact"]:
    """Share of the period; exactly 1 where it is the whole of every interval."""
    return jnp.where(jnp.all(part > WHOLE, axis=0), 1.0, jnp.mean(part, axis=0))


@dataclass(frozen=True)
class ContactForces:
    """Forces and states of the contacts over a period.

    Attributes:
        coefficient: of (f1, f2, n), n not less the preload, shape (C, 3, 2H + 1).
        slip, separation: shares of the period, shape (C,).
        closure, passes: as in `ClosedPeriod`.
    """

    coefficient: NDArray[np.float64]
    slip: NDArray[np.float64]
    separation: NDArray[np.float64]
    closure: NDArray[np.float64]
    passes: int


def motion_of(basis: Basis, coefficient: NDArray[np.float64]) -> Motion:
    """Relative motion at the samples, shape (N, C), from (u1, u2, v), shape (C, 3, 2H + 1); no rates."""
    u1, u2, v = (basis.value @ coefficient[:, i].T for i in range(3))
    return Motion((u1, u2), v, (), v)


def starts_of(period: ClosedPeriod) -> Plane:
    """Elastic displacement at the start of each interval, shape (N, C)."""
    pairs = zip(period.start, period.ends.d, strict=True)
    return tuple(np.concatenate([np.asarray(first)[None], np.asarray(d)[:-1]]) for first, d in pairs)


def touching_stiffness(law: ConeLaw, period: ClosedPeriod) -> NDArray[np.float64]:
    """The normal stiffness that acts at each sample, shape (N, C)."""
    return (np.asarray(period.force)[:, :, 2] > 0) * np.asarray(law.normal_stiffness)


def forces_of(basis: Basis, period: ClosedPeriod) -> ContactForces:
    """Forces and shares of a closed period."""
    coefficient = np.moveaxis(np.tensordot(basis.project, np.asarray(period.force), 1), 0, 2)
    shares = np.asarray(period.slip), np.asarray(period.separation)
    return ContactForces(coefficient, *shares, np.asarray(period.closure), int(period.passes))


def contact_forces(law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64]) -> ContactForces:
    """Contact forces of a motion given by its Fourier coefficients (u1, u2, v), shape (C, 3, 2H + 1)."""
    return forces_of(basis, closed_period(law, motion_of(basis, coefficient)))
