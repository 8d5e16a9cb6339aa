"""The commands: exit status, messages, and the files that they leave."""

import errno
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from bad_scenes import BAD_SCENES, BadScene
from commands import fill_disk
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.engine import event_loop
from timesim.result import netcdf
from timesim.result.folder import locked_folder
from timesim.study import element_map

CONFIGS = Path(__file__).parents[2] / "configs"
OSCILLATOR = str(CONFIGS / "oscillator.yaml")
SHORT = ("--set", "study.cycles=3", "--set", "study.record_last=2", "--set", "solver.accuracy=draft")

TOO_FEW = "{method: rk4, max_steps: 205}"  # enough for a cycle without transitions


def call(*args: object) -> tuple[int, str, str]:
    found = CliRunner().invoke(app, [str(arg) for arg in args])
    return found.exit_code, found.stdout, found.stderr


@pytest.mark.parametrize("bad", BAD_SCENES, ids=lambda bad: f"{bad.key}: {bad.rule}")
def test_a_bad_scene_is_refused_before_anything_runs(bad: BadScene, tmp_path: Path):
    scene, folder = tmp_path / "scene.yaml", tmp_path / "run"
    scene.write_text(bad.text)
    status, _, error = call("run", scene, "-o", folder)
    assert status == 2
    assert bad.key in error or bad.rule in error
    assert "Traceback" not in error
    assert not folder.exists()


def test_run_writes_a_result_that_opens_and_runs_again(tmp_path: Path):
    status, out, _ = call("run", OSCILLATOR, "-o", tmp_path / "one", "--no-plots", *SHORT)
    assert status == 0
    assert "transitions" in out
    first = timesim.open_result(tmp_path / "one")
    assert first.attrs["complete"] == 1
    assert first.sizes["time"] == 2 * 200 + 1
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == ["result.nc", "scene.yaml"]
    assert call("run", tmp_path / "one" / "scene.yaml", "-o", tmp_path / "two", "--no-plots")[0] == 0
    second = timesim.open_result(tmp_path / "two")
    np.testing.assert_array_equal(first["displacement"], second["displacement"])


def test_an_existing_result_is_kept_without_force(tmp_path: Path):
    assert call("run", OSCILLATOR, "-o", tmp_path, "--no-plots", *SHORT)[0] == 0
    before = (tmp_path / "result.nc").read_bytes()
    status, _, error = call("run", OSCILLATOR, "-o", tmp_path, "--no-plots", *SHORT)
    assert status == 2
    assert "--force" in error
    assert (tmp_path / "result.nc").read_bytes() == before
    assert call("run", OSCILLATOR, "-o", tmp_path, "--no-plots", "--force", *SHORT)[0] == 0


@pytest.mark.long
def test_pictures_are_drawn_by_run_and_again_by_plot(tmp_path: Path):
    status, out, _ = call("run", OSCILLATOR, "-o", tmp_path, *SHORT)
    assert status == 0
    drawn = sorted(tmp_path.glob("*.png"))
    assert f"{len(drawn)} pictures" in out
    assert len(drawn) == 7
    for path in drawn:
        path.unlink()
    for given in (tmp_path, tmp_path / "result.nc"):
        assert call("plot", given)[0] == 0
        assert sorted(tmp_path.glob("*.png")) == drawn
        for path in drawn:
            path.unlink()
    elsewhere = tmp_path / "figures" / "pdf"
    assert call("plot", tmp_path, "-o", elsewhere, "--format", "pdf")[0] == 0
    assert sorted(path.stem for path in elsewhere.iterdir()) == [path.stem for path in drawn]
    assert not list(tmp_path.glob("*.pdf"))
    status, _, error = call("plot", tmp_path, "--output", tmp_path / "result.nc")
    assert (status, "cannot be made" in error) == (2, True)


def test_an_interrupt_while_pictures_are_drawn_says_that_the_result_is_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_: Any, **__: Any) -> Any:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("timesim.study.registry.draw", interrupted)
    status, out, error = call("run", OSCILLATOR, "-o", tmp_path, *SHORT)
    assert status == 1
    assert out.endswith(f"result: {tmp_path / 'result.nc'}\n")
    assert f"interrupted\nthe result is saved; timesim plot {tmp_path} draws the pictures again" in error
    assert timesim.open(tmp_path).attrs["complete"] == 1


