"""Structure, contacts and excitation as one dynamical system: the only place where the parts meet.

In the dimensionless form (see `timesim.model.scales`), with the modal coordinate ``eta_i = sqrt(m_i) q_i / X``,

    eta_i'' + d_i eta_i' + (omega_i / Omega)^2 eta_i = p_i(theta) + sum_contacts B_i^T g

where ``g = (-f, -(n - max(n0, 0)))`` is the force on body 1 in the axes of the contact: a positive preload is carried
by the structure at rest, so only its change acts.
"""

from timesim.runtime import Leaf, tree_class  # isort: skip

import dataclasses
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from timesim.engine.barrier import apart
from timesim.engine.law.contact_law import (
    ContactLaw,
    ContinuousState,
    Dynamics,
    Motion,
    Path,
    Plane,
    Reaction,
    Scalar,
    State,
    dot,
)
from timesim.engine.law.table import law_class
from timesim.model.cost import WIDE
from timesim.model.model import Model
from timesim.model.reduction import COUPLED, Reduction, reduction_of
from timesim.model.scales import Scales, scales_of


@tree_class
class Work:
    """Energy put in by the excitation, lost in modal damping, and lost in each contact."""

    input: Float[Leaf, ""]
    damping: Float[Leaf, ""]
    friction: Float[Leaf, " contact"]

    @classmethod
    def none(cls, contacts: int) -> "Work":
        return cls(np.zeros(()), np.zeros(()), np.zeros(contacts))


@tree_class
class Point(ContinuousState):
    """Continuous state of a `System`.

    Attributes:
        q, p: modal displacement and velocity (dimensionless).
        w: slip of the contacts.
        work: the energies since the start, or None where nobody asks for them.
    """

    q: Float[Leaf, " mode"]
    p: Float[Leaf, " mode"]
    w: Plane
    work: Work | None

    def error(self) -> Float[Array, ""]:
        worst = jnp.maximum(jnp.abs(self.q).max(), jnp.abs(self.p).max())
        for w in self.w:
            worst = jnp.maximum(worst, jnp.abs(w).max(initial=0.0))
        return worst

    def finite(self) -> Bool[Array, ""]:
        return jnp.isfinite(self.q).all() & jnp.isfinite(self.p).all()


MOST_SUMMED = 32
"""Most terms that XLA adds in one loop; more it adds in parts, which takes longer than its own product."""

IDLE_DAMPING = 2.0
"""Damping of modes that are not those of the model, whose stiffness is 1: critical."""


@tree_class
class System(Dynamics):
    """A model at one frequency, dimensionless. Leaves only: what changes between runs needs no new compilation.

    Modes beyond those of the model, see `room_of`, are at rest: neither a force nor a contact moves them.

    Attributes:
        law: parameters of the contacts.
        shape: B, relative motion at the contacts for a unit of each mode: one array (contact, mode) for each
            tangential axis, and the normal last.
        stiffness: ``(omega_i / Omega)^2``.
        damping: ``2 zeta_i omega_i / Omega``, or a matrix where the modes do not diagonalise it.
        harmonic: the multiples of the base frequency that are excited.
        cosine, sine: modal forces at them.
        phase: phase of the excitation at the start of a cycle [rad].
        ladder: what a method has prepared for its steps, see `timesim.engine.exponential.collocation`.
    """

    law: ContactLaw
    shape: tuple[Float[Leaf, "contact mode"], ...]
    stiffness: Float[Leaf, " mode"]
    damping: Float[Leaf, " mode"] | Float[Leaf, "mode mode"]
    harmonic: Float[Leaf, " harmonic"]
    cosine: Float[Leaf, "harmonic mode"]
    sine: Float[Leaf, "harmonic mode"]
    constant: Float[Leaf, " mode"]
    phase: Float[Leaf, ""]
    ladder: Any = None
    by_itself: bool = dataclasses.field(default=False, metadata={"static": True})

    def single(self) -> "System":
        return replace(self, by_itself=True)

    @property
    def wide(self) -> bool:
        # A sweep of many entries compiles in two thirds of the time or less so, and marches somewhat slower.
        *_, contacts, modes = self.shape[0].shape
        return modes > MOST_SUMMED or contacts * modes > WIDE

    def field(self, state: State, time: Float[Array, ""], point: Point) -> Point:
        acts = self.law.reaction(state, self.motion(point), point.w)
        return _response(self, time, point, acts)

    def motion(self, point: Point) -> Motion:
        return _motion(self, point)

    def path(self, point: Point, rate: Point) -> Path:
        return relative(self, point.q), relative(self, point.p), relative(self, rate.p)

    def size(self, point: Point) -> Float[Array, ""]:
        # Where a rigid body is, is no motion: relative to the way that a rotor had come in 2,000 cycles, steps of its
        # clutch erred so much that the power lost in it was wrong by 0.4 %.
        swung = jnp.where(self.stiffness > 0, jnp.abs(point.q), 0.0)
        return jnp.maximum(swung.max(), jnp.abs(point.p).max())


