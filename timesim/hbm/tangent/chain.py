"""Derivatives of the contact forces of a period by the Fourier coefficients of the motion.

Those of the law over the intervals, `timesim.hbm.tangent.slope`, are chained through the period; that d at its end is
that at its start gives two linear equations a contact. All coefficients together cost a few passes of the law:
differentiating the passes themselves would cost one for every coefficient. Only intervals that neither stick nor are
apart all along are links of that chain: in between d follows the motion, or there is none.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Plane, product
from timesim.hbm.period import (
    Basis,
    ClosedPeriod,
    ContactForces,
    dense_motion_of,
    forces_of,
    part_of,
    period_of,
    touching_stiffness,
)
from timesim.hbm.stuck_offset import offset_slope, stuck_offset
from timesim.hbm.tangent.slope import Array64, Slope, interval_slopes
from timesim.orbit.fourier import weighted

# Intervals whose motion is put together at a time: few enough to stay near the processor.
TOGETHER = 64
# Intervals through which derivatives are chained at a time.
LINKS = 8


def compile_offsets(law: ConeLaw, basis: Basis) -> None:
    """Compile the offset with which a contact sticks all along, and its derivative."""
    part, dense = part_of(law, np.zeros(1, dtype=int)), dense_motion_of(basis, np.zeros((1, 3, basis.value.shape[1])))
    offset_slope(part, stuck_offset(part, dense).force, dense)


@dataclass(frozen=True)
class _Chain:
    """Derivatives of a contact's elastic displacement d by the coefficients and by d at the start of the period.

    Attributes:
        places: of the intervals that slip or change their state, in order; the first, -1, is the start of the period.
        follows: whether d follows the motion after each of them; else there is none.
        rows: derivatives of d at their ends, shape (G, 2, 3 (2H + 1) + 2).
    """

    places: NDArray[np.int64]
    follows: NDArray[np.bool_]
    rows: Array64

    @classmethod
    def of(cls, slopes: Slope, contact: int, basis: Basis) -> "_Chain":
        """Each follows from the one before, x_k = A_k x_(k-1) + b_k."""
        active, sticks = slopes.active[:, contact], slopes.sticks[:, contact]
        places = np.append(-1, np.flatnonzero(active))
        follows = np.append(active | sticks, True)[places + 1]
        own, size = places[1:], basis.value.shape[1]
        start, tangential, normal = slopes.of(own, contact, slice(2))
        before, rows = _followed(basis, follows, places), np.empty((places.size, 2, 3 * size + 2))
        rows[0], rows[0, :, -2:], rows[1:, :, -2:] = 0.0, np.eye(2), 0.0
        for first in range(0, own.size, TOGETHER):
            some = slice(first, min(first + TOGETHER, own.size))
            course, out = _course(basis, own[some], before[some]), rows[some.start + 1 : some.stop + 1]
            for j in range(2):
                by_u = np.concatenate([tangential[some, :, j], start[some, :, j, None]], axis=2)
                np.matmul(by_u, course[:, 2:], out=out[..., j * size : (j + 1) * size])
            np.matmul(normal[some], course[:, :4], out=out[..., 2 * size : -2])
        chained(start * follows[:-1, None, None], rows)
        return cls(places, follows, rows)

    def starts(self, basis: Basis, of: NDArray[np.int64]) -> Array64:
        """The same at the start of some of the intervals, of which 0 is the first; of one behind them: of the period.

        Shape (P, 2, 3 (2H + 1) + 2).
        """
        rows = self.rows[of] * self.follows[of, None, None]
        _add_to_both(rows, _followed(basis, self.follows, self.places)[of])
        return rows

    def spectrum(self, basis: Basis) -> Array64:
        """Fourier coefficients of d, shape (2H + 1, 2, 3 (2H + 1) + 2)."""
        count, own = len(basis.value), self.places[1:]
        weight = (basis.sums[:, np.append(own, count)] - basis.sums[:, self.places + 1]) * self.follows
        sticks = np.repeat(self.follows, np.diff(np.append(self.places, count)))[1:]
        sticks[own] = False
        direct = weighted(sticks, basis.value.shape[1]) - weight @ basis.value[self.places]
        weight[:, 1:] += basis.project[:, own]
        whole = np.tensordot(weight, self.rows, 1)
        _add_to_both(whole, direct)
        return whole


def chained(step: Array64, rows: Array64) -> None:
    """Solve x_k = A_k x_(k-1) + b_k in place, from A_1 ... A_K, shape (K, 2, 2), and x_0, b_1 ... b_K, (K + 1, 2, n).

    Some at a time are one product of matrices: one by one they are too many.
    """
    steps = np.pad(step, [(0, -len(step) % LINKS), (0, 0), (0, 0)]).reshape(-1, LINKS, 2, 2)
    maps = np.zeros((len(steps), LINKS + 1, 2, 2 * LINKS + 2))
    maps[:, 0, :, :2] = np.eye(2)
    for k in range(LINKS):
        maps[:, k + 1] = steps[:, k] @ maps[:, k]
        maps[:, k + 1, :, 2 * k + 2 : 2 * k + 4] = np.eye(2)
    for block, first in zip(maps, range(0, len(step), LINKS), strict=True):
        own = rows[first : first + LINKS + 1].reshape(-1, rows.shape[2])
        own[2:] = block.reshape(2 * LINKS + 2, -1)[2 : len(own), : len(own)] @ own


def _add_to_both(rows: Array64, part: Array64) -> None:
    """Add to the derivatives of d1 by u1 and to those of d2 by u2."""
    size = part.shape[1]
    for i in range(2):
        rows[:, i, i * size : (i + 1) * size] += part


def _followed(basis: Basis, follows: NDArray[np.bool_], places: NDArray[np.int64]) -> Array64:
    """Change of u from the end of each of some intervals to the start of the next, if d follows it; (G, 2H + 1)."""
    until = np.append(places[1:], len(basis.value)) - 1
    return (basis.value[until] - basis.value[places]) * follows[:, None]


def _course(basis: Basis, places: NDArray[np.int64], followed: Array64 | float = 0.0) -> Array64:
    """What a component of the motion does in some intervals, by its coefficients, shape (P, 6, 2H + 1).

    Value and rate at both ends, the change, and the change that d followed since the interval before: the first four as
    `by_parts` has those of v, the last but the first two as those of u.
    """
    course = np.empty((places.size, 6, basis.value.shape[1]))
    for i, part in enumerate((basis.value, basis.rate)):
        course[:, 2 * i], course[:, 2 * i + 1] = part[places - 1], part[places]
    np.subtract(course[:, 1], course[:, 0], out=course[:, 4])
    course[:, 5] = followed
    return course


def linearised(
    law: ConeLaw, basis: Basis, coefficient: NDArray[np.float64], *, keep_offsets: bool = False
) -> tuple[ContactForces, NDArray[np.float64]]:
    """`contact_forces`, and their derivatives by the coefficients of the same contact: 3 (2H + 1) rows and columns.

    The offset of a contact that sticks all along follows its motion, unless it is kept.
    """
    period, size = period_of(law, basis, coefficient), 3 * basis.value.shape[1]
    slope = np.zeros((len(coefficient), size, size))
    if (own := np.flatnonzero(period.works)).size:
        for contact, part in zip(own, _working(part_of(law, own), basis, period.of(own)), strict=True):
            slope[contact] = part
    for own in np.flatnonzero(period.stuck.sticks)[:, None]:
        stuck = part_of(period.stuck, own).force
        # An offset that is zero stays so.
        offset = stuck if np.any(stuck) and not keep_offsets else None
        slope[own] = _stuck(part_of(law, own), basis, coefficient[own], offset)
    return forces_of(law, basis, period), slope


def _working(law: ConeLaw, basis: Basis, period: ClosedPeriod) -> Iterator[Array64]:
    """Derivatives of the forces of each of the contacts that slip, or open and close: 3 (2H + 1) rows and columns.

    With d at the end of the last pass e(y, d0) and d0 = e, ``(1 - de/dd0) dd0/dy = de/dy`` closes the period.
    """
    slopes = interval_slopes(law, period)
    touching, size = touching_stiffness(law, period.motion), basis.value.shape[1]
    for contact in range(touching.shape[1]):
        chain = _Chain.of(slopes, contact, basis)
        spectrum = np.zeros((3, size, 3 * size + 2))
        stiffness = tuple(np.asarray(k)[contact, None, None] for k in law.stiffness)
        spectrum[0], spectrum[1] = product(stiffness, tuple(chain.spectrum(basis).swapaxes(0, 1)))
        spectrum[2, :, 2 * size : -2] = weighted(touching[:, contact], size)
        _add_kinks(spectrum, slopes, contact, basis, chain)
        (end,) = chain.starts(basis, np.array([chain.places.size - 1]))
        by_motion, by_start = end[:, :-2], end[:, -2:]
        change = np.eye(2) - by_start
        if np.abs(np.linalg.det(change)) > 1e-13:
            spectrum[..., :-2] += spectrum[..., -2:] @ np.linalg.solve(change, by_motion)
        yield spectrum[..., :-2].reshape(3 * size, 3 * size)


def _stuck(law: ConeLaw, basis: Basis, coefficient: Array64, offset: Plane | None) -> Array64:
    """The same of one that sticks all along, whose force follows the motion, as its offset does if one is given."""
    size = coefficient.shape[-1]
    each, slope = np.arange(size), np.zeros((3, size, 3, size))
    elastic = np.zeros((2, size, 3, size))
    if offset is not None:
        weight = offset_slope(law, offset, dense_motion_of(basis, coefficient))
        elastic[:, 0] = np.einsum("itca,tk->icak", np.asarray(weight), basis.dense, optimize=True)[:, 0]
    for i in range(2):
        elastic[i, each, i, each] += 1.0
    slope[0], slope[1] = product(tuple(map(np.asarray, law.stiffness)), tuple(elastic))
    slope[2, each, 2, each] = law.normal_stiffness
    return slope.reshape(3 * size, 3 * size)


def _add_kinks(spectrum: Array64, slopes: Slope, contact: int, basis: Basis, chain: _Chain) -> None:
    """Add what the few intervals with kinks put on the samples before and after them.

    ``spectrum``: derivatives of the coefficients of a contact's forces; ``chain``: what `_Chain.of` gives.
    """
    places = chain.places[1:]
    start, tangential, normal = slopes.of(places, contact, slice(2, None))
    kinks = np.flatnonzero(np.any(tangential, axis=(1, 2, 3)) | np.any(normal, axis=(1, 2)))
    if not kinks.size:
        return
    at, course = places[kinks], _course(basis, places[kinks])
    along = tangential[kinks].reshape(kinks.size, 12, 3) @ course[:, 2:5]
    rows = start[kinks] @ chain.starts(basis, kinks)
    rows[..., :-2] += np.concatenate([along.reshape(kinks.size, 6, -1), normal[kinks] @ course[:, :4]], axis=2)
    put = np.tensordot(basis.project[:, [at - 1, at]], rows.reshape(kinks.size, 2, 3, -1), ((2, 1), (0, 1)))
    spectrum += put.swapaxes(0, 1)
