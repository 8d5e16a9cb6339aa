"""Convergence of solutions with harmonics and with time samples, each increased until the amplitudes stay the same.

Each solution is computed anew at its frequency, with more harmonics on the same samples, then with more samples and the
same harmonics. The measure is the largest difference of an amplitude from that of the finest scheme, relative to the
largest amplitude of the motion.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.adaptive import left_out, tail
from timesim.hbm.balance import Array, Balance
from timesim.hbm.continuation import Bordered, Controls, Nearby, solve
from timesim.hbm.curve import HbmCurve, SoFar, Watch
from timesim.hbm.scheme import MIN_SAMPLES, Scheme, coarsest, highest_excited
from timesim.model.model import Model
from timesim.orbit.fourier import half_range
from timesim.orbit.steady_state import switches

HARMONICS = (1, 3, 5, 7, 9, 13, 19, 27, 39, 57, 81)
MAX_DOUBLINGS = 15  # of one time sample
# Changes below this end the refinement.
ENOUGH = 1e-5


# Share of the motion of the contacts that the error of the samples may make at the worst of some solutions, to which
# amplitudes are meant to be right, and how many are looked at.
SAMPLED, LOOKED_AT = 1e-3, 12
# Least share of the frequency in the tangent of a curve by which that error is taken to be one at a frequency: beside
# folds no solution is close at the same frequency.
STEEPEST = 0.1
# How many times as many samples are taken where they are too few, and the most that the program chooses.
FINER, MOST_SAMPLES = 4, 2048
# Solutions of a curve that grows after which its samples are checked at one.
CHECKED = 50


def looked_at(curve: HbmCurve) -> NDArray[np.int64]:
    """Some solutions of a curve at which a contact slips, or opens within the period."""
    rows = np.flatnonzero(switches(curve.slip_share, curve.separation_share).any(axis=1))
    return np.unique(rows[np.linspace(0, rows.size - 1, LOOKED_AT).round().astype(int)]) if rows.size else rows


def neglected(model_at: Callable[[float], Model], curve: HbmCurve, schemes: Sequence[Scheme]) -> float:
    """Share of the amplitude that harmonics above those of a curve add and change, the most at solutions looked at."""
    worst = 0.0
    for balance, x, frequency in _solutions(model_at, curve, schemes, looked_at(curve)):
        beside = _nearby(balance, x, frequency)
        if beside is None:
            worst = max(worst, float(tail(balance, x, frequency)[balance.scheme.harmonics]))
        else:
            worst = max(worst, left_out(balance, x, frequency, beside))
    return worst


def _solutions(
    model_at: Callable[[float], Model], curve: HbmCurve, schemes: Sequence[Scheme], rows: NDArray[np.int64]
) -> Iterator[tuple[Balance, Array, float]]:
    """Some solutions of a curve: the balance by which each was found, the unknowns and the frequency [Hz]."""
    for i in rows:
        motion, frequency = curve.contact_motion[i], float(curve.frequency[i])
        balance = Balance(model_at(float(curve.parameter[i])), frequency, schemes[coarsest(schemes, motion)])
        yield balance, motion[..., : balance.size].ravel() / balance.length, frequency


def _nearby(balance: Balance, x: Array, frequency: float) -> Nearby | None:
    """Solutions beside one, to first order; None where there are none."""
    size = float(np.linalg.norm(x - balance.centre(x)))
    try:
        _, by_x, by_p = balance.linearised(x, frequency)
        factors = Bordered(by_x, by_p * (frequency / size), np.append(np.zeros(x.size), 1.0))
    except np.linalg.LinAlgError:
        return None
    return Nearby(factors, size, frequency, frequency)


def with_more_samples(
    model_at: Callable[[float], Model], curve: HbmCurve, schemes: Sequence[Scheme]
) -> tuple[Scheme, ...] | None:
    """The schemes with more samples where those of a curve are too few; None where they are enough."""
    most = FINER * schemes[0].time_samples > MOST_SAMPLES
    if most or sampling_error(model_at, curve, schemes, looked_at(curve)) <= SAMPLED:
        return None
    return tuple(_finer(scheme, MOST_SAMPLES) for scheme in schemes)


class TooFewSamplesError(Exception):
    """A curve needs more samples, those of the schemes: it would be followed again anyway."""

    def __init__(self, schemes: tuple[Scheme, ...]):
        super().__init__(schemes)
        self.schemes = schemes


def checking_samples(model_at: Callable[[float], Model], schemes: tuple[Scheme, ...], watch: Watch) -> Watch:
    """What watches a curve by some schemes, and gives it up by a `TooFewSamplesError` where their samples are too few.

    ``model_at``: the model for a value of the parameter of the curve.
    """
    number = count(1)

    def seen(share: float, so_far: SoFar) -> None:
        if next(number) % CHECKED == 0 and (finer := with_more_samples(model_at, so_far(1), schemes)) is not None:
            raise TooFewSamplesError(finer)
        watch(share, so_far)

    return seen


def _finer(scheme: Scheme, most: int) -> Scheme:
    """`FINER` times as many samples, but no more than the most, nor fewer than there are."""
    return replace(scheme, time_samples=max(min(FINER * scheme.time_samples, most), scheme.time_samples))


def left_to_samples(model_at: Callable[[float], Model], curve: HbmCurve, schemes: Sequence[Scheme]) -> float:
    """`sampling_error` where the program takes no more samples, however many would be; 0 where it still may."""
    if FINER * schemes[0].time_samples <= MOST_SAMPLES:
        return 0.0
    return sampling_error(model_at, curve, schemes, looked_at(curve), most=FINER * MOST_SAMPLES)


def sampling_error(
    model_at: Callable[[float], Model],
    curve: HbmCurve,
    schemes: Sequence[Scheme],
    rows: NDArray[np.int64],
    *,
    most: int = MOST_SAMPLES,
) -> float:
    """Change of the motion of the contacts with `FINER` times as many samples, relative to its waves: the most of all.

    By one step of Newton's method, whose derivatives are those of the samples at hand: up to `MOST_SAMPLES` no other
    program is compiled. More than `most` are not taken.
    """
    worst = 0.0
    for balance, x, frequency in _solutions(model_at, curve, schemes, rows):
        if (beside := _nearby(balance, x, frequency)) is None:
            continue
        tangent, _ = beside.factors.tangent()
        finer = balance.with_scheme(_finer(balance.scheme, most))
        change = beside.factors.solve(-finer.value(x, frequency) / beside.x_unit, 0.0)
        across = float(np.linalg.norm(change - (tangent @ change) * tangent))
        worst = max(worst, across / max(abs(tangent[-1]), STEEPEST))
    return worst


@dataclass(frozen=True)
class Known:
    """A solution to refine: model, frequency [Hz], motion of the contacts (C, 3, 2H + 1) and amplitudes (P, 3)."""

    model: Model
    frequency: float
    motion: Array
    amplitude: Array


@dataclass(frozen=True)
class Convergence:
    """Changes of the solutions with harmonics and with samples.

    Attributes:
        harmonics, with_harmonics: numbers of harmonics, and the difference of each from the last; the last entry is the
            difference from the last but one; NaN where no solution exists with both.
        time_samples, with_samples: the same for the samples.
        lost: number of solutions that do not exist, by the number of harmonics or samples in words.
    """

    count: int
    harmonics: Array
    with_harmonics: Array
    time_samples: Array
    with_samples: Array
    lost: dict[str, int]


def order_of(numbers: Array, changes: Array) -> float:
    """Exponent with which the changes fall, by a straight line through their logarithms; NaN if there are too few."""
    usable = np.isfinite(changes[:-1]) & (changes[:-1] > 3 * changes[-1]) & (changes[:-1] > 1e-9)
    if usable.sum() < 2:
        return float("nan")
    return float(-np.polyfit(np.log(numbers[:-1][usable]), np.log(changes[:-1][usable]), 1)[0])


def convergence(known: Sequence[Known], scheme: Scheme) -> Convergence:
    """Refine harmonics and samples at given solutions, computed with a scheme."""
    least = max(4 * scheme.harmonics, MIN_SAMPLES)
    samples = [2**k for k in range(4, MAX_DOUBLINGS + 1) if 2**k >= least]
    enough = max(scheme.time_samples, 4 * max(HARMONICS))
    highest = max((highest_excited(one.model) for one in known), default=1)
    harmonics = [h for h in sorted({*HARMONICS, scheme.harmonics}) if h >= highest]
    by_harmonics = _refined(known, harmonics, lambda h: replace(scheme, harmonics=h, time_samples=enough))
    by_samples = _refined(known, samples, lambda n: replace(scheme, time_samples=n))
    lost = {
        f"{int(number)} {name}{'s' * (int(number) != 1)}": int(count)
        for (numbers, _, counts), name in ((by_harmonics, "harmonic"), (by_samples, "sample"))
        for number, count in zip(numbers, counts, strict=True)
        if count
    }
    return Convergence(len(known), *by_harmonics[:2], *by_samples[:2], lost)


def _refined(
    known: Sequence[Known], numbers: Sequence[int], scheme_of: Callable[[int], Scheme]
) -> tuple[Array, Array, Array]:
    """Numbers tried, the difference of each from the last, and how many solutions do not exist with it."""
    answers: list[Array] = []
    moves = [np.inf]
    for number in numbers if known else numbers[:1]:
        answers.append(np.array([amplitude(one, scheme_of(number)) for one in known]))
        if len(answers) > 1:
            moves.append(_change(known, answers[-2], answers[-1]))
        if np.all(np.array(moves[-2:]) < ENOUGH):
            break
    changes = [_change(known, answer, answers[-1]) for answer in answers[:-1]]
    lost = np.array([np.isnan(answer[:, 0, 0]).sum() if known else 0 for answer in answers])
    return np.array(numbers[: len(answers)], dtype=float), np.array([*changes, moves[-1]]), lost


def _change(known: Sequence[Known], one: Array, other: Array) -> float:
    """Largest difference of amplitudes, relative to each motion, where both exist; NaN where none does."""
    if not known:
        return 0.0
    change = np.abs(one - other).max(axis=(1, 2)) / np.array([solution.amplitude.max() for solution in known])
    exists = np.isfinite(change)
    return float(change[exists].max()) if exists.any() else np.nan


def amplitude(known: Known, scheme: Scheme) -> Array:
    """Amplitudes of a solution by another scheme, shape (P, 3); NaN where it does not exist."""
    balance = Balance(known.model, known.frequency, scheme)
    guess = np.zeros((*known.motion.shape[:2], balance.size))
    kept = min(balance.size, known.motion.shape[2])
    guess[..., :kept] = known.motion[..., :kept]
    solution = solve(balance, guess.ravel() / balance.length, known.frequency, Controls())
    if solution is None:
        return np.full_like(known.amplitude, np.nan)
    modal = balance.modes(solution[0], balance.contact_forces(solution[0]), known.frequency)
    return half_range(np.einsum("pam,hm->hpa", known.model.structure.shape, modal)[None])[0]
