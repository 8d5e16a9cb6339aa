"""Opponent (c): a hand-written serial RK4 in numba with a fixed grid and located transitions.

What a careful engineer writes for speed: masses scaled out; forces from a table over the phase of the grid;
Nystrom form; the motion of the contacts is carried along, so that a stage needs one product with the mode
shapes each way; numbers of modes and contacts are compile-time constants (the lengths of tuples), and all
that a stage needs lies in flat arrays at offsets known then; no allocation after the start.

A slipping contact has f = mu n e exactly. The direction e turns by tau, the tangent of half the angle,
which starts at 0 in each step (no trigonometric functions, |e| = 1 to rounding). As n falls to 0 the rate
at which e relaxes has no bound: it is held at RELAX / step, and e is led by the lag this adds; what remains
is of third order in the step.

A step at whose end a guard is violated, or whose cubic through a guard's values and rates at both ends dips
below zero, is taken again with a shorter length until it ends on the earliest guard: the cubic's root
first, then Newton in a bracket; the last correction, below 1e-7 of a step, is made without an RK4 step.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from problems import Event, Run

from timesim.model.model import SEPARATION, SLIP, STICK, Model

GUARD = 1e-12
# Located here, not at 0: a run at rest on a guard (n0 = 0) has no direction to slip in until it moves.
CROSSING = 0.5 * GUARD
RELAX = 2.2
MAX_TRIALS = 80
MAX_EVENTS_A_STEP = 500
STUCK_IN_LOCATION, TOO_MANY_EVENTS = -1, -2
FAILURES = {
    STUCK_IN_LOCATION: "a transition was not located",
    TOO_MANY_EVENTS: "too many transitions in a step",
}

compiled = njit(cache=True, fastmath={"contract", "nsz", "reassoc", "arcp"}, error_model="numpy")
inlined = njit(cache=True, fastmath={"contract", "nsz", "reassoc", "arcp"}, error_model="numpy", forceinline=True)


class Scene(NamedTuple):
    """Constants. Modes are mass-normalised; `modes` and `pads` carry their numbers as types."""

    modes: tuple[int, ...]
    pads: tuple[int, ...]
    constant: np.ndarray  # flat: stiffness (M), damping (M), shape (3C, M), its transpose (M, 3C), pads (C, 9)
    load: np.ndarray  # (2N + 3, M): at half-steps, then two rows for points off the grid
    harmonic: np.ndarray  # (H,)
    cosine: np.ndarray  # (H, M)
    sine: np.ndarray
    mean: np.ndarray  # (M,)
    phase: float
    points: np.ndarray  # (3P, M)


class Work(NamedTuple):
    """What changes. Rows are flat arrays by `Columns`: the two ends of a step, the three inner stages."""

    start: np.ndarray
    end: np.ndarray
    second: np.ndarray
    third: np.ndarray
    fourth: np.ndarray
    pad: np.ndarray  # flat: force (C, 3), w (C, 2)
    state: np.ndarray  # (C,)
    extreme: np.ndarray  # (3P, 2)
    log: np.ndarray  # (events, 4)


class Columns(NamedTuple):
    """Where things lie in a row; in Scene.constant; in Work.pad."""

    q: int
    v: int
    a: int
    u: int  # motion of the contacts, 3C
    du: int
    ddu: int
    e: int  # 2C
    tau: int
    turn: int
    guard: int  # 2C
    slope: int
    width: int
    damping: int
    shape: int
    turned: int
    pad: int
    w: int


@inlined
def columns(modes, pads):
    M, C = len(modes), len(pads)
    K = 3 * C
    e = 3 * M + 3 * K
    return Columns(
        0, M, 2 * M, 3 * M, 3 * M + K, 3 * M + 2 * K,
        e, e + 2 * C, e + 3 * C, e + 4 * C, e + 6 * C, e + 8 * C,
        M, 2 * M, 2 * M + K * M, 2 * M + 2 * K * M, K,
    )  # fmt: skip


@compiled
def off_grid_load(s, row, theta):
    M = len(s.modes)
    for i in range(M):
        s.load[row, i] = s.mean[i]
    for k in range(s.harmonic.size):
        c, d = np.cos(s.harmonic[k] * theta), np.sin(s.harmonic[k] * theta)
        for i in range(M):
            s.load[row, i] += c * s.cosine[k, i] + d * s.sine[k, i]


@compiled
def led_direction(k11, k12, k22, mu, n, dn, a1, a2, e1, e2, across, floor_per_pull):
    """Direction of f and mu n as it bounds the rate of e (see the module): e1, e2, bounded mu n."""
    size = np.sqrt(a1 * a1 + a2 * a2)
    k1, k2 = k11 * e1 + k12 * e2, k12 * e1 + k22 * e2
    p1, p2 = k12 * e1 - k11 * e2, k22 * e1 - k12 * e2
    pull = p2 * a1 - p1 * a2 + mu * dn * (p1 * e2 - p2 * e1 + k1 * e1 + k2 * e2)
    pull = max(pull / (e1 * k1 + e2 * k2), 0.3 * size)
    bounded = pull * floor_per_pull
    if bounded <= mu * n or pull == 0.0:
        return e1, e2, max(mu * n, 1e-300)
    lead = across * (1.0 - mu * n / bounded) / pull
    half = 0.5 * lead
    d = 1.0 / (1.0 + half * half)
    c, t = (1.0 - half * half) * d, 2.0 * half * d
    return c * e1 - t * e2, c * e2 + t * e1, bounded


@inlined
def contact_forces(s, z, row, grid_step):
    """Forces on body 1 in each contact's frame, and the rate of tau where it slips."""
    o = columns(s.modes, s.pads)
    for c in range(len(s.pads)):
        k11, k12, k22, mu = (
            s.constant[o.pad + 9 * c],
            s.constant[o.pad + 9 * c + 1],
            s.constant[o.pad + 9 * c + 2],
            s.constant[o.pad + 9 * c + 3],
        )
        kv, n0, base = (
            s.constant[o.pad + 9 * c + 4],
            s.constant[o.pad + 9 * c + 5],
            s.constant[o.pad + 9 * c + 6],
        )
        n = n0 + kv * row[o.u + 3 * c + 2]
        f1 = f2 = 0.0
        if z.state[c] == SEPARATION:
            n = 0.0
        elif z.state[c] == STICK:
            d1, d2 = row[o.u + 3 * c] - z.pad[o.w + 2 * c], row[o.u + 3 * c + 1] - z.pad[o.w + 2 * c + 1]
            f1, f2 = k11 * d1 + k12 * d2, k12 * d1 + k22 * d2
        elif mu > 0.0:
            e1, e2, tau = row[o.e + 2 * c], row[o.e + 2 * c + 1], row[o.tau + c]
            du1, du2, dn = row[o.du + 3 * c], row[o.du + 3 * c + 1], kv * row[o.du + 3 * c + 2]
            a1, a2 = k11 * du1 + k12 * du2, k12 * du1 + k22 * du2
            k1, k2 = k11 * e1 + k12 * e2, k12 * e1 + k22 * e2
            across = k1 * (a2 - mu * dn * e2) - k2 * (a1 - mu * dn * e1)
            along = e1 * k1 + e2 * k2
            bounded = mu * n
            floor = grid_step / RELAX
            if bounded < 4.0 * floor * (abs(a1) + abs(a2)):
                e1, e2, bounded = led_direction(k11, k12, k22, mu, n, dn, a1, a2, e1, e2, across / along, floor)
            f1, f2 = mu * n * e1, mu * n * e2
            row[o.turn + c] = 0.5 * (1.0 + tau * tau) * across / (along * bounded)
        z.pad[3 * c], z.pad[3 * c + 1], z.pad[3 * c + 2] = -f1, -f2, base - n


