"""Two methods on one scene: the study that sets them side by side, and what it shows of the paper's oscillator."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray
import zoo
from commands import CONFIGS, options, run_of_config
from systems import oscillator, oscillator_scene
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.engine.status import RunError
from timesim.hbm.balance import Balance
from timesim.hbm.scheme import Scheme
from timesim.orbit.settling import steady_states
from timesim.picture import compare as plot_compare
from timesim.result.file import StoreError
from timesim.study import compare, hbm
from timesim.study import registry as plot
from timesim.study.curves import collection
from timesim.study.execution.campaign import Execution
from timesim.study.registry import carry_out, load_scene
from timesim.study.summary import comparison

pytestmark = pytest.mark.long

SHORT: dict[str, Any] = {
    "study.frequency": {"values": [0.85, 0.9, 1.2, 1.42]},
    "study.over": {"contacts.pad.preload": [-4, 3]},
    "study.harmonics": 7,
    "study.time_samples": 512,
}


folder, result = run_of_config("figure10.yaml", SHORT)


def test_the_result_has_both_methods_and_their_difference(result):
    assert result.attrs["complete"] == 1
    assert set(result.children) == {"sweep", "hbm", "cycle"}
    sweep, difference = result["sweep"].amplitude, result["relative_difference"]
    assert difference.dims == sweep.dims == ("contacts.pad.preload", "direction", "frequency", "point", "axis")
    assert difference.shape == sweep.shape
    assert result["sweep"].direction.values.tolist() == ["independent"]
    assert result["sweep"].settled.values.all()
    assert result["hbm"].frequency.dims == ("solution",)
    assert "7 harmonics" in result.attrs["method"]
    assert "tsit5" in result.attrs["method"]


def test_the_exported_function_opens_all_parts_of_it(folder, result):
    opened = timesim.open_result(folder / "run")
    assert set(opened.children) == {"sweep", "hbm", "cycle"}
    for name in ("", *opened.children):
        part, other = (tree[name].to_dataset() if name else tree.to_dataset() for tree in (opened, result))
        xarray.testing.assert_identical(part, other)
        assert part.sizes or not name


def test_both_agree_where_the_contact_slips_or_opens(result):
    slip, apart = (result["sweep"][f"{name}_share"].values[..., 0] for name in ("slip", "separation"))
    telling = (slip > 0) | ((apart > 0) & (apart < 1))
    size = np.abs(result["relative_difference"].values).max(axis=(-2, -1))
    assert telling.sum() == 3
    assert slip[telling].min() > 0.05
    assert 1e-7 < size[telling].max() < 2e-3


def test_both_see_the_same_phases_harmonics_and_losses(result):
    """Where contacts slip or open, the curve of the balance, straight between its solutions, passes near the sweep."""
    sweep, hbm = (result[name].to_dataset() for name in ("sweep", "hbm"))
    slip, apart = (sweep[f"{name}_share"].values[..., 0] for name in ("slip", "separation"))
    key = "contacts.pad.preload"
    for v, d, f in np.argwhere((slip > 0) | ((apart > 0) & (apart < 1))):
        point = sweep.isel({key: v, "direction": d, "frequency": f})
        own = hbm.isel(solution=(hbm[key].values == float(point[key])) & (hbm.stable.values > 0))
        for name, off in (
            ("phase_deg", 0.05),
            ("dissipated_power", 2e-4),
            ("harmonic_cos", 2e-4),
            ("harmonic_sin", 2e-4),
        ):
            known, found = point[name].values.ravel(), own[name].values.reshape(own.sizes["solution"], -1)
            at = [np.interp(float(point.frequency), own.frequency.values, column) for column in found.T]
            count = min(known.size, len(at))  # 9 harmonics of the sweep, 7 of the balance
            np.testing.assert_allclose(at[:count], known[:count], rtol=0, atol=off)
    assert sweep.dissipated_power.max() > 0.5


def test_the_balance_promises_nothing_of_time_integration(result):
    promises = ("promised_error", "rtol", "atol", "method_choice")
    assert [name in result.attrs for name in promises] == [True] * 4
    assert not [name for name in promises if name in result["hbm"].attrs]


def test_the_command_prints_the_verdict(folder, result):
    said = (folder / "said").read_text()
    verdict = result.attrs["verdict"]
    for line in verdict.splitlines():
        assert line in said
    assert "the methods agree: at 3 points with slip, or contact for a part of the cycle, they differ by" in verdict
    assert "of the cycle in slip" in verdict
    assert "at 5 points every contact sticks, or stays apart, all the time" in verdict
    assert "proves nothing" in verdict
    assert "harmonic balance: " in verdict.splitlines()[-1]
    assert "time integration: 8 points in" in verdict


def test_a_cycle_by_both_methods(result):
    cycle = result["cycle"].to_dataset()
    x = cycle.displacement
    assert x.dims == ("found_by", "excitation_angle", "point", "axis")
    size = float(np.abs(x).max())
    np.testing.assert_allclose(x.sel(found_by="hbm"), x.sel(found_by="sweep"), atol=2e-3 * size)
    assert float(np.abs(x.sel(found_by="hbm") - x.sel(found_by="sweep")).max()) > 1e-9 * size
    same = cycle.contact_state.sel(found_by="hbm").values == cycle.contact_state.sel(found_by="sweep").values
    assert same.mean() > 0.97
    assert np.unique(cycle.contact_state).size >= 2
    height = cycle.harmonic_amplitude
    np.testing.assert_allclose(height.sel(found_by="hbm"), height.sel(found_by="sweep"), atol=2e-3 * size)
    # The first harmonic is that of the samples, whichever way it was found.
    angle = np.deg2rad(cycle.excitation_angle.values)
    first = 2 * np.abs(np.exp(-1j * angle) @ x.sel(found_by="sweep", point="tip", axis="x").values) / angle.size
    assert height.sel(found_by="sweep", point="tip", axis="x", harmonic=1) == pytest.approx(first, rel=1e-9)


def test_time_integration_begins_with_the_place_the_speed_and_the_slip_of_a_solution():
    """A series of two harmonics; the contact's is a constant, and it bears an elastic displacement."""
    model, frequency = oscillator(3.0, 1.39), 1.39
    balance = Balance(model, frequency, Scheme(2, 64))
    modal = np.array([[0.01, -0.02], [0.01 + 0.02j, -0.03j], [0.005j, 0.01 - 0.01j]])
    coefficient, elastic = np.zeros((1, 3, 5)), np.array([[0.004, -0.003]])
    coefficient[0, :2, 0] = 0.05, 0.02
    start = compare._start(model, balance, coefficient, modal, elastic / balance.length, frequency)

    def motion(time: float) -> np.ndarray:
        return (np.exp(2j * np.pi * frequency * time * np.arange(3)) @ modal).real

    step = 1e-6
    np.testing.assert_allclose(start.displacement, motion(0.0), atol=1e-15)
    np.testing.assert_allclose(start.velocity, (motion(step) - motion(-step)) / (2 * step), rtol=1e-6)
    np.testing.assert_allclose(start.slip, [np.array([0.05, 0.02]) * balance.length - elastic[0]], atol=1e-12)


