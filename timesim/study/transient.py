"""The studies `transient`, one run at one frequency, and `jump`, one through a schedule of frequencies.

What is recorded of them is the same (sections 5.2 and 5.3 of the paper).
"""

import timesim.runtime  # noqa: F401  isort: skip

import time
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from xarray import Dataset

from timesim.engine.contact_law import ContactLaw, Motion
from timesim.engine.history import CycleTotals, Events, Samples, Steps, events, sample, stored_energy
from timesim.engine.laws import law_class
from timesim.engine.trajectory import Phase, Run, RunError
from timesim.model.model import SEPARATION, Model
from timesim.model.scales import scales_of
from timesim.result.coordinate import coordinates
from timesim.result.dataset import dataset
from timesim.scene.resolution import Scene
from timesim.scene.transient import Schedule
from timesim.study.campaign import Execution, Progress
from timesim.study.outcome import Outcome, attributes

ROWS = 1024  # samples evaluated at a time: a fixed number, so that the law is compiled once

LISTED = 12  # phases at most that the summary of a run lists


class Recorder:
    """Takes up the steps of a run: samples of the recorded cycles, all transitions, totals of every cycle."""

    def __init__(self, run: Run, plan: Schedule):
        self.run, self.plan = run, plan
        now = (run.displacement, run.velocity, run.slip, run.state)
        self.totals = CycleTotals(run.model, float(stored_energy(run.model, *(part[None] for part in now))[0]))
        self.samples: list[Samples] = []
        self.events: list[Events] = []
        self.times = plan.sample_times()
        self.taken = 0

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
    law = law_class(model.contacts).of(model.contacts, scales)
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
def _force(law: ContactLaw, state: Any, x: Any, dx: Any, w: Any) -> Any:
    moves = Motion((x[..., 0], x[..., 1]), x[..., 2], (dx[..., 0], dx[..., 1]), dx[..., 2])
    acts = law.reaction(state, moves, (w[..., 0], w[..., 1]))
    return jnp.stack([*acts.f, acts.n], axis=-1)


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run a scene of a transient or a jump; the result is marked incomplete where the run ended early."""
    plan: Schedule = scene.plan
    run = Run(scene.model(), [Phase(*phase) for phase in plan.phases], scene.solver())
    run.time = float(plan.edges()[0])
    recorder = Recorder(run, plan)
    reason, seconds = follow(run, recorder, execution.progress)
    record = record_of(scene, run, recorder, seconds, reason)
    return Outcome({"": record}, reason, (*summary(run, record), *phase_summary(plan, record)))


def summary(run: Run, record: Dataset) -> Iterator[str]:
    """What a user wants to know of a run at once."""
    found = {str(name): array.values for name, array in record.data_vars.items()}
    count = record.attrs["run_seconds"]
    yield f"{run.completed} cycles by {run.solver} in {count:.2f} s, {found['event_time'].size} transitions"
    if run.completed:
        largest = max(np.max(np.abs(found["energy_input"])), record.attrs["peak_stored_energy"])
        residual = np.max(np.abs(found["energy_residual"])) / largest if largest > 0 else 0.0
        yield f"energy balance of a cycle closes to {residual:.1e} of the larger of input and stored energy"


def phase_summary(plan: Schedule, record: Dataset) -> Iterator[str]:
    """Of a schedule, the amplitude at the end of each phase of what moves most, unless the phases are too many."""
    amplitude = record["cycle_amplitude"].values
    if not 1 < len(plan.phases) <= LISTED or not amplitude.size:
        return
    _, point, axis = np.unravel_index(np.argmax(amplitude), amplitude.shape)
    name = f"{record['point'].values[point]} {record['axis'].values[axis]}"
    ends = np.cumsum([cycles for _, cycles in plan.phases])
    for number, ((frequency, cycles), end) in enumerate(zip(plan.phases, ends, strict=True), 1 - plan.run_up):
        if end <= len(amplitude):
            which = f"phase {number}" if number > 0 else "run-up"
            size = f"amplitude {amplitude[end - 1, point, axis]:.6g} of {name} at its end"
            yield f"{which}: {cycles} cycles at {frequency:.6g} Hz, {size}"


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


def record_of(scene: Scene, run: Run, recorder: Recorder, seconds: float, reason: str | None) -> Dataset:
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
        "cycle_frequency": (("cycle",), recorder.plan.cycle_frequency()[: len(totals.amplitude)]),
    }
    coords = {"time": samples.time} | coordinates(variables, model)
    told = attributes(scene, str(run.solver), run.compile_seconds, seconds, reason)
    return dataset(variables, coords, told | {"peak_stored_energy": totals.peak})


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
