"""Resonances that contacts hardly feel, as of two equal blades that move together beside a contact between them.

The unknowns of a balance are the motions of its contacts. Where these show nothing of a resonance, a curve takes steps
that lead past its peak.
"""

from collections.abc import Callable

import numpy as np

from timesim.model.held import natural_modes
from timesim.model.model import Model

# By how many halves of its width stuck contacts move a resonance at most that they hardly feel. Those that they move
# more move them as well.
FELT = 10.0
# Longest step, as a share of the way to such a resonance and, next to it, of half its width.
SHARE = 0.25
# Share of the largest force on a mode that is rounding.
ROUNDING = 1e-12
# Half the width of a resonance without damping, as a share of its frequency.
SHARPEST = 1e-6


def steps_to_resolve(model: Model) -> Callable[[float], float]:
    """How far at most a step leads from a frequency [Hz] that is to show all resonances that contacts hardly feel."""
    structure, excited = model.structure, model.excitation
    root = np.sqrt(structure.mass)
    omega, vectors = natural_modes(model, np.arange(root.size), np.arange(model.num_contacts))
    vectors = np.eye(root.size) if vectors is None else vectors
    alone = np.hypot.reduce(structure.omega[:, None] * vectors, axis=0)
    shapes = vectors / root[:, None]
    damping = np.diag(structure.damping) if structure.damping.ndim == 1 else structure.damping
    half = np.maximum(np.einsum("im,ij,jm->m", shapes, damping, shapes) / 2, SHARPEST * omega)
    hidden = (omega > 0) & (omega - alone <= FELT * half)
    force = np.abs((excited.cosine + 1j * excited.sine) @ shapes)
    force[excited.harmonic == 0] = 0.0
    order, place = np.nonzero(force[:, hidden] > ROUNDING * force.max(initial=0.0))
    low, high, width = (part[hidden][place] / (2 * np.pi * excited.harmonic[order]) for part in (alone, omega, half))

    def longest(frequency: float) -> float:
        away = np.maximum(np.maximum(low - frequency, frequency - high), width)
        return SHARE * float(away.min(initial=np.inf))

    return longest
