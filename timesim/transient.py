"""The `transient` study: one run at one frequency, and what is recorded of it (section 5.2 of the paper)."""

import timesim.jax_setup  # noqa: F401  isort: skip

import time
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from timesim import store
from timesim.config import Scene
from timesim.contact import Motion, reaction
from timesim.history import CycleTotals, Events, Samples, Steps, events, sample, stored_energy
from timesim.model import SEPARATION, Model
from timesim.solver import solver_of
from timesim.study import Outcome, Progress, attributes
from timesim.study_section import Transient
from timesim.system import contact_law, scales_of
from timesim.trajectory import Phase, Run, RunError

ROWS = 1024  # samples evaluated at a time: a fixed number, so that the law is compiled once


class Recorder:
    """Takes up the steps of a run: samples of the recorded cycles, all transitions, totals of every cycle."""

    def __init__(self, run: Run, samples_per_cycle: int, first_recorded: int):
        self.run, self.first = run, first_recorded
        self.samples_per_cycle = samples_per_cycle
        now = (run.displacement, run.velocity, run.slip, run.state)
        self.totals = CycleTotals(run.model, float(stored_energy(run.model, *(part[None] for part in now))[0]))
        self.samples: list[Samples] = []
        self.events: list[Events] = []
        self.times = self._grid()
        self.taken = 0

    def _grid(self) -> np.ndarray:
        """Times of the samples, both ends of the recorded cycles included."""
        start, cycle, grid = 0.0, 0, []
        for phase in self.run.phases:
            skipped = min(max(self.first - cycle, 0), phase.cycles)
            count = (phase.cycles - skipped) * self.samples_per_cycle
            ticks = skipped * self.samples_per_cycle + np.arange(count)
            grid.append(start + ticks / (phase.frequency * self.samples_per_cycle))
            start, cycle = start + phase.cycles / phase.frequency, cycle + phase.cycles
        return np.concatenate([*grid, [start]])

    def add(self, steps: Steps) -> None:
        """Take up a batch of steps."""
        if steps.time.size == 0:
            return
        self.totals.add(steps, self.run.completed)
        self.events.append(events(steps))
        end = steps.time[-1] + steps.h[-1]
        finished = self.run.completed == self.run.num_cycles
        upto = self.times.size if finished else int(np.searchsorted(self.times, end * (1 - 1e-13), side="left"))
        if upto > self.taken:
            self.samples.append(sample(steps, self.times[self.taken : upto]))
            self.taken = upto

    def joined_samples(self) -> Samples:
        """All samples."""
        return _joined(Samples, self.samples, self.run.model)

    def joined_events(self) -> Events:
        """All transitions."""
        return _joined(Events, self.events, self.run.model)


def _joined(kind: Any, parts: Sequence[Any], model: Model) -> Any:
    """One record from many; with none, an empty one."""
    if not parts:
        m, c = model.structure.num_modes, model.num_contacts
        shapes = {"q": (0, m), "p": (0, m), "w": (0, c, 2), "state": (0, c)}
        return kind(**{name: np.zeros(shapes.get(name, (0,))) for name in kind.__dataclass_fields__})
    return kind(*(np.concatenate([getattr(part, name) for part in parts]) for name in kind.__dataclass_fields__))


