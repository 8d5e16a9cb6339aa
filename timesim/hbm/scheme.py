"""Numerical scheme of a harmonic balance, steps along its curves, and the models that allow one.

Checks of a scene import it: no JAX here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from timesim.model.model import Model

MIN_SAMPLES = 16
# With so many samples of the shortest wave, and of the period, the contact forces of most generated structures err by
# less than 1e-5 (benchmarks/samples.py), a tenth of what harmonics may leave out, and those under the motions of
# tests/hbm/test_period.py by less than 1e-6 of the largest.
SAMPLES_PER_WAVE, ENOUGH_SAMPLES = 16, 256
# Where the program chooses them: harmonics at first, and those that are tried after them; unknowns at most, beyond
# which a solution takes a second.
FIRST_HARMONICS, MORE_HARMONICS, MOST_UNKNOWNS = 9, (13, 19, 27, 39, 57, 81), 2000
# Share of the amplitude that harmonics above those balanced may add, and from which on that is said, with what they
# change in those below.
NEGLECTED, NOTED = 1e-4, 3e-4


class BalanceError(ValueError):
    """A balance that cannot be set up: the key, the rule that it breaks, its value and what to do."""

    def __init__(self, key: str, rule: str, value: object, hint: str):
        super().__init__(f"hbm: {key} {rule}{'' if value is None else f', not {value}'}; {hint}")
        self.key, self.rule, self.value, self.hint = key, rule, value, hint


@dataclass(frozen=True)
class Scheme:
    """Numerical scheme of a balance.

    Attributes:
        harmonics: H >= 1, the highest one balanced.
        time_samples: N, samples of a period at which contact forces are evaluated, at least 4 H and 16. The error is
            of third order in 1/N.
    """

    harmonics: int = 9
    time_samples: int = 256

    def __post_init__(self) -> None:
        if self.harmonics < 1:
            raise BalanceError("harmonics", "must be at least 1", self.harmonics, "9 is the default")
        least = max(4 * self.harmonics, MIN_SAMPLES)
        if self.time_samples < least:
            rule = f"must be at least {least} for {self.harmonics} harmonics"
            raise BalanceError("time_samples", rule, self.time_samples, "the default is enough")

    def __str__(self) -> str:
        count = f"{self.harmonics} harmonic{'s' * (self.harmonics > 1)}"
        return f"harmonic balance, {count}, {self.time_samples} time samples"


@dataclass(frozen=True)
class Controls:
    """How a curve is followed. Lengths of arc are shares of the range of p and of the size of x.

    Attributes:
        size: unit of x where its norm is smaller, else x is measured by its norm, both about the centre of a `Centred`
            residual. The default suits a balance, whose unknowns are in the scene's own unit of length.
        first_step, min_step, max_step: length of arc of a step.
        max_points: points after which the curve is given up.
        tolerance: norm of the residual at a solution, relative to the size of x.
        max_newton: iterations for one point.
        turn: turn of the tangent over a step at which the step is neither lengthened nor shortened [rad].
        place: a value of p in messages.
        longest: how far along p a step leads at most from a value of it and the unknowns there.
        watch: called after each point with the share of the range that the curve has reached, and what gives it so far.
    """

    size: float = 0.1
    first_step: float = 0.01
    min_step: float = 1e-8
    max_step: float = 0.05
    max_points: int = 5000
    tolerance: float = 1e-9
    max_newton: int = 8
    turn: float = 0.3
    place: str = "{:.10g}"
    longest: Callable[[float, np.ndarray], float] | None = None
    watch: Callable[[float, Callable[[], Any]], None] | None = None

    def __post_init__(self) -> None:
        steps = (self.min_step, self.first_step, self.max_step)
        for obeyed, rule, values in (
            (self.size > 0 and self.tolerance > 0, "size and tolerance must be positive", (self.size, self.tolerance)),
            (0 < steps[0] <= steps[1] <= steps[2], "steps must obey 0 < min_step <= first_step <= max_step", steps),
            (self.max_points >= 2, "max_points must be at least 2", (self.max_points,)),
            (self.max_newton >= 1, "max_newton must be at least 1", (self.max_newton,)),
        ):
            if not obeyed:
                raise ValueError(f"continuation: {rule}, not {', '.join(map(str, values))}")


def enough_samples(harmonics: int) -> int:
    """Samples that suit a number of harmonics."""
    return max(ENOUGH_SAMPLES, SAMPLES_PER_WAVE * harmonics)


def most_harmonics(num_contacts: int) -> int:
    """Harmonics that the program chooses at most."""
    return max(FIRST_HARMONICS, min(MORE_HARMONICS[-1], (MOST_UNKNOWNS // (3 * num_contacts) - 1) // 2))


def first_scheme(harmonics: int | Literal["auto"], time_samples: int | Literal["auto"]) -> Scheme:
    """The one to begin with."""
    count = FIRST_HARMONICS if harmonics == "auto" else harmonics
    return Scheme(count, enough_samples(count) if time_samples == "auto" else time_samples)


def finer_schemes(first: Scheme, model: Model, *, choose_samples: bool) -> tuple[Scheme, ...]:
    """A scheme with all excited harmonics of a model, and those with more that the program may take after it.

    ``choose_samples``: take as many samples as suit each number of harmonics, else as few as it allows.
    """
    least, most = max(first.harmonics, highest_excited(model)), most_harmonics(model.num_contacts)
    counts = [least, *(count for count in MORE_HARMONICS if least < count < most)]
    counts += [most] if most > least else []
    samples = enough_samples if choose_samples else lambda count: 4 * count
    return tuple(Scheme(count, max(first.time_samples, samples(count))) for count in counts)


def coarsest(schemes: Sequence[Scheme], motion: np.ndarray) -> int:
    """Which of several schemes, coarsest first, is the first that has all harmonics of a motion; the last one has.

    ``motion``: coefficients 1, cos, sin, ... of any components, shape (..., 2H + 1).
    """
    used = np.flatnonzero(motion.reshape(-1, motion.shape[-1]).any(axis=0))
    highest = int(used[-1]) if used.size else 0
    return next(place for place, own in enumerate(schemes) if highest <= 2 * own.harmonics)


def highest_excited(model: Model) -> int:
    """The highest harmonic of the excitation; 0 where nothing is periodic."""
    excited = model.excitation
    moving = np.any(excited.cosine != 0, axis=1) | np.any(excited.sine != 0, axis=1)
    return int(excited.harmonic[moving].max(initial=0))


def check_model(model: Model, harmonics: int | None) -> None:
    """Refuse a model without contacts or periodic excitation, or with excited harmonics that are not balanced.

    ``harmonics``: those balanced; None: as many as are needed.

    Raises:
        BalanceError: the model allows no balance.
    """
    if not model.contacts:
        rule = "must hold at least one contact, since the response without is linear"
        raise BalanceError("contacts", rule, None, "a sweep gives the linear response")
    highest = highest_excited(model)
    if not highest:
        rule = "moves no mode periodically, so there is no periodic response to balance"
        hint = (
            "give excitation.modal_force an amplitude, or one of excitation.forces, along which a mode moves its point"
        )
        raise BalanceError("excitation", rule, None, hint)
    if harmonics is not None and highest > harmonics:
        rule = f"must be at least {highest}, since harmonic {highest} is excited"
        raise BalanceError("harmonics", rule, harmonics, f"set harmonics to at least {highest}")
