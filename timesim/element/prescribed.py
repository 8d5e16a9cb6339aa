"""Prescribed motion in the event loop: contacts whose modes are moved, and what their friction force amounts to.

The loop is that of every simulation; only the method of a step differs. Of the seven modes of a contact

- three carry its relative motion (u1, u2, v): the method sets them to the given motion at every stage, so nothing is
  integrated but the slip;
- two free masses, one an axis, collect the mean of the friction force in their velocity;
- two undamped oscillators at the base frequency collect its first harmonic: starting at rest they end a cycle with
  ``q = -∫ F sin θ dθ`` and ``p = ∫ F cos θ dθ`` (Duhamel's integral), which is equation (19).

Every mode shape is `WEAK`: what the force does to the carriers is overwritten, and what the collectors add to the
motion is a rounding of it. The energy is collected as in every run, as the work of friction ``∫ f · dw``. Time is the
angle θ.
"""

import timesim.runtime  # noqa: F401  isort: skip

import abc
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from timesim.element.elements import Elements
from timesim.element.motion import CYCLE, HarmonicMotion, Motion, SplineMotion
from timesim.engine.contact import ConeLaw
from timesim.engine.event_loop import advance, march
from timesim.engine.method import Advance, Explicit, Field, Method, method_named, moved
from timesim.engine.solver import Control, step_control
from timesim.engine.step import Status, Step, Trajectory, begin
from timesim.engine.system import Point, System, Work
from timesim.model.solver import Solver

WEAK = 1e-8
NUM_CARRIERS, NUM_MODES = 3, 7
# Harmonics of a sampled motion from which the loop has the acceleration at the start of a step: for its guesses only.
NUM_GUESSED = 4
FIRST_STEP = 0.02
CAPACITY = 2048  # steps recorded of one cycle
Carriers = tuple[Array, Array]


class Drive(eqx.Module):
    """A prescribed motion as the event loop needs it, in units of the scale of lengths over `WEAK`."""

    @abc.abstractmethod
    def at(
        self, q: Float[Array, " 3"], p: Float[Array, " 3"], time: Float[Array, ""], tau: Float[Array, ""]
    ) -> tuple[Float[Array, " 3"], Float[Array, " 3"], Float[Array, " 3"]]:
        """Motion and two derivatives a time ``tau`` after ``time``, where motion and rate are ``q`` and ``p``."""


class Turn(Drive):
    """Harmonic motion, of whatever amplitude and phase: a turn of the phasor that q and p already are."""

    def at(self, q: Array, p: Array, time: Array, tau: Array) -> tuple[Array, Array, Array]:
        """q cos τ + p sin τ."""
        c, s = jnp.cos(tau), jnp.sin(tau)
        value = c * q + s * p
        return value, c * p - s * q, -value


class Pieces(Drive):
    """A motion by polynomials of degree five between equal angles.

    Attributes:
        taylor: coefficients at the start of each piece, highest power first.
    """

    taylor: Float[Array, "6 piece 3"]

    def at(self, q: Array, p: Array, time: Array, tau: Array) -> tuple[Array, Array, Array]:
        """The polynomial and its derivatives."""
        count = self.taylor.shape[1]
        width = CYCLE / count
        angle = time + tau
        # A step ends with the cycle to rounding: beyond it the last piece goes on.
        piece = jnp.clip(jnp.floor(angle / width).astype(int), 0, count - 1)
        x, c = angle - piece * width, self.taylor[:, piece]
        value, rate, second = c[0], 5 * c[0], 20 * c[0]
        for power in range(1, 6):
            value = value * x + c[power]
            rate = rate * x + (5 - power) * c[power] if power < 5 else rate
            second = second * x + (5 - power) * (4 - power) * c[power] if power < 4 else second
        return value, rate, second


