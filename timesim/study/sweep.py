"""The `sweep` study: steady states over frequency and any scalars of the scene, in chunks that are computed separately.

The result of a chunk depends only on its payload and on the state in which the chunk before it has ended, so a sweep
gives the same bits however its chunks are spread over threads or a cluster, and wherever it was interrupted.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.fault import SceneError
from timesim.model.model import Model
from timesim.model.solver import Criterion, Solver
from timesim.orbit.jump import Stretch, Watched, jumps_of, steps_of, suspects
from timesim.orbit.settling import Chain, GivenUpError, SteadyStates, steady_states, warm_up
from timesim.orbit.steady_state import COLUMNS, Columns, Orbit, blank_columns, columns_of, end_of, orbit_of
from timesim.result.coordinate import most_friction
from timesim.result.dataset import Arrays, dataset
from timesim.result.label import counted
from timesim.scene.resolution import Scene
from timesim.scene.study import SweepPlan, combinations
from timesim.study.columns import variables_of
from timesim.study.execution.campaign import Chunk, Execution, Result, carry_through
from timesim.study.execution.progress import Phases
from timesim.study.execution.worker import UnfinishedError, each, halted, point_done
from timesim.study.outcome import Outcome, attributes, unit_names
from timesim.study.summary.effort import sweep_effort_lines
from timesim.study.summary.sweep import failure_line, sweep_lines

POINTS_A_CHUNK = 32  # independent points: 16 to 128 take as long; those of a chunk under way are lost at an interrupt
CHAINS_A_CHUNK = (4, 32)  # few chains are spread over the processors, many are kept in few files
MANY_CHAINS = 64
FAILURES = "search_failures"  # of a chunk: why motions of its search could not be computed
STEPS_A_CHUNK = 16  # of a chain: the most that is lost when a sweep is interrupted


@dataclass(frozen=True)
class Segment:
    """Work of one chunk: chains of frequencies [Hz], begun anew or where the chunk before has ended.

    Attributes:
        solver, criterion: how their steady states are sought.
        refine: width [Hz] to which jumps along the chains are bisected; None does not search for them.
    """

    chains: tuple[Chain, ...]
    solver: Solver
    criterion: Criterion
    refine: float | None = None


def steady_of(chains: Sequence[Chain], solver: Solver, criterion: Criterion) -> list[list[Orbit]]:
    """`steady_states` within a chunk: given up with it, its points counted, its parts shared by the threads."""
    return steady_states(chains, solver, criterion, halted=halted, count=point_done, each=each)


def solve(segment: Segment, before: Result | None) -> Result:
    """The steady states of a segment as arrays: chain first, then its frequencies.

    Raises:
        UnfinishedError: it was given up; some steady states may be missing, and all jumps.
    """
    chains = [continued(chain, index, before) for index, chain in enumerate(segment.chains)]
    steady = partial(steady_of, solver=segment.solver, criterion=segment.criterion)
    orbits, search, jumps = list[list[Orbit]](), Watched(steady), list[tuple[int, float, float]]()
    try:
        orbits = steady(chains)
        if segment.refine is not None:
            jumps = list(_jumps(search, segment.refine, chains, orbits, before))
    except GivenUpError as given_up:
        own = orbits or given_up.orbits
        result = _so_far(chains, own) | {"jumps": np.zeros((0, 3)), FAILURES: np.zeros(0, dtype=str)}
        raise UnfinishedError(result, sum(map(len, own))) from None
    rows = columns_of(orbits)
    rows |= {"jumps": np.array(jumps, dtype=float).reshape(-1, 3), FAILURES: np.array(search.failures, dtype=str)}
    return rows | {"last_frequency": np.array([chain.frequencies[-1] for chain in chains])}


def _so_far(chains: Sequence[Chain], orbits: Sequence[list[Orbit]]) -> dict[str, np.ndarray]:
    """`columns_of` where some steady states of each chain are still missing."""
    rows = blank_columns(chains[0].model, len(chains), len(chains[0].frequencies))
    for index, own in enumerate(orbits):
        if own:
            for name, array in columns_of([own]).items():
                rows[name][index, : len(own)] = array[0]
    return rows


def _jumps(
    steady: SteadyStates, width: float, chains: Sequence[Chain], orbits: Sequence[list[Orbit]], before: Result | None
) -> Iterator[tuple[int, float, float]]:
    """Jumps along the chains: position of the chain, low and high end."""
    steps = [_steps(chain, own, before, index) for index, (chain, own) in enumerate(zip(chains, orbits, strict=True))]
    where = [index for index, own in enumerate(steps) for _ in own]
    every = [step for own in steps for step in own]
    for step, low, high in jumps_of(every, steady, width):
        yield where[step], low, high


def _steps(chain: Chain, own: list[Orbit], before: Result | None, index: int) -> list[Stretch]:
    """The steps of a chain, within which it may jump, including the one from the segment before."""
    frequencies, orbits = list(chain.frequencies), list(own)
    if before is not None and not before["reason"][index, -1]:
        frequencies.insert(0, float(before["last_frequency"][index]))
        orbits.insert(0, orbit_of(before, (index, -1), chain.model.start.phase))
    return steps_of(chain.model, frequencies, orbits)


def continued(chain: Chain, index: int, before: Result | None) -> Chain:
    """A chain that continues where the same one of the segment before has ended, unless its last point failed."""
    if before is None or before["reason"][index, -1]:
        return chain
    start = end_of(before, (index, -1), chain.model.start.phase)
    return replace(chain, model=replace(chain.model, start=start))


# The study


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run a sweep; points that fail are marked, named with the reason, and make the result incomplete."""
    phases = Phases(execution.progress, {"sweep": scene.plan.size})
    data, reason = sweep_record(scene, scene.plan, replace(execution, progress=phases["sweep"]))
    method, compiling, running = (data.attrs[name] for name in ("method", "compile_seconds", "run_seconds"))
    attrs = attributes(scene, method, compiling, running, reason)
    return Outcome({"": data.assign_attrs(attrs)}, reason, (*sweep_lines(data), *sweep_effort_lines(data, scene)))