@inlined
def evaluate(s, z, row, load_row, grid_step):
    """Accelerations of the modes and of the contacts' motion at a row."""
    o = columns(s.modes, s.pads)
    M, K = len(s.modes), 3 * len(s.pads)
    contact_forces(s, z, row, grid_step)
    for i in range(M):
        row[o.a + i] = s.load[load_row, i] - s.constant[o.damping + i] * row[o.v + i] - s.constant[i] * row[i]
    for k in range(K):
        g = z.pad[k]
        for i in range(M):
            row[o.a + i] += s.constant[o.shape + len(s.modes) * k + i] * g
    for k in range(K):
        row[o.ddu + k] = 0.0
    for i in range(M):
        a = row[o.a + i]
        for k in range(K):
            row[o.ddu + k] += s.constant[o.turned + 3 * len(s.pads) * i + k] * a


@inlined
def turn_to(s, z, row, c, tau):
    o = columns(s.modes, s.pads)
    e1, e2 = z.start[o.e + 2 * c], z.start[o.e + 2 * c + 1]
    d = 1.0 / (1.0 + tau * tau)
    x, y = (1.0 - tau * tau) * d, 2.0 * tau * d
    row[o.e + 2 * c], row[o.e + 2 * c + 1] = x * e1 - y * e2, x * e2 + y * e1
    row[o.tau + c] = tau


