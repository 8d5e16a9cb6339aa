"""About how long an integration and a harmonic balance take, from figures measured on one core of an AMD EPYC server.

    python benchmarks/cost.py           microseconds of a step: within 15 % for 2 to 30 modes with 1 to 4 contacts
    python benchmarks/accuracy.py       steps of a cycle: those of the oscillator, the blade and 20 modes

Another machine, separation within the cycle and many transitions change them by a factor of two or three.
"""

import math

import numpy as np

from timesim.model.model import Model
from timesim.model.solver import PRESETS, Criterion, Solver

REACH = 3.3
"""Largest |eigenvalue| times step at which an explicit fifth-order method stays stable on an oscillation."""
STEPS = {"draft": (38, 2.3), "standard": (75, 4.9), "reference": (63, 7.0)}
"""Steps of a cycle: for accuracy alone, and beside them for each one that stability asks for."""
RECORDED, SIDE_BY_SIDE = (3.8, 0.16), (0.47, 0.045)
"""Microseconds of a step of tsit5, and for each mode and contact: of a run that is recorded, of one of sixteen."""
ALONE = 2.8
"""Work of a step of one that is alone and not recorded, as a multiple of that of one of sixteen."""
STAGES = {"tsit5": 1.0, "dopri5": 1.0, "rk4": 0.6, "dopri8": 1.9}
"""Work of a step, as a multiple of that of tsit5."""
SETTLING = 0.004
"""Seconds of a steady state beside its cycles: what is left out, amplitudes, multipliers."""
SHOTS = 8
"""Cycles of Newton's method, beside those that are marched before it is tried."""
SOLUTIONS = 200
"""Solutions on a curve of harmonic balance."""


def stable_steps(model: Model, frequency: float) -> float:
    """Explicit steps of a cycle at a frequency [Hz] that stability alone asks for."""
    return model.stuck_rate / (REACH * frequency)


def seconds_a_cycle(model: Model, solver: Solver, frequency: float, side_by_side: int | None = None) -> float | None:
    """Of a cycle at a frequency [Hz].

    Args:
        model, solver, frequency: what is integrated.
        side_by_side: how many are marched side by side; None: it is one run, and recorded.

    Returns:
        The time of a cycle of one of them; None for a method that was not measured.
    """
    if solver.name not in STAGES:
        return None
    steps = 2 * np.pi / solver.longest
    if solver.name != "rk4":
        near = min(PRESETS, key=lambda name: abs(np.log(PRESETS[name].rtol / solver.rtol)))
        finer = (PRESETS[near].rtol / solver.rtol) ** (1 / 8 if solver.name == "dopri8" else 1 / 5)
        steps = finer * STEPS[near][0] + max(finer, 1.0) * STEPS[near][1] * stable_steps(model, frequency)
    each, share = RECORDED if side_by_side is None else SIDE_BY_SIDE
    alone = 1.0 if side_by_side is None else max(1.0, ALONE ** (1 - np.log(side_by_side) / np.log(16)))
    size = model.structure.num_modes * model.num_contacts
    return float(1e-6 * STAGES[solver.name] * alone * steps * (each + share * size))


def cycles_to_settle(model: Model, criterion: Criterion, frequency: float) -> int:
    """Cycles at a frequency [Hz] in which the mode that decays most slowly has decayed to the tolerance, or is shot."""
    structure = model.structure
    decay = 2 * np.pi * (structure.damping_ratio * structure.frequency)[structure.frequency > 0]
    slowest = max(float(decay.min(initial=np.inf)), 1e-300)
    marched = -math.log(criterion.tolerance) * frequency / slowest
    return int(np.ceil(min(marched, criterion.first_shot + SHOTS, criterion.max_cycles)))


def seconds_a_solution(model: Model, time_samples: int, *, stability: bool) -> float:
    """Of a solution of a harmonic balance, with its multipliers or without (benchmarks/harmonic_balance.py).

    Up to nine harmonics cost nothing beside the samples, more bring more samples with them.
    """
    contacts, modes = model.num_contacts, model.structure.num_modes
    each = 7 + (3 + 0.18 * modes + 3.5 * (contacts - 1) if stability else 1.7 * (contacts - 1))
    return 1e-3 * each * (0.2 + 0.8 * time_samples / 256)
