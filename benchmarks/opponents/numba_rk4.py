"""Opponent: a hand-written serial RK4 in numba with a fixed grid and located transitions, in Nystrom form.

A step in which a guard is crossed ends on it: the cubic's root first, then Newton in a bracket; the last correction,
below 1e-7 of a step, is made without an RK4 step.
"""

from typing import NamedTuple

import numpy as np
from opponents.numba_contact import contact_motion, evaluate, keep_slip, start_slip, switch, turn_to
from opponents.numba_guard import GUARD, cubic, earliest, guards, refine
from opponents.numba_system import Scene, Work, columns, compiled, inlined, off_grid_load, scene, work
from problems import Event, Run

from timesim.model.model import SEPARATION, SLIP, STICK, Model

MAX_TRIALS = 80
MAX_EVENTS_A_STEP = 500
STUCK_IN_LOCATION, TOO_MANY_EVENTS = -1, -2
FAILURES = {
    STUCK_IN_LOCATION: "a transition was not located",
    TOO_MANY_EVENTS: "too many transitions in a step",
}


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
