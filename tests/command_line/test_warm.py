"""Programs compiled beforehand by `timesim warm`."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import CONFIGS
from typer.testing import CliRunner

from timesim import warm
from timesim.cli import app
from timesim.study.registry import STUDIES, load_scene

pytestmark = pytest.mark.long


def test_all_usual_studies_are_good_scenes():
    kinds = {load_scene(scene).kind for scene in warm.USUAL}
    assert kinds == {"transient", "sweep", "hbm", "element", "element_map"} <= set(STUDIES)


def test_the_command_carries_them_out(monkeypatch):
    done = []
    monkeypatch.setattr(warm, "carry_out", done.append)
    said = CliRunner().invoke(app, ["warm"])
    assert said.exit_code == 0, said.output
    assert sorted(scene.kind for scene in done) == sorted(scene["study"]["kind"] for scene in warm.USUAL)
    assert said.stdout.startswith("compiled for transient, sweep, hbm, element, element_map in 0 s")


@pytest.mark.slow
def test_scenes_of_usual_sizes_compile_nothing_afterwards(tmp_path):
    environment = os.environ | {"TIMESIM_CACHE": str(tmp_path / "cache")}

    def timesim(*arguments: str) -> set[Path]:
        subprocess.run([sys.executable, "-m", "timesim", *arguments], env=environment, check=True)
        return {path for path in (tmp_path / "cache").rglob("*") if path.is_file()}

    found = timesim("warm")
    assert len(found) > 10
    narrow = ["--set", "study={kind: hbm, frequency: {from: 1.39, to: 1.392}}"]
    for name, more in [("oscillator", []), ("oscillator", narrow), ("figure4", [])]:
        scene = str(CONFIGS / f"{name}.yaml")
        assert timesim("run", scene, "--no-plots", "--force", "-o", str(tmp_path / "run"), *more) == found, name
