"""Stability of periodic solutions: Floquet multipliers of the linearised contact law.

Over one sample interval the modes move exactly for the mean of the contact forces at both ends. That is of second order
however stiff a contact is (the average acceleration of N. M. Newmark, J. Eng. Mech. Div. ASCE 85 (1959) 67-94); forces
taken as linear would grow without end where one vibrates faster than the samples. The law of `timesim.hbm.period`,
linearised about the solution, gives these forces from the motion and from the elastic displacement d of the contacts.
The product of these maps over the period is the monodromy matrix of (q, q', d), whose eigenvalues are the multipliers.
The memory of the contacts is therefore a part of the state; transitions need no saltation, since the contact force is
continuous through all of them and the derivatives of an interval hold their shift. Disturbances so large that the
contacts take on states which the solution does not have are beyond a linearisation: a small push may free a contact
that sticks all along.

The number of real multipliers above 1 is odd where the determinant of the balance is negative. That is exact, unlike
the multipliers, in which the samples leave an error. But a contact that sticks keeps its slip, hence the offset g of
its force, which the balance chooses anew for each motion x (`timesim.hbm.stuck_offset`), and of

    det (r_x + r_g g_x) = det r_x  det (1 + r_x^-1 r_g g_x)

only the first factor concerns disturbances; the other one turns the curve.

G. Floquet, Sur les équations différentielles linéaires à coefficients périodiques, Annales scientifiques de l'ENS 12
(1883) 47-88; A. H. Nayfeh and B. Balachandran, Applied Nonlinear Dynamics (Wiley 1995), chapter 3.
"""

import timesim.runtime  # noqa: F401  isort: skip

from dataclasses import replace

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

from timesim.engine.law.cone import ConeLaw
from timesim.hbm.balance import Array, Balance
from timesim.hbm.continuation import Curve
from timesim.hbm.period import basis_of, period_of, touching_stiffness
from timesim.hbm.tangent import interval_slopes

# Modulus of a multiplier above which a solution is unstable: those of an undamped structure lie on the unit circle but
# for the error of the samples.
BORDER = 1 + 1e-3
# Distance of a real multiplier from 1 within which the determinant of the balance decides: the samples leave an error
# of this size.
NEAR_ONE = 0.03
# Estimated errors by which a modulus must be off that, or the solution is looked at again with `MANY` samples.
SAFETY, MANY = 5.0, 2048
# Change of the logarithm from fewer samples up to which a multiplier is the same one, and modulus from which on it is
# extrapolated.
ALIKE, DEAD = 0.3, 1e-2
# With half as many the largest multiplier errs by at most 3e-3 on the paper's oscillator in slip and separation, and by
# up to 0.097 on the structures there.
SAMPLES = 256
# Entries of the maps over the intervals that are in memory at a time, and those of one interval of one contact: 4 and
# 12 that give d, 6 and 18 that give what is put on the samples, twice, and 18, 18 and 36 by the force at its end.
MAX_ENTRIES, ENTRIES = 8_000_000, 142
# What the law gives over an interval: d, and the force put on the samples beside it.
RESULTS = (slice(0, 2), slice(2, 5))
# Contacts, of several solutions, that one call evaluates.
SIDE_BY_SIDE = 16


def floquet_multipliers(balance: Balance, x: Array, frequency: Array, *, samples: int | None = None) -> Array:
    """Multipliers of solutions, largest first; a contact in full stick gives two that are 1.

    Args:
        balance: the equations solved.
        x: unknowns of `Balance`, shape (S, n).
        frequency: of the excitation [Hz], shape (S,).

    Keyword Args:
        samples: of the period, from which and from half as many they are extrapolated; by default those of the
            balance, at least `SAMPLES`.

    Returns:
        multipliers, complex, shape (S, 2M + 2C).
    """
    return _with_doubt(balance, x, frequency, samples)[0]


def checked_multipliers(balance: Balance, x: Array, frequency: Array, sign: NDArray[np.int64]) -> Array:
    """`floquet_multipliers`, with more samples where stability is in doubt or the sign of det dr/dx contradicts.

    On structures with stiff contacts real ones of 0.95 and 1.20 were 1.29 and 0.34 with 128 and 156 samples.

    Args:
        balance, x, frequency: as of `floquet_multipliers`.
        sign: of det dr/dx, shape (S,), 0 where it does not tell.
    """
    multipliers, doubt = _with_doubt(balance, x, frequency)
    passed = np.count_nonzero((multipliers.imag == 0) & (multipliers.real > BORDER), axis=1)
    again = np.flatnonzero(doubt.any(axis=1) | (sign * (-1) ** passed < 0))
    if balance.scheme.time_samples < MANY:
        multipliers[again] = floquet_multipliers(balance, x[again], frequency[again], samples=MANY)
    return multipliers


