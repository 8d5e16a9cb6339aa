"""How long does a cycle take at equal error: with scipy, the oracle, a serial numba march and timesim?

Run `python benchmarks/event_loop.py` (numba comes with the extra `bench`). Each problem starts from rest.
The error is that of the last state against DOP853 with located events at rtol 1e-12. Every contender runs
once before the timing, so compilation is not counted; then all of them run in turn, several times over, and
the median is shown.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import opponents_numba
import opponents_scipy
from problems import MANY_CONTACTS_FREQUENCY, Run, error, many_contacts, oscillator

from timesim.model import Model

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import oracle

BATCHES = (1, 16, 256)


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
    return opponents_scipy.simulate(problem.model, problem.frequency, problem.cycles, rtol=1e-12, lag=3e-5)


def scipy_rows(problem: Problem) -> list[Contender]:
    def contender(method: str, rtol: float, steps: int) -> Contender:
        def run() -> Run:
            return opponents_scipy.simulate(
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
        constants = opponents_numba.scene(problem.model, steps)

        def run() -> Run:
            return opponents_numba.simulate(
                problem.model, problem.frequency, problem.cycles, steps_per_cycle=steps, constants=constants
            )

        return Contender(f"numba RK4, {steps} steps/cycle", 1, run)

    return [contender(steps) for steps in (50, 200, 800)]


def oracle_rows(problem: Problem) -> list[Contender]:
    def run() -> Run:
        end: Any = oracle.simulate(problem.model, problem.frequency, problem.cycles)
        return Run(end.displacement, end.velocity, end.slip, end.state, len(end.event_time), [])

    return [Contender("oracle (diffrax events), rtol 1e-10", 1, run)]


def timesim_rows(problem: Problem, batch: int) -> list[Contender]:
    """The program's own entries at one batch size; `run` returns when the whole batch is ready."""
    return []


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
    body = [
        f"| {r.name} | {r.batch} | {r.error:.1e} | {r.num_events} | {r.seconds * 1e6:.4g} |" for r in rows
    ]
    return "\n".join(head + body)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--budget", type=float, default=5.0, help="seconds of timed runs for one contender")
    parser.add_argument("--no-oracle", action="store_true")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, numpy {np.__version__}")
    for problem in PROBLEMS:
        contenders = scipy_rows(problem) + numba_rows(problem)
        if not options.no_oracle:
            contenders += oracle_rows(problem)
        for batch in BATCHES:
            contenders += timesim_rows(problem, batch)
        rows = measure(problem, contenders, options.repeats, options.budget)
        print(table(problem, rows, reference(problem).num_events), flush=True)


if __name__ == "__main__":
    main()
