"""The study `jump`: figure 12 of the paper, continuous phase, the run-up, starts from its result, its pictures."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from scipy.integrate import solve_ivp
from simulation import simulate
from systems import oscillator, oscillator_scene

import timesim
from timesim.engine.companion import Companion, estimate
from timesim.engine.trajectory import Phase, Run
from timesim.model import promise
from timesim.model.solver import PRESETS
from timesim.picture import jump as plot_jump
from timesim.picture import transient as plot_transient
from timesim.result import netcdf
from timesim.scene.report import warnings_of
from timesim.study import registry as plot
from timesim.study import transient
from timesim.study.execution.campaign import Execution
from timesim.study.registry import carry_out, load_scene

pytestmark = pytest.mark.long

FIGURE12 = Path(__file__).parents[2] / "configs" / "figure12.yaml"
UPPER, LOWER = 0.4297, 0.2052  # amplitude of x on both branches at 0.9470 Hz, settled marches

SHORT = oscillator_scene(preload=1.0, phase_deg=30.0) | {
    "solver": {"accuracy": "reference"},
    "study": {
        "kind": "jump",
        "run_up": [{"frequency": 0.7, "cycles": 2}, {"frequency": 1.1, "cycles": 3}],
        "phases": [{"frequency": 1.1, "cycles": 1}, {"frequency": 1.6, "cycles": 2}, {"frequency": 0.9, "cycles": 1}],
        "samples_per_cycle": 20,
    },
}
RUN_UP_END = 2 / 0.7 + 3 / 1.1


def scene(**study: Any) -> dict[str, Any]:
    made = copy.deepcopy(SHORT)
    made["study"] |= study
    return made


def linear_amplitude(frequency: float) -> np.ndarray:
    """Amplitude of the tip of figure 12 along x, y, z while the gap stays open."""
    omega, natural = 2 * np.pi * frequency, 2 * np.pi * np.array([0.9, 1.1])
    q = 1 / (natural**2 - omega**2 + 2j * 0.02 * natural * omega)
    return np.abs(np.array([[1, 1], [1, -1], [0.8, 0.6]]) @ q)


@pytest.fixture(scope="module")
def figure12() -> xarray.Dataset:
    return timesim.run(FIGURE12)


@pytest.fixture(scope="module")
def short() -> xarray.Dataset:
    return timesim.run(SHORT)


def test_figure_12_upper_branch_jump_and_stays_below(figure12: xarray.Dataset) -> None:
    assert figure12.attrs["complete"] == 1
    x = figure12.cycle_amplitude.sel(point="tip", axis="x").values
    ends = [part.end for part in plot_jump.phases(figure12)]
    assert [part.frequency for part in plot_jump.phases(figure12)] == [0.93, 0.945, 0.947, 0.947, 0.948, 0.947]
    assert np.diff([0, *ends]).tolist() == [60, 100, 300, 50, 120, 50]
    before, first, second, third = (x[end - 1] for end in ends[2:])
    assert before == pytest.approx(UPPER, abs=1e-4)
    assert first == pytest.approx(UPPER, abs=1e-4)
    assert second == pytest.approx(linear_amplitude(0.948)[0], rel=0.01)
    assert third == pytest.approx(LOWER, abs=1e-4)
    assert np.all(x[ends[3] : ends[3] + 40] > 0.35)  # the jump takes its time


def test_the_lower_branch_is_the_open_gap(figure12: xarray.Dataset) -> None:
    third = figure12.cycle_amplitude.sel(point="tip").values[-1]
    assert third == pytest.approx(linear_amplitude(0.947), rel=1e-4)
    assert linear_amplitude(0.947)[0] == pytest.approx(LOWER, abs=5e-5)
    last_event = float(figure12.event_time[-1])
    start_of_third = float(figure12.cycle_start[-50])
    assert start_of_third - 60 < last_event < start_of_third
    settled = timesim.run(FIGURE12, {"study.phases.1.cycles": 400, "study.samples_per_cycle": 2})
    assert settled.cycle_amplitude.sel(point="tip").values[-51] == pytest.approx(linear_amplitude(0.948), rel=1e-6)


def test_times_of_the_schedule(short: xarray.Dataset) -> None:
    time = short.time.values
    assert time[0] == 0.0
    assert time.size == 4 * 20 + 1
    assert np.diff(time) == pytest.approx(np.repeat(1 / (20 * np.array([1.1, 1.6, 0.9])), [20, 40, 20]))
    assert short.cycle.values.tolist() == list(range(1, 10))
    assert short.cycle_frequency.values.tolist() == [0.7, 0.7, 1.1, 1.1, 1.1, 1.1, 1.6, 1.6, 0.9]
    assert short.cycle_period.values * short.cycle_frequency.values == pytest.approx(1)
    assert short.cycle_start.values[0] == pytest.approx(-RUN_UP_END)
    assert short.cycle_start.values[5] == pytest.approx(0, abs=1e-12)
    assert short.event_time.values[0] < 0 < short.event_time.values[-1]
    assert np.all(np.diff(short.event_time.values) >= 0)
    assert short.cycle_frequency.attrs["units"] == "Hz"


def test_a_run_up_is_as_other_phases_but_for_its_samples(short: xarray.Dataset) -> None:
    whole = timesim.run(scene(run_up=[], phases=[*SHORT["study"]["run_up"], *SHORT["study"]["phases"]]))
    skipped = 5 * 20
    assert whole.time.values[skipped:] == pytest.approx(short.time.values + RUN_UP_END)
    assert np.abs(whole.displacement.values[skipped:] - short.displacement.values).max() < 1e-12
    assert np.abs(whole.cycle_amplitude.values - short.cycle_amplitude.values).max() < 1e-12
    assert whole.event_time.values == pytest.approx(short.event_time.values + RUN_UP_END, abs=1e-9)
    assert whole.event_to.values.tolist() == short.event_to.values.tolist()


def test_the_error_is_estimated_over_all_phases(short: xarray.Dataset) -> None:
    outcome = carry_out(load_scene(SHORT))
    line = next(line for line in outcome.summary if line.startswith("estimated error"))
    assert 1e-14 < short.attrs["estimated_error"] < 1e-9
    assert f"{short.attrs['estimated_error']:.1e}" in line
    assert short.cycle_amplitude_error.shape == (9,)
    assert float(short.cycle_amplitude_error.max()) < 1e-9
    assert short.cycle_amplitude_error.attrs["units"] == "1"
    without = timesim.run(SHORT, {"solver.estimate_error": False})
    assert "estimated_error" not in without.attrs
    assert "cycle_amplitude_error" not in without
    np.testing.assert_array_equal(without.displacement, short.displacement)


def test_a_broken_promise_is_mended_or_else_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a scene that errs more than was foreseen: its tolerances are taken as proportional to its error."""
    monkeypatch.setattr(promise, "GROWTH", 1e-9)
    monkeypatch.setitem(promise.PROMISE, "standard", 1e-8)
    standard = scene() | {"solver": {"accuracy": "standard"}}
    outcome = carry_out(load_scene(standard))
    first, mended = outcome.summary[0], outcome.groups[""]
    assert first.startswith("by tsit5, rtol 1e-07, atol 1e-09 the estimated error is ")
    assert first.endswith(f"above the promised 1e-08: repeated by {mended.attrs['method']}")
    assert mended.attrs["rtol"] < 5e-8
    assert mended.attrs["estimated_error"] < mended.attrs["promised_error"] == 1e-8
    exact = timesim.run(SHORT).final_modal_displacement.values
    true = np.abs(mended.final_modal_displacement.values - exact).max() / np.abs(exact).max()
    assert true < 1e-8
    assert mended.attrs["estimate_remark"] == ""

    monkeypatch.setattr(transient, "AMPLIFIED", 0.1)
    doubted = carry_out(load_scene(standard))
    assert doubted.groups[""].attrs["estimate_remark"].startswith("in doubt: the motion amplifies errors")
    assert any("in doubt" in line for line in doubted.summary)

    monkeypatch.setattr(transient, "tightened", lambda solver, share: solver)
    said = carry_out(load_scene(standard)).summary
    block = next(line for line in said if line.startswith("warning: that is more than the 1e-08"))
    assert "solver: {method: tsit5, rtol: 2.9e-08, atol: 2.9e-10}" in block

    monkeypatch.setattr(transient, "tightened", promise.tightened)
    carried = transient._carried

    def cut_off(*given: Any, first: Any = None) -> Any:
        done = carried(*given, first=first)
        return done if first is None else replace(done, ended="ended in cycle 3")

    monkeypatch.setattr(transient, "_carried", cut_off)
    failed = carry_out(load_scene(standard))
    assert failed.reason is None
    assert failed.groups[""].attrs["repetition"].endswith(": ended in cycle 3")
    ends = "promises; a repetition with finer tolerances did not reach the end"
    assert any(line.endswith(ends) for line in failed.summary)
    assert not any("try solver" in line for line in failed.summary)


