"""Processes that take work over from the threads: the same results, and nothing is lost."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from multiprocessing import synchronize
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toys
from threadpoolctl import threadpool_info, threadpool_limits
from toys import SCENE, chains, digest, expected

from timesim.study import registry
from timesim.study.execution import campaign, processes
from timesim.study.execution.campaign import Chunk, Execution, carry_through
from timesim.study.execution.processes import Processes, unseen
from timesim.study.execution.worker import halted, point_done

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "LASTS", 0.0)


@pytest.fixture(scope="module")
def two() -> Iterator[Processes]:
    with Processes(2) as own:
        yield own


def carried(chunks: list[Chunk], own: Processes, **options: Any) -> tuple[dict[str, Any], str | None]:
    return carry_through(chunks, toys.work, Execution(workers=2, processes=own, **options), identity=SCENE)


def threads() -> list[int]:
    """Of each library for products of matrices that is loaded."""
    return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]


def test_products_of_matrices_take_one_thread_in_a_study_and_in_its_processes(
    two: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with threadpool_limits(2, "blas"):
        scene = registry.load_scene(Path(__file__).parents[3] / "configs" / "oscillator.yaml")
        monkeypatch.setattr(registry, "_loaded", lambda _: lambda scene, execution: threads())
        inside = registry.carry_out(scene)
        outside = threads()
    assert set(inside) == {1}
    assert set(outside) == {2}
    assert set(two.submit(unseen, threads).result()) == {1}


def places(payload: Any, before: Any) -> dict[str, np.ndarray]:
    return {"process": np.array(os.getpid())}


def counted(payload: Any, before: Any) -> dict[str, np.ndarray]:
    for _ in range(3):
        point_done()
    time.sleep(1.5)
    return {"done": np.array(True)}


def test_chains_give_the_same_bits_as_threads(two: Processes):
    chunks, shown = chains(3, 2), list[tuple[float, float]]()
    results, reason = carried(chunks, two, progress=lambda done, number, _="": shown.append((done, number)))
    assert reason is None
    assert digest(results) == digest(expected(chunks))
    assert shown[-1] == (12, 12)


@pytest.mark.parametrize(("lasts", "elsewhere"), [(0.0, True), (1e9, False)])
def test_only_work_that_lasts_is_given_to_them(
    lasts: float, elsewhere: bool, two: Processes, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(campaign, "LASTS", lasts)
    chunks = [Chunk(f"c{i}", i) for i in range(3)]
    results, _ = carry_through(chunks, places, Execution(workers=2, processes=two), identity="")
    assert (os.getpid() not in {int(result["process"]) for result in results.values()}) == elsewhere


def test_a_chunk_alone_is_left_to_a_thread(two: Processes):
    results, _ = carry_through([Chunk("c", 0)], places, Execution(processes=two), identity="")
    assert int(results["c"]["process"]) == os.getpid()


def test_points_are_shown_while_a_chunk_is_worked_on(two: Processes):
    shown: list[float] = []
    execution = Execution(lambda done, *_: shown.append(done), workers=2, processes=two)
    carry_through([Chunk(f"c{i}", i, size=4) for i in range(2)], counted, execution, identity="")
    assert shown[-1] == 8
    assert {3, 6, 7} & set(shown)  # of one chunk, of both, and of one with the other done


def test_work_begins_with_no_point_counted(two: Processes, monkeypatch: pytest.MonkeyPatch):
    """Whatever the work counted before that had its place."""
    monkeypatch.setattr(processes, "APART", 0.02)
    two.submit(unseen, point_done).result()
    two._counts[:] = [5] * len(two._counts)
    shown: list[int] = []
    two.submit(shown.append, time.sleep, 2.0).result()
    assert set(shown) == {0}


def test_what_fails_is_named(two: Processes):
    chunks = chains(2, 2, faults={"c-1-0": "raise"})
    results, reason = carried(chunks, two)
    assert digest(results) == digest(expected(chunks[:2]))
    assert reason == "1 of 4 chunks failed: c-1-0: ArithmeticError: c-1-0 has no solution; 4 of 8 points missing"


def test_with_one_killed_the_others_go_on_in_threads(tmp_path: Path):
    log = tmp_path / "log"
    chunks = chains(4, 2, log=log, faults={"c-0-0": "kill"})
    with Processes(2) as own:
        results, reason = carried(chunks, own, folder=tmp_path)
    assert reason is not None
    assert "c-0-0: BrokenProcessPool" in reason
    whole = expected(chunks)
    assert digest(results) == digest({name: whole[name] for name in results})
    lost = {name.rpartition("-")[0] for name in whole if name not in results}
    assert "c-0" in lost <= {f"c-{i}" for i in range(4)}
    assert len(lost) <= 2, "what both processes were at"
    options: dict[str, Any] = {"folder": tmp_path, "resume": True, "notice": lambda _: None}
    rest, reason = carry_through(chunks, toys.work, Execution(**options), identity=SCENE)
    assert reason is None
    assert digest(rest) == digest(whole)


def test_an_interrupt_stops_them_and_keeps_what_is_done(two: Processes, tmp_path: Path):
    chunks, sent = chains(2, 2, faults={"c-1-0": "stay"}), threading.Event()

    def interrupt(done: float, *_: Any) -> None:
        if done == 4 and not sent.is_set():  # it is shown again where the processes' counts are looked at
            sent.set()
            os.kill(os.getpid(), signal.SIGINT)

    results, reason = carried(chunks, two, progress=interrupt, folder=tmp_path)
    assert reason == "interrupted; 4 of 8 points missing"
    assert list(results) == ["c-0-0", "c-0-1"]
    assert not two.submit(unseen, ignores_interrupts).result()[1]  # they may be used again
    assert {path.stem for path in (tmp_path / "checkpoint").glob("*.npz")} == set(results)


def test_another_interrupt_while_they_stop_leaves_none_halted(two: Processes, monkeypatch: pytest.MonkeyPatch):
    def interrupted(_: Any) -> None:
        raise KeyboardInterrupt

    two.submit(unseen, ignores_interrupts).result()
    with monkeypatch.context() as patch:
        patch.setattr(processes, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            two.give_up([])
    assert not two.submit(unseen, ignores_interrupts).result()[1]


def ignores_interrupts() -> tuple[bool, bool]:
    return signal.getsignal(signal.SIGINT) is signal.SIG_IGN, halted()


def test_they_leave_an_interrupt_to_the_process_that_began_them():
    with Processes(1) as own:
        assert own.submit(unseen, ignores_interrupts).result() == (True, False)
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
        with pytest.raises(BrokenExecutor):
            own.submit(unseen, os._exit, 1).result()


def until_halted(number: int) -> int:
    while not halted():
        time.sleep(0.01)
    return number


def test_what_is_given_up_is_yielded_before_the_interrupt_goes_on(two: Processes):
    timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
    found = []
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        found.extend(two.each([(unseen, until_halted, (number,)) for number in range(5)]))
    timer.join()
    assert sorted(found) == [(0, 0), (1, 1)]
    assert not two.submit(unseen, ignores_interrupts).result()[1]


def killed_once_halted() -> None:
    until_halted(0)
    os.kill(os.getpid(), signal.SIGKILL)


def test_an_interrupt_goes_on_though_a_process_is_killed_meanwhile():
    """At the time limit of a batch job a process may not have the time to give what it has."""
    timer = threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with Processes(1) as own, pytest.raises(KeyboardInterrupt):
        list(own.each([(unseen, killed_once_halted, ())]))
    timer.join()


def told_to_end(number: int) -> int:
    os.kill(os.getpid(), signal.SIGTERM)
    return until_halted(number)


def test_a_process_that_is_told_to_end_gives_what_it_has_if_it_is_halted():
    """A cluster sends SIGTERM to every process of a run."""
    with Processes(1) as own:
        work = own.submit(unseen, told_to_end, 7)
        while not work.running():
            time.sleep(0.01)
        time.sleep(1.0)
        own.give_up([work])
        assert work.result() == 7


def test_a_process_that_alone_is_told_to_end_ends():
    with Processes(1) as own, pytest.raises(BrokenExecutor):
        own.submit(unseen, told_to_end, 7).result()


def test_each_gives_its_result_with_its_place(two: Processes):
    assert sorted(two.each([(unseen, abs, (-number,)) for number in range(5)])) == [(i, i) for i in range(5)]


@pytest.mark.parametrize(("pages", "workers"), [(2**30, 3), (2**19, 1), (1, 1)])
def test_no_more_than_the_memory_has_room_for(pages: int, workers: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "sysconf", lambda name: pages if name == "SC_PHYS_PAGES" else 4096)
    monkeypatch.setattr(processes, "default_workers", lambda: 3)
    assert Processes().workers == workers


def test_one_alone_is_left_out_and_holds_up_no_thread():
    meeting = threading.Barrier(3, timeout=600)
    with Processes(1) as own:
        execution = Execution(workers=3, processes=own)
        chunks = [Chunk(f"c{i}", i) for i in range(3)]
        _, reason = carry_through(chunks, lambda *_: {"i": np.array(meeting.wait())}, execution, identity="")
        assert not own.begun
    assert reason is None


def test_where_none_can_be_begun_threads_do_the_work(monkeypatch: pytest.MonkeyPatch):
    def refused(*_: Any, **__: Any) -> None:
        raise OSError("no shared memory")

    monkeypatch.setattr(synchronize.SemLock, "__init__", refused)
    with Processes(2) as own:
        results, reason = carried(chains(2, 2), own)
    assert reason is None
    assert digest(results) == digest(expected(chains(2, 2)))


def test_a_slot_that_is_not_free_yet_holds_nothing_up(two: Processes):
    two.submit(unseen, abs, -1).result()
    two._seen |= {0: unseen, 1: unseen}
    assert [two.submit(unseen, abs, -i).result() for i in range(3)] == [0, 1, 2]
    two._seen.clear()
