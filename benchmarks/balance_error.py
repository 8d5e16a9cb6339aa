"""How far do the amplitudes err that few harmonics give, and the multipliers that few samples give?

Lightly damped generated structures (benchmarks/generated.py), harmonics and samples chosen by the program, the first
solutions of each curve. Seeds were set once and nothing was tuned on them.

    python benchmarks/balance_error.py --seeds 9100 9101

Of some solutions at which a contact works: what harmonics above those taken would still add, and change in those below,
as shares of the amplitude; at the worst of them, the change of the amplitude with 57 harmonics. Then the error of the
largest multiplier against 8,192 samples, and CPU milliseconds a solution, by the number of samples; "own" are those
of a curve, 2,048 where the others leave it open.
"""

import argparse
import runpy
import time
from pathlib import Path

import numpy as np

from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Controls
from timesim.hbm.convergence import Known, amplitude, neglected
from timesim.hbm.curve import HbmCurve, hbm_curve
from timesim.hbm.scheme import Scheme, coarsest, enough_samples, finer_schemes
from timesim.hbm.stability import checked_multipliers, floquet_multipliers, grows
from timesim.model.model import Model
from timesim.orbit.steady_state import switches

GENERATED = runpy.run_path(str(Path(__file__).with_name("generated.py")))
SOLUTIONS, MANY, WORST = 32, Scheme(57, 1024), 3
SAMPLES = (128, 256, 512, 1024, 2048)
EXACT = 8192


def lightly_damped(seed: int, ratio: float) -> tuple[Model, float, float]:
    """A generated structure under a load at which its contacts work, and the range of its curve [Hz]."""
    model, free = GENERATED["STRUCTURE"](seed, (ratio, ratio))
    low, high = GENERATED["span_of"](model, free)
    return GENERATED["loaded"](model, np.linspace(low, high, GENERATED["POINTS"] + 1)), low, high


def at_work(curve: HbmCurve) -> np.ndarray:
    """Places of some solutions at which a contact slips or opens within the period."""
    rows = np.flatnonzero(switches(curve.slip_share, curve.separation_share).any(axis=1))
    return np.unique(rows[np.linspace(0, rows.size - 1, SOLUTIONS).round().astype(int)]) if rows.size else rows


def only(curve: HbmCurve, i: int) -> HbmCurve:
    """A curve of one solution."""
    own = slice(i, i + 1)
    arrays = {name: value[own] for name, value in vars(curve).items() if isinstance(value, np.ndarray)}
    return HbmCurve(**{**vars(curve), **arrays})


def harmonics(model: Model, curve: HbmCurve, schemes: tuple[Scheme, ...], rows: np.ndarray) -> str:
    """What the harmonics leave out, by estimate, and at the worst of the solutions the change with many."""
    left = np.array([neglected(lambda _: model, only(curve, i), schemes) for i in rows])
    worst = rows[np.argsort(-left)[:WORST]]
    known = [Known(model, float(curve.frequency[i]), curve.contact_motion[i], curve.amplitude[i]) for i in worst]
    change = [np.abs(amplitude(one, MANY) - one.amplitude).max() / one.amplitude.max() for one in known]
    return f"{np.median(left):.1e} | {left.max():.1e} | {np.nanmax(change):.1e}"


def multipliers(model: Model, curve: HbmCurve, schemes: tuple[Scheme, ...], rows: np.ndarray, samples: int) -> tuple:
    """The largest modulus at each solution, whether it grows, and CPU seconds; 0 samples: those of the balance."""
    place = np.array([coarsest(schemes, curve.contact_motion[i]) for i in rows])
    largest, unstable, clock = np.zeros(rows.size), np.zeros(rows.size, dtype=bool), 0.0
    for own in np.unique(place):
        balance, at = Balance(model, 1.0, schemes[own]), rows[place == own]
        x = curve.contact_motion[at][..., : balance.size].reshape(at.size, -1) / balance.length
        begin = time.process_time()
        found = _found(balance, x, curve.frequency[at], samples)
        clock += time.process_time() - begin
        largest[place == own], unstable[place == own] = np.abs(found[:, 0]), grows(found)
    return largest, unstable, clock


def _found(balance: Balance, x: np.ndarray, frequency: np.ndarray, samples: int) -> np.ndarray:
    """Multipliers by so many samples, or as a curve has them, but for what the sign of its determinant tells."""
    if samples:
        return floquet_multipliers(balance, x, frequency, samples=samples)
    return checked_multipliers(balance, x, frequency, np.zeros(len(x), dtype=int))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[9100, 9101])
    parser.add_argument("--damping", type=float, default=5e-3, help="ratio of all modes")
    parser.add_argument("--points", type=int, default=600, help="solutions of a curve at most")
    given = parser.parse_args()
    for seed in given.seeds:
        model, low, high = lightly_damped(seed, given.damping)
        schemes = finer_schemes(Scheme(9, enough_samples(9)), model, choose_samples=True)
        options = {"scheme": schemes, "stability": False}
        hbm_curve(model, low, high, controls=Controls(max_points=2), **options)
        begin = time.process_time()
        curve = hbm_curve(model, low, high, controls=Controls(max_points=given.points), **options)
        seconds, rows = time.process_time() - begin, at_work(curve)
        cells: tuple = seed, model.structure.num_modes, model.num_contacts, curve.frequency.size, f"{seconds:.1f}"
        if not rows.size:
            print(f"| {' | '.join(map(str, cells))} | no contact works |", flush=True)
            continue
        print(f"| {' | '.join(map(str, cells))} | {harmonics(model, curve, schemes, rows)} |", flush=True)
        exact, unstable, _ = multipliers(model, curve, schemes, rows, EXACT)
        for samples in (0, *SAMPLES):
            found, grown, clock = multipliers(model, curve, schemes, rows, samples)
            error, wrong = np.abs(found - exact), np.count_nonzero(grown != unstable)
            cells = samples or "own", f"{np.median(error):.1e}", f"{error.max():.1e}", f"{wrong} of {rows.size}"
            print(f"| {seed} | {' | '.join(map(str, cells))} | {1e3 * clock / rows.size:.1f} |", flush=True)


if __name__ == "__main__":
    main()
