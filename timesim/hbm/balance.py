"""Harmonic balance: periodic solutions by their Fourier coefficients, followed in frequency.

With H harmonics of the excitation and their mean, the modal equations are algebraic,

    (omega_i^2 m_i - (h Omega)^2 m_i) q_h + i h Omega sum_j c_ij q_jh = p_h + sum_contacts phi^T g_h,   h = 0 ... H

and only the relative motion y = (u1, u2, v) of the contacts enters the contact forces ``g = (-f, -(n - max(n0, 0)))``.
With the flexibility F_h of the structure at its contacts the unknowns are those of y alone (condensation),

    r = y_h - y_h,free - F_h(Omega) g_h(y) = 0

however many modes there are. The forces follow y through the law of `timesim.hbm.period` on equal time samples
(alternating frequency/time); their derivatives are exact for that law, and so is the matrix of Newton's method.

Sections 4.3 and 5 of the paper, whose scheme is ``harmonics=1``; T. M. Cameron and J. H. Griffin, J. Appl. Mech. 56
(1989) 149 for the alternation; M. Krack and J. Gross, Harmonic Balance for Nonlinear Vibration Problems (Springer
2019).
"""

import timesim.runtime  # noqa: F401  isort: skip

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from timesim.engine.contact import ConeLaw
from timesim.hbm.located import located_forces
from timesim.hbm.period import Basis, basis_of, forces
from timesim.hbm.setting import Setting, check_excitation
from timesim.hbm.tangent import linearised
from timesim.model.model import Model
from timesim.model.scales import Scales, scales_of

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def to_complex(coefficient: Array) -> Complex:
    """Phasors a_h - i b_h of a_0, a_1, b_1, ...: the last axis (2H + 1) becomes H + 1."""
    first = coefficient[..., :1].astype(complex)
    return np.concatenate([first, coefficient[..., 1::2] - 1j * coefficient[..., 2::2]], axis=-1)


def to_real(phasor: NDArray[Any]) -> Array:
    """The inverse of `to_complex`."""
    waves = np.stack([phasor[..., 1:].real, -phasor[..., 1:].imag], axis=-1)
    return np.concatenate([phasor[..., :1].real, waves.reshape(*phasor.shape[:-1], 2 * waves.shape[-2])], axis=-1)


@dataclass(frozen=True)
class Linear:
    """The structure alone, at one frequency; h = 0 ... H first.

    Attributes:
        modal_free, modal: response of the mass-normalised modes to the excitation, shape (H + 1, M), and to unit forces
            at the contacts, shape (H + 1, M, 3C).
        free, flexibility: the same at the contacts, shapes (H + 1, 3C) and (H + 1, 3C, 3C).
        free_slope, flexibility_slope: their derivatives by Omega.
    """

    modal_free: Complex
    modal: Complex
    free: Complex
    flexibility: Complex
    free_slope: Complex
    flexibility_slope: Complex


