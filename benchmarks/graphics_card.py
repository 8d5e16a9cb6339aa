"""Does a graphics card march many trajectories faster than all cores of a processor?

Run `python benchmarks/graphics_card.py` where JAX finds a card (`pip install "jax[cuda13]"`); with `--card cpu` the
processor stands in for one, to try this script. Trajectories of tsit5 (rtol 1e-7) begin at different phases of the
excitation, and nothing is recorded: on the processor a part of the batch on each core, as studies march them; on the
card all of them side by side. Microseconds a cycle and trajectory, the median of some runs after a first one, which
compiles; the largest difference between the ends of the two, displacements and velocities, relative to the largest of
them; and how many trajectories met another number of transitions. `--command` times the loop of a command's transient
on either instead, from a folder of programs that are compiled.
"""

import timesim.runtime  # isort: skip

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import jax
import numpy as np
from problems import MANY_CONTACTS_FREQUENCY, many_contacts, many_modes, oscillator

from timesim.engine import event_loop
from timesim.engine.method import step_method
from timesim.engine.solver import step_control
from timesim.engine.status import Status
from timesim.engine.step import begin
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame, Phase, Run
from timesim.model.model import Model
from timesim.model.solver import Solver

SCENE = Path(__file__).parents[1] / "configs" / "oscillator.yaml"
SOLVER = Solver("tsit5", 1e-7, 1e-9)


class Problem(NamedTuple):
    model: Model
    frequency: float
    cycles: int
    lanes: tuple[int, ...]


PROBLEMS = {
    "2 modes, 1 contact": Problem(oscillator(3.0), 1.39, 10, (16, 256, 4096, 65536, 524288)),
    "10 modes, 5 contacts": Problem(many_contacts(), MANY_CONTACTS_FREQUENCY, 5, (256, 4096, 32768)),
    "50 modes, 10 contacts": Problem(many_modes(50, 10), 1.0, 2, (256, 4096)),
}


class Row(NamedTuple):
    first: float  # seconds of the first run, which compiles
    another: float  # seconds of one of the others


def trajectories(problem: Problem, lanes: int) -> tuple:
    """Method and control, and systems, starts and cycles of a batch, batch first."""
    model = problem.model
    run = Run(model, [Phase(problem.frequency, problem.cycles)], SOLVER)
    frame = Frame(model, run.reduction, problem.frequency)
    stiffest = model.stuck_rate / frame.scales.omega
    control = step_control(SOLVER, stiffest)
    system = system_of(model, problem.frequency, 0.0, run.reduction)
    start = frame.begin(system, run, SOLVER.first_step(stiffest), work=False)
    systems, points, states = jax.tree.map(
        lambda leaf: np.broadcast_to(leaf, (lanes, *np.shape(leaf))), (system, start.point, start.state)
    )
    systems = timesim.runtime.with_parts(systems, phase=2 * np.pi * np.arange(lanes) / lanes)
    starts = jax.jit(jax.vmap(begin, in_axes=(0, 0, 0, None)))(systems, points, states, control.opening)
    return step_method(SOLVER), control, systems, starts, np.full(lanes, problem.cycles)


def on_cores(method: object, control: object, *batch: object) -> Callable[[], list]:
    """March a part of a batch on each core."""
    cores = min(len(os.sched_getaffinity(0)), len(batch[-1]))  # type: ignore[arg-type]
    bounds = np.linspace(0, len(batch[-1]), cores + 1).astype(int)  # type: ignore[arg-type]
    parts = [jax.tree.map(itemgetter(slice(*pair)), batch) for pair in pairwise(bounds)]
    pool = ThreadPoolExecutor(cores)
    return lambda: list(pool.map(lambda part: jax.block_until_ready(event_loop.march(method, control, *part)), parts))


