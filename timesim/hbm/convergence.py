"""How many harmonics and time samples are enough: the answer against both, until it no longer changes.

Each solution is solved for anew at its frequency, with more harmonics on the same samples, then with more samples and
the same harmonics. What counts is the largest change of an amplitude, relative to the largest amplitude of the motion,
from the finest answer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from timesim.hbm.balance import Array, Balance
from timesim.hbm.continuation import solve
from timesim.hbm.curve import default_controls
from timesim.hbm.scheme import MIN_SAMPLES, Scheme
from timesim.model.model import Model
from timesim.orbit.fourier import half_range

HARMONICS = (1, 3, 5, 7, 9, 13, 19, 27, 39, 57, 81)
MAX_DOUBLINGS = 15  # of one time sample
# Changes below this end the refinement.
ENOUGH = 1e-5


@dataclass(frozen=True)
class Place:
    """A solution that is looked at: its model, frequency [Hz], motion at the contacts (C, 3, 2H + 1), amplitudes."""

    model: Model
    frequency: float
    motion: Array
    amplitude: Array


@dataclass(frozen=True)
class Convergence:
    """The answer against harmonics and samples.

    Attributes:
        scheme: that of the study.
        count: solutions looked at.
        harmonics, with_harmonics: numbers of harmonics, and the change from the last of them; the last entry is the
            change from the one before.
        time_samples, with_samples: the same for the samples.
        lost: how many of the solutions a number of harmonics, or of samples, does not have, by name.
    """

    scheme: Scheme
    count: int
    harmonics: Array
    with_harmonics: Array
    time_samples: Array
    with_samples: Array
    lost: dict[str, int]

    def told(self) -> list[str]:
        """The report in words, a line each."""
        if not self.count:
            return ["convergence: no stable solution slips or separates, so harmonics and samples change nothing"]
        return [
            f"convergence of {self.count} solutions with slip or separation, change from the finest: "
            + _listed(self.harmonics, self.with_harmonics, "harmonics"),
            _listed(self.time_samples, self.with_samples, "time samples"),
            *([f"not found: {', '.join(f'{n} with {name}' for name, n in self.lost.items())}"] if self.lost else []),
        ]


def _listed(numbers: Array, changes: Array, name: str) -> str:
    parts = ", ".join(f"{int(n)}: {change:.1e}" for n, change in zip(numbers[:-1], changes[:-1], strict=True))
    order = order_of(numbers, changes)
    seen = f"order {order:.1f}" if np.isfinite(order) else "no order yet"
    return f"{name} {parts} ({seen}, and the finest, {int(numbers[-1])}, moved it by {changes[-1]:.1e})"


def order_of(numbers: Array, changes: Array) -> float:
    """Exponent with which the changes fall, by a straight line through their logarithms; NaN if there are too few."""
    usable = np.isfinite(changes[:-1]) & (changes[:-1] > 3 * changes[-1]) & (changes[:-1] > 1e-9)
    if usable.sum() < 2:
        return float("nan")
    return float(-np.polyfit(np.log(numbers[:-1][usable]), np.log(changes[:-1][usable]), 1)[0])


def convergence(places: Sequence[Place], scheme: Scheme) -> Convergence:
    """Refine harmonics and samples at given solutions.

    Args:
        places: the solutions, found with `scheme`.
        scheme: of the study.
    """
    least = max(4 * scheme.harmonics, MIN_SAMPLES)
    samples = [2**k for k in range(4, MAX_DOUBLINGS + 1) if 2**k >= least]
    enough = max(scheme.time_samples, 4 * max(HARMONICS))
    harmonics = sorted({*HARMONICS, scheme.harmonics})
    highest = max((int(place.model.excitation.harmonic.max()) for place in places), default=1)
    by_harmonics = _refined(
        places, [h for h in harmonics if h >= highest], lambda h: replace(scheme, harmonics=h, time_samples=enough)
    )
    by_samples = _refined(places, samples, lambda n: replace(scheme, time_samples=n))
    lost = {
        f"{int(number)} {name}": int(count)
        for (numbers, _, counts), name in ((by_harmonics, "harmonics"), (by_samples, "samples"))
        for number, count in zip(numbers, counts, strict=True)
        if count
    }
    return Convergence(scheme, len(places), *by_harmonics[:2], *by_samples[:2], lost)


def _refined(
    places: Sequence[Place], numbers: Sequence[int], scheme_of: Callable[[int], Scheme]
) -> tuple[Array, Array, Array]:
    """Numbers tried, the change from the last of them, and how many places have no solution."""
    answers: list[Array] = []
    moves = [np.inf]
    for number in numbers if places else numbers[:1]:
        answers.append(np.array([amplitude(place, scheme_of(number)) for place in places]))
        if len(answers) > 1:
            moves.append(_change(places, answers[-2], answers[-1]))
        if max(moves[-2:]) < ENOUGH:
            break
    changes = [_change(places, answer, answers[-1]) for answer in answers[:-1]]
    lost = np.array([np.isnan(answer[:, 0, 0]).sum() if len(places) else 0 for answer in answers])
    return np.array(numbers[: len(answers)], dtype=float), np.array([*changes, moves[-1]]), lost


def _change(places: Sequence[Place], one: Array, other: Array) -> float:
    """Largest difference of the answers, relative to each motion, where both have one."""
    size = np.array([place.amplitude.max() for place in places])
    change = np.abs(one - other).max(axis=(1, 2), initial=0.0) / size if len(places) else np.zeros(0)
    return float(np.max(change[np.isfinite(change)], initial=0.0))


def amplitude(place: Place, scheme: Scheme) -> Array:
    """Amplitudes at a place as another scheme finds them, shape (P, 3); NaN where it finds no solution."""
    balance = Balance(place.model, place.frequency, scheme)
    size = 2 * scheme.harmonics + 1
    guess = np.zeros((*place.motion.shape[:2], size))
    kept = min(size, place.motion.shape[2])
    guess[..., :kept] = place.motion[..., :kept]
    found = solve(balance, guess.ravel() / balance.length, place.frequency, default_controls())
    if found is None:
        return np.full_like(place.amplitude, np.nan)
    modal = balance.modes(found[0], balance.contact_forces(found[0]), place.frequency)
    return half_range(np.einsum("pam,hm->hpa", place.model.structure.shape, modal)[None])[0]
