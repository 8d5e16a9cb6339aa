"""What a preset promises, and the tolerances that keep it for a scene.

A preset promises a relative error of the state at the end of a run (`timesim.engine.companion` says of what). The error
at a given tolerance grows with how long the structure remembers it, and with how fast it vibrates against the
excitation, since a step is controlled relative to the whole state:

    error ~ GROWTH rtol cycles (highest circular frequency of the stuck structure) / (that of the excitation)

where the cycles are those of the run, or those in which the slowest mode decays by a factor of e where these are fewer.
"""

from dataclasses import replace

import numpy as np

from timesim.model.held import springs
from timesim.model.model import Model
from timesim.model.solver import PRESETS, Solver

PROMISE = {"draft": 1e-4, "standard": 1e-6, "reference": 1e-8}
"""Relative error of the state at the end of a run, by preset."""
GROWTH = 0.05
"""Of 95 generated structures (2 to 30 modes, 1 to 6 contacts) half have less than 0.02, three quarters less than 0.09.

One in seven amplifies every error a thousand times and more, which no formula foresees: these, and those between, the
run itself detects.
"""
LONGEST = 100.0
"""Most cycles that count in a steady state, which does not depend on the way to it."""
FINEST = 1e-13
"""Tolerance below which rounding rules."""
CLOSE = 0.5
"""Share of the promised error above which a run is repeated: one estimate in ten errs by more than that."""
MARGIN = 3.0
"""Factor by which a repeated run is to be better than promised: the uncertainty of its estimate."""

AMPLIFIED = 3e4
"""How many times finer than the promise the tolerance of a repetition may be before its estimate is in doubt.

Of 179 repetitions beyond that (of 261 generated structures with 2 to 50 modes) 142 did not keep the promise; of 12 the
estimate did not show it.
"""
SLOW = 0.1
"""Share of the frequency of the excitation below which a mode counts as free."""


def remembered(model: Model, frequency: float) -> float:
    """Cycles at a frequency [Hz] in which the mode that decays most slowly decays by a factor of e, at least 1."""
    return float(1 / max(-np.expm1(-model.structure.decay / frequency), 1e-300))


def growth(model: Model, frequency: float, cycles: float | None = None) -> float:
    """Error at the end over the tolerance, after so many cycles at a frequency [Hz]; None: in a steady state."""
    counted = min(remembered(model, frequency), LONGEST if cycles is None else cycles)
    return GROWTH * counted * max(float(model.stuck_omega[-1]) / (2 * np.pi * frequency), 1.0)


def preset(accuracy: str, model: Model, frequency: float, cycles: float | None = None) -> Solver:
    """The solver of a preset for a model: its own tolerances, or tighter ones where they would not keep the promise."""
    solver = PRESETS[accuracy]
    return tightened(solver, PROMISE[accuracy] / growth(model, frequency, cycles) / solver.rtol)


def tightened(solver: Solver, share: float) -> Solver:
    """The solver with its tolerances multiplied by a share where that is less than 1, to two digits."""
    rtol = float(f"{max(share * solver.rtol, FINEST):.1e}")
    return replace(solver, rtol=rtol, atol=rtol * (solver.atol / solver.rtol)) if rtol < solver.rtol else solver


def rounded(model: Model, contact: int, frequency: float) -> tuple[float, float]:
    """The stiffness of a contact that rounding spoils most, and about the relative error that it leaves.

    The force of a stiffness k is rounded to eps k u, which moves what is left of the structure without the contact.
    ``frequency`` [Hz] is that of the excitation: a mode far below it moves by inertia, as a free body does.
    """
    body = model.structure
    omega = np.where(body.frequency > SLOW * frequency, body.omega, 2 * np.pi * frequency)
    stiffness, axes = np.linalg.eigh(springs(model.contacts[contact]))
    compliance = (axes.T @ model.contact_shape[contact]) ** 2 @ (1 / (body.mass * omega**2))
    error = np.finfo(float).eps * stiffness * compliance
    worst = int(np.argmax(error))
    return float(stiffness[worst]), float(error[worst])
