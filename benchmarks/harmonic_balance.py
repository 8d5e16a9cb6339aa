"""Harmonic balance: what does a response curve cost, how does that grow, and what do others pay and find?

A chain of masses under friction contacts, followed through its first resonance around which every contact slips and
some separate. Times are CPU seconds after compilation, the least of the repeats; the Floquet multipliers are timed
apart. Run it pinned to one core: ``taskset -c 0 python benchmarks/harmonic_balance.py``.

``--quick``: the first line alone. ``--picture FILE``: the growth with harmonics, contacts and modes drawn as well.
``--peaks``: instead, the peaks of the paper's nine preloads by harmonic balance and by time integration.
``--estimates``: instead, what `timesim check` estimates of a solution, beside what it takes.
``--folds``: instead, where its curves turn for 1 to 15 harmonics.
``--pyharm PYTHON``: instead, a curve of the paper's oscillator by pyHarm beside ours; PYTHON has it installed.
"""

import argparse
import json
import os
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.interpolate import CubicSpline

from timesim.hbm.balance import Balance
from timesim.hbm.branches import solutions_at
from timesim.hbm.continuation import Controls, follow
from timesim.hbm.curve import evaluated, hbm_curve
from timesim.hbm.scheme import Scheme, enough_samples
from timesim.model.cost import seconds_a_solution
from timesim.model.model import GROUND, Contact, Excitation, Model, Start, Structure
from timesim.model.solver import PRESETS, Criterion
from timesim.orbit.settling import Chain, steady_states
from timesim.study.registry import load_scene
from timesim.study.summary.curve import peak

RANGE = (0.75, 1.3)


def chain(num_modes: int, num_contacts: int) -> Model:
    """Modes from 1 Hz upwards, 2 % damped, and contacts at points of their own; every contact moves in three axes."""
    rng = np.random.default_rng(num_contacts)
    frequency = 1.0 + 0.45 * np.arange(num_modes)
    points = tuple(f"p{i}" for i in range(num_contacts))
    shape = rng.uniform(-1, 1, (num_contacts, 3, 50))[:, :, :num_modes]
    shape[:, :, 0] = [1.0, 0.4, 0.5]
    body = Structure(frequency, np.ones(num_modes), 0.04 * 2 * np.pi * frequency, points, shape)
    contacts = tuple(
        Contact(
            f"c{i}", p, GROUND, np.eye(3), 0.4, 6.0 * np.eye(2) / num_contacts, 6.0 / num_contacts, 0.5 / num_contacts
        )
        for i, p in enumerate(points)
    )
    force = np.zeros((1, num_modes))
    force[0, : min(3, num_modes)] = [1.0, 0.5, 0.3][: min(3, num_modes)]
    load = Excitation(None, np.array([1]), force, np.zeros_like(force), np.zeros(num_modes))
    rest = Start(np.zeros(num_modes), np.zeros(num_modes), np.zeros((num_contacts, 2)), np.full(num_contacts, -1))
    return Model(body, contacts, load, rest)


def by_default(harmonics: int) -> Scheme:
    """The number of samples that a scene has where it gives none."""
    return Scheme(harmonics, enough_samples(harmonics))


def seconds(model: Model, scheme: Scheme, controls: Controls, repeats: int) -> tuple[int, float, float, float]:
    """Points, and CPU seconds of the curve, of the whole result, and of the result with multipliers."""
    balance = Balance(model, RANGE[0], scheme)
    guess = hbm_curve(model, *RANGE, scheme=scheme, controls=replace(controls, max_points=2), stability=False)
    first = guess.contact_motion[0].ravel() / balance.length
    evaluated(balance, follow(balance, first, *RANGE, replace(controls, max_points=3)))
    best = np.full(3, np.inf)
    for _ in range(repeats):
        t0 = time.process_time()
        curve = follow(balance, first, *RANGE, controls)
        t1 = time.process_time()
        done = evaluated(balance, curve, stability=False)
        t2 = time.process_time()
        evaluated(balance, curve, stability=True)
        t3 = time.process_time()
        best = np.minimum(best, [t1 - t0, t2 - t0, t3 - t1 + t1 - t0])
    if not done.complete:
        raise RuntimeError(done.message)
    slip, apart = done.slip_share.max(), done.separation_share.max()
    print(
        f"  at most {slip:.2f} of a period in slip, {apart:.2f} apart; {done.closure.max():.1e} of the closure allowed"
    )
    return curve.p.size, *best


Row = tuple[int, float, float, float]


def row(name: str, model: Model, scheme: Scheme, controls: Controls, repeats: int) -> Row:
    """Print one line of the table."""
    points, curve, whole, floquet = seconds(model, scheme, controls, repeats)
    print(f"| {name} | {points} | {curve:.2f} | {whole:.2f} | {floquet:.2f} | {1e3 * curve / points:.2f} |", flush=True)
    return points, curve, whole, floquet


