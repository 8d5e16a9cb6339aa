"""The study `sweep`: what its result holds, against settled amplitudes computed by others; jumps; what goes wrong."""

import copy
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
import xarray
from scipy.integrate import solve_ivp
from systems import oscillator_scene
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.fault import SceneError
from timesim.orbit.linear import linear_orbit
from timesim.orbit.settling import Chain, GivenUpError, first_lane, steady_states
from timesim.orbit.steady_state import SAME, without_orbit
from timesim.orbit.threshold import UNSETTLED_CYCLES
from timesim.picture import sweep as plot_sweep
from timesim.result.netcdf import read, save
from timesim.study import sweep
from timesim.study.execution.campaign import Execution
from timesim.study.outcome import attributes
from timesim.study.registry import carry_out, load_scene
from timesim.study.summary.sweep import anew_lines, jump_lines, peak_lines, sweep_lines, unusual_lines

pytestmark = pytest.mark.long

DATA = Path(__file__).parents[1] / "data"
CONFIGS = Path(__file__).parents[2] / "configs"
PRELOAD = "contacts.pad.preload"

OSCILLATOR = oscillator_scene(preload=3.0)

# Settled amplitudes of x by preload and frequency: marches with located events (DOP853, rtol 1e-12) until they repeat.
SETTLED = {(3.0, 1.39): 0.15612878, (-1.0, 0.97): 0.28839155, (5.0, 1.52): 0.15680399}
# Ends of the range of two motions at preloads -4 and 2, and the amplitudes of x in it: settled marches of 800 cycles a
# step of 1e-4 Hz, by the same method.
GAP_UP, GAP_DOWN, SOFT_UP, SOFT_DOWN = (0.9472, 0.9473), (0.9415, 0.9416), (1.2560, 1.2561), (1.2510, 1.2511)
UPPER, LOWER, BEYOND = 0.4297, 0.2052, 0.1996


def scene(study: dict[str, Any], **others: Any) -> dict[str, Any]:
    return copy.deepcopy(OSCILLATOR) | others | {"study": {"kind": "sweep"} | study}


def run(study: dict[str, Any], *, workers: int | None = None, **others: Any) -> xarray.Dataset:
    return timesim.run(scene(study, **others), workers=workers)


def of(result: xarray.Dataset, preload: float, frequency: float) -> xarray.Dataset:
    return result.sel({PRELOAD: preload, "frequency": frequency}).squeeze("direction")


def x(result: xarray.Dataset) -> Any:
    """Amplitude of the tip along x."""
    return result.amplitude.sel(point="tip", axis="x")


def assert_same(one: xarray.Dataset, other: xarray.Dataset) -> None:
    """Every variable and coordinate, bit for bit."""
    assert set(one.variables) == set(other.variables)
    for name in one.variables:
        assert one[name].dims == other[name].dims
        assert one[name].values.tolist() == other[name].values.tolist() or (
            one[name].values.tobytes() == other[name].values.tobytes()
        ), name


# What a result holds

THREE = {"frequency": {"values": [1.52, 0.97, 1.39]}, "over": {PRELOAD: [3, -1, 5], "contacts.pad.friction": [0.5]}}


@pytest.fixture(scope="module")
def three() -> xarray.Dataset:
    return run(THREE)


def test_axes_labels_and_types(three: xarray.Dataset) -> None:
    axes = (PRELOAD, "contacts.pad.friction", "direction", "frequency")
    assert three.amplitude.dims == (*axes, "point", "axis")
    assert three.amplitude_band.dims == (*axes, "band", "point", "axis")
    for name in ("settled", "cycles", "period", "floquet_max", "failure"):
        assert three[name].dims == axes
    for name in ("slip_share", "separation_share"):
        assert three[name].dims == (*axes, "contact")
    assert three[PRELOAD].values.tolist() == [3.0, -1.0, 5.0]
    assert three.direction.values.tolist() == ["independent"]
    assert three.frequency.values.tolist() == [0.97, 1.39, 1.52]
    assert three.point.values.tolist() == ["tip"]
    assert three.axis.values.tolist() == ["x", "y", "z"]
    assert three.contact.values.tolist() == ["pad"]
    assert three.jump_low.shape == three.jump_high.shape == (3, 1, 1, 0)
    assert {three[name].dtype.kind for name in ("settled", "cycles", "period")} == {"i"}
    assert all(three[name].attrs["long_name"] for name in three.variables)
    assert {three[name].attrs["units"] for name in ("amplitude", "amplitude_band")} == {"length"}
    assert three.frequency.attrs["units"] == "Hz"
    assert three.attrs["complete"] == 1
    assert three.attrs["study"] == "sweep"
    assert three.attrs["run_seconds"] > 0


def test_what_the_values_change_of_a_model_lies_along_their_axes() -> None:
    mass = "structure.modes.0.mass"
    swept = load_scene(scene({"frequency": {"values": [1.39]}, "over": {PRELOAD: [1, 2, 3], mass: [1, 2]}}))
    grid = sweep.Grid(swept, swept.plan)
    dims, values = grid.of_models(("mode",), lambda model: model.preload * model.structure.mass)
    assert dims == (PRELOAD, mass, "mode")
    np.testing.assert_array_equal(values[..., 0], np.outer([1, 2, 3], [1, 2]))
    np.testing.assert_array_equal(values[..., 1], np.outer([1, 2, 3], [1, 1]))
    assert grid.of_models(("contact",), lambda model: model.friction)[0] == ("contact",)


def test_settled_amplitudes(three: xarray.Dataset) -> None:
    for (preload, frequency), amplitude in SETTLED.items():
        assert x(of(three, preload, frequency)).item() == pytest.approx(amplitude, rel=1e-6)
    assert three.settled.values.all()
    assert (three.period.values == 1).all()
    assert (three.failure.values == "").all()
    assert np.all((three.floquet_max.values > 0) & (three.floquet_max.values < 1))
    solved = three.cycles.values == 0  # n0 = 5 at 0.97 Hz: proven to stick, and linear
    assert solved.sum() == 1
    assert np.all(three.slip_share.values[solved] == 0)
    assert np.all((three.cycles.values > 30) | solved)
    assert np.all(three.cycles.values < 400)


def test_bands_of_settled_motions_are_narrow_and_shares_are_parts(three: xarray.Dataset) -> None:
    low, high = three.amplitude_band.sel(band="smallest"), three.amplitude_band.sel(band="largest")
    np.testing.assert_array_equal(low, three.amplitude)
    np.testing.assert_array_equal(high, three.amplitude)
    parts = [of(three, *case) for case in SETTLED]
    slip, apart = ([float(part[f"{name}_share"].item()) for part in parts] for name in ("slip", "separation"))
    assert all(0.05 < share < 0.95 for share in slip)
    assert [share > 0.05 for share in apart] == [False, True, False]
    assert of(three, 3.0, 0.97).slip_share.item() == 0  # it sticks all along, which no bound proves beforehand


