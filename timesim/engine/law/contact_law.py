"""What the event loop asks of a contact law and of the system in which it acts; vectors of the contact plane.

A vector of the contact plane is a tuple of its components, each an array over the contacts: two of them, or one where
all motion is straight. A law is elementwise, which is what XLA fuses. Nothing here knows units: the event loop uses
the dimensionless form, in which time is an angle and a cycle has length 2 pi.
"""

from timesim.runtime import Leaf  # isort: skip

import abc
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from timesim.engine.law.rule import Rule
from timesim.model.model import SEPARATION, Contact
from timesim.model.scales import Scales

if TYPE_CHECKING:
    Scalar: TypeAlias = Array
    State: TypeAlias = Array
else:
    Scalar = Float[Leaf, "*#contact"]
    State = Int[Leaf, "*#contact"]
Plane: TypeAlias = tuple[Scalar, ...]
Path: TypeAlias = tuple[Plane, Plane, Plane]
AnyState: TypeAlias = Any
"""A `ContinuousState`, of the kind that the dynamics at hand have."""


class Motion(NamedTuple):
    """Relative motion of the contacts, in the axes of the law: u, v and their rates."""

    u: Plane
    v: Scalar
    du: Plane
    dv: Scalar


class Reaction(eqx.Module):
    """What the contacts do at an instant.

    Attributes:
        f: friction force.
        n: normal load as it enters the equations of motion.
        dw: slip rate w'; ``f . w'`` is the power lost in friction.
        lost: power lost otherwise, as in a damper across the contact; None for a law without any.
    """

    f: Plane
    n: Scalar
    dw: Plane
    lost: Scalar | None = None


class Within(NamedTuple):
    """Contacts at the nodes of a step.

    Attributes:
        inner: what the law iterates on, its first axis that of the nodes, the start of the step among them.
        f, n: friction force and normal load, components of shape (node, contact).
        w: slip, the same.
        lost: power lost otherwise than in friction, as in `Reaction`.
    """

    inner: PyTree
    f: Plane
    n: Scalar
    w: Plane
    lost: Scalar | None = None


class Nodes(NamedTuple):
    """Relative motion, normal last, its rate, and slip at the start and the nodes of a step, each (node, contact)."""

    x: Plane
    dx: Plane
    w: Plane


