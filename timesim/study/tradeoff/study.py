"""The study `tradeoff`: one run by many solvers, which of them are worth their time, and the block that is recommended.

The truth is the finest run. It is known as well as a run of another method agrees with it; smaller errors count as that
much.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.engine.companion import amplitude_error, state_error
from timesim.model.choice import TABLE
from timesim.model.promise import PROMISE
from timesim.model.reduction import reduction_of
from timesim.model.solver import CLOSED_FORM, Solver
from timesim.result.dataset import dataset
from timesim.result.label import counted
from timesim.scene.resolution import Scene
from timesim.scene.transient import TradeoffPlan
from timesim.study.execution.campaign import Execution
from timesim.study.outcome import Outcome, attributes
from timesim.study.tradeoff.bench import NO_TIME, Bench, Trial
from timesim.study.tradeoff.report import KEPT, block, lines, more_runs

FINE = 1e-11
"""Tolerance of the runs by which the others are judged."""
SAFETY = 0.5
"""Share of the wanted error for which a tolerance is interpolated between two that were tried."""
UNVARIED = ("max_steps", "estimate_error")
"""Keys of the section `solver` that no run varies: whoever pastes a block is to keep them."""


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run a scene of a tradeoff; interrupted, it judges the runs that it has by the finest of them."""
    plan: TradeoffPlan = scene.plan
    bench, reason = Bench(scene.model(), plan, execution), None
    settings = {"budget": scene.file.solver.max_steps}
    try:
        _try_all(bench, settings)
        _between(bench, "exponential")
        bench.time_again()
    except KeyboardInterrupt:
        reason = f"interrupted after {counted(len(bench.trials), 'run')}"
    judged = judge(bench)
    if np.isnan(judged.known) and reason is None:
        why = next(left_out_lines(bench))
        done = "no two runs of the whole scene have come to their ends, so that no error is known"
        done = done if bench.trials else "no run has come to its end"
        reason = f"{done}{''.join(f' ({what})' for what in more_runs(why))}: {why}"
    data = _record(scene, bench, judged, reason)
    return Outcome({"": data}, reason, tuple(lines(data)))


def _try_all(bench: Bench, settings: dict[str, Any]) -> None:
    """Make the runs, the cheapest first, and those that need another program after those that do not."""
    model, plan = bench.model, bench.plan

    def by(method: str, rtol: float, **more: Any) -> Solver:
        return Solver(method, rtol, float(f"{rtol / 100:.3g}"), **settings, **more)

    own = {name: replace(plan.preset(name, model, settings["budget"]), **settings) for name in PROMISE}
    for rtol in 10.0 ** -np.arange(3, 10):
        bench.try_(by("tsit5", float(f"{rtol:g}")))
    for name in ("draft", "standard"):
        bench.try_(own[name], preset=name)
    if any(line.method == "kvaerno5" and line.applies(model, plan.frequency) for line in TABLE):
        for rtol in (1e-5, 1e-6, 1e-7, 1e-8):
            bench.try_(by("kvaerno5", rtol))
    bench.try_(by("tsit5", FINE))
    bench.try_(by("dopri8", FINE))
    for rtol in (1e-4, 1e-6, 1e-8):
        bench.try_(by("dopri8", rtol))
    bench.try_(own["reference"], preset="reference")
    for method in ("tsit5", "dopri8"):
        _between(bench, method)
    if reduction_of(model, [plan.frequency]).findings:
        bench.try_(by("tsit5", 1e-7, reduce=False))
    for steps in (200, 800):
        bench.try_(Solver("rk4", 1e-8, 1e-10, longest=2 * np.pi / steps, **settings))
    for count in fewer(model.structure.num_modes):
        if not np.any([model.start.displacement[count:], model.start.velocity[count:]]):
            bench.try_(by("tsit5", 1e-7), num_modes=count)
    for rtol in (1e-5, 1e-7, 1e-9):
        bench.try_(by("exponential", rtol))