class Prescribed(Method):
    """A Runge-Kutta method that integrates what depends on the motion, and takes the motion as it is given.

    Attributes:
        inner: the method.
        drive: the motion.
    """

    order: int = eqx.field(static=True)
    inner: Explicit
    drive: Drive

    def advance(self, field: Field, time: Array, point: Point, rate: Point, h: Array) -> Advance:
        """Every stage, and the end, with the carriers where they are to be."""
        inner, slopes = self.inner, [rate]

        def driven(moving: Point, tau: Array) -> tuple[Point, Array]:
            q, p, a = self.drive.at(point.q[:NUM_CARRIERS], point.p[:NUM_CARRIERS], time, tau)
            carried = (_with_carriers(q, moving.q), _with_carriers(p, moving.p))
            return Point(*carried, moving.w, moving.work), a

        for node, row in zip(inner.nodes, inner.stages, strict=True):
            slopes.append(field(time + node * h, driven(moved(point, slopes, row, h), node * h)[0]))
        end, acceleration = driven(moved(point, slopes, inner.weights, h), h)
        first_same_as_last = inner.nodes[-1] == 1 and inner.stages[-1] == inner.weights[:-1]
        last = slopes[-1] if first_same_as_last else field(time + h, end)
        end_rate = Point(end.p, _with_carriers(acceleration, last.p), last.w, last.work)
        if not any(inner.error_weights):
            return Advance(end, end_rate, None)
        error = moved(None, slopes, inner.error_weights, h)
        none = jnp.zeros(NUM_CARRIERS)
        q, p = (_with_carriers(none, part / WEAK) for part in (error.q, error.p))
        return Advance(end, end_rate, Point(q, p, error.w, error.work))


def _with_carriers(carriers: Array, modes: Array) -> Array:
    return jnp.concatenate([carriers, modes[NUM_CARRIERS:]])


def carriers_of(elements: Elements) -> Carriers:
    """Where the carriers start a cycle, and their rate, shape (N, 3)."""
    unit = (elements.length * WEAK)[:, None]
    return jnp.asarray(elements.start / unit), jnp.asarray(elements.rate / unit)


def law_of(elements: Elements, isotropic: bool) -> ConeLaw:
    """The law in the units of each element, the batch as the first axis."""
    ratio = elements.length / elements.force
    K = elements.stiffness * ratio[:, None, None]
    K = np.where(elements.live[:, None, None], K, np.eye(2))
    k11, k12, k22 = K[:, 0, 0], K[:, 0, 1], K[:, 1, 1]
    det = k11 * k22 - k12**2
    stiffness, compliance = ((k11,), (1 / k11,)) if isotropic else ((k11, k12, k22), (k22 / det, -k12 / det, k11 / det))
    column = [jnp.asarray(x)[:, None] for x in (elements.normal_stiffness * ratio, elements.preload / elements.force)]
    return ConeLaw(
        jnp.asarray(elements.friction)[:, None],
        tuple(jnp.asarray(x)[:, None] for x in stiffness),
        tuple(jnp.asarray(x)[:, None] for x in compliance),
        *column,
    )


def system_of(law: ConeLaw, acceleration: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None) -> System:
    """The system of seven modes of each element, the batch as the first axis.

    Args:
        law: the law, batch first.
        acceleration: multiples of the base frequency, shape (H,), and the acceleration of the carriers at them on
            cosine and sine, shape (H, 3) each; of harmonic motion, the default, it is -q.
    """
    shape = WEAK * np.array([[1, 0, 0, 1, 0, 1, 0], [0, 1, 0, 0, 1, 0, 1], [0, 0, 1, 0, 0, 0, 0]], float)
    own = 1.0 if acceleration is None else 0.0
    harmonic, cosine, sine = (np.zeros((0, *s)) for s in ((), (3,), (3,))) if acceleration is None else acceleration
    wide = [np.pad(part, ((0, 0), (0, NUM_MODES - NUM_CARRIERS))) for part in (cosine, sine)]

    def one(law: ConeLaw) -> System:
        return System(
            law=law,
            shape=tuple(jnp.asarray(row[None]) for row in shape),
            stiffness=jnp.asarray([own, own, own, 0.0, 0.0, 1.0, 1.0]),
            damping=jnp.zeros(NUM_MODES),
            harmonic=jnp.asarray(harmonic, dtype=float),
            cosine=jnp.asarray(wide[0]),
            sine=jnp.asarray(wide[1]),
            constant=jnp.zeros(NUM_MODES),
            phase=jnp.zeros(()),
        )

    return jax.vmap(one)(law)


def control_of(solver: Solver) -> Control:
    """Tolerances of the loop: relative ones count from the scale of the motion, not from that of the carriers."""
    control = step_control(solver, 1.0)
    return eqx.tree_at(lambda c: c.rtol, control, control.rtol * WEAK)


