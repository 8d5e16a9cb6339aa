"""Small disturbances led through explicit steps by products of matrices.

That is quicker where there are many modes; and modes that are fast over a step can be taken out of the rates.
"""

import timesim.runtime  # noqa: F401  isort: skip

from functools import cache
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import numpy as np
import scipy.linalg

from timesim.engine.method import Explicit, tableau
from timesim.engine.system import System
from timesim.model.model import SLIP
from timesim.orbit.monodromy.linearised import Linear, weights_of

MANY = 48
"""Numbers in a state from which on this is as quick as `derivative`; with 28 it takes half as long again."""
LOST = 5e-4
"""Error of the modulus of a multiplier over some steps from which on the modes that it is of are fast."""
FAST = 0.05
"""Share of it, if all steps were alike, from which on a mode is fast over a step."""
VAGUE = 1e-6
"""Product of unit left and right eigenvectors below which a mode counts as one of a defective matrix."""
LEAST, ENTRIES = 32, 100_000
"""Steps, and entries of their matrices, that are led through at a time: more do not stay in the caches."""


def error_of(name: str, angle: Any) -> Any:
    """Error of a free vibration after a step of an explicit method in which it turns by an angle [rad]."""
    return np.abs(np.polyval(_stability(name), 1j * np.asarray(angle)) - np.exp(1j * np.asarray(angle)))


@cache
def _stability(name: str) -> np.ndarray:
    """Coefficients of the stability function of a method, the highest power first.

    E. Hairer & G. Wanner, Solving Ordinary Differential Equations II, section IV.2.
    """
    weights = weights_of(tableau(name))
    stages, row, found = weights[:-1], weights[-1], [1.0]
    for _ in range(len(row)):
        found.append(float(row.sum()))
        row = row @ stages
    return np.array(found[::-1])


