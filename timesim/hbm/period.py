"""Contact forces through one period of a given relative motion, on equal time samples.

The law over the interval between two samples is that of `timesim.hbm.interval`. A contact that can stick all along
does, with the offset of `timesim.hbm.stuck_offset`, and one that is apart all along has no force: neither needs a pass
through the period. Any other begins it with ``w = 0``, put on the cone where it would lie outside, and the period is
repeated until the elastic displacement at its end is that at its start.

The number of samples is data of the compiled program, which has room for many; contacts go through it one at a time, so
that intervals in which one sticks or is apart cost next to nothing. So one program serves any number of samples,
contacts and harmonics.
"""

import timesim.runtime  # noqa: F401  isort: skip

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from timesim.engine.law.cone import ConeLaw, normal_load
from timesim.engine.law.contact_law import Motion, Plane, Scalar, dot, length, minus, product, scaled
from timesim.hbm.interval import Interval, IntervalEnd, advance, sliding, unchanging
from timesim.hbm.stuck_offset import Offset, plainly_sticks, plainly_works, stuck_offset
from timesim.orbit.fourier import fourier_basis, fourier_coefficients, periodic_samples, to_phasors
from timesim.program import program

MAX_PASSES = 100
# Samples that the compiled programs of a period have room for.
ROOM = 2048, 32768
# Samples at which a contact must stick all along, at least: between those of the period a path may leave the cone.
DENSE = 2048
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
        sums: those of the first 0 ... N samples being 1, the others 0, shape (2H + 1, N + 1).
        dense: the functions at the samples where a contact must stick all along, shape (max(DENSE, N), 2H + 1).
    """

    value: NDArray[np.float64]
    rate: NDArray[np.float64]
    project: NDArray[np.float64]
    sums: NDArray[np.float64]
    dense: NDArray[np.float64]


@lru_cache(maxsize=64)
def basis_of(harmonics: int, time_samples: int) -> Basis:
    """The functions of H harmonics on N equal samples."""
    value, dense = (
        fourier_basis(2 * np.pi * np.arange(1, count + 1) / count, 2 * harmonics + 1)
        for count in (time_samples, max(DENSE, time_samples))
    )
    rate, order = np.zeros_like(value), 2 * np.pi / time_samples * np.arange(1, harmonics + 1)
    rate[:, 1::2], rate[:, 2::2] = -order * value[:, 2::2], order * value[:, 1::2]
    weight = np.append(1.0, np.full(2 * harmonics, 2.0)) / time_samples
    project = weight[:, None] * value.T
    return Basis(value, rate, project, np.cumsum(np.pad(project, [(0, 0), (1, 0)]), axis=1), dense)


def onto_cone(law: ConeLaw, d: Plane, v: Scalar) -> Plane:
    """An elastic displacement, shortened to the cone where its force lies outside; zero in separation."""
    limit = law.friction * jnp.maximum(normal_load(law, v), 0.0)
    force = length(product(law.stiffness, d))
    return scaled(jnp.where(force > limit, limit / force, jnp.where(law.friction > 0, 1.0, 0.0)), d)


@dataclass(frozen=True)
class ClosedPeriod:
    """A period at whose end the elastic displacement is that at its start; N samples, C contacts.

    Attributes:
        motion: relative motion at the samples and its rates, shape (N, C).
        start: elastic displacement at the start, shape (C,).
        ends: the same at the end of each interval, its shares, and what is put on the samples beside it, shape (N, C).
        closure: distance of d at the start from where the period closes, over the tolerated one, at most 1 where it
            closed, shape (C,).
        passes: through the period, at most.
        stuck: which contacts stick all along, and the offset of their force.
        works: which contacts neither stick nor are apart all along, shape (C,).
    """

    motion: Motion
    start: Plane
    ends: IntervalEnd
    closure: NDArray[np.float64]
    passes: int
    stuck: Offset
    works: NDArray[np.bool_]

    def of(self, places: NDArray[np.int64]) -> "ClosedPeriod":
        """The period of some contacts."""
        names = ("motion", "start", "ends", "closure", "stuck", "works")
        return replace(self, **{name: part_of(getattr(self, name), places) for name in names})

    @property
    def slip(self) -> NDArray[np.float64]:
        """Share of the period spent in slip, shape (C,)."""
        return _share(np.asarray(self.ends.slip))

    @property
    def separation(self) -> NDArray[np.float64]:
        """The same in separation."""
        return _share(np.asarray(self.ends.separation))


def _share(part: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the period; exactly 1 where it is the whole of every interval."""
    return np.where(np.all(part > WHOLE, axis=0), 1.0, np.mean(part, axis=0))


T = TypeVar("T")


