"""Curves of harmonic balance outlive their run: finished ones are taken up again, a growing one is on disk."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from systems import oscillator_scene

import timesim
from timesim.hbm import scheme as hbm_scheme
from timesim.hbm.continuation import Ending
from timesim.result.checkpoint import chunks_done, resuming_helps
from timesim.result.file import StoreError
from timesim.study.curves import kept as kept_curves
from timesim.study.execution.campaign import Execution
from timesim.study.registry import carry_out, load_scene

pytestmark = pytest.mark.long

RANGE = {"from": 1.0, "to": 0.97}
STUDY = {"kind": "hbm", "frequency": RANGE, "harmonics": 5, "time_samples": 128, "stability": False}
OVER = {"contacts.pad.preload": [-4, -3]}
SCENE = oscillator_scene(preload=-4.0) | {"study": STUDY | {"over": OVER}}


class Killed(BaseException):
    """Ends a run as `kill -9` does: nothing is saved that is not on disk already."""


class Watcher:
    """Takes in the progress of a run, and may end it."""

    def __init__(self, ending: type[BaseException] | None = None):
        self.seen: list[tuple[float, str]] = []
        self.ending = ending

    def __call__(self, done: float, number: float, phase: str = "", /) -> None:
        assert number == 2
        self.seen.append((done, phase))
        if self.ending is not None and done > 1.3:
            raise self.ending


@pytest.fixture(scope="module")
def whole() -> Any:
    """A run that nothing ends, and what it shows."""
    watcher = Watcher()
    return carry_out(load_scene(SCENE), Execution(progress=watcher)).groups[""], watcher.seen


def execution_of(folder: Path, watcher: Watcher, **others: Any) -> tuple[Execution, list[str]]:
    notices: list[str] = []
    return Execution(progress=watcher, folder=folder, notice=notices.append, **others), notices


def test_the_progress_of_a_curve_is_the_share_of_its_range(whole):
    seen = whole[1]
    done = [now for now, _ in seen]
    assert done == sorted(done)
    assert (done[0], done[-1]) == (0, 2)
    shares = [int(share) for _, words in seen for share in re.findall(r"curve 1: (\d+)% of the range", words)]
    assert len(shares) > 10
    assert shares[-1] == 100
    assert np.median(shares) < 90
    assert seen[-2][1] == "curve 2: 100% of the range, contacts.pad.preload -3"


@pytest.mark.parametrize("ending", [pytest.param(Killed, marks=pytest.mark.slow), KeyboardInterrupt])
def test_a_run_cut_off_goes_on_with_its_curves(
    ending: type[BaseException], whole: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    if ending is Killed:
        monkeypatch.setattr(kept_curves, "SECONDS_APART", 0.0)
        monkeypatch.setattr(kept_curves, "TIMES_APART", 0.0)
    scene, one = load_scene(SCENE), whole[0]["curve"].values == 0
    execution, _ = execution_of(tmp_path, Watcher(ending))
    if ending is Killed:
        with pytest.raises(Killed):
            carry_out(scene, execution)
        found = timesim.open_result(tmp_path / "checkpoint" / "growing.nc")
    else:
        outcome = carry_out(scene, execution)
        found = outcome.groups[""]
        assert outcome.reason is not None
        assert Ending.INTERRUPTED.value in outcome.reason
        assert "missing" not in outcome.reason
        assert resuming_helps(tmp_path, outcome.reason)
    assert found.attrs["complete"] == 0
    assert "interrupted" in found.attrs["reason"]
    partly = found.isel(solution=found["curve"].values == 1)
    np.testing.assert_array_equal(found["amplitude"][found["curve"].values == 0], whole[0]["amplitude"][one])
    assert 3 < partly.sizes["solution"] < np.sum(~one)
    np.testing.assert_array_equal(partly["frequency"], whole[0]["frequency"][~one][: partly.sizes["solution"]])
    assert set(partly["contacts.pad.preload"].values) == {-3.0}
    assert chunks_done(tmp_path) == 1
    watcher = Watcher()
    resumed, notices = execution_of(tmp_path, watcher, resume=True)
    earlier = resumed.earlier()
    assert earlier > 0
    again = carry_out(scene, resumed)
    assert again.reason is None
    folder = tmp_path / "checkpoint"
    assert notices == [f"the curves of 1 of 2 sets of values are taken up from {folder}"]
    assert not any("curve 1" in words for _, words in watcher.seen)
    for name, array in whole[0].variables.items():
        np.testing.assert_array_equal(again.groups[""][name], array, err_msg=name)
    assert again.groups[""].attrs["run_seconds"] > earlier


@pytest.mark.parametrize("along", [True, False])
def test_a_curve_without_its_multipliers_is_followed_again(
    along: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The interrupt comes along the curve, or among its multipliers."""

    def interrupted(done: float = 1.0, *_: Any) -> None:
        if done > 0.2:
            raise KeyboardInterrupt

    scene = load_scene(SCENE | {"study": STUDY | {"frequency": {"from": 1.0, "to": 0.999}, "stability": True}})
    execution = Execution(folder=tmp_path, notice=lambda _: None)
    with monkeypatch.context() as patched:
        if not along:
            patched.setattr("timesim.study.hbm.warm_up", lambda *_, **__: None)  # it asks for multipliers too
            patched.setattr("timesim.hbm.curve.evaluation.checked_multipliers", lambda *_: interrupted())
        outcome = carry_out(scene, replace(execution, progress=interrupted) if along else execution)
    assert outcome.reason is not None
    assert "interrupted before the multipliers" in outcome.reason
    assert "complete" not in outcome.reason
    assert any("unstable solutions by folds alone; " in line for line in outcome.summary)
    assert np.isnan(outcome.groups[""]["floquet_max"]).all()
    assert chunks_done(tmp_path) == 0
    again = carry_out(scene, replace(execution, resume=True))
    assert again.reason is None
    assert np.isfinite(again.groups[""]["floquet_max"]).all()


