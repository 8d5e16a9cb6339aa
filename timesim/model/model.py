"""What a scene says, in numbers: structure, contacts, excitation and start, in the units of the scene.

Plain numpy, so that a scene can be read and checked without loading JAX. The dimensionless form that the
event loop integrates is derived from it in `timesim.engine.system`.

Notation (the paper's section 2, with the sign convention of this package): modal displacement ``q``, point
displacement ``x = sum_i shape_i q_i``; in the frame of a contact the relative motion of body 1 with respect to
body 2 is ``(u1, u2, v)``, and ``v`` grows as the bodies press together.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

STICK, SLIP, SEPARATION = 0, 1, 2
STATE_NAMES = ("stick", "slip", "separation")
GROUND = "ground"
CONE = "cone"
"""The contact law of the paper, by its name in `timesim.engine.law.table`."""
NO_DRAG = 1e-10
"""Share of the largest rate of damping up to which a body's drag is none."""
AS_ONE = 1e-10
"""Share of the motion of two points, as a body that nothing holds moves on, up to which they move as one."""


@dataclass(frozen=True)
class Structure:
    """A linear structure by its modes, frequency ascending.

    Attributes:
        frequency: natural frequencies [Hz], shape (M,).
        mass: modal masses, shape (M,).
        damping: modal viscous damping, either ``2 zeta omega m`` a mode, shape (M,), or the whole matrix
            [force / modal velocity], shape (M, M), where the modes do not diagonalise it.
        shape: displacement of each point along x, y, z for a unit of each mode, shape (P, 3, M).
        left_out: static flexibility of the modes that are not kept, between the points along x, y, z, shape (3P, 3P);
            None where none is known of.
    """

    frequency: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    points: tuple[str, ...]
    shape: np.ndarray
    left_out: np.ndarray | None = None

    @property
    def num_modes(self) -> int:
        return self.frequency.size

    @property
    def omega(self) -> np.ndarray:
        """Natural circular frequencies [rad/time], shape (M,)."""
        return 2 * np.pi * self.frequency

    @property
    def damping_ratio(self) -> np.ndarray:
        """Of each mode, shape (M,); of a damping matrix, its diagonal's. NaN where the frequency is 0."""
        damping = np.diagonal(self.damping) if self.damping.ndim == 2 else self.damping
        critical = 2 * self.mass * self.omega
        return np.divide(damping, critical, out=np.full(critical.size, np.nan), where=critical > 0)

    @property
    def decay(self) -> float:
        """Least rate at which a mode with a stiffness decays, overdamped or not [1/time]; infinite if there is none."""
        rings = self.frequency > 0
        zeta, omega = self.damping_ratio[rings], self.omega[rings]
        if self.damping.ndim == 2 and omega.size:
            # Modes that the damping couples decay together: the dashpot between two equal masses leaves one undamped.
            rate = self.decays[np.ix_(rings, rings)]
            free = np.block([[np.zeros_like(rate), np.diag(omega)], [-np.diag(omega), -rate]])
            return float(max(-np.linalg.eigvals(free).real.max(), 0.0))
        creeping = zeta + np.sqrt(np.maximum(zeta**2 - 1, 0.0))
        return float((np.minimum(zeta, 1 / np.maximum(creeping, 1.0)) * omega).min(initial=np.inf))

    @property
    def settling(self) -> float:
        """Least rate at which a motion settles [1/time]: as modes decay, or drag sets the speed of a free body.

        What has no drag never changes its speed, and does not count.
        """
        rings, rate = self.frequency > 0, self.decays
        if rings.all() or not rate.any():
            return self.decay
        omega = np.diag(self.omega)[rings]
        free = np.block([[np.zeros((len(omega), len(omega))), omega], [-omega.T, -rate]])
        falls = -np.linalg.eigvals(free).real
        return float(min(self.decay, falls.min(initial=np.inf, where=falls > NO_DRAG * np.abs(rate).max())))

    @property
    def decays(self) -> np.ndarray:
        """Damping of the modes, normalised to unit mass, shape (M, M) [1/time]."""
        root, damping = np.sqrt(self.mass), self.damping
        return np.asarray((np.diag(damping) if damping.ndim == 1 else damping) / np.outer(root, root))

    @property
    def stiffness(self) -> np.ndarray:
        """Modal stiffness ``m omega^2``, shape (M,)."""
        return self.mass * self.omega**2


@dataclass(frozen=True)
class Contact:
    """One frictional contact between a point and the ground or another point (equations 1 to 5).

    Attributes:
        name: how results and messages call it.
        point: point of body 1.
        against: point of body 2, or `GROUND`.
        frame: rows t1, t2, normal: rotates x, y, z into the contact's axes, shape (3, 3).
        tangential_stiffness: K_u, symmetric positive definite, or zero together with friction 0, shape (2, 2).
        normal_stiffness: k_v.
        preload: n0; negative is a gap of ``-n0 / k_v``.
        law: name of the law that it obeys, see `timesim.engine.law.table`.
        law_parameters: what this law has beside the above, by name, in the units of the scene.
    """

    name: str
    point: str
    against: str
    frame: np.ndarray
    friction: float
    tangential_stiffness: np.ndarray
    normal_stiffness: float
    preload: float
    law: str = CONE
    law_parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Excitation:
    """Modal forces ``sum_h cosine_h cos(h theta) + sine_h sin(h theta) + constant``, theta the base phase.

    Attributes:
        frequency: base frequency [Hz], None where the study sets it.
        harmonic: the multiples of the base frequency that occur, ascending integers >= 1, shape (H,).
        cosine, sine: modal force amplitudes at these multiples, shape (H, M).
        constant: constant modal force, shape (M,).
    """

    frequency: float | None
    harmonic: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    constant: np.ndarray

    @property
    def largest(self) -> np.ndarray:
        """Bound of the force on each mode, shape (M,): its amplitudes and its constant part."""
        return np.abs(self.constant) + np.hypot(self.cosine, self.sine).sum(axis=0)


