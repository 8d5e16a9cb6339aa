"""Curves of several sets of values on processes: the same as here, and what was followed is not lost."""

import itertools
import pickle
import re
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future
from functools import partial
from pathlib import Path
from threading import Event, Thread
from time import sleep
from typing import Any, cast

import numpy as np
import pytest
from systems import oscillator_scene

from timesim.hbm import convergence, scheme
from timesim.hbm.continuation import Controls, Curve, Ending, other_end
from timesim.hbm.curve import evaluation
from timesim.result.checkpoint import chunks_done
from timesim.result.file import StoreError
from timesim.study.compare import matched
from timesim.study.curves import aside, follow
from timesim.study.curves.collection import Curves
from timesim.study.curves.kept import KeptCurves
from timesim.study.execution.campaign import Execution
from timesim.study.execution.processes import Processes
from timesim.study.execution.worker import count_by, halt_by
from timesim.study.hbm import followed
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

STUDY = {
    "kind": "hbm",
    "frequency": {"from": 1.0, "to": 0.985},
    "harmonics": 5,
    "time_samples": 512,
    "stability": False,
}
OVER = {"contacts.pad.preload": [-4, -3, -2.5, -2]}
SCENE = load_scene(oscillator_scene(preload=-4.0) | {"study": STUDY | {"over": OVER}})


@pytest.fixture(scope="module")
def two() -> Iterator[Processes]:
    with Processes(2) as own:
        yield own


