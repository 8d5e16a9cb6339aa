"""Motions that nothing holds: cycle after cycle a point moves on, as a free body does under a constant force."""

from collections.abc import Iterator

import numpy as np
from xarray import DataArray, Dataset

from timesim.result.label import with_unit
from timesim.scene.transient import Schedule

LEAST = 1e-3  # share of the motion of a cycle that it must move on by
FEWEST, LASTING = 3, 0.9  # cycles of a run that it must move on in one way, and the share of its speed that it keeps


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
