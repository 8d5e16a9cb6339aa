"""How do time and memory grow with modes, contacts, transitions, cycles, lanes and points?

    python benchmarks/growth.py --picture configs/pictures/growth.png

One number grows at a time, each value in a process of its own that keeps to one core: CPU after a first run, which
compiles, in all and for a piece of the work; the exponent of the latter between a value and the one before; peak memory
of the process. Modes, contacts and transitions are those of `many_modes` (tsit5, rtol 1e-6, 10 cycles), with the more
transitions the larger the load, and nothing left out; cycles (as `timesim run` records
them), lanes and points are those of the paper's oscillator.
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import sweep_memory
from event_loop import Problem, marched
from problems import many_modes, oscillator

from timesim.engine.trajectory import Phase
from timesim.engine.trajectory import Run as Simulation
from timesim.model.model import Model
from timesim.model.solver import Solver
from timesim.study.registry import carry_out, load_scene

SOLVER = Solver("tsit5", 1e-6, 1e-8, reduce=False)
CYCLES, REPEATS = 10, 5


class Cost(NamedTuple):
    """What a value costs: the number itself, the pieces of its work, CPU seconds."""

    number: float
    pieces: float
    seconds: float


class Row(NamedTuple):
    cost: Cost
    peak: float  # MB


def cpu(run: Callable[[], object]) -> float:
    clock = time.process_time()
    run()
    return time.process_time() - clock


def timed(run: Callable[[], object]) -> float:
    """Median CPU seconds after a first run."""
    run()
    return statistics.median(cpu(run) for _ in range(REPEATS))


def steps(model: Model, number: float) -> Cost:
    """A trajectory by its steps."""
    run = Simulation(model, [Phase(1.0, CYCLES)], SOLVER)
    count = sum(batch.time.size for batch in run.batches())
    return Cost(number, count, timed(marched(Problem("", model, 1.0, CYCLES), 1, SOLVER)))


def of_modes(number: int) -> Cost:
    return steps(many_modes(number, 3), number)


def of_contacts(number: int) -> Cost:
    return steps(many_modes(40, number), number)


def of_transitions(percent: int) -> Cost:
    """20 modes with 32 contacts under a preload of 1, by a percentage of the load."""
    model = many_modes(20, 32)
    x, contacts = model.excitation, tuple(replace(contact, preload=1.0) for contact in model.contacts)
    load = replace(x, cosine=percent / 100 * x.cosine, sine=percent / 100 * x.sine)
    model = replace(model, contacts=contacts, excitation=load)
    return steps(model, marched(Problem("", model, 1.0, CYCLES), 1, SOLVER)().num_events / CYCLES)


def of_cycles(number: int) -> Cost:
    def run(cycles: int) -> object:
        study = {"kind": "transient", "cycles": cycles, "record_last": 10}
        return carry_out(load_scene(sweep_memory.SCENE, {"study": study, "solver.estimate_error": False}))

    run(10)
    return Cost(number, number, cpu(lambda: run(number)))


def of_lanes(number: int) -> Cost:
    return Cost(number, number, timed(marched(Problem("", oscillator(3.0), 1.39, CYCLES), number, SOLVER)))


def of_points(number: int) -> Cost:
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        sweep_memory.measure(100, first)
        return Cost(number, number, cpu(lambda: sweep_memory.measure(number, second)))


class Axis(NamedTuple):
    values: tuple[int, ...]
    piece: str
    title: str
    cost: Callable[[int], Cost]


LOADS = (200, 250, 300, 400, 800, 1600)

AXES = {
    "modes": Axis((10, 20, 40, 80, 160, 320), "step", "3 contacts", of_modes),
    "contacts": Axis((1, 2, 4, 8, 16, 32), "step", "40 modes", of_contacts),
    "transitions a cycle": Axis(LOADS, "step", "20 modes, 32 contacts", of_transitions),
    "cycles": Axis((30, 100, 300, 1000, 3000, 10000), "cycle", "recorded run of the oscillator", of_cycles),
    "lanes": Axis((1, 4, 16, 64, 256, 1024), "lane and cycle", "oscillator", of_lanes),
    "points": Axis((200, 500, 1000), "point", "sweep of the oscillator", of_points),
}


def measure(axis: str) -> list[Row]:
    rows = []
    for value in AXES[axis].values:
        command = [sys.executable, __file__, "--one", axis, str(value)]
        done = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
        rows.append(Row(Cost(*done["cost"]), done["peak"]))
    return rows


def each(axis: str, row: Row) -> float:
    """Microseconds a piece."""
    return 1e6 * row.cost.seconds / row.cost.pieces / (CYCLES if axis == "lanes" else 1)


def table(axis: str, rows: list[Row]) -> str:
    lines = [
        f"\n#### {axis} ({AXES[axis].title})\n",
        f"| {axis} | pieces | µs a {AXES[axis].piece} | exponent | CPU s in all | peak MB |",
        "|---|---|---|---|---|---|",
    ]
    before: tuple[float, float] | None = None
    for row in rows:
        (number, pieces, seconds), one = row.cost, each(axis, row)
        exponent = f"{np.log(one / before[1]) / np.log(number / before[0]):+.2f}" if before and before[0] else ""
        lines.append(f"| {number:g} | {pieces:g} | {one:.3g} | {exponent} | {seconds:.3g} | {row.peak:.0f} |")
        before = (number, one)
    return "\n".join(lines)


def draw(found: dict[str, list[Row]], path: Path) -> None:
    """Time of a piece against each number."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    from timesim.picture.figure import figure
    from timesim.picture.style import SERIES

    fig, grid = figure(2, 3, width=10.0, height=2.1, gap=0.75)
    for ax, (axis, rows) in zip(grid.flat, found.items(), strict=False):
        number, cost, look = [row.cost.number for row in rows], [each(axis, row) for row in rows], SERIES[0]
        ax.plot(number, cost, marker=look.marker, color=look.colour)
        ax.set(xscale="linear" if 0 in number else "log", yscale="log", ylim=(min(cost) / 3, 3 * max(cost)))
        apart = [value for i, value in enumerate(number) if not i or value > 1.5 * number[i - 1]]
        ax.set_xticks(apart, [f"{value:g}" for value in apart])
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        for side in (ax.xaxis, ax.yaxis):
            side.set_minor_locator(NullLocator())
        ax.set_xlabel(f"{axis} ({AXES[axis].title})", fontsize=8)
        ax.set_ylabel(f"µs a {AXES[axis].piece}", fontsize=8)
    fig.suptitle("Time of a piece of work against what there is of it", fontsize=11)
    fig.savefig(path, dpi=75)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axis", nargs="+", choices=list(AXES), default=list(AXES))
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    if options.one:
        cost = AXES[options.one[0]].cost(int(options.one[1]))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps({"cost": cost, "peak": peak}))
        return
    print(f"one of {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    found = {}
    for axis in options.axis:
        found[axis] = measure(axis)
        print(table(axis, found[axis]), flush=True)
    if options.picture:
        draw(found, options.picture)


if __name__ == "__main__":
    main()
