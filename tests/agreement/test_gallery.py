"""Scenes of `configs` whose answers are known in closed form, or by symmetry; their comments derive them."""

from pathlib import Path

import numpy as np
import pytest

import timesim

pytestmark = pytest.mark.long

DIFFERENCE = np.array([[1.0, -1.0], [-1.0, 1.0]])
CONFIGS = Path(__file__).parents[2] / "configs"


def run(name, **overrides):
    return timesim.run(timesim.load_scene(CONFIGS / f"{name}.yaml", overrides))


def turning_points(result):
    """Extremes of the displacement along x, by the parabola through its rates at the samples beside them."""
    x, v, t = (result[name].values.squeeze() for name in ("displacement", "velocity", "time"))
    x, v = x[:, 0], v[:, 0]
    i = np.flatnonzero(v[:-1] * v[1:] < 0)
    until = v[i] / (v[i] - v[i + 1]) * np.diff(t)[i]
    return x[i] + v[i] * until / 2


def test_free_decay_under_dry_friction():
    stiffness, limit, elastic = 2 * (2 * np.pi * 5) ** 2, 12.0, 6e-5
    expected, here = [], 0.1
    for sign in (-1, 1) * 4:
        energy = stiffness * here**2 / 2 - limit * (here - 2 * elastic)
        here = (np.sqrt(limit**2 + 2 * stiffness * energy) - limit) / stiffness
        expected.append(sign * here)
    np.testing.assert_allclose(turning_points(run("free_decay"))[:8], expected, rtol=0, atol=1e-7)
    assert np.abs(expected[-1]) < 0.004
    rigid = 0.1 - 2 * np.arange(1, 9) * limit / stiffness
    np.testing.assert_allclose(np.abs(expected), rigid, atol=8 * 2 * elastic)


def slider_frequencies(amplitude, force, limit=0.5, stiffness=1.0):
    """Both frequencies [Hz] at which one harmonic of a given amplitude balances; NaN where it does not."""
    elastic = limit / stiffness
    theta = np.arccos(np.maximum(1 - 2 * elastic / amplitude, -1))
    storing = stiffness / np.pi * (theta - np.sin(2 * theta) / 2)
    losing = 4 * limit * np.maximum(amplitude - elastic, 0) / (np.pi * amplitude**2)
    with np.errstate(invalid="ignore"):
        drive = np.sqrt((force / amplitude) ** 2 - losing**2)
        return np.sqrt([1 + storing - drive, 1 + storing + drive]) / (2 * np.pi)


def test_one_harmonic_with_an_elastic_slider():
    result = run("one_slider")
    amplitude = result["harmonic_amplitude"].sel(point="body", axis="x", harmonic=1).values
    slips = (amplitude > 0.51) & (amplitude < 0.999 * 0.5 / (1 - np.pi * 0.45 / 2))
    assert np.count_nonzero(slips) > 20
    known = slider_frequencies(amplitude[slips], 0.45)
    error = np.abs(known / result["frequency"].values[slips] - 1).min(axis=0)
    assert error.max() < 1e-5
    assert amplitude.max() == pytest.approx(0.5 / (1 - np.pi * 0.45 / 2), rel=1e-3)
    height, frequency = amplitude[slips], result["frequency"].values[slips]
    loss = 4 * 0.5 * (height - 0.5)
    np.testing.assert_allclose(result["dissipated_power"].values[slips, 0], frequency * loss, rtol=1e-5)
    # The force does the work that friction loses: pi F A sin(lag) = 4 mu N (A - d).
    lag = -np.deg2rad(result["phase_deg"].sel(point="body", axis="x").values[slips])
    np.testing.assert_allclose(np.sin(lag), loss / (np.pi * 0.45 * height), rtol=1e-4)
    low = np.abs(known[0] / frequency - 1) < 1e-5
    assert low.any()
    assert np.all((np.cos(lag) > 0) == low)


@pytest.mark.slow
def test_the_loss_of_an_elastic_slider_in_time():
    """Between two turning points 2 A apart it is 4 mu N (A - d) whatever the motion between them."""
    study = {"kind": "sweep", "frequency": {"values": [0.175, 0.19, 0.22]}}
    result = run("one_slider", study=study, **{"structure.modes.0.damping_ratio": 0.01})
    amplitude, frequency = result["amplitude"].sel(point="body", axis="x").values[0], result["frequency"].values
    assert np.all(result["settled"] == 1)
    assert np.all(result["slip_share"] > 0.1)
    expected = 4 * 0.5 * (amplitude - 0.5) * frequency
    np.testing.assert_allclose(result["dissipated_power"].values[0, :, 0], expected, rtol=1e-6)
    phase = result["phase_deg"].sel(point="body", axis="x").values[0]
    assert np.all(np.diff(phase) < 0)
    assert -90 < phase[0] < 0
    assert -180 < phase[-1] < -90


