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


def steps_to_resolve(model: Model, balance: AdaptiveBalance) -> Callable[[float, Array], float]:
    """How far at most a step leads from a frequency [Hz] and the unknowns there.

    It is to show all resonances that contacts hardly feel, under any harmonic of the excitation and of their forces.
    """
    structure, excited = model.structure, model.excitation
    omega, vectors, wide = damped_modes(model, np.arange(model.num_contacts))
    alone = np.hypot.reduce(structure.omega[:, None] * vectors, axis=0)
    half = np.maximum(wide / 2, SHARPEST * omega)
    hidden = (omega > 0) & (omega - alone <= FELT * half)
    shapes = vectors / np.sqrt(structure.mass)[:, None]
    force = np.abs((excited.cosine + 1j * excited.sine) @ shapes)
    order = np.arange(1, max(excited.harmonic.max(), balance.schemes[-1].harmonics) + 1)[:, None]
    by_excitation = np.zeros((order.size, omega.size), dtype=bool)
    by_excitation[excited.harmonic - 1] = hidden & (force > ROUNDING * force.max(initial=0.0))
    rise = hidden * np.abs(structure.shape @ shapes).max(axis=(0, 1)) / (2 * np.maximum(half * omega, 1e-300))
    low, high, width = (part / (2 * np.pi * order) for part in (alone, omega, half))

    def longest(frequency: float, x: Array) -> float:
        wanted = by_excitation.copy()
        if hidden.any():
            force, largest = balance.driven(x, frequency)
            wanted[: len(force)] |= np.abs(force @ vectors) * rise > SEEN * largest
        away = np.maximum(np.maximum(low - frequency, frequency - high), width)
        return SHARE * float(away.min(initial=np.inf, where=wanted))

    return longest
