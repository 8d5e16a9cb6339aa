"""Contact forces through one period of a given relative motion, on equal time samples.

The law over the interval between two samples is that of `timesim.hbm.interval`. A contact that can stick all along
does, with the offset of `timesim.hbm.stuck_offset`. Any other begins the period with ``w = 0``, put on the cone where
it would lie outside, and the period is repeated until the elastic displacement at its end is that at its start.
"""

import timesim.runtime  # noqa: F401  isort: skip

from dataclasses import dataclass
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from timesim.engine.law.cone import ConeLaw, normal_load
from timesim.engine.law.contact_law import Motion, Plane, Scalar, dot, length, minus, product, scaled
from timesim.hbm.interval import Interval, IntervalEnd, advance, intervals_of
from timesim.hbm.stuck_offset import Offset, stuck_offset
from timesim.orbit.fourier import fourier_basis

MAX_PASSES = 100
# Samples at which a contact must stick all along, for one of the others: between two of them a path may leave the cone.
DENSE = 4
# Change of d over a period, relative to the largest d, that counts as none; rounding adds to it with |u|.
CLOSED = 1e-12
ROUNDING = 1e-14
# An interval that slips but for less than this share of it slips all along: the time at which slip begins is rounded.
WHOLE = 1 - 1e-9


@dataclass(frozen=True)
class Basis:
    """Harmonic functions 1, cos, sin, ..., cos H theta, sin H theta at the samples, the last one at 2 pi.

    Attributes:
        value: shape (N, 2H + 1).
        rate: their derivatives, the interval between two samples as the unit of time, shape (N, 2H + 1).
        project: Fourier coefficients from samples, shape (2H + 1, N).
        dense: the functions at `DENSE` times as many samples, shape (DENSE N, 2H + 1).
    """

    value: NDArray[np.float64]
    rate: NDArray[np.float64]
    project: NDArray[np.float64]
    dense: NDArray[np.float64]


@lru_cache(maxsize=64)
def basis_of(harmonics: int, time_samples: int) -> Basis:
    """The functions of H harmonics on N equal samples."""
    theta = 2 * np.pi * np.arange(1, DENSE * time_samples + 1) / (DENSE * time_samples)
    dense = fourier_basis(theta, 2 * harmonics + 1)
    value = dense[DENSE - 1 :: DENSE]
    rate, order = np.zeros_like(value), 2 * np.pi / time_samples * np.arange(1, harmonics + 1)
    rate[:, 1::2], rate[:, 2::2] = -order * value[:, 2::2], order * value[:, 1::2]
    weight = np.append(1.0, np.full(2 * harmonics, 2.0)) / time_samples
    return Basis(value, rate, weight[:, None] * value.T, dense)


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
        force: (f1, f2, n) at the samples, with what is put on them for the kinks between, n not less the preload, shape
            (N, C, 3).
        slip, separation: shares of the period, shape (C,).
        closure: distance of d at the start from where the period closes, over the tolerated one, at most 1 where it
            closed, shape (C,).
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
def closed_period(law: ConeLaw, motion: Motion, stuck: Offset) -> ClosedPeriod:
    """Pass through a periodic motion, shape (N, C), until d closes, at most `MAX_PASSES` times.

    A contact that can stick all along enters with the offset of `timesim.hbm.stuck_offset` and does. The others are
    accelerated from the third pass on (D. G. Anderson, J. ACM 12 (1965) 547, with one pass remembered): slip maps the
    plane on a curve, so the change over a pass has one direction. One program serves any number of harmonics.
    """
    intervals = intervals_of(motion)
    elastic = tuple(u[-1] + c for u, c in zip(motion.u, product(law.compliance, stuck.force), strict=True))
    first_start = onto_cone(law, elastic, motion.v[-1])
    reach = jnp.max(length(motion.u), axis=0)

    def again(last: _Passes) -> _Passes:
        start = last.next_start
        end, path = one_pass(law, start, intervals)
        change, before = minus(end, start), minus(last.end, last.start)
        bend = minus(change, before)
        ratio = dot(change, bend) / jnp.maximum(dot(bend, bend), 1e-300)
        usable = (last.count >= 2) & (dot(change, change) < dot(before, before))
        leap = scaled(jnp.where(usable, ratio, 0.0), minus(end, last.end))
        next_start = minus(end, leap)
        tolerated = CLOSED * jnp.max(length(path.d), axis=0) + ROUNDING * reach
        # Not the change alone: where slip is short, each pass makes up for a small share of what is left.
        # Not less than the length of no vector at all, as of a stop, which never has an elastic displacement.
        closure = length(minus(next_start, start)) / jnp.maximum(tolerated, 1e-140)
        return _Passes(onto_cone(law, next_start, motion.v[-1]), start, end, path, closure, last.count + 1)

    path = IntervalEnd(motion.u, motion.v, motion.v, (motion.v,) * 3, (motion.v,) * 3)
    none = _Passes(first_start, first_start, first_start, path, jnp.full_like(reach, jnp.inf), jnp.asarray(0))
    last = jax.lax.while_loop(lambda last: jnp.any(last.closure > 1) & (last.count < MAX_PASSES), again, none)
    sampled = *product(law.stiffness, last.path.d), jnp.maximum(normal_load(law, motion.v), 0.0)
    parts = zip(sampled, last.path.before, last.path.after, strict=True)
    force = jnp.stack([f + jnp.roll(before, -1, axis=0) + after for f, before, after in parts], axis=2)
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
    """Relative motion at the samples, shape (N, C), from (u1, u2, v), shape (C, 3, 2H + 1); rates as of `Basis`."""
    u1, u2, v = (basis.value @ coefficient[:, i].T for i in range(3))
    du1, du2, dv = (basis.rate @ coefficient[:, i].T for i in range(3))
    return Motion((u1, u2), v, (du1, du2), dv)


def period_of(law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64]) -> ClosedPeriod:
    """The closed period of a motion given by its Fourier coefficients (u1, u2, v), shape (C, 3, 2H + 1)."""
    return closed_period(law, motion_of(basis, coefficient), stuck_offset(law, dense_motion_of(basis, coefficient)))


def dense_motion_of(basis: Basis, coefficient: NDArray[np.float64]) -> Motion:
    """`motion_of` at the samples where a contact must stick all along, shape (DENSE N, C); no rates."""
    u1, u2, v = (basis.dense @ coefficient[:, i].T for i in range(3))
    return Motion((u1, u2), v, (), v)


def starts_of(period: ClosedPeriod) -> Plane:
    """Elastic displacement at the start of each interval, shape (N, C)."""
    pairs = zip(period.start, period.ends.d, strict=True)
    return tuple(np.concatenate([np.asarray(first)[None], np.asarray(d)[:-1]]) for first, d in pairs)


def touching_stiffness(law: ConeLaw, motion: Motion) -> NDArray[np.float64]:
    """The normal stiffness that acts at each sample, shape (N, C)."""
    return (np.asarray(normal_load(law, motion.v)) > 0) * np.asarray(law.normal_stiffness)


def forces_of(basis: Basis, period: ClosedPeriod) -> ContactForces:
    """Forces and shares of a closed period."""
    coefficient = np.moveaxis(np.tensordot(basis.project, np.asarray(period.force), 1), 0, 2)
    shares = np.asarray(period.slip), np.asarray(period.separation)
    return ContactForces(coefficient, *shares, np.asarray(period.closure), int(period.passes))


def contact_forces(law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64]) -> ContactForces:
    """Contact forces of a motion given by its Fourier coefficients (u1, u2, v), shape (C, 3, 2H + 1)."""
    return forces_of(basis, period_of(law, basis, coefficient))
