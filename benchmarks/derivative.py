"""How exact is the derivative of a cycle by its start, for Newton's method and multipliers, and what does it cost?

Run `python benchmarks/derivative.py`. Driven structures of tests/zoo.py, every second one with full K_u, after some
cycles: the derivative of the next one by each method and tolerance against that by dopri8 at rtol 1e-11, its largest
difference by its largest entry, and CPU milliseconds of a cycle that is recorded with it, compiled before. Structures
whose contacts do not switch in that cycle are left out.
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import runpy
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from timesim.model.model import Model
from timesim.model.solver import Solver
from timesim.orbit.batch import march_lanes, record
from timesim.orbit.lane import Lane
from timesim.orbit.settling import Chain, first_lane

ZOO = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "zoo.py"))
METHODS = [("exponential", 1e-6), ("exponential", 1e-7), ("exponential", 1e-8), ("tsit5", 1e-7), ("dopri8", 1e-8)]
TRUTH = Solver("dopri8", 1e-11, 1e-13)
REPEATS = 5


def begun(model: Model, solver: Solver) -> Lane:
    return first_lane(Chain(model, (model.excitation.frequency,)), solver)


def measured(model: Model, lane: Lane, exact: np.ndarray, solver: Solver) -> tuple[float, float]:
    """Error of the derivative, and milliseconds."""
    own, times = replace(lane, control=begun(model, solver).control), []
    for _ in range(REPEATS + 1):  # the first compiles
        clock = time.process_time()
        slope = record([own], solver, [1])[0].slope
        times.append(1e3 * (time.process_time() - clock))
    return float(np.abs(slope - exact).max() / np.abs(exact).max()), float(np.median(times[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="7000:7060", help="first seed and the one behind the last")
    parser.add_argument("--size", default="3x2", help="modes and contacts")
    options = parser.parse_args()
    first, end = map(int, options.seeds.split(":"))
    modes, contacts = map(int, options.size.split("x"))
    rows = []
    for seed in range(first, end):
        model, _ = ZOO["driven"](seed, (modes, contacts))
        model = ZOO["with_full_stiffness"](model, seed) if seed % 2 else model
        lane = march_lanes([begun(model, TRUTH)], TRUTH, 20)[0][0]
        exact = record([lane], TRUTH, [1])[0]
        if (exact.steps.state == exact.steps.state_after).all():
            continue
        rows.append([measured(model, lane, exact.slope, Solver(name, rtol, rtol / 100)) for name, rtol in METHODS])
        print(seed, *(f"{error:.1e} ({ms:.1f} ms)" for error, ms in rows[-1]), flush=True)
    print(f"\n| {len(rows)} structures of {options.size} | median error | largest | CPU ms of a cycle, median |")
    print("|---|---|---|---|")
    for (name, rtol), (errors, ms) in zip(METHODS, np.array(rows).transpose(1, 2, 0), strict=True):
        print(f"| {name}, rtol {rtol:g} | {np.median(errors):.1e} | {errors.max():.1e} | {np.median(ms):.1f} |")


if __name__ == "__main__":
    main()
