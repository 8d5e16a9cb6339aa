"""Runs of one scene by different methods, each compiled before it is timed, within a budget of seconds."""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from timesim.engine.companion import amplitude_error, totals_of
from timesim.engine.method import MANY_FROM
from timesim.engine.status import RunError
from timesim.engine.trajectory import Phase, Run
from timesim.model.cost import cycles_to_settle, seconds_a_cycle
from timesim.model.model import Model, Start
from timesim.model.solver import CLOSED_FORM, NEVER, Criterion, Solver
from timesim.orbit.threshold import PERIODS
from timesim.result.label import counted
from timesim.scene.transient import TradeoffPlan
from timesim.study.execution.campaign import Execution

REPEATED, REPEATS = 0.3, 5
"""A run of fewer seconds is made this many times, and the least time counts: other work of the machine adds to it."""
STEP = {CLOSED_FORM: 0.1, "tsit5": 1.0, "rk4": 0.6, "dopri8": 2.0, "exponential": 4.0, "kvaerno5": 80.0}
COMPILED = {CLOSED_FORM: 0.0, "tsit5": 1.0, "rk4": 0.6, "dopri8": 2.5, "exponential": 4.0, "kvaerno5": 2.0}
"""Time of a step, and of compilation, roughly, as multiples of that of tsit5. Compilation of collocation: measured, 2.3
to 3.8 from 2 modes with a contact to 50 with ten; taken for more, a first run leaves it out for want of time."""
SETTLING = Solver("tsit5", 1e-9, 1e-11)
"""The solver that marches to the settled motion, whose amplitude is judged."""
LEFT = 0.1
"""Share of the wanted error to which free vibrations have decayed by then."""
MOST_CYCLES, MOST_TIME = 2000, 0.3
"""Most cycles, and largest share of the budget, for this march."""
FAR, NEAR = 1e-2, 1e-3
"""Distances from the settled amplitude between which its decay is read off this march."""
FORGOTTEN = 0.02
"""Share to which the difference of a run's own settled motion from the one that it begins with has decayed at its end.
"""
ORDER = {"dopri8": 8, "exponential": 6}
"""Order of the methods where it is not 5: the number of steps grows as tolerance ** (-1/order)."""


@dataclass(frozen=True)
class Trial:
    """A run that has been timed, in the units of the scene.

    Attributes:
        solver: method, tolerances and whether the reductions were on.
        num_modes: modes kept, the lowest.
        preset: name of the preset whose solver it is; empty otherwise.
        seconds, compiling: of the compiled run, and of its compilation; 0 where it was compiled before.
        displacement, velocity: of all modes at the end, 0 for those not kept.
        size: largest of both in the last cycle, as of `timesim.engine.history.CycleTotals`.
        amplitude: of the last cycle, of each point along each axis; the largest of the last period where it is judged.
        scatter: how much longer than the least its times were, as a share of it; NaN where it was timed once.
    """

    solver: Solver
    num_modes: int
    preset: str
    seconds: float
    compiling: float
    steps: int
    transitions: int
    displacement: np.ndarray
    velocity: np.ndarray
    size: np.ndarray
    amplitude: np.ndarray
    scatter: float = np.nan


NO_TIME = "no time left"


