"""The contact law of the loops in numba: forces, the turning of slip, and the transitions.

A slipping contact has f = mu n e exactly. The direction e turns by tau, the tangent of half the angle, which starts at
0 in each step (no trigonometric functions, |e| = 1 to rounding). As n falls to 0 the rate at which e relaxes has no
bound: it is held at RELAX / step, and e is led by the lag this adds; what remains is of third order in the step.
"""

import numpy as np
from opponents.numba_system import columns, compiled, inlined

from timesim.model.model import SEPARATION, SLIP, STICK

RELAX = 2.2


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
