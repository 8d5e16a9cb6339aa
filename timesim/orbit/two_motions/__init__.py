"""Ranges of frequency with two steady motions, where sweeps lose their motion, and which starts lead where."""

from timesim.orbit.two_motions.loss import DOWN, UP, RangeSearch, Sweeps, losses, suspect_steps
from timesim.orbit.two_motions.ranges import LARGER, NO_MOTION, SMALLER, ranges, ranges_of