def test_pictures_are_drawn_by_run_and_again_by_plot(folder):
    drawn = sorted(path.name for path in (folder / "run").glob("*.png"))
    assert drawn == sorted(plot.picture_names("compare"))
    for name in drawn:
        (folder / "run" / name).unlink()
    assert CliRunner().invoke(app, ["plot", str(folder / "run")]).exit_code == 0
    assert sorted(path.name for path in (folder / "run").glob("*.png")) == drawn


def test_pictures_name_what_they_show(result):
    folds = result["hbm"].frequency.values[result["hbm"].fold.values > 0]
    figure = plot_compare.PICTURES["difference"](result)
    named = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert ("frequency of a fold" in named) == (folds.size > 0)
    assert plot_compare.contact_states(result).get_xlabel() == "phase of the excitation [degree]"


def test_bars_bear_the_whole_name_of_their_method(result):
    """Left of the bars, where a long line is cut off by the edge of the picture."""
    low, high = plot_compare.harmonics(result).get_ylim()
    assert low >= 1e-10 * high, "harmonics of rounding do not stretch the axis"
    figure = plot_compare.PICTURES["cycle"](result)
    figure.draw_without_rendering()
    labels = figure.axes[1].get_yticklabels()
    assert {label.get_text().splitlines()[-1] for label in labels} == set(plot_compare.SHORT.values())
    assert min(label.get_window_extent().x0 for label in labels) >= 0