def sweep_record(scene: Scene, plan: SweepPlan, execution: Execution) -> tuple[Dataset, str | None]:
    """The steady states over the further axes, direction and frequency, and why they are incomplete, or None.

    The attributes of the result are `method`, `compile_seconds`, `run_seconds` and, of its work, `complete`.
    """
    solver, grid = scene.solver(), Grid(scene, plan)
    chunks, places = grid.chunks(solver)
    earlier = execution.earlier("")
    clock = time.perf_counter()
    if execution.cluster is None:
        warm_up((chain for chunk in chunks for chain in chunk.payload.chains), solver)
    compiling = time.perf_counter() - clock
    execution.progress(0, plan.size)
    results, reason = carry_through(chunks, solve, execution, identity=scene.resolved_yaml())
    arrays, jumps = grid.gathered(results, places)
    seconds = earlier + time.perf_counter() - clock - compiling
    search = search_failure(results.values())
    attrs: dict[str, Any] = {"method": str(solver), "compile_seconds": compiling, "run_seconds": seconds}
    attrs["complete"] = int(reason is None and search is None)
    if plan.chained:
        attrs["jumps_bisected"] = int(plan.refine is not None)
    data = grid.data(arrays, jumps, attrs)
    return data, reason or failure_line(data) or search


def search_failure(results: Iterable[Result]) -> str | None:
    """Why the search for jumps of some chunks is not whole, with the first failure; None if it is."""
    failures = [str(why) for result in results for why in result.get(FAILURES, ())]
    if not failures:
        return None
    motions = counted(len(failures), "motion")
    return f"the search for jumps is not exact, as {motions} of it could not be computed: {failures[0]}"


def steady_dataset(grid: "Grid", columns: Columns, own: Arrays) -> Dataset:
    """The result file of a sweep: its steady states, and further variables of its own."""
    scene, plan, model = grid.scene, grid.plan, grid.any_model
    coords = {**grid.axes, "direction": np.array(plan.directions), "frequency": grid.frequency}
    axes = {name: len(values) for name, values in coords.items()}
    variables = variables_of(columns, axes, scene.solver().rtol)
    variables["mode_shape"] = grid.of_models(("point", "axis", "mode"), lambda model: model.structure.shape)
    variables["contact_frame"] = grid.of_models(("contact", "component", "axis"), lambda model: model.contact_frames)
    variables["final_phase_deg"] = ((), np.array(np.rad2deg(model.start.phase) % 360))
    return dataset(variables | own, coords, {"settle_tolerance": plan.criterion.tolerance, **unit_names(scene)}, model)


Place = tuple[int, int, slice]
"""Set of values, direction, and positions of the frequencies, for each chain of a chunk."""
Jump = tuple[int, int, float, float]
"""Set of values, direction, low and high end [Hz]."""


