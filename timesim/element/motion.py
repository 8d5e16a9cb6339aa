"""Prescribed relative motion y = (u1, u2, v) of a contact over one cycle, period 2 pi in the angle theta.

The paper's section 3.1 takes u = [A sin theta, B sin(theta + phi)], v = D sin(theta + psi); a motion from
samples is interpolated by a periodic quintic spline. Either kind answers in closed form what the march from
state to state asks: where a linear combination of y changes its sign (equations 13 and 14), and where the
trial force of a stuck contact leaves its cone (section 3.1: a quartic in exp(i theta) for the harmonic
motion, a polynomial of degree ten on each piece of the spline).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly, make_interp_spline

from timesim.element.cone_exit import CYCLE, TOUCH, Array, cone_margin, harmonic_exit, piece_exit, shifted, wrap
from timesim.engine.dense_output import control_points

MIN_SAMPLES = 16


class PrescribedMotion(ABC):
    """One cycle of motion of body 1 relative to body 2 in the contact frame, period 2 pi in theta [rad]."""

    @abstractmethod
    def evaluate(self, theta: ArrayLike) -> tuple[Array, Array]:
        """y = (u1, u2, v) [length] and dy/dtheta [length/rad], of shape (3, ...), at angles of shape (...) [rad]."""

    @abstractmethod
    def crossings(self, weights: Array, constant: float, *, rate: bool = False) -> tuple[Array, NDArray[np.bool_]]:
        """Where ``weights . y + constant``, or the same of dy/dtheta, changes its sign.

        Args:
            weights, constant: of u1, u2 and v, shape (3,), and what is added.
            rate: take dy/dtheta in place of y.

        Returns:
            angles in [0, 2 pi), ascending [rad], shape (k,), and whether the value rises there, shape (k,).
        """

    @abstractmethod
    def cone_exit(self, transform: Array, offset: Array, start: float, *, on_cone: bool) -> float:
        """First angle after `start`, within one cycle, where the trial force leaves its cone.

        The cone is ``r1^2 + r2^2 <= r3^2`` of ``r = transform @ y + offset``.

        Args:
            transform, offset: r = (f1, f2, mu n) of a stuck contact, shapes (3, 3) and (3,).
            start: angle at which the contact stuck, where r lies in the cone [rad].
            on_cone: r lies on the cone at `start` and does not leave it to first order, so that `start` is a
                double root: it is divided out.

        Returns:
            angle in [start, start + 2 pi] [rad]; inf where r never leaves the cone; touching is not leaving.
        """

    @property
    def normal_extremes(self) -> Array:
        """Angles at which v may be largest, the start of the cycle among them [rad]."""
        return np.append(self.crossings(np.array([0.0, 0.0, 1.0]), 0.0, rate=True)[0], 0.0)

    @property
    @abstractmethod
    def fundamental(self) -> NDArray[np.complex128]:
        """First harmonic of the tangential motion, u_i = Im(U_i exp(i theta)), U of shape (2,) [length]."""

    @property
    @abstractmethod
    def amplitude(self) -> Array:
        """Amplitude of u1 and u2 at the base frequency, shape (2,) [length]: A and B of the paper, signs included."""

    @property
    @abstractmethod
    def phase(self) -> Array:
        """Phase of u1 and u2, shape (2,) [rad]: (0, phi) of the paper; amplitude * sin(theta + phase)."""

    @property
    @abstractmethod
    def line(self) -> Array | None:
        """Unit vector along a straight tangential motion, shape (2,); None where the motion has an area."""

    @property
    @abstractmethod
    def breaks(self) -> Array:
        """Angles in [0, 2 pi) where a high derivative jumps [rad], ascending."""


@dataclass(frozen=True)
class HarmonicMotion(PrescribedMotion):
    """u = [A sin theta, B sin(theta + phi)], v = D sin(theta + psi): section 3.1 of the paper.

    Attributes:
        A, B, D: amplitudes of u1, u2 and v [length].
        phi, psi: phases of u2 and v [rad].
    """

    A: float
    B: float
    D: float
    phi: float = 0.0
    psi: float = 0.0

    def __post_init__(self) -> None:
        for name in ("A", "B", "D", "phi", "psi"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"motion: {name} must be a finite number, not {getattr(self, name)}")

    @cached_property
    def phasor(self) -> NDArray[np.complex128]:
        """y = Im(phasor exp(i theta)), shape (3,): sine coefficients real, cosine ones imaginary [length]."""
        return np.array([self.A, self.B * np.exp(1j * self.phi), self.D * np.exp(1j * self.psi)])

    def evaluate(self, theta: ArrayLike) -> tuple[Array, Array]:
        turned = np.multiply.outer(self.phasor, np.exp(1j * np.asarray(theta)))
        return turned.imag, turned.real

    def crossings(self, weights: Array, constant: float, *, rate: bool = False) -> tuple[Array, NDArray[np.bool_]]:
        phasor = (1j if rate else 1.0) * np.dot(weights, self.phasor)
        if abs(phasor) <= abs(constant) * (1 + TOUCH):  # no more than rounding beyond it
            return np.zeros(0), np.zeros(0, bool)
        rise = -np.arcsin(constant / abs(phasor))
        angles = wrap(np.array([rise, np.pi - rise]) - np.angle(phasor))
        order = np.argsort(angles)
        return angles[order], np.array([True, False])[order]

    def cone_exit(self, transform: Array, offset: Array, start: float, *, on_cone: bool) -> float:
        # A quartic in exp(i theta), or what a double root leaves of it.
        phasor = (transform @ self.phasor) * np.exp(1j * start)
        return start + harmonic_exit(offset, phasor.imag, phasor.real, on_cone=on_cone)

    @property
    def fundamental(self) -> NDArray[np.complex128]:
        return self.phasor[:2]

    @property
    def amplitude(self) -> Array:
        return np.array([self.A, self.B])

    @property
    def phase(self) -> Array:
        return np.array([0.0, self.phi])

    @property
    def line(self) -> Array | None:
        a, b = self.fundamental
        size = abs(a) ** 2 + abs(b) ** 2
        if abs((np.conj(a) * b).imag) > 4 * np.finfo(float).eps * size:
            return None
        largest = a if abs(a) >= abs(b) else b
        return unit((self.fundamental * np.conj(largest)).real)

    @property
    def breaks(self) -> Array:
        return np.zeros(0)


@dataclass(frozen=True)
class SplineMotion(PrescribedMotion):
    """Periodic quintic spline through samples at theta = 2 pi k / N; smooth to the fourth derivative.

    Attributes:
        samples: (u1, u2, v) at these angles, the end of the cycle left out, shape (N, 3) [length].
    """

    samples: Array

    def __post_init__(self) -> None:
        if self.samples.ndim != 2 or self.samples.shape[1] != 3 or len(self.samples) < MIN_SAMPLES:
            rule = f"samples must be at least {MIN_SAMPLES} rows of (u1, u2, v)"
            raise ValueError(f"motion: {rule}, not an array of shape {self.samples.shape}")
        if not np.isfinite(self.samples).all():
            raise ValueError(f"motion: sample {np.argwhere(~np.isfinite(self.samples))[0, 0]} is not a finite number")

    @cached_property
    def pieces(self) -> PPoly:
        """Polynomials between the samples: shape (6, N, 3), powers of theta - theta_k, highest first."""
        theta = np.linspace(0.0, CYCLE, len(self.samples) + 1)
        closed = np.concatenate([self.samples, self.samples[:1]])
        spline = make_interp_spline(theta, closed, k=5, bc_type="periodic")
        taylor = np.stack([spline(theta[:-1], nu=k) / factorial(k) for k in range(5, -1, -1)])
        return PPoly(taylor, theta, extrapolate="periodic")

    @cached_property
    def _rate(self) -> PPoly:
        return self.pieces.derivative()

    def evaluate(self, theta: ArrayLike) -> tuple[Array, Array]:
        return np.moveaxis(self.pieces(theta), -1, 0), np.moveaxis(self._rate(theta), -1, 0)

    def crossings(self, weights: Array, constant: float, *, rate: bool = False) -> tuple[Array, NDArray[np.bool_]]:
        source = self._rate if rate else self.pieces
        value = PPoly(source.c @ weights, source.x)
        roots = value.solve(-constant, discontinuity=False, extrapolate=False)
        edges = np.unique(np.concatenate([source.x, roots[np.isfinite(roots)]]))
        floor = TOUCH * (np.abs(constant) + np.abs(value.c[-1]).max())
        positive = value((edges[1:] + edges[:-1]) / 2) + constant > floor
        rising = positive & ~np.roll(positive, 1)
        changes = np.flatnonzero(positive != np.roll(positive, 1))
        return wrap(edges[changes]), rising[changes]

    def cone_exit(self, transform: Array, offset: Array, start: float, *, on_cone: bool) -> float:
        # By the roots of the pieces that their Bernstein coefficients do not exclude.
        width = CYCLE / len(self.samples)
        powers = width ** np.arange(6)[:, None, None]
        r = (self.pieces.c[::-1] @ transform.T) * powers
        r[0] += offset
        margin = cone_margin(r)
        floor = TOUCH * np.abs(r).max() ** 2
        first = int(start // width)
        local = start / width - first
        exit_ = piece_exit(cone_margin(shifted(r[:, first], local)), 1 - local, floor, on_cone)
        if np.isfinite(exit_):
            return start + exit_ * width
        for piece in first + 1 + np.flatnonzero(np.roll((control_points(11) @ margin).max(0), -first - 1) > floor):
            end = local if piece == first + len(self.samples) else 1.0
            exit_ = piece_exit(margin[:, piece % len(self.samples)], end, floor, False)
            if np.isfinite(exit_):
                return float((piece + exit_) * width)
        return np.inf

    @cached_property
    def fundamental(self) -> NDArray[np.complex128]:
        theta = np.linspace(0.0, CYCLE, len(self.samples), endpoint=False)
        phasor = 2j / len(self.samples) * np.exp(-1j * theta) @ self.samples[:, :2]
        phasor[np.abs(phasor) <= TOUCH * np.abs(phasor).max()] = 0
        return phasor

    @property
    def amplitude(self) -> Array:
        return np.abs(self.fundamental)

    @property
    def phase(self) -> Array:
        return np.angle(self.fundamental)

    @cached_property
    def line(self) -> Array | None:
        tangential = self.samples[:, :2] - self.samples[:, :2].mean(0)
        _, size, axes = np.linalg.svd(tangential, full_matrices=False)
        return axes[0] if size[1] <= TOUCH * size[0] else None

    @property
    def breaks(self) -> Array:
        return self.pieces.x[:-1]


def unit(vector: Array) -> Array:
    """Unit vector along `vector`; the first axis where that is zero."""
    size = np.hypot(*vector)
    return vector / size if size > 0 else np.array([1.0, 0.0])
