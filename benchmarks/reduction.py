"""What is gained by leaving out what a scene does not need?

Run `python benchmarks/reduction.py`. Each scene with ``solver.reduce`` true and false, in turn: microseconds a cycle
of the whole run, compiled before, median of several; the ratio; and the difference of the last state, which must be
rounding or the solver's tolerance.
"""

import argparse
import os
import statistics
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from timesim.engine.trajectory import Phase, Run
from timesim.model.solver import PRESETS
from timesim.study.registry import load_scene

ROOT = Path(__file__).parents[1]
OSCILLATOR, MANY = ROOT / "configs" / "oscillator.yaml", ROOT / "tests" / "data" / "many_modes.yaml"
CYCLES = 200
STRAIGHT = {"structure.modes.0.shape.tip": [1, 0, 0.8], "structure.modes.1.shape.tip": [1, 0, 0.6]}
SCENES: dict[str, tuple[Path, dict[str, Any]]] = {
    "contact proven to stick (n0 = 40)": (OSCILLATOR, {"contacts.pad.preload": 40}),
    "contact proven to stay apart (n0 = -40)": (OSCILLATOR, {"contacts.pad.preload": -40}),
    "straight motion": (OSCILLATOR, STRAIGHT),
    "20 modes, three contacts that stay apart": (
        MANY,
        {f"contacts.{i}.preload": -1e4 for i in range(3)},
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {CYCLES} cycles, accuracy standard\n")
    print("| scene | µs a cycle, reduced | whole | whole/reduced | difference |\n|---|---|---|---|---|")
    for name, (path, overrides) in SCENES.items():
        model = load_scene(path, overrides).model()
        assert model.excitation.frequency is not None
        phases = [Phase(model.excitation.frequency, CYCLES)]
        seconds: dict[bool, list[float]] = {True: [], False: []}
        ends = {}
        for _ in range(options.repeats + 1):
            for reduced in (True, False):
                clock = time.perf_counter()
                run = Run(model, phases, replace(PRESETS["standard"], reduce=reduced))
                for _ in run.batches():
                    pass
                seconds[reduced].append(time.perf_counter() - clock)
                ends[reduced] = np.concatenate([run.displacement, run.velocity])
        lean, whole = (statistics.median(seconds[reduced][1:]) / CYCLES * 1e6 for reduced in (True, False))
        difference = np.abs(ends[True] - ends[False]).max() / np.abs(ends[False]).max()
        print(f"| {name} | {lean:.0f} | {whole:.0f} | {whole / lean:.2f} | {difference:.1e} |", flush=True)


if __name__ == "__main__":
    main()
