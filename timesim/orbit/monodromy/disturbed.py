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
from timesim.orbit.monodromy.columns import Columns, by_contact, in_rows, product
from timesim.orbit.monodromy.linearised import Linear, weights_of

MANY = 64
"""Numbers in a state from which on this is as quick as `derivative`; with 28 it takes twice as long."""
LOST = 5e-4
"""Error of the modulus of a multiplier over some steps from which on the modes that it is of are fast."""
FAST = 0.05
"""Share of it, if all steps were alike, from which on a mode is fast over a step."""
VAGUE = 1e-6
"""Product of unit left and right eigenvectors below which a mode counts as one of a defective matrix."""
LEAST, ENTRIES = 8, 100_000
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
    """Fast modes of the structure as contacts hold it while they keep their states, of each of some steps.

    Real parts come before imaginary ones: a product of complex matrices takes four times as long.

    Attributes:
        rates: their eigenvalues, of a conjugate pair the upper one, shape (N, F).
        shapes: parts of their eigenvectors, by which shares make up a state, shape (N, n, 2, F).
        parts: those of the shares of each in a state, shape (N, 2, F, n).
    """

    rates: np.ndarray
    shapes: np.ndarray
    parts: np.ndarray

    def shares(self, columns: np.ndarray) -> np.ndarray:
        """Complex shares of the modes in columns, shape (N, F, n)."""
        num, _, modes, size = self.parts.shape
        both = self.parts.reshape(num, 2 * modes, size) @ columns
        return both[:, :modes] + 1j * both[:, modes:]

    def columns(self, shares: np.ndarray) -> np.ndarray:
        """What shares make up, shape (N, n, n)."""
        num, size, _, modes = self.shapes.shape
        return self.shapes.reshape(num, size, 2 * modes) @ np.concatenate([shares.real, shares.imag], axis=1)

    def change(self, time: np.ndarray) -> np.ndarray:
        """By which each moves by itself for a time, or back where it is negative, less 1, shape (N, F, 1)."""
        return np.expm1(self.rates * time[:, None])[..., None]


class Modes(NamedTuple):
    """Eigenvalues, shape (F,), eigenvectors, columns (n, F), and shares of each mode in a state, shape (F, n)."""

    rates: np.ndarray
    shapes: np.ndarray
    parts: np.ndarray

    def fastest(self, num: int) -> "Modes":
        """The first ones, of a conjugate pair the upper one for both."""
        right, left = self.shapes[:, :num], self.parts[:num]
        parts, upper = np.linalg.pinv(left @ right) @ left, self.rates[:num].imag >= 0
        twice = np.where(self.rates[:num].imag > 0, 2.0, 1.0)
        return Modes(self.rates[:num][upper], (twice * right)[:, upper], parts[upper])


