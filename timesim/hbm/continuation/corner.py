"""Corners of a curve, where contacts begin or cease to slip or to touch, and the steps around them.

A corner may turn the curve by more than a right angle. Then no solution lies ahead, and the corner is an extreme of
something, often of the parameter.
"""

from contextlib import suppress

import numpy as np

from timesim.hbm.continuation.bordered import Array
from timesim.hbm.continuation.corrector import Controls, Corrector, CurvePoint
from timesim.hbm.continuation.residual import NoSolutionError
from timesim.hbm.continuation.step import Step

# Distance by which the tangents of two points miss each other, as a share of the way, up to which a corner is between.
STRAIGHT = 0.1
# Length of a step up to which one that fails, or a tangent that turns by much, may have met a corner of the curve.
NEAR_CORNER = 0.01
# Cosine of the turn at a corner beyond which the curve goes to it, how close, and the share of the way at a time.
SHARP, AT_CORNER, APPROACH = 0.5**0.5, 1e-6, 0.95
# Length of a step up to which a sharp corner is crossed that cannot be approached: it is not located any closer.
CROSSED = 1e-4


def around_corner(
    corrector: Corrector, controls: Controls, point: CurvePoint, length: float, new: CurvePoint | None = None
) -> Step | None:
    """A step behind a corner of the curve, or to a sharp one; None where there is none.

    ``new``: a solution ahead, if one was found.
    """
    if length > NEAR_CORNER:
        return None
    with suppress(NoSolutionError):
        if new is None:
            along, tangent = _corner_ahead(corrector, point, length)
            if point.tangent @ tangent > SHARP:
                new = _behind(corrector, point, (along, tangent), length)
        if new is not None:
            if not _is_corner(point, new):
                return None
            if point.tangent @ new.tangent > SHARP:
                return _over(point, new, length)
            along, tangent = _meeting(point, new)[0], new.tangent
        with suppress(NoSolutionError):
            if (step := _at_corner(corrector, controls, point, along, tangent)) is not None:
                return step
        if length > CROSSED:
            return None
        # As where the slip of a contact ends, which falls with the root of the way.
        new = _behind(corrector, point, (along, tangent), length) if new is None else new
        return _over(point, new, controls.first_step / 10) if _is_corner(point, new) else None
    return None


def _meeting(point: CurvePoint, other: CurvePoint) -> tuple[float, float]:
    """How far along the tangent of a point that of another one comes closest to it, and their distance there."""
    way, lines = other.y - point.y, np.column_stack([point.tangent, other.tangent])
    share = np.linalg.lstsq(lines, way, rcond=None)[0]
    return float(share[0]), float(np.linalg.norm(way - lines @ share))


def _corner_ahead(corrector: Corrector, point: CurvePoint, length: float) -> tuple[float, Array]:
    """How far ahead of a point a corner of the curve lies, up to a length, and the tangent behind it.

    Derivatives from behind the corner give the line on which the curve goes on; it meets the tangent at the corner.

    Raises:
        NoSolutionError: there is none.
    """
    behind = corrector.linear_ahead(point, length)
    along, gap = _meeting(point, behind)
    if not (0 <= along <= 2 * length and gap <= STRAIGHT * length):
        raise NoSolutionError
    return along, behind.tangent


def _is_corner(point: CurvePoint, new: CurvePoint) -> bool:
    """Whether the short way between two points of a curve is along the tangent of the one, then of the other."""
    way = float(np.linalg.norm(new.y - point.y))
    along, gap = _meeting(point, new)
    back, _ = _meeting(new, point)
    same = new.orientation * point.orientation >= 0
    return same and way <= NEAR_CORNER and along > 0 > back and gap <= STRAIGHT * way


def _behind(corrector: Corrector, point: CurvePoint, corner: tuple[float, Array], length: float) -> CurvePoint:
    """A solution behind a corner, given by how far ahead it lies and by the tangent there."""
    along, tangent = corner
    return corrector.simplified_newton(point.y + along * point.tangent + length * tangent, tangent)


def _over(point: CurvePoint, new: CurvePoint, next_length: float) -> Step:
    return Step(new, float(np.linalg.norm(new.y - point.y)), next_length, corner=True)


def _at_corner(
    corrector: Corrector, controls: Controls, point: CurvePoint, along: float, tangent: Array
) -> Step | None:
    """Next to a sharp corner ahead, or right behind it, where the curve has another tangent.

    Raises:
        NoSolutionError: Newton's method fails.
    """
    if along > AT_CORNER:
        way = APPROACH * along
        near = corrector.simplified_newton(point.y + way * point.tangent, point.tangent)
        same = near.orientation * point.orientation >= 0
        return Step(near, way, along / 4) if same and point.tangent @ near.tangent > SHARP else None
    new = _behind(corrector, point, (along, tangent), AT_CORNER)
    return _over(point, new, controls.first_step / 10) if new.orientation * point.orientation >= 0 else None
