"""How does the error of contact forces fall with the samples of a period?

Prescribed motions of one contact that slips, sticks and opens, each begun at 24 places within a sample. The error is
the root mean square of the Fourier coefficients of the force, against 8,192 samples; tests/hbm/test_period.py holds
the same against an independent computation.
"""

import numpy as np

from timesim.engine.law.cone import ConeLaw, matrix_and_inverse
from timesim.hbm.period import basis_of, contact_forces
from timesim.orbit.fourier import to_coefficients, to_phasors

SAMPLES = (32, 64, 128, 256, 512, 1024)
EXACT, PLACES = 8192, 24
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


def main() -> None:
    print("| motion | K_u | " + " | ".join(map(str, SAMPLES)) + " | order |\n" + "|---" * (len(SAMPLES) + 3) + "|")
    for name, motion in MOTIONS.items():
        for kind, stiffness in STIFFNESS.items():
            law, own = law_of(stiffness), motions(*motion)
            exact = contact_forces(law, basis_of(3, EXACT), own).coefficient
            found = (contact_forces(law, basis_of(3, count), own).coefficient for count in SAMPLES)
            errors = [float(np.sqrt(np.mean((forces - exact) ** 2))) for forces in found]
            order = -np.polyfit(np.log(SAMPLES[1:]), np.log(errors[1:]), 1)[0]
            print(f"| {name} | {kind} | " + " | ".join(f"{error:.1e}" for error in errors) + f" | {order:.2f} |")


if __name__ == "__main__":
    main()
