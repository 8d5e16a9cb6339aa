"""Derivatives of the contact forces of a period by the Fourier coefficients of the motion.

The law over one interval, `timesim.hbm.interval`, has 12 arguments and 8 results a contact and is differentiated
forward. The derivatives are chained through the period; that d at its end is that at its start gives two linear
equations a contact. All coefficients together cost a few passes of the law: differentiating the passes themselves would
cost one for every coefficient.
"""

import timesim.runtime  # noqa: F401  isort: skip

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray
from scipy.linalg import lapack

from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Motion, product
from timesim.hbm.interval import Interval, advance, before, intervals_of
from timesim.hbm.period import (
    Basis,
    ClosedPeriod,
    ContactForces,
    dense_motion_of,
    forces_of,
    in_lanes,
    motion_of,
    part_of,
    period_of,
    starts_of,
    touching_stiffness,
)
from timesim.hbm.stuck_offset import Offset, offset_slope
from timesim.program import program

Array64 = NDArray[np.float64]
# Intervals that are differentiated side by side.
LANES = 128


class Slope(NamedTuple):
    """Derivatives of what the law gives over each interval: d at its end, and the forces put on both samples, R = 8.

    Attributes:
        start: by d at its start, shape (N, C, R, 2).
        tangential: by the change and by the rates at both ends of u1 and u2, shape (N, C, R, 2, 3).
        normal: by v at both ends and its rates there, shape (N, C, R, 4).
    """

    start: Array64
    tangential: Array64
    normal: Array64


def interval_slopes(law: ConeLaw, period: ClosedPeriod, motion: Motion) -> Slope:
    """Derivatives of the law over the intervals of a closed period."""
    of = intervals_of(motion)
    slope = _slopes(law, period, (*of.change, *of.du0, *of.du1, of.v0, of.v1, of.dv0, of.dv1))
    tangential = slope[..., 2:8].reshape(*slope.shape[:3], 3, 2).swapaxes(3, 4)
    return Slope(slope[..., :2], tangential, slope[..., 8:])


def _slopes(law: ConeLaw, period: ClosedPeriod, motion: tuple[Array, ...]) -> Array64:
    """Derivatives of the results by d at the start and by the motion, shape (N, C, 8, 12).

    Most intervals stick or are apart all along: d follows u, or there is none. The others are gathered, so that one
    program serves any number of samples and contacts.
    """
    slip, apart = np.asarray(period.ends.slip), np.asarray(period.ends.separation)
    rubs = np.asarray(law.friction) > 0
    changes = (apart > 0) & (apart < 1)
    place = np.nonzero(changes | (rubs & (slip > 0)))
    slope = np.zeros((*slip.shape, 8, 12))
    sticks = rubs & ~changes & (apart == 0)
    for i in range(2):
        slope[..., i, i] = slope[..., i, 2 + i] = sticks
    arguments = np.stack([np.asarray(x)[place] for x in (*starts_of(period), *motion)])
    count = len(place[0])
    for first in range(0, count, LANES):
        # The last lanes are filled up with the last interval.
        lanes = np.minimum(np.arange(first, first + LANES), count - 1)
        own = jax.tree.map(lambda leaf, which=place[1][lanes]: np.asarray(leaf)[which], law)
        part = np.asarray(_lane_slopes(own, arguments[:, lanes]))
        slope[place[0][lanes], place[1][lanes]] = part
    return slope


@program
def _lane_slopes(law: ConeLaw, arguments: Float[Array, "12 lane"]) -> Float[Array, "lane 8 12"]:
    def results(x: Float[Array, "12 lane"]) -> Float[Array, "8 lane"]:
        end = advance(law, (x[0], x[1]), Interval((x[2], x[3]), (x[4], x[5]), (x[6], x[7]), *x[8:]))
        return jnp.stack([*end.d, *end.before, *end.after])

    def along(seed: Float[Array, " 12"]) -> Float[Array, "8 lane"]:
        return jax.jvp(results, (arguments,), (jnp.broadcast_to(seed[:, None], arguments.shape),))[1]

    return jax.vmap(along, out_axes=2)(jnp.eye(len(arguments))).swapaxes(0, 1)


def _tangents(slopes: Slope, basis: Basis) -> Array64:
    """Derivatives of d at the end of each interval by the coefficients and by d at the start of the period.

    Shape (N, C, 2, 3 (2H + 1) + 2). Each follows from that of the interval before, x_k = A_k x_(k-1) + b_k: a banded
    triangular system for all of them.
    """
    count, size = basis.value.shape
    of_u, of_v = _of_interval(basis)
    tangents = np.empty((count, slopes.start.shape[1], 2, 3 * size + 2))
    for contact in range(tangents.shape[1]):
        start, tangential, normal = (part[:, contact, :2] for part in slopes)
        source = np.zeros((3 * size + 2, count, 2))
        along = (tangential.reshape(count, 4, 3) @ of_u).reshape(count, 2, 2, size)
        source[: 2 * size] = along.transpose(2, 3, 0, 1).reshape(2 * size, count, 2)
        source[2 * size : -2] = (normal @ of_v).transpose(2, 0, 1)
        source[-2:, 0] = start[0].T
        band = np.zeros((4, count, 2))
        for i, j in np.ndindex(2, 2):
            band[2 + i - j, :-1, j] = -start[1:, i, j]
        done, _ = lapack.dtbtrs(band.reshape(4, -1), source.reshape(len(source), -1).T, uplo="L", diag="U")
        tangents[:, contact] = done.reshape(count, 2, -1)
    return tangents


