"""Thresholds of settling and shooting, each with its derivation.

Sizes are relative to the largest entry of the state vectors; a round is a number of cycles marched in one call.
"""

# Marching
CYCLES_A_ROUND = 8
"""Half of it holds a whole motion of the longest period that is recognised; the call itself takes some 0.5 ms of host
work."""
UNDER_WAY = 128
"""Searches under way at a time: enough for all threads while some come to their end."""
UNSETTLED_CYCLES = 10
"""Over which the amplitude of a motion that has not settled is taken, as the result file promises."""

# Recognition of the period
PERIODS = (1, 2, 3, 4)
"""In cycles. Of two rounds the changes over the longest must fill one round, 16 - 4 >= 8, and half a round hold it."""
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
LONGEST = 64
"""Longest period that is looked for, once the budget is spent: it is shot in a fraction of what was marched."""
NEARLY_REPEATS = 1e-2
"""Change over it above which it is not worth a shot: what converges within hundreds of cycles has come closer. Above
it a march does not show its way, either."""
NEARLY_LEAST = 2.0
"""Change over a period, as a multiple of the least over any: a period twice as long repeats as nearly."""
CLEARLY = 0.7
"""Least fall of the logarithm of the change, to a half, that tells a motion that settles from one that does not. A
change that has fallen by less than half of what is due has not fallen; nor, where much more is due, has one that has
fallen by less than this, for even that of a creeping contact falls by more."""
DECAYED = 4.0
"""Decay of the slowest free vibration, of its logarithm, before a motion can be said not to repeat. After less, motions
that were irregular at first settled all the same, on a branch that hardly touches a stop."""

# Shooting
LATER = 1.5
"""Cycles before the next attempt, as a multiple of those so far: a motion that never repeats costs little to shoot
beside what it costs to march."""
NEXT_PROOF = 3.0
"""Cycles before the next proof that no contact leaves its state, as a multiple of those so far: it takes a third of a
round of marching, and fails as long as the free vibration could still move a contact."""
REACH = 0.5
"""Longest step, relative to the state: a longer one leaves the neighbourhood in which the linear map is valid."""
SHORTER, SHORTEST_SHARE = 0.25, 1 / 64
"""Factor by which a step that does not lead closer is shortened, and the smallest share of it that is tried."""
MOST_SHOTS, FEW_SHOTS = 32, 8
"""Iterations: near the fixed point five suffice, of a motion that nearly repeats eight, and a few steps of half the
state lead anywhere."""
CLEARLY_NEARER = 0.5
"""Step that an iterate leaves, as a multiple of the shortest before, that is clearly shorter."""
FEW_IDLE, MOST_IDLE = 4, 8
"""Iterations without a clearly shorter step after which it is given up, at the least, and cycles of these: of 328
attempts at 192 points of generated structures of 3 to 10 modes all 141 that converged did so with fewer, while half of
the cycles of the others came after. A cycle that is shot takes as long as ten that are marched."""
TRIES = 2**14
"""Most steps tried in a cycle that is shot: some hundred times as many as at usual tolerances, for a fine one."""
UNSTABLE = 1 + 1e-6
"""Modulus of a Floquet multiplier above which a motion is unstable; multipliers are exact to 1e-6, as tested."""
# Departure from an unstable motion
DISTURBANCE, FARTHEST = 1e-3, 0.03
"""Of the state, by which an unstable motion is at least and at most moved: small enough to keep to a stable one beside
it. What leaves for another motion has, at the farthest, begun to leave faster than small disturbances do."""
SOON = 200
"""Periods after which a disturbance has grown to the farthest, where it needs a larger one than the least to do so."""
FARTHER = 2.0
"""As a multiple of where a motion is that was moved and has not left."""
GONE = 0.1
"""Disturbance, of the state, with which a motion has left another for good."""

# Noise
NOISY = 100.0
"""Change over a period, in units of the tolerance of a step, that may be the noise of its steps: of some hundred, most
are far more precise than they must be."""
QUICK = 0.1
"""Share of the distance that is left after a step of Newton's method, up to which noise does not stand in its way."""
FINER, FINEST = 0.1, 1e-13
"""Factor by which the tolerance of a step is at least reduced where the noise stands in the way, its margin below the
one that suffices, and the smallest tolerance: beyond it is rounding."""
VAGUE = 1e-5
"""Distance from the fixed point, relative to the state, from which on the motion has not settled at all."""
