"""How long does a cycle take at equal error: with scipy, the oracle, a serial numba march and timesim?

Run `python benchmarks/event_loop.py` (numba comes with the extra `bench`). Each problem starts from rest.
The error is that of the last state against DOP853 with located events at rtol 1e-12. Every contender runs
once before the timing, so compilation is not counted; then all of them run in turn, several times over, and
the median is shown.
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from opponents import numba_rk4, scipy_events
from problems import MANY_CONTACTS_FREQUENCY, Run, error, many_contacts, oscillator

from timesim.engine.event_loop import march
from timesim.engine.history import events
from timesim.engine.method import step_method
from timesim.engine.solver import step_control
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase
from timesim.engine.trajectory import Run as Simulation
from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import Solver

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import oracle

BATCHES = {1: (1, 16, 256), 5: (1, 4)}
"""Of trajectories side by side, by the contacts: studies march four; of five contacts XLA compiles sixteen to a program
that does not load."""
TIMESIM_SOLVERS = (("tsit5", 1e-5), ("tsit5", 1e-7), ("tsit5", 1e-9), ("dopri8", 1e-9))


class Problem(NamedTuple):
    name: str
    model: Model
    frequency: float
    cycles: int


class Contender(NamedTuple):
    """A way to compute a problem; `run` gives the end of the first of `batch` trajectories."""

    name: str
    batch: int
    run: Callable[[], Run]


class Row(NamedTuple):
    name: str
    batch: int
    error: float
    num_events: int
    seconds: float  # a cycle and trajectory


PROBLEMS = (
    Problem("oscillator, n0 = 3, 1.39 Hz", oscillator(3.0), 1.39, 60),
    Problem("oscillator, n0 = -4, 0.947 Hz", oscillator(-4.0), 0.947, 60),
    Problem("10 modes, 5 contacts, 1 Hz", many_contacts(), MANY_CONTACTS_FREQUENCY, 20),
)


def reference(problem: Problem) -> Run:
    return scipy_events.simulate(problem.model, problem.frequency, problem.cycles, rtol=1e-12, lag=3e-5)


def scipy_rows(problem: Problem) -> list[Contender]:
    def contender(method: str, rtol: float, steps: int) -> Contender:
        def run() -> Run:
            return scipy_events.simulate(
                problem.model,
                problem.frequency,
                problem.cycles,
                method=method,
                rtol=rtol,
                steps_per_cycle=steps,
            )

        least = f", {steps} steps/cycle or more" if steps else ""
        return Contender(f"scipy {method}, rtol {rtol:g}{least}", 1, run)

    return [
        contender("RK45", 1e-6, 0),
        contender("RK45", 1e-9, 0),
        contender("DOP853", 1e-6, 40),
        contender("DOP853", 1e-9, 0),
    ]


def numba_rows(problem: Problem) -> list[Contender]:
    def contender(steps: int) -> Contender:
        constants = numba_rk4.scene(problem.model, steps)

        def run() -> Run:
            return numba_rk4.simulate(
                problem.model, problem.frequency, problem.cycles, steps_per_cycle=steps, constants=constants
            )

        return Contender(f"numba RK4, {steps} steps/cycle", 1, run)

    return [contender(steps) for steps in (50, 200, 800)]


def oracle_rows(problem: Problem) -> list[Contender]:
    def run() -> Run:
        end: Any = oracle.simulate(problem.model, problem.frequency, problem.cycles)
        return Run(end.displacement, end.velocity, end.slip, end.state, len(end.event_time), [])

    return [Contender("oracle (diffrax events), rtol 1e-10", 1, run)]


def timesim_rows(problem: Problem, batch: int, methods: list[str]) -> list[Contender]:
    """The program's own entries at one batch size.

    The first of the batch is the problem itself, the others lie up to 1 % above it in frequency. At batch 1 also the
    whole run as a user has it: every step recorded and handed to the host.
    """
    rows = []
    for method, rtol in ((m, r) for m, r in TIMESIM_SOLVERS if m in methods):
        solver = Solver(method, rtol, rtol * 1e-2)
        rows.append(Contender(f"timesim {method}, rtol {rtol:g}", batch, marched(problem, batch, solver)))
        if batch == 1:
            rows.append(Contender(f"timesim {method}, rtol {rtol:g}, recorded", 1, recorded(problem, solver)))
    return rows


def marched(problem: Problem, batch: int, solver: Solver) -> Callable[[], Run]:
    frequencies = problem.frequency * (1 + 0.01 * np.arange(batch) / batch)
    reduction = reduction_of(problem.model, frequencies, reduce=solver.reduce)
    frames = [Frame(problem.model, reduction, frequency) for frequency in frequencies]
    stiffest = problem.model.stuck_rate / frames[0].scales.omega
    start = Simulation(problem.model, [Phase(problem.frequency, problem.cycles)], solver)
    systems = [system_of(problem.model, frequency, 0.0, reduction) for frequency in frequencies]
    starts = [
        frame.begin(system, start, solver.first_step(stiffest), work=False)
        for frame, system in zip(frames, systems, strict=True)
    ]
    systems, starts = (jax.tree.map(lambda *leaves: jnp.stack(leaves), *each) for each in (systems, starts))
    cycles, method, control = jnp.full(batch, problem.cycles), step_method(solver), step_control(solver, stiffest)

    def run() -> Run:
        end, count = jax.tree.map(np.asarray, march(method, control, systems, starts, cycles))
        assert np.max(end.status) == 0
        first = jax.tree.map(lambda leaf: leaf[0], end)
        own = frames[0].start(first.point, first.state, 0.0)
        return Run(own.displacement, own.velocity, own.slip, own.state, int(count[0]), [])

    return run


def recorded(problem: Problem, solver: Solver) -> Callable[[], Run]:
    def run() -> Run:
        simulation = Simulation(problem.model, [Phase(problem.frequency, problem.cycles)], solver)
        count = sum(events(steps).time.size for steps in simulation.batches())
        s = simulation
        return Run(s.displacement, s.velocity, s.slip, s.state, count, [])

    return run


def measure(problem: Problem, contenders: list[Contender], repeats: int, budget: float) -> list[Row]:
    """Error and median time of each contender, of `repeats` interleaved runs or `budget` seconds of them."""
    truth = reference(problem)
    ends = [contender.run() for contender in contenders]
    times: list[list[float]] = [[] for _ in contenders]
    for _ in range(repeats):
        for contender, taken in zip(contenders, times, strict=True):
            if sum(taken) < budget:
                start = time.perf_counter()
                contender.run()
                taken.append(time.perf_counter() - start)
    return [
        Row(
            c.name,
            c.batch,
            error(end, truth),
            end.num_events,
            statistics.median(t) / problem.cycles / c.batch,
        )
        for c, end, t in zip(contenders, ends, times, strict=True)
    ]


def table(problem: Problem, rows: list[Row], num_events: int) -> str:
    head = [
        f"\n### {problem.name}, {problem.cycles} cycles, {num_events} transitions\n",
        "| who | batch | error | transitions | µs a cycle and trajectory |",
        "|---|---|---|---|---|",
    ]
    body = [f"| {r.name} | {r.batch} | {r.error:.1e} | {r.num_events} | {r.seconds * 1e6:.4g} |" for r in rows]
    return "\n".join(head + body)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--budget", type=float, default=5.0, help="seconds of timed runs for one contender")
    parser.add_argument("--no-oracle", action="store_true")
    parser.add_argument("--methods", nargs="+", default=["tsit5", "dopri8"], help="of timesim")
    parser.add_argument("--problem", type=int, choices=range(len(PROBLEMS)), help="only this one")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, numpy {np.__version__}")
    chosen = PROBLEMS if options.problem is None else PROBLEMS[options.problem : options.problem + 1]
    for problem in chosen:
        contenders = scipy_rows(problem) + numba_rows(problem)
        if not options.no_oracle:
            contenders += oracle_rows(problem)
        for batch in BATCHES[len(problem.model.contacts)]:
            contenders += timesim_rows(problem, batch, options.methods)
        rows = measure(problem, contenders, options.repeats, options.budget)
        print(table(problem, rows, reference(problem).num_events), flush=True)


if __name__ == "__main__":
    main()
