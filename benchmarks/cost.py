"""How long do a step, a cycle and a solution take, by the numbers of modes and contacts?

Run `python benchmarks/cost.py`. Generated structures whose contacts stick and slip: steps a cycle at each accuracy, and
microseconds a step, of a run that is recorded and of one that is marched, as to a steady state, compiled before;
milliseconds of a cycle with the derivative of its end by its start, as Newton's method and the measure of a settled
motion take it. CPU seconds beside wall seconds, since other jobs may share the machine. The rows stand in
`timesim/model/cost.py`, from which `timesim check` estimates what a scene will take.
"""

import argparse
import time

import numpy as np

from timesim.engine.trajectory import Phase, Run
from timesim.model.model import GROUND, Contact, Excitation, Model, Structure
from timesim.model.solver import PRESETS
from timesim.model.start import rest_start
from timesim.orbit.batch import march_lanes, record
from timesim.orbit.settling import Chain, first_lane

SIZES = ((2, 1), (10, 1), (10, 4), (30, 1), (30, 4), (50, 10))
CYCLES, REPEATS = 20, 3
FREQUENCY = 1.3


def structure(num_modes: int, num_contacts: int) -> Model:
    """Modes from 1 to 8 Hz, each contact at a point of its own and as stiff as the first mode."""
    random = np.random.default_rng(3)
    natural = np.geomspace(1.0, 8.0, num_modes)
    names = tuple(f"p{k}" for k in range(num_contacts))
    shape = random.uniform(-1, 1, (num_contacts, 3, num_modes))
    body = Structure(natural, np.ones(num_modes), 2 * 0.02 * 2 * np.pi * natural, names, shape)
    stiffness = (2 * np.pi) ** 2
    contacts = tuple(
        Contact(f"c{k}", name, GROUND, np.eye(3), 0.4, stiffness * np.eye(2), stiffness, 1.0)
        for k, name in enumerate(names)
    )
    force = random.uniform(0.5, 1, (1, num_modes))
    load = Excitation(FREQUENCY, np.array([1]), force, np.zeros_like(force), np.zeros(num_modes))
    return Model(body, contacts, load, rest_start(num_modes, num_contacts))


def recorded(model: Model, accuracy: str) -> tuple[float, float, float]:
    """Steps a cycle, wall and CPU microseconds a step of a run; the least of some runs."""
    best = (np.inf, np.inf)
    for _ in range(REPEATS + 1):  # the first compiles
        run = Run(model, [Phase(FREQUENCY, CYCLES)], PRESETS[accuracy])
        wall, cpu = time.perf_counter(), time.process_time()
        steps = sum(part.time.size for part in run.batches())
        best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
    return steps / CYCLES, 1e6 * best[0] / steps, 1e6 * best[1] / steps


def marched(model: Model, accuracy: str, steps: float) -> tuple[float, float]:
    """Wall and CPU microseconds a step of a march."""
    lane, best = first_lane(Chain(model, (FREQUENCY,)), PRESETS[accuracy]), (np.inf, np.inf)
    for _ in range(REPEATS + 1):
        wall, cpu = time.perf_counter(), time.process_time()
        march_lanes([lane], PRESETS[accuracy], CYCLES)
        best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
    number = steps * CYCLES
    return 1e6 * best[0] / number, 1e6 * best[1] / number


def differentiated(model: Model, accuracy: str) -> tuple[float, float]:
    """Wall and CPU milliseconds of a cycle with its derivative."""
    lane, best = first_lane(Chain(model, (FREQUENCY,)), PRESETS[accuracy]), (np.inf, np.inf)
    for _ in range(REPEATS + 1):
        wall, cpu = time.perf_counter(), time.process_time()
        record([lane], PRESETS[accuracy], [1])
        best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
    return 1e3 * best[0], 1e3 * best[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--accuracy", nargs="+", default=["standard"], choices=list(PRESETS))
    parser.add_argument("--sizes", nargs="+", metavar="MxC", default=[f"{m}x{c}" for m, c in SIZES])
    options = parser.parse_args()
    times = "µs a step, recorded (CPU) | marched (CPU) | ms a cycle with its derivative (CPU)"
    print(f"| modes | contacts | accuracy | steps a cycle | {times} |")
    print("|---|---|---|---|---|---|---|")
    for num_modes, num_contacts in (map(int, size.split("x")) for size in options.sizes):
        model = structure(num_modes, num_contacts)
        for accuracy in options.accuracy:
            steps, wall, cpu = recorded(model, accuracy)
            other, other_cpu = marched(model, accuracy, steps)
            times = f"{wall:.3g} ({cpu:.3g}) | {other:.3g} ({other_cpu:.3g})"
            times += " | {:.2g} ({:.2g})".format(*differentiated(model, accuracy))
            print(f"| {num_modes} | {num_contacts} | {accuracy} | {steps:.0f} | {times} |", flush=True)


if __name__ == "__main__":
    main()
