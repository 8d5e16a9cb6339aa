"""A contact under prescribed motion as the event loop takes it, and the integrals of one cycle.

The relative motion (u, v) is a given function of the angle θ, so that of the contact only its slip w evolves. The
continuous state holds w and, from the start of the cycle on, the integrals of which equation (19) consists::

    θ' = 1    w' = w'(u, v, u', v', w)    a' = f    c' = f cos θ    s' = f sin θ    W' = f . w'

prime the derivative with respect to the angle, f and w' by the law of the contact. At the end of the cycle

    f_b = a / 2π                                        mean
    f ≈ f_b + (c cos θ + s sin θ) / π                   first harmonic
    f_c - i f_s = (c - i s) exp(-i φ) / π               the same on cos(θ + φ) and sin(θ + φ), component by component
    W                                                   work of friction

θ is part of the state because the guards ask for the motion at a state, and a time alone does not reach them. Method,
guards, step control and law are those of every simulation. Lengths are in units of the motion's size: a tolerance is
relative to one.
"""

from timesim.runtime import Leaf, tree_class  # isort: skip

import abc
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from timesim.element.elements import Elements
from timesim.element.motion import CYCLE, HarmonicMotion, PrescribedMotion, SplineMotion
from timesim.engine import dense_output
from timesim.engine.event_loop import advance, march
from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import ContinuousState, Dynamics, Motion, Path, Plane, Scalar, State, dot
from timesim.engine.method import Method
from timesim.engine.solver import Control
from timesim.engine.status import Status
from timesim.engine.step import Step, Trajectory, begin
from timesim.program import program

FIRST_STEP = 0.02
CAPACITY = 16_384  # steps recorded of one cycle: a method of order 5 at 1e-12 takes 3,000 where k A is 66 mu n


class Drive(eqx.Module):
    """A prescribed motion of contacts."""

    @abc.abstractmethod
    def path(self, angle: Float[Array, ""]) -> Path:
        """The motion (u1, u2, v) at an angle, with two derivatives."""


class HarmonicDrive(Drive):
    """Harmonic motion, ``cosine cos θ + sine sin θ`` of u1, u2 and v."""

    cosine: Plane
    sine: Plane

    def path(self, angle: Float[Array, ""]) -> Path:
        c, s = jnp.cos(angle), jnp.sin(angle)
        pairs = list(zip(self.cosine, self.sine, strict=True))
        value = tuple(a * c + b * s for a, b in pairs)
        return value, tuple(b * c - a * s for a, b in pairs), tuple(-x for x in value)


class SplineDrive(Drive):
    """The motion of one contact, by polynomials of degree five in the angle from the start of each of equal pieces."""

    taylor: Float[Leaf, "6 piece 3"]

    def path(self, angle: Float[Array, ""]) -> Path:
        count = self.taylor.shape[1]
        width = CYCLE / count
        angle = angle % CYCLE
        piece = jnp.minimum(jnp.floor(angle / width).astype(int), count - 1)
        c, x = tuple(jnp.asarray(self.taylor)[:, piece, :, None]), angle - piece * width
        value, _ = dense_output.evaluate(x, c)
        rate, second = dense_output.evaluate(x, tuple(k * c[k] for k in range(1, 6)))
        return tuple(value), tuple(rate), tuple(second)


@tree_class
class CycleState(ContinuousState):
    """Continuous state of a contact under prescribed motion, from the start of a cycle on.

    Attributes:
        angle: θ.
        w: slip.
        force: a, c and s, the integrals of f, f cos θ and f sin θ, by components of f.
        work: W, the integral of f . w'.
    """

    angle: Float[Array, ""]
    w: Plane
    force: Float[Array, "3 tangent contact"]
    work: Scalar

    def error(self) -> Float[Array, ""]:
        worst = jnp.abs(self.force).max()
        for w in self.w:
            worst = jnp.maximum(worst, jnp.abs(w).max())
        return worst

    def finite(self) -> Bool[Array, ""]:
        return jnp.isfinite(self.w[0]).all() & jnp.isfinite(self.w[1]).all() & jnp.isfinite(self.work).all()


