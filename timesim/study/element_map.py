"""The `element_map` study: Fourier coefficients of a contact over two of its parameters (figures 7 and 8 of the paper).

Every pair of values is a contact of its own in the event loop, under the prescribed motion. All are marched cycle by
cycle, in batches of similar stiffness on all cores, until the cycle repeats; those that creep are extrapolated to their
limit.
"""

import timesim.runtime  # noqa: F401  isort: skip

import time
from functools import partial

import jax
import numpy as np

from timesim.element.cycle import JUDGED, WITHDRAWN, beyond, in_phase
from timesim.element.elements import Elements, harmonic_elements
from timesim.element.prescribed import CycleEnd, PrescribedContacts, cycle_end, drive_of, march_cycle
from timesim.engine.method import step_method
from timesim.engine.solver import step_control
from timesim.engine.status import Status
from timesim.model.contact_state import require_cone
from timesim.model.model import SEPARATION, SLIP
from timesim.model.solver import Solver
from timesim.orbit.extrapolation import limits, remaining
from timesim.result.dataset import dataset
from timesim.result.label import counted
from timesim.scene.element import MAP_AXES, MapPlan
from timesim.scene.resolution import Scene
from timesim.study.execution.campaign import INTERRUPTED, Execution
from timesim.study.execution.progress import Progress, unwatched
from timesim.study.execution.worker import threads
from timesim.study.outcome import Outcome, attributes, took

BATCH = 256
MAX_CYCLES = 300
# Change of f from cycle to cycle, relative to the largest mu n, that ends the march, as a share of the solver's rtol.
SETTLED = 0.1
# Work of slip in a cycle, relative to the largest mu n and the motion, up to which a contact all but sticks: of what
# steps have erred by across the slip, 1e-9 and more, a cycle takes back no larger share.
ALMOST_STUCK = 1e-5
# Ends of cycles from which a limit is extrapolated.
HISTORY = 6
ADVICE = {
    Status.BUDGET: "Raise solver.max_steps",
    Status.TOO_SHORT: "Try a larger solver.rtol, or a less stiff contact",
    Status.ZENO: "Try a softer contact, or solver.accuracy: reference",
    Status.NOT_FINITE: "Check the values of the map, and try a smaller solver.rtol",
}
"""What to try for one contact without modes; `Status` has that for structures."""


