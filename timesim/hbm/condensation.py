"""Derivatives of a balance by few of its unknowns: the motions of contacts that slip, or open and close.

A contact that sticks or is apart all along is linear, as is the tangential motion at one without friction. With such
components L and the others W, and with the derivatives K of the forces on the structure by the motion, those of the
balance are, harmonic by harmonic but for K_W,

    1 - F K = (1 - F K_L) (1 - F' K_W),    F' = (1 - F K_L)^-1 F

where F' is the flexibility of the structure with its linear contacts; the unknowns of L follow from those of W.
"""

import numpy as np
from numpy.typing import NDArray

from timesim.orbit.fourier import Array, Complex, to_coefficients, to_phasors

# Of the largest derivative of a contact: what rounding leaves of one that is zero.
ROUNDING = 1e-12


class Condensation:
    """The derivatives of a balance, for `timesim.hbm.continuation`.

    Its unknowns are the coefficients of all components of all contacts, shape (3C, 2H + 1) made flat.

    Attributes:
        inner, outer: positions of the k unknowns of W, and of the n - k of L.
        matrix: 1 - F' K_W in the rows and columns of W, shape (k, k).
        sign: of the determinant of 1 - F K_L.
    """

    def __init__(self, flexibility: Complex, stiffness: Array):
        """From the flexibility of the structure and the derivatives of the contact forces on it.

        Args:
            flexibility: F, shape (H + 1, 3C, 3C).
            stiffness: K of each contact by its own components, shape (C, 3, 2H + 1, 3, 2H + 1).

        Raises:
            numpy.linalg.LinAlgError: the flexibility is not finite, or the structure with its contacts singular.
        """
        self.stiffness, self.size = stiffness, stiffness.shape[2]
        linear, constant = _linear_part(stiffness)
        self.works = ~linear
        change = np.eye(linear.size) - flexibility @ constant
        if not np.isfinite(change).all():
            raise np.linalg.LinAlgError("the structure is singular")
        self.inverse = np.linalg.inv(change)
        self.flexibility = self.inverse @ flexibility
        # That of a complex matrix is positive as the determinant of a real one.
        self.sign = int(np.sign(np.linalg.det(change[0].real)))
        places = np.arange(linear.size * self.size).reshape(linear.size, self.size)
        self.inner, self.outer = places[self.works].ravel(), places[linear].ravel()
        self.matrix = self._matrix()

    def solve(self, r: Array) -> Array:
        """(1 - F K_L)^-1 r, shape (n,)."""
        return self._by_harmonics(self.inverse, self._rows(r)).ravel()

    def others(self, x: Array) -> Array:
        """Motion of L, shape (n - k,), under the contact forces that motions of W, shape (k,), give."""
        rows = np.zeros((self.works.size, self.size))
        rows[self.works] = self._rows(x)
        forces = np.einsum("cjhkl,ckl->cjh", self.stiffness, rows.reshape(-1, 3, self.size))
        return self._by_harmonics(self.flexibility, self._rows(forces))[~self.works].ravel()

    def on_others(self, row: Array) -> Array:
        """The transpose of that: from a row of L to one of W."""
        rows = np.zeros((self.works.size, self.size))
        rows[~self.works] = self._rows(row)
        forces = self._by_harmonics(self.flexibility.conj().swapaxes(1, 2), rows).reshape(-1, 3, self.size)
        return np.einsum("cjhkl,cjh->ckl", self.stiffness, forces).reshape(rows.shape)[self.works].ravel()

    def _matrix(self) -> Array:
        """`matrix`."""
        own, size = self.works.reshape(-1, 3), self.size
        count, turn = np.count_nonzero(own), _as_real(-self.flexibility[1:, self.works])
        motion, first = np.empty((count, size, count * size)), 0
        for i in np.flatnonzero(own.any(axis=1)):
            columns, of = self.stiffness[i][:, :, own[i]].reshape(3, size, -1), slice(3 * i, 3 * i + 3)
            last = first + columns.shape[2]
            motion[:, 0, first:last] = -self.flexibility[0, self.works, of].real @ columns[:, 0]
            waves = columns[:, 1:].reshape(3, len(turn), 2, -1).swapaxes(0, 1).reshape(len(turn), 6, -1)
            moved = (turn[:, :, :, of].reshape(len(turn), -1, 6) @ waves).reshape(len(turn), count, 2, -1)
            motion[:, 1:, first:last] = moved.swapaxes(0, 1).reshape(count, size - 1, -1)
            first = last
        matrix = motion.reshape(count * size, count * size)
        matrix[np.diag_indices(count * size)] += 1.0
        return matrix

    def _rows(self, x: Array) -> Array:
        return x.reshape(-1, self.size)

    def _by_harmonics(self, matrix: NDArray[np.complexfloating], rows: Array) -> Array:
        """The product of a matrix of each harmonic, shape (H + 1, J, J), and components by coefficients."""
        return to_coefficients((matrix @ to_phasors(rows).T[:, :, None])[..., 0].T)


def _as_real(matrix: Complex) -> Array:
    """A matrix of each harmonic by what it makes of the coefficients of cos and sin, (H, J, K) as (H, J, 2, K, 2)."""
    whole = np.empty((*matrix.shape[:2], 2, matrix.shape[2], 2))
    whole[:, :, 0, :, 0] = whole[:, :, 1, :, 1] = matrix.real
    whole[:, :, 0, :, 1], whole[:, :, 1, :, 0] = matrix.imag, -matrix.imag
    return whole


def _linear_part(stiffness: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which components act alike on each coefficient, and by what: shapes (3C,), (3C, 3C)."""
    num_contacts, size = stiffness.shape[0], stiffness.shape[2]
    constant, each = stiffness[:, :, 1, :, 1], np.arange(size)
    linear = np.zeros((num_contacts, 3), dtype=bool)
    whole = stiffness.reshape(num_contacts, -1)
    rounding = ROUNDING * np.maximum(whole.max(axis=1), -whole.min(axis=1))
    for (contact, k), _ in np.ndenumerate(linear):
        by = stiffness[contact, :, :, k]
        # The column of one coefficient tells of most components that do not.
        if np.abs(np.delete(by[..., 1], 1, axis=1)).max(initial=0.0) <= rounding[contact]:
            rest = by.copy()
            rest[:, each, each] -= constant[contact, :, k, None]
            linear[contact, k] = np.abs(rest, out=rest).max() <= rounding[contact]
    by_contact = np.zeros((num_contacts, 3, num_contacts, 3))
    own = np.arange(num_contacts)
    by_contact[own, :, own] = constant * linear[:, None, :]
    return linear.ravel(), by_contact.reshape(3 * num_contacts, -1)