def fewer(num_modes: int) -> list[int]:
    """Numbers of modes that are tried beside all of them: three quarters, half and a quarter."""
    return sorted({-(-num_modes * share // 4) for share in (1, 2, 3)} - {num_modes}, reverse=True)


def _between(bench: Bench, method: str) -> None:
    """Run a method with the tolerance that would give half the wanted error, by the errors of its other runs."""
    judged, wanted = judge(bench), SAFETY * bench.plan.error
    own = [
        (error, trial.solver.rtol)
        for trial, error in zip(bench.trials, judged.error, strict=True)
        if trial.solver.name == method and comparable(trial, bench) and judged.known < 0.3 * error < np.inf
    ]
    coarse = [pair for pair in own if pair[0] > wanted]
    fine = [pair for pair in own if pair[0] <= wanted]
    if not coarse or not fine:
        return
    (above, a), (below, b) = min(coarse), max(fine)
    share = np.log(above / wanted) / np.log(above / below)
    rtol = float(f"{a * (b / a) ** share:.1e}")
    if b < rtol < a:
        bench.try_(replace(bench.trials[0].solver, name=method, rtol=rtol, atol=float(f"{rtol / 100:.3g}")))


def comparable(trial: Trial, bench: Bench) -> bool:
    """Whether a run is of the whole scene, reduced, so that it may be recommended."""
    return trial.solver.reduce and trial.num_modes == bench.model.structure.num_modes


@dataclass(frozen=True)
class Judged:
    """The runs by their errors.

    Attributes:
        error: of each, at least `known`.
        known: how well the truth is known.
        verified: the two solvers that agree on it; empty where no other method has verified it.
        pareto: whether no other run of the whole scene is both faster and better.
        recommended: position of the fastest run of the whole scene that keeps the wanted error, of the best where none
            does; -1 where there is none.
    """

    error: np.ndarray
    known: float
    verified: str
    pareto: np.ndarray
    recommended: int


def judge(bench: Bench) -> Judged:
    """The runs so far, judged by the finest of them."""
    trials = bench.trials
    whole = [trial for trial in trials if comparable(trial, bench) and trial.solver.name != "rk4"]
    if len(whole) < 2:
        return Judged(np.full(len(trials), np.nan), np.nan, "", np.zeros(len(trials), dtype=bool), -1)
    # The truth is what is known in closed form, else by the finest tolerance; of equal ones by that of higher order.
    closed = [trial for trial in whole if trial.solver.name == CLOSED_FORM]
    true = min(closed or whole, key=lambda trial: (trial.solver.rtol, trial.solver.name != "dopri8"))
    others = [trial for trial in whole if trial.solver.name != true.solver.name]
    second = min(others, key=lambda trial: trial.solver.rtol, default=None)
    if second is None or second.solver.rtol > FINE:
        second, verified = min((t for t in whole if t is not true), key=lambda t: t.solver.rtol), ""
    else:
        verified = f"{true.solver} and {second.solver}"
    known = max(_apart(bench, second, true), 1e-14)
    error = np.array([known if trial is true else max(_apart(bench, trial, true), known) for trial in trials])
    seconds = np.array([trial.seconds for trial in trials])
    may = np.array([comparable(trial, bench) for trial in trials])
    better = (error[None] <= error[:, None]) & (seconds[None] <= seconds[:, None]) & may[None]
    better &= (error[None] < error[:, None]) | (seconds[None] < seconds[:, None])
    keeps = may & (error <= bench.plan.error)
    choice = np.where(keeps, seconds, np.inf) if keeps.any() else np.where(may, error, np.inf)
    return Judged(error, known, verified, may & ~better.any(axis=1), int(np.lexsort((seconds, choice))[0]))


def _apart(bench: Bench, trial: Trial, true: Trial) -> float:
    """Error of a run against another."""
    if bench.plan.amplitude:
        return float(amplitude_error(true.amplitude[None], trial.amplitude[None])[0])
    return state_error(bench.model, bench.plan.frequency, trial, true, true.size)


def left_out_lines(bench: Bench) -> Iterator[str]:
    """The runs that were left out, a line for each reason; where a run failed is said beside its solver."""
    names: dict[str, list[str]] = {}
    for (solver, kept), why in bench.left_out.items():
        place, _, cause = why.rpartition(": ") if why.startswith("at time") else ("", "", why)
        names.setdefault(cause, []).append(bench.name_of(solver, kept) + (f" ({place})" if place else ""))
    return (f"{cause}: {'; '.join(those)}" for cause, those in names.items())


def _record(scene: Scene, bench: Bench, judged: Judged, reason: str | None) -> Dataset:
    trials, cycles, num_modes = bench.trials, bench.cycles, bench.model.structure.num_modes
    untried = [str(kept) for (_, kept), why in bench.left_out.items() if kept < num_modes and why == NO_TIME]
    rk4 = np.array([trial.solver.name == "rk4" for trial in trials], dtype=bool)
    most_steps = 2 * np.pi / np.array([trial.solver.longest for trial in trials])
    of_run = {"long_name": "transitions in the run"}
    columns: dict[str, Any] = {
        "method": [trial.solver.name for trial in trials],
        "rtol": np.where(rk4, np.nan, [trial.solver.rtol for trial in trials]),
        "error": judged.error,
        "seconds_a_cycle": np.array([trial.seconds for trial in trials]) / cycles,
        "seconds_scatter": np.array([trial.scatter for trial in trials]),
        "steps_a_cycle": np.array([trial.steps for trial in trials]) / cycles,
        "steps_asked": np.where(rk4, np.round(most_steps), 0).astype(int),
        "pareto": judged.pareto,
        "modes_kept": np.array([trial.num_modes for trial in trials], dtype=int),
        "reduced": np.array([trial.solver.reduce for trial in trials], dtype=bool),
        "preset": [trial.preset for trial in trials],
        "compile_seconds_before": np.array([trial.compiling for trial in trials]),
    }
    variables: dict[str, Any] = {name: (("trial",), np.asarray(values)) for name, values in columns.items()}
    variables["transitions"] = (("trial",), np.array([trial.transitions for trial in trials], dtype=int), of_run)
    compiling = sum(trial.compiling for trial in trials)
    running = bench.plan.budget - bench.left - compiling
    attrs = attributes(scene, counted(len(trials), "run"), compiling, running, reason) | {
        "error_known_to": judged.known,
        "truth": judged.verified,
        "error_wanted": bench.plan.error,
        "cycles": cycles,
        "cycles_asked": bench.plan.cycles,
        "judged_by_amplitude": bench.plan.amplitude,
        "settled_to": bench.settled_to,
        "recommended_trial": judged.recommended,
        "num_modes": num_modes,
        "left_out": "\n".join(left_out_lines(bench)),
        "modes_not_tried": " or ".join(untried),
        KEPT: json.dumps(_kept(scene)),
    }
    data = dataset(variables, {}, attrs)
    chosen = block(data.isel(trial=judged.recommended)) if judged.recommended >= 0 else {}
    return data.assign_attrs(recommended=json.dumps(chosen))


def _kept(scene: Scene) -> dict[str, Any]:
    """What the scene itself sets in `solver`, other than the default, that no run varies."""
    solver = scene.file.solver
    own = {name: getattr(solver, name) for name in UNVARIED}
    return {name: value for name, value in own.items() if value != type(solver).model_fields[name].default}
