"""The study `tradeoff`: which runs it makes, how they are judged, what it recommends, what it says when cut short."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray
from xarray import Dataset

import timesim
from timesim.engine.status import RunError, Status
from timesim.model.solver import CLOSED_FORM, Solver
from timesim.picture.tradeoff import error_against_time
from timesim.scene.transient import TradeoffPlan
from timesim.study.execution.campaign import Execution
from timesim.study.registry import carry_out, draw, load_scene
from timesim.study.tradeoff import bench as benches
from timesim.study.tradeoff import study
from timesim.study.tradeoff.bench import Bench, Trial, lowest_modes
from timesim.study.tradeoff.report import block, lines
from timesim.study.tradeoff.study import fewer, judge

pytestmark = pytest.mark.long

CONFIG = Path(__file__).parents[2] / "configs" / "tradeoff.yaml"
SCENE = load_scene(CONFIG)
TRUE = np.array([1.0, 0.5])
FOREVER = 1e9  # seconds: what is no test of the budget ends on a slow machine as on any other


def trial(name: str, rtol: float, error: float, seconds: float, **more: Any) -> Trial:
    """A run that is off the truth by an error."""
    start = Trial(
        solver=Solver(name, rtol, rtol / 100),
        num_modes=2,
        preset="",
        seconds=seconds,
        compiling=0.0,
        steps=600,
        transitions=9,
        displacement=TRUE * [1 + error, 1],
        velocity=np.zeros(2),
        size=np.array([1.0, 0.0]),
        amplitude=np.array([[1.0 + error / 10, 0.0, 0.0]]),
    )
    return replace(start, **more)


TRIALS = [
    trial("tsit5", 1e-3, 1e-2, 1.0),
    trial("tsit5", 1e-7, 1e-6, 3.0),
    trial("dopri8", 1e-5, 5e-6, 1.5),
    trial("dopri8", 1e-6, 5e-7, 2.0),
    trial("tsit5", 1e-11, 2e-11, 9.0),
    trial("dopri8", 1e-11, 0.0, 4.0),
    trial("tsit5", 1e-7, 1e-6, 0.1, num_modes=1),
    trial("rk4", 1e-8, 1e-4, 8.0),
]


def bench(trials: list[Trial], **plan: Any) -> Bench:
    given = {"frequency": 1.39, "cycles": 60, "error": 1e-6, "budget": FOREVER, "amplitude": False} | plan
    made = Bench(SCENE.model(), TradeoffPlan(**given), Execution())
    made.trials = list(trials)
    return made


def test_runs_are_judged_by_the_finest_and_known_as_well_as_a_second_method_agrees() -> None:
    judged = judge(bench(TRIALS))
    assert judged.known == pytest.approx(2e-11)
    assert judged.verified == "dopri8, rtol 1e-11, atol 1e-13 and tsit5, rtol 1e-11, atol 1e-13"
    assert judged.error == pytest.approx([1e-2, 1e-6, 5e-6, 5e-7, 2e-11, 2e-11, 1e-6, 1e-4])
    # The run with a mode left out is faster than all, and is no run of this scene.
    assert judged.pareto.tolist() == [True, False, True, True, False, True, False, False]
    assert judged.recommended == 3


def test_no_error_is_less_than_what_is_known_of_the_truth() -> None:
    """A run may be nearer to it than the second method, by chance."""
    judged = judge(bench([*TRIALS, trial("dopri8", 1e-10, 1e-12, 3.0)]))
    assert judged.error[-1] == judged.known == pytest.approx(2e-11)


def test_what_fewer_modes_and_all_that_is_left_out_make_of_a_run() -> None:
    whole = trial("tsit5", 1e-7, 1e-6, 7.5, solver=Solver("tsit5", 1e-7, 1e-9, reduce=False))
    for error, verdict in ((3e-7, "the lowest 1 do"), (3e-5, "all 2 are needed")):
        few = trial("tsit5", 1e-7, error, 0.1, num_modes=1)
        made = bench([*TRIALS[:6], few, whole])
        said = list(lines(study._record(SCENE, made, judge(made), None)))
        assert f"error by the number of lowest modes kept: 1: {error:.1e}; for 1e-06 {verdict}" in said
        assert "with nothing left out (solver.reduce: false) a run takes 2.5 times as long" in said


def test_a_gain_within_the_scatter_of_the_times_is_none() -> None:
    """The run that leaves out what it can takes 3 s."""
    whole = Solver("tsit5", 1e-7, 1e-9, reduce=False)
    for seconds, said in ((3.5, "as long, as far as the scatter of the times tells"), (3.8, "1.3 times as long")):
        more = trial("tsit5", 1e-7, 1e-6, seconds, solver=whole)
        made = bench([replace(one, scatter=0.1) for one in (*TRIALS[:6], more)])
        heard = list(lines(study._record(SCENE, made, judge(made), None)))
        assert f"with nothing left out (solver.reduce: false) a run takes {said}" in heard


def test_modes_that_were_not_tried_and_times_that_are_not_told_apart_are_said() -> None:
    quick = trial("dopri8", 3e-6, 8e-7, 2.1)
    made = bench([*(replace(one, scatter=0.1) for one in TRIALS[:6]), quick])
    made.left_out[Solver("tsit5", 1e-7, 1e-9), 1] = benches.NO_TIME
    said = list(lines(study._record(SCENE, made, judge(made), None)))
    assert "no time left to try the lowest 1 of 2 modes" in said
    assert "times of one run scatter by 10 %: they do not tell which is quicker, that or dopri8 3e-06" in said
    made.trials[-1] = replace(quick, seconds=2.3)
    said = list(lines(study._record(SCENE, made, judge(made), None)))
    assert not any("scatter" in line for line in said)


def test_a_block_keeps_what_the_scene_sets_and_no_run_varies() -> None:
    """Pasted in the place of the scene's own section it changes only the method and its tolerance."""
    made, given = bench(TRIALS), {"max_steps": 5000, "estimate_error": False}
    data = study._record(load_scene(CONFIG, {"solver": given}), made, judge(made), None)
    block_of_run = json.loads(data.attrs["recommended"])
    assert block_of_run == {"method": "dopri8", "rtol": 1e-6, "atol": 1e-8} | given
    assert load_scene(CONFIG, {"solver": block_of_run}).solver().budget == 5000
    blocks = [line for line in lines(data) if "solver: {" in line]
    assert len(blocks) > 2
    assert all("max_steps: 5000, estimate_error: false" in line for line in blocks)