def contact_forces(model: Model, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Force (f1, f2, n) on the contacts and their relative motion (u1, u2, v), each of shape (N, C, 3)."""
    x, dx = (np.einsum("cam,nm->nca", model.contact_shape, y) for y in (samples.q, samples.p))
    if not model.contacts:
        return x, x
    scales = scales_of(model, 1.0)
    law = contact_law(model, scales)
    force = np.zeros_like(x)
    for begin in range(0, x.shape[0], ROWS):
        rows = slice(begin, begin + ROWS)
        parts = (
            x[rows] / scales.length,
            dx[rows] / (scales.length * scales.omega),
            samples.w[rows] / scales.length,
        )
        missing = ROWS - parts[0].shape[0]
        padded = [np.pad(part, ((0, missing), (0, 0), (0, 0))) for part in parts]
        state = np.pad(samples.state[rows], ((0, missing), (0, 0)))
        force[rows] = np.asarray(_force(law, state, *padded))[: ROWS - missing] * scales.force
    return force, x


@jax.jit
def _force(law: Any, state: Any, x: Any, dx: Any, w: Any) -> Any:
    moves = Motion((x[..., 0], x[..., 1]), x[..., 2], (dx[..., 0], dx[..., 1]), dx[..., 2])
    acts = reaction(law, state, moves, (w[..., 0], w[..., 1]))
    return jnp.stack([*acts.f, acts.n], axis=-1)


def study(scene: Scene, progress: Progress | None = None) -> Outcome:
    """Run a transient scene; the result is marked incomplete where the run ended early."""
    plan = scene.file.study
    assert isinstance(plan, Transient)
    frequency = scene.model().excitation.frequency
    assert frequency is not None
    run = Run(scene.model(), [Phase(frequency, plan.cycles)], solver_of(scene.file.solver))
    assert plan.record_last is not None
    recorder = Recorder(run, plan.samples_per_cycle, plan.cycles - plan.record_last)
    reason, seconds = follow(run, recorder, progress)
    record = record_of(scene, run, recorder, seconds, reason)
    return Outcome({"": record}, reason, tuple(summary(run, record)))


def summary(run: Run, record: store.Record) -> Iterator[str]:
    """What a user wants to know of a run at once."""
    found = {name: array for name, (_, array) in record.variables.items()}
    count = record.attrs["run_seconds"]
    yield f"{run.completed} cycles by {run.solver} in {count:.2f} s, {found['event_time'].size} transitions"
    if run.completed:
        largest = max(np.max(np.abs(found["energy_input"])), record.attrs["peak_stored_energy"])
        residual = np.max(np.abs(found["energy_residual"])) / largest if largest > 0 else 0.0
        yield f"energy balance of a cycle closes to {residual:.1e} of the larger of input and stored energy"


def follow(run: Run, recorder: Recorder, progress: Progress | None) -> tuple[str | None, float]:
    """Advance a run to its end; why it ended early, if it did, and the seconds that it took."""
    clock = time.perf_counter()
    reason = None
    try:
        for steps in run.batches():
            recorder.add(steps)
            if progress is not None:
                progress(run.completed, run.num_cycles)
    except RunError as error:
        reason = str(error)
    except KeyboardInterrupt:
        reason = f"interrupted in cycle {run.completed + 1} of {run.num_cycles}"
    return reason, time.perf_counter() - clock


def record_of(scene: Scene, run: Run, recorder: Recorder, seconds: float, reason: str | None) -> store.Record:
    """The result file of a run."""
    model = run.model
    samples, log, totals = recorder.joined_samples(), recorder.joined_events(), recorder.totals
    force, motion = contact_forces(model, samples)
    shape = model.structure.shape
    free = (samples.state == SEPARATION) | np.array([c.friction == 0 for c in model.contacts], dtype=bool)
    variables = {
        "displacement": (("time", "point", "axis"), np.einsum("pam,nm->npa", shape, samples.q)),
        "velocity": (("time", "point", "axis"), np.einsum("pam,nm->npa", shape, samples.p)),
        "modal_displacement": (("time", "mode"), samples.q),
        "modal_velocity": (("time", "mode"), samples.p),
        "contact_force": (("time", "contact", "component"), force),
        "contact_displacement": (("time", "contact", "component"), motion),
        "contact_state": (("time", "contact"), samples.state.astype(np.int8)),
        "slip": (("time", "contact", "tangent"), np.where(free[..., None], motion[..., :2], samples.w)),
        "event_time": (("event",), log.time),
        "event_contact": (("event",), log.contact.astype(np.int32)),
        "event_from": (("event",), log.before.astype(np.int8)),
        "event_to": (("event",), log.after.astype(np.int8)),
        **final_variables(run),
        **cycle_variables(run, totals),
    }
    coords = {
        "time": samples.time,
        "point": np.array(model.structure.points),
        "axis": np.array(["x", "y", "z"]),
        "mode": np.arange(1, model.structure.num_modes + 1),
        "contact": np.array([contact.name for contact in model.contacts], dtype=str),
        "component": np.array(["t1", "t2", "n"]),
        "tangent": np.array(["t1", "t2"]),
        "cycle": np.arange(1, len(totals.amplitude) + 1),
    }
    told = attributes(scene, str(run.solver), run.compile_seconds, seconds, reason)
    return store.record(variables, coords, told | {"peak_stored_energy": totals.peak})


def final_variables(run: Run) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """State at the very end, from which another run may start."""
    model = run.model
    u = np.einsum("cam,m->ca", model.contact_shape[:, :2], run.displacement)
    free = (run.state == SEPARATION) | np.array([c.friction == 0 for c in model.contacts], dtype=bool)
    return {
        "final_modal_displacement": (("mode",), run.displacement),
        "final_modal_velocity": (("mode",), run.velocity),
        "final_slip": (("contact", "tangent"), np.where(free[:, None], u, run.slip)),
        "final_contact_state": (("contact",), run.state.astype(np.int8)),
        "final_phase_deg": ((), np.array(np.rad2deg(run.phase) % 360.0)),
    }


def cycle_variables(run: Run, totals: CycleTotals) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Amplitude and energies of each cycle; every term is the integral of its own force."""
    model, count = run.model, len(totals.amplitude)
    work = np.diff(np.array([np.zeros(2 + model.num_contacts), *totals.work]), axis=0)
    stored = np.diff(np.array([totals.initial, *totals.stored]))
    friction = work[:, 2:]
    amplitude = np.array(totals.amplitude).reshape(count, len(model.structure.points), 3)
    return {
        "cycle_amplitude": (("cycle", "point", "axis"), amplitude),
        "cycle_start": (("cycle",), np.array(totals.start[:count])),
        "cycle_period": (("cycle",), np.array(totals.end) - np.array(totals.start[:count])),
        "energy_input": (("cycle",), work[:, 0]),
        "energy_damping": (("cycle",), work[:, 1]),
        "energy_friction": (("cycle", "contact"), friction),
        "energy_stored_change": (("cycle",), stored),
        "energy_residual": (("cycle",), work[:, 0] - work[:, 1] - friction.sum(axis=1) - stored),
    }
