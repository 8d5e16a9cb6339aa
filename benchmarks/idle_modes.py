"""What do the idle modes take that fill a system up to a number of modes for which a program is compiled?

Structures whose numbers of modes are none of `timesim.engine.system.room_of`, each run with idle modes and without, in
turn: CPU time of a run that is compiled already, as a ratio of medians.

    python benchmarks/idle_modes.py
"""

import argparse
import time

import numpy as np
from problems import many_modes

from timesim.engine import system
from timesim.engine.trajectory import Phase, Run
from timesim.model.solver import Solver

ROOM_OF = system.room_of
SIZES = ("5x1", "7x2", "9x3", "11x5", "17x3", "21x3", "33x5", "50x10")
METHODS = ("tsit5", "dopri8", "exponential")
CYCLES, FREQUENCY = 60, 1.0


def seconds(size: tuple[int, int], method: str, *, idle: bool) -> float:
    """CPU seconds of a run."""
    system.room_of = ROOM_OF if idle else lambda reduction: reduction.modes.size
    clock = time.process_time()
    for _ in Run(many_modes(*size), [Phase(FREQUENCY, CYCLES)], Solver(method, 1e-6, 1e-9)).batches():
        pass
    return time.process_time() - clock


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", metavar="MxC", default=SIZES)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    print("| modes x contacts | " + " | ".join(METHODS) + " |\n|" + "---|" * (1 + len(METHODS)), flush=True)
    for text in options.sizes:
        modes, contacts = map(int, text.split("x"))
        ratios = []
        for method in METHODS:
            times = np.array(
                [
                    [seconds((modes, contacts), method, idle=idle) for idle in (True, False)]
                    for _ in range(1 + options.repeats)
                ]
            )
            own, bare = np.median(times[1:], axis=0)
            ratios.append(f"{own / bare:.2f}")
        print(f"| {modes} x {contacts} | {' | '.join(ratios)} |", flush=True)


if __name__ == "__main__":
    main()
