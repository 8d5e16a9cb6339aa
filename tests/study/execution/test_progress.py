"""What is shown of a run on its way: over all its phases, with the rate and the time left."""

import os
import pty
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toys
from toys import chains

from timesim import cli
from timesim.result import checkpoint
from timesim.study.execution.campaign import Chunk, Execution, Result, carry_through
from timesim.study.execution.progress import Phases, Standing, unwatched
from timesim.study.execution.worker import point_done


class Clock:
    """Seconds that a test sets."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_the_time_left_is_that_of_all_parts_so_far():
    clock = Clock()
    standing = Standing("points", earlier=30.0, clock=clock)
    clock.now = 5.0
    standing(0, 100, "sweep, 0 of 100 points")
    assert standing.line() == "0 %, 0:00:35 so far, sweep, 0 of 100 points"
    clock.now = 15.0
    standing(40, 100, "sweep, 40 of 100 points")
    # 40 points in the 30 s before and the 10 s after the programs were compiled.
    assert standing.line() == "40 %, 1 points/s, 0:00:45 so far, 0:01:00 left, sweep, 40 of 100 points"


def test_the_time_left_falls_while_nothing_advances():
    clock = Clock()
    standing = Standing("points", clock=clock)
    standing(0, 100)
    clock.now = 10.0
    standing(40, 100)
    left = []
    for now in (10.0, 14.0, 24.0, 30.0):
        clock.now = now
        standing(40, 100, "40 of 100 points")
        left.append(standing.left)
    assert left == [15.0, 11.0, 1.0, 45.0]  # more than was left has passed: it is slower than it was
    assert standing.line() == "40 %, 1.33 points/s, 0:00:30 so far, 0:00:45 left, 40 of 100 points"


def test_all_of_it_is_never_shown_as_done_and_the_share_never_falls():
    standing = Standing("points")
    shown = []
    for done, number in ((50, 100), (100, 100), (30, 100), (1000, 100)):
        standing(done, number)
        shown.append(standing.percent)
    assert shown == ["50 %", "99 %", "99 %", "99 %"]


def test_phases_are_one_progress():
    seen: list[Any] = []
    phases = Phases(lambda *now: seen.append(now), {"sweep": 50, "balance": 100, "comparison": 25})
    phases["sweep"](5, 10)
    phases["balance"](0.5, 2, "curve 1")
    phases["comparison"](0, 0)
    assert seen == [(25, 175, "sweep, 5 of 10 points"), (75, 175, "curve 1"), (175, 175, "comparison, 0 of 0 points")]
    Phases(unwatched, {"sweep": 1})["sweep"](1, 1)


def test_points_of_a_chunk_count_before_it_is_done():
    seen: list[Any] = []

    def work(payload: int, before: Result | None) -> Result:
        for _ in range(payload):
            point_done()
        return {"x": np.zeros(1)}

    chunks = [Chunk("a", 3, None, 3), Chunk("b", 5, "a", 3)]
    carry_through(chunks, work, Execution(lambda *now: seen.append(now), workers=1), identity="")
    assert seen == [(n, 6) for n in (1, 2, 2, 3, 4, 5, 5, 5, 5, 6)]


def test_the_time_of_earlier_parts_is_kept_with_their_chunks(tmp_path: Path):
    chunks = chains(1, 3, seconds=0.05)
    execution = Execution(folder=tmp_path, workers=1, notice=lambda text: None)
    carry_through(chunks, toys.work, execution, identity="")
    first = checkpoint.seconds_worked(tmp_path)
    assert first > 0.15
    assert execution.earlier() == 0
    resumed = replace(execution, resume=True)
    assert resumed.earlier() == resumed.earlier("") == first
    (tmp_path / "checkpoint" / "c-0-2.npz").unlink()
    carry_through(chunks, toys.work, resumed, identity="")
    assert checkpoint.seconds_worked(tmp_path) > first + 0.05
    carry_through(chunks, toys.work, replace(execution, folder=tmp_path), identity="", stage="later")
    assert resumed.earlier() == pytest.approx(resumed.earlier("") + resumed.earlier("later"), rel=1e-12)
    carry_through(chunks[:1], toys.work, execution, identity="")
    assert resumed.earlier("") < first
    checkpoint.clear(tmp_path)
    assert not (tmp_path / "checkpoint").exists()


def test_without_a_terminal_there_is_a_line_a_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    assert cli.SECONDS_A_LINE == 60
    monkeypatch.setattr(cli, "SECONDS_A_LINE", 0.02)
    third = threading.Event()

    class Shown(Standing):
        def line(self) -> str:
            lines.append(super().line())
            if len(lines) == 3:
                third.set()
            return lines[-1]

    lines: list[str] = []
    standing, start = Shown("points"), time.monotonic()
    standing(3, 10, "sweep, 3 of 10 points")
    with cli._progress(standing):
        assert third.wait(300)
    said = capsys.readouterr().err.splitlines()
    assert said == lines
    assert len(said) * cli.SECONDS_A_LINE <= time.monotonic() - start
    assert said[0].startswith("30 %, ")
    assert said[0].endswith(" left, sweep, 3 of 10 points")
    assert all(thread.name != "timesim-progress" for thread in threading.enumerate())


SHOWN = """
import threading
from timesim import cli
from timesim.study.execution.progress import Standing

drawn = threading.Event()

class Shown(Standing):
    def line(self):
        words = super().line()
        drawn.set()
        return words

standing = Shown("points")
with cli._progress(standing):
    for done in (5, 10):
        standing(done, 10, f"sweep, {done} of 10 points")
        for _ in range(2):  # the first may be of before, and is written when the second is drawn
            drawn.clear()
            assert drawn.wait(300)
print("over")
"""


def test_on_a_terminal_there_is_a_bar():
    reader, writer = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen([sys.executable, "-c", SHOWN], stdout=writer, stderr=writer, env=environment) as run:
        os.close(writer)
        said = b"".join(iter(_reading(reader), b"")).decode()
    os.close(reader)
    assert run.returncode == 0
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", said)
    assert re.search(r"━.* 50 %, .* points/s, .* so far, .* left, sweep, 5 of 10 points", plain)
    assert "99 %" in plain
    assert "100 %" not in plain
    assert plain.rstrip().endswith("over")


def _reading(reader: int) -> Callable[[], bytes]:
    def read() -> bytes:
        try:
            return os.read(reader, 4096)
        except OSError:  # the other end is closed
            return b""

    return read
