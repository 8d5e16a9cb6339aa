"""Run folders: what is made in them, and what they refuse."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from timesim.result import folder
from timesim.result.file import StoreError
from timesim.result.folder import check_folder, prepare_folder


def test_a_new_folder_gets_the_scene(tmp_path: Path) -> None:
    made = prepare_folder(tmp_path / "runs" / "first", "title: a\n")
    assert (made / "scene.yaml").read_text() == "title: a\n"
    assert [path.name for path in made.iterdir()] == ["scene.yaml"]


def test_checking_a_folder_makes_nothing(tmp_path: Path) -> None:
    check_folder(tmp_path / "runs" / "first")
    assert not list(tmp_path.iterdir())


def test_an_existing_result_needs_force(tmp_path: Path) -> None:
    prepare_folder(tmp_path, "title: a\n")
    (tmp_path / "result.nc").write_bytes(b"old")
    (tmp_path / "energy.png").write_bytes(b"old")
    (tmp_path / "mine.png").write_bytes(b"own")
    with pytest.raises(StoreError, match="exists; choose another folder or give --force"):
        prepare_folder(tmp_path, "title: b\n")
    assert (tmp_path / "scene.yaml").read_text() == "title: a\n"
    prepare_folder(tmp_path, "title: b\n", force=True, stale=["energy.png", "orbit.png"])
    assert (tmp_path / "scene.yaml").read_text() == "title: b\n"
    assert (tmp_path / "result.nc").read_bytes() == b"old"
    assert {path.name for path in tmp_path.iterdir()} == {"scene.yaml", "result.nc", "mine.png"}


def test_the_users_own_scene_is_never_overwritten(tmp_path: Path) -> None:
    own = tmp_path / "scene.yaml"
    own.write_text("title: a  # a comment\n")
    with pytest.raises(StoreError, match="is another scene"):
        prepare_folder(tmp_path, "title: a\n")
    with pytest.raises(StoreError, match="overwrite its own scene file"):
        prepare_folder(tmp_path, "title: a\n", force=True, source=own)
    assert own.read_text() == "title: a  # a comment\n"
    prepare_folder(tmp_path, own.read_text(), source=own)


def test_a_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(StoreError, match="runs is a file"):
        prepare_folder(tmp_path / "runs" / "first", "title: a\n")


def test_a_file_system_that_is_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder.os, "access", lambda *_: False)
    with pytest.raises(StoreError, match="no permission in"):
        check_folder(tmp_path)
    flags = SimpleNamespace(f_flag=os.ST_RDONLY)
    monkeypatch.setattr(folder.os, "statvfs", lambda _: flags)
    with pytest.raises(StoreError, match=f"the file system of {tmp_path} is read-only"):
        check_folder(tmp_path)


def test_a_folder_that_cannot_be_made() -> None:
    with pytest.raises(StoreError, match="/proc/timesim"):
        prepare_folder("/proc/timesim", "title: a\n")
