"""Harmonics of the motion over whole cycles of the loop.

Gauss-Legendre quadrature of the dense output, step by step: a transition always lies between two steps.
"""

import timesim.runtime  # noqa: F401  isort: skip

import jax
import numpy as np

from timesim.engine import dense_output as hermite
from timesim.engine.exponential.work import gauss
from timesim.engine.step import PERIOD, Step
from timesim.engine.system import System

# Six nodes of a step: over 2.8 rad of the highest harmonic, as with 20 steps a cycle, they leave 1e-10 of an integral.
NODE, WEIGHT = gauss(6)  # as fractions of the step


def phasors(system: System, steps: Step, cycles: int, harmonics: int) -> np.ndarray:
    """Phasors of the modal displacement, ``q = Re sum_h phasor_h exp(i h phase of the excitation)``, shape (H + 1, M).

    The steps, numpy arrays whose first axis is that of the steps, make up ``cycles`` whole ones.
    """
    steps = jax.tree.map(lambda rows: rows[steps.h > 0], steps)
    h = steps.h[:, None]
    angle, share = (steps.time[:, None] + h * NODE).ravel(), (h * WEIGHT).ravel() / (PERIOD * cycles)
    start, end = (
        [part[:, None] for part in (y.q, y.p, dy.p)]
        for y, dy in ((steps.start, steps.start_rate), (steps.end, steps.end_rate))
    )
    q = hermite.quintic(NODE[:, None], h[:, None], (*start,), (*end,))[0].reshape(angle.size, -1)
    turn = np.exp(-1j * np.outer(np.arange(harmonics + 1), angle + float(system.phase)))
    phasor = (turn * share) @ q
    phasor[1:] *= 2
    return phasor
