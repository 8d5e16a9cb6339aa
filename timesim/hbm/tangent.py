"""Derivatives of the contact forces of a period by the Fourier coefficients of the motion.

The law over one interval, `period.advance`, has 16 derivatives a contact, by forward differentiation. They are chained
through the period; that d at its end is that at its start gives two linear equations a contact. All coefficients
together cost some three passes of the law: differentiating the passes themselves would cost one for every coefficient.
"""

import timesim.runtime  # noqa: F401  isort: skip

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from timesim.engine.contact import ConeLaw, normal_load
from timesim.engine.contact_law import Motion, Plane, Scalar, product
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
)
from timesim.hbm.stuck_offset import Offset, offset_slope


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


def interval_slopes(law: ConeLaw, starts: Plane, intervals: Interval) -> Slope:
    """Derivatives of the law over each interval, from the elastic displacement at its start."""

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


def _tangents(slope: Slope, basis: Basis) -> Float[Array, "sample contact 2 column"]:
    """Derivatives of d at the samples by the 3 (2H + 1) coefficients, d at the start kept, then by d at the start."""
    value, moved = basis.value, change_of(basis.value)
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


@jax.jit
def _last_pass(law: ConeLaw, basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]) -> tuple[Any, ...]:
    """Forces, and derivatives of the last pass by the coefficients of the motion and, last, by d at its start.

    Returns:
        the forces; derivatives of d at the end, shape (C, 2, 3 (2H + 1) + 2), and of the Fourier coefficients of f,
        (C, 2, 2H + 1, 3 (2H + 1) + 2); those of the normal load by the coefficients of v, (C, 2H + 1, 2H + 1); which
        contacts stick all along, and the derivatives of their d at the start, (C, 2, 3 (2H + 1)).
    """
    motion = motion_of(basis, coefficient)
    period = closed_period(law, motion)
    forces = forces_of(law, basis, motion, period)
    tangents = _tangents(interval_slopes(law, starts_of(period), intervals_of(motion)), basis)
    spectrum = jnp.moveaxis(jnp.tensordot(basis.project, tangents, 1), 0, 2)
    stiffness = tuple(k[:, None, None] for k in law.stiffness)
    spectrum = jnp.stack(product(stiffness, (spectrum[:, 0], spectrum[:, 1])), axis=1)
    touching = (normal_load(law, motion.v) > 0) * law.normal_stiffness
    normal = jnp.einsum("ak,kc,kb->cab", basis.project, touching, basis.value)
    return forces, tangents[-1], spectrum, normal, period.stuck.sticks, _stuck_start(law, basis, motion, period.stuck)


def _stuck_start(law: ConeLaw, basis: Basis, motion: Motion, stuck: Offset) -> Float[Array, "contact 2 column"]:
    """Derivatives of d at the start of the period by the coefficients, for contacts that stick all along."""
    none = jnp.zeros_like(motion.v)

    def along(row: Float[Array, " sample"]) -> Float[Array, "3 2 contact"]:
        wave = jnp.broadcast_to(row[:, None], none.shape)
        components = ((wave, none, none), (none, wave, none), (none, none, wave))
        seeds = (Motion((u1, u2), v, (), v) for u1, u2, v in components)
        changes = (product(law.compliance, offset_slope(law, stuck.force, motion, seed)) for seed in seeds)
        return jnp.stack([jnp.stack(change) for change in changes])

    by_offset = jnp.moveaxis(jax.lax.map(along, basis.value.T), (0, 1, 2, 3), (3, 2, 1, 0))
    by_motion = jnp.zeros((2, 3)).at[0, 0].set(1.0).at[1, 1].set(1.0)[..., None] * basis.value[-1]
    return (by_offset + by_motion).reshape(*by_offset.shape[:2], -1)


def linearised(
    law: ConeLaw, basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]
) -> tuple[ContactForces, NDArray[np.float64]]:
    """`contact_forces`, and their derivatives by the coefficients of the same contact: 3 (2H + 1) rows and columns.

    With d at the end of the last pass e(y, d0) and d0 = e, ``(1 - de/dd0) dd0/dy = de/dy`` closes the period.
    """
    forces, *slopes = _last_pass(law, basis, coefficient)
    end, spectrum, normal, sticks, stuck_start = map(np.asarray, slopes)
    by_motion, by_start = end[..., :-2], end[..., -2:]
    change = np.eye(2) - by_start
    unique = (np.abs(np.linalg.det(change)) > 1e-13) & ~sticks
    start = np.array(stuck_start)
    start[unique] = np.linalg.solve(change[unique], by_motion[unique])
    slope = spectrum[..., :-2] + spectrum[..., -2:] @ start[:, None]
    normal = np.concatenate([np.zeros((*normal.shape[:2], 2 * basis.value.shape[1])), normal], axis=2)
    return forces, np.concatenate([slope[:, 0], slope[:, 1], normal], axis=1)