class MapMarch:
    """N elements on their way to a steady cycle.

    Attributes:
        result: the present results, by the names of the result file: the coefficients of (19), shape (N, 2) [force],
            the dissipation [force length], the transitions in the cycle, the cycles marched, whether it repeats, and
            whether it sticks throughout, or all but, so that w, and with it f_b, may keep another offset.
        status: `Status` at the end of the last cycle, shape (N,).
    """

    def __init__(self, elements: Elements, phase: np.ndarray, solver: Solver):
        self.elements, self.phase = elements, phase
        self.dynamics = PrescribedContacts(elements.law(), drive_of(elements))
        self.method, self.control = step_method(solver), step_control(solver, 1.0)
        self.tolerance = SETTLED * solver.rtol
        count = elements.size
        self.slip, self.state = elements.start[:, :2].copy(), elements.start_state.copy()
        self.forces = np.full((count, 4, 2), np.nan)
        self.forces[:, -1] = elements.start_force(self.slip, self.state)
        self.since, self.status = np.zeros(count, dtype=int), np.full(count, Status.RUNNING)
        pair = np.full((count, 2), np.nan)
        # Of the last leap: the friction force and the state before it, and the change of the force.
        self.origin, self.origin_state, self.way = pair.copy(), self.state.copy(), pair.copy()
        self.result: dict[str, np.ndarray] = {name: pair.copy() for name in ("f_b", "f_s", "f_c")}
        self.result["dissipation"] = np.full(count, np.nan)
        self.result |= {name: np.zeros(count, dtype=int) for name in ("transitions", "cycles")}
        self.result |= {name: np.zeros(count, dtype=bool) for name in ("settled", "offset_free")}

    def run(self, progress: Progress = unwatched, max_cycles: int = MAX_CYCLES) -> dict[str, np.ndarray]:
        """March until every cycle repeats, at most `max_cycles` cycles."""
        # The stiffness relative to the least limit of friction sets the steps; elements alike in it share a batch.
        stiffness = np.linalg.norm(self.elements.stiffness, axis=(1, 2))
        load = np.maximum(self.elements.least_load * self.elements.friction, 0.02)
        waiting = np.argsort(stiffness / load)
        done = self.elements.size
        with threads() as pool:
            for cycle in range(1, max_cycles + 1):
                batches = [waiting[i : i + BATCH] for i in range(0, waiting.size, BATCH)]
                keep: list[np.ndarray] = []
                for batch, kept in zip(batches, pool.map(partial(self._cycle, cycle), batches), strict=True):
                    keep.append(batch[kept])
                    on, ahead = sum(map(len, keep)), waiting.size - min(len(keep) * BATCH, waiting.size)
                    # A point on its way counts by the cycles behind it: most need a few, and none shows any before.
                    share = int(done - on / (cycle + 1) - ahead / cycle)
                    progress(share, done, f"cycle {cycle}, {on + ahead} of {done} points to settle")
                waiting = np.concatenate(keep)
                if not waiting.size:
                    break
        return self.result

    def _cycle(self, cycle: int, rows: np.ndarray) -> np.ndarray:
        """March a batch by one cycle, and return which of its elements must go on."""
        full = np.concatenate([rows, np.repeat(rows[:1], BATCH - rows.size)])
        dynamics = jax.tree.map(lambda leaf: leaf[full], self.dynamics)
        slip, state = tuple(self.slip[full].T), self.state[full]
        done = march_cycle(self.method, self.control, dynamics, slip, state)
        end, count = jax.tree.map(lambda leaf: np.asarray(leaf)[: rows.size], done)
        reached = cycle_end(self.elements.pick(rows), end)
        self._take(cycle, rows, reached, count)
        return self._judge(rows, reached)

    def _take(self, cycle: int, rows: np.ndarray, reached: CycleEnd, count: np.ndarray) -> None:
        """Write the results of a cycle."""
        result, good, self.status[rows] = self.result, reached.good, reached.status
        forces = (reached.mean, *in_phase(reached.first, self.phase[rows]))
        for name, values in zip(("f_b", "f_s", "f_c"), forces, strict=True):
            result[name][rows] = np.where(good[:, None], values, np.nan)
        result["dissipation"][rows] = np.where(good, reached.dissipation, np.nan)
        result["transitions"][rows], result["cycles"][rows] = count, cycle

    def _judge(self, rows: np.ndarray, reached: CycleEnd) -> np.ndarray:
        """Take over the state after a cycle, extrapolated where it has a limit; return which elements must go on."""
        elements = self.elements.pick(rows)
        force = elements.start_force(reached.slip, reached.state)
        history = np.concatenate([self.forces[rows, 1:], force[:, None]], axis=1)
        change = np.hypot(*np.moveaxis(np.diff(history, axis=1), -1, 0))
        same = (reached.state == self.state[rows]) | (change[:, -2] <= self.tolerance)
        before = np.where(np.isfinite(change[:, -2]), change[:, -2], np.inf)
        ratio = change[:, -1] / np.where(before > 0, before, np.inf)
        left = np.maximum(remaining(change[:, -1], ratio), change[:, -1])
        rounding = change[:, -1] <= 1e-13
        settled = same & (rounding | (left <= self.tolerance)) & reached.good
        self.slip[rows], self.state[rows] = reached.slip, reached.state
        self.forces[rows], self.since[rows] = history, self.since[rows] + 1
        far = (np.linalg.norm(self.way[rows], axis=1) > self.tolerance) & reached.good
        back = far & (self.since[rows] == JUDGED) & beyond(self.way[rows], history[:, -1] - history[:, -2])
        settled &= ~back & ~(far & (self.since[rows] < JUDGED))
        self.result["settled"][rows] = settled
        self.result["offset_free"][rows] = settled & self._sticks(rows, reached)
        self.way[rows[back]] *= WITHDRAWN
        self._move(rows[back])
        self._leap(rows[~settled & ~back & (self.since[rows] >= HISTORY) & (reached.state != SEPARATION)])
        return ~settled & reached.good

    def _sticks(self, rows: np.ndarray, reached: CycleEnd) -> np.ndarray:
        """Which never separate and all but stick: the errors of the steps decide where on the border f_b ends."""
        elements = self.elements.pick(rows)
        work = reached.dissipation / (elements.length * elements.force)
        return (elements.least_load > 0) & (elements.friction > 0) & (work <= ALMOST_STUCK)

    def _leap(self, rows: np.ndarray) -> None:
        """Set the friction force at θ = 0 to the limit extrapolated from its last changes."""
        limit, leads = limits(self.forces[rows])
        rows, limit = rows[leads], limit[leads]
        self.origin[rows], self.origin_state[rows] = self.forces[rows, -1], self.state[rows]
        self.way[rows] = limit - self.origin[rows]
        self._move(rows)

    def _move(self, rows: np.ndarray) -> None:
        """Set the friction force at θ = 0 to the end of the last leap, of the size mu n in slip, else at most that."""
        force, self.state[rows] = self.origin[rows] + self.way[rows], self.origin_state[rows]
        elements = self.elements.pick(rows)
        load = elements.friction * (elements.preload + elements.normal_stiffness * elements.start[:, 2])
        share = np.hypot(*force.T) / load
        force /= np.where(self.state[rows] == SLIP, share, np.maximum(share, 1.0))[:, None]
        elastic = np.linalg.solve(elements.stiffness, force[..., None])[..., 0]
        self.slip[rows] = elements.start[:, :2] - elastic
        self.forces[rows] = np.nan
        self.forces[rows, -1], self.since[rows] = force, 0


