"""What does a cycle take by exponential collocation, at equal error, against Runge-Kutta?

Run `python benchmarks/collocation.py`. Each problem starts from rest and runs alone, nothing recorded, and again with
all that a transient keeps of its cycles: amplitudes, energies, transitions. The error is that of the last state against
dopri8 at rtol 1e-12. Every contender runs once before the timing, so compilation is not counted (it is shown); then all
of them run in turn, and the medians of their CPU time are shown.
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import os
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from problems import many_contacts, many_modes, oscillator

from timesim.engine.companion import totals_of
from timesim.engine.event_loop import march
from timesim.engine.history import events
from timesim.engine.method import step_method
from timesim.engine.solver import step_control
from timesim.engine.status import Status
from timesim.engine.step import Trajectory
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run
from timesim.model.model import Model
from timesim.model.solver import Solver
from timesim.study.registry import load_scene

DATA = Path(__file__).parents[1] / "tests" / "data"
SOLVERS = [
    *(Solver(name, rtol, 1e-2 * rtol) for name in ("exponential", "tsit5") for rtol in (1e-2, 1e-4, 1e-6, 1e-8)),
    Solver("dopri8", 1e-8, 1e-10),
]
TRUTH = Solver("dopri8", 1e-12, 1e-14)


class Problem(NamedTuple):
    model: Model
    frequency: float
    cycles: int


def blade(num_modes: int) -> Model:
    """The blade of the tests, by its matrices; with all its modes up to 331 kHz, excited at 720 Hz."""
    changes = {"structure.file": "blade.npz", "structure.keep_modes": num_modes}
    return load_scene(DATA / "blade_matrices.yaml", changes).model()


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "oscillator, n0 = 3, 1.39 Hz": lambda: Problem(oscillator(3.0), 1.39, 60),
    "oscillator, n0 = -4, 0.947 Hz": lambda: Problem(oscillator(-4.0), 0.947, 60),
    "oscillator, n0 = 10, 1.5 Hz": lambda: Problem(oscillator(10.0), 1.5, 60),
    "10 modes, 5 contacts with full K_u": lambda: Problem(many_contacts(), 1.0, 20),
    "20 modes, 3 contacts": lambda: Problem(many_modes(20, 3), 1.0, 20),
    "50 modes, 10 contacts": lambda: Problem(many_modes(50, 10), 1.0, 10),
    "blade, 12 modes, 2 contacts": lambda: Problem(blade(12), 720.0, 20),
    "blade, 24 modes, 2 contacts": lambda: Problem(blade(24), 720.0, 5),
}


def runner(problem: Problem, solver: Solver) -> Callable[[], tuple[Trajectory, int]]:
    """What runs a problem by a solver, to its end and its number of transitions."""
    run = Run(problem.model, [Phase(problem.frequency, problem.cycles)], solver)
    frame = Frame(problem.model, run.reduction, problem.frequency)
    stiffest = problem.model.stuck_rate / frame.scales.omega
    system = system_of(problem.model, problem.frequency, 0.0, run.reduction)
    start = frame.begin(system, run, solver.first_step(stiffest), work=False)
    one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (system, start))
    control, cycles = step_control(solver, stiffest), jnp.array([problem.cycles])

    def go() -> tuple[Trajectory, int]:
        end, count = march(step_method(solver), control, *one, cycles)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[0], end), int(count[0])

    return go


def recorder(problem: Problem, solver: Solver) -> Callable[[], None]:
    """What runs a problem by a solver and keeps of each cycle what a transient does."""

    def go() -> None:
        run = Run(problem.model, [Phase(problem.frequency, problem.cycles)], solver)
        totals = totals_of(run)
        for steps in run.batches():
            totals.add(steps, run.completed)
            events(steps)

    return go


def apart(end: Trajectory, true: Trajectory) -> float:
    """Largest difference of two states, relative to the largest entry."""
    mine, truth = (np.concatenate([t.point.q, t.point.p]) for t in (end, true))
    return float(np.abs(mine - truth).max() / np.abs(truth).max())


def rows(problem: Problem, repeats: int) -> list[str]:
    true, events = runner(problem, TRUTH)()
    table = [f"\n{events} transitions in {problem.cycles} cycles\n"]
    table += ["| method | error | transitions | us a cycle | recorded | first run, s |", "|---|---|---|---|---|---|"]
    runs, ends, first = [runner(problem, solver) for solver in SOLVERS], [], []
    for run in runs:
        clock = time.process_time()
        ends.append(run())
        first.append(time.process_time() - clock)
    bare = medians(runs, repeats)
    recorders = [recorder(problem, solver) for solver in SOLVERS]
    for record in recorders:
        record()
    kept = medians(recorders, repeats)
    for solver, (end, count), *times, begun in zip(SOLVERS, ends, bare, kept, first, strict=True):
        how = f"{apart(end, true):.1e}" if end.status == Status.RUNNING else Status(end.status).name
        cycle, recorded = (1e6 * seconds / problem.cycles for seconds in times)
        table.append(
            f"| {solver.name}, rtol {solver.rtol:g} | {how} | {count} | {cycle:.4g} | {recorded:.4g} | {begun:.1f} |"
        )
    return table


def medians(runs: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """CPU seconds of each, run in turn."""
    taken: list[list[float]] = [[] for _ in runs]
    for _ in range(repeats):
        for run, times in zip(runs, taken, strict=True):
            clock = time.process_time()
            run()
            times.append(time.process_time() - clock)
    return [statistics.median(times) for times in taken]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--problem", nargs="+", choices=list(PROBLEMS), default=list(PROBLEMS))
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name in options.problem:
        print("\n".join([f"\n#### {name}", *rows(PROBLEMS[name](), options.repeats)]), flush=True)


if __name__ == "__main__":
    main()
