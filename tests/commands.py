"""What tests of the commands share: a scene of `configs` run as users run it, and a disk that is full."""

import errno
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from timesim.cli import app
from timesim.result.netcdf import open_result

CONFIGS = Path(__file__).parents[1] / "configs"


def options(overrides: Mapping[str, object]) -> list[str]:
    """Overrides as the command takes them."""
    return [part for key, value in overrides.items() for part in ("--set", f"{key}={value}")]


def run_config(folder: Path, name: str, overrides: Mapping[str, object]) -> Path:
    """Run a scene of `configs` into `folder`/run; its output is in `folder`/said."""
    call = ["run", str(CONFIGS / name), "-o", str(folder / "run"), *options(overrides)]
    done = CliRunner().invoke(app, call)
    assert done.exit_code == 0, done.output
    (folder / "said").write_text(done.stdout)
    return folder


def run_of_config(name: str, overrides: Mapping[str, object]) -> tuple[Any, Any]:
    """Two fixtures of a module: the folder of `run_config`, and the result in it."""

    @pytest.fixture(scope="module")
    def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
        return run_config(tmp_path_factory.mktemp("config"), name, overrides)

    @pytest.fixture(scope="module")
    def result(folder: Path) -> Any:
        return open_result(folder / "run")

    return folder, result


def fill_disk(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """From now on no file with this in its name can be written: the disk is full."""
    fsync = os.fsync

    def full(handle: int) -> None:
        if name in os.readlink(f"/proc/self/fd/{handle}"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
