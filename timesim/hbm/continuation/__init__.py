"""Continuation of the solutions of any residual in a parameter: points, steps, folds."""

from timesim.hbm.continuation.bordered import Bordered, Nearby
from timesim.hbm.continuation.other_end import WORK, Elsewhere
from timesim.hbm.continuation.place import solve
from timesim.hbm.continuation.residual import NoSolutionError, Residual
from timesim.hbm.continuation.solutions import Curve, Ending, Solution, crossings, joined, part_of
from timesim.hbm.continuation.tracker import SAME, follow, follow_both_ways
from timesim.hbm.scheme import Controls