def test_sets_of_values_whose_curves_were_not_begun_are_named():
    def interrupted(done: float, *_: Any) -> None:
        if done > 0.5:
            raise KeyboardInterrupt

    study = STUDY | {"frequency": {"from": 1.0, "to": 0.999}, "over": {"contacts.pad.preload": [-4, -3.5, -3]}}
    outcome = carry_out(load_scene(SCENE | {"study": study}), Execution(progress=interrupted))
    assert outcome.reason is not None
    assert outcome.reason.endswith("; the curves of 2 of 3 sets of values are missing")


def test_the_samples_that_the_first_curves_needed_are_kept_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """At -4 a contact that is closed for a quarter of the cycle needs 96; at 3 the 24 would do that it began with."""
    monkeypatch.setattr(hbm_scheme, "ENOUGH_SAMPLES", 24)
    monkeypatch.setattr(hbm_scheme, "SAMPLES_PER_WAVE", 4)
    study = STUDY | {"frequency": {"from": 0.93, "to": 0.9302}, "time_samples": "auto"}
    scene = load_scene(SCENE | {"study": study | {"over": {"contacts.pad.preload": [-4, 3]}}})
    expected = carry_out(scene).groups[""]

    def interrupted(done: float, *_: Any) -> None:
        if done == 1:
            raise KeyboardInterrupt

    execution = Execution(progress=interrupted, folder=tmp_path, notice=lambda _: None)
    assert carry_out(scene, execution).reason is not None
    assert chunks_done(tmp_path) == 1
    resumed = carry_out(scene, replace(execution, progress=Watcher(), resume=True)).groups[""]
    assert "96 time samples" in resumed.attrs["method"]
    for name, array in expected.variables.items():
        np.testing.assert_array_equal(resumed[name], array, err_msg=name)


def test_curves_of_another_scene_are_not_taken_up(tmp_path: Path):
    execution, _ = execution_of(tmp_path, Watcher(Killed))
    with pytest.raises(Killed):
        carry_out(load_scene(SCENE), execution)
    other = load_scene(SCENE | {"study": STUDY | {"over": OVER, "harmonics": 7}})
    with pytest.raises(StoreError, match=r"another scene: study\.harmonics was 5, is 7"):
        carry_out(other, replace(execution, resume=True))
    (tmp_path / "checkpoint" / "curves-00000.npz").write_bytes(b"PK")
    resumed, notices = execution_of(tmp_path, Watcher(Killed), resume=True)
    with pytest.raises(Killed):
        carry_out(load_scene(SCENE), resumed)
    assert "curves-00000.npz is damaged or cut off" in notices[1]


def test_a_growing_curve_takes_more_harmonics_than_the_first_scheme_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(kept_curves, "SECONDS_APART", 0.0)
    monkeypatch.setattr(kept_curves, "TIMES_APART", 0.0)
    study = {"kind": "hbm", "frequency": {"from": 0.25, "to": 0.26}, "stability": False}
    scene = load_scene(oscillator_scene(preload=-0.3) | {"study": study})

    def killed_half_way(done: float, number: float, phase: str = "", /) -> None:
        if done > 0.5 * number:
            raise Killed

    with pytest.raises(Killed):
        carry_out(scene, Execution(progress=killed_half_way, folder=tmp_path))
    found = timesim.open_result(tmp_path / "checkpoint" / "growing.nc")
    assert found.sizes["harmonic"] - 1 > scene.plan.schemes_for(scene.model())[0].harmonics
    assert np.all(np.isfinite(found["amplitude"]))