@inlined
def inner_stage(s, z, row, h, move, kick, kick_at, push_at):
    """q = q0 + h move q' + h^2 kick a(kick_at), q' = q0' + h move a(push_at), from the start of the step."""
    o = columns(s.modes, s.pads)
    x, y = h * move, h * h * kick
    for i in range(len(s.modes)):
        row[i] = z.start[i] + x * z.start[o.v + i] + y * kick_at[o.a + i]
        row[o.v + i] = z.start[o.v + i] + x * push_at[o.a + i]
    for k in range(3 * len(s.pads)):
        row[o.u + k] = z.start[o.u + k] + x * z.start[o.du + k] + y * kick_at[o.ddu + k]
        row[o.du + k] = z.start[o.du + k] + x * push_at[o.ddu + k]
    for c in range(len(s.pads)):
        if z.state[c] == SLIP:
            turn_to(s, z, row, c, x * push_at[o.turn + c])


@inlined
def step(s, z, h, mid_load, end_load, grid_step):
    """One RK4 step from `start` to `end`, with the accelerations and the guards at its end."""
    o = columns(s.modes, s.pads)
    h6 = h / 6.0
    inner_stage(s, z, z.second, h, 0.5, 0.0, z.start, z.start)
    evaluate(s, z, z.second, mid_load, grid_step)
    inner_stage(s, z, z.third, h, 0.5, 0.25, z.start, z.second)
    evaluate(s, z, z.third, mid_load, grid_step)
    inner_stage(s, z, z.fourth, h, 1.0, 0.5, z.second, z.third)
    evaluate(s, z, z.fourth, end_load, grid_step)
    for i in range(len(s.modes)):
        inner = z.second[o.a + i] + z.third[o.a + i]
        z.end[i] = z.start[i] + h * (z.start[o.v + i] + h6 * (z.start[o.a + i] + inner))
        z.end[o.v + i] = z.start[o.v + i] + h6 * (z.start[o.a + i] + 2.0 * inner + z.fourth[o.a + i])
    for k in range(3 * len(s.pads)):
        inner = z.second[o.ddu + k] + z.third[o.ddu + k]
        z.end[o.u + k] = z.start[o.u + k] + h * (z.start[o.du + k] + h6 * (z.start[o.ddu + k] + inner))
        z.end[o.du + k] = z.start[o.du + k] + h6 * (z.start[o.ddu + k] + 2.0 * inner + z.fourth[o.ddu + k])
    for c in range(len(s.pads)):
        if z.state[c] == SLIP:
            inner = z.second[o.turn + c] + z.third[o.turn + c]
            turn_to(s, z, z.end, c, h6 * (z.start[o.turn + c] + 2.0 * inner + z.fourth[o.turn + c]))
            z.end[o.tau + c] = 0.0
    evaluate(s, z, z.end, end_load, grid_step)
    guards(s, z, z.end)


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