def test_a_run_is_whole_where_its_estimate_is_interrupted() -> None:
    def impatient(done: float, number: float, phase: str = "") -> None:
        if phase.startswith("estimating"):
            raise KeyboardInterrupt

    outcome = carry_out(load_scene(SHORT), Execution(progress=impatient))
    assert outcome.reason is None
    assert np.isnan(outcome.groups[""].attrs["estimated_error"])
    assert any("not known, interrupted" in line for line in outcome.summary)


def test_the_companion_of_a_long_run_advances_beside_it() -> None:
    """A batch of steps for each batch of the run; what may be left of it comes after the run."""
    shown: list[str] = []
    long = oscillator_scene(preload=3.0) | {"study": {"kind": "transient", "cycles": 150, "record_last": 1}}
    long["excitation"]["frequency"] = 1.39
    outcome = carry_out(load_scene(long), Execution(progress=lambda *part: shown.append(part[-1])))
    first = next(words for words in shown if words.startswith("estimating"))
    assert int(first.split()[3]) > 100
    alone = simulate(load_scene(long).model(), 150, load_scene(long).solver())
    companion = Companion(alone.run)
    while companion.advance():
        pass
    assert outcome.groups[""].attrs["estimated_error"] == estimate(alone.run, alone.totals, companion).state


