"""Units of the dimensionless form in which a model is simulated.

In it a tolerance means the same in every system of units and at every frequency. Time is the phase of the excitation,
``theta = 2 pi f t``: a cycle has length 2 pi. A modal displacement is in units of ``X / sqrt(m)``, lengths at the
contacts are in units of L, forces there in units of F, with ``F L = X^2 Omega^2``.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from timesim.fault import RuleError
from timesim.model.model import Model

LARGEST = 1e100
"""Largest size of a number in the units of a scene, and its inverse the smallest; their squares are representable."""
LEAST = 1e-3
"""Least scale as a share of the start: a resonance with a damping ratio of 0.05 % moves as much more than its force
would quasi-statically. A start 1e8 times as large as the scale left margins to rounding, and the loop crept."""


@dataclass(frozen=True)
class Scales:
    """Units of the dimensionless form in those of the scene.

    Attributes:
        omega: circular frequency of the excitation; a unit of time is its inverse.
        mode: unit of each modal displacement, shape (M,).
        length: unit of length at the contacts.
        force: unit of force at the contacts.
    """

    omega: float
    mode: np.ndarray
    length: float
    force: float
    energy: float


def modal_size(model: Model, omega: float) -> float:
    """The scene's own scale X of mass-normalised modal displacement: what the forces would move quasi-statically.

    Without forces it is the size of the start: of its motion, else of what its contacts, stuck on a slip, would move.
    Forces that hardly move the structure beside its start give no scale either: a share of the start is the least.
    """
    root, floor = np.sqrt(model.structure.mass), np.maximum(model.structure.omega, omega) ** 2
    driven = np.max(model.excitation.largest / root / floor, initial=0.0)
    start = np.max(np.hypot(model.start.displacement, model.start.velocity / omega) * root, initial=0.0)
    size = float(max(driven, LEAST * start) if driven > 0 else start)
    if size == 0:
        size = float(np.max(np.abs(_pull_of_slip(model)) / root / floor, initial=0.0))
    return size if size > 0 else 1.0


def _pull_of_slip(model: Model) -> np.ndarray:
    """Modal force of the slips of the start at rest, shape (M,)."""
    pull = np.zeros(model.structure.num_modes)
    for c in model.summation_order:
        pull += model.contact_shape[c, :2].T @ (model.contacts[c].tangential_stiffness @ model.start.slip[c])
    return pull


def scales_of(model: Model, frequency: float) -> Scales:
    """Units for a model at a frequency [Hz]."""
    omega = 2 * np.pi * frequency
    size = modal_size(model, omega)
    length = size * _reach(model)
    energy = (size * omega) ** 2
    return Scales(omega, size / np.sqrt(model.structure.mass), length, energy / length, energy)


def _reach(model: Model) -> float:
    """Largest motion at a contact for a unit of a mass-normalised mode; 1 where nothing moves one."""
    return float(np.max(np.abs(model.contact_shape / np.sqrt(model.structure.mass)), initial=0.0)) or 1.0


def out_of_range(model: Model, frequency: float) -> Iterator[RuleError]:
    """Numbers so far apart that squares of them, as in an energy, are zero or overflow.

    Yields what is wrong, keys from the root of the scene; ``frequency`` is the base frequency of the excitation [Hz].
    """
    omega, reach = 2 * np.pi * frequency, _reach(model)
    with np.errstate(all="ignore"):
        size = modal_size(model, omega)
    length, force = size * reach, size * omega * omega / reach
    for what, unit in (("displacements", length), ("velocities", length * omega), ("forces", force)):
        if not 1 / LARGEST <= unit <= LARGEST:
            rule = f"must lead to {what} from {1 / LARGEST:g} to {LARGEST:g}, not of {unit:.3g}"
            cause = "excitation" if np.any(model.excitation.largest) else "initial"
            yield RuleError((cause,), rule, "use other units, or forces of another size")
            return
    for i, contact in enumerate(model.contacts):
        soft, stiff = np.linalg.eigvalsh(contact.tangential_stiffness) * length / force
        normal, preload = contact.normal_stiffness * length / force, abs(contact.preload) / force
        ratios = {"tangential_stiffness": stiff, "normal_stiffness": normal, "preload": preload}
        for key, ratio in ratios.items():
            if ratio > LARGEST or (key == "tangential_stiffness" and stiff > 0 and soft < 1 / LARGEST):
                rule = f"is out of proportion to forces of {force:.3g} and displacements of {length:.3g}"
                yield RuleError(("contacts", i, key), rule, value=np.asarray(getattr(contact, key)).tolist())
