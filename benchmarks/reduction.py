"""What is gained by leaving out what a scene does not need?

Run `python benchmarks/reduction.py`. Each scene reduced and whole, in turn: CPU microseconds a cycle of a run that is
recorded, and marched as to a steady state, compiled before, median of several; the ratios; and the difference of the
last state, which must be rounding or the solver's tolerance. The same tangential stiffness in all directions is taken
away by a part in a million, which is the difference to expect.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from timesim.engine.trajectory import Phase, Run
from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import CLOSED_FORM, PRESETS, Criterion, Solver
from timesim.orbit.batch import march_lanes
from timesim.orbit.settling import Chain, first_lane, steady_states
from timesim.study.registry import load_scene

ROOT = Path(__file__).parents[1]
OSCILLATOR, MANY = ROOT / "configs" / "oscillator.yaml", ROOT / "tests" / "data" / "many_modes.yaml"
CYCLES, POINTS = 40, 16
STRAIGHT = {"structure.modes.0.shape.tip": [1, 0, 0.8], "structure.modes.1.shape.tip": [1, 0, 0.6]}
SCENES: dict[str, tuple[Path, dict[str, Any]]] = {
    "contact proven to stick (n0 = 40)": (OSCILLATOR, {"contacts.pad.preload": 40}),
    "contact proven to stay apart (n0 = -40)": (OSCILLATOR, {"contacts.pad.preload": -40}),
    "20 modes, three contacts that stay apart": (MANY, {f"contacts.{i}.preload": -1e4 for i in range(3)}),
    "straight motion": (OSCILLATOR, STRAIGHT),
    "straight motion, 20 modes, three contacts": (MANY, {}),
    "10 of 20 modes that nothing moves": (MANY, {}),
    "the same tangential stiffness in all directions": (OSCILLATOR, {}),
    "the same, 20 modes, three contacts": (MANY, {}),
}


def straightened(model: Model) -> Model:
    """Every contact moves along its first tangential axis and its normal."""
    shape = model.structure.shape.copy()
    for contact in model.contacts:
        point = model.structure.points.index(contact.point)
        shape[point] -= np.outer(contact.frame[1], contact.frame[1]) @ shape[point]
    return replace(model, structure=replace(model.structure, shape=shape))


def half_still(model: Model) -> Model:
    """Nothing moves every second mode: no contact, no force."""
    body, load = model.structure, model.excitation
    moves = np.arange(body.num_modes) % 2 == 0
    load = replace(load, cosine=load.cosine * moves, sine=load.sine * moves)
    return replace(model, structure=replace(body, shape=body.shape * moves), excitation=load)


def turned(model: Model) -> Model:
    """Tangential stiffness that is not quite the same in both directions."""
    apart = np.diag([1.0, 1.0 + 1e-6])
    contacts = (replace(c, tangential_stiffness=c.tangential_stiffness * apart) for c in model.contacts)
    return replace(model, contacts=tuple(contacts))


Pair = tuple[tuple[Model, Solver], tuple[Model, Solver]]


def pair(name: str) -> Pair:
    """The scene reduced and whole, each with its solver."""
    path, overrides = SCENES[name]
    model, lean = load_scene(path, overrides).model(), PRESETS["standard"]
    if "directions" in name or "the same" in name:
        return (model, lean), (turned(model), lean)
    if "straight motion, " in name:
        model = straightened(model)
    if "nothing moves" in name:
        model = half_still(model)
    return (model, lean), (model, replace(lean, reduce=False))


def recorded(model: Model, solver: Solver) -> np.ndarray:
    """The state at the end of a run; in closed form where no contact is left in it, as a transient has it."""
    assert model.excitation.frequency is not None
    frequency = model.excitation.frequency
    if not reduction_of(model, [frequency], reduce=solver.reduce).live.size:
        solver = replace(solver, name=CLOSED_FORM)
    run = Run(model, [Phase(frequency, CYCLES)], solver)
    for _ in run.batches():
        pass
    return np.concatenate([run.displacement, run.velocity])


def marched(model: Model, solver: Solver) -> np.ndarray:
    """The state at the end of a march."""
    assert model.excitation.frequency is not None
    lane = first_lane(Chain(model, (model.excitation.frequency,)), solver)
    return march_lanes([lane], solver, CYCLES)[0][1][-1]


def alternated(work: Callable[..., np.ndarray], both: Pair, repeats: int) -> tuple[list[float], list[np.ndarray]]:
    """Median CPU seconds of each of two, run in turn, and their results."""
    seconds: list[list[float]] = [[], []]
    ends = [np.zeros(0)] * 2
    for _ in range(repeats + 1):
        for index, (model, solver) in enumerate(both):
            clock = time.process_time()
            ends[index] = work(model, solver)
            seconds[index].append(time.process_time() - clock)
    return [statistics.median(own[1:]) for own in seconds], ends


def steady(model: Model, solver: Solver) -> np.ndarray:
    """Amplitudes of steady states from 1.0 to 1.5 Hz; in closed form where contacts are proven to keep their states."""
    chains = [Chain(model, (frequency,)) for frequency in np.linspace(1.0, 1.5, POINTS)]
    return np.array([orbits[0].amplitude for orbits in steady_states(chains, solver, Criterion())]).ravel()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {CYCLES} cycles, accuracy standard\n")
    head = "| scene | recorded: CPU µs a cycle | whole | gain | marched: CPU µs a cycle | whole | gain | difference |"
    print(head, "|---|---|---|---|---|---|---|---|", sep="\n")
    for name in SCENES:
        both, cells = pair(name), []
        for work in (recorded, marched):
            (lean, whole), ends = alternated(work, both, options.repeats)
            cells += [f"{lean / CYCLES * 1e6:.3g}", f"{whole / CYCLES * 1e6:.3g}", f"{whole / lean:.2f}"]
            if work is recorded:
                difference = np.abs(ends[0] - ends[1]).max() / np.abs(ends[1]).max()
        print(f"| {name} | {' | '.join(cells)} | {difference:.1e} |", flush=True)
    model = load_scene(OSCILLATOR, {"contacts.pad.preload": 40}).model()
    (lean, whole), ends = alternated(
        steady, ((model, PRESETS["standard"]), (model, replace(PRESETS["standard"], reduce=False))), 3
    )
    difference = np.abs(ends[0] - ends[1]).max() / np.abs(ends[1]).max()
    each = f"{lean / POINTS * 1e3:.3g} against {whole / POINTS * 1e3:.3g} ms of CPU a steady state"
    print(f"\nlinear in closed form (n0 = 40): {each}, {whole / lean:.0f} times, difference {difference:.1e}")


if __name__ == "__main__":
    main()
