"""Response curves by harmonic balance: how they are followed, what is known of each solution, and how it is found."""

from timesim.hbm.curve.evaluation import Piece, Pieces, Signed, Work, by_schemes, each_here, evaluated
from timesim.hbm.curve.following import finished, hbm_curve, left_part, part_of_curve, schemes_of, watched
from timesim.hbm.curve.record import HbmCurve, SoFar, Watch
