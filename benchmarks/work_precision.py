"""What does an error cost, by our methods and by what others do: error against time a cycle on fourteen scenes.

    python benchmarks/work_precision.py --picture configs/pictures/work_precision.png
    python benchmarks/work_precision.py --quick --rest --scene n0 1000    # and methods that `auto` never takes

Each scene runs from its start for some cycles. The error is that of the last state, displacement and velocity each by
its own largest entry, against dopri8 at rtol 1e-13; `known to` is how far the same is from Tsit5 written apart from it
in numba, at rtol 1e-12. Times are CPU seconds of a process that keeps to one core: the median of runs taken in turn,
after a first one, in which compilation falls (said apart). Nothing is recorded.

Opponents, in `opponents`: scipy with terminal events (`scipy_events.py`); scipy as most write it, with if and else
(`scipy_plain.py`); CVODE with roots, compiled right-hand side (`cvode.py`, where scikit-sundae is installed); by hand
in numba RK4 with Newton on every transition, the paper's scheme (`numba_rk4.py`), Tsit5 with located transitions
(`tsit5.py`), return mapping without any, and a viscous law (`capture.py`).
"""

import timesim.runtime  # noqa: F401  isort: skip

import argparse
import importlib.util
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from event_loop import Problem, marched
from opponents import capture, numba_rk4, scipy_events, scipy_plain, tsit5
from problems import MANY_CONTACTS_FREQUENCY, Run, many_contacts, many_modes, oscillator

from timesim.engine.exponential.linear import LinearMotion, reached
from timesim.engine.status import Status
from timesim.engine.system import system_of
from timesim.engine.trajectory import Frame
from timesim.model.contact_state import start_states
from timesim.model.cost import stable_steps
from timesim.model.model import Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import Solver
from timesim.study.registry import load_scene

ROOT = Path(__file__).parents[1]
LEVELS = tuple(10.0**-k for k in range(2, 10))
FINEST = Solver("dopri8", 1e-13, 1e-15)
LANES = 64
SIDE_BY_SIDE = f", {LANES} side by side"
FEW_MODES = 4
"""Most modes of structures of which lanes are run side by side; of larger ones a core takes them in turn."""


class Entry(NamedTuple):
    """A way to compute a problem; `share` is the part of its time that counts as that of one trajectory."""

    family: str
    setting: str
    run: Callable[[], Run]
    share: float = 1.0


class Row(NamedTuple):
    family: str
    setting: str
    error: float
    transitions: int
    seconds: float  # CPU, a cycle
    first: float  # CPU of the first run


OURS = "timesim"
CVODE_MISSING = "scikit-sundae is not installed: nothing of CVODE (pip install scikit-sundae)"


def grazing() -> Model:
    """The oscillator in free steady motion at 1.39 Hz, with a stop that it passes by 1e-3 of its amplitude."""
    frequency, free = 1.39, oscillator(-1.0)
    s, omega = free.structure, 2 * np.pi * 1.39
    response = 1 / (s.stiffness - s.mass * omega**2 + 1j * omega * s.damping)
    start = replace(free.start, displacement=response.real, velocity=(1j * omega * response).real)
    reach = abs(free.contact_shape[0, 2] @ response)
    pad = replace(free.contacts[0], preload=-free.contacts[0].normal_stiffness * reach * (1 - 1e-3))
    return replace(free, contacts=(pad,), start=start, excitation=replace(free.excitation, frequency=frequency))


def with_pad(preload: float, **changes: Any) -> Model:
    """The oscillator with another pad."""
    model = oscillator(preload)
    return replace(model, contacts=(replace(model.contacts[0], **changes),))


def scene(path: str, changes: dict[str, Any] | None = None) -> Model:
    return load_scene(ROOT / path, changes or {}).model()


