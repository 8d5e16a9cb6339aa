"""Interrupts of a run: none is lost, wherever the main thread is when the signal comes."""

import gc
import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from timesim.study.execution.interrupts import ENDING, Signals
from timesim.study.registry import STUDIES, carry_out, load_scene

OSCILLATOR = Path(__file__).parents[3] / "configs" / "oscillator.yaml"
AT_MOST = 20.0  # seconds, far more than it takes


@pytest.mark.parametrize("sent", ENDING)
def test_one_that_comes_while_the_garbage_collector_calls_back_is_raised_once_more(
    sent: signal.Signals, capfd: pytest.CaptureFixture[str]
):
    def called_back(*_: Any) -> None:
        gc.callbacks.remove(called_back)
        signal.raise_signal(sent)

    def collect() -> None:
        gc.callbacks.append(called_back)
        gc.collect()
        time.sleep(AT_MOST)

    before = signal.signal(sent, signal.SIG_DFL)  # a job in the background ignores some
    try:
        with Signals() as signals:
            with pytest.raises(KeyboardInterrupt):
                collect()
            assert signals.saving
            signal.raise_signal(sent)  # the second is only noted
    finally:
        signal.signal(sent, before)
    assert capfd.readouterr().err == "note: what is computed is being saved\n"


def test_other_exceptions_that_cannot_be_raised_are_said_as_before(monkeypatch: pytest.MonkeyPatch):
    said: list[Any] = []
    monkeypatch.setattr("sys.unraisablehook", lambda unraisable: said.append(unraisable.exc_type))

    class Finalised:
        def __del__(self) -> None:
            raise ValueError

    with Signals(), suppress(KeyboardInterrupt):
        Finalised()
    assert said == [ValueError]


def test_one_that_comes_while_the_modules_of_a_study_are_imported_is_raised_after_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Raised while those of JAX are imported, it would end the process by a segmentation fault."""
    lines = ["import signal", "signal.raise_signal(signal.SIGINT)", "def study(scene, execution): ..."]
    (tmp_path / "slowly_imported.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(STUDIES, "sweep", replace(STUDIES["sweep"], run="slowly_imported:study"))
    scene = load_scene(OSCILLATOR, {"study": {"kind": "sweep", "frequency": {"values": [1.0]}}})
    assert "slowly_imported" not in sys.modules
    with pytest.raises(KeyboardInterrupt):
        carry_out(scene)
    assert callable(sys.modules.pop("slowly_imported").study)
