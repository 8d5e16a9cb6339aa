"""A step along a curve, and its predictor, of second order."""

from dataclasses import dataclass

from timesim.hbm.continuation.bordered import Array
from timesim.hbm.continuation.corrector import CurvePoint


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
