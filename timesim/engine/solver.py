"""What a scene's ``solver`` section means in numbers: a method, its tolerances, its budget.

The presets, each with the largest error of the last state that was measured for it, relative to the largest
displacement and velocity (`python benchmarks/accuracy.py`): on the paper's oscillator, on a blade with two contacts,
and on 20 modes up to 40 times the excitation with three contacts.

=========  ======  =====  ==========  ======  ========
accuracy   method  rtol   oscillator  blade   20 modes
=========  ======  =====  ==========  ======  ========
draft      tsit5   1e-5   8.0e-6      3.4e-5  7.6e-4
standard   tsit5   1e-7   8.4e-8      2.0e-7  3.1e-6
reference  dopri8  1e-11  1.6e-11     1.8e-12 6.7e-12
=========  ======  =====  ==========  ======  ========
"""

import timesim.runtime  # noqa: F401  isort: skip

from dataclasses import dataclass

import numpy as np

from timesim.engine.event_loop import Control
from timesim.engine.method import Method, method_named
from timesim.scene.file import SolverSection


@dataclass(frozen=True)
class Solver:
    """A method with its tolerances.

    Attributes:
        name: of the method.
        rtol, atol: tolerance of a step, relative to the state and to the scene's own scale.
        longest: longest step [rad of the excitation]; the step itself for rk4.
        budget: most steps tried in one cycle.
        reduce: leave out what the scene cannot need.
    """

    name: str
    rtol: float
    atol: float
    longest: float = 2 * np.pi / 12
    budget: int = 100_000
    reduce: bool = True

    def method(self) -> Method:
        """The method of this name."""
        return method_named(self.name, rtol=self.rtol, atol=self.atol)

    def control(self, stiffest: float) -> Control:
        """Its numbers for the event loop; ``stiffest``: fastest rate of the stuck structure over the excitation's."""
        stiffest = max(stiffest, 1.0)
        return Control(
            *(np.asarray(value, dtype=float) for value in (self.rtol, self.atol, self.longest)),
            opening=np.asarray(self.first_step(stiffest), dtype=float),
            budget=np.asarray(self.budget),
            stiffest=np.asarray(stiffest, dtype=float),
        )

    def first_step(self, stiffest: float) -> float:
        """Length of the first step of a cycle; the error control takes over from there."""
        return self.longest if self.name == "rk4" else min(0.02, 0.2 / max(stiffest, 1.0))

    def __str__(self) -> str:
        if self.name == "rk4":
            return f"rk4, {round(2 * np.pi / self.longest)} steps a cycle"
        return f"{self.name}, rtol {self.rtol:g}, atol {self.atol:g}"


PRESETS = {
    "draft": Solver("tsit5", 1e-5, 1e-7),
    "standard": Solver("tsit5", 1e-7, 1e-9),
    "reference": Solver("dopri8", 1e-11, 1e-13),
}


def solver_of(section: SolverSection) -> Solver:
    """The solver that a scene asks for."""
    if section.accuracy is not None:
        preset = PRESETS[section.accuracy]
        return Solver(preset.name, preset.rtol, preset.atol, preset.longest, section.max_steps, section.reduce)
    assert section.method is not None
    if section.method == "rk4":
        assert section.steps_per_cycle is not None
        step = 2 * np.pi / section.steps_per_cycle
        return Solver("rk4", 1e-8, 1e-10, step, section.max_steps, section.reduce)
    assert section.rtol is not None
    assert section.atol is not None
    return Solver(section.method, section.rtol, section.atol, budget=section.max_steps, reduce=section.reduce)