class _Passes(eqx.Module):
    """Passes so far: where the next one starts, and start, end and path of the last one.

    The path holds, for each interval, d at its end, both shares, and what is put on the samples before and after it.
    """

    next_start: Plane
    start: Plane
    end: Plane
    path: Float[Array, "room 10 lane"]
    closure: Scalar
    count: Scalar


def _moving(law: ConeLaw, d: Plane, interval: Interval) -> IntervalEnd:
    """The law over an interval in which some contact slips or changes its state."""
    slips, along = sliding(law, d, interval)
    return jax.lax.cond(jnp.all(slips), lambda: along, lambda: advance(law, d, interval))


@program
def _closed(law: ConeLaw, motion: Float[Array, "room+1 6 lane"], count: Int[Array, ""]) -> _Passes:
    """Pass through a periodic motion until d closes, at most `MAX_PASSES` times.

    They are accelerated from the third pass on (D. G. Anderson, J. ACM 12 (1965) 547, with one pass remembered): slip
    maps the plane on a curve, so the change over a pass has one direction.

    ``motion``: (u1, u2, v) and their rates at the samples, of which there are ``count``, the last one first too.
    """
    elastic, last_v = (motion[0, 0], motion[0, 1]), motion[0, 2]
    reach = jnp.max(length((motion[:, 0], motion[:, 1])), axis=0)

    def one_pass(start: Plane, path: Array) -> tuple[Plane, Scalar, Array]:
        def step(k: Scalar, so_far: tuple[Plane, Scalar, Array]) -> tuple[Plane, Scalar, Array]:
            d, largest, path = so_far
            (u1, u2, v0, *du0, dv0), (w1, w2, v1, *du1, dv1) = motion[k], motion[k + 1]
            interval = Interval((w1 - u1, w2 - u2), tuple(du0), tuple(du1), v0, v1, dv0, dv1)
            plain, simple = unchanging(law, d, interval)
            end = jax.lax.cond(jnp.all(plain), lambda: simple, lambda: _moving(law, d, interval))
            row = jnp.stack([*end.d, end.slip, end.separation, *end.before, *end.after])
            return end.d, jnp.maximum(largest, length(end.d)), path.at[k].set(row)

        return jax.lax.fori_loop(0, count, step, (start, jnp.zeros_like(reach), path))

    def again(last: _Passes) -> _Passes:
        start = last.next_start
        end, largest, path = one_pass(start, last.path)
        change, before = minus(end, start), minus(last.end, last.start)
        bend = minus(change, before)
        ratio = dot(change, bend) / jnp.maximum(dot(bend, bend), 1e-300)
        usable = (last.count >= 2) & (dot(change, change) < dot(before, before))
        leap = scaled(jnp.where(usable, ratio, 0.0), minus(end, last.end))
        next_start = minus(end, leap)
        tolerated = CLOSED * largest + ROUNDING * reach
        # Not the change alone: where slip is short, each pass makes up for a small share of what is left.
        # Not less than the length of no vector at all, as of a stop, which never has an elastic displacement.
        closure = length(minus(next_start, start)) / jnp.maximum(tolerated, 1e-140)
        return _Passes(onto_cone(law, next_start, last_v), start, end, path, closure, last.count + 1)

    first = onto_cone(law, elastic, last_v)
    path = jnp.zeros((len(motion) - 1, 10, reach.size))
    none = _Passes(first, first, first, path, jnp.full_like(reach, jnp.inf), jnp.zeros((), int))
    return jax.lax.while_loop(lambda last: jnp.any(last.closure > 1) & (last.count < MAX_PASSES), again, none)