def _of_interval(basis: Basis) -> tuple[Array64, Array64]:
    """What enters `Slope.tangential` and `Slope.normal`, by the coefficients: shapes (N, 3, 2H + 1), (N, 4, 2H + 1)."""
    value, rate = basis.value, basis.rate
    value0, rate0 = before(value), before(rate)
    return np.stack([value - value0, rate0, rate], axis=1), np.stack([value0, value, rate0, rate], axis=1)


def _seed(size: int) -> Array64:
    """Derivatives of d at the start of the period, the same for each contact."""
    return np.eye(2, size, size - 2)


def linearised(
    law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64]
) -> tuple[ContactForces, NDArray[np.float64]]:
    """`contact_forces`, and their derivatives by the coefficients of the same contact: 3 (2H + 1) rows and columns."""
    motion, size = motion_of(basis, coefficient), 3 * basis.value.shape[1]
    period = period_of(law, basis, coefficient)
    slope = np.zeros((len(coefficient), size, size))
    if (own := np.flatnonzero(period.works)).size:
        slope[own] = _working(part_of(law, own), basis, part_of(motion, own), period.of(own))
    if (own := np.flatnonzero(period.stuck.sticks)).size:
        slope[own] = _stuck(part_of(law, own), basis, coefficient[own], part_of(period.stuck, own))
    return forces_of(law, basis, motion, period), slope


def _working(law: ConeLaw, basis: Basis, motion: Motion, period: ClosedPeriod) -> Array64:
    """Derivatives of the forces of contacts that slip, or open and close, shape (C, 3 (2H + 1), 3 (2H + 1)).

    With d at the end of the last pass e(y, d0) and d0 = e, ``(1 - de/dd0) dd0/dy = de/dy`` closes the period.
    """
    slopes = interval_slopes(law, period, motion)
    tangents = _tangents(slopes, basis)
    by_motion, by_start = tangents[-1, ..., :-2], tangents[-1, ..., -2:]
    change, start = np.eye(2) - by_start, np.zeros_like(by_motion)
    unique = np.abs(np.linalg.det(change)) > 1e-13
    start[unique] = np.linalg.solve(change[unique], by_motion[unique])
    # Projected first: the samples are many, the coefficients few.
    num_contacts, size = len(start), basis.value.shape[1]
    spectrum = np.zeros((num_contacts, 3, size, 3 * size + 2))
    elastic = np.tensordot(basis.project, tangents, 1).transpose(2, 1, 0, 3)
    stiffness = tuple(np.asarray(k)[:, None, None] for k in law.stiffness)
    spectrum[:, 0], spectrum[:, 1] = product(stiffness, tuple(elastic))
    spectrum[:, 2, :, 2 * size : -2] = (basis.project * touching_stiffness(law, motion).T[:, None]) @ basis.value
    _add_kinks(spectrum, slopes, basis, tangents)
    slope = spectrum[..., :-2] + spectrum[..., -2:] @ start[:, None]
    return slope.reshape(num_contacts, 3 * size, 3 * size)


def _stuck(law: ConeLaw, basis: Basis, coefficient: Array64, stuck: Offset) -> Array64:
    """The same of contacts that stick all along: their forces follow the motion, but for the offset."""
    num_contacts, _, size = coefficient.shape
    elastic = np.zeros((2, num_contacts, size, 3, size))
    # An offset that is zero stays so.
    moved = np.flatnonzero(np.any(stuck.force, axis=0))
    for lanes in in_lanes(moved.size):
        own = moved[lanes]
        weight = offset_slope(part_of(law, own), part_of(stuck, own).force, dense_motion_of(basis, coefficient[own]))
        elastic[:, own, 0] = np.einsum("itca,tk->icak", np.asarray(weight), basis.dense, optimize=True)
    each = np.arange(size)
    for i in range(2):
        elastic[i, :, each, i, each] += 1.0
    stiffness = tuple(np.asarray(k)[:, None, None, None] for k in law.stiffness)
    slope = np.zeros((num_contacts, 3, size, 3, size))
    slope[:, 0], slope[:, 1] = product(stiffness, tuple(elastic))
    slope[:, 2, each, 2, each] = np.asarray(law.normal_stiffness)[:, None]
    return slope.reshape(num_contacts, 3 * size, 3 * size)


def _add_kinks(spectrum: Array64, slopes: Slope, basis: Basis, tangents: Array64) -> None:
    """Add what the few intervals with kinks put on the samples before and after them."""
    place = np.nonzero(
        np.any(slopes.tangential[:, :, 2:], axis=(2, 3, 4)) | np.any(slopes.normal[:, :, 2:], axis=(2, 3))
    )
    sample, contact = place
    of_u, of_v = (part[sample] for part in _of_interval(basis))
    tangential = np.einsum("poaj,pjk->poak", slopes.tangential[place][:, 2:], of_u)
    direct = np.concatenate([tangential, (slopes.normal[place][:, 2:] @ of_v)[:, :, None]], axis=2)
    start = np.where((sample == 0)[:, None, None], _seed(tangents.shape[3]), tangents[sample - 1, contact])
    rows = slopes.start[place][:, 2:] @ start
    rows[..., :-2] += direct.reshape(*direct.shape[:2], rows.shape[2] - 2)
    for side, i in ((slice(0, 3), sample - 1), (slice(3, 6), sample)):
        np.add.at(spectrum, contact, basis.project.T[i][:, None, :, None] * rows[:, side, None])
