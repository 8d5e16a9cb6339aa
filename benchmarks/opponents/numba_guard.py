"""The guards of the loops in numba, and where the first of them falls through zero.

A step at whose end a guard is violated, or whose cubic through a guard's values and rates at both ends dips below zero,
is taken again with a shorter length until it ends on the earliest guard.
"""

import numpy as np
from opponents.numba_system import columns, compiled, inlined

from timesim.model.model import SEPARATION, STICK

GUARD = 1e-12
# Located here, not at 0: a run at rest on a guard (n0 = 0) has no direction to slip in until it moves.
CROSSING = 0.5 * GUARD


@inlined
def guards(s, z, row):
    """Guards of each contact (friction's, then n's) and their rates; a state holds while they are >= 0."""
    o = columns(s.modes, s.pads)
    for c in range(len(s.pads)):
        k11, k12, k22, mu, kv = (
            s.constant[o.pad + 9 * c],
            s.constant[o.pad + 9 * c + 1],
            s.constant[o.pad + 9 * c + 2],
            s.constant[o.pad + 9 * c + 3],
            s.constant[o.pad + 9 * c + 4],
        )
        per_force, per_rate = s.constant[o.pad + 9 * c + 7], s.constant[o.pad + 9 * c + 8]
        n, dn = s.constant[o.pad + 9 * c + 5] + kv * row[o.u + 3 * c + 2], kv * row[o.du + 3 * c + 2]
        sign = -per_force if z.state[c] == SEPARATION else per_force
        row[o.guard + 2 * c + 1], row[o.slope + 2 * c + 1] = sign * n, sign * dn
        row[o.guard + 2 * c], row[o.slope + 2 * c] = 1.0, 0.0
        if z.state[c] == SEPARATION or mu == 0.0:
            continue
        du1, du2 = row[o.du + 3 * c], row[o.du + 3 * c + 1]
        a1, a2 = k11 * du1 + k12 * du2, k12 * du1 + k22 * du2
        if z.state[c] == STICK:
            f1, f2 = -z.pad[3 * c], -z.pad[3 * c + 1]
            size = np.sqrt(f1 * f1 + f2 * f2)
            pull = (f1 * a1 + f2 * a2) / size if size > 0.0 else np.sqrt(a1 * a1 + a2 * a2)
            row[o.guard + 2 * c], row[o.slope + 2 * c] = (
                per_force * (mu * n - size),
                per_force * (mu * dn - pull),
            )
        else:
            x1, x2 = row[o.ddu + 3 * c], row[o.ddu + 3 * c + 1]
            b1, b2 = k11 * x1 + k12 * x2, k12 * x1 + k22 * x2
            e1, e2, spin = row[o.e + 2 * c], row[o.e + 2 * c + 1], 2.0 * row[o.turn + c]
            size = mu * n
            if size > 0.0:
                e1, e2 = -z.pad[3 * c] / size, -z.pad[3 * c + 1] / size
            row[o.guard + 2 * c] = per_rate * (e1 * a1 + e2 * a2 - mu * dn)
            bend = mu * kv * row[o.ddu + 3 * c + 2]
            row[o.slope + 2 * c] = per_rate * (spin * (e1 * a2 - e2 * a1) + e1 * b1 + e2 * b2 - bend)


@compiled
def cubic(x, g0, r0, g1, r1):
    """Cubic on [0, 1] by values and rates at both ends."""
    d = g1 - g0
    return g0 + x * (r0 + x * (3.0 * d - 2.0 * r0 - r1 + x * (r0 + r1 - 2.0 * d)))


@compiled
def first_root(g0, r0, g1, r1):
    """First place on [0, 1] where the cubic falls below zero, 2 if nowhere."""
    g0 = max(g0, 0.0)
    low, at_low = 0.0, g0
    for k in range(1, 9):
        high = k / 8.0
        at_high = cubic(high, g0, r0, g1, r1)
        if at_high < 0.0:
            for _ in range(12):
                mid = low + (high - low) * at_low / (at_low - at_high)
                value = cubic(mid, g0, r0, g1, r1)
                if value < 0.0:
                    high, at_high, at_low = mid, value, at_low * 0.5
                else:
                    low, at_low, at_high = mid, value, at_high * 0.5
                if high - low < 1e-9 or value == 0.0:
                    break
            return mid
        low, at_low = high, at_high
    return 2.0


@compiled
def dips(g0, r0, g1, r1):
    """Whether the cubic, falling at first and rising at last, goes below zero in between."""
    if not (r0 < 0.0 < r1) or g0 <= 0.0 or g0 + r0 >= 0.0:
        return False
    d = g1 - g0
    c, b, a = r0, 2.0 * (3.0 * d - 2.0 * r0 - r1), 3.0 * (r0 + r1 - 2.0 * d)
    x = -2.0 * c / (b + np.sqrt(max(b * b - 4.0 * a * c, 0.0)))
    return cubic(x, g0, r0, g1, r1) < -GUARD


@compiled
def earliest(s, z, h):
    """Where a guard first falls through zero in the step just made, by its cubic, and which; -1 if none."""
    o = columns(s.modes, s.pads)
    best, which = 2.0, -1
    for j in range(2 * len(s.pads)):
        g0, r0, g1, r1 = (
            z.start[o.guard + j],
            h * z.start[o.slope + j],
            z.end[o.guard + j],
            h * z.end[o.slope + j],
        )
        if g1 < -GUARD:
            x = min(first_root(g0 + CROSSING, r0, g1 + CROSSING, r1), 1.0)
        elif dips(g0, r0, g1, r1):
            x = first_root(g0 + CROSSING, r0, g1 + CROSSING, r1)
        else:
            continue
        if x < best:
            best, which = x, j
    return (best * h, which) if which >= 0 else (-1.0, -1)


@compiled
def refine(s, z, row, x, target):
    """Newton's next length and its guard, and whether this end lies beyond a guard."""
    o = columns(s.modes, s.pads)
    best, which, beyond = np.inf, target, row[o.guard + target] < -CROSSING
    for j in range(2 * len(s.pads)):
        g, r = row[o.guard + j], row[o.slope + j]
        if j != target and g >= -GUARD:
            continue
        beyond = beyond or g < -GUARD
        there = x - (g + CROSSING) / r if r < 0.0 else (-np.inf if g < -CROSSING else np.inf)
        if there < best:
            best, which = there, j
    return best, which, beyond