@pytest.mark.slow
def test_no_peak_where_the_force_exceeds_what_friction_can_dissipate():
    """Above 4 mu N/pi the response grows without bound towards the natural frequency of the mass on its spring."""
    ends = {"study.frequency": {"from": 0.127, "to": 0.1588}, "study.time_samples": 1024}
    result = run("one_slider", **{"excitation.modal_force.0.amplitude": 0.7}, **ends)
    amplitude = result["harmonic_amplitude"].sel(point="body", axis="x", harmonic=1).values[-1]
    assert amplitude > 40
    assert slider_frequencies(amplitude, 0.7)[0] == pytest.approx(0.1588, rel=1e-6)


def test_the_loss_of_sliders_in_parallel_is_that_of_masing():
    result = run("sliders")
    amplitude = result["cycle_amplitude"].sel(point="body", axis="x").values[-1]
    stiffness, limit = np.array([5.0, 10.0, 20.0]), np.array([0.4, 0.5, 0.3])
    elastic = limit / stiffness
    assert np.all(elastic < 0.5 * amplitude)
    loading = np.where(amplitude > elastic, limit * (amplitude - elastic / 2), stiffness * amplitude**2 / 2)
    loss = 8 * loading - 4 * amplitude * np.minimum(stiffness * amplitude, limit)
    np.testing.assert_allclose(result["energy_friction"].values[-1], loss, rtol=1e-8)


def rotating(frequency, mass=0.5, own=30.0, ratio=0.01, force=20.0, limit=10.0, stiffness=5.0e4):
    """Complex amplitude of x under a rotating force, and the radius of the slip."""
    omega, elastic = 2 * np.pi * frequency, limit / stiffness
    s = mass * ((2 * np.pi * own) ** 2 - omega**2)
    c = 2 * ratio * 2 * np.pi * own * mass * omega
    square, half = s**2 + c**2, limit * c
    rest = force**2 - limit**2 - 2 * limit * s * elastic - square * elastic**2
    radius = (np.sqrt(half**2 + square * rest) - half) / square
    size = np.hypot(radius, elastic)
    return force / (s + 1j * c + stiffness * elastic * (elastic + 1j * radius) / size**2), radius


@pytest.mark.parametrize(
    ("accuracy", "integrated"), [("standard", 1e-6), pytest.param("reference", 1e-8, marks=pytest.mark.slow)]
)
def test_slip_round_a_circle_under_a_rotating_force(accuracy, integrated):
    result = run("rotating_force", solver={"accuracy": accuracy})
    sweep, balance = result["sweep"].isel(direction=0).to_dataset(), result["hbm"].to_dataset()
    assert np.all(sweep["settled"] == 1)
    for data, tolerance in ((sweep, integrated), (balance, 1e-6)):
        known, radius = rotating(data["frequency"].values)
        axes = data.sel(point="disk", axis=["x", "y"])
        np.testing.assert_allclose(axes["amplitude"], np.abs(known)[:, None] * [1, 1], rtol=tolerance)
        lag = np.rad2deg(np.angle(known))[:, None] - [0, 90]
        assert np.abs((axes["phase_deg"] - lag + 180) % 360 - 180).max() < 180 * tolerance
        power = 2 * np.pi * data["frequency"].values * 10.0 * radius
        np.testing.assert_allclose(data["dissipated_power"].values[:, 0], power, rtol=1e-6)
        assert np.all(data["slip_share"] == 1)


@pytest.mark.slow
def test_den_hartog_by_contacts_that_become_rigid():
    """At each turn the contact sticks for a time of the order of (k/k_t)^(1/2): two extrapolations leave its cube."""
    result = run("den_hartog")
    assert np.all(result["settled"] == 1)
    assert np.all(result["slip_share"] > 0.98)
    soft, middle, hard = result["amplitude"].sel(point="body", axis="x").values[:, 0]
    first, second = 2 * middle - soft, 2 * hard - middle
    ratio = result["frequency"].values / 4.0
    turn = np.pi / ratio
    magnified, rubbed = 1 / (1 - ratio**2), np.sin(turn) / (ratio * (1 + np.cos(turn)))
    known = 100.0 / (2 * (2 * np.pi * 4.0) ** 2) * np.sqrt(magnified**2 - (0.3 * rubbed) ** 2)
    np.testing.assert_allclose(second + (second - first) / 3, known, rtol=1e-6)