def problems() -> list[Problem]:
    study = {"kind": "transient", "cycles": 20}
    pair = scene("configs/two_contacts.yaml", {"excitation.frequency": 1.2, "study": study})
    stiff = {"tangential_stiffness": 2e4 * np.eye(2), "normal_stiffness": 2e4}
    very_stiff = {"tangential_stiffness": 2e5 * np.eye(2), "normal_stiffness": 2e5}
    return [
        Problem("oscillator, stick and slip (n0 = 3)", oscillator(3.0), 1.39, 60),
        Problem("oscillator, separating (n0 = -1)", oscillator(-1.0), 0.97, 60),
        Problem("oscillator with a gap (n0 = -4)", oscillator(-4.0), 0.947, 60),
        Problem("grazing: passes a stop by 1e-3", grazing(), 1.39, 60),
        Problem("contact 1000 times as stiff (n0 = 0)", with_pad(0.0, **stiff), 1.39, 20),
        Problem("full stick (n0 = 40)", oscillator(40.0), 1.5, 60),
        Problem("full separation (n0 = -40), 600 cycles", oscillator(-40.0), 1.5, 600),
        Problem("stuck contact 10,000 times as stiff", with_pad(40.0, **very_stiff), 1.39, 60),
        Problem("constant normal load", with_pad(1.0, normal_stiffness=0.0), 1.39, 60),
        Problem("point to point, with a damper", pair, 1.2, 40),
        Problem("blade: 12 modes, 2 contacts", scene("configs/blade.yaml"), 720.0, 20),
        Problem("20 modes, 3 contacts", scene("tests/data/many_modes.yaml"), 1.0, 20),
        Problem("10 modes, 5 contacts, full K_u", many_contacts(), MANY_CONTACTS_FREQUENCY, 20),
        Problem("50 modes, 10 contacts", many_modes(50, 10), 1.0, 10),
    ]


def ladder(first: float, last: float, each: int = 1) -> list[float]:
    """Tolerances as exponents of ten, `each` to a decade."""
    return [float(10.0**-k) for k in np.arange(first, last + 1e-9, 1 / each)]


def leaping(problem: Problem) -> Callable[[], Run] | None:
    """The end of a run in closed form; None where a contact is left in it."""
    model, cycles = problem.model, problem.cycles
    reduction = reduction_of(model, [problem.frequency])
    if reduction.live.size:
        return None
    frame, system = Frame(model, reduction, problem.frequency), system_of(model, problem.frequency, 0.0, reduction)
    motion, (start, state) = LinearMotion(system), frame.point(replace(model.start, state=start_states(model)))

    def run() -> Run:
        end = motion.after(motion.state(start.q, start.p, 0.0), 2 * np.pi * cycles)
        now = reached(motion, end, (cycles, 0.0), start, Status.RUNNING)
        own = frame.start(now.point, state, 0.0)
        return Run(own.displacement, own.velocity, own.slip, own.state, 0, [])

    return run


REST = ("dopri5", "rk4", "kvaerno5")
"""Methods that a scene may name and `method: auto` never takes."""


def rest_entries(problem: Problem) -> list[Entry]:
    def entry(name: str, setting: str, solver: Solver) -> Entry:
        return Entry(f"{OURS} {name}", setting, marched(problem, 1, solver))

    steps = [n for n in (50, 100, 200, 400, 800, 1600, 3200) if n > stable_steps(problem.model, problem.frequency)]
    return [
        *(entry("dopri5", f"rtol {rtol:.1e}", Solver("dopri5", rtol, 1e-2 * rtol)) for rtol in ladder(2, 10)),
        *(entry("rk4", f"{n} steps a cycle", Solver("rk4", 1e-8, 1e-10, longest=2 * np.pi / n)) for n in steps),
        *(entry("kvaerno5", f"rtol {rtol:.1e}", Solver("kvaerno5", rtol, 1e-2 * rtol)) for rtol in (1e-4, 1e-6, 1e-8)),
    ]


def our_entries(problem: Problem, quick: bool) -> list[Entry]:
    each = 1 if quick else 2
    methods = {"tsit5": ladder(2, 11, each), "dopri8": ladder(2, 11, each), "exponential": ladder(1, 9, each)}
    found = [
        Entry(f"{OURS} {name}", f"rtol {rtol:.1e}", marched(problem, 1, Solver(name, rtol, 1e-2 * rtol)))
        for name, tolerances in methods.items()
        for rtol in tolerances
    ]
    if leap := leaping(problem):
        found.append(Entry(f"{OURS} closed form", "", leap))
    if problem.model.structure.num_modes <= FEW_MODES and not quick:
        found += [
            Entry(
                f"{OURS} {name}{SIDE_BY_SIDE}",
                f"rtol {rtol:.1e}",
                marched(problem, LANES, Solver(name, rtol, 1e-2 * rtol)),
                1 / LANES,
            )
            for name in ("tsit5", "dopri8")
            for rtol in ladder(3, 9, 0.5)
        ]
    return found


