"""Responses that jump: both ends of the range, which start leads to which motion, offsets that are free.

The ends on the paper's oscillator were computed independently, settled for 800 cycles a step: at a preload of 2 the
lower motion lives to 1.2560 Hz and is gone at 1.2561, the upper one to 1.2511 and is gone at 1.2510; with a gap of
0.2 the upper motion lives to 0.9472 Hz, the lower one to 0.9416.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commands import CONFIGS, options, run_of_config
from systems import oscillator
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.model.contact_state import contact_loads
from timesim.model.model import SEPARATION, STICK, Model, Start
from timesim.model.solver import NEVER, PRESETS, SHOOT, Criterion, Solver
from timesim.orbit.fourier import HARMONICS
from timesim.orbit.jump import Stretch, jumps_of, narrowed, steps_of
from timesim.orbit.settling import Chain, SteadyStates
from timesim.orbit.steady_state import Orbit, columns_of, differ, orbit_of, without_orbit
from timesim.orbit.two_motions import (
    DOWN,
    NO_MOTION,
    SMALLER,
    UP,
    RangeSearch,
    Sweeps,
    losses,
    ranges,
    ranges_of,
    suspect_steps,
)
from timesim.orbit.two_motions.basin import (
    ANOTHER,
    IRREGULAR,
    NONE,
    branch_of,
    explore,
    offsets,
    placed,
    starts_between,
    unique,
)
from timesim.orbit.two_motions.loss import WALK
from timesim.picture import bistable as plot_bistable
from timesim.result.netcdf import open_result, save
from timesim.scene.resolution import Scene
from timesim.study import bistable, hbm
from timesim.study import registry as plot
from timesim.study.execution.campaign import Chunk, Execution
from timesim.study.outcome import Outcome
from timesim.study.registry import carry_out, load_scene
from timesim.study.summary.bistable import bistable_lines, fold_lines
from timesim.study.sweep import FAILURES

pytestmark = pytest.mark.long

QUICK = {
    "study.frequency": "{from: 1.24, to: 1.27}",
    "study.step": "0.01",  # twice as wide as the range
    "study.width": "2e-4",
    "study.starts": "5",
    "study.harmonics": "5",
    "study.time_samples": "256",
    "study.settle": "{tolerance: 1e-6, max_cycles: 1500}",
    "solver.accuracy": "draft",
}


folder, result = run_of_config("softening.yaml", QUICK)


def test_both_ends_are_found_by_steps_wider_than_the_range(result):
    (low, high), *rest = result["range"].values
    assert not rest
    assert low == pytest.approx(1.2510586, abs=3e-4)
    assert high == pytest.approx(1.2560812, abs=3e-4)
    assert result["range_cut"].values.tolist() == [[0, 0]]


def test_the_motions_at_mid_range(result):
    lower, upper = (result[f"amplitude_{name}"].sel(point="tip", axis="x").values[0] for name in ("lower", "upper"))
    assert lower == pytest.approx(0.12886, rel=5e-3)
    assert upper == pytest.approx(0.27898, rel=5e-3)
    shares = result["slip_share"].sel(contact="pad").values[0]
    assert np.all((shares > 0.05) & (shares < 0.95))
    assert np.all(result["floquet_max"].values < 1)
    smaller, larger = result["dissipated_power"].sel(contact="pad").values[0]
    assert larger > 1.5 * smaller > 0
    ahead, behind = result["phase_deg"].sel(point="tip", axis="x").values[0]
    assert -180 < behind < ahead - 5 < 0
    assert result["sweep"]["phase_deg"].dims == ("direction", "frequency", "point", "axis")


def test_each_end_is_a_jump_to_the_other_motion(result):
    x = {name: result[name].sel(point="tip", axis="x") for name in ("jump_from", "jump_to")}
    before, after = (x[name].values[0] for name in ("jump_from", "jump_to"))
    assert before[0] > 0.2 > after[0]
    assert before[1] < 0.2 < after[1]
    sweep = result["sweep"].to_dataset()
    ends = np.array([sweep.jump_low.values.ravel(), sweep.jump_high.values.ravel()])
    assert np.all(ends[1] - ends[0] <= 2e-4)
    assert sorted(ends.mean(axis=0)) == pytest.approx(result["range"].values[0].tolist(), abs=2e-4)


def test_each_start_leads_to_one_of_the_motions(result):
    branch = result["start_branch"].isel(jump=0)
    at = {(a, b): int(branch.sel(share_lower=a, share_upper=b)) for a in (0, 1) for b in (0, 1)}
    assert at[1, 0] == 0
    assert at[0, 1] == 1
    assert at[0, 0] == 0
    assert set(np.unique(branch)) == {0, 1}
    amplitude = result["start_amplitude"].isel(jump=0).sel(point="tip", axis="x").values
    motions = [float(result[f"amplitude_{name}"].sel(point="tip", axis="x")[0]) for name in ("lower", "upper")]
    np.testing.assert_allclose(amplitude, np.array(motions)[branch.values], rtol=1e-3)


def test_the_branch_behind_turns_where_the_sweeps_jump(result):
    hbm = result["hbm"].to_dataset()
    assert sorted(hbm.frequency.values[hbm.fold.values > 0]) == pytest.approx([1.25106, 1.25608], abs=5e-4)
    assert (hbm.stable.values == 0).any()


def test_the_summary(folder):
    said = (folder / "said").read_text()
    for words in (
        "two motions from 1.25",
        "of 25 starts",
        "rest leads to the smaller motion",
        "folds of the balance at",
    ):
        assert words in said
    assert (folder / "run" / "ranges.png").exists()


def test_the_summary_says_what_there_is_at_the_middle_of_a_range(result):
    data, sweep = (tree.to_dataset().copy(deep=True) for tree in (result, result["sweep"]))
    lower, upper = (float(data[f"amplitude_{name}"].sel(point="tip", axis="x")[0]) for name in ("lower", "upper"))
    data["range"].values[0] = 1.25, 1.26
    two, *_ = bistable_lines(data, sweep, 1e-4)
    ends = "two motions from 1.25 to 1.26 Hz (each end to 0.0001 Hz)"
    assert two == f"{ends}: amplitude of tip x {lower:.6g} or {upper:.6g} at 1.255 Hz"


def test_the_summary_names_motions_that_do_not_repeat_each_cycle(result):
    data, sweep = (tree.to_dataset().copy(deep=True) for tree in (result, result["sweep"]))
    assert data["range_irregular"].values.tolist() == [[0, 0]]
    assert data["period"].values.tolist() == [[1, 1]]
    data["range_irregular"][0, 1], data["period"][0, 0] = 2, 3
    data["start_branch"][0, 0, :3] = [-1, 2, 3]
    said = "; ".join(bistable_lines(data, sweep, 1e-4))
    assert (
        f"the high end of it is where the larger motion loses its period: beyond {data['range'].values[0, 1]:.8g}"
        in said
    )
    assert "the smaller motion repeats after 3 cycles" in said
    assert ", 1 to another motion, 1 to one that does not repeat, 1 did not settle" in said


def test_the_summary_names_contacts_whose_offset_alone_may_tell_the_motions_apart(result):
    """Such motions are no two: others lie between them, and where they end depends on the sweeps."""
    data, sweep = (tree.to_dataset().copy(deep=True) for tree in (result, result["sweep"]))
    assert not any("on both motions" in line for line in bistable_lines(data, sweep, 1e-4))
    data["slip_share"][0, 0] = data["separation_share"][0] = 0
    assert not any("on both motions" in line for line in bistable_lines(data, sweep, 1e-4))
    data["slip_share"][0, 1] = 0
    (line,) = [line for line in bistable_lines(data, sweep, 1e-4) if "on both motions" in line]
    assert line.startswith("contact pad sticks all the time on both motions: they may differ by its offset alone")


def test_a_fold_near_which_no_range_ends_is_named(result):
    """As of a stop whose sweeps both stay on the upper motion: nobody may take it for the only one."""
    balance, ends = result["hbm"].to_dataset(), result["range"].values.ravel()
    assert not any("no range ends" in line for line in fold_lines(balance, {(): ends}, {}, 0.02))
    (line,) = fold_lines(
        balance.isel(solution=[0]).assign(fold=("solution", [0])).assign_attrs(complete=0), {}, {}, 0.02
    )
    assert line == "the branch of the balance has no fold as far as it was followed"


def test_a_branch_without_a_fold_beside_two_motions_does_not_join_them(result):
    """Of a search that one end of the range is cut off by: the other end is that of a branch that is not followed."""
    balance, ends = result["hbm"].to_dataset(), result["range"].values.ravel()
    one = balance.isel(solution=[0]).assign(fold=("solution", [0]))
    (line,) = fold_lines(one, {(): ends}, {}, 0.02)
    assert line == "the branch of the balance has no fold: it does not join the two motions"
    assert [*fold_lines(one, {(): np.zeros(0)}, {}, 0.02)] == ["the branch of the balance has no fold"]
    lines = [line for line in fold_lines(balance, {(): ends[1:]}, {}, 1e-3) if "no range ends" in line]
    assert [line.split(" Hz")[0] for line in lines] == ["beside the fold at " + f"{_folds(balance)[0]:.7g}"]


@pytest.mark.parametrize("other", [3.0, -4.0000001])
def test_folds_are_held_against_the_ranges_with_their_own_values(result, other: float):
    """Also where both are written alike."""
    balance, ends = result["hbm"].to_dataset(), result["range"].values.ravel()
    balance["contacts.pad.preload"] = ("solution", np.full(balance.sizes["solution"], -4.0))
    sets = {(-4.0,): ends[1:], (other,): ends}
    assert sum("no range ends" in line for line in fold_lines(balance, sets, {}, 1e-3)) == 1
    sets.pop((-4.0,))  # whose ends are not known
    assert not any("no range ends" in line for line in fold_lines(balance, sets, {}, 1e-3))


def test_a_fold_beside_points_that_failed_asks_for_no_other_search(result):
    balance, ends = result["hbm"].to_dataset(), result["range"].values.ravel()
    (first, _), failed = _folds(balance), np.array([1.24, 1.25, 1.27])
    lines = list(fold_lines(balance, {(): ends[1:]}, {(): failed}, 1e-3))
    because = "no range ends, perhaps because 3 points of the sweeps failed, the nearest at 1.25 Hz"
    assert lines[1:] == [f"near the fold at {first:.7g} Hz {because}"]


def _folds(balance):
    return sorted(balance["frequency"].values[balance["fold"].values > 0])


def test_the_pictures_show_the_ranges(result):
    assert plot.picture_names("bistable") == ["response.png", "ranges.png", "starts.png", "existence.png"]
    (place,) = plot_bistable.ranges(result)
    ax = plot_bistable.response(result, near=place, point="tip", axis="x")
    assert ax.get_xlim()[0] < place.low < place.high < ax.get_xlim()[1]
    stars = [line for line in ax.get_lines() if line.get_marker() == "*"]
    assert [float(np.asarray(line.get_ydata())[0]) for line in stars] == pytest.approx([0.1289, 0.2790], rel=1e-2)
    diamonds = [line for line in ax.get_lines() if line.get_marker() == "D"]
    assert np.asarray(diamonds[0].get_xdata()).size == 2
    square = plot_bistable.starts(result)
    (mesh,) = square.collections
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).ravel(), result["start_branch"].values.ravel())
    assert plot_bistable.PICTURES["existence"](result) is None


def test_starts_that_were_not_run_are_not_said_to_lead_anywhere(result):
    """As after an interrupt: they have led to no settled motion in the result, as those that did not settle."""
    root, sweep = result.to_dataset(), result["sweep"].to_dataset()
    lines = list(bistable_lines(root, sweep, 1e-3))
    assert any(" starts " in line and "to the larger" in line for line in lines)
    cut = root.assign(start_cycles=0 * root["start_cycles"] - 1, start_branch=0 * root["start_branch"] + NONE)
    lines = list(bistable_lines(cut, sweep, 1e-3))
    assert "the starts at its middle were not run" in lines
    assert not any("to the larger" in line or "rest leads" in line for line in lines)


def test_jumps_without_a_range_between_them_are_told(result):
    """A range that is no wider than twice its ends are known to is none; the jumps are there all the same."""
    root, sweep = result.to_dataset(), result["sweep"].to_dataset()
    none = root.assign(range=np.nan * root["range"])
    lines = list(bistable_lines(none, sweep, 0.5))
    assert lines[0].endswith("one between jumps is at most 1 Hz wide, or has a motion that does not repeat")
    assert sum("the motion jumps between" in line for line in lines) == 2
    still = sweep.assign(jump_low=np.nan * sweep["jump_low"])
    (line,) = bistable_lines(none, still, 0.5)
    assert "both sweeps are on one motion at all" in line


def test_no_jump_is_a_result(tmp_path: Path):
    given = QUICK | {"study.frequency": "{from: 1.4, to: 1.45}", "study.harmonics": "0"}
    call = ["run", str(CONFIGS / "softening.yaml"), "-o", str(tmp_path), *options(given)]
    done = CliRunner().invoke(app, call)
    assert done.exit_code == 0, done.output
    assert "no range with two motions was found from 1.4 to 1.45 Hz" in done.stdout
    data = open_result(tmp_path)
    assert data["range"].shape == (0, 2)
    assert data["start_branch"].shape == (0, 5, 5)
    assert set(data.children) == {"sweep"}
    assert {path.name for path in tmp_path.glob("*.png")} == {"response.png"}


@dataclass(frozen=True)
class Searched:
    """A study without its balance: the folder of its chunks, their results, and the outcome."""

    scene: Scene
    folder: Path
    chunks: dict[str, Any]
    outcome: Outcome


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Searched:
    rough = {"study.harmonics": "0", "study.width": "1e-3", "study.settle": "{tolerance: 1e-5, max_cycles: 1500}"}
    scene = load_scene(CONFIGS / "softening.yaml", [f"{key}={value}" for key, value in (QUICK | rough).items()])
    folder, chunks, work = tmp_path_factory.mktemp("searched"), {}, bistable.carry_through

    def kept(*given: Any, **options: Any) -> Any:
        results, reason = work(*given, **options)
        chunks.update(results)
        return results, reason

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bistable, "carry_through", kept)
        return Searched(scene, folder, chunks, carry_out(scene, Execution(folder=folder)))


@pytest.mark.parametrize("num", [0, 3])
def test_more_jumps_than_ranges_or_fewer(searched: Searched, num: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A tree of Datasets shares its dimensions: both must have room along `jump`."""
    jumps = {"jumps": np.tile([0, 1.25, 1.26], (num, 1))}
    changed = {name: dict(chunk) | (jumps if "jumps" in chunk else {}) for name, chunk in searched.chunks.items()}
    assert sum("jumps" in chunk for chunk in searched.chunks.values()) == 2
    monkeypatch.setattr(bistable, "carry_through", lambda *_, **__: (changed, None))
    outcome = carry_out(searched.scene)
    data = open_result(save(outcome.groups, tmp_path / "result.nc"))
    assert data["range"].shape == (max(num, 1), 2)
    assert np.isfinite(data["range"]).all(axis=1).sum() == 1
    assert data["sweep"].jump_low.dims == ("direction", "jump")
    assert np.isfinite(data["sweep"].jump_low).sum() == num
    assert data["range_cut"].dtype.kind == "i"


