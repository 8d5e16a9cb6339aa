"""Harmonic balance: what does a response curve cost, and how does that grow with harmonics, contacts and modes?

A chain of masses under friction contacts, followed through its first resonance around which every contact slips and
some separate. Times are CPU seconds after compilation, the least of the repeats; the Floquet multipliers are timed
apart. Run it pinned to one core: ``taskset -c 0 python benchmarks/harmonic_balance.py``.
"""

import argparse
import os
import time
from dataclasses import replace

import numpy as np

from timesim.continuation import Controls, follow
from timesim.hbm import Balance, Setting
from timesim.hbm_curve import default_controls, described, hbm_curve
from timesim.model import GROUND, Contact, Excitation, Model, Start, Structure

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


def seconds(model: Model, setting: Setting, controls: Controls, repeats: int) -> tuple[int, float, float, float]:
    """Points, and CPU seconds of the curve, of the whole result, and of the result with multipliers."""
    balance = Balance(model, RANGE[0], setting)
    guess = hbm_curve(model, *RANGE, setting=setting, controls=replace(controls, max_points=2), stability=False)
    first = guess.contact_motion[0].ravel() / balance.length
    described(balance, follow(balance, first, *RANGE, replace(controls, max_points=3)))
    best = np.full(3, np.inf)
    for _ in range(repeats):
        t0 = time.process_time()
        curve = follow(balance, first, *RANGE, controls)
        t1 = time.process_time()
        done = described(balance, curve, stability=False)
        t2 = time.process_time()
        described(balance, curve, stability=True)
        t3 = time.process_time()
        best = np.minimum(best, [t1 - t0, t2 - t0, t3 - t1 + t1 - t0])
    if not done.complete:
        raise RuntimeError(done.message)
    slip, apart = done.slip_share.max(), done.separation_share.max()
    print(
        f"  at most {slip:.2f} of a period in slip, {apart:.2f} apart; {done.closure.max():.1e} of the closure allowed"
    )
    return curve.p.size, *best


def row(name: str, model: Model, setting: Setting, controls: Controls, repeats: int) -> None:
    """Print one line of the table."""
    points, curve, whole, floquet = seconds(model, setting, controls, repeats)
    print(f"| {name} | {points} | {curve:.2f} | {whole:.2f} | {floquet:.2f} | {1e3 * curve / points:.2f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="the first line alone")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, numpy {np.__version__}\n")
    print(
        "| case | points | curve [s] | and amplitudes, shares | and multipliers | ms a point |\n"
        "|---|---|---|---|---|---|"
    )
    fine = replace(default_controls(), first_step=0.005, max_step=0.022)
    row("3 modes, 3 contacts, H = 7, N = 1024", chain(3, 3), Setting(7, 1024), fine, options.repeats)
    if options.quick:
        return
    usual = default_controls()
    for harmonics in (1, 3, 5, 9, 15, 21):
        row(f"50 modes, 5 contacts, H = {harmonics}", chain(50, 5), Setting(harmonics, 1024), usual, options.repeats)
    for num_contacts in (1, 2, 3, 8):
        row(
            f"50 modes, {num_contacts} contacts, H = 9",
            chain(50, num_contacts),
            Setting(9, 1024),
            usual,
            options.repeats,
        )
    for num_modes in (3, 12, 50):
        row(f"{num_modes} modes, 1 contact, H = 9", chain(num_modes, 1), Setting(9, 1024), usual, options.repeats)


if __name__ == "__main__":
    main()