@pytest.mark.parametrize("estimated", [True, False])
def test_the_progress_of_a_run_ends_with_all_of_it(estimated: bool) -> None:
    shares: list[float] = []
    solver = {"accuracy": "reference", "estimate_error": estimated}
    carry_out(
        load_scene(SHORT | {"solver": solver}),
        Execution(progress=lambda done, whole, _="": shares.append(done / whole)),
    )
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_the_phase_at_the_end_is_that_of_the_excitation_in_a_whole_turn() -> None:
    """After whole cycles it is that of the start, in the second half of a turn as well."""
    model = oscillator(3.0, 1.39)
    for degrees in (0.0, 30.0, 229.0):
        turned = replace(model, start=replace(model.start, phase=np.deg2rad(degrees)))
        run = Run(turned, [Phase(1.39, 1)], PRESETS["standard"])
        for _ in run.batches():
            pass
        found = float(transient.final_variables(run)["final_phase_deg"][1])
        assert abs((found - degrees + 180) % 360 - 180) < 1e-9


def test_the_phase_of_the_excitation_is_continuous() -> None:
    """Against a march of the modal equations whose force follows the integral of the frequency."""
    free = scene() | {"contacts": []}
    free["excitation"] = {"forces": [{"point": "tip", "direction": [1, 0, 0], "amplitude": 1.0, "harmonic": 2}]}
    result = timesim.run(free)
    parts = [(0.7, 2), (1.1, 4), (1.6, 2), (0.9, 1)]
    natural, state, time = 2 * np.pi * np.array([0.9, 1.1]), np.zeros(4), -RUN_UP_END
    for frequency, cycles in parts:

        def rate(t: float, y: np.ndarray, start: float = time, frequency: float = frequency) -> np.ndarray:
            force = np.cos(2 * 2 * np.pi * frequency * (t - start))
            return np.concatenate([y[2:], force - natural**2 * y[:2] - 0.04 * natural * y[2:]])

        end = time + cycles / frequency
        inside = (result.time.values > time) & (result.time.values < end)
        found = solve_ivp(
            rate, (time, end), state, "DOP853", [*result.time.values[inside], end], rtol=1e-11, atol=1e-13
        )
        expected = found.y[:2].sum(axis=0)[:-1]
        assert result.displacement.sel(point="tip", axis="x").values[inside] == pytest.approx(expected, abs=1e-8)
        state, time = found.y[:, -1], end
    assert result.final_modal_velocity.values == pytest.approx(state[2:], abs=1e-8)


