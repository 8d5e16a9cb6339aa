"""Bounds over all time on the motion of a linear structure under constant and periodic forces.

With unit modal masses, ``q'' + D q' + K q = p(t)``, K symmetric and positive definite, D not negative. With
the eigenvectors V of K, ``K V = V W^2`` and ``q = V a``, the state is ``y = (W a, a')``; ``|y|^2`` is twice
the energy, which damping cannot raise (in free vibration).

At one frequency the motion is the rest position under the constant forces, plus one ellipse a harmonic,
plus a free vibration. That starts from ``y(0)`` less the steady motion, at whatever phase; it is bounded
complex mode by complex mode, ``exp(lambda t)`` with Re lambda <= 0, and by its energy. Where the frequency
changes, in any order and after any time, each complex mode is bounded by its start value plus ``sup |force|
/ -Re lambda``, which asks for damping in every mode that is forced.

The bounds add absolute values: they hold, but need not be reached.
"""

from dataclasses import dataclass

import numpy as np

ROUNDING = 1e-5
"""Largest relative error of a bound from rounding, by condition numbers; where it is more, there is none."""
EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Oscillation:
    """A linear structure with unit modal masses under periodic and constant forces.

    Attributes:
        stiffness: K, shape (N, N).
        damping: D, shape (N, N).
        harmonic: multiples of the base frequency, shape (H,).
        wave: complex force amplitudes P, ``p = Re(P exp(i h theta))``, shape (H, N).
        constant: constant forces, shape (N,).
        displacement, velocity: at the start, shape (N,).
    """

    stiffness: np.ndarray
    damping: np.ndarray
    harmonic: np.ndarray
    wave: np.ndarray
    constant: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True)
class Envelope:
    """Bound on a vector z(t) over all time: the largest value that a linear functional l of it can take.

    At no time is ``l . z`` above ``l . constant + sum_j |l . wave_j| + |l . ball|``.

    Attributes:
        constant: shape (3,).
        wave: complex, shape (3, J).
        ball: shape (3, N).
    """

    constant: np.ndarray
    wave: np.ndarray
    ball: np.ndarray

    def highest(self, functional: np.ndarray) -> np.ndarray:
        """Bound on ``l . z`` for each row l of an array, shape (L, 3)."""
        swing = np.abs(functional @ self.wave).sum(axis=1)
        return functional @ self.constant + swing + np.linalg.norm(functional @ self.ball, axis=1)

    def size(self, rows: slice) -> float:
        """Bound on the length of some components of z; `highest` changes no faster than that with l."""
        waves = np.linalg.norm(self.wave[rows], axis=0).sum()
        return float(np.linalg.norm(self.constant[rows]) + waves + np.linalg.norm(self.ball[rows]))


def envelopes(
    oscillation: Oscillation, output: np.ndarray, offset: np.ndarray, omega: float | None
) -> list[list[Envelope]]:
    """Bounds on ``z = output . q + offset``, several for each z: all hold, either may be the closer one.

    ``output`` is of shape (C, 3, N), ``offset`` (C, 3); ``omega`` is the circular frequency of the forces, None where
    it changes or is not known.

    Returns:
        For each of the C outputs its bounds. Empty lists where K or D allow none, at the resonance of an
        undamped mode, or where rounding would spoil it.
    """
    frame = _frame(oscillation)
    if frame is None:
        return [[] for _ in offset]
    swings = _swings(frame, oscillation, omega)
    output = output @ (frame.vectors / frame.frequency)
    return [
        [Envelope(zero + out @ frame.still, out @ wave, out @ ball) for wave, ball in swings]
        for out, zero in zip(output, offset, strict=True)
    ]


@dataclass(frozen=True)
class _Frame:
    """The structure in the eigenvectors of K.

    Attributes:
        frequency: W, shape (N,).
        damping: V^T D V, shape (N, N).
        vectors: V, shape (N, N).
        still: W a under the constant forces, shape (N,).
        rounding: relative error of W^2.
    """

    frequency: np.ndarray
    damping: np.ndarray
    vectors: np.ndarray
    still: np.ndarray
    rounding: float


def _frame(oscillation: Oscillation) -> _Frame | None:
    """None where K is not positive definite, D feeds energy in, or rounding spoils the lowest frequency."""
    value, vectors = np.linalg.eigh(0.5 * (oscillation.stiffness + oscillation.stiffness.T))
    lowest = float(value.min(initial=np.inf))
    damping = vectors.T @ oscillation.damping @ vectors
    decay = np.linalg.eigvalsh(0.5 * (damping + damping.T))
    feeds = bool(np.any(decay < -1e-12 * np.abs(decay).max(initial=0.0)))
    rounding = EPSILON * float(value.max(initial=0.0)) / lowest if lowest > 0 else np.inf
    if feeds or rounding > ROUNDING:
        return None
    frequency = np.sqrt(value)
    return _Frame(frequency, damping, vectors, vectors.T @ oscillation.constant / frequency, rounding)


