"""Interrupts at places that lose nothing: a signal is noted, and raised where the work reports its progress."""

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Any, Self

from timesim.study.execution.progress import Progress

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a run: Ctrl-C, the time limit of a cluster, the end of a session."""

LAST_SIGNAL = 3
"""The Ctrl-C, counted from 1, that ends the program whatever it is doing."""

LATER = 0.05  # seconds after which a signal that was lost is raised once more


class Interrupts:
    """Takes the first signal that would interrupt the main thread; further ones act at once, as without it.

    Attributes:
        seen: whether there was one.
    """

    def __init__(self) -> None:
        self.seen = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            handlers = {number: signal.getsignal(number) for number in ENDING}
            self._before = {number: handler for number, handler in handlers.items() if callable(handler)}
            for number in self._before:
                signal.signal(number, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if self.seen:
            self._before[number](number, frame)
            return
        self.seen = True
        with suppress(KeyboardInterrupt):
            self._before[number](number, frame)

    def raised_by(self, progress: Progress) -> Progress:
        """The progress, which raises the interrupt after it has taken in what is done."""

        def show(done: float, number: float, phase: str = "", /) -> None:
            progress(done, number, phase)
            if self.seen:
                raise KeyboardInterrupt

        return show


class Signals:
    """Ctrl-C during a run, the SIGTERM that a cluster sends at its time limit, or the end of a session.

    The first one ends the study, which keeps what it has computed. After that, and while a result is being assembled or
    saved, only the third is obeyed.

    One that comes while the garbage collector calls back, as it calls JAX, or while an object is finalised, is lost
    there like any exception, so it is raised once more a little later.
    """

    def __init__(self) -> None:
        self.saving, self._count, self._last = False, 0, int(signal.SIGINT)

    def __enter__(self) -> Self:
        # Signals that a shell has its background jobs ignore stay ignored.
        caught = [number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN]
        self._before = {number: signal.signal(number, self._take) for number in caught}
        self._hook, sys.unraisablehook = sys.unraisablehook, self._lost
        return self

    def __exit__(self, *_: object) -> None:
        sys.unraisablehook = self._hook
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, *_: object) -> None:
        self._last = number
        self._count += 1
        if self.saving and self._count < LAST_SIGNAL:
            os.write(2, b"note: what is computed is being saved\n")  # print is not reentrant
            return
        self.saving = True
        raise KeyboardInterrupt

    def _lost(self, unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._hook(unraisable)
            return
        self.saving, self._count = False, self._count - 1
        again = threading.Timer(LATER, os.kill, (os.getpid(), self._last))
        again.daemon = True
        again.start()
