"""Opponent: Tsit5 in numba with a controlled step and located transitions; and the same equations for CVODE.

The rows, guards and transitions of `opponents.numba_rk4`, with seven stages of Tsitouras (2011) in place of RK4 and a
step that the embedded error controls. The bound on the rate at which the direction of slip relaxes as n -> 0 follows
the tolerance, since what it leaves is of third order in it.
"""

from typing import NamedTuple

import numpy as np
from diffrax import Tsit5
from numba import njit
from opponents.numba_contact import contact_motion, evaluate, keep_slip, switch, turn_to
from opponents.numba_guard import GUARD, earliest, guards, refine
from opponents.numba_rk4 import (
    FAILURES,
    MAX_EVENTS_A_STEP,
    MAX_TRIALS,
    STUCK_IN_LOCATION,
    TOO_MANY_EVENTS,
    begin,
    keep_end,
    shift_end,
)
from opponents.numba_system import Scene, columns, compiled, inlined, off_grid_load, scene, work
from problems import Run

from timesim.model.model import SLIP, Model

LONGEST = 1 / 12  # of a period
TABLEAU = Tsit5.tableau
MATRIX = [np.zeros(1), *TABLEAU.a_lower]


def _weights(row: int) -> tuple[float, ...]:
    return tuple(float(x) for x in np.pad(MATRIX[row], (0, 6 - MATRIX[row].size)))


A2, A3, A4, A5, A6, A7 = (_weights(row) for row in range(1, 7))
NODES = tuple(float(x) for x in TABLEAU.c)
ERROR = tuple(float(x) for x in TABLEAU.b_error)


class Stages(NamedTuple):
    """What changes: rows by `Columns`, and the contacts as in `Work`."""

    start: np.ndarray
    end: np.ndarray
    second: np.ndarray
    third: np.ndarray
    fourth: np.ndarray
    fifth: np.ndarray
    sixth: np.ndarray
    pad: np.ndarray
    state: np.ndarray


# Products with the zeros of the tableau go away only where the compiler may take every number for finite.
blending = njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)


@blending
def blend(z, k, weights):
    early = weights[0] * z.start[k] + weights[1] * z.second[k] + weights[2] * z.third[k]
    return early + weights[3] * z.fourth[k] + weights[4] * z.fifth[k] + weights[5] * z.sixth[k]


@inlined
def stage(s, z, row, h, weights):
    o = columns(s.modes, s.pads)
    for i in range(len(s.modes)):
        row[i] = z.start[i] + h * blend(z, o.v + i, weights)
        row[o.v + i] = z.start[o.v + i] + h * blend(z, o.a + i, weights)
    for k in range(3 * len(s.pads)):
        row[o.u + k] = z.start[o.u + k] + h * blend(z, o.du + k, weights)
        row[o.du + k] = z.start[o.du + k] + h * blend(z, o.ddu + k, weights)
    for c in range(len(s.pads)):
        if z.state[c] == SLIP:
            turn_to(s, z, row, c, h * blend(z, o.turn + c, weights))


@compiled
def step(s, z, h, theta, omega, lag):
    """One step from `start` to `end`, with accelerations and guards there; loads are written to rows 1 to 6."""
    o = columns(s.modes, s.pads)
    for k in range(5):
        off_grid_load(s, k + 1, theta + omega * h * NODES[k])
    stage(s, z, z.second, h, A2)
    evaluate(s, z, z.second, 1, lag)
    stage(s, z, z.third, h, A3)
    evaluate(s, z, z.third, 2, lag)
    stage(s, z, z.fourth, h, A4)
    evaluate(s, z, z.fourth, 3, lag)
    stage(s, z, z.fifth, h, A5)
    evaluate(s, z, z.fifth, 4, lag)
    stage(s, z, z.sixth, h, A6)
    evaluate(s, z, z.sixth, 5, lag)
    stage(s, z, z.end, h, A7)
    for c in range(len(s.pads)):
        z.end[o.tau + c] = 0.0
    evaluate(s, z, z.end, 5, lag)
    guards(s, z, z.end)


@inlined
def embedded(z, k):
    return blend(z, k, ERROR) + ERROR[6] * z.end[k]


@compiled
def error(s, z, h, rtol, atol):
    """Largest error of the step by its tolerance: displacements, velocities and forces of slip."""
    o = columns(s.modes, s.pads)
    size_q = size_v = off_q = off_v = 0.0
    for i in range(len(s.modes)):
        size_q = max(size_q, abs(z.start[i]), abs(z.end[i]))
        size_v = max(size_v, abs(z.start[o.v + i]), abs(z.end[o.v + i]))
        off_q = max(off_q, abs(embedded(z, o.v + i)))
        off_v = max(off_v, abs(embedded(z, o.a + i)))
    worst = max(off_q / (atol[0] + rtol * size_q), off_v / (atol[1] + rtol * size_v))
    for c in range(len(s.pads)):
        if z.state[c] == SLIP:
            # The rate at the end is that of a turn which begins there, where half the angle has the tangent 0.
            tau = h * blend(z, o.turn + c, A7)
            turn = blend(z, o.turn + c, ERROR) + ERROR[6] * z.end[o.turn + c] * (1.0 + tau * tau)
            k = o.pad + 9 * c
            f1, f2 = z.pad[3 * c], z.pad[3 * c + 1]
            elastic = np.sqrt(f1 * f1 + f2 * f2) / s.constant[k] if s.constant[k] > 0.0 else 0.0
            size_u = abs(z.end[o.u + 3 * c]) + abs(z.end[o.u + 3 * c + 1]) + elastic
            worst = max(worst, 2.0 * abs(turn) * elastic / (atol[2] + rtol * size_u))
    return h * worst