def test_a_difference_of_an_unsettled_point_is_hollow(result):
    sweep = result["sweep"].to_dataset()
    loose = result.copy()
    loose["sweep"] = xarray.DataTree(sweep.assign(settled=sweep.settled * 0))
    lines = plot_compare.difference(loose).get_lines()
    markers = [line for line in lines if line.get_marker() not in ("", "None") and np.size(line.get_xdata())]
    assert {line.get_label() for line in markers} == {"not settled"}
    assert {line.get_fillstyle() for line in markers} == {"none"}


SHAPE = (2, 1, 3)
"""Two values, one direction, three frequencies."""


def test_a_stop_is_closed_where_others_slip():
    """The largest share of slip is that of contacts with friction."""
    assert any("a contact 0.40 of the cycle in slip" in line for line in lines_on(1e-4))
    assert any("a contact 0.00 of the cycle in slip" in line for line in lines_on(1e-4, friction=np.zeros(1)))


def test_a_point_is_compared_with_the_nearest_stable_solution_at_its_frequency(monkeypatch: pytest.MonkeyPatch):
    """An unstable one may be nearer; where there is none, or no motion, nothing is compared, nor along resting axes."""
    height = np.array([1.0, 1.2, 0.5, 3.0])
    solutions = SimpleNamespace(
        stable=np.array([True, False, True, True]),
        frequency=np.array([1.0, 1.0, 1.0, 2.0]),
        amplitude=height[:, None, None] * np.array([[1.0, 0.0, 0.0]]),
    )
    monkeypatch.setattr(compare, "_all_solutions", lambda *_: [solutions, None])
    swept = np.tile([1.25, np.nan, 1.0], (2, 1))[:, None, :, None, None] * np.array([[1.0, 0.0, 0.0]])
    match = compare.matched(swept, np.array([1.0, 2.0, 3.0]), None)
    assert match.solution.tolist() == [[[0, -1, -1]], [[-1, -1, -1]]]
    expected = np.full(swept.shape, np.nan)
    expected[0, 0, 0, 0, 0] = -0.2
    np.testing.assert_allclose(match.difference, expected)


def test_each_set_of_values_has_a_curve_of_its_own():
    """Where one fails, points of another are not said to lie where it did not get."""
    study = {"kind": "hbm", "frequency": {"from": 1.0, "to": 0.9}, "over": {"contacts.pad.preload": [-4, 3, 4]}}
    loaded = load_scene(oscillator_scene(preload=3.0) | {"study": study})
    curves = collection.Curves(loaded, loaded.plan)
    done = [(0, True), (0, True), (1, True), (1, False)]
    curves.curves = [SimpleNamespace(values=curves.values[v], curve=SimpleNamespace(complete=c)) for v, c in done]
    assert curves.whole.tolist() == [True, False, False]
    text = "\n".join(lines_on(1e-4, 6, whole=curves.whole[:2]))
    assert "the balance has no stable solution: contacts.pad.preload -4 at 1 to 3 Hz" in text
    assert "the balance has no solution, as it did not get there: contacts.pad.preload 3 at 1 to 3 Hz" in text


@pytest.mark.parametrize(
    ("stop", "said"), [(StoreError("no space left"), "no space left"), (KeyboardInterrupt(), "interrupted, not begun")]
)
def test_curves_that_are_not_begun_leave_what_is_computed(
    stop: BaseException, said: str, monkeypatch: pytest.MonkeyPatch
):
    """They cannot be kept, or an interrupt comes while they compile: the sweeps before them stay."""

    def stopped(*_: Any) -> Any:
        raise stop

    study = {"kind": "hbm", "frequency": {"from": 1.0, "to": 0.9}}
    loaded = load_scene(oscillator_scene(preload=3.0) | {"study": study})
    monkeypatch.setattr(hbm, "followed", stopped)
    data, curves, reason = hbm.followed_behind(loaded, loaded.plan, Execution())
    assert reason == data.attrs["reason"] == said
    assert (data.sizes["solution"], data.attrs["complete"], curves.curves) == (0, 0, [])