def test_steps_are_counted_in_whole_numbers_whichever_runs_were_made() -> None:
    for trials in (TRIALS, TRIALS[:4], []):
        made = bench(trials)
        assert study._record(SCENE, made, judge(made), None)["steps_asked"].dtype.kind == "i"


def test_a_truth_without_a_second_method_says_so_and_a_single_run_has_no_error() -> None:
    alone = judge(bench([trial for trial in TRIALS if trial.solver.name == "tsit5"]))
    assert alone.verified == ""
    assert alone.known == pytest.approx(1e-6, rel=1e-3)
    assert np.isnan(judge(bench(TRIALS[:1])).error).all()
    assert judge(bench([])).recommended == -1


def test_the_wanted_error_or_else_the_best() -> None:
    assert judge(bench(TRIALS, error=1e-13)).recommended == 5
    assert judge(bench(TRIALS, amplitude=True)).recommended == 2


def test_a_tolerance_between_two_for_half_the_wanted_error() -> None:
    made, tried = bench(TRIALS, error=2e-6), []
    made.try_ = lambda solver, **_: tried.append(solver)  # type: ignore[method-assign, assignment, return-value]
    study._between(made, "dopri8")
    (between,) = tried
    assert between.rtol == pytest.approx(10 ** (-5 - np.log10(5)), rel=0.02)
    assert between.atol == pytest.approx(between.rtol / 100)


