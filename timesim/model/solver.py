"""The numbers of an integration: a method with its tolerances, and when a motion counts as settled.

The presets are the tolerances of an easy scene; one that needs finer ones gets them (`timesim.model.promise`).
"""

from dataclasses import dataclass, replace

import numpy as np

CLOSED_FORM = "closed form"
"""Name of what solves a run of which no contact is left; no scene can give it."""


@dataclass(frozen=True)
class Solver:
    """A method with its tolerances.

    Attributes:
        rtol, atol: tolerance of a step, relative to the state and to the scene's own scale.
        longest: longest step [rad of the excitation]; the step itself for rk4.
        budget: most steps tried in one cycle.
        reduce: leave out modes, contacts and directions that are proven to have no effect.
    """

    name: str
    rtol: float
    atol: float
    longest: float = 2 * np.pi / 12
    budget: int = 100_000
    reduce: bool = True

    def first_step(self, stiffest: float) -> float:
        """Length of the first step of a cycle [rad]; the error control takes over from there.

        ``stiffest``: fastest rate of the stuck structure, in units of the excitation's frequency.
        """
        if self.name in ("rk4", "exponential"):
            return self.longest
        return min(0.02, 0.2 / max(stiffest, 1.0))

    def first_slip(self, stiffest: float) -> float:
        """Longest first step of a slip that starts where a contact closes [rad]; ``stiffest`` as in `first_step`.

        By `first_step` errors of up to 1.5e-8 were left there at any tolerance, by a tenth of it 2e-12 at 1e-11.
        """
        return self.first_step(stiffest) if self.name in ("rk4", "exponential") else 0.1 * self.first_step(stiffest)

    @property
    def has_tolerance(self) -> bool:
        """Whether its steps keep a tolerance."""
        return self.name not in ("rk4", CLOSED_FORM)

    def __str__(self) -> str:
        if self.name == CLOSED_FORM:
            return self.name
        if self.name == "rk4":
            return f"rk4, {round(2 * np.pi / self.longest)} steps a cycle"
        return f"{self.name}, rtol {self.rtol:g}, atol {self.atol:g}"


RATIO = 10.0
"""Tolerance of the coarser run that a run is compared with to estimate its error, as a multiple of its own."""
COMPANION = 0.6
"""Time that it takes, as a share of that of the run: the share of the steps by a method of order five."""


def coarser(solver: Solver) -> Solver:
    """The solver of the run that one by this solver is compared with."""
    if solver.name == "rk4":
        return replace(solver, longest=2 * solver.longest)
    # Where the longest step rules, the same steps would hide the error.
    return replace(solver, rtol=RATIO * solver.rtol, atol=RATIO * solver.atol, longest=1.5 * solver.longest)


PRESETS = {
    "draft": Solver("tsit5", 1e-5, 1e-7),
    "standard": Solver("tsit5", 1e-7, 1e-9),
    "reference": Solver("dopri8", 1e-11, 1e-13),
}


SHOOT, SLOW, NEVER = 16, 256, np.inf
"""Cycles marched before the first attempt at shooting: where it is asked for (a motion that settles at once has done so
by then); by default (a motion that has not settled by then would take thousands); and where it matters to which motion
a start leads, since Newton's method may lead to another."""


@dataclass(frozen=True)
class Criterion:
    """When a motion counts as settled, and how it is sought.

    Attributes:
        tolerance: of the state from cycle to cycle, relative to its largest entry.
        max_cycles: budget at each frequency.
        first_shot: cycles marched before Newton's method on the state after a period is tried.
    """

    tolerance: float = 1e-8
    max_cycles: int = 2000
    first_shot: float = SLOW