def elements_of(plan: MapPlan) -> tuple[Elements, np.ndarray]:
    """All points of the map, the second axis fastest, and the phases of u1 and u2 there, shape (N, 2) [rad]."""
    require_cone([plan.contact], "prescribed motion")
    keys = (*plan.axes, *(key for key in plan.values if key not in plan.axes))  # the others have one value each
    grid = np.meshgrid(*(plan.values[key] for key in keys), indexing="ij")
    value = {key: values.ravel() for key, values in zip(keys, grid, strict=True)}
    phi, psi = (np.deg2rad(value[key]) for key in ("phi_deg", "psi_deg"))
    phasor = np.stack([value["A"] + 0j, value["B"] * np.exp(1j * phi), value["D"] * np.exp(1j * psi)], axis=1)
    numbers = (value["friction"], value["normal_stiffness"], value["preload"])
    phase = np.stack([np.zeros_like(phi), phi], axis=1)
    return harmonic_elements(*numbers, plan.contact.tangential_stiffness, phasor), phase


def _failure(march: MapMarch, plan: MapPlan, solver: Solver) -> str | None:
    """How many points failed, why and where the first of them did, and what to try; None if none did."""
    failed = np.flatnonzero(march.status != Status.RUNNING)
    if not failed.size:
        return None
    status = Status(march.status[failed[0]])
    place = np.unravel_index(failed[0], [len(plan.values[key]) for key in plan.axes])
    where = ", ".join(f"{key} = {plan.values[key][i]:.6g}" for key, i in zip(plan.axes, place, strict=True))
    alike = counted(int(np.sum(march.status == status)), "point")
    why = f"{status.reason.format(budget=solver.budget)} ({alike}, the first at {where})"
    of_all = f"{failed.size} of {counted(march.elements.size, 'point')}"
    return f"the event loop ended early at {of_all}, NaN in the result: {why}. {ADVICE[status]}"


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run an element_map scene; the result is incomplete if it was interrupted or the event loop ended early."""
    plan: MapPlan = scene.plan
    solver, (elements, phase) = scene.solver(), elements_of(plan)
    clock = time.perf_counter()
    MapMarch(elements.pick(np.arange(1)), phase[:1], solver).run(max_cycles=1)
    compiled = time.perf_counter()
    march, reason = MapMarch(elements, phase, solver), None
    result = march.result
    try:
        execution.progress(0, elements.size)
        march.run(execution.progress)
    except KeyboardInterrupt:
        if np.any(~result["settled"] & (march.status == Status.RUNNING)):  # else it came behind the last cycle
            of_all = f"{np.sum(~result['settled'])} of {counted(elements.size, 'point')}"
            reason = f"{INTERRUPTED} with {of_all} unsettled (settled = 0)"
    seconds = time.perf_counter() - compiled
    reason = reason or _failure(march, plan, solver)
    lost = np.isnan(result["dissipation"])
    creeping = int(np.sum(~result["settled"] & ~lost & (result["cycles"] == MAX_CYCLES)))
    stuck, taken = int(np.sum(result["offset_free"])), result["cycles"][result["settled"]]
    coords = {MAP_AXES[key]: np.array(plan.values[key]) for key in plan.axes}
    variables = {
        name: ((*coords, "tangent")[: 1 + array.ndim], array.reshape(*map(len, coords.values()), *array.shape[1:]))
        for name, array in result.items()
    }
    about = attributes(scene, str(solver), compiled - clock, seconds, reason)
    record = dataset(variables, coords, about | {"contact": plan.contact.name})
    lines = [f"{counted(elements.size, 'point')} by {solver} {took(about)}"]
    if taken.size:
        lines.append(f"cycles to the steady one: {np.median(taken):.0f} in the median, {taken.max()} at most")
    if creeping:
        lines.append(f"{counted(creeping, 'point')} still creeping after {MAX_CYCLES} cycles (settled = 0)")
    if stuck:
        free = "f_b there depends on the start, here f = 0"
        lines.append(f"{counted(stuck, 'point')} in full stick, or all but: {free}")
    return Outcome({"": record}, reason, tuple(lines))
