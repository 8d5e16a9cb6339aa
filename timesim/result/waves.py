"""The motion that a time integration has settled to, by its Fourier coefficients: a start for `timesim.hbm.balance`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from timesim.orbit.fourier import fourier_coefficients
from timesim.result.netcdf import read

Array = NDArray[np.float64]
NEEDED = ("time", "modal_displacement", "cycle_start", "cycle_period", "final_phase_deg")


@dataclass(frozen=True)
class Waves:
    """A periodic motion.

    Attributes:
        frequency: of the excitation [Hz].
        modal: modal displacement by 1, cos, sin, ... of the excitation's phase, shape (2K + 1, M) [modal length].
    """

    frequency: float
    modal: Array


def result_waves(path: Path) -> Waves:
    """The last whole cycle that a transient recorded.

    Args:
        path: result file, or the folder of the run.

    Raises:
        ValueError: it holds no such cycle.
        StoreError: the file is no result.
    """
    root = read(path)[""]
    arrays = {str(name): array.values for name, array in root.variables.items()}
    if missing := [name for name in NEEDED if name not in arrays]:
        raise ValueError(f"result {path}: no {', '.join(missing)}; give the result of a transient")
    if not arrays["cycle_start"].size or arrays["time"].size < 3:
        raise ValueError(f"result {path}: no cycle was finished and recorded")
    period, end = arrays["cycle_period"][-1], arrays["time"][-1]
    rows = arrays["time"] > end - period * (1 - 1e-6)
    if not np.isclose(arrays["cycle_start"][-1] + period, end, rtol=1e-6, atol=1e-6 * period):
        raise ValueError(f"result {path}: it does not end with a whole cycle")
    return Waves(
        1 / period,
        fourier_coefficients(arrays["modal_displacement"][rows], float(np.deg2rad(arrays["final_phase_deg"]))),
    )