def part_of(whole: T, places: NDArray[np.int64]) -> T:
    """That of some contacts, which are along the last axis of each array."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[..., places], whole)


def period_of(law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64]) -> ClosedPeriod:
    """The closed period of a motion given by its Fourier coefficients (u1, u2, v), shape (C, 3, 2H + 1)."""
    motion, num_contacts = motion_of(basis, coefficient), len(coefficient)
    stuck, works = offsets_of(law, basis, coefficient, motion)
    # Of those that stick all along: d follows u.
    offset = product(tuple(map(np.asarray, law.compliance)), stuck.force)
    d = [np.where(stuck.sticks, u + c, 0.0) for u, c in zip(motion.u, offset, strict=True)]
    slip, separation = (np.zeros_like(motion.v) for _ in range(2))
    separation[:, ~stuck.sticks & ~works] = 1.0
    put = np.zeros((6, *motion.v.shape))
    start, closure, passes = [part[-1].copy() for part in d], np.zeros(num_contacts), 1
    for own in np.flatnonzero(works)[:, None]:
        last = _closed_part(part_of(law, own), motion, own)
        path = np.moveaxis(np.asarray(last.path)[: len(motion.v)], 1, 0)
        for whole, part in zip((*d, slip, separation, *put), path, strict=True):
            whole[:, own] = part
        for i in range(2):
            start[i][own] = last.start[i]
        closure[own], passes = last.closure, max(passes, int(last.count))
    ends = IntervalEnd((d[0], d[1]), slip, separation, tuple(put[:3]), tuple(put[3:]))
    return ClosedPeriod(motion, (start[0], start[1]), ends, closure, passes, stuck, works)


def _closed_part(law: ConeLaw, motion: Motion, places: NDArray[np.int64]) -> _Passes:
    """The passes through the period of some of the contacts; the law is theirs."""
    count = len(motion.v)
    room = next((room for room in ROOM if room >= count), count)
    table = np.zeros((room + 1, 6, places.size))
    for i, part in enumerate((*motion.u, motion.v, *motion.du, motion.dv)):
        table[1 : count + 1, i] = part[:, places]
    table[0] = table[count]
    return _closed(law, table, np.asarray(count))


def offsets_of(
    law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64], motion: Motion
) -> tuple[Offset, NDArray[np.bool_]]:
    """Which contacts stick all along, and the offset of their force; and which neither do nor are apart all along."""
    works, touches = plainly_works(law, motion), np.max(normal_load(law, motion.v), axis=0) > 0
    sticks, force = np.zeros_like(works), np.zeros((2, works.size))
    for own in np.flatnonzero(~works)[:, None]:
        part, dense = part_of(law, own), dense_motion_of(basis, coefficient[own])
        if not touches[own]:
            works[own] = ~_apart(part, dense)
        elif plainly_sticks(part, dense).all():
            sticks[own] = True
        else:
            found = stuck_offset(part, dense)
            force[:, own], sticks[own] = found.force, found.sticks
            works[own] = ~sticks[own]
    return Offset((force[0], force[1]), sticks), works


def _apart(law: ConeLaw, dense: Motion) -> NDArray[np.bool_]:
    """Which contacts are apart all along: v rises between two samples by less than its second difference."""
    bend = np.abs(np.roll(dense.v, -1, axis=0) - 2 * dense.v + np.roll(dense.v, 1, axis=0)).max(axis=0)
    highest = np.asarray(dense.v).max(axis=0) + bend / 4
    return np.asarray(law.preload) + np.asarray(law.normal_stiffness) * highest < 0


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
    phasor, count = to_phasors(coefficient.swapaxes(0, 1)), len(basis.value)
    turn = 2j * np.pi / count * np.arange(phasor.shape[-1])
    u1, u2, v, du1, du2, dv = (part.T for part in periodic_samples(np.concatenate([phasor, turn * phasor]), count))
    return Motion((u1, u2), v, (du1, du2), dv)


def dense_motion_of(basis: Basis, coefficient: NDArray[np.float64]) -> Motion:
    """`motion_of` at the samples where a contact must stick all along, shape (max(DENSE, N), C); no rates."""
    phasor = to_phasors(coefficient.swapaxes(0, 1))
    u1, u2, v = (part.T for part in periodic_samples(phasor, len(basis.dense)))
    return Motion((u1, u2), v, (), v)


def starts_of(period: ClosedPeriod) -> Plane:
    """Elastic displacement at the start of each interval, shape (N, C)."""
    pairs = zip(period.start, period.ends.d, strict=True)
    return tuple(np.concatenate([np.asarray(first)[None], np.asarray(d)[:-1]]) for first, d in pairs)


def touching_stiffness(law: ConeLaw, motion: Motion) -> NDArray[np.float64]:
    """The normal stiffness that acts at each sample, shape (N, C)."""
    return (np.asarray(normal_load(law, motion.v)) > 0) * np.asarray(law.normal_stiffness)


def forces_of(law: ConeLaw, basis: Basis, period: ClosedPeriod) -> ContactForces:
    """Forces and shares of a closed period."""
    ends, stiffness = period.ends, tuple(map(np.asarray, law.stiffness))
    load = np.maximum(np.asarray(law.preload) + np.asarray(law.normal_stiffness) * period.motion.v, 0.0)
    parts = zip((*product(stiffness, ends.d), load), ends.before, ends.after, strict=True)
    force = np.stack([f + np.roll(before, -1, axis=0) + after for f, before, after in parts], axis=1)
    coefficient = fourier_coefficients(force, 0.0)[: basis.value.shape[1]].T.copy()
    return ContactForces(coefficient, period.slip, period.separation, period.closure, period.passes)


def contact_forces(law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64]) -> ContactForces:
    """Contact forces of a motion given by its Fourier coefficients (u1, u2, v), shape (C, 3, 2H + 1)."""
    return forces_of(law, basis, period_of(law, basis, coefficient))