def test_what_has_no_time_left_or_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    made = bench(TRIALS[2:3], budget=0.0)
    made._compiling[benches.program(TRIALS[2].solver, 2)] = 3.0
    assert made.try_(Solver("dopri8", 1e-9, 1e-11), num_modes=1) is None
    made.plan = replace(made.plan, budget=FOREVER)

    failed: list[str] = []

    def failing(_: Any, solver: Solver, *__: Any) -> Any:
        failed.append(solver.name)
        raise RunError("at time 1 s: too stiff. Try something else")

    monkeypatch.setattr(benches, "_through", failing)
    made.try_(Solver("rk4", 1e-8, 1e-10, longest=0.1))
    for _ in range(2):  # what failed once is not tried again
        made.try_(Solver("tsit5", 1e-3, 1e-5))
    assert failed == ["rk4", "tsit5"]
    data = study._record(SCENE, made, judge(made), None)
    assert list(lines(data))[-2:] == [
        "left out, no time left: dopri8, rtol 1e-09, 1 mode",
        "left out, too stiff: rk4, 63 steps a cycle (at time 1 s); tsit5, rtol 0.001 (at time 1 s)",
    ]
    assert data.attrs["modes_not_tried"] == "1"


def test_where_steps_are_spent_more_of_them_are_advised(monkeypatch: pytest.MonkeyPatch) -> None:
    """More time for the study would not help."""
    one_method = [trial for trial in TRIALS if trial.solver.name == "tsit5"]
    spent = f"at time 1 s: {Status.BUDGET.message(solver='tsit5', budget=100, contact='pad')}"
    monkeypatch.setattr(benches, "_through", lambda *_: (_ for _ in ()).throw(RunError(spent)))
    for trials, what in ((one_method, "by no second method"), (one_method[:1], "one run says nothing of its error")):
        made = bench(trials, budget=FOREVER)
        made._compiling[benches.program(made.trials[0].solver, 2)] = 0.0
        made.try_(Solver("rk4", 1e-8, 1e-10, longest=0.1))
        (said,) = [line for line in lines(study._record(SCENE, made, judge(made), None)) if what in line]
        assert said.endswith(": raise solver.max_steps")
        made.left_out[Solver("dopri8", 1e-9, 1e-11), 2] = benches.NO_TIME
        (said,) = [line for line in lines(study._record(SCENE, made, judge(made), None)) if what in line]
        assert said.endswith(": raise solver.max_steps and give it a larger study.budget")
    reason = carry_out(SCENE).reason or ""
    assert reason.startswith("no run has come to its end (raise solver.max_steps): the budget of 100 steps")