def test_a_disk_that_is_full_when_pictures_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    fill_disk(monkeypatch, ".png.")
    status, out, error = call("run", OSCILLATOR, "-o", tmp_path, *SHORT)
    assert status == 1
    assert "transitions" in out
    assert f"result: {tmp_path / 'result.nc'}" in out
    assert ".png cannot be written: No space left on device\n" in error
    assert f"the result is saved; timesim plot {tmp_path} draws the pictures again" in error
    assert timesim.open_result(tmp_path).attrs["complete"] == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["result.nc", "scene.yaml"]
    status, _, error = call("plot", tmp_path)
    assert status == 1
    assert ".png cannot be written" in error


def test_a_result_that_the_disk_has_no_room_for_is_saved_elsewhere_and_without_its_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """What is left of the disk is enough for a result without samples."""
    folder, spare, limit = tmp_path / "run", tmp_path / "spare", 100_000
    spare.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(spare))
    fsync = os.fsync

    def full(handle: int) -> None:
        if os.readlink(f"/proc/self/fd/{handle}").startswith(str(folder)) and os.fstat(handle).st_size > limit:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
    call_of_run = ("run", OSCILLATOR, "-o", folder, "--no-plots", *SHORT, "--set", "study.samples_per_cycle=2000")
    status, _, error = call(*call_of_run)
    (whole,) = spare.iterdir()
    assert status == 1
    assert f"result.nc cannot be written: No space left on device; the whole of it is in {whole}: move it" in error
    assert f"all but its samples is in {folder / 'result.nc'}, marked complete = 0" in error
    there, here = timesim.open_result(whole), timesim.open_result(folder)
    assert (there.attrs["complete"], there.sizes["time"]) == (1, 4001)
    assert (here.attrs["complete"], here.sizes["time"]) == (0, 0)
    assert "samples are left out" in here.attrs["reason"]
    np.testing.assert_array_equal(here["final_modal_displacement"], there["final_modal_displacement"])