@compiled
def shift_end(s, z, d):
    """Newton's last correction, where the square of `d` is below rounding, without an RK4 step."""
    o = columns(s.modes, s.pads)
    for i in range(len(s.modes)):
        z.end[i] += d * z.end[o.v + i]
        z.end[o.v + i] += d * z.end[o.a + i]
    for k in range(3 * len(s.pads)):
        z.end[o.u + k] += d * z.end[o.du + k]
        z.end[o.du + k] += d * z.end[o.ddu + k]
    for c in range(len(s.pads)):
        if z.state[c] == SLIP:
            e1, e2, angle = z.end[o.e + 2 * c], z.end[o.e + 2 * c + 1], 2.0 * d * z.end[o.turn + c]
            z.end[o.e + 2 * c], z.end[o.e + 2 * c + 1] = e1 - angle * e2, e2 + angle * e1


@compiled
def locate(s, z, offset, theta, omega, h, x, target, grid_step):
    """Shorten the step until it ends on the earliest guard: its length and the guard, -1 if none."""
    o = columns(s.modes, s.pads)
    mid, end = s.load.shape[0] - 2, s.load.shape[0] - 1
    low, high = 0.0, h
    only_dips = z.end[o.guard + target] >= -GUARD
    for _ in range(MAX_TRIALS):
        off_grid_load(s, mid, theta + omega * (offset + 0.5 * x))
        off_grid_load(s, end, theta + omega * (offset + x))
        step(s, z, x, mid, end, grid_step)
        there, target, beyond = refine(s, z, z.end, x, target)
        if only_dips and not beyond and z.end[o.slope + target] >= 0.0:
            return x, -1
        if abs(there - x) <= 1e-13 * grid_step or (x == 0.0 and beyond) or high - low <= 1e-14 * grid_step:
            return x, target
        if abs(there - x) <= 1e-7 * grid_step and there > 0.0:
            off_grid_load(s, end, theta + omega * (offset + there))
            shift_end(s, z, there - x)
            evaluate(s, z, z.end, end, grid_step)
            guards(s, z, z.end)
            return there, target
        if beyond:
            high = x
        else:
            low = x
        x = there if low < there < high else (0.0 if there <= 0.0 and low == 0.0 else 0.5 * (low + high))
    return x, -2


@compiled
def slip_direction(k11, k12, k22, a1, a2, limit):
    """The unit vector e that solves (limit I + s K) e = a, s >= 0, for |a| >= limit."""
    low, high = 0.0, 1.0
    trace, spread = k11 + k22, np.sqrt((k11 - k22) ** 2 + 4.0 * k12 * k12)
    high = 2.0 * np.sqrt(a1 * a1 + a2 * a2) / (trace - spread)
    e1 = e2 = size = 0.0
    x = high
    if high == 0.0:
        return 1.0, 0.0
    for _ in range(200):
        m11, m12, m22 = limit + x * k11, x * k12, limit + x * k22
        det = m11 * m22 - m12 * m12
        e1, e2 = (m22 * a1 - m12 * a2) / det, (m11 * a2 - m12 * a1) / det
        size = np.sqrt(e1 * e1 + e2 * e2)
        if size > 1.0:
            low = x
        else:
            high = x
        if abs(size - 1.0) < 1e-15 or high - low < 1e-15 * high:
            break
        k1, k2 = k11 * e1 + k12 * e2, k12 * e1 + k22 * e2
        drop = (e1 * (m22 * k1 - m12 * k2) + e2 * (m11 * k2 - m12 * k1)) / (det * size * size)
        x = x + (size - 1.0) / drop  # Newton on 1 / |e|, which is nearly straight in s
        if not low < x < high:
            x = 0.5 * (low + high)
    return e1 / size, e2 / size