def test_a_start_that_fails_is_not_one_that_did_not_settle(
    searched: Searched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """It is counted apart, with the reason, and the study is not complete."""
    before, model, why = searched.chunks["00000-ends"], searched.scene.model(), "no steps are left"

    def steady(chains: Sequence[Chain]) -> list[list[Orbit]]:
        led = [[orbit_of(before, (0, 1), 0.0)] for _ in chains]
        led[6], led[7] = [without_orbit(model, why)], [replace(led[7][0], period=0)]  # the first is rest
        return led

    changed = searched.chunks | {"00000-starts": before | explore(model, steady, before, 5)}
    monkeypatch.setattr(bistable, "carry_through", lambda *_, **__: (changed, None))
    outcome = carry_out(searched.scene)
    data = open_result(save(outcome.groups, tmp_path / "result.nc"))
    assert outcome.reason == f"the motion from 1 start could not be computed: {why}"
    assert data.attrs["complete"] == 0
    lines = ["of 25 starts 0 lead to the smaller motion, 23 to the larger, 1 did not settle", outcome.reason]
    assert list(outcome.summary[1:4]) == [*lines, "where rest leads is not known"]
    failure, branch = data["start_failure"].values[0], data["start_branch"].values[0]
    assert (failure[1, 1], failure[1, 2], np.sum(failure != "")) == (why, "", 1)
    assert branch[1, 1] == branch[1, 2] == NONE


def test_each_sweep_is_labelled_by_its_direction_and_ascends(searched: Searched, monkeypatch: pytest.MonkeyPatch):
    sweep = searched.chunks["00000-sweep-00000"]
    amplitude = sweep["amplitude"] * np.array([1.0, 2.0]).reshape(2, 1, 1, 1)
    changed = searched.chunks | {"00000-sweep-00000": sweep | {"amplitude": amplitude}}
    monkeypatch.setattr(bistable, "carry_through", lambda *_, **__: (changed, None))
    data = carry_out(searched.scene).groups["sweep"]["amplitude"].transpose("direction", "frequency", "point", "axis")
    assert (np.diff(data["frequency"]) > 0).all()
    np.testing.assert_allclose(data.sel(direction="up"), amplitude[UP])
    np.testing.assert_allclose(data.sel(direction="down"), amplitude[DOWN][::-1])


def test_what_could_not_be_computed_makes_the_study_incomplete_and_the_first_of_it_is_named(
    searched: Searched, monkeypatch: pytest.MonkeyPatch
):
    """A point of the sweeps, before a motion of the search, before a start; seconds of earlier sessions count."""
    sweep, starts = (searched.chunks[f"00000-{name}"] for name in ("sweep-00000", "starts"))
    why = starts["start_failure"].astype(object)
    why[0, 2, 2] = "no start"
    reason = sweep["reason"].astype(object)
    reason[DOWN, 1] = "no point"
    fails = [
        {"00000-starts": starts | {"start_failure": why}},
        {"00000-starts": starts | {"start_failure": why, FAILURES: np.array(["no way"])}},
    ]
    fails += [fails[1] | {"00000-sweep-00000": sweep | {"reason": reason}}]
    monkeypatch.setattr(Execution, "earlier", lambda *_: 1000.0)
    said = []
    for changed in fails:
        chunks = searched.chunks | changed
        monkeypatch.setattr(bistable, "carry_through", lambda *_, chunks=chunks, **__: (chunks, None))
        outcome = carry_out(searched.scene)
        assert outcome.groups[""].attrs["complete"] == 0
        assert 1000 < outcome.groups[""].attrs["run_seconds"] < 1100
        said.append(outcome.reason)
    assert said[0] == "the motion from 1 start could not be computed: no start"
    assert said[1] == "the search for jumps is not exact, as 1 motion of it could not be computed: no way"
    assert "no point" in said[2]


def test_a_balance_that_comes_to_no_end_leaves_the_study_whole(monkeypatch: pytest.MonkeyPatch):
    given = QUICK | {"study.frequency": "{from: 1.4, to: 1.45}", "study.starts": "0"}
    scene = load_scene(CONFIGS / "softening.yaml", [f"{key}={value}" for key, value in given.items()])
    reason = ["the corrector did not converge"]

    def not_whole(curves: Any, *_: Any) -> str:
        curves.notes.append("few harmonics were enough")
        return reason[0]

    monkeypatch.setattr(hbm, "follow_all", not_whole)
    outcome = carry_out(scene)
    assert "few harmonics were enough" in outcome.summary
    assert outcome.reason is None
    assert outcome.groups[""].attrs["complete"] == 1
    assert outcome.groups["hbm"].attrs["complete"] == 0
    assert any("the balance behind is not whole: the corrector did not" in line for line in outcome.summary)
    reason[0] = "interrupted at curve 1"
    assert carry_out(scene).reason == "hbm: interrupted at curve 1"


def test_resumed_it_is_the_same(searched: Searched, tmp_path: Path):
    scene, whole, folder = searched.scene, searched.outcome, tmp_path / "checkpoint"
    shutil.copytree(searched.folder / "checkpoint", folder)
    (folder / "00000-starts.npz").unlink()
    (folder / "00000-ends.npz").unlink()
    notices: list[str] = []
    again = carry_out(scene, Execution(folder=tmp_path, notice=notices.append, resume=True))
    assert notices == [f"1 of 3 chunks taken up from {folder}"]
    assert again.reason is whole.reason is None
    for group in ("", "sweep"):
        for name, array in whole.groups[group].variables.items():
            assert again.groups[group][name].dims == array.dims
            np.testing.assert_array_equal(again.groups[group][name], array)


# The search, on motions that are known: two branches that live to given frequencies


class Branches:
    """Motions 0, 1, ... that live from `low` to `high` each; one that is lost gives way to the next that is there."""

    irregular = (np.inf, np.inf)
    """Frequencies at which one of the motions does not repeat: the last one, or that of the number `wanders`."""
    wanders = -1

    def __init__(self, *spans: tuple[float, float], rise: float = 1.0, slope: float = 0.1):
        self.spans, self.rise, self.slope = spans, rise, slope

    def orbit(self, branch: float, frequency: float) -> Orbit:
        number = int(branch)
        while not self.spans[number][0] <= frequency <= self.spans[number][1]:
            number += 1 if frequency > self.spans[number][1] else -1
        amplitude = np.full((1, 3), 1 + self.rise * number + self.slope * (frequency - 1) ** 3)
        end = Start(np.full(2, float(number)), np.zeros(2), np.zeros((1, 2)), np.full(1, STICK))
        wanders = self.wanders % len(self.spans) == number
        irregular = wanders and self.irregular[0] < frequency < self.irregular[1]
        return replace(
            without_orbit(oscillator(2.0, 1.0), "", 8), end=end, amplitude=amplitude, band=np.stack([amplitude] * 2),
            period=int(not irregular), irregular=irregular, slip_share=np.zeros(1), separation_share=np.zeros(1),
            reason=None,
        )  # fmt: skip

    def along(self, start: Start, frequencies: Sequence[float]) -> list[Orbit]:
        found, branch = [], start.displacement[0]
        for frequency in frequencies:
            found.append(self.orbit(branch, frequency))
            branch = found[-1].end.displacement[0]
        return found


def two_branches(low: float, high: float, **shape: float) -> Branches:
    """A small motion (0) that lives up to `high`, and a large one (1) that lives down to `low`."""
    return Branches((-np.inf, high), (low, np.inf), **shape)


def toy_search(toy: Branches) -> RangeSearch:
    """A search along the known motions."""

    def steady(chains: Sequence[Chain]) -> list[list[Orbit]]:
        return [toy.along(chain.model.start, chain.frequencies) for chain in chains]

    return RangeSearch(oscillator(2.0, 1.0), steady, 1e-6)


class Counted:
    """Steady states, and how many were asked for."""

    def __init__(self, steady: SteadyStates):
        self.steady, self.num_points = steady, 0

    def __call__(self, chains: Sequence[Chain]) -> list[list[Orbit]]:
        self.num_points += sum(len(chain.frequencies) for chain in chains)
        return self.steady(chains)


def toy_sweeps(toy: Branches, frequency: np.ndarray) -> Sweeps:
    up, down = toy.along(toy.orbit(0, 0.0).end, frequency), toy.along(toy.orbit(0, 9.0).end, frequency[::-1])
    return Sweeps(frequency, (up, down[::-1]))


@pytest.mark.parametrize("num", [5, 6, 21, 200])
def test_ranges_of_known_motions(num: int):
    toy = two_branches(1.43, 1.52)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, num))
    lost = list(losses(search, sweeps))
    assert [loss.direction for loss in lost] == [UP, DOWN]
    (found,) = ranges(search, sweeps, lost)
    assert (found.low, found.high) == pytest.approx((1.43, 1.52), abs=1e-6)
    assert found.low >= 1.43
    assert found.high <= 1.52
    assert found.cut == (False, False)
    assert (found.lower.end.displacement[0], found.upper.end.displacement[0]) == (0, 1)


