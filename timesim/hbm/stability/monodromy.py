"""Monodromy matrices of periodic solutions: what becomes of disturbances of (q, q', d) over a period.

Where no contact slips or changes its state the structure with its stuck contacts is linear, and its flow exact, however
fast a stiff contact vibrates. Over another sample interval the modes move exactly for the mean of the contact forces at
both ends. That is of second order however stiff a contact is (the average acceleration of N. M. Newmark, J. Eng. Mech.
Div. ASCE 85 (1959) 67-94); forces taken as linear would grow without end where one vibrates faster than the samples.
The law of `timesim.hbm.period`, linearised about the solution, gives these forces from the motion and from the elastic
displacement d of the contacts. The memory of the contacts is therefore a part of the state; transitions need no
saltation, since the contact force is continuous through all of them and the derivatives of an interval hold their
shift.
"""

import timesim.runtime  # noqa: F401  isort: skip

from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from timesim.engine.law.cone import ConeLaw
from timesim.hbm.balance import Array, Balance
from timesim.hbm.period import Basis, basis_of, period_of, touching_stiffness
from timesim.hbm.tangent import Slope, by_parts, interval_slopes

# Intervals in a row without any change of state from which on they are passed by their exact flow.
LONG = 8
# Intervals of which the maps are in memory at a time.
AT_A_TIME = 256
# What the law gives over an interval: d, and the force put on the samples beside it.
RESULTS = (slice(0, 2), slice(2, 5))
# Contacts, of several solutions, that one call evaluates.
SIDE_BY_SIDE = 16


