"""About how long an integration and a harmonic balance take, from figures measured on one core of a server.

    python benchmarks/cost.py           2 to 50 modes: a step within a factor of 2, a derivative of 1.8
    python benchmarks/accuracy.py       steps of a cycle: those of the oscillator, the blade and 20 modes

Another machine, separation within the cycle and many transitions change them by a factor of two or three.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from timesim.model.model import Model
from timesim.model.solver import CLOSED_FORM, COMPANION, PRESETS, Criterion, Solver

REACH = 3.3
"""Largest |eigenvalue| times step at which an explicit fifth-order method stays stable on an oscillation."""
EXPLICIT = ("tsit5", "dopri5", "dopri8", "rk4")
"""Methods whose steps stability bounds."""
STEPS = {"draft": (38, 2.3), "standard": (75, 4.9), "reference": (63, 7.0)}
"""Steps of a cycle: for accuracy alone, and beside them for each one that stability asks for."""
STABLE = STEPS["draft"][1]
"""Fewest steps for each one that stability asks for, by any tolerance.

By dopri8 at rtol 2.9e-9 on a six-mode beam, 115 times as fast as its excitation, up to 2.8; by the tolerance 3.5."""
RECORDED, MARCHED = (1.7, 0.65), (0.25, 0.5)
"""Microseconds of a step of tsit5, and for the root of the number of modes times contacts: of a run that is recorded,
of one that is marched to a steady state."""
WIDE = 20
"""Modes times contacts from which on the stages of an explicit step are turns of a loop, which compiles for less."""
FOLLOWED = 40
"""Steps of a cycle by which a motion in closed form is recorded."""
STAGES = {
    CLOSED_FORM: 0.35,
    "tsit5": 1.0,
    "dopri5": 1.0,
    "rk4": 0.6,
    "dopri8": 1.9,
    "kvaerno5": 80.0,
    "exponential": 0.6,
}
"""Work of a step over that of tsit5; of `exponential`, of a cycle (benchmarks/method_choice.py, dampers.py)."""
SLIP_STIFF = (120.0, 5.0)
"""Least steps of a cycle that the direction of slip asks for, and the least multiple of those that stability asks for,
from which on it rules the time of an explicit method (benchmarks/method_choice.py)."""
STEADY = 0.1
"""Share of a preload up to which the motion hardly changes it, and what counts is mu n, not mu: a contact that slides
takes these steps. At mu n = 0.5, k 50, 500 and 5,000 times as stiff as the structure, and 1.6 times the force that
makes it slide, 0.4, 2 and 18 ms a cycle by tsit5, 0.56, 0.52 and 0.65 by collocation."""
LITTLE_FRICTION = 0.05
"""Coefficient up to which it does where the load varies; with more a contact is mostly apart or sticks."""
SLIPPING = 0.4
"""Steps that the direction of slip is seen to take, as a share of those that it asks for at its fastest."""
SETTLING = 0.002
"""Seconds of a steady state beside its cycles: what is left out, amplitudes, multipliers."""
DERIVATIVE = (0.002, 0.8)
"""Seconds of a cycle with the derivative of its end by its start, and for each state, as a share of a cycle without."""
SHOTS = 8
"""Cycles of Newton's method, beside those that are marched before it is tried."""
SOLUTIONS, MANY_SOLUTIONS = 200, 2500
"""Solutions on a curve of harmonic balance: of one that takes few harmonics, and the most of generated structures."""


@dataclass(frozen=True)
class Work:
    """What is integrated in time.

    Attributes:
        phases: frequencies [Hz], and how many cycles at each; of a sweep its mean, and the cycles of all points.
        lowest: of all frequencies.
        sweep: whether it is marched to steady states; else it is one run, and recorded.
        again: time that it takes as a multiple of that of its cycles, a second run being made to estimate its error.
    """

    phases: tuple[tuple[float, float], ...]
    lowest: float
    sweep: bool = False
    again: float = 1.0

    @classmethod
    def of_run(cls, phases: tuple[tuple[float, int], ...], *, estimated: bool) -> "Work":
        """One run through phases, its error estimated or not."""
        return cls(phases, min(phases)[0], again=1 + COMPANION * estimated)

    @property
    def run_cycles(self) -> float | None:
        """Cycles of a run; None where it goes on until it is steady."""
        return None if self.sweep else sum(cycles for _, cycles in self.phases)


