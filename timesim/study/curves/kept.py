"""Curves of harmonic balance on disk while a study runs: the finished ones, and the one that is being followed."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.hbm.continuation import Ending
from timesim.hbm.curve import HbmCurve
from timesim.hbm.scheme import Scheme
from timesim.result import checkpoint, netcdf
from timesim.result.checkpoint import Checkpoint, Result
from timesim.result.file import StoreError
from timesim.result.label import counted
from timesim.study.execution.campaign import Execution

Found = tuple[list[HbmCurve], list[str], tuple[Scheme, ...]]
"""The curves of a set of values, the notes on them, and the schemes that they needed."""
SECONDS_APART = 30.0
"""Least time between two writes of a growing curve [s]."""
TIMES_APART = 20.0
"""The same as a multiple of the time that a write takes."""


class KeptCurves:
    """The curves of each set of values, as a chunk of a checkpoint; without a run folder nothing is kept.

    `earlier` is the time spent on the curves that were taken up [s].
    """

    def __init__(self, kept: Checkpoint | None, notice: Callable[[str], None]):
        self._kept, self._notice = kept, notice
        self._next = time.monotonic() + SECONDS_APART
        self.earlier = 0.0 if kept is None else kept.earlier

    def load(self, place: int) -> Found | None:
        """What was found for a set of values; None if it is not finished."""
        result = None if self._kept is None else self._kept.load(_name(place), self._notice)
        return None if result is None else _read(result)

    def save(self, place: int, found: Found) -> None:
        """Keep what was found for a set of values.

        Raises:
            StoreError: the disk is full, or the folder may not be written.
        """
        if self._kept is not None:
            self._kept.save(_name(place), _written(*found))

    def grow(self, record: Callable[[], Dataset]) -> None:
        """Write all curves so far, including the one being followed, as a result file, unless the last is recent."""
        begun = time.monotonic()
        if self._kept is None or begun < self._next:
            return
        with suppress(StoreError):  # keeping the next finished curve raises it too
            netcdf.save(record(), self._kept.folder / checkpoint.GROWING_NAME)
        now = time.monotonic()
        self._next = now + max(SECONDS_APART, TIMES_APART * (now - begun))


@contextmanager
def kept_curves(execution: Execution, identity: str, sets: Sequence[Any], stage: str) -> Iterator[KeptCurves]:
    """Where the curves of a study are kept; ``sets`` holds what determines those of each set of values.

    ``identity`` and ``stage`` are those of `Execution.checkpoint`, whose errors it raises.
    """
    names = [_name(place) for place in range(len(sets))]
    with execution.checkpoint(identity, dict(zip(names, sets, strict=True)), stage) as (kept, begun):
        if kept is not None and begun:
            done = sum((kept.folder / f"{name}.npz").exists() for name in names)
            of_all = counted(len(sets), "set of values", "sets of values")
            execution.notice(f"the curves of {done} of {of_all} are taken up from {kept.folder}")
        yield KeptCurves(kept, execution.notice)


def _name(place: int) -> str:
    return f"curves-{place:05d}"


def _written(curves: Sequence[HbmCurve], notes: Sequence[str], schemes: Sequence[Scheme]) -> Result:
    arrays: dict[str, Any] = {"notes": np.array(notes, dtype=str), "count": np.array(len(curves))}
    arrays["schemes"] = np.array([(own.harmonics, own.time_samples) for own in schemes])
    for place, curve in enumerate(curves):
        values = {part.name: getattr(curve, part.name) for part in fields(curve)} | {"ending": curve.ending.name}
        arrays |= {f"{place}-{name}": np.asarray(value) for name, value in values.items()}
    return arrays


def _read(arrays: Result) -> Found:
    curves = []
    for place in range(int(arrays["count"])):
        own: Mapping[str, Any] = {part.name: arrays[f"{place}-{part.name}"] for part in fields(HbmCurve)}
        texts = {"ending": Ending[str(own["ending"])], "message": str(own["message"])}
        curves.append(HbmCurve(**{**own, **texts}))
    schemes = tuple(Scheme(*numbers) for numbers in arrays["schemes"].tolist())
    return curves, [str(note) for note in arrays["notes"]], schemes
