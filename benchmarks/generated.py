"""Does harmonic balance start, arrive and agree with time integration on structures that nobody has seen?

Generated structures (tests/zoo.py), each run as a `compare` scene over 1.5 octaves around its first free and stuck
natural frequency, harmonics and samples chosen by the program. The seeds were set once and nothing was tuned on them.

    python benchmarks/generated.py --seeds 100:140

A row a structure: how the balance ends, its harmonics, samples, solutions and folds, CPU seconds of the balance with
what it compiles, and the difference of amplitudes where the motion settles with period one, relative to the largest.
"""

import argparse
import runpy
import time
from pathlib import Path
from typing import Any

import numpy as np
from xarray import DataTree

import timesim
from timesim.model.model import Model
from timesim.study import compare
from timesim.study.hbm import followed

POINTS = 16
ZOO = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "zoo.py"))
STRUCTURE, SCENE = ZOO["structure"], ZOO["scene_of"]
SAME_BRANCH, AGREE = 0.05, 1e-3


def scene_of(model: Model, free: float) -> dict[str, Any]:
    """The `compare` scene of a structure whose first mode without contacts is at a frequency [Hz]."""
    stuck = float(np.min(model.stuck_omega)) / (2 * np.pi)
    low, high = free / 2**0.75, (stuck if stuck <= 3 * free else 1.5 * free) * 2**0.75
    study = {
        "kind": "compare",
        "frequency": {"from": low, "to": high, "step": (high - low) / POINTS},
        "settle": {"tolerance": 1e-7, "max_cycles": 1000},
    }
    return SCENE(model) | {"study": study}


def differences(result: DataTree) -> np.ndarray:
    """Of the amplitudes of settled points of period one from the balance's, by the largest; NaN without a solution."""
    sweep = result["sweep"].to_dataset()
    amplitude = sweep.amplitude.transpose("direction", "frequency", "point", "axis").values[0]
    relative = result["relative_difference"].transpose("direction", "frequency", "point", "axis").values[0]
    height = amplitude.max(axis=(1, 2))
    moving = amplitude > 1e-6 * height[:, None, None]
    found = np.max(np.abs(relative) * amplitude, axis=(1, 2), where=moving, initial=0.0) / height
    settled = (sweep.settled.values[0] == 1) & (sweep.period.values[0] == 1)
    return found[settled]


def row(seed: int) -> str:
    model, free = STRUCTURE(seed)
    begin, seconds = time.process_time(), []

    def timed(*args: Any, **options: Any) -> Any:
        clock = time.process_time()
        done = followed(*args, **options)
        seconds.append(time.process_time() - clock)
        return done

    compare.followed = timed
    try:
        result = timesim.run(scene_of(model, free))
    except Exception as error:  # a row of the table
        return f"| {seed} | {model.structure.num_modes} | {model.num_contacts} | {type(error).__name__}: {error} |"
    own = result["hbm"].to_dataset()
    scheme = own.attrs["method"].removeprefix("harmonic balance, ")
    ending = "to its end" if own.attrs["complete"] else str(own.attrs.get("incomplete", "not to its end"))
    found = differences(result)
    same = found[found < SAME_BRANCH]
    cells = (
        seed,
        model.structure.num_modes,
        model.num_contacts,
        ending,
        scheme,
        own.sizes["solution"],
        int(own.fold.sum()),
        f"{seconds[0]:.1f}",
        f"{time.process_time() - begin:.1f}",
        found.size,
        f"{np.max(same, initial=0.0):.1e}",
        int(np.count_nonzero(same > AGREE)),
        int(np.count_nonzero(found >= SAME_BRANCH)),
        int(np.count_nonzero(np.isnan(found))),
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="100:140", help="first and one behind the last")
    first, last = map(int, parser.parse_args().seeds.split(":"))
    heads = "seed, modes, contacts, curve, scheme, solutions, folds, CPU s of the balance, CPU s in all, "
    heads += "points of period one, largest difference, above 1e-3, on another branch, without a solution"
    print("| " + heads.replace(", ", " | ") + " |\n" + "|---" * (heads.count(",") + 1) + "|")
    for seed in range(first, last):
        print(row(seed), flush=True)


if __name__ == "__main__":
    main()