@pytest.mark.parametrize("where", ["recorder.sample", "transient.contact_forces"])
def test_a_run_whose_samples_do_not_fit_into_memory_keeps_all_else(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def short_of_memory(*_: Any, **__: Any) -> Any:
        monkeypatch.undo()
        raise MemoryError

    monkeypatch.setattr(f"timesim.study.{where}", short_of_memory)
    status, out, error = call("run", OSCILLATOR, "-o", tmp_path / "run", *SHORT)
    assert status == 1
    assert "transitions" in out
    assert "incomplete: the memory does not suffice for 401 samples, which are left out; a smaller" in error
    result = timesim.open_result(tmp_path / "run")
    assert call("run", OSCILLATOR, "-o", tmp_path / "whole", "--no-plots", *SHORT)[0] == 0
    whole = timesim.open_result(tmp_path / "whole")
    assert (result.attrs["complete"], result.sizes["time"]) == (0, 0)
    for name in ("cycle_amplitude", "event_time", "final_modal_displacement", "energy_residual"):
        np.testing.assert_array_equal(result[name], whole[name])
    assert result.attrs["estimated_error"] == whole.attrs["estimated_error"]


def test_plot_of_a_result_without_a_point_says_so(tmp_path: Path):
    """As of a run that was interrupted before the first; here, in full stick, nothing is marched."""
    study, stuck = "study={kind: sweep, frequency: {values: [1.2, 1.3]}}", "contacts.pad.preload=60"
    assert call("run", OSCILLATOR, "-o", tmp_path, "--no-plots", "--set", study, "--set", stuck)[0] == 0
    result = timesim.open_result(tmp_path)
    result["amplitude"] = xarray.full_like(result["amplitude"], np.nan)
    netcdf.save(result, tmp_path / "result.nc")
    status, out, _ = call("plot", tmp_path)
    assert status == 0
    assert out == "there is nothing to draw: no point of the result was computed\n"


def test_plot_of_no_result(tmp_path: Path):
    status, _, error = call("plot", tmp_path)
    assert status == 2
    assert "no result file" in error


@pytest.mark.parametrize("arguments", [("run", OSCILLATOR, "-o"), ("plot",), ("show",)])
def test_a_name_that_no_file_can_have(arguments: tuple[str, ...], tmp_path: Path):
    status, _, error = call(*arguments, tmp_path / ("a" * 300))
    assert status == 2
    assert "a" * 300 in error


def test_a_run_that_fails_saves_what_it_has(tmp_path: Path):
    arguments = ("--set", "study.cycles=40", "--set", "study.record_last=40", "--set", f"solver={TOO_FEW}")
    status, _, error = call("run", OSCILLATOR, "-o", tmp_path, "--no-plots", *arguments)
    assert status == 1
    assert "budget of 205 steps" in error
    assert "'pad'" in error
    assert "solver.max_steps" in error
    result = timesim.open_result(tmp_path)
    assert result.attrs["complete"] == 0
    assert "budget" in result.attrs["reason"]
    assert 0 < result.sizes["time"] < 40 * 200


def test_from_python_a_failed_run_warns_and_returns_what_it_has():
    with pytest.warns(RuntimeWarning, match="incomplete"):
        result = timesim.run(OSCILLATOR, {"solver": {"method": "rk4", "max_steps": 205}})
    assert result.attrs["complete"] == 0


def test_from_python_overrides_may_complete_a_scene():
    """As those of the command do; without them the file would be refused."""
    scene = timesim.load_scene(OSCILLATOR).source.data
    scene = scene | {"study": {"kind": "transient"}}
    assert timesim.run(scene, {"study.cycles": 1}).sizes["cycle"] == 1
    assert timesim.run(timesim.load_scene(OSCILLATOR), {"study.cycles": 1, "study.record_last": 1}).sizes["cycle"] == 1


def test_a_run_taken_up_is_the_same_run(tmp_path: Path):
    both = ("--no-plots", "--set", "solver.accuracy=draft", "--set", "study.record_last=1")
    assert call("run", OSCILLATOR, "-o", tmp_path / "whole", *both, "--set", "study.cycles=7")[0] == 0
    assert call("run", OSCILLATOR, "-o", tmp_path / "half", *both, "--set", "study.cycles=4")[0] == 0
    taken_up = f"initial={{from: {tmp_path / 'half' / 'result.nc'}}}"
    assert call("run", OSCILLATOR, "-o", tmp_path / "rest", *both, "--set", "study.cycles=3", "--set", taken_up)[0] == 0
    whole, rest = timesim.open_result(tmp_path / "whole"), timesim.open_result(tmp_path / "rest")
    for name in ("final_modal_displacement", "final_modal_velocity", "final_slip", "final_contact_state"):
        np.testing.assert_allclose(whole[name], rest[name], rtol=0, atol=1e-12)


def test_a_result_is_saved_before_anything_is_said_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """What reads the summary may be gone, as `head` is after a line."""

    def closed(*_: Any, **__: Any) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("builtins.print", closed)
    assert (
        call(
            "run", OSCILLATOR, "-o", tmp_path, "--no-plots", "--set", "study.cycles=3", "--set", "study.record_last=1"
        )[0]
        == 1
    )
    assert timesim.open_result(tmp_path).attrs["complete"] == 1


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, "in the background"])
def test_an_interrupted_run_saves_what_it_has(
    sent: signal.Signals | str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    if isinstance(sent, str):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sent = signal.SIGTERM
    ignored = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # as under nohup
    own = signal.getsignal(signal.SIGTERM)
    calls, advance = [], event_loop.advance

    def interrupted(*args: Any) -> Any:
        calls.append(1)
        if len(calls) == 3:
            os.kill(os.getpid(), sent)
        return advance(*args)

    monkeypatch.setattr(event_loop, "advance", interrupted)
    arguments = ("--set", "study.cycles=1000", "--set", "study.record_last=1000", "--set", "solver.accuracy=draft")
    status, _, error = call("run", OSCILLATOR, "-o", tmp_path, "--no-plots", *arguments)
    signal.signal(signal.SIGHUP, ignored)
    assert status == 1
    assert "interrupted in cycle" in error
    assert "marked complete = 0; another scene goes on from there with initial: {from: ...}" in error
    result = timesim.open_result(tmp_path)
    assert result.attrs["complete"] == 0
    assert 0 < result.sizes["cycle"] < 1000
    assert result["time"][-1] < 1000 / 1.39
    assert signal.getsignal(signal.SIGTERM) is own


@pytest.mark.parametrize(("in_cycle", "in_saving"), [(1, 1), (0, 2), (1, 2), (0, 3)])
def test_signals_while_saving(in_cycle: int, in_saving: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A result is saved whole, whether the study was interrupted or had come to its end; the third signal is obeyed."""
    calls, advance, fsync = [], event_loop.advance, os.fsync

    def interrupted(*args: Any) -> Any:
        calls.append(1)
        if len(calls) == 3 and in_cycle:
            os.kill(os.getpid(), signal.SIGINT)
        return advance(*args)

    def slow(handle: int) -> None:
        if "result.nc" in os.readlink(f"/proc/self/fd/{handle}"):
            for sent in (signal.SIGTERM, signal.SIGINT, signal.SIGINT)[:in_saving]:
                os.kill(os.getpid(), sent)
        fsync(handle)

    monkeypatch.setattr(event_loop, "advance", interrupted)
    monkeypatch.setattr(os, "fsync", slow)
    cycles = ("--set", f"study.cycles={1000 if in_cycle else 3}", "--set", "study.record_last=3")
    status, *_ = call("run", OSCILLATOR, "-o", tmp_path, "--no-plots", *cycles, "--set", "solver.accuracy=draft")
    if in_cycle + in_saving > 2:
        assert status not in (0, None)
        assert not (tmp_path / "result.nc").exists()
        return
    assert status == in_cycle
    assert timesim.open_result(tmp_path).attrs["complete"] == 1 - in_cycle


@pytest.mark.long
def test_an_interrupted_map_saves_what_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    cycle = element_map.MapMarch._cycle

    def interrupted(march: element_map.MapMarch, number: int, rows: np.ndarray) -> np.ndarray:
        kept = cycle(march, number, rows)
        if number == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return kept

    monkeypatch.setattr(element_map.MapMarch, "_cycle", interrupted)
    axes = ("--set", "study.A={from: 0.0, to: 2.0, num: 7}", "--set", "study.B={from: 0.0, to: 2.0, num: 7}")
    status, out, error = call("run", CONFIGS / "figure7.yaml", "-o", tmp_path, "--no-plots", *axes)
    result = timesim.open_result(tmp_path)
    settled = result["settled"].values == 1
    assert status == 1
    assert f"interrupted with {np.sum(~settled)} of 49 points unsettled (settled = 0)" in error
    assert "creeping" not in out
    assert result.attrs["complete"] == 0
    assert 0 < settled.sum() < 49
    assert np.isfinite(result["dissipation"].values[settled]).all()


def test_a_map_that_is_interrupted_behind_its_last_cycle_is_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    march = element_map.MapMarch.run

    def interrupted(own: element_map.MapMarch, *args: Any, **options: Any) -> Any:
        found = march(own, *args, **options)
        if not options:  # else it compiles
            os.kill(os.getpid(), signal.SIGINT)
        return found

    monkeypatch.setattr(element_map.MapMarch, "run", interrupted)
    axes = ("--set", "study.A={from: 0.0, to: 2.0, num: 3}", "--set", "study.B={from: 0.0, to: 2.0, num: 3}")
    assert call("run", CONFIGS / "figure7.yaml", "-o", tmp_path, "--no-plots", *axes)[0] == 0
    assert timesim.open_result(tmp_path).attrs["complete"] == 1


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_before_anything_is_run_says_so(
    sent: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(_: object) -> Any:
        os.kill(os.getpid(), sent)
        return ()

    monkeypatch.setattr("timesim.scene.report.warnings_of", interrupted)
    status, _, error = call("run", OSCILLATOR, "-o", tmp_path, *SHORT)
    assert status == 1
    assert "interrupted before anything was run" in error
    assert not (tmp_path / "result.nc").exists()


@pytest.mark.parametrize("place", ["cross_check", "steady_cycle"])
def test_an_interrupted_element_saves_its_cycle_or_says_that_there_is_none(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Its cross check compiles for seconds."""

    def interrupted(*_: Any, **__: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)

    name = "timesim.element.loop.loop_cycle" if place == "cross_check" else "timesim.study.element.steady_cycle"
    monkeypatch.setattr(name, interrupted)
    status, _, error = call("run", CONFIGS / "figure4.yaml", "-o", tmp_path, "--no-plots")
    assert status == 1
    if place == "steady_cycle":
        assert "interrupted before there was a result to save" in error
        return
    assert "incomplete: interrupted in the cross check" in error
    result = timesim.open_result(tmp_path)
    assert result.attrs["complete"] == 0
    assert result["dissipation"] > 0


def test_a_folder_where_a_run_is_at_work_is_left_alone(tmp_path: Path):
    assert call("run", OSCILLATOR, "-o", tmp_path, *SHORT)[0] == 0
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with locked_folder(tmp_path):
        status, _, error = call("run", OSCILLATOR, "-o", tmp_path, "--force", *SHORT, "--set", "study.cycles=4")
        assert status == 2
        assert "another run is at work in" in error
        assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.name != ".lock"} == before


def test_other_files_are_not_written_among(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "thesis.tex").touch()
    monkeypatch.chdir(tmp_path)
    for force in ((), ("--force",)):
        status, _, error = call("run", OSCILLATOR, "-o", ".", *force, *SHORT)
        assert status == 2
        assert error == ". holds other files (thesis.tex) and no run; choose a new or an empty folder\n"
        assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_check_says_what_would_be_modelled():
    status, out, _ = call("check", OSCILLATOR)
    assert status == 0
    assert "natural frequencies without contacts: 0.9, 1.1 Hz" in out
    assert "left out or simplified" in out
    assert call("check", OSCILLATOR, "--set", "contacts.pad.friction=-1")[0] == 2


def test_schema_is_json():
    import json

    status, out, _ = call("schema")
    assert status == 0
    assert "structure" in json.loads(out)["properties"]


@pytest.mark.parametrize("arguments", [("--help",), ("check", OSCILLATOR), ("schema",)])
def test_light_commands_load_no_jax(arguments: tuple[str, ...]):
    heavy = ("jax", "jaxlib", "diffrax", "equinox", "xarray", "matplotlib", "h5netcdf")
    code = (
        "import sys\n"
        f"sys.argv = ['timesim', *{arguments!r}]\n"
        "from timesim.cli import main\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert not stop.code\n"
        f"print([n for n in {heavy!r} if n in sys.modules], file=sys.stderr)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stderr.strip() == "[]"


def test_the_version_is_that_of_results():
    assert call("--version") == (0, f"{timesim.__version__}\n", "")
    assert re.fullmatch(r"\d+\.\d+.*", timesim.__version__)


def test_the_package_is_the_command_too():
    found = subprocess.run([sys.executable, "-m", "timesim", "--help"], capture_output=True, text=True, check=True)
    assert "python -m timesim [OPTIONS] COMMAND" in found.stdout


@pytest.mark.long
def test_an_error_that_no_command_expects_is_said_in_words():
    fails = "import timesim.scene.report as report; report.describe = lambda scene: {}['x']"
    code = f"import sys; from timesim.cli import main; {fails}; sys.argv = ['timesim', 'check', {OSCILLATOR!r}]; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    what, advice = done.stderr.splitlines()
    assert done.returncode == 1
    assert re.fullmatch(r"timesim has failed: KeyError: 'x' \(.*cli\.py:\d+\)", what)
    assert "`python -X dev -m timesim` in place of `timesim` shows the calls" in advice