@compiled
def keep_slip(s, z, row, c):
    """w from the motion so far: the force is the same on both sides of a transition."""
    o = columns(s.modes, s.pads)
    k11, k12, k22, mu = (
        s.constant[o.pad + 9 * c],
        s.constant[o.pad + 9 * c + 1],
        s.constant[o.pad + 9 * c + 2],
        s.constant[o.pad + 9 * c + 3],
    )
    if z.state[c] == SEPARATION or mu == 0.0:
        z.pad[o.w + 2 * c], z.pad[o.w + 2 * c + 1] = row[o.u + 3 * c], row[o.u + 3 * c + 1]
    elif z.state[c] == SLIP:
        f1, f2, det = -z.pad[3 * c], -z.pad[3 * c + 1], k11 * k22 - k12 * k12
        z.pad[o.w + 2 * c] = row[o.u + 3 * c] - (k22 * f1 - k12 * f2) / det
        z.pad[o.w + 2 * c + 1] = row[o.u + 3 * c + 1] - (k11 * f2 - k12 * f1) / det


@compiled
def start_slip(s, z, row, c, b1, b2):
    o = columns(s.modes, s.pads)
    size = np.sqrt(b1 * b1 + b2 * b2)
    row[o.e + 2 * c], row[o.e + 2 * c + 1] = (b1 / size, b2 / size) if size > 0.0 else (1.0, 0.0)
    row[o.tau + c] = 0.0
    z.state[c] = SLIP


@compiled
def switch(s, z, row, c, by_normal):
    """Apply the transition of a contact; row `row` has to be evaluated afterwards."""
    o = columns(s.modes, s.pads)
    k11, k12, k22, mu, kv = (
        s.constant[o.pad + 9 * c],
        s.constant[o.pad + 9 * c + 1],
        s.constant[o.pad + 9 * c + 2],
        s.constant[o.pad + 9 * c + 3],
        s.constant[o.pad + 9 * c + 4],
    )
    keep_slip(s, z, row, c)
    dn = kv * row[o.du + 3 * c + 2]
    if z.state[c] == SEPARATION:
        du1, du2 = row[o.du + 3 * c], row[o.du + 3 * c + 1]
        a1, a2 = k11 * du1 + k12 * du2, k12 * du1 + k22 * du2
        if mu == 0.0:
            z.state[c] = SLIP
        elif np.sqrt(a1 * a1 + a2 * a2) < mu * dn:
            z.state[c] = STICK
        else:
            e1, e2 = slip_direction(k11, k12, k22, a1, a2, max(mu * dn, 0.0))
            start_slip(s, z, row, c, e1, e2)
    elif by_normal or (z.state[c] == STICK and row[o.guard + 2 * c + 1] < 1e-9 and dn < 0.0):
        z.state[c] = SEPARATION
    elif z.state[c] == SLIP:
        z.state[c] = STICK
    else:
        start_slip(s, z, row, c, -z.pad[3 * c], -z.pad[3 * c + 1])


@inlined
def keep_end(s, z):
    for k in range(columns(s.modes, s.pads).width):
        z.start[k] = z.end[k]


