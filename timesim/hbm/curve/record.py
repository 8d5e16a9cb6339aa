"""A response curve: motion, contact states, folds and stability of periodic solutions along it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.continuation import Ending
from timesim.orbit.fourier import Array, phase_deg, to_phasors


@dataclass(frozen=True)
class HbmCurve:
    """Periodic solutions along a curve; S solutions, P points, C contacts, harmonics 0 ... H, harmonic 0 the mean.

    Attributes:
        parameter: that of the continuation, shape (S,): the frequency, or a scalar of the scene.
        frequency: of the excitation, shape (S,) [Hz].
        stable: whether disturbances die out, shape (S,).
        fold: whether the frequency turns here, unless the offset of a contact that sticks turns it, shape (S,).
        branch: folds passed before, shape (S,).
        amplitude: (max - min) / 2 of the continuous motion along x, y, z, shape (S, P, 3) [length].
        harmonic_cos, harmonic_sin: Fourier coefficients, shape (S, H + 1, P, 3) [length].
        slip_share, separation_share: of the period, shape (S, C).
        contact_motion: Fourier coefficients 1, cos, sin, ... of (u1, u2, v), shape (S, C, 3, 2H + 1) [length].
        contact_force: of (f1, f2, n), shape (S, C, 3, 2H + 1) [force].
        floquet_max: largest modulus of a Floquet multiplier, shape (S,); NaN where none was computed.
        floquet_phase_deg: phase of that multiplier, or of its complex conjugate, shape (S,), from 0 to 180 [degree].
        closure: distance of the elastic displacement from one that repeats, relative to its tolerance, shape (S,); at
            most 1 where the hysteresis loop of every contact is closed.
        ending: why it ended.
        message: the same with the place.
    """

    parameter: Array
    frequency: Array
    stable: NDArray[np.bool_]
    fold: NDArray[np.bool_]
    branch: NDArray[np.int64]
    amplitude: Array
    harmonic_cos: Array
    harmonic_sin: Array
    slip_share: Array
    separation_share: Array
    contact_motion: Array
    contact_force: Array
    floquet_max: Array
    floquet_phase_deg: Array
    closure: Array
    ending: Ending
    message: str

    @property
    def complete(self) -> bool:
        """Whether the whole range was followed."""
        return self.ending.complete

    def with_harmonics(self, count: int) -> "HbmCurve":
        """The same with more harmonics, which are zero."""

        def longer(part: Array, axis: int, size: int) -> Array:
            return np.pad(part, [(0, size - part.shape[axis] if i == axis else 0) for i in range(part.ndim)])

        return replace(
            self,
            harmonic_cos=longer(self.harmonic_cos, 1, count + 1),
            harmonic_sin=longer(self.harmonic_sin, 1, count + 1),
            contact_motion=longer(self.contact_motion, 3, 2 * count + 1),
            contact_force=longer(self.contact_force, 3, 2 * count + 1),
        )

    @property
    def harmonic_amplitude(self) -> Array:
        """Amplitude of each harmonic, shape (S, H + 1, P, 3); harmonic 0 is the signed mean [length]."""
        amplitude = np.hypot(self.harmonic_cos, self.harmonic_sin)
        amplitude[:, 0] = self.harmonic_cos[:, 0]
        return amplitude

    @property
    def phase_deg(self) -> Array:
        """Phase of the first harmonic as in a sweep, shape (S, P, 3) [degree]; NaN along axes that rest."""
        return phase_deg(self.harmonic_cos - 1j * self.harmonic_sin)

    @property
    def dissipated_power(self) -> Array:
        """Power lost in each contact, f times the integral of f . u' over a period, shape (S, C) [force length/time].

        Truncation leaves it exact: of the force, only the harmonics that the motion has do work on it.
        """
        u, f = (to_phasors(part[:, :, :2]) for part in (self.contact_motion, self.contact_force))
        work = -np.pi * np.sum(np.arange(u.shape[-1]) * (f.conj() * u).imag, axis=(2, 3))
        return self.frequency[:, None] * np.where(self.slip_share > 0, work, 0.0)


SoFar = Callable[..., HbmCurve]
"""Gives the solutions so far of a curve that grows; or the last ones, if it is told how many."""
Watch = Callable[[float, SoFar], None]
"""Takes in the share of the range that a curve has reached, and what gives its solutions so far."""
