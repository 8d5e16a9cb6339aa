"""Means over whole cycles of the loop: harmonics of the motion and power lost in the contacts.

Gauss-Legendre quadrature of the dense output, step by step: a transition always lies between two steps.
"""

import timesim.runtime  # noqa: F401  isort: skip

from typing import Any

import jax
import numpy as np

from timesim.engine import dense_output as hermite
from timesim.engine.exponential.work import gauss
from timesim.engine.lanes import by_rows
from timesim.engine.law.contact_law import ContactLaw, Motion, Scalar
from timesim.engine.step import PERIOD, Step
from timesim.engine.system import System, power_lost
from timesim.program import program

# Six nodes of a step: over 2.8 rad of the highest harmonic, as with 20 steps a cycle, they leave 1e-10 of an integral.
NODE, WEIGHT = gauss(6)  # as fractions of the step


def means(system: System, steps: Step, cycles: int, harmonics: int) -> tuple[np.ndarray, np.ndarray]:
    """Means over all steps of some cycles, dimensionless.

    Args:
        system: in which the steps were taken.
        steps: numpy arrays, the first axis that of the steps.
        cycles: how many they make up.
        harmonics: of the modal displacement, beside its mean.

    Returns:
        phasors of the modal displacement, ``q = Re sum_h phasor_h exp(i h phase of the excitation)``, shape (H + 1, M),
        and the power lost in each contact, shape (C,).
    """
    steps = jax.tree.map(lambda rows: rows[steps.h > 0], steps)
    angle, q, p, h = _nodes(steps)
    share = (h * WEIGHT).ravel() / (PERIOD * cycles)
    turn = np.exp(-1j * np.outer(np.arange(harmonics + 1), angle + float(system.phase)))
    phasor = (turn * share) @ q
    phasor[1:] *= 2
    return phasor, share @ _power(system, steps, q, p)


def _nodes(steps: Step) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Angle, modal displacement and velocity at the nodes of all steps, and the length of each step, shape (N, 1)."""
    h = steps.h[:, None]
    angle = (steps.time[:, None] + h * NODE).ravel()
    start, end = (
        [part[:, None] for part in (y.q, y.p, dy.p)]
        for y, dy in ((steps.start, steps.start_rate), (steps.end, steps.end_rate))
    )
    q, p = (part.reshape(angle.size, -1) for part in hermite.quintic(NODE[:, None], h[:, None], (*start,), (*end,)))
    return angle, q, p, h


def _power(system: System, steps: Step, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Power lost in each contact at the nodes of all steps, shape (N, C)."""
    shape = (len(q), steps.state.shape[1])
    if 0 in shape:
        return np.zeros(shape)
    sides = list(zip(steps.start.w, steps.start_rate.w, steps.end.w, steps.end_rate.w, strict=True))
    w = tuple(_slip(steps.h, *side).reshape(shape) for side in sides)
    (*u, v), (*du, dv) = ([y @ axis.T for axis in system.shape] for y in (q, p))
    columns = (np.repeat(steps.state, NODE.size, axis=0), Motion((*u,), v, (*du,), dv), w)
    return by_rows(_lost, (system.law,), columns)


def _slip(h: np.ndarray, w0: np.ndarray, dw0: np.ndarray, w1: np.ndarray, dw1: np.ndarray) -> Any:
    """One component of the slip at the nodes of steps of length h, shape (N, nodes, C)."""
    start, end = (w0[:, None], dw0[:, None]), (w1[:, None], dw1[:, None])
    return hermite.cubic(NODE[:, None], h[:, None, None], start, end)


@program
def _lost(law: ContactLaw, state: Any, motion: Motion, w: Any) -> Scalar:
    return power_lost(law.reaction(state, motion, w))