@compiled
def note_extremes(s, z, h):
    """Highest and lowest place of each point over a step, by the cubic through its ends."""
    o = columns(s.modes, s.pads)
    for k in range(s.points.shape[0]):
        x0 = x1 = v0 = v1 = 0.0
        for i in range(len(s.modes)):
            b = s.points[k, i]
            x0, v0 = x0 + b * z.start[i], v0 + b * z.start[o.v + i]
            x1, v1 = x1 + b * z.end[i], v1 + b * z.end[o.v + i]
        low, high = min(x0, x1), max(x0, x1)
        if v0 * v1 < 0.0:
            d = (x1 - x0) / h
            a, b = 3.0 * (v0 + v1 - 2.0 * d), 2.0 * (3.0 * d - 2.0 * v0 - v1)
            y = -2.0 * v0 / (b - np.copysign(np.sqrt(b * b - 4.0 * a * v0), v0))
            x = cubic(y, x0, h * v0, x1, h * v1)
            low, high = min(low, x), max(high, x)
        z.extreme[k, 0], z.extreme[k, 1] = min(z.extreme[k, 0], low), max(z.extreme[k, 1], high)


@compiled
def grid_steps(s, z, omega, grid_step, first, num_events, track):
    """One cycle: the number of events with those before, or a failure below 0."""
    num, end = (s.load.shape[0] - 3) // 2, s.load.shape[0] - 1
    mid = end - 1
    for k in range(num):
        offset, theta = 0.0, s.phase + omega * k * grid_step
        mid_load, tries = 2 * k + 1, 0
        while True:
            h = grid_step - offset
            step(s, z, h, mid_load, 2 * k + 2, grid_step)
            x, target = earliest(s, z, h)
            if target < 0:
                if track:
                    note_extremes(s, z, h)
                keep_end(s, z)
                break
            x, target = locate(s, z, offset, theta, omega, h, x, target, grid_step)
            tries += 1
            if target < -1 or tries > MAX_EVENTS_A_STEP:
                return STUCK_IN_LOCATION if target < -1 else TOO_MANY_EVENTS
            if track and x > 0.0:
                note_extremes(s, z, x)
            keep_end(s, z)
            offset += x
            if target >= 0:
                c = target // 2
                left = z.state[c]
                switch(s, z, z.start, c, target % 2 == 1)
                if num_events < z.log.shape[0]:
                    z.log[num_events, 0], z.log[num_events, 1] = (first + k) * grid_step + offset, c
                    z.log[num_events, 2], z.log[num_events, 3] = left, z.state[c]
                num_events += 1
                evaluate(s, z, z.start, end, grid_step)
                guards(s, z, z.start)
            off_grid_load(s, mid, theta + omega * 0.5 * (offset + grid_step))
            mid_load = mid
    return num_events


@compiled
def contact_motion(s, z, row):
    """Motion of the contacts afresh from the modes."""
    o = columns(s.modes, s.pads)
    for k in range(3 * len(s.pads)):
        row[o.u + k] = row[o.du + k] = 0.0
        for i in range(len(s.modes)):
            row[o.u + k] += s.constant[o.shape + len(s.modes) * k + i] * row[i]
            row[o.du + k] += s.constant[o.shape + len(s.modes) * k + i] * row[o.v + i]


@compiled
def begin(s, z, omega, grid_step):
    o = columns(s.modes, s.pads)
    contact_motion(s, z, z.start)
    for c in range(len(s.pads)):
        n = s.constant[o.pad + 9 * c + 5] + s.constant[o.pad + 9 * c + 4] * z.start[o.u + 3 * c + 2]
        if z.state[c] < 0:
            z.state[c] = SEPARATION if n <= 0.0 else STICK
        if z.state[c] == STICK and s.constant[o.pad + 9 * c + 3] == 0.0:
            z.state[c] = SLIP
        if z.state[c] == SLIP:
            d1, d2 = (
                z.start[o.u + 3 * c] - z.pad[o.w + 2 * c],
                z.start[o.u + 3 * c + 1] - z.pad[o.w + 2 * c + 1],
            )
            start_slip(
                s,
                z,
                z.start,
                c,
                s.constant[o.pad + 9 * c] * d1 + s.constant[o.pad + 9 * c + 1] * d2,
                s.constant[o.pad + 9 * c + 1] * d1 + s.constant[o.pad + 9 * c + 2] * d2,
            )
    evaluate(s, z, z.start, 0, grid_step)
    guards(s, z, z.start)