@dataclass(frozen=True)
class Start:
    """State at the start of a run.

    Attributes:
        displacement, velocity: modal displacement and velocity, shape (M,).
        slip: w of each contact (t1, t2), shape (C, 2).
        state: state of each contact, shape (C,); -1 where it follows from the motion by the law of the contact, in
            the cone: separated if n <= 0, else stuck.
        phase: phase of the excitation [rad].
    """

    displacement: np.ndarray
    velocity: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    phase: float = 0.0


@dataclass(frozen=True, eq=False)
class Model:
    """A structure with contacts under excitation: all that a run needs to know of the physics."""

    structure: Structure
    contacts: tuple[Contact, ...]
    excitation: Excitation
    start: Start
    notes: tuple[str, ...] = field(default=())

    @property
    def num_contacts(self) -> int:
        return len(self.contacts)

    @property
    def friction(self) -> np.ndarray:
        """mu of each contact, shape (C,)."""
        return np.array([contact.friction for contact in self.contacts], dtype=float)

    @property
    def tangential_stiffness(self) -> np.ndarray:
        """K_u of each contact, shape (C, 2, 2)."""
        return np.array([contact.tangential_stiffness for contact in self.contacts], dtype=float).reshape(-1, 2, 2)

    @property
    def normal_stiffness(self) -> np.ndarray:
        """k_v of each contact, shape (C,)."""
        return np.array([contact.normal_stiffness for contact in self.contacts], dtype=float)

    @property
    def preload(self) -> np.ndarray:
        """n0 of each contact, shape (C,)."""
        return np.array([contact.preload for contact in self.contacts], dtype=float)

    @property
    def contact_frames(self) -> np.ndarray:
        """Rows t1, t2, normal of each contact along x, y, z, shape (C, 3, 3)."""
        return np.array([contact.frame for contact in self.contacts], dtype=float).reshape(-1, 3, 3)

    @cached_property
    def contact_shape(self) -> np.ndarray:
        """Relative motion (u1, u2, v) of each contact for a unit of each mode, shape (C, 3, M)."""
        if not self.contacts:
            return np.zeros((0, 3, self.structure.num_modes))
        return np.stack([self._relative_shape(contact) for contact in self.contacts])

    @cached_property
    def summation_order(self) -> np.ndarray:
        """Contacts by their numbers and not by their place, shape (C,).

        Summed in this order, and computed side by side in it, they act the same to the last bit in whatever order a
        scene lists them.
        """
        rows = []
        for i, c in enumerate(self.contacts):
            parameters = [value for _, value in sorted(c.law_parameters.items())]
            numbers = [c.friction, c.normal_stiffness, c.preload, *parameters, self.start.state[i]]
            parts = (numbers, c.tangential_stiffness, self.contact_shape[i], self.start.slip[i], c.frame)
            rows.append(np.concatenate([np.ravel(part) for part in parts]))
        return np.lexsort(np.array(rows).T[::-1]) if rows else np.zeros(0, dtype=int)

    @cached_property
    def stuck_omega(self) -> np.ndarray:
        """Circular natural frequencies with every contact stuck, ascending, shape (M,) [rad/time]."""
        stiffness = self.with_contacts(np.diag(self.structure.omega**2))
        return np.sqrt(np.maximum(np.linalg.eigvalsh(stiffness), 0.0))

    def with_contacts(self, stiffness: np.ndarray) -> np.ndarray:
        """A stiffness of the modes, normalised to unit mass, and that of every contact beside it, shape (M, M)."""
        whole, shapes = stiffness.copy(), self.contact_shape / np.sqrt(self.structure.mass)
        for c in self.summation_order:
            shape, contact = shapes[c], self.contacts[c]
            whole += shape[:2].T @ contact.tangential_stiffness @ shape[:2]
            whole += contact.normal_stiffness * np.outer(shape[2], shape[2])
        return whole

    @cached_property
    def stuck_rate(self) -> float:
        """Fastest rate with every contact stuck [rad/time]: the highest circular frequency, or decay."""
        return float(max(self.stuck_omega[-1], np.linalg.eigvalsh(self.structure.decays)[-1]))

    @property
    def coupling_rate(self) -> float:
        """Fastest rate at which damping acts between the modes [1/time]; 0 where it does not couple them."""
        decays = self.structure.decays
        return float(np.abs(np.linalg.eigvalsh(decays - np.diag(np.diag(decays)))).max())

    def _relative_shape(self, contact: Contact) -> np.ndarray:
        points, shape = self.structure.points, self.structure.shape
        relative = most = shape[points.index(contact.point)]
        if contact.against != GROUND:
            other = shape[points.index(contact.against)]
            relative, most = relative - other, np.maximum(np.abs(relative), np.abs(other))
        own = contact.frame @ relative
        # What rounding leaves of a difference, or across a plane, would hold a body that nothing holds.
        rounded = np.abs(own) <= AS_ONE * np.abs(most).max(axis=0)
        return np.where(rounded & (self.structure.omega == 0), 0.0, own)
