"""Departure from a motion that is unstable, and the disturbance that brings it about where rounding alone would not.

Beside the place where a motion loses its stability a disturbance grows by a thousandth in a cycle or less, and bodies
that are equal, and begin alike, move alike until rounding parts them. What would not have left within its budget is
moved: as far as it takes to leave soon, but no farther, for a stable motion may lie beside the unstable one; and
farther if it has not left then.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from timesim.orbit.lane import Lane, Recorded, largest
from timesim.orbit.threshold import DISTURBANCE, FARTHER, FARTHEST, GONE, SOON, UNSTABLE, VAGUE

SIDED = 1e-9  # least distance from a motion, relative, that tells on which side of it a trajectory is: beyond rounding
LARGE = 0.3  # entry of a unit vector; the first such tells its sign


@dataclass(frozen=True)
class Departure:
    """How a trajectory leaves a motion.

    Attributes:
        recorded: a period of the motion, which is unstable.
    """

    recorded: Recorded
    lane: Lane

    @property
    def growth(self) -> float:
        """By which a disturbance grows over the period."""
        return float(np.abs(self._own[0]).max())

    @cached_property
    def off(self) -> float:
        """How far the trajectory is along disturbances that grow, relative; infinite where that cannot be told."""
        end = self.recorded.end
        if not np.array_equal(end.apart, self.lane.apart) or largest(self._offset) > GONE * end.size:
            return np.inf
        return self._growing(self._own[1] * self._parts) / end.size

    def ends_within(self, cycles: float) -> bool:
        """Whether the trajectory has left, or will have left after so many cycles."""
        periods = cycles / self.recorded.cycles
        return bool(np.log(max(self.off, 1e-300) / GONE) + periods * np.log(self.growth) > 0)

    def disturbed(self) -> Iterator[Lane]:
        """The motion, moved off along all disturbances by their growth.

        That which grows most alone would leave unstable motions of other bodies, and symmetries, as they are. It is
        moved to the side of the trajectory, for on the other may lie another motion; where that tells none, so that an
        early entry grows. A trajectory that has hardly left may go either way if contacts do not allow the one.
        """
        values, vectors = self._own
        end, sided = self.recorded.end, SIDED < self.off < np.inf
        parts = self._parts if sided else vectors[np.argmax(np.abs(vectors) > LARGE, axis=0), range(len(values))].conj()
        sides = np.where(np.abs(parts) > SIDED * end.size, parts, 1.0)
        ways = vectors * (np.abs(values) * sides / np.abs(sides))
        share = max(DISTURBANCE, FARTHEST * self.growth**-SOON, FARTHER * self.off if sided else 0.0)
        way = share * end.size / self._growing(ways) * (self.recorded.disturbances @ ways.sum(axis=1).real)
        for side in (1, -1)[: 1 if VAGUE < self.off < np.inf else 2]:
            moved = end.moved(end.vector + side * way)
            if moved is not None:
                yield moved

    def _growing(self, ways: np.ndarray) -> float:
        """Size of what grows of disturbances, given as columns."""
        return largest(ways[:, np.abs(self._own[0]) > UNSTABLE].sum(axis=1))

    @cached_property
    def _own(self) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers, and their disturbances as columns."""
        values, vectors = np.linalg.eig(self.recorded.slope_of_disturbances)
        return values, vectors

    @cached_property
    def _offset(self) -> np.ndarray:
        recorded = self.recorded
        motion = recorded.start.vector + recorded.newton_step(recorded.change)
        return recorded.disturbances.T @ (self.lane.vector - motion)

    @cached_property
    def _parts(self) -> np.ndarray:
        """How much of each disturbance leads from the motion to the trajectory."""
        return np.linalg.lstsq(self._own[1], self._offset.astype(complex))[0]