def test_marching_and_shooting_agree(three: xarray.Dataset) -> None:
    """Newton's method takes fewer cycles and finds the same motions."""
    march, shoot = three, run(THREE | {"periodic": "shoot"})
    size = march.amplitude.values.max()
    np.testing.assert_allclose(shoot.amplitude, march.amplitude, rtol=0, atol=1e-7 * size)
    np.testing.assert_allclose(shoot.floquet_max, march.floquet_max, rtol=0, atol=1e-6)
    np.testing.assert_allclose(shoot.slip_share, march.slip_share, rtol=0, atol=1e-6)
    assert shoot.settled.values.all()
    assert np.all((shoot.cycles.values < march.cycles.values) | (march.cycles.values == 0))
    assert not np.array_equal(shoot.amplitude, march.amplitude)


LINEAR: dict[str, Any] = {
    "structure": {
        "matrices": {
            "mass": [[1.0, 0.0, 0.0], [0.0, 2.0, 0.1], [0.0, 0.1, 1.5]],
            "stiffness": [[60.0, -20.0, 0.0], [-20.0, 50.0, 8.0], [0.0, 8.0, 90.0]],
            "damping": [[1.2, -0.1, 0.0], [-0.1, 1.3, 0.2], [0.0, 0.2, 1.6]],
            "points": {"a": {"x": 0}, "b": {"x": 1, "z": 2}},
        }
    },
    "contacts": [
        {
            "name": "held",
            "point": "b",
            "friction": 0.5,
            "tangential_stiffness": 30.0,
            "normal_stiffness": 25.0,
            "preload": 500.0,
        },
        {"name": "open", "point": "a", "against": "b", "normal": [1, 0, 0], "tangent": [0, 0, 1], "preload": -50.0}
        | {"friction": 0.3, "tangential_stiffness": 10.0, "normal_stiffness": 10.0},
    ],
    "excitation": {
        "forces": [
            {"point": "a", "direction": [1, 0, 0], "amplitude": 2.0},
            {"point": "b", "direction": [0, 0, 1], "amplitude": 0.8, "phase_deg": 40, "harmonic": 3},
        ],
        "constant_forces": [{"point": "b", "direction": [1, 0, 0], "amplitude": 0.5}],
    },
}


def test_the_steady_state_of_a_linear_scene_against_integration() -> None:
    """Two harmonics, a constant force, damping that the modes do not diagonalise, one contact stuck and one apart."""
    scene_ = load_scene(LINEAR | {"study": {"kind": "sweep", "frequency": {"values": [0.9]}}})
    solver = scene_.solver()
    lane = first_lane(Chain(scene_.model(), (0.9,)), solver)
    found = linear_orbit(lane)
    assert found is not None
    system = jax.tree.map(np.asarray, lane.system)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        angle = system.harmonic[:, None] * (t + system.phase)
        force = system.constant + (system.cosine * np.cos(angle) + system.sine * np.sin(angle)).sum(axis=0)
        q, p = np.split(y, 2)
        return np.concatenate([p, force - system.stiffness * q - system.damping @ p])

    point, _ = lane.frame.point(found.end)
    begin = np.concatenate([point.q, point.p])
    times = np.linspace(0, 2 * np.pi, 20001)
    path = solve_ivp(rate, times[[0, -1]], begin, method="DOP853", rtol=1e-11, atol=1e-13, t_eval=times).y
    np.testing.assert_allclose(path[:, -1], begin, atol=1e-9 * np.abs(begin).max())
    x = lane.frame.shape @ path[:3]
    np.testing.assert_allclose(found.amplitude.ravel(), np.ptp(x, axis=1) / 2, atol=1e-6 * found.amplitude.max())
    pushed = [solve_ivp(rate, (0, 2 * np.pi), begin + e, method="DOP853", rtol=1e-11, atol=1e-13) for e in np.eye(6)]
    slope = np.stack([end.y[:, -1] - path[:, -1] for end in pushed], axis=1)
    moduli = np.sort(np.abs(np.linalg.eigvals(slope)))[::-1]
    np.testing.assert_allclose(np.abs(found.floquet), moduli, atol=1e-7)


def test_a_scene_that_is_linear_needs_no_march() -> None:
    """Proven to stick: the closed form against a march that models the contact."""
    held = [OSCILLATOR["contacts"][0] | {"preload": 60.0}]
    study = {"frequency": {"values": [0.6, 0.9, 1.3]}, "settle": {"tolerance": 1e-9}}
    solver = {"accuracy": "standard", "reduce": False}
    marched, solved = run(study, contacts=held, solver=solver), run(study, contacts=held)
    assert marched.cycles.values.min() > 10
    assert np.all(solved.cycles.values == 0)
    assert np.all(solved.settled.values == 1)
    for name in ("amplitude", "final_modal_displacement", "final_modal_velocity"):
        size = np.abs(marched[name].values).max()
        np.testing.assert_allclose(solved[name], marched[name], rtol=0, atol=1e-6 * size, err_msg=name)
    np.testing.assert_allclose(solved.floquet_max, marched.floquet_max, atol=1e-6)


def test_an_undamped_scene_is_marched() -> None:
    """Nothing dies out, so there is no steady state that every start leads to."""
    modes = [{"frequency": 0.9, "damping_ratio": 0.0, "mass": 1.0, "shape": {"tip": [1, 0, 0]}}]
    scene_ = {"structure": {"modes": modes}, "excitation": {"modal_force": [{"amplitude": 1.0}]}}
    study = {"kind": "sweep", "frequency": {"values": [0.7]}, "settle": {"max_cycles": 40}}
    result = timesim.run(scene_ | {"study": study})
    assert result.settled.item() == 0
    assert result.cycles.item() >= 40


# Both directions, jumps


BOTH = {
    "frequency": {"from": 0.938, "to": 0.950, "step": 0.001},
    "over": {PRELOAD: [-4]},
    "direction": "both",
    "refine": 1e-4,
}


@pytest.fixture(scope="module")
def both() -> xarray.Dataset:
    return run(BOTH)


