"""Structure, contacts and excitation as one dynamical system: the only place where the parts meet.

The event loop integrates a dimensionless form, so that a tolerance means the same in every system of units and at
every frequency. Time is the phase of the excitation, ``theta = 2 pi f t``: a cycle has length 2 pi. With the modal
coordinate ``eta_i = sqrt(m_i) q_i / X``, lengths at the contacts in units of L and forces in units of F,

    eta_i'' + d_i eta_i' + (omega_i / Omega)^2 eta_i = p_i(theta) + sum_contacts B_i^T g,   F L = X^2 Omega^2

where ``g = (-f, -(n - max(n0, 0)))`` is the force on body 1 in the axes of the contact: a positive preload is carried
by the structure at rest, so only its change acts.
"""

from timesim.runtime import Leaf  # isort: skip

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from timesim.engine.barrier import apart
from timesim.engine.contact import Law, Motion, Plane, Reaction, State, dot, reaction
from timesim.model.model import Contact, Model
from timesim.model.reduction import Reduction, reduction_of, stuck_force, stuck_matrix


class System(eqx.Module):
    """A model at one frequency, dimensionless. Leaves only: what changes between runs needs no new compilation.

    Attributes:
        law: parameters of the contacts.
        shape: B, relative motion at the contacts for a unit of each mode: one array (contact, mode) for each
            tangential axis, and the normal last.
        stiffness: ``(omega_i / Omega)^2``, or a matrix where stuck contacts are taken into the structure.
        damping: ``2 zeta_i omega_i / Omega``, or a matrix where the modes do not diagonalise it.
        harmonic: the multiples of the base frequency that are excited.
        cosine, sine: modal forces at them.
        constant: constant modal force.
        phase: phase of the excitation at the start of a cycle [rad].
    """

    law: Law
    shape: tuple[Float[Leaf, "contact mode"], ...]
    stiffness: Float[Leaf, " mode"] | Float[Leaf, "mode mode"]
    damping: Float[Leaf, " mode"] | Float[Leaf, "mode mode"]
    harmonic: Float[Leaf, " harmonic"]
    cosine: Float[Leaf, "harmonic mode"]
    sine: Float[Leaf, "harmonic mode"]
    constant: Float[Leaf, " mode"]
    phase: Float[Leaf, ""]


class Work(eqx.Module):
    """Energy put in by the excitation, lost in modal damping, and lost in each contact."""

    input: Float[Array, ""]
    damping: Float[Array, ""]
    friction: Float[Array, " contact"]


class Point(eqx.Module):
    """Where a trajectory is in its continuous state.

    Attributes:
        q, p: modal displacement and velocity (dimensionless).
        w: slip of the contacts.
        work: the energies since the start, or None where nobody asks for them.
    """

    q: Float[Leaf, " mode"]
    p: Float[Leaf, " mode"]
    w: Plane
    work: Work | None


def excitation(system: System, time: Float[Array, ""]) -> Float[Array, " mode"]:
    """Modal force at a time within the cycle."""
    force = system.constant
    for row in range(system.harmonic.shape[0]):
        angle = system.harmonic[row] * (time + system.phase)
        force = force + system.cosine[row] * jnp.cos(angle) + system.sine[row] * jnp.sin(angle)
    return force


def times(matrix: Array, x: Float[Array, " column"]) -> Float[Array, " row"]:
    """A matrix times a vector; a modal matrix may be given by its diagonal."""
    # A sum of products is fused with what uses it; XLA's own product of matrices is not.
    return matrix * x if matrix.ndim == 1 else (matrix * x).sum(axis=-1)


def relative(system: System, x: Float[Array, " mode"]) -> tuple[Float[Array, " contact"], ...]:
    """Relative motion at the contacts, normal last."""
    return tuple(times(axis, x) for axis in system.shape)


@apart
def motion(system: System, point: Point) -> Motion:
    """Relative motion of the contacts and its rates."""
    x, dx = relative(system, point.q), relative(system, point.p)
    return Motion(x[:-1], x[-1], dx[:-1], dx[-1])


def contact_force(system: System, acts: Reaction) -> tuple[Float[Array, " contact"], ...]:
    """g, the force on body 1 in the axes of the contact."""
    return *(-f for f in acts.f), jnp.maximum(system.law.preload, 0.0) - acts.n


def field(system: System, state: State, time: Float[Array, ""], point: Point) -> Point:
    """Rate of the continuous state, every contact keeping its own."""
    acts = reaction(system.law, state, motion(system, point), point.w)
    return _response(system, time, point, acts)


@apart
def _response(system: System, time: Float[Array, ""], point: Point, acts: Reaction) -> Point:
    drive = excitation(system, time)
    drag = times(system.damping, point.p)
    acceleration = drive - drag - times(system.stiffness, point.q)
    for axis, force in zip(system.shape, contact_force(system, acts), strict=True):
        acceleration = acceleration + times(axis.T, force)
    power = None
    if point.work is not None:
        power = Work(jnp.sum(drive * point.p), jnp.sum(drag * point.p), dot(acts.f, acts.dw))
    return Point(point.p, acceleration, acts.dw, power)


@dataclass(frozen=True)
class Scales:
    """Units of the dimensionless form in those of the scene.

    Attributes:
        omega: circular frequency of the excitation; a unit of time is its inverse.
        mode: unit of each modal displacement, shape (M,).
        length: unit of length at the contacts.
        force: unit of force at the contacts.
        energy: unit of energy.
    """

    omega: float
    mode: np.ndarray
    length: float
    force: float
    energy: float


