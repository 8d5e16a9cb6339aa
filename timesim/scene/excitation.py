"""Sections of the scene file that describe the forces on the structure."""

from collections.abc import Iterator

import numpy as np

from timesim.fault import RuleError
from timesim.model import model
from timesim.scene.section import Count, Direction, Number, PointName, Positive, Section, unit

STILL = 1e-12  # of the largest entry of all mode shapes


class ModalForce(Section):
    """A harmonic force on one mode: amplitude cos(2 pi f t + phase)."""

    amplitude: Number
    phase_deg: Number = 0.0


class ConstantForce(Section):
    """A constant force on a point, along a direction."""

    point: PointName
    direction: Direction
    """Its length does not count."""
    amplitude: Number

    def work(self, structure: model.Structure) -> np.ndarray:
        """Work of a unit of the force on a unit of each mode, shape (M,)."""
        return unit(self.direction) @ structure.shape[structure.points.index(self.point)]


class Force(ConstantForce):
    """A harmonic force on a point: amplitude cos(harmonic 2 pi f t + phase) along a direction."""

    phase_deg: Number = 0.0
    harmonic: Count = 1
    """Multiple of the base frequency."""


def cos_sin_deg(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle in degrees, exact at multiples of 90."""
    turns, rest = divmod(angle, 90.0)
    c, s = np.cos(np.deg2rad(rest)), np.sin(np.deg2rad(rest))
    return [(c, s), (-s, c), (-c, -s), (s, -c)][int(turns) % 4]


class ExcitationSection(Section):
    """The forces on the structure."""

    frequency: Positive | None = None
    """Base frequency [Hz]."""
    modal_force: tuple[ModalForce, ...] | None = None
    """One a mode, in the scene's order of modes."""
    forces: tuple[Force, ...] = ()
    constant_forces: tuple[ConstantForce, ...] = ()

    def build(self, structure: model.Structure, order: np.ndarray) -> model.Excitation:
        """Modal forces; ``order`` is the scene's index of each mode."""
        terms = [(force.harmonic, force.amplitude * force.work(structure), force.phase_deg) for force in self.forces]
        if self.modal_force is not None:
            if len(self.modal_force) != order.size:
                rule = f"must have {order.size} entries, one a mode, not {len(self.modal_force)}"
                raise RuleError(("modal_force",), rule)
            sorted_forces = [self.modal_force[i] for i in order]
            for column, force in zip(np.eye(order.size), sorted_forces, strict=True):
                terms.append((1, force.amplitude * column, force.phase_deg))
        harmonic = np.array(sorted({1, *(multiple for multiple, _, _ in terms)}))
        cosine, sine = np.zeros((2, harmonic.size, order.size))
        for multiple, pull, phase_deg in terms:
            c, s = cos_sin_deg(phase_deg)
            row = np.searchsorted(harmonic, multiple)
            cosine[row] += c * pull
            sine[row] -= s * pull
        constant = sum(
            (force.amplitude * force.work(structure) for force in self.constant_forces), np.zeros(order.size)
        )
        return model.Excitation(self.frequency, harmonic, cosine, sine, constant)

    def without_effect(self, structure: model.Structure) -> Iterator[str]:
        """Forces along directions in which no mode moves their point, in words."""
        least = STILL * np.abs(structure.shape).max()
        for key in ("forces", "constant_forces"):
            for i, force in enumerate(getattr(self, key)):
                if force.amplitude and np.abs(force.work(structure)).max() <= least:
                    yield f"excitation.{key}.{i} has no effect: no mode moves {force.point} along its direction"