class Disturbed(Columns):
    """Matrices by which steps of an explicit method move small disturbances, in the order of `vector_of`.

    Args:
        system: of one trajectory, its arrays of numpy.
        fastest: bound of the rates of its modes, whatever the contacts hold.
    """

    def __init__(self, method: Explicit, system: System, fastest: float):
        super().__init__(system)
        own = tableau(method.name)
        self.weights, self.stiffness, self.damping = weights_of(own), system.stiffness, system.damping
        self.nodes = np.concatenate([[0.0], own.nodes])[: len(self.weights) - 1]
        self.name, self.fastest = method.name, fastest
        self._modes_of: dict[bytes, Modes] = {}

    def opening(self, steps: Linear) -> np.ndarray:
        """Derivative of the state from which the first step starts by that from which its lane does."""
        columns = np.eye(self.size)[None]
        return self.put(steps.ends.opening[:1], columns)[0]

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
        fast = self._of_steps(steps.rates[:, 0], h, state, allowed)
        slopes = np.empty((len(self.nodes), h.size, self.size, self.size))
        for stage, row in enumerate(self.weights):
            columns = np.tensordot(row[:stage], slopes[:stage], 1)
            columns *= h[:, None, None]
            columns.reshape(h.size, -1)[:, :: self.size + 1] += 1.0  # what is moved is the unit matrix
            after = h * np.append(self.nodes, 1.0)[stage]
            if fast is not None:
                shares = fast.shares(columns)
                columns += fast.columns(fast.change(after) * shares)
            if stage < len(self.nodes):
                slope = self._rate(steps.rates[:, stage], columns, slopes[stage])
                if fast is not None:
                    own = fast.change(-after) * fast.shares(slope) - fast.rates[..., None] * shares
                    slope += fast.columns(own)
        return self.ended(steps.ends, columns)

    def _rate(self, rates: np.ndarray, columns: np.ndarray, out: np.ndarray) -> np.ndarray:
        acts, moving = by_contact(rates, self.of_contacts(columns)), slice(self.modes, 2 * self.modes)
        q, p, push = columns[:, : self.modes], columns[:, moving], out[:, moving]
        np.matmul(self.shape.T, in_rows(acts[:, : self.axes]), out=push)
        push -= self.stiffness[:, None] * q
        push -= self.damping[:, None] * p if self.damping.ndim == 1 else self.damping @ p
        out[:, : self.modes], out[:, 2 * self.modes :] = p, in_rows(acts[:, self.axes :])
        return out

    def _of_steps(self, rates: np.ndarray, h: np.ndarray, state: np.ndarray, allowed: float) -> Fast | None:
        """The modes that are fast over each of some steps, whose axis is the first; None where no mode is.

        ``rates``: of the contacts at their starts, (step, disturbance, rate, contact).
        """
        if error_of(self.name, self.fastest * h.max()) <= allowed:
            return None
        _, first, own = np.unique(state, axis=0, return_index=True, return_inverse=True)
        known = []
        for number, k in enumerate(first):
            modes = self._of_state(rates[k], state[k])
            error = error_of(self.name, np.abs(modes.rates) * h[own == number].max())
            known.append(modes.fastest(int(np.count_nonzero(error > allowed))))
        num = max(len(modes.rates) for modes in known)
        if not num:
            return None
        sizes = (num,), (self.size, 2, num), (2, num, self.size)
        rates, shapes, parts = (np.zeros((first.size, *size), kind) for size, kind in zip(sizes, "Ddd", strict=True))
        for k, modes in enumerate(known):
            count = len(modes.rates)
            rates[k, :count] = modes.rates
            shapes[k, :, 0, :count], shapes[k, :, 1, :count] = modes.shapes.real, -modes.shapes.imag
            parts[k, 0, :count], parts[k, 1, :count] = modes.parts.real, modes.parts.imag
        values = np.where(error_of(self.name, np.abs(rates[own]) * h[:, None]) > allowed, rates[own], 0.0)
        return Fast(values, shapes[own], parts[own])

    def _of_state(self, rates: np.ndarray, state: np.ndarray) -> Modes:
        """All modes as contacts in these states hold the structure."""
        held, normal = np.where(state == SLIP, 0.0, rates), self.axes - 1
        held[normal, normal] = rates[normal, normal]  # the normal load, where a contact slips too
        if state.tobytes() not in self._modes_of:
            one = np.eye(self.size)[None]
            self._modes_of[state.tobytes()] = modes_of(self._rate(held[None], one, np.empty_like(one))[0])
        return self._modes_of[state.tobytes()]


def modes_of(matrix: np.ndarray) -> Modes:
    """Eigenvalues, the fastest first, and eigenvectors of a matrix; without those that a defect leaves vague."""
    values, left, right = scipy.linalg.eig(np.nan_to_num(matrix), left=True)
    clear = np.abs((left.conj() * right).sum(axis=0)) > VAGUE
    order = np.argsort(-np.abs(values), kind="stable")
    order = order[clear[order]]
    return Modes(values[order], right[:, order], left[:, order].conj().T)
