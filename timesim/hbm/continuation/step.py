"""A step along a curve: its predictor, of second order, and whether it goes round a corner."""

from dataclasses import dataclass

import numpy as np

from timesim.hbm.continuation.bordered import Array
from timesim.hbm.continuation.corrector import STRAIGHT, CurvePoint, meeting

# Length of a step up to which a tangent that turns by much may have met a corner of the curve.
NEAR_CORNER = 0.01


@dataclass(frozen=True)
class Step:
    """A step along the curve: where it leads, its length of arc, the length to try next, and whether round a corner.

    `moved`: by how much other unknowns have moved the parameter where it leads.
    """

    point: CurvePoint
    length: float
    next_length: float
    corner: bool = False
    moved: float = 0.0


def predicted(point: CurvePoint, before: tuple[CurvePoint, float] | None, length: float) -> Array:
    """Along the tangent, and its turn since the point before."""
    if before is None:
        return point.y + length * point.tangent
    last, last_length = before
    return point.y + length * point.tangent + (length**2 / (2 * last_length)) * (point.tangent - last.tangent)


def is_corner(point: CurvePoint, new: CurvePoint) -> bool:
    """Whether the short way between two points is along the tangent of the one, then along that of the other."""
    way = float(np.linalg.norm(new.y - point.y))
    along, gap = meeting(point, new)
    back, _ = meeting(new, point)
    return way <= NEAR_CORNER and along > 0 > back and gap <= STRAIGHT * way