class Bench:
    """Makes and times runs while there is time left.

    Attributes:
        trials: the runs that have come to their end.
        left_out: solvers with the number of modes of runs that were not made, or failed, each with the reason.
        settled_to: change of the amplitude over the last period before the runs, where it is judged; else NaN.
        cycles: of each run; where the amplitude is judged, enough for it to come to that of its own solver.
    """

    def __init__(self, model: Model, plan: TradeoffPlan, execution: Execution):
        self.model, self.plan, self.execution = model, plan, execution
        self.begun = time.perf_counter()
        self.trials: list[Trial] = []
        self.left_out: dict[tuple[Solver, int], str] = {}
        self.settled_to = np.nan
        self.cycles = plan.cycles
        self._compiling: dict[tuple[str, float, int, bool], float] = {}
        self._models: dict[int, Model] = {}
        self._periods: dict[int, int] = {}

    @property
    def left(self) -> float:
        return self.plan.budget - (time.perf_counter() - self.begun)

    def _show(self, words: str) -> None:
        self.execution.progress(self.plan.budget - max(self.left, 0.0), self.plan.budget, words)

    def try_(self, solver: Solver, *, num_modes: int | None = None, preset: str = "") -> Trial | None:
        """Run and time a solver with the lowest modes; None where there is no time for it, or it fails."""
        kept = num_modes or self.model.structure.num_modes
        for i, trial in enumerate(self.trials):
            if (trial.solver, trial.num_modes) == (solver, kept):
                self.trials[i] = replace(trial, preset=preset or trial.preset)
                return self.trials[i]
        self._show(self.name_of(solver, kept))
        if self.left_out.get((solver, kept), NO_TIME) != NO_TIME:
            return None
        if self.trials and self._guess(solver, kept) > self.left:
            self.left_out[solver, kept] = NO_TIME
            return None
        try:
            trial = self._timed(solver, kept, preset)
        except RunError as error:
            # Without the advice, which is the same for many.
            self.left_out[solver, kept] = str(error).partition(". ")[0]
            return None
        self.left_out.pop((solver, kept), None)
        self.trials.append(trial)
        return trial

    def name_of(self, solver: Solver, num_modes: int) -> str:
        """A solver in words, with what its run leaves out; its atol is always the same share of rtol."""
        name = str(solver).partition(", atol")[0]
        name += f", {counted(num_modes, 'mode')}" if num_modes < self.model.structure.num_modes else ""
        return name + ("" if solver.reduce else ", nothing left out")

    def time_again(self) -> None:
        """Time the short runs once more, since the machine may have done other work during the first ones."""
        for i, trial in enumerate(self.trials):
            if trial.seconds < min(REPEATED, self.left):
                self._show(f"{trial.solver} again")
                model, clock = self.model_of(trial.num_modes), time.perf_counter()
                _through(model, trial.solver, self.plan.frequency, self.cycles)
                less, more = sorted((trial.seconds, time.perf_counter() - clock))
                self.trials[i] = replace(trial, seconds=less, scatter=np.fmax(trial.scatter, more / less - 1))

    def model_of(self, num_modes: int) -> Model:
        """The lowest modes from the scene's start, or, where the amplitude is judged, from their settled motion."""
        if num_modes not in self._models:
            model = lowest_modes(self.model, num_modes)
            self._models[num_modes] = self._settled(model) if self.plan.amplitude else model
        return self._models[num_modes]

    def _settled(self, model: Model) -> Model:
        """The model with its motion after as many cycles as its slowest mode takes to decay, or there is time for."""
        frequency, until = self.plan.frequency, self.left - MOST_TIME * self.plan.budget
        criterion = Criterion(LEFT * self.plan.error, MOST_CYCLES, NEVER)
        cycles = max(2, cycles_to_settle(model, criterion, frequency))
        run = Run(model, [Phase(frequency, cycles)], SETTLING)
        totals = totals_of(run)
        for steps in run.batches():
            totals.add(steps, run.completed)
            self._show("settling")
            if self.left < until and run.completed > 1:
                break
        self._compiling.setdefault(program(SETTLING, model.structure.num_modes), run.compile_seconds)
        amplitude = np.array(totals.amplitude)[: run.completed]
        period, left = repeats(amplitude)
        self._periods[model.structure.num_modes] = period
        self.settled_to = float(np.nanmax([self.settled_to, left]))
        if model is self.model:
            unknown = cycles_to_settle(model, replace(criterion, tolerance=FORGOTTEN), frequency)
            self.cycles = max(self.cycles, period + forgets(amplitude, period, unknown))
        start = Start(run.displacement, run.velocity, run.slip, run.state, run.phase % (2 * np.pi))
        return replace(model, start=start)

    def _timed(self, solver: Solver, num_modes: int, preset: str) -> Trial:
        model, key = self.model_of(num_modes), program(solver, num_modes)
        # The first run of a program that is not compiled yet includes its compilation.
        first, seconds = key not in self._compiling, list[float]()
        while len(seconds) < 1 + first or (min(seconds) < REPEATED and len(seconds) < REPEATS):
            clock = time.perf_counter()
            run, totals, steps = _through(model, solver, self.plan.frequency, self.cycles)
            seconds.append(time.perf_counter() - clock)
        compiling = seconds[0] - min(seconds) if first else 0.0
        self._compiling.setdefault(key, compiling)
        missing = (0, self.model.structure.num_modes - num_modes)
        period = self._periods.get(num_modes, 1)
        return Trial(
            solver=solver,
            num_modes=num_modes,
            preset=preset,
            seconds=min(seconds),
            compiling=compiling,
            steps=steps,
            transitions=totals.transitions,
            displacement=np.pad(run.displacement, missing),
            velocity=np.pad(run.velocity, missing),
            size=totals.size,
            amplitude=np.max(totals.amplitude[-period:], axis=0),
            scatter=float(np.median(seconds[first:]) / min(seconds) - 1) if len(seconds) > 1 + first else np.nan,
        )

    def _guess(self, solver: Solver, num_modes: int) -> float:
        """Seconds that a run may take, its compilation included, from those before it."""
        key = program(solver, num_modes)
        like = [trial for trial in self.trials if program(trial.solver, trial.num_modes) == key] or self.trials
        last = like[-1]
        power = 1 / ORDER.get(solver.name, 5)
        share = STEP[solver.name] / STEP[last.solver.name] * max((last.solver.rtol / solver.rtol) ** power, 1.0)
        own = last.seconds * share
        if solver.name == "kvaerno5" and last.solver.name != solver.name:  # its steps are others than those of the rest
            own = self.cycles * seconds_a_cycle(self.model, solver, self.plan.frequency)
        first = next(iter(self._compiling.values())) * COMPILED[solver.name]
        return min(max(own, REPEATED), REPEATS * own) + (0.0 if key in self._compiling else first)