def method_of(solver: Solver, drive: Drive) -> Prescribed:
    """The solver's method with the motion prescribed.

    Raises:
        ValueError: the method is an implicit one.
    """
    inner = method_named(solver.name)
    if not isinstance(inner, Explicit):
        raise ValueError(f"a prescribed motion needs an explicit method, not {solver.name}")
    return Prescribed(inner.order, inner, drive)


def trajectory(system: System, carriers: Carriers, w: Array, state: Array, length: Array) -> Trajectory:
    """The start of a cycle of one element, collectors at rest."""
    q, p = (jnp.concatenate([part, jnp.zeros(NUM_MODES - NUM_CARRIERS)]) for part in carriers)
    zero = jnp.zeros(())
    point = Point(q, p, (w[None, 0], w[None, 1]), Work(zero, zero, jnp.zeros(1)))
    return begin(system, point, state[None], length)


@eqx.filter_jit
def march_cycle(
    method: Method, control: Control, systems: System, carriers: Carriers, w: Array, state: Array, length: Array
) -> tuple[Trajectory, Array]:
    """One cycle of a batch: the trajectories at its end, and the number of transitions of each."""
    starts = jax.vmap(trajectory, in_axes=(0, 0, 0, 0, None))(systems, carriers, w, state, length)
    return march(method, control, systems, starts, jnp.ones(w.shape[0], dtype=jnp.int64))


@eqx.filter_jit
def record_cycle(
    method: Method, control: Control, system: System, carriers: Carriers, w: Array, state: Array, length: Array
) -> tuple[Trajectory, Step, Array]:
    """One cycle of one element: the trajectory at its end, its steps, and how many there are."""
    start = trajectory(system, carriers, w, state, length)
    return advance(method, control, system, start, jnp.asarray(1), CAPACITY)


@dataclass(frozen=True)
class Collected:
    """What one cycle amounts to, of N elements.

    Attributes:
        mean: of the friction force, shape (N, 2) [force].
        cosine, sine: its first harmonic, shape (N, 2) [force].
        dissipation: work of friction, shape (N,) [force length].
        slip: w at the end of the cycle, shape (N, 2) [length].
        state: state there, shape (N,).
        good: whether the loop came through, shape (N,).
    """

    mean: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    dissipation: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    good: np.ndarray


def collected(elements: Elements, end: Trajectory) -> Collected:
    """Read the collectors at the end of a cycle, batch first; the force on body 1, which moves them, is -f."""
    length, force = elements.length, elements.force
    q, p = (np.asarray(part)[:, NUM_CARRIERS:] * (force / WEAK)[:, None] for part in (end.point.q, end.point.p))
    assert end.point.work is not None
    w = np.concatenate([np.asarray(part) for part in end.point.w], axis=1)
    return Collected(
        mean=-p[:, :2] / CYCLE,
        cosine=-p[:, 2:] / np.pi,
        sine=q[:, 2:] / np.pi,
        dissipation=np.asarray(end.point.work.friction)[:, 0] * length * force,
        slip=w * length[:, None],
        state=np.asarray(end.state)[:, 0],
        good=np.asarray(end.status) == Status.RUNNING,
    )


def coefficients(phase: np.ndarray, found: Collected) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """f_b, f_s and f_c of (19) along t1 and t2, each of shape (N, 2) [force].

    Args:
        phase: of u1 and u2, shape (N, 2) [rad].
        found: mean and first harmonic.
    """
    turned = (found.cosine - 1j * found.sine) * np.exp(-1j * phase)
    return found.mean, -turned.imag, turned.real


def drive_of(motion: Motion, unit: float) -> tuple[Drive, tuple[np.ndarray, np.ndarray, np.ndarray] | None]:
    """A motion for the loop, and its acceleration for the system; see `system_of`.

    Args:
        motion: the motion.
        unit: of the carriers [length].

    Raises:
        TypeError: a motion of another kind.
    """
    if isinstance(motion, HarmonicMotion):
        return Turn(), None
    if not isinstance(motion, SplineMotion):
        raise TypeError(f"no drive for a {type(motion).__name__}")
    taylor = motion.pieces.c / unit
    spectrum = np.fft.rfft(motion.samples / unit, axis=0)[1 : NUM_GUESSED + 1] * 2 / len(motion.samples)
    harmonic = np.arange(1, len(spectrum) + 1)
    acceleration = -(harmonic**2)[:, None] * spectrum
    return Pieces(jnp.asarray(taylor)), (harmonic, acceleration.real, -acceleration.imag)
