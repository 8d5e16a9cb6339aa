"""The `sweep` study: steady states over frequency and any scalars of the scene, in chunks that are computed apart.

What a chunk gives depends on nothing but its payload and the state that the chunk before it has ended with, so a sweep
gives the same bits however its chunks are spread over threads or a cluster, and wherever it was interrupted.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.fault import SceneError
from timesim.model.model import Model
from timesim.model.solver import Criterion, Solver
from timesim.orbit.jump import Stretch, jumps_of, steps_of, suspects
from timesim.orbit.settling import Chain, SteadyStates, steady_states, warm_up
from timesim.orbit.steady_state import COLUMNS, START, Orbit, columns_of, end_of, orbit_of
from timesim.result.coordinate import coordinates
from timesim.result.dataset import dataset
from timesim.scene.resolution import Scene
from timesim.scene.study import SweepPlan, combinations
from timesim.study.campaign import Chunk, Means, Result, carry_through, halted
from timesim.study.outcome import Outcome, attributes

POINTS_A_CHUNK = 128  # of independent points: their batch is kept full while some of them settle late
CHAINS_A_CHUNK = (4, 32)  # few chains are spread over the processors, many fill a batch
MANY_CHAINS = 64
STEPS_A_CHUNK = 16  # of a chain: what is lost at most when a sweep is interrupted
LISTED = 5  # failed points that the summary names


@dataclass(frozen=True)
class Segment:
    """Work of one chunk: some chains of frequencies [Hz], begun anew or where the chunk before it has ended.

    Attributes:
        chains: what is to be found.
        solver, criterion: how.
        refine: width [Hz] to which jumps along the chains are narrowed down; None does not look for them.
        crowd: chains of the largest segment, which the batches of all are sized for.
    """

    chains: tuple[Chain, ...]
    solver: Solver
    criterion: Criterion
    refine: float | None = None
    crowd: int = 0


def solve(segment: Segment, before: Result | None) -> Result:
    """The steady states of a segment as arrays: chain first, then its frequencies."""
    chains = list(segment.chains) if before is None else _continued(segment.chains, before)
    steady = partial(steady_states, solver=segment.solver, criterion=segment.criterion, halted=halted)
    orbits = steady(chains, crowd=segment.crowd)
    rows = columns_of(orbits)
    jumps = [] if segment.refine is None else list(_jumps(steady, segment.refine, chains, orbits, before))
    last = np.array([chain.frequencies[-1] for chain in chains])
    return rows | {"last_frequency": last, "jumps": np.array(jumps, dtype=float).reshape(-1, 3)}


def _jumps(
    steady: SteadyStates, width: float, chains: Sequence[Chain], orbits: Sequence[list[Orbit]], before: Result | None
) -> Iterator[tuple[int, float, float]]:
    """Jumps along the chains: position of the chain, low and high end."""
    steps = [_steps(chain, own, before, index) for index, (chain, own) in enumerate(zip(chains, orbits, strict=True))]
    where = [index for index, own in enumerate(steps) for _ in own]
    every = [step for own in steps for step in own]
    for step, jump in jumps_of(every, steady, width):
        yield where[step], jump.low, jump.high


def _steps(chain: Chain, own: list[Orbit], before: Result | None, index: int) -> list[Stretch]:
    """Steps of a chain within which it may jump, that from the segment before included."""
    frequencies, orbits = list(chain.frequencies), list(own)
    if before is not None and not before["reason"][index, -1]:
        frequencies.insert(0, float(before["last_frequency"][index]))
        orbits.insert(0, orbit_of(before, (index, -1), chain.model.start.phase))
    return steps_of(chain.model, frequencies, orbits)


def _continued(chains: Sequence[Chain], before: Result) -> list[Chain]:
    """Chains from where the segment before has ended; one whose last point failed starts anew."""
    made = []
    for index, chain in enumerate(chains):
        if before["reason"][index, -1]:
            made.append(chain)
            continue
        start = end_of(before, (index, -1), chain.model.start.phase)
        made.append(replace(chain, model=replace(chain.model, start=start)))
    return made


# The study


def study(scene: Scene, means: Means) -> Outcome:
    """Run a sweep; points that fail are marked, named with their reason, and make the result incomplete."""
    record, reason = sweep_record(scene, scene.plan, means)
    told = record.attrs
    attrs = attributes(scene, told["method"], told["compile_seconds"], told["run_seconds"], reason)
    return Outcome({"": record.assign_attrs(attrs)}, reason, tuple(summary(record)))


def sweep_record(scene: Scene, plan: SweepPlan, means: Means) -> tuple[Dataset, str | None]:
    """The steady states over the further axes, direction and frequency.

    Returns:
        The record, with `method`, `compile_seconds` and `run_seconds` as its attributes, and why it is incomplete; None
        if every point was computed.
    """
    solver, grid = scene.solver(), Grid(scene, plan)
    chunks, places = grid.chunks(solver)
    clock = time.perf_counter()
    if means.cluster is None:
        warm_up((chain for chunk in chunks for chain in chunk.payload.chains), solver, [chunks[0].payload.crowd])
    compiling = time.perf_counter() - clock
    results, reason = carry_through(chunks, solve, means, identity=scene.resolved_yaml())
    arrays, jumps = grid.gathered(results, places)
    seconds = time.perf_counter() - clock - compiling
    told = {"method": str(solver), "compile_seconds": compiling, "run_seconds": seconds}
    record = grid.record(arrays, jumps, told)
    return record, reason or failures(record)


def failures(record: Dataset) -> str | None:
    """How many points failed, and the first of them with their reasons; None if none did."""
    dims, reason = record["failure"].dims, record["failure"].values
    failed = np.argwhere(reason != "")
    if not failed.size:
        return None
    named = []
    for place in failed[:LISTED]:
        where = ", ".join(f"{dim} {_shown(record[dim].values[i])}" for dim, i in zip(dims, place, strict=True))
        named.append(f"{where}: {reason[tuple(place)]}")
    more = f"; and {len(failed) - LISTED} more, all in the variable failure" if len(failed) > LISTED else ""
    return f"{len(failed)} of {reason.size} points failed: " + "; ".join(named) + more


def _shown(value: Any) -> str:
    return str(value) if isinstance(value, str | np.str_) else f"{value:.10g}"


def summary(record: Dataset) -> Iterator[str]:
    """What a user wants to know of a sweep at once."""
    yield from states_told(record)
    yield from jumps_told(record)


def states_told(record: Dataset) -> Iterator[str]:
    """How many steady states there are, and which have not settled, in words."""
    found = {str(name): array.values for name, array in record.data_vars.items()}
    settled, period, done = found["settled"] == 1, found["period"], np.isfinite(found["amplitude"]).all(axis=(-2, -1))
    yield (
        f"{done.sum()} steady states by {record.attrs['method']} in {record.attrs['run_seconds']:.2f} s, "
        f"{found['cycles'].sum()} cycles"
    )
    if np.any(period > 1):
        yield f"{np.sum(period > 1)} of them repeat after more than one cycle (variable period)"
    lost = done & ~settled
    if np.any(lost):
        yield (
            f"{lost.sum()} points did not settle in settle.max_cycles (settled = 0, with the band of their amplitude): "
            f"{_spans(record, lost)}"
        )


def jumps_told(record: Dataset) -> Iterator[str]:
    """The jumps of a sweep in words."""
    found = {end: record[f"jump_{end}"].values for end in ("low", "high")}
    for place in zip(*np.nonzero(np.isfinite(found["low"])), strict=True):
        low, high = found["low"][place], found["high"][place]
        yield f"{_chain(record, place[:-1])}the motion jumps between {low:.8g} and {high:.8g} Hz"


def _spans(record: Dataset, chosen: np.ndarray) -> str:
    """From where to where points lie, for each chain that has some."""
    spans = []
    for place in map(tuple, np.argwhere(chosen.any(axis=-1))):
        at = record["frequency"].values[chosen[place]]
        between = f"at {at[0]:g} Hz" if at.size == 1 else f"between {at[0]:g} and {at[-1]:g} Hz"
        spans.append(_chain(record, place) + between)
    more = f"; and in {len(spans) - LISTED} more rows of the result" if len(spans) > LISTED else ""
    return "; ".join(spans[:LISTED]) + more


def _chain(record: Dataset, place: Sequence[int]) -> str:
    """What tells the points of a chain from those of others, with a colon; empty where there are no others."""
    dims = record["settled"].dims[:-1]
    named = [(dim, _shown(record[dim].values[i])) for dim, i in zip(dims, place, strict=True)]
    told = ", ".join(f"{dim} {value}" for dim, value in named if value != "independent")
    return f"{told}: " if told else ""


# Dimensions of the columns after those of the sweep, and the names of some in the result file.
TAILS = {
    "amplitude": ("point", "axis"),
    "band": ("band", "point", "axis"),
    "slip_share": ("contact",),
    "separation_share": ("contact",),
    "end_displacement": ("mode",),
    "end_velocity": ("mode",),
    "end_slip": ("contact", "tangent"),
    "end_state": ("contact",),
}
STORED = {
    "band": "amplitude_band",
    "reason": "failure",
    "end_displacement": "final_modal_displacement",
    "end_velocity": "final_modal_velocity",
    "end_slip": "final_slip",
    "end_state": "final_contact_state",
}

Place = tuple[int, int, slice | int]
"""Set of values, direction, and positions of the frequencies, for each chain of a chunk."""


class Grid:
    """The points of a sweep: sets of values of the further axes, directions, frequencies."""

    def __init__(self, scene: Scene, plan: SweepPlan):
        self.scene, self.plan = scene, plan
        self.axes = {key: np.array(values) for key, values in plan.over.items()}
        self.frequency = plan.frequency
        self.models = [_variant(scene, values) for values in combinations(plan.over)]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Sets of values, directions, frequencies."""
        return len(self.models), len(self.plan.directions), self.frequency.size

    def chunks(self, solver: Solver) -> tuple[list[Chunk], dict[str, list[Place]]]:
        """The work, and where the results of each chunk belong."""
        chunks: list[Chunk] = []
        places: dict[str, list[Place]] = {}
        pieces = list(self._pieces())
        crowd = max((len(where) for _, _, where in pieces), default=0)
        for name, after, where in pieces:
            chains = tuple(Chain(self._model(v), tuple(self._visited(d, f))) for v, d, f in where)
            size = sum(len(chain.frequencies) for chain in chains)
            payload = Segment(chains, solver, self.plan.criterion, self.plan.refine, crowd)
            chunks.append(Chunk(name, payload, after, size))
            places[name] = where
        return chunks, places

    def _model(self, index: int) -> Model:
        model = self.models[index]
        assert isinstance(model, Model)
        return model

    def _visited(self, direction: int, where: slice | int) -> list[float]:
        order = self.frequency[::-1] if self.plan.directions[direction] == "down" else self.frequency
        return list(map(float, np.atleast_1d(order[where])))

    def _pieces(self) -> Iterator[tuple[str, str | None, list[Place]]]:
        good = [v for v, model in enumerate(self.models) if isinstance(model, Model)]
        if not self.plan.chained:
            points: list[Place] = [(v, 0, f) for v in good for f in range(self.frequency.size)]
            for number, part in enumerate(_parts(points, POINTS_A_CHUNK)):
                yield f"points-{number:05d}", None, part
            return
        every = list(product(good, range(len(self.plan.directions))))
        for number, chains in enumerate(_parts(every, CHAINS_A_CHUNK[len(every) > MANY_CHAINS])):
            after = None
            for step in range(0, self.frequency.size, STEPS_A_CHUNK):
                name = f"chains-{number:05d}-{step // STEPS_A_CHUNK:05d}"
                yield name, after, [(v, d, slice(step, step + STEPS_A_CHUNK)) for v, d in chains]
                after = name

    def gathered(
        self, results: Mapping[str, Result], places: Mapping[str, list[Place]]
    ) -> tuple[dict[str, np.ndarray], list[tuple[int, int, float, float]]]:
        """Columns on (set, direction, order of the sweep), and jumps as (set, direction, low, high)."""
        arrays = self._blank()
        jumps: list[tuple[int, int, float, float]] = []
        for name, result in results.items():
            for index, (v, d, f) in enumerate(places[name]):
                for column in COLUMNS:
                    value = result[column][index]
                    arrays[column][v, d, f] = value if isinstance(f, slice) else value[0]
            for index, low, high in result["jumps"]:
                v, d, _ = places[name][int(index)]
                jumps.append((v, d, low, high))
        if self.plan.refine is None and self.plan.chained:
            jumps += self._unrefined(arrays["amplitude"])
        for name in START:
            arrays[name][arrays["reason"] != ""] = -1 if name == "end_state" else np.nan
        for d, direction in enumerate(self.plan.directions):
            if direction == "down":
                for array in arrays.values():
                    array[:, d] = array[:, d, ::-1]
        return arrays, jumps

    def _unrefined(self, amplitude: np.ndarray) -> Iterator[tuple[int, int, float, float]]:
        """Steps that stand out, from the amplitudes in the order of the sweep."""
        for v, d in product(range(self.shape[0]), range(self.shape[1])):
            frequency = self._visited(d, slice(None))
            for k in suspects(amplitude[v, d].reshape(self.frequency.size, -1)):
                low, high = sorted(frequency[k : k + 2])
                yield v, d, low, high

    def _blank(self) -> dict[str, np.ndarray]:
        model = next((item for item in self.models if isinstance(item, Model)), None)
        sizes = _sizes(model)
        tails = {name: tuple(sizes[dim] for dim in TAILS.get(name, ())) for name in COLUMNS}
        arrays = {name: np.full((*self.shape, *tail), np.nan) for name, tail in tails.items()}
        for name in ("settled", "cycles", "period"):
            arrays[name] = np.zeros(self.shape, dtype=np.int32)
        arrays["end_state"] = np.full((*self.shape, sizes["contact"]), -1, dtype=np.int8)
        arrays["reason"] = np.full(self.shape, "", dtype=object)
        for v, model_ in enumerate(self.models):
            if isinstance(model_, str):
                arrays["reason"][v] = model_
        return arrays

    def record(
        self, arrays: Mapping[str, np.ndarray], jumps: Sequence[tuple[int, int, float, float]], attrs: Mapping[str, Any]
    ) -> Dataset:
        """The result file."""
        model = next((item for item in self.models if isinstance(item, Model)), self.scene.model())
        sizes = tuple(values.size for values in self.axes.values())
        dims = (*self.axes, "direction", "frequency")
        variables: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
        for name, array in arrays.items():
            kept = array.astype(str) if name == "reason" else array
            whole = kept.reshape(*sizes, *array.shape[1:])
            variables[STORED.get(name, name)] = ((*dims, *TAILS.get(name, ())), whole)
        variables["final_phase_deg"] = ((), np.array(np.rad2deg(model.start.phase) % 360))
        for end, place in (("low", 2), ("high", 3)):
            variables[f"jump_{end}"] = (
                (*dims[:-1], "jump"),
                self._jump_rows(jumps, place).reshape(*sizes, self.shape[1], -1),
            )
        coords = self.axes | {"direction": np.array(self.plan.directions), "frequency": self.frequency}
        return dataset(variables, coords | coordinates(variables, model), attrs)

    def _jump_rows(self, jumps: Sequence[tuple[int, int, float, float]], place: int) -> np.ndarray:
        """One end of the jumps of each chain, shape (sets, directions, jumps), NaN where a chain has fewer."""
        rows: dict[tuple[int, int], list[float]] = {}
        for jump in sorted(jumps, key=lambda item: item[2]):
            rows.setdefault((jump[0], jump[1]), []).append(float(jump[place]))
        table = np.full((*self.shape[:2], max(map(len, rows.values()), default=0)), np.nan)
        for (v, d), values in rows.items():
            table[v, d, : len(values)] = values
        return table


def _sizes(model: Model | None) -> dict[str, int]:
    points, modes = (len(model.structure.points), model.structure.num_modes) if model else (0, 0)
    contacts = model.num_contacts if model else 0
    return {"point": points, "axis": 3, "band": 2, "contact": contacts, "mode": modes, "tangent": 2}


def _variant(scene: Scene, values: Mapping[str, float]) -> Model | str:
    """The model with other scalars, or what is wrong with it."""
    try:
        return scene.variant(values)
    except SceneError as error:
        return str(error)


def _parts(items: list[Any], size: int) -> Iterator[list[Any]]:
    for first in range(0, len(items), size):
        yield items[first : first + size]