class Balance:
    """The balance of a model as a residual in the frequency [Hz], for `timesim.hbm.continuation`.

    The unknowns are the Fourier coefficients of (u1, u2, v) of each contact in units of `length`, shape (C, 3, 2H + 1)
    made flat.
    """

    def __init__(self, model: Model, frequency: float, setting: Setting, units: Scales | None = None):
        """For a model near a frequency [Hz], which sets the units unless they are given.

        Raises:
            SettingError: nothing is periodic, or harmonics are excited that are not balanced.
        """
        check_excitation(model, setting.harmonics)
        self.model, self.setting = model, setting
        self.units = scales_of(model, frequency) if units is None else units
        self.length, self.force = self.units.length, self.units.force
        self.law: ConeLaw = ConeLaw.of(model.contacts, self.units)
        self.basis: Basis = basis_of(setting.harmonics, setting.time_samples)
        structure, excited = model.structure, model.excitation
        root = np.sqrt(structure.mass)
        self.shape = model.contact_shape.reshape(-1, root.size) / root
        self.load = np.zeros((setting.harmonics + 1, root.size), complex)
        self.load[0] = excited.constant / root
        kept = excited.harmonic <= setting.harmonics
        self.load[excited.harmonic[kept]] = (excited.cosine - 1j * excited.sine)[kept] / root
        self.damping = structure.damping / (np.outer(root, root) if structure.damping.ndim == 2 else root**2)
        self.support = self._support()

    @property
    def num_contacts(self) -> int:
        return self.model.num_contacts

    def _support(self) -> Array:
        """Contact stiffness lent to the structure, shape (3C, 3C), lest modes of frequency zero make it singular."""
        support = np.zeros((3 * self.num_contacts, 3 * self.num_contacts))
        if self.damping.ndim == 2 or np.any(self.model.structure.omega == 0):
            for i, contact in enumerate(self.model.contacts):
                support[3 * i : 3 * i + 2, 3 * i : 3 * i + 2] = contact.tangential_stiffness
                support[3 * i + 2, 3 * i + 2] = contact.normal_stiffness
        return support

    def linear(self, frequency: float) -> Linear:
        """Response of the structure at a frequency [Hz].

        Raises:
            numpy.linalg.LinAlgError: it is singular there.
        """
        omega, order = 2 * np.pi * frequency, np.arange(self.setting.harmonics + 1)[:, None]
        # Columns: unit forces at the contacts, then the excitation.
        columns = np.broadcast_to(self.shape.T, (order.size, *self.shape.T.shape))
        right = np.concatenate([columns, self.load[:, :, None]], axis=2)
        stiffness = self.model.structure.omega**2
        if self.damping.ndim == 1 and not self.support.any():
            dynamic = stiffness - (order * omega) ** 2 + 1j * order * omega * self.damping
            response = right / dynamic[:, :, None]
            slope = (2 * order**2 * omega - 1j * order * self.damping) / dynamic
            change = slope[:, :, None] * response
        else:
            damping = np.diag(self.damping) if self.damping.ndim == 1 else self.damping
            held = np.diag(stiffness) + self.shape.T @ self.support @ self.shape
            order, one = order[:, :, None], np.eye(stiffness.size)
            dynamic = held - (order * omega) ** 2 * one + 1j * order * omega * damping
            response = np.linalg.solve(dynamic, right)
            change = np.linalg.solve(dynamic, (2 * order**2 * omega * one - 1j * order * damping) @ response)
        here, there = self.shape @ response, self.shape @ change
        return Linear(
            response[..., -1], response[..., :-1], here[..., -1], here[..., :-1], there[..., -1], there[..., :-1]
        )

    @property
    def num_unknowns(self) -> int:
        return 3 * self.num_contacts * (2 * self.setting.harmonics + 1)

    def coefficients(self, x: Array) -> Array:
        """The unknowns by contact, component and coefficient, shape (..., C, 3, 2H + 1)."""
        return x.reshape(*x.shape[:-1], self.num_contacts, 3, 2 * self.setting.harmonics + 1)

    def _given(self, acts: Array) -> Array:
        """g from (f1, f2, n), in units of force."""
        g = -acts
        g[:, 2, 0] += np.maximum(np.asarray(self.law.preload), 0.0)
        return g

    def contact_forces(self, x: Array) -> Array:
        """g, the force on body 1 in the axes of each contact, by its coefficients in units of `force`."""
        return self._given(self.acts(x))

    def acts(self, x: Array) -> Array:
        """(f1, f2, n) of each contact by their coefficients in units of `force`, shape (C, 3, 2H + 1)."""
        sampled = forces(self.law, self.basis, jnp.asarray(self.coefficients(x))).coefficient
        return self.placed(x, np.asarray(sampled))

    def placed(self, x: Array, sampled: Array) -> Array:
        """(f1, f2, n) with transitions as the setting wants them, from those found on the samples.

        In full stick, where the offset is free, they stay what they are.
        """
        acts = np.array(sampled)
        if self.setting.transitions == "located":
            for i, contact in enumerate(self.model.contacts):
                located = located_forces(contact, self.length * self.coefficients(x)[i])
                acts[i] = acts[i] if located is None else located / self.force
        return acts

    def _rows(self, coefficient: Array) -> Array:
        """All components of all contacts, shape (3C, 2H + 1)."""
        return coefficient.reshape(3 * self.num_contacts, 2 * self.setting.harmonics + 1)

    def _balanced(self, x: Array, g: Array, linear: Linear) -> tuple[Complex, Complex]:
        """Forces at the contacts and the motion that they give, by phasor, shape (H + 1, 3C)."""
        motion = to_complex(self._rows(self.coefficients(x))).T * self.length
        acting = to_complex(self._rows(g)).T * self.force + motion @ self.support
        return acting, linear.free + np.einsum("hij,hj->hi", linear.flexibility, acting)

    def value(self, x: Array, p: float) -> Array:
        """r in units of `length`."""
        _, motion = self._balanced(x, self.contact_forces(x), self.linear(p))
        return x - to_real(motion.T).ravel() / self.length

    def linearised(self, x: Array, p: float) -> tuple[Array, Array, Array]:
        """r, and its derivatives by the unknowns and by the frequency."""
        acts, slope = linearised(self.law, self.basis, jnp.asarray(self.coefficients(x)))
        g = self._given(self.placed(x, np.asarray(acts.coefficient)))
        linear = self.linear(p)
        acting, motion = self._balanced(x, g, linear)
        by_p = linear.free_slope + np.einsum("hij,hj->hi", linear.flexibility_slope, acting)
        matrix = np.eye(x.size) - self._matrix(linear.flexibility, np.asarray(slope))
        r = x - to_real(motion.T).ravel() / self.length
        return r, matrix, to_real(by_p.T).ravel() * (-2 * np.pi / self.length)

    def _matrix(self, flexibility: Complex, slope: Array) -> Array:
        """Derivatives of F g by the unknowns, from those of (f1, f2, n) of each contact by its own."""
        size, rows = 2 * self.setting.harmonics + 1, 3 * self.num_contacts
        matrix = np.empty((rows, size, rows * size))
        for i, block in enumerate(slope):
            own = slice(3 * i, 3 * i + 3)
            stiffness = -block * (self.force / self.length)
            if self.support.any():
                stiffness = stiffness + np.kron(self.support[own, own], np.eye(size))
            force = to_complex(stiffness.reshape(3, size, -1).swapaxes(1, 2)).transpose(2, 0, 1)
            motion = flexibility[:, :, own] @ force
            matrix[:, :, 3 * size * i : 3 * size * (i + 1)] = to_real(motion.transpose(1, 2, 0)).swapaxes(1, 2)
        return matrix.reshape(rows * size, rows * size)

    def modes(self, x: Array, acts: Array, frequency: float) -> Complex:
        """Modal displacement by phasors, shape (H + 1, M), from the unknowns and (f1, f2, n) in units of `force`."""
        linear = self.linear(frequency)
        acting, _ = self._balanced(x, self._given(acts), linear)
        modal = linear.modal_free + np.einsum("hij,hj->hi", linear.modal, acting)
        return modal / np.sqrt(self.model.structure.mass)
