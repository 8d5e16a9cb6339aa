"""All curves of one model: those from both ends of a range, and isolated ones through motions by time integration."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from timesim.hbm.balance import Array, Balance
from timesim.hbm.continuation import SAME, Controls, Curve, Ending, Solution, crossings, solve
from timesim.hbm.curve import HbmCurve, evaluated, hbm_curve, schemes_of
from timesim.hbm.first_guess import unknowns_of_modes
from timesim.hbm.scheme import Scheme
from timesim.hbm.stability import sign_with_offsets_kept
from timesim.hbm.tangent import compile_offsets, compile_slopes, linearised
from timesim.model.model import Model

# Difference of amplitudes, relative to the largest, up to which a curve passes through a motion.
NEAR = 0.05
# Share of the longest step, where that led onto another branch.
SHORTER = 0.5
# Of the frequency: by how much an end of the range may be missed, by rounding.
ROUNDED = 1e-12
# What a curve ends with that may be passed from the other end of the range.
FAILED = (Ending.START, Ending.STEP, Ending.AGAIN, Ending.UNBOUNDED)


@dataclass(frozen=True)
class SettledMotion:
    """A motion that repeats each cycle, by time integration.

    Attributes:
        frequency: of the excitation [Hz].
        amplitude: (max - min) / 2 of each point along x, y, z, shape (P, 3).
        coefficients: computes its modal displacement by 1, cos, sin, ..., shape (2K + 1, M), or None where it cannot.
    """

    frequency: float
    amplitude: Array
    coefficients: Callable[[], Array | None]


def warm_up(model: Model, frequency: float, scheme: Scheme, *, stability: bool = True) -> None:
    """Compile what curves take, whatever their contacts do at a frequency [Hz]; arguments as of `hbm_curve`."""
    balance, end, controls = Balance(model, frequency, scheme), 1.001 * frequency, Controls(max_points=2)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(compile_slopes, balance.law)
        pool.submit(compile_offsets, balance.law, balance.basis)
        curve = hbm_curve(model, frequency, end, scheme=scheme, controls=controls, stability=stability)
        if curve.ending is Ending.INTERRUPTED:
            raise KeyboardInterrupt
        # Of the contacts alone: at this frequency the structure may be in resonance without damping.
        linearised(balance.law, balance.basis, balance.coefficients(balance.working))


def curves_from_ends(model: Model, start: float, stop: float, *, both: bool, **options: Any) -> list[HbmCurve]:
    """The curve from one end of a range, and that from the other end if it is another.

    Arguments as of `timesim.hbm.curve.hbm_curve`. ``both``: begin at the other end too in any case, not only where the
    first curve turns back to where it began, or fails.
    """
    there = _followed(model, start, stop, **options)
    if there.ending is Ending.INTERRUPTED or not (both or there.ending in (Ending.LEFT, *FAILED)):
        return [there]
    message = f"{there.message}; {Ending.INTERRUPTED.value} at the other end of the range"
    cut = replace(there, ending=Ending.INTERRUPTED, message=message)
    try:
        back = _followed(model, stop, start, **options)
    except KeyboardInterrupt:
        return [cut]
    if there.complete and _meet(there, -1, back, 0):
        return [cut if back.ending is Ending.INTERRUPTED else there]
    if back.complete and (there.ending is Ending.START or _meet(there, 0, back, -1)):
        return [_instead_of(there, back)]
    return [_whole_beside(there, back), _whole_beside(back, there)]


def _whole_beside(curve: HbmCurve, other: HbmCurve) -> HbmCurve:
    """A curve, whole also if it turned back to where it began where that from the other end, another one, is whole."""
    if curve.ending is not Ending.LEFT or not other.complete:
        return curve
    place = curve.message.split(": ")[0]
    return replace(curve, ending=Ending.RETURNED, message=f"{place}: {Ending.RETURNED.value}")


def _instead_of(there: HbmCurve, back: HbmCurve) -> HbmCurve:
    """A curve from the other end that has the whole of one; it says why that one has not, if it failed."""
    if there.ending not in FAILED:
        return back
    whole = back.message.replace(back.ending.value, Ending.BACKWARDS.value)
    return replace(back, ending=Ending.BACKWARDS, message=f"{whole}; from the first one: {there.message}")


def _followed(model: Model, start: float, stop: float, **options: Any) -> HbmCurve:
    """The curve from one end; once more in shorter steps where a step has led it onto another branch, a closed one."""
    curve = hbm_curve(model, start, stop, **options)
    if curve.ending is not Ending.AGAIN:
        return curve
    controls = options.get("controls", Controls())
    finer = replace(controls, max_step=SHORTER * controls.max_step)
    # Processes know of the longer steps alone.
    own = {name: value for name, value in options.items() if name != "aside"}
    other = hbm_curve(model, start, stop, **own | {"controls": finer})
    return other if other.complete or other.ending is Ending.INTERRUPTED else curve


def isolated_curves(
    model: Model,
    curves: Sequence[HbmCurve],
    motions: Sequence[SettledMotion],
    span: tuple[float, float],
    *,
    scheme: Scheme | Sequence[Scheme],
    **options: Any,
) -> Iterator[HbmCurve]:
    """Curves through settled motions that no other curve passes.

    Args:
        curves: those followed before.
        motions: by time integration; any outside the span are ignored, those at its ends are not.
        span: range of the curves [Hz]; what follows is as of `timesim.hbm.curve.hbm_curve`.
    """
    known = list(curves)
    low, high = min(span) * (1 - ROUNDED), max(span) * (1 + ROUNDED)
    left = [motion for motion in motions if low <= motion.frequency <= high]
    left = [motion for motion in left if not any(passes(curve, motion) for curve in known)]
    while left:
        # The middle one of those that are left is far from the folds at the ends of its branch.
        motion = left.pop(len(left) // 2)
        guess = motion.coefficients()
        if guess is None or not _leads_elsewhere(model, known, motion.frequency, guess, schemes_of(scheme)):
            continue
        curve = hbm_curve(model, *span, guess=guess, begin=motion.frequency, scheme=scheme, **options)
        known.append(curve)
        left = [motion for motion in left if not passes(curve, motion)]
        yield curve


def passes(curve: HbmCurve, motion: SettledMotion) -> bool:
    """Whether a curve passes through a motion, its amplitudes taken straight between its solutions."""
    for i, share in crossings(curve.frequency, motion.frequency):
        here = curve.amplitude[i] + share * (curve.amplitude[i + 1] - curve.amplitude[i])
        if np.max(np.abs(here - motion.amplitude)) <= NEAR * np.max(motion.amplitude):
            return True
    return False


def solutions_at(
    model: Model, curve: HbmCurve, frequency: float | Array, *, scheme: Scheme | None = None, stability: bool = True
) -> HbmCurve:
    """The solutions of a curve at given frequencies, each solved for anew, in the order of these and of the curve.

    ``frequency``: where [Hz], one or several; outside the curve there are none. The others as given to and got from
    `hbm_curve`.
    """
    wanted = np.atleast_1d(np.asarray(frequency, dtype=float))
    balance = Balance(model, float(wanted[0]), scheme or Scheme())
    unknowns = curve.contact_motion.reshape(curve.frequency.size, balance.num_unknowns) / balance.length
    places = [(f, *crossing) for f in wanted for crossing in crossings(curve.frequency, f)]
    rows, branch = list[Solution](), []
    for f, i, share in places:
        guess = _between(unknowns, curve.frequency, (i, share), f)
        solution = solve(balance, guess, float(f), Controls(), near=True)
        if solution is not None:
            rows.append((solution[0], f, False, sign_with_offsets_kept(balance, solution[0], f, solution[1])))
            branch.append(curve.branch[i + 1])
    ending = Ending.COMPLETE if len(rows) == len(places) else Ending.STEP
    message = f"{len(rows)} of {len(places)} solutions at {wanted.size} frequencies"
    solved = Curve.of(rows, balance.num_unknowns, ending, message)
    return replace(evaluated(balance, solved, stability=stability), branch=np.array(branch, dtype=np.int64))


def _between(unknowns: Array, frequency: Array, crossing: tuple[int, float], place: float) -> Array:
    """Unknowns where a curve passes a frequency: by a cubic through four points if it goes one way along them."""
    i, share = crossing
    four = slice(max(i - 1, 0), i + 3)
    if np.ptp(np.sign(np.diff(frequency[four]))) > 0:  # a fold beside it, where they are no function of the frequency
        return unknowns[i] + share * (unknowns[i + 1] - unknowns[i])
    from scipy.interpolate import KroghInterpolator

    return KroghInterpolator(frequency[four], unknowns[four])(place)


def _leads_elsewhere(
    model: Model, known: list[HbmCurve], frequency: float, guess: Array, schemes: Sequence[Scheme]
) -> bool:
    """Whether a guess leads to a solution that is on none of the curves, with as few harmonics as lead to one."""
    count = max((curve.harmonic_cos.shape[1] - 1 for curve in known), default=schemes[0].harmonics)
    for scheme in (own for own in schemes if own.harmonics >= count):
        balance = Balance(model, frequency, scheme)
        solution = solve(balance, unknowns_of_modes(balance, guess), frequency, Controls())
        if solution is not None:
            break
    else:
        return False
    curves = [curve.with_harmonics(scheme.harmonics) for curve in known]
    # Not the mean: it may hold the offset of a contact that sticks, which is free.
    waves = balance.coefficients(solution[0])[..., 1:] * balance.length
    at_frequency = (solutions_at(model, curve, frequency, scheme=scheme, stability=False) for curve in curves)
    return not any(
        np.linalg.norm(motion[..., 1:] - waves) <= SAME * np.linalg.norm(waves)
        for solutions in at_frequency
        for motion in solutions.contact_motion
    )


def _meet(one: HbmCurve, i: int, other: HbmCurve, j: int) -> bool:
    """Whether two curves share a solution at these positions."""
    if not one.frequency.size or not other.frequency.size or not np.isclose(one.frequency[i], other.frequency[j]):
        return False
    count = max(curve.harmonic_cos.shape[1] for curve in (one, other)) - 1
    x, y = one.with_harmonics(count).contact_motion[i], other.with_harmonics(count).contact_motion[j]
    return bool(np.linalg.norm(x - y) <= SAME * np.linalg.norm(y[..., 1:]))