@pytest.mark.parametrize(("high", "cut"), [(1.52, False), (2.5, True)])
def test_a_motion_lost_by_a_long_step_is_led_on(high: float, cut: bool):
    """The sweep up leaves the small motion early; its end is found all the same, or that it lives to the last point."""
    toy = two_branches(1.23, high)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    early = [
        toy.orbit(1.0, f) if f > 1.36 else orbit for f, orbit in zip(sweeps.frequency, sweeps.orbits[UP], strict=True)
    ]
    sweeps = replace(sweeps, orbits=(early, sweeps.orbits[DOWN]))
    lost = list(losses(search, sweeps))
    (found,) = ranges(search, sweeps, lost)
    assert (found.low, found.high) == pytest.approx((1.23, min(high, 2.0)), abs=1e-6)
    assert found.cut == (False, cut)
    assert np.isnan(found.jumped).all(axis=(1, 2, 3)).tolist() == [False, cut]
    assert found.settled == (True, True)  # what is cut too
    columns = columns_of([early, sweeps.orbits[DOWN][::-1]]) | {"frequency": np.array([sweeps.frequency] * 2)}
    columns["frequency"][DOWN] = sweeps.frequency[::-1]
    (_, up_low, up_high), _ = ranges_of(search, columns)["jumps"]
    assert (up_low, up_high) == pytest.approx((1.35, 1.4) if cut else (high, high), abs=1e-6)


def test_the_jump_of_a_sweep_down_whose_motion_lives_on_is_the_whole_step():
    toy = two_branches(0.5, 1.52)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    down = [toy.orbit(float(f > 1.36), f) for f in sweeps.frequency]
    columns = columns_of([sweeps.orbits[UP], down[::-1]]) | {"frequency": np.array([sweeps.frequency] * 2)}
    columns["frequency"][DOWN] = sweeps.frequency[::-1]
    jumps = ranges_of(search, columns)["jumps"]
    assert jumps[jumps[:, 0] == DOWN, 1:].tolist() == [pytest.approx([1.35, 1.4])]


def test_a_jump_that_is_small_beside_the_slope():
    toy = two_branches(1.43, 1.62, rise=0.05, slope=8.0)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert (found.low, found.high) == pytest.approx((1.43, 1.62), abs=1e-6)


def test_a_range_within_a_step_beside_one_of_larger_change():
    """The response goes on to change over the next step by five times as much, without a jump."""
    toy = two_branches(1.43, 1.47, rise=0.3, slope=8.0)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 3))
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert (found.low, found.high) == pytest.approx((1.43, 1.47), abs=1e-6)