@compiled
def locate(s, z, theta, omega, h, x, target, lag):
    """Shorten the step until it ends on the earliest guard: its length and the guard, -1 if none."""
    o = columns(s.modes, s.pads)
    low, high = 0.0, h
    only_dips = z.end[o.guard + target] >= -GUARD
    for _ in range(MAX_TRIALS):
        step(s, z, x, theta, omega, lag)
        there, target, beyond = refine(s, z, z.end, x, target)
        if only_dips and not beyond and z.end[o.slope + target] >= 0.0:
            return x, -1
        if abs(there - x) <= 1e-13 / omega or (x == 0.0 and beyond) or high - low <= 1e-13 / omega:
            return x, target
        if abs(there - x) <= 1e-7 / omega and there > 0.0:
            off_grid_load(s, 5, theta + omega * there)
            shift_end(s, z, there - x)
            evaluate(s, z, z.end, 5, lag)
            guards(s, z, z.end)
            return there, target
        if beyond:
            high = x
        else:
            low = x
        x = there if low < there < high else (0.0 if there <= 0.0 and low == 0.0 else 0.5 * (low + high))
    return x, -2


@compiled
def run_adaptive(s, z, frequency, cycles, rtol, atol, lag):
    """From the state in `start`: number of events, or a failure below 0, and of steps tried."""
    omega, end = 2.0 * np.pi * frequency, cycles / frequency
    t, h, longest = 0.0, 0.002 / frequency, LONGEST / frequency
    num_events, num_steps, at_once = 0, 0, 0
    begin(s, z, omega, lag)
    while t < end:
        h = min(h, longest)
        last = t + h >= end
        taken = end - t if last else h
        theta = s.phase + omega * t
        step(s, z, taken, theta, omega, lag)
        num_steps += 1
        off = error(s, z, taken, rtol, atol)
        factor = 0.9 * off**-0.2 if off > 0.0 else 5.0
        if not off <= 1.0:
            h = taken * max(0.2, min(factor, 0.9)) if off > 1.0 else 0.2 * taken
            if h * omega < 1e-14 * (1.0 + omega * t):
                return STUCK_IN_LOCATION, num_steps
            continue
        x, target = earliest(s, z, taken)
        if target >= 0:
            x, target = locate(s, z, theta, omega, taken, x, target, lag)
            last = False
            if target < -1:
                return STUCK_IN_LOCATION, num_steps
        else:
            x = taken
            h = taken * min(5.0, factor)
        keep_end(s, z)
        t = end if last else t + x
        at_once = at_once + 1 if x == 0.0 else 0
        if at_once > MAX_EVENTS_A_STEP:
            return TOO_MANY_EVENTS, num_steps
        if target >= 0:
            switch(s, z, z.start, target // 2, target % 2 == 1)
            num_events += 1
            contact_motion(s, z, z.start)
            evaluate(s, z, z.start, 5, lag)
            guards(s, z, z.start)
    for c in range(len(s.pads)):
        keep_slip(s, z, z.start, c)
    return num_events, num_steps


def simulate(model: Model, frequency: float, cycles: int, *, rtol: float, constants: Scene | None = None) -> Run:
    """Run `cycles` periods of the excitation from the start of the model.

    Args:
        model: the scene.
        frequency: of the excitation [Hz].
        cycles: number of periods.
        rtol: relative tolerance; the absolute one is a hundredth of it times the static deflection.
        constants: `scene(model, 4)` where it is at hand.
    """
    s, old = constants or scene(model, 4), work(model, None, 0)
    z = Stages(
        old.start, old.end, old.second, old.third, old.fourth, *np.zeros((2, old.start.size)), old.pad, old.state
    )
    num_events, _ = run_adaptive(
        s, z, frequency, cycles, rtol, tolerances(model, frequency, rtol), lag(frequency, rtol)
    )
    if num_events < 0:
        raise RuntimeError(FAILURES[num_events])
    root, m = np.sqrt(model.structure.mass), model.structure.num_modes
    slip = z.pad[3 * model.num_contacts :].reshape(-1, 2)
    return Run(z.start[:m] / root, z.start[m : 2 * m] / root, slip, z.state, num_events, [])


def lag(frequency: float, rtol: float) -> float:
    """Shortest time that the direction of slip takes, times `RELAX`."""
    return float(np.cbrt(0.1 * rtol)) / frequency


def tolerances(model: Model, frequency: float, rtol: float) -> np.ndarray:
    """Absolute tolerances of displacements, velocities and the motion of contacts; modes normalised to unit mass."""
    s, x = model.structure, model.excitation
    load = np.abs(x.cosine).sum(0) + np.abs(x.sine).sum(0) + np.abs(x.constant)
    reach = float((load / s.stiffness * np.sqrt(s.mass)).max()) or 1.0
    across = float((np.abs(model.contact_shape) @ (load / s.stiffness)).max(initial=0.0)) or 1.0
    return 1e-2 * rtol * np.array([reach, reach * 2 * np.pi * frequency, across])
