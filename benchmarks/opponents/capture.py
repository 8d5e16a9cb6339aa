"""Opponents: fixed steps in numba that locate no transition.

`capture` is what explicit finite element codes do: central differences of the structure, and each contact's force by
a return mapping (elastic trial force, put back on the cone along the direction that an implicit Euler step of the
slip gives). `regularised` has no states at all: the force may leave the cone, and slip follows it like a viscous
fluid, w' = (|f| - mu n)+ f / (|f| eta) (Perzyna 1966), with eta as small as RK4's stability lets it be.
"""

import numpy as np
from opponents.numba_contact import slip_direction
from opponents.numba_system import Scene, compiled, inlined, scene
from problems import Run

from timesim.model.contact_state import start_states
from timesim.model.model import SEPARATION, SLIP, STICK, Model

VISCOSITY = 0.5  # eta by K_u times the step; RK4 is stable down to 1 / 2.78


@inlined
def pad_row(s, c):
    """k11, k12, k22, mu, k_v, n0 of a contact."""
    at = 2 * len(s.modes) + 6 * len(s.pads) * len(s.modes) + 9 * c
    return (
        s.constant[at],
        s.constant[at + 1],
        s.constant[at + 2],
        s.constant[at + 3],
        s.constant[at + 4],
        s.constant[at + 5],
    )


@inlined
def moved(s, q, u):
    """Relative motion of the contacts."""
    M = len(s.modes)
    for k in range(3 * len(s.pads)):
        total = 0.0
        for i in range(M):
            total += s.constant[2 * M + M * k + i] * q[i]
        u[k] = total


@inlined
def push(s, u, w, state, out):
    """Return mapping: w and forces on body 1 at a position."""
    for c in range(len(s.pads)):
        k11, k12, k22, mu, kv, n0 = pad_row(s, c)
        n = n0 + kv * u[3 * c + 2]
        f1 = f2 = 0.0
        if n <= 0.0 or mu == 0.0:
            n = max(n, 0.0)
            w[2 * c], w[2 * c + 1] = u[3 * c], u[3 * c + 1]
            state[c] = SEPARATION if n == 0.0 else SLIP
        else:
            d1, d2 = u[3 * c] - w[2 * c], u[3 * c + 1] - w[2 * c + 1]
            f1, f2 = k11 * d1 + k12 * d2, k12 * d1 + k22 * d2
            size, limit = np.sqrt(f1 * f1 + f2 * f2), mu * n
            state[c] = STICK
            if size > limit:
                state[c] = SLIP
                e1, e2 = f1 / size, f2 / size
                if k12 != 0.0 or k11 != k22:
                    e1, e2 = slip_direction(k11, k12, k22, f1, f2, limit)
                f1, f2, det = limit * e1, limit * e2, k11 * k22 - k12 * k12
                w[2 * c] = u[3 * c] - (k22 * f1 - k12 * f2) / det
                w[2 * c + 1] = u[3 * c + 1] - (k11 * f2 - k12 * f1) / det
        out[3 * c], out[3 * c + 1], out[3 * c + 2] = -f1, -f2, max(n0, 0.0) - n


@inlined
def accelerations(s, q, force, row, a):
    """Without damping."""
    M, K = len(s.modes), 3 * len(s.pads)
    for i in range(M):
        total = s.load[row, i] - s.constant[i] * q[i]
        for k in range(K):
            total += s.constant[2 * M + K * M + K * i + k] * force[k]
        a[i] = total


@compiled
def run_capture(s, q, v, w, state, h, cycles, num_steps):
    M, K = len(s.modes), 3 * len(s.pads)
    u, force, a, half = np.zeros(K), np.zeros(K), np.zeros(M), np.zeros(M)
    moved(s, q, u)
    push(s, u, w, state, force)
    accelerations(s, q, force, 0, a)
    for i in range(M):
        half[i] = v[i] + 0.5 * h * (a[i] - s.constant[M + i] * v[i])
    for _ in range(cycles):
        for k in range(num_steps):
            for i in range(M):
                q[i] += h * half[i]
            moved(s, q, u)
            push(s, u, w, state, force)
            accelerations(s, q, force, 2 * k + 2, a)
            for i in range(M):
                d = 0.5 * h * s.constant[M + i]
                before = half[i]
                half[i] = ((1.0 - d) * before + h * a[i]) / (1.0 + d)
                v[i] = 0.5 * (before + half[i])


