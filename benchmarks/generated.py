"""Does harmonic balance start, arrive and agree with time integration on structures that nobody has seen?

Generated structures (tests/zoo.py), each run as a `compare` scene over 1.5 octaves around its first free and stuck
natural frequency, harmonics and samples chosen by the program. The seeds were set once and nothing was tuned on them.
The load is such that at three quarters of the frequencies a contact of the linear response would slip, open or close.

    python benchmarks/generated.py --seeds 100:140 --limit 600 --processes 2

A row a structure: how the balance ends, its harmonics, samples, solutions and folds, seconds of the balance after
compilation, and its CPU seconds in this process with what it compiles; at how many of the frequencies a contact works,
which slips or opens for a part of the cycle; and the difference of amplitudes, relative to the largest, where one does
and the motion settles with period one. Points where the methods differ by the free offset of a contact that sticks,
which `compare` proves and lists, are counted apart. Between the two folds of a pair a multiplier passes 1: of how many
pairs it does not, or hardly, is the column behind the folds.
"""

import argparse
import runpy
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from xarray import Dataset, DataTree

from timesim.hbm.balance import Balance, contact_stiffness
from timesim.hbm.scheme import Scheme
from timesim.model.model import Contact, Model
from timesim.orbit.steady_state import switches
from timesim.result.netcdf import joined
from timesim.study import compare
from timesim.study.execution.campaign import Execution
from timesim.study.execution.processes import Processes
from timesim.study.hbm import followed_behind
from timesim.study.registry import carry_out, load_scene

POINTS = 16
ZOO = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "zoo.py"))
STRUCTURE, SCENE = ZOO["structure"], ZOO["scene_of"]
SAME_BRANCH, AGREE = 0.05, 1e-3
# What few samples may leave in a multiplier that is 1.
PASSES = 1.03
# Share of the frequencies at which contacts are meant to work.
AT_WORK = 0.75


def span_of(model: Model, free: float) -> tuple[float, float]:
    """Frequencies around the first mode without contacts and stuck [Hz]."""
    stuck = float(np.min(model.stuck_omega)) / (2 * np.pi)
    return free / 2**0.75, (stuck if stuck <= 3 * free else 1.5 * free) * 2**0.75


def working_load(contact: Contact, motion: np.ndarray) -> float:
    """Share of a load from which a contact slips, opens or closes, by its linear motion (u1, u2, v) over a period."""
    pull = np.linalg.norm(contact.tangential_stiffness @ motion[:2], axis=0)
    press, preload = contact.normal_stiffness * motion[2], float(contact.preload)
    if preload < 0:
        return -preload / press.max()
    ways = [-press.min()]
    if contact.friction > 0:
        ways.append(np.max(pull / contact.friction - press))
    return preload / max(ways)


def loaded(model: Model, frequencies: np.ndarray) -> Model:
    """The model under a load at which contacts work at most of the frequencies [Hz]."""
    closed = contact_stiffness(model, np.array([float(contact.preload > 0) for contact in model.contacts]))
    turn, least = np.exp(2j * np.pi * np.arange(256) / 256), []
    for frequency in frequencies:
        linear = Balance(model, float(frequency), Scheme(1, 16)).linear(float(frequency))
        motion = np.linalg.solve(np.eye(len(closed)) + linear.flexibility[1] @ closed, linear.free[1])
        parts = np.real(motion.reshape(-1, 3, 1) * turn)
        least.append(min(working_load(contact, part) for contact, part in zip(model.contacts, parts, strict=True)))
    share = 1.2 * np.quantile(least, AT_WORK) or 1.0
    return replace(model, excitation=replace(model.excitation, cosine=share * model.excitation.cosine))


def scene_of(model: Model, low: float, high: float) -> dict[str, Any]:
    """The `compare` scene of a structure over a range of frequency [Hz]."""
    study = {
        "kind": "compare",
        "frequency": {"from": low, "to": high, "step": (high - low) / POINTS},
        "settle": {"tolerance": 1e-7, "max_cycles": 1000},
    }
    return SCENE(model) | {"study": study}


def doubtful(curves: Dataset) -> int:
    """Pairs of folds without a multiplier above `PASSES` on the branch between them."""
    place = np.stack([curves.curve.values, curves.branch.values], axis=1)[curves.fold.values == 0]
    largest = curves.floquet_max.values[curves.fold.values == 0]
    between = (np.all(place == own, axis=1) for own in np.unique(place, axis=0) if own[1] % 2)
    return sum(bool(np.nanmax(largest[own], initial=0.0) <= PASSES) for own in between)