@compiled
def run_cycles(s, z, frequency, cycles, num_steps):
    """From the state in `start`: the number of events, or a failure below 0."""
    omega, grid_step = 2.0 * np.pi * frequency, 1.0 / (frequency * num_steps)
    begin(s, z, omega, grid_step)
    num_events = 0
    for cycle in range(cycles):
        contact_motion(s, z, z.start)
        num_events = grid_steps(s, z, omega, grid_step, cycle * num_steps, num_events, False)
        if num_events < 0:
            break
    for c in range(len(s.pads)):
        keep_slip(s, z, z.start, c)
    return num_events


@compiled
def run_settling(s, z, frequency, tol, max_cycles, num_steps, last):
    """Cycles until the state changes by less than `tol`, one more for extremes: events, cycles, change."""
    o = columns(s.modes, s.pads)
    omega, grid_step = 2.0 * np.pi * frequency, 1.0 / (frequency * num_steps)
    begin(s, z, omega, grid_step)
    num_events, cycles, change = 0, 0, np.inf
    while cycles < max_cycles and change >= tol:
        contact_motion(s, z, z.start)
        for i in range(len(s.modes)):
            last[0, i], last[1, i] = z.start[i], z.start[o.v + i]
        num_events = grid_steps(s, z, omega, grid_step, cycles * num_steps, num_events, False)
        if num_events < 0:
            return num_events, cycles, change
        cycles += 1
        moved = size = 0.0
        for i in range(len(s.modes)):
            moved = max(moved, abs(z.start[i] - last[0, i]), abs(z.start[o.v + i] - last[1, i]) / omega)
            size = max(size, abs(z.start[i]), abs(z.start[o.v + i]) / omega)
        change = moved / size if size > 0.0 else 0.0
    num_events = grid_steps(s, z, omega, grid_step, cycles * num_steps, num_events, True)
    for c in range(len(s.pads)):
        keep_slip(s, z, z.start, c)
    return num_events, cycles + 1, change


def scene(model: Model, steps_per_cycle: int) -> Scene:
    """Constants of a model on a grid; they hold for every frequency."""
    s, x = model.structure, model.excitation
    if s.damping.ndim != 1:
        raise ValueError("structure.damping: this opponent takes one number a mode, not a matrix")
    root = np.sqrt(s.mass)
    shape = model.contact_shape.reshape(-1, s.num_modes) / root
    cosine, sine, mean = x.cosine / root, x.sine / root, x.constant / root
    theta = np.arange(2 * steps_per_cycle + 1) * np.pi / steps_per_cycle + model.start.phase
    load = np.zeros((2 * steps_per_cycle + 3, s.num_modes))
    angle = np.outer(theta, x.harmonic)
    load[:-2] = np.cos(angle) @ cosine + np.sin(angle) @ sine + mean
    own = [s.stiffness / s.mass, s.damping / s.mass, shape.ravel(), shape.T.ravel(), _pads(model).ravel()]
    constants = np.concatenate(own)
    return Scene(
        (0,) * s.num_modes, (0,) * model.num_contacts, constants, load,
        x.harmonic.astype(float), cosine, sine, mean, float(model.start.phase),
        np.ascontiguousarray(s.shape.reshape(-1, s.num_modes) / root),
    )  # fmt: skip


def _pads(model: Model) -> np.ndarray:
    s, x = model.structure, model.excitation
    load = np.abs(x.cosine).sum(0) + np.abs(x.sine).sum(0) + np.abs(x.constant)
    modal = load / s.stiffness + np.abs(model.start.displacement)
    rows = []
    for contact, shape in zip(model.contacts, np.abs(model.contact_shape), strict=True):
        k = contact.tangential_stiffness
        scale = abs(contact.preload) + max(k[0, 0], contact.normal_stiffness) * float((shape @ modal).max())
        scale = scale or 1.0
        rows.append([
            k[0, 0], k[0, 1], k[1, 1], contact.friction, contact.normal_stiffness, contact.preload,
            max(contact.preload, 0.0), 1 / scale, 1 / (scale * s.omega.min()),
        ])  # fmt: skip
    return np.array(rows).reshape(-1, 9)


