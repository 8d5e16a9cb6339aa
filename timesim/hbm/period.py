"""Contact forces through one period of a given relative motion, on equal time samples.

The law is that of `engine.contact`. Between two samples the path of (u, v) is taken as straight; along it the law is
solved without further error, so the scheme is of second order, and of third in slip under constant load, where the turn
of the path is put right. With the elastic displacement ``d = u - w``, the
friction force ``f = K_u d`` and primes for rates along the interval,

    stick       d' = u'; the cone |K_u d| = mu n is reached at the root of a quadratic
    slip        K_u d = mu n e,   e' = (1 - e e^T) z / (mu n),   z = (u' - mu n' C e) / (e_t . C e_t),   C = K_u^-1
    separation  d = 0; n = 0 is reached at the root of a linear function, and slip starts along the incipient direction

where ``e_t`` is normal to ``e``. For an isotropic K_u the direction of slip follows in closed form: ``z = K_u u'``, and
over an interval ``e`` is turned towards it as light is by aberration, however small n is. For others the part of C
that is not isotropic is evaluated midway. Along a straight path the slip speed never falls, so slip ends at a sample,
where its speed and the error so made vanish together.

A contact that may stick all along does, with the offset of `timesim.hbm.stuck_offset`. Any other enters the period from
``w = 0``, put on the cone where it would lie outside, and goes through it again until the elastic displacement closes.
"""

import timesim.runtime  # noqa: F401  isort: skip

from functools import lru_cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from timesim.engine.contact import ConeLaw, incipient_direction, normal_load
from timesim.engine.contact_law import Motion, Plane, Scalar, dot, length, minus, product, scaled, where
from timesim.hbm.stuck_offset import Offset, stuck_offset

MAX_PASSES = 100
# Change of d over a period, relative to the largest d, that counts as none; rounding adds to it with |u|.
CLOSED = 1e-12
ROUNDING = 1e-14
# Excess of |f|^2 over (mu n)^2, relative, that is no slip: what a contact left at rest on its cone shows by rounding.
GRAZING = 1e-11


class Basis(eqx.Module):
    """Harmonic functions 1, cos, sin, ..., cos H theta, sin H theta at the samples, the last one at 2 pi.

    Attributes:
        value: shape (N, 2H + 1).
        project: Fourier coefficients from samples, shape (2H + 1, N).
    """

    value: Float[Array, "sample coefficient"]
    project: Float[Array, "coefficient sample"]


@lru_cache(maxsize=64)
def basis_of(harmonics: int, time_samples: int) -> Basis:
    """The functions of H harmonics on N equal samples."""
    theta = 2 * np.pi * np.arange(1, time_samples + 1) / time_samples
    angle = np.outer(theta, np.arange(1, harmonics + 1))
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(time_samples, -1)
    value = np.concatenate([np.ones((time_samples, 1)), waves], axis=1)
    weight = np.append(1.0, np.full(2 * harmonics, 2.0)) / time_samples
    return Basis(jnp.asarray(value), jnp.asarray(weight[:, None] * value.T))


class Interval(eqx.Module):
    """Motion from one sample to the next: change of u, how this changes itself, and v at both ends."""

    change: Plane
    bend: Plane
    v0: Scalar
    v1: Scalar


class Stay(eqx.Module):
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
    """How much the change from sample to sample changes itself over an interval."""
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


def carried(law: ConeLaw, d: Plane, interval: Interval) -> Stay:
    """One interval of the law from the elastic displacement at its start."""
    load0, load1 = normal_load(law, interval.v0), normal_load(law, interval.v1)
    limit0, limit1 = law.friction * load0, law.friction * load1
    root = load0 / jnp.where(load0 == load1, 1.0, load0 - load1)
    was, stays, rubs = load0 > 0, load1 > 0, law.friction > 0
    held, leave = _in_contact(law, d, interval, limit0, limit1)
    fresh, grips = _touching(law, interval, root, limit0, limit1)
    d = where(was, held, fresh)
    d = where(stays & rubs, d, (jnp.zeros_like(limit1),) * len(d))
    leave = jnp.where(was, leave, jnp.where(grips, 1.0, root))
    first = jnp.where(was, 0.0, jnp.where(stays, root, 1.0))
    last = jnp.where(was & ~stays, root, 1.0)
    slip = jnp.maximum(last - jnp.where(rubs, jnp.maximum(leave, first), first), 0.0)
    return Stay(d, slip, first + 1 - last)


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
    held = where(slides, product(law.compliance, scaled(limit1, e)), stuck)
    return held, jnp.where(slides | (limit1 <= 0), leave, 1.0)


def _touching(
    law: ConeLaw, interval: Interval, root: Scalar, limit0: Scalar, limit1: Scalar
) -> tuple[Plane, Bool[Array, "*contact"]]:
    """From separation to contact at `root`: d at the end, and whether it sticks (15) or slips in one direction (17)."""
    rates = Motion(interval.change, interval.v1, interval.change, interval.v1 - interval.v0)
    pull = product(law.stiffness, interval.change)
    grips = length(pull) < limit1 - limit0
    slid = product(law.compliance, scaled(limit1, incipient_direction(law, rates)))
    return where(grips, scaled(1 - root, interval.change), slid), grips


