"""Opponent: CVODE of SUNDIALS with its own rootfinding, restarted after each transition.

By scikit-sundae (`pip install scikit-sundae`), with right-hand side and guards compiled by numba: those of
`opponents.tsit5`, over the state (q, qdot, angle of slip).
"""

import numpy as np
from opponents.numba_contact import contact_motion, evaluate, keep_slip, switch
from opponents.numba_guard import GUARD, guards
from opponents.numba_rk4 import begin
from opponents.numba_system import columns, compiled, off_grid_load, scene, work
from opponents.tsit5 import lag, tolerances
from problems import Run
from sksundae.cvode import CVODE

from timesim.model.model import SLIP, Model


@compiled
def place(s, z, t, y, omega, floor):
    """The row of a state, evaluated."""
    o = columns(s.modes, s.pads)
    M = len(s.modes)
    for i in range(M):
        z.start[i], z.start[o.v + i] = y[i], y[M + i]
    contact_motion(s, z, z.start)
    for c in range(len(s.pads)):
        z.start[o.e + 2 * c], z.start[o.e + 2 * c + 1] = np.cos(y[2 * M + c]), np.sin(y[2 * M + c])
        z.start[o.tau + c] = z.start[o.turn + c] = 0.0
    off_grid_load(s, 1, s.phase + omega * t)
    evaluate(s, z, z.start, 1, floor)


@compiled
def rate(s, z, t, y, out, omega, floor):
    o = columns(s.modes, s.pads)
    M = len(s.modes)
    place(s, z, t, y, omega, floor)
    for i in range(M):
        out[i], out[M + i] = y[M + i], z.start[o.a + i]
    for c in range(len(s.pads)):
        out[2 * M + c] = 2.0 * z.start[o.turn + c] if z.state[c] == SLIP else 0.0


@compiled
def margins(s, z, t, y, out, omega, floor):
    o = columns(s.modes, s.pads)
    place(s, z, t, y, omega, floor)
    guards(s, z, z.start)
    for j in range(2 * len(s.pads)):
        out[j] = z.start[o.guard + j] + GUARD


@compiled
def cross(s, z, t, y, target, omega, floor):
    """Take a transition."""
    o = columns(s.modes, s.pads)
    place(s, z, t, y, omega, floor)
    guards(s, z, z.start)
    c = target // 2
    switch(s, z, z.start, c, target % 2 == 1)
    y[2 * len(s.modes) + c] = np.arctan2(z.start[o.e + 2 * c + 1], z.start[o.e + 2 * c])


@compiled
def finish(s, z, t, y, omega, floor):
    place(s, z, t, y, omega, floor)
    for c in range(len(s.pads)):
        keep_slip(s, z, z.start, c)


def simulate(model: Model, frequency: float, cycles: int, *, rtol: float, method: str = "Adams") -> Run:
    """Run `cycles` periods of the excitation from the start of the model, as `opponents.tsit5.simulate` does."""
    s, z = scene(model, 4), work(model, None, 0)
    m, num, omega, floor = model.structure.num_modes, model.num_contacts, 2 * np.pi * frequency, lag(frequency, rtol)
    begin(s, z, omega, floor)
    o = columns.py_func(s.modes, s.pads)
    y = np.concatenate([z.start[: 2 * m], np.arctan2(z.start[o.e + 1 : o.tau : 2], z.start[o.e : o.tau : 2])])
    atol = np.repeat([*tolerances(model, frequency, rtol)[:2], rtol], [m, m, num])

    def right(t: float, y: np.ndarray, yp: np.ndarray) -> None:
        rate(s, z, t, y, yp, omega, floor)

    def roots(t: float, y: np.ndarray, events: np.ndarray) -> None:
        margins(s, z, t, y, events, omega, floor)

    roots.terminal, roots.direction = [True] * 2 * num, [-1] * 2 * num  # type: ignore[attr-defined]
    options = {"rtol": rtol, "atol": atol, "max_step": 1 / (12 * frequency), "max_num_steps": 10**7}
    solver = CVODE(right, method=method, eventsfn=roots, num_events=2 * num, **options)
    t, end, count, values = 0.0, cycles / frequency, 0, np.empty(2 * num)
    while t < end:
        leg = solver.solve(np.array([t, end]), y)
        if not leg.success:
            raise RuntimeError(leg.message)
        t, y = float(leg.t[-1]), np.array(leg.y[-1])
        if leg.i_events is None or not len(leg.i_events):
            break
        target = int(np.flatnonzero(leg.i_events[-1])[0])
        for _ in range(50):
            cross(s, z, t, y, target, omega, floor)
            count += 1
            margins(s, z, t, y, values, omega, floor)
            target = int(np.argmin(values))
            if values[target] >= 0:
                break
    finish(s, z, t, y, omega, floor)
    root = np.sqrt(model.structure.mass)
    return Run(y[:m] / root, y[m : 2 * m] / root, z.pad[3 * num :].reshape(-1, 2), z.state, count, [])
