"""A balance with as many harmonics and samples as each solution asks for, by the tail of its residual."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.balance import Array, Balance, Complex, LinearResponse, contact_stiffness, mean_of
from timesim.hbm.condensation import Condensation
from timesim.hbm.continuation import Nearby, Residual
from timesim.hbm.period import contact_forces, forces_of
from timesim.hbm.scheme import NEGLECTED, Scheme
from timesim.orbit.fourier import to_coefficients, to_phasors

# Share of `NEGLECTED` that harmonics may add which a solution does without again.
SPARED = 0.5
# What the harmonics that a solution lacks may add, relative to the amplitude, where none is near it with them: if they
# add more, it may be one for no other reason than that it lacks them.
MISSED = 1e-2
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

    Attributes:
        positions: of the unknowns of each scheme.
        demanding: whether it refuses solutions that lack much; `refused`: whether it did since the curve began.
    """

    def __init__(self, residual_of: Callable[[Scheme], Family], schemes: Sequence[Scheme], num_contacts: int):
        """From the equations by a scheme, and schemes with more and more harmonics."""
        self.schemes, self.residual_of = tuple(schemes), lru_cache(maxsize=None)(residual_of)
        self.shape = 3 * num_contacts, 2 * self.schemes[-1].harmonics + 1
        whole = np.arange(np.prod(self.shape)).reshape(self.shape)
        self.positions = [whole[:, : 2 * scheme.harmonics + 1].ravel() for scheme in self.schemes]
        self.place = self._least = self._held = 0
        self.demanding = self.refused = False
        self._before: list[tuple[int, int]] = []

    @property
    def residual(self) -> Family:
        """The equations in use."""
        return self.residual_of(self.schemes[self.place])

    @property
    def active(self) -> NDArray[np.int64]:
        """Positions of the unknowns in use."""
        return self.positions[self.place]

    def centre(self, x: Array) -> Array:
        """The mean of a motion."""
        return mean_of(x.reshape(self.shape)).ravel()

    def value(self, x: Array, p: float) -> Array:
        return self.residual.value(x, p)

    def linearised(self, x: Array, p: float) -> tuple[Array, Array | Condensation, Array]:
        return self.residual.linearised(x, p)

    def begin(self, x: Array) -> None:
        """Take the coarsest scheme above which a guess has next to nothing, or the finest."""
        above = _above(np.abs(to_phasors(x.reshape(self.shape))).max(axis=0))
        self.place = next(i for i, own in enumerate(self.schemes) if above[own.harmonics] <= NEGLECTED)
        self._least, self.refused = 0, False

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

    def refuses(self, x: Array, p: float) -> bool:
        """Whether no curve is to begin from a solution, whose harmonics could not be raised: see `MISSED`."""
        own = self.residual
        if self.demanding:
            above = tail(own.at(p), x[self.active], own.frequency_at(p))
            self.refused = bool(above[self.schemes[self.place].harmonics] > MISSED)
        return self.refused

    def driven(self, x: Array, p: float) -> tuple[Complex, float]:
        """Forces of the contacts on modes of mass 1, by harmonics 1 ... H, shape (H, M); the largest displacement."""
        own = self.residual.at(p)
        forces = own.contact_forces(x[self.active])
        modes = own.modes(x[self.active], forces, self.residual.frequency_at(p))[1:]
        points = np.einsum("pam,hm->hpa", own.model.structure.shape, modes)
        return own.on_modes(forces)[1:], float(np.abs(points).max())

    def whole(self, x: Array, place: int = 0) -> Array:
        """All unknowns from those of a scheme."""
        whole = np.zeros(np.prod(self.shape))
        whole[self.positions[place]] = x
        return whole


def _above(size: Array) -> Array:
    """What harmonics above each order add to a motion, relative to the largest, from the size of each of 0 ... H.

    The root of the sum of their squares: where none is in resonance, the sum is ten times the error of the amplitude.
    """
    square = np.append(np.cumsum(size[:0:-1] ** 2)[::-1], 0.0)
    return np.sqrt(square) / max(float(size[1:].max(initial=0.0)), 1e-300)


