"""The `optimum` study: the peak of the response over frequency against a scalar, and the value where it is least."""

import time
from dataclasses import replace

import numpy as np
from xarray import Dataset

from timesim.orbit.settling import Chain, warm_up
from timesim.orbit.steady_state import COLUMNS, blank_columns
from timesim.result.dataset import Arrays
from timesim.result.label import counted
from timesim.scene.resolution import Scene
from timesim.study.execution.campaign import INTERRUPTED, Execution
from timesim.study.optimum.peak import Peak
from timesim.study.optimum.search import Peaks, SearchError
from timesim.study.outcome import Outcome, attributes
from timesim.study.summary.optimum import optimum_lines
from timesim.study.summary.sweep import failure_line
from timesim.study.sweep import Grid, steady_dataset


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run an optimum scene; the result is incomplete if the least peak was not found or points of a sweep failed."""
    peaks, reason = Peaks(scene, execution), None
    earlier, clock = execution.earlier(), time.perf_counter()
    models = Grid(scene, peaks.plan.sweep).models.values()
    if execution.cluster is None:
        warm_up((Chain(model, tuple(map(float, peaks.frequency))) for model in models), peaks.solver)
    compiling = time.perf_counter() - clock
    execution.progress(0, 1)
    try:
        peaks.search()
    except SearchError as error:
        reason = str(error)
    except KeyboardInterrupt:  # between two campaigns, each of which takes in its own
        reason = f"{INTERRUPTED}; {counted(len(peaks.results), 'value is', 'values are')} done and kept"
    data = data_of(peaks)
    reason = reason or failure_line(data)
    seconds = earlier + time.perf_counter() - clock - compiling
    attrs = attributes(scene, str(peaks.solver), compiling, seconds, reason)
    attrs |= {name: value for name, value in (("point", peaks.plan.point), ("axis", peaks.plan.axis)) if value}
    data = data.assign_attrs(attrs)
    return Outcome({"": data}, reason, tuple(optimum_lines(data, peaks.plan.accuracy)))


def data_of(peaks: Peaks) -> Dataset:
    """The result file: all values that were computed, ascending, and the best of them."""
    key, values, model = peaks.key, sorted(peaks.results), peaks.scene.model()
    columns = blank_columns(model, len(values), 2, peaks.frequency.size)
    for row, value in enumerate(values):
        for name in COLUMNS:
            columns[name][row] = peaks.results[value][name]
    least = peaks.least()
    best = peaks.results.get(least, {})
    found = {name: np.array([peaks.results[value].get(name, 0) for value in values]) for name in Peak._fields}
    motions = np.array([f"{point} {axis}" for point in model.structure.points for axis in "xyz"])
    found["peak_of"] = np.where(np.isfinite(found["peak"]), motions[found["peak_of"].astype(int)], "")
    own: Arrays = {
        **{name: ((key,), column) for name, column in found.items()},
        "optimum": ((), np.array(least)),
        "optimum_peak": ((), np.array(best.get("peak", np.nan))),
        "optimum_frequency": ((), np.array(best.get("peak_frequency", np.nan))),
    }
    grid = Grid(peaks.scene, replace(peaks.plan.sweep, over={key: tuple(values)}))
    data = steady_dataset(grid, columns, own)
    data["optimum"].attrs |= {name: text for name, text in data[key].attrs.items() if name == "units"}
    return data