def repeats(amplitude: np.ndarray) -> tuple[int, float]:
    """Cycles after which amplitudes, of shape (cycle, point, axis), repeat best, and how they still change."""
    change = {
        period: float(np.max(amplitude_error(amplitude[-period:], amplitude[-2 * period : -period])))
        for period in PERIODS
        if 2 * period <= len(amplitude)
    }
    period = min(change, key=lambda period: change[period])
    return period, change[period]


def forgets(amplitude: np.ndarray, period: int, unknown: int) -> int:
    """Cycles in which a small difference of a settled motion has decayed to `FORGOTTEN`.

    By the amplitude while it settles, shape (cycle, point, axis), and the cycles after which the settled motion
    repeats; ``unknown`` where it was never `FAR` from that.
    """
    same = (np.arange(len(amplitude)) - len(amplitude)) % period - period
    away = amplitude_error(amplitude[same], amplitude)
    far, near = np.flatnonzero(away > FAR), np.flatnonzero(away > NEAR)
    if not far.size:
        return unknown
    return math.ceil((near[-1] - far[-1]) * math.log(FORGOTTEN) / math.log(NEAR / FAR))


def program(solver: Solver, num_modes: int) -> tuple[str, float, int, bool]:
    """What tells compiled programs apart."""
    few_nodes = solver.name == "exponential" and solver.rtol > MANY_FROM
    own = solver.rtol if solver.name == "kvaerno5" else int(few_nodes)
    return solver.name, own, num_modes, solver.reduce


def _through(model: Model, solver: Solver, frequency: float, cycles: int) -> tuple:
    """A run as a transient makes it, its samples left out: the run, its totals and the number of its steps."""
    run = Run(model, [Phase(frequency, cycles)], solver)
    totals, count = totals_of(run), 0
    for steps in run.batches():
        totals.add(steps, run.completed)
        count += steps.time.size
    return run, totals, count


def lowest_modes(model: Model, count: int) -> Model:
    """The model with its lowest modes alone."""
    if count == model.structure.num_modes:
        return model
    few, body, load, start = slice(count), model.structure, model.excitation, model.start
    damping = body.damping[(few,) * body.damping.ndim]
    shape = body.shape[:, :, few]
    return replace(
        model,
        structure=replace(body, frequency=body.frequency[few], mass=body.mass[few], damping=damping, shape=shape),
        excitation=replace(load, cosine=load.cosine[:, few], sine=load.sine[:, few], constant=load.constant[few]),
        start=replace(start, displacement=start.displacement[few], velocity=start.velocity[few]),
    )
