"""Steady states as arrays over the points of a study, and as the variables of a result file."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from timesim.model.model import Model
from timesim.orbit.fourier import HARMONICS, phase_deg, signed_amplitude
from timesim.orbit.steady_state import COLUMNS, START, Columns
from timesim.result.dataset import Arrays

# Dimensions of the quantities of a point after those of the sweep; values for points that were not computed, where
# these are not NaN; names of some columns in the result file.
TAILS = {
    **dict.fromkeys(("amplitude", "phase_deg", "drift"), ("point", "axis")),
    **dict.fromkeys(("phasor", "harmonic_amplitude", "harmonic_cos", "harmonic_sin"), ("harmonic", "point", "axis")),
    "band": ("band", "point", "axis"),
    **dict.fromkeys(("slip_share", "separation_share", "dissipated_power", "cycle_transitions"), ("contact",)),
    **dict.fromkeys(("end_displacement", "end_velocity"), ("mode",)),
    "end_slip": ("contact", "tangent"),
    "end_state": ("contact",),
}
BLANK: dict[str, tuple[Any, type]] = {
    **dict.fromkeys(("settled", "cycles", "period", "irregular"), (0, np.int32)),
    "end_state": (-1, np.int8),
    "phasor": (np.nan, complex),
    "reason": ("", object),
}
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


def blank_columns(model: Model, *shape: int) -> dict[str, np.ndarray]:
    """Columns of points that were not computed; ``shape`` is that of the points."""
    sizes, arrays = sizes_of(model), dict[str, np.ndarray]()
    for name in COLUMNS:
        fill, kind = BLANK.get(name, (np.nan, float))
        arrays[name] = np.full((*shape, *(sizes[dim] for dim in TAILS.get(name, ()))), fill, dtype=kind)
    return arrays


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


def sizes_of(model: Model) -> dict[str, int]:
    """Lengths of the dimensions that a model determines, or that are the same everywhere."""
    own = {"point": len(model.structure.points), "contact": model.num_contacts, "mode": model.structure.num_modes}
    return own | {"axis": 3, "band": 2, "tangent": 2, "harmonic": HARMONICS + 1}
