"""Are the folds of a balance's curves real, on structures that nobody has seen?

At a fold a real Floquet multiplier passes 1, so the number of those above 1 is even on one side and odd on the other.
The curves are those of benchmarks/generated.py. First the multipliers of the balance are asked, of solutions on both
sides; where one of them is too near 1 to tell, time integration: the motion of the solution is shot by collocation at
1e-9, be it stable or not, and the multipliers are those of the cycle to which that leads. Where neither tells a part
of the curve is followed again by as many harmonics as the program ever takes: whether it turns there as well, and a
multiplier passes 1. Harmonics that are left out may move a multiplier by more than a narrow pair of folds does.

    python benchmarks/folds.py --seeds 103 107 116

A row a structure: how many of the folds are real by the balance's multipliers, by those of time integration, by more
harmonics, false by all of them, and open, where Newton's method leads from no solution near by to a cycle; CPU seconds.
"""

import argparse
import runpy
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Controls, Curve, follow
from timesim.hbm.curve import HbmCurve
from timesim.hbm.scheme import MORE_HARMONICS, Scheme
from timesim.hbm.stability import floquet_multipliers
from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import Solver
from timesim.orbit.batch import record
from timesim.orbit.lane import Lane
from timesim.study import compare, hbm
from timesim.study.execution.processes import Processes

GENERATED = runpy.run_path(str(Path(__file__).with_name("generated.py")))
SOLVER = Solver("exponential", 1e-9, 1e-11)
SAMPLES = 2048
# Distance of a real multiplier from 1 from which on the samples of the balance tell its side; the same of integration.
CLEAR, FINE = 1e-2, 1e-5
# Solutions on each side of a fold that are asked, iterations of Newton's method, and a change that ends it.
NEIGHBOURS, SHOTS, CLOSED = 12, 12, 1e-8
# Solutions before and behind a fold between which it is followed by more harmonics, tried in turn; how far these may
# move it, relative to its frequency; and the distance of a multiplier from 1 from which on it tells its side then.
AROUND, MOVED, CLOSE = (6, 10, 16, 24), 1e-4, 2e-4
# Largest distance of a cycle from the motion of the balance, relative to the state: farther it is another motion.
SAME = 0.02


def followed(seed: int, processes: Processes) -> tuple[Model, list[HbmCurve], Scheme]:
    """The curves of a structure from the ends of its range."""
    model, free = GENERATED["STRUCTURE"](seed)
    low, high = GENERATED["span_of"](model, free)
    model = GENERATED["loaded"](model, np.linspace(low, high, GENERATED["POINTS"] + 1))
    kept: list[Any] = []

    def solutions(curves: Any, *given: Any) -> Any:
        kept.append(curves)
        return record_of(curves, *given)

    record_of, hbm.solutions = hbm.solutions, solutions
    try:
        scene = GENERATED["SCENE"](model) | {"study": {"kind": "hbm", "frequency": {"from": low, "to": high}}}
        GENERATED["result_of"](scene, processes)
    finally:
        hbm.solutions = record_of
    return model, [one.curve for one in kept[0].curves], kept[0].scheme


def number_above(multipliers: np.ndarray, clear: float) -> int | None:
    """How many real multipliers are above 1; None where one is too near to tell."""
    real = multipliers.real[np.abs(multipliers.imag) < 1e-9]
    real = real[np.abs(real - 1) > 1e-12]  # those of a contact that sticks all along are 1
    return None if np.any(np.abs(real - 1) < clear) else int(np.count_nonzero(real > 1))


def by_balance(balance: Balance, curve: HbmCurve, at: int) -> int | None:
    """The number at a solution by the balance."""
    x = (curve.contact_motion[at] / balance.length).ravel()[None]
    return number_above(floquet_multipliers(balance, x, curve.frequency[at : at + 1], samples=SAMPLES)[0], CLEAR)


def by_integration(balance: Balance, curve: HbmCurve, at: int) -> int | None:
    """The number by the cycle to which Newton's method leads from the motion of a solution; None where to none."""
    model, frequency = balance.model, float(curve.frequency[at])
    coefficient = curve.contact_motion[at] / balance.length
    modal = balance.modes(coefficient.ravel(), curve.contact_force[at] / balance.force, frequency)
    elastic, _ = compare._contacts(balance, coefficient)
    start = compare._start(model, balance, coefficient, modal, elastic, frequency)
    lane: Lane | None = Lane.begin(model, reduction_of(model, [frequency], reduce=False), frequency, SOLVER, start)
    first = lane.vector
    for _ in range(SHOTS):
        if lane is None:
            return None
        (cycle,) = record([lane], SOLVER, [1])
        if not cycle.closes:
            return None
        step, size = cycle.newton_step(cycle.change), np.abs(first).max()
        if np.abs(step).max() < CLOSED * size:
            modes = slice(2 * lane.here.point.q.size)
            near = np.abs((lane.vector - first)[modes]).max() < SAME * np.abs(first[modes]).max()
            return number_above(cycle.multipliers, FINE) if near else None
        lane = next((moved for share in (1.0, 0.5, 0.25) if (moved := lane.moved(lane.vector + share * step))), None)
    return None