def points_on(
    difference: float | np.ndarray,
    missing: int = 0,
    folds: Sequence[tuple[float, float]] = (),
    whole: Sequence[bool] = (True, True),
    **changes: np.ndarray,
) -> comparison.Points:
    """Points of motions along x in which a contact slips and opens, the balance off by a share of each amplitude.

    Args:
        difference: of the methods.
        missing: points without a solution of the balance.
        folds: preload and frequency of each.
        whole: whether the curves of each preload came to their end.
        changes: variables of the sweep.
    """
    dims = ("contacts.pad.preload", "direction", "frequency")
    shares = {"slip_share": np.full((*SHAPE, 1), 0.4), "separation_share": np.full((*SHAPE, 1), 0.1)}
    arrays: dict[str, Any] = {"settled": np.ones(SHAPE, int), "period": np.ones(SHAPE, int)}
    arrays |= {"irregular": np.zeros(SHAPE, int)} | shares | changes
    friction, amplitude = arrays.pop("friction", np.ones(1)), arrays.pop("amplitude", np.ones((*SHAPE, 1, 3)))
    drift = arrays.pop("drift", np.zeros((*SHAPE, 1, 3)))
    variables = {name: ((*dims, "contact")[: array.ndim], array) for name, array in arrays.items()}
    variables |= {"amplitude": ((*dims, "point", "axis"), amplitude), "drift": ((*dims, "point", "axis"), drift)}
    coords: dict[str, Any] = {
        "contacts.pad.preload": [-4.0, 3.0],
        "direction": ["independent"],
        "frequency": [1.0, 2.0, 3.0],
    }
    coords["friction"] = ("contact", friction)
    at = np.array(folds).reshape(-1, 2)
    columns = {"fold": np.ones(len(at)), "contacts.pad.preload": at[:, 0], "frequency": at[:, 1]}
    hbm = {name: (("solution",), column) for name, column in columns.items()}
    off = np.full((*SHAPE, 1, 3), np.nan)
    off[..., 0] = np.asarray(difference)[..., None]
    off.reshape(-1, 3)[:missing] = np.nan
    return comparison.compared_points(xarray.Dataset(variables, coords), xarray.Dataset(hbm), off, np.array(whole))


def lines_on(*given: Any, **changes: Any) -> list[str]:
    """The lines on these points."""
    return list(comparison.comparison_lines(points_on(*given, **changes)))


@pytest.mark.parametrize(("size", "word"), [(1e-4, "agree"), (1e-2, "nearly agree"), (0.1, "differ")])
def test_the_verdict_follows_the_difference(size, word):
    lines = lines_on(size)
    assert lines[0].startswith(f"the methods {word}: at 6 points")
    assert ("convergence" in lines[0]) == (size > 2e-3)
    assert len(lines) == 1


def test_the_verdict_gives_the_median_of_what_it_judges():
    lines = lines_on(np.array([1, 2, 3, 4, 5, 600]).reshape(SHAPE) * 1e-6)
    assert "differ by at most 6.0e-04 of the amplitude (median 3.5e-06" in lines[0]
    assert "most at 3 Hz with contacts.pad.preload 3" in lines[0]


@pytest.mark.parametrize(("other", "said"), [(1.0, False), (1000.0, True)])
def test_the_verdict_says_where_the_axis_that_differs_hardly_moves(other, said):
    amplitude = np.ones((*SHAPE, 1, 3))
    amplitude[..., 2] = other
    verdict = lines_on(1e-2, amplitude=amplitude)[0]
    assert (", along 0 0, which moves 1.0e-03 of the largest amplitude, a contact" in verdict) == said