@inlined
def viscous(s, q, v, w, row, eta, u, force, a, dw):
    """Accelerations and rates of w of the regularised law."""
    M = len(s.modes)
    moved(s, q, u)
    for c in range(len(s.pads)):
        k11, k12, k22, mu, kv, n0 = pad_row(s, c)
        n = max(n0 + kv * u[3 * c + 2], 0.0)
        d1, d2 = u[3 * c] - w[2 * c], u[3 * c + 1] - w[2 * c + 1]
        f1, f2 = k11 * d1 + k12 * d2, k12 * d1 + k22 * d2
        size = np.sqrt(f1 * f1 + f2 * f2)
        over = max(size - mu * n, 0.0) / (size * eta[c]) if size > 0.0 else 0.0
        dw[2 * c], dw[2 * c + 1] = over * f1, over * f2
        force[3 * c], force[3 * c + 1], force[3 * c + 2] = -f1, -f2, max(n0, 0.0) - n
    accelerations(s, q, force, row, a)
    for i in range(M):
        a[i] -= s.constant[M + i] * v[i]


@compiled
def run_regularised(s, q, v, w, eta, h, cycles, num_steps):
    M, C = len(s.modes), len(s.pads)
    u, force = np.zeros(3 * C), np.zeros(3 * C)
    x, y, z = q.copy(), v.copy(), w.copy()
    sum_q, sum_v, sum_w = np.zeros(M), np.zeros(M), np.zeros(2 * C)
    a, dw = np.zeros(M), np.zeros(2 * C)
    for _ in range(cycles):
        for k in range(num_steps):
            x[:], y[:], z[:] = q, v, w
            sum_q[:] = 0.0
            sum_v[:] = 0.0
            sum_w[:] = 0.0
            for j in range(4):
                row = 2 * k + (0 if j == 0 else (2 if j == 3 else 1))
                weight = h / 6.0 if j == 0 or j == 3 else h / 3.0
                ahead = 0.5 * h if j < 2 else h
                viscous(s, x, y, z, row, eta, u, force, a, dw)
                for i in range(M):
                    sum_q[i] += weight * y[i]
                    sum_v[i] += weight * a[i]
                    x[i], y[i] = q[i] + ahead * y[i], v[i] + ahead * a[i]
                for i in range(2 * C):
                    sum_w[i] += weight * dw[i]
                    z[i] = w[i] + ahead * dw[i]
            q += sum_q
            v += sum_v
            w += sum_w


def _begin(model: Model) -> tuple[np.ndarray, ...]:
    root, start = np.sqrt(model.structure.mass), model.start
    return start.displacement * root, start.velocity * root, start.slip.ravel().astype(float)


def _end(model: Model, q: np.ndarray, v: np.ndarray, w: np.ndarray, state: np.ndarray) -> Run:
    root = np.sqrt(model.structure.mass)
    return Run(q / root, v / root, w.reshape(-1, 2), state, 0, [])


def capture(
    model: Model, frequency: float, cycles: int, *, steps_per_cycle: int, constants: Scene | None = None
) -> Run:
    """Central differences with a return mapping; arguments as of `opponents.numba_rk4.simulate`."""
    s, (q, v, w) = constants or scene(model, steps_per_cycle), _begin(model)
    state = np.array(start_states(model), dtype=np.int64)
    run_capture(s, q, v, w, state, 1 / (frequency * steps_per_cycle), cycles, steps_per_cycle)
    return _end(model, q, v, w, state)


def regularised(
    model: Model, frequency: float, cycles: int, *, steps_per_cycle: int, constants: Scene | None = None
) -> Run:
    """RK4 through a viscous regularisation of slip; arguments as of `opponents.numba_rk4.simulate`."""
    s, (q, v, w) = constants or scene(model, steps_per_cycle), _begin(model)
    h = 1 / (frequency * steps_per_cycle)
    stiffness = [float(np.linalg.eigvalsh(c.tangential_stiffness)[-1]) for c in model.contacts]
    eta = VISCOSITY * h * np.where(np.array(stiffness) > 0, stiffness, 1.0)
    run_regularised(s, q, v, w, eta, h, cycles, steps_per_cycle)
    return _end(model, q, v, w, np.full(model.num_contacts, -1))