def modal_size(model: Model, omega: float) -> float:
    """The scene's own scale X of mass-normalised modal displacement: what the forces would move quasi-statically.

    Without forces it is the size of the start.
    """
    root = np.sqrt(model.structure.mass)
    drive = np.abs(model.excitation.constant) + np.hypot(model.excitation.cosine, model.excitation.sine).sum(axis=0)
    size = np.max(drive / root / np.maximum(model.structure.omega, omega) ** 2, initial=0.0)
    if size == 0:
        size = np.max(np.hypot(model.start.displacement, model.start.velocity / omega) * root, initial=0.0)
    return float(size) if size > 0 else 1.0


def scales_of(model: Model, frequency: float) -> Scales:
    """Units for a model at a frequency [Hz]."""
    omega = 2 * np.pi * frequency
    size = modal_size(model, omega)
    root = np.sqrt(model.structure.mass)
    reach = float(np.max(np.abs(model.contact_shape / root), initial=0.0)) or 1.0
    length = size * reach
    energy = (size * omega) ** 2
    return Scales(omega, size / root, length, energy / length, energy)


def system_of(model: Model, frequency: float, phase: float = 0.0, reduction: Reduction | None = None) -> System:
    """The dimensionless system of a model at a frequency [Hz], without what a reduction leaves out.

    Args:
        model: the model.
        frequency: base frequency of the excitation [Hz].
        phase: its phase at the start of a cycle [rad].
        reduction: what need not be modelled; nothing is left out by default.
    """
    reduction = reduction_of(model, [frequency], reduce=False) if reduction is None else reduction
    scales, excited, modes = scales_of(model, frequency), model.excitation, reduction.modes
    root = np.sqrt(model.structure.mass[modes])
    push = scales.mode[modes] * root**2 * scales.omega**2
    damping = model.structure.damping / scales.omega
    whole = damping.ndim == 2
    damping = damping[np.ix_(modes, modes)] / np.outer(root, root) if whole else damping[modes] / root**2
    stiffness = (model.structure.omega[modes] / scales.omega) ** 2
    constant = excited.constant[modes]
    if reduction.stuck.size:
        stiffness = np.diag(stiffness) + stuck_matrix(reduction) / np.outer(root, root) / scales.omega**2
    if reduction.stuck.size or reduction.apart.size:
        constant = constant + stuck_force(reduction)
    shape = model.contact_shape[reduction.live][:, :, modes] * scales.mode[modes] / scales.length
    axes = contact_axes(model, reduction)
    shape = np.concatenate([np.einsum("cax,cam->cxm", axes, shape[:, :2]), shape[:, 2:]], axis=1)
    return System(
        law=_principal_law([model.contacts[i] for i in reduction.live], axes, scales),
        shape=tuple(np.asarray(shape[:, axis]) for axis in range(shape.shape[1])),
        stiffness=np.asarray(stiffness),
        damping=np.asarray(damping),
        harmonic=np.asarray(excited.harmonic, dtype=float),
        cosine=np.asarray(excited.cosine[:, modes] / push),
        sine=np.asarray(excited.sine[:, modes] / push),
        constant=np.asarray(constant / push),
        phase=np.asarray(phase, dtype=float),
    )


def contact_axes(model: Model, reduction: Reduction) -> np.ndarray:
    """Axes of the loop in those of each live contact, as columns, shape (C, 2, 2), or (C, 2, 1) of straight motion.

    They are the principal axes of K_u, so that a whole matrix costs no more than two numbers.
    """
    if reduction.line is not None:
        return reduction.line[:, :, None]
    return np.array([_principal(model.contacts[i].tangential_stiffness) for i in reduction.live]).reshape(-1, 2, 2)


def _principal(stiffness: np.ndarray) -> np.ndarray:
    diagonal = stiffness[0, 1] == 0
    return np.eye(2) if diagonal else np.linalg.eigh(stiffness)[1]


def contact_law(model: Model, scales: Scales) -> Law:
    """Parameters of all contacts of a model in given units, along the axes of the contacts."""
    matrices = _matrices(model.contacts, scales)
    inverse = np.array([np.linalg.inv(k) if k.any() else k for k in matrices]).reshape(-1, 2, 2)
    return _law(model.contacts, scales, _components(matrices), _components(inverse))


def _matrices(contacts: Sequence[Contact], scales: Scales) -> np.ndarray:
    stiffness = np.array([contact.tangential_stiffness for contact in contacts]).reshape(-1, 2, 2)
    return stiffness * (scales.length / scales.force)


def _principal_law(contacts: Sequence[Contact], axes: np.ndarray, scales: Scales) -> Law:
    """Parameters along the axes of the loop."""
    stiffness = np.einsum("cax,cab,cbx->xc", axes, _matrices(contacts, scales), axes)
    if np.all(stiffness == stiffness[0]):
        stiffness = stiffness[:1]
    return _law(
        contacts, scales, stiffness, np.divide(1.0, stiffness, out=np.zeros_like(stiffness), where=stiffness > 0)
    )


def _law(contacts: Sequence[Contact], scales: Scales, stiffness: Iterable[Any], compliance: Iterable[Any]) -> Law:
    ratio = scales.length / scales.force
    return Law(
        friction=np.asarray([c.friction for c in contacts], dtype=float),
        stiffness=tuple(map(np.asarray, stiffness)),
        compliance=tuple(map(np.asarray, compliance)),
        normal_stiffness=np.asarray([c.normal_stiffness * ratio for c in contacts], dtype=float),
        preload=np.asarray([c.preload / scales.force for c in contacts], dtype=float),
    )


def _components(matrices: np.ndarray) -> tuple[np.ndarray, ...]:
    """K_u as (k,) where every contact's is isotropic, else (k11, k12, k22)."""
    k11, k12, k22 = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    return (k11,) if np.all(k12 == 0) and np.all(k11 == k22) else (k11, k12, k22)
