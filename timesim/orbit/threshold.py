"""Thresholds of settling and shooting, each with what it follows from.

Sizes are relative to the largest entry of the state vectors; a round is a number of cycles marched in one call.
"""

# Marching
CYCLES_A_ROUND = 8
"""Half of it holds a whole motion of the longest period that is recognised; the call itself, some 1 ms of host work,
is a tenth of a round of 16 lanes."""
SIDE_BY_SIDE = 128
"""Searches that share batches: eight full ones, so that most stay full while some of the searches come to their end."""
LONELY = 256
"""Cycles after which few searches left march alone: a batch of four costs up to four times as much, and a scene that
takes that many cycles takes thousands, more than another program takes to compile."""
UNSETTLED_CYCLES = 10
"""Over which the amplitude of a motion that has not settled is taken, as the result file promises."""

# Recognition of the period
PERIODS = (1, 2, 3)
"""In cycles. Of two rounds the changes over the longest must fill one round: 16 - 3 >= 8."""
REST = 1e-13
"""A change this small is rounding: some hundred steps a cycle, each of which rounds to 1e-16."""
LEADS_NOWHERE = 3.0
"""Times the change of a cycle, over two rounds: what goes to and fro leads to twice its change at most, a drift to
fifteen times."""
STILL_THERE = 0.99
"""What is left of an alternation after half a round, if it stays: a vibration with a damping ratio above 4e-4 of the
excitation's frequency loses more."""
DOUBLED = 30.0
"""Times the tolerance: a smaller alternation may be that of a vibration near its end, held up by the beat of two."""

# Shooting
FIRST_SHOT = 2 * CYCLES_A_ROUND
"""Cycles marched before the first attempt: what settles at once has by then, and its period is recognised."""
TAKES_OVER = 0.3
"""Share to which an iteration of Newton's method must shrink the change over a period, or it gives up. Near a motion
that repeats it converges quadratically; what it shrinks less than that, marching shrinks as well."""
REACH = 0.5
"""Of the state: a longer step leaves the neighbourhood in which the linear map holds, and leads elsewhere."""
TRIES = 2048
"""Steps tried in a cycle that is shot, eight times those of a call that records: more, and it has gone astray."""
UNSTABLE = 1 + 1e-6
"""Modulus of a Floquet multiplier above which a motion is unstable; multipliers are exact to 1e-6, as tested."""