def numba_entries(problem: Problem, quick: bool) -> list[Entry]:
    what, found = problem[1:], []
    small = numba_rk4.scene(problem.model, 4)

    def adaptive(rtol: float) -> Callable[[], Run]:
        return lambda: tsit5.simulate(*what, rtol=rtol, constants=small)

    def fixed(solve: Callable[..., Run], steps: int) -> Callable[[], Run]:
        constants = numba_rk4.scene(problem.model, steps)
        return lambda: solve(*what, steps_per_cycle=steps, constants=constants)

    found += [Entry("numba Tsit5", f"rtol {r:.1e}", adaptive(r)) for r in ladder(2, 11, 1 if quick else 2)]
    # The fixed steps of an explicit scheme have to resolve the fastest mode.
    fewest = 1.2 * problem.model.stuck_rate / problem.frequency / (2 * np.pi)
    for name, solve, smallest, most in (
        ("numba RK4, Newton", numba_rk4.simulate, 25, 3200),
        ("numba return mapping", capture.capture, 50, 3200),
        ("numba regularised", capture.regularised, 50, 3200),
    ):
        counts = [n for n in (smallest * 2**k for k in range(0, 10, 2 if quick else 1)) if 2 * fewest <= n <= most]
        found += [Entry(name, f"{n} steps a cycle", fixed(solve, n)) for n in counts]
    return found


def python_entries(problem: Problem, quick: bool) -> list[Entry]:
    what, large = problem[1:], problem.model.structure.num_modes > 12

    def events(method: str, rtol: float, least: float) -> Callable[[], Run]:
        return lambda: scipy_events.simulate(*what, method=method, rtol=rtol, steps_per_cycle=least)

    def plain(rtol: float, least: float) -> Callable[[], Run]:
        return lambda: scipy_plain.simulate(*what, method="RK45", rtol=rtol, steps_per_cycle=least)

    with_events = (
        [("RK45", 1e-6, 0)] if quick or large else [("RK45", 1e-4, 20), ("RK45", 1e-6, 0), ("DOP853", 1e-8, 20)]
    )
    written = [] if quick or large else [(1e-3, 50), (1e-6, 100)]
    found = [Entry("scipy, events", f"{m}, rtol {r:g}", events(m, r, n)) for m, r, n in with_events]
    return found + [Entry("scipy, if and else", f"rtol {r:g}, {n} steps", plain(r, n)) for r, n in written]


def cvode_entries(problem: Problem, quick: bool) -> list[Entry]:
    if importlib.util.find_spec("sksundae") is None:
        return []
    from opponents import cvode

    def run(rtol: float) -> Callable[[], Run]:
        return lambda: cvode.simulate(*problem[1:], rtol=rtol)

    return [Entry("CVODE, roots", f"rtol {rtol:g}", run(rtol)) for rtol in ladder(4, 10, 0.5)[:: 2 if quick else 1]]


def error(run: Run, truth: Run) -> float:
    """Of displacement and velocity, each by its own largest entry: in SI units the velocities would hide the rest."""
    parts = ((run.q, truth.q), (run.qdot, truth.qdot))
    return max(float(np.abs(mine - true).max() / np.abs(true).max()) for mine, true in parts)


def timed(run: Callable[[], Run]) -> tuple[Run | None, float]:
    """The end of a run, none where it fails, and its CPU seconds."""
    clock = time.process_time()
    try:
        end = run()
    except (RuntimeError, AssertionError, ValueError):
        return None, np.nan
    return end, time.process_time() - clock


