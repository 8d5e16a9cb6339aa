"""Do two checkouts give the same results, bit for bit?

Run `python benchmarks/same_results.py BEFORE AFTER OUTPUT [scene ...]`: every scene of `BEFORE/configs` (or those
named) is run by both checkouts, each into a folder of `OUTPUT`, and all variables of both result files are compared.
Results that are already in `OUTPUT` are kept, so a checkout is run once. Both use the Python environment of this
command.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import xarray

NAN = np.nan


def run(checkout: Path, scene: Path, folder: Path) -> float:
    """Seconds of a run; NaN where its result is there already."""
    if (folder / "result.nc").exists():
        return NAN
    folder.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "timesim", "run", str(scene), "-o", str(folder), "--no-plots"]
    clock = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    with (folder.parent / f"{scene.stem}.log").open("w") as log:
        subprocess.run(command, cwd=checkout, env=environment, stdout=log, stderr=log, check=False)
    return time.perf_counter() - clock


def variables(path: Path) -> dict[str, np.ndarray]:
    """Every variable and coordinate of a result file by its path."""
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        return {
            f"{node.path.rstrip('/')}/{name}": np.asarray(variable.values)
            for node in tree.subtree
            for name, variable in node.to_dataset(inherit=False).variables.items()
        }


def difference(before: np.ndarray, after: np.ndarray) -> float:
    """Largest difference relative to the largest entry; 0 for the same bits, infinite where shape or kind differ."""
    if before.shape != after.shape or before.dtype.kind != after.dtype.kind:
        return np.inf
    if before.dtype.kind not in "fc":
        return 0.0 if np.array_equal(before, after) else np.inf
    if before.tobytes() == after.tobytes() or np.array_equal(before, after, equal_nan=True):
        return 0.0
    if not np.array_equal(np.isnan(before), np.isnan(after)):
        return np.inf
    size = np.nanmax(np.abs(before), initial=0.0)
    return float(np.nanmax(np.abs(after - before)) / size) if size else np.inf


def compared(before: Path, after: Path) -> str:
    """What differs between two result files, in words."""
    if not before.exists() or not after.exists():
        return "no result: see the logs"
    old, new = variables(before), variables(after)
    parts = [f"only before: {', '.join(sorted(old.keys() - new.keys()))}"] if old.keys() - new.keys() else []
    parts += [f"only after: {', '.join(sorted(new.keys() - old.keys()))}"] if new.keys() - old.keys() else []
    apart = {name: difference(old[name], new[name]) for name in old.keys() & new.keys()}
    apart = {name: size for name, size in apart.items() if size}
    parts += [f"{name} {size:.1e}" for name, size in sorted(apart.items())]
    return "; ".join(parts) or f"same bits in {len(old)} variables"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("scenes", nargs="*")
    given = parser.parse_args()
    output = given.output.absolute()
    scenes = sorted((given.before.absolute() / "configs").glob("*.yaml"))
    if unknown := set(given.scenes) - {scene.stem for scene in scenes}:
        parser.error(f"no scene is called {', '.join(sorted(unknown))}: give names without .yaml")
    for scene in scenes:
        if given.scenes and scene.stem not in given.scenes:
            continue
        folders = [output / side / scene.stem for side in ("before", "after")]
        seconds = []
        for checkout, folder in zip((given.before, given.after), folders, strict=True):
            own = checkout.absolute() / "configs" / scene.name
            seconds.append(run(checkout.absolute(), own, folder))
        told = " and ".join("kept" if np.isnan(s) else f"{s:.1f} s" for s in seconds)
        result = compared(*(folder / "result.nc" for folder in folders))
        print(f"{scene.stem:16} {told:18} {result}", flush=True)


if __name__ == "__main__":
    main()
