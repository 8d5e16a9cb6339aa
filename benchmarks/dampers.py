"""Dampers between two masses that couple the modes: what each method takes at equal error, and where auto takes which.

    python benchmarks/dampers.py
    python benchmarks/dampers.py --modes 12 --rates 1e3 1e5

A chain of masses on springs with little damping, a pad under one end, a force at the other, and one strong damper
between two masses. Its rate, over the highest natural frequency of the chain, is that at which the damper alone would
bring the masses together. Time of a cycle of a compiled run of 20 cycles, median of three, error of the last state
against dopri8 at rtol 1e-12, with the largest damper against kvaerno5 at rtol 1e-10.
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import statistics
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from timesim.model.choice import choice
from timesim.model.cost import Work, stable_steps
from timesim.model.model import Model
from timesim.study.registry import carry_out, load_scene

CYCLES, FREQUENCY, SPRING = 20, 0.9, 40.0
TOLERANCES = {
    "tsit5": (1e-5, 1e-7),
    "dopri8": (1e-8, 1e-10),
    "exponential": (1e-4, 1e-6),
    "kvaerno5": (1e-4, 1e-6, 1e-8),
}
BUDGET = 2_000_000
MOST_STEPS = 3e5  # explicit steps of a cycle beyond which only kvaerno5 is tried


def scene(modes: int, rate: float, solver: dict[str, Any]) -> dict[str, Any]:
    """The chain, its damper in the middle with a rate relative to the highest natural frequency."""
    stiffness = SPRING * (2 * np.eye(modes) - np.eye(modes, k=1) - np.eye(modes, k=-1))
    damping, middle = 1e-4 * SPRING * stiffness, modes // 2
    pair = np.ix_([middle - 1, middle], [middle - 1, middle])
    damping[pair] += rate * np.sqrt(SPRING) * np.array([[1, -1], [-1, 1]])
    points = {"free": {"x": 0}, "driven": {"x": modes - 1}}
    matrices = {"mass": np.eye(modes), "stiffness": stiffness, "damping": damping}
    return {
        "structure": {"matrices": {name: matrix.tolist() for name, matrix in matrices.items()} | {"points": points}},
        "contacts": [
            {
                "name": "pad",
                "point": "free",
                "normal": [0, 0, 1],
                "friction": 0.4,
                "tangential_stiffness": SPRING,
                "normal_stiffness": SPRING,
                "preload": 1.0,
            }
        ],
        "excitation": {
            "frequency": FREQUENCY,
            "forces": [{"point": "driven", "direction": [1, 0, 0], "amplitude": 2.0}],
        },
        "solver": solver,
        "study": {"kind": "transient", "cycles": CYCLES, "record_last": 1},
    }


def run(modes: int, rate: float, method: str, rtol: float) -> tuple[np.ndarray, float, int]:
    """The last state, seconds of a cycle, and steps of a cycle; compiled before."""
    solver = {"method": method, "rtol": rtol, "atol": rtol / 100, "max_steps": BUDGET, "estimate_error": False}
    loaded, times = load_scene(scene(modes, rate, solver)), []
    carry_out(loaded)
    for _ in range(3):
        clock = time.perf_counter()
        data = carry_out(loaded).groups[""]
        times.append(time.perf_counter() - clock)
    state = np.concatenate([data["final_modal_displacement"], data["final_modal_velocity"] / np.sqrt(SPRING)])
    return state, statistics.median(times) / CYCLES, int(data["cycle_steps"].sum()) // CYCLES


def chosen(model: Model) -> str:
    """What auto takes for each accuracy, of a long run."""
    work = Work.of_run(((FREQUENCY, 1_000_000),), estimated=False)
    names = (choice(accuracy, model, work, 100_000).solver.name for accuracy in ("draft", "standard", "reference"))
    return ", ".join(names)


def rows(modes: int, rate: float) -> Iterator[str]:
    """A row of the table for each method."""
    model = load_scene(scene(modes, rate, {"accuracy": "standard"})).model()
    explicit = stable_steps(model, FREQUENCY)
    few = explicit < MOST_STEPS
    truth, *_ = run(modes, rate, *(("dopri8", 1e-12) if few else ("kvaerno5", 1e-10)))
    for method, tolerances in TOLERANCES.items():
        if few or method == "kvaerno5":
            cells = []
            for rtol in tolerances:
                state, seconds, steps = run(modes, rate, method, rtol)
                error = np.abs(state - truth).max() / np.abs(truth).max()
                cells.append(f"{1e3 * seconds:.3g} ms, {steps} steps, {error:.0e}")
            yield f"| {modes} | {rate:g} | {explicit:.3g} | {method} | {'; '.join(cells)} |"
    yield f"| {modes} | {rate:g} | {explicit:.3g} | auto | {chosen(model)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--modes", type=int, nargs="+", default=[4, 12])
    parser.add_argument("--rates", type=float, nargs="+", default=[1e2, 1e3, 1e4, 1e6])
    given = parser.parse_args()
    print("| modes | rate of the damper | explicit steps for stability | method | a cycle, error of the last state |")
    print("|---|---|---|---|---|")
    for modes in given.modes:
        for rate in given.rates:
            for row in rows(modes, rate):
                print(row, flush=True)


if __name__ == "__main__":
    main()