def measure(problem: Problem, entries: list[Entry], repeats: int, budget: float) -> tuple[list[Row], float]:
    """A row an entry, and how well the truth is known."""
    truth = marched(problem, 1, FINEST)()
    known = error(tsit5.simulate(*problem[1:], rtol=1e-12), truth)
    ends = [timed(entry.run) for entry in entries]
    # What compiles nothing need not run twice where that takes long.
    taken = [
        [first] if entry.family.startswith("scipy") else [] for entry, (_, first) in zip(entries, ends, strict=True)
    ]
    for _ in range(repeats):
        for entry, (end, _), times in zip(entries, ends, taken, strict=True):
            if end is not None and sum(times) < budget:
                times.append(timed(entry.run)[1])
    rows = []
    for entry, (end, first), times in zip(entries, ends, taken, strict=True):
        if end is not None and np.all(np.isfinite(end.q)):
            seconds = statistics.median(times) * entry.share / problem.cycles
            rows.append(Row(entry.family, entry.setting, error(end, truth), end.num_events, seconds, first))
    return rows, known


def fastest(rows: list[Row], level: float) -> Row | None:
    """The cheapest run that errs by no more than a level."""
    good = [row for row in rows if row.error <= level]
    return min(good, key=lambda row: row.seconds, default=None)


def single(row: Row) -> bool:
    """One trajectory of ours, by a method that `auto` may take."""
    return row.family.startswith(OURS) and SIDE_BY_SIDE not in row.family and not rest(row)


def rest(row: Row) -> bool:
    return row.family.removeprefix(f"{OURS} ") in REST


SHORT = {
    "timesim tsit5": "tsit5",
    "timesim dopri8": "dopri8",
    "timesim exponential": "exponential",
    "timesim closed form": "closed form",
    **{f"timesim {name}": name for name in REST},
    "numba Tsit5": "Tsit5",
    "numba RK4, Newton": "RK4",
    "numba return mapping": "mapping",
    "numba regularised": "viscous",
    "CVODE, roots": "CVODE",
    "scipy, events": "scipy",
    "scipy, if and else": "scipy if",
}


def heading() -> str:
    levels = [f"{level:.0e}" for level in LEVELS]
    return "\n".join(["| scene | who | " + " | ".join(levels) + " |", "|---" * (len(LEVELS) + 2) + "|"])


