"""Steady states as arrays over the points of a study, and as the variables of a result file."""

from collections.abc import Mapping

import numpy as np

from timesim.orbit.fourier import phase_deg, signed_amplitude
from timesim.orbit.steady_state import BLANK, START, TAILS, Columns
from timesim.result.dataset import Arrays

# Names of some columns in the result file.
STORED = {
    "band": "amplitude_band",
    "reason": "failure",
    "end_displacement": "final_modal_displacement",
    "end_velocity": "final_modal_velocity",
    "end_slip": "final_slip",
    "end_state": "final_contact_state",
}

# Of a solver's rtol: what its steps leave in a harmonic that the motion has not, relative to the largest, is less.
STEP_NOISE = 0.1


def variables_of(columns: Columns, axes: Mapping[str, int], rtol: float) -> Arrays:
    """Steady states as variables of a result file; a point that failed has no state.

    The columns may have any dimensions of the points first, which become axes of these names and sizes. Where the first
    harmonic may be all of it what has not settled yet, or noise of steps of this relative tolerance, it has no phase.
    """
    phasor, failed = columns["phasor"], columns["reason"] != ""
    values = {name: array for name, array in columns.items() if name != "phasor"}
    error = np.fmax(columns["settled_to"], STEP_NOISE * rtol)
    values |= {"phase_deg": phase_deg(phasor, error), "harmonic_amplitude": signed_amplitude(phasor)}
    values |= {"harmonic_cos": phasor.real, "harmonic_sin": 0.0 - phasor.imag, "reason": columns["reason"].astype(str)}
    for name in START:
        blank, kind = BLANK.get(name, (np.nan, float))
        missing = failed.reshape(*failed.shape, *[1] * len(TAILS[name]))
        values[name] = np.where(missing, blank, values[name]).astype(kind)

    def shaped(array: np.ndarray) -> np.ndarray:
        return array.reshape(*axes.values(), *array.shape[failed.ndim :])

    return {STORED.get(name, name): ((*axes, *TAILS.get(name, ())), shaped(value)) for name, value in values.items()}
