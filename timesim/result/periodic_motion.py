"""The motion that a time integration has settled to, by its Fourier coefficients: a start for `timesim.hbm.balance`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from timesim.orbit.fourier import fourier_coefficients
from timesim.result.last_cycle import last_cycle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PeriodicMotion:
    """A periodic motion.

    Attributes:
        frequency: of the excitation [Hz].
        modal: modal displacement by 1, cos, sin, ... of the excitation's phase, shape (2K + 1, M) [modal length].
    """

    frequency: float
    modal: Array


def periodic_motion(path: Path) -> PeriodicMotion:
    """The last whole cycle that a transient recorded.

    Args:
        path: result file, or the folder of the run.

    Raises:
        ValueError: it holds no such cycle.
        StoreError: the file is no result.
    """
    data, rows = last_cycle(path, "modal_displacement", "final_phase_deg")
    if rows[-1] < data.sizes["time"] - 1:
        raise ValueError(f"result {path}: it does not end with a whole cycle")
    motion, phase = data["modal_displacement"].values[rows[1:]], float(np.deg2rad(data["final_phase_deg"].values))
    return PeriodicMotion(1 / data["cycle_period"].values[-1], fourier_coefficients(motion, phase))
