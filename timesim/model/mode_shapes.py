"""Modal coordinates of a motion in the modes of another structure, by what they move its points.

``x = S q``, ``S`` the shapes of the modes at the points. Modes that are the same but for their order, their signs and
their scale, exchange coordinates one by one. Otherwise ``q = S^+ S_0 q_0``, where the points determine the coordinates
and the modes allow the whole motion, as where all coordinates of the structure are those of points.
"""

from dataclasses import dataclass

import numpy as np

from timesim.fault import RuleError
from timesim.model.model import Structure

SAME = 1e-6
"""Difference of shapes, relative to the largest entry of a mode, that leaves a state as it is: its own tolerance."""
DETERMINED = 1e-3
"""Least singular value of the shapes, relative to the largest, above which the points determine the coordinates. That
of all coordinates is the root of a ratio of masses; below it a small change of the shapes would be a large motion."""


@dataclass(frozen=True)
class ModeShapes:
    """Shapes of modes at points.

    Attributes:
        shape: displacement of each point along x, y, z for a unit of each mode, shape (P, 3, M).
    """

    points: tuple[str, ...]
    shape: np.ndarray

    def change(self, structure: Structure) -> np.ndarray | None:
        """Coordinates in the modes of a structure for a unit of each coordinate here, shape (M, M); None if the same.

        Raises:
            RuleError: there is no point of both, or the motion of the points is none of these modes.
        """
        common = [name for name in self.points if name in structure.points]
        if not common:
            hint = f"its points are {_listed(self.points)}, those of the scene {_listed(structure.points)}"
            raise RuleError((), "names no point of the scene, by which its modes could be known", hint)
        before, now = _rows(self.points, self.shape, common), _rows(structure.points, structure.shape, common)
        size = np.maximum(np.abs(before), np.abs(now)).max(axis=0)
        apart = np.abs(now - before) / np.where(size > 0, size, 1.0)
        if apart.max() <= SAME:
            return None
        for found in (_exchanged(before, now), _projected(before, now)):
            if found is not None:
                return found
        row, mode = np.unravel_index(np.argmax(apart), apart.shape)
        where = f"{common[row // 3]} along {'xyz'[row % 3]}"
        values = f"mode {mode + 1} moves {where} by {before[row, mode]:.6g} there, by {now[row, mode]:.6g} in the scene"
        rule = f"has other modes, in which its points do not determine the motion: {values}"
        raise RuleError((), rule, "take the structure of that result, or start from rest or from a result of this one")


def _listed(points: tuple[str, ...]) -> str:
    return ", ".join(points) or "none"


def _rows(points: tuple[str, ...], shape: np.ndarray, names: list[str]) -> np.ndarray:
    """Shapes at the points of these names, shape (3P, M)."""
    return shape[[points.index(name) for name in names]].reshape(3 * len(names), -1)


def _exchanged(before: np.ndarray, now: np.ndarray) -> np.ndarray | None:
    """The change where each mode is a multiple of one before; None if not, or if two are multiples of each other."""
    sizes = [np.linalg.norm(shape, axis=0) for shape in (before, now)]
    if min(size.min() for size in sizes) == 0:
        return None
    old, new = (shape / size for shape, size in zip((before, now), sizes, strict=True))
    sign = np.where(new.T @ old < 0, -1.0, 1.0)
    same = np.abs(new[:, :, None] - sign * old[:, None, :]).max(axis=0) <= SAME
    if not (np.all(same.sum(axis=0) == 1) and np.all(same.sum(axis=1) == 1)):
        return None
    return same * sign * sizes[0] / sizes[1][:, None]


def _projected(before: np.ndarray, now: np.ndarray) -> np.ndarray | None:
    """The change by least squares; None where the shapes do not determine it, or leave a part of the motion."""
    size = np.linalg.norm(now, axis=0)
    if size.min() == 0 or min(now.shape) < now.shape[1]:
        return None
    singular = np.linalg.svd(now / size, compute_uv=False)
    if singular[-1] < DETERMINED * singular[0]:
        return None
    change = np.linalg.lstsq(now / size, before, rcond=None)[0] / size[:, None]
    left = np.abs(now @ change - before).max(axis=0)
    return change if np.all(left <= SAME * np.abs(before).max(axis=0)) else None