def test_a_range_in_which_both_sweeps_are_on_one_motion():
    """The sweep up leaves the small motion in the step in which the range begins, which ends in the step after it."""
    toy = two_branches(1.43, 1.62)
    search, frequencies = toy_search(toy), np.linspace(1.0, 2.0, 11)
    up = [toy.orbit(f > 1.45, f) for f in frequencies]
    sweeps = replace(toy_sweeps(toy, frequencies), orbits=(up, toy_sweeps(toy, frequencies).orbits[DOWN]))
    assert not sweeps.apart.any()
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert (found.low, found.high) == pytest.approx((1.43, 1.62), abs=1e-6)


@pytest.mark.parametrize(
    ("spans", "wanders", "end"),
    [
        (((-np.inf, 1.5), (1.3, 1.8), (1.1, np.inf)), 0, (1.3, 1.8)),
        (((-np.inf, 1.9), (1.2, 1.7), (1.5, np.inf)), 2, (1.2, 1.7)),
        (((-np.inf, 1.5), (0.9, 1.8), (1.1, np.inf)), 0, (1.1, 1.8)),
        (((-np.inf, 1.5), (0.9, 1.8), (0.9, np.inf)), 0, (1.0, 1.8)),
    ],
)
def test_a_motion_to_which_an_irregular_one_jumps_is_followed_back(
    spans: tuple, wanders: int, end: tuple[float, float]
):
    """To where it is lost, or the other sweep's motion is, or the sweep ends: there the range is cut."""
    toy = Branches(*spans)
    toy.irregular, toy.wanders = (1.02, 1.98), wanders
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    found = [one for one in ranges(search, sweeps, list(losses(search, sweeps))) if one.high - one.low > 0.1]
    (own,) = [one for one in found if 1 in (one.lower.end.displacement[0], one.upper.end.displacement[0])][-1:]
    assert (own.low, own.high) == pytest.approx(end, abs=1e-6)
    assert own.cut == (end[0] == 1.0, False)
    assert own.irregular == (NO_MOTION, NO_MOTION)
    for orbit in (own.lower, own.upper):  # also where its low end has moved, of the middle of the range that is told
        there = toy.orbit(orbit.end.displacement[0], 0.5 * (own.low + own.high))
        np.testing.assert_array_equal(orbit.amplitude, there.amplitude)


def test_a_motion_that_is_followed_back_may_lose_its_period():
    toy = Branches((-np.inf, 1.5), (1.3, 1.8), (1.1, np.inf))
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    steady = search.steady

    def wandering(chains: Sequence[Chain]) -> list[list[Orbit]]:
        """The first motion from 1.02 on, and the second one below 1.43, do not repeat."""
        return [[wanders(orbit, f) for f, orbit in zip(chain.frequencies, own, strict=True)]
                for chain, own in zip(chains, steady(chains), strict=True)]  # fmt: skip

    def wanders(orbit: Orbit, frequency: float) -> Orbit:
        number = orbit.end.displacement[0]
        irregular = (number == 0 and frequency > 1.02) or (number == 1 and frequency < 1.43)
        return replace(orbit, irregular=irregular, period=int(not irregular))

    up, down = ([wanders(*one) for one in zip(own, sweeps.frequency, strict=True)] for own in sweeps.orbits)
    search, sweeps = replace(search, steady=wandering), replace(sweeps, orbits=(up, down))
    found = list(ranges(search, sweeps, list(losses(search, sweeps))))[-1]
    assert (found.low, found.high) == pytest.approx((1.43, 1.8), abs=1e-6)
    assert found.irregular == (SMALLER, NO_MOTION)


def test_adjacent_jumps_are_one():
    """From the motion before the first of them to the one beyond the last."""
    toy = Branches((-np.inf, 1.49), (1.3, 1.51), (1.4, np.inf))
    search, on = toy_search(toy), toy.orbit(0, 1.25)
    (beyond,) = toy.along(on.end, [1.75])
    step = Stretch(search.model, 1.25, 1.75, on, beyond, least=0.05)
    ((index, jump),) = narrowed([step], search.steady, 1 / 64)
    assert (index, jump.near, jump.far) == (0, 1.484375, 1.515625)
    np.testing.assert_array_equal(jump.on.amplitude, toy.orbit(0, jump.near).amplitude)
    np.testing.assert_array_equal(jump.beyond.amplitude, toy.orbit(2, jump.far).amplitude)


@pytest.mark.parametrize(("low", "high"), [(-np.inf, 1.3), (1.1, 1.3), (-np.inf, 1.7)])
def test_a_motion_is_lost_once_in_a_step(low: float, high: float):
    """At the end of a long step up the sweep is on motion 2; shorter steps lead from motion 0 to 1, or stay on 0.

    Where motion 0 lives to the end of the step, only its length has lost it, and the jump is the whole step. Where it
    is lost on the way, the jump is there: the sweep was never on motion 1, and does not lose it.
    """
    toy = Branches((low, high), (1.2, np.inf), (1.4, np.inf))
    search = toy_search(toy)
    step = Stretch(search.model, 1.25, 1.5, toy.orbit(0, 1.25), toy.orbit(2, 1.5), least=0.05)
    ((index, *ends),) = jumps_of([step], search.steady, 1e-6)
    assert index == 0
    assert ends == ([1.25, 1.5] if high > 1.5 else pytest.approx([high, high], abs=1e-6))


Carried = Callable[[float, float, Sequence[float]], Iterator[Orbit]]


def stepping(toy: Branches, lands: Callable[[float, float, float], float]) -> tuple[SteadyStates, Carried]:
    """Motions that depend on the steps: ``lands`` is the number of that to which one at a frequency is carried.

    From (number, last frequency, next frequency); below zero the steady state is not found. Also the orbits along
    frequencies from such a motion on.
    """

    def steady(chains: Sequence[Chain]) -> list[list[Orbit]]:
        return [list(carried(*chain.model.start.displacement, chain.frequencies)) for chain in chains]

    def carried(branch: float, last: float, frequencies: Sequence[float]) -> Iterator[Orbit]:
        for frequency in frequencies:
            number = lands(branch, last, frequency)
            orbit = toy.orbit(max(number, 0), frequency)
            branch, last = orbit.end.displacement[0], frequency
            end = replace(orbit.end, displacement=np.array([branch, frequency]))
            yield replace(orbit, end=end, reason="no steady state" if number < 0 else None)

    return steady, carried


@pytest.mark.parametrize(("num", "start", "far", "third"), [(4, 0, 3, 2), (3, 1, 2, 0)])
def test_a_motion_that_is_carried_to_a_third_one_is_lost(num: int, start: int, far: int, third: int):
    """Beyond 1.7 long steps lead from a motion to the far one, those up to 0.1 to a third.

    That is as far from it as most of the way, or away from both.
    """
    toy = Branches(*[(-np.inf, np.inf)] * num, slope=0.0)

    def lands(branch: float, last: float, frequency: float) -> float:
        lost = branch == start and frequency > 1.7
        return (third if frequency - last <= 0.1 else far) if lost else branch

    steady, carried = stepping(toy, lands)
    (on,), (beyond,) = carried(start, 1.0, [1.0]), carried(far, 2.0, [2.0])
    step = Stretch(oscillator(2.0, 1.0), 1.0, 2.0, on, beyond, least=0.05)
    assert list(jumps_of([step], steady, 1 / 16)) == [(0, 1.6875, 1.75)]


@pytest.mark.parametrize("carries", [0.3, 0.6])
def test_a_step_whose_middle_has_no_steady_state_is_halved_no_further(carries: float):
    """Between 1.6 and 1.9 none is found: the jump is in the half from 1.5 on, if a step of its length jumps or not."""
    toy = Branches(*[(-np.inf, np.inf)] * 2, slope=0.0)

    def lands(branch: float, last: float, frequency: float) -> float:
        if 1.6 < frequency < 1.9:
            return -1
        return 1 if frequency - last > carries and frequency > 1.6 else branch

    steady, carried = stepping(toy, lands)
    (on,), (beyond,) = carried(0, 1.0, [1.0]), carried(1, 2.0, [2.0])
    step = Stretch(oscillator(2.0, 1.0), 1.0, 2.0, on, beyond, least=0.05)
    assert list(jumps_of([step], steady, 1e-3)) == [(0, 1.5, 2.0)]


@pytest.mark.parametrize("high", [1.38, 1.44, 1.56, 1.7, 1.9])
@pytest.mark.parametrize("longest", [0.01, 0.07, 0.1, 0.13])
def test_a_motion_lost_by_halving_is_followed(longest: float, high: float):
    """Motion 0 is lost by steps longer than `longest`, also by those that halve a step, and truly at `high`."""
    toy = two_branches(-np.inf, high, slope=0.0)
    steady, carried = stepping(toy, lambda branch, last, frequency: 1 if abs(frequency - last) > longest else branch)
    (on,), (beyond,) = carried(0, 1.25, [1.25]), carried(1, 1.75, [1.75])
    step = Stretch(oscillator(2.0, 1.0), 1.25, 1.75, on, beyond, least=0.05)
    ((_, low, far),) = jumps_of([step], steady, 1e-3)
    assert low <= high <= far or (low, far) == (1.25, 1.75)
    assert far - low <= (0.5 if high > 1.75 else 1e-3)


