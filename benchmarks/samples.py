"""How does the error of contact forces fall with the samples of a period?

Prescribed motions of one contact that slips, sticks and opens, each begun at 24 places within a sample. The error is
the root mean square of the Fourier coefficients of the force, against 8,192 samples; tests/hbm/test_period.py holds
the same against an independent computation.

``--waves SEED ...``: instead, the same at solutions of generated structures (benchmarks/generated.py), by samples of
the shortest wave and relative to the norm of the coefficients.
"""

import argparse
import runpy
from pathlib import Path

import numpy as np

from timesim.engine.law.cone import ConeLaw, matrix_and_inverse
from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Controls
from timesim.hbm.curve import hbm_curve
from timesim.hbm.period import basis_of, contact_forces
from timesim.hbm.scheme import Scheme, finer_schemes
from timesim.orbit.fourier import to_coefficients, to_phasors
from timesim.orbit.steady_state import switches

SAMPLES = (32, 64, 128, 256, 512, 1024)
EXACT, PLACES = 8192, 24
PER_WAVE, SOLUTIONS = (6, 8, 12, 16, 24, 32), 20
# u = (A cos, B cos(. + 90 deg)), v = D cos(. + 45 deg); mu = 0.3, k_v = n0 = 1.
MOTIONS = {"slip": (1.0, 0.5, 0.0), "stick and slip": (0.6, 0.1, 0.0), "separation": (1.0, 0.5, 1.5)}
STIFFNESS = {"isotropic": np.eye(2), "full": np.array([[1.0, 0.3], [0.3, 0.6]])}


def motions(A: float, B: float, D: float) -> np.ndarray:
    """Fourier coefficients of (u1, u2, v) of one motion begun at several places, shape (PLACES, 3, 7)."""
    own = np.zeros((3, 7))
    own[:, 1], own[:, 2] = (A, 0.0, D * 0.5**0.5), (0.0, -B, -D * 0.5**0.5)
    turn = np.exp(1j * np.outer(0.37 * np.arange(PLACES), np.arange(4)))
    return to_coefficients(to_phasors(own) * turn[:, None])


def law_of(stiffness: np.ndarray) -> ConeLaw:
    """The same contact as often as there are motions."""
    one = np.ones(PLACES)
    return ConeLaw(0.3 * one, *matrix_and_inverse(np.tile(stiffness, (PLACES, 1, 1))), one, one)


def wave_errors(seed: int) -> np.ndarray:
    """Errors at some solutions of a generated structure, shape (solutions, len(PER_WAVE))."""
    generated = runpy.run_path(str(Path(__file__).parent / "generated.py"))
    model, free = generated["STRUCTURE"](seed)
    low, high = generated["span_of"](model, free)
    model = generated["loaded"](model, np.linspace(low, high, generated["POINTS"] + 1))
    schemes = finer_schemes(Scheme(), model, choose_samples=True)
    curve = hbm_curve(model, low, high, scheme=schemes, controls=Controls(max_points=200), stability=False)
    works = switches(curve.slip_share, curve.separation_share)
    rows = np.flatnonzero(works.any(axis=1))
    balance, errors = Balance(model, low, schemes[-1]), []
    for i in rows[np.unique(np.linspace(0, rows.size - 1, SOLUTIONS).round().astype(int))]:
        motion = curve.contact_motion[i] / balance.length
        order = int(np.flatnonzero(motion.any(axis=(0, 1)))[-1] + 1) // 2
        motion = motion[..., : 2 * order + 1]
        exact, *found = (
            contact_forces(balance.law, basis_of(order, count), motion).coefficient[works[i]]
            for count in (EXACT, *(share * order for share in PER_WAVE))
        )
        errors.append([np.linalg.norm(forces - exact) / np.linalg.norm(exact) for forces in found])
    return np.array(errors)


def by_waves(seeds: list[int]) -> None:
    print("| seed | | " + " | ".join(map(str, PER_WAVE)) + " |\n" + "|---" * (len(PER_WAVE) + 2) + "|")
    for seed in seeds:
        errors = wave_errors(seed)
        for name, row in (("median", np.median(errors, axis=0)), ("largest", errors.max(axis=0))):
            print(f"| {seed} | {name} | " + " | ".join(f"{error:.1e}" for error in row) + " |", flush=True)


def by_samples() -> None:
    print("| motion | K_u | " + " | ".join(map(str, SAMPLES)) + " | order |\n" + "|---" * (len(SAMPLES) + 3) + "|")
    for name, motion in MOTIONS.items():
        for kind, stiffness in STIFFNESS.items():
            law, own = law_of(stiffness), motions(*motion)
            exact = contact_forces(law, basis_of(3, EXACT), own).coefficient
            found = (contact_forces(law, basis_of(3, count), own).coefficient for count in SAMPLES)
            errors = [float(np.sqrt(np.mean((forces - exact) ** 2))) for forces in found]
            order = -np.polyfit(np.log(SAMPLES[1:]), np.log(errors[1:]), 1)[0]
            print(f"| {name} | {kind} | " + " | ".join(f"{error:.1e}" for error in errors) + f" | {order:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--waves", nargs="+", type=int, metavar="SEED", help="at solutions of generated structures")
    seeds = parser.parse_args().waves
    by_waves(seeds) if seeds else by_samples()


if __name__ == "__main__":
    main()