class ContactLaw(eqx.Module):
    """A law of contacts: forces, slip rate, what ends a state and what follows it.

    The parameters are arrays over the contacts. A contact is in one of the states of `timesim.model.model`: stick, slip
    or separation; a law need not use all of them.

    Attributes:
        preload: n0, the load that the structure carries at rest where it is positive.
    """

    preload: eqx.AbstractVar[Scalar]

    @classmethod
    @abc.abstractmethod
    def of(cls, contacts: Sequence[Contact], scales: Scales, axes: np.ndarray | None = None) -> "ContactLaw":
        """The law of some contacts, its parameters numpy arrays.

        Args:
            contacts: their parameters in the units of the scene.
            scales: units of the dimensionless form.
            axes: those of the law as columns in the plane of each contact, shape (C, 2, 2), principal axes of K_u, or
                (C, 2, 1) where all motion is straight; by default the axes of the contacts themselves.
        """

    @staticmethod
    @abc.abstractmethod
    def start_states(contacts: Sequence[Contact], normal: np.ndarray) -> np.ndarray:
        """States in which contacts start under a load n0 + k_v v [force] where nothing else says so, shape (C,), numpy.

        Contacts and loads are in the units of the scene.
        """

    def disturbed(self, state: State, h: Scalar, ends: Sequence[tuple[Motion, Plane]]) -> "ContactLaw":
        """The law as an explicit step follows it with a disturbance: by default this one.

        ``ends``: motion and slip at both ends of the step of length h.
        """
        return self

    def decays(self, state: State, h: Scalar, ends: Sequence[tuple[Motion, Plane]]) -> Sequence[Scalar]:
        """Of a disturbance that the contacts themselves let die out over a step, at the rate of each of its ends.

        Arguments as `disturbed`; by default 0.
        """
        return [jnp.zeros(state.shape) for _ in ends]

    @abc.abstractmethod
    def reaction(self, state: State, motion: Motion, w: Plane) -> Reaction:
        """Forces and slip rate of each contact in its state; smooth a little beyond its end, for trial steps."""

    @abc.abstractmethod
    def margins(self, state: State, motion: Motion, w: Plane) -> tuple[Scalar, Scalar]:
        """Distances to two ends of the state, positive inside, zero at the transition: a force, a number of size one.

        The second one is the speed that ends slip by stick, or of any other state another end, and 1 where it has none.
        """

    @abc.abstractmethod
    def successor(self, state: State, motion: Motion) -> State:
        """State of a contact that has reached a transition."""

    @abc.abstractmethod
    def slip_at_transition(self, before: State, after: State, motion: Motion, w: Plane) -> Plane:
        """Slip with which a contact goes on after a step; if its state has not changed, at the rates that it had."""

    def placed(self, state: np.ndarray, motion: Motion, w: Plane) -> tuple[np.ndarray, tuple[np.ndarray, ...]] | None:
        """States and slip of contacts that are put elsewhere, as by Newton's method between two periods; in numpy.

        By default the states stay, and the slip is that with which they go on. None where a contact would touch that
        was apart, or the reverse, or be outside its state otherwise.
        """
        w = self.slip_at_transition(state, state, motion, w)
        inside = np.minimum(*self.margins(state, motion, w)) >= 0
        return (state, tuple(map(np.asarray, w))) if inside.all() else None

    def inner(self, state: State, motion: Motion, w: Plane) -> PyTree:
        """What the law iterates on in a step that is taken at all its nodes at once: by default the slip."""
        return w

    def collocated(self, state: State, w: Plane, motion: Motion, inner: PyTree, h: Scalar, rule: Rule) -> Within:
        """Contacts at the nodes of a rule, from a better inner value than the one given.

        Args:
            state: states during the step.
            w: slip at its start.
            motion: at the nodes, their axis the first.
            inner: at the start and the nodes.
        """
        acts = self.reaction(state, motion, tuple(x[1:] for x in inner))
        moved = tuple(x + h * (jnp.asarray(rule.integrals) @ dw) for x, dw in zip(w, acts.dw, strict=True))
        moved = where(state == SEPARATION, motion.u, moved)
        new = tuple(jnp.concatenate([old[:1], x]) for old, x in zip(inner, moved, strict=True))
        return Within(new, acts.f, acts.n, moved, acts.lost)

    def slip_inside(self, state: State, w: Plane, motion: Motion, inner: PyTree) -> Plane:
        """Slip inside a step, from that at its start and the motion and the inner value there."""
        return where(state == SEPARATION, motion.u, inner)

    @abc.abstractmethod
    def scale(self, state: State) -> Scalar:
        """Size of the forces in the first margin of a state for motions of size one, to compare it with zero."""

    @staticmethod
    @abc.abstractmethod
    def stored_energy(
        contact: Contact, motion: np.ndarray, slip: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Parts of the elastic energy of one contact, in the units of the scene, each of shape (N,).

        What acts on the structure is the change of the normal load, n - max(n0, 0): the preload does work as well.

        Args:
            motion: (u1, u2, v) in its axes, shape (N, 3).
            slip: w, shape (N, 2).
            state: shape (N,).
        """


class ContinuousState(abc.ABC):
    """Where a trajectory is in its continuous state, slip w among it, or the rate of that, or its error over a step."""

    w: Plane

    @abc.abstractmethod
    def error(self) -> Float[Array, ""]:
        """Largest entry of an error that the step control looks at."""

    @abc.abstractmethod
    def finite(self) -> Bool[Array, ""]:
        """Whether every coordinate is a number."""


class Dynamics(abc.ABC):
    """A system with contacts and their law."""

    law: ContactLaw

    @abc.abstractmethod
    def field(self, state: State, time: Float[Array, ""], point: AnyState) -> AnyState:
        """Rate of the continuous state, every contact keeping its own."""

    @abc.abstractmethod
    def motion(self, point: AnyState) -> Motion:
        """Relative motion of the contacts and its rates."""

    @abc.abstractmethod
    def path(self, point: AnyState, rate: AnyState) -> Path:
        """Relative motion of the contacts, normal last, with two derivatives; ``rate`` is that of the point."""

    @abc.abstractmethod
    def size(self, point: AnyState) -> Float[Array, ""]:
        """Largest coordinate of the motion: what a relative tolerance is relative to."""

    @property
    def by_itself(self) -> bool:
        """Whether its trajectory is advanced `single`."""
        return False

    def single(self) -> "Dynamics":
        """The same, where its trajectory is advanced by itself and not in one operation with others."""
        return self

    @property
    def wide(self) -> bool:
        """Whether trajectories go one after the other, the stages of a step in a loop: so much goes into a rate."""
        return False


def dot(a: Plane, b: Plane) -> Scalar:
    """Scalar product in the contact plane."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def scaled(factor: Scalar, a: Plane) -> Plane:
    """A multiple of a vector."""
    return tuple(factor * x for x in a)


def where(condition: Bool[Array, "*#contact"], a: Plane, b: Plane) -> Plane:
    """One of two vectors."""
    return tuple(jnp.where(condition, x, y) for x, y in zip(a, b, strict=True))


def minus(a: Plane, b: Plane) -> Plane:
    """a - b."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


def length(a: Plane) -> Scalar:
    """Length of a vector; its derivative at zero is zero, and one may divide by it."""
    return jnp.sqrt(jnp.maximum(dot(a, a), 1e-300))


def product(matrix: tuple[Scalar, ...], a: Plane) -> Plane:
    """A symmetric matrix of the plane times a vector; isotropic if it is one number, diagonal if it is two."""
    if len(matrix) == 1:
        return scaled(matrix[0], a)
    if len(matrix) == 2:
        return tuple(k * x for k, x in zip(matrix, a, strict=True))
    k11, k12, k22 = matrix
    return (k11 * a[0] + k12 * a[1], k12 * a[0] + k22 * a[1])
