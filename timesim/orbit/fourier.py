"""Periodic motions by their Fourier coefficients, those of 1, cos, sin, ..., cos H theta, sin H theta.

The phasor of harmonic h is ``a_h - i b_h`` for the coefficients a_h of cos h theta and b_h of sin h theta.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
HARMONICS = 9
"""Harmonics of a steady motion that are kept: as many as harmonic balance takes by default."""
# Of the largest: the first harmonic of what does not move has no phase.
STILL = 1e-9
# Samples of the motion, of the highest harmonic, among which an extreme is searched before Newton's method.
SAMPLES_PER_WAVE = 16
# Complex samples in memory at a time, of all motions together.
MAX_ENTRIES = 2**20


def fourier_basis(theta: Array, num_coefficients: int) -> Array:
    """1, cos, sin, ..., cos H theta, sin H theta, shape (..., 2H + 1)."""
    angle = np.multiply.outer(theta, np.arange(1, num_coefficients // 2 + 1))
    pairs = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(*theta.shape, -1)
    return np.concatenate([np.ones((*theta.shape, 1)), pairs], axis=-1)


def to_phasors(coefficient: Array) -> Complex:
    """Phasors of a motion by its coefficients: the last axis (2H + 1) becomes H + 1."""
    mean = coefficient[..., :1].astype(complex)
    return np.concatenate([mean, coefficient[..., 1::2] - 1j * coefficient[..., 2::2]], axis=-1)


def to_coefficients(phasor: NDArray[Any]) -> Array:
    """The inverse of `to_phasors`."""
    pairs = np.stack([phasor[..., 1:].real, -phasor[..., 1:].imag], axis=-1)
    return np.concatenate([phasor[..., :1].real, pairs.reshape(*phasor.shape[:-1], 2 * pairs.shape[-2])], axis=-1)


def periodic_samples(phasor: Complex, count: int) -> Array:
    """Re sum_h phasor_h exp(i h theta), h along the last axis, at N equal samples, the last at 2 pi: shape (..., N).

    The phasors are of shape (..., H + 1); ``count`` is N, more than 2H.
    """
    spectrum = phasor * (0.5 * count)
    spectrum[..., 0] *= 2
    return np.roll(np.fft.irfft(spectrum, count), -1, axis=-1)


def weighted(weight: NDArray[Any], size: int) -> Array:
    """Fourier coefficients of each harmonic function 1, cos, sin, ... times a weight, shape (size, size).

    A product of two is half of those of the sum and of the difference of their orders. The weight is given at N equal
    samples of a period, the last at 2 pi; each column is of one of the functions, of at most N / 4 harmonics.
    """
    if np.all(weight == weight[0]):
        return weight[0] * np.eye(size)
    spectrum, (total, difference, sign) = np.fft.rfft(np.roll(weight, 1)) / len(weight), _orders(size // 2)
    more, less = spectrum[total], spectrum[difference]
    pairs, turned, whole = np.empty((len(total), 2, len(total), 2)), sign * less.imag, np.empty((size, size))
    pairs[:, 0, :, 0], pairs[:, 0, :, 1] = less.real + more.real, turned - more.imag
    pairs[:, 1, :, 0], pairs[:, 1, :, 1] = -turned - more.imag, less.real - more.real
    whole[0], whole[1:, 1:] = to_coefficients(spectrum[: size // 2 + 1]), pairs.reshape(size - 1, size - 1)
    whole[1:, 0] = 2 * whole[0, 1:]
    return whole


@lru_cache(maxsize=64)
def _orders(harmonics: int) -> tuple[NDArray[np.int64], ...]:
    """Sum and distance of any two of the orders 1 ... H, and which is larger, each of shape (H, H)."""
    order = np.arange(1, harmonics + 1)
    difference = order[:, None] - order
    return order[:, None] + order, np.abs(difference), np.sign(difference)


def phase_deg(phasor: Complex, error: Array | float = 0.0) -> Array:
    """Phase [degree] of the first harmonic in (-180, 180]: x ~ A cos(2 pi f t + phase).

    Args:
        phasor: harmonics, then points and axes along the last three dimensions, shape (..., H + 1, P, 3).
        error: of the motion, relative to the largest, which may be all of a first harmonic, shape (...).

    Returns:
        shape (..., P, 3); NaN where a motion has no period, and along axes that do not move with the excitation.
    """
    first = phasor[..., 1, :, :]
    least = np.fmax(error, STILL) * np.max(np.abs(phasor), axis=(-3, -2, -1), initial=0.0)
    moves = np.abs(first) > least[..., None, None]
    return np.where(moves, np.rad2deg(np.angle(first)), np.nan)


def signed_amplitude(phasor: Complex) -> Array:
    """Amplitude of each harmonic, of harmonic 0 the signed mean; harmonics along the third dimension from the end."""
    amplitude = np.abs(phasor)
    amplitude[..., 0, :, :] = phasor[..., 0, :, :].real
    return amplitude


def fourier_coefficients(samples: Array, phase: float) -> Array:
    """Coefficients of N equal samples of a period, the last at a phase [rad], shape (2K + 1, ...)."""
    count = len(samples)
    spectrum = np.fft.rfft(samples, axis=0)[: (count + 1) // 2] / count
    order = np.arange(len(spectrum)).reshape(-1, *[1] * (samples.ndim - 1))
    # The first sample lies one interval after the phase at which the last one does.
    spectrum = spectrum * np.exp(-1j * order * (phase + 2 * np.pi / count))
    spectrum[1:] *= 2
    return np.moveaxis(to_coefficients(np.moveaxis(spectrum, 0, -1)), -1, 0)


def half_range(phasor: Complex) -> Array:
    """(max - min) / 2 over a period of Re sum_h phasor_h exp(i h theta), h along axis 1: shape (S, H + 1, ...)."""
    count = SAMPLES_PER_WAVE * phasor.shape[1]
    rows = max(1, MAX_ENTRIES // max(1, count * phasor[:1, 0].size))
    parts = [phasor[first : first + rows] for first in range(0, max(len(phasor), 1), rows)]
    return np.concatenate([_half_range(part, count) for part in parts])


def _half_range(phasor: Complex, count: int) -> Array:
    rows = np.moveaxis(phasor, 1, -1)
    values, order = periodic_samples(rows, count), np.arange(phasor.shape[1])
    # A sample misses the crest beside it by no more than this, so that a lower sample may have the higher crest.
    missed = np.abs(rows) @ order**2 * (np.pi / count) ** 2 / 2
    highest, lowest = (sign * _highest(sign * rows, sign * values, missed) for sign in (1, -1))
    return np.asarray((highest - lowest) / 2)


def _highest(phasor: Complex, values: Array, missed: Array) -> Array:
    """Largest value of motions, shape (...), by phasors (..., H + 1), samples (..., N) and what these may miss."""
    count, largest = values.shape[-1], values.max(axis=-1)
    crest = (values >= np.roll(values, 1, axis=-1)) & (values > np.roll(values, -1, axis=-1))
    crest &= values >= (largest - missed)[..., None]
    np.put_along_axis(crest, values.argmax(axis=-1)[..., None], True, axis=-1)
    *motion, place = np.nonzero(crest)
    theta, highest = 2 * np.pi / count * (place + 1), np.full_like(largest, -np.inf)
    np.maximum.at(highest, tuple(motion), _extreme(phasor[tuple(motion)].T, theta, np.pi / count))
    return highest


def _extreme(weights: Complex, theta: Array, reach: float) -> Array:
    """Values where the derivatives vanish near angles, shape (N,), by Newton's method within reach.

    ``weights``: phasors of the motion at each of them, shape (H + 1, N).
    """
    order, middle = np.arange(len(weights))[:, None], theta
    for _ in range(5):
        wave = weights * np.exp(1j * order * theta)
        slope, curvature = (1j * order * wave).real.sum(0), -(order**2 * wave).real.sum(0)
        step = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature != 0)
        theta = np.clip(theta - step, middle - 2 * reach, middle + 2 * reach)
    return np.asarray((weights * np.exp(1j * order * theta)).real.sum(0))