def test_a_motion_that_a_sweep_has_lost_is_led_on_by_a_quarter_of_its_steps():
    """Longer ones would lose it time and again, far from where it ends."""
    toy, frequency = two_branches(1.23, 1.82), np.linspace(1.0, 2.0, 21)
    longest = 1.01 * (frequency[1] - frequency[0]) / WALK
    steady, _ = stepping(toy, lambda branch, last, f: 1 if abs(f - last) > longest and f > 1.23 else branch)

    def orbits(*branches: bool) -> list[Orbit]:
        own = [(toy.orbit(branch, f), f) for branch, f in zip(branches, frequency, strict=True)]
        ends = (replace(orbit.end, displacement=np.array([orbit.end.displacement[0], f])) for orbit, f in own)
        return [replace(orbit, end=end) for (orbit, _), end in zip(own, ends, strict=True)]

    search = replace(toy_search(toy), steady=steady)
    sweeps = Sweeps(frequency, (orbits(*(frequency > 1.36)), orbits(*(frequency > 1.22))))
    (lost,) = [loss for loss in losses(search, sweeps) if loss.direction == UP]
    assert (lost.jump.near, lost.jump.far) == pytest.approx((1.82, 1.82), abs=2e-6)


def test_steps_that_follow_a_motion_are_half_as_long_as_any_that_has_lost_it():
    """They do not grow until they lose it again, so that it is lost by halving, and by steps that grow, once each."""
    toy = two_branches(-np.inf, 1.9, slope=0.0)
    steady, carried = stepping(toy, lambda branch, last, frequency: 1 if abs(frequency - last) > 0.01 else branch)
    (on,), (beyond,) = carried(0, 1.25, [1.25]), carried(1, 1.75, [1.75])
    counted = Counted(steady)
    list(jumps_of([Stretch(oscillator(2.0, 1.0), 1.25, 1.75, on, beyond, least=0.05)], counted, 1e-3))
    assert counted.num_points < 90


def test_a_slope_and_a_jump_in_one_step():
    """Each half is looked at: the jump is narrowed down beside a slope that changes the amplitude more than it does."""
    toy = two_branches(1.43, 1.62, rise=0.3, slope=8.0)
    search = toy_search(toy)
    for near, far, lost in ((1.5, 1.9, 1.62), (1.9, 1.3, 1.43)):
        on = toy.orbit(0.0 if near < far else 1.0, near)
        (beyond,) = toy.along(on.end, [far])
        for width in (1.0, 1e-2, 1e-6):
            step = Stretch(search.model, near, far, on, beyond, least=0.05)
            ((_, jump),) = narrowed([step], search.steady, width)
            low, high = sorted((jump.near, jump.far))
            assert low <= lost <= high
            assert high - low <= width
        slope = Stretch(search.model, 1.1, 1.4, toy.orbit(0.0, 1.1), toy.orbit(0.0, 1.4), least=0.05)
        assert narrowed([slope], search.steady, 1.0) == []


@pytest.mark.parametrize("ends", [(1.53, 1.78), (1.502, 1.998), (1.51, 1.6)])
def test_two_jumps_of_the_same_size_in_one_step(ends: tuple[float, float]):
    """Together they change the amplitude as evenly as a slope does."""
    first, last = ends
    toy = Branches((-np.inf, first), (first, last), (last, np.inf), rise=0.1, slope=0.0)
    search, on = toy_search(toy), toy.orbit(0, 1.5)
    (beyond,) = toy.along(on.end, [2.0])
    jumps = narrowed([Stretch(search.model, 1.5, 2.0, on, beyond, least=0.03 * 1.2)], search.steady, 1e-6)
    np.testing.assert_allclose([jump.near for _, jump in jumps], ends, atol=1e-6)


@pytest.mark.parametrize("peak", [1.5, 1.6, 1.65, 1.7, 1.8, 1.9])
@pytest.mark.parametrize("width", [0.3, 0.05, 0.02, 1e-3])
def test_a_peak_between_the_points_of_a_sweep_is_no_jump(peak: float, width: float):
    """The amplitudes at both ends are alike; over a part of the step they change by more than from end to end."""
    toy = two_branches(-np.inf, np.inf, slope=0.0)

    def orbit(frequency: float) -> Orbit:
        one = toy.orbit(0.0, frequency)
        return replace(one, amplitude=one.amplitude / (1 + ((frequency - peak) / 0.15) ** 2))

    def steady(chains: Sequence[Chain]) -> list[list[Orbit]]:
        return [[orbit(frequency) for frequency in chain.frequencies] for chain in chains]

    step = Stretch(oscillator(2.0, 1.0), 1.5, 1.9, orbit(1.5), orbit(1.9), least=0.03)
    assert narrowed([step], steady, width) == []


def test_a_slope_over_several_steps_takes_one_motion_each():
    """Steps of like change are as even as two halves are; a change that stands alone is halved until it is told."""
    toy = two_branches(-np.inf, np.inf, slope=1.0)
    search, frequencies = toy_search(toy), np.linspace(2.0, 2.5, 6)
    steps = steps_of(search.model, frequencies, toy.along(toy.orbit(0, 2.0).end, frequencies))
    assert [step.even for step in steps] == [True] * 5
    counted = Counted(search.steady)
    assert narrowed(steps, counted, 1e-6) == []
    assert counted.num_points == 5
    lost = two_branches(-np.inf, 2.25, slope=0.0)
    (step,) = steps_of(search.model, frequencies, lost.along(lost.orbit(0, 2.0).end, frequencies))
    assert not step.even
    ((_, jump),) = narrowed([step], toy_search(lost).steady, 1e-6)
    assert (jump.near, jump.far) == pytest.approx((2.25, 2.25), abs=1e-6)


def test_of_a_slope_over_several_steps_of_two_sweeps_only_the_steepest_step_takes_more_than_one_motion():
    toy = two_branches(-np.inf, np.inf, slope=1.0)
    frequencies = np.linspace(2.0, 2.5, 6)
    counted = Counted(toy_search(toy).steady)
    search, sweeps = replace(toy_search(toy), steady=counted), toy_sweeps(toy, frequencies)
    assert suspect_steps(sweeps, UP).tolist() == suspect_steps(sweeps, DOWN).tolist() == list(range(5))
    assert list(losses(search, sweeps)) == []
    assert counted.num_points == 2 * (4 + 3)


@pytest.mark.parametrize("num", [5, 101])
def test_three_motions(num: int):
    """Between jumps each sweep stays on one motion: there is a range for each pair, also of jumps in one step."""
    toy = Branches((-np.inf, 1.503), (1.217, 1.524), (1.441, np.inf))
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, num))
    found = list(ranges(search, sweeps, list(losses(search, sweeps))))
    ends = [(1.217, 1.441), (1.441, 1.503), (1.503, 1.524)]
    np.testing.assert_allclose([(one.low, one.high) for one in found], ends, atol=1e-6)
    pairs = [(one.lower.end.displacement[0], one.upper.end.displacement[0]) for one in found]
    assert pairs == [(0, 1), (0, 2), (1, 2)]


def test_a_range_that_the_search_cuts():
    toy = two_branches(0.9, 1.52)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert found.cut == (True, False)
    assert found.low == 1.0
    assert np.isnan(found.jumped[0]).all()
    assert np.isfinite(found.jumped[1]).all()


@pytest.mark.parametrize(
    ("low", "high", "cut", "ends"),
    [(0.5, 1.03, (True, False), (1.0, 1.03)), (1.97, 2.5, (False, True), (1.97, 2.0))],
)
def test_a_range_that_only_an_end_of_the_search_shows(low: float, high: float, cut, ends):
    """The sweeps differ at the first or last frequency alone: the other end lies in the step beside it."""
    toy = two_branches(low, high)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    assert sweeps.apart.sum() == 1
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert found.cut == cut
    assert (found.low, found.high) == pytest.approx(ends, abs=1e-6)


@pytest.mark.parametrize(
    ("irregular", "ends", "losers"),
    [
        ((1.463, 1.8), [(1.23, 1.463)], [(0, 2)]),
        ((1.1, 1.463), [(1.463, 1.52)], [(2, 0)]),
        ((1.3, 1.4), [(1.23, 1.3), (1.4, 1.52)], [(0, 2), (2, 0)]),
        ((1.0, 1.9), [], []),
    ],
)
def test_a_motion_that_does_not_repeat_is_not_one_of_two(irregular, ends, losers):
    """The downward sweep carries the larger motion to where it loses its period, or finds it: there the range ends."""
    toy = two_branches(1.23, 1.52)
    toy.irregular = irregular
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    found = list(ranges(search, sweeps, list(losses(search, sweeps))))
    np.testing.assert_allclose([(one.low, one.high) for one in found], ends, atol=2e-6)
    assert [one.irregular for one in found] == losers
    assert all(one.settled == (True, True) for one in found)


