"""The `bistable` study: where a response has two steady motions, which start leads to which, and the curve behind.

For each set of values of the further axes both sweeps are computed part by part, then the ends of the ranges, then the
motions from an ensemble of starts. Each of these is a chunk, so that an interrupted study can be taken up.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.model.model import Model
from timesim.model.solver import NEVER, Criterion, Solver
from timesim.orbit.fourier import phase_deg
from timesim.orbit.jump import Watched
from timesim.orbit.settling import Chain, warm_up
from timesim.orbit.steady_state import COLUMNS, Orbit, columns_of, sizes_of
from timesim.orbit.two_motions import UP, RangeSearch, ranges_of
from timesim.orbit.two_motions.basin import LOWER, UPPER, explore, shares
from timesim.result.dataset import dataset
from timesim.result.label import counted
from timesim.scene.resolution import Scene
from timesim.scene.sweep import BistablePlan
from timesim.study.execution.campaign import INTERRUPTED, Chunk, Execution, Result, carry_through
from timesim.study.execution.progress import CURVE, Phases
from timesim.study.execution.worker import each
from timesim.study.hbm import compile_beside, followed_behind
from timesim.study.outcome import Outcome, attributes
from timesim.study.summary.bistable import bistable_lines, fold_lines, starts_line
from timesim.study.summary.effort import sweep_effort_lines
from timesim.study.summary.sweep import failure_line, number_of_states, unusual_lines
from timesim.study.sweep import FAILURES, STEPS_A_CHUNK, Grid, continued, search_failure, steady_of

SEARCH = "sweeps, ends and starts"  # phase of the progress


@dataclass(frozen=True)
class Payload:
    """Work on one set of values; each kind of work continues from the result of the one before."""

    model: Model
    solver: Solver
    criterion: Criterion

    def steady(self, chains: Sequence[Chain]) -> list[list[Orbit]]:
        return steady_of(chains, self.solver, self.criterion)


@dataclass(frozen=True)
class Part(Payload):
    """A part of both sweeps: the frequencies [Hz] of the sweep up and of the sweep down."""

    up: tuple[float, ...]
    down: tuple[float, ...]

    def result(self, before: Result | None) -> Result:
        """All steady states of both sweeps so far, in the order of each."""
        chains = [continued(Chain(self.model, own), i, before) for i, own in enumerate((self.up, self.down))]
        here = columns_of(self.steady(chains)) | {"frequency": np.array([self.up, self.down])}
        if before is None:
            return here
        return {name: np.concatenate([before[name], array], axis=1) for name, array in here.items()}


@dataclass(frozen=True)
class Ends(Payload):
    """The search for the ends of the ranges, each to a width [Hz]."""

    width: float

    def result(self, before: Result | None) -> Result:
        """The jumps, and the ranges with their motions."""
        assert before is not None
        steady = Watched(self.steady)
        found = ranges_of(RangeSearch(self.model, steady, self.width, each), before)
        return found | {FAILURES: np.array(steady.failures, dtype=str)}


@dataclass(frozen=True)
class Starts(Payload):
    """The ensemble of starts, ``num`` along each side. They are only marched: Newton's method may lead elsewhere."""

    num: int

    def result(self, before: Result | None) -> Result:
        """Where they lead, and the ranges."""
        assert before is not None
        marching = replace(self, criterion=replace(self.criterion, first_shot=NEVER))
        return dict(before) | explore(self.model, marching.steady, before, self.num)


