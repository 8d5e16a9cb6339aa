"""Which method integrates a scene where none is given: the first line of a table that applies, if compiling it pays.

A method of the table pays where it saves more of the time that the preset's own method would take than its programs
take longer to compile, both in a first run. Short runs keep the method of the preset: sixty cycles of
the oscillator take 20 ms, its program 5 s. The rates of a scene are known beforehand, but not how often its contacts
switch.

Measured by `benchmarks/method_choice.py`: microseconds of a cycle at errors of 1e-4 and 1e-6, compiled, CPU seconds of
compilation by whole runs with an empty cache; the tables are in benchmarks/README.md.
"""

from dataclasses import dataclass, replace

import numpy as np

from timesim.model.cost import SLIPPING, Work, seconds, slip_steps, slip_stiff, stable_steps
from timesim.model.model import Model
from timesim.model.promise import PROMISE, preset, tightened
from timesim.model.reduction import reduction_of
from timesim.model.solver import CLOSED_FORM, Solver


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes:
        why: it is taken, in words.
        accuracies: presets at which it was measured.
        share: of the time that the preset's own method takes, in one run and in a sweep.
        compiling: CPU seconds that its programs take longer to compile, for one run and for a sweep.
        slippery: only where the direction of slip turns fast (`timesim.model.cost.slip_stiff`).
        passive: least ratio of the fastest rate of the stuck structure to what is none of its own motion by modes: that
            of its contacts (`contact_rate`), and of damping between the modes.
        fast: least ratio of the fastest rate of the stuck structure to the excitation's.
        dashpots: least ratio of the rate of damping between the modes to the highest circular frequency.
        largest: tolerance of a step.
    """

    method: str
    why: str
    accuracies: tuple[str, ...]
    share: tuple[float, float]
    compiling: tuple[float, float]
    slippery: bool = False
    passive: float = 0.0
    fast: float = 0.0
    dashpots: float = 0.0
    largest: float = 1.0

    def applies(self, model: Model, frequency: float) -> bool:
        """Whether it does by the rates of a model at a frequency [Hz]."""
        if self.slippery and not slip_stiff(model, frequency):
            return False
        if self.dashpots and model.coupling_rate < self.dashpots * model.stuck_omega[-1]:
            return False
        others = max(contact_rate(model), model.coupling_rate)
        return model.stuck_rate >= max(self.passive * others, self.fast * 2 * np.pi * frequency)


def contact_rate(model: Model) -> float:
    """Fastest rate that the contacts would have on the masses of the structure, without its springs [rad/time]."""
    alone = model.with_contacts(np.zeros((model.structure.num_modes,) * 2))
    return float(np.sqrt(max(np.linalg.eigvalsh(alone)[-1], 0.0)))


# 4 x 2: 110, 90, 410, 180 and 160, 130, 510, 230 against 220, 120, 520, 250 and 430, 230, 1,180, 390 by tsit5;
# 8 x 3: 530, 490, 560, 90 and 710, 730, 960, 120 against 810, 870, 520, 100 and 1,410, 1,790, 850, 190; contacts
# 1e4 times stiffer or a mode at 1,000 times: two fifths. The oscillator, hardly faster than it is driven: 76, 63,
# 44 and 87, 78, 44 against 60, 39, 30 and 75, 61, 43. Sweeps of twelve structures of tests/zoo.py, 2 x 1 to 8 x 3: 0.66
# to 1.02 of the time of tsit5, in the middle 0.86; of the blade with 12 modes 0.84. A run compiles 0.1 to 0.8 s longer
# than by tsit5; a sweep, on a machine of half the speed, from 1.3 s less to 3.3 s more (benchmarks/compile_time.py).
DOPRI8 = Line(
    method="dopri8",
    why="of order 8, it takes about half of the time of tsit5 where the structure is faster than its excitation",
    accuracies=("draft", "standard"),
    share=(0.6, 0.8),
    compiling=(2.0, 1.0),
    fast=1.5,
)
TABLE = (
    # 4 modes, 2 contacts, friction 1e-2 to 1e-4, where slip asks for 350 to 1e6 steps (20 structures that slip): 300 to
    # 1,600 at rtol 1e-7 against 800 to 90,000 by tsit5, of which two run out of steps; dopri8 takes as long. Where it
    # asks for 90: 330 and 450 against 240 and 340. At 1e-5 and 1e-6 four of 30 runs crept without end (mended since).
    # Stiff contact, mu 0.6 under steady load, 1e4 times stiffer, 4 x 2: 61 ms against 91 by tsit5 and 126 by dopri8.
    Line(
        method="exponential",
        why="slip under little friction force asks explicit methods for very short steps",
        accuracies=("draft", "standard", "reference"),
        share=(0.2, 0.2),
        compiling=(7.0, 20.0),
        slippery=True,
        largest=1e-7,
    ),
    # Chains of masses with a damper between two, ms a cycle (benchmarks/dampers.py): 10,000 times as fast as all
    # vibrations, 4 masses, 16 for 2e-7 against 140 for 5e-7 by tsit5. 1,000 times as fast, 12 masses, 26 for 5e-8
    # against 16 for 4e-11 by dopri8; collocation, to which such damping is one more force, 400.
    Line(
        method="kvaerno5",
        why="dampers that couple its modes are far faster than its vibrations, and explicit steps follow them",
        accuracies=("draft", "standard"),
        share=(0.6, 0.8),
        compiling=(5.0, 23.0),
        fast=4000.0,
        dashpots=10.0,
    ),
    # Modes to 40 times the excitation with contacts as soft as the first: 20 x 3 470 and 520 against 720 and 1,130 by
    # tsit5, 820 and 1,060 by dopri8; 50 x 10 2,670 and 2,680 against 2,140 and 3,790, 2,550 and 3,570; the blade with
    # 24 modes 1,630 and 4,180 against 5,950 and 8,130, 2,880 and 3,460. Where contacts are as stiff as the fastest
    # modes (a ratio of 1 to 4) dopri8 takes a half to a quarter of it: 50 x 10, generated, 2,100 and 2,970 against
    # 8,180 and 11,700. In a sweep the derivatives of its cycles take longer than its steps save: three points of
    # tests/data/many_modes.yaml, 5.5 s against 3.0.
    Line(
        method="exponential",
        why="the structure is far faster than its contacts, and its own motion needs no steps",
        accuracies=("draft", "standard"),
        share=(0.6, 1.0),
        compiling=(7.0, 20.0),
        passive=6.0,
        fast=10.0,
    ),
    DOPRI8,
)


BETWEEN = 1e-3
"""Share of the promise that a motion in closed form may err by between the ends of its steps."""
LINEAR = "no contact ever leaves its state, so the motion is linear and known over any time"
UNSEEN = "the motion is linear, but holds vibrations too fast to be followed one by one"


@dataclass(frozen=True)
class Choice:
    """A solver, and why it is taken, in words."""

    solver: Solver
    why: str


def choice(accuracy: str, model: Model, work: Work, budget: int, *, reduce: bool = True) -> Choice:
    """The solver that keeps what a preset promises in the least time, that of a first run.

    ``accuracy`` names the preset, ``work`` says what is integrated, ``budget`` how many steps a cycle may take,
    ``reduce`` whether what is proven to have no effect is left out. A run of which no contact is left needs no method.
    """
    frequencies = [frequency for frequency, _ in work.phases]
    own, frequency = preset(accuracy, model, work.lowest, work.run_cycles), float(np.mean(frequencies))
    if not work.sweep and not reduction_of(model, frequencies, reduce=reduce).live.size:
        if stable_steps(model, work.lowest) > budget:
            return Choice(replace(own, name="exponential"), UNSEEN)
        left = BETWEEN * PROMISE[accuracy]
        return Choice(Solver(CLOSED_FORM, left, left / 100), LINEAR)
    hopeless = max(stable_steps(model, frequency), SLIPPING * slip_steps(model, frequency)) > budget
    lines = [line for line in TABLE if accuracy in line.accuracies and line.applies(model, frequency)]
    # A line that saves nothing in a sweep leaves it to the next, unless explicit steps would run out.
    line = next((line for line in lines if line.share[work.sweep] < 1 or hopeless), None)
    if line is None or line.method == own.name:
        return Choice(own, f"the method of accuracy {accuracy}, no other being much quicker on such a structure")
    saved, compiling = (1 - line.share[work.sweep]) * seconds(model, own, work), line.compiling[work.sweep]
    if saved <= compiling and not (hopeless and line.method in ("exponential", "kvaerno5")):
        shorter = f"{line.method} would save about {saved:.1g} s and take {compiling:g} s longer to compile"
        return Choice(own, f"the method of accuracy {accuracy}, since {shorter}")
    taken = tightened(own, line.largest / own.rtol)
    return Choice(replace(taken, name=line.method), line.why)