def test_points_that_failed_do_not_hide_the_jumps():
    toy = two_branches(1.23, 1.52)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    sweeps.orbits[UP][2] = without_orbit(oscillator(2.0, 1.0), "it broke")
    sweeps.orbits[DOWN][7] = without_orbit(oscillator(2.0, 1.0), "it broke")
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert (found.low, found.high) == pytest.approx((1.23, 1.52), abs=1e-6)


def test_a_slope_is_no_jump():
    toy = two_branches(9.0, 9.0)
    toy.orbit = lambda branch, f: replace(
        Branches.orbit(toy, 0, f), amplitude=np.full((1, 3), np.arctan(40 * (f - 1.5)) + 2)
    )
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 11))
    assert suspect_steps(sweeps, UP).size > 0
    assert list(losses(search, sweeps)) == []


def test_motions_that_have_not_settled_differ_only_beyond_their_bands():
    toy = two_branches(1.0, 2.0)
    one, other = toy.orbit(0, 1.5), toy.orbit(1, 1.5)
    assert differ(one, other)
    assert not differ(one, one)
    wide = replace(other, period=0, band=np.stack([other.amplitude - 1.1, other.amplitude]))
    assert not differ(one, wide)
    assert not differ(one, replace(other, reason="failed"))


def test_motions_of_one_amplitude_differ_by_their_harmonics():
    """Not by the mean, which depends on offsets that are free, nor by what a motion without a period lacks."""
    one = two_branches(1.0, 2.0).orbit(0, 1.5)
    phasor = np.zeros((HARMONICS + 1, 1, 3), dtype=complex)
    phasor[1] = 1.0
    one = replace(one, phasor=phasor)

    def with_(harmonic: int, value: complex) -> Orbit:
        other = phasor.copy()
        other[harmonic] = value
        return replace(one, phasor=other)

    assert not differ(one, with_(1, np.exp(1e-4j)))
    assert differ(one, with_(1, np.exp(1e-2j)))
    assert differ(with_(2, 0.01), with_(2, -0.01)), "mirror images of one another"
    assert not differ(one, with_(0, 0.3))
    assert not differ(one, replace(with_(1, np.nan), period=0))


def test_ranges_of_motions_that_differ_by_their_phase_only():
    toy = two_branches(1.43, 1.62, rise=0.0)
    size = toy.orbit

    def orbit(branch: float, frequency: float) -> Orbit:
        there = size(branch, frequency)
        phasor = np.zeros((HARMONICS + 1, 1, 3), dtype=complex)
        phasor[1] = there.amplitude * np.exp(1j * there.end.displacement[0])
        return replace(there, phasor=phasor)

    toy.orbit = orbit
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert (found.low, found.high) == pytest.approx((1.43, 1.62), abs=1e-6)


def test_several_jumps_of_one_size_are_no_slope():
    """Twice halved they still change the amplitude evenly, but by far more than a jump has to."""
    ends = (1.06, 1.19, 1.31, 1.44)
    toy = Branches(*zip((-np.inf, *ends), (*ends, np.inf), strict=True), rise=0.3, slope=0.0)
    search, on = toy_search(toy), toy.orbit(0, 1.0)
    (beyond,) = toy.along(on.end, [1.5])
    jumps = narrowed([Stretch(search.model, 1.0, 1.5, on, beyond, least=0.05)], search.steady, 1e-6)
    np.testing.assert_allclose([jump.near for _, jump in jumps], ends, atol=1e-6)


def test_jumps_come_in_the_order_in_which_a_sweep_down_meets_them():
    """And adjacent ones are one, as of a sweep up."""
    toy = Branches((-np.inf, 1.3), (1.2, 1.45), (1.4, np.inf))
    search, on = toy_search(toy), toy.orbit(2, 1.5)
    (beyond,) = toy.along(on.end, [1.0])
    step = Stretch(search.model, 1.5, 1.0, on, beyond, least=0.05)
    jumps = [jump for _, jump in narrowed([step], search.steady, 1e-6)]
    np.testing.assert_allclose([jump.near for jump in jumps], [1.4, 1.2], atol=1e-6)
    step = Stretch(search.model, 1.41, 1.19, toy.orbit(2, 1.41), beyond, least=0.05)
    toy.spans = ((-np.inf, 1.3), (1.295, 1.45), (1.305, np.inf))
    ((_, jump),) = narrowed([step], search.steady, 0.22 / 8)
    np.testing.assert_array_equal(jump.on.amplitude, toy.orbit(2, jump.near).amplitude)
    np.testing.assert_array_equal(jump.beyond.amplitude, toy.orbit(0, jump.far).amplitude)


def test_jumps_behind_one_that_was_lost_by_the_length_of_a_step_are_found():
    """Steps above 0.2 lead from motion 0 to 5, shorter ones to 3, 4, and 5; also where steps beside are alike."""
    toy, ends = Branches(*[(-np.inf, np.inf)] * 6, rise=0.1, slope=0.0), (1.3, 1.5, 1.8)

    def lands(branch: float, last: float, frequency: float) -> float:
        passed = sum(frequency > end for end in ends)
        return 5 if branch == 0 and frequency - last > 0.2 else max(branch, passed and 2 + passed)

    steady, carried = stepping(toy, lands)
    (on,), (beyond,) = carried(0, 1.0, [1.0]), carried(5, 2.0, [2.0])
    step = Stretch(oscillator(2.0, 1.0), 1.0, 2.0, on, beyond, least=0.05, even=True)
    found = [low for _, low, _ in jumps_of([step], steady, 1e-4)]
    np.testing.assert_allclose(found, ends, atol=1e-4)


def test_jumps_of_a_motion_that_the_sweep_was_never_on_are_none():
    """Steps above 0.2 lose motion 0, which lives on; motion 1, to which they lead, is lost at 1.8."""
    toy = Branches(*[(-np.inf, np.inf)] * 3, slope=0.0)

    def lands(branch: float, last: float, frequency: float) -> float:
        if branch == 0:
            return float(frequency - last > 0.2)
        return 2 if frequency > 1.8 else branch

    steady, carried = stepping(toy, lands)
    (on,), (beyond,) = carried(0, 1.0, [1.0]), carried(2, 2.0, [2.0])
    step = Stretch(oscillator(2.0, 1.0), 1.0, 2.0, on, beyond, least=0.05)
    assert list(jumps_of([step], steady, 1e-3)) == [(0, 1.0, 2.0)]


def test_steps_of_a_sweep_are_judged_alike_both_ways_and_beside_points_that_failed():
    toy, frequencies = two_branches(-np.inf, np.inf, slope=1.0), np.linspace(2.0, 2.5, 6)
    orbits = toy.along(toy.orbit(0, 2.0).end, frequencies)
    model = oscillator(2.0, 1.0)
    there, back = steps_of(model, frequencies, orbits), steps_of(model, frequencies[::-1], orbits[::-1])
    assert [step.least for step in there] == [step.least for step in back][::-1]
    orbits[-1] = without_orbit(model, "it broke")
    assert [step.even for step in steps_of(model, frequencies, orbits)] == [True] * 4
    assert [step.even for step in steps_of(model, frequencies[::-1], orbits[::-1])] == [True] * 4


def test_the_first_of_two_jumps_behind_a_long_step_is_that_of_its_motion():
    """Both lie within a quarter of a step of the sweep, in which the motion is followed."""
    toy = Branches((-np.inf, 1.52), (1.5, 1.5225), (1.23, np.inf))
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    early = [toy.orbit(2.0 * (f > 1.36), f) for f in sweeps.frequency]
    sweeps = replace(sweeps, orbits=(early, sweeps.orbits[DOWN]))
    (lost,) = [loss for loss in losses(search, sweeps) if loss.direction == UP]
    assert (lost.jump.near, lost.jump.far) == pytest.approx((1.52, 1.52), abs=2e-6)


@pytest.mark.parametrize("slope", [1.5, 3.0, 6.0, 12.0])
def test_a_motion_that_a_sweep_has_lost_is_followed_up_a_slope(slope: float):
    """There it is nearer to the one beyond the jump than to what it was at the jump, or past it, yet always itself."""
    toy = two_branches(1.23, 1.82, slope=slope)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    early = [toy.orbit(float(f > 1.36), f) for f in sweeps.frequency]
    sweeps = replace(sweeps, orbits=(early, sweeps.orbits[DOWN]))
    (lost,) = [loss for loss in losses(search, sweeps) if loss.direction == UP]
    assert (lost.jump.near, lost.jump.far) == pytest.approx((1.82, 1.82), abs=2e-6)


