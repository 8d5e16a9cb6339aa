"""Guesses for the first solution of a curve, the cheapest first; a motion of time integration always exists."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from timesim.engine.status import RunError
from timesim.hbm.adaptive import AdaptiveBalance
from timesim.hbm.balance import Array, Balance, contact_stiffness
from timesim.hbm.condensation import Condensation
from timesim.hbm.continuation import Controls, Curve, Ending, follow
from timesim.model.solver import PRESETS, Criterion
from timesim.orbit.cycle import modal_coefficients
from timesim.orbit.fourier import to_coefficients
from timesim.orbit.settling import Chain, steady_states

RAMP_POINTS = 200
RAMP_STEPS = 4  # length of its longest step, by that of a curve: only its end matters
DIFFERENCE = 1e-6  # for the derivative by the share of the ramp, which only directs its steps
STAYS = 2  # solutions up to which a curve that fails has not come away from where it began
SOLVER, SETTLED = PRESETS["standard"], Criterion(1e-6, 500)
"""How the motion of a time integration is sought; Newton's method needs it no closer."""


def unknowns_of_modes(balance: Balance, modal: Array) -> Array:
    """Unknowns of a balance from modal Fourier coefficients 1, cos, sin, ..., shape (2K + 1, M)."""
    num_modes = balance.model.structure.num_modes
    if modal.ndim != 2 or modal.shape[0] % 2 == 0 or modal.shape[1] != num_modes:
        rule = f"1, cos, sin, ... of each mode, an odd number of rows and {num_modes} columns"
        raise ValueError(f"hbm: the guess must hold {rule}, not shape {modal.shape}")
    kept = np.zeros((balance.size, num_modes))
    kept[: len(modal)] = modal[: balance.size]
    shape = balance.model.contact_shape.reshape(3 * balance.num_contacts, -1)
    return np.asarray((shape @ kept.T).ravel() / balance.length)


def curve_near(
    adaptive: AdaptiveBalance,
    p: float,
    frequency: float,
    controls: Controls,
    guess: Array | None,
    followed: Callable[[Array], Curve],
) -> Curve:
    """The curve through a solution near a modal guess, or else near the first of `first_guesses` that leads to one.

    To one that does not lack much of what harmonics add (`AdaptiveBalance.refuses`), and from which the curve goes on,
    if any of them does: beside few harmonics there may be a solution where the curve has none.

    Args:
        p, frequency: where the curve begins: the parameter, and the frequency of the excitation [Hz].
        guess: modal Fourier coefficients 1, cos, sin, ....
        followed: the curve from a guess of the unknowns.
    """
    coarse, fine = (adaptive.residual_of(adaptive.schemes[place]).at(p) for place in (0, -1))
    if guess is not None:
        return followed(unknowns_of_modes(fine, guess))
    tried, poor, stays = [], [], list[Curve]()
    adaptive.demanding = True
    for way, first in first_guesses(coarse, frequency, controls, fine):
        tried.append(way)
        if first is not None:
            whole = first if first.size == fine.num_unknowns else adaptive.whole(first)
            curve = followed(whole)
            if _goes_on(curve):
                return curve
            poor += [whole] * adaptive.refused
            stays += [curve] * bool(curve.p.size)
    adaptive.demanding = False
    if poor and (_goes_on(curve := followed(poor[0])) or not stays):
        return curve
    curve = stays[0] if stays else curve
    return replace(curve, message=f"{curve.message}; tried: {', '.join(tried)}")


def _goes_on(curve: Curve) -> bool:
    """Whether a curve has come away from where it began."""
    return curve.ending is not Ending.START and (curve.ending is not Ending.STEP or curve.p.size > STAYS)


Guess = tuple[str, Array | None]
"""A way to a first solution in words, and where it leads to; None if it leads nowhere."""


