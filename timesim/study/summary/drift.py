"""Motions that nothing holds: cycle after cycle a point moves on, as a free body does under a constant force.

In steady states a drift shows in the amplitudes: those of single cycles are alike, and that over several of them is
larger by half of what is covered meanwhile.
"""

from collections.abc import Iterator

import numpy as np
from xarray import DataArray, Dataset

from timesim.orbit.threshold import UNSETTLED_CYCLES
from timesim.result.label import with_unit
from timesim.scene.transient import Schedule

STEADY = 2e-3
"""Largest difference of the single cycles' amplitudes, as a share of what the drift adds: a contact that creeps to its
limit must do so for 500 cycles to pass, over which it settles."""
LEAST = 1e-3  # share of the motion of a cycle that it must move on by
FEWEST, LASTING = 3, 0.9  # cycles of a run that it must move on in one way, and the share of its speed that it keeps


def step_of_points(data: Dataset) -> np.ndarray:
    """Length by which each point of a sweep that drifts moves on in a cycle, shape (..., P, 3); 0 where it does not."""
    low, high = (data["amplitude_band"].isel(band=i).values for i in (0, 1))
    added = data["amplitude"].values - high
    moves = (added > LEAST * high) & (high - low <= STEADY * added) & (data["settled"].values == 0)[..., None, None]
    return np.where(moves, 2 * added / (UNSETTLED_CYCLES - 1), 0.0)


def largest_step(moved: DataArray, step: np.ndarray) -> str:
    """The largest of the steps of what is moved in words, with the point and axis: ``tip x by 0.1 mm``."""
    place = np.unravel_index(np.argmax(step), step.shape)
    name = f"{moved['point'].values[place[-2]]} {moved['axis'].values[place[-1]]}"
    return f"{name} by {with_unit(f'{step[place]:.4g}', moved.attrs)}"


def run_lines(data: Dataset, plan: Schedule, frequency: np.ndarray) -> Iterator[str]:
    """A line on a run at whose end a free body drifts; ``frequency``: of the modes, [Hz]."""
    if frequency.all() or not data.attrs["complete"]:
        return
    kept = min(plan.phases[-1][1], (data.sizes["time"] - 1) // plan.samples_per_cycle)
    last = data["displacement"].values[-(kept - kept // 2) * plan.samples_per_cycle - 1 :]
    step = np.diff(last[:: plan.samples_per_cycle], axis=0)
    if len(step) < FEWEST:
        return
    size = np.abs(step)
    lasts = (np.abs(step.sum(axis=0)) == size.sum(axis=0)) & (size[-1] >= LASTING * size.max(axis=0))
    moves = np.where(lasts & (size[-1] > LEAST * np.ptp(last[-plan.samples_per_cycle - 1 :], axis=0)), size[-1], 0.0)
    if moves.any():
        yield f"the body drifts, in the last cycle {largest_step(data['displacement'], moves)}: nothing holds it"