def work(payload: Part | Ends | Starts, before: Result | None) -> Result:
    """The result of a chunk; the `Work` of the campaign."""
    return payload.result(before)


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run a bistable scene. Finding no range is a result, not a failure.

    The balance is only drawn behind the ranges. Where a curve does not reach its end, the summary says so and its group
    in the result is marked incomplete, but the study is complete.
    """
    plan: BistablePlan = scene.plan
    solver, grid = scene.solver(), Grid(scene, plan.sweep)
    earlier, clock = execution.earlier(""), time.perf_counter()
    if plan.balance is not None:
        compile_beside(scene, plan.balance)
    if execution.cluster is None:
        warm_up((Chain(model, tuple(map(float, grid.frequency))) for model in grid.models.values()), solver)
    compiling = time.perf_counter() - clock
    every = chunks(grid, plan, solver)
    curves = 0 if plan.balance is None else 2 * grid.shape[0]
    phases = Phases(execution.progress, {SEARCH: sum(chunk.size for chunk in every), "balance": CURVE * curves})
    searching = replace(execution, progress=phases[SEARCH])
    searching.progress(0, 1)
    results, reason = carry_through(every, work, searching, identity=scene.resolved_yaml())
    running = earlier + time.perf_counter() - clock - compiling
    gathered = Gathered(grid, plan, results)
    sweep = gathered.sweep({"method": str(solver), "compile_seconds": compiling, "run_seconds": running})
    states = counted(number_of_states(sweep), "steady state")
    states = f"{states} of both sweeps, and the search, in {running:.2f} s"
    lines = [states, *unusual_lines(sweep), *sweep_effort_lines(sweep, scene)]
    groups, reasons = {"sweep": sweep}, [reason or failure_line(sweep) or gathered.failure]
    if plan.balance is not None and not (reason or "").startswith(INTERRUPTED):
        after = replace(execution, progress=phases["balance"])
        hbm, own, hbm_reason = followed_behind(scene, plan.balance, after)
        groups["hbm"] = hbm
        lines += own.notes
        lines += fold_lines(hbm, gathered.ends, gathered.failed, float(np.diff(grid.frequency).max(initial=0.0)))
        compiling, running = (compiling + hbm.attrs["compile_seconds"], running + hbm.attrs["run_seconds"])
        if hbm_reason and INTERRUPTED in hbm_reason:
            reasons.append(f"hbm: {hbm_reason}")
        elif hbm_reason:
            lines.append(f"the balance behind is not whole: {hbm_reason}; study.harmonics: 0 leaves it out")
    why = "; ".join(filter(None, reasons)) or None
    data = gathered.data(attributes(scene, str(solver), compiling, running, why))
    return Outcome({"": data, **groups}, why, (*bistable_lines(data, sweep, plan.width), *lines))


def chunks(grid: Grid, plan: BistablePlan, solver: Solver) -> list[Chunk]:
    """All the work: for each set of values the parts of the sweeps, the ends, the starts."""
    up = tuple(map(float, grid.frequency))
    every = []
    for v, model in grid.models.items():
        given, after = (model, solver, plan.sweep.criterion), None
        for first in range(0, len(up), STEPS_A_CHUNK):
            rows = slice(first, first + STEPS_A_CHUNK)
            name = f"{v:05d}-sweep-{first // STEPS_A_CHUNK:05d}"
            every.append(Chunk(name, Part(*given, up[rows], up[::-1][rows]), after, 2 * len(up[rows])))
            after = name
        every.append(Chunk(f"{v:05d}-ends", Ends(*given, plan.width), after, len(up)))
        if plan.starts:
            every.append(Chunk(f"{v:05d}-starts", Starts(*given, plan.starts), f"{v:05d}-ends", plan.starts**2))
    return every


# Dimensions of the quantities of a range, and of its starts, after those of the further axes and `jump`.
SPOT = ("point", "axis")
DIMS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("range", "range_cut", "range_settled", "range_irregular"), ("end",)),
    **dict.fromkeys(("jump_from", "jump_to"), ("end", *SPOT)),
    **dict.fromkeys(("amplitude_lower", "amplitude_upper"), SPOT),
    **dict.fromkeys(("period", "floquet_max"), ("motion",)),
    **dict.fromkeys(("slip_share", "separation_share"), ("motion", "contact")),
    "phase_deg": ("motion", *SPOT),
    "dissipated_power": ("motion", "contact"),
}
OF_STARTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("start_branch", "start_failure", "start_cycles"), ("share_lower", "share_upper")),
    "start_amplitude": ("share_lower", "share_upper", *SPOT),
    **dict.fromkeys(("offset_low", "offset_high"), ("motion", "contact", "tangent")),
}
# Values where there is no range, where these are not NaN.
BLANK: dict[str, tuple[Any, type]] = {
    **dict.fromkeys(("range_cut", "range_settled", "range_irregular", "period"), (-1, np.int32)),
    **dict.fromkeys(("start_branch", "start_cycles"), (-1, np.int32)),
    "start_failure": ("", object),
}


class Gathered:
    """The results of the chunks, put together."""

    def __init__(self, grid: Grid, plan: BistablePlan, results: Mapping[str, Result]):
        self.grid, self.plan, self.results = grid, plan, results
        self.sets = list(product(*plan.sweep.over.values()))
        self.whole = [self._last(v) for v in range(len(self.sets))]
        self.count = max((len(result["range"]) for result in self.whole if result), default=0)

    @property
    def ends(self) -> dict[tuple[float, ...], np.ndarray]:
        """Ends of the ranges [Hz] of each set of values that knows its ranges."""
        sets = zip(self.sets, self.whole, strict=True)
        return {values: np.ravel(result["range"]) for values, result in sets if result is not None}

    @property
    def failure(self) -> str | None:
        """Why the search for jumps is not whole, or else the ensemble of starts; None if both are."""
        known = [result for result in self.whole if result is not None]
        starts = [str(why) for result in known for why in np.ravel(result.get("start_failure", ()))]
        return search_failure(known) or starts_line(list(filter(None, starts)))

    @property
    def failed(self) -> dict[tuple[float, ...], np.ndarray]:
        """Frequencies [Hz] of the points of both sweeps that failed, of each set of values that is swept."""
        return {self.sets[v]: result["frequency"][result["reason"] != ""] for v, result in self.swept.items()}

    @property
    def swept(self) -> dict[int, Result]:
        """Both sweeps of each set of values: each part includes those before it, so that the last one replaces them."""
        return {int(name.split("-")[0]): result for name, result in self.results.items() if "-sweep-" in name}

    def _last(self, v: int) -> Result | None:
        """The last result of a set of values that has the ranges; None if they are not known."""
        names = (f"{v:05d}-starts", f"{v:05d}-ends")
        return next((self.results[name] for name in names if name in self.results), None)

    def sweep(self, attrs: Mapping[str, Any]) -> Dataset:
        """Both sweeps as the `sweep` study writes them, their jumps bisected."""
        swept: dict[str, Result] = {}
        places: dict[str, Any] = {}
        for v, result in self.swept.items():
            done = self.whole[v]
            jumps = np.zeros((0, 3)) if done is None else done["jumps"]
            key, size = f"{v:05d}", result["settled"].shape[1]
            swept[key] = {column: result[column] for column in COLUMNS} | {"jumps": jumps}
            places[key] = [(v, direction, slice(0, size)) for direction in (UP, 1 - UP)]
        data = self.grid.data(*self.grid.gathered(swept, places), attrs)
        # The groups of a tree share their dimensions, so there must be as many places for jumps as for ranges.
        self.count = max(self.count, data.sizes["jump"])
        return data.pad(jump=(0, self.count - data.sizes["jump"]))

    def data(self, attrs: Mapping[str, Any]) -> Dataset:
        """The root of the result file."""
        model, num = self.grid.any_model, self.plan.starts
        sizes = sizes_of(model) | {"end": 2, "motion": 2, "share_lower": num, "share_upper": num}
        over = tuple(values.size for values in self.grid.axes.values())
        variables = {}
        for name, dims in (DIMS | OF_STARTS if num else DIMS).items():
            shape = tuple(sizes[dim] for dim in dims)
            table = self._table(name, shape).reshape(*over, self.count, *shape)
            variables[name] = ((*self.grid.axes, "jump", *dims), table)
        of_starts = {"share_lower": shares(num), "share_upper": shares(num)} if num else {}
        return dataset(variables, self.grid.axes | of_starts, attrs, model)

    def _table(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """A quantity of all ranges, shape (sets, ranges, ...); blank where there are fewer."""
        fill, kind = BLANK.get(name, (np.nan, float))
        table: np.ndarray = np.full((len(self.whole), self.count, *shape), fill, dtype=kind)
        for v, result in enumerate(self.whole):
            rows = None if result is None else _of_ranges(result, name)
            if rows is not None:
                table[v, : len(rows)] = rows
        return table


def _of_ranges(result: Result, name: str) -> np.ndarray | None:
    """A quantity of the ranges of one set of values; None if it is not known."""
    side = {"amplitude_lower": LOWER, "amplitude_upper": UPPER}.get(name)
    if not len(result["range"]) or (side is None and name != "phase_deg"):
        return result.get(name)
    return phase_deg(result["phasor"]) if side is None else result["amplitude"][:, side]
