"""A point of a sweep again: the motion that the result knows the amplitude of, and what is refused."""

import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from systems import oscillator_scene
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.engine import event_loop
from timesim.result import netcdf
from timesim.result.folder import prepare_folder

pytestmark = pytest.mark.long

UNITS = {"length": "mm", "force": "N"}
PRELOAD = "contacts.pad.preload"
STUDY = {"kind": "sweep", "frequency": {"values": [0.97, 1.2]}, "direction": "both", "over": {PRELOAD: [-1, 3]}}
POINT = {"frequency": 0.97, "direction": "down", PRELOAD: -1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data, folder = (
        timesim.run(oscillator_scene(3.0) | {"study": STUDY, "units": UNITS}),
        tmp_path_factory.mktemp("sweep"),
    )
    netcdf.save(data, folder / "result.nc")
    return folder


def call(folder: Path, *at: str, options: Sequence[object] = ()) -> Any:
    return CliRunner().invoke(
        app, ["show", str(folder), *(part for one in at for part in ("--at", one)), *map(str, options)]
    )


@pytest.mark.parametrize("point", [POINT, POINT | {PRELOAD: 3, "direction": "up"}])
def test_the_motion_is_that_of_the_point(folder: Path, point: dict[str, Any]):
    known, motion = timesim.open_result(folder).sel(point), timesim.show(folder, point)
    assert motion.sizes["cycle"] == 1
    x = motion["displacement"].values
    np.testing.assert_allclose(x[-1], x[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(motion["cycle_amplitude"].values[0], known["amplitude"].values, rtol=1e-6)
    power = motion["energy_friction"].values[0] * point["frequency"]
    np.testing.assert_allclose(power, known["dissipated_power"].values, rtol=1e-5)
    share = np.mean(motion["contact_state"].values == 1, axis=0)
    np.testing.assert_allclose(share, known["slip_share"].values, atol=0.01)
    first = np.mean(x[1:] * np.exp(-2j * np.pi * np.arange(1, len(x)) / (len(x) - 1))[:, None, None], axis=0)
    np.testing.assert_allclose(np.rad2deg(np.angle(first)), known["phase_deg"].values, atol=1e-3)


def test_the_command_prints_a_table_and_draws(folder: Path):
    done = call(folder, *(f"{name}={value}" for name, value in POINT.items()))
    assert done.exit_code == 0, done.output
    said = done.stdout.splitlines()
    assert said[0].startswith(f"{PRELOAD} -1, direction down, frequency 0.97 Hz: repeats every cycle, settled after")
    known = timesim.open_result(folder).sel(POINT)
    assert said[1].split("  ")[-3:] == ["amplitude [mm]", "phase [degree]", "mean [mm]"]
    assert "power [N·mm/s]  largest |f| [N]  largest n [N]" in done.stdout
    place = known.amplitude.sel(point="tip", axis="x").item(), known.phase_deg.sel(point="tip", axis="x").item()
    assert any(line.split()[:4] == ["tip", "x", f"{place[0]:.5g}", f"{place[1]:.5g}"] for line in said)
    assert any(line.startswith("pad") and f"{known.dissipated_power.item():.5g}" in line.split() for line in said)
    drawn = {path.name for path in (folder / "show" / f"{PRELOAD}=-1,direction=down,frequency=0.97").iterdir()}
    assert {"hysteresis.png", "orbit.png", "contact_states.png", "result.nc"} <= drawn


def test_a_point_goes_into_a_folder_of_ones_choice(folder: Path, tmp_path: Path):
    """Which takes the place of an earlier point only if it is told to, and never that of a run."""
    at, place = [f"{name}={value}" for name, value in POINT.items()], tmp_path / "point"
    assert call(folder, *at, options=("-o", place)).exit_code == 0
    assert {"hysteresis.png", "orbit.png", "result.nc"} <= {path.name for path in place.iterdir()}
    (place / "orbit.pdf").touch()
    other = [*at[:1], "direction=up", *at[2:]]
    refused = call(folder, *other, options=("--output", place))
    assert refused.exit_code == 2
    assert f"{place / 'result.nc'} exists; choose another folder or give --force" in refused.stderr
    assert call(folder, *other, options=("-o", place, "--force")).exit_code == 0
    assert "direction up" in timesim.open(place).attrs["title"]
    assert not (place / "orbit.pdf").exists()
    (place / "scene.yaml").touch()
    for run in (folder, place):
        refused = call(folder, *at, options=("-o", run, "--force"))
        assert refused.exit_code == 2
        assert f"{run} is the folder of a run; choose another" in refused.stderr


def test_the_title_of_the_pictures_names_the_point_first(folder: Path):
    """The end of a long title is cut off."""
    for point in (POINT, POINT | {"direction": "up"}):
        title = timesim.show(folder, point).attrs["title"]
        assert title.startswith(f"{PRELOAD} -1, direction {point['direction']}, frequency 0.97 Hz")


def test_a_contact_that_never_sticks_has_no_share_of_rounding(folder: Path, tmp_path: Path):
    data = timesim.open_result(folder).load()
    data["slip_share"][:], data["separation_share"][:] = 0.45 - 1e-15, 0.55
    netcdf.save(data, tmp_path / "result.nc")
    done = call(tmp_path, *(f"{name}={value}" for name, value in POINT.items()))
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("pad")]
    assert line.split()[1:4] == ["0", "0.45", "0.55"]


def test_a_mean_of_rounding_is_none(folder: Path, tmp_path: Path):
    data = timesim.open_result(folder).load()
    data["harmonic_amplitude"].loc[{"harmonic": 0, "axis": "x"}] = -1e-14
    netcdf.save(data, tmp_path / "result.nc")
    done = call(tmp_path, *(f"{name}={value}" for name, value in POINT.items()))
    x, y = (next(line for line in done.stdout.splitlines() if line.split()[:2] == ["tip", axis]) for axis in "xy")
    assert x.split()[-1] == "0"
    assert float(y.split()[-1]) == pytest.approx(
        data["harmonic_amplitude"].sel(POINT).sel(harmonic=0, axis="y").item(), rel=1e-4
    )


@pytest.mark.parametrize("irregular", [0, 1])
def test_ten_cycles_of_a_motion_without_a_period_are_shown(folder: Path, tmp_path: Path, irregular: int):
    data = timesim.open_result(folder).load()
    data["period"][:], data["settled"][:], data["irregular"][:] = 0, 0, irregular
    netcdf.save(data, tmp_path / "result.nc")
    done = call(tmp_path, *(f"{name}={value}" for name, value in POINT.items()))
    said = "does not repeat in" if irregular else "not settled after"
    assert re.search(said + ".*; of its last 10 are the numbers, 10 more are drawn", done.stdout.splitlines()[0])
    (path,) = (tmp_path / "show").glob("*/result.nc")
    assert timesim.open_result(path).sizes["cycle"] == 10


def test_a_motion_that_is_cut_off_before_its_first_sample(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(event_loop, "advance", interrupted)
    done = call(folder, *(f"{name}={value}" for name, value in POINT.items()))
    assert done.exit_code == 1
    assert "incomplete: interrupted in cycle 1 of 1" in done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("pad")]
    assert line.split()[-2:] == ["nan", "nan"]


def test_a_scene_that_has_changed_since_is_doubted(folder: Path, tmp_path: Path):
    """As where a file of matrices has."""
    data = timesim.open_result(folder).load()
    data.attrs["scene"] = data.attrs["scene"].replace("damping_ratio: 0.02", "damping_ratio: 0.03")
    netcdf.save(data, tmp_path / "result.nc")
    with pytest.warns(timesim.SceneWarning, match="a file that the scene names may have changed since") as said:
        motion = timesim.show(tmp_path, POINT)
    x, known = motion["displacement"].sel(point="tip").values, data["amplitude"].sel(POINT | {"point": "tip"}).values
    moved = np.ptp(x, axis=0)[1] / 2
    assert f"tip y moves by {moved:.5g}, not by {known[1]:.5g} as in the result" in str(said[0].message)
    assert [one.filename for one in said] == [__file__]


def test_a_point_goes_with_the_run_that_it_was_of(tmp_path: Path):
    point, own = tmp_path / "show" / "frequency=1", tmp_path / "show" / "own"
    for name in (point / "result.nc", own / "thesis.tex", tmp_path / "result.nc"):
        name.parent.mkdir(parents=True, exist_ok=True)
        name.touch()
    prepare_folder(tmp_path, "scene", overwrite=True)
    assert not point.exists()
    assert (own / "thesis.tex").exists()
    shutil.rmtree(own)
    prepare_folder(tmp_path, "scene", overwrite=True)
    assert not (tmp_path / "show").exists()


@pytest.mark.parametrize(
    ("at", "message"),
    [
        (["frequncy=0.97"], r"--at frequncy=0.97: is no axis of the result \(did you mean frequency\?\)"),
        (["preload=3"], rf"--at preload=3.0: is no axis of the result \(did you mean {PRELOAD}\?\)"),
        (["frequency=0,97"], r"--at frequency=0,97: must be a frequency .*\(with a point for the decimals; it has"),
        (["frequency=0.98"], r"--at frequency=0.98: must be a frequency of the result \(it has 0.97, 1.2\)"),
        (["direction=left"], r"--at direction=left: must be a direction .*up, down"),
        (["frequency"], "write it as AXIS=VALUE"),
        (
            ["frequency=0.97", "frequency=1.2"],
            "--at frequency=1.2: frequency is given already, as 0.97; show one",
        ),
        (["frequency=0.97", "direction=up"], rf"--at {PRELOAD}=...: must name the {PRELOAD} .*{PRELOAD} has -1, 3"),
        (["frequency=0.97"], rf"4 match: {PRELOAD} -1, direction up; {PRELOAD} -1, direction down; {PRELOAD} 3"),
    ],
)
def test_a_point_that_is_not_there_is_named(folder: Path, at: list[str], message: str):
    done = call(folder, *at)
    assert done.exit_code == 2
    assert re.search(message, done.stderr), done.stderr


def test_the_sweep_of_a_result_with_groups(folder: Path, tmp_path: Path):
    data = timesim.open_result(folder)
    netcdf.save({"": data[["final_phase_deg"]], "sweep": data.drop_attrs(deep=False)}, tmp_path / "result.nc")
    one, other = (timesim.show(place, POINT) for place in (folder, tmp_path))
    np.testing.assert_array_equal(one["displacement"], other["displacement"])


def test_a_result_without_states_says_so(tmp_path: Path):
    data = timesim.run(oscillator_scene(3.0) | {"study": STUDY | {"frequency": {"values": [0.97]}}})
    netcdf.save(data.drop_vars("final_modal_displacement"), tmp_path / "result.nc")
    done = call(tmp_path, "frequency=0.97")
    assert done.exit_code == 2
    assert "holds no final state" in done.stderr
    with pytest.raises(ValueError, match="holds no final state"):
        timesim.show(tmp_path, POINT)
    netcdf.save(data.drop_vars("dissipated_power"), tmp_path / "result.nc")
    assert "lacks dissipated_power (it is of an earlier version of timesim" in call(tmp_path).stderr
    netcdf.save(
        data.isel({"direction": 0, "frequency": 0, PRELOAD: 0}, missing_dims="ignore").assign_attrs(study="transient"),
        tmp_path / "result.nc",
    )
    assert "is of one run, a transient" in call(tmp_path, "frequency=0.97").stderr
    netcdf.save(data.drop_vars("final_modal_displacement").assign_attrs(study="hbm"), tmp_path / "result.nc")
    assert "is of harmonic balance, whose solutions are not integrated (a sweep" in call(tmp_path).stderr
    netcdf.save(data.drop_vars("final_modal_displacement").assign_attrs(study="element"), tmp_path / "result.nc")
    assert "is of a contact under prescribed motion (a sweep" in call(tmp_path).stderr