Swing = tuple[np.ndarray, np.ndarray]
"""Bound on W a about its constant part: `wave` and `ball` of an `Envelope`, shapes (N, J) and (N, K)."""


def _swings(frame: _Frame, oscillation: Oscillation, omega: float | None) -> list[Swing]:
    displacement = frame.frequency * (frame.vectors.T @ oscillation.displacement) - frame.still
    start = np.concatenate([displacement, frame.vectors.T @ oscillation.velocity])
    force = oscillation.wave @ frame.vectors
    modes = _complex_modes(frame)
    if omega is None:
        return _any_schedule(modes, start, force) if modes else []
    return _one_frequency(frame, modes, start, _steady(frame, force, oscillation.harmonic * omega))


@dataclass(frozen=True)
class _ComplexModes:
    """Free vibration ``y = sum_k shape_k c_k exp(rate_k t)``, ``c = inverse . y(0)``."""

    rate: np.ndarray
    shape: np.ndarray
    inverse: np.ndarray
    condition: float


def _complex_modes(frame: _Frame) -> _ComplexModes | None:
    """None where the shapes hardly span the space: at critical damping."""
    if not frame.frequency.size:
        empty = np.zeros((0, 0))
        return _ComplexModes(np.zeros(0), empty, empty, 1.0)
    W = np.diag(frame.frequency)
    rate, shape = np.linalg.eig(np.block([[np.zeros_like(W), W], [-W, -frame.damping]]))
    condition = float(np.linalg.cond(shape))
    if not 100 * condition * EPSILON <= ROUNDING:
        return None
    return _ComplexModes(rate, shape, np.linalg.inv(shape), condition)


def _one_frequency(
    frame: _Frame, modes: _ComplexModes | None, start: np.ndarray, steady: np.ndarray | None
) -> list[Swing]:
    if steady is None:
        return []
    size = frame.frequency.size
    waves = steady[:size]
    # The longest half axis of each ellipse.
    swing = np.sqrt(0.5 * ((np.abs(steady) ** 2).sum(axis=0) + np.abs((steady**2).sum(axis=0)))).sum()
    bounds = [(waves, np.eye(size) * (np.linalg.norm(start) + swing))]
    if modes:
        free = np.abs(modes.inverse @ start) + _at_any_phase(modes.inverse, steady)
        bounds.append((np.hstack([waves, modes.shape[:size] * free]), np.zeros((size, 0))))
    return bounds


def _at_any_phase(inverse: np.ndarray, wave: np.ndarray) -> np.ndarray:
    """Bound on ``|inverse . Re(wave exp(i theta))|`` over theta, summed over the columns of the waves."""
    return 0.5 * (np.abs(inverse @ wave) + np.abs(inverse @ wave.conj())).sum(axis=1)


def _any_schedule(modes: _ComplexModes, start: np.ndarray, force: np.ndarray) -> list[Swing]:
    push = _at_any_phase(modes.inverse, np.concatenate([np.zeros_like(force.T), force.T]))
    # A decay of the size of its rounding error is none.
    decay = -modes.rate.real - 1e-13 * modes.condition * np.abs(modes.rate).max(initial=0.0)
    forced = push > 0
    if np.any(decay[forced] <= 0):
        return []
    free = np.abs(modes.inverse @ start) + np.divide(push, decay, out=np.zeros_like(push), where=forced)
    size = force.shape[1]
    return [(modes.shape[:size] * free, np.zeros((size, 0)))]


def _steady(frame: _Frame, force: np.ndarray, omega: np.ndarray) -> np.ndarray | None:
    """Amplitudes of y at each circular frequency, shape (2N, H); None at an undamped resonance."""
    size = frame.frequency.size
    amplitude = np.zeros((2 * size, omega.size), dtype=complex)
    for row in np.flatnonzero(np.any(force != 0, axis=1)):
        scale = np.maximum(frame.frequency, omega[row])
        matrix = np.diag(frame.frequency**2 - omega[row] ** 2) + 1j * omega[row] * frame.damping
        matrix = matrix / np.outer(scale, scale)
        if max(frame.rounding, 10 * EPSILON) > ROUNDING * np.linalg.svd(matrix, compute_uv=False).min():
            return None
        a = np.linalg.solve(matrix, force[row] / scale) / scale
        amplitude[:, row] = np.concatenate([frame.frequency * a, 1j * omega[row] * a])
    return amplitude
