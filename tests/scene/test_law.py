"""The law of a contact in a scene: by its name, with its own parameters, and which studies know it."""

from typing import Any

import pytest
from bad_scenes import BASE, BISTABLE, ELEMENT, ELEMENT_MAP, HBM, SWEEP

import timesim
from timesim.engine.law.table import LAWS, LawEntry
from timesim.fault import SceneError
from timesim.scene.report import describe, warnings_of
from timesim.study.registry import json_schema, load_scene

STOPS = {f"contacts.{name}.law": {"name": "hunt_crossley", "damping": 0.1} for name in ("pad", "stop")}
ALONE = {"contacts.pad.law": {"name": "hunt_crossley", "damping": 0.1}}


@pytest.fixture(autouse=True)
def table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LAWS, "hunt_crossley", LawEntry("hunt_crossley", "HuntCrossley", ("damping",)))
    monkeypatch.setitem(LAWS, "plain", LawEntry("nowhere", "Plain"))


def test_a_law_is_read_with_its_parameters():
    scene = load_scene(BASE, STOPS)
    for contact in scene.model().contacts:
        assert (contact.law, contact.law_parameters) == ("hunt_crossley", {"damping": 0.1})
    assert load_scene(scene.resolved_yaml()).file == scene.file
    assert any("law hunt_crossley (damping 0.1)" in line for lines in describe(scene).values() for line in lines)
    assert not any("stuck" in line for lines in describe(scene).values() for line in lines)
    varied = load_scene(SWEEP, STOPS | {"study.over": {"contacts.pad.law.damping": [0.2, 0.3]}})
    assert varied.variant({"contacts.pad.law.damping": 0.3}).contacts[0].law_parameters == {"damping": 0.3}


def test_a_law_without_parameters_is_a_name():
    scene = load_scene(BASE, {"contacts.pad.law": "plain", "contacts.stop.law": {"name": "plain"}})
    assert {contact.law for contact in scene.model().contacts} == {"plain"}
    assert {"type": "string"} in json_schema()["$defs"]["ContactSection"]["properties"]["law"]["anyOf"]


@pytest.mark.parametrize("law", [None, "cone", {"name": "cone"}])
def test_the_cone_is_the_default_and_is_not_written(law: Any):
    scene = load_scene(BASE, {"contacts.pad.law": law})
    assert "law" not in scene.resolved_yaml()
    assert [contact.law for contact in scene.model().contacts] == ["cone", "cone"]


def test_another_law_may_have_a_tangential_stiffness_without_friction():
    stiff = {"contacts.pad.friction": 0.0}
    assert not load_scene(BASE, stiff).model().contacts[0].tangential_stiffness.any()
    assert load_scene(BASE, STOPS | stiff).model().contacts[0].tangential_stiffness[0, 0] == 20
    assert not list(warnings_of(load_scene(BASE, STOPS | stiff)))


@pytest.mark.parametrize(
    ("law", "key", "rule"),
    [
        ("hunt_crosley", "law.name", "must be one of cone, hunt_crossley, plain (did you mean"),
        (3, "law", "must be a mapping of keys"),
        ({"damping": 1.0}, "law.name", "is required"),
        ("hunt_crossley", "law.damping", "is required for the law hunt_crossley"),
        ({"name": "hunt_crossley", "dampng": 1.0}, "law.dampng", "is no parameter of the law hunt_crossley (did you"),
        ({"name": "hunt_crossley", "damping": "much"}, "law.damping", "must be a number"),
        ({"name": "hunt_crossley", "damping": 1e200}, "law.damping", "must be <= 1e+100"),
        ({"name": "cone", "damping": 1.0}, "law.damping", "is no parameter of the law cone"),
    ],
)
def test_a_wrong_law_is_refused_by_its_key(law: Any, key: str, rule: str):
    with pytest.raises(SceneError) as caught:
        load_scene(BASE, {"contacts.pad.law": law})
    (problem,) = caught.value.problems
    assert problem.key == f"contacts.pad.{key}"
    assert rule in f"{problem.rule} ({problem.hint})"


@pytest.mark.parametrize(
    ("text", "changes", "key", "rule"),
    [
        (BASE, ALONE, "contacts.stop.law", "must be the same for all contacts, that of pad is hunt_crossley"),
        (BASE, STOPS | {"initial": "static"}, "contacts.pad.law", "must be cone where initial is static"),
        (HBM, STOPS, "contacts.pad.law", "must be cone in a study of kind hbm"),
        (SWEEP, STOPS | {"study.kind": "compare"}, "contacts.pad.law", "must be cone in a study of kind compare"),
        (ELEMENT, ALONE, "contacts.pad.law", "must be cone in a study of kind element"),
        (ELEMENT_MAP, ALONE, "contacts.pad.law", "must be cone in a study of kind element_map"),
        (BISTABLE, STOPS, "study.harmonics", "must be 0 where the law of a contact is not cone"),
    ],
)
def test_what_knows_the_cone_alone_refuses_other_laws(text: str, changes: dict[str, Any], key: str, rule: str):
    with pytest.raises(SceneError) as caught:
        load_scene(text, changes)
    assert (caught.value.problems[0].key, caught.value.problems[0].rule) == (key, rule)
    if text == BISTABLE:
        assert load_scene(text, changes | {"study.harmonics": 0}).plan.balance is None


@pytest.mark.long
def test_a_scene_of_another_law_runs():
    stop = {
        "name": "pad", "point": "m", "friction": 0, "tangential_stiffness": 0, "normal_stiffness": 400, "preload": -8,
        "law": {"name": "hunt_crossley", "damping": 0.3},
    }  # fmt: skip
    scene = {
        "structure": {"modes": [{"frequency": 1, "damping_ratio": 0.01, "mass": 1, "shape": {"m": [0, 0, 1]}}]},
        "contacts": [stop],
        "excitation": {"frequency": 0.9, "modal_force": [{"amplitude": 1}]},
        "study": {"kind": "transient", "cycles": 10, "samples_per_cycle": 20},
    }
    result = timesim.run(scene)
    assert result.attrs["complete"] == 1
    assert result.sizes["event"] > 10
    assert float(abs(result["energy_residual"]).max()) < 1e-6 * float(abs(result["energy_input"]).max())