class Fast(NamedTuple):
    """Fast modes of the structure as contacts hold it while they keep their states.

    Attributes:
        rates: their eigenvalues, shape (F,).
        shapes: eigenvectors of the state, columns, shape (n, F).
        parts: share of each in a state, shape (F, n).
    """

    rates: np.ndarray
    shapes: np.ndarray
    parts: np.ndarray

    def fastest(self, num: int) -> "Fast":
        """The first ones."""
        right, left = self.shapes[:, :num], self.parts[:num]
        return Fast(self.rates[:num], right, np.linalg.pinv(left @ right) @ left)

    def turned(self, columns: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Columns after these modes have moved by themselves for a time, or before it where it is negative."""
        return columns + self._changed(columns, np.exp(self.rates * time[:, None]) - 1)

    def rate(self, columns: np.ndarray) -> np.ndarray:
        """The rate at which they do."""
        return self._changed(columns, self.rates)

    def _changed(self, columns: np.ndarray, factor: np.ndarray) -> np.ndarray:
        return (self.shapes @ (factor[..., None] * (self.parts @ columns))).real


class Disturbed:
    """Matrices by which steps of an explicit method move small disturbances, in the order of `vector_of`.

    Args:
        system: of one trajectory, its arrays of numpy.
    """

    def __init__(self, method: Explicit, system: System):
        own = tableau(method.name)
        self.weights, self.shape = weights_of(own), np.concatenate(system.shape)
        self.nodes = np.concatenate([[0.0], own.nodes])[: len(self.weights) - 1]
        self.modes, self.stiffness = self.shape.shape[1], np.asarray(system.stiffness)
        self.damping = np.asarray(system.damping)
        self.axes = len(system.shape)
        self.size = 2 * self.modes + system.law.preload.size * (self.axes - 1)
        self.name = method.name
        self._modes_of: dict[bytes, Fast] = {}

    def opening(self, steps: Linear) -> np.ndarray:
        """Derivative of the state from which the first step starts by that from which its lane does."""
        return self._put(_on_diagonals(steps.opening[:1]), np.eye(self.size)[None])[0]

    def moved(self, steps: Linear, h: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The product of those of some steps of lengths h in these states of the contacts, shape (n, n)."""
        num, whole = max(LEAST, ENTRIES // self.size**2), np.eye(self.size)
        allowed = FAST * LOST / max(h.size, 1)
        for first in range(0, h.size, num):
            own = slice(first, first + num)
            part = jax.tree.map(itemgetter(own), steps)
            whole = product(self._moves(part, h[own], state[own], allowed)) @ whole
        return whole

    def _moves(self, steps: Linear, h: np.ndarray, state: np.ndarray, allowed: float) -> np.ndarray:
        """Those of a few steps, shape (N, n, n); ``allowed``: error from which on a mode is fast."""
        rates = _on_diagonals(steps.rates)
        fast = self._of_steps(steps.rates[:, 0], h, state, allowed)
        start = np.broadcast_to(np.eye(self.size), (h.size, self.size, self.size))
        slopes: list[np.ndarray] = []
        for stage, row in enumerate(self.weights):
            columns = start + h[:, None, None] * sum(weight * slope for weight, slope in zip(row, slopes, strict=False))
            after = h * np.append(self.nodes, 1.0)[stage]
            columns = columns if fast is None else fast.turned(columns, after)
            if stage < len(self.nodes):
                slope = self._rate(rates[:, stage], columns)
                slopes.append(slope if fast is None else fast.turned(slope - fast.rate(columns), -after))
        delay = steps.delay.reshape(h.size, 1, -1) @ self._of_contacts(columns)
        columns = self._put(_on_diagonals(steps.put), columns + steps.before[..., None] * delay)
        return columns - steps.after[..., None] * delay

    def _of_contacts(self, columns: np.ndarray) -> np.ndarray:
        """Those of the contacts, rows in the order of the disturbance and the contact."""
        q, p, w = np.split(columns, [self.modes, 2 * self.modes], axis=-2)
        return np.concatenate([self.shape @ q, self.shape @ p, w], axis=-2)

    def _rate(self, blocks: np.ndarray, columns: np.ndarray) -> np.ndarray:
        q, p, _ = np.split(columns, [self.modes, 2 * self.modes], axis=-2)
        pushes, dw = np.split(blocks @ self._of_contacts(columns), [len(self.shape)], axis=-2)
        drag = self.damping[:, None] * p if self.damping.ndim == 1 else self.damping @ p
        return np.concatenate([p, self.shape.T @ pushes - self.stiffness[:, None] * q - drag, dw], axis=-2)

    def _put(self, blocks: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return np.concatenate([columns[..., : 2 * self.modes, :], blocks @ self._of_contacts(columns)], axis=-2)

    def _of_steps(self, rates: np.ndarray, h: np.ndarray, state: np.ndarray, allowed: float) -> Fast | None:
        """The modes that are fast over each of some steps, whose axis is the first; None where no mode is.

        ``rates``: of the contacts at their starts, (step, disturbance, rate, contact).
        """
        _, first, own = np.unique(state, axis=0, return_index=True, return_inverse=True)
        known = []
        for number, k in enumerate(first):
            modes = self._of_state(rates[k], state[k])
            error = error_of(self.name, np.abs(modes.rates) * h[own == number].max())
            known.append(modes.fastest(int(np.count_nonzero(error > allowed))))
        num = max(len(modes.rates) for modes in known)
        if not num:
            return None
        all_of = Fast(
            *(np.zeros((first.size, *shape), complex) for shape in ((num,), (self.size, num), (num, self.size)))
        )
        for k, modes in enumerate(known):
            count = len(modes.rates)
            all_of.rates[k, :count], all_of.shapes[k, :, :count], all_of.parts[k, :count] = modes
        values, shapes, parts = (table[own] for table in all_of)
        return Fast(np.where(error_of(self.name, np.abs(values) * h[:, None]) > allowed, values, 0.0), shapes, parts)

    def _of_state(self, rates: np.ndarray, state: np.ndarray) -> Fast:
        """All modes as contacts in these states hold the structure."""
        held, normal = np.where(state == SLIP, 0.0, rates), self.axes - 1
        held[normal, normal] = rates[normal, normal]  # the normal load, where a contact slips too
        if state.tobytes() not in self._modes_of:
            self._modes_of[state.tobytes()] = modes_of(self._rate(_on_diagonals(held), np.eye(self.size)))
        return self._modes_of[state.tobytes()]


def modes_of(matrix: np.ndarray) -> Fast:
    """Eigenvalues, the fastest first, and eigenvectors of a matrix; without those that a defect leaves vague."""
    values, left, right = scipy.linalg.eig(np.nan_to_num(matrix), left=True)
    clear = np.abs((left.conj() * right).sum(axis=0)) > VAGUE
    order = np.argsort(-np.abs(values), kind="stable")
    order = order[clear[order]]
    return Fast(values[order], right[:, order], left[:, order].conj().T)


def product(moves: np.ndarray) -> np.ndarray:
    """The product of matrices, the first on the right."""
    while (num := len(moves)) > 1:
        pairs = moves[1::2] @ moves[: num & ~1 : 2]
        moves = np.concatenate([pairs, moves[-1:]]) if num % 2 else pairs
    return moves[0]


def _on_diagonals(blocks: np.ndarray) -> np.ndarray:
    """Rows by columns of all contacts, from (..., column, row, contact)."""
    *before, columns, rows, contacts = blocks.shape
    whole, at = np.zeros((*before, rows, contacts, columns, contacts)), np.arange(contacts)
    whole[..., :, at, :, at] = np.moveaxis(blocks, (-1, -2, -3), (0, -2, -1))
    return whole.reshape(*before, rows * contacts, columns * contacts)
