"""Derivatives of the contact forces of a period by the Fourier coefficients of the motion.

Each interval of the law has 16 local derivatives, found by forward differentiation of `period.carried`; they
are chained through the period, which closes by a solution of two equations a contact. All coefficients together cost
some three passes of the law: differentiating the passes themselves would cost one for every coefficient.
"""

import timesim.runtime  # noqa: F401  isort: skip

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import NDArray

from timesim.engine.contact import ConeLaw, normal_load
from timesim.engine.contact_law import Motion, Plane, Scalar, product
from timesim.hbm.period import (
    Basis,
    Forces,
    Interval,
    before_intervals,
    bend_of,
    carried,
    change_of,
    closed_period,
    intervals_of,
    motion_of,
    summary,
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


def slopes(law: ConeLaw, before: Plane, intervals: Interval) -> Slope:
    """Local derivatives of the law, from the elastic displacement at the start of each interval."""

    def end(d1: Scalar, d2: Scalar, c1: Scalar, c2: Scalar, b1: Scalar, b2: Scalar, *v: Scalar) -> Plane:
        return carried(law, (d1, d2), Interval((c1, c2), (b1, b2), *v)).d

    def at(place: tuple[Scalar, ...]) -> Float[Array, "8 2 contact"]:
        def along(seed: Float[Array, " 8"]) -> Plane:
            seeds = (jnp.broadcast_to(x, y.shape) for x, y in zip(seed, place, strict=True))
            return jax.jvp(end, place, tuple(seeds))[1]

        return jnp.stack(jax.vmap(along)(jnp.eye(len(place))), axis=1)

    # One sample after the other: as one array XLA computes the law anew for every derivative (13 ms, not 0.9).
    place = (*before, *intervals.change, *intervals.bend, intervals.v0, intervals.v1)
    slope = jax.lax.map(at, place).transpose(0, 3, 2, 1)
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

    begin = jnp.concatenate([jnp.zeros((2, size)), jnp.eye(2)], axis=1)
    start = jnp.broadcast_to(begin, (num_contacts, *begin.shape))
    return jax.lax.scan(step, start, (slope, moved, bend_of(moved), value))[1]


class _Chained(eqx.Module):
    """Forces, and the derivatives of the last pass.

    Attributes:
        acts: the forces.
        spectrum: Fourier coefficients of the derivatives of f by the coefficients of the motion and by d at the start.
        end: the same derivatives of d at the end, d instead of f.
        normal: derivatives of the normal load.
        entered: derivatives of d where the period begins by the coefficients, of contacts that stick all along.
        sticks: which ones do.
    """

    acts: Forces
    spectrum: Float[Array, "contact 2 coefficient column"]
    end: Float[Array, "contact 2 column"]
    normal: Float[Array, "contact coefficient coefficient"]
    entered: Float[Array, "contact 2 column"]
    sticks: Bool[Array, " contact"]


@jax.jit
def _chained(law: ConeLaw, basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]) -> _Chained:
    motion = motion_of(basis, coefficient)
    period = closed_period(law, motion)
    acts = summary(law, basis, motion, period)
    passed = _tangents(slopes(law, before_intervals(period), intervals_of(motion)), basis)
    spectrum = jnp.moveaxis(jnp.tensordot(basis.project, passed, 1), 0, 2)
    stiffness = tuple(k[:, None, None] for k in law.stiffness)
    spectrum = jnp.stack(product(stiffness, (spectrum[:, 0], spectrum[:, 1])), axis=1)
    touching = (normal_load(law, motion.v) > 0) * law.normal_stiffness
    normal = jnp.einsum("ak,kc,kb->cab", basis.project, touching, basis.value)
    entered = _entered(law, basis, motion, period.held)
    return _Chained(acts, spectrum, passed[-1], normal, entered, period.held.sticks)


def _entered(law: ConeLaw, basis: Basis, motion: Motion, held: Offset) -> Float[Array, "contact 2 column"]:
    """Derivatives of d where the period begins by the coefficients, for contacts that stick all along."""
    none = jnp.zeros_like(motion.v)

    def along(row: Float[Array, " sample"]) -> Float[Array, "3 2 contact"]:
        wave = jnp.broadcast_to(row[:, None], none.shape)
        ways = ((wave, none, none), (none, wave, none), (none, none, wave))
        seeds = (Motion((u1, u2), v, (), v) for u1, u2, v in ways)
        changes = (product(law.compliance, offset_slope(law, held.force, motion, seed)) for seed in seeds)
        return jnp.stack([jnp.stack(change) for change in changes])

    found = jnp.moveaxis(jax.lax.map(along, basis.value.T), (0, 1, 2, 3), (3, 2, 1, 0))
    here = jnp.zeros((2, 3)).at[0, 0].set(1.0).at[1, 1].set(1.0)[..., None] * basis.value[-1]
    return (found + here).reshape(*found.shape[:2], -1)


def linearised(
    law: ConeLaw, basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]
) -> tuple[Forces, NDArray[np.float64]]:
    """`forces`, and their derivatives by the coefficients of the same contact: 3 (2H + 1) rows and columns.

    The derivatives run through the last pass alone and close by a solution of two equations a contact.
    """
    done = _chained(law, basis, coefficient)
    end, spectrum = np.asarray(done.end), np.asarray(done.spectrum)
    moved, carry = end[..., :-2], end[..., -2:]
    open_ = np.eye(2) - carry
    unique = (np.abs(np.linalg.det(open_)) > 1e-13) & ~np.asarray(done.sticks)
    begin = np.array(done.entered)
    begin[unique] = np.linalg.solve(open_[unique], moved[unique])
    slope = spectrum[..., :-2] + spectrum[..., -2:] @ begin[:, None]
    normal = np.concatenate([np.zeros((*done.normal.shape[:2], 2 * basis.value.shape[1])), done.normal], axis=2)
    return done.acts, np.concatenate([slope[:, 0], slope[:, 1], normal], axis=1)
