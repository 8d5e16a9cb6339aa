"""All curves of a study: one set of values after the other in this process, and on others once that takes long."""

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from functools import partial

from xarray import Dataset

from timesim.hbm.continuation import Ending
from timesim.hbm.curve import HbmCurve
from timesim.result.file import StoreError
from timesim.result.label import counted, in_words
from timesim.result.state import SavedStates
from timesim.study.curves.aside import PARTS, counting
from timesim.study.curves.collection import Curves, StudyCurve, Sweep
from timesim.study.curves.kept import Found, KeptCurves
from timesim.study.execution.campaign import Execution
from timesim.study.execution.processes import LASTS
from timesim.study.outcome import attributes

FOLLOWED = 0.6  # share of the time of a curve; its multipliers take the rest


def follow_all(curves: Curves, execution: Execution, kept: KeptCurves, passing: SavedStates | None) -> str | None:
    """Add the curves of all sets of values, and return why some are incomplete, or None.

    The curves of a set depend on those of the others only by the number of samples with which they begin, which is what
    the first set needed. The progress counts sets of values. ``passing``: a sweep whose settled points the curves are
    to pass, besides that of the plan's start.
    """
    sweeps = [sweep for sweep in (curves.plan.passing, passing and (passing, {})) if sweep]
    work = _Work(curves, execution, kept, sweeps)
    try:
        work.carry_out()
    except KeyboardInterrupt:
        work.take_rest()
        left = len(curves.values) - len(work.added)
        if Ending.INTERRUPTED not in [own.curve.ending for own in curves.curves]:
            at = f"at curve {len(curves.curves) + 1}" if left else "behind the last curve"
            curves.faults.append(f"interrupted {at}")
        elif left:
            curves.faults.append(f"the curves of {left} of {len(curves.values)} sets of values are missing")
    except StoreError as error:
        work.take_rest()
        curves.faults.append(str(error))
    return "; ".join(curves.faults) or None


class _Work:
    """The sets of values by their places: those whose curves are found, and those whose curves are added."""

    def __init__(self, curves: Curves, execution: Execution, kept: KeptCurves, sweeps: Sequence[Sweep]):
        self.curves, self.execution, self.kept, self.sweeps = curves, execution, kept, sweeps
        self.begun = time.monotonic()
        self.first = curves.none
        self.found: dict[int, Found] = {}
        self.added: set[int] = set()
        self.parts: dict[int, int] = {}

    def carry_out(self) -> None:
        """Add the curves of all sets, in their order.

        Raises:
            KeyboardInterrupt: it was interrupted; there may be more found than added.
            StoreError: what was found cannot be kept.
        """
        places = range(len(self.curves.values))
        for place in places:
            if (done := self.kept.load(place)) is not None:
                self._know(place, done)
        for place in places:
            if place not in self.found and (left := self._for_processes()):
                self._elsewhere(left)
            if place not in self.found:
                self._here(place)
            self._add(place)
            self.execution.progress(len(self.found), len(places), "harmonic balance")

    def take_rest(self) -> None:
        """Add the curves that are found but not added yet."""
        for place in sorted(self.found.keys() - self.added):
            with suppress(KeyboardInterrupt):
                self._add(place)

    def _add(self, place: int) -> None:
        (curves, notes, _), values = self.found[place], self.curves.values[place]
        self.added.add(place)
        self.curves.notes += [note for note in notes if note not in self.curves.notes]
        self.curves.add(StudyCurve(values, self.curves.model_at(values), curve) for curve in curves)

    def _here(self, place: int) -> None:
        """Find the curves of a set."""
        own = self.first.none
        try:
            watch = partial(self._grown, place, own)
            own.follow(self.curves.values[place], self.sweeps, watch, self.execution.several)
        except KeyboardInterrupt:
            self._know(place, own.found)
            raise
        self._know(place, own.found)
        self.kept.save(place, own.found)

    def _grown(self, place: int, own: Curves, share: float, so_far: Callable[[], HbmCurve]) -> None:
        """Show the progress of a curve that is followed in this process, and keep what there is of it on disk."""
        values, number = self.curves.values, len(self.curves.curves) + len(own.curves) + 1
        words = filter(None, (f"curve {number}: {share:.0%} of the range", in_words(values[place])))
        self.execution.progress(place + _part(own, share), len(values), ", ".join(words))
        self.kept.grow(lambda: self._record(place, own, so_far()))

    def _record(self, place: int, own: Curves, curve: HbmCurve) -> Dataset:
        """The result so far."""
        grown, values = self.curves, self.curves.values[place]
        for one in (*own.curves, StudyCurve(values, own.model_at(values), curve)):
            grown = grown.with_curve(one)
        attrs = attributes(grown.scene, str(grown.scheme), 0.0, 0.0, curve.message, integrated=False)
        return grown.record(attrs)

    def _know(self, place: int, found: Found) -> None:
        """Take in what was found for a set, and the samples that it needed."""
        self.found[place] = found
        self.curves.have_samples(found[2])
        if place == 0:
            self.first.have_samples(found[2])

    def _for_processes(self) -> list[int]:
        """The sets that are given to processes: all that are left after the first, once the work takes long."""
        left, processes = sorted(set(range(len(self.curves.values))) - self.found.keys()), self.execution.several
        if processes is None or 0 in left or len(left) < 2:
            return []
        return left if processes.begun or time.monotonic() - self.begun > LASTS else []

    def _elsewhere(self, places: Sequence[int]) -> None:
        """Find the curves of some sets on processes. Where a process is killed, sets remain."""
        processes = self.execution.several
        assert processes is not None
        asked = [(self.first, self.curves.values[place], self.sweeps) for place in places]
        works = [(partial(self._count, place), followed_set, own) for place, own in zip(places, asked, strict=True)]
        with suppress(BrokenExecutor):
            for number, (found, whole) in processes.each(works):
                self._know(places[number], found)
                if whole:
                    self.kept.save(places[number], found)
                self._show()

    def _count(self, place: int, parts: int) -> None:
        self.parts[place] = parts
        self._show()

    def _show(self) -> None:
        under_way = [parts for place, parts in list(self.parts.items()) if place not in self.found]
        done, number = len(self.found) + sum(under_way) / PARTS, len(self.curves.values)
        sets = counted(len(under_way), "set of values", "sets of values")
        self.execution.progress(done, number, f"harmonic balance, {sets} side by side")


def _part(own: Curves, share: float) -> float:
    """The part of the work on a set that is done when a share of the range of the present curve is followed."""
    before = len(own.curves)
    # How many further curves will begin from points of a sweep is not known beforehand.
    expected = max(before + 1, 1 + own.plan.both_ends)
    return (before + FOLLOWED * share) / expected


def followed_set(none: Curves, values: Mapping[str, float], sweeps: Sequence[Sweep]) -> tuple[Found, bool]:
    """Find the curves of a set of values in another process; and whether they are complete, or it was halted."""
    own = none.none
    try:
        own.follow(values, sweeps, counting(lambda share: _part(own, share)))
    except KeyboardInterrupt:
        return own.found, False
    return own.found, True
