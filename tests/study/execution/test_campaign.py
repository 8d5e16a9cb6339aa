"""Campaigns: chains of chunks on threads and on processes, and that nothing is lost whatever happens to them."""

import errno
import io
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse
import toys
import xarray
from commands import fill_disk
from toys import SCENE, chains, digest, expected
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.result import checkpoint, file
from timesim.result.change import fingerprint
from timesim.result.file import StoreError
from timesim.result.folder import locked_folder
from timesim.result.netcdf import open_result
from timesim.study import registry as study
from timesim.study.execution import campaign, worker
from timesim.study.execution.campaign import Chunk, Execution, ExecutionError, carry_through


def carried(
    chunks: list[Chunk], execution: Execution, identity: str = SCENE, **stage: str
) -> tuple[dict[str, Any], str | None]:
    return carry_through(chunks, toys.work, execution, identity=identity, **stage)


def execution_of(folder: Path, **others: Any) -> tuple[Execution, list[str]]:
    """Two threads, or a cluster, with checkpoints, and the notices they give."""
    notices: list[str] = []
    workers = None if "cluster" in others else 2
    return Execution(folder=folder, workers=workers, notice=notices.append, **others), notices


def calls(log: Path) -> Counter[str]:
    return Counter(log.read_text().split()) if log.exists() else Counter()


@pytest.mark.parametrize("workers", [1, 2, 7])
def test_chains_give_the_same_whoever_does_the_work(workers: int):
    shown: list[tuple[int, int]] = []
    chunks = chains(4, 3)
    results, reason = carried(chunks, Execution(lambda *now: shown.append(now), workers=workers))
    assert reason is None
    assert digest(results) == digest(expected(chunks))
    assert shown == [(2 * (i + 1), 24) for i in range(12)]


def test_threads_work_side_by_side():
    meeting = threading.Barrier(3, timeout=600)
    results, reason = carry_through(
        [Chunk(f"c{i}", i) for i in range(3)],
        lambda i, before: {"i": np.array([i, meeting.wait()])},
        Execution(workers=3),
        identity="",
    )
    assert reason is None
    assert sorted(int(result["i"][1]) for result in results.values()) == [0, 1, 2]


def test_threads_change_over_sooner_only_while_they_work():
    before = sys.getswitchinterval()
    with worker.threads(1):
        assert sys.getswitchinterval() <= worker.SWITCH < before
    assert sys.getswitchinterval() == before


def test_threads_share_the_parts_of_a_work_that_has_them_to_itself():
    """In their order, each counted; a part that has parts again does them itself."""
    meeting, counted = threading.Barrier(2, timeout=600), list[int]()

    def part(i: int) -> int:
        meeting.wait()
        worker.point_done()
        return sum(worker.each(lambda j: 10 * i + j, range(3)))

    def work(payload: None, before: None) -> dict[str, np.ndarray]:
        return {"i": np.array(list(worker.each(part, range(4))))}

    shown = Execution(lambda done, of: counted.append(done), workers=2)
    results, reason = carry_through([Chunk("c", None, size=5)], work, shown, identity="")
    assert reason is None
    assert results["c"]["i"].tolist() == [3, 33, 63, 93]
    assert sorted(counted) == [1, 2, 3, 4, 5]


def test_threads_that_all_have_a_work_do_its_parts_themselves():
    """More would compete for the same processors."""
    both = threading.Barrier(2, timeout=600)

    def work(payload: None, before: None) -> dict[str, np.ndarray]:
        both.wait()
        own = [threading.get_ident() == thread for thread in worker.each(lambda _: threading.get_ident(), range(4))]
        both.wait()
        return {"own": np.array(own)}

    results, _ = carry_through([Chunk(name, None) for name in "ab"], work, Execution(workers=2), identity="")
    assert all(results[name]["own"].all() for name in "ab")


def test_the_parts_of_a_work_are_halted_with_it():
    def work(payload: None, before: None) -> dict[str, np.ndarray]:
        worker.halt_by(lambda: True)
        return {"halted": np.array(list(worker.each(lambda _: worker.halted(), range(2))))}

    results, _ = carry_through([Chunk("c", None)], work, Execution(workers=2), identity="")
    assert results["c"]["halted"].tolist() == [True, True]


