"""Derivatives of the contact forces of a period by the Fourier coefficients of the motion.

Each interval of the law has 16 local derivatives, found by forward differentiation of `timesim.period.carried`; they
are chained through the period, which closes by a solution of two equations a contact. All coefficients together cost
some three passes of the law: differentiating the passes themselves would cost one for every coefficient.
"""

import timesim.jax_setup  # noqa: F401  isort: skip

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from timesim.contact import Law, Motion, Plane, Scalar, between, length, normal_load, product
from timesim.period import (
    Basis,
    Forces,
    Interval,
    Period,
    before_intervals,
    bend_of,
    carried,
    change_of,
    closed_period,
    intervals_of,
    motion_of,
    settled,
    summary,
    through,
)


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


def slopes(law: Law, before: Plane, intervals: Interval) -> Slope:
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


def _closing(
    passed: Array, loose: Bool[Array, " contact"], entered: Float[Array, "contact 2 column"]
) -> Float[Array, "contact 2 column"]:
    """Derivatives of d at the start of a closed period; `entered` where nothing slips, for there it is not unique."""
    moved, carry = passed[..., :-2], passed[..., -2:]
    a, b, c, d = 1 - carry[:, 0, 0], -carry[:, 0, 1], -carry[:, 1, 0], 1 - carry[:, 1, 1]
    det = a * d - b * c
    adjoint = jnp.stack([jnp.stack([d, -b], axis=1), jnp.stack([-c, a], axis=1)], axis=1)
    loose = loose | (jnp.abs(det) < 1e-13)
    solved = adjoint @ moved / jnp.where(loose, 1.0, det)[:, None, None]
    return jnp.where(loose[:, None, None], entered, solved)


def _after_entry(law: Law, basis: Basis, motion: Motion, period: Period) -> Float[Array, "contact 2 column"]:
    """Derivatives of d at the end of the first pass."""
    intervals = intervals_of(motion)
    _, path = through(law, period.entered, intervals)
    first = Period(period.entered, path, period.entered, period.gap, period.passes)
    passed = _tangents(slopes(law, before_intervals(first), intervals), basis)[-1]

    def enter(u1: Scalar, u2: Scalar, v: Scalar) -> Plane:
        return settled(law, (u1, u2), v)

    place = (motion.u[0][-1], motion.u[1][-1], motion.v[-1])
    seeds = ((jnp.full_like(x, i == j) for j, x in enumerate(place)) for i in range(3))
    entry = jnp.stack([jnp.stack(jax.jvp(enter, place, tuple(seed))[1], axis=1) for seed in seeds], axis=2)
    begin = (entry[..., None] * basis.value[-1]).reshape(entry.shape[0], 2, -1)
    return passed[..., :-2] + passed[..., -2:] @ begin


@jax.jit
def linearised(
    law: Law, basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]
) -> tuple[Forces, Float[Array, "contact unknown unknown"]]:
    """`forces`, and their derivatives by the coefficients of the same contact: 3 (2H + 1) rows and columns.

    The derivatives run through the last pass alone and close by a solution of two equations a contact. Where that
    pass only sticks but the first one slipped, they run through the first.
    """
    motion = motion_of(basis, coefficient)
    period = closed_period(law, motion)
    acts = summary(law, basis, motion, period)
    passed = _tangents(slopes(law, before_intervals(period), intervals_of(motion)), basis)
    loose = (acts.slip == 0) & (acts.separation == 0)
    size, here = basis.value.shape[1], basis.value[-1]
    stuck = jnp.zeros((2, 3, size)).at[0, 0].set(here).at[1, 1].set(here).reshape(2, -1)
    stuck = jnp.broadcast_to(stuck, (loose.shape[0], *stuck.shape))
    shift = length(between(tuple(u[-1] for u in motion.u), period.begin))
    entered = jax.lax.cond(
        jnp.any(loose & (shift > 1e-9 * jnp.max(length(period.d), axis=0))),
        lambda: _after_entry(law, basis, motion, period),
        lambda: stuck,
    )
    begin = _closing(passed[-1], loose, entered)
    spectrum = jnp.moveaxis(jnp.tensordot(basis.project, passed, 1), 0, 2)
    slope = spectrum[..., :-2] + spectrum[..., -2:] @ begin[:, None]
    friction = product(tuple(k[:, None, None] for k in law.stiffness), (slope[:, 0], slope[:, 1]))
    touching = (normal_load(law, motion.v) > 0) * law.normal_stiffness
    normal = jnp.einsum("ak,kc,kb->cab", basis.project, touching, basis.value)
    none = jnp.zeros((*normal.shape[:2], 2 * size))
    return acts, jnp.concatenate([*friction, jnp.concatenate([none, normal], axis=2)], axis=1)