def test_the_directions_differ_where_there_are_two_motions(both: xarray.Dataset) -> None:
    assert both.direction.values.tolist() == ["up", "down"]
    assert both.frequency.values.tolist() == pytest.approx(np.arange(0.938, 0.9505, 0.001).tolist())
    assert np.all(np.diff(both.frequency.values) > 0)
    up, down = (x(both).sel({PRELOAD: -4, "direction": way}).values for way in ("up", "down"))
    two = (both.frequency.values > GAP_DOWN[1]) & (both.frequency.values < GAP_UP[0])
    assert two.sum() == 6
    assert np.all(up[two] > 1.5 * down[two])
    np.testing.assert_allclose(up[~two], down[~two], rtol=1e-5)
    at = dict(zip(np.round(both.frequency.values, 3), zip(up, down, strict=True), strict=True))
    assert at[0.947] == pytest.approx((UPPER, LOWER), abs=1e-4)
    assert at[0.948] == pytest.approx((BEYOND, BEYOND), abs=1e-4)
    assert both.settled.values.all()


def test_jumps_are_found_and_bisected(both: xarray.Dataset) -> None:
    """Each direction jumps once; the bracket is as narrow as asked for, and in the step of 1e-4 Hz of the reference."""
    assert both.jump_low.dims == both.jump_high.dims == (PRELOAD, "direction", "jump")
    assert both.sizes["jump"] == 1
    low, high = both.jump_low.values[0, :, 0], both.jump_high.values[0, :, 0]
    assert np.all((high > low) & (high - low <= 1e-4))
    for found, true in zip(zip(low, high, strict=True), (GAP_UP, GAP_DOWN), strict=True):
        assert found[0] <= true[1]
        assert found[1] >= true[0]


def test_jumps_of_a_chain_ascend_in_frequency_whichever_way_it_is_swept() -> None:
    swept = load_scene(scene({"frequency": {"values": [1, 2, 3]}, "direction": "both"}))
    grid = sweep.Grid(swept, swept.plan)
    arrays, _ = grid.gathered({}, {})
    data = grid.data(arrays, [(0, 0, 1.2, 1.3), (0, 1, 2.4, 2.5), (0, 1, 1.1, 1.2)], {})
    np.testing.assert_array_equal(data.jump_low, [[1.2, np.nan], [1.1, 2.4]])
    np.testing.assert_array_equal(data.jump_high, [[1.3, np.nan], [1.2, 2.5]])


def test_a_jump_is_reported_with_its_chain(both: xarray.Dataset, tmp_path: Path) -> None:
    record = read(save(both, tmp_path / "result.nc"))[""]
    lines = list(jump_lines(record))
    ends = [f"{both.jump_low.values[0, d, 0]:.8g} and {both.jump_high.values[0, d, 0]:.8g} Hz" for d in (0, 1)]
    assert lines == [
        f"{PRELOAD} -4, direction {way}: the motion jumps between {end}"
        for way, end in zip(("up", "down"), ends, strict=True)
    ]
    whole = both.frequency.values[[4, 5]]
    record["jump_low"][0, 1, 0], record["jump_high"][0, 1, 0] = whole
    short, long = jump_lines(record)
    assert short == lines[0]
    assert long.partition(" Hz, ")[2].startswith("a whole step: in shorter ones the motion is not lost within it")


def test_the_peak_of_each_set_of_values_is_named(both: xarray.Dataset) -> None:
    """With its direction where the other has another; not that of a set without a motion."""
    data = both.copy(deep=True)
    amplitude = data.amplitude.sel(point="tip")
    frequency = [float(both.frequency[i]) for i in amplitude.max("axis").argmax("frequency").values[0]]
    (line,) = peak_lines(data)
    top = float(amplitude.max())
    assert line.startswith(f"{PRELOAD} -4: peak {top:.5g} of tip ")
    assert line.endswith(f" at {frequency[0]:g} Hz, direction up")
    data.amplitude[:, 1] = np.nan  # as of a sweep that was interrupted
    (line,) = peak_lines(data)
    assert line.endswith(f" at {frequency[0]:g} Hz")
    data.amplitude[:, 1] = data.amplitude[:, 0] * (1 - SAME / 10)
    (line,) = peak_lines(data)
    assert line.endswith(f" at {frequency[0]:g} Hz")
    (line,) = peak_lines(data.isel(frequency=slice(5)))
    assert line.endswith("Hz, an end of the frequencies")
    (line,) = peak_lines(data.isel(frequency=[5]))
    assert f"{PRELOAD} -4: amplitude " in line
    data.amplitude[:, :, 6] *= 5
    (line,) = peak_lines(data)
    assert re.search(r"Hz; beside it \d+% of that: between the points it may be far higher$", line)
    data.attrs["jumps_bisected"] = 1
    for step in (5, 6):  # below the peak and above it
        data.jump_low[:], data.jump_high[:] = both.frequency[step], both.frequency[step + 1]
        (line,) = peak_lines(data)
        assert line.endswith("Hz")  # what lies between is known: a jump
    data.amplitude[:, :, :3] = np.nan
    (line,) = peak_lines(data)
    size = both.sizes["frequency"]
    assert line.endswith(f"Hz; of {size - 3} of {size} points, the others are missing")
    data.amplitude[:, :, 5], data.attrs["jumps_bisected"] = np.nan, 0
    (line,) = peak_lines(data)
    assert "-" not in line.partition("peak")[2]  # a point that is missing is no small one
    data.amplitude[:] = np.nan
    assert list(peak_lines(data)) == []


def test_points_that_stand_apart_are_named_as_such(both: xarray.Dataset) -> None:
    data = both.copy(deep=True)
    kinds = ("irregular", 1, "irregular"), ("period", 2, "repeat after more"), ("floquet_max", np.nan, "overflow")
    for name, value, _ in kinds:
        data[name][0, 0, [0, 1, 5]] = value
    data["floquet_max"][0, 1, 3] = 1.01
    f, lines = data.frequency.values, list(unusual_lines(data))
    assert next(line for line in lines if "unstable" in line).endswith(f"direction down: at {f[3]:g} Hz")
    for _, _, words in kinds:
        (line,) = (line for line in lines if words in line)
        assert line.endswith(f"direction up: between {f[0]:g} and {f[1]:g} Hz, at {f[5]:g} Hz")
    data["settled"][0, 1, [6, 7]], data["amplitude"][0, 1, 7] = 0, np.nan  # the latter was not computed
    (line,) = (line for line in unusual_lines(data) if "did not settle" in line)
    assert line.endswith(f"direction down: at {f[6]:g} Hz")


def test_a_jump_between_points_that_each_start_anew_is_no_slope_in_silence() -> None:
    """The far end of a bistable range: the peak of the other motion is missing, and nothing else tells."""
    anew = run({"frequency": {"values": [0.95, 0.97, 1.39, 1.40]}, "over": {PRELOAD: [3]}})
    (line,) = anew_lines(anew)
    assert line in sweep_lines(anew)
    assert line.startswith(
        f"{PRELOAD} 3: the amplitude changes steeply between 0.97 and 1.39 Hz, over a slope or a jump"
    )
    assert "study.direction: both tells of another motion" in line
    assert list(anew_lines(run({"frequency": {"values": [0.95, 0.96, 0.97]}, "over": {PRELOAD: [3]}}))) == []