def stable_steps(model: Model, frequency: float) -> float:
    """Explicit steps of a cycle at a frequency [Hz] that stability alone asks for."""
    return model.stuck_rate / (REACH * frequency)


def slip_rates(model: Model, frequency: float) -> np.ndarray:
    """Rate k|u'|/(mu n) at which the direction of slip turns in each contact, about, shape (C,) [rad/time].

    By the response to the excitation at a frequency [Hz] with the contacts closed along their normals and free to
    slide. It is 0 where nothing slides, or only along a line, and of a gap that the response without it does not close.
    """
    shapes, normal_stiffness = model.contact_shape, model.normal_stiffness
    speed, press = _sliding(model, frequency, np.ones(model.num_contacts, dtype=bool))
    _, reach = _sliding(model, frequency, model.preload > 0)
    touches = (model.preload > 0) | (model.preload + normal_stiffness * reach > 0)
    normal = model.friction * (np.maximum(model.preload, 0.0) + normal_stiffness * press)
    turns = np.array([np.linalg.matrix_rank(shape[:2]) == 2 for shape in shapes], dtype=bool)
    stiffest = np.linalg.eigvalsh(model.tangential_stiffness)[:, -1:].sum(axis=1)
    with np.errstate(over="ignore"):
        return np.divide(stiffest * speed, normal, out=np.zeros_like(normal), where=turns & touches & (normal > 0))


def stiff_rates(model: Model, frequency: float) -> np.ndarray:
    """The same of the contacts that are known to slide under little load, 0 of the others."""
    _, press = _sliding(model, frequency, np.ones(model.num_contacts, dtype=bool))
    steady = (model.preload > 0) & (model.normal_stiffness * press <= STEADY * model.preload)
    slides = _held(model, frequency) > model.friction * model.preload
    counted = np.where(steady, slides, model.friction <= LITTLE_FRICTION)
    return np.where(counted, slip_rates(model, frequency), 0.0)