def monodromy(balance: Balance, x: Array, frequency: Array, samples: int) -> Array:
    """Monodromy matrices of solutions, shape (S, 2M + 2C, 2M + 2C).

    Args:
        balance: the equations solved.
        x: unknowns of `Balance`, shape (S, n).
        frequency: of the excitation [Hz], shape (S,).
        samples: of the period.
    """
    size = 2 * (balance.model.structure.num_modes + balance.num_contacts)
    coefficient, count = balance.coefficients(x), max(1, SIDE_BY_SIDE // balance.num_contacts)
    basis, law = basis_of(balance.scheme.harmonics, samples), jax.tree.map(lambda y: np.tile(y, count), balance.law)
    parts = [slice(first, first + count) for first in range(0, len(x), count)]
    done = [_of_solutions(balance, frequency[own], _Local.of(law, basis, coefficient[own])) for own in parts]
    return np.concatenate(done) if done else np.zeros((0, size, size))


class _Local(NamedTuple):
    """What the law does to disturbances over each interval; S solutions, N samples, C contacts.

    Attributes:
        slope: derivatives of the law, as of `Slope` but with the solutions first, shapes (S, N, C, ...).
        touching: the normal stiffness that acts at the end, shape (S, N, C).
    """

    slope: Slope
    touching: Array

    @classmethod
    def of(cls, law: ConeLaw, basis: Basis, coefficient: Array) -> "_Local":
        """Of solutions, with at most as many contacts as the law has, from their coefficients."""
        num, contacts = coefficient.shape[1], coefficient.reshape(-1, *coefficient.shape[2:])
        period = period_of(law, basis, np.resize(contacts, (law.preload.size, *contacts.shape[1:])))

        def each(leaf: NDArray[Any]) -> NDArray[Any]:
            return leaf.reshape(len(leaf), -1, num, *leaf.shape[2:]).swapaxes(0, 1)[: len(coefficient)]

        slope = interval_slopes(law, period)
        return cls(Slope(*map(each, slope)), each(touching_stiffness(law, period.motion)))

    def slopes(self, places: NDArray[np.int64]) -> list[Array]:
        """Derivatives over some intervals by d at the start, and by the motion s at both ends, shape (S, P, C, 5, ...).

        Of d at the end, and of the force put on the samples beside them; s = (u1, u2, v) and its rates, time in units
        of the interval.
        """
        start, tangential, normal = by_parts(self.slope.by[:, places])
        rate0, rate1, change = np.moveaxis(tangential, -1, 0)
        v0, v1, dv0, dv1 = np.moveaxis(normal[..., None], -2, 0)
        sides = [-change, v0, rate0, dv0], [change, v1, rate1, dv1]
        rows = start, *(np.concatenate(side, axis=-1) for side in sides)
        return [np.concatenate([x[..., :2, :], x[..., 2:5, :] + x[..., 5:, :]], axis=-2) for x in rows]


def _rates(balance: Balance, frequency: Array, more: int) -> Array:
    """Rates of x = (q, q') by x, time in periods over 2 pi, and room for more rows and columns; (S, 2M + more, ...)."""
    omega, size = 2 * np.pi * frequency[:, None, None], balance.model.structure.num_modes
    whole = np.zeros((len(frequency), 2 * size + more, 2 * size + more))
    whole[:, :size, size : 2 * size] = np.eye(size)
    whole[:, size : 2 * size, :size] = -np.diag(balance.model.structure.omega**2) / omega**2
    damping = balance.damping if balance.damping.ndim == 2 else np.diag(balance.damping)
    whole[:, size : 2 * size, size : 2 * size] = -damping / omega
    return whole


def _of_solutions(balance: Balance, frequency: Array, local: _Local) -> Array:
    """Product of the maps of (x, d) over the intervals of a period, shape (S, 2M + 2C, 2M + 2C)."""
    size, samples = 2 * (balance.model.structure.num_modes + balance.num_contacts), local.touching.shape[1]
    y, flows = np.tile(np.eye(size), (len(frequency), 1, 1)), {}
    modes = _modes(balance, frequency, samples)
    for first, end, rests in _runs(local):
        if rests:
            state = local.touching[:, first].tobytes(), local.slope.sticks[:, first].tobytes()
            if state not in flows:
                flows[state] = _resting(balance, frequency, local, first)
            y = np.linalg.matrix_power(flows[state], end - first) @ y
        else:
            for begin in range(first, end, AT_A_TIME):
                places = np.arange(begin, min(begin + AT_A_TIME, end))
                y = _Moving.of(balance, modes, local, places).through(y)
    return y


def _runs(local: _Local) -> list[tuple[int, int, bool]]:
    """Runs of intervals: the first, the one behind the last, and whether no contact changes its state in any of them.

    That is, each contact sticks all along or is apart, or touches without friction, in all solutions.
    """
    touching, sticks = local.touching, local.slope.sticks
    rests = (~local.slope.active & (touching == np.roll(touching, 1, axis=1))).all(axis=(0, 2))
    goes_on = rests & np.roll(rests, 1) & (sticks == np.roll(sticks, 1, axis=1)).all(axis=(0, 2))
    runs: list[tuple[int, int, bool]] = []
    first, cuts = 0, np.append(np.flatnonzero(~goes_on[1:]) + 1, len(rests)).tolist()
    for end in cuts:
        long = bool(rests[first]) and end - first >= LONG
        if runs and not long and not runs[-1][2]:
            runs[-1] = runs[-1][0], end, False
        else:
            runs.append((first, end, long))
        first = end
    return runs


def _resting(balance: Balance, frequency: Array, local: _Local, k: int) -> Array:
    """(x, d) over an interval k in which no contact changes its state, exactly; shape (S, 2M + 2C, 2M + 2C)."""
    size, shape = balance.model.structure.num_modes, balance.shape
    sticks, whole = np.repeat(local.slope.sticks[:, k], 2, axis=1), _rates(balance, frequency, 2 * balance.num_contacts)
    push = balance.force / balance.length * shape.T / (2 * np.pi * frequency[:, None, None]) ** 2
    whole[:, size : 2 * size, :size] -= push[..., 2::3] @ (local.touching[:, k, :, None] * shape[2::3])
    whole[:, size : 2 * size, 2 * size :] = -push @ block_diag(*_springs(balance.law)) * sticks[:, None]
    whole[:, 2 * size :, size : 2 * size] = sticks[..., None] * np.delete(shape, np.s_[2::3], axis=0)
    flow = expm(2 * np.pi / local.touching.shape[1] * whole)
    flow[:, 2 * size :] *= sticks[..., None]
    return flow


class _Moving(NamedTuple):
    """Maps of (x, d) over intervals in which contacts slip or change their states.

    Over an interval the modes move for the mean of the forces g at both ends,

        x1 = keep x + hold (g + g1),  s = T x,  g = -K d - P s.

    With d at its end, which the law gives, and with what is put on both samples for kinks, which acts for a whole
    interval, twice as long as an end does by `hold`, that is

        x1 = keep x + hold (A (d, s) - F s1),  d1 = B (d, s) + D s1,

    and F s1 = (1 + F T hold)^-1 F T (keep x + hold A (d, s)). A, B, F and D concern a contact at a time.

    Attributes:
        given: A and B, shape (S, N, C, 5, 8).
        felt: F, shape (S, N, C, 3, 6).
        inverse: (1 + F T hold)^-1, shape (S, N, 3C, 3C).
        follows: D, shape (S, N, C, 2, 6).
        keep, hold: shapes (S, 2M, 2M) and (S, 2M, 3C).
        seen: T, from the displacements of the modes to (u1, u2, v) of each contact, and alike from their rates, time in
            units of the interval, shape (2, 3C, M).
    """

    given: Array
    felt: Array
    inverse: Array
    follows: Array
    keep: Array
    hold: Array
    seen: Array

    @classmethod
    def of(cls, balance: Balance, flow: Array, local: _Local, places: NDArray[np.int64]) -> "_Moving":
        """The maps over some intervals, by what `_modes` gives."""
        samples, ratio = local.touching.shape[1], balance.force / balance.length
        spring, keep, hold = ratio * _springs(balance.law), *np.split(flow, [2 * balance.shape.shape[1]], axis=2)
        seen = np.stack([balance.shape, 2 * np.pi / samples * balance.shape])
        press0, press1 = np.zeros((2, *local.touching[:, places].shape, 3, 6))
        press0[..., 2, 2], press1[..., 2, 2] = (ratio * local.touching[:, k] for k in (places - 1, places))
        carry, begin, end = ([part[..., rows, :] for rows in RESULTS] for part in local.slopes(places))
        moved, put = (np.concatenate(pair, axis=-1) for pair in zip(carry, begin, strict=True))
        at_start = np.concatenate([np.broadcast_to(spring, (*press0.shape[:-1], 2)), press0], axis=-1)
        given = np.concatenate([-at_start - 2 * ratio * put - spring @ moved, moved], axis=-2)
        felt = spring @ end[0] + press1 + 2 * ratio * end[1]
        change = (felt @ _motion(seen, hold)[:, None]).reshape(*felt.shape[:2], *(len(balance.shape),) * 2)
        return cls(given, felt, np.linalg.inv(np.eye(len(balance.shape)) + change), end[0], keep, hold, seen)

    def through(self, y: Array) -> Array:
        """(x, d) after the intervals, one after the other, from (x, d) before them, shape (S, 2M + 2C, columns)."""
        size, (num, forces, columns) = self.keep.shape[1], (len(y), self.hold.shape[2], y.shape[2])
        x, d = y[:, :size], y[:, size:].reshape(num, -1, 2, columns)
        s = _motion(self.seen, x)
        for k in range(self.given.shape[1]):
            own, kept = self.given[:, k] @ np.concatenate([d, s], axis=2), self.keep @ x
            force = own[:, :, :3].reshape(num, forces, columns)
            felt = self.felt[:, k] @ _motion(self.seen, kept + self.hold @ force)
            x = kept + self.hold @ (force - self.inverse[:, k] @ felt.reshape(num, forces, columns))
            s = _motion(self.seen, x)
            d = own[:, :, 3:] + self.follows[:, k] @ s
        return np.concatenate([x, d.reshape(num, -1, columns)], axis=1)


def _motion(seen: Array, x: Array) -> Array:
    """(u1, u2, v) of each contact and their rates, shape (S, C, 6, columns), from x by the `seen` of `_Moving`."""
    both = seen @ x.reshape(len(x), 2, seen.shape[2], -1)
    return both.reshape(len(x), 2, -1, 3, x.shape[2]).swapaxes(1, 2).reshape(len(x), -1, 6, x.shape[2])


def _modes(balance: Balance, frequency: Array, samples: int) -> Array:
    """Keep and hold of `_Moving`, side by side: the modes over an interval, shape (S, 2M, 2M + 3C)."""
    size = balance.model.structure.num_modes
    whole = _rates(balance, frequency, 3 * balance.num_contacts)
    whole[:, size : 2 * size, 2 * size :] = balance.shape.T / (2 * np.pi * frequency[:, None, None]) ** 2 / 2
    flow: Array = expm(2 * np.pi / samples * whole)[:, : 2 * size]
    return flow


def _springs(law: ConeLaw) -> Array:
    """K_u of each contact, from (d1, d2) to (f1, f2, 0), shape (C, 3, 2)."""
    parts = [np.asarray(part) for part in law.stiffness]
    k11, k12, k22 = parts if len(parts) == 3 else (parts[0], np.zeros_like(parts[0]), parts[0])
    none = np.zeros_like(k11)
    return np.stack([k11, k12, k12, k22, none, none], axis=1).reshape(-1, 3, 2)