def test_the_motion_loses_its_stability_before_it_jumps(both: xarray.Dataset) -> None:
    largest = both.floquet_max.sel({PRELOAD: -4, "direction": "up"}).values[:10]
    assert np.all(np.diff(largest[3:]) > 0)
    assert 0.95 < largest[-1] < 1


def test_the_lower_motion_is_that_of_the_open_gap(both: xarray.Dataset) -> None:
    """Nothing touches there: a closed form, and the largest multiplier is the decay of a mode over a period."""
    below = both.sel({PRELOAD: -4, "direction": "down"}).sel(frequency=0.945, method="nearest")
    assert below.separation_share.item() == pytest.approx(1.0, abs=1e-12)
    frequency = below.frequency.item()
    np.testing.assert_allclose(below.amplitude.values[0], np.abs(SHAPE @ linear(frequency)), rtol=1e-6)
    assert below.floquet_max.item() == pytest.approx(np.exp(-0.02 * 2 * np.pi * 0.9 / frequency), rel=1e-6)


SHAPE = np.array([[1, 1], [1, -1], [0.8, 0.6]])


def linear(frequency: float) -> np.ndarray:
    """Complex amplitudes of both modes without contact."""
    omega, natural = 2 * np.pi * frequency, 2 * np.pi * np.array([0.9, 1.1])
    return 1 / (natural**2 - omega**2 + 2j * 0.02 * natural * omega)


def test_independent_points_start_from_the_initial_state() -> None:
    """From rest the upper motion is reached, from the motion of the open gap that one, which then lasts."""
    study = {"frequency": {"values": [0.944, 0.945]}, "over": {PRELOAD: [-4]}}
    q = linear(0.945)
    start = {"modal_displacement": q.real.tolist(), "modal_velocity": (-2 * np.pi * 0.945 * q.imag).tolist()}
    rest, started = run(study), run(study, initial=start)
    assert np.all(x(rest) > 0.4)
    assert x(started).values.ravel()[1] == pytest.approx(abs(SHAPE[0] @ q), rel=1e-6)
    assert started.separation_share.values.ravel()[1] == pytest.approx(1.0, abs=1e-12)
    assert started.cycles.values.ravel()[1] < rest.cycles.values.ravel()[1]


def test_a_slope_is_no_jump() -> None:
    """A step across the flank of a resonance stands out among small ones; bisected it shows itself as a slope."""
    study = {"frequency": {"values": [0.95, 0.97, 1.39, 1.40]}, "over": {PRELOAD: [3]}, "direction": "up"}
    unrefined, refined = run(study), run(study | {"refine": 1e-3})
    assert unrefined.jump_low.values.tolist() == [[[0.97]]]
    assert unrefined.jump_high.values.tolist() == [[[1.39]]]
    assert refined.sizes["jump"] == 0
    slopes = ": the amplitude changes along slopes only, as shorter steps show"
    assert list(jump_lines(refined)) == [f"no jump{slopes}"]
    cut_off = refined.assign(amplitude=refined.amplitude.where(refined.frequency < 1.395))
    assert list(jump_lines(cut_off)) == [f"no jump between the points that were computed{slopes}"]
    assert not list(jump_lines(refined.assign(amplitude=refined.amplitude * np.nan)))
    assert list(jump_lines(unrefined)) == [
        f"{PRELOAD} 3, direction up: the amplitude changes steeply between 0.97 and 1.39 Hz, over a slope or a jump: "
        "study.refine tells which"
    ]
    labels = [line.get_label() for line in plot_sweep.response(unrefined).get_lines()]
    assert "jump or slope" in labels
    assert "jump" not in labels
    np.testing.assert_array_equal(unrefined.amplitude, refined.amplitude)


@pytest.mark.parametrize("width", [1e-3, 0.02])
def test_a_linear_response_has_no_jump(width: float) -> None:
    """However wide the steps are for the resonance, and the wanted width for the steps."""
    apart = [OSCILLATOR["contacts"][0] | {"preload": -1e4}]
    study = {"frequency": {"from": 0.8, "to": 1.2, "step": 0.02}, "direction": "both", "refine": width}
    assert run(study, contacts=apart).sizes["jump"] == 0


def test_a_jump_beside_a_slope_is_found() -> None:
    """Up and down differ at one frequency of a coarse grid: each names the step, or the part of it, where it jumped."""
    study = {"frequency": {"values": [0.86, 0.9, 0.946, 0.99]}, "over": {PRELOAD: [-4]}, "direction": "both"}
    result = run(study | {"refine": 1e-3})
    up, down = x(result)[0].values
    assert up[2] > 1.5 * down[2]
    (low_up, low_down), (high_up, high_down) = result.jump_low.values[0, :, 0], result.jump_high.values[0, :, 0]
    assert 0.946 <= low_up <= GAP_UP[1]
    assert GAP_UP[0] <= high_up <= 0.99
    assert low_down <= GAP_DOWN[1]
    assert high_down >= GAP_DOWN[0]


# What goes wrong

BUDGET = 88  # steps a cycle: enough for a contact that seldom switches


def call(folder: Path, text: str, *options: str) -> tuple[int, str, str]:
    path = folder.parent / "scene.yaml"
    path.write_text(text)
    found = CliRunner().invoke(app, ["run", str(path), "-o", str(folder), "--no-plots", *options])
    return found.exit_code, found.stdout, found.stderr


def test_points_that_fail_are_named_and_the_others_kept(tmp_path: Path) -> None:
    """A budget that is enough where the contact seldom switches; a combination of values that is no scene."""
    study = {
        "frequency": {"values": [0.97, 1.39]},
        "over": {PRELOAD: [-1, 3], "contacts.pad.normal_stiffness": [0, 20]},
    }
    solver = {"method": "tsit5", "rtol": 1e-7, "atol": 1e-9, "max_steps": BUDGET}
    status, out, error = call(tmp_path / "run", json.dumps(scene(study, solver=solver)))
    result = timesim.open_result(tmp_path / "run")
    assert status == 1
    assert result.attrs["complete"] == 0
    failed = result.failure != ""
    assert failed.values[0, 0].all()
    assert all("must be > 0 where normal_stiffness is 0" in text for text in result.failure.values[0, 0].ravel())
    assert failed.sel({PRELOAD: 3, "contacts.pad.normal_stiffness": 20}).values.tolist() == [[False, True]]
    spent = result.failure.sel({PRELOAD: -1, "contacts.pad.normal_stiffness": 20, "frequency": 0.97}).item()
    assert f"the budget of {BUDGET} steps a cycle is spent" in spent
    assert spent.startswith("at 0.97 Hz, in cycle ")
    assert "5 of 8 points failed" in error
    assert "preload -1, contacts.pad.normal_stiffness 20, direction independent, frequency 0.97: at 0.97 Hz" in error
    assert result.attrs["reason"] in error
    failed = failed.values
    good = ~failed
    assert good.sum() == 3
    assert f"{good.sum()} steady states" in out
    assert np.isnan(result.amplitude.values[failed]).all()
    assert np.isnan(result.floquet_max.values[failed]).all()
    assert not result.settled.values[failed].any()
    with pytest.warns(RuntimeWarning, match="2 of 8 points failed"):
        whole = run(study)
    np.testing.assert_array_equal(result.amplitude.values[good], whole.amplitude.values[good])
    np.testing.assert_array_equal(result.cycles.values[good], whole.cycles.values[good])
    assert whole.settled.values[good].all()


