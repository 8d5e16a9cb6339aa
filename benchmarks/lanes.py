"""Side by side or one after the other: what do many trajectories of one structure take?

Run `python benchmarks/lanes.py`. Sixteen trajectories, or `--lanes`, of tsit5 that begin at different phases of the
excitation, 10 cycles, nothing recorded: microseconds of CPU a cycle and trajectory, the median of some runs after the
first. `timesim.engine.system.MOST_SUMMED` follows from it, and `WIDE` in part: what compiles counts there too.
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import os
import statistics
import time
from unittest.mock import patch

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from problems import many_modes

from timesim.engine import event_loop
from timesim.engine.method import step_method
from timesim.engine.solver import step_control
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run
from timesim.model.solver import Solver

SIZES = [(2, 1), (10, 3), (10, 5), (20, 3), (14, 7), (20, 8), (40, 1), (40, 2), (50, 10)]
CYCLES, SOLVER = 10, Solver("tsit5", 1e-5, 1e-7)


def taken(num_modes: int, num_contacts: int, lanes: int, one_by_one: bool, repeats: int) -> float:
    """Microseconds a cycle and trajectory."""
    model = many_modes(num_modes, num_contacts)
    run = Run(model, [Phase(1.0, CYCLES)], SOLVER)
    frame = Frame(model, run.reduction, 1.0)
    stiffest = model.stuck_rate / frame.scales.omega
    system = system_of(model, 1.0, 0.0, run.reduction)
    start = frame.begin(system, run, SOLVER.first_step(stiffest), work=False)
    systems, starts = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * lanes), (system, start))
    systems = eqx.tree_at(lambda s: s.phase, systems, jnp.linspace(0, 1, lanes))
    times = []
    jax.clear_caches()
    with patch.object(event_loop, "one_by_one", lambda *_: one_by_one):
        for _ in range(repeats + 1):
            clock = time.process_time()
            cycles = jnp.full(lanes, CYCLES)
            end, _ = event_loop.march(step_method(SOLVER), step_control(SOLVER, stiffest), systems, starts, cycles)
            assert np.all(np.asarray(end.cycle) == CYCLES)
            times.append(time.process_time() - clock)
    return statistics.median(times[1:]) / CYCLES / lanes * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--lanes", type=int, default=16)
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    print("| modes x contacts | side by side | one after the other |\n|---|---|---|")
    for modes, contacts in SIZES:
        both = [taken(modes, contacts, options.lanes, one_by_one, options.repeats) for one_by_one in (False, True)]
        print(f"| {modes} x {contacts} | {both[0]:.0f} | {both[1]:.0f} |", flush=True)


if __name__ == "__main__":
    main()
