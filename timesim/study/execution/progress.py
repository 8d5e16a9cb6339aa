"""How much of a run is done, over all its phases: the share, the rate and the time left, for a bar or a line.

Every kind of work counts as a number of points, so that one bar runs through all phases.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Protocol

from timesim.result.label import counted

CURVE = 100
"""Points of a sweep that take about as long as a curve of harmonic balance: 20 ms each, 1 to 3 s (both measured on the
oscillator)."""

NEARLY_ALL = 0.99  # the most that is shown while a run goes on


class Progress(Protocol):
    """Takes in how much of some work is done."""

    def __call__(self, done: float, number: float, phase: str = "", /) -> None:
        """Take in how many points, cycles or curves of all of them are done, and what is being done, in words."""


def unwatched(done: float, number: float, phase: str = "", /) -> None:
    """A `Progress` that ignores everything."""


@dataclass(frozen=True)
class Phases:
    """The phases of a study as one progress, each counting as a number of points, in the order in which they come."""

    whole: Progress
    sizes: Mapping[str, float]

    def __getitem__(self, name: str) -> Progress:
        """The progress of one phase, in any unit of its own."""
        names = list(self.sizes)
        before = sum(self.sizes[phase] for phase in names[: names.index(name)])

        def show(done: float, number: float, phase: str = "", /) -> None:
            share = min(done / number, 1.0) if number else 1.0
            words = phase or f"{name}, {done:.0f} of {counted(round(number), 'point')}"
            self.whole(before + share * self.sizes[name], sum(self.sizes.values()), words)

        return show


class Standing:
    """Where a run stands: takes in its progress, and puts it into words.

    Attributes:
        share: of the whole run, at most `NEARLY_ALL`; it never falls.
        phase: what is being done, in words.
    """

    def __init__(self, unit: str, earlier: float = 0.0, clock: Callable[[], float] = time.monotonic):
        """For a run that counts in ``unit``, earlier parts of which have taken ``earlier`` seconds."""
        self.unit, self.clock, self.share, self.phase = unit, clock, 0.0, "compiling programs, or loading them"
        self._earlier, self._number = earlier, 0.0
        self._begun = self._worked = self._advanced = clock()

    def __call__(self, done: float, number: float, phase: str = "", /) -> None:
        if not done:
            self._worked = self.clock()  # up to now it has compiled
        share = min(done / number if number else 0.0, NEARLY_ALL)
        if share > self.share:
            self.share, self._advanced = share, self.clock()
        self.phase, self._number = phase, number

    @property
    def percent(self) -> str:
        return f"{int(100 * self.share + 1e-9)} %"

    @property
    def elapsed(self) -> float:
        """Seconds of all parts of the run."""
        return self._earlier + self.clock() - self._begun

    @property
    def _spent(self) -> float:
        """Seconds in which the share was done.

        Those since it last rose count once they are more than were left by the rate before.
        """
        done, waited = self._earlier + self._advanced - self._worked, self.clock() - self._advanced
        return done + waited if waited >= done * (1 / self.share - 1) else done

    @property
    def left(self) -> float | None:
        """Seconds left at the rate of all parts so far; None where nothing is done yet."""
        if not self.share > 0 or not self._spent > 0:
            return None
        since = self._earlier + self.clock() - self._worked - self._spent
        return self._spent * (1 / self.share - 1) - since

    def line(self) -> str:
        """All of this in a line, with what may be long at its end."""
        parts = [self.percent, f"{_clock_time(self.elapsed)} so far", self.phase]
        if (left := self.left) is not None:
            rate = self.share * self._number / self._spent
            parts[1:1] = [f"{rate:.0f} {self.unit}/s" if rate >= 100 else f"{rate:.3g} {self.unit}/s"]
            parts[-1:-1] = [f"{_clock_time(left)} left"]
        return ", ".join(parts)

    @contextmanager
    def told(self, seconds: float, say: Callable[[str], None]) -> Iterator[None]:
        """Say `line` every so many seconds."""
        over = threading.Event()

        def lines() -> None:
            while not over.wait(seconds):
                say(self.line())

        thread = threading.Thread(target=lines, name="timesim-progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


def _clock_time(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