def test_compilation_is_what_the_first_run_takes_longer_than_the_quickest(monkeypatch: pytest.MonkeyPatch) -> None:
    now, lasts = [0.0], [5.0, 0.2, 0.1, 0.3, 0.4]

    def run(*_: Any) -> Any:
        now[0] += lasts.pop(0)
        ended = SimpleNamespace(displacement=np.zeros(2), velocity=np.zeros(2))
        return ended, SimpleNamespace(transitions=0, size=np.ones(2), amplitude=np.ones((1, 1, 3))), 600

    monkeypatch.setattr(benches, "_through", run)
    monkeypatch.setattr(benches, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    made = bench([])
    first = made.try_(Solver("tsit5", 1e-4, 1e-6))
    lasts += [0.5]
    again = made.try_(Solver("tsit5", 1e-6, 1e-8))
    assert first is not None
    assert again is not None
    assert (first.seconds, first.compiling) == (pytest.approx(0.1), pytest.approx(4.9))
    assert (again.seconds, again.compiling) == (pytest.approx(0.5), 0.0)
    assert first.scatter == pytest.approx(1.5)
    assert np.isnan(again.scatter)
    assert made.left == pytest.approx(FOREVER - 6.5)


def test_the_lowest_modes_of_a_model() -> None:
    assert fewer(12) == [9, 6, 3]
    assert fewer(2) == [1]
    assert fewer(1) == []
    model = SCENE.model()
    one = lowest_modes(model, 1)
    np.testing.assert_array_equal(one.structure.frequency, model.structure.frequency[:1])
    np.testing.assert_array_equal(one.contact_shape, model.contact_shape[..., :1])
    assert one.excitation.cosine.shape == (1, 1)
    assert lowest_modes(model, 2) is model


def two_methods(made: Bench, settings: dict[str, Any]) -> None:
    for solver in (Solver("tsit5", 1e-4, 1e-6), Solver("tsit5", 1e-7, 1e-9), Solver("rk4", 1e-8, 1e-10, 0.03)):
        made.try_(solver)
    made.try_(Solver("tsit5", 1e-7, 1e-9), preset="standard")
    made.try_(Solver("tsit5", 1e-7, 1e-9))  # made already, and that of the preset still
    # Times by the steps, and below all that a machine takes: which run is the quickest is no matter of its load.
    made.trials[:] = [replace(trial, seconds=1e-9 * trial.steps) for trial in made.trials]


def test_a_scene_of_a_tradeoff(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(study, "_try_all", two_methods)
    outcome = carry_out(load_scene(CONFIG, {"study.cycles": 20, "study.error": 1e-4, "study.budget": FOREVER}))
    data, text = outcome.groups[""], "\n".join(outcome.summary)
    assert outcome.reason is None
    assert data.method.values.tolist() == ["tsit5", "tsit5", "rk4"]
    assert data.preset.values.tolist() == ["", "standard", ""]
    assert data.transitions.values.tolist() == [75, 75, 75]
    assert 1e-6 < float(data.error[0]) < 1e-4
    assert data.seconds_a_cycle.attrs["units"] == "s"
    assert json.loads(data.attrs["recommended"]) == {"method": "tsit5", "rtol": 1e-4, "atol": 1e-6}
    assert "for an error of 1e-04: solver: {method: tsit5, rtol: 0.0001, atol: 1e-06}" in text
    assert "by no second method" in text
    (picture,) = draw(data, tmp_path)
    assert picture.name == "tradeoff.png"
    shown = {line.get_label() for line in error_against_time(data).lines}
    assert {"tsit5", "rk4", "recommended", "wanted, 1e-04"} <= shown
    pasted = timesim.run(CONFIG, {"study": {"kind": "transient", "cycles": 20}, "solver": json.loads(data.recommended)})
    assert pasted.attrs["estimated_error"] < 1e-3


def test_runs_whose_amplitude_is_judged_begin_where_it_has_settled() -> None:
    """The settled amplitude is known (tests/agreement); three cycles from rest are far from it."""
    made, from_rest = bench([], cycles=3, amplitude=True), bench([], cycles=3)
    solver = Solver("tsit5", 1e-7, 1e-9)
    settled, begun = made.try_(solver), from_rest.try_(solver)
    assert settled is not None
    assert begun is not None
    assert settled.amplitude[0, 0] == pytest.approx(0.15612878, rel=1e-6)
    assert abs(begun.amplitude[0, 0] / 0.15612878 - 1) > 1e-2
    assert made.settled_to < 1e-7
    assert np.isnan(from_rest.settled_to)
    made.time_again()
    assert made.model_of(2) is made.model_of(2)


def test_runs_whose_amplitude_is_judged_come_to_their_own() -> None:
    """With light damping, three cycles from the accurate motion hardly leave it, whatever the tolerance."""
    damping = {f"structure.modes.{i}.damping_ratio": 0.002 for i in range(2)}
    model, errors = load_scene(CONFIG, damping).model(), []
    for cycles in (3, 300):
        made = Bench(model, TradeoffPlan(1.3, cycles, 1e-4, FOREVER, amplitude=True), Execution())
        runs = [made.try_(Solver("tsit5", rtol, rtol / 100)) for rtol in (1e-4, 1e-9)]
        coarse, fine = (run.amplitude for run in runs if run is not None)
        errors.append(float(np.max(np.abs(coarse - fine)) / np.max(fine)))
        assert 10 < made.cycles <= max(cycles, 200)
    assert errors[0] == pytest.approx(errors[1], rel=0.1)
    data = study._record(SCENE, made, judge(made), None)
    assert (data.attrs["cycles"], data.attrs["cycles_asked"]) == (300, 300)
    made.plan = replace(made.plan, cycles=3)
    said = list(lines(study._record(SCENE, made, judge(made), None)))
    assert any(line.startswith("each run has 300 cycles: in 3 it would not have come") for line in said)


def test_how_long_a_motion_remembers() -> None:
    """Of one that decays by a share in each cycle, and of one that repeats after two cycles."""
    share, cycles = 0.9, np.arange(400)
    for period in (1, 2):
        settled = 1 + 0.2 * (cycles % period)
        amplitude = (settled * (1 + share**cycles))[:, None, None]
        expected = np.log(benches.FORGOTTEN) / np.log(share)
        assert benches.forgets(amplitude, period, 7) == pytest.approx(expected, abs=3)
        assert benches.forgets(amplitude[100:], period, 7) == 7


def test_a_motion_that_repeats_after_two_cycles_has_settled_and_has_one_amplitude() -> None:
    """A mass that hits a stop at three times its natural frequency hits it in every other cycle."""
    stop = {"name": "stop", "point": "tip", "friction": 0, "tangential_stiffness": 0, "normal_stiffness": 200}
    scene = {
        "structure": {"modes": [{"frequency": 1, "damping_ratio": 0.02, "mass": 1, "shape": {"tip": [0, 0, 1]}}]},
        "contacts": [stop | {"preload": 0.4}],
        "excitation": {"frequency": 3.2, "modal_force": [{"amplitude": 40}]},
        "study": {"kind": "tradeoff", "amplitude": True},
    }
    model, heights = load_scene(scene).model(), []
    for cycles in (3, 4):
        made = Bench(model, TradeoffPlan(3.2, cycles, 1e-6, FOREVER, amplitude=True), Execution())
        run = made.try_(Solver("tsit5", 1e-7, 1e-9))
        assert run is not None
        assert made.settled_to < 1e-6
        heights.append(run.amplitude[0, 2])
    assert heights[0] == pytest.approx(heights[1], rel=1e-6)


def test_what_has_not_settled_is_said() -> None:
    made = bench([], cycles=3, amplitude=True, budget=1e-9)
    made.model_of(2)
    assert made.settled_to > 1e-6


def test_presets_that_err_alike_are_named_apart() -> None:
    columns = {"seconds_a_cycle": [1.0, 1.2, 9.0], "error": [1e-8, 1e-8, 1e-2], "preset": ["standard", "reference", ""]}
    columns |= {"method": ["tsit5"] * 3, "modes_kept": [2] * 3, "reduced": [1] * 3, "pareto": [1, 0, 0]}
    attrs = {"cycles": 1, "num_modes": 2, "error_wanted": 1e-6, "error_known_to": 1e-8, "recommended_trial": -1}
    variables = {name: ("trial", values) for name, values in columns.items()}
    ax = error_against_time(xarray.Dataset(variables, attrs=attrs | {"judged_by_amplitude": 0}))
    ax.figure.canvas.draw()
    one, other = (text.get_window_extent() for text in ax.texts)
    assert not one.overlaps(other)


def test_an_interrupted_tradeoff_keeps_what_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(made: Bench, settings: dict[str, Any]) -> None:
        two_methods(made, settings)
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "_try_all", interrupted)
    outcome = carry_out(load_scene(CONFIG, {"study.cycles": 20, "study.budget": FOREVER}))
    assert outcome.reason == "interrupted after 3 runs"
    assert outcome.groups[""].sizes["trial"] == 3
    assert outcome.groups[""].attrs["complete"] == 0


def test_what_is_over_the_budget_is_left_out() -> None:
    """Of a single run no error is known, which is what the study is for."""
    outcome = carry_out(load_scene(CONFIG, {"study.cycles": 3, "study.budget": 1e-3}))
    data = outcome.groups[""]
    assert data.sizes["trial"] == 1
    assert data.attrs["complete"] == 0
    assert outcome.reason == data.attrs["reason"]
    assert outcome.reason.startswith(
        "no two runs of the whole scene have come to their ends, so that no error is known "
        "(give it a larger study.budget): no time left: tsit5, rtol 0.0001; "
    )
    assert "one run says nothing of its error" in outcome.summary[-2]
    assert outcome.summary[-1].startswith("left out, no time left: tsit5, rtol 0.0001; tsit5, rtol 1e-05; ")
    assert outcome.summary[-1].count("; ") > 10


def test_of_a_run_in_closed_form_the_accuracy_is_recommended() -> None:
    """It has no method that a scene could name; its run is the truth for the others."""
    judged = [trial(CLOSED_FORM, 1e-7, 0.0, 0.1, preset="draft"), *TRIALS[:6]]
    verdict = judge(bench(judged))
    assert verdict.recommended == 0
    assert verdict.verified == "closed form and tsit5, rtol 1e-11, atol 1e-13"
    one = Dataset({"method": "closed form", "rtol": 1e-7, "preset": "draft"})
    assert block(one) == {"accuracy": "draft"}
