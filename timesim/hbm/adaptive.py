"""A balance with as many harmonics and samples as each solution asks for, by the tail of its residual."""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.balance import Array, Balance, contact_stiffness, mean_of
from timesim.hbm.continuation import Condensed, Residual
from timesim.hbm.period import basis_of, forces_of, period_of
from timesim.hbm.scheme import NEGLECTED, Scheme, coarsest
from timesim.orbit.fourier import to_phasors

# Share of `NEGLECTED` that harmonics may add which a solution does without again.
SPARED = 0.5
# Solutions after which a scheme that was taken for a fold may be left again.
HELD = 20


class Family(Residual, Protocol):
    """A residual that is the balance of a model at each value of its parameter."""

    def at(self, p: float) -> Balance:
        """The balance; its frequency is `frequency_at`."""

    def frequency_at(self, p: float) -> float:
        """Frequency of the excitation [Hz]."""


class AdaptiveBalance:
    """A balance by the one of several schemes that the solution at hand asks for.

    The unknowns are those of the finest scheme; those that the scheme in use does not have are zero.
    """

    def __init__(self, residual_of: Callable[[Scheme], Family], schemes: Sequence[Scheme], num_contacts: int):
        """From the equations by a scheme, and schemes with more and more harmonics."""
        self.schemes, self.residual_of = tuple(schemes), lru_cache(maxsize=None)(residual_of)
        self.shape = 3 * num_contacts, 2 * self.schemes[-1].harmonics + 1
        self.place = self._least = self._held = 0
        self._before: list[tuple[int, int]] = []

    @property
    def residual(self) -> Family:
        """The equations in use."""
        return self.residual_of(self.schemes[self.place])

    @property
    def active(self) -> NDArray[np.int64]:
        """Positions of the unknowns in use."""
        return self.positions(self.place)

    def positions(self, place: int) -> NDArray[np.int64]:
        """Positions of the unknowns of a scheme."""
        return np.arange(np.prod(self.shape)).reshape(self.shape)[:, : 2 * self.schemes[place].harmonics + 1].ravel()

    def centre(self, x: Array) -> Array:
        """The mean of a motion."""
        return mean_of(x.reshape(self.shape)).ravel()

    def value(self, x: Array, p: float) -> Array:
        """r of the unknowns in use."""
        return self.residual.value(x, p)

    def linearised(self, x: Array, p: float) -> tuple[Array, Array | Condensed, Array]:
        """r and its derivatives by those."""
        return self.residual.linearised(x, p)

    def begin(self, x: Array) -> None:
        """Take the coarsest scheme that has the harmonics of a guess."""
        size = np.abs(to_phasors(x.reshape(self.shape))).max(axis=0)
        self.place, self._least = self._enough(_above(size), NEGLECTED), 0

    def adapt(self, x: Array, p: float) -> bool:
        """Take the scheme that a solution asks for; whether it is another one than before."""
        if len(self.schemes) == 1:
            return False
        own, orders = self.residual, [scheme.harmonics for scheme in self.schemes]
        above = tail(own.at(p), x[self.active], own.frequency_at(p))
        self._held -= 1
        if self._held < 0:
            self._least = 0
        before = self.place
        self._before = [(before, self._least)]
        if above[orders[self.place]] > NEGLECTED:
            self.place = min(self.place + 1, len(orders) - 1)
        elif self.place > self._least and above[orders[self.place - 1]] < SPARED * NEGLECTED:
            self.place -= 1
        return self.place != before

    def restore(self) -> None:
        """Undo the last change of scheme."""
        self.place, self._least = self._before.pop()

    def refine(self) -> bool:
        """Take the next scheme, and none before it for the next solutions; False at the finest."""
        if self.place == len(self.schemes) - 1:
            return False
        self._before.append((self.place, self._least))
        self.place = self._least = self.place + 1
        self._held = HELD
        return True

    def whole(self, x: Array, place: int = 0) -> Array:
        """All unknowns from those of a scheme."""
        whole = np.zeros(np.prod(self.shape))
        whole[self.positions(place)] = x
        return whole

    def place_of(self, x: Array) -> int:
        """The coarsest scheme that has all harmonics of a solution."""
        return coarsest(self.schemes, x.reshape(self.shape))

    def _enough(self, above: Array, share: float) -> int:
        """The coarsest scheme above which no more is left than a share, or the finest."""
        enough = (above[min(own.harmonics, above.size - 1)] <= share for own in self.schemes)
        return next((i for i, own in enumerate(enough) if own), len(self.schemes) - 1)


def _above(size: Array) -> Array:
    """What harmonics above each order add to a motion, relative to the largest, from the size of each of 0 ... H.

    The root of the sum of their squares: where none is in resonance, the sum is ten times the error of the amplitude.
    """
    square = np.append(np.cumsum(size[:0:-1] ** 2)[::-1], 0.0)
    return np.sqrt(square) / max(float(size[1:].max(initial=0.0)), 1e-300)


def tail(balance: Balance, x: Array, frequency: float) -> Array:
    """Displacement that harmonics above each order of 0 ... N/4 add, relative to the largest one.

    Above those balanced it is the motion under the harmonics of the contact forces, as far as the samples resolve them,
    each contact as stiff as its shares of the period in stick and in contact make it.
    """
    scheme, coefficient = balance.scheme, balance.coefficients(x)
    wide = Scheme(scheme.time_samples // 4, scheme.time_samples)
    period = period_of(balance.law, balance.basis, coefficient)
    done = forces_of(balance.law, basis_of(wide.harmonics, wide.time_samples), period)
    phasors = to_phasors(done.coefficient.reshape(3 * balance.num_contacts, -1)).T * balance.force
    linear = balance.with_scheme(wide).linear(frequency)
    closed = 1.0 - done.separation
    spring = contact_stiffness(balance.model, closed - done.slip)
    spring[2::3, 2::3] = contact_stiffness(balance.model, closed)[2::3, 2::3]
    own = slice(scheme.harmonics + 1, None)
    spring, flexibility = spring - balance.support, linear.flexibility[own]
    matrix = np.eye(len(spring)) + flexibility @ spring
    moved = np.linalg.solve(matrix, -(flexibility @ phasors[own, :, None]))
    forces = -phasors[own, :, None] - spring @ moved
    root = np.sqrt(balance.model.structure.mass)
    modes = np.concatenate(
        [
            balance.modes(x, done.coefficient[..., : balance.size], frequency),
            (linear.modal[own, :, :-1] @ forces)[..., 0] / root,
        ]
    )
    return _above(np.abs(np.einsum("pam,hm->hpa", balance.model.structure.shape, modes)).max(axis=(1, 2)))