def test_points_next_to_a_fold_of_their_own_curve_are_judged_apart():
    """Within 1e-3 of its frequency; the other preload's curve has no fold there."""
    sizes = np.full(SHAPE, 1e-5)
    sizes[0, 0, 1:] = 0.3, 0.2
    lines = lines_on(sizes, folds=[(-4.0, 2.0019), (-4.0, 3.0031)])
    assert lines[0].startswith("the methods differ: at 5 points")
    assert "most at 3 Hz with contacts.pad.preload -4" in lines[0]
    assert lines[1] == "at 1 point within 0.001 of a fold's frequency they differ by up to 3.0e-01"


def test_a_motion_that_no_curve_passes_begins_one():
    """Both motions at a gap, in a range that the fold between them lies outside of: each sweep has its own curve."""
    study = {
        "kind": "compare",
        "frequency": {"values": [0.9425, 0.944, 0.946]},
        "direction": "both",
        "harmonics": 7,
        "time_samples": 512,
    }
    start = {"modal_displacement": [-0.2, -0.2]}  # leads to the larger motion at 0.9425 Hz, the smaller at 0.946
    scene = load_scene(oscillator_scene(preload=-4.0) | {"study": study, "initial": start})
    outcome = carry_out(scene)
    assert outcome.reason is None
    amplitude = outcome.groups["sweep"].amplitude.sel(point="tip", axis="x")
    assert float(amplitude.max() / amplitude.min()) > 1.3
    curves = outcome.groups["hbm"]
    assert set(curves.curve.values) == {0, 1}
    difference = outcome.groups[""].relative_difference
    assert float(abs(difference).max()) < 2e-3
    assert any("a curve of its own" in line for line in outcome.summary)


def test_jumps_of_the_sweeps_are_listed_beside_the_folds():
    study = {
        "kind": "compare",
        "frequency": {"values": [0.93, 0.944, 0.96]},
        "direction": "both",
        "refine": 1e-3,
        "harmonics": 7,
        "time_samples": 512,
    }
    said = carry_out(load_scene(oscillator_scene(preload=-4.0) | {"study": study})).summary
    jumps = [line for line in said if "the motion jumps between" in line]
    assert [line.split(":")[0] for line in jumps] == ["direction up", "direction down"]
    assert any("folds at 0.947" in line for line in said)


def test_points_with_another_offset_are_listed_with_the_reason():
    """A contact sticks all the time at points of the first preload: doubtful, and not judged once it is known."""
    slip = np.full((*SHAPE, 2), 0.4)
    slip[0, ..., 1] = 4e-7  # on its cone for a moment, as it has come to rest there
    sizes = np.full(SHAPE, 1e-5)
    sizes[0, 0, 1:] = 3e-3
    sizes[1, 0, 0] = 4e-3
    known = np.zeros(SHAPE, dtype=bool)
    known[0, 0, 1:] = True
    shares = {"slip_share": slip, "separation_share": np.zeros((*SHAPE, 2)), "friction": np.ones(2)}
    points = points_on(sizes, **shares)
    np.testing.assert_array_equal(points.doubtful, known)
    lines = list(comparison.comparison_lines(replace(points, other_offset=known)))
    assert lines[0].startswith("the methods nearly agree: at 4 points")
    assert lines[1].startswith(
        "at 2 points they differ by up to 3.0e-03 because a contact that sticks all the time keep"
    )
    assert lines[1].endswith("contacts.pad.preload -4 at 2 to 3 Hz")


@pytest.mark.parametrize(("apart", "friction", "sticks"), [(0.0, 1.0, True), (0.0, 0.0, False), (1.0, 1.0, False)])
def test_a_contact_keeps_an_offset_where_it_is_closed_with_friction(apart: float, friction: float, sticks: bool):
    """Beside one that slips: neither one that stays apart nor a stop has an offset that is free."""
    slip, separation = np.full((*SHAPE, 2), 0.4), np.zeros((*SHAPE, 2))
    slip[..., 1], separation[..., 1] = 0.0, apart
    shares = {"slip_share": slip, "separation_share": separation, "friction": np.array([1.0, friction])}
    points = points_on(1e-2, **shares)
    assert points.judged.all()
    np.testing.assert_array_equal(points.doubtful, np.full(SHAPE, sticks))


