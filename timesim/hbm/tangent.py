"""Derivatives of the contact forces of a period by the Fourier coefficients of the motion.

The law over one interval, `period.advance`, has 16 derivatives a contact, by forward differentiation. They are chained
through the period; that d at its end is that at its start gives two linear equations a contact. All coefficients
together cost some three passes of the law: differentiating the passes themselves would cost one for every coefficient.
"""

import timesim.runtime  # noqa: F401  isort: skip


import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Motion, Plane, Scalar, product
from timesim.hbm.period import (
    Basis,
    ContactForces,
    Interval,
    advance,
    bend_of,
    change_of,
    closed_period,
    forces_of,
    intervals_of,
    motion_of,
    starts_of,
    touching_stiffness,
)
from timesim.hbm.stuck_offset import Offset, offset_slope

Array64 = NDArray[np.float64]


class Slope(eqx.Module):
    """Derivatives of d at the end of each interval.

    Attributes:
        carry: by d at its start.
        change: by the change of (u, v) along it.
        bend: by the change of the change of u.
        load: by v.
    """

    carry: Float[Array, "sample contact 2 2"]
    change: Float[Array, "sample contact 2 3"]
    bend: Float[Array, "sample contact 2 2"]
    load: Float[Array, "sample contact 2"]


@jax.jit
def interval_slopes(law: ConeLaw, starts: Plane, motion: Motion) -> Slope:
    """Derivatives of the law over each interval of a motion, from the elastic displacement at its start."""
    intervals = intervals_of(motion)

    def end(d1: Scalar, d2: Scalar, c1: Scalar, c2: Scalar, b1: Scalar, b2: Scalar, *v: Scalar) -> Plane:
        return advance(law, (d1, d2), Interval((c1, c2), (b1, b2), *v)).d

    def at(arguments: tuple[Scalar, ...]) -> Float[Array, "8 2 contact"]:
        def along(seed: Float[Array, " 8"]) -> Plane:
            seeds = (jnp.broadcast_to(x, y.shape) for x, y in zip(seed, arguments, strict=True))
            return jax.jvp(end, arguments, tuple(seeds))[1]

        return jnp.stack(jax.vmap(along)(jnp.eye(len(arguments))), axis=1)

    # One sample after the other: as one array XLA computes the law anew for every derivative (13 ms, not 0.9).
    arguments = (*starts, *intervals.change, *intervals.bend, intervals.v0, intervals.v1)
    slope = jax.lax.map(at, arguments).transpose(0, 3, 2, 1)
    by_start, by_end = slope[..., 6], slope[..., 7]
    change = jnp.concatenate([slope[..., 2:4], -by_start[..., None]], axis=3)
    return Slope(slope[..., :2], change, slope[..., 4:6], by_start + by_end)


@jax.jit
def _tangents(slope: Slope, value: Float[Array, "sample coefficient"]) -> Float[Array, "sample contact 2 column"]:
    """Derivatives of d at the samples by the 3 (2H + 1) coefficients, d at the start kept, then by d at the start."""
    moved = change_of(value)
    num_contacts, size = slope.load.shape[1], 3 * value.shape[1]
    none = jnp.zeros((num_contacts, 2, 2))

    def step(x: Array, at: tuple[Slope, Array, Array, Array]) -> tuple[Array, Array]:
        local, moved, bent, here = at
        source = local.change[..., None] * moved
        source = source.at[:, :, :2].add(local.bend[..., None] * bent).at[:, :, 2].add(local.load[..., None] * here)
        source = jnp.concatenate([source.reshape(num_contacts, 2, size), none], axis=2)
        x = local.carry[..., :1] * x[:, None, 0] + local.carry[..., 1:] * x[:, None, 1] + source
        return x, x

    seed = jnp.concatenate([jnp.zeros((2, size)), jnp.eye(2)], axis=1)
    start = jnp.broadcast_to(seed, (num_contacts, *seed.shape))
    return jax.lax.scan(step, start, (slope, moved, bend_of(moved), value))[1]


def linearised(
    law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64]
) -> tuple[ContactForces, NDArray[np.float64]]:
    """`contact_forces`, and their derivatives by the coefficients of the same contact: 3 (2H + 1) rows and columns.

    With d at the end of the last pass e(y, d0) and d0 = e, ``(1 - de/dd0) dd0/dy = de/dy`` closes the period; where a
    contact sticks all along, d0 follows from its offset.
    """
    motion = motion_of(basis, coefficient)
    period = closed_period(law, motion)
    tangents = np.asarray(_tangents(interval_slopes(law, starts_of(period), motion), basis.value))
    by_motion, by_start = tangents[-1, ..., :-2], tangents[-1, ..., -2:]
    change, sticks = np.eye(2) - by_start, np.asarray(period.stuck.sticks)
    start = _stuck_start(law, basis, motion, period.stuck) if sticks.any() else np.zeros_like(by_motion)
    unique = (np.abs(np.linalg.det(change)) > 1e-13) & ~sticks
    start[unique] = np.linalg.solve(change[unique], by_motion[unique])
    # Projected first: the samples are many, the coefficients few.
    spectrum = np.tensordot(basis.project, tangents, 1).transpose(1, 2, 0, 3)
    spectrum = spectrum[..., :-2] + spectrum[..., -2:] @ start[:, None]
    stiffness = tuple(np.asarray(k)[:, None, None] for k in law.stiffness)
    num_contacts, size = spectrum.shape[0], basis.value.shape[1]
    slope = np.zeros((num_contacts, 3, size, 3 * size))
    slope[:, 0], slope[:, 1] = product(stiffness, (spectrum[:, 0], spectrum[:, 1]))
    slope[:, 2, :, 2 * size :] = (basis.project * touching_stiffness(law, period).T[:, None]) @ basis.value
    return forces_of(basis, period), slope.reshape(num_contacts, 3 * size, 3 * size)


def _stuck_start(law: ConeLaw, basis: Basis, motion: Motion, stuck: Offset) -> Array64:
    """Derivatives of d at the start of the period by the coefficients, for contacts that stick all along."""
    weights = np.asarray(offset_slope(law, stuck.force, motion))
    start = np.einsum("itca,tk->ciak", weights, basis.value)
    start[:, [0, 1], [0, 1]] += basis.value[-1]
    return start.reshape(*start.shape[:2], -1)
