"""Resonances that contacts hardly feel, as of two equal blades that move together beside a contact between them.

The unknowns of a balance are the motions of its contacts. Where these show nothing of a resonance, a curve takes steps
that lead past its peak. The excitation meets such a resonance with each of its harmonics, and so do the forces of
contacts that slip or separate: at a third of a natural frequency too.
"""

from collections.abc import Callable

import numpy as np

from timesim.hbm.adaptive import AdaptiveBalance
from timesim.model.held import damped_modes
from timesim.model.model import Model
from timesim.orbit.fourier import Array

# By how many halves of its width stuck contacts move a resonance at most that they hardly feel. Those that they move
# more move them as well.
FELT = 10.0
# Longest step, as a share of the way to such a resonance and, next to it, of half its width.
SHARE = 0.25
# Share of the largest force on a mode that is rounding.
ROUNDING = 1e-12
# Half the width of a resonance without damping, as a share of its frequency.
SHARPEST = 1e-6
# Displacement in a resonance under the forces of contacts, as a share of the largest one, from which on it counts.
SEEN = 1e-2


class Hidden:
    """The resonances of a model that its contacts hardly feel.

    Attributes:
        low, high: frequencies of the excitation [Hz] between which contacts move each, by the harmonic that
            meets it, shape (H, M).
    """

    def __init__(self, model: Model, harmonics: int):
        structure, excited = model.structure, model.excitation
        omega, self._vectors, wide = damped_modes(model, np.arange(model.num_contacts))
        alone = np.hypot.reduce(structure.omega[:, None] * self._vectors, axis=0)
        half = np.maximum(wide / 2, SHARPEST * omega)
        self._hidden = (omega > 0) & (omega - alone <= FELT * half)
        shapes = self._vectors / np.sqrt(structure.mass)[:, None]
        force = np.abs((excited.cosine + 1j * excited.sine) @ shapes)
        order = np.arange(1, max(excited.harmonic.max(), harmonics) + 1)[:, None]
        self._excited = np.zeros((order.size, omega.size), dtype=bool)
        self._excited[excited.harmonic - 1] = self._hidden & (force > ROUNDING * force.max(initial=0.0))
        largest = np.abs(structure.shape @ shapes).max(axis=(0, 1))
        self._rise = self._hidden * largest / (2 * np.maximum(half * omega, 1e-300))
        self.low, self.high, self._width = (part / (2 * np.pi * order) for part in (alone, omega, half))

    def away(self, frequency: float, driven: Callable[[], tuple[np.ndarray, float]]) -> Array:
        """How far a frequency [Hz] is from each, at least half its width, shape (H, M); infinite where nothing acts.

        ``driven``: as of `AdaptiveBalance`.
        """
        wanted = self._excited.copy()
        if self._hidden.any():
            force, largest = driven()
            wanted[: len(force)] |= np.abs(force @ self._vectors) * self._rise > SEEN * largest
        away = np.maximum(np.maximum(self.low - frequency, frequency - self.high), self._width)
        return np.where(wanted, away, np.inf)


def steps_to_resolve(model: Model, balance: AdaptiveBalance) -> Callable[[float, Array], float]:
    """How far at most a step leads from a frequency [Hz] and the unknowns there.

    It is to show all resonances that contacts hardly feel, under any harmonic of the excitation and of their forces.
    """
    hidden = Hidden(model, balance.schemes[-1].harmonics)

    def longest(frequency: float, x: Array) -> float:
        return SHARE * float(hidden.away(frequency, lambda: balance.driven(x, frequency)).min(initial=np.inf))

    return longest
