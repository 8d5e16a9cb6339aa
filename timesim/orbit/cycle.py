"""The motion of one cycle by time integration, from a state that repeats: sampled, and by its Fourier coefficients."""

from dataclasses import replace

import numpy as np

from timesim.engine.history import Samples, joined, sample
from timesim.engine.trajectory import Phase, Run
from timesim.model.model import Model
from timesim.model.solver import Solver
from timesim.orbit.fourier import fourier_coefficients

SAMPLES = 1024


def one_cycle(model: Model, frequency: float, solver: Solver, num: int) -> Samples:
    """A cycle from the start of a model at a frequency [Hz], at num + 1 equal times, both ends among them."""
    run = Run(model, [Phase(frequency, 1)], replace(solver, reduce=False))
    times, parts, taken = np.arange(num + 1) / (frequency * num), [], 0
    for steps in run.batches():
        upto = times.size if run.completed else int(np.searchsorted(times, steps.time[-1] + steps.h[-1]))
        if upto > taken:
            parts.append(sample(steps, times[taken:upto]))
            taken = upto
    return joined(parts)


def modal_coefficients(model: Model, frequency: float, solver: Solver) -> np.ndarray:
    """Modal displacement of that cycle by 1, cos, sin, ... of the excitation's phase, shape (2K + 1, M)."""
    return fourier_coefficients(one_cycle(model, frequency, solver, SAMPLES).q[1:], model.start.phase)
