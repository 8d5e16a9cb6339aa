"""Derivatives of the contact forces of a period: of the law over each interval, and chained through the period."""

from timesim.hbm.tangent.chain import compile_offsets, linearised
from timesim.hbm.tangent.slope import Slope, by_parts, compile_slopes, interval_slopes, intervals_of
