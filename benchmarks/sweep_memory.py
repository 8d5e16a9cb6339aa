"""Does the memory of a sweep grow with its number of points, and how long does it take?

Each number of points is run in a process of its own: the oscillator at n0 = 3 from 0.8 to 1.65 Hz, draft accuracy,
each point from rest. Printed: wall and processor time, the run itself without imports and compilation, peak memory.
Compiled programs come from the cache of an earlier run; run it twice, or the first row contains the compilation.

    python benchmarks/sweep_memory.py [1000 10000 ...]
"""

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

SCENE = Path(__file__).parents[1] / "configs" / "oscillator.yaml"


def measure(points: int, folder: str) -> dict[str, float]:
    """Run the sweep in this process, with its checkpoints, and tell what it took."""
    from timesim.study.execution.campaign import Execution
    from timesim.study.registry import carry_out, load_scene

    step = (1.65 - 0.8) / (points - 1)
    study = {"kind": "sweep", "frequency": {"from": 0.8, "to": 1.65 + step / 4, "step": step}}
    scene = load_scene(SCENE, {"solver.accuracy": "draft", "study": study})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    outcome = carry_out(scene, Execution(folder=Path(folder)))
    record = outcome.groups[""]
    found = {str(name): array.values for name, array in record.data_vars.items()}
    used = resource.getrusage(resource.RUSAGE_SELF)
    assert outcome.reason is None
    assert found["settled"].size == points
    return {
        "points": points,
        "settled": int(found["settled"].sum()),
        "cycles": int(found["cycles"].sum()),
        "run_s": record.attrs["run_seconds"],
        "cpu_s": used.ru_utime + used.ru_stime,
        "before_mb": before / 1024,
        "peak_mb": used.ru_maxrss / 1024,
    }


def main() -> None:
    import tempfile

    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(measure(int(sys.argv[2]), sys.argv[3])))
        return
    print(f"{'points':>8} {'settled':>8} {'cycles':>9} {'wall s':>8} {'run s':>8} {'CPU s':>8} {'peak MB':>8}")
    for points in map(int, sys.argv[1:] or ["1000", "10000"]):
        clock = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, __file__, "--one", str(points), folder]
            done = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        wall = time.perf_counter() - clock
        print(
            f"{points:8d} {done['settled']:8d} {done['cycles']:9d} {wall:8.1f} {done['run_s']:8.1f} "
            f"{done['cpu_s']:8.1f} {done['peak_mb']:8.0f}"
        )


if __name__ == "__main__":
    main()
