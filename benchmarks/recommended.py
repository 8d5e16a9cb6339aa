"""Does the block that a tradeoff recommends keep the wanted error, and is it as fast as its table says?

    python benchmarks/recommended.py --seeds 3000:3010 --error 1e-6

Generated structures (`driven` of tests/zoo.py, 2 to 8 modes, 1 to 3 contacts, a size in turn), each as a scene of the
command line: a tradeoff with a budget of 40 s, then a transient by the block that it recommends. Its error is that to
dopri8 and to tsit5 at rtol 1e-12, the larger of the two; where these differ by more than a tenth of the wanted error,
nothing is known and the row is marked. The time is that of the table over the least of all runs in it that keep the
wanted error.
"""

import argparse
import json
import runpy
from pathlib import Path

import numpy as np

import timesim

HERE = Path(__file__).parent
ZOO = runpy.run_path(str(HERE.parent / "tests" / "zoo.py"))
ERROR = runpy.run_path(str(HERE / "promise.py"))["error_of"]
SIZES = ((2, 1), (4, 2), (8, 3))


def row(seed: int, wanted: float) -> str:
    size = SIZES[seed % len(SIZES)]
    model, cycles = ZOO["driven"](seed, size)
    scene = ZOO["scene_of"](model)
    table = timesim.run(scene | {"study": {"kind": "tradeoff", "cycles": cycles, "error": wanted, "budget": 40}})
    block = json.loads(table.attrs["recommended"])
    run = scene | {"study": {"kind": "transient", "cycles": cycles, "record_last": 1}}
    exact = [
        timesim.run(run, {"solver": {"method": method, "rtol": 1e-12, "estimate_error": False}})
        for method in ("dopri8", "tsit5")
    ]
    measure = (2 * np.pi * model.excitation.frequency, model.structure.mass)
    known = ERROR(exact[0], exact[1], *measure)
    own = timesim.run(run, {"solver": block})
    error = max(ERROR(own, true, *measure) for true in exact)
    whole = (table.modes_kept == table.attrs["num_modes"]) & (table.reduced == 1) & (table.error <= wanted)
    seconds = table.seconds_a_cycle.values[table.attrs["recommended_trial"]]
    share = seconds / table.seconds_a_cycle.values[whole].min() if whole.any() else np.nan
    verdict = "unknown" if known > 0.1 * wanted else "kept" if error <= wanted else "not kept"
    cells = (
        f"{size[0]} modes, {size[1]} contacts, seed {seed}",
        table.sizes["trial"],
        json.dumps(block),
        f"{table.error.values[table.attrs['recommended_trial']]:.1e}",
        f"{error:.1e}",
        verdict,
        f"{own.attrs['estimated_error']:.1e}",
        f"{share:.2f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="3000:3010", help="first and one behind the last")
    parser.add_argument("--error", type=float, default=1e-6)
    options = parser.parse_args()
    heads = ("structure", "runs", "recommended", "its error in the table", "its true error", "verdict", "estimated")
    print("| " + " | ".join((*heads, "time over the least")) + " |\n" + "|---" * (len(heads) + 1) + "|")
    for seed in range(*map(int, options.seeds.split(":"))):
        print(row(seed, options.error), flush=True)


if __name__ == "__main__":
    main()