def summary(problem: Problem, rows: list[Row], known: float) -> str:
    """The fastest at each error: one trajectory of ours, many side by side, and the opponents."""
    parts = {
        "ours": [row for row in rows if single(row)],
        SIDE_BY_SIDE.strip(", "): [row for row in rows if SIDE_BY_SIDE in row.family],
        **{name: [row for row in rows if row.family == f"{OURS} {name}"] for name in REST},
        "others": [row for row in rows if not row.family.startswith(OURS)],
    }
    lines = []
    for who, part in parts.items():
        best = [fastest(part, level) if level > 3 * known else None for level in LEVELS]
        cells = [f"{1e6 * row.seconds:.3g} {SHORT[row.family.split(SIDE_BY_SIDE)[0]]}" if row else "" for row in best]
        if part:
            lines.append(f"| {'' if lines else problem.name} | {who} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def listing(problem: Problem, rows: list[Row], known: float) -> str:
    """Every run."""
    lines = [
        f"\n#### {problem.name}: {problem.cycles} cycles, known to {known:.0e}\n",
        "| who | setting | error | transitions | µs a cycle | first run, s |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.family} | {r.setting} | {r.error:.1e} | {r.transitions} | {1e6 * r.seconds:.4g} | {r.first:.2f} |"
        for r in rows
    ]
    return "\n".join([*lines, ""])


LOOKS: dict[str, dict[str, Any]] = {
    "timesim tsit5": {"color": "#0072B2", "marker": "o"},
    "timesim dopri8": {"color": "#D55E00", "marker": "s"},
    "timesim exponential": {"color": "#009E73", "marker": "D"},
    "timesim closed form": {"color": "#000000", "marker": "P"},
    f"timesim tsit5{SIDE_BY_SIDE}": {"color": "#0072B2", "marker": "o", "fillstyle": "none", "linestyle": ":"},
    f"timesim dopri8{SIDE_BY_SIDE}": {"color": "#D55E00", "marker": "s", "fillstyle": "none", "linestyle": ":"},
    "numba Tsit5": {"color": "0.35", "marker": "x"},
    "numba RK4, Newton": {"color": "0.35", "marker": "+", "linestyle": "--"},
    "numba return mapping": {"color": "0.6", "marker": "1"},
    "numba regularised": {"color": "0.6", "marker": "2", "linestyle": "--"},
    "CVODE, roots": {"color": "0.6", "marker": "*"},
    "scipy, events": {"color": "0.6", "marker": "<", "fillstyle": "none"},
    "scipy, if and else": {"color": "0.6", "marker": ">", "fillstyle": "none", "linestyle": "--"},
}


LEAST = 1e-12
"""Error at the lower rim of a panel, where smaller ones are drawn."""


def draw(found: dict[str, tuple[list[Row], float]], path: Path) -> None:
    """Error against time, a panel a scene; the front of one trajectory of ours thick behind it."""
    from timesim.picture.figure import figure

    columns = min(4, len(found))
    tall = -(-len(found) // columns)
    fig, grid = figure(tall, columns, width=3.3 * columns + 0.8, height=2.4, gap=0.55, sharey=True)
    for ax, (name, (rows, known)) in zip(grid.flat, found.items(), strict=False):
        for family, look in LOOKS.items():
            own = [row for row in rows if row.family == family and row.error < 2]
            line = {"linewidth": 0.9, "markersize": 3.5, "linestyle": "-"} | look
            errors = [max(r.error, 1.3 * LEAST) for r in own]
            ax.plot([1e6 * r.seconds for r in own], errors, label=family, **line)
        front, best = [], np.inf
        for row in sorted((r for r in rows if single(r)), key=lambda row: row.seconds):
            if row.error < best:
                front.append(row)
                best = row.error
        ax.plot(
            [1e6 * r.seconds for r in front],
            [max(r.error, 1.3 * LEAST) for r in front],
            color="#F0E442",
            linewidth=6,
            alpha=0.6,
            zorder=0,
        )
        ax.axhspan(0.1 * LEAST, known, color="0.9", linewidth=0)
        ax.set(xscale="log", yscale="log", ylim=(LEAST, 2))
        ax.set_title(name, fontsize=9)
    for ax in grid[:, 0]:
        ax.set_ylabel("relative error", fontsize=8)
    for ax in grid.flat[len(found) - columns : len(found)]:
        ax.set_xlabel("µs of CPU a cycle", fontsize=8)
    for ax in grid.flat[len(found) :]:
        ax.set_visible(False)
    fig.suptitle("Error of the last state against time; thick: the front of one trajectory of ours", fontsize=11)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="lower center", ncol=7, fontsize=8, frameon=False)
    fig.savefig(path, dpi=75)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--budget", type=float, default=0.15, help="CPU seconds of timed runs of an entry")
    parser.add_argument("--quick", action="store_true", help="fewer tolerances, fewer opponents")
    parser.add_argument("--rest", action="store_true", help=f"also {', '.join(REST)}, one program for each tolerance")
    parser.add_argument("--rows", action="store_true", help="print every run")
    parser.add_argument("--scene", nargs="+", help="parts of the names of those to run")
    parser.add_argument("--picture", type=Path, help="draw error against time into this file")
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    print(f"one of {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    if importlib.util.find_spec("sksundae") is None:
        print(CVODE_MISSING)
    found, lines = {}, []
    for problem in problems():
        if options.scene and not any(part in problem.name for part in options.scene):
            continue
        entries = our_entries(problem, options.quick) + numba_entries(problem, options.quick)
        entries += rest_entries(problem) if options.rest else []
        entries += cvode_entries(problem, options.quick) + python_entries(problem, options.quick)
        begun = time.process_time()
        rows, known = measure(problem, entries, options.repeats, options.budget)
        found[problem.name] = rows, known
        spent = time.process_time() - begun
        print(listing(problem, rows, known) if options.rows else f"{problem.name}: {spent:.0f} s of CPU", flush=True)
        lines.append(summary(problem, rows, known))
    print("\n".join(["", heading(), *lines]))
    if options.picture:
        draw(found, options.picture)


if __name__ == "__main__":
    main()