def on_card(method: object, control: object, *batch: object) -> Callable[[], list]:
    """March a batch side by side, however wide."""
    placed = jax.device_put(batch)

    def run() -> list:
        with (
            patch.object(event_loop, "one_by_one", lambda *_: False),
            patch.object(event_loop, "SIDE_BY_SIDE", len(batch[-1])),  # type: ignore[arg-type]
        ):
            return [jax.block_until_ready(event_loop.march(method, control, *placed))]

    return run


def measured(side: str, name: str, lanes: int, repeats: int) -> tuple[Row, np.ndarray, np.ndarray]:
    """Times on the platform of this process, the ends (lane, 2 M), and how many transitions each has met."""
    march = {"cores": on_cores, "card": on_card}[side](*trajectories(PROBLEMS[name], lanes))
    times = []
    for _ in range(repeats + 1):
        clock = time.perf_counter()
        found = march()
        times.append(time.perf_counter() - clock)
    end, count = jax.tree.map(lambda *parts: np.concatenate([np.asarray(part) for part in parts]), *found)
    assert np.all(end.status == Status.RUNNING)
    assert np.all(end.cycle == PROBLEMS[name].cycles)
    return Row(times[0], statistics.median(times[1:])), np.hstack([end.point.q, end.point.p]), count


def in_process(side: str, platform: str, name: str, lanes: int, repeats: int, folder: Path) -> tuple[Row, dict]:
    """`measured` in a process of its own, which has the platform."""
    path = folder / f"{side}.npz"
    asked = json.dumps([side, name, lanes, repeats, str(path)])
    command = [sys.executable, __file__, "--one", asked]
    environment = os.environ | {"JAX_PLATFORMS": platform, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    subprocess.run(command, check=True, env=environment)
    found = dict(np.load(path))
    return Row(*found.pop("row")), found


def compare(name: str, lanes: int, repeats: int, card: str, folder: Path) -> str:
    """A row of the table."""
    cores, ours = in_process("cores", "cpu", name, lanes, repeats, folder)
    wide, theirs = in_process("card", card, name, lanes, repeats, folder)
    each = [row.another / lanes / PROBLEMS[name].cycles * 1e6 for row in (cores, wide)]
    difference = np.abs(ours["end"] - theirs["end"]).max() / np.abs(ours["end"]).max()
    others = int((ours["count"] != theirs["count"]).sum())
    return (
        f"| {name} | {lanes} | {each[0]:.3g} | {each[1]:.3g} | {each[0] / each[1]:.2g} | {difference:.0e} | {others} |"
        f" {cores.first:.0f} | {wide.first:.0f} |"
    )


def command_time(platform: str, folder: Path) -> float:
    """Seconds of the loop of a transient as a command runs it, its programs compiled by a run before."""
    result = folder / platform
    command = [sys.executable, "-m", "timesim", "run", str(SCENE), "-o", str(result), "--force", "--no-plots"]
    for _ in range(2):
        subprocess.run(command, check=True, env=os.environ | {"JAX_PLATFORMS": platform}, stdout=subprocess.DEVNULL)
    from timesim.result.netcdf import open_result

    return float(open_result(result).attrs["run_seconds"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problem", nargs="+", choices=list(PROBLEMS), default=list(PROBLEMS))
    parser.add_argument("--most", type=int, default=2**30, help="lanes")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--card", default="cuda", help="platform of JAX")
    parser.add_argument("--command", action="store_true", help="only the transient of a command")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        *asked, path = json.loads(options.one)
        row, end, count = measured(*asked)
        np.savez(path, row=row, end=end, count=count)
        return
    with tempfile.TemporaryDirectory() as folder:
        print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, jax {jax.__version__}\n")
        if options.command:
            for platform in ("cpu", options.card):
                print(f"{platform}: {command_time(platform, Path(folder)):.3g} s", flush=True)
            return
        print("| structure | lanes | cores | card | ratio | difference | other counts | first [s] | first, card [s] |")
        print("|---|---|---|---|---|---|---|---|---|")
        for name in options.problem:
            for lanes in PROBLEMS[name].lanes:
                if lanes <= options.most:
                    print(compare(name, lanes, options.repeats, options.card, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
