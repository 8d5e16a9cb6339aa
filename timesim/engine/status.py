"""How a trajectory stands: data in the compiled loop, and a message at its boundary."""

import enum

from timesim.model.model import Model
from timesim.model.reduction import Reduction
from timesim.model.solver import Solver

NOBODY = -1
"""The contact of the last transition where there was none yet."""


class RunError(Exception):
    """A run that ended early: the message says when, why and what to try."""


class Status(enum.IntEnum):
    """How a trajectory stands. All but RUNNING end it.

    Attributes:
        reason, advice: the message for the user; may name {solver} and {budget}.
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
        "The problem is too stiff for {solver}: try solver.method: exponential (kvaerno5 where dampers couple the "
        "modes), fewer modes (structure.keep_modes), or a larger rtol",
    )
    BUDGET = (
        3,
        "the budget of {budget} steps a cycle is spent",
        "Raise solver.max_steps, keep fewer modes (structure.keep_modes), or try solver.method: exponential "
        "(kvaerno5 where dampers couple the modes)",
    )
    NOT_FINITE = (
        4,
        "the state is no longer finite",
        "Check the scene for negative damping or forces that are far too large, and try a smaller rtol",
    )

    def message(self, *, solver: str, budget: int, contact: str | None) -> str:
        """What has ended a trajectory, and what to try; ``contact``: that of the last transition, if there is any."""
        last = f"; contact '{contact}' switched last" if contact else ""
        # The name of a contact may hold braces: it is put in last.
        return f"{last}. ".join(text.format(solver=solver, budget=budget) for text in (self.reason, self.advice))


def message_of(model: Model, reduction: Reduction, solver: Solver, status: int, culprit: int) -> str:
    """What a status that has ended a trajectory means, and what to try."""
    contact = model.contacts[reduction.live[culprit]].name if culprit != NOBODY else None
    return Status(status).message(solver=solver.name, budget=solver.budget, contact=contact)