def first_guesses(
    balance: Balance, frequency: float, controls: Controls, fine: Balance | None = None
) -> Iterator[Guess]:
    """Linear responses, a load that grows from zero while damping leaves, and the motion of a time integration.

    The last one, to which it settles, has the unknowns of a finer balance, if one is given: it may be far from any
    solution with few of them.
    """
    closed = np.array([contact.preload > 0 for contact in balance.model.contacts], dtype=float)
    states = {
        "stuck where they are closed at rest": closed,
        "all stuck": np.ones_like(closed),
        "absent": np.zeros_like(closed),
        "half as stiff where they are closed at rest": closed / 2,
    }
    tried: set[tuple[float, ...]] = set()
    for way, stuck in states.items():
        if tuple(stuck) not in tried:
            tried.add(tuple(stuck))
            yield f"the linear response with contacts {way}", _linear_guess(balance, frequency, stuck)
    yield _ramped(balance, frequency, controls)
    yield _settled(fine or balance, frequency)


def _ramped(balance: Balance, frequency: float, controls: Controls) -> Guess:
    most, longest = min(controls.max_points, RAMP_POINTS), RAMP_STEPS * controls.max_step
    # What limits steps along the frequency is none of the load's.
    few = replace(controls, max_points=most, max_step=longest, longest=None, watch=None)
    ramp = follow(_Ramp(balance, frequency), np.zeros(balance.num_unknowns), 0.0, 1.0, few)
    if ramp.ending is Ending.INTERRUPTED:
        raise KeyboardInterrupt
    reached = int(100 * ramp.p[-1]) if ramp.p.size else 0
    way = f"a load that grows from zero while damping leaves, {reached}% of the way"
    return way, ramp.x[-1] if ramp.complete else None


def _settled(balance: Balance, frequency: float) -> Guess:
    """The last cycle of a march: of a motion that has not settled, or repeats after several cycles, a guess too."""
    model = balance.model
    ((orbit,),) = steady_states([Chain(model, (frequency,))], SOLVER, SETTLED)
    if orbit.reason is not None:
        return f"time integration, which fails ({orbit.reason})", None
    if orbit.drift.any():
        return "time integration, whose body drifts, as nothing holds it", None
    kind = f"which does not settle in {SETTLED.max_cycles} cycles"
    if orbit.settled:
        kind = "which settles" if orbit.period == 1 else f"which repeats after {orbit.period} cycles"
    try:
        modal = modal_coefficients(replace(model, start=orbit.end), frequency, SOLVER)
    except RunError as error:
        return f"time integration, which fails ({error})", None
    return f"time integration, {kind}", unknowns_of_modes(balance, modal)


def _linear_guess(balance: Balance, frequency: float, stuck: Array) -> Array:
    """Linear response with each contact stuck (1), absent (0) or in between."""
    linear, stiffness = balance.linear(frequency), contact_stiffness(balance.model, stuck)
    matrix = np.eye(len(stiffness)) + linear.flexibility @ (stiffness - balance.support)
    try:
        motion = np.linalg.solve(matrix, linear.free[..., None])[..., 0]
    except np.linalg.LinAlgError:
        motion = np.zeros_like(linear.free)
    return np.nan_to_num(to_coefficients(motion.T).ravel() / balance.length, posinf=0.0, neginf=0.0)


class _Ramp:
    """A balance at one frequency as a residual in p: to 1 its load grows from zero, and damping beside its own leaves.

    Critical damping at first: motions that are damped grow straight, where without it they turn at many folds.
    """

    def __init__(self, balance: Balance, frequency: float):
        self.balance, self.frequency = balance, frequency
        self.critical = 2 * (balance.model.structure.omega + 2 * np.pi * frequency)
        self.at = lru_cache(maxsize=2)(self._at)

    def _at(self, p: float) -> tuple[Balance, Array]:
        """The balance under the whole load, and what the rest of it does to the motion without contact forces."""
        left = (1 - p) ** 2
        balance = self.balance.damped(left * self.critical)
        return balance, left * to_coefficients(balance.linear(self.frequency).free.T).ravel() / balance.length

    def value(self, x: Array, p: float) -> Array:
        balance, missing = self.at(p)
        return balance.value(x, self.frequency) + missing

    def linearised(self, x: Array, p: float) -> tuple[Array, Condensation, Array]:
        balance, missing = self.at(p)
        r, by_x, _ = balance.linearised(x, self.frequency)
        return r + missing, by_x, (self.value(x, p + DIFFERENCE) - r - missing) / DIFFERENCE