@pytest.fixture(scope="module")
def here() -> Any:
    return followed(SCENE, SCENE.plan, Execution())


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Work lasts from the beginning; the places of the sets that are followed here all the same."""
    monkeypatch.setattr(follow, "LASTS", -1.0)
    places: list[int] = []
    own = follow._Work._here
    monkeypatch.setattr(follow._Work, "_here", lambda work, place: (places.append(place), own(work, place)))
    return places


def same(one: Any, other: Any) -> None:
    for name, array in one.variables.items():
        np.testing.assert_array_equal(other[name], array, err_msg=name)


def test_the_same_bits_as_here(here: Any, two: Processes, at_once: list[int]):
    seen: list[tuple[float, str]] = []
    execution = Execution(lambda done, number, words="": seen.append((done / number, words)), processes=two)
    data, curves, reason = followed(SCENE, SCENE.plan, execution)
    assert at_once == [0]
    assert reason is None
    same(here[0], data)
    assert [share for share, _ in seen] == sorted(share for share, _ in seen)
    assert any("2 sets of values side by side" in words for _, words in seen)
    assert seen[-1][0] == 1
    frequency = np.array([0.988, 0.995])
    alone, side_by_side = (matched(np.ones((4, 1, 2, 1, 3)), frequency, curves, own) for own in (None, two))
    assert np.isfinite(alone.difference).any()
    np.testing.assert_array_equal(alone.difference, side_by_side.difference)


def test_an_interrupt_keeps_what_is_followed(here: Any, tmp_path: Path, at_once: list[int]):
    class Interrupted(Processes):
        """The second set is followed, the fourth has begun when the interrupt comes."""

        def each(self, works: Any) -> Iterator[Any]:
            yield 0, follow.followed_set(*works[0][2])
            halt, points = Event(), itertools.count()
            halt_by(halt.is_set)
            count_by(lambda: halt.set() if next(points) == 20 else None)
            try:
                yield 2, follow.followed_set(*works[2][2])
            finally:
                halt_by(lambda: False)
                count_by(lambda: None)
            raise KeyboardInterrupt

    with Interrupted(2) as own:
        data, _, reason = followed(SCENE, SCENE.plan, Execution(folder=tmp_path, processes=own))
    assert reason is not None
    cut = r"contacts\.pad\.preload -2: continuation at \S+ Hz, after \d+ points?: interrupted"
    assert re.fullmatch(f"{cut}; the curves of 1 of 4 sets of values are missing", reason)
    assert at_once == [0]
    assert chunks_done(tmp_path) == 2
    preload, whole = data["contacts.pad.preload"].values, here[0]["contacts.pad.preload"].values
    assert np.sum(preload == -3) == np.sum(whole == -3)
    assert 0 < np.sum(preload == -2) < np.sum(whole == -2)
    assert set(preload) == {-4, -3, -2}
    options: dict[str, Any] = {"folder": tmp_path, "resume": True, "notice": lambda _: None}
    again, _, reason = followed(SCENE, SCENE.plan, Execution(**options))
    assert reason is None
    assert at_once == [0, 2, 3]
    same(here[0], again)


def test_what_is_evaluated_is_forgotten_when_nothing_waits(two: Processes):
    """Else a wait for the first of them to be done would return at once, over and over."""
    done: Future[Any] = Future()
    done.set_result(None)
    evaluation = aside.Evaluation(two)
    evaluation.running = {done}
    evaluation.go_on(0)
    assert not evaluation.running


def test_an_interrupt_behind_the_last_curve_is_named_as_that(here: Any):
    def interrupted(done: float, number: float, _: str = "") -> None:
        if done == number:
            raise KeyboardInterrupt

    data, _, reason = followed(SCENE, SCENE.plan, Execution(progress=interrupted))
    assert reason == "interrupted behind the last curve"
    same(here[0], data)


@pytest.mark.parametrize("name", ["_with_more_samples", "_left_out"])
def test_an_interrupt_behind_a_curve_keeps_it(here: Any, name: str, monkeypatch: pytest.MonkeyPatch):
    """While it is judged, or as its like with more samples begins."""

    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(Curves, name, interrupted)
    data, _, reason = followed(SCENE, SCENE.plan, Execution())
    assert reason is not None
    assert "interrupted" in reason
    first = here[0].isel(solution=here[0]["contacts.pad.preload"].values == -4)
    np.testing.assert_array_equal(data["frequency"], first["frequency"])


def test_where_a_process_is_killed_the_rest_is_followed_here(here: Any, at_once: list[int]):
    class Killed(Processes):
        def each(self, works: Any) -> Iterator[Any]:
            if not self.begun:
                yield next(iter(super().each(works[:1])))
            raise BrokenExecutor

    with Killed(2) as own:
        data, _, reason = followed(SCENE, SCENE.plan, Execution(processes=own))
    assert reason is None
    assert at_once == [0, 2, 3]
    same(here[0], data)


def test_curves_that_cannot_be_kept_are_in_the_result(
    here: Any, two: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def full(*_: Any) -> None:
        raise StoreError("the disk is full")

    monkeypatch.setattr(KeptCurves, "save", full)
    data, _, reason = followed(SCENE, SCENE.plan, Execution(folder=tmp_path, processes=two))
    assert reason == "the disk is full"
    first = here[0].isel(solution=here[0]["curve"].values == 0)
    np.testing.assert_array_equal(data["amplitude"], first["amplitude"])


STEEP = {"stability": True, "frequency": {"from": 1.0, "to": 0.93}}
LONG = load_scene(oscillator_scene(preload=-4.0) | {"study": STUDY | STEEP})


@pytest.fixture
def takes_long(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, tuple[Any, ...]]]:
    """A curve takes long from its second solution on; what is done aside, and with what."""
    monkeypatch.setattr(other_end, "WORK", 60)
    monkeypatch.setattr(aside, "WORK", 60)
    monkeypatch.setattr(evaluation, "PIECE", 16)
    given: list[tuple[str, tuple[Any, ...]]] = []
    part, piece = aside.Aside.part, aside.Evaluation._next

    def asked(self: aside.Aside, *args: Any) -> Any:
        given.append(("part", args))
        return part(self, *args)

    def evaluated(self: aside.Evaluation) -> Any:
        if (found := piece(self)) is not None:
            given.append(("piece", found[1][1]))
        return found

    monkeypatch.setattr(aside.Aside, "part", asked)
    monkeypatch.setattr(aside.Evaluation, "_next", evaluated)
    return given


def test_processes_take_a_part_of_a_curve_that_takes_long(two: Processes, takes_long: list[Any]):
    alone, *_ = followed(LONG, LONG.plan, Execution())
    assert not takes_long
    both, _, reason = followed(LONG, LONG.plan, Execution(processes=two))
    assert reason is None
    assert [name for name, _ in takes_long] == ["part"] + ["piece"] * (len(takes_long) - 1)
    evaluated = np.concatenate([solutions.p for _, (_, solutions) in takes_long[1:]])
    np.testing.assert_array_equal(np.sort(evaluated), np.sort(both.frequency))
    folds = [data.frequency.values[data.fold.values > 0] for data in (both, alone)]
    assert folds[0].size == 2
    np.testing.assert_allclose(*folds, rtol=1e-9)
    for branch in range(3):
        one, other = (data.isel(solution=data.branch.values == branch).sortby("frequency") for data in (both, alone))
        for name in ("amplitude", "floquet_max"):
            wanted, found = (
                np.interp(one.frequency, own.frequency, own[name].values.reshape(own.sizes["solution"], -1)[:, 0])
                for own in (other, one)
            )
            inside = slice(3, -3)  # beside a fold the curve is steep
            np.testing.assert_allclose(found[inside], wanted[inside], rtol=0.05, err_msg=f"{name} {branch}")


def at_once_here(_: Processes, seen: Any, function: Any, *args: Any) -> Future[Any]:
    """`Processes.submit` by this process."""
    done = Future[Any]()
    done.set_result(pickle.loads(pickle.dumps(function))(*args))
    return done


def test_solutions_are_evaluated_before_the_curve_is_whole_where_a_process_has_nothing_else_to_do(
    takes_long: list[Any], monkeypatch: pytest.MonkeyPatch
):
    """What comes out does not depend on when it happens, nor on who does it."""
    monkeypatch.setattr(aside, "LOOKED", 1)
    steps: list[str] = []

    def submit(own: Processes, seen: Any, function: Any, *args: Any) -> Future[Any]:
        steps.append("part" if function is aside.followed_part else "piece")
        return at_once_here(own, seen, function, *args)

    monkeypatch.setattr(Processes, "submit", submit)

    def solution(done: float, whole: float, words: str = "", /) -> None:
        steps.extend(["solution"] * ("of the range" in words))

    with Processes(2) as own:
        data, _, reason = followed(LONG, LONG.plan, Execution(progress=solution, processes=own))
    assert reason is None
    last = len(steps) - steps[::-1].index("solution")
    assert steps[:last].count("piece") >= 2  # of the other part, and of this one
    assert "piece" in steps[last:]
    monkeypatch.setattr(aside.Aside, "meanwhile", lambda *_: None)
    with Processes(2) as own:
        late, *_ = followed(LONG, LONG.plan, Execution(processes=own))
    same(data, late)


def test_an_interrupt_keeps_the_multipliers_that_are_known(takes_long: list[Any], monkeypatch: pytest.MonkeyPatch):
    """Of solutions that were evaluated while the curve was followed."""
    monkeypatch.setattr(aside, "LOOKED", 1)
    monkeypatch.setattr(evaluation, "OPEN", 4)
    monkeypatch.setattr(evaluation, "PIECE", 4)
    monkeypatch.setattr(Processes, "submit", at_once_here)

    def interrupted(*_: Any) -> None:
        if len(takes_long) >= 4:
            raise KeyboardInterrupt

    with Processes(2) as own:
        data, _, reason = followed(LONG, LONG.plan, Execution(progress=interrupted, processes=own))
    assert reason is not None
    assert "interrupted before all multipliers" in reason
    known = np.isfinite(data.floquet_max.values)
    assert 3 * 4 <= known.sum() < known.size
    evaluated = np.concatenate([given[1].p for name, given in takes_long if name == "piece"])
    assert set(data.frequency.values[known]) <= set(evaluated)
    assert data.stable.values[~known].any()


def test_solutions_are_evaluated_while_the_other_part_is_waited_for(
    takes_long: list[Any], monkeypatch: pytest.MonkeyPatch
):
    """The other part ends as soon as solutions are evaluated, or after a minute."""
    monkeypatch.setattr(evaluation, "OPEN", 4)
    monkeypatch.setattr(evaluation, "PIECE", 4)
    part, waits, pieces = Future[Any](), Event(), 0
    one_here = aside.Evaluation.one_here

    def here(own: aside.Evaluation) -> bool:
        nonlocal pieces
        done = one_here(own)
        pieces += done and not part.done()
        if done:
            waits.set()
        return done

    def end(function: Any, args: Any) -> None:
        waits.wait(60.0)
        part.set_result(function(*args))

    def submit(own: Processes, seen: Any, function: Any, *args: Any) -> Future[Any]:
        if function is aside.followed_part:
            Thread(target=end, args=(function, args)).start()
            return part
        return at_once_here(own, seen, function, *args)

    monkeypatch.setattr(Processes, "submit", submit)
    monkeypatch.setattr(aside.Evaluation, "one_here", here)
    with Processes(2) as own:
        data, _, reason = followed(LONG, LONG.plan, Execution(processes=own))
    assert reason is None
    assert pieces
    monkeypatch.setattr(Processes, "submit", at_once_here)
    monkeypatch.setattr(aside.Aside, "meanwhile", lambda *_: None)
    late, *_ = followed(LONG, LONG.plan, Execution(processes=own))
    same(data, late)


def test_the_part_of_another_curve_is_not_evaluated(monkeypatch: pytest.MonkeyPatch):
    """The curve from the other end of the range has units of its own."""
    monkeypatch.setattr(aside, "LOOKED", 1)
    monkeypatch.setattr(Processes, "submit", at_once_here)
    solutions = Curve.of([(np.ones(2), p, False, 1) for p in (0.9, 0.95, 1.0)], 2, Ending.COMPLETE, "")
    monkeypatch.setattr(aside, "followed_part", partial(part_at_once, solutions))
    asked: list[list[float]] = []

    def pieces(known: Curve, *, grows: bool) -> list[Any]:
        if not grows:
            asked.append(known.p.tolist())
        return []

    with Processes(2) as own:
        beside = aside.Aside(own, (), Controls(), checks_samples=False)
        beside.part(cast(Any, None), 1.2, 0.9, 1.0)
        for start in (0.9, 1.2):
            beside.meanwhile(start, cast(Any, None), pieces, lambda: solutions)
    assert asked == [[0.9, 0.95]]


def part_at_once(solutions: Curve, *_: Any) -> Curve:
    return solutions


@pytest.mark.parametrize("stability", [True, False])
def test_an_interrupt_keeps_what_there_is_from_both_ends(
    two: Processes, takes_long: list[Any], stability: bool, monkeypatch: pytest.MonkeyPatch
):
    parts: list[aside.Part] = []

    class Part(aside.Part):
        def __init__(self, *asked: Any):
            super().__init__(*asked)
            parts.append(self)

    def interrupted(*_: Any) -> None:
        if parts:
            while parts[0].share < 0.2 and not (parts[0]._future and parts[0]._future.done()):
                sleep(0.05)
            raise KeyboardInterrupt

    monkeypatch.setattr(aside, "Part", Part)
    scene = LONG.with_overrides({"study.stability": stability})
    data, _, reason = followed(scene, scene.plan, Execution(processes=two, progress=interrupted))
    here, there = (data.isel(solution=data.curve.values == place) for place in range(2))
    assert here.frequency.values[0] == 1.0
    assert there.frequency.values[0] == 0.93
    assert there.sizes["solution"] >= 3
    assert np.all(np.isfinite(there.amplitude.values[..., 0]))
    assert reason is not None
    assert [part.split(", after")[0] for part in reason.split("; ")] == [
        f"continuation at {own.frequency.values[-1]:.10g} Hz" for own in (here, there)
    ]
    assert "from the other end of the range: interrupted" in reason
    assert reason.count("before the multipliers") == (2 if stability else 0)


def test_too_few_samples_that_another_process_finds_end_both_parts(
    takes_long: list[Any], monkeypatch: pytest.MonkeyPatch
):
    """Here no solution is checked on its way, and there every third: the curve is followed again at once."""
    monkeypatch.setattr(scheme, "ENOUGH_SAMPLES", 24)
    monkeypatch.setattr(scheme, "SAMPLES_PER_WAVE", 4)
    monkeypatch.setattr(convergence, "CHECKED", 3)
    monkeypatch.setattr(convergence, "checking_samples", lambda model_at, schemes, watch: watch)
    judged: list[int] = []
    own = Curves._with_more_samples
    monkeypatch.setattr(Curves, "_with_more_samples", lambda *asked: (judged.append(1), own(*asked))[1])

    def submit(_: Processes, seen: Any, function: Any, *args: Any) -> Future[Any]:
        done = Future[Any]()
        try:
            done.set_result(function(*args))
        except Exception as error:  # as a process hands over what a work raises
            done.set_exception(pickle.loads(pickle.dumps(error)))
        return done

    monkeypatch.setattr(Processes, "submit", submit)
    auto = LONG.with_overrides({"study.time_samples": "auto", "study.stability": False})
    with Processes(2) as two:
        data, _, reason = followed(auto, auto.plan, Execution(processes=two))
    assert reason is None
    assert "96 time samples" in data.attrs["method"]
    assert len(judged) == 1


@pytest.mark.parametrize("refused", [True, False])
def test_where_the_process_of_a_part_is_killed_the_curve_is_the_same_as_here(
    takes_long: list[Any], refused: bool, monkeypatch: pytest.MonkeyPatch
):
    def killed(*_: Any) -> Any:
        if refused:
            raise BrokenExecutor
        broken = Future[Any]()
        broken.set_exception(BrokenExecutor())
        return broken

    alone, *_ = followed(LONG, LONG.plan, Execution())
    monkeypatch.setattr(Processes, "submit", killed)
    with Processes(2) as own:
        data, _, reason = followed(LONG, LONG.plan, Execution(processes=own))
    assert reason is None
    same(alone, data)
