"""Do the presets keep their promise, and is the estimated error right, on structures that nobody tuned on?

    python benchmarks/promise.py --seeds 1000:1010

Generated structures (`driven` of tests/zoo.py: 2 to 50 modes, 1 to 8 contacts) run as scenes of the command line,
each by every preset. The truth is dopri8 at rtol 1e-12, and certain where a method of another family, exponential
collocation at 1e-11, is a tenth as far from it as the run. Kept are structures of which a contact slips for 5 to 95 %
of the last cycle. A row a run: its method and the tolerance in the end, whether it was repeated, the true error of
the last state, the estimated one, the promise; then the errors of the amplitudes, the largest of all cycles, true and
estimated, and how well the truth of these is known.

With `--by-hand exponential tsit5` these methods are given in place of the presets, at tolerances a decade apart. A row
says how the true error of the last state is to the estimated one, where that is not said to be in doubt.
"""

import timesim.runtime  # isort: skip

import argparse
import runpy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import jax
import numpy as np
from xarray import Dataset

from timesim.engine.companion import amplitude_error
from timesim.model.model import SEPARATION, SLIP
from timesim.model.promise import PROMISE
from timesim.study.registry import carry_out, load_scene

ZOO = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "zoo.py"))
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7)
SIZES = ((2, 1), (4, 2), (8, 3), (20, 4), (30, 6), (50, 8))


def shares(run: Dataset, state: int) -> np.ndarray:
    """Share of the last cycle that each contact is in a state."""
    found: np.ndarray = np.mean(run.contact_state.values == state, axis=0)
    return found


def error_of(run: Dataset, true: Dataset, omega: float, mass: np.ndarray) -> float:
    """Error of the last state in the norm of `timesim.engine.companion`."""
    root = np.sqrt(mass)
    q, p = (np.max(np.abs(true[f"modal_{name}"].values) * root) for name in ("displacement", "velocity"))
    parts = zip(("displacement", "velocity"), (q, max(p, omega * q)), strict=True)
    return max(
        float(np.max(np.abs(run[f"final_modal_{name}"] - true[f"final_modal_{name}"]).values * root)) / size
        for name, size in parts
    )


def largest(error: np.ndarray) -> float:
    """Of all cycles."""
    return float(np.max(error))


@dataclass(frozen=True)
class Structure:
    """A scene of a generated structure, its true run, and that of another method.

    Attributes:
        measure: circular frequency of the excitation and masses of the modes, for `error_of`.
    """

    scene: dict[str, Any]
    true: Dataset
    other: Dataset
    measure: tuple[float, np.ndarray]

    def error_of(self, run: Dataset) -> float:
        return error_of(run, self.true, *self.measure)


def structure(seed: int, size: tuple[int, int], *, full: bool = False) -> Structure | None:
    """None where no contact slips for a part of the cycle; ``full``: contacts with a full K_u."""
    model, cycles = ZOO["driven"](seed, size)
    model = ZOO["with_full_stiffness"](model, seed) if full else model
    scene = ZOO["scene_of"](model) | {"study": {"kind": "transient", "cycles": cycles, "record_last": 1}}
    exact = {"method": "dopri8", "rtol": 1e-12, "estimate_error": False}
    true = timesim.run(scene, {"solver": exact})
    slip = shares(true, SLIP)
    if not np.any((slip > 0.05) & (slip < 0.95)):
        return None
    other = timesim.run(scene, {"solver": exact | {"method": "exponential", "rtol": 1e-11}})
    return Structure(scene, true, other, (2 * np.pi * model.excitation.frequency, model.structure.mass))


def by_hand(methods: Sequence[str], structures: Iterator[Structure]) -> None:
    """Print how true errors are to estimated ones where a method is given."""
    ratios: dict[tuple[str, float], list[float]] = {}
    for own in structures:
        sure = own.error_of(own.other)
        for method, rtol in product(methods, TOLERANCES):
            run = timesim.run(own.scene, {"solver": {"method": method, "rtol": rtol}})
            error = own.error_of(run)
            if sure < 0.1 * error and not run.attrs["estimate_remark"]:
                ratios.setdefault((method, rtol), []).append(error / run.attrs["estimated_error"])
    print("| method | rtol | runs | true over estimated error, median | largest | above 10 | below 0.1 |")
    print("|---|---|---|---|---|---|---|")
    for (method, rtol), found in sorted(ratios.items()):
        ratio = np.array(found)
        outside = f"{np.sum(ratio > 10)} | {np.sum(ratio < 0.1)}"
        print(f"| {method} | {rtol:g} | {ratio.size} | {np.median(ratio):.2g} | {ratio.max():.2g} | {outside} |")


