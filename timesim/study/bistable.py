"""The `bistable` study: where a response has two steady motions, which start leads to which, and the branch behind.

For each set of values of the further axes: parts of both sweeps one after the other, then the ends of the ranges, then
the ensemble of starts. Each is a chunk of its own, so that an interrupted study is taken up where it was.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.model.model import Model
from timesim.model.solver import Criterion, Solver
from timesim.orbit.basin import ANOTHER, LOWER, NONE, UPPER, explore, shares, unique
from timesim.orbit.batch import SIZES
from timesim.orbit.settling import Chain, steady_states, warm_up
from timesim.orbit.steady_state import COLUMNS, Orbit, columns_of, end_of
from timesim.orbit.two_motions import UP, Search, ranges_of
from timesim.result.coordinate import coordinates
from timesim.result.dataset import dataset
from timesim.scene.resolution import Scene
from timesim.scene.sweep import BistablePlan
from timesim.study.campaign import INTERRUPTED, Chunk, Means, Result, carry_through, halted
from timesim.study.hbm import followed
from timesim.study.outcome import Outcome, attributes
from timesim.study.sweep import STEPS_A_CHUNK, Grid, failures, states_told

LISTED = 12  # ranges that the summary names
MOTIONS = ("lower", "upper")


@dataclass(frozen=True)
class Payload:
    """What is done for one set of values; each kind of work goes on from the result of the one before.

    Attributes:
        model, solver, criterion: the scene, and how its steady states are sought.
    """

    model: Model
    solver: Solver
    criterion: Criterion

    def steady(self, chains: Sequence[Chain]) -> list[list[Orbit]]:
        """Their steady states."""
        return steady_states(chains, self.solver, self.criterion, halted=halted)


@dataclass(frozen=True)
class Part(Payload):
    """A part of both sweeps: the frequencies [Hz] that each visits, upwards and downwards."""

    up: tuple[float, ...]
    down: tuple[float, ...]

    def result(self, before: Result | None) -> Result:
        """All steady states of both sweeps so far, in the order of each."""
        chains = []
        for direction, frequencies in enumerate((self.up, self.down)):
            start = self.model.start
            if before is not None and not before["reason"][direction, -1]:
                start = end_of(before, (direction, -1), start.phase)
            chains.append(Chain(replace(self.model, start=start), frequencies))
        here = columns_of(self.steady(chains)) | {"frequency": np.array([self.up, self.down])}
        if before is None:
            return here
        return {name: np.concatenate([before[name], array], axis=1) for name, array in here.items()}


@dataclass(frozen=True)
class Ends(Payload):
    """The ends of the ranges, each to a width [Hz]."""

    width: float

    def result(self, before: Result | None) -> Result:
        """The jumps, and the ranges with their motions."""
        assert before is not None
        return ranges_of(Search(self.model, self.steady, self.width), before)


@dataclass(frozen=True)
class Starts(Payload):
    """The ensemble of starts, so many along each side."""

    num: int

    def result(self, before: Result | None) -> Result:
        """What has become of them, beside the ranges."""
        assert before is not None
        return dict(before) | explore(self.model, self.steady, before, self.num)


def work(payload: Part | Ends | Starts, before: Result | None) -> Result:
    """What a chunk gives; `Work` of the campaign."""
    return payload.result(before)


def study(scene: Scene, means: Means) -> Outcome:
    """Run a bistable scene. That no range is found is a result, no failure.

    The balance is only drawn behind the ranges: where it comes to no end the summary says so, and its group of the
    result is marked, but the study is complete.
    """
    plan: BistablePlan = scene.plan
    solver, grid = scene.solver(), Grid(scene, plan.sweep)
    clock = time.perf_counter()
    models = [item for item in grid.models if isinstance(item, Model)]
    sizes = SIZES if plan.starts**2 > SIZES[0] else SIZES[:1]
    warm_up((Chain(model, (float(grid.frequency[0]),)) for model in models), solver, sizes)
    compiling = time.perf_counter() - clock
    results, reason = carry_through(chunks(grid, plan, solver), work, means, identity=scene.resolved_yaml())
    found = Found(grid, plan, results)
    running = time.perf_counter() - clock - compiling
    swept = found.sweep({"method": str(solver), "compile_seconds": compiling, "run_seconds": running})
    reasons, groups = [reason or failures(swept)], {"sweep": swept}
    _, *more = states_told(swept)
    size = int(np.isfinite(swept["amplitude"].values).all(axis=(-2, -1)).sum())
    lines = [*found.summary(), f"{size} steady states of both sweeps, and the search, in {running:.2f} s", *more]
    if plan.balance is not None and not (reason or "").startswith(INTERRUPTED):
        balanced, _, hbm_reason = followed(scene, plan.balance)
        groups["hbm"] = balanced
        lines += folds(balanced)
        compiling, running = (compiling + balanced.attrs["compile_seconds"], running + balanced.attrs["run_seconds"])
        if hbm_reason and INTERRUPTED in hbm_reason:
            reasons.append(f"hbm: {hbm_reason}")
        elif hbm_reason:
            lines.append(f"the balance behind is not whole: {hbm_reason}; study.harmonics: 0 leaves it out")
    why = "; ".join(filter(None, reasons)) or None
    told = attributes(scene, str(solver), compiling, running, why)
    return Outcome({"": found.record(told), **groups}, why, tuple(lines))


def chunks(grid: Grid, plan: BistablePlan, solver: Solver) -> list[Chunk]:
    """All the work: of each set of values parts of the sweeps, the ends, the starts."""
    up = tuple(map(float, grid.frequency))
    every = []
    for v, model in enumerate(grid.models):
        if not isinstance(model, Model):
            continue
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


class Found:
    """What the chunks have given, put together."""

    def __init__(self, grid: Grid, plan: BistablePlan, results: Mapping[str, Result]):
        self.grid, self.plan, self.results = grid, plan, results
        self.whole = [self._last(v) for v in range(len(grid.models))]
        self.count = max((len(result["range"]) for result in self.whole if result), default=0)

    def _last(self, v: int) -> Result | None:
        """The result of the last chunk of a set of values that knows its ranges."""
        names = (f"{v:05d}-starts", f"{v:05d}-ends")
        return next((self.results[name] for name in names if name in self.results), None)

    def sweep(self, told: Mapping[str, Any]) -> Dataset:
        """Both sweeps as the `sweep` study writes them, their jumps bisected."""
        swept: dict[str, Result] = {}
        places: dict[str, Any] = {}
        for name, result in self.results.items():
            if "-sweep-" not in name:
                continue
            v = int(name.split("-")[0])
            done = self.whole[v]
            jumps = np.zeros((0, 3)) if done is None else done["jumps"]
            key, size = f"{v:05d}", result["settled"].shape[1]
            # The last part holds those before it.
            swept[key] = {column: result[column] for column in COLUMNS} | {"jumps": jumps}
            places[key] = [(v, direction, slice(0, size)) for direction in (UP, 1 - UP)]
        data = self.grid.record(*self.grid.gathered(swept, places), told)
        # The groups of a tree share their dimensions: ranges and jumps have as many places.
        self.count = max(self.count, data.sizes["jump"])
        return data.pad(jump=(0, self.count - data.sizes["jump"]))

    def record(self, told: Mapping[str, Any]) -> Dataset:
        """The root of the result file."""
        model = next((item for item in self.grid.models if isinstance(item, Model)), self.grid.scene.model())
        points, contacts, num = len(model.structure.points), model.num_contacts, self.plan.starts
        spot = ("point", "axis")
        tails: dict[str, tuple[tuple[str, ...], tuple[int, ...]]] = {
            "range": (("end",), (2,)),
            "range_cut": (("end",), (2,)),
            "range_settled": (("end",), (2,)),
            "jump_from": (("end", *spot), (2, points, 3)),
            "jump_to": (("end", *spot), (2, points, 3)),
            "amplitude_lower": (spot, (points, 3)),
            "amplitude_upper": (spot, (points, 3)),
            "floquet_max": (("motion",), (2,)),
            "slip_share": (("motion", "contact"), (2, contacts)),
            "separation_share": (("motion", "contact"), (2, contacts)),
        }
        if num:
            side = ("share_lower", "share_upper")
            free = (("motion", "contact", "tangent"), (2, contacts, 2))
            tails |= {
                "start_branch": (side, (num, num)),
                "start_cycles": (side, (num, num)),
                "start_amplitude": ((*side, *spot), (num, num, points, 3)),
                "offset_low": free,
                "offset_high": free,
            }
        sizes = tuple(values.size for values in self.grid.axes.values())
        variables = {}
        for name, (dims, shape) in tails.items():
            table = self._table(name, shape)
            variables[name] = ((*self.grid.axes, "jump", *dims), table.reshape(*sizes, self.count, *shape))
        coords = self.grid.axes | coordinates(variables, model)
        if num:
            coords |= {"share_lower": shares(num), "share_upper": shares(num)}
        return dataset(variables, coords, told)

    def _table(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """A quantity of all ranges, shape (sets, ranges, ...); NaN, and of whole numbers -1, where there are fewer."""
        whole = name in ("range_cut", "range_settled", "start_branch", "start_cycles")
        table = np.full(
            (len(self.whole), self.count, *shape), -1 if whole else np.nan, dtype=np.int32 if whole else float
        )
        for v, result in enumerate(self.whole):
            if result is None:
                continue
            side = {"amplitude_lower": LOWER, "amplitude_upper": UPPER}.get(name)
            rows = result["amplitude"][:, side] if side is not None else result.get(name)
            if rows is not None:
                table[v, : len(rows)] = rows
        return table

    def summary(self) -> Iterator[str]:
        """The ranges in words."""
        lines = [line for v, result in enumerate(self.whole) if result for line in self._told(v, result)]
        if not lines and any(result is not None for result in self.whole):
            span = self.grid.frequency
            yield (
                f"no range with two motions was found from {span[0]:g} to {span[-1]:g} Hz: both sweeps are on one "
                f"motion at all {self.grid.frequency.size} frequencies, and no jump is left when a step is bisected"
            )
        yield from lines[:LISTED]
        if len(lines) > LISTED:
            yield f"and {len(lines) - LISTED} more lines, all of it in the result file"

    def _told(self, v: int, result: Result) -> Iterator[str]:
        index = np.unravel_index(v, tuple(values.size for values in self.grid.axes.values())) if self.grid.axes else ()
        values = [f"{key} {values[i]:g}" for (key, values), i in zip(self.grid.axes.items(), index, strict=True)]
        label = ", ".join(values) + ": " if values else ""
        model = self.grid.models[v]
        assert isinstance(model, Model)
        for k, (low, high) in enumerate(result["range"]):
            pair = result["amplitude"][k]
            point, axis = np.unravel_index(np.argmax(pair[UPPER]), pair[UPPER].shape)
            name = f"{model.structure.points[int(point)]} {'xyz'[int(axis)]}"
            one, other = pair[:, point, axis]
            yield (
                f"{label}two motions from {low:.8g} to {high:.8g} Hz (each end to {self.plan.width:g} Hz): "
                f"amplitude of {name} {one:.6g} or {other:.6g} at {0.5 * (low + high):.6g} Hz"
            )
            for end, cut in zip(("low", "high"), result["range_cut"][k], strict=True):
                if cut:
                    yield f"{label}the {end} end of it is that of the search, not of the range: widen frequency"
            if not result["range_settled"][k].all():
                yield (
                    f"{label}next to an end of it the motion had not settled after settle.max_cycles, "
                    "which may move that end by some of the width"
                )
            if "start_branch" in result:
                yield from _starts_told(label, model, result, k)


def _starts_told(label: str, model: Model, result: Result, k: int) -> Iterator[str]:
    branch = result["start_branch"][k]
    count = {side: int(np.sum(branch == side)) for side in (LOWER, UPPER, ANOTHER, NONE)}
    others = (f", {count[ANOTHER]} to another motion" if count[ANOTHER] else "") + (
        f", {count[NONE]} did not settle" if count[NONE] else ""
    )
    yield (
        f"{label}of {branch.size} starts {count[LOWER]} lead to the smaller motion, "
        f"{count[UPPER]} to the larger{others}"
    )
    at_rest = np.isclose(shares(len(branch)), 0.0)
    if at_rest.any():
        rest = int(np.argmax(at_rest))
        led = {LOWER: "the smaller motion", UPPER: "the larger motion", ANOTHER: "another motion"}
        yield f"{label}rest leads to {led.get(int(branch[rest, rest]), 'no settled motion')}"
    low, high = result["offset_low"][k], result["offset_high"][k]
    size = float(np.max(result["amplitude"][k]))
    free = ~unique(low, high, size)
    for side, i in np.argwhere(free.any(axis=-1)).tolist():
        spans = " and ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(low[side, i], high[side, i], strict=True))
        yield (
            f"{label}contact {model.contacts[i].name} sticks all the time on the {MOTIONS[side]} motion, "
            f"and its offset is not unique: over the starts w is {spans}. The end at which this motion is lost holds "
            "for the offset that the sweep left it with"
        )


def folds(record: Dataset) -> Iterator[str]:
    """Folds of the balance, beside which the ends may be read."""
    frequency, fold = record["frequency"].values, record["fold"].values > 0
    keys = [name for name in map(str, record.data_vars) if "." in name]
    sets: dict[str, list[float]] = {}
    for place in np.flatnonzero(fold):
        label = ", ".join(f"{key} {record[key].values[place]:g}" for key in keys)
        sets.setdefault(label, []).append(float(frequency[place]))
    for label, turning in list(sets.items())[:LISTED]:
        before = f"{label}: " if label else ""
        yield f"{before}folds of the balance at {', '.join(f'{place:.7g}' for place in sorted(turning))} Hz"
    if not sets and frequency.size:
        yield "the branch of the balance has no fold"