@tree_class
class PrescribedContacts(Dynamics):
    """Contacts whose relative motion is given: their law, and what drives them."""

    law: ConeLaw
    drive: Drive

    def field(self, state: State, time: Float[Array, ""], point: CycleState) -> CycleState:
        acts = self.law.reaction(state, self.motion(point), point.w)
        waves = jnp.stack([jnp.ones(()), jnp.cos(point.angle), jnp.sin(point.angle)])
        force = waves[:, None, None] * jnp.stack(acts.f)
        return CycleState(jnp.ones(()), acts.dw, force, dot(acts.f, acts.dw))

    def motion(self, point: CycleState) -> Motion:
        x, dx, _ = self.drive.path(point.angle)
        return Motion(x[:-1], x[-1], dx[:-1], dx[-1])

    def path(self, point: CycleState, rate: CycleState) -> Path:
        return self.drive.path(point.angle)

    def size(self, point: CycleState) -> Float[Array, ""]:
        return jnp.ones(())


def drive_of(elements: Elements, motion: PrescribedMotion | None = None) -> Drive:
    """The motion of elements, harmonic unless another one is given for a single element.

    Raises:
        TypeError: a motion of another kind.
    """
    if motion is None or isinstance(motion, HarmonicMotion):
        return HarmonicDrive(tuple(elements.start.T), tuple(elements.rate.T))
    if isinstance(motion, SplineMotion):
        return SplineDrive(motion.pieces.c[::-1] / elements.length)
    raise TypeError(f"no drive for a {type(motion).__name__}")


def cycle_start(dynamics: PrescribedContacts, w: Plane, state: State) -> Trajectory:
    """The start of a cycle at θ = 0."""
    none = jnp.zeros_like(w[0])
    point = CycleState(jnp.zeros(()), w, jnp.zeros((3, 2, none.size)), none)
    return begin(dynamics, point, state, jnp.asarray(FIRST_STEP))


@program
def march_cycle(
    method: Method, control: Control, dynamics: PrescribedContacts, w: Plane, state: State
) -> tuple[Trajectory, Array]:
    """One cycle of contacts side by side, each in steps of its own.

    Returns the trajectories at its end, the contact as first axis, and the number of transitions of each.
    """
    lanes, w, state = jax.tree.map(lambda leaf: leaf[:, None], (dynamics, w, state))
    starts = jax.vmap(cycle_start)(lanes, w, state)
    return march(method, control, lanes, starts, jnp.ones(state.shape[0], dtype=jnp.int64))


@program
def record_cycle(
    method: Method, control: Control, dynamics: PrescribedContacts, w: Plane, state: State
) -> tuple[Trajectory, Step, Array]:
    """One cycle of one contact: the trajectory at its end, its steps, and how many there are."""
    return advance(method, control, dynamics, cycle_start(dynamics, w, state), jnp.asarray(1), CAPACITY)


@dataclass(frozen=True)
class CycleEnd:
    """What one cycle of N elements amounts to.

    Attributes:
        mean: of the friction force, shape (N, 2) [force].
        first: its first harmonic, cosine part minus i times the sine part, shape (N, 2) [force].
        dissipation: work of friction, shape (N,) [force length].
        slip: w at the end of the cycle, shape (N, 2), in units of the elements.
        state: state there, shape (N,).
        status: `Status` of each, shape (N,); RUNNING where the loop reached it.
    """

    mean: np.ndarray
    first: np.ndarray
    dissipation: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    status: np.ndarray

    @property
    def good(self) -> np.ndarray:
        """Whether the loop reached it, shape (N,)."""
        return self.status == Status.RUNNING


def cycle_end(elements: Elements, end: Trajectory) -> CycleEnd:
    """Read the integrals at the end of a cycle."""
    point = end.point
    a, c, s = np.moveaxis(np.reshape(point.force, (-1, 3, 2)), 1, 0) * elements.force[:, None]
    return CycleEnd(
        mean=a / CYCLE,
        first=(c - 1j * s) / np.pi,
        dissipation=np.ravel(point.work) * elements.length * elements.force,
        slip=np.stack([np.ravel(w) for w in point.w], axis=1),
        state=np.ravel(end.state),
        status=np.ravel(end.status),
    )