def excitation(system: System, time: Float[Array, ""]) -> Float[Array, " mode"]:
    """Modal force at a time within the cycle."""
    force = system.constant
    for row in range(system.harmonic.shape[0]):
        angle = system.harmonic[row] * (time + system.phase)
        force = force + system.cosine[row] * jnp.cos(angle) + system.sine[row] * jnp.sin(angle)
    return force


def times(matrix: Array, x: Float[Array, " column"], by_itself: bool) -> Float[Array, " row"]:
    """A matrix times a vector; a modal matrix may be given by its diagonal."""
    if matrix.ndim == 1:
        return matrix * x
    # A sum of products is fused with what uses it, and in lanes it is no product of many matrices.
    return jnp.dot(matrix, x) if by_itself and matrix.shape[1] > MOST_SUMMED else (matrix * x).sum(axis=-1)


def relative(system: System, x: Float[Array, " mode"]) -> tuple[Float[Array, " contact"], ...]:
    """Relative motion at the contacts, normal last."""
    return tuple(times(axis, x, system.by_itself) for axis in system.shape)


@apart
def _motion(system: System, point: Point) -> Motion:
    x, dx = relative(system, point.q), relative(system, point.p)
    return Motion(x[:-1], x[-1], dx[:-1], dx[-1])


def contact_force(system: System, f: Plane, n: Scalar) -> Plane:
    """g, the force on body 1 in the axes of the contact."""
    return *(-x for x in f), jnp.maximum(system.law.preload, 0.0) - n


@apart
def _response(system: System, time: Float[Array, ""], point: Point, acts: Reaction) -> Point:
    drive = excitation(system, time)
    drag = times(system.damping, point.p, system.by_itself)
    acceleration = drive - drag - system.stiffness * point.q
    for axis, force in zip(system.shape, contact_force(system, acts.f, acts.n), strict=True):
        acceleration = acceleration + times(axis.T, force, system.by_itself)
    power = None
    if point.work is not None:
        rubbing = dot(acts.f, acts.dw)
        lost = rubbing if acts.lost is None else rubbing + acts.lost
        power = Work(jnp.sum(drive * point.p), jnp.sum(drag * point.p), lost)
    return Point(point.p, acceleration, acts.dw, power)


