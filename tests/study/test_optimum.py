"""The preload of least peak response, to the accuracy asked for; the search on known peaks."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import CONFIGS, run_of_config
from systems import oscillator

import timesim
from timesim.model.contact_state import contact_loads
from timesim.model.model import SEPARATION, SLIP, STICK, Start
from timesim.model.solver import PRESETS, Criterion
from timesim.orbit.settling import Chain, steady_states
from timesim.orbit.steady_state import Orbit, blank_columns, without_orbit
from timesim.picture import optimum as plot_optimum
from timesim.result.file import StoreError
from timesim.scene.study import SweepPlan
from timesim.scene.sweep import OptimumPlan
from timesim.study import registry as plot
from timesim.study.execution.campaign import Chunk, Execution
from timesim.study.optimum import peak as own_peak
from timesim.study.optimum import search
from timesim.study.optimum.peak import Motion, Response, _peak, begin_from
from timesim.study.optimum.search import Peaks, SearchError
from timesim.study.optimum.study import data_of
from timesim.study.registry import carry_out, load_scene
from timesim.study.summary.optimum import jumps_beside, optimum_lines

pytestmark = pytest.mark.long

KEY = "contacts.pad.preload"
QUICK = {
    "study.along": "{contacts.pad.preload: {from: 3.2, to: 4.4, num: 4}}",
    "study.frequency": "{from: 1.36, to: 1.56, step: 0.05}",
    "study.accuracy": "0.05",
    "study.settle": "{tolerance: 1e-6, max_cycles: 1000}",
    "solver.accuracy": "draft",
}


folder, result = run_of_config("preload.yaml", QUICK)


def test_the_preload_of_least_peak(result):
    assert float(result["optimum"]) == pytest.approx(3.648, abs=0.05)
    assert float(result["optimum_peak"]) == pytest.approx(0.139481, rel=2e-4)
    assert float(result["optimum_frequency"]) == pytest.approx(1.4615, abs=5e-3)
    assert float(result["peak"].min()) == float(result["optimum_peak"])


def test_the_peaks_beside_the_optimum_are_not_smaller(result):
    values, best = result[KEY].values, float(result["optimum"])
    assert np.all(np.diff(values) > 0)
    for value in (best - 0.05, best + 0.05):
        assert np.min(np.abs(values - value)) < 1e-12
    assert float(result["optimum_peak"]) <= result["peak"].values.min()


def test_a_peak_lies_between_the_points_of_the_sweep(result):
    largest = result["amplitude"].sel(point="tip", axis="x").max(("direction", "frequency")).values
    assert np.all(result["peak"].values >= largest)
    assert np.max(result["peak"].values / largest - 1) > 1e-3
    place = np.argmin(np.abs(result[KEY].values - 3.6))
    value, frequency = float(result[KEY][place]), float(result["peak_frequency"][place])
    chain = Chain(oscillator(value, frequency), (frequency,))
    ((orbit,),) = steady_states([chain], PRESETS["standard"], Criterion())
    assert float(result["peak"][place]) == pytest.approx(orbit.amplitude[0, 0], rel=1e-4)


def test_its_points_are_those_of_a_sweep(result):
    """The phase falls through resonance, what slips loses power, and a run may start from any of them."""
    phase = result["phase_deg"].sel(point="tip", axis="x", direction="up")
    assert phase.dims == (KEY, "frequency")
    assert np.all(phase[:, 0] > phase[:, -1])
    lost, slips = (result[name].sel(contact="pad").values for name in ("dissipated_power", "slip_share"))
    assert np.all((lost > 0) == (slips > 0))
    assert lost.max() > 0.1
    assert np.all(np.isfinite(result["final_modal_displacement"]))


def test_both_sweeps_of_one_motion_have_its_amplitude_at_the_same_frequencies(result):
    """There is one motion at each of them, so that it does not matter from where it is come to."""
    up, down = (result["amplitude"].sel(direction=direction).values for direction in ("up", "down"))
    assert np.ptp(up[0, :, 0, 0]) > 0.1 * up.max()
    np.testing.assert_allclose(down, up, rtol=1e-4, atol=1e-6)


def test_the_summary_and_the_pictures(folder, result):
    said = (folder / "said").read_text()
    assert f"at {KEY} = {float(result['optimum']):.6g}" in said
    assert "an accuracy away the peak is not smaller" in said
    assert {path.name for path in (folder / "run").glob("*.png")} == set(plot.picture_names("optimum"))
    ax = plot_optimum.peak(result)
    (star,) = [line for line in ax.get_lines() if line.get_marker() == "*"]
    assert np.ravel(star.get_xydata()).tolist() == [float(result["optimum"]), float(result["optimum_peak"])]
    curves = plot_optimum.responses(result).get_lines()
    assert any("the least" in str(line.get_label()) for line in curves)


@pytest.mark.slow
def test_an_optimum_at_the_end_of_the_range(tmp_path: Path):
    given = QUICK | {"study.along": "{contacts.pad.preload: {from: 5.0, to: 5.4, num: 3}}"}
    scene = load_scene(CONFIGS / "preload.yaml", [f"{key}={value}" for key, value in given.items()])
    execution = Execution(folder=tmp_path, notice=lambda text: None)
    outcome = carry_out(scene, execution)
    assert outcome.reason is None
    assert any("at an end of the range" in line for line in outcome.summary)
    cut = outcome.groups[""].assign_attrs(complete=0)
    assert not any("at an end of the range" in line for line in optimum_lines(cut, 1e-3)), "of what has been computed"
    record = outcome.groups[""]
    assert float(record["optimum"]) == 5.0
    (tmp_path / "checkpoint" / "value-00001.npz").unlink()
    (tmp_path / "checkpoint" / "search-001" / "value-00000.npz").unlink()
    again = carry_out(scene, replace(execution, resume=True)).groups[""]
    for name in record.variables:
        np.testing.assert_array_equal(again[name], record[name])


def test_a_motion_to_which_no_sweep_comes_goes_on_from_a_value_beside(tmp_path: Path):
    """With a gap of 4.2 rest leads to the motion of the open contact; the larger one lives on from a gap of 4."""
    given = QUICK | {
        "study.along": "{contacts.pad.preload: {from: -4.2, to: -3.8, num: 3}}",
        "study.frequency": "{values: [0.944, 0.9445, 0.945]}",
        "study.axis": "y",
        "study.accuracy": "0.2",
    }
    scene = load_scene(CONFIGS / "preload.yaml", [f"{key}={value}" for key, value in given.items()])
    execution = Execution(folder=tmp_path, notice=lambda text: None)
    outcome = carry_out(scene, execution)
    assert outcome.reason is None
    assert any("at 1 value no sweep comes to the motion of the peak" in line for line in outcome.summary)
    data = outcome.groups[""]
    assert data["peak_carried"].values.tolist() == [1] + [0] * (data.sizes[KEY] - 1)
    swept = data["amplitude"].sel(point="tip", axis="y")
    place, frequency = {KEY: -4.0, "frequency": 0.944}, 0.944
    start = end_state(swept.sel(place).argmax("direction").item(), data, place)
    chain = Chain(replace(oscillator(-4.2, frequency), start=start), (frequency,))
    ((orbit,),) = steady_states([chain], PRESETS["standard"], Criterion())
    assert swept.sel({KEY: -4.2, "frequency": 0.944}).max() < 0.7 * orbit.amplitude[0, 1]
    assert float(data["peak"][0]) > (1 - 1e-4) * orbit.amplitude[0, 1]
    assert float(data["optimum"]) == -3.8
    (tmp_path / "checkpoint" / "carried-001" / "motions.npz").unlink()
    again = carry_out(scene, replace(execution, resume=True)).groups[""]
    for name in data.variables:
        np.testing.assert_array_equal(again[name], data[name])


@pytest.mark.parametrize(("preload", "state"), [(60.0, STICK), (3.0, SLIP), (2.0, SLIP), (-9.0, SEPARATION)])
def test_a_state_is_carried_over_with_its_force_in_the_cone(preload: float, state: int):
    """Of a contact that slips at a preload of 3: it sticks under more, and slips in the same direction under less."""
    before, model = oscillator(3.0, 1.39), oscillator(preload, 1.39)
    ((orbit,),) = steady_states([Chain(before, (1.39,))], PRESETS["draft"], Criterion(1e-6, 1000))
    own = contact_loads(before, orbit.end.displacement, orbit.end.slip)
    slip = own.motion - own.limit / own.size * (own.motion - orbit.end.slip)  # on the cone there
    end = replace(orbit.end, slip=slip, state=np.array([SLIP]))
    start = begin_from(model, end)
    loads = contact_loads(model, start.displacement, start.slip)
    assert start.state.tolist() == [state]
    assert loads.size == pytest.approx(np.minimum(own.limit, loads.limit), rel=1e-9)
    np.testing.assert_allclose(loads.force * own.size, own.force * loads.size, atol=1e-9)
    np.testing.assert_array_equal(start.displacement, end.displacement)
    still = replace(end, displacement=np.zeros(2), velocity=np.zeros(2), slip=np.zeros((1, 2)))
    with np.errstate(all="raise"):
        np.testing.assert_array_equal(begin_from(model, still).slip, 0.0)


def end_state(direction: int, data: Any, place: dict[str, float]) -> Start:
    """The state that a result holds of a point of one of its sweeps."""
    here = data.isel(direction=direction).sel(place)
    names = ("final_modal_displacement", "final_modal_velocity", "final_slip", "final_contact_state")
    return Start(*(here[name].values for name in names), 0.0)


def test_an_optimum_of_points_that_all_fail_says_so():
    given = QUICK | {"solver.max_steps": "20"}
    outcome = carry_out(load_scene(CONFIGS / "preload.yaml", [f"{key}={value}" for key, value in given.items()]))
    data = outcome.groups[""]
    assert "no steady state was found at any value of contacts.pad.preload: at 1.36 Hz" in outcome.reason
    assert "budget of 20 steps" in outcome.reason
    assert data.attrs["complete"] == 0
    assert np.isnan(data["optimum"])
    assert (data["failure"] != "").all()
    assert len(outcome.summary) == 1


# The search, on peaks that are known


class Known(Peaks):
    """Peaks by a formula; `computed` are the values asked for.

    ``stays(value, size)``: the peak of a motion carried over to a value from beside, where it is of a size; None where
    it is lost.
    """

    def __init__(self, formula, accuracy: float = 1e-3, stays=lambda value, size: None):
        keys = {"study.along": {KEY: {"from": 0.0, "to": 10.0, "num": 11}}, "study.accuracy": accuracy}
        super().__init__(load_scene(CONFIGS / "preload.yaml", keys), Execution())
        self.formula, self.computed, self.stays = formula, [], stays

    def motions(self, value: float, least: float) -> tuple[Motion, ...]:
        return (Motion(float(self.results[value]["peak"]), 0, self.scene.model().start),)

    def carry(self, carried: Any, stage: str) -> Any:
        value, (motion,) = carried.response.model.contacts[0].preload, carried.motions
        peak = self.stays(value, motion.size)
        return {} if peak is None else {"peak": np.array(peak), "peak_carried": np.array(1)}

    def take(self, values: list[float], stage: str) -> None:
        for value in values:
            self.computed.append(value)
            shape = (2, self.frequency.size)
            self.results[value] = blank_columns(self.scene.model(), *shape) | {
                "peak": np.array(self.formula(value)), "peak_at_end": np.array(0), "peak_settled": np.array(1),
                "peak_irregular": np.array(0),
                "peak_of": np.array(0), "peak_carried": np.array(0),
                "peak_frequency": np.array(1.0), "cycles": np.zeros(shape, int), "settled": np.ones(shape, bool),
                "amplitude": np.full((*shape, 1, 3), self.formula(value)),
                "reason": np.full(shape, "it broke" if np.isnan(self.formula(value)) else ""),
            }  # fmt: skip


def test_a_stage_that_cannot_be_kept_ends_the_search_and_keeps_the_values(monkeypatch: pytest.MonkeyPatch):
    """The first values are begun before anything is computed: there is nothing to keep yet."""
    peaks = Peaks(load_scene(CONFIGS / "preload.yaml"), Execution())

    def full(*_: Any, **__: Any) -> Any:
        raise StoreError("no space left")

    monkeypatch.setattr(search, "carry_through", full)
    with pytest.raises(SearchError, match="no space left"):
        peaks.take([3.3], "search-001")
    with pytest.raises(StoreError):
        peaks.take([3.3], "")


@pytest.mark.parametrize(("unit", "smaller"), [(1.0, 0.3), (1e-9, 0.3), (1.0, 0.97)])
def test_both_motions_at_a_frequency_are_refined_in_any_unit(
    unit: float, smaller: float, monkeypatch: pytest.MonkeyPatch
):
    """That of the sweep up is smaller where that of the sweep down peaks."""
    scene = load_scene(CONFIGS / "preload.yaml")
    response, count = Response(scene.model(), scene.plan, scene.solver()), scene.plan.sweep.frequency.size
    up, down = np.full(count, 0.3), np.full(count, 0.5)
    up[2], down[2] = smaller, 1.0
    monkeypatch.setattr(Response, "size", lambda _, orbit: orbit.largest)
    model, refined = scene.model(), list[int]()
    orbits = [[replace(without_orbit(model, ""), amplitude=np.full((1, 3), unit * size)) for size in own]
              for own in (up, down)]  # fmt: skip
    monkeypatch.setattr(own_peak, "_refined", lambda _, orbit, i: (refined.append(i), own_peak.Peak(-np.inf))[1])
    assert _peak(response, orbits).peak == pytest.approx(unit)
    assert refined == ([2, 2] if smaller > own_peak.NEARLY else [2])


def test_the_point_and_axis_of_a_peak_are_among_those_that_count():
    scene = load_scene(CONFIGS / "preload.yaml")
    model = scene.model()
    orbit = replace(without_orbit(model, ""), amplitude=np.array([[0.3, 0.7, 0.5]]))
    for point, axis, size, place in ((None, None, 0.7, 1), ("tip", "z", 0.5, 2), (None, "x", 0.3, 0)):
        response = Response(model, replace(scene.plan, point=point, axis=axis), scene.solver())
        assert (response.size(orbit), response.place(orbit)) == (size, place)
    still = replace(orbit, amplitude=np.array([[0.3, 0.7, 0.0]]))
    response = Response(model, replace(scene.plan, point=None, axis="z"), scene.solver())
    assert (response.size(still), response.place(still)) == (0.0, 2)


@pytest.mark.parametrize("best", [3.64836, 0.5, 9.9996, 7.0])
@pytest.mark.parametrize("power", [1, 2, 4])
def test_the_least_peak_to_the_accuracy(best: float, power: int):
    peaks = Known(lambda value: 0.1 + abs(value - best) ** power)
    peaks.search()
    # A flat minimum is known no better than its peaks differ by more than those of the time integration do.
    assert abs(peaks.least() - best) < (1e-3 if power < 4 else 3e-2)
    assert len(peaks.computed) < 45
    assert len(set(peaks.computed)) == len(peaks.computed)


def test_the_least_of_two_valleys_counts():
    peaks = Known(lambda value: min(1 + (value - 2.2) ** 2, 0.9 + (value - 7.3) ** 2))
    peaks.search()
    assert peaks.least() == pytest.approx(7.3, abs=1e-3)


def test_a_peak_that_is_the_same_over_a_span_is_told_and_drawn_so():
    """As where a contact sticks from a preload on."""
    peaks = Known(lambda value: 2.8 + max(0.0, 5.3 - value) ** 2)
    peaks.search()
    data = data_of(peaks).assign_attrs(complete=1)
    assert len(peaks.computed) <= len(peaks.values) + 4
    (line,) = [line for line in optimum_lines(data, 1e-3) if "the peak is the same" in line]
    first, last = (float(word.strip(":")) for word in (line.split()[6], line.split()[8]))
    assert 5.2 < first < 6.1
    assert last == 10
    for share, told in ((3.1, True), (2.9, False)):  # a span of three accuracies is that of the search itself
        lines = optimum_lines(data, (last - first) / share)
        assert any("the peak is the same" in line for line in lines) == told
    units = {"peak": data["peak"].assign_attrs(units="mm"), KEY: data[KEY].assign_attrs(units="N")}
    said = list(optimum_lines(data.assign(peak=units["peak"]).assign_coords({KEY: units[KEY]}), 1e-3))
    assert any("to 10 N: any value between" in line for line in said)
    assert any(line.startswith("least peak 2.8 mm of tip x at ") for line in said)
    assert all(ax.get_xlabel().startswith("pad preload") for ax in plot_optimum.PICTURES["peak"](data).axes)
    low, high = plot_optimum.magnified(data).get_ylim()
    assert high - low > 1e-4 * 2.8


@pytest.mark.parametrize("sign", [1, -1])
def test_a_peak_that_jumps_beside_the_least_one_is_told(sign: int):
    """A motion that the sweeps of one value come to is lost at the next, or may go on there if it does not repeat."""
    peaks = Known(lambda value: 1 + 0.1 * abs(value - 5.3) if sign * (value - 5.3) >= 0 else 3 + 0.1 * abs(value - 5.3))
    peaks.search()
    data = data_of(peaks).assign_attrs(complete=1)
    (line,) = [line for line in optimum_lines(data, 1e-3) if "jumps" in line]
    assert re.match(rf"the peak jumps beside it, to 3(\.\d+)? at {KEY} = 5\.(29|30)\d*, at 1 Hz: carried over", line)
    data["peak_settled"][:] = 0
    assert any("may go on at the least peak" in line for line in optimum_lines(data, 1e-3))
    assert not any("jumps" in text for text in optimum_lines(data.assign_attrs(complete=0), 1e-3))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("end", [2.7, 4.9996, -1.0])
def test_a_motion_that_goes_on_from_beside_counts(sign: int, end: float):
    """The sweeps come to it from 5.3 on; it lives on to `end`, where the peak falls, or beyond the range."""

    def smaller(value: float) -> float:
        return 1 + 0.1 * (value if sign > 0 else 10 - value)

    def larger(value: float) -> float:
        return 3 + 0.05 * abs(value - (5.3 if sign > 0 else 4.7))

    def here(value: float) -> float:
        return value if sign > 0 else 10 - value

    peaks = Known(
        lambda value: larger(value) if here(value) > 5.3 else smaller(value),
        stays=lambda value, size: larger(value) if here(value) > end else None,
    )
    peaks.search()
    least = here(peaks.least())
    assert least == pytest.approx(0 if end > 0 else 5.3, abs=2e-3)
    for value, result in peaks.results.items():
        assert float(result["peak"]) == (larger(value) if here(value) > end else smaller(value))
        assert bool(result["peak_carried"]) == (end < here(value) <= 5.3)
    lines = list(optimum_lines(data_of(peaks).assign_attrs(complete=1), 1e-3))
    assert any("no sweep comes to the motion of the peak" in line for line in lines)


@pytest.mark.parametrize("power", [0.5, 1, 2])
@pytest.mark.parametrize("best", [3.64836, 9.9996])
def test_a_peak_that_rises_beside_the_least_one_does_not_jump(best: float, power: float):
    peaks = Known(lambda value: 0.1 + abs(value - best) ** power)
    peaks.search()
    assert not any("jumps" in line for line in optimum_lines(data_of(peaks).assign_attrs(complete=1), 1e-3))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("values", "peak", "jumps"), [((0, 10, 11), (1, 11, 12), []), ((0, 1, 11), (1, 3, 4), [1]), ((0, 1), (1, 3), [])]
)
def test_a_rise_is_judged_by_the_length_over_which_it_goes_on(sign: int, values: Any, peak: Any, jumps: list[int]):
    """Bisected values are not evenly apart."""
    at, beside = (0, jumps) if sign > 0 else (len(values) - 1, [len(values) - 1 - i for i in jumps])
    assert jumps_beside(sign * np.array(values, float)[::sign], np.array(peak, float)[::sign], at) == beside


def test_peaks_that_are_rounding_are_the_same():
    """As of what is behind a clutch that slips all the time: it moves on evenly."""
    noise = np.random.default_rng(1)
    peaks = Known(lambda value: 1e-14 * noise.random() if value < 5.3 else value - 5.3)
    peaks.search()
    data = data_of(peaks).assign_attrs(complete=1)
    assert len(peaks.computed) <= len(peaks.values) + 4
    lines = list(optimum_lines(data.assign(peak_at_end=data["peak_at_end"] + 1), 1e-3))
    assert any("the peak is the same from 0 to 5" in line for line in lines)
    assert "that is rounding beside the largest peak: nothing vibrates there" in lines
    assert not any("at an end of frequency" in line for line in lines)


def test_values_near_each_other_have_labels_of_their_own():
    peaks = Known(lambda value: 0.1 + (value - 5.00001) ** 2, accuracy=1e-5)
    peaks.search()
    labels = [str(line.get_label()) for line in plot_optimum.responses(data_of(peaks)).get_lines()]
    assert {"5", "5.00001, the least"} < set(labels)


def test_a_search_that_is_cut_off_says_what_is_done(monkeypatch: pytest.MonkeyPatch):
    """Of the values, not of the points of the one that was under way alone."""
    cut, known = "interrupted; 12 of 12 points missing", Known(lambda value: (value - 3.3) ** 2)
    done = [5]

    def carried(chunks: list[Chunk], *_: Any, stage: str, **__: Any) -> tuple[dict[str, Any], str | None]:
        if stage:
            return {}, cut
        known.take(list(known.values[: done[0]]), "")
        results = [known.results[value] for value in known.values[: done[0]]]
        return dict(zip([chunk.name for chunk in chunks], results, strict=False)), None if done[0] > 5 else cut

    monkeypatch.setattr(search, "carry_through", carried)
    for number, said in (
        (5, f"{cut}; 5 of 11 values of {KEY} are done and kept"),
        (11, f"{cut} at {KEY} = 2.76393; 11 other values are done and kept"),
    ):
        done[0] = number
        with pytest.raises(SearchError, match=re.escape(said)):
            Peaks(known.scene, Execution()).search()


def test_a_search_that_is_cut_off_as_a_motion_is_carried_on_says_so(monkeypatch: pytest.MonkeyPatch):
    peaks = Known(lambda value: 1.0 if value < 4.5 else 2.0)
    monkeypatch.setattr(search, "carry_through", lambda *_, **__: ({}, "interrupted; 1 of 1 points missing"))
    monkeypatch.setattr(Known, "carry", Peaks.carry)
    with pytest.raises(SearchError, match=rf"^interrupted; .* missing, as a motion was carried on from .* of {KEY} to"):
        peaks.search()
    assert len(peaks.results) == 11


def test_an_interrupt_between_two_values_keeps_those_that_are_done(monkeypatch: pytest.MonkeyPatch):
    """As where the model of the next value is made."""

    def interrupted(peaks: Peaks) -> None:
        done = Known(lambda value: (value - 3.3) ** 2)
        done.take([3.0, 4.0], "")
        peaks.results.update(done.results)
        raise KeyboardInterrupt

    monkeypatch.setattr(Peaks, "search", interrupted)
    outcome = carry_out(Known(lambda value: value).scene)
    assert outcome.reason == outcome.groups[""].attrs["reason"] == "interrupted; 2 values are done and kept"
    assert outcome.groups[""][KEY].values.tolist() == [3, 4]


def test_a_value_without_a_motion_is_named():
    peaks = Known(lambda value: np.nan if 3.1 < value < 3.9 else (value - 3.5) ** 2)
    with pytest.raises(SearchError, match=r"no steady state was found at contacts.pad.preload = 3\.\d+: it broke"):
        peaks.search()
    lines = list(optimum_lines(data_of(peaks).assign_attrs(complete=0), 1e-3))
    assert any("least peak 0.25 of tip x so far, at " in line for line in lines)
    assert not any("not smaller" in line for line in lines)


def test_the_kind_of_a_motion_without_a_period_is_named():
    """Of the least peak, and of the points of the sweeps."""
    peaks = Known(lambda value: (value - 3) ** 2)
    peaks.search()
    peaks.results[3.0]["settled"][0, 2:4], peaks.results[3.0]["irregular"][0, 2] = False, 1
    for settled, irregular, said in ((1, 0, None), (0, 0, "its motion had not settled"), (0, 1, "its motion does not")):
        peaks.results[3.0] |= {"peak_settled": np.array(settled), "peak_irregular": np.array(irregular)}
        lines = list(optimum_lines(data_of(peaks).assign_attrs(complete=1), 1e-3))
        of_peak = [line for line in lines if line.startswith("its motion")]
        assert len(of_peak) == (said is not None)
        assert all(line.startswith(said) for line in of_peak)
        points = [line for line in lines if f"{KEY} 3, direction up: at 1.1" in line]
        assert "1 point does not repeat" in points[0]
        assert "1 point did not settle" in points[1]


def test_the_size_of_a_response():
    model = oscillator(3.0, 1.4)
    amplitude = np.array([[0.1, 0.3, 0.2]])
    orbit = replace(without_orbit(model, ""), amplitude=amplitude, reason=None)
    for point, axis, size in ((None, None, 0.3), ("tip", "x", 0.1), ("tip", None, 0.3), (None, "z", 0.2)):
        sweep = SweepPlan(np.array([1.4]), ("up", "down"), {KEY: (3.0, 4.0)}, Criterion(), None)
        plan = OptimumPlan(sweep, 0.1, point, axis)
        assert Response(model, plan, PRESETS["draft"]).size(orbit) == size


@pytest.mark.parametrize(
    ("best", "at_end", "most"), [(1.03, False, 20), (1.97, False, 20), (0.8, True, 1), (2.5, True, 1)]
)
def test_a_peak_in_the_first_or_last_step(best: float, at_end: bool, most: int, monkeypatch: pytest.MonkeyPatch):
    """It is sought there too, at the cost of one point where the response only falls from the end on."""
    model = oscillator(3.0, 1.4)
    frequency = np.linspace(1.0, 2.0, 11)
    sweep = SweepPlan(frequency, ("up", "down"), {KEY: (3.0, 4.0)}, Criterion(), None)
    computed: list[float] = []

    def steady(*chains: Chain) -> list[list[Orbit]]:
        computed.extend(f for chain in chains for f in chain.frequencies)
        return [
            [
                replace(without_orbit(model, ""), amplitude=np.full((1, 3), 2 - (f - best) ** 2), reason=None, period=1)
                for f in chain.frequencies
            ]
            for chain in chains
        ]

    monkeypatch.setattr(Response, "steady", lambda self, *chains: steady(*chains))
    chain = Chain(model, tuple(map(float, frequency)))
    orbits = steady(chain, chain)
    computed.clear()
    found = _peak(Response(model, OptimumPlan(sweep, 0.1, None, None), PRESETS["draft"]), orbits)
    assert found.peak_at_end == at_end
    assert len(computed) <= most
    assert found.peak_frequency == pytest.approx(np.clip(best, 1.0, 2.0), abs=2e-4)


def test_a_peak_at_the_end_of_a_branch_that_longer_steps_lose(monkeypatch: pytest.MonkeyPatch):
    """The branch rises down to 1.23 Hz; the sweep down has lost it at 1.4 Hz already, as a step above 0.07 Hz does."""
    model = oscillator(3.0, 1.4)
    frequency, fold, longest = np.linspace(1.0, 2.0, 11), 1.23, 0.07
    sweep = SweepPlan(frequency, ("up", "down"), {KEY: (3.0, 4.0)}, Criterion(), None)

    def orbit_at(f: float, upper: bool) -> Orbit:
        """Its end has a phase that stands for the frequency on the upper branch, for none on the lower one."""
        end = replace(model.start, phase=f if upper else 0.0)
        size = np.full((1, 3), 3.0 - f if upper else 0.1)
        return replace(without_orbit(model, ""), amplitude=size, end=end, reason=None, period=1)

    def steady(self: Response, chain: Chain) -> list[list[Orbit]]:
        ((f,), before) = chain.frequencies, chain.model.start.phase
        return [[orbit_at(f, f >= fold and abs(f - before) <= longest)]]

    monkeypatch.setattr(Response, "steady", steady)
    orbits = [[orbit_at(float(f), bool(f > lost)) for f in frequency] for lost in (9.9, 1.45)]
    found = _peak(Response(model, OptimumPlan(sweep, 0.1, None, None), PRESETS["draft"]), orbits)
    assert found.peak == pytest.approx(3.0 - fold, abs=2e-4)
    assert found.peak_frequency == pytest.approx(fold, abs=2e-4)
    assert not found.peak_at_end


@pytest.mark.slow
def test_the_preload_of_the_papers_oscillator():
    data = timesim.run(CONFIGS / "preload.yaml")
    assert float(data["optimum"]) == pytest.approx(3.64836, abs=1e-3)
    assert float(data["optimum_peak"]) == pytest.approx(0.1394811526, rel=1e-6)
    for preload, peak in ((3.0, 0.156), (5.0, 0.157)):
        assert float(data["peak"].sel({KEY: preload})) == pytest.approx(peak, abs=5e-4)