@pytest.mark.parametrize("kind", ["jump", "transient"])
def test_another_run_goes_on_from_a_jump(short: xarray.Dataset, tmp_path: Path, kind: str) -> None:
    begun = carry_out(load_scene(scene(phases=SHORT["study"]["phases"][:2])))
    path = netcdf.save(begun.groups, tmp_path / "result.nc")
    rest = scene(run_up=[], phases=SHORT["study"]["phases"][2:]) | {"initial": {"from": str(path)}}
    if kind == "transient":
        rest["excitation"] = rest["excitation"] | {"frequency": 0.9}
        rest["study"] = {"kind": "transient", "cycles": 1, "samples_per_cycle": 20}
    went_on = timesim.run(rest)
    assert went_on.displacement.values == pytest.approx(short.displacement.values[-21:], abs=1e-8)
    assert went_on.final_slip.values == pytest.approx(short.final_slip.values, abs=1e-8)
    assert float(went_on.final_phase_deg) == pytest.approx(0, abs=1e-9)


def test_the_energies_of_every_cycle_balance(short: xarray.Dataset) -> None:
    assert short.energy_residual.size == 9
    assert np.abs(short.energy_residual).max() < 1e-8 * short.attrs["peak_stored_energy"]


def test_a_run_whose_chosen_method_spends_its_steps_begins_anew_by_collocation(
    short: xarray.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless the scene itself says how many it may take."""
    monkeypatch.setattr(transient, "BUDGET", 60)
    few = SHORT | {"solver": {"accuracy": "standard", "max_steps": 60}}
    outcome = carry_out(load_scene(few))
    assert load_scene(few).solver().name == "tsit5"
    assert outcome.reason is None
    assert any(
        "the 60 steps a cycle are spent in cycle 1: begun anew by exponential" in line for line in outcome.summary
    )
    again = outcome.groups[""]
    assert again.attrs["method"].startswith("exponential")
    assert again.attrs["method_choice"] == "exponential: tsit5, chosen at first, spent its budget of steps"
    assert again.displacement.values == pytest.approx(short.displacement.values, abs=1e-5)


def test_a_path_over_a_sliver_of_its_amplitude_has_short_labels(short: xarray.Dataset) -> None:
    """Where an amplitude changes by parts in a million, its digits would reach over the margin."""
    settled = 0.511395 * (1 - 1e-6 * np.arange(short.sizes["cycle"]))
    ax = plot_jump.path(
        short.assign(cycle_amplitude=short.cycle_amplitude * 0 + xarray.DataArray(settled, dims="cycle"))
    )
    low, high = ax.get_ylim()
    assert high - low == pytest.approx(1e-3 * 0.5114, rel=1e-3)
    assert low < settled.min() < settled.max() < high
    ax.figure.canvas.draw()
    assert max(len(label.get_text()) for label in ax.get_yticklabels()) <= len("0.51140")


def test_a_run_that_fails_in_its_run_up_keeps_what_it_has(tmp_path: Path) -> None:
    outcome = carry_out(load_scene(SHORT | {"solver": {"method": "tsit5", "max_steps": 12}}))
    assert outcome.reason is not None
    assert "budget of 12 steps" in outcome.reason
    assert "at time -" in outcome.reason
    result = netcdf.open_result(netcdf.save(outcome.groups, tmp_path / "result.nc"))
    assert result.attrs["complete"] == 0
    assert result.sizes["time"] == 0
    assert plot.draw(result, tmp_path) == []


def test_the_summary_gives_the_amplitude_of_each_phase() -> None:
    outcome = carry_out(load_scene(SHORT))
    lines, amplitude = outcome.summary, outcome.groups[""].cycle_amplitude.values[:, 0]
    assert [line.split(":")[0] for line in lines[-5:]] == ["run-up", "run-up", "phase 1", "phase 2", "phase 3"]
    assert "2 cycles at 1.6 Hz, amplitude" in lines[-2]
    assert ["those of the cycle before differ by" in line for line in lines[-5:]] == [True, True, False, True, False]
    axis = np.argmax(amplitude.max(axis=0))
    for line, end in zip(lines[-5:], (2, 5, 6, 8, 9), strict=True):
        assert f"amplitude {amplitude[end - 1, axis]:.6g} of tip {'xyz'[axis]} at its end" in line
        change = np.abs(amplitude[end - 1] - amplitude[end - 2]).max() / amplitude[end - 1].max()
        assert "differ by" not in line or line.endswith(f" differ by {change:.1e} of the largest")


def test_the_summary_of_a_transient_gives_the_last_amplitude_and_how_settled_it_is() -> None:
    study = {"kind": "transient", "cycles": 3, "record_last": 1}
    made = SHORT | {"units": {"length": "mm"}, "study": study}
    made["excitation"] = SHORT["excitation"] | {"frequency": 1.1}
    outcome = carry_out(load_scene(made))
    amplitude = outcome.groups[""].cycle_amplitude.values[:, 0]
    axis = np.argmax(amplitude.max(axis=0))
    change = np.abs(amplitude[2] - amplitude[1]).max() / amplitude[2].max()
    assert change > 0.01
    assert outcome.summary[-1] == (
        f"amplitude {amplitude[2, axis]:.6g} mm of tip {'xyz'[axis]} in the last cycle; "
        f"those of the cycle before differ by {change:.1e} of the largest"
    )
    once = carry_out(load_scene(made, {"study.cycles": 1}))
    assert once.summary[-1].endswith("in the last cycle")


def test_the_summary_of_a_run_that_a_static_load_holds_has_no_amplitude_of_rounding() -> None:
    force = {"point": "tip", "direction": [1, 0, 0], "amplitude": 1e-3}
    held = {"frequency": 1.1, "constant_forces": [force]}
    study = {"kind": "transient", "cycles": 3}
    outcome = carry_out(load_scene(SHORT | {"study": study, "excitation": held, "initial": "static"}))
    assert np.abs(outcome.groups[""].displacement.values).max() > 0
    assert outcome.summary[-1] == "nothing moves in the last cycle"


def test_the_summary_warns_of_an_energy_balance_that_does_not_close() -> None:
    """200 steps a cycle are too few for the closed contact: energy appears from nowhere."""
    study = {"kind": "transient", "cycles": 3}
    made = oscillator_scene(preload=3.0) | {"study": study, "solver": {"method": "rk4"}}
    stiff = {"contacts.pad.normal_stiffness": 1e6, "excitation.frequency": 1.39}
    assert "warning: energy balance of a cycle closes to" in carry_out(load_scene(made, stiff)).summary[1]
    right = carry_out(load_scene(made, stiff | {"solver.steps_per_cycle": 800})).summary
    assert right[1].startswith("energy balance of a cycle closes to")


def test_the_resolved_scene_runs_again_and_an_unused_frequency_is_reported() -> None:
    loaded = load_scene(SHORT)
    assert load_scene(loaded.resolved_yaml()).file == loaded.file
    warnings = list(warnings_of(load_scene(SHORT, {"excitation.frequency": 1.0})))
    assert any("excitation.frequency is not used" in line for line in warnings)


def test_stretches_part_equal_frequencies_at_time_zero(short: xarray.Dataset) -> None:
    expected = [(0, 2, 0.7, True), (2, 5, 1.1, True), (5, 6, 1.1, False), (6, 8, 1.6, False), (8, 9, 0.9, False)]
    assert plot_jump.phases(short) == expected
    assert plot_jump.phases(short.isel(cycle=slice(0, 0))) == []


def test_the_envelope_over_the_schedule(short: xarray.Dataset) -> None:
    ax = plot_jump.envelope(short)
    curves = {line.get_label(): line for line in ax.get_lines()}
    assert set(curves) >= {"tip x", "tip y", "tip z"}
    assert np.array_equal(curves["tip x"].get_ydata(), short.cycle_amplitude.sel(point="tip", axis="x"))
    assert [line.get_xdata()[0] for line in ax.get_lines()[3:]] == [2.5, 5.5, 6.5, 8.5]
    (shaded,) = ax.patches
    assert (shaded.get_x(), shaded.get_width(), shaded.get_label()) == (0.5, 5.0, "run-up")


def test_the_frequency_over_the_schedule(short: xarray.Dataset) -> None:
    ax = plot_jump.frequency(short)
    steps = ax.patches[0].get_data()
    assert steps.values.tolist() == [0.7, 1.1, 1.1, 1.6, 0.9]
    assert steps.edges.tolist() == [0.5, 2.5, 5.5, 6.5, 8.5, 9.5]
    assert [text.get_text().strip() for text in ax.texts] == ["0.7", "1.1", "1.1", "1.6", "0.9"]


def test_the_path_joins_the_ends_of_the_phases(figure12: xarray.Dataset) -> None:
    ax = plot_jump.path(figure12, point="tip", axis="x")
    curves = {line.get_label(): line for line in ax.get_lines()}
    assert len(curves["a cycle"].get_xdata()) == 220
    f, a = curves["end of a phase"].get_data()
    assert f.tolist() == [0.947, 0.948, 0.947]
    assert a == pytest.approx([UPPER, linear_amplitude(0.948)[0], LOWER], rel=0.01)
    assert curves["end of the run-up"].get_ydata()[0] == pytest.approx(UPPER, abs=1e-4)
    assert [text.get_text() for text in ax.texts if text.get_text()] == ["1", "2", "3"]
    assert len(ax.texts) == 5  # two arrows: the end of the run-up is where phase 1 ends


def test_ends_of_phases_at_one_place_are_numbered_together(short: xarray.Dataset) -> None:
    amplitude = xarray.DataArray([3.0, 3, 3, 3, 3, 2, 3, 1, 1], dims="cycle") * (short.cycle_amplitude * 0 + 1)
    frequency = [0.7, 0.7, 1.1, 1.1, 1.1, 1.1, 1.6, 1.6, 1.1]
    ax = plot_jump.path(short.assign(cycle_amplitude=amplitude, cycle_frequency=("cycle", frequency)))
    assert [text.get_text() for text in ax.texts if text.get_text()] == ["1", "2", "3"]
    amplitude[-1] = 2.01
    ax = plot_jump.path(short.assign(cycle_amplitude=amplitude, cycle_frequency=("cycle", frequency)))
    assert [text.get_text() for text in ax.texts if text.get_text()] == ["1, 3", "2"]


def test_displacement_leaves_the_run_up_out(short: xarray.Dataset) -> None:
    ax = plot_transient.displacement(short, point="tip", axis="x")
    edges = ax.patches[0].get_data().edges
    assert edges == pytest.approx([0, 1 / 1.1, 1 / 1.1 + 1 / 1.6, 1 / 1.1 + 2 / 1.6, 1 / 1.1 + 2 / 1.6 + 1 / 0.9])
    changes = [line.get_xdata()[0] for line in ax.get_lines()[1:]]
    assert changes == pytest.approx([edges[1], edges[3]])


def test_all_pictures_of_a_jump(short: xarray.Dataset, tmp_path: Path) -> None:
    names = [file.name for file in plot.draw(short, tmp_path)]
    assert names == plot.picture_names("jump")
    assert names[:3] == ["displacement.png", "envelope.png", "path.png"]
    begun = short.isel(cycle=slice(0, 5), time=slice(0, 3)).assign_attrs(complete=0)
    assert len(plot.draw(begun, tmp_path)) == len(names) - 1
    nothing = short.isel(cycle=slice(0, 0), time=slice(0, 3)).assign_attrs(complete=0)
    shown = {file.name for file in plot.draw(nothing, tmp_path)}
    assert set(names) - shown == {"path.png", "spectrum.png", "energy.png"}  # these need a whole cycle
