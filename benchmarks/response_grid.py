"""How long does figure 10's grid take: nine preloads, 0.80 to 1.65 Hz by 0.01, every point settled?

Run `python benchmarks/response_grid.py` (numba comes with the extra `bench`). The sweep runs as users run it, a process
of its own with its compiled programs on disk; the serial numba march of the same 774 points is compiled before it is
timed. Both in turn, several times over; medians. Amplitudes of the two are compared point by point.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from opponents import numba_rk4
from problems import oscillator

from timesim.result.netcdf import open_result

PRELOADS = (-4.0, -1.0, 0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 32.0)
SCENE = Path(__file__).parents[1] / "configs" / "oscillator.yaml"
GRID = "{from: 0.80, to: 1.65, step: 0.01}"


def sweep(periodic: str, folder: Path) -> tuple[float, float, np.ndarray]:
    """Seconds of the whole process and of the study in it, and the amplitude of x, shape (9, 86)."""
    over = f"{{contacts.pad.preload: {list(PRELOADS)}}}"
    study = f"study={{kind: sweep, frequency: {GRID}, over: {over}, periodic: {periodic}}}"
    command = [
        sys.executable,
        "-c",
        "from timesim.cli import main; main()",
        "run",
        str(SCENE),
        "-o",
        str(folder),
        "--force",
        "--no-plots",
    ]
    start = time.perf_counter()
    subprocess.run([*command, "--set", study], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    whole = time.perf_counter() - start
    data = open_result(folder)
    inside = data.attrs["compile_seconds"] + data.attrs["run_seconds"]
    return whole, inside, data.amplitude.sel(point="tip", axis="x").isel(direction=0).values


def numba_march(steps: int) -> tuple[float, float, np.ndarray]:
    """Seconds, twice for the shape of `sweep`, and the amplitude of x."""
    frequency = 0.80 + 0.01 * np.arange(86)
    start = time.perf_counter()
    found = []
    for preload in PRELOADS:
        model = oscillator(preload)
        constants = numba_rk4.scene(model, steps)
        march = numba_rk4.march
        found.append([march(model, f, constants=constants, steps_per_cycle=steps).amplitude[0, 0] for f in frequency])
    seconds = time.perf_counter() - start
    return seconds, seconds, np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {repeats} runs of each in turn, medians")
    with tempfile.TemporaryDirectory() as name:
        runs = {
            "timesim, shooting": lambda: sweep("shoot", Path(name) / "shoot"),
            "timesim, marching": lambda: sweep("march", Path(name) / "march"),
            "numba march, 50 steps/cycle": lambda: numba_march(50),
            "numba march, 200 steps/cycle": lambda: numba_march(200),
            "numba march, 800 steps/cycle": lambda: numba_march(800),
        }
        amplitude = {who: run()[2] for who, run in runs.items()}  # compiles what is not compiled
        times: dict[str, list[tuple[float, float]]] = {who: [] for who in runs}
        for _ in range(repeats):
            for who, run in runs.items():
                times[who].append(run()[:2])
    truth = amplitude["timesim, shooting"]
    print("\n| who | whole process [s] | from the end of imports [s] | largest difference |\n|---|---|---|---|")
    for who, taken in times.items():
        whole, inside = (statistics.median(column) for column in zip(*taken, strict=True))
        difference = np.nanmax(np.abs(amplitude[who] - truth) / truth.max(axis=1, keepdims=True))
        shown = f"{whole:.2f}" if who.startswith("timesim") else "-"
        print(f"| {who} | {shown} | {inside:.2f} | {difference:.1e} |")


if __name__ == "__main__":
    main()
