"""Small disturbances as columns, and what transitions at the ends of steps do to them, by products of matrices."""

import timesim.runtime  # noqa: F401  isort: skip

import numpy as np

from timesim.engine.system import System
from timesim.orbit.monodromy.linearised import Ends


class Columns:
    """Columns of disturbances in the order of `vector_of`.

    Args:
        system: of one trajectory, its arrays of numpy.
    """

    def __init__(self, system: System):
        self.shape = np.concatenate(system.shape)
        self.modes, self.axes, self.contacts = self.shape.shape[1], len(system.shape), system.law.preload.size
        self.size = 2 * self.modes + self.contacts * (self.axes - 1)

    def of_contacts(self, columns: np.ndarray) -> np.ndarray:
        """Those of the contacts, shape (N, disturbance, contact, n)."""
        num, size, axes = len(columns), columns.shape[-1], self.axes
        local = np.empty((num, 3 * axes - 1, self.contacts, size))
        motion = columns[:, : 2 * self.modes].reshape(num, 2, self.modes, size)
        np.matmul(self.shape, motion, out=local[:, : 2 * axes].reshape(num, 2, len(self.shape), size))
        local[:, 2 * axes :] = columns[:, 2 * self.modes :].reshape(num, axes - 1, self.contacts, size)
        return local

    def ended(self, ends: Ends, columns: np.ndarray) -> np.ndarray:
        """Columns after the transitions at the ends of steps, from those before; both (N, n, n)."""
        local = self.of_contacts(columns).reshape(len(columns), (3 * self.axes - 1) * self.contacts, self.size)
        delay = ends.delay.reshape(len(columns), 1, local.shape[1]) @ local
        return self.put(ends.put, columns + ends.before[..., None] * delay) - ends.after[..., None] * delay

    def put(self, blocks: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Columns with w as it is after a transition."""
        slip = in_rows(by_contact(blocks, self.of_contacts(columns)))
        return np.concatenate([columns[:, : 2 * self.modes], slip], axis=1)


def by_contact(blocks: np.ndarray, local: np.ndarray) -> np.ndarray:
    """What each contact does by itself, shape (N, row, contact, n), from blocks (N, disturbance, row, contact)."""
    found = np.empty((len(local), blocks.shape[2], *local.shape[2:]))
    np.matmul(blocks.transpose(0, 3, 2, 1), local.swapaxes(1, 2), out=found.swapaxes(1, 2))
    return found


def in_rows(parts: np.ndarray) -> np.ndarray:
    """(N, row, contact, n) with all contacts of a row below those of the row before."""
    num, rows, contacts, size = parts.shape
    return parts.reshape(num, rows * contacts, size)


def product(moves: np.ndarray) -> np.ndarray:
    """The product of matrices, the first on the right."""
    while (num := len(moves)) > 1:
        pairs = moves[1::2] @ moves[: num & ~1 : 2]
        moves = np.concatenate([pairs, moves[-1:]]) if num % 2 else pairs
    return moves[0]