def test_a_motion_that_comes_down_to_the_other_one_does_not_live_on():
    """From 1.7 on both are one: the sweep, which has lost it by the length of a step, counts with its jump."""
    toy = two_branches(1.23, np.inf, slope=0.0)
    apart = toy.orbit

    def orbit(branch: float, frequency: float) -> Orbit:
        own = apart(branch, frequency)
        if own.end.displacement[0] == 1:
            return own
        return replace(own, amplitude=np.full((1, 3), np.clip(1 + 5 * (frequency - 1.5), 1, 2)))

    toy.orbit = orbit
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    early = [toy.orbit(float(f > 1.36), f) for f in sweeps.frequency]
    sweeps = replace(sweeps, orbits=(early, [toy.orbit(float(f > 1.22), f) for f in sweeps.frequency]))
    (lost,) = [loss for loss in losses(search, sweeps) if loss.direction == UP]
    assert not lost.lives
    assert 1.35 <= lost.jump.near < lost.jump.far <= 1.4


@pytest.mark.parametrize("shape", [{}, {"rise": 0.05, "slope": 8.0}])
def test_the_motions_at_both_sides_of_a_jump_are_those_at_its_ends(shape: dict[str, float]):
    """Also of one that is small beside the slope of the step."""
    toy = two_branches(1.43, 1.62, **shape)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    lost = list(losses(search, sweeps))
    assert len(lost) == 2
    for loss in lost:
        before, after = (0, 1) if loss.direction == UP else (1, 0)
        for orbit, frequency, number in (
            (loss.jump.on, loss.jump.near, before),
            (loss.jump.beyond, loss.jump.far, after),
        ):
            np.testing.assert_array_equal(orbit.amplitude, toy.orbit(number, frequency).amplitude)


def test_a_motion_loses_its_period_no_later_than_where_it_cannot_be_computed():
    """Whether it repeats in between is not known: the range ends at the last place where it does."""
    toy = two_branches(1.23, 1.52)
    toy.irregular = (1.463, 1.8)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    known = search.steady

    def steady(chains: Sequence[Chain]) -> list[list[Orbit]]:
        found = zip(chains, known(chains), strict=True)
        return [[fails(orbit, f) for orbit, f in zip(own, chain.frequencies, strict=True)] for chain, own in found]

    def fails(orbit: Orbit, frequency: float) -> Orbit:
        on_it = orbit.end.displacement[0] == 1
        return replace(orbit, reason="it broke") if on_it and 1.458 < frequency < 1.463 else orbit

    search = replace(search, steady=steady)
    (found,) = ranges(search, sweeps, list(losses(search, sweeps)))
    assert (found.low, found.high) == pytest.approx((1.23, 1.458), abs=2e-6)


@pytest.mark.parametrize(("high", "num"), [(1.445, 0), (1.46, 1)])
def test_a_range_has_to_be_wider_than_both_of_its_ends_are_known_to(high: float, num: int):
    toy = two_branches(1.43, high)
    search, sweeps = replace(toy_search(toy), width=0.01), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    lost = list(losses(search, sweeps))
    assert [loss.direction for loss in lost].count(UP) == [loss.direction for loss in lost].count(DOWN) == 1
    assert abs(lost[0].jump.near - lost[1].jump.near) > search.width
    assert len(list(ranges(search, sweeps, lost))) == num


def test_between_two_ranges_there_is_one_motion():
    toy = Branches((-np.inf, 1.2), (1.1, 1.6), (1.5, np.inf))
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    found = [(one.low, one.high) for one in ranges(search, sweeps, list(losses(search, sweeps)))]
    np.testing.assert_allclose(found, [(1.1, 1.2), (1.5, 1.6)], atol=1e-6)


def test_where_a_motion_loses_its_period_there_is_no_jump():
    toy = two_branches(1.23, 1.52)
    toy.irregular = (1.463, 1.8)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    columns = columns_of([sweeps.orbits[UP], sweeps.orbits[DOWN][::-1]])
    found = ranges_of(search, columns | {"frequency": np.array([sweeps.frequency, sweeps.frequency[::-1]])})
    np.testing.assert_allclose(found["jumps"], [[UP, 1.52, 1.52], [DOWN, 1.23, 1.23]], atol=2e-6)
    np.testing.assert_allclose(found["range"], [[1.23, 1.463]], atol=2e-6)


def test_the_loss_of_period_of_a_motion_that_is_followed_back_is_bisected_from_beside_it():
    """Steps down of more than 0.02 lose motion 1, which has no period below 1.43; motion 0 has none from 1.02 on."""
    toy, frequencies = Branches((-np.inf, 1.5), (1.3, 1.8), (1.1, np.inf)), np.linspace(1.0, 2.0, 21)
    known, _ = stepping(toy, lambda branch, last, f: 2 if branch == 1 and last - f > 0.02 else branch)

    def at(orbit: Orbit, frequency: float) -> Orbit:
        number = orbit.end.displacement[0]
        irregular = (number == 0 and frequency > 1.02) or (number == 1 and frequency < 1.43)
        end = replace(orbit.end, displacement=np.array([number, frequency]))
        return replace(orbit, end=end, irregular=irregular, period=int(not irregular))

    def steady(chains: Sequence[Chain]) -> list[list[Orbit]]:
        found = zip(chains, known(chains), strict=True)
        return [[at(*one) for one in zip(own, chain.frequencies, strict=True)] for chain, own in found]

    up, down = ([at(*one) for one in zip(own, frequencies, strict=True)] for own in toy_sweeps(toy, frequencies).orbits)
    search, sweeps = replace(toy_search(toy), steady=steady), Sweeps(frequencies, (up, down))
    found = list(ranges(search, sweeps, list(losses(search, sweeps))))[-1]
    assert (found.low, found.high) == pytest.approx((1.43, 1.8), abs=1e-6)


# Starts


def forces_of(model: Model, start: Start) -> tuple[float, float]:
    """|f| and mu n of the only contact."""
    u = model.contact_shape[0] @ start.displacement
    contact = model.contacts[0]
    force = contact.tangential_stiffness @ (u[:2] - start.slip[0])
    return float(np.linalg.norm(force)), contact.friction * max(contact.preload + contact.normal_stiffness * u[2], 0.0)


def test_starts_stay_in_the_cone():
    model, random = oscillator(2.0, 1.25), np.random.default_rng(3)
    states = set()
    for _ in range(60):
        displacement, slip = random.normal(scale=0.15, size=2), random.normal(scale=0.1, size=(1, 2))
        start = placed(model, displacement, np.zeros(2), slip, random.uniform(-0.9, 0.9, (1, 2)))
        force, limit = forces_of(model, start)
        states.add(int(start.state[0]))
        assert force <= limit
        if start.state[0] == SEPARATION:
            np.testing.assert_allclose(start.slip[0], model.contact_shape[0, :2] @ displacement)
    assert states == {STICK, SEPARATION}
    turned = replace(model, start=replace(model.start, phase=0.7))
    assert placed(turned, np.zeros(2), np.zeros(2), np.zeros((1, 2))).phase == 0.7
    kept = placed(model, np.array([0.01, 0.0]), np.zeros(2), np.array([[0.02, 0.01]]))
    np.testing.assert_array_equal(kept.slip, [[0.02, 0.01]])
    none, pull = np.zeros(2), np.array([[0.5, -0.2]])
    pulled = contact_loads(model, none, placed(model, none, none, np.zeros((1, 2)), pull).slip)
    np.testing.assert_allclose(pulled.force, pull * pulled.limit)


def test_the_motions_and_rest_are_among_the_starts():
    model = oscillator(2.0, 1.25)
    base = two_branches(1.0, 2.0).orbit(0, 1.5)
    ends = [
        Start(np.array(d), np.array([0.1, 0.2]), np.zeros((1, 2)), np.zeros(1)) for d in ([0.01, 0.02], [-0.02, 0.01])
    ]
    starts = starts_between(model, [replace(base, end=end) for end in ends], 5)
    assert len(starts) == 25
    for place, displacement in ((1 * 5 + 1, [0, 0]), (3 * 5 + 1, [0.01, 0.02]), (1 * 5 + 3, [-0.02, 0.01])):
        np.testing.assert_allclose(starts[place].displacement, displacement, atol=1e-15)
        np.testing.assert_array_equal(starts[place].slip, 0)
    # The contact sticks in both motions: elsewhere it is pulled aside.
    assert len({tuple(start.slip[0].round(9)) for start in starts}) > 8


def test_offsets_of_a_contact_that_sticks():
    base = two_branches(1.0, 2.0).orbit(0, 1.5)
    orbits = [replace(base, end=replace(base.end, slip=np.array([[w, -w]]))) for w in (0.1, 0.3, -0.2)]
    low, high = offsets(orbits)
    np.testing.assert_allclose((low, high), [[[-0.2, -0.3]], [[0.3, 0.2]]])
    assert not unique(low, high, 1.0).any()
    for works in ({"slip_share": np.array([0.1])}, {"separation_share": np.array([1.0])}):
        low, high = offsets([replace(orbit, **works) for orbit in orbits])
        assert np.isnan([low, high]).all()
        assert unique(low, high, 1.0).all()