@dataclass(frozen=True)
class _Above:
    """What harmonics above those balanced, up to N/4, make of a solution: the motion under those of the contact forces.

    Each contact is as stiff as its shares of the period in stick and in contact make it.

    Attributes:
        linear: response of the structure, of all orders.
        forces: (f1, f2, n) of the contacts as far as the samples resolve them, in units of force, shape (C, 3, n).
        moved: motion of the contacts in the harmonics above, by phasors, shape (N/4 - H, 3C).
        points: motion of the points of the structure with them, by phasors, shape (N/4 + 1, P, 3).
    """

    linear: LinearResponse
    forces: Array
    moved: Complex
    points: Complex

    @classmethod
    def of(cls, balance: Balance, x: Array, frequency: float) -> "_Above":
        wide = _wide(balance)
        done = forces_of(balance.law, wide.basis, balance.period(x))
        phasors = to_phasors(done.coefficient.reshape(3 * balance.num_contacts, -1)).T * balance.force
        linear = wide.linear(frequency)
        closed = 1.0 - done.separation
        spring = contact_stiffness(balance.model, closed - done.slip)
        spring[2::3, 2::3] = contact_stiffness(balance.model, closed)[2::3, 2::3]
        own = slice(balance.scheme.harmonics + 1, None)
        spring, flexibility = spring - balance.support, linear.flexibility[own]
        matrix = np.eye(len(spring)) + flexibility @ spring
        moved = np.linalg.solve(matrix, -(flexibility @ phasors[own, :, None]))
        forces = -phasors[own, :, None] - spring @ moved
        root = np.sqrt(balance.model.structure.mass)
        low = balance.modes(x, done.coefficient[..., : balance.size], frequency)
        above = (linear.modal[own, :, :-1] @ forces)[..., 0] / root
        points = np.einsum("pam,hm->hpa", balance.model.structure.shape, np.concatenate([low, above]))
        return cls(linear, done.coefficient, np.asarray(moved[..., 0], dtype=complex), points)

    @property
    def share(self) -> Array:
        """Displacement that harmonics above each order of 0 ... N/4 add, relative to the largest one."""
        return _above(np.abs(self.points).max(axis=(1, 2)))

    def motion(self, balance: Balance, x: Array) -> Array:
        """Motion of the contacts with the harmonics above, in units of length, shape (C, 3, n)."""
        coefficient = balance.coefficients(x)
        above = to_coefficients(np.pad(self.moved, [(1, 0), (0, 0)]).T)[:, 1:] / balance.length
        return np.concatenate([coefficient, above.reshape(*coefficient.shape[:2], -1)], axis=2)

    def below(self, balance: Balance, x: Array, nearby: Nearby) -> float:
        """By how much harmonics above those balanced change the amplitudes of those, relative to the largest one."""
        own, low = slice(balance.scheme.harmonics + 1), slice(balance.size)
        stiffness = cast(Condensation, nearby.factors.by_x).stiffness
        change = contact_forces(balance.law, _wide(balance).basis, self.motion(balance, x)).coefficient - self.forces
        acting = -_phasors(change[..., low]) * balance.force
        motion = np.einsum("hij,hj->hi", self.linear.flexibility[own], acting)
        moved = nearby.change(-to_coefficients(motion.T).ravel() / balance.length)
        felt = np.einsum("cjhkl,ckl->cjh", stiffness, balance.coefficients(moved))
        acting += _phasors(felt) * balance.length
        modes = np.einsum("hij,hj->hi", self.linear.modal[own, :, :-1], acting)
        modes /= np.sqrt(balance.model.structure.mass)
        points = self.points[own]
        other = points + np.einsum("pam,hm->hpa", balance.model.structure.shape, modes)
        rise = (np.abs(other) - np.abs(points))[1:]
        return float(np.sqrt(np.sum(rise**2, axis=0)).max() / max(np.abs(points[1:]).max(), 1e-300))


def _wide(balance: Balance) -> Balance:
    """The balance with as many harmonics as the samples resolve."""
    samples = balance.scheme.time_samples
    return balance.with_scheme(Scheme(samples // 4, samples))


def _phasors(coefficient: Array) -> Complex:
    """Of all components of all contacts, shape (H + 1, 3C), from shape (C, 3, 2H + 1)."""
    return to_phasors(coefficient.reshape(-1, coefficient.shape[-1])).T


def tail(balance: Balance, x: Array, frequency: float) -> Array:
    """Displacement that harmonics above each order of 0 ... N/4 add, relative to the largest one."""
    return _Above.of(balance, x, frequency).share


def left_out(balance: Balance, x: Array, frequency: float, nearby: Nearby) -> float:
    """What harmonics above those balanced add, and change in those below them, relative to the largest displacement.

    The change is that of one step of Newton's method. Near a lightly damped resonance it may be ten times the tail. No
    scheme is chosen by it: where a contact is about to leave its state no number of harmonics makes it small.
    """
    above = _Above.of(balance, x, frequency)
    return float(above.share[balance.scheme.harmonics]) + above.below(balance, x, nearby)
