"""Opponent: `solve_ivp` as most people write it: one right-hand side with if and else, a longest step, no events.

The state is (q, qdot, w). Which state a contact is in follows at every call from the numbers at hand, so the right-hand
side jumps wherever a contact stops slipping, and has a kink wherever it starts to or separates.
"""

import numpy as np
from problems import Run
from scipy.integrate import solve_ivp

from timesim.model.model import SEPARATION, SLIP, STICK, Contact, Model


def friction(contact: Contact, move: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, int]:
    """Friction force and normal load on body 2, rate of w, and the state that these are of."""
    u, v, du, dv = move[:2], move[2], move[3:5], move[5]
    mu, K = contact.friction, contact.tangential_stiffness
    n = contact.preload + contact.normal_stiffness * v
    if n <= 0:
        return np.zeros(2), 0.0, du, SEPARATION
    f = K @ (u - w)
    size = float(np.hypot(*f))
    if mu == 0:
        return np.zeros(2), n, du, SLIP
    if size < mu * n:
        return f, n, np.zeros(2), STICK
    e = f / size
    speed = (e @ K @ du - mu * contact.normal_stiffness * dv) / (e @ K @ e)
    if speed <= 0:
        return f, n, np.zeros(2), STICK
    return mu * n * e, n, speed * e, SLIP


def simulate(model: Model, frequency: float, cycles: int, *, method: str, rtol: float, steps_per_cycle: float) -> Run:
    """Run `cycles` periods of the excitation from the start of the model, as `opponents.scipy_events.simulate` does."""
    s, x, start = model.structure, model.excitation, model.start
    m, omega = s.num_modes, 2 * np.pi * frequency
    damping = s.damping if s.damping.ndim == 2 else np.diag(s.damping)
    shape = model.contact_shape

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        q, v, w = y[:m], y[m : 2 * m], y[2 * m :].reshape(-1, 2)
        theta = x.harmonic * (omega * t + start.phase)
        p = np.cos(theta) @ x.cosine + np.sin(theta) @ x.sine + x.constant - damping @ v - s.stiffness * q
        moves = np.concatenate([shape @ q, shape @ v], axis=1)
        dw = np.empty_like(w)
        for c, contact in enumerate(model.contacts):
            f, n, dw[c], _ = friction(contact, moves[c], w[c])
            p -= shape[c].T @ np.array([*f, n - max(contact.preload, 0.0)])
        return np.concatenate([v, p / s.mass, dw.ravel()])

    y = np.concatenate([start.displacement, start.velocity, start.slip.ravel()])
    load = np.abs(x.cosine).sum(0) + np.abs(x.sine).sum(0) + np.abs(x.constant)
    reach = float((load / s.stiffness).max()) or 1.0
    across = float((np.abs(shape) @ (load / s.stiffness)).max(initial=0.0)) or 1.0
    atol = 1e-2 * rtol * np.repeat([reach, reach * omega, across], [m, m, 2 * model.num_contacts])
    longest = 1 / frequency / steps_per_cycle
    end = solve_ivp(rate, (0, cycles / frequency), y, method=method, rtol=rtol, atol=atol, max_step=longest).y[:, -1]
    moves = np.concatenate([shape @ end[:m], shape @ end[m : 2 * m]], axis=1)
    w = end[2 * m :].reshape(-1, 2)
    state = [friction(contact, moves[c], w[c])[3] for c, contact in enumerate(model.contacts)]
    return Run(end[:m], end[m : 2 * m], w, np.array(state), 0, [])
