"""Stability of periodic solutions: Floquet multipliers of the linearised contact law.

Over one sample interval the modes move exactly for a contact force that varies linearly, and the law of
`timesim.hbm.period`, linearised about the solution, gives that force from the motion and from the elastic displacement
d of the contacts. The product of these maps over the period is the monodromy matrix of (q, q', d), whose eigenvalues
are the multipliers. The memory of the contacts is therefore a part of the state; transitions need no saltation, since
the contact force is continuous through all of them and the derivatives of an interval hold their shift. Disturbances
so large that the contacts take on states which the solution does not have are beyond a linearisation: a small push
may free a contact that sticks all along.

G. Floquet, Sur les équations différentielles linéaires à coefficients périodiques, Annales scientifiques de l'ENS 12
(1883) 47-88; A. H. Nayfeh and B. Balachandran, Applied Nonlinear Dynamics (Wiley 1995), chapter 3.
"""

import timesim.runtime  # noqa: F401  isort: skip

import jax
import numpy as np
from scipy.linalg import expm

from timesim.engine.law.cone import ConeLaw
from timesim.hbm.balance import Array, Balance
from timesim.hbm.period import basis_of, motion_of, period_of, touching_stiffness
from timesim.hbm.tangent import straight_slopes

# Modulus of a multiplier above which a solution is unstable: those of an undamped structure lie on the unit circle but
# for the error of the samples.
BORDER = 1 + 1e-3
# With so many the largest multiplier errs by at most 2e-2 on the paper's oscillator in slip and separation (measured).
SAMPLES = 128
# Entries of the maps over the intervals that are in memory at a time.
MAX_ENTRIES = 2_000_000
# Contacts, of several solutions, that one call evaluates.
SIDE_BY_SIDE = 16