def at_work(result: DataTree, model: Model) -> np.ndarray:
    """Whether a contact slips or opens within the cycle, at each frequency of the sweep."""
    sweep = result["sweep"].to_dataset()
    slip, apart = (
        sweep[name].transpose("direction", "frequency", "contact").values[0]
        for name in ("slip_share", "separation_share")
    )
    rubs = np.array([contact.friction > 0 for contact in model.contacts])
    return np.asarray(switches(slip * rubs, apart)).any(axis=1)


def differences(result: DataTree) -> np.ndarray:
    """Of amplitudes from the balance's, by the largest; NaN without a solution, infinite where no period is one."""
    sweep = result["sweep"].to_dataset()
    amplitude = sweep.amplitude.transpose("direction", "frequency", "point", "axis").values[0]
    relative = result["relative_difference"].transpose("direction", "frequency", "point", "axis").values[0]
    height = amplitude.max(axis=(1, 2))
    moving = amplitude > 1e-6 * height[:, None, None]
    found = np.max(np.abs(relative) * amplitude, axis=(1, 2), where=moving, initial=0.0) / height
    settled = (sweep.settled.values[0] == 1) & (sweep.period.values[0] == 1)
    return np.where(settled, found, np.inf)


def result_of(scene: dict[str, Any], processes: Processes | None) -> DataTree:
    """The result of a scene, with what processes take over, as of the command line."""
    outcome = carry_out(load_scene(scene), Execution(processes=processes))
    result: DataTree = joined(outcome.groups)
    return result


def row(seed: int, limit: float, processes: Processes | None, *, full: bool = False) -> str:
    model, free = STRUCTURE(seed)
    model = ZOO["with_full_stiffness"](model, seed) if full else model
    low, high = span_of(model, free)
    model = loaded(model, np.linspace(low, high, POINTS + 1))
    begin, seconds = time.process_time(), []

    def timed(*args: Any, **options: Any) -> Any:
        clock, begun = time.process_time(), time.perf_counter()
        signal.signal(signal.SIGPROF, lambda *_: signal.raise_signal(signal.SIGINT))
        signal.setitimer(signal.ITIMER_PROF, limit)
        done = followed_behind(*args, **options)
        signal.setitimer(signal.ITIMER_PROF, 0)
        seconds.extend([time.process_time() - clock, time.perf_counter() - begun])
        return done

    compare.followed_behind = timed
    try:
        result = result_of(scene_of(model, low, high), processes)
    except Exception as error:  # a row of the table
        return f"| {seed} | {model.structure.num_modes} | {model.num_contacts} | {type(error).__name__}: {error} |"
    own = result["hbm"].to_dataset()
    scheme = own.attrs["method"].removeprefix("harmonic balance, ")
    ending = "to its end" if own.attrs["complete"] else str(own.attrs.get("incomplete", "not to its end"))
    works = at_work(result, model)
    other = result["other_offset"].transpose("direction", "frequency").values[0] > 0
    found = differences(result)[works & ~other]
    found = found[~np.isinf(found)]
    same = found[found < SAME_BRANCH]
    cells = (
        seed,
        model.structure.num_modes,
        model.num_contacts,
        ending,
        scheme,
        own.sizes["solution"],
        int(own.fold.sum()),
        doubtful(own),
        f"{seconds[1] - own.attrs['compile_seconds']:.1f}",
        f"{seconds[0]:.1f}",
        f"{time.process_time() - begin:.1f}",
        f"{np.count_nonzero(works)} of {works.size}",
        found.size,
        f"{np.max(same, initial=0.0):.1e}",
        int(np.count_nonzero(same > AGREE)),
        int(np.count_nonzero(other)),
        int(np.count_nonzero(found >= SAME_BRANCH)),
        int(np.count_nonzero(np.isnan(found))),
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="100:140", help="first and one behind the last, or some with commas")
    parser.add_argument("--processes", type=int, default=1, help="that work on a curve which takes long")
    parser.add_argument("--limit", type=float, default=0, help="CPU seconds after which a balance is interrupted")
    parser.add_argument("--full", action="store_true", help="contacts with a full K_u")
    options = parser.parse_args()
    ends = options.seeds.split(":")
    seeds = range(*map(int, ends)) if len(ends) > 1 else map(int, options.seeds.split(","))
    heads = (
        "seed, modes, contacts, curve, scheme, solutions, folds, pairs in doubt, "
        "s of the balance, CPU s of the balance, CPU s in all, "
    )
    heads += (
        "points at work, of them of period one, largest difference, above 1e-3, "
        "with another offset, on another branch, without a solution"
    )
    print("| " + heads.replace(", ", " | ") + " |\n" + "|---" * (heads.count(",") + 1) + "|")
    with Processes(options.processes) as processes:
        for seed in seeds:
            print(row(seed, options.limit, processes, full=options.full), flush=True)


if __name__ == "__main__":
    main()
