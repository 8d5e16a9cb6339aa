"""Is every motion that repeats recognised, by default settings, where structures are lightly damped?

    python benchmarks/settled.py --seeds 300:340

Generated structures (tests/zoo.py) at damping ratios of 0.05 to 0.5 %, loaded as in `generated.py`, swept over 17
frequencies around the first free and stuck mode with nothing said of accuracy, method or settling. A row a structure:
at how many points a contact works, how many are settled with period one and with a longer one, how many are named
irregular, not settled without a name, and not computed. Then the truth, at accuracy reference: by how much the state of
four or more settled points that are stable changes in 50 periods from where the sweep left them, at most, relative to
its largest entry; and of those not settled how many repeat after 1,500 more cycles, by the amplitudes of the last ones.
"""

import argparse
import runpy
import time
from pathlib import Path
from typing import Any

import numpy as np
from xarray import Dataset

import timesim

HERE = Path(__file__).parent
GENERATED = runpy.run_path(str(HERE / "generated.py"))
POINTS, DAMPING = GENERATED["POINTS"], (5e-4, 5e-3)
PERIODS, CYCLES, LONGEST, REPEATS = 50, 1_500, 32, 1e-6
STABLE = 0.999


def scene_of(seed: int) -> tuple[Any, dict[str, Any]]:
    """A structure and the scene of its sweep."""
    model, free = GENERATED["STRUCTURE"](seed, DAMPING)
    low, high = GENERATED["span_of"](model, free)
    model = GENERATED["loaded"](model, np.linspace(low, high, POINTS + 1))
    sweep = {"kind": "sweep", "frequency": {"from": low, "to": high, "step": (high - low) / POINTS}}
    return model, GENERATED["SCENE"](model) | {"study": sweep}


def carried_on(scene: dict[str, Any], point: Dataset, cycles: int) -> Dataset:
    """The motion of a point, from where the sweep left it, for some cycles at accuracy reference."""
    initial = {
        "modal_displacement": point.final_modal_displacement.values.tolist(),
        "modal_velocity": point.final_modal_velocity.values.tolist(),
        "slip": {name: point.final_slip.sel(contact=name).values.tolist() for name in point.contact.values},
    }
    load = scene["excitation"] | {"frequency": float(point.frequency)}
    study = {"kind": "transient", "cycles": cycles, "record_last": 1}
    solver = {"accuracy": "reference", "estimate_error": False}
    return timesim.run(scene | {"initial": initial, "excitation": load, "study": study, "solver": solver})


def change(point: Dataset, after: Dataset) -> float:
    """Of the state, relative to its largest entry."""
    parts = (f"final_modal_{name}" for name in ("displacement", "velocity"))
    return max(float(abs(after[name] - point[name]).max() / max(abs(point[name]).max(), 1e-300)) for name in parts)


def repeats(run: Dataset) -> bool:
    """Whether the amplitudes of the last cycles repeat after a number of cycles."""
    amplitude = run.cycle_amplitude.transpose("cycle", "point", "axis").values[-4 * LONGEST :]
    size = np.nanmax(amplitude)
    return any(np.nanmax(np.abs(amplitude[n:] - amplitude[:-n])) < REPEATS * size for n in range(1, LONGEST + 1))


def row(seed: int) -> str:
    model, scene = scene_of(seed)
    begin = time.process_time()
    sweep = timesim.run(scene).isel(direction=0)
    seconds = time.process_time() - begin
    rubs = np.array([contact.friction > 0 for contact in model.contacts])
    shares = (sweep[name].transpose("frequency", "contact").values for name in ("slip_share", "separation_share"))
    slip, apart = shares
    works = GENERATED["switches"](slip * rubs, apart).any(axis=1)
    settled, irregular, failed = (sweep.settled == 1, sweep.irregular == 1, sweep.failure != "")
    stable = np.flatnonzero(works & settled & (sweep.floquet_max < STABLE))
    drift = [0.0]
    for i in stable[:: max(1, stable.size // 4)]:
        point = sweep.isel(frequency=i)
        drift.append(change(point, carried_on(scene, point, PERIODS * int(point.period))))
    loose = np.flatnonzero(~settled & ~failed)
    late = sum(repeats(carried_on(scene, sweep.isel(frequency=i), CYCLES)) for i in loose)
    cells = (
        seed,
        model.structure.num_modes,
        model.num_contacts,
        f"{100 * model.structure.damping_ratio[0]:.2f} %",
        f"{np.count_nonzero(works)} of {works.size}",
        int((settled & (sweep.period == 1)).sum()),
        int((settled & (sweep.period > 1)).sum()),
        int((~settled & irregular).sum()),
        int((~settled & ~irregular & ~failed).sum()),
        int(failed.sum()),
        f"{max(drift):.1e}",
        f"{late} of {loose.size}",
        f"{float(sweep.cycles.median()):.0f}",
        f"{seconds:.1f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="300:340", help="first and one behind the last")
    first, last = map(int, parser.parse_args().seeds.split(":"))
    heads = "seed, modes, contacts, damping, points at work, period one, longer, irregular, not settled, not computed, "
    heads += "change in 50 periods, that repeat after all, cycles (median), CPU s of the sweep"
    print("| " + heads.replace(", ", " | ") + " |\n" + "|---" * (heads.count(",") + 1) + "|")
    for seed in range(first, last):
        print(row(seed), flush=True)


if __name__ == "__main__":
    main()