def floquet_multipliers(balance: Balance, x: Array, frequency: Array, *, samples: int = SAMPLES) -> Array:
    """Multipliers of solutions, largest first; a contact in full stick gives two that are 1.

    Args:
        balance: the equations solved.
        x: unknowns of `Balance`, shape (S, n).
        frequency: of the excitation [Hz], shape (S,).

    Keyword Args:
        samples: of the period; second order.

    Returns:
        multipliers, complex, shape (S, 2M + 2C).
    """
    size = 2 * (balance.model.structure.num_modes + balance.num_contacts)
    if not len(x):
        return np.zeros((0, size), complex)
    local = _linearised(balance, balance.coefficients(x), samples)
    count = max(1, MAX_ENTRIES // (samples * size**2))
    parts = [slice(i, i + count) for i in range(0, len(x), count)]
    matrix = np.concatenate(
        [_monodromy(balance, _steps(balance, frequency[at], samples), [part[at] for part in local]) for at in parts]
    )
    multipliers = np.linalg.eigvals(matrix)
    return np.take_along_axis(multipliers, np.argsort(-np.abs(multipliers), axis=1), axis=1)


def _linearised(balance: Balance, coefficient: Array, samples: int) -> list[Array]:
    """Derivatives of d at the end of each interval by d at its start, by the change of y and by v, and the touch.

    Shapes (S, N, C, 2, 2), (S, N, C, 2, 3), (S, N, C, 2) and (S, N, C): the normal stiffness that acts at each sample.
    """
    basis, count = basis_of(balance.scheme.harmonics, samples), max(1, SIDE_BY_SIDE // balance.num_contacts)
    law = jax.tree.map(lambda leaf: np.tile(leaf, count), balance.law)

    def local(own: Array) -> list[Array]:
        contacts = np.resize(own, (count, *own.shape[1:])).reshape(-1, *own.shape[2:])
        motion, period = motion_of(basis, contacts), period_of(law, basis, contacts)
        slope = straight_slopes(law, period, motion)
        change = np.concatenate([slope[..., 2:4], -slope[..., 4:5]], axis=-1)
        rows = slope[..., :2], change, slope[..., 4] + slope[..., 5], touching_stiffness(law, motion)
        return [leaf.reshape(samples, count, -1, *leaf.shape[2:]).swapaxes(0, 1)[: len(own)] for leaf in rows]

    parts = [local(coefficient[first : first + count]) for first in range(0, len(coefficient), count)]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def _steps(balance: Balance, frequency: Array, samples: int) -> tuple[Array, Array, Array]:
    """The modes over an interval: x1 = keep x0 + first g0 + last g1 for a force g that varies linearly.

    x = (q, q'), time in periods over 2 pi; shapes (S, 2M, 2M), or (S, M, 2, 2) of modes that the damping leaves apart,
    and twice (S, 2M, 3C).
    """
    if balance.damping.ndim == 2:
        each = [_coupled_step(balance, one, samples) for one in frequency]
        keep, first, last = (np.stack(column) for column in zip(*each, strict=True))
        return keep, first, last
    size, span = balance.model.structure.num_modes, 2 * np.pi / samples
    omega = 2 * np.pi * frequency[:, None]
    whole = np.zeros((len(frequency), size, 4, 4))
    whole[..., 0, 1] = span
    whole[..., 2, 3] = 1.0
    whole[..., 1, 0] = -((balance.model.structure.omega / omega) ** 2) * span
    whole[..., 1, 1] = -balance.damping / omega * span
    whole[..., 1, 2] = span / omega**2
    flow = expm(whole)
    begin, end = flow[..., :2, 2] - flow[..., :2, 3], flow[..., :2, 3]
    first, last = (
        (part.swapaxes(1, 2)[..., None] * balance.shape.T).reshape(len(frequency), 2 * size, -1)
        for part in (begin, end)
    )
    return flow[..., :2, :2], first, last


def _coupled_step(balance: Balance, frequency: float, samples: int) -> tuple[Array, Array, Array]:
    """The same at one frequency for modes that the damping couples."""
    omega, span = 2 * np.pi * frequency, 2 * np.pi / samples
    size, forces = balance.model.structure.num_modes, 3 * balance.num_contacts
    whole = np.zeros((2 * size + 2 * forces,) * 2)
    whole[:size, size : 2 * size] = np.eye(size) * span
    whole[size : 2 * size, :size] = -np.diag((balance.model.structure.omega / omega) ** 2) * span
    whole[size : 2 * size, size : 2 * size] = -balance.damping / omega * span
    whole[size : 2 * size, 2 * size : -forces] = balance.shape.T * (span / omega**2)
    whole[2 * size : -forces, -forces:] = np.eye(forces)
    flow = expm(whole)[: 2 * size]
    last = flow[:, -forces:]
    return flow[:, : 2 * size], flow[:, 2 * size : -forces] - last, last


def _kept(keep: Array, x: Array) -> Array:
    """keep x of `_steps`, x of shape (S, 2M, columns)."""
    if keep.ndim == 3:
        return keep @ x
    q, p = np.split(x, 2, axis=1)
    k = keep[..., None]
    return np.concatenate([k[:, :, 0, 0] * q + k[:, :, 0, 1] * p, k[:, :, 1, 0] * q + k[:, :, 1, 1] * p], axis=1)


def _monodromy(balance: Balance, steps: tuple[Array, Array, Array], local: list[Array]) -> Array:
    """Product of the maps of (x, d) over the intervals of a period, shape (S, 2M + 2C, 2M + 2C).

    With the motion y = E x and the force g = -K d - P y of the contacts at both ends of an interval, its end follows
    from d1 = carry d0 + change (y1 - y0) + load v1.
    """
    keep, first, last = steps
    carry, change, load, touching = local
    ratio, shape = balance.force / balance.length, balance.shape
    normal = np.zeros((*touching.shape, 3, 3))
    normal[..., 2, 2] = ratio * touching
    at_end = change.copy()
    at_end[..., 2] += load
    carry, change, rising, press = (_blocks(part) for part in (carry, change, at_end, normal))
    spring = ratio * _spring(balance.law)
    num_modes, size = shape.shape[1], 2 * (shape.shape[1] + balance.num_contacts)
    start = np.broadcast_to(np.eye(size), (len(first), size, size))
    x, d = start[:, : 2 * num_modes], start[:, 2 * num_modes :]
    y = shape @ x[:, :num_modes]
    g = -spring @ d - press[:, -1] @ y
    both, seen_first = np.concatenate([first, last], axis=2), shape @ first[:, :num_modes]
    seen_last = shape @ last[:, :num_modes]
    back = seen_last[:, None] @ (spring @ rising + press)
    inverse = np.linalg.inv(np.eye(len(shape)) + back)
    for k in range(carry.shape[1]):
        d = carry[:, k] @ d - change[:, k] @ y
        x = _kept(keep, x)
        y = inverse[:, k] @ (shape @ x[:, :num_modes] + seen_first @ g - seen_last @ (spring @ d))
        d = d + rising[:, k] @ y
        end = -spring @ d - press[:, k] @ y
        x, g = x + both @ np.concatenate([g, end], axis=1), end
    return np.concatenate([x, d], axis=1)


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