def growth(repeats: int) -> dict[str, list[tuple[int, float]]]:
    """Milliseconds a point with multipliers against harmonics, contacts and modes."""
    found: dict[str, list[tuple[int, float]]] = {"harmonics": [], "contacts": [], "modes": []}

    def add(kind: str, number: int, name: str, model: Model, scheme: Scheme) -> None:
        points, _, _, floquet = row(name, model, scheme, Controls(), repeats)
        found[kind].append((number, 1e3 * floquet / points))

    for harmonics in (1, 3, 5, 9, 15, 21):
        add("harmonics", harmonics, f"50 modes, 5 contacts, H = {harmonics}", chain(50, 5), by_default(harmonics))
    for count in (1, 2, 3, 8):
        add("contacts", count, f"50 modes, {count} contacts, H = 9", chain(50, count), by_default(9))
    for count in (3, 12, 50):
        add("modes", count, f"{count} modes, 1 contact, H = 9", chain(count, 1), by_default(9))
    return found


def estimates(repeats: int) -> None:
    """CPU of a solution against `seconds_a_solution`, for structures of few and many modes and contacts."""
    print("| modes | contacts | ms a solution, estimated | with multipliers, estimated |\n|---|---|---|---|")
    scheme = by_default(9)
    for modes, contacts in ((3, 1), (50, 1), (12, 6), (18, 7), (24, 12), (50, 8)):
        model = chain(modes, contacts)
        points, _, *taken = seconds(model, scheme, Controls(), repeats)
        cells = []
        for own, stability in zip(taken, (False, True), strict=True):
            estimate = seconds_a_solution(model, scheme.harmonics, scheme.time_samples, stability=stability)
            cells.append(f"{1e3 * own / points:.3g}, {1e3 * estimate:.3g}")
        print(f"| {modes} | {contacts} | {' | '.join(cells)} |", flush=True)


def draw(found: dict[str, list[tuple[int, float]]], path: Path) -> None:
    """The growth as a picture."""
    from timesim.picture.figure import figure
    from timesim.picture.style import SERIES

    made, grid = figure(1, 3, width=9.5, height=2.6, sharey=True)
    told = {"harmonics": "50 modes, 5 contacts", "contacts": "50 modes, 9 harmonics", "modes": "1 contact, 9 harmonics"}
    for ax, (kind, points), style in zip(grid[0], found.items(), SERIES, strict=False):
        number, cost = zip(*points, strict=True)
        ax.loglog(number, cost, marker=style.marker, color=style.colour, linestyle=style.line)
        ax.set_xticks(number, [str(n) for n in number], minor=False)
        ax.minorticks_off()
        ax.set(xlabel=f"{kind} ({told[kind]})")
    grid[0, 0].set_ylabel("ms a point")
    costs = [cost for points in found.values() for _, cost in points]
    ticks = [tick for tick in (2, 5, 10, 20, 50, 100, 200) if min(costs) / 3 < tick < 3 * max(costs)]
    grid[0, 0].set_yticks(ticks, [str(tick) for tick in ticks])
    grid[0, 0].set_ylim(0.8 * min(costs), 1.25 * max(costs))
    made.suptitle("a point of a response curve by harmonic balance, Floquet multipliers included", fontsize=10)
    made.savefig(path, dpi=110)


PRELOADS = (-4, -1, 0, 1, 2, 3, 5, 10, 32)


def oscillator(preload: float) -> Model:
    """The paper's, from its scene."""
    scene = Path(__file__).parents[1] / "configs" / "figure10.yaml"
    return load_scene(scene).variant({"contacts.pad.preload": preload})


