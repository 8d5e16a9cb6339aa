"""Thresholds of settling and shooting, each with its derivation.

Sizes are relative to the largest entry of the state vectors; a round is a number of cycles marched in one call.
"""

# Marching
CYCLES_A_ROUND = 8
"""Half of it holds a whole motion of the longest period that is recognised; the call itself, some 1 ms of host work,
is a tenth of a round of 16 lanes."""
SIDE_BY_SIDE = 128
"""Searches under way at a time: eight full batches, so that most stay full while some searches come to their end."""
LONELY = 256
"""Cycles after which the last few searches march alone: a batch of four costs up to four times as much, and a scene
that takes that many cycles takes thousands, more than compiling one more program does."""
UNSETTLED_CYCLES = 10
"""Over which the amplitude of a motion that has not settled is taken, as the result file promises."""

# Recognition of the period
PERIODS = (1, 2, 3)
"""In cycles. Of two rounds the changes over the longest must fill one round: 16 - 3 >= 8."""
REST = 1e-13
"""A change this small is rounding: some hundred steps a cycle, each of which rounds to 1e-16."""
LEADS_NOWHERE = 3.0
"""Displacement over two rounds in units of the change of a cycle: an alternation moves the state by twice its change at
most, a drift by fifteen times."""
STILL_THERE = 0.99
"""Share of an alternation that is left after half a round, if it is permanent: a vibration at the frequency of the
excitation with a damping ratio above 4e-4 loses more."""
DOUBLED = 30.0
"""In units of the tolerance: a smaller alternation may be the end of a decaying beat."""

# Shooting
FIRST_SHOT = 2 * CYCLES_A_ROUND
"""Cycles marched before the first attempt: a motion that settles at once has settled by then."""
TAKES_OVER = 0.3
"""Ratio by which an iteration of Newton's method must reduce the change over a period, or it is given up. Near a
periodic motion it converges quadratically; where it reduces the change by less, marching does as well."""
REACH = 0.5
"""Longest step, relative to the state: a longer one leaves the neighbourhood in which the linear map is valid."""
TRIES = 2048
"""Most steps tried in a cycle that is shot: eight calls of the loop that records."""
UNSTABLE = 1 + 1e-6
"""Modulus of a Floquet multiplier above which a motion is unstable; multipliers are exact to 1e-6, as tested."""
