"""Harmonic balance: periodic solutions by their Fourier coefficients, followed in frequency.

With H harmonics of the excitation and their mean, the modal equations are algebraic,

    (omega_i^2 m_i - (h Omega)^2 m_i) q_h + i h Omega sum_j c_ij q_jh = p_h + sum_contacts phi^T g_h,   h = 0 ... H

and only the relative motion y = (u1, u2, v) of the contacts enters the contact forces ``g = (-f, -(n - max(n0, 0)))``.
With the flexibility F_h of the structure at its contacts the unknowns are those of y alone (condensation),

    r = y_h - y_h,free - F_h(Omega) g_h(y) = 0

however many modes there are. The forces follow from y on equal time samples by the law of `timesim.hbm.period`
(alternating frequency/time); their derivatives are exact for that law, and so is the matrix of Newton's method.

Sections 4.3 and 5 of the paper, whose scheme is ``harmonics=1``. T. M. Cameron and J. H. Griffin, An alternating
frequency/time domain method for calculating the steady-state response of nonlinear dynamic systems, J. Appl. Mech. 56
(1989) 149-154; M. Krack and J. Gross, Harmonic Balance for Nonlinear Vibration Problems (Springer 2019).
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, orth

from timesim.engine.law.cone import ConeLaw
from timesim.hbm.condensation import Condensation
from timesim.hbm.period import Basis, ClosedPeriod, basis_of, forces_of, motion_of, offsets_of, period_of
from timesim.hbm.scheme import Scheme, check_model
from timesim.hbm.tangent import linearised
from timesim.model.contact_state import require_cone
from timesim.model.held import springs
from timesim.model.model import Model
from timesim.model.scales import Scales, scales_of
from timesim.model.start import rest_start
from timesim.orbit.fourier import Array, Complex, to_coefficients, to_phasors

LOOSE = 1e-12
"""Share of the largest stiffness of free modes, and of the constant forces on them, that is rounding."""
SLIGHT = 1e-4
"""Share of the stiffness of contacts that is more in the matrix of Newton's method: an error of that size beside those
that stick, a step of 10,000 times the rounding of their mean force where all slip."""
AWAY = 100.0
"""Mean of what friction alone holds, by what its contacts can be deflected and its motion: it has run away. Towards the
border of stick, beyond which a constant force drives it on, the offset that such a contact is taken to have does so."""
UNDAMPED = 1e-6
"""Loss of a mode at resonance, over its stiffness, up to which its response there is too large for a balance."""


@dataclass(frozen=True)
class LinearResponse:
    """Response of the structure without its contacts at one frequency, by h = 0 ... H.

    Each array has 3C columns for unit forces at the contacts, then one for the excitation.

    Attributes:
        modal: of the mass-normalised modes, shape (H + 1, M, 3C + 1).
        motion: of the contacts, shape (H + 1, 3C, 3C + 1).
        slope: derivative of `motion` by Omega.
    """

    modal: Complex
    motion: Complex
    slope: Complex

    @property
    def free(self) -> Complex:
        """Motion of the contacts under the excitation alone, shape (H + 1, 3C)."""
        return self.motion[..., -1]

    @property
    def flexibility(self) -> Complex:
        """F_h, shape (H + 1, 3C, 3C)."""
        return self.motion[..., :-1]


def under(response: Complex, forces: Complex) -> Complex:
    """One of the arrays of a `LinearResponse` under forces at the contacts, shape (H + 1, 3C), and the excitation."""
    return response[..., -1] + np.einsum("hij,hj->hi", response[..., :-1], forces)


def contact_stiffness(model: Model, share: Array) -> Array:
    """Stiffness of all contacts, each stuck and closed to a share of it, shape (3C, 3C)."""
    return np.asarray(block_diag(*(own * springs(c) for own, c in zip(share, model.contacts, strict=True))))


def units_of(model: Model, frequency: float) -> Scales:
    """Units that suit the periodic part of the response at a frequency [Hz], whatever constant forces or starts add."""
    rest = rest_start(model.structure.num_modes, model.num_contacts)
    waves = replace(model.excitation, constant=np.zeros_like(model.excitation.constant))
    return scales_of(replace(model, excitation=waves, start=rest), frequency)


def mean_of(rows: Array) -> Array:
    """Coefficients 1, cos, sin, ... along the last axis of which all but the first are zero."""
    mean = np.zeros_like(rows)
    mean[..., 0] = rows[..., 0]
    return mean


def _loose(free: NDArray[np.bool_], stiffness: Array) -> Array:
    """Motions of modes of frequency zero that a stiffness does not restrain, shape (M, L).

    ``free``: which modes these are, shape (M,); ``stiffness``: of the structure and of contacts, shape (M, M).
    """
    values, vectors = np.linalg.eigh(stiffness[np.ix_(free, free)])
    loose = np.zeros((free.size, values.size))
    loose[free] = vectors
    return loose[:, values <= LOOSE * values.max(initial=0.0)]


def _held(loose: Array, stiffness: Array, constant: Array) -> tuple[Array, Array]:
    """Stiffness of motions that nothing restrains, shape (M, M): their mean, which is free, is then zero.

    And the constant forces on the modes, shape (M,), not finite where they act on these motions: then there is no
    periodic motion. ``loose``: these motions, shape (M, L); ``stiffness``: of the structure and whatever restrains it.
    """
    pushed = np.abs(constant @ loose).max(initial=0.0) > LOOSE * np.linalg.norm(constant)
    return (loose @ loose.T) * (stiffness.max() or 1.0), np.full_like(constant, np.nan) if pushed else constant


class Balance:
    """The balance of a model as a residual in the frequency [Hz], for `timesim.hbm.continuation`.

    The unknowns are the Fourier coefficients of (u1, u2, v) of each contact in units of `length`, shape (C, 3, 2H + 1)
    made flat.
    """

    def __init__(self, model: Model, frequency: float, scheme: Scheme, units: Scales | None = None):
        """For a model near a frequency [Hz], which sets the units unless they are given.

        Raises:
            BalanceError: it has no contact, nothing is periodic, or harmonics are excited that are not balanced.
            ValueError: a contact obeys another law than the cone.
        """
        require_cone(model.contacts, "harmonic balance")
        check_model(model, scheme.harmonics)
        self.model, self.scheme, self.num_contacts = model, scheme, model.num_contacts
        self.size = 2 * scheme.harmonics + 1
        self.units = units_of(model, frequency) if units is None else units
        self.length, self.force = self.units.length, self.units.force
        self.law: ConeLaw = ConeLaw.of(model.contacts, self.units)
        self.basis: Basis = basis_of(scheme.harmonics, scheme.time_samples)
        structure, excited = model.structure, model.excitation
        root = np.sqrt(structure.mass)
        self.shape = model.contact_shape.reshape(-1, root.size) / root
        self.load = np.zeros((scheme.harmonics + 1, root.size), complex)
        self.load[0] = excited.constant / root
        kept = excited.harmonic <= scheme.harmonics
        self.load[excited.harmonic[kept]] = (excited.cosine - 1j * excited.sine)[kept] / root
        self.damping = structure.damping / (np.outer(root, root) if structure.damping.ndim == 2 else root**2)
        # Stiffness added to the structure at its contacts and taken from their forces again: without it modes of
        # frequency zero make the structure singular, and those with next to no damping in resonance.
        omega = structure.omega
        supported = self.damping.ndim == 2 or np.any((omega == 0) | (self.damping <= UNDAMPED * omega))
        self.support = contact_stiffness(model, np.full(model.num_contacts, float(supported)))
        self.stiffness = np.diag(omega**2) + self.shape.T @ self.support @ self.shape
        self.hold, self.load[0] = _held(_loose(omega == 0, self.stiffness), self.stiffness, self.load[0].real)
        across = self.shape[2::3]
        pressed = np.diag(omega**2) + across.T @ (np.diag(self.support)[2::3, None] * across)
        self.slack = self._slack_of(_loose(omega == 0, pressed))
        self.held_by_friction, self.reach = orth(self.slack), self._reach()
        self._last: tuple[Array, ClosedPeriod] | None = None

    def _slack_of(self, loose: Array) -> Array:
        """What a little more stiffness of motions that friction alone holds, shape (M, L), takes from F_0, (3C, 3C).

        Where their contacts slip in every cycle the mean of such a motion is free, and the matrix of Newton's method
        singular. With this in it, and not in the balance, the mean stays where it is; where the forces drive the motion
        away there is still no solution.
        """
        if not loose.size:
            return np.zeros_like(self.support)
        held = self.stiffness + self.hold
        more = held + SLIGHT * loose @ (loose.T @ held @ loose) @ loose.T
        try:
            return np.asarray(self.shape @ (np.linalg.solve(held, self.shape.T) - np.linalg.solve(more, self.shape.T)))
        except np.linalg.LinAlgError:
            return np.zeros_like(self.support)

    def _reach(self) -> float:
        """How far a contact can be deflected at rest before it slips, the most of all, in units of `length`."""
        stiffness = np.array([np.linalg.norm(contact.tangential_stiffness, 2) for contact in self.model.contacts])
        most = self.model.friction * np.maximum(self.model.preload, 0.0) / np.maximum(stiffness, 1e-300)
        return float(most.max() / self.length)

    def linear(self, frequency: float) -> LinearResponse:
        """Response of the structure at a frequency [Hz]; not finite where it is singular."""
        omega, order = 2 * np.pi * frequency, np.arange(self.scheme.harmonics + 1)[:, None]
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
            order, one = order[:, :, None], np.eye(stiffness.size)
            dynamic = self.stiffness - (order * omega) ** 2 * one + 1j * order * omega * damping
            dynamic[0] += self.hold
            try:
                response = np.linalg.solve(dynamic, right)
            except np.linalg.LinAlgError:
                response, dynamic = np.full_like(right, np.nan), one
            change = np.linalg.solve(dynamic, (2 * order**2 * omega * one - 1j * order * damping) @ response)
        return LinearResponse(response, self.shape @ response, self.shape @ change)

    @lru_cache(maxsize=8)  # noqa: B019 a balance lives as long as its curve
    def with_scheme(self, scheme: Scheme) -> "Balance":
        """The same by another scheme."""
        return Balance(self.model, 1.0, scheme, self.units)

    def damped(self, more: Array) -> "Balance":
        """The same with more damping of each mode, for unit mass [1/time], shape (M,)."""
        other = copy(self)
        other.damping = self.damping + (more if self.damping.ndim == 1 else np.diag(more))
        return other

    def at(self, p: float) -> "Balance":
        """The balance at a value of the parameter."""
        return self

    def frequency_at(self, p: float) -> float:
        """Frequency of the excitation [Hz] at a value of the parameter, which it is."""
        return p

    @property
    def num_unknowns(self) -> int:
        return 3 * self.num_contacts * self.size

    @property
    def working(self) -> Array:
        """A motion in which contacts stick and slip to and fro, and separate where they have a normal stiffness."""
        law, x = self.law, np.zeros((self.num_contacts, 3, self.size))
        preload, normal, along = (np.asarray(part) for part in (law.preload, law.normal_stiffness, law.stiffness[0]))
        x[:, 2, 1] = 2 * np.divide(np.abs(preload), normal, out=np.zeros_like(preload), where=normal > 0)
        limit = law.friction * (np.abs(preload) + normal * x[:, 2, 1])
        x[:, 0, 2] = 4 * np.divide(limit, along, out=np.zeros_like(preload), where=along > 0)
        return x.ravel()

    def coefficients(self, x: Array) -> Array:
        """The unknowns by contact, component and coefficient, shape (..., C, 3, 2H + 1)."""
        return x.reshape(*x.shape[:-1], self.num_contacts, 3, self.size)

    def centre(self, x: Array) -> Array:
        """The mean of a motion: constant forces may make it far larger than its waves."""
        return mean_of(self.coefficients(x)).ravel()

    def contact_forces(self, x: Array) -> Array:
        """(f1, f2, n) of each contact by their coefficients in units of `force`, shape (C, 3, 2H + 1)."""
        return forces_of(self.law, self.basis, self.period(x)).coefficient

    def period(self, x: Array) -> ClosedPeriod:
        """The contacts through a period; the last one is kept, as a solution is looked at more than once."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x.copy(), period_of(self.law, self.basis, self.coefficients(x))
        return self._last[1]

    def has_offset(self, x: Array) -> bool:
        """Whether a contact sticks all along with an offset of its force, which follows the motion."""
        own = self.coefficients(x)
        return bool(np.any(offsets_of(self.law, self.basis, own, motion_of(self.basis, own))[0].force))

    def _phasors_on_body_1(self, forces: Array) -> Complex:
        """g by phasors, shape (H + 1, 3C), from (f1, f2, n) in units of force."""
        g = -forces
        g[:, 2, 0] += np.maximum(np.asarray(self.law.preload), 0.0)
        return to_phasors(g.reshape(-1, self.size)).T * self.force

    def on_modes(self, forces: Array) -> Complex:
        """Forces of the contacts on modes of mass 1 by phasors, shape (H + 1, M), from (f1, f2, n)."""
        return self._phasors_on_body_1(forces) @ self.shape

    def _response(self, x: Array, forces: Array, linear: LinearResponse) -> tuple[Complex, Complex]:
        """Forces on the supported structure and the motion of the contacts that they give, by phasor, (H + 1, 3C)."""
        motion = to_phasors(x.reshape(-1, self.size)).T * self.length
        acting = self._phasors_on_body_1(forces) + motion @ self.support
        return acting, under(linear.motion, acting)

    def value(self, x: Array, p: float) -> Array:
        """r in units of `length`; not finite where the mean has run away, see `AWAY`."""
        _, motion = self._response(x, self.contact_forces(x), self.linear(p))
        return x - to_coefficients(motion.T).ravel() / self.length + self._away(x)

    def _away(self, x: Array) -> float:
        """NaN where the mean of what friction alone holds is `AWAY`, else 0."""
        if not self.held_by_friction.size:
            return 0.0
        rows = x.reshape(-1, self.size)
        far = np.abs(rows[:, 0] @ self.held_by_friction).max() > AWAY * (self.reach + np.abs(rows[:, 1:]).max())
        return np.nan if far else 0.0

    def linearised(self, x: Array, p: float, *, keep_offsets: bool = False) -> tuple[Array, Condensation, Array]:
        """r, and its derivatives by the unknowns and by the frequency; offsets as in `hbm.tangent.linearised`."""
        sampled, slope = linearised(self.law, self.basis, self.coefficients(x), keep_offsets=keep_offsets)
        linear = self.linear(p)
        acting, motion = self._response(x, sampled.coefficient, linear)
        by_p = under(linear.slope, acting)
        flexibility = linear.flexibility.copy()
        flexibility[0] -= self.slack
        by_x = Condensation(flexibility, self._stiffness(slope))
        r = x - to_coefficients(motion.T).ravel() / self.length + self._away(x)
        return r, by_x, to_coefficients(by_p.T).ravel() * (-2 * np.pi / self.length)

    def _stiffness(self, slope: Array) -> Array:
        """Derivatives of the forces on the supported structure, from those of (f1, f2, n) of each contact, in place."""
        stiffness = slope.reshape(-1, 3, self.size, 3, self.size)
        stiffness *= -(self.force / self.length)
        if self.support.any():
            own = self.support.reshape(self.num_contacts, 3, self.num_contacts, 3)
            each, alike = np.arange(self.num_contacts), np.eye(self.size)
            stiffness += own[each, :, each][:, :, None, :, None] * alike[:, None, :]
        return stiffness

    def modes(self, x: Array, forces: Array, frequency: float) -> Complex:
        """Modal displacement by phasors, shape (H + 1, M), from the unknowns and (f1, f2, n) in units of `force`."""
        linear = self.linear(frequency)
        acting, _ = self._response(x, forces, linear)
        return under(linear.modal, acting) / np.sqrt(self.model.structure.mass)
