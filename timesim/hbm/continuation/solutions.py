"""Solutions of a residual in the order of a curve, and why the curve ends."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.continuation.bordered import Array


class Ending(Enum):
    """Why a curve ends; the value is the message for the user."""

    COMPLETE = "complete: the whole range was followed"
    CLOSED = "complete: the curve is closed, it comes back to where it began"
    START = "no solution at the start"
    STEP = (
        "Newton's method fails even at the smallest step; a smaller continuation.min_step may help, unless what "
        "friction alone holds moves on from cycle to cycle, which a sweep tells"
    )
    POINTS = "the largest number of points is reached; raise continuation.max_points or max_step"
    RETURNED = "complete: the curve turned back to where it began; the one from the other end of the range is another"
    BACKWARDS = "complete: the whole range was followed, from its other end"
    AGAIN = (
        "the curve goes round a closed branch, onto which a step has led it; a smaller continuation.max_step may keep "
        "it on its own"
    )
    LEFT = "the curve turned back and left the range where it began; begin at the other end of the range"
    UNBOUNDED = (
        "the motion grows without bound, as in a resonance without damping; leave that frequency out, or add damping"
    )
    INTERRUPTED = "interrupted"

    @property
    def complete(self) -> bool:
        """Whether the whole range was followed, or the whole of a curve in it."""
        return self in (Ending.COMPLETE, Ending.CLOSED, Ending.RETURNED, Ending.BACKWARDS)


Solution = tuple[Array, float, bool, int]
"""Unknowns, parameter, whether it is a fold, and the sign of det dr/dx."""


@dataclass(frozen=True)
class Curve:
    """Solutions in the order of the curve.

    Attributes:
        x: unknowns, shape (S, n).
        p: parameter, shape (S,).
        fold: whether the parameter turns here, shape (S,).
        determinant: sign of det dr/dx, 0 at a fold, shape (S,).
        backwards: whether it was followed from the other end of the range, shape (S,).
        ending: why it ends.
        message: the same with the place.
    """

    x: Array
    p: Array
    fold: NDArray[np.bool_]
    determinant: NDArray[np.int64]
    backwards: NDArray[np.bool_]
    ending: Ending
    message: str

    @classmethod
    def of(
        cls, solutions: Sequence[Solution], num_unknowns: int, ending: Ending, message: str, backwards: int = 0
    ) -> "Curve":
        """From its solutions, of which so many at the end were followed backwards."""
        number = len(solutions)
        x, p, fold, determinant = zip(*solutions, strict=True) if solutions else ((),) * 4
        unknowns, flags = np.array(x).reshape(number, num_unknowns), np.array(fold, dtype=bool)
        signs, behind = np.array(determinant, dtype=np.int64), np.arange(number) >= number - backwards
        return cls(unknowns, np.array(p, dtype=float), flags, signs, behind, ending, message)

    @property
    def branch(self) -> NDArray[np.int64]:
        """Folds passed before, shape (S,); a fold belongs to the branch that it ends."""
        return np.cumsum(self.fold) - self.fold

    @property
    def complete(self) -> bool:
        """Whether the whole range was followed."""
        return self.ending.complete


Solutions = TypeVar("Solutions", bound=Any)
"""A record whose arrays have one entry for each solution along the first axis, as `Curve`."""


def part_of(curve: Solutions, rows: slice | NDArray[np.intp]) -> Solutions:
    """Some of the solutions."""
    return replace(curve, **{name: array[rows] for name, array in _arrays(curve).items()})


def joined(parts: Sequence[Solutions]) -> Solutions:
    """The solutions of several records, one after the other; they end as the last one does."""
    arrays = [_arrays(part) for part in parts]
    return replace(parts[-1], **{name: np.concatenate([own[name] for own in arrays]) for name in arrays[-1]})


def _arrays(curve: Any) -> dict[str, Any]:
    return {name: value for name, value in vars(curve).items() if isinstance(value, np.ndarray)}


def crossings(parameter: Array, place: float) -> Iterator[tuple[int, float]]:
    """Where a curve passes a value of its parameter: the point before, and the share of the way to the next one."""
    # An end of the range is met but for rounding.
    side = np.where(np.isclose(parameter, place, rtol=1e-12, atol=0.0), 0.0, np.sign(parameter - place))
    last = np.arange(1, side.size) == side.size - 1
    for i in np.flatnonzero((side[1:] * side[:-1] < 0) | (side[:-1] == 0) | last & (side[1:] == 0)):
        way = parameter[i + 1] - parameter[i]  # none where a resonance without damping leads straight up
        yield int(i), (place - parameter[i]) / way if way else 0.0
