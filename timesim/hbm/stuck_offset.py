"""The elastic displacement of a contact that sticks all along a periodic motion.

Such a contact may keep any slip w for which its friction force stays inside the cone, so its mean force is free. Here
the offset g of the force, ``f = K_u u + g``, minimises

    |g|^2 / (2 R^2) + mean_t phi(|K_u u_t + g|^2 / (mu n_t)^2),   R = mean_t mu n_t,

where the barrier ``phi`` vanishes up to 1/2 and grows beyond all bounds towards 1. So w is 0 where that leaves room in
the cone; where the cone narrows the offset moves, smoothly, to the one that is left when slip becomes unavoidable, so
that a curve goes on there. The function is convex. It is minimised by Newton's method, first for cones widened by s,
which goes to 0 if any offset is admissible (S. Boyd and L. Vandenberghe, Convex Optimization (2004), section 11.4).
"""

import timesim.runtime  # noqa: F401  isort: skip

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import NDArray

from timesim.engine.lanes import advance_lanes
from timesim.engine.law.cone import ConeLaw, normal_load
from timesim.engine.law.contact_law import Motion, Plane, Scalar, product
from timesim.program import program

MAX_ITERATIONS = 1000
CONVERGED = 1e-12  # change of g that counts as none, relative to R
# Room left in the widened cones relative to the widening, below which they cannot be narrowed to what they are.
NO_ROOM = 0.02
# Change of g, relative to the room, below which it has come to rest and the cones may be narrowed.
AT_REST = 0.1
FREE = 0.5
FEW = 128  # samples, at least, by which a contact that must slip is told
SLIGHT = 0.01  # weight of |g|^2 as long as the cones are widened
DIRECTIONS = np.exp(1j * np.pi * np.arange(16) / 16)
"""Along which it is told; every fourth where all samples are looked at."""


class Offset(NamedTuple):
    """Offset of the friction force, shape (C,), and whether the contact sticks all along with it."""

    force: Plane
    sticks: Bool[Array, " contact"]


class _Iterate(eqx.Module):
    """Offset and widening of the cones so far, whether the iteration goes on, and whether it has converged.

    `beside`: offset less that which puts the force in the middle: it may be so large that g never comes to rest.
    """

    beside: Plane
    widening: Scalar
    moves: Bool[Array, " contact"]
    converged: Bool[Array, " contact"]
    count: Scalar


def _slopes(
    g: Plane, force: Plane, limit: Scalar, unit: Scalar, weight: Scalar, more: Plane | tuple[float, float] = (0.0, 0.0)
) -> tuple[Plane, Plane]:
    """Gradient of the function by g, in units of 1 / unit, and its second derivatives 11, 12, 22, of 1 / unit^2.

    `weight` is that of |g|^2; `more` the part of g that is in the force already. With
    ``z = max(2 |K_u u + g|^2 / (mu n)^2 - 1, 0)`` the barrier is ``z^3 / (1 - z)^2``.
    """
    # So steep because the mean over time is taken: at a touch of the cone 1 - z falls to 0 as t^2, where the mean of a
    # log barrier stays finite, and the offset did not tend to the one that the motion leaves; that of a pole grows.
    x, y = (f + part for f, part in zip(force, g, strict=True))
    size, steep = unit / limit, 1 / (1 - FREE)
    z = jnp.maximum((x**2 + y**2) / limit**2 - FREE, 0.0) * steep
    left = 1 / (1 - jnp.minimum(z, 1 - 1e-7))
    once, twice = steep * z**2 * (3 - z) * left**3, steep**2 * 6 * z * left**4
    a, b = 2 * size * x / limit, 2 * size * y / limit
    even = weight + jnp.mean(2 * once * size**2, axis=0)
    whole = tuple(part + m for part, m in zip(g, more, strict=True))
    gradient = tuple(weight * part / unit + jnp.mean(once * e, axis=0) for part, e in zip(whole, (a, b), strict=True))
    bend = tuple(jnp.mean(twice * e, axis=0) for e in (a * a, a * b, b * b))
    return gradient, (even + bend[0], bend[1], even + bend[2])


def _change_of(hessian: Plane, gradient: Plane, unit: Scalar) -> Plane:
    """Change of g that changes the gradient by a given vector."""
    (a, b, c), (x, y) = hessian, gradient
    scale = unit / (a * c - b * b)
    return scale * (c * x - b * y), scale * (a * y - b * x)


def _size(force: Plane) -> Scalar:
    return jnp.sqrt(sum(f**2 for f in force))


def _share_to_cone(g: Plane, step: Plane, force: Plane, limit: Scalar) -> Scalar:
    """Share of a step after which the first force is on its cone."""
    here = tuple(f + x for f, x in zip(force, g, strict=True))
    a = sum(s**2 for s in step)
    b = sum(x * s for x, s in zip(here, step, strict=True))
    room = limit**2 - sum(x**2 for x in here)
    return jnp.min(room / (b + jnp.sqrt(b**2 + a * room) + 1e-300), axis=0)


def without_slip(law: ConeLaw, motion: Motion) -> tuple[Plane, Scalar, Scalar]:
    """Friction force for w = 0 and its limit at the samples, shape (N, C), and the mean limit."""
    force = product(law.stiffness, motion.u)
    limit = law.friction * normal_load(law, motion.v)
    return force, limit, jnp.maximum(jnp.mean(limit, axis=0), 1e-300)