def test_only_motions_that_stay_at_the_solution_of_the_balance_have_another_offset(monkeypatch: pytest.MonkeyPatch):
    """Of four doubtful points: time integration stays there, leaves it, comes to a longer period, and fails."""
    doubtful = np.zeros(SHAPE, dtype=bool)
    doubtful[0, 0, :] = doubtful[1, 0, 1] = True
    points = replace(points_on(1e-2), sticks=doubtful)
    np.testing.assert_array_equal(points.doubtful, doubtful)
    own = SimpleNamespace(amplitude=np.array([[[0.1, 0.0, 0.0]], [[2.0, 1.0, 0.0]]]))
    match = compare.Match(np.zeros(0), np.ones(SHAPE, dtype=int), [own, own])
    near, far = (own.amplitude[1] + change for change in (9e-4, 1.1e-3))
    outcomes = [(near, 1, None), (far, 1, None), (near, 2, None), (near, 1, "the budget is spent")]
    orbits = [[SimpleNamespace(amplitude=x, period=period, reason=why)] for x, period, why in outcomes]
    scene: Any = SimpleNamespace(plan=SimpleNamespace(sweep=SimpleNamespace(criterion=None)), solver=lambda: None)
    monkeypatch.setattr(compare, "_begun", lambda *given: (None, 1.0, None, None))
    monkeypatch.setattr(compare, "steady_states", lambda chains, *_: orbits[: len(chains)])
    found = compare.other_offsets(scene, None, match, points)
    assert np.argwhere(found).tolist() == [[0, 0, 0]]


@pytest.mark.slow
def test_a_contact_that_sticks_with_another_offset_explains_a_difference():
    """The sweep from rest leaves a mean force in a contact that sticks; it loads another, which slips."""
    model, _ = zoo.structure(101)
    model = replace(model, excitation=replace(model.excitation, cosine=30.4 * model.excitation.cosine))
    study = {"kind": "compare", "frequency": {"values": [26.2, 38.0]}, "stability": False}
    found = timesim.run(zoo.scene_of(model) | {"study": study})
    assert found["other_offset"].values.ravel().tolist() == [1, 1]
    assert float(abs(found["relative_difference"]).max()) > 1e-3
    assert "keeps another free offset" in found.attrs["verdict"]


@pytest.mark.parametrize("rounding", [0.0, 2e-16])
def test_full_stick_and_contacts_that_stay_apart_prove_nothing(rounding):
    """A share that rounding keeps from 0 or 1 is none of a state that changes."""
    none = np.full((*SHAPE, 1), rounding)
    apart = none.copy()
    apart[0] = 1 - rounding
    lines = lines_on(0.0, slip_share=none, separation_share=apart)
    assert "nothing is proven" in lines[0]
    assert "at 6 points every contact sticks" in lines[1]


def test_a_stop_that_stays_closed_proves_nothing():
    closed, never = np.ones((*SHAPE, 1)), np.zeros((*SHAPE, 1))
    lines = lines_on(0.0, slip_share=closed, separation_share=never, friction=np.zeros(1))
    assert "nothing is proven" in lines[0]
    assert "at 6 points every contact sticks" in lines[1]


