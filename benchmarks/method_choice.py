"""Which method takes least at equal error, and does `method: auto` choose it where a run is long?

    python benchmarks/method_choice.py --seeds 0:4                             # calibration, all families
    python benchmarks/method_choice.py --reference
    python benchmarks/method_choice.py --seeds 100:104 --family "stiff 1e2"    # verification

Generated structures (`driven` of tests/zoo.py) as they are, and with stiffer contacts, a fast mode, or little friction,
and the problems of `collocation.py`. Each runs by every method at tolerances a decade apart, alone, from rest,
nothing recorded and nothing left out; CPU time of compiled runs, median of three. The error is that of the last state
against dopri8 at rtol 1e-12, the time at an error is read off between the tolerances beside it, by logarithms. Where
collocation at 1e-11 is further from the truth than a tenth of an error asked for, nothing is known and the cell is
empty. A star marks what auto takes for 1e-4, 1e-6 and 1e-8 (draft, standard, reference) where compiling does not count.
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import os
import runpy
import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from collocation import PROBLEMS, TRUTH, Problem, apart, runner

from timesim.engine.status import Status
from timesim.model.choice import TABLE, choice
from timesim.model.cost import Work
from timesim.model.model import Model
from timesim.model.promise import PROMISE
from timesim.model.solver import Solver

ZOO = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "zoo.py"))
ERRORS = (1e-4, 1e-6, 1e-8)
METHODS: dict[str, np.ndarray] = dict.fromkeys(("tsit5", "dopri5", "dopri8"), 10.0 ** -np.arange(3, 12))
METHODS |= {"exponential": 10.0 ** -np.arange(5, 12), "kvaerno5": 10.0 ** -np.array([4, 6])}
SECOND = Solver("exponential", 1e-11, 1e-13, budget=1_000_000)
LONGEST = 2.0
"""CPU seconds of a run after which finer tolerances of the method are left out."""
CYCLES = 12
GOOD = 1.5


class Case(NamedTuple):
    family: str
    seed: int
    problem: Problem


def stiffer(model: Model, factor: float) -> Model:
    """The model with contacts so many times as stiff; gaps keep their width, preloads their force."""
    contacts = tuple(
        replace(
            own,
            tangential_stiffness=factor * own.tangential_stiffness,
            normal_stiffness=factor * own.normal_stiffness,
            preload=own.preload * (factor if own.preload < 0 else 1.0),
        )
        for own in model.contacts
    )
    return replace(model, contacts=contacts)


def pressed(model: Model, factor: float) -> Model:
    """The model with contacts so many times as stiff, under preloads at which they mostly stick."""
    stiff = stiffer(model, factor)
    load = 3 * float(np.abs(model.excitation.cosine).sum())
    return replace(stiff, contacts=tuple(replace(own, preload=load) for own in stiff.contacts))


def with_fast_mode(model: Model, factor: float) -> Model:
    """The model with its last mode at so many times the first frequency, its static compliance kept."""
    body = model.structure
    up = np.ones(body.num_modes)
    up[-1] = factor * body.frequency[0] / body.frequency[-1]
    load = replace(model.excitation, cosine=model.excitation.cosine * up)
    shape, damping = body.shape * up, body.damping * up
    return replace(
        model, structure=replace(body, frequency=body.frequency * up, shape=shape, damping=damping), excitation=load
    )


def slippery(model: Model, friction: float) -> Model:
    """The model with a coefficient of friction; frictionless stops stay what they are."""
    own = tuple(replace(own, friction=friction if own.friction else 0.0) for own in model.contacts)
    return replace(model, contacts=own)


FAMILIES: dict[str, tuple[tuple[int, int], Any]] = {
    "1 mode, 1 contact": ((1, 1), None),
    "2 modes, 1 contact": ((2, 1), None),
    "4 modes, 2 contacts": ((4, 2), None),
    "8 modes, 3 contacts": ((8, 3), None),
    "20 modes, 3 contacts": ((20, 3), None),
    "50 modes, 10 contacts": ((50, 10), None),
    "stiff 1e2": ((4, 2), lambda model: stiffer(model, 1e2)),
    "stiff 1e4": ((4, 2), lambda model: stiffer(model, 1e4)),
    "fast 100": ((4, 2), lambda model: with_fast_mode(model, 100.0)),
    "fast 1000": ((4, 2), lambda model: with_fast_mode(model, 1000.0)),
    "stuck 1e4": ((4, 2), lambda model: pressed(model, 1e4)),
    "stuck 1e8": ((4, 2), lambda model: pressed(model, 1e8)),
    "friction 1e-2": ((4, 2), lambda model: slippery(model, 1e-2)),
    "friction 1e-3": ((4, 2), lambda model: slippery(model, 1e-3)),
    "friction 1e-4": ((4, 2), lambda model: slippery(model, 1e-4)),
}


def cases(seeds: range, families: list[str]) -> Iterator[Case]:
    for family in families:
        size, change = FAMILIES[family]
        for seed in seeds:
            model, _ = ZOO["driven"](seed, size)
            frequency = model.excitation.frequency
            yield Case(family, seed, Problem(change(model) if change else model, frequency, CYCLES))


def timed(problem: Problem, solver: Solver, true: Any) -> dict[str, Any]:
    """A solver's error, and CPU time a cycle."""
    run = runner(problem, solver)
    end, _ = run()
    taken: list[float] = []
    while len(taken) < (3 if not taken or taken[0] < 0.3 else 1):
        clock = time.process_time()
        run()
        taken.append(time.process_time() - clock)
    good = end.status == Status.RUNNING
    error = apart(end, true) if good else np.inf
    own = {"method": solver.name, "rtol": solver.rtol, "error": error}
    return own | {"cycle": statistics.median(taken) / problem.cycles}


