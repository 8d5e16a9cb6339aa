"""The studies `transient`, one run at one frequency, and `jump`, one run through a schedule of frequencies.

Both record the same (sections 5.2 and 5.3 of the paper).
"""

import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from xarray import Dataset

from timesim.engine.companion import Companion, Estimate, compared, estimate, rounding, unknown
from timesim.engine.status import RunError, Status
from timesim.engine.trajectory import Phase, Run
from timesim.model.choice import TABLE
from timesim.model.contact_state import slip_follows_motion
from timesim.model.cost import EXPLICIT
from timesim.model.promise import AMPLIFIED, CLOSE, MARGIN, tightened
from timesim.model.solver import COMPANION, Solver
from timesim.result.dataset import Arrays, dataset
from timesim.result.label import counted
from timesim.scene.resolution import Scene
from timesim.scene.transient import Schedule
from timesim.study.execution.campaign import Execution
from timesim.study.execution.interrupts import Interrupts
from timesim.study.outcome import Outcome, attributes
from timesim.study.recorder import Recorder, contact_forces
from timesim.study.summary.effort import effort_lines
from timesim.study.summary.transient import drift_lines, transient_lines

SLIPPERY = next(line.largest for line in TABLE if line.method == "exponential")
"""Tolerance from which on collocation begins a run anew: most often slip spends the budget."""
BUDGET = Solver.budget
"""Steps of a cycle unless the scene asks for others: those are its own bound, at which its run ends."""
REPETITIONS = 2
"""Of a run that errs more than promised: the first estimate may be far off if errors are not proportional yet."""


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run a scene of a transient or a jump; the result is marked incomplete where the run ended early.

    Where a method that was chosen, not given, spends its budget of explicit steps, the run begins anew by collocation.
    Where the estimated error is above what the accuracy promises, it is repeated with tighter tolerances.
    """
    with Interrupts() as interrupts:
        return _study(scene, replace(execution, progress=interrupts.raised_by(execution.progress)))


def _study(scene: Scene, execution: Execution) -> Outcome:
    clock = time.perf_counter()
    promise, lines, more = scene.promise or np.inf, list[str](), dict[str, str]()
    done = _carried(scene, scene.solver(), execution)
    spent = done.recorder.run.status == Status.BUDGET and done.solver.budget == BUDGET
    if scene.choice is not None and done.solver.name in EXPLICIT and spent:
        instead = replace(tightened(done.solver, SLIPPERY / done.solver.rtol), name="exponential")
        where = f"{BUDGET} steps a cycle are spent in cycle {done.recorder.run.completed + 1}"
        lines.append(f"by {done.solver} the {where}: begun anew by {instead}")
        done = _carried(scene, instead, execution)
        more["method_choice"] = f"exponential: {scene.solver().name}, chosen at first, spent its budget of steps"
    for _ in range(REPETITIONS):
        state = done.error.state if done.error else 0.0
        better = tightened(done.solver, promise / (MARGIN * state)) if state > CLOSE * promise else done.solver
        if better == done.solver or done.recorder.run.closed:
            break
        again = _carried(scene, better, execution, first=done)
        ended = f"repeated by {better}" if again.reason is None else f"and the repetition {again.reason}"
        lines.append(f"by {done.solver} the estimated error is {state:.1e}, above the promised {promise:.0e}: {ended}")
        if again.reason is not None:
            more["repetition"] = f"{better}: {again.reason}"
            break
        done = _doubted(again, promise)
    record = _record(scene, done, time.perf_counter() - clock - done.compiling).assign_attrs(more)
    lines += [*transient_lines(record, scene.plan), *drift_lines(record, scene.plan, scene.model().structure.frequency)]
    lines += effort_lines(record, scene.model(), done.solver)
    return Outcome({"": record}, done.reason, tuple(lines))


@dataclass(frozen=True)
class _Carried:
    """A run that has ended: its record, why it `ended` early or None, its estimated error if that is wanted.

    `compiling` is the time of compilation [s].
    """

    recorder: Recorder
    ended: str | None
    error: Estimate | None
    compiling: float

    @property
    def reason(self) -> str | None:
        """Why the result is incomplete; None if it is not."""
        return "; ".join(filter(None, (self.ended, self.recorder.lost))) or None

    @property
    def solver(self) -> Solver:
        return self.recorder.run.solver


def _doubted(done: _Carried, promise: float) -> _Carried:
    """A repetition, with a remark on its estimate where the fine tolerance shows that the motion amplifies errors."""
    share = promise / done.solver.rtol
    if done.error is None or done.error.remark or share <= AMPLIFIED:
        return done
    remark = f"in doubt: the motion amplifies errors, and took a tolerance {share:.0e} times finer than the promise"
    return replace(done, error=replace(done.error, remark=remark))


def _carried(scene: Scene, solver: Solver, execution: Execution, first: _Carried | None = None) -> _Carried:
    """Run a scene by a solver, and estimate the error if that is wanted; ``first`` is a coarser run of the same."""
    plan: Schedule = scene.plan
    run = Run(scene.model(), [Phase(*phase) for phase in plan.phases], solver)
    run.time = float(plan.edges()[0])
    recorder = Recorder(run, plan)
    estimated, before = scene.file.solver.estimate_error, None
    if first is not None and first.error is not None and first.error.proportional:
        before = first.recorder
    companion = Companion(run) if estimated and before is None and not run.closed else None
    reason = _advance(recorder, companion, execution)
    compiling = run.compile_seconds if first is None else first.compiling
    if not estimated:
        error = None
    elif before is not None and reason is None:
        error = compared(run, recorder.totals, before.run, before.totals)
    else:
        error = _estimate(recorder, companion, reason, execution)
    return _Carried(recorder, reason, error, compiling)


def _record(scene: Scene, done: _Carried, seconds: float) -> Dataset:
    """The result of a run."""
    recorder, run = done.recorder, done.recorder.run
    try:
        variables, times = _sample_variables(recorder)
    except MemoryError:
        recorder.forget_samples()
        variables, times = _sample_variables(recorder)
    attrs = attributes(scene, str(run.solver), done.compiling, seconds, done.reason)
    if run.solver.has_tolerance:
        attrs |= {"rtol": run.solver.rtol, "atol": run.solver.atol}
    attrs["peak_stored_energy"] = recorder.totals.peak
    variables |= final_variables(run) | _cycle_variables(recorder)
    if done.error is not None:
        variables["cycle_amplitude_error"] = (("cycle",), done.error.amplitude)
        attrs |= {"estimated_error": done.error.state, "estimate_remark": done.error.remark}
    return dataset(variables, {"time": times}, attrs, run.model)


def _advance(recorder: Recorder, companion: Companion | None, execution: Execution) -> str | None:
    """Advance a run to its end, its companion beside it, and return why it ended early, or None."""
    run, beside = recorder.run, list[Future]()
    try:
        with ThreadPoolExecutor(2) as threads:
            for steps in run.batches():
                compiled = bool(beside)
                _wait(beside)
                beside = [threads.submit(recorder.add, steps, run.completed)]
                if companion is not None and compiled:
                    beside.append(threads.submit(companion.advance))
                # Here an interrupt is raised: all steps that were taken are recorded, or being so.
                _show(recorder, companion, execution, recorder.plan.place(run.completed))
        _wait(beside)
    except RunError as error:
        _wait(beside)
        return str(error)
    except KeyboardInterrupt:
        if run.completed < run.num_cycles:
            return f"interrupted in cycle {run.completed + 1} of {run.num_cycles}"
    return None


def _wait(tasks: Sequence[Future]) -> None:
    """Wait until all of them are done; raises what one of them has raised."""
    for task in tasks:
        task.result()


def _show(recorder: Recorder, companion: Companion | None, execution: Execution, words: str) -> None:
    """Show how much of a run and its companion is done, in cycles of the run."""
    share = 0.0 if companion is None else COMPANION
    done = recorder.run.completed + (share * companion.run.completed if companion else 0.0)
    execution.progress(done, (1 + share) * recorder.run.num_cycles, words)


def _estimate(recorder: Recorder, companion: Companion | None, reason: str | None, execution: Execution) -> Estimate:
    """The estimated error of a run, by what is left of its companion; ``reason``: why the run ended early."""
    run, totals = recorder.run, recorder.totals
    if reason is not None:
        return unknown(totals, "the run ended early")
    if companion is None:
        return rounding(run, totals)
    try:
        more = True
        while more:
            cycles = counted(run.num_cycles, "cycle")
            words = f"estimating the error, {companion.run.completed} of {cycles}"
            _show(recorder, companion, execution, words)
            more = companion.advance()
    except KeyboardInterrupt:
        return unknown(totals, "interrupted")
    return estimate(run, totals, companion)


def _sample_variables(recorder: Recorder) -> tuple[Arrays, np.ndarray]:
    """The recorded samples and all transitions, and the times of the samples."""
    model, samples, log = recorder.run.model, recorder.samples, recorder.events
    force, motion = contact_forces(model, samples)
    shape = model.structure.shape
    free = slip_follows_motion(samples.state, model.friction)
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
    }
    return variables, samples.time


def final_variables(run: Run) -> Arrays:
    """The state at the end, from which another run may start."""
    model = run.model
    u = np.einsum("cam,m->ca", model.contact_shape[:, :2], run.displacement)
    free = slip_follows_motion(run.state, model.friction)
    return {
        "final_modal_displacement": (("mode",), run.displacement),
        "final_modal_velocity": (("mode",), run.velocity),
        "mode_shape": (("point", "axis", "mode"), model.structure.shape),
        "contact_frame": (("contact", "component", "axis"), model.contact_frames),
        "final_slip": (("contact", "tangent"), np.where(free[:, None], u, run.slip)),
        "final_contact_state": (("contact",), run.state.astype(np.int8)),
        "final_phase_deg": ((), np.array(np.rad2deg(run.phase) % 360.0)),
    }


def _cycle_variables(recorder: Recorder) -> Arrays:
    """Amplitude and energies of each cycle; every term is the integral of its own force."""
    model, totals, count = recorder.run.model, recorder.totals, len(recorder.totals.amplitude)
    work = np.diff(np.array([np.zeros(2 + model.num_contacts), *totals.work]), axis=0)
    stored = np.diff(np.array([totals.initial, *totals.stored]))
    friction = work[:, 2:]
    amplitude = np.array(totals.amplitude).reshape(count, len(model.structure.points), 3)
    return {
        "cycle_amplitude": (("cycle", "point", "axis"), amplitude),
        "cycle_start": (("cycle",), np.array(totals.start[:count])),
        "cycle_period": (("cycle",), np.array(totals.end) - np.array(totals.start[:count])),
        "cycle_steps": (("cycle",), np.array(totals.steps, dtype=np.int64)),
        "cycle_frequency": (("cycle",), recorder.plan.cycle_frequency()[:count]),
        "energy_input": (("cycle",), work[:, 0]),
        "energy_damping": (("cycle",), work[:, 1]),
        "energy_friction": (("cycle", "contact"), friction),
        "energy_stored_change": (("cycle",), stored),
        "energy_residual": (("cycle",), work[:, 0] - work[:, 1] - friction.sum(axis=1) - stored),
    }
