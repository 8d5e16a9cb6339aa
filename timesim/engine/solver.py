"""A solver's numbers as the event loop takes them: the method of a step, and what controls its length."""

import timesim.runtime  # noqa: F401  isort: skip

import numpy as np

from timesim.engine.event_loop import Control
from timesim.engine.method import Method, method_named
from timesim.model.solver import Solver


def step_method(solver: Solver) -> Method:
    """The method that takes the steps."""
    return method_named(solver.name, rtol=solver.rtol, atol=solver.atol)


def step_control(solver: Solver, stiffest: float) -> Control:
    """Tolerances, lengths and budget of the steps.

    Args:
        solver: the numbers.
        stiffest: fastest rate of the stuck structure, in units of the excitation's frequency.
    """
    stiffest = max(stiffest, 1.0)
    return Control(
        *(np.asarray(value, dtype=float) for value in (solver.rtol, solver.atol, solver.longest)),
        opening=np.asarray(solver.first_step(stiffest), dtype=float),
        budget=np.asarray(solver.budget),
        stiffest=np.asarray(stiffest, dtype=float),
    )