def settled(law: ConeLaw, d: Plane, v: Scalar) -> Plane:
    """An elastic displacement, shortened to the cone where its force lies outside; zero in separation."""
    limit = law.friction * jnp.maximum(normal_load(law, v), 0.0)
    force = length(product(law.stiffness, d))
    return scaled(jnp.where(force > limit, limit / force, jnp.where(law.friction > 0, 1.0, 0.0)), d)


class Period(eqx.Module):
    """A period that closes.

    Attributes:
        begin: elastic displacement where it begins, shape (C,).
        d: the same at the samples, shape (N, C).
        gap: change of d over the period over what is tolerated, at most 1 where it closed, shape (C,).
        passes: how often it was gone through.
        held: which contacts stick all along, and the offset of their force.
    """

    begin: Plane
    d: Plane
    gap: Float[Array, " contact"]
    passes: Int[Array, ""]
    held: Offset


def through(law: ConeLaw, begin: Plane, intervals: Interval) -> tuple[Plane, Plane]:
    """One pass: d at the end and at every sample."""

    def step(d: Plane, interval: Interval) -> tuple[Plane, Plane]:
        d = carried(law, d, interval).d
        return d, d

    return jax.lax.scan(step, begin, intervals)


class _Search(eqx.Module):
    """Passes so far: where the next one begins, and begin, end and path of the last one."""

    following: Plane
    begin: Plane
    end: Plane
    path: Plane
    gap: Scalar
    passes: Scalar


def closed_period(law: ConeLaw, motion: Motion) -> Period:
    """Go through a periodic motion, shape (N, C), until d closes, at most `MAX_PASSES` times.

    A contact that may stick all along enters with the offset of `timesim.hbm.stuck_offset` and does.
    From the third pass on the next one begins where the secant of the last two would close: slip maps the plane on a
    curve, so the change over a pass has one direction.
    """
    intervals = intervals_of(motion)
    held = stuck_offset(law, motion)
    begin = tuple(u[-1] + c for u, c in zip(motion.u, product(law.compliance, held.force), strict=True))
    start = settled(law, begin, motion.v[-1])
    reach = jnp.max(length(motion.u), axis=0)

    def again(search: _Search) -> _Search:
        begin = search.following
        end, path = through(law, begin, intervals)
        change, before = minus(end, begin), minus(search.end, search.begin)
        tolerated = CLOSED * jnp.max(length(path), axis=0) + ROUNDING * reach
        gap = length(change) / jnp.maximum(tolerated, 1e-300)
        bend = minus(change, before)
        ratio = dot(change, bend) / jnp.maximum(dot(bend, bend), 1e-300)
        usable = (search.passes >= 2) & (dot(change, change) < dot(before, before))
        leap = scaled(jnp.where(usable, ratio, 0.0), minus(end, search.end))
        following = settled(law, minus(end, leap), motion.v[-1])
        return _Search(following, begin, end, path, gap, search.passes + 1)

    first = _Search(start, start, start, motion.u, jnp.full_like(reach, jnp.inf), jnp.asarray(0))
    last = jax.lax.while_loop(lambda search: jnp.any(search.gap > 1) & (search.passes < MAX_PASSES), again, first)
    return Period(last.begin, last.path, last.gap, last.passes, held)


class Forces(eqx.Module):
    """What the contacts do over a period.

    Attributes:
        coefficient: of (f1, f2, n), n not less the preload, shape (C, 3, 2H + 1).
        slip, separation: shares of the period, shape (C,).
        gap: as in `Period`, shape (C,).
        passes: as in `Period`.
    """

    coefficient: Float[Array, "contact 3 coefficient"]
    slip: Float[Array, " contact"]
    separation: Float[Array, " contact"]
    gap: Float[Array, " contact"]
    passes: Int[Array, ""]


def motion_of(basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]) -> Motion:
    """Relative motion at the samples, shape (N, C); no rates."""
    u1, u2, v = (basis.value @ coefficient[:, i].T for i in range(3))
    return Motion((u1, u2), v, (), v)


def before_intervals(period: Period) -> Plane:
    """Elastic displacement at the start of each interval."""
    return tuple(jnp.concatenate([b[None], d[:-1]]) for b, d in zip(period.begin, period.d, strict=True))


@jax.jit
def forces(law: ConeLaw, basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]) -> Forces:
    """Contact forces of a motion given by its Fourier coefficients (u1, u2, v)."""
    motion = motion_of(basis, coefficient)
    return summary(law, basis, motion, closed_period(law, motion))


def summary(law: ConeLaw, basis: Basis, motion: Motion, period: Period) -> Forces:
    """Forces and shares of a closed period."""
    stay = jax.vmap(partial(carried, law))(before_intervals(period), intervals_of(motion))
    load = jnp.maximum(normal_load(law, motion.v), 0.0)
    samples = jnp.stack([*product(law.stiffness, period.d), load], axis=2)
    coefficient = jnp.moveaxis(jnp.tensordot(basis.project, samples, 1), 0, 2)
    shares = (jnp.mean(share, axis=0) for share in (stay.slip, stay.separation))
    return Forces(coefficient, *shares, period.gap, period.passes)
