"""The steady cycle of a contact under prescribed motion: its states, force, hysteresis and Fourier coefficients.

Section 4.3 of the paper: the friction force of one cycle, known state by state, is developed into equation
(19). Integrals over the cycle are Gauss rules between the transitions and the steps of a slip, where the
force is smooth.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray

from timesim.element.motion import CYCLE, Array, PrescribedMotion, unit
from timesim.element.slip_path import NUM_STAGES, TO_LEGENDRE, Law, SlipPath
from timesim.model.model import SEPARATION, SLIP, STICK

# Change of f from cycle to cycle, relative to the largest mu n, that may be rounding: along a spline, whose high
# derivatives jump from piece to piece, it was seen to stay at 3e-12.
PERIODIC = 1e-11
GAUSS_NODES, GAUSS_WEIGHTS = legendre.leggauss(16)
INTERVAL = 0.6
# Cycles after which a leap is judged: the first one takes back what is across its way.
JUDGED = 2
# Share of its way that a leap beyond the limit is taken by instead.
WITHDRAWN = 3 / 4


@dataclass(frozen=True)
class Stay:
    """One state from `start` to `stop` [rad] within a cycle; w in stick, the path in slip."""

    state: int
    start: float
    stop: float
    slip: Array
    path: SlipPath | None = None


@dataclass(frozen=True)
class Transition:
    """Change of state at an angle counted from the start of the run [rad]."""

    angle: float
    before: int
    after: int


@dataclass(frozen=True)
class Coefficients:
    """Mean and first harmonic of the friction force, equation (19); each of shape (2,) [force].

    Attributes:
        f_b: mean.
        f_s: parts in phase with the motion of each component, on sin(theta + phase).
        f_c: parts a quarter ahead, on cos(theta + phase).
        amplitude, phase: of the motion along the same axes [length], [rad].
        axes: rows are the axes, shape (2, 2).
    """

    f_b: Array
    f_s: Array
    f_c: Array
    amplitude: Array
    phase: Array
    axes: Array

    @property
    def effective_stiffness(self) -> Array:
        """f_s over the amplitude [force/length], NaN where that is zero."""
        return _ratio(self.f_s, self.amplitude)

    @property
    def effective_damping(self) -> Array:
        """f_c over the amplitude [force/length], NaN where that is zero."""
        return _ratio(self.f_c, self.amplitude)


def in_phase(first: NDArray[np.complex128], phase: Array) -> tuple[Array, Array]:
    """f_s and f_c of (19), the parts of a first harmonic on sin(theta + phase) and cos(theta + phase).

    The harmonic is given as its cosine part minus i times its sine part [force], the phase is that of the motion [rad],
    both of shape (..., 2).
    """
    turned = first * np.exp(-1j * phase)
    return -turned.imag, turned.real


def beyond(way: Array, change: Array) -> NDArray[np.bool_]:
    """Whether a leap of friction forces went beyond their limit, as cycles after it do not go on in its direction.

    There other slips push back, or none is left: among the offsets of full stick, on the border of which the march
    ends. ``change`` is that of the force over a cycle; shapes (..., 2) [force].
    """
    return np.sum(np.multiply(way, change), axis=-1) <= 0


def _ratio(force: Array, amplitude: Array) -> Array:
    return np.divide(force, amplitude, out=np.full(2, np.nan), where=amplitude != 0)


def principal_axes(fundamental: NDArray[np.complex128]) -> tuple[Array, Array, Array]:
    """Principal axes of the ellipse u_i = Im(U_i exp(i theta)), U of shape (2,) [length].

    Along them the motion is [a sin(theta + chi), b cos(theta + chi)].

    Returns:
        axes, rows the major and the minor one, right-handed, shape (2, 2); amplitudes (a, b), a >= |b|, shape
        (2,) [length]; phases (chi, chi + pi/2) [rad]. For a circle, and for no motion, they are t1 and t2.
    """
    square = np.sum(fundamental**2)
    if abs(square) <= 1e-14 * np.sum(np.abs(fundamental) ** 2):
        chi = float(np.angle(fundamental[0]))
    else:
        chi = float(np.angle(square)) / 2
    turned = fundamental * np.exp(-1j * chi)
    major = unit(turned.real)
    if (major[0], major[1]) < (0.0, 0.0):
        major, chi = -major, chi + np.pi
    axes = np.array([major, [-major[1], major[0]]])
    along = axes @ (fundamental * np.exp(-1j * chi))
    return axes, np.array([along[0].real, along[1].imag]), np.array([chi, chi + np.pi / 2])


@dataclass(frozen=True)
class ElementCycle:
    """The steady cycle of a contact under prescribed motion.

    Attributes:
        stays: the states of the cycle in turn, from theta = 0 to 2 pi.
        transitions: those of the cycle, angles in [0, 2 pi).
        num_cycles: cycles marched from the start, this one included.
        residual: change of the friction force from its start to its end, relative to the largest mu n.
        history: all transitions from the start on, without the leaps of a slow march to its limit.
    """

    law: Law
    motion: PrescribedMotion
    stays: tuple[Stay, ...]
    transitions: tuple[Transition, ...]
    num_cycles: int
    residual: float
    history: tuple[Transition, ...]

    @property
    def periodic(self) -> bool:
        """Whether the cycle repeats to rounding."""
        return self.residual <= PERIODIC

    @property
    def touches(self) -> bool:
        """Whether there is contact at all; without, every result is zero."""
        return any(stay.state != SEPARATION for stay in self.stays)

    @property
    def offset_free(self) -> bool:
        """Full stick: w may keep another offset, seen in f_b alone; here that of a start with f = 0."""
        return all(stay.state == STICK for stay in self.stays)

    @property
    def largest_limit(self) -> float:
        """Largest limit force mu n of the cycle [force]; zero where there is none."""
        return float(self.law.friction * self.normal_load(self.motion.normal_extremes).max())

    @property
    def force_scale(self) -> float:
        """Friction times what n is the sum of, preload and largest k_v v [force]: its rounding is relative to this."""
        pressed = self.law.normal_stiffness * np.abs(self.motion.evaluate(self.motion.normal_extremes)[0][2]).max()
        return float(self.law.friction * (abs(self.law.preload) + pressed))

    @cached_property
    def _pieces(self) -> tuple[Array, Array, NDArray[np.int64], Array, Array]:
        """Start, length, state, w and Legendre series of alpha of each piece: a stay, or a step of a slip."""
        rows = [row for stay in self.stays if stay.stop > stay.start for row in _rows(stay)]
        start, length, state, slip, series = zip(*rows, strict=True)
        return np.array(start), np.array(length), np.array(state, np.int64), np.array(slip), np.array(series)

    def _at(self, theta: ArrayLike) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """State, w in stick, shape (2, ...), direction in slip, and the angle within the cycle."""
        start, length, state, slip, series = self._pieces
        local = np.mod(np.asarray(theta, float), CYCLE)
        piece = np.searchsorted(start, local, side="right") - 1
        basis = legendre.legvander(2 * (local - start[piece]) / length[piece] - 1, NUM_STAGES)
        direction = np.sum(basis * series[piece], -1).reshape(local.shape)  # legvander makes one angle an array of it
        return state[piece], np.moveaxis(slip[piece], -1, 0), direction, local

    def state(self, theta: ArrayLike) -> NDArray[np.int64]:
        """State at angles of any shape [rad]: 0 stick, 1 slip, 2 separation."""
        return self._at(theta)[0]

    def normal_load(self, theta: ArrayLike) -> Array:
        """n = max(0, n0 + k_v v) at angles of any shape [force]."""
        y, _ = self.motion.evaluate(np.mod(theta, CYCLE))
        return np.maximum(self.law.load(y), 0.0)

    def force(self, theta: ArrayLike) -> Array:
        """Friction force f at angles of any shape, shape (2, ...) [force]."""
        return self._forces(theta)[0]

    def slip(self, theta: ArrayLike) -> Array:
        """Slip motion w at angles of any shape, shape (2, ...) [length]; w = u in separation."""
        y, _ = self.motion.evaluate(np.mod(theta, CYCLE))
        return y[:2] - np.tensordot(self.law.compliance, self.force(theta), 1)

    def _forces(self, theta: ArrayLike) -> tuple[Array, Array, Array]:
        """f and u', shapes (2, ...), and the power f . w', shape (...), by the angle."""
        state, slip, direction, local = self._at(theta)
        y, dy = self.motion.evaluate(local)
        limit, _ = self.law.limit(y, dy)
        sliding = limit * (state == SLIP)
        stuck = np.tensordot(self.law.stiffness, y[:2] - slip, 1) * (state == STICK)
        power = np.zeros_like(sliding) if self.law.frictionless else sliding * self.law.slip_rate(direction, dy)
        return sliding * np.stack([np.cos(direction), np.sin(direction)]) + stuck, dy[:2], power

    def _quadrature(self, width: float) -> tuple[Array, Array]:
        """Angles and weights of a Gauss rule over the cycle, broken where the force is not smooth."""
        edges = np.unique(np.concatenate([self._pieces[0], self.motion.breaks, [CYCLE]]))
        parts = np.ceil(np.diff(edges) / width).astype(int)
        size = np.repeat(np.diff(edges) / parts, parts)
        place = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        first = np.repeat(edges[:-1], parts) + size * place
        theta = first[:, None] + size[:, None] * (GAUSS_NODES + 1) / 2
        return theta.ravel(), (size[:, None] * GAUSS_WEIGHTS / 2).ravel()

    def harmonics(self, num_harmonics: int) -> tuple[Array, Array]:
        """Fourier coefficients of f, cosine, with the mean first, and sine, each of shape (H + 1, 2) [force]."""
        theta, weights = self._quadrature(INTERVAL / max(1.0, num_harmonics / 8))
        turn = np.exp(-1j * np.multiply.outer(np.arange(num_harmonics + 1), theta))
        phasor = (turn * weights) @ self.force(theta).T / np.pi
        phasor[0] /= 2
        return phasor.real, -phasor.imag

    @cached_property
    def _integrals(self) -> tuple[Array, Array, float, float]:
        """Mean and first harmonic of f, its loop area and its work, from one quadrature."""
        theta, weights = self._quadrature(INTERVAL)
        force, velocity, power = self._forces(theta)
        weighted = force * weights
        first = weighted @ np.exp(-1j * theta) / np.pi
        return weighted.sum(1) / CYCLE, first, float(np.sum(weighted * velocity)), float(power @ weights)

    @cached_property
    def coefficients(self) -> Coefficients:
        """f_b, f_s and f_c of (19) along t1 and t2, component 2 on sin and cos of theta + phi."""
        return self._along(np.eye(2), self.motion.amplitude, self.motion.phase)

    @cached_property
    def principal_coefficients(self) -> Coefficients:
        """The same along the principal axes of the ellipse of the motion (figures 7 and 8)."""
        return self._along(*principal_axes(self.motion.fundamental))

    def _along(self, axes: Array, amplitude: Array, phase: Array) -> Coefficients:
        mean, first, _, _ = self._integrals
        return Coefficients(axes @ mean, *in_phase(axes @ first, phase), amplitude, phase, axes)

    @property
    def dissipation(self) -> float:
        """Energy a cycle as the area of the hysteresis loops, the integral of f . du [force length]."""
        return self._integrals[2]

    @property
    def work(self) -> float:
        """Energy a cycle as the work of friction, the integral of f . dw over the slip [force length]."""
        return self._integrals[3]


def _rows(stay: Stay) -> list[tuple[float, float, int, Array, Array]]:
    if stay.path is None:
        return [(stay.start, stay.stop - stay.start, stay.state, stay.slip, np.zeros(NUM_STAGES + 1))]
    path = stay.path
    return [
        (start, length, stay.state, stay.slip, TO_LEGENDRE @ alpha)
        for start, length, alpha in zip(path.start, path.length, path.alpha, strict=True)
    ]
