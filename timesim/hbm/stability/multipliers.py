"""Floquet multipliers of periodic solutions, and whether disturbances grow.

They are the eigenvalues of the monodromy matrix (`timesim.hbm.stability.monodromy`), whose error is of second order in
the number of samples: half as many tell it, and it is taken away. Disturbances so large that the contacts take on
states which the solution does not have are beyond a linearisation: a small push may free a contact that sticks.

G. Floquet, Sur les équations différentielles linéaires à coefficients périodiques, Annales scientifiques de l'ENS 12
(1883) 47-88; A. H. Nayfeh and B. Balachandran, Applied Nonlinear Dynamics (Wiley 1995), chapter 3.
"""

import timesim.runtime  # noqa: F401  isort: skip

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from timesim.hbm.balance import Array, Balance
from timesim.hbm.stability.monodromy import monodromy

# Modulus of a multiplier above which a solution is unstable: those of an undamped structure lie on the unit circle but
# for the error of the samples.
BORDER = 1 + 1e-3
# Distance of a real multiplier from 1 within which the determinant of the balance decides, if no other one is beyond 1:
# the samples leave an error of this size.
NEAR_ONE = 0.03
# Estimated errors by which a modulus must be off the border, change from fewer samples up to which the largest one
# stands, and samples with which a solution is looked at again where one is in doubt.
SAFETY, ROUGH, MANY = 5.0, 0.1, 2048
# Change of the logarithm from fewer samples up to which a multiplier is the same one, and modulus from which on it is
# extrapolated.
ALIKE, DEAD = 0.3, 1e-2
# Change of the modulus from a partner, over that from the one of the same rank, up to which it is the partner; and of
# moduli that are the same.
SWAPPED, ROUNDING = 3.0, 1e-9
# With half as many the largest multiplier errs by at most 3e-3 on the paper's oscillator in slip and separation.
SAMPLES = 256


def floquet_multipliers(balance: Balance, x: Array, frequency: Array, *, samples: int | None = None) -> Array:
    """Multipliers of solutions, largest first; a contact in full stick gives two that are 1.

    Args:
        balance: the equations solved.
        x: unknowns of `Balance`, shape (S, n).
        frequency: of the excitation [Hz], shape (S,).

    Keyword Args:
        samples: of the period, from which and from half as many they are extrapolated; by default those of the
            balance, at least `SAMPLES`.

    Returns:
        multipliers, complex, shape (S, 2M + 2C).
    """
    return _with_doubt(balance, x, frequency, samples)[0]


def checked_multipliers(balance: Balance, x: Array, frequency: Array, sign: NDArray[np.int64]) -> Array:
    """`floquet_multipliers`, with more samples where stability is in doubt or the sign of det dr/dx contradicts.

    On structures with stiff contacts real ones of 0.95 and 1.20 were 1.29 and 0.34 with 128 and 156 samples.

    ``sign``: of det dr/dx, shape (S,), 0 where it does not tell; the others as of `floquet_multipliers`.
    """
    multipliers, doubt = _with_doubt(balance, x, frequency, None)
    passed = np.count_nonzero((multipliers.imag == 0) & (multipliers.real > BORDER), axis=1)
    again = np.flatnonzero(doubt.any(axis=1) | (sign * (-1) ** passed < 0))
    if balance.scheme.time_samples < MANY:
        multipliers[again] = floquet_multipliers(balance, x[again], frequency[again], samples=MANY)
    return multipliers


def _with_doubt(balance: Balance, x: Array, frequency: Array, samples: int | None) -> tuple[Array, NDArray[np.bool_]]:
    """`floquet_multipliers`, and which of them are in doubt: `extrapolated`."""
    samples = samples or max(SAMPLES, balance.scheme.time_samples)
    fine, coarse = (_by_samples(balance, x, frequency, number) for number in (samples, samples // 2))
    both = [extrapolated(*pair, samples / (samples // 2)) for pair in zip(fine, coarse, strict=True)]
    multipliers, doubt = np.array(both, complex).reshape(-1, 2, fine.shape[1]).swapaxes(0, 1)
    order = np.argsort(-np.abs(multipliers), axis=1)
    return np.take_along_axis(multipliers, order, axis=1), np.take_along_axis(doubt, order, axis=1) == 1


def extrapolated(fine: Array, coarse: Array, ratio: float) -> tuple[Array, NDArray[np.bool_]]:
    """Multipliers of a solution from those with samples and with fewer [1]_, and which are in doubt.

    That are those which may be on the other side of 1, and the largest, which is shown, where it changes much.

    Logarithms are extrapolated, so a mode that vibrates faster than the samples keeps its modulus. It may find no
    partner among those with fewer samples, or a wrong one; one of a pair that is real in one and complex in the other
    finds none. They stay as they are, and so do those that may be on the other side. Of either the moduli in order tell
    how much the samples change: the one of each rank depends continuously on them, whatever its partner is.

    .. [1] L. F. Richardson, Philosophical Transactions of the Royal Society A 210 (1911) 307-357.
    """
    partner = coarse[linear_sum_assignment(np.abs(fine[:, None] - coarse))[1]]
    size, ranked = np.abs(fine), np.empty(fine.size)
    ranked[np.argsort(size)] = np.sort(np.abs(coarse))
    off = np.abs(size - ranked)
    alike = (np.minimum(size, np.abs(partner)) > DEAD) & ((fine.imag == 0) == (partner.imag == 0))
    alike &= np.abs(size - np.abs(partner)) <= SWAPPED * off + ROUNDING
    change = np.log(np.where(alike, fine / np.where(alike, partner, 1.0), 1.0))
    alike &= np.abs(change) < ALIKE
    better = fine * np.exp(np.where(alike, change, 0.0) / (ratio**2 - 1))
    error = np.where(alike, off / (ratio**2 - 1), off / 2)
    doubt = np.abs(np.abs(better) - BORDER) < SAFETY * error
    return np.where(doubt, fine, better), doubt | ((size == size.max()) & (off > ROUGH))


def _by_samples(balance: Balance, x: Array, frequency: Array, samples: int) -> Array:
    """The multipliers that so many samples give, shape (S, 2M + 2C)."""
    return np.linalg.eigvals(monodromy(balance, x, frequency, samples)).astype(complex)  # real where all of them are


def grows(multipliers: Array) -> NDArray[np.bool_]:
    """Whether disturbances of solutions grow, shape (S,), by their multipliers, largest first.

    Whether a real one alone has passed 1, as at a fold, the determinant tells exactly; of a complex pair, or of two
    real ones, as equal bodies have them, it sees nothing.
    """
    beyond = np.abs(multipliers) > BORDER
    passed = beyond & (multipliers.imag == 0) & (multipliers.real > 0)
    alone = passed & (np.count_nonzero(passed, axis=1, keepdims=True) == 1)
    return (beyond & ~(alone & (np.abs(multipliers - 1) <= NEAR_ONE))).any(axis=1)