@pytest.mark.parametrize("periodic", ["march", "shoot"])
def test_a_clutch_that_slips_all_the_time(periodic):
    """It passes on its capacity of 90 N m and none of the ripple of 40 N m."""
    few = {"study.frequency": {"values": [5.0, 12.0]}, "study.over": {"contacts.clutch.preload": [300]}}
    data = run("clutch", **few, **{"study.periodic": periodic}).squeeze().sel(axis="x")
    assert np.all(data["settled"] == 1)
    assert np.all(data["slip_share"] == 1)
    omega = 2 * np.pi * data["frequency"].values
    speed = np.array([(100 - 90) / 0.5, (90 - 100) / 2.0, (90 - 100) / 2.0])
    np.testing.assert_allclose(data["drift"], speed / data["frequency"].values[:, None], rtol=1e-6)
    np.testing.assert_allclose(data["dissipated_power"], 90 * (speed[0] - speed[1]), rtol=1e-6)
    swing = 40 / (-0.2 * omega**2 + 0.5j * omega)
    np.testing.assert_allclose(data["amplitude"].sel(point="engine"), np.abs(swing), rtol=1e-6)
    np.testing.assert_allclose(data["phase_deg"].sel(point="engine"), np.rad2deg(np.angle(swing)), rtol=1e-6)
    assert np.all(data["amplitude"].sel(point=["gearbox", "car"]) < 1e-8)
    # The slowest decay is that of the speed of gearbox and car against its drag; their place does not count.
    mass, stiffness, damping = np.diag([0.05, 3.0]), 900 * DIFFERENCE, 0.8 * DIFFERENCE + np.diag([0.0, 2.0])
    rate = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]]
    )
    slowest = np.sort(np.linalg.eigvals(rate).real)[-2]
    np.testing.assert_allclose(data["floquet_max"], np.exp(slowest / data["frequency"]), rtol=1e-7)


def test_two_masses_that_meet_move_as_one_at_a_wall():
    both = run("two_masses")
    x = both["displacement"].sel(axis="x").values
    np.testing.assert_allclose(x[:, 0], -x[:, 1], atol=1e-9 * np.abs(x).max())
    wall = {
        "structure.matrices": {
            "mass": [[25]], "stiffness": [[98696]], "damping_ratio": 0.07, "points": {"a": {"x": 0}}
        },
        "contacts.bumper.against": "ground",
        "contacts.bumper.normal_stiffness": 5.76e7,
        "excitation.forces": [{"point": "a", "direction": [1, 0, 0], "amplitude": 1000.0}],
    }  # fmt: skip
    alone = run("two_masses", **wall)
    np.testing.assert_allclose(alone["displacement"].sel(axis="x").values[:, 0], x[:, 0], atol=1e-7 * np.abs(x).max())
    assert alone.sizes["event"] == both.sizes["event"] > 40
    assert np.abs(x).max() > 5 * x[:, 0].max()


def test_a_blade_between_neighbours_that_move_against_it_moves_as_between_walls():
    """Engine order three of six: what a shroud sees, its slip and its loss are twice those at a wall."""
    frequencies = {"kind": "sweep", "frequency": {"values": [420.0, 450.0, 480.0]}, "periodic": "shoot"}
    phases = {f"excitation.forces.{blade}.phase_deg": 180 * (blade % 2) for blade in range(6)}
    wheel = run("bladed_disk", study=frequencies, **phases).isel(direction=0)
    wall = {"point": "b", "tangent": [0, 0, 1], "friction": 0.3, "tangential_stiffness": 300, "normal_stiffness": 600}
    blade = {
        "structure": {
            "matrices": {
                "mass": [[2e-4, 0], [0, 2e-4]],
                "stiffness": [[1020, -200], [-200, 920]],
                "damping_ratio": 0.002,
                "points": {"b": {"x": 0, "z": 1}},
            }
        },
        "contacts": [wall | {"name": side, "normal": [n, 0, 0], "preload": 20} for side, n in (("a", 1), ("b", -1))],
        "excitation": {"forces": [{"point": "b", "direction": [0, 0, 1], "amplitude": 8}]},
        "study": frequencies,
    }
    alone = timesim.run(blade).isel(direction=0)
    for name in ("amplitude", "slip_share", "dissipated_power"):
        first, own = wheel[name].values[:, 0], alone[name].values[:, 0] * (2 if name == "dissipated_power" else 1)
        np.testing.assert_allclose(first, own, rtol=1e-6, atol=1e-9 * np.abs(own).max())
        same = np.ptp(wheel[name].values, axis=1)
        assert same.max() < 1e-6 * np.abs(own).max()
    assert np.all((wheel["slip_share"] > 0.02) & (wheel["slip_share"] < 0.5))


def test_a_wave_round_a_bladed_disk():
    """All blades by the same amplitude, each behind the one before; about 356 Hz after two cycles only."""
    fewer = {"study.frequency": {"values": [354.0, 356.0, 360.0]}}
    both = run("bladed_disk", **fewer)
    sweep = both["sweep"].to_dataset().sel(axis="z").isel(direction=0)
    amplitude, step = sweep["amplitude"].values, np.diff(sweep["phase_deg"].values, axis=1)
    np.testing.assert_allclose(amplitude, np.tile(amplitude[:, :1], 6), rtol=1e-6)
    assert np.abs((step + 120 + 180) % 360 - 180).max() < 1e-3
    assert list(sweep["period"].values) == [1, 2, 1]
    assert amplitude[1, 0] < 0.9 * amplitude[0, 0]
    balance = both["hbm"]
    unstable = balance["frequency"].values[balance["stable"].values == 0]
    assert unstable.size > 0
    assert np.all((unstable > 354.5) & (unstable < 357.5))
    assert np.abs(both["relative_difference"].sel(axis="z").values[0, [0, 2]]).max() < 1e-4
