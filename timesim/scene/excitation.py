"""Sections of the scene file that describe the forces on the structure."""

from collections.abc import Sequence

import numpy as np

from timesim.fault import RuleError, nearest
from timesim.model import model
from timesim.scene.section import Count, Direction, Number, Positive, Section, Text, unit

STILL = 1e-12  # of the largest entry of all mode shapes


class ModalForce(Section):
    """A harmonic force on one mode: amplitude cos(2 pi f t + phase)."""

    amplitude: Number
    phase_deg: Number = 0.0


class Force(Section):
    """A harmonic force on a point: amplitude cos(harmonic 2 pi f t + phase) along a direction."""

    point: Text
    direction: Direction
    """Its length does not count."""
    amplitude: Number
    phase_deg: Number = 0.0
    harmonic: Count = 1
    """Multiple of the base frequency."""


class ConstantForce(Section):
    """A constant force on a point, along a direction."""

    point: Text
    direction: Direction
    """Its length does not count."""
    amplitude: Number


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

    def check_points(self, points: Sequence[str]) -> list[RuleError]:
        """Forces on points that there are not."""
        keys = ("forces", "constant_forces")
        forces = [((key, i, "point"), force.point) for key in keys for i, force in enumerate(getattr(self, key))]
        hint = "must be a point of the structure"
        return [RuleError(key, hint, nearest(name, points), name) for key, name in forces if name not in points]

    def build(self, structure: model.Structure, order: np.ndarray) -> model.Excitation:
        """Modal forces; ``order`` is the scene's index of each mode."""
        terms = [(force.harmonic, self._pull(force, structure), force.phase_deg) for force in self.forces]
        for column, entry in zip(np.eye(order.size), self._modal_forces(order), strict=True):
            terms.append((1, entry.amplitude * column, entry.phase_deg))
        harmonic = np.array(sorted({term[0] for term in terms}) or [1])
        cosine, sine = np.zeros((2, harmonic.size, order.size))
        for multiple, pull, phase_deg in terms:
            c, s = cos_sin_deg(phase_deg)
            row = np.searchsorted(harmonic, multiple)
            cosine[row] += c * pull
            sine[row] -= s * pull
        constant = sum((self._pull(force, structure) for force in self.constant_forces), np.zeros(order.size))
        return model.Excitation(self.frequency, harmonic, cosine, sine, constant)

    def without_effect(self, structure: model.Structure) -> list[RuleError]:
        """Forces along directions in which no mode moves their point."""
        return [
            RuleError((key, i), f"has no effect: no mode moves {force.point} along its direction")
            for key in ("forces", "constant_forces")
            for i, force in enumerate(getattr(self, key))
            if force.amplitude and not np.any(self._moves(force, structure))
        ]

    @staticmethod
    def _moves(force: Force | ConstantForce, structure: model.Structure) -> np.ndarray:
        """In which modes a force does work."""
        shape = structure.shape[structure.points.index(force.point)]
        return np.abs(unit(force.direction) @ shape) > STILL * np.abs(structure.shape).max()

    def _modal_forces(self, order: np.ndarray) -> list[ModalForce]:
        if self.modal_force is None:
            return [ModalForce(amplitude=0.0)] * order.size
        if len(self.modal_force) != order.size:
            rule = f"must have {order.size} entries, one a mode, not {len(self.modal_force)}"
            raise RuleError(("modal_force",), rule)
        return [self.modal_force[i] for i in order]

    @staticmethod
    def _pull(force: Force | ConstantForce, structure: model.Structure) -> np.ndarray:
        row = structure.points.index(force.point)
        return force.amplitude * (unit(force.direction) @ structure.shape[row])