def _with_doubt(
    balance: Balance, x: Array, frequency: Array, samples: int | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """`floquet_multipliers`, and of which of them more samples might tell that they are on the other side of 1."""
    samples = samples or max(SAMPLES, balance.scheme.time_samples)
    fine, coarse = (_by_samples(balance, x, frequency, number) for number in (samples, samples // 2))
    both = [extrapolated(*pair, samples / (samples // 2)) for pair in zip(fine, coarse, strict=True)]
    multipliers, doubt = np.array(both, complex).reshape(-1, 2, fine.shape[1]).swapaxes(0, 1)
    order = np.argsort(-np.abs(multipliers), axis=1)
    return np.take_along_axis(multipliers, order, axis=1), np.take_along_axis(doubt, order, axis=1) == 1


def extrapolated(fine: Array, coarse: Array, ratio: float) -> tuple[Array, NDArray[np.bool_]]:
    """Multipliers of a solution from those with samples and with fewer [1]_, and which may be on the other side of 1.

    Logarithms are extrapolated, so a mode that vibrates faster than the samples keeps its modulus. It may find no
    partner among those with fewer samples, or a wrong one; one of a pair that is real in one and complex in the other
    finds none. They stay as they are, and so do those that may be on the other side.

    .. [1] L. F. Richardson, Philosophical Transactions of the Royal Society A 210 (1911) 307-357.
    """
    partner = coarse[linear_sum_assignment(np.abs(fine[:, None] - coarse))[1]]
    alike = (np.minimum(np.abs(fine), np.abs(partner)) > DEAD) & ((fine.imag == 0) == (partner.imag == 0))
    change = np.log(np.where(alike, fine / np.where(alike, partner, 1.0), 1.0))
    change = np.where(np.abs(change) < ALIKE, change, 0.0) / (ratio**2 - 1)
    better = fine * np.exp(change)
    error = np.abs(np.abs(fine) - np.abs(np.where(change == 0, partner, better)))
    doubt = np.abs(np.abs(better) - BORDER) < SAFETY * error
    return np.where(doubt, fine, better), doubt


def _by_samples(balance: Balance, x: Array, frequency: Array, samples: int) -> Array:
    """The multipliers that so many samples give, shape (S, 2M + 2C)."""
    size = 2 * (balance.model.structure.num_modes + balance.num_contacts)
    if not len(x):
        return np.zeros((0, size), complex)
    local = _linearised(balance, balance.coefficients(x), samples)
    count = max(1, MAX_ENTRIES // (samples * ENTRIES * balance.num_contacts**2))
    parts = [slice(i, i + count) for i in range(0, len(x), count)]
    matrix = np.concatenate(
        [_monodromy(balance, _steps(balance, frequency[at], samples), [part[at] for part in local]) for at in parts]
    )
    return np.linalg.eigvals(matrix).astype(complex)  # real where all of them are


def grows(multipliers: Array) -> NDArray[np.bool_]:
    """Whether disturbances of solutions grow, shape (S,), by their multipliers, largest first.

    Whether a real one has passed 1, as at a fold, the determinant tells exactly; a complex pair it does not see.
    """
    at_one = (multipliers.imag == 0) & (np.abs(multipliers - 1) <= NEAR_ONE)
    return ((np.abs(multipliers) > BORDER) & ~at_one).any(axis=1)


def sign_with_offsets_kept(balance: Balance, x: Array, frequency: float, sign: int) -> int:
    """Sign of det dr/dx at a solution whose contacts keep their offsets, from that where these follow the motion.

    At a fold, where that is 0, it stays so.
    """
    if sign == 0 or not balance.has_offset(x):
        return sign
    _, by_x, _ = balance.linearised(x, frequency, keep_offsets=True)
    return by_x.sign * int(np.linalg.slogdet(by_x.matrix)[0])


def with_offsets_kept(curve: Curve, sign: NDArray[np.int64]) -> Curve:
    """A curve with these signs of det dr/dx, shape (S,), and no fold where nothing but an offset turns it."""
    sign, fold, inner = sign.copy(), curve.fold.copy(), np.flatnonzero(~curve.fold)
    by_offset = (sign * curve.determinant)[inner]
    for i in np.flatnonzero(fold):
        after = int(np.searchsorted(inner, i))
        if 0 < after < inner.size and by_offset[after] != by_offset[after - 1]:
            fold[i], sign[i] = False, sign[inner[after]]
    return replace(curve, fold=fold, determinant=sign)


def _linearised(balance: Balance, coefficient: Array, samples: int) -> list[Array]:
    """Derivatives of what the law gives over each interval, and the normal stiffness that acts at its end.

    The former are those of d at its end and of the force put on the samples beside it, 5 for a contact, by d at its
    start and by the motion s = (u1, u2, v) and its rates at both ends, time in units of the interval: shapes
    (S, N, C, 5, 2), twice (S, N, C, 5, 6), and (S, N, C).
    """
    basis, count = basis_of(balance.scheme.harmonics, samples), max(1, SIDE_BY_SIDE // balance.num_contacts)
    law = jax.tree.map(lambda leaf: np.tile(leaf, count), balance.law)

    def local(own: Array) -> list[Array]:
        contacts = np.resize(own, (count, *own.shape[1:])).reshape(-1, *own.shape[2:])
        period = period_of(law, basis, contacts)
        slope = interval_slopes(law, period)
        change, rate0, rate1 = np.moveaxis(slope.tangential, -1, 0)
        v0, v1, dv0, dv1 = np.moveaxis(slope.normal[..., None], -2, 0)
        before, after = (
            np.concatenate([-change, v0, rate0, dv0], axis=-1),
            np.concatenate([change, v1, rate1, dv1], axis=-1),
        )
        slopes = [
            np.concatenate([part[..., :2, :], part[..., 2:5, :] + part[..., 5:, :]], axis=-2)
            for part in (slope.start, before, after)
        ]
        rows = *slopes, touching_stiffness(law, period.motion)
        return [leaf.reshape(samples, count, -1, *leaf.shape[2:]).swapaxes(0, 1)[: len(own)] for leaf in rows]

    parts = [local(coefficient[first : first + count]) for first in range(0, len(coefficient), count)]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def _steps(balance: Balance, frequency: Array, samples: int) -> tuple[Array, Array]:
    """The modes over an interval: x1 = keep x0 + hold (g0 + g1) for the forces g at its ends, their mean held.

    x = (q, q'), time in periods over 2 pi; shapes (S, 2M, 2M) and (S, 2M, 3C).
    """
    if balance.damping.ndim == 2:
        each = [_coupled_step(balance, one, samples) for one in frequency]
        keep, hold = (np.stack(column) for column in zip(*each, strict=True))
        return keep, hold
    size, span = balance.model.structure.num_modes, 2 * np.pi / samples
    omega = 2 * np.pi * frequency[:, None]
    whole = np.zeros((len(frequency), size, 3, 3))
    whole[..., 0, 1] = span
    whole[..., 1, 0] = -((balance.model.structure.omega / omega) ** 2) * span
    whole[..., 1, 1] = -balance.damping / omega * span
    whole[..., 1, 2] = span / omega**2 / 2
    flow = expm(whole)
    hold = flow[..., :2, 2].swapaxes(1, 2)[..., None] * balance.shape.T
    return _diagonal(flow[..., :2, :2]), hold.reshape(len(frequency), 2 * size, -1)


def _diagonal(flow: Array) -> Array:
    """Matrices of (q, q') from those of each mode, shape (S, M, 2, 2)."""
    count, size = flow.shape[:2]
    whole, modes = np.zeros((count, 2, size, 2, size)), np.arange(size)
    whole[:, :, modes, :, modes] = flow.swapaxes(0, 1)
    return whole.reshape(count, 2 * size, 2 * size)


def _coupled_step(balance: Balance, frequency: float, samples: int) -> tuple[Array, Array]:
    """The same at one frequency for modes that the damping couples."""
    omega, span = 2 * np.pi * frequency, 2 * np.pi / samples
    size = balance.model.structure.num_modes
    whole = np.zeros((2 * size + 3 * balance.num_contacts,) * 2)
    whole[:size, size : 2 * size] = np.eye(size) * span
    whole[size : 2 * size, :size] = -np.diag((balance.model.structure.omega / omega) ** 2) * span
    whole[size : 2 * size, size : 2 * size] = -balance.damping / omega * span
    whole[size : 2 * size, 2 * size :] = balance.shape.T * (span / omega**2 / 2)
    flow = expm(whole)[: 2 * size]
    return flow[:, : 2 * size], flow[:, 2 * size :]


def _monodromy(balance: Balance, steps: tuple[Array, Array], local: list[Array]) -> Array:
    """Product of the maps of (x, d) over the intervals of a period, shape (S, 2M + 2C, 2M + 2C).

    The motion s = T x of the contacts and d at its end obey the law, with the force g = -K d - P s at both ends. What
    is put on them for kinks acts for a whole interval: for twice as long as an end does by `hold`. So over an interval

        x1 = keep x + hold (A (d, s) - F s1),  d1 = B (d, s) + D s1,  s1 = T x1,

    with matrices that are put together beforehand, F s1 = (1 + F T hold)^-1 F T (keep x + hold A (d, s)) among them.
    """
    keep, hold = steps
    *slopes, touching = local
    ratio, num_modes = balance.force / balance.length, balance.shape.shape[1]
    press = np.zeros((*touching.shape, 3, 6))
    press[..., 2, 2] = touching
    press, spring = ratio * _blocks(press), ratio * _spring(balance.law)
    carry, begin, end = ([_blocks(part[..., rows, :]) for rows in RESULTS] for part in slopes)
    seen = _seen(balance, touching.shape[1])
    moved, put = (np.concatenate(pair, axis=-1) for pair in zip(carry, begin, strict=True))
    before = np.concatenate([np.broadcast_to(spring, (*press.shape[:-1], spring.shape[1])), np.roll(press, 1, 1)], -1)
    given = np.concatenate([-before - 2 * ratio * put - spring @ moved, moved], axis=-2)
    felt = spring @ end[0] + press + 2 * ratio * end[1]
    flow, forces, at_contacts = np.concatenate([keep, hold], axis=-1), len(spring), seen @ hold
    held = np.linalg.solve(np.eye(forces) + felt @ at_contacts[:, None], felt)
    size = 2 * num_modes + spring.shape[1]
    start = np.broadcast_to(np.eye(size), (len(hold), size, size))
    x, d = start[:, : 2 * num_modes], start[:, 2 * num_modes :]
    s, seen_flow = seen @ x, seen @ flow
    for k in range(touching.shape[1]):
        own = given[:, k] @ np.concatenate([d, s], axis=1)
        free = seen_flow @ np.concatenate([x, own[:, :forces]], axis=1)
        back = held[:, k] @ free
        s = free - at_contacts @ back
        x = flow @ np.concatenate([x, own[:, :forces] - back], axis=1)
        d = own[:, forces:] + end[0][:, k] @ s
    return np.concatenate([x, d], axis=1)


def _seen(balance: Balance, samples: int) -> Array:
    """T: (u1, u2, v) of each contact and their rates, time in units of the interval, from x, shape (6C, 2M)."""
    shape = balance.shape.reshape(balance.num_contacts, 3, -1)
    none = np.zeros_like(shape)
    rows = [np.concatenate([shape, none], axis=2), np.concatenate([none, 2 * np.pi / samples * shape], axis=2)]
    return np.concatenate(rows, axis=1).reshape(6 * balance.num_contacts, -1)


def _blocks(small: Array) -> Array:
    """Block diagonal matrices of one block a contact, from shape (..., C, rows, columns)."""
    count, rows, columns = small.shape[-3:]
    whole = np.zeros((*small.shape[:-3], count, rows, count, columns))
    for i in range(count):
        whole[..., i, :, i, :] = small[..., i, :, :]
    return whole.reshape(*small.shape[:-3], count * rows, count * columns)


def _spring(law: ConeLaw) -> Array:
    """K_u of all contacts, from (d1, d2) to (f1, f2, 0), shape (3C, 2C)."""
    parts = [np.asarray(part) for part in law.stiffness]
    k11, k12, k22 = parts if len(parts) == 3 else (parts[0], np.zeros_like(parts[0]), parts[0])
    none = np.zeros_like(k11)
    return _blocks(np.stack([k11, k12, k12, k22, none, none], axis=1).reshape(-1, 3, 2))