def by_more_harmonics(model: Model, curve: HbmCurve, fold: int) -> bool:
    """Whether the curve turns near a fold by more harmonics as well, and a multiplier passes 1 there."""
    balance = Balance(model, float(curve.frequency[0]), Scheme(MORE_HARMONICS[-1], SAMPLES))
    for reach in AROUND:
        finer = again(balance, curve, fold, reach)
        for place in [] if finer is None else np.flatnonzero(finer.fold):
            if abs(finer.p[place] / curve.frequency[fold] - 1) < MOVED and passes(balance, finer, int(place)):
                return True
    return False


def again(balance: Balance, curve: HbmCurve, fold: int, reach: int) -> Curve | None:
    """A part of a curve about a fold by another balance; None where the curve has no such part."""
    first, last = fold - reach, fold + reach
    if first < 0 or last >= curve.frequency.size:
        return None
    start, stop = float(curve.frequency[first]), float(curve.frequency[last])
    if (stop - start) * (curve.frequency[first + 1] - start) <= 0:
        return None
    guess, known = np.zeros((balance.num_contacts, 3, balance.size)), curve.contact_motion[first]
    guess[..., : min(balance.size, known.shape[-1])] = known[..., : balance.size] / balance.length
    return follow(balance, guess.ravel(), start, stop, Controls())


def passes(balance: Balance, curve: Curve, fold: int) -> bool:
    """Whether the number of real multipliers above 1 is even on one side of a fold and odd on the other."""
    found = []
    for side in sides(curve, fold):
        each = (floquet_multipliers(balance, curve.x[at][None], curve.p[at : at + 1], samples=SAMPLES) for at in side)
        found.append(next((n for own in each if (n := number_above(own[0], CLOSE)) is not None), None))
    return None not in found and sum(filter(None, found)) % 2 == 1


def sides(curve: HbmCurve | Curve, fold: int) -> list[list[int]]:
    """Solutions on each side of a fold as far as the next fold, the nearest first."""
    found = []
    for step in (-1, 1):
        places = [fold + step * k for k in range(1, NEIGHBOURS + 1)]
        inside = [k for k in places if 0 <= k < curve.fold.size]
        ends = [i for i, k in enumerate(inside) if curve.fold[k]]
        found.append(inside[: ends[0]] if ends else inside)
    return found


def verdict(balance: Balance, curve: HbmCurve, fold: int) -> str:
    """Whether a fold is real, and by what.

    The farthest solutions are asked first: from the nearest Newton's method may go across. But the multiplier of a free
    offset may have passed 1 on the way to them.
    """
    told = False
    for name, number in (("balance", by_balance), ("integration", by_integration)):
        for order in (-1, 1):
            each = ((number(balance, curve, at) for at in side[::order]) for side in sides(curve, fold))
            known = [n for side in each if (n := next((n for n in side if n is not None), None)) is not None]
            if len(known) == 2 and sum(known) % 2:
                return name
            told |= name == "integration" and len(known) == 2
    if by_more_harmonics(balance.model, curve, fold):
        return "harmonics"
    return "false" if told else "open"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[103, 107, 116, 118, 123, 129, 130, 135])
    parser.add_argument("--processes", type=int, default=1, help="that work on a curve which takes long")
    options = parser.parse_args()
    names = ("real by the balance", "by time integration", "by more harmonics", "false", "open")
    print(f"| seed | folds | {' | '.join(names)} | CPU s |\n" + "|---" * 8 + "|")
    for seed in options.seeds:
        with Processes(options.processes) as processes:
            model, curves, scheme = followed(seed, processes)
        clock, verdicts = time.process_time(), Counter()
        for curve in curves:
            balance = Balance(model, float(curve.frequency[0]), scheme)
            for fold in np.flatnonzero(curve.fold):
                verdicts[found := verdict(balance, curve, int(fold))] += 1
                if found in ("false", "open"):
                    print(f"{seed}: {found}: fold at {curve.frequency[fold]:.9g} Hz, solution {fold}", flush=True)
        cells = (verdicts[name] for name in ("balance", "integration", "harmonics", "false", "open"))
        seconds = f"{time.process_time() - clock:.0f}"
        print(f"| {seed} | {verdicts.total()} | {' | '.join(map(str, cells))} | {seconds} |", flush=True)


if __name__ == "__main__":
    main()