def settled(model: Model, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Amplitude of tip x by time integration, and the largest share in slip or separation."""
    chains = [Chain(model, (float(f),)) for f in frequency]
    orbits = [orbit for (orbit,) in steady_states(chains, PRESETS["standard"], Criterion())]
    shares = [max(orbit.slip_share.max(), orbit.separation_share.max() % 1) for orbit in orbits]
    return np.array([orbit.amplitude[0, 0] for orbit in orbits]), np.array(shares)


def top(frequency: np.ndarray, amplitude: np.ndarray) -> tuple[float, float]:
    """Place and height of the largest amplitude, by a polynomial of fourth degree."""
    middle = frequency.mean()
    fit = np.polynomial.Polynomial.fit(frequency - middle, amplitude, 4)
    fine = np.linspace(frequency[0], frequency[-1], 20001)
    values = fit(fine - middle)
    return float(fine[np.argmax(values)]), float(values.max())


def peaks() -> None:
    """Largest amplitude of tip x from 0.8 to 1.65 Hz with 15 harmonics, and settled, both from 9 points about it."""
    print("| n0 | harmonic balance | at [Hz] | time integration | at [Hz] | difference | share in slip or separation |")
    print("|---|---|---|---|---|---|---|")
    scheme = by_default(15)
    for preload in PRELOADS:
        model = oscillator(preload)
        curve = hbm_curve(model, 1.65, 0.8, scheme=scheme, stability=False)
        frequency = peak(curve.frequency, curve.amplitude[:, 0, 0], curve.contact_motion)[0] + 1e-3 * np.arange(-4, 5)
        found = solutions_at(model, curve, frequency, scheme=scheme, stability=False)
        balanced = np.array([found.amplitude[found.frequency == f, 0, 0].max() for f in frequency])
        marched, share = settled(model, frequency)
        (here, height), (there, truth) = top(frequency, balanced), top(frequency, marched)
        line = f"| {preload} | {height:.6f} | {here:.5f} | {truth:.6f} | {there:.5f} | {height / truth - 1:+.1e} |"
        print(f"{line} {share.max():.2f} |", flush=True)


def folds() -> None:
    """Folds of the oscillator at n0 = -4 and 2 for growing numbers of harmonics, beside where the sweeps jump."""
    print("| harmonics | n0 = -4, low [Hz] | high [Hz] | n0 = 2, low [Hz] | high [Hz] |")
    print("|---|---|---|---|---|")
    for harmonics in (1, 3, 9, 15):
        cells = []
        for preload, span in ((-4.0, (1.0, 0.92)), (2.0, (1.32, 1.2))):
            curve = hbm_curve(oscillator(preload), *span, scheme=by_default(harmonics), stability=False)
            turning = np.sort(curve.frequency[curve.fold])
            cells += [f"{place:.6f}" for place in turning] if turning.size == 2 else [f"{turning.size} folds", ""]
        print(f"| {harmonics} | {' | '.join(cells)} |", flush=True)


def beside_pyharm(python: str) -> None:
    """A curve at n0 = 3, 9 harmonics, by both; errors against settled time integration. pyHarm has 512 samples."""
    preload, span, scheme, samples = 3.0, (0.8, 1.65), by_default(9), 512
    model, script = oscillator(preload), Path(__file__).parent / "opponents" / "balance_by_pyharm.py"
    at = np.round(np.arange(1.32, 1.65, 0.01), 10)
    exact, share = settled(model, at)
    print(
        f"n0 = {preload:g}, {at.size} frequencies from {at[0]:g} to {at[-1]:g} Hz, share of slip {share.min():.2f} up\n"
    )
    print("| who | setting | points | CPU s | largest error | at 1.39 Hz |")
    print("|---|---|---|---|---|---|")

    def line(who: str, told: str, frequency: np.ndarray, amplitude: np.ndarray, taken: float) -> None:
        off = CubicSpline(frequency, amplitude)(at) / exact - 1
        middle = off[np.argmin(np.abs(at - 1.39))]
        print(
            f"| {who} | {told} | {frequency.size} | {taken:.2f} | {np.abs(off).max():.1e} | {middle:+.1e} |", flush=True
        )

    for step in (1.0, 0.2, 0.05):
        call = [python, str(script.resolve()), "--step", str(step), "--harmonics", str(scheme.harmonics)]
        call += ["--samples", str(samples), "--preload", str(preload)]
        with TemporaryDirectory() as folder:  # it leaves a folder of its own where it runs
            done = subprocess.run(call, capture_output=True, text=True, check=True, cwd=folder)
        said = json.loads(done.stdout.splitlines()[-1])
        frequency, order = np.unique(said["frequency"], return_index=True)
        line("pyHarm", f"ds_max {step:g}", frequency, np.array(said["amplitude"])[order], said["seconds"])
    for step in (0.05, 0.02):
        controls = replace(Controls(), first_step=step / 5, max_step=step)
        hbm_curve(model, *span[::-1], scheme=scheme, controls=controls)
        t0 = time.process_time()
        curve = hbm_curve(model, *span[::-1], scheme=scheme, controls=controls)
        taken = time.process_time() - t0
        frequency, order = np.unique(curve.frequency, return_index=True)
        line("timesim", f"max_step {step:g}", frequency, curve.amplitude[order, 0, 0], taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="the first line alone")
    parser.add_argument("--picture", type=Path, help="draw the growth into this file")
    parser.add_argument("--estimates", action="store_true", help="time of a solution beside its estimate")
    parser.add_argument("--peaks", action="store_true", help="peaks of nine preloads by two methods")
    parser.add_argument("--folds", action="store_true", help="folds for 1, 3, 9 and 15 harmonics")
    parser.add_argument("--pyharm", metavar="PYTHON", help="a Python that has pyHarm-os installed")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, numpy {np.__version__}\n")
    if options.folds:
        return folds()
    if options.estimates:
        return estimates(options.repeats)
    if options.peaks:
        return peaks()
    if options.pyharm:
        return beside_pyharm(options.pyharm)
    print(
        "| case | points | curve [s] | and amplitudes, shares | and multipliers | ms a point |\n"
        "|---|---|---|---|---|---|"
    )
    fine = replace(Controls(), first_step=0.005, max_step=0.022)
    row("3 modes, 3 contacts, H = 7", chain(3, 3), by_default(7), fine, options.repeats)
    if not options.quick:
        found = growth(options.repeats)
        if options.picture:
            draw(found, options.picture)
    return None


if __name__ == "__main__":
    main()