def _must_slip(force: Plane, limit: Scalar, directions: NDArray[np.complex128]) -> Bool[Array, " contact"]:
    """Whether the force needs more room along some direction than the cones leave, whatever its offset."""
    e = directions[:, None, None]
    along = e.real * force[0] + e.imag * force[1]
    return ((along - limit).max(axis=1) > (along + limit).min(axis=1)).any(axis=0)


def plainly_works(law: ConeLaw, motion: Motion) -> NDArray[np.bool_]:
    """Which contacts, by a few samples, can neither stick nor be apart all along, shape (C,); on the host.

    It spares most of those that work the search for an offset, which costs as much as a pass through the period.
    """
    few = slice(None, None, max(1, len(motion.v) // FEW))
    force = product(tuple(map(np.asarray, law.stiffness)), tuple(np.asarray(u)[few] for u in motion.u))
    load = np.asarray(law.preload) + np.asarray(law.normal_stiffness) * np.asarray(motion.v)[few]
    limit = np.asarray(law.friction) * load
    return np.asarray((load > 0).any(axis=0) & ((limit <= 0).any(axis=0) | _must_slip(force, limit, DIRECTIONS)))


def plainly_sticks(law: ConeLaw, motion: Motion) -> NDArray[np.bool_]:
    """Which contacts stick all along with w = 0, far inside their cones, shape (C,); on the host, which is quick."""
    force = product(tuple(map(np.asarray, law.stiffness)), motion.u)
    limit = np.asarray(law.friction) * (np.asarray(law.preload) + np.asarray(law.normal_stiffness) * motion.v)
    square = sum(np.asarray(f) ** 2 for f in force)
    return np.asarray((limit > 0).all(axis=0) & (square <= FREE * limit**2).all(axis=0))


@program
def stuck_offset(law: ConeLaw, motion: Motion) -> Offset:
    """The offset with which each contact only sticks under a periodic motion, shape (N, C); 0 where there is none."""
    force, limit, unit = without_slip(law, motion)
    middle = tuple(-(jnp.max(f, axis=0) + jnp.min(f, axis=0)) / 2 for f in force)
    waves = tuple(f + x for f, x in zip(force, middle, strict=True))

    def least_widening(beside: Plane) -> Scalar:
        """By how much the cones must at least be wider."""
        return jnp.max(_size(tuple(f + x for f, x in zip(waves, beside, strict=True))) - limit, axis=0)

    def improved(now: _Iterate) -> tuple[_Iterate]:
        wide = limit + now.widening
        weight = jnp.where(now.widening == 0, 1.0, SLIGHT)
        gradient, hessian = _slopes(now.beside, waves, wide, unit, weight, middle)
        step = _change_of(hessian, tuple(-x for x in gradient), unit)
        share = jnp.minimum(1.0, 0.9 * _share_to_cone(now.beside, step, waves, wide))
        beside = tuple(x + share * s for x, s in zip(now.beside, step, strict=True))
        least, change, inside = least_widening(beside), share * _size(step), now.widening == 0
        converged = inside & (change < CONVERGED * unit)
        stopped = (now.widening - least < NO_ROOM * now.widening) & (change < AT_REST * now.widening)
        centred = change < AT_REST * (now.widening - least)
        narrower = jnp.where(centred, (now.widening + least) / 2, now.widening)
        widening = jnp.where((least < 0) | inside, 0.0, narrower)
        return (_Iterate(beside, widening, ~converged & ~(stopped & ~inside), converged, now.count + 1),)

    free = least_widening(tuple(-x for x in middle)) < 0
    begin = tuple(jnp.where(free, -x, 0.0) for x in middle)
    least = least_widening(begin)
    start = jnp.where(least < 0, 0.0, least + 0.1 * unit)
    moves = (jnp.min(limit, axis=0) > 0) & ~_must_slip(force, limit, DIRECTIONS[::4])
    first = _Iterate(begin, start, moves, jnp.zeros_like(moves), jnp.zeros_like(moves, int))
    last, _ = advance_lanes(
        improved, lambda now: now.moves & (now.count < MAX_ITERATIONS), first, None, lambda *step: None
    )
    g = (x + b for x, b in zip(middle, last.beside, strict=True))
    return Offset(tuple(jnp.where(last.converged, x, 0.0) for x in g), last.converged)


@program
def offset_slope(law: ConeLaw, g: Plane, motion: Motion) -> Float[Array, "2 sample contact 3"]:
    """Derivatives of C g, of the offset g of a contact that sticks, by (u1, u2, v) at each sample."""
    one, none = jnp.ones_like(g[0]), jnp.zeros_like(g[0])

    def gradient(u: Plane, v: Scalar) -> Plane:
        return _slopes(g, *without_slip(law, Motion(u, v, (), v)), one)[0]

    pull = jax.vjp(gradient, motion.u, motion.v)[1]
    ((a1, a2), a3), ((b1, b2), b3) = pull((one, none)), pull((none, one))
    here = without_slip(law, motion)
    hessian = _slopes(g, *here, one)[1]
    rows = [_change_of(hessian, (-a, -b), here[2]) for a, b in ((a1, b1), (a2, b2), (a3, b3))]
    elastic = [product(law.compliance, row) for row in rows]
    return jnp.stack([jnp.stack(component, axis=-1) for component in zip(*elastic, strict=True)])