def test_after_a_point_that_fails_a_chain_starts_anew() -> None:
    study = {"frequency": {"values": [0.97, 1.38, 1.39]}, "direction": "down"}
    solver = {"method": "tsit5", "rtol": 1e-7, "atol": 1e-9, "max_steps": BUDGET}
    with pytest.warns(RuntimeWarning, match="2 of 3 points failed: direction down, frequency 1.38: at 1.38 Hz"):
        chain = run(study, solver=solver)
    alone = run({"frequency": {"values": [0.97]}})
    assert x(chain).values.ravel().tolist() == pytest.approx([x(alone).item(), np.nan, np.nan], nan_ok=True, rel=0)
    assert chain.cycles.values.ravel()[0] == alone.cycles.item()


def test_a_motion_that_does_not_settle_is_reported_with_its_band(tmp_path: Path) -> None:
    study = {"frequency": {"values": [0.97, 1.39]}, "over": {PRELOAD: [-1, 3]}, "settle": {"max_cycles": 16}}
    status, out, _ = call(tmp_path / "run", json.dumps(scene(study)))
    result = timesim.open_result(tmp_path / "run")
    assert status == 0
    assert (
        "warning: 4 points did not settle in settle.max_cycles (settled = 0, with the band of the amplitude): " in out
    )
    assert f"{PRELOAD} -1: between 0.97 and 1.39 Hz; {PRELOAD} 3: between 0.97 and 1.39 Hz" in out
    assert out.startswith("0 steady states by ")
    assert out.count(" Hz, not settled, an end of the frequencies") == 2  # the peaks
    assert result.attrs["complete"] == 1
    assert not result.settled.values.any()
    assert not result.period.values.any()
    assert np.isnan(result.floquet_max.values).all()
    assert np.all((result.cycles.values >= 16) & (result.cycles.values <= 16 + UNSETTLED_CYCLES))
    low, high = (x(result.amplitude_band.to_dataset(name="amplitude").sel(band=end)) for end in ("smallest", "largest"))
    assert np.all(low.values < high.values)
    assert np.all(x(result).values >= high.values)  # over ten cycles, of which each has its own


@pytest.mark.parametrize(("accuracy", "tolerance"), [("standard", 1e-3), ("draft", 1e-8)])
def test_what_is_only_error_is_given_no_phase(accuracy: str, tolerance: float) -> None:
    """Under a force of harmonic 2 alone, harmonic 1 is what has not settled yet, or noise of the steps."""
    force = {"point": "tip", "direction": [1, 0.5, 0.2], "amplitude": 1.0, "harmonic": 2}
    study = {"kind": "sweep", "frequency": {"values": [0.6, 0.75]}, "settle": {"tolerance": tolerance}}
    changes = {"excitation": {"forces": [force]}, "solver": {"accuracy": accuracy}, "study": study}
    result = timesim.run(oscillator_scene(preload=2.0) | changes)
    assert result.settled.values.all()
    assert np.all(result.slip_share.values > 0)
    assert np.all(result.harmonic_amplitude.sel(harmonic=1).max(("point", "axis")).values > 0)
    assert np.isnan(result.phase_deg.values).all()


@pytest.mark.slow
def test_a_period_of_two_cycles_is_reported(tmp_path: Path) -> None:
    """A mass that bounces on a stop, excited at twice its natural frequency of impacts."""
    stop = {
        "structure": {"modes": [{"frequency": 0.2, "damping_ratio": 0.3, "mass": 1.0, "shape": {"tip": [0, 0, 1]}}]},
        "contacts": [
            {"name": "stop", "point": "tip", "friction": 0.0, "tangential_stiffness": 0.0, "normal_stiffness": 100.0}
        ],
        "excitation": {"modal_force": [{"amplitude": 1.0}]},
        "study": {"kind": "sweep", "frequency": {"values": BOUNCES}},
    }
    status, out, error = call(tmp_path / "run", json.dumps(stop))
    result = timesim.open_result(tmp_path / "run")
    assert status == 0, error
    assert result.period.values.ravel().tolist() == [1, 2]
    assert result.settled.values.all()
    assert "1 of them repeats after more than one cycle (variable period)" in out
    low, high = result.amplitude_band.sel(axis="z", frequency=BOUNCES[1]).values.ravel()
    assert low < high
    every = result.sel(axis="z", direction="independent", point="tip")
    assert np.isfinite(every.phase_deg.values).all()
    cosine, sine = every.harmonic_cos.sel(harmonic=1), every.harmonic_sin.sel(harmonic=1)
    np.testing.assert_allclose(every.phase_deg, np.rad2deg(np.arctan2(-sine, cosine)))
    # What the force puts in, pi F A sin(lag) a cycle, is what the damper takes: more than its share of harmonic 1.
    work = np.pi * np.abs(np.sin(np.deg2rad(every.phase_deg))) * every.harmonic_amplitude.sel(harmonic=1)
    damper = 2 * 0.3 * 2 * np.pi * 0.2 * 2 * np.pi**2 * every.frequency * every.harmonic_amplitude.sel(harmonic=1) ** 2
    assert np.all(work > damper)


BOUNCES = [0.3, 0.6]


# Whoever does the work, and however often it is interrupted


@pytest.mark.parametrize(
    "study",
    [
        {"frequency": {"from": 1.30, "to": 1.34, "step": 0.005}, "settle": {"max_cycles": 24}},
        {"frequency": {"from": 1.30, "to": 1.32, "step": 0.01}, "direction": "up", "over": {PRELOAD: [0, 1, 2, 3, 5]}},
    ],
    ids=["points", "chains"],
)
def test_workers_make_no_difference(study: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep, "POINTS_A_CHUNK", 5)
    grid = sweep.Grid(timesim.load_scene(scene(study)), timesim.load_scene(scene(study)).plan)
    assert len(grid.chunks(grid.scene.solver())[0]) == 2
    assert_same(
        run(study, workers=1, solver={"accuracy": "draft"}), run(study, workers=2, solver={"accuracy": "draft"})
    )


