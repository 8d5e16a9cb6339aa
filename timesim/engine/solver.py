"""The control of the step length, from a solver's numbers."""

from timesim.runtime import Leaf, tree_class  # isort: skip

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from timesim.engine.barrier import apart
from timesim.engine.law.contact_law import ContinuousState
from timesim.engine.tolerance import LANDING, NO_TIME
from timesim.model.solver import Solver


@tree_class
class Control:
    """Tolerances of the step size, relative to the largest coordinate and to the scene's scale.

    Attributes:
        rtol, atol: the tolerance of a step is ``rtol * max|state| + atol``.
        longest: longest step, and the step of a method without error estimate [rad of the excitation].
        opening: first step of each cycle. The control forgets at a cycle's end: what a cycle makes of a state depends
            on that state alone, so a settled motion repeats to rounding, and a run taken up again is the same run.
        closing: longest first step of a slip that starts where a contact closes.
        budget: most steps tried in a cycle.
        stiffest: fastest rate of the structure with all its contacts stuck, in units of the excitation's; at least 1.
    """

    rtol: Float[Leaf, ""]
    atol: Float[Leaf, ""]
    longest: Float[Leaf, ""]
    opening: Float[Leaf, ""]
    closing: Float[Leaf, ""]
    budget: Int[Leaf, ""]
    stiffest: Float[Leaf, ""]

    @property
    def landing(self) -> Float[Array, ""]:
        """Time from a guard over which an Euler step corrects the end of a step."""
        return LANDING / jnp.asarray(self.stiffest)


def step_control(solver: Solver, stiffest: float) -> Control:
    """Tolerances, lengths and budget of the steps; ``stiffest`` as in `Control`."""
    stiffest = max(stiffest, 1.0)
    lengths = (solver.longest, solver.first_step(stiffest), solver.first_slip(stiffest))
    rtol, atol, longest, opening, closing, fastest = map(np.asarray, (solver.rtol, solver.atol, *lengths, stiffest))
    return Control(rtol, atol, longest, opening, closing, np.asarray(solver.budget), fastest)


@apart
def error_size(control: Control, size: Float[Array, ""], error: ContinuousState) -> Float[Array, ""]:
    """Error of a step relative to its tolerance for a motion of that size."""
    return error.error() / (control.atol + control.rtol * size)


def next_length(
    control: Control, order: int, before: tuple[Array, Array], error: Array, h: Array, precise: Array
) -> Float[Array, ""]:
    """Step length for the next try; a step cut short by an event or a cycle's end slows nothing.

    PI control (Gustafsson, ACM Trans. Math. Softw. 17, 1991) with the exponents 0.7 / k and 0.4 / k of Hairer & Wanner,
    Solving Ordinary Differential Equations II, section IV.2.

    Args:
        order: k of the method.
        before: length that was asked for, and the error of the last accepted step.
        error: error of this try over its tolerance.
        h, precise: its length, and whether it is within its tolerance.
    """
    asked, last_error = before
    floor = jnp.maximum(error, 1e-10)
    power = 1 / order
    grown = h * jnp.clip(0.9 * floor ** (-0.7 * power) * last_error ** (0.4 * power), 0.2, 8.0)
    shrunk = h * jnp.clip(0.9 * floor ** (-power), 0.1, 0.9)
    cut = h < asked * (1 - NO_TIME)
    length = jnp.where(precise, jnp.where(cut & (grown < asked), asked, grown), shrunk)
    return jnp.minimum(length, control.longest)