def work(model: Model, start: Run | None, num_log: int) -> Work:
    """Room to work, with the start of the model, or the end of an earlier run, in row 0."""
    M, C, P = model.structure.num_modes, model.num_contacts, len(model.structure.points)
    root, s = np.sqrt(model.structure.mass), model.start
    q, v, w, state = (
        (s.displacement, s.velocity, s.slip, s.state)
        if start is None
        else (start.q, start.qdot, start.slip, start.state)
    )
    rows = [np.zeros(3 * M + 17 * C) for _ in range(5)]
    rows[0][:M], rows[0][M : 2 * M] = q * root, v * root
    extreme = np.tile([np.inf, -np.inf], (3 * P, 1))
    pad = np.concatenate([np.zeros(3 * C), np.ravel(w)])
    return Work(*rows, pad, np.array(state, dtype=np.int64), extreme, np.zeros((num_log, 4)))


def _result(model: Model, z: Work, num_events: int) -> Run:
    if num_events < 0:
        raise RuntimeError(f"{FAILURES[num_events]}; take more steps per cycle")
    root = np.sqrt(model.structure.mass)
    events: list[Event] = [(float(t), int(c), int(a), int(b)) for t, c, a, b in z.log[:num_events]]
    m = root.size
    slip = z.pad[3 * model.num_contacts :].reshape(-1, 2)
    return Run(z.start[:m] / root, z.start[m : 2 * m] / root, slip, z.state, num_events, events)


def simulate(
    model: Model,
    frequency: float,
    cycles: int,
    *,
    steps_per_cycle: int = 200,
    num_log: int = 0,
    constants: Scene | None = None,
) -> Run:
    """Run `cycles` periods of the excitation from the start of the model.

    Args:
        model: the scene.
        frequency: of the excitation [Hz].
        cycles: number of periods.
        steps_per_cycle: of the grid.
        num_log: the first so many events are returned.
        constants: `scene(model, steps_per_cycle)` where it is at hand.
    """
    s, z = constants or scene(model, steps_per_cycle), work(model, None, num_log)
    num_events = run_cycles(s, z, frequency, cycles, steps_per_cycle)
    return _result(model, z, num_events)


class Settled(NamedTuple):
    """Amplitude of each point axis (P, 3) over the last cycle, and how the march ended."""

    amplitude: np.ndarray
    end: Run
    cycles: int
    change: float


def march(
    model: Model,
    frequency: float,
    start: Run | None = None,
    *,
    tol: float = 1e-8,
    max_cycles: int = 2000,
    steps_per_cycle: int = 200,
    constants: Scene | None = None,
) -> Settled:
    """Cycle until the state at a cycle's end changes by less than `tol`; amplitude of one cycle more.

    Args:
        model: the scene.
        frequency: of the excitation [Hz].
        start: the end of an earlier march to go on from, else the start of the model.
        tol: largest change of (q, qdot / omega) over a cycle, relative to its largest component.
        max_cycles: budget.
        steps_per_cycle: of the grid.
        constants: `scene(model, steps_per_cycle)` where many frequencies of one model are marched.
    """
    s = constants or scene(model, steps_per_cycle)
    z = work(model, start, 0)
    last = np.empty((2, model.structure.num_modes))
    num_events, cycles, change = run_settling(s, z, frequency, tol, max_cycles, steps_per_cycle, last)
    end = _result(model, z, num_events)
    return Settled(0.5 * (z.extreme[:, 1] - z.extreme[:, 0]).reshape(-1, 3), end, cycles, change)