@pytest.mark.parametrize(
    "study",
    [
        {"frequency": {"from": 1.30, "to": 1.34, "step": 0.01}},
        {"frequency": {"from": 1.30, "to": 1.32, "step": 0.01}, "direction": "up", "over": {PRELOAD: [0, 1]}},
    ],
    ids=["points", "chains"],
)
def test_an_interrupt_keeps_the_points_of_a_chunk_that_are_done(study: dict[str, Any], tmp_path: Path) -> None:
    """A chunk of many points may take minutes."""
    loaded = load_scene(scene(study, solver={"accuracy": "draft"}))

    def interrupted(done: float, *_: Any) -> None:
        if done >= 2:
            raise KeyboardInterrupt

    whole = carry_out(loaded).groups[""]
    outcome = carry_out(loaded, Execution(progress=interrupted, folder=tmp_path, workers=1))
    cut = outcome.groups[""]
    found = np.isfinite(x(cut).values)
    assert 1 <= found.sum() <= loaded.plan.size - 2
    assert outcome.reason == f"interrupted; {loaded.plan.size - found.sum()} of {loaded.plan.size} points missing"
    for name in ("amplitude", "phase_deg", "final_modal_displacement", "settled", "slip_share"):
        np.testing.assert_array_equal(cut[name].values[found], whole[name].values[found], err_msg=name)
    assert np.isnan(cut["final_modal_displacement"].values[~found]).all()
    assert set(cut["failure"].values.ravel()) == {""}
    again = carry_out(loaded, Execution(folder=tmp_path, resume=True, workers=1, notice=lambda _: None))
    assert_same(again.groups[""].drop_attrs(), whole.drop_attrs())


def test_work_is_given_up_between_two_rounds_of_cycles() -> None:
    """Not only between steady states, of which one may take minutes."""
    loaded = load_scene(scene({"frequency": {"values": [1.39]}}, solver={"accuracy": "draft"}))
    chains, asked = [Chain(loaded.model(), (1.39,))], iter([False, True])
    with pytest.raises(GivenUpError) as raised:
        steady_states(chains, loaded.solver(), loaded.plan.criterion, halted=lambda: next(asked))
    assert raised.value.orbits == [[]]


def test_an_interrupt_of_the_search_for_jumps_keeps_all_points(monkeypatch: pytest.MonkeyPatch) -> None:
    study = {"frequency": {"from": 1.30, "to": 1.31, "step": 0.01}, "direction": "up", "refine": 1e-3}
    loaded = load_scene(scene(study, solver={"accuracy": "draft"}))

    def interrupted(*_: Any) -> Any:
        raise GivenUpError([[]])

    monkeypatch.setattr(sweep, "_jumps", interrupted)
    outcome = carry_out(loaded, Execution(workers=1))
    assert outcome.reason == "interrupted; 1 of 1 chunk unfinished, with all points done"
    assert np.isfinite(x(outcome.groups[""]).values).all()
    assert not any("no jump" in line for line in outcome.summary), "none was sought to the end"


LONG = {"frequency": {"from": 0.92, "to": 0.96, "step": 0.001}, "direction": "both", "over": {PRELOAD: [-4]}}


