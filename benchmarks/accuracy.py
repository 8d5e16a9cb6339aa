"""What do the presets cost, and how large is their error?

Run `python benchmarks/accuracy.py`. Each preset, with the tolerances that it has for the scene, on each reference case
of `tests/data` (computed independently with DOP853 and located events at rtol 1e-12): error of the last state,
transitions found of those that there are, steps and microseconds a cycle. A run is the whole of it: every step recorded
and handed to the host, compiled before. Median of several runs, the presets in turn.

`--samples` tells instead how exact the samples of the last cycles are, between the steps: by their dense output.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from timesim.engine.history import events
from timesim.engine.trajectory import Phase, Run
from timesim.model.model import Model
from timesim.model.promise import PROMISE, preset
from timesim.model.solver import Solver
from timesim.study.registry import load_scene
from timesim.study.registry import run as simulate

CONFIGS, DATA = (Path(__file__).parents[1] / folder for folder in ("configs", "tests/data"))


class Case(NamedTuple):
    name: str
    model: Model
    frequency: float
    cycles: int
    state: np.ndarray  # displacement and velocity of the modes at the end
    num_events: int


def cases() -> list[Case]:
    found = []
    oscillator = json.loads((DATA / "oscillator.json").read_text())["cases"]
    for preload, frequency in ((3, 1.39), (-1, 0.97), (5, 1.52)):
        truth = oscillator[f"osc_n0={preload}_f={frequency:g}"]
        scene = load_scene(CONFIGS / "oscillator.yaml", {"contacts.pad.preload": preload})
        state = np.array(truth["state_end"])
        found.append(Case(f"oscillator, n0 = {preload}", scene.model(), frequency, 60, state, truth["n_events"]))
    truth = json.loads((DATA / "many_modes_truth.json").read_text())
    model = load_scene(DATA / "many_modes.yaml").model()
    frequency = model.excitation.frequency
    assert frequency is not None
    state = np.array(truth["state_end"])
    found.append(Case("20 modes, 3 contacts", model, frequency, truth["cycles"], state, truth["n_events"]))
    return found + [blade(name) for name in ("slip_720Hz", "separation_640Hz")]


def blade(name: str) -> Case:
    truth = json.loads((DATA / "blade_truth.json").read_text())["cases"][name]
    model = load_scene(DATA / "blade_modes.yaml", truth["set"]).model()
    end: dict[str, Any] = truth["transient"]
    state = np.concatenate([end["final_modal_displacement"], end["final_modal_velocity"]])
    return Case(f"blade, {name}", model, truth["set"]["excitation.frequency"], end["cycles"], state, end["events"])


def run(case: Case, solver: Solver) -> tuple[float, int, int, float]:
    """Error, transitions, steps and seconds of a run."""
    clock = time.perf_counter()
    simulation = Run(case.model, [Phase(case.frequency, case.cycles)], solver)
    found = [(events(steps).time.size, steps.time.size) for steps in simulation.batches()]
    seconds = time.perf_counter() - clock
    # Displacement and velocity each by its own largest entry: in SI units the velocities would hide the rest.
    halves = np.split(case.state, 2)
    ends = (simulation.displacement, simulation.velocity)
    error = max(np.abs(end - half).max() / np.abs(half).max() for end, half in zip(ends, halves, strict=True))
    return error, sum(count for count, _ in found), sum(steps for _, steps in found), seconds


def print_samples() -> None:
    """Largest error of each quantity over the samples, by its largest size; truth: RK4 with 4,000 steps a cycle."""
    names = ("displacement", "velocity", "slip", "contact_force")
    print(f"| scene | accuracy | {' | '.join(names)} |\n|---|---|{'---|' * len(names)}")
    for scene in ("oscillator", "blade"):
        path, fine = CONFIGS / f"{scene}.yaml", {"method": "rk4", "steps_per_cycle": 4000}
        truth = simulate(path, {"solver": fine, "study.record_last": 2})
        for accuracy in PROMISE:
            found = simulate(path, {"solver": {"accuracy": accuracy}, "study.record_last": 2})
            errors = [np.abs(found[name] - truth[name]).max() / np.abs(truth[name]).max() for name in names]
            print(f"| {scene} | {accuracy} | {' | '.join(f'{float(error):.1e}' for error in errors)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--samples", action="store_true", help="of the samples instead")
    options = parser.parse_args()
    if options.samples:
        return print_samples()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    print(
        "| case | accuracy | rtol | error | transitions | steps a cycle | µs a cycle |\n|---|---|---|---|---|---|---|"
    )
    for case in cases():
        solvers = {name: preset(name, case.model, case.frequency, case.cycles) for name in PROMISE}
        results = {name: [run(case, solver)] for name, solver in solvers.items()}
        for _ in range(options.repeats):
            for name, solver in solvers.items():
                results[name].append(run(case, solver))
        for name, rows in results.items():
            error, count, steps, _ = rows[0]
            seconds = statistics.median(row[3] for row in rows[1:])
            print(
                f"| {case.name} | {name} | {solvers[name].rtol:g} | {error:.1e} | {count} of {case.num_events} "
                f"| {steps / case.cycles:.0f} | {seconds / case.cycles * 1e6:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
