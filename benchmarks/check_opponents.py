"""Are the opponents right? Both against reference states, the numba march against settled amplitudes.

Run `python benchmarks/check_opponents.py`. Exits with 1 if a row misses its bound.
"""

import json
import sys
from pathlib import Path

import numpy as np
from opponents import numba_rk4, scipy_events
from problems import MANY_CONTACTS_FREQUENCY, Run, error, many_contacts, oscillator

DATA = Path(__file__).parents[1] / "tests" / "data" / "oscillator.json"
CASES = {"osc_n0=3_f=1.39": (3.0, 1.39), "osc_n0=-1_f=0.97": (-1.0, 0.97), "osc_n0=5_f=1.52": (5.0, 1.52)}
SETTLED = {(3.0, 1.39): 0.15612878, (-1.0, 0.97): 0.28839155, (5.0, 1.52): 0.15680399}
BOUNDS = {50: 1e-4, 200: 1e-6, 800: 1e-8}


def row(who: str, what: str, found: float, bound: float, note: str) -> bool:
    good = found <= bound
    print(f"| {who} | {what} | {found:.1e} | {bound:.0e} | {note} | {'yes' if good else 'NO'} |", flush=True)
    return good


def end_and_events(run: Run, case: dict, what: str, who: str, bound: float) -> bool:
    state, truth = np.concatenate([run.q, run.qdot]), np.array(case["state_end"])
    off = float(np.abs(state - truth).max() / np.abs(truth).max())
    late = max(abs(mine[0] - theirs[0]) for mine, theirs in zip(run.events, case["events"], strict=False))
    same = run.num_events == case["n_events"] and run.state.tolist() == case["modes_end"]
    note = f"{run.num_events} of {case['n_events']} events, times to {late:.0e} s"
    return row(who, what, off, bound, note) and same


def reference_states() -> list[bool]:
    good = []
    for name, case in json.loads(DATA.read_text())["cases"].items():
        n0, frequency = CASES[name]
        model = oscillator(n0)
        run = scipy_events.simulate(model, frequency, case["cycles"], rtol=1e-12, lag=3e-5, log=True)
        good.append(end_and_events(run, case, name, "scipy DOP853 1e-12", 1e-9))
        for steps, bound in BOUNDS.items():
            run = numba_rk4.simulate(model, frequency, case["cycles"], steps_per_cycle=steps, num_log=case["n_events"])
            good.append(end_and_events(run, case, name, f"numba, {steps} steps", bound))
    return good


def settled_amplitudes() -> list[bool]:
    good = []
    for (n0, frequency), amplitude in SETTLED.items():
        for steps, bound in ((200, 1e-6), (800, 1e-7)):
            end = numba_rk4.march(oscillator(n0), frequency, tol=1e-9, steps_per_cycle=steps)
            off = abs(float(end.amplitude[0, 0]) / amplitude - 1)
            what = f"settled amplitude, n0 = {n0:g}, {frequency} Hz"
            good.append(row(f"numba march, {steps} steps", what, off, bound, f"{end.cycles} cycles"))
    return good


def many_contacts_against_each_other() -> list[bool]:
    model, frequency = many_contacts(), MANY_CONTACTS_FREQUENCY
    truth = scipy_events.simulate(model, frequency, 20, rtol=1e-12, lag=3e-5)
    good = []
    for lag, rtol, bound in ((1e-4, 1e-11, 1e-8), (3e-4, 1e-9, 1e-6)):
        run = scipy_events.simulate(model, frequency, 20, rtol=rtol, lag=lag)
        note = f"{run.num_events} of {truth.num_events} events"
        good.append(row(f"scipy DOP853 {rtol:g}, lag {lag:g}", "many_contacts", error(run, truth), bound, note))
    for steps, bound in ((50, 1e-3), (200, 1e-5), (800, 1e-7), (3200, 1e-9)):
        run = numba_rk4.simulate(model, frequency, 20, steps_per_cycle=steps)
        note = f"{run.num_events} of {truth.num_events} events"
        good.append(row(f"numba, {steps} steps", "many_contacts", error(run, truth), bound, note))
    return good


def main() -> None:
    print("| who | what | error | bound | | within |\n|---|---|---|---|---|---|")
    good = reference_states() + settled_amplitudes() + many_contacts_against_each_other()
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
