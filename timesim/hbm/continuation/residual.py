"""What continuation follows: equations, with their derivatives, in as many unknowns."""

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.condensation import Condensation
from timesim.hbm.continuation.bordered import Array


class Residual(Protocol):
    """A system of as many equations as unknowns.

    Either method may raise `NoSolutionError` where it cannot be evaluated.
    """

    def value(self, x: Array, p: float) -> Array:
        """r, shape (n,)."""

    def linearised(self, x: Array, p: float) -> tuple[Array, Array | Condensation, Array]:
        """r, shape (n,), its derivatives by x, shape (n, n) or a `Condensation`, and by p, shape (n,)."""


@runtime_checkable
class Centred(Residual, Protocol):
    """A residual whose solutions move about a centre that may be far from zero, which is no part of their size."""

    def centre(self, x: Array) -> Array:
        """That of a solution or guess, shape (n,)."""


@runtime_checkable
class Adaptive(Residual, Protocol):
    """A residual of some of its unknowns, the others being zero: of as many as a solution asks for."""

    @property
    def active(self) -> NDArray[np.int64]:
        """Positions of the unknowns that it is of."""

    def begin(self, x: Array) -> None:
        """Take those that a guess, shape (n,), asks for."""

    def adapt(self, x: Array, p: float) -> bool:
        """Take those that a solution, shape (n,), asks for; whether they are others than before."""

    def restore(self) -> None:
        """Undo the last `adapt` or `refine`; of several `refine`, one after the other."""

    def refine(self) -> bool:
        """Take more, and not less for the next solutions; False if there are no more."""

    def refuses(self, x: Array, p: float) -> bool:
        """Whether no curve is to begin from a solution, shape (n,), that asks for more where none is near with more."""


class NoSolutionError(Exception):
    """Newton's method does not converge."""