def rows(seed: int, size: tuple[int, int], *, full: bool = False) -> list[dict[str, Any]]:
    """The runs of a structure; none where no contact slips for a part of the cycle, or the truth is not certain."""
    own = structure(seed, size, full=full)
    if own is None:
        return []
    scene, true, other, cycles = own.scene, own.true, own.other, own.scene["study"]["cycles"]
    apart, measure = shares(true, SEPARATION), own.measure
    sure, found = own.error_of(other), []
    for accuracy in PROMISE:
        outcome = carry_out(load_scene(scene, {"solver.accuracy": accuracy}))
        run = outcome.groups[""]
        found.append(
            {
                "structure": f"{size[0]} modes, {size[1]} contacts, seed {seed}",
                "cycles": cycles,
                "transitions": true.sizes["event"],
                "separates": bool(np.any((apart > 0.02) & (apart < 0.98))),
                "accuracy": accuracy,
                "method": run.attrs["method"],
                "rtol": run.attrs["rtol"],
                "repeated": "above the promised" in outcome.summary[0],
                "true": error_of(run, true, *measure),
                "estimated": run.attrs["estimated_error"],
                "promised": PROMISE[accuracy],
                "sure": sure,
                "true amplitude": largest(amplitude_error(run.cycle_amplitude.values, true.cycle_amplitude.values)),
                "estimated amplitude": largest(run.cycle_amplitude_error.values),
                "sure amplitude": largest(amplitude_error(other.cycle_amplitude.values, true.cycle_amplitude.values)),
                "said": run.attrs["estimated_error"] > PROMISE[accuracy] or bool(run.attrs["estimate_remark"]),
            }
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1000:1010", help="first and one behind the last")
    parser.add_argument("--modes", type=int, nargs="*", default=[size[0] for size in SIZES], help="which sizes")
    parser.add_argument("--by-hand", nargs="*", default=(), metavar="METHOD", help="methods in place of the presets")
    parser.add_argument("--full", action="store_true", help="contacts with a full K_u")
    options = parser.parse_args()
    first, last = map(int, options.seeds.split(":"))
    if options.by_hand:
        sizes = [size for size in SIZES if size[0] in options.modes]
        found = (structure(seed, size, full=options.full) for size in sizes for seed in range(first, last))
        by_hand(options.by_hand, (own for own in found if own is not None))
        return
    every = []
    for size in (size for size in SIZES if size[0] in options.modes):
        jax.clear_caches()
        for seed in range(first, last):
            for row in rows(seed, size, full=options.full):
                every.append(row)
                print(
                    "| " + " | ".join(f"{v:.2g}" if isinstance(v, float) else str(v) for v in row.values()) + " |",
                    flush=True,
                )
    kept = {row["structure"]: row["separates"] for row in every}
    print(f"{len(kept)} structures, of which {sum(kept.values())} separate")
    known = [row for row in every if row["sure"] < 0.1 * row["true"]]
    near = [row for row in known if 0.1 < row["estimated"] / row["true"] < 10]
    print(f"{len(known)} of {len(every)} runs with a certain truth; estimated within a factor of 10 in {len(near)}")
    known = [row for row in every if row["sure amplitude"] < 0.1 * row["true amplitude"]]
    near = [row for row in known if 0.1 < row["estimated amplitude"] / row["true amplitude"] < 10]
    print(f"amplitudes of {len(known)} runs have a certain truth; estimated within a factor of 10 in {len(near)}")
    for accuracy in PROMISE:
        promise = PROMISE[accuracy]
        own = [row for row in every if row["accuracy"] == accuracy]
        judged = [row for row in own if row["sure"] < 0.3 * promise]
        kept, again = (sum(row["true"] <= promise for row in judged), sum(row["repeated"] for row in judged))
        unknown = len(own) - len(judged)
        print(f"{accuracy}: kept in {kept} of {len(judged)}, {again} repeated; beside them {unknown} of unknown truth")
        for row in own:
            if row["true"] > promise:
                print(f"   broken: {row['structure']}, {row['true']:.1e}, {'said' if row['said'] else 'not said'}")


if __name__ == "__main__":
    main()