@pytest.mark.slow
def test_killed_and_resumed_it_gives_the_same(tmp_path: Path) -> None:
    text = json.dumps(scene(LONG | {"refine": 1e-4}, solver={"accuracy": "draft"}))
    (tmp_path / "cut").mkdir()
    path, folder = tmp_path / "cut.yaml", tmp_path / "cut" / "run"
    path.write_text(text)
    begun = [
        sys.executable,
        "-c",
        "from timesim.cli import main; main()",
        "run",
        str(path),
        "-o",
        str(folder),
        "--no-plots",
    ]
    with subprocess.Popen(begun, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        while not (kept := list((folder / "checkpoint").glob("*.npz"))) and process.poll() is None:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert kept
    assert not (folder / "result.nc").exists()
    status, _, error = call(folder, text)
    assert status == 2
    assert "--resume" in error
    status, _, error = call(folder, text, "--resume")
    assert status == 0
    assert "of 3 chunks taken up" in error
    assert "0 of 3" not in error
    assert sorted(item.name for item in folder.iterdir()) == ["result.nc", "scene.yaml"]
    assert call(tmp_path / "whole", text)[0] == 0
    resumed, whole = (timesim.open_result(part) for part in (folder, tmp_path / "whole"))
    assert_same(resumed, whole)
    assert whole.sizes["jump"] == 1
    assert whole.jump_low.notnull().all()
    assert call(folder, text.replace("0.96", "0.97"), "--resume")[0] == 2


@pytest.mark.slow
def test_a_cluster_gives_the_same_as_threads() -> None:
    study = {"frequency": {"from": 1.30, "to": 1.43, "step": 0.001}, "settle": {"max_cycles": 24}}
    assert_same(timesim.run(scene(study), cluster="local", workers=2), run(study))


# Against settled amplitudes of other systems, and the softening jump


@pytest.mark.slow
def test_the_softening_jump() -> None:
    study = {"frequency": {"from": 1.248, "to": 1.259, "step": 0.001}, "direction": "both", "refine": 1e-4}
    result = run(study, contacts=[OSCILLATOR["contacts"][0] | {"preload": 2.0}])
    assert result.sizes["jump"] == 1
    for way, true in zip(result.direction.values, (SOFT_UP, SOFT_DOWN), strict=True):
        low, high = (result[f"jump_{end}"].sel(direction=way).item() for end in ("low", "high"))
        assert low - 1e-4 <= true[0]
        assert high + 1e-4 >= true[1]
    upper = x(result).sel(direction="down").sel(frequency=1.255, method="nearest").item()
    lower = x(result).sel(direction="up").sel(frequency=1.255, method="nearest").item()
    assert (lower, upper) == pytest.approx((0.1343, 0.2861), abs=1e-4)


def one_point(
    modes: list[tuple[float, float, list[float]]], contact: dict[str, Any], excitation: dict[str, Any]
) -> dict[str, Any]:
    """Unit masses; modes as stiffness, damping, shape of the point."""
    return {
        "structure": {
            "modes": [
                {
                    "frequency": float(np.sqrt(stiffness) / (2 * np.pi)),
                    "damping_ratio": float(damping / (2 * np.sqrt(stiffness))),
                    "mass": 1.0,
                    "shape": {"tip": shape},
                }
                for stiffness, damping, shape in modes
            ]
        },
        "contacts": [{"name": "pad", "point": "tip"} | contact],
        "excitation": excitation,
        "solver": {"accuracy": "reference"},
    }


X = [(1.0, 0.02, [1, 0, 0])]
STEADY_LOAD = {"friction": 0.3, "tangential_stiffness": 1.0, "normal_stiffness": 0.0, "preload": 1.0}
FORCE = "excitation.forces.0.amplitude"

# A mass on a plane under a rotating force: the closed form of the circle that it slips on (two forces, the second axis
# follows by a quarter of a turn). Radius by force and angular frequency.
CIRCLE = {
    0.5: {0.8: 0.8224980778, 1.1: 1.9650913002, 1.2: 1.0748621048, 1.5: 0.4917039499},
    1.0: {0.8: 2.5147887309, 1.1: 4.4653853589, 1.2: 2.2206252747, 1.5: 0.8466794784},
}
# A mass on a Jenkins element under constant load, by time integration of another code, six decimals.
JENKINS = {0.8: 0.435691, 1.0: 6.210109, 1.1: 2.344376, 1.2: 1.360172, 1.3: 0.965336, 1.4: 0.745880}
# One mass on a contact inclined by 45 degrees: where it has one motion by a march of 200 and 400 cycles that stops at
# its events (scipy's DOP853, rtol 1e-12); where it has two by another time integration, six decimals.
INCLINED = {1.3: 1.65472471, 1.4: 0.89336548}
INCLINED_UP = {1.27: 0.515553, 1.28: 0.558662}
INCLINED_DOWN = {1.27: 1.981046, 1.28: 1.874119}
# A tangential and a normal mode closed by a constant force (TMDSimPy's 2dof_eldry_fric), tangential and normal
# amplitude by force and angular frequency, time integration of another code, six decimals.
TWO = {
    (10.0, 4.0): (5.852057, 0.036761),
    (50.0, 3.5): (10.974332, 0.163600),
    (80.0, 3.0): (10.451682, 0.238514),
    (80.0, 3.5): (29.987567, 0.261759),
    (80.0, 4.0): (21.985107, 0.294086),
    (300.0, 3.0): (82.238182, 0.894427),
    (300.0, 3.5): (202.980752, 0.981597),
}


def hertz(omegas: Any) -> dict[str, Any]:
    return {"values": [float(omega / (2 * np.pi)) for omega in sorted(omegas)]}


@pytest.mark.slow
@pytest.mark.parametrize("force", CIRCLE)
def test_circular_motion(force: float) -> None:
    loads = [{"point": "tip", "direction": axis, "amplitude": force} for axis in ([1, 0, 0], [0, 1, 0])]
    loads[1]["phase_deg"] = -90.0
    made = one_point([*X, (1.0, 0.02, [0, 1, 0])], STEADY_LOAD, {"forces": loads})
    study = {"kind": "sweep", "frequency": hertz(CIRCLE[force]), "settle": {"tolerance": 1e-10}}
    result = timesim.run(made | {"study": study})
    radius = result.amplitude.values[0, :, 0]
    np.testing.assert_allclose(radius[:, 0], list(CIRCLE[force].values()), rtol=1e-8)
    np.testing.assert_allclose(radius[:, 1], list(CIRCLE[force].values()), rtol=1e-8)
    np.testing.assert_allclose(result.slip_share, 1.0, rtol=1e-12)


@pytest.mark.slow
def test_jenkins_element() -> None:
    made = one_point(X, STEADY_LOAD, {"forces": [{"point": "tip", "direction": [1, 0, 0], "amplitude": 0.5}]})
    result = timesim.run(made | {"study": {"kind": "sweep", "frequency": hertz(JENKINS)}})
    np.testing.assert_allclose(x(result).values[0], list(JENKINS.values()), rtol=1e-6, atol=6e-7)


@pytest.mark.slow
def test_inclined_contact_jumps_up_and_down() -> None:
    """Folds 1.28524 and 1.25752 by harmonic balance (15 harmonics): the sweeps leave their branches there."""
    contact = {"friction": 0.4, "tangential_stiffness": 1.0, "normal_stiffness": 1.0, "preload": 1.0}
    contact |= {"normal": [1, 0, 1], "tangent": [1, 0, -1]}
    made = one_point(X, contact, {"forces": [{"point": "tip", "direction": [1, 0, 0], "amplitude": 0.2}]})
    omegas = [1.2, *np.arange(1.24, 1.3001, 0.01), 1.4]
    study = {"kind": "sweep", "frequency": hertz(omegas), "direction": "both", "refine": 2e-6}
    result = timesim.run(made | {"study": study})
    omega = np.round(2 * np.pi * result.frequency.values, 6)
    up, down = (dict(zip(omega, x(result).sel(direction=way).values, strict=True)) for way in ("up", "down"))
    for found, true in ((up, INCLINED_UP), (down, INCLINED_DOWN), (up, INCLINED), (down, INCLINED)):
        for at, amplitude in true.items():
            assert found[at] == pytest.approx(amplitude, rel=1e-6, abs=1.5e-6), at
    jumps = 2 * np.pi * result.jump_low.values.squeeze()
    np.testing.assert_allclose(jumps, [1.28524, 1.25752], atol=5e-5)


@pytest.mark.slow
def test_a_normal_load_that_varies() -> None:
    contact = {"friction": 0.85, "tangential_stiffness": 5.0, "normal_stiffness": 21.0, "preload": 0.0}
    modes = [(12.0, 0.1 * np.sqrt(12.0), [1, 0, 0]), (21.0, 2.0, [0, 0, 1])]
    for force in sorted({case[0] for case in TWO}):
        loads = [
            {"point": "tip", "direction": [1, 0, 0], "amplitude": force},
            {"point": "tip", "direction": [0, 0, 1], "amplitude": 0.1 * force},
        ]
        excitation = {
            "forces": loads,
            "constant_forces": [{"point": "tip", "direction": [0, 0, 1], "amplitude": 100.0}],
        }
        mine = {omega: amplitude for (of, omega), amplitude in TWO.items() if of == force}
        made = one_point(modes, contact, excitation) | {"initial": "static"}
        result = timesim.run(made | {"study": {"kind": "sweep", "frequency": hertz(mine)}})
        found = result.amplitude.values[0, :, 0, ::2]
        np.testing.assert_allclose(found, list(mine.values()), rtol=1e-6, atol=6e-7)


# The blade: finite elements, two shroud contacts

RIGHT = "contacts.right.preload"


def blade(study: dict[str, Any], **overrides: Any) -> xarray.Dataset:
    changes = {"study": {"kind": "sweep"} | study} | overrides
    return timesim.run(str(CONFIGS / "blade_response.yaml"), changes)


@pytest.mark.slow
def test_blade_settled_amplitudes() -> None:
    """Amplitudes of the tip in all three directions, and shares of states that were sampled 4000 times a cycle."""
    truth = json.loads((DATA / "blade_truth.json").read_text())["cases"]
    study = {"frequency": {"values": [640, 720]}, "over": {RIGHT: [3, 5]}, "settle": {"tolerance": 1e-8}}
    result = blade(study).squeeze("direction")
    for name, preload, frequency in (("separation_640Hz", 3, 640), ("slip_720Hz", 5, 720)):
        true, found = truth[name], result.sel({RIGHT: preload, "frequency": frequency})
        assert found.settled.item() == found.period.item() == 1
        amplitude = found.amplitude.sel(point="tip").values
        np.testing.assert_allclose(amplitude, true["steady_limit"]["amplitude"], rtol=2e-6)
        for contact, (_, slip, apart) in true["steady"]["share_stick_slip_separation"].items():
            assert found.slip_share.sel(contact=contact).item() == pytest.approx(slip, abs=1.1e-3)
            assert found.separation_share.sel(contact=contact).item() == pytest.approx(apart, abs=1.1e-3)


@pytest.mark.slow
def test_blade_motions_that_never_repeat_are_recognised() -> None:
    """With a loose right contact: one motion of period 1, one of period 2, and two that repeat neither so nor so."""
    study = {"frequency": {"values": [560, 640, 720, 760]}, "settle": {"tolerance": 1e-6, "max_cycles": 600}}
    result = blade(study, **{RIGHT: 2.0}).squeeze("direction")
    assert result.settled.values.tolist() == [0, 1, 1, 0]
    assert result.period.values.tolist() == [0, 1, 2, 0]
    assert result.attrs["complete"] == 1
    low, high = result.amplitude_band.sel(point="tip", axis="y").values.T
    width = (high - low) / high
    assert width[1] == 0.0
    assert 1e-3 < width[2] < 0.01
    assert np.all(width[[0, 3]] > 0.03)
    assert np.isnan(result.floquet_max.values).tolist() == [True, False, False, True]
    assert np.all(result.floquet_max.values[1:3] < 1)


@pytest.mark.slow
def test_blade_shooting_finds_the_motions_that_marching_finds() -> None:
    study = {"frequency": {"values": [640, 680, 720]}, "settle": {"tolerance": 1e-8}}
    march, shoot = (blade(study | {"periodic": periodic}) for periodic in ("march", "shoot"))
    np.testing.assert_allclose(shoot.amplitude, march.amplitude, rtol=2e-6)
    np.testing.assert_allclose(shoot.floquet_max, march.floquet_max, atol=1e-6)
    assert np.all(shoot.cycles < 0.5 * march.cycles)


@pytest.mark.slow
def test_two_contacts_of_which_one_joins_two_bodies() -> None:
    result = timesim.run(str(CONFIGS / "two_contacts.yaml"))
    assert result.settled.values.all()
    assert result.sizes["jump"] == 1
    up, down = result.jump_low.values[:, 0]
    assert 1.45 < down < up < 1.52
    between = (result.frequency > down) & (result.frequency < up)
    shroud = result.sel(contact="shroud", frequency=between)
    assert np.all(shroud.separation_share.sel(direction="up") < 0.9)
    np.testing.assert_allclose(shroud.separation_share.sel(direction="down"), 1.0)
    z = result.amplitude.sel(point="b", axis="z", frequency=between)
    assert np.all(z.sel(direction="up") > 5 * z.sel(direction="down"))


def test_a_run_goes_on_from_a_point_of_a_sweep(tmp_path: Path):
    """The state kept of a point is on its settled motion: a run from there repeats the amplitude at once."""
    gap = [OSCILLATOR["contacts"][0] | {"preload": -4.0}]
    swept = run({"frequency": {"values": [0.93, 0.94, 0.945]}, "direction": "both"}, contacts=gap)
    path = save(swept, tmp_path / "result.nc")
    for direction in ("up", "down"):
        start = {"from": str(path), "at": {"frequency": 0.945, "direction": direction}}
        force = OSCILLATOR["excitation"] | {"frequency": 0.945}
        study = {"kind": "transient", "cycles": 2}
        found = timesim.run(scene(study, contacts=gap, initial=start, excitation=force))
        expected = swept.amplitude.sel(frequency=0.945, direction=direction)
        np.testing.assert_allclose(found.cycle_amplitude.isel(cycle=0), expected, rtol=1e-7)
        np.testing.assert_allclose(found.cycle_amplitude.isel(cycle=1), expected, rtol=1e-7)
    for at, said in (
        ({"frequency": 0.9, "direction": "up"}, "must be a frequency of the result"),
        ({"frequency": 0.945}, "must name the direction of a point of the sweep"),
    ):
        with pytest.raises(SceneError, match=said):
            load_scene(scene(study, contacts=gap, excitation=force, initial=start | {"at": at}))


def test_the_promise_of_its_accuracy_is_in_the_result() -> None:
    scene = load_scene(CONFIGS / "blade_response.yaml")
    own = attributes(scene, "tsit5", 0.0, 0.0, None)
    assert own["promised_error"] == 1e-6
    assert own["rtol"] == scene.solver().rtol < 1e-7
    given = scene.with_overrides(["solver={method: tsit5}"])
    assert "promised_error" not in attributes(given, "tsit5", 0.0, 0.0, None)


def test_a_motion_of_the_search_for_jumps_that_fails_makes_the_result_incomplete(monkeypatch: pytest.MonkeyPatch):
    """The search goes on without it, so that a jump may be wider than asked for, or none."""
    known, steady = [0.945, 0.96], sweep.steady_states

    def failing(chains: list[Chain], *args: Any, **options: Any) -> list[list[Any]]:
        found = steady(chains, *args, **options)
        return [
            [
                orbit if frequency in known else without_orbit(chain.model, f"no steps are left at {frequency:g} Hz")
                for frequency, orbit in zip(chain.frequencies, own, strict=True)
            ]
            for chain, own in zip(chains, found, strict=True)
        ]

    monkeypatch.setattr(sweep, "steady_states", failing)
    study = {"frequency": {"values": known}, "direction": "up", "refine": 1e-3, "over": {PRELOAD: [-4.0]}}
    with pytest.warns(RuntimeWarning, match="the search for jumps is not exact, as 1 motion of it could not be comp"):
        result = run(study, workers=1)
    assert (result.attrs["complete"], result.jump_low.item(), result.jump_high.item()) == (0, *known)
    assert result.attrs["reason"].endswith("no steps are left at 0.9525 Hz")