def test_what_fails_in_a_part_fails_the_work():
    def work(payload: None, before: None) -> dict[str, np.ndarray]:
        return {"i": np.array(list(worker.each(lambda i: 1 // i, range(2))))}

    results, reason = carry_through([Chunk("c", None)], work, Execution(workers=2), identity="")
    assert not results
    assert "ZeroDivisionError" in str(reason)


def test_nothing_to_do():
    assert carried([], Execution()) == ({}, None)


def test_what_fails_is_named_and_the_others_go_on():
    chunks = chains(3, 3, faults={"c-1-1": "raise"})
    results, reason = carried(chunks, Execution(workers=2))
    left = [chunk for chunk in chunks if chunk.name not in ("c-1-1", "c-1-2")]
    assert digest(results) == digest(expected(left))
    assert reason == ("1 of 9 chunks failed: c-1-1: ArithmeticError: c-1-1 has no solution; 4 of 18 points missing")


def test_of_many_failures_the_first_are_named():
    chunks = chains(9, 1, faults={f"c-{i}-0": "raise" for i in range(9)})
    results, reason = carried(chunks, Execution(workers=1))
    assert results == {}
    assert reason is not None
    assert "c-3-0: Arith" in reason
    assert "c-4-0" not in reason
    assert "and 5 more" in reason


@pytest.mark.parametrize("fault", ["interrupt", "halt"])
def test_an_interrupt_keeps_what_is_done(fault: str, tmp_path: Path):
    log = tmp_path / "log"
    chunks = chains(3, 8, seconds=0.01, log=log, faults={"c-1-4": fault})
    execution, _ = execution_of(tmp_path)
    results, reason = carried(chunks, execution)
    assert reason is not None
    assert reason.startswith("interrupted; ")
    assert 0 < len(results) < len(chunks)
    assert ("c-1-4" in results) == (fault == "interrupt")
    whole = expected(chunks)
    assert digest(results) == digest({name: whole[name] for name in results})
    kept = {path.stem for path in (tmp_path / "checkpoint").glob("*.npz")}
    assert kept == set(results)
    before = calls(log)
    clean = [replace(chunk, payload=replace(chunk.payload, fault="")) for chunk in chunks]
    manifest = checkpoint.Manifest(SCENE, {chunk.name: fingerprint(chunk) for chunk in clean})
    file.write_whole(tmp_path / "checkpoint" / "manifest.json", manifest_text(manifest))
    rest, reason = carried(clean, replace(execution, resume=True))
    assert reason is None
    assert digest(rest) == digest(whole)
    assert all(calls(log)[name] == before[name] for name in results)


def manifest_text(manifest: checkpoint.Manifest) -> bytes:
    import json
    from dataclasses import asdict

    return json.dumps(asdict(manifest)).encode()


def test_resumed_bit_for_bit(tmp_path: Path):
    log = tmp_path / "log"
    chunks = chains(3, 4, log=log)
    execution, notices = execution_of(tmp_path)
    whole, _ = carried(chunks, execution)
    for name in ("c-0-3", "c-1-1", "c-2-0"):
        (tmp_path / "checkpoint" / f"{name}.npz").unlink()
    before = calls(log)
    again, reason = carried(chunks, replace(execution, resume=True))
    assert reason is None
    assert digest(again) == digest(whole) == digest(expected(chunks))
    assert calls(log) - before == Counter(["c-0-3", "c-1-1", "c-2-0"])
    assert notices == [f"9 of 12 chunks taken up from {tmp_path / 'checkpoint'}"]
    checkpoint.clear(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["log"]


def test_without_resume_it_starts_anew(tmp_path: Path):
    log = tmp_path / "log"
    execution, notices = execution_of(tmp_path)
    growing = tmp_path / "checkpoint" / checkpoint.GROWING_NAME
    for repeat in (1, 2):
        carried(chains(1, 3, log=log), execution)
        assert set(calls(log).values()) == {repeat}
        assert not growing.exists()
        growing.write_bytes(b"a curve that was cut off")
    assert notices == []
    checkpoint.clear(tmp_path)
    assert not growing.parent.exists()


def test_nothing_to_resume_is_reported(tmp_path: Path):
    execution, notices = execution_of(tmp_path, resume=True)
    assert carried(chains(1, 2), execution)[1] is None
    assert notices == [f"there is nothing to resume in {tmp_path}: it starts from the beginning"]


@pytest.mark.parametrize(
    ("chunks", "identity", "message"),
    [
        (chains(2, 2), SCENE.replace("1.6", "1.7"), "another scene: study.frequency.to was 1.6, is 1.7"),
        (chains(2, 2), SCENE.replace("title: toy\n", ""), "another scene: title was toy, is not given"),
        (chains(2, 2), f"{SCENE}# why", "another scene: 'nothing' was there, now '# why'"),
        (chains(2, 3), SCENE, "other chunks: 'c-1-0' was there, now 'c-0-2'"),
        (chains(2, 2, seconds=1.0), SCENE, "a file of matrices or a result that has changed: see chunk c-0-0"),
    ],
)
def test_a_changed_scene_is_named_and_not_resumed(chunks: list[Chunk], identity: str, message: str, tmp_path: Path):
    execution, _ = execution_of(tmp_path)
    carried(chains(2, 2), execution)
    before = {path: path.read_bytes() for path in (tmp_path / "checkpoint").iterdir()}
    with pytest.raises(StoreError) as caught:
        carried(chunks, replace(execution, resume=True), identity)
    assert message in str(caught.value)
    assert "--force" in str(caught.value)
    assert {path: path.read_bytes() for path in (tmp_path / "checkpoint").iterdir()} == before


def test_another_version_is_named_and_not_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    execution, _ = execution_of(tmp_path)
    carried(chains(1, 1), execution)
    monkeypatch.setattr(checkpoint, "version", lambda name: "99.0")
    with pytest.raises(StoreError, match=r"was begun by timesim \S+, this is 99\.0"):
        carried(chains(1, 1), replace(execution, resume=True))


@pytest.mark.parametrize("damage", [lambda content: content[:-40], lambda content: b"", lambda content: b"PK" * 99])
def test_a_damaged_chunk_is_named_and_computed_again(damage: Any, tmp_path: Path):
    log = tmp_path / "log"
    chunks = chains(2, 2, log=log)
    execution, notices = execution_of(tmp_path)
    whole, _ = carried(chunks, execution)
    file = tmp_path / "checkpoint" / "c-0-0.npz"
    content = file.read_bytes()
    file.write_bytes(damage(content))
    again, reason = carried(chunks, replace(execution, resume=True))
    assert reason is None
    assert digest(again) == digest(whole)
    assert calls(log) == Counter({"c-0-0": 2, "c-0-1": 1, "c-1-0": 1, "c-1-1": 1})
    assert f"{file} is damaged or cut off" in notices[0]
    assert file.read_bytes() == content


def test_a_chunk_that_another_has_written_is_computed_again(tmp_path: Path):
    """A copy of another chunk, one of another scene, and one that was read and written anew with another value."""
    execution, notices = execution_of(tmp_path)
    carried(chains(2, 1), replace(execution, folder=tmp_path / "other"), "another: scene")
    whole, _ = carried(chains(2, 1), execution)
    file = tmp_path / "checkpoint" / "c-0-0.npz"
    content = file.read_bytes()
    edited = io.BytesIO()
    np.savez(edited, **dict(whole["c-0-0"]) | {"x": whole["c-0-0"]["x"] + 1})
    other = tmp_path / "other" / "checkpoint" / "c-0-0.npz"
    for wrong in ((file.parent / "c-1-0.npz").read_bytes(), other.read_bytes(), edited.getvalue()):
        file.write_bytes(wrong)
        notices.clear()
        again, reason = carried(chains(2, 1), replace(execution, resume=True))
        assert (digest(again), reason) == (digest(whole), None)
        assert notices[0].endswith(
            "c-0-0.npz is damaged or cut off (not as this run has written it): it is computed again"
        )
        assert file.read_bytes() == content


def test_a_flipped_bit_is_found(tmp_path: Path):
    execution, notices = execution_of(tmp_path)
    chunks = chains(1, 1)
    whole, _ = carried(chunks, execution)
    file = tmp_path / "checkpoint" / "c-0-0.npz"
    content = bytearray(file.read_bytes())
    place = content.index(whole["c-0-0"]["x"].tobytes())
    content[place + 3] ^= 1
    file.write_bytes(content)
    again, _ = carried(chunks, replace(execution, resume=True))
    assert digest(again) == digest(whole)
    assert "CRC" in notices[0]


def test_a_damaged_manifest_is_a_message(tmp_path: Path):
    execution, _ = execution_of(tmp_path)
    carried(chains(1, 1), execution)
    manifest = tmp_path / "checkpoint" / "manifest.json"
    manifest.write_bytes(manifest.read_bytes()[:-9])
    with pytest.raises(StoreError, match=r"manifest.json cannot be read .* 1 chunk beside it belongs to, .* --force"):
        carried(chains(1, 1), replace(execution, resume=True))


@pytest.mark.parametrize(
    "content",
    [
        '{"identity": 1, "chunks": {}}',
        '{"identity": "a: 1", "chunks": null}',
        '{"identity": "a: 1", "chunks": ["c-0-0"]}',
        '{"identity": "a: 1", "chunks": {"c-0-0": 5}}',
        '{"identity": "a: 1", "chunks": {}, "timesim": []}',
        "[" * 100_000,
        "null",
    ],
    ids=lambda content: content[:40],
)
def test_a_manifest_of_another_form_is_a_message(content: str, tmp_path: Path):
    execution, _ = execution_of(tmp_path)
    carried(chains(1, 1), execution)
    (tmp_path / "checkpoint" / "manifest.json").write_text(content)
    with pytest.raises(StoreError, match=r"manifest.json cannot be read .* 1 chunk beside it belongs to, .* --force"):
        carried(chains(1, 1), replace(execution, resume=True))


def test_a_manifest_with_a_scene_that_is_none_is_a_message(tmp_path: Path):
    execution, _ = execution_of(tmp_path)
    carried(chains(1, 1), execution)
    manifest = tmp_path / "checkpoint" / "manifest.json"
    for scene in ("a: &a [*a]", "[" * 5000):
        manifest.write_text(json.dumps({"identity": scene, "chunks": {}}))
        with pytest.raises(StoreError, match=f"is of another scene: '{re.escape(scene[:5])}"):
            carried(chains(1, 1), replace(execution, resume=True))


def test_chunks_without_a_manifest_are_not_thrown_away(tmp_path: Path):
    execution, _ = execution_of(tmp_path)
    carried(chains(1, 3), execution)
    manifest = tmp_path / "checkpoint" / "manifest.json"
    content = manifest.read_bytes()
    manifest.unlink()
    with pytest.raises(StoreError, match=r"holds 3 chunks but no manifest.json.* put it back, .* --force"):
        carried(chains(1, 3), replace(execution, resume=True))
    with pytest.raises(StoreError, match=r"holds 3 chunks but no manifest\.json"):
        checkpoint.is_finished(tmp_path, SCENE, force=False, resume=False)
    assert not checkpoint.is_finished(tmp_path, SCENE, force=True, resume=False)
    manifest.write_bytes(content)
    results, reason = carried(chains(1, 3), replace(execution, resume=True))
    assert (len(results), reason) == (3, None)


def test_a_full_disk_ends_it_with_what_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    chunks = chains(2, 20)
    fsync, written = os.fsync, []

    def full(handle: int) -> None:
        written.append(handle)
        if len(written) > 6:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    execution, _ = execution_of(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        results, reason = carried(chunks, execution)
    assert reason is not None
    assert "No space left on device; " in reason
    assert "unchanged" not in reason
    assert "points missing" in reason
    assert 6 <= len(results) < 40
    assert len(list((tmp_path / "checkpoint").glob("*.npz"))) == 5
    assert not list((tmp_path / "checkpoint").glob("*.part"))
    again, reason = carried(chunks, replace(execution, resume=True))
    assert reason is None
    assert digest(again) == digest(expected(chunks))


def test_a_folder_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").touch()
    execution, _ = execution_of(tmp_path / "file")
    with pytest.raises(StoreError, match="cannot be made: Not a directory"):
        carried(chains(1, 1), execution)

    def refused(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(file, "open", refused, raising=False)
    execution, _ = execution_of(tmp_path)
    with pytest.raises(StoreError, match=r"manifest.json cannot be written: Permission denied"):
        carried(chains(1, 1), execution)


def test_two_runs_do_not_work_in_one_folder(tmp_path: Path):
    execution, _ = execution_of(tmp_path)

    def second(now: int, number: int) -> None:
        with pytest.raises(StoreError, match="another run is at work"):
            carried(chains(1, 1), replace(execution, resume=True))
        with pytest.raises(StoreError, match="another run is at work"):
            checkpoint.clear(tmp_path)

    assert carried(chains(1, 1), replace(execution, progress=second))[1] is None
    with locked_folder(tmp_path), pytest.raises(StoreError, match="another run is at work"):
        checkpoint.is_finished(tmp_path, "", force=False, resume=False)
    with pytest.raises(StoreError, match="holds a run that was cut off"):
        checkpoint.is_finished(tmp_path, "", force=False, resume=False)


def test_stages_of_a_study_keep_apart(tmp_path: Path):
    log = tmp_path / "log"
    execution, notices = execution_of(tmp_path)
    for resume in (False, True):
        for stage in ("", "bisect"):
            assert carried(chains(1, 2, log=log), replace(execution, resume=resume), stage=stage)[1] is None
    assert notices == [f"2 of 2 chunks taken up from {tmp_path / 'checkpoint'}"], "once, however many stages follow"
    assert calls(log) == Counter({"c-0-0": 2, "c-0-1": 2})
    (tmp_path / "checkpoint" / "notes.txt").write_text("the user's own")
    checkpoint.clear(tmp_path)
    assert [path.name for path in (tmp_path / "checkpoint").iterdir()] == ["notes.txt"]


def test_arrays_of_objects_are_refused(tmp_path: Path):
    kept, begun = checkpoint.begin(tmp_path, checkpoint.Manifest(SCENE, {}), resume=False)
    assert not begun
    with pytest.raises(StoreError, match="chunk a, 'x': not an array of numbers or text"):
        kept.save("a", {"x": np.array([{}])})
    kept.close()
    assert not list((tmp_path / "checkpoint").glob("*a.npz*"))


@pytest.mark.parametrize(
    ("chunks", "message"),
    [
        ([Chunk("a", 1), Chunk("a", 2)], "unique"),
        ([Chunk("../a", 1)], "'../a'"),
        ([Chunk(".a", 1)], "'.a'"),
        ([Chunk("a", 1, "b"), Chunk("b", 1)], "a comes after 'b', which must be a chunk above it"),
    ],
)
def test_chunks_that_make_no_sense(chunks: list[Chunk], message: str):
    with pytest.raises(ValueError, match=message):
        carried(chunks, Execution())


def process(folder: Path, resume: str, last: float = math.inf) -> subprocess.Popen[str]:
    """A campaign in a process of its own, which goes on with no more chunks than `last`."""
    command = [sys.executable, str(Path(toys.__file__)), str(folder), resume, str(last)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


@pytest.mark.long
def test_killed_at_random_moments_it_goes_on(tmp_path: Path):
    """Half of the times while chunks are begun and saved, half when some have begun that do not come to an end."""
    random = np.random.default_rng(7)
    log = tmp_path / "log.txt"
    for attempt in range(10):
        kept = {path.stem for path in (tmp_path / "checkpoint").glob("*.npz")}
        before, last = calls(log), int(random.integers(7))
        with process(tmp_path, "resume" if attempt else "anew", last) as run:
            assert run.stdout is not None
            assert run.stdout.readline() == "begun\n"
            while attempt % 2 and (calls(log) - before).total() <= last:
                time.sleep(0.001)
            time.sleep(random.uniform(0.0, 0.12))
            run.send_signal(signal.SIGKILL)
        assert run.returncode == -signal.SIGKILL
        assert not kept & set(calls(log) - before)
    with process(tmp_path, "resume") as run:
        said, _ = run.communicate()
    assert said.split() == ["begun", "None", digest(expected(chains(5, 16)))]
    assert sum(calls(log).values()) > 80


# Processes of a dask cluster


@pytest.fixture(scope="module")
def scheduler() -> Any:
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as own:
        yield own.scheduler_address


@pytest.mark.long
def test_on_a_cluster_with_a_worker_killed_nothing_is_lost(scheduler: str, tmp_path: Path):
    log = tmp_path / "log"
    chunks = chains(3, 3, log=log, faults={"c-1-1": "kill", "c-2-0": "raise"})
    execution, _ = execution_of(tmp_path, cluster=scheduler)
    results, reason = carried(chunks, execution)
    assert Path(f"{log}.killed").exists()
    assert list(results) == [chunk.name for chunk in chunks[:6]], reason
    assert digest(results) == digest(expected(chunks[:6]))
    assert reason is not None
    assert "c-2-0: ArithmeticError: c-2-0 has no solution; 6 of 18 points missing" in reason
    assert calls(log)["c-2-0"] == 1 + worker.RETRIES
    assert {path.stem for path in (tmp_path / "checkpoint").glob("*.npz")} == set(results)
    kept = calls(log)
    assert digest(carried(chunks, replace(execution, resume=True, cluster=None))[0]) == digest(results)
    assert calls(log) - kept == Counter({"c-2-0": 1})


def interrupted_with(fault: str, scheduler: str, tmp_path: Path) -> tuple[dict[str, Any], str | None]:
    """What a campaign on a cluster gives that is interrupted when it has done all but a chunk that is under way."""
    log = tmp_path / "log"
    chunks = chains(2, 1, log=log, faults={"c-1-0": fault})
    execution, _ = execution_of(tmp_path, cluster=scheduler)

    def interrupt(done: int, number: int) -> None:
        begun, deadline = calls(log), time.monotonic() + 600
        while not begun["c-1-0"] and time.monotonic() < deadline:
            time.sleep(0.01)
            begun = calls(log)
        os.kill(os.getpid(), signal.SIGINT)

    try:
        return carried(chunks, replace(execution, progress=interrupt))
    finally:
        Path(f"{log}.over").touch()
        assert {path.stem for path in (tmp_path / "checkpoint").glob("*.npz")} == {"c-0-0"}


@pytest.mark.long
def test_an_interrupt_keeps_what_a_cluster_has_of_its_chunks(scheduler: str, tmp_path: Path):
    results, reason = interrupted_with("part", scheduler, tmp_path)
    assert reason == "interrupted; 1 of 4 points missing"
    np.testing.assert_array_equal(results["c-1-0"]["x"], chains(2, 1)[1].payload.start)
    results, reason = carried(chains(2, 2), Execution(cluster=scheduler))
    assert reason is None, "what is given up is one campaign, not what others begin on the same workers"
    assert digest(results) == digest(expected(chains(2, 2)))


@pytest.mark.long
@pytest.mark.parametrize("again", [False, True])
def test_an_interrupt_leaves_a_cluster_that_does_not_answer(
    again: bool, scheduler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """After some seconds, or at another interrupt."""
    waiting = worker.futures.wait

    def wait(works: Any, seconds: float) -> None:
        if again:
            threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        waiting(works, 600 if again else 0.2)

    monkeypatch.setattr(worker.futures, "wait", wait)
    results, reason = interrupted_with("deaf", scheduler, tmp_path)
    assert reason == "interrupted; 2 of 4 points missing"
    assert list(results) == ["c-0-0"]


@pytest.mark.long
def test_processes_of_this_machine():
    chunks = chains(2, 2)
    results, reason = carried(chunks, Execution(cluster="local", workers=1))
    assert reason is None
    assert digest(results) == digest(expected(chunks))


def test_a_cluster_that_is_lost(monkeypatch: pytest.MonkeyPatch):

    class Lost(ThreadPoolExecutor):
        def submit(self, *args: Any, **kwargs: Any) -> Any:
            future = super().submit(*args, **kwargs)
            future.result()
            other: Any = type(future)()
            other.cancel()
            other.set_running_or_notify_cancel()
            return other

    monkeypatch.setattr(campaign, "processes", lambda *_: Lost(1))
    results, reason = carried(chains(1, 2), Execution(cluster="tcp://there:1"))
    assert results == {}
    assert reason == "the connection to the cluster tcp://there:1 is lost; 4 of 4 points missing"


@pytest.mark.long
@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n"])
def test_an_address_where_something_else_than_a_scheduler_answers(answer: bytes, monkeypatch: pytest.MonkeyPatch):
    """As the dashboard of a scheduler, which listens at the next port: silent, or in words of its own."""
    monkeypatch.setattr(worker, "PATIENCE", 0.2)

    def serve() -> None:
        with suppress(OSError):
            while True:
                open_ones.append(listening.accept()[0])
                open_ones[-1].sendall(answer)

    open_ones: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=serve, daemon=True).start()
        address = f"tcp://127.0.0.1:{listening.getsockname()[1]}"
        with pytest.raises(ExecutionError, match=f"cluster {address} cannot be reached: .*; give the address"):
            carried(chains(1, 1), Execution(cluster=address))
    for one in open_ones:
        one.close()


def test_clusters_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(worker, "PATIENCE", 0.2)
    with pytest.raises(ExecutionError, match=r"tcp://127\.0\.0\.1:9 cannot be reached.*give the address"):
        carried(chains(1, 1), Execution(cluster="tcp://127.0.0.1:9"))
    for wrong, message in (
        ("a:b:c", "give one as tcp://host:8786"),
        ("lokal", r"did you mean local\?"),
        ("host", "give"),
    ):
        with pytest.raises(ExecutionError, match=f"cluster {wrong}: is no address of a scheduler; {message}"):
            Execution(cluster=wrong)
    for address in ("local", "host:8786", "[::1]:8786", "tls://host:8786"):
        Execution(cluster=address)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExecutionError, match=r"pip install 'timesim\[cluster\]'"):
        carried(chains(1, 1), Execution(cluster="local"))
    with pytest.raises(ExecutionError, match="workers must be at least 1, not 0"):
        Execution(workers=0)
    with pytest.raises(ExecutionError, match="workers must be a whole number, at least 1, not '2'"):
        Execution(workers="2")
    with pytest.raises(ExecutionError, match="cluster must be the address of a scheduler or 'local', not 3"):
        Execution(cluster=3)
    with pytest.raises(ExecutionError, match="workers: the cluster host:8786 has its own; leave it out"):
        Execution(cluster="host:8786", workers=2)


def test_no_more_threads_than_this_process_may_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3, 4}, raising=False)
    monkeypatch.setattr(worker, "_quotas", lambda: iter((7.0, 2.5)))
    assert worker.default_workers() == 2
    monkeypatch.undo()
    own = tmp_path / "batch" / "job"
    own.mkdir(parents=True)
    (tmp_path / "cgroup").write_text("1:name=systemd:/\n0::/batch/job\n")
    (own / "cpu.max").write_text("max 100000\n")
    (tmp_path / "batch" / "cpu.max").write_text("150000 100000\n")
    assert list(worker._quotas(tmp_path / "cgroup", tmp_path)) == [1.5]
    assert list(worker._quotas(tmp_path / "none", tmp_path)) == []


def test_no_more_threads_than_control_groups_of_the_first_version_allow(tmp_path: Path):
    (tmp_path / "cgroup").write_text("5:cpuset:/job\n4:cpu,cpuacct:/host/job\n1:name=systemd:/\n0::/\n")
    own = tmp_path / "cpu,cpuacct" / "host" / "job"
    own.mkdir(parents=True)
    for group, quota in ((own, -1), (own.parents[1], 350000)):
        (group / "cpu.cfs_quota_us").write_text(f"{quota}\n")
        (group / "cpu.cfs_period_us").write_text("100000\n")
    (tmp_path / "cpuset").mkdir()
    (tmp_path / "cpuset" / "cpu.cfs_quota_us").write_text("100000\n")
    assert list(worker._quotas(tmp_path / "cgroup", tmp_path)) == [3.5]


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({}, "has no workers"),
        ({"tcp://w:1": "0.0.1"}, "worker tcp://w:1 has timesim 0.0.1"),
        ({"tcp://w:1": ModuleNotFoundError("timesim")}, "worker tcp://w:1 has no timesim"),
    ],
)
def test_workers_that_would_do_other_work(found: dict[str, Any], message: str):
    class Client:
        def run(self, *_: Any, **__: Any) -> dict[str, Any]:
            return found

    with pytest.raises(ExecutionError, match=message):
        worker._check_workers(Client(), "tcp://there:1")


# The commands

OSCILLATOR = str(Path(__file__).parents[3] / "configs" / "oscillator.yaml")
TOY_SWEEP = "study={kind: sweep, frequency: {from: 1.0, to: 1.5, step: 0.1}}"


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Makes toys of sweeps; the list says what goes wrong."""
    monkeypatch.setitem(study.STUDIES, "sweep", replace(study.STUDIES["sweep"], run="toys:study"))
    monkeypatch.setattr(toys, "FAULTY", [])
    return toys.FAULTY


def call(folder: Path, *options: str, scene: str = TOY_SWEEP) -> tuple[int, str, str]:
    arguments = ["run", OSCILLATOR, "-o", str(folder), "--no-plots", "--set", scene, *options]
    found = CliRunner().invoke(app, arguments)
    return found.exit_code, found.stdout, found.stderr


def test_a_whole_run_leaves_no_checkpoint(faulty: list[Any], tmp_path: Path):
    assert call(tmp_path)[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["result.nc", "scene.yaml"]
    before = (tmp_path / "result.nc").read_bytes()
    status, out, _ = call(tmp_path, "--resume")
    assert status == 0
    assert f"complete: there is nothing to resume; timesim plot {tmp_path} draws it" in out
    status, _, error = call(tmp_path, "--resume", scene=TOY_SWEEP.replace("1.5", "1.6"))
    assert status == 2
    assert "study.frequency.to was 1.5, is 1.6" in error
    assert (tmp_path / "result.nc").read_bytes() == before


@pytest.mark.parametrize("form", [np.asarray, scipy.sparse.csr_array])
def test_a_whole_run_of_other_matrices_is_not_taken_for_that_of_the_scene(
    form: Callable[[np.ndarray], Any], faulty: list[Any], tmp_path: Path
):
    """The files hold the same names, and the resolved scene the same text; the same matrices may be written again."""

    def write(last: float) -> None:
        for name, diagonal in (("m", [1.0, 1.0]), ("k", [30.0, last])):
            scipy.io.mmwrite(tmp_path / f"{name}.mtx", form(np.diag(diagonal)))

    points = "points: {tip: {x: 0, y: 1}}"
    files = f"file: {{mass: {tmp_path}/m.mtx, stiffness: {tmp_path}/k.mtx}}"
    structure = ("--set", f"structure={{{files}, damping_ratio: 0.02, {points}}}")
    run = tmp_path / "run"
    write(70.0)
    assert call(run, *structure)[0] == 0
    before = (run / "result.nc").read_bytes()
    write(70.0)
    status, out, _ = call(run, *structure, "--resume")
    assert (status, "there is nothing to resume" in out) == (0, True)
    write(71.0)
    status, out, error = call(run, *structure, "--resume")
    assert (status, out) == (2, "")
    changed = "such as a file of matrices or a result that has changed"
    assert f"result.nc is of other data, {changed}; run what it was begun" in error
    assert (run / "result.nc").read_bytes() == before
    assert call(run, *structure, "--force")[0] == 0
    assert call(run, *structure, "--resume")[0] == 0


@pytest.mark.parametrize("fault", ["interrupt", "raise"])
def test_a_run_cut_off_is_resumed_by_the_commands(fault: str, faulty: list[Any], tmp_path: Path):
    assert call(tmp_path / "whole")[0] == 0
    whole = open_result(tmp_path / "whole")
    faulty[:] = [fault, 3]
    status, _, error = call(tmp_path / "run")
    assert status == 1
    assert "points missing" in error
    assert "--resume" in error
    assert np.isnan(open_result(tmp_path / "run")["cycles"]).any()
    status, _, error = call(tmp_path / "run")
    assert status == 2
    assert "chunks done; give --resume to go on, or --force to start anew" in error
    status, _, error = call(tmp_path / "run", "--resume", scene=TOY_SWEEP.replace("1.5", "1.4"))
    assert status == 2
    assert "study.frequency.to was 1.5, is 1.4" in error
    assert call(tmp_path / "run", "--resume", "--force")[0] == 2
    status, _, error = call(tmp_path / "run", "--resume")
    assert "of 6 chunks taken up" in error
    assert status == (1 if fault == "raise" else 0)
    if status == 0:
        np.testing.assert_array_equal(open_result(tmp_path / "run")["cycles"], whole["cycles"])
    faulty.clear()
    assert call(tmp_path / "run", "--force")[0] == 0
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["result.nc", "scene.yaml"]


def test_a_result_that_cannot_be_saved_names_the_chunks_that_are_safe(
    faulty: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    fill_disk(monkeypatch, "result.nc")
    (tmp_path / "spare").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "spare"))
    status, _, error = call(tmp_path / "run")
    assert status == 1
    assert "result.nc cannot be written: No space left on device; 6 finished chunks are safe in" in error
    (whole,) = (tmp_path / "spare").iterdir()
    assert f"--resume goes on from there; the whole of it is in {whole}: move it" in error
    assert "unchanged" not in error
    monkeypatch.undo()
    monkeypatch.setitem(study.STUDIES, "sweep", replace(study.STUDIES["sweep"], run="toys:study"))
    assert call(tmp_path / "run", "--resume")[0] == 0
    xarray.testing.assert_equal(open_result(whole), open_result(tmp_path / "run"))


def test_resuming_is_advised_where_it_gets_further(tmp_path: Path):
    execution, _ = execution_of(tmp_path)
    carried(chains(2, 2), execution)
    assert not checkpoint.resuming_helps(tmp_path, "hbm: did not converge")
    assert checkpoint.resuming_helps(tmp_path, "hbm: interrupted at curve 2")
    (tmp_path / "checkpoint" / "c-1-1.npz").unlink()
    assert checkpoint.resuming_helps(tmp_path, "hbm: did not converge")
    assert not checkpoint.resuming_helps(tmp_path / "new", "interrupted")


def test_resuming_is_not_advised_where_no_chunk_was_finished(tmp_path: Path):
    """It would begin anew, whatever was computed of the chunks that were under way."""
    execution, _ = execution_of(tmp_path)
    carried(chains(2, 2), execution)
    for kept in (tmp_path / "checkpoint").glob("*.npz"):
        kept.unlink()
    assert not checkpoint.resuming_helps(tmp_path, "interrupted")
    assert not checkpoint.resuming_helps(tmp_path, "sweep: interrupted; 42 of 42 points missing; hbm: not begun")


def test_resume_with_nothing_there_runs(faulty: list[Any], tmp_path: Path):
    status, _, error = call(tmp_path / "new", "--resume")
    assert status == 0
    assert "nothing to resume" in error


@pytest.mark.parametrize(("option", "name"), [(("--resume",), "resume"), (("--cluster", "local"), "cluster")])
def test_a_study_in_one_go_refuses_them(option: tuple[str, ...], name: str, tmp_path: Path):
    status, _, error = call(tmp_path / "run", *option, scene="study.cycles=60")
    assert status == 2
    assert f"{name}: a study of kind transient is done in one go" in error
    assert "leave it out" in error
    assert ("hbm" in error) == (name == "resume"), "the curves of a balance are taken up, too, but use no cluster"
    assert not (tmp_path / "run").exists()
    with pytest.raises(ExecutionError, match="workers: a study of kind transient"):
        timesim.run(OSCILLATOR, workers=2)


def test_a_cluster_that_does_not_answer_is_status_2(faulty: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(worker, "PATIENCE", 0.2)
    status, _, error = call(tmp_path, "--cluster", "tcp://127.0.0.1:9")
    assert status == 2
    assert "cannot be reached" in error
    assert not (tmp_path / "result.nc").exists()
    assert call(tmp_path)[0] == 0
    status, _, error = call(tmp_path / "new", "--cluster", "lokal")
    assert status == 2
    assert error == "cluster lokal: is no address of a scheduler; did you mean local?\n"
    assert not (tmp_path / "new").exists()