def system_of(model: Model, frequency: float, phase: float = 0.0, reduction: Reduction | None = None) -> System:
    """The dimensionless system of a model at a base frequency of the excitation [Hz].

    ``phase``: of the excitation at the start of a cycle [rad]. Nothing is left out without a ``reduction``.
    """
    reduction = reduction_of(model, [frequency], reduce=False) if reduction is None else reduction
    scales, excited, modes = scales_of(model, frequency), model.excitation, reduction.modes
    omega, turn = reduction.natural
    push = _push(model, modes, scales)
    shape = model.contact_shape[reduction.live][:, :, modes] * scales.mode[modes] / scales.length
    axes, live = contact_axes(model, reduction), [model.contacts[i] for i in reduction.live]
    shape = np.concatenate([np.einsum("cax,cam->cxm", axes, shape[:, :2]), shape[:, 2:]], axis=1)
    rows = [*np.moveaxis(shape, 1, 0), excited.cosine[:, modes] / push, excited.sine[:, modes] / push]
    rows.append(excited.constant[modes] / push)
    rows = rows if turn is None else [row @ turn for row in rows]
    rows[-1] = rows[-1] + held_force(reduction, scales)
    *shape, cosine, sine, constant = [widened(row, reduction) for row in rows]
    damping, idle = widened(_damping(model, modes, turn) / scales.omega, reduction), slice(modes.size, None)
    if damping.ndim == 2:
        damping = widened(damping.T, reduction).T
        damping[idle, idle] = IDLE_DAMPING * np.eye(room_of(reduction) - modes.size)
    else:
        damping[idle] = IDLE_DAMPING
    stiffness = widened((omega / scales.omega) ** 2, reduction)
    stiffness[idle] = 1.0
    return System(
        law=law_class(live).of(live, scales, axes),
        shape=tuple(shape),
        stiffness=stiffness,
        damping=damping,
        harmonic=np.asarray(excited.harmonic, dtype=float),
        cosine=cosine,
        sine=sine,
        constant=constant,
        phase=np.asarray(phase, dtype=float),
    )


def room_of(reduction: Reduction) -> int:
    """Modes that a system has room for, four sizes an octave or fewer: 1, 2, 3, 4, 6, 8, 10, 12, 14, 16, 20, ...

    So structures of nearly as many modes share what is compiled. Where no contact is left nothing is.
    """
    num = reduction.modes.size
    step = max(2 ** (num.bit_length() - 3), 2) if num > 4 and reduction.live.size else 1
    return -(-num // step) * step


def widened(row: np.ndarray, reduction: Reduction) -> np.ndarray:
    """Numbers of each mode along the last axis, and zero for those that a system has room for beyond them."""
    whole = np.zeros((*row.shape[:-1], room_of(reduction)))
    whole[..., : row.shape[-1]] = row
    return whole


def _push(model: Model, modes: np.ndarray, scales: Scales) -> np.ndarray:
    """Unit of the modal force on each mode, shape (K,)."""
    return scales.mode[modes] * model.structure.mass[modes] * scales.omega**2


def held_force(reduction: Reduction, scales: Scales) -> np.ndarray:
    """Constant force on the modes of the loop of the contacts that are left out, shape (K,)."""
    force, turn = reduction.held_force / _push(reduction.model, reduction.modes, scales), reduction.natural[1]
    return force if turn is None else force @ turn


def _damping(model: Model, modes: np.ndarray, turn: np.ndarray | None) -> np.ndarray:
    """Damping of natural modes of unit mass, by one number each where it does not couple them, [1/time]."""
    damping, root = model.structure.damping, np.sqrt(model.structure.mass[modes])
    whole = damping[np.ix_(modes, modes)] / np.outer(root, root) if damping.ndim == 2 else damping[modes] / root**2
    if turn is None:
        return whole
    turned = turn.T @ (whole @ turn if whole.ndim == 2 else whole[:, None] * turn)
    own = np.diagonal(turned)
    couples = np.abs(turned - np.diag(own)).max() > COUPLED * np.abs(own).max()
    return 0.5 * (turned + turned.T) if couples else own


def contact_axes(model: Model, reduction: Reduction) -> np.ndarray:
    """Axes of the loop in those of each live contact, as columns, shape (C, 2, 2), or (C, 2, 1) of straight motion.

    They are the principal axes of K_u, so that a whole matrix costs no more than two numbers.
    """
    if reduction.line is not None:
        return reduction.line[:, :, None]
    stiffness = model.tangential_stiffness[reduction.live]
    return np.array([np.eye(2) if K[0, 1] == 0 else np.linalg.eigh(K)[1] for K in stiffness]).reshape(-1, 2, 2)
