"""The table of studies: a toy of one module and one line of the table does all that the others do."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.scene.report import warnings_of
from timesim.study import registry
from timesim.study.outcome import took

TOY = '''
"""The work of the excitation on the structure at rest: a study in one module."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from timesim.scene.value import Count
from timesim.scene.study import Context, StudySection


@dataclass(frozen=True)
class ToyPlan:
    frequency: float
    samples: int


class Toy(StudySection):
    """How much force acts, over a cycle."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation", "excitation.frequency")

    kind: Literal["toy"]
    samples: Count = 8
    """Angles of the cycle."""

    def plan(self, context: Context) -> ToyPlan:
        return ToyPlan(context.frequency, self.samples)


def study(scene, execution):
    from timesim.result.dataset import dataset
    from timesim.study.outcome import Outcome, attributes

    plan, excitation = scene.plan, scene.model().excitation
    angle = np.arange(plan.samples) * 2 * np.pi / plan.samples
    force = (np.cos(angle)[:, None] * excitation.cosine.sum(axis=0)).sum(axis=1)
    own = {"long_name": "sum of all modal forces", "units": "modal force"}
    result = dataset(
        {"toy_force": (("toy_angle",), force, own)},
        {"toy_angle": (("toy_angle",), np.rad2deg(angle), {"long_name": "angle", "units": "degree"})},
        attributes(scene, "by hand", 0.0, 0.0, None),
    )
    return Outcome({"": result}, None, (f"{plan.samples} angles",))


def _curve(data):
    from matplotlib.figure import Figure

    figure = Figure()
    figure.subplots().plot(data["toy_angle"], data["toy_force"])
    return figure


PICTURES = {"toy_curve": _curve}
'''

SCENE = """\
structure:
  modes:
    - {frequency: 0.9, damping_ratio: 0.02, mass: 1.0, shape: {tip: [1, 1, 0.8]}}
excitation: {frequency: 1.39, modal_force: [{amplitude: 2.0}]}
study: {kind: toy}
"""


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene of the toy study, which is one module and one line of the table."""
    (tmp_path / "toy_study.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    row = registry.Study("toy_study:Toy", "toy_study:study", "toy_study:PICTURES")
    monkeypatch.setitem(registry.STUDIES, "toy", row)
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path / "scene.yaml"


def call(*arguments: object) -> str:
    done = CliRunner().invoke(app, [str(part) for part in arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def test_a_toy_study_is_checked_run_and_drawn(toy: Path):
    assert "study: kind toy, samples 8" in call("check", toy)
    assert "8 angles" in call("run", toy, "-o", toy.parent / "run")
    picture = toy.parent / "run" / "toy_curve.png"
    assert picture.is_file()
    picture.unlink()
    assert str(picture) in call("plot", toy.parent / "run")
    assert picture.is_file()
    result = timesim.open_result(toy.parent / "run")
    assert result["toy_force"].attrs == {"long_name": "sum of all modal forces", "units": "modal force"}
    np.testing.assert_allclose(result["toy_force"], 2 * np.cos(np.deg2rad(result["toy_angle"])), atol=1e-15)
    assert result.attrs["study"] == "toy"
    assert "Angles of the cycle." in json.dumps(json.loads(call("schema")))


def test_a_toy_study_is_refused_as_others_are(toy: Path):
    with pytest.raises(timesim.SceneError, match=r"study\.sample: 9: is no key here \(did you mean samples\?\)"):
        timesim.load_scene(toy, {"study.sample": 9})
    with pytest.raises(timesim.SceneError, match=r"excitation\.frequency: is required in a study of kind toy"):
        timesim.load_scene(toy, {"excitation.frequency": None})
    with pytest.raises(ValueError, match="a study of kind toy is done in one go"):
        timesim.run(toy, workers=2)
    assert timesim.run(toy, {"study.samples": 3}).sizes["toy_angle"] == 3


def test_python_is_told_what_the_command_warns_of(toy: Path):
    overdamped = {"structure.modes.0.damping_ratio": 1.5}
    with pytest.warns(timesim.SceneWarning, match=r"damping ratio 1\.5 of mode 1 .* 1 % is 0\.01") as said:
        timesim.run(toy, overdamped)
    assert [str(one.message) for one in said] == list(warnings_of(timesim.load_scene(toy, overdamped)))


def test_python_is_told_what_the_summary_warns_of(toy: Path, monkeypatch: pytest.MonkeyPatch):
    plain, lines = registry.carry_out, ("peak 1 of tip x", "warning: 2 points did not settle")
    monkeypatch.setattr(registry, "carry_out", lambda *given: replace(plain(*given), summary=lines))
    with pytest.warns(timesim.SceneWarning) as said:
        timesim.run(toy)
    assert [str(one.message) for one in said][1:] == ["2 points did not settle"]


def test_a_kind_that_is_not_known_is_refused_with_all_that_are(toy: Path):
    with pytest.raises(timesim.SceneError, match=r"study\.kind: tooy: must be one of .*transient, .*, toy \(did"):
        timesim.load_scene(toy, {"study.kind": "tooy"})
    assert registry.picture_names("toy") == ["toy_curve.png"]
    assert registry.picture_names("unknown") == []


def test_every_row_of_the_table_can_be_loaded():
    for kind, row in registry.STUDIES.items():
        section, run, pictures = map(registry._loaded, (row.section, row.run, row.pictures))
        assert section.model_fields["kind"].annotation.__args__ == (kind,)
        assert callable(run)
        assert all(map(callable, pictures.values()))


@pytest.mark.parametrize(("compiling", "words"), [(0.4, "in 3.25 s"), (1.2, "in 3.25 s, after 1.2 s of compilation")])
def test_compilation_is_told_where_it_is_felt(compiling: float, words: str):
    assert took({"compile_seconds": compiling, "run_seconds": 3.25}) == words