def measured(case: Case, methods: list[str]) -> dict[str, Any]:
    """All runs of a case, and what is known of it beforehand."""
    problem = case.problem._replace(model=replace(case.problem.model))
    (true, events), (second, _) = (
        runner(problem, replace(s, budget=1_000_000, reduce=False))() for s in (TRUTH, SECOND)
    )
    known = apart(second, true) if true.status == second.status == Status.RUNNING else np.inf
    trials: list[dict[str, Any]] = []
    for name in methods:
        for rtol in METHODS[name] if known < ERRORS[0] else ():
            own = timed(problem, Solver(name, rtol, 1e-2 * rtol, budget=1_000_000, reduce=False), true)
            trials.append(own)
            if own["error"] < ERRORS[-1] or (own["error"] < np.inf and own["cycle"] * problem.cycles > LONGEST):
                break
    model, turn = problem.model, 2 * np.pi * problem.frequency
    about = {
        "modes": model.structure.num_modes,
        "contacts": model.num_contacts,
        "free": model.structure.frequency[-1] / problem.frequency,
        "stuck": model.stuck_rate / turn,
        "events": events / problem.cycles,
        "known": known,
    }
    return {"family": case.family, "seed": case.seed, **about, "trials": trials}


def time_at(trials: list[dict[str, Any]], error: float) -> float:
    """CPU time a cycle of a method at an error, the least, by logarithms between tolerances; infinite where none."""
    best, trials = np.inf, sorted(trials, key=lambda trial: -trial["rtol"])
    for coarse, fine in zip([None, *trials], trials, strict=False):
        if fine["error"] > error:
            continue
        share = 1.0
        if coarse is not None and error < coarse["error"] < np.inf:
            share = np.log(coarse["error"] / error) / np.log(coarse["error"] / fine["error"])
        before = fine["cycle"] if coarse is None else coarse["cycle"]
        best = min(best, before ** (1 - share) * fine["cycle"] ** share)
    return best


def taken(problem: Problem, error: float) -> Solver:
    """What auto takes for an error where the run is so long that compiling does not count."""
    (accuracy,) = (name for name, promised in PROMISE.items() if promised == error)
    work = Work(((problem.frequency, 1e12),), problem.frequency)
    return choice(accuracy, problem.model, work, 1_000_000).solver


def row(found: dict[str, Any], problem: Problem, methods: list[str], ratios: list[float]) -> str:
    """Times of the methods at each error; adds to the ratios that of what auto takes to the least."""
    cells = [f"{found['family']}, seed {found['seed']}", *(f"{found[key]:.3g}" for key in ("free", "stuck", "events"))]
    for error in ERRORS:
        solver, times = taken(problem, error), {}
        for name in methods:
            # Where slip is stiff, auto allows collocation no tolerance that may end nowhere.
            most = TABLE[0].largest if name == solver.name == "exponential" and solver.rtol <= TABLE[0].largest else 1.0
            own = [t for t in found["trials"] if t["method"] == name and t["rtol"] < 1.01 * most]
            times[name] = time_at(own, error)
        if found["known"] > 0.1 * error or min(times.values()) == np.inf:
            cells.append("")
            continue
        ratios.append(times[solver.name] / min(times.values()))
        cells.append(" / ".join(f"{1e6 * times[name]:.4g}{'*' * (name == solver.name)}" for name in methods))
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:4", help="first and one behind the last")
    parser.add_argument("--family", nargs="+", choices=list(FAMILIES), default=list(FAMILIES))
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--reference", action="store_true", help="the problems of collocation.py")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; us a cycle of {' / '.join(options.methods)}")
    print("| structure | free | stuck | transitions | " + " | ".join(f"{e:g}" for e in ERRORS) + " |")
    chosen = cases(range(*map(int, options.seeds.split(":"))), options.family)
    if options.reference:
        chosen = (Case(name, 0, build()) for name, build in PROBLEMS.items())
    ratios: list[float] = []
    for case in chosen:
        print(row(measured(case, options.methods), case.problem, options.methods, ratios), flush=True)
    ratios = ratios or [1.0]
    good = sum(ratio <= GOOD for ratio in ratios)
    print(f"what auto takes is within {GOOD:g} of the least in {good} of {len(ratios)}, at worst {max(ratios):.2g}")


if __name__ == "__main__":
    main()