def test_points_without_an_answer_are_named():
    settled, period = np.ones(SHAPE, int), np.ones(SHAPE, int)
    settled[1, 0, 2], period[1, 0, 1] = 0, 2
    text = "\n".join(lines_on(1e-5, missing=2, settled=settled, period=period))
    assert "at 2 points the balance has no stable solution: contacts.pad.preload -4 at 1 to 2 Hz" in text
    assert "at 1 point the motion repeats after several cycles, which the balance cannot show: contacts.pad.pre" in text
    assert "at 1 point the motion did not settle and is left out: contacts.pad.preload 3 at 3 Hz" in text
    sticking = np.zeros(SHAPE, dtype=bool)
    sticking[0, 0, 1] = True
    text = "\n".join(comparison.comparison_lines(replace(points_on(1e-5, missing=2), sticks=sticking)))
    assert "at 1 point the balance has no stable solution: contacts.pad.preload -4 at 1 Hz" in text
    offset = "perhaps only because a contact that sticks all the time keeps another free offset there"
    assert f"at 1 point the balance has no stable solution, {offset}: contacts.pad.preload -4 at 2 Hz" in text
    text = "\n".join(comparison.comparison_lines(replace(points_on(1e-5, missing=2), followed=np.zeros(SHAPE, bool))))
    assert "at 2 points the balance has no solution, as it did not get there" in text
    assert "no stable solution" not in text
    text = "\n".join(lines_on(1e-5, settled=settled, irregular=1 - settled))
    assert "at 1 point the motion does not repeat, being quasi-periodic or irregular, and is left out: cont" in text
    assert "did not settle" not in text
    amplitude = np.ones((*SHAPE, 1, 3))
    amplitude[1, 0, 2] = np.nan
    text = "\n".join(lines_on(1e-5, settled=settled, amplitude=amplitude))
    assert "at 1 point the sweep has no motion, having failed or ended before: contacts.pad.preload 3 at 3 Hz" in text
    assert "did not settle" not in text
    drift = np.zeros((*SHAPE, 1, 3))
    drift[1, 0, 0, 0, 1] = -0.1
    points = points_on(1e-5, drift=drift)
    assert np.count_nonzero(points.judged) == 5
    (line,) = [line for line in comparison.comparison_lines(points) if "drift" in line]
    assert line.startswith(
        "at 1 point the body drifts, as nothing holds it, which the balance cannot show: contacts.pad.p"
    )


def test_points_between_those_that_are_named_are_not_named_with_them():
    """The first and the last of three frequencies do not settle, and the one between them does."""
    settled = np.ones(SHAPE, int)
    settled[1, 0, [0, 2]] = 0
    text = "\n".join(lines_on(1e-5, settled=settled))
    assert text.endswith("at 2 points the motion did not settle and is left out: contacts.pad.preload 3 at 1 Hz, 3 Hz")


def test_a_cycle_that_does_not_settle_is_left_out_with_the_reason(monkeypatch: pytest.MonkeyPatch):
    """The sweep settles from its own start in time; from the solution of the balance no cycles are left for it."""
    study = {"kind": "compare", "frequency": {"values": [1.39]}, "harmonics": 3, "time_samples": 64}
    study |= {"settle": {"tolerance": 1e-7}}
    seen = []

    def impatient(chains, solver, criterion):
        seen.append(criterion)
        return steady_states(chains, solver, replace(criterion, max_cycles=1))

    assert "cycle" in carry_out(load_scene(oscillator_scene(preload=3.0) | {"study": study})).groups
    monkeypatch.setattr(compare, "steady_states", impatient)
    outcome = carry_out(load_scene(oscillator_scene(preload=3.0) | {"study": study}))
    assert [criterion.tolerance for criterion in seen] == [1e-7]
    assert outcome.reason is None
    assert "cycle" not in outcome.groups
    (line,) = [line for line in outcome.summary if "no cycle is shown" in line]
    assert "at 1.39 Hz the motion does not settle in settle.max_cycles" in line

    def failing(*_):
        raise RunError("the budget is spent")

    monkeypatch.undo()
    monkeypatch.setattr(compare, "one_cycle", failing)
    outcome = carry_out(load_scene(oscillator_scene(preload=3.0) | {"study": study}))
    assert "no cycle is shown by both methods: the budget is spent" in outcome.summary


