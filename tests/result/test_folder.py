"""Run folders: the files that a run leaves in them, and what they refuse."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from timesim.result import folder
from timesim.result.file import StoreError
from timesim.result.folder import check_folder, locked_folder, prepare_folder


def test_a_new_folder_gets_the_scene(tmp_path: Path) -> None:
    with locked_folder(tmp_path / "runs" / "first") as made:
        prepare_folder(made, "title: a\n")
    assert (made / "scene.yaml").read_text() == "title: a\n"
    assert [path.name for path in made.iterdir()] == ["scene.yaml"]


def test_a_new_folder_of_no_run_goes_again(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), locked_folder(tmp_path / "first"):
        _ = 1 / 0
    assert not list(tmp_path.iterdir())


def test_one_run_at_a_time_works_in_a_folder(tmp_path: Path) -> None:
    with locked_folder(tmp_path):
        with pytest.raises(StoreError, match="another run is at work in"), locked_folder(tmp_path):
            pass
        check_folder(tmp_path)
    with locked_folder(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_a_folder_of_other_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("title: a\n")
    check_folder(tmp_path)
    for name in ("thesis.tex", "data.csv", "b", "a"):
        (tmp_path / name).touch()
    for overwrite in (False, True):
        with pytest.raises(StoreError, match=r"holds other files \(a, b, data.csv, ...\) and no run; choose a new"):
            check_folder(tmp_path, overwrite=overwrite)
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "manifest.json").touch()
    check_folder(tmp_path)


def test_checking_a_folder_makes_nothing(tmp_path: Path) -> None:
    check_folder(tmp_path / "runs" / "first")
    assert not list(tmp_path.iterdir())


def test_an_existing_result_needs_force(tmp_path: Path) -> None:
    prepare_folder(tmp_path, "title: a\n")
    (tmp_path / "result.nc").write_bytes(b"old")
    (tmp_path / "energy.png").write_bytes(b"old")
    (tmp_path / "mine.png").write_bytes(b"own")
    with pytest.raises(StoreError, match="exists; choose another folder or give --force"):
        check_folder(tmp_path)
    check_folder(tmp_path, overwrite=True)
    assert (tmp_path / "scene.yaml").read_text() == "title: a\n"
    prepare_folder(tmp_path, "title: b\n", overwrite=True, stale=["energy.png", "orbit.png"])
    assert (tmp_path / "scene.yaml").read_text() == "title: b\n"
    assert (tmp_path / "result.nc").read_bytes() == b"old"
    assert {path.name for path in tmp_path.iterdir()} == {"scene.yaml", "result.nc", "mine.png"}


def test_the_users_own_scene_is_never_overwritten(tmp_path: Path) -> None:
    own = tmp_path / "scene.yaml"
    own.write_text("title: a  # a comment\n")
    with pytest.raises(StoreError, match="is another scene"):
        prepare_folder(tmp_path, "title: a\n")
    with pytest.raises(StoreError, match="overwrite its own scene file"):
        prepare_folder(tmp_path, "title: a\n", overwrite=True, source=own)
    assert own.read_text() == "title: a  # a comment\n"
    prepare_folder(tmp_path, own.read_text(), source=own)


def test_a_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(StoreError, match="runs is a file"):
        check_folder(tmp_path / "runs" / "first")


def test_a_folder_that_may_not_be_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As another user's: asking for a file in it is an error."""
    closed, stat = tmp_path / "closed", os.stat
    closed.mkdir()

    def refused(path: Any, *args: Any, **options: Any) -> Any:
        if closed in Path(path).parents:
            raise PermissionError(13, "Permission denied", str(path))
        return stat(path, *args, **options)

    monkeypatch.setattr(os, "stat", refused)
    monkeypatch.setattr(folder.os, "access", lambda *_: False)
    with pytest.raises(StoreError, match=r"no permission in .*closed"):
        check_folder(closed / "run")


def test_a_file_system_that_is_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder.os, "access", lambda *_: False)
    with pytest.raises(StoreError, match="no permission in"):
        check_folder(tmp_path)
    flags = SimpleNamespace(f_flag=os.ST_RDONLY)
    monkeypatch.setattr(folder.os, "statvfs", lambda _: flags)
    with pytest.raises(StoreError, match=f"the file system of {tmp_path} is read-only"):
        check_folder(tmp_path)


def test_a_folder_that_cannot_be_made() -> None:
    with pytest.raises(StoreError, match="/proc/timesim cannot be made"), locked_folder("/proc/timesim"):
        pass
