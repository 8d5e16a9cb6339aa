"""The summary of a run, in words, from its finished result."""

from collections.abc import Iterator

import numpy as np
from xarray import DataArray, Dataset

from timesim.engine.companion import amplitude_error
from timesim.model.promise import MARGIN, tightened
from timesim.model.solver import Solver
from timesim.result.coordinate import place_of_largest
from timesim.result.label import counted, with_unit
from timesim.scene.transient import Schedule
from timesim.study.outcome import DOUBT, took

PHASES = 12  # of a schedule at most that are listed
OPEN = 1e-2
"""Share of the energy from which on what a cycle leaves unexplained is no error of a few digits."""

STILL = 1e-12
"""Share of the largest displacement up to which an amplitude is rounding, as under a load that only holds."""

LEAST, FEWEST, LASTING = 1e-3, 3, 0.9
"""Share of the motion of a cycle by which a body that drifts must move on, cycles in which it must do so in one way,
and the share of its speed that it keeps over them."""


def transient_lines(data: Dataset, plan: Schedule) -> Iterator[str]:
    """A run: its size, how well its energy balance closes, and the phases of its schedule unless they are many.

    It gives the amplitude at the end, or at that of each phase, of the point and axis that move most during the run.
    """
    attrs, amplitude = data.attrs, data["cycle_amplitude"].values
    whole, transitions = counted(len(amplitude), "cycle"), counted(data.sizes["event"], "transition")
    yield f"{whole} by {attrs['method']} {took(attrs)}, {transitions}"
    if not len(amplitude):
        return
    largest = max(np.max(np.abs(data["energy_input"].values)), attrs["peak_stored_energy"])
    residual = np.max(np.abs(data["energy_residual"].values)) / largest if largest > 0 else 0.0
    closes = f"energy balance of a cycle closes to {residual:.1e} of the larger of input and stored energy"
    wrong = ": this is no motion of the scene; take finer tolerances or more steps"
    yield f"{DOUBT}{closes}{wrong}" if residual > OPEN else closes
    if "estimated_error" in attrs:
        yield from error_lines(data)
    ends = np.cumsum([cycles for _, cycles in plan.phases])
    if not 1 < len(plan.phases) <= PHASES:
        yield _reached(data, len(amplitude), "in the last cycle", len(amplitude) - 1 not in (0, *ends))
        return
    for number, ((frequency, cycles), end) in enumerate(zip(plan.phases, ends, strict=True), 1 - plan.run_up):
        if end <= len(amplitude):
            which = f"phase {number}" if number > 0 else "run-up"
            reached = _reached(data, end, "at its end", cycles > 1)
            yield f"{which}: {counted(cycles, 'cycle')} at {frequency:.6g} Hz, {reached}"


def _reached(data: Dataset, end: int, when: str, compared: bool) -> str:
    """The amplitude of a cycle, and perhaps how much the amplitudes of the one before differ."""
    amplitude = data["cycle_amplitude"].values
    point, axis = place_of_largest(amplitude)
    if amplitude[end - 1].max() <= STILL * np.abs(data["displacement"].values).max(initial=0.0):
        return f"nothing moves {when}"
    name = f"{data['point'].values[point]} {data['axis'].values[axis]}"
    size = with_unit(f"{amplitude[end - 1, point, axis]:.6g}", data["cycle_amplitude"].attrs)
    words = f"amplitude {size} of {name} {when}"
    if not compared:
        return words
    (change,) = amplitude_error(amplitude[end - 1 : end], amplitude[end - 2 : end - 1])
    return f"{words}; those of the cycle before differ by {change:.1e} of the largest"


def error_lines(data: Dataset) -> Iterator[str]:
    """The estimated error of a run, and the tolerances that might keep its promise if it has not."""
    attrs = data.attrs
    error, remark, promise = attrs["estimated_error"], attrs["estimate_remark"], attrs.get("promised_error", np.inf)
    if not np.isfinite(error):
        yield f"estimated error of the state at the end: not known, {remark}"
        return
    largest = float(data["cycle_amplitude_error"].max())
    sizes = f"{error:.1e} of its size, of the amplitude of a cycle at most {largest:.1e}"
    yield f"estimated error of the state at the end: {sizes}{f' ({remark})' if remark else ''}"
    if error <= promise:
        return
    now = Solver(attrs["method"].partition(",")[0], attrs.get("rtol", 0.0), attrs.get("atol", 0.0))
    better = tightened(now, promise / (MARGIN * error))
    over = f"{DOUBT}that is more than the {promise:.0e} that the accuracy promises"
    if "repetition" in attrs:
        yield f"{over}; a repetition with finer tolerances did not reach the end"
    elif better.rtol == now.rtol:
        yield f"{over}, and rounding allows no finer tolerance: the motion amplifies any error"
    else:
        yield f"{over}; try solver: {{method: {now.name}, rtol: {better.rtol:g}, atol: {better.atol:g}}}"


def drift_lines(data: Dataset, plan: Schedule, frequency: np.ndarray) -> Iterator[str]:
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


def largest_step(moved: DataArray, step: np.ndarray) -> str:
    """The largest of the steps of what is moved in words, with the point and axis: ``tip x by 0.1 mm``."""
    place = np.unravel_index(np.argmax(step), step.shape)
    name = f"{moved['point'].values[place[-2]]} {moved['axis'].values[place[-1]]}"
    return f"{name} by {with_unit(f'{step[place]:.4g}', moved.attrs)}"
