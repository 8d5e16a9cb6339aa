"""The motion at a point of a sweep, integrated again from the state in its result, with the record of a transient."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.fault import RuleError
from timesim.orbit.steady_state import BRIEF
from timesim.orbit.threshold import UNSETTLED_CYCLES
from timesim.picture.choice import motions
from timesim.picture.style import unit
from timesim.result.label import axis_value, counted, is_scalar_key
from timesim.result.netcdf import read
from timesim.result.state import states_in
from timesim.study.outcome import DOUBT
from timesim.study.registry import carry_out, load_scene

SAMPLES = 400  # of a cycle
OTHER = 0.01  # share of the largest amplitude; that of a settled motion, from these samples, differs by less than 1e-3
ROUNDING = 1e-9  # share of the amplitude up to which a mean is none; a motion settles to 1e-8 by default
SHOWN = ("cycles", "harmonic_amplitude", "phase_deg", "dissipated_power", "irregular")
"""Variables of a point beside those of its state; results of earlier versions lack some."""
POINTLESS = {
    "hbm": "harmonic balance, whose solutions are not integrated",
    "tradeoff": "one run by several methods",
} | dict.fromkeys(("element", "element_map"), "a contact under prescribed motion")
"""Studies whose result has no points of a sweep, by what it is of."""


@dataclass(frozen=True)
class Point:
    """A point of a sweep and its motion.

    Attributes:
        name: its values along the axes of the sweep, ``frequency=0.945,direction=up``.
        motion: one period, or ten cycles of a motion without one: the result of a transient.
        table: the lines that the command prints.
        reason: why the motion could not be computed to its end; None if it was.
    """

    name: str
    motion: Dataset
    table: tuple[str, ...]
    reason: str | None


def point_again(path: Path | str, at: Mapping[str, float | str]) -> Point:
    """Integrate the motion at a point of a sweep again.

    Args:
        path: result file of a study with a sweep, or the folder of its run.
        at: the point, values along the axes of the sweep by name.

    Raises:
        RuleError: the result has no such point, or more than one, or holds no states; the key is the axis.
        StoreError: no such result.
        SceneError: the scene of the result cannot be built any more.
    """
    groups = read(path)
    sweep = groups.get("sweep", groups[""])
    if what := POINTLESS.get(groups[""].attrs["study"]):
        hint = "a sweep, or kind: compare, has points to show; `timesim plot` draws the pictures"
        raise RuleError((), f"is of {what}", hint)
    states = states_in(sweep)
    if not states.axes:
        hint = "`timesim plot` draws its pictures, `show` is for a point of a sweep"
        raise RuleError((), f"is of one run, a {groups[''].attrs['study']}, which shows its motion itself", hint)
    if missing := [name for name in SHOWN if name not in sweep.variables]:
        raise RuleError((), f"lacks {', '.join(missing)}", "it is of an earlier version of timesim: run it again")
    states.one(at)
    places = {name: places[0] for name, places in states.places(at).items()}
    where = {name: values[places[name]].item() for name, values in states.axes.items()}
    here = sweep.isel(places)
    overrides = {key: value for key, value in where.items() if is_scalar_key(key) and not key.startswith("initial.")}
    texts = {name: f"{axis_value(value)}{' Hz' if name == 'frequency' else ''}" for name, value in where.items()}
    words = ", ".join(f"{name} {text}" for name, text in texts.items())
    cycles = int(here["period"]) or UNSETTLED_CYCLES
    overrides |= {
        "title": ": ".join(filter(None, (words, groups[""].attrs.get("title")))),
        "study": {"kind": "transient", "cycles": cycles, "samples_per_cycle": SAMPLES},
        "excitation.frequency": where["frequency"],
        "initial": {"from": str(Path(path).absolute()), "at": where},
    }
    outcome = carry_out(load_scene(groups[""].attrs["scene"], overrides))
    motion = outcome.groups[""]
    name = ",".join(f"{name}={axis_value(value)}" for name, value in where.items())
    table = (f"{words}: {_kind(here)}", *_table(here, motion), *([] if outcome.reason else _changes(here, motion)))
    return Point(name, motion, table, outcome.reason)


def _kind(here: Dataset) -> str:
    """The kind of motion, in words."""
    period, cycles = int(here["period"]), counted(int(here["cycles"]), "cycle")
    more = f"of its last {UNSETTLED_CYCLES} are the numbers, {UNSETTLED_CYCLES} more are drawn"
    if int(here["irregular"]):
        return f"does not repeat in {cycles}: quasi-periodic or irregular; {more}"
    if not period:
        return f"not settled after {cycles}; {more}"
    apart = " but for its drift" if "drift" in here and here["drift"].values.any() else ""
    return f"repeats {'every cycle' if period == 1 else f'after {period} cycles'}{apart}, settled after {cycles}"


def _changes(here: Dataset, motion: Dataset) -> Iterator[str]:
    """That a motion which repeats is another than that of the result, as where a file of matrices has changed since."""
    before, now = here["amplitude"].values, np.ptp(motion["displacement"].values, axis=0) / 2
    drifts = "drift" in here and here["drift"].values.any()
    if int(here["period"]) and not drifts and np.abs(now - before).max() > OTHER * before.max():
        place = np.unravel_index(np.argmax(np.abs(now - before)), before.shape)
        moved = f"{here['point'].values[place[0]]} {here['axis'].values[place[1]]}"
        yield (
            f"{DOUBT}computed again, {moved} moves by {now[place]:.5g}, not by {before[place]:.5g} as in the result: a "
            "file that the scene names may have changed since; run it again"
        )


def _table(here: Dataset, motion: Dataset) -> Iterator[str]:
    """Amplitude, phase and mean of the points that move; states, power and largest forces of the contacts."""
    shown = [here.sel(point=point, axis=axis) for point, axis in motions(here, here["amplitude"].values)]
    columns: dict[str, Iterable[Any]] = {
        "point": [str(one["point"].values) for one in shown],
        "axis": [str(one["axis"].values) for one in shown],
        f"amplitude{unit(here, 'amplitude')}": [float(one["amplitude"]) for one in shown],
        f"phase{unit(here, 'phase_deg')}": [float(one["phase_deg"]) for one in shown],
        f"mean{unit(here, 'harmonic_amplitude')}": [_mean(one) for one in shown],
    }
    yield from _lines(columns)
    if not here.sizes["contact"]:
        return
    stops = here["friction"].values == 0
    force, slip, apart = motion["contact_force"].values, here["slip_share"].values, here["separation_share"].values
    force = force if len(force) else np.full((1, *force.shape[1:]), np.nan)  # cut off before its first sample
    columns = {
        "contact": here["contact"].values.tolist(),
        "stick": np.where(1 - slip - apart > BRIEF, 1 - slip - apart, 0.0),
        "slip, closed" if stops.any() else "slip": slip,
        "separation": apart,
        f"power{unit(here, 'dissipated_power')}": here["dissipated_power"].values,
        f"largest |f|{unit(motion, 'contact_force')}": np.hypot(force[..., 0], force[..., 1]).max(axis=0),
        f"largest n{unit(motion, 'contact_force')}": force[..., 2].max(axis=0),
    }
    yield from _lines(columns)


def _mean(one: Dataset) -> float:
    """The mean of a motion along an axis, 0 where it is rounding."""
    mean = float(one["harmonic_amplitude"].sel(harmonic=0))
    return mean if abs(mean) > ROUNDING * float(one["amplitude"]) else 0.0


def _lines(columns: Mapping[str, Iterable[Any]]) -> Iterator[str]:
    """Columns by their headings as lines, text on the left, numbers on the right."""
    cells = []
    for head, values in columns.items():
        column = [head, *(value if isinstance(value, str) else f"{value + 0.0:.5g}" for value in values)]
        aligned = str.ljust if head in ("point", "axis", "contact") else str.rjust
        cells.append([aligned(cell, max(map(len, column))) for cell in column])
    yield from ("  ".join(line).rstrip() for line in zip(*cells, strict=True))