def test_offsets_are_those_of_the_motions_in_which_the_contact_sticks():
    base = two_branches(1.0, 2.0).orbit(0, 1.5)
    orbits = [replace(base, end=replace(base.end, slip=np.array([[w, -w]]))) for w in (0.1, 0.3, -0.2)]
    orbits[1] = replace(orbits[1], slip_share=np.array([0.01]))
    np.testing.assert_allclose(offsets(orbits), [[[-0.2, -0.1]], [[0.1, 0.2]]])


@pytest.mark.parametrize("works", ["slip_share", "separation_share"])
def test_a_contact_that_works_in_a_motion_is_not_pulled_aside(works: str):
    """Its slip is that of the motions, as far as its cone allows."""
    model = oscillator(64.0, 1.25)
    base = two_branches(1.0, 2.0).orbit(0, 1.5)
    ends = [replace(base.end, displacement=np.zeros(2), slip=np.array([[w, -w]])) for w in (0.01, 0.02)]
    motions = [replace(base, end=end, **{works: np.array([0.2])}) for end in ends]
    slips = [start.slip for start in starts_between(model, motions, 5)]
    sides = (-0.5, 0.0, 0.5, 1.0, 1.5)
    np.testing.assert_allclose(slips, [a * ends[0].slip + b * ends[1].slip for a in sides for b in sides], atol=1e-15)


def test_where_a_start_has_led():
    toy = two_branches(1.0, 2.0)
    motions = [toy.orbit(0, 1.5), toy.orbit(1, 1.5)]
    assert [branch_of(orbit, motions) for orbit in motions] == [0, 1]
    assert branch_of(replace(motions[0], period=0), motions) == NONE
    assert branch_of(replace(motions[0], period=0, irregular=True), motions) == IRREGULAR
    assert branch_of(replace(motions[0], amplitude=3 * motions[0].amplitude), motions) == ANOTHER


def test_starts_are_led_on_at_the_middle_of_a_range_and_show_the_offsets_of_each_motion():
    """Of all starts that lead to it, and of the motion itself, whose contact sticks at 0 here."""
    toy = two_branches(1.43, 1.62)
    search, sweeps = toy_search(toy), toy_sweeps(toy, np.linspace(1.0, 2.0, 21))
    columns = columns_of([sweeps.orbits[UP], sweeps.orbits[DOWN][::-1]])
    found = ranges_of(search, columns | {"frequency": np.array([sweeps.frequency, sweeps.frequency[::-1]])})
    visited: list[tuple[float, ...]] = []

    def steady(chains: Sequence[Chain]) -> list[list[Orbit]]:
        """To the smaller motion with the first offsets, to the larger one with others."""
        visited.extend(chain.frequencies for chain in chains)
        led = [(toy.orbit(k >= 12, 1.525), 0.01 * (k + 1) * np.array([[1.0, -1.0]])) for k in range(len(chains))]
        return [[replace(orbit, end=replace(orbit.end, slip=slip))] for orbit, slip in led]

    data = explore(search.model, steady, found, 5)
    assert {len(own) for own in visited} == {1}
    np.testing.assert_allclose(np.ravel(visited), found["range"].mean(), rtol=1e-12)
    assert data["start_branch"].ravel().tolist() == [0] * 12 + [1] * 13
    np.testing.assert_allclose(data["offset_low"][0], [[[0.0, -0.12]], [[0.0, -0.25]]])
    np.testing.assert_allclose(data["offset_high"][0], [[[0.12, 0.0]], [[0.25, 0.0]]])


def test_both_sweeps_are_carried_on_from_part_to_part(monkeypatch: pytest.MonkeyPatch):
    """The one up, the other down, as if each was one; then their jumps are sought, and the starts are only marched."""
    toy, frequency = two_branches(1.43, 1.62), np.linspace(1.0, 2.0, 2 * bistable.STEPS_A_CHUNK + 5)
    shot: list[float] = []

    def steady_of(chains: Sequence[Chain], solver: Solver, criterion: Criterion) -> list[list[Orbit]]:
        shot.append(criterion.first_shot)
        return [toy.along(chain.model.start, chain.frequencies) for chain in chains]

    monkeypatch.setattr(bistable, "steady_of", steady_of)
    model = replace(oscillator(2.0, 1.0), start=toy.orbit(0, 1.0).end)
    grid: Any = SimpleNamespace(frequency=frequency, models={0: model})
    criterion = Criterion(1e-6, 500, SHOOT)
    plan: Any = SimpleNamespace(sweep=SimpleNamespace(criterion=criterion), width=1e-6, starts=5)
    results: dict[str, Any] = {}
    *parts, ends, starts = bistable.chunks(grid, plan, PRESETS["draft"])
    assert [part.name for part in parts] == [f"00000-sweep-{i:05d}" for i in range(3)]
    assert sum(part.size for part in parts) == 2 * frequency.size

    def work(chunk: Chunk) -> Any:
        shot.clear()
        results[chunk.name] = bistable.work(chunk.payload, results.get(chunk.after) if chunk.after else None)
        return results[chunk.name]

    *_, both = (work(part) for part in parts)
    np.testing.assert_array_equal(both["frequency"], [frequency, frequency[::-1]])
    up, down = toy_sweeps(toy, frequency).orbits
    for own, orbits in zip(both["amplitude"], (up, down[::-1]), strict=True):
        np.testing.assert_array_equal(own, [orbit.amplitude for orbit in orbits])
    found = work(ends)["range"]
    assert set(shot) == {SHOOT}
    np.testing.assert_allclose(found, [[1.43, 1.62]], atol=1e-6)
    data = work(starts)
    assert set(shot) == {NEVER}
    assert starts.size == data["start_branch"].size == 25
    np.testing.assert_array_equal(data["range"], found)


# Longer


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ends"), [("bistable", (0.9416, 0.9472)), ("softening", (1.2511, 1.2560))])
@pytest.mark.parametrize("periodic", ["march", "shoot"])
def test_the_ends_on_the_papers_oscillator(name: str, ends: tuple[float, float], periodic: str):
    given = {"study.frequency": {"from": 0.8, "to": 1.65}, "study.starts": 0, "study.periodic": periodic}
    data = timesim.run(CONFIGS / f"{name}.yaml", given)
    (found,) = data["range"].values
    assert found == pytest.approx(ends, abs=1e-4)
    hbm = data["hbm"].to_dataset()
    turning = hbm.frequency.values[(hbm.fold.values > 0) & (hbm.slip_share.values[:, 0] > 0)]
    assert sorted(turning) == pytest.approx(found.tolist(), abs=2e-5)


@pytest.mark.slow
def test_ranges_over_a_scalar():
    given = {
        "study.frequency": {"from": 1.2, "to": 1.35},
        "study.over": {"contacts.pad.preload": [1.5, 2.0, 2.5]},
        "study.starts": 0,
        "study.width": 1e-4,
    }
    data = timesim.run(CONFIGS / "softening.yaml", given)
    ends = data["range"].sel({"contacts.pad.preload": [1.5, 2.0, 2.5]}).values[:, 0]
    assert np.isnan(ends[0]).all()
    np.testing.assert_allclose(ends[1:], [[1.25106, 1.25608], [1.30658, 1.31081]], atol=1.1e-4)
    assert plot_bistable.PICTURES["existence"](data) is not None


CLAMP = """\
title: the oscillator of Table 1, and a mode of its own held by a contact that always sticks
structure:
  modes:
    - {frequency: 0.9, damping_ratio: 0.02, mass: 1.0, shape: {tip: [1, 1, 0.8], root: [0, 0, 0]}}
    - {frequency: 1.1, damping_ratio: 0.02, mass: 1.0, shape: {tip: [1, -1, 0.6], root: [0, 0, 0]}}
    - {frequency: 3.0, damping_ratio: 0.02, mass: 1.0, shape: {tip: [0, 0, 0], root: [1, 0.5, 0.2]}}
contacts:
  - {name: pad, point: tip, friction: 0.5, tangential_stiffness: 20.0, normal_stiffness: 20.0, preload: 2.0}
  - {name: clamp, point: root, friction: 0.5, tangential_stiffness: 20.0, normal_stiffness: 20.0, preload: 8.0}
excitation: {modal_force: [{amplitude: 1.0}, {amplitude: 1.0}, {amplitude: 1.0}]}
solver: {accuracy: draft}
study: {kind: bistable, frequency: {from: 1.245, to: 1.265}, step: 0.005, width: 2.0e-4, starts: 5, harmonics: 0}
"""


@pytest.mark.slow
def test_offsets_that_are_not_unique():
    data = timesim.run(CLAMP)
    low, high = (data[name].isel(jump=0) for name in ("offset_low", "offset_high"))
    assert np.isnan(low.sel(contact="pad")).all()
    spread = (high - low).sel(contact="clamp").values
    assert np.all(spread > 0.1)
    # Half the preload, over the stiffness: no offset is held that would leave the cone.
    assert float(abs(high.sel(contact="clamp")).max()) < 0.5 * (8.0 + 20 * 0.1) / 20 + 0.1
