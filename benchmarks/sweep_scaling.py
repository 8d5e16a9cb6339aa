"""How much faster is a sweep on two threads than on one, and on a local dask cluster of one and two processes?

The oscillator at n0 = 3, 768 points from 0.8 to 1.65 Hz, standard accuracy, each from rest: six chunks of points. Every
way is taken twice, in turn, and the quicker time counts. A cluster is started anew for each run, as by
`timesim run --cluster local`: its time contains the start of the processes, their imports, and loading the compiled
programs. The load of the machine is printed, for on a busy one the ratios mean little. Results are compared
bit for bit.

    python benchmarks/sweep_scaling.py [points]
"""

import os
import sys
import time
from pathlib import Path

import numpy as np

import timesim

SCENE = Path(__file__).parents[1] / "configs" / "oscillator.yaml"
WAYS = {
    "1 thread": {"workers": 1},
    "2 threads": {"workers": 2},
    "cluster local, 1 process": {"cluster": "local", "workers": 1},
    "cluster local, 2 processes": {"cluster": "local", "workers": 2},
}
REPEATS = 2


def main() -> None:
    points = int(sys.argv[1]) if len(sys.argv) > 1 else 768
    step = (1.65 - 0.8) / (points - 1)
    study = {"kind": "sweep", "frequency": {"from": 0.8, "to": 1.65 + step / 4, "step": step}}
    best: dict[str, float] = {}
    results = {}
    print(f"load of the machine before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} processors")
    for _ in range(REPEATS):
        for name, means in WAYS.items():
            clock, cpu = time.perf_counter(), time.process_time()
            results[name] = timesim.run(str(SCENE), {"study": study}, **means)
            wall, busy = time.perf_counter() - clock, time.process_time() - cpu
            print(f"  {name}: {wall:.2f} s, of this process {busy:.2f} CPU s, run {results[name].run_seconds:.2f} s")
            best[name] = min(best.get(name, np.inf), wall)
    print(f"load of the machine after: {os.getloadavg()[0]:.2f}")
    first = best["1 thread"]
    reference = results["1 thread"]
    print(f"{'':>28} {'wall s':>8} {'speed':>6}  same bits")
    for name, wall in best.items():
        same = all(
            reference[variable].values.tobytes() == results[name][variable].values.tobytes() for variable in reference
        )
        print(f"{name:>28} {wall:8.2f} {first / wall:6.2f}  {'yes' if same else 'NO'}")


if __name__ == "__main__":
    main()
