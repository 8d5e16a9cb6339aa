"""Scenes that nobody wrote: what the command says of them. Many more: benchmarks/fuzz.py."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from scenes import any_scene, small_scene
from systems import oscillator_scene

from timesim.scene.report import describe
from timesim.scene.text import yaml_text
from timesim.study.registry import json_schema, load_scene

few = settings(deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def judge() -> ModuleType:
    """The script with what is asked of every scene."""
    path = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"
    spec = importlib.util.spec_from_file_location("fuzz", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@settings(few, max_examples=80)
@given(any_scene(json_schema()))
def test_a_scene_is_checked_or_refused_in_words(judge: ModuleType, tmp_path_factory: Any, scene: Any):
    path = tmp_path_factory.mktemp("check") / "scene.yaml"
    path.write_text(yaml_text(scene))
    status, fault = judge.fault_of_check(path)
    assert status in ("0", "2")
    assert fault == ""


def test_what_is_drawn_mostly_fits_together(judge: ModuleType, tmp_path: Path):
    """Scenes that are all refused would test little: this fails where a new required key is not drawn."""
    path, ends = tmp_path / "scene.yaml", []

    @settings(few, max_examples=60)
    @given(small_scene(json_schema()))
    def one(scene: Any) -> None:
        path.write_text(yaml_text(scene))
        ends.append(judge.fault_of_check(path)[0])

    one()
    assert ends.count("0") > 0.6 * len(ends)


def without(scene: dict[str, Any], damping_ratio: float | None = None, frequency: float | None = None) -> dict:
    for mode in scene["structure"]["modes"]:
        mode |= {} if damping_ratio is None else {"damping_ratio": damping_ratio}
        mode |= {} if frequency is None else {"frequency": frequency}
    return scene


def stiff_contact(scene: dict[str, Any], stiffness: float) -> dict[str, Any]:
    scene["structure"]["modes"][1]["shape"] = {"tip": [1, 1, 1]}
    return scene | {"contacts": [scene["contacts"][0] | {"normal": [1, 1, 0], "normal_stiffness": stiffness}]}


SWEEP = {"study": {"kind": "sweep", "frequency": {"values": [1.0]}}}
FAR_OUT: dict[str, dict[str, Any]] = {
    "undamped, far above": without(oscillator_scene(3.0), damping_ratio=0.0)
    | {"study": {"kind": "sweep", "frequency": {"values": [1e9]}}},
    "a frequency that is not used": oscillator_scene(3.0)
    | {"excitation": {"frequency": 5e-324, "modal_force": [{"amplitude": 1.0}] * 2}}
    | SWEEP,
    "a contact beside which the structure is lost in rounding": stiff_contact(oscillator_scene(3.0), 1e100) | SWEEP,
    "modes whose stiffness is lost": without(oscillator_scene(3.0), frequency=4e-166) | SWEEP | {"contacts": []},
}
"""Numbers whose quotients are beyond all numbers: each made numpy warn where `check` estimates something."""


@pytest.mark.parametrize("name", FAR_OUT)
def test_numbers_far_apart_are_checked_without_a_warning(name: str):
    assert "scene" in describe(load_scene(FAR_OUT[name]))
