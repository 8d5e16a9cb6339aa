"""How a trajectory stands: data in the compiled loop, and a message at its boundary."""

import enum

from timesim.model.model import Model
from timesim.model.reduction import Reduction
from timesim.model.solver import Solver

NOBODY = -1
"""The contact of the last transition where there was none yet."""

DAMPERS = "kvaerno5 where dampers couple the modes"
OTHER = {"exponential": DAMPERS, "kvaerno5": "exponential"}
"""Methods to try instead of those that stay stable by themselves."""
BOTH = f"exponential ({DAMPERS})"


class RunError(Exception):
    """A run that ended early: the message says when, why and what to try."""


class Status(enum.IntEnum):
    """How a trajectory stands. All but RUNNING end it.

    Attributes:
        reason, advice: the message for the user; may name {solver}, {budget} and {other}, a method to try instead.
    """

    reason: str
    advice: str

    def __new__(cls, value: int, reason: str = "", advice: str = "") -> "Status":
        member = int.__new__(cls, value)
        member._value_, member.reason, member.advice = value, reason, advice
        return member

    RUNNING = 0
    ZENO = (
        1,
        "transitions follow one another over and over without time passing (Zeno-like accumulation)",
        "Smooth the scene (a little damping in its modes, softer contacts) or ask for solver.accuracy: reference",
    )
    TOO_SHORT = (
        2,
        "the step fell below rounding",
        "The problem is too stiff for {solver}: try solver.method: {other}, fewer modes (structure.keep_modes), or a "
        "larger rtol",
    )
    BUDGET = (
        3,
        "the budget of {budget} steps a cycle is spent",
        "Raise solver.max_steps, keep fewer modes (structure.keep_modes), or try solver.method: {other}",
    )
    NOT_FINITE = (
        4,
        "the state is no longer finite",
        "The steps are too long for the fastest motion: raise solver.steps_per_cycle, or try a method that controls "
        "its steps (solver.method: tsit5); check the scene for forces that are far too large",
    )

    def message(self, *, solver: str, budget: int, contact: str | None) -> str:
        """What has ended a trajectory, and what to try; ``contact``: that of the last transition, if there is any."""
        last = f"; contact '{contact}' switched last" if contact else ""
        words = {"solver": solver, "budget": budget, "other": OTHER.get(solver, BOTH)}
        # The name of a contact may hold braces: it is put in last.
        return f"{last}. ".join(text.format(**words) for text in (self.reason, self.advice))


def message_of(model: Model, reduction: Reduction, solver: Solver, status: int, culprit: int) -> str:
    """What a status that has ended a trajectory means, and what to try."""
    contact = model.contacts[reduction.live[culprit]].name if culprit != NOBODY else None
    return Status(status).message(solver=solver.name, budget=solver.budget, contact=contact)