def _sliding(model: Model, frequency: float, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest tangential speed and normal displacement of each contact, some being closed along their normals."""
    speed, press = np.zeros((2, model.num_contacts))
    normals = model.contact_shape[closed, 2]
    for turn, response, _ in _responses(model, frequency, normals, model.normal_stiffness[closed]):
        motion = model.contact_shape @ response
        speed += turn * np.linalg.norm(motion[:, :2], axis=1)
        press += np.abs(motion[:, 2])
    return speed, press


def _held(model: Model, frequency: float) -> np.ndarray:
    """Largest tangential force on each contact, all of them sticking."""
    stiffness, turned = np.linalg.eigh(model.tangential_stiffness)
    shapes = model.contact_shape
    axes = np.concatenate([turned.transpose(0, 2, 1) @ shapes[:, :2], shapes[:, 2:]], axis=1)
    along = np.column_stack([stiffness, model.normal_stiffness]).ravel()
    force = np.zeros(model.num_contacts)
    for _, _, forces in _responses(model, frequency, axes.reshape(-1, model.structure.num_modes), along):
        force += np.linalg.norm(forces.reshape(-1, 3)[:, :2], axis=1)
    return force


def _responses(
    model: Model, frequency: float, axes: np.ndarray, stiffness: np.ndarray
) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Circular frequency of each harmonic, the response to it with springs along some axes, and their forces."""
    body, load = model.structure, model.excitation
    damping = np.diag(body.damping) if body.damping.ndim == 1 else body.damping
    springs = stiffness >= np.finfo(float).tiny  # of less the inverse overflows
    axes, compliance = axes[springs], 1 / stiffness[springs]
    for order, force in zip(load.harmonic, load.cosine - 1j * load.sine, strict=True):
        turn = 2 * np.pi * frequency * order
        # No resonance is without bound: a little of each stiffness is taken for damping.
        dynamic = np.diag(body.stiffness * (1 + 1e-3j) - turn**2 * body.mass) + 1j * turn * damping
        free, pressed = np.linalg.solve(dynamic, force), np.linalg.solve(dynamic, axes.T)
        # Contacts as loads, not as stiffness: one of 1e100 would drown the structure in rounding.
        gap = axes @ pressed
        gap += np.diag(np.maximum(compliance, 1e-9 * np.abs(gap.diagonal())) / (1 + 1e-3j))
        forces = np.zeros(springs.size, complex)
        forces[springs] = np.linalg.solve(gap, axes @ free)
        yield turn, free - pressed @ forces[springs], forces


def slip_steps(model: Model, frequency: float) -> float:
    """Explicit steps of a cycle at a frequency [Hz] that the direction of slip asks for, where it is known to."""
    return float(stiff_rates(model, frequency).max(initial=0.0)) / (REACH * frequency)


def slip_stiff(model: Model, frequency: float) -> bool:
    """Whether the direction of slip asks for far more explicit steps than the structure does at a frequency [Hz]."""
    least, multiple = SLIP_STIFF
    return slip_steps(model, frequency) >= max(least, multiple * stable_steps(model, frequency))


def steps_for(solver: Solver) -> tuple[float, float]:
    """Steps of a cycle that its tolerance asks for, and how many beside them for each one that stability asks for."""
    high = solver.name == "dopri8"  # of the eighth order as `reference` is; the others as draft and standard, the fifth
    alike = [name for name, preset in PRESETS.items() if (preset.name == "dopri8") == high]
    near = min(alike, key=lambda name: abs(np.log(PRESETS[name].rtol / solver.rtol)))
    finer = (PRESETS[near].rtol / solver.rtol) ** (1 / 8 if high else 1 / 5)
    return finer * STEPS[near][0], max(finer * STEPS[near][1], STABLE)


def seconds_a_cycle(model: Model, solver: Solver, frequency: float, *, marched: bool = False) -> float:
    """Of a cycle at a frequency [Hz], marched to a steady state or of a run that is recorded."""
    steps = 2 * np.pi / solver.longest
    if solver.name == CLOSED_FORM:
        steps = FOLLOWED
    elif solver.name != "rk4":
        least, multiple = steps_for(solver)
        asked = float(model.stuck_omega[-1]) if solver.name == "kvaerno5" else model.stuck_rate
        steps = least + multiple * asked / (REACH * frequency)
        steps = max(steps, SLIPPING * slip_steps(model, frequency) * (solver.name != "exponential"))
    each, share = MARCHED if marched else RECORDED
    size = model.structure.num_modes * model.num_contacts
    return float(1e-6 * STAGES[solver.name] * steps * (each + share * np.sqrt(size)))


def seconds_a_derivative(model: Model, solver: Solver, frequency: float) -> float:
    """Of a cycle at a frequency [Hz] with the derivative of its end by its start, as it is shot or measured."""
    least, share = DERIVATIVE
    states = 2 * (model.structure.num_modes + model.num_contacts)
    return least + share * states * seconds_a_cycle(model, solver, frequency, marched=True)


def seconds(model: Model, solver: Solver, work: Work) -> float:
    """Of all cycles."""
    each = (cycles * seconds_a_cycle(model, solver, f, marched=work.sweep) for f, cycles in work.phases)
    return work.again * sum(each)


def cycles_to_settle(model: Model, criterion: Criterion, frequency: float) -> int:
    """Cycles at a frequency [Hz] in which what settles most slowly has done so to the tolerance, or is shot."""
    marched = -math.log(criterion.tolerance) * frequency / max(model.structure.settling, 1e-300)
    return int(np.ceil(min(marched, criterion.first_shot + SHOTS, criterion.max_cycles)))


def seconds_a_solution(model: Model, harmonics: int, time_samples: int, *, stability: bool) -> float:
    """Of a solution of a harmonic balance, with multipliers or without (benchmarks/harmonic_balance.py --estimates).

    The law takes time for each sample, as do the multipliers with all states; the matrix of the derivatives for each of
    its entries.
    """
    contacts, states = model.num_contacts, 2 * model.structure.num_modes + model.num_contacts
    unknowns = 3 * contacts * (2 * harmonics + 1)
    each = 7 + 3 * (contacts - 1) + stability * ((2.4 + 0.016 * states) * contacts + 1.2e-3 * states**2)
    return 1e-3 * (each * (0.2 + 0.8 * time_samples / 256) + 2.6e-5 * unknowns**2)
