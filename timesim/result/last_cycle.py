"""The last whole cycle that a transient has recorded, read from its result."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from timesim.fault import RuleError
from timesim.model.mode_shapes import ModeShapes
from timesim.model.model import Structure
from timesim.orbit.fourier import fourier_coefficients
from timesim.result.netcdf import read
from timesim.result.state import SHAPE

if TYPE_CHECKING:
    from xarray import Dataset

SAME = 1e-6  # share of a cycle by which the time of a sample may be off


def last_cycle(path: Path, *names: str) -> "tuple[Dataset, np.ndarray]":
    """The result of a transient, and which of its samples lie in its last whole cycle, both ends included.

    Raises:
        ValueError: the result lacks one of the variables that are named, or no cycle was recorded whole.
        StoreError: the file, or the folder of a run, holds no result.
    """
    data = read(path)[""]
    if missing := [name for name in ("time", "cycle_start", "cycle_period", *names) if name not in data.variables]:
        raise ValueError(f"result {path}: no {', '.join(missing)}; give the result of a transient")
    if not data.sizes["cycle"]:
        raise ValueError(f"result {path}: no cycle was finished")
    time, start, period = data["time"].values, data["cycle_start"].values[-1], data["cycle_period"].values[-1]
    rows = np.flatnonzero((time >= start - SAME * period) & (time <= start + period * (1 + SAME)))
    if rows.size < 3 or time[rows[-1]] - time[rows[0]] < period * (1 - 2 * SAME):
        raise ValueError(f"result {path}: its last cycle was not recorded whole")
    return data, rows


@dataclass(frozen=True)
class PeriodicMotion:
    """A periodic motion, from which harmonic balance may start.

    Attributes:
        frequency: of the excitation [Hz].
        modal: modal displacement by 1, cos, sin, ... of the excitation's phase, shape (2K + 1, M) [modal length].
        shapes: of its modes; None where a result of an earlier version does not hold them.
    """

    frequency: float
    modal: np.ndarray
    shapes: ModeShapes | None = None

    def guess(self, structure: Structure) -> np.ndarray:
        """`modal` in the modes of a structure, or as it is where its points do not determine that."""
        with suppress(RuleError):
            change = None if self.shapes is None else self.shapes.change(structure)
            return self.modal if change is None else self.modal @ change.T
        return self.modal


def periodic_motion(path: Path) -> PeriodicMotion:
    """The last whole cycle that a transient recorded; errors as of `last_cycle`."""
    data, rows = last_cycle(path, "modal_displacement", "final_phase_deg")
    if rows[-1] < data.sizes["time"] - 1:
        raise ValueError(f"result {path}: it does not end with a whole cycle")
    motion, phase = data["modal_displacement"].values[rows[1:]], float(np.deg2rad(data["final_phase_deg"].values))
    shapes = ModeShapes(tuple(map(str, data["point"].values)), data[SHAPE].values) if SHAPE in data else None
    return PeriodicMotion(1 / data["cycle_period"].values[-1], fourier_coefficients(motion, phase), shapes)
