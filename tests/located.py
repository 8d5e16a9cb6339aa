"""Contact forces through one period with every transition located: a reference for `timesim.hbm.period`.

The state-by-state simulation of `timesim.element` along a motion given by its Fourier coefficients.
"""

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from timesim.element.motion import CYCLE, SplineMotion
from timesim.element.state_by_state import steady_cycle
from timesim.model.model import Contact
from timesim.orbit.fourier import fourier_basis, to_coefficients

Array = NDArray[np.float64]
# The spline through the samples errs by less than 1e-11 of the highest harmonic.
SAMPLES_PER_WAVE = 128
GAUSS_NODES, GAUSS_WEIGHTS = legendre.leggauss(16)


def located_forces(contact: Contact, motion: Array) -> Array | None:
    """Fourier coefficients of (f1, f2, n) for those of (u1, u2, v).

    Args:
        contact: the contact.
        motion: coefficients, shape (3, 2H + 1) [length].

    Returns:
        coefficients, shape (3, 2H + 1) [force]; None in full stick, where the mean force is not unique.

    Raises:
        RuntimeError: see `timesim.element.state_by_state.steady_cycle`.
    """
    size = motion.shape[1]
    num_samples = SAMPLES_PER_WAVE * max(1, size // 2)
    theta = np.arange(num_samples) * CYCLE / num_samples
    spline = SplineMotion(fourier_basis(theta, size) @ motion.T)
    cycle = steady_cycle(contact, spline)
    if cycle.offset_free:
        return None
    cosine, sine = cycle.harmonics(size // 2)
    friction = to_coefficients((cosine - 1j * sine).T)
    return np.concatenate([friction, _normal_load(contact, spline, motion[2])[None]])


def _normal_load(contact: Contact, spline: SplineMotion, v: Array) -> Array:
    """Coefficients of max(0, n0 + k_v v), by Gauss rules between its zeros."""
    roots, _ = spline.crossings(np.array([0.0, 0.0, contact.normal_stiffness]), contact.preload)
    edges = np.unique(np.concatenate([roots, np.linspace(0.0, CYCLE, 2 * v.size + 1)]))
    half = np.diff(edges)[:, None] / 2
    theta = (edges[:-1, None] + half * (GAUSS_NODES + 1)).ravel()
    basis = fourier_basis(theta, v.size)
    load = np.maximum(contact.preload + contact.normal_stiffness * (basis @ v), 0.0)
    coefficient = ((half * GAUSS_WEIGHTS).ravel() * load) @ basis / np.pi
    coefficient[0] /= 2
    return np.asarray(coefficient)
