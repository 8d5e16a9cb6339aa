"""Units of the dimensionless form in which a model is simulated.

In it a tolerance means the same in every system of units and at every frequency. Time is the phase of the excitation,
``theta = 2 pi f t``: a cycle has length 2 pi. A modal displacement is in units of ``X / sqrt(m)``, lengths at the
contacts are in units of L, forces there in units of F, with ``F L = X^2 Omega^2``.
"""

from dataclasses import dataclass

import numpy as np

from timesim.model.model import Model


@dataclass(frozen=True)
class Scales:
    """Units of the dimensionless form in those of the scene.

    Attributes:
        omega: circular frequency of the excitation; a unit of time is its inverse.
        mode: unit of each modal displacement, shape (M,).
        length: unit of length at the contacts.
        force: unit of force at the contacts.
        energy: unit of energy.
    """

    omega: float
    mode: np.ndarray
    length: float
    force: float
    energy: float


def modal_size(model: Model, omega: float) -> float:
    """The scene's own scale X of mass-normalised modal displacement: what the forces would move quasi-statically.

    Without forces it is the size of the start.
    """
    root = np.sqrt(model.structure.mass)
    drive = np.abs(model.excitation.constant) + np.hypot(model.excitation.cosine, model.excitation.sine).sum(axis=0)
    size = np.max(drive / root / np.maximum(model.structure.omega, omega) ** 2, initial=0.0)
    if size == 0:
        size = np.max(np.hypot(model.start.displacement, model.start.velocity / omega) * root, initial=0.0)
    return float(size) if size > 0 else 1.0


def scales_of(model: Model, frequency: float) -> Scales:
    """Units for a model at a frequency [Hz]."""
    omega = 2 * np.pi * frequency
    size = modal_size(model, omega)
    root = np.sqrt(model.structure.mass)
    reach = float(np.max(np.abs(model.contact_shape / root), initial=0.0)) or 1.0
    length = size * reach
    energy = (size * omega) ** 2
    return Scales(omega, size / root, length, energy / length, energy)