@pytest.mark.parametrize("at", [pytest.param("matched", marks=pytest.mark.slow), "cycle_by_both"])
def test_a_comparison_that_is_interrupted_keeps_both_methods(at, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    short = SHORT | {"study.frequency": {"values": [1.2, 1.42]}, "study.over": {"contacts.pad.preload": [3]}}
    monkeypatch.setattr(compare, at, interrupted)
    call = ["run", str(CONFIGS / "figure10.yaml"), "-o", str(tmp_path), "--force", *options(short)]
    said = CliRunner().invoke(app, call)
    assert said.exit_code == 1
    assert "interrupted while the methods were compared" in said.output
    kept = timesim.open_result(tmp_path)
    assert kept.attrs["complete"] == 0
    assert set(kept.children) == {"sweep", "hbm"}
    assert kept["sweep"].settled.values.all()
    assert np.isfinite(kept["relative_difference"].values).any() == (at == "cycle_by_both")
    assert (tmp_path / "overlay.png").exists()
    assert (tmp_path / "difference.png").exists() == (at == "cycle_by_both")


def test_a_balance_that_is_interrupted_while_it_compiles_keeps_the_sweep(monkeypatch, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(hbm, "followed", interrupted)
    short = SHORT | {"study.frequency": {"values": [1.2, 1.42]}, "study.over": {"contacts.pad.preload": [3]}}
    call = ["run", str(CONFIGS / "figure10.yaml"), "-o", str(tmp_path), "--no-plots", *options(short)]
    said = CliRunner().invoke(app, call)
    assert said.exit_code == 1
    assert "hbm: interrupted, not begun" in said.output
    assert "--resume goes on with it" in said.output
    kept = timesim.open_result(tmp_path)
    assert kept.attrs["complete"] == 0
    assert kept["sweep"].settled.values.all()
    assert kept["hbm"].sizes["solution"] == 0


@pytest.mark.slow
def test_the_sweep_carries_its_state():
    """Between the jumps of figure 11 each direction has its own motion; the balance has both, and a third unstable."""
    given = {"study.frequency": {"from": 0.94, "to": 0.95, "step": 0.0025}, "study.convergence": False}
    found = timesim.run(CONFIGS / "figure11.yaml", given | {"study.harmonics": 7})
    assert found.attrs["complete"] == 1
    x = found["sweep"].amplitude.sel(point="tip", axis="x").sel(frequency=0.945, method="nearest")
    up, down = float(x.sel(direction="up")), float(x.sel(direction="down"))
    assert up > 1.5 * down
    size = np.abs(found["relative_difference"].values)
    assert np.nanmax(size) < 2e-3
    assert np.isfinite(size).all()
    folds = found["hbm"].frequency.values[found["hbm"].fold.values == 1]
    np.testing.assert_allclose(np.sort(folds), [0.9416, 0.9472], atol=2e-4)
    assert (found["hbm"].stable.values[found["hbm"].fold.values == 0] == 0).any()


@pytest.mark.slow
def test_figure_10_point_by_point():
    """The errors of the balance at figure 10's points fall with its harmonics; 15 leave less than 2e-3."""
    frequencies = np.round(np.arange(0.82, 1.66, 0.04), 10).tolist()
    worst = {}
    for harmonics in (1, 3, 7, 15):
        given = {"study.frequency": {"values": frequencies}, "study.harmonics": harmonics}
        given |= {"study.start": "both_ends", "study.stability": False}
        with np.errstate(all="ignore"):
            found = timesim.run(CONFIGS / "figure10.yaml", given)
        sweep = found["sweep"].to_dataset()
        slip, apart = (sweep[f"{name}_share"].values[..., 0] for name in ("slip", "separation"))
        size = np.nanmax(np.abs(found["relative_difference"].values), axis=(-2, -1))
        folds = found["hbm"].frequency.values[found["hbm"].fold.values == 1]
        clear = (np.abs(np.subtract.outer(frequencies, folds)) > 1e-3).all(axis=1)
        telling = ((slip > 0) | ((apart > 0) & (apart < 1))) & (sweep.settled.values == 1) & clear
        assert telling.sum() > 60
        worst[harmonics] = float(np.nanmax(size[telling]))
        shares = f"{slip[telling].mean():.2f} in slip, {apart[telling].mean():.2f} in separation"
        print(f"{harmonics} harmonics: {telling.sum()} points, {shares}: at most {worst[harmonics]:.1e}")
        assert np.isfinite(size[telling]).all()
    assert worst[1] > 3 * worst[3] > 9 * worst[7]
    assert worst[15] < worst[7]
    assert worst[15] < 2e-3