class Grid:
    """The points of a sweep: sets of values of the further axes, directions, frequencies.

    `models` and `failed` hold by the number of each set of values its model, or why it has none.
    """

    def __init__(self, scene: Scene, plan: SweepPlan):
        self.scene, self.plan = scene, plan
        self.axes = {key: np.array(values) for key, values in plan.over.items()}
        self.frequency = plan.frequency
        self.models: dict[int, Model] = {}
        self.failed: dict[int, str] = {}
        for v, values in enumerate(combinations(plan.over)):
            try:
                self.models[v] = scene.variant(values)
            except SceneError as error:
                self.failed[v] = str(error)
        self.any_model = most_friction(self.models.values() or [scene.model()])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Sets of values, directions, frequencies."""
        return len(self.models) + len(self.failed), len(self.plan.directions), self.frequency.size

    def chunks(self, solver: Solver) -> tuple[list[Chunk], dict[str, list[Place]]]:
        """The chunks, and the places of their results."""
        chunks: list[Chunk] = []
        places: dict[str, list[Place]] = {}
        for name, after, where in self._pieces():
            chains = tuple(Chain(self.models[v], tuple(self._visited(d, f))) for v, d, f in where)
            size = sum(len(chain.frequencies) for chain in chains)
            payload = Segment(chains, solver, self.plan.criterion, self.plan.refine)
            chunks.append(Chunk(name, payload, after, size))
            places[name] = where
        return chunks, places

    def _visited(self, direction: int, where: slice) -> list[float]:
        order = self.frequency[::-1] if self.plan.directions[direction] == "down" else self.frequency
        return list(map(float, order[where]))

    def _pieces(self) -> Iterator[tuple[str, str | None, list[Place]]]:
        if not self.plan.chained:
            points: list[Place] = [(v, 0, slice(f, f + 1)) for v in self.models for f in range(self.frequency.size)]
            for number, part in enumerate(_parts(points, POINTS_A_CHUNK)):
                yield f"points-{number:05d}", None, part
            return
        every = list(product(self.models, range(len(self.plan.directions))))
        for number, chains in enumerate(_parts(every, CHAINS_A_CHUNK[len(every) > MANY_CHAINS])):
            after = None
            for step in range(0, self.frequency.size, STEPS_A_CHUNK):
                name = f"chains-{number:05d}-{step // STEPS_A_CHUNK:05d}"
                yield name, after, [(v, d, slice(step, step + STEPS_A_CHUNK)) for v, d in chains]
                after = name

    def gathered(
        self, results: Mapping[str, Result], places: Mapping[str, list[Place]]
    ) -> tuple[dict[str, np.ndarray], list[Jump]]:
        """Columns over (set, direction, ascending frequency), and the jumps."""
        arrays = blank_columns(self.any_model, *self.shape)
        for v, reason in self.failed.items():
            arrays["reason"][v] = reason
        jumps: list[Jump] = []
        for name, result in results.items():
            for index, (v, d, f) in enumerate(places[name]):
                for column in COLUMNS:
                    arrays[column][v, d, f] = result[column][index]
            for index, low, high in result["jumps"]:
                v, d, _ = places[name][int(index)]
                jumps.append((v, d, low, high))
        if self.plan.refine is None and self.plan.chained:
            jumps += self._unrefined(arrays["amplitude"])
        for d, direction in enumerate(self.plan.directions):
            if direction == "down":
                for array in arrays.values():
                    array[:, d] = array[:, d, ::-1]
        return arrays, jumps

    def _unrefined(self, amplitude: np.ndarray) -> Iterator[Jump]:
        """Steps over which the amplitude stands out."""
        for v, d in product(range(self.shape[0]), range(self.shape[1])):
            frequency = self._visited(d, slice(None))
            for k in suspects(amplitude[v, d].reshape(self.frequency.size, -1)):
                low, high = sorted(frequency[k : k + 2])
                yield v, d, low, high

    def data(self, arrays: Mapping[str, np.ndarray], jumps: Sequence[Jump], attrs: Mapping[str, Any]) -> Dataset:
        """The result file."""
        ends = self._jump_table(jumps).reshape(*map(len, self.axes.values()), self.shape[1], -1, 2)
        dims = (*self.axes, "direction", "jump")
        own = {name: (dims, ends[..., i]) for i, name in enumerate(("jump_low", "jump_high"))}
        return steady_dataset(self, arrays, own).assign_attrs(attrs)

    def of_models(
        self, dims: tuple[str, ...], array_of: Callable[[Model], np.ndarray]
    ) -> tuple[tuple[str, ...], np.ndarray]:
        """An array of the models, along the further axes too where it depends on these; NaN where there is no model."""
        first = array_of(self.any_model)
        if all(np.array_equal(array_of(model), first) for model in self.models.values()):
            return dims, first
        every = np.full((self.shape[0], *first.shape), np.nan)
        for v, model in self.models.items():
            every[v] = array_of(model)
        return (*self.axes, *dims), every.reshape(*map(len, self.axes.values()), *first.shape)

    def _jump_table(self, jumps: Sequence[Jump]) -> np.ndarray:
        """Both ends of the jumps of each chain, shape (sets, directions, jumps, 2), NaN where a chain has fewer."""
        rows: dict[tuple[int, int], list[tuple[float, float]]] = {}
        for v, d, low, high in sorted(jumps, key=lambda jump: jump[2]):
            rows.setdefault((v, d), []).append((low, high))
        table = np.full((*self.shape[:2], max(map(len, rows.values()), default=0), 2), np.nan)
        for (v, d), ends in rows.items():
            table[v, d, : len(ends)] = ends
        return table


def _parts(items: list[Any], size: int) -> Iterator[list[Any]]:
    for first in range(0, len(items), size):
        yield items[first : first + size]
