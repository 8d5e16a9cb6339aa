"""The paper's oscillator by pyHarm 1.2.2 (PyPI: pyHarm-os), for `harmonic_balance.py --pyharm`.

It pins an older JAX: run it by a Python of its own (``python -m venv /tmp/pyharm && /tmp/pyharm/bin/pip install
pyHarm-os``). Prints JSON: frequencies [Hz], amplitudes of tip x, CPU seconds.

Its `Penalty3D` needs a preload and does not open under one, so the case is n0 = 3, where the contact slips and never
opens. Its degrees of freedom are those of a node: the two modes get a third, far above, that makes their shapes square.
The normal axis is turned: it opens along +z.
"""

import argparse
import json
import logging
import time

import numpy as np
from pyHarm.Maestro import Maestro

STILL_MODE = 300.0
SHAPE = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.3], [-0.8, -0.6, 1.0]])


def oscillator(preload: float, harmonics: int, samples: int, span: tuple[float, float], step: float) -> dict:
    omega = 2 * np.pi * np.array([0.9, 1.1, STILL_MODE])
    inverse = np.linalg.inv(SHAPE)
    mass, stiffness = inverse.T @ inverse, inverse.T @ np.diag(omega**2) @ inverse
    damping = inverse.T @ np.diag(2 * 0.02 * omega) @ inverse
    force = inverse.T @ np.array([1.0, 1.0, 0.0])
    matrices = {"M": mass, "K": stiffness, "C": damping, "G": np.zeros((3, 3))}
    connectors = {
        f"force{i}": {"type": "CosinusForcing", "connect": {"body": [0]}, "dirs": [i], "amp": float(force[i])}
        for i in range(3)
    }
    connectors["pad"] = {
        "type": "Penalty3D",
        "connect": {"body": [0], "GROUND": [0]},
        "dirs": [2, 0, 1],
        "jac": "jax",
        "mu": 0.5,
        "N0": preload,
        "k_n": 20.0,
        "k_t": 20.0,
        "g": 0.0,
    }
    study = {
        "study": "frf",
        "puls_inf": 2 * np.pi * span[0],
        "puls_sup": 2 * np.pi * span[1],
        "ds0": step / 2,
        "ds_max": step,
        "ds_min": 1e-8,
        "sign_ds": 1,
        "verbose": False,
    }
    return {
        "analysis": {"frf": study},
        "system": {"type": "Base", "nh": harmonics, "nti": samples, "adim": {"status": False}},
        "substructures": {"body": {"matrix": matrices, "ndofs": 3, "nmodes": 0}},
        "connectors": connectors,
    }


def amplitudes(maestro: Maestro, harmonics: int) -> tuple[list[float], list[float]]:
    dofs = maestro.system.expl_dofs
    rows = dofs[(dofs["dof_num"] == 0) & (dofs["sub"] == "body")]
    angle = np.linspace(0, 2 * np.pi, 4001)[:, None] * np.array(rows["harm"])
    waves = np.where(np.array(rows["cs"]) == "c", np.cos(angle), np.sin(angle))
    points = [solution.x for solution in maestro.nls["frf"].SolList if solution.flag_accepted]
    return [float(x[-1] / 2 / np.pi) for x in points], [float(np.ptp(waves @ x[rows.index]) / 2) for x in points]


def main() -> None:
    parser = argparse.ArgumentParser()
    for name, kind, usual in (("preload", float, 3.0), ("harmonics", int, 9), ("samples", int, 512)):
        parser.add_argument(f"--{name}", type=kind, default=usual)
    parser.add_argument("--span", type=float, nargs=2, default=(0.8, 1.65))
    parser.add_argument("--step", type=float, default=0.05)
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    few = oscillator(asked.preload, asked.harmonics, asked.samples, (asked.span[0], asked.span[0] + 0.01), asked.step)
    Maestro(few).operate()
    maestro = Maestro(oscillator(asked.preload, asked.harmonics, asked.samples, tuple(asked.span), asked.step))
    clock = time.process_time()
    maestro.operate()
    seconds = time.process_time() - clock
    frequency, amplitude = amplitudes(maestro, asked.harmonics)
    print(json.dumps({"frequency": frequency, "amplitude": amplitude, "seconds": seconds}))


if __name__ == "__main__":
    main()
