"""Scenes: how a good one is read, and that every bad one is refused with its key, line and rule."""

import contextlib
import json
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest
from bad_scenes import BAD_SCENES, BASE, ELEMENT, HBM, MATRICES, OPTIMUM, BadScene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from timesim.fault import RuleError, SceneError
from timesim.model.cost import cycles_to_settle, seconds_a_cycle, seconds_a_derivative
from timesim.model.model import SEPARATION, SLIP, STICK
from timesim.model.solver import NEVER, SHOOT, SLOW, Criterion
from timesim.scene import text as scene_text
from timesim.scene.report import describe, warnings_of
from timesim.scene.report.description import contact_line
from timesim.scene.study import SweepSection
from timesim.scene.text import MAX_BYTES, parse, yaml_text
from timesim.study.registry import json_schema, load_scene

CONFIGS = Path(__file__).parents[2] / "configs"


def problems(source: Any, *overrides: Any) -> list[tuple[str, str]]:
    with pytest.raises(SceneError) as caught:
        load_scene(source, overrides[0] if overrides and isinstance(overrides[0], dict) else overrides)
    return [(problem.key, problem.rule) for problem in caught.value.problems]


@pytest.mark.parametrize("bad", BAD_SCENES, ids=lambda bad: f"{bad.key}: {bad.rule}")
def test_bad_scene(bad: BadScene, tmp_path: Path):
    path = tmp_path / "scene.yaml"
    path.write_text(bad.text)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    (problem,) = caught.value.problems
    assert bad.rule in f"{problem.rule} ({problem.hint})"
    assert problem.line == bad.line
    if "is no YAML" not in problem.rule:
        assert problem.key == bad.key
        assert f"{path}:{bad.line}: {bad.key}: " in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "hint"),
    [
        ("friction", "30 %", "as a share: 1 % is 0.01"),
        ("tangential_stiffness", "2e4 N/m", "without quotes and unit, with a point for the decimals"),
        ("preload", "3 N", "without quotes and unit, with a point for the decimals"),
    ],
)
def test_a_number_with_a_unit_or_in_percent(key: str, value: str, hint: str):
    with pytest.raises(SceneError, match=rf'contacts\.pad\.{key}: "{value}": must be a number.* \({hint}\)'):
        load_scene(BASE, {f"contacts.pad.{key}": value})


def test_symbols_of_the_theory_are_taken_for_the_keys_that_they_mean():
    """And these are not missed as well."""
    meant = {"mu": "friction", "kt": "tangential_stiffness", "kn": "normal_stiffness", "n0": "preload"}
    pad = {"name": "pad", "point": "tip"} | meant
    with pytest.raises(SceneError) as caught:
        load_scene(load_scene(BASE).source.data | {"contacts": [pad]})
    assert {problem.hint for problem in caught.value.problems} == {f"did you mean {key}?" for key in meant.values()}
    with pytest.raises(SceneError) as caught:
        load_scene(MATRICES.replace("mass:", "M:").replace("stiffness:", "K:"))
    assert [problem.hint for problem in caught.value.problems] == ["did you mean mass?", "did you mean stiffness?"]


def test_a_file_in_place_of_matrices():
    with pytest.raises(SceneError, match=r"structure\.matrices: .*\(a file is given as structure: {file: b\.npz"):
        load_scene(MATRICES, {"structure": {"matrices": "b.npz"}})


def test_a_map_whose_contact_would_never_carry_names_the_value():
    """That of the contact itself where the map gives none."""
    study = "study={kind: element_map, contact: pad, A: [1, 2], B: [1, 2], normal_stiffness: [0, 1]"
    with pytest.raises(SceneError, match=r"study\.preload: -2\.5: must be > 0 where normal_stiffness is 0 \(such"):
        load_scene(BASE, [study.replace("[0, 1]", "0") + ", preload: -2.5}"])
    with pytest.raises(SceneError, match=r"study\.normal_stiffness: 0\.0: must be > 0 where preload is -3 \(such"):
        load_scene(BASE, [study.replace("B: [1, 2]", "B: 1") + "}", "contacts.pad.preload=-3"])


def test_a_tab_and_the_keys_of_a_range():
    with pytest.raises(SceneError, match=r":7: is no YAML.*use spaces, not tabs"):
        load_scene(BASE.replace("      shape: {tip: [1, 1", "\tshape: {tip: [1, 1"))
    study = "study={kind: sweep, frequency: {from: 1, to: 2, step: 0.5}}"
    with pytest.raises(SceneError, match=r"preload\.step: 0\.5: is no key here \(known: from, to, num\)"):
        load_scene(BASE, [study, "study.over.contacts.pad.preload={from: 1, to: 2, step: 0.5}"])


def test_a_line_that_begins_in_another_column_and_a_colon_that_is_missing():
    for friction, hint in (
        ("   friction: 0.3", "keys of one mapping begin in one column"),
        ("    friction 0.3", "colon"),
    ):
        with pytest.raises(SceneError, match=rf"is no YAML.*\(.*{hint}"):
            load_scene(f"contacts:\n  - name: pad\n    preload: 1\n{friction}\n    point: tip\n")


def test_a_range_of_frequencies_the_other_way_says_how_to_sweep_downwards():
    with pytest.raises(SceneError, match=r"frequency\.to: 1\.0: must not be smaller than from \(.*direction: down"):
        load_scene(BASE, ["study={kind: sweep, frequency: {from: 2, to: 1, step: 0.5}}"])


@pytest.mark.parametrize("num", [2, 7, 41, 1001])
def test_so_many_frequencies_are_those_of_the_step_between_them(num: int):
    def frequencies(given: str) -> np.ndarray:
        scene = load_scene(BASE, ["study={kind: sweep, frequency: {from: 0.83, to: 1.31, " + given + "}}"])
        assert isinstance(scene.file.study, SweepSection)
        return scene.file.study.sweep().frequency

    found = frequencies(f"num: {num}")
    np.testing.assert_allclose(found, np.linspace(0.83, 1.31, num), rtol=1e-14)
    np.testing.assert_allclose(found, frequencies(f"step: {0.48 / (num - 1)!r}"), rtol=1e-14)


def test_a_value_of_over_is_shown_once():
    study = "study={kind: sweep, frequency: {from: 1, to: 2, step: 0.5}, over: {contacts.pad.normal_stiffness: [0]}}"
    with pytest.raises(SceneError) as caught:
        load_scene(BASE, [study, "contacts.pad.preload=-30"])
    start = "override: study.over.contacts.pad.normal_stiffness: 0.0: contacts.pad.preload must be > 0 where"
    assert str(caught.value).startswith(start)


def test_zoo_is_diverse():
    assert len(BAD_SCENES) >= 45
    assert len({(bad.key, bad.rule) for bad in BAD_SCENES}) == len(BAD_SCENES)


def test_zoo_starts_from_good_scenes():
    assert load_scene(BASE).model().num_contacts == 2
    assert load_scene(MATRICES).model().structure.num_modes == 2


def test_problems_come_together():
    text = (
        BASE.replace("mass: 1.0", "mass: -1.0")
        .replace("friction: 0.5", "frictoin: 0.5")
        .replace("cycles: 60", "cycles: 0")
    )
    keys = [key for key, _ in problems(text)]
    assert keys == ["structure.modes.0.mass", "contacts.pad.frictoin", "study.cycles"]


def test_rules_between_keys_of_a_contact_come_with_its_other_problems():
    wrong = {
        "against: ground": "against: tip",
        "tangent: [1, 0, 0]": "tangent: [0, 0, 1]",
        "friction: 0.5": "friction: -0.5",
        "tangential_stiffness: 20.0": "tangential_stiffness: [[1, 2], [2, 1]]",
        "normal_stiffness: 21.0": "normal_stiffness: 0",
        "preload: 3.0": "preload: -3.0",
    }
    text = BASE
    for good, bad in wrong.items():
        text = text.replace(good, bad, 1)
    keys = [key.removeprefix("contacts.pad.") for key, _ in problems(text)]
    assert keys == ["against", "tangent", "friction", "tangential_stiffness", "preload"]


def test_the_number_of_modes_is_no_axis_of_steady_states():
    """Each point has the state of all modes; a balance has none."""
    over = "frequency: {values: [0.2]}, over: {structure.keep_modes: [1, 2]}"
    text = MATRICES.replace("kind: transient, cycles: 5", f"kind: sweep, {over}")
    ((key, rule),) = problems(text)
    assert key == "study.over.structure.keep_modes"
    assert "must not change the number of modes" in rule


TYPO = {"study.cycles": 0}


@pytest.mark.parametrize(
    ("text", "changes", "keys"),
    [
        (BASE, {"contacts.stop.point": "ram", "excitation.forces.0.point": "tap"} | TYPO, None),
        (BASE, {"contacts.pad.against": "grund", "structure.modes.0.mass": -1} | TYPO, None),
        (BASE, {"contacts.stop.point": None} | TYPO, None),
        (MATRICES, {"excitation.forces.0.point": "m3", "structure.matrices.mass": [[1, 0], [1]]} | TYPO, None),
        (BASE, {"initial": {"slip": {"pod": [0, 0]}}} | TYPO, ["initial.slip.pod", "study.cycles"]),
        (BASE, {"contacts.stop.name": "pad"} | TYPO, ["contacts.1.name", "study.cycles"]),
        (BASE, {"excitation.frequency": None, "study.samples": 3}, None),
        (OPTIMUM, {"study.point": "tap", "solver.max_steps": 0}, None),
        (ELEMENT, {"study.contact": "pod", "study.samples": 1}, None),
        (BASE, {"excitation.modal_force": [], "initial": {"modal_velocity": [1]}},
         ["excitation.modal_force", "initial.modal_velocity"]),
        (HBM, {"study.start": {"from": "no.nc"}, "initial": {"from": "no.nc"}, "excitation.modal_force": []},
         ["excitation.modal_force", "initial.from", "study.start.from"]),
    ],
)  # fmt: skip
def test_no_problem_waits_for_another_to_be_mended(text: str, changes: dict[str, Any], keys: list[str] | None):
    with pytest.raises(SceneError) as caught:
        load_scene(text, changes)
    assert sorted(problem.key for problem in caught.value.problems) == sorted(keys or changes)


@pytest.mark.parametrize("tiny", [1e-160, 1e-200, 1e-320])
@pytest.mark.parametrize(
    ("keys", "refused"),
    [
        (("excitation.modal_force.0.amplitude", "excitation.modal_force.1.amplitude"), "excitation"),
        (("structure.modes.0.mass", "structure.modes.1.mass"), "excitation"),
        (("excitation.frequency",), "excitation"),
        (("contacts.pad.tangential_stiffness",), "contacts.pad.tangential_stiffness"),
        (("structure.modes.0.frequency",), None),
        (("structure.modes.0.damping_ratio",), None),
        (("contacts.pad.normal_stiffness",), None),
        (("contacts.pad.friction",), None),
    ],
)
def test_numbers_whose_squares_vanish(keys: tuple[str, ...], refused: str | None, tiny: float):
    changes = {"excitation.forces": [], "excitation.constant_forces": []} | dict.fromkeys(keys, tiny)
    if refused is None:
        assert describe(load_scene(BASE, changes))
    else:
        ((key, rule),) = problems(BASE, changes)
        assert key == refused
        assert "must lead to" in rule or "out of proportion" in rule


def test_a_response_may_be_small_as_long_as_its_square_is_a_number():
    changes = {f"excitation.modal_force.{i}.amplitude": 1e-90 for i in (0, 1)}
    assert load_scene(CONFIGS / "oscillator.yaml", changes).model().contacts[0].preload == 3
    still = {"excitation.modal_force": None, "contacts": [], "initial": {"modal_velocity": [1e-200, 0]}}
    assert problems(BASE, still | {"excitation": {"frequency": 1}})[0][0] == "initial"
    assert problems(CONFIGS / "oscillator.yaml", changes | {"contacts.pad.preload": 1e20})[0] == (
        "contacts.pad.preload", "is out of proportion to forces of 1e-90 and displacements of 1.31e-92",
    )  # fmt: skip


def test_a_point_is_known_if_any_mode_names_it():
    text = BASE.replace("shape: {tip: [1, 1, 0.8], rim", "shape: {tp: [1, 1, 0.8], rim")
    assert [key for key, _ in problems(text)] == ["structure.modes.1.shape"]
    assert [key for key, _ in problems(BASE.replace("excitation:", "excitaton:"))] == ["excitaton"]


def test_problems_of_the_parts_together():
    text = BASE.replace("point: rim\n", "point: ram\n").replace(
        "{point: tip, direction: [1", "{point: tap, direction: [1"
    )
    assert [key for key, _ in problems(text)] == ["contacts.stop.point", "excitation.forces.0.point"]


@pytest.mark.parametrize(
    ("content", "line", "rule"),
    [
        (b"", 1, "is empty"),
        (b"# nothing\n", 1, "is empty"),
        (b"- 1\n", 1, "must be a mapping"),
        (b"a: 1\nb: \xff\n", 2, "not UTF-8"),
        ("a: 1\n".encode("utf-16"), 1, "not UTF-8"),
        (b"a: 1\nb: [1, 2\nc: 3\n", 3, "is no YAML"),
        (b"a: 1\n\tb: 2\n", 2, "is no YAML"),
        (b"a: \x07\n", None, "is no YAML"),
        (b"a: 1\nb: 2\na: 3\n", 3, "stands twice"),
        (b"a: !!python/object/apply:os.system [x]\n", 1, "has the tag"),
        (b"%YAML 1.1\n---\na: on\n", 1, "is YAML 1.1"),
        (b"a: &a {b: 1}\nc: {<<: *a, d: 2}\n", 2, "is a merge key, which YAML 1.2 has not"),
        (b"a: 1\n---\nb: 1\n", 2, "more than one document"),
        (b"a:\n  ? [1, 2]\n  : 3\n", 2, "not plain text"),
        (b"a: 1\nb: *c\n", 2, "no anchor"),
        (b"a: &a\n  - *a\n", 2, "no anchor"),
        (b"a: " + b"[" * 100_000, 1, "nested deeper"),
        (b"#" * (MAX_BYTES + 1), None, "is larger than"),
    ],
)
def test_text_that_is_no_scene(content: bytes, line: int | None, rule: str, tmp_path: Path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    (problem,) = caught.value.problems
    assert rule in problem.rule
    assert problem.line == line


def test_text_that_was_written_by_the_program_may_be_long(monkeypatch: pytest.MonkeyPatch):
    """Matrices that a notebook gives stand in the text of the scene that its result holds."""
    monkeypatch.setattr(scene_text, "MAX_BYTES", 10)
    monkeypatch.setattr(scene_text, "MAX_VALUES", 3)
    assert parse("a: [1, 2, 3, 4, 5]")[0] == {"a": [1, 2, 3, 4, 5]}
    with pytest.raises(RuleError, match="is larger than"):
        parse(b"a: [1, 2, 3, 4, 5]")
    with pytest.raises(RuleError, match="holds more than 74 values, aliases written out"):
        parse(f"a: &a [{', '.join('1' * 9)}]\nb: &b [{', '.join(['*a'] * 7)}]\nc: *b")


def test_alias_bomb_is_refused():
    levels = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    refused = problems("\n".join(["a0: &a0 [x, x, x]", *levels, ""]))
    assert "values, aliases written out" in refused[0][1]


def test_files_that_are_none(tmp_path: Path):
    assert "no such file" in problems(tmp_path / "none.yaml")[0][1]
    assert "cannot be read" in problems(tmp_path)[0][1]


def test_numbers_and_text_of_yaml_1_2():
    data, lines = parse("a: 2e6\nb: [on, yes, 1_0, 0x1F, '2', .5E3, -.inf]\nc: 010\nd: 1.\n")
    assert data == {"a": 2e6, "b": ["on", "yes", "1_0", 31, "2", 500.0, -np.inf], "c": 10, "d": 1.0}
    assert type(data["a"]) is float
    assert lines["c",] == 3


def test_anchors_are_shared_text_but_not_shared_values():
    text = BASE.replace("shape: {tip: [1, 1, 0.8]", "shape: &s {tip: [1, 1, 0.8]").replace(
        "shape: {tip: [1, -1, 0.6], rim: [1, 0, 0]}", "shape: *s"
    )
    shape = load_scene(text, {"structure.modes.1.shape.tip": [5, 5, 5]}).model().structure.shape
    assert np.array_equal(shape[0], [[1, 5], [1, 5], [0.8, 5]])


def test_modes_are_sorted_with_what_belongs_to_them():
    text = BASE.replace("frequency: 0.9", "frequency: 1.9").replace(
        "initial: rest", "initial: {modal_velocity: [1, 2]}"
    )
    model = load_scene(text, {"excitation.forces": []}).model()
    assert np.array_equal(model.structure.frequency, [1.1, 1.9])
    assert np.array_equal(model.structure.mass, [2, 1])
    assert np.allclose(model.structure.damping, 4 * np.pi * np.array([0.03 * 1.1 * 2, 0.02 * 1.9]), rtol=1e-15)
    assert np.array_equal(model.structure.shape[0], [[1, 1], [-1, 1], [0.6, 0.8]])
    assert np.array_equal(model.start.velocity, [2, 1])
    assert np.array_equal(model.excitation.cosine, [[0, 1]])
    assert np.array_equal(model.excitation.sine, [[-1, 0]])


def test_forces_add_up_by_harmonic():
    forces = [
        {"point": "tip", "direction": [0, 0, 4], "amplitude": 2, "harmonic": 3, "phase_deg": 180},
        {"point": "tip", "direction": [3, 4, 0], "amplitude": 5, "phase_deg": 30},
    ]
    model = load_scene(BASE, {"excitation.forces": forces}).model()
    excitation = model.excitation
    assert np.array_equal(excitation.harmonic, [1, 3])
    pull = np.array([3 + 4, 3 - 4])
    assert np.allclose(excitation.cosine, [np.sqrt(0.75) * pull + [1, 0], -2 * np.array([0.8, 0.6])], rtol=1e-14)
    assert np.allclose(excitation.sine, [-0.5 * pull - [0, 1], [0, 0]], rtol=1e-14)
    assert np.allclose(excitation.constant, [0.4, 0.3], rtol=1e-15)


def test_contact_defaults_and_frames():
    contacts = [
        {"name": "a", "point": "tip", "friction": 0.3, "tangential_stiffness": [1, 2], "normal_stiffness": 1},
        {"name": "b", "point": "tip", "against": "rim", "normal": [0, 3, 0.1], "tangent": [1, 1, 0],
         "friction": 0.3, "tangential_stiffness": [[2, 1], [1, 2]], "normal_stiffness": 0, "preload": 2},
        {"name": "c", "point": "rim", "normal": [1e200, 0, 0], "friction": 0, "tangential_stiffness": 7,
         "normal_stiffness": 1},
    ]  # fmt: skip
    scene = load_scene(BASE, {"contacts": contacts})
    a, b, c = scene.model().contacts
    assert np.array_equal(a.frame, np.eye(3))
    assert (a.against, a.preload) == ("ground", 0)
    assert np.array_equal(a.tangential_stiffness, np.diag([1, 2]))
    assert np.allclose(b.frame @ b.frame.T, np.eye(3), atol=1e-15)
    assert np.allclose(np.linalg.det(b.frame), 1)
    assert np.allclose(b.frame[2] * np.hypot(3, 0.1), [0, 3, 0.1])
    assert b.frame[0] @ [1, 1, 0] > 0
    assert np.array_equal(c.frame, [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    assert not np.any(c.tangential_stiffness)
    assert any("tangential_stiffness has no effect" in warning for warning in warnings_of(scene))
    relative = scene.model().structure.shape[0] - scene.model().structure.shape[1]
    assert np.allclose(scene.model().contact_shape[1], b.frame @ relative, rtol=1e-15)


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("contacts.pad.preload=5", 5.0),
        ("contacts.0.preload=5", 5.0),
        ({"contacts.pad.preload": np.float64(5)}, 5.0),
        ("contacts.pad.preload=0x5", 5.0),
    ],
)
def test_override(override: Any, value: float):
    scene = load_scene(BASE, [override] if isinstance(override, str) else override)
    assert scene.model().contacts[0].preload == value
    assert load_scene(BASE).model().contacts[0].preload == 3


def test_a_star_names_every_item_of_a_list():
    scene = load_scene(CONFIGS / "blade.yaml", ["contacts.*.preload=7"])
    assert [contact.preload for contact in scene.model().contacts] == [7, 7]
    study = {"kind": "sweep", "frequency": {"values": [1.0, 2.0]}, "over": {"contacts.*.friction": [0.1, 0.2]}}
    varied = load_scene(CONFIGS / "blade.yaml", {"study": study}).variant({"contacts.*.friction": 0.2})
    assert [contact.friction for contact in varied.contacts] == [0.2, 0.2]
    assert problems(BASE, "contacts.*.prelod=3")[0][0] == "contacts.pad.prelod"
    assert problems(BASE, {"contacts": [], "contacts.*.preload": 3}) == [
        ("contacts.*.preload", "* is no item of the list")
    ]


def test_overrides_make_missing_sections_and_reach_into_lists():
    scene = load_scene(
        BASE.replace("solver:\n  accuracy: standard\n", ""),
        ["solver.method=rk4", "structure.modes.1.shape.tip.2=9"],
    )
    assert (scene.file.solver.method, scene.file.solver.steps_per_cycle) == ("rk4", 200)
    assert scene.model().structure.shape[0, 2, 1] == 9


@pytest.mark.parametrize(
    ("override", "key", "rule"),
    [
        ("contacts.pod.preload=5", "contacts.pod.preload", "pod is no item"),
        ("structure.modes.2.mass=5", "structure.modes.2.mass", "2 is no item"),
        ("contacts.pad.friction.x=1", "contacts.pad.friction.x", "has no keys"),
        ("contacts..x=1", "contacts..x", "is no item"),
        ("preload", "preload", "must be key.path=value"),
        ("study.cycles=", "study.cycles", "must be key.path=value"),
        ("study.cycles=[1", "study.cycles", "is no YAML"),
        ("study.cycles=!x 3", "study.cycles", "has the tag"),
        ("study.cycles=three", "study.cycles", "must be a whole number"),
        ("contacts.pad.prelod=3", "contacts.pad.prelod", "is no key"),
    ],
)
def test_bad_override(override: str, key: str, rule: str):
    with pytest.raises(SceneError) as caught:
        load_scene(BASE, [override])
    (problem,) = caught.value.problems
    assert (problem.file, problem.line, problem.key) == ("override", None, key)
    assert rule in problem.rule


def test_an_entry_of_a_list_that_the_scene_leaves_out_cannot_be_set():
    with pytest.raises(SceneError, match=r"contacts.stop.normal: .*must be a list \(not in the scene: give all of it"):
        load_scene(BASE, ["contacts.stop.normal.0=1"])


@pytest.mark.parametrize("override", ["contact.pad.preload=3", "contact=3", "solver.bogus.x=1"])
def test_a_key_that_an_override_makes_on_the_way_is_no_line_of_the_file(override: str, tmp_path: Path):
    path = tmp_path / "scene.yaml"
    path.write_text(BASE)
    with pytest.raises(SceneError) as caught:
        load_scene(path, [override])
    (problem,) = caught.value.problems
    assert (problem.file, problem.line) == ("override", None)
    assert problem.rule == "is no key here"


def test_mapping_is_a_scene():
    data = parse(BASE)[0]
    data["structure"]["modes"][0]["shape"]["tip"] = np.array([1.0, 1.0, 0.8])
    assert load_scene(data).resolved_yaml() == load_scene(BASE).resolved_yaml()
    data["title"] = object()
    assert problems(data) == [("title", "must be text, a number, a list or a mapping, not object")]
    data["title"] = data
    assert "nested deeper" in problems(data)[0][1]


@pytest.mark.parametrize("name", ["oscillator.yaml", "blade.yaml"])
def test_resolved_scene_runs_from_anywhere(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(CONFIGS.parent)
    scene = load_scene(Path("configs") / name, ["study.record_last=3"])
    resolved = scene.resolved_yaml()
    (tmp_path / "scene.yaml").write_text(resolved)
    monkeypatch.chdir(tmp_path)
    again = load_scene("scene.yaml")
    assert again.file.study.record_last == 3
    assert again.file == load_scene(resolved).file
    assert again.resolved_yaml() == resolved
    assert np.array_equal(again.model().structure.shape, scene.model().structure.shape)
    assert again.file.solver.accuracy == "standard"


def test_with_overrides_starts_from_the_scene():
    scene = load_scene(BASE, ["contacts.pad.preload=5"]).with_overrides({"contacts.pad.friction": 0.25})
    assert (scene.model().contacts[0].preload, scene.model().contacts[0].friction) == (5, 0.25)


def test_keys_of_over_hold_dots_themselves():
    study = "study={kind: sweep, frequency: {from: 1, to: 2, step: 0.5}, direction: up, refine: 0.01}"
    over = "study.over.contacts.pad.preload"
    assert load_scene(BASE, [study, f"{over}=[1,2]"]).file.study.over == {"contacts.pad.preload": (1, 2)}
    spread = load_scene(BASE, [study, f"{over}={{from: 1, to: 2, num: 3}}", f"{over}.num=5"]).file.study
    assert spread.over["contacts.pad.preload"].num == 5
    assert problems(BASE, study, f"{over[:-1]}=[1,2]")[0][0] == over[:-1]


def test_null_takes_a_key_out():
    study = "study={kind: sweep, frequency: {from: 1, to: 2, step: 0.5}, direction: up, refine: 0.01}"
    scene = load_scene(BASE, [study, "study.refine=null", "study.settle.tolerance=null", "title=null"])
    assert scene.file.study.refine is None
    assert scene.file.title == ""
    assert scene.resolved_yaml() == load_scene(BASE, [study.replace(", refine: 0.01", ""), "title=''"]).resolved_yaml()
    assert problems(BASE, "structure.modes.0.frequency=null") == [("structure.modes.0.frequency", "is required")]
    assert problems(BASE, "study.kind=null")[0][0] in ("study", "study.kind")


def test_a_missing_key_says_what_it_is():
    with pytest.raises(SceneError, match=r"contacts\.pad\.friction: is required \(Coefficient of friction\)"):
        load_scene(BASE, ["contacts.pad.friction=null"])


def test_solver_defaults():
    def solver(text: str) -> Any:
        return load_scene(BASE.replace("  accuracy: standard", f"  {text}")).file.solver

    assert (solver("reduce: false").accuracy, solver("reduce: false").reduce) == ("standard", False)
    assert (solver("reduce: false").method, solver("method: tsit5").accuracy) == ("auto", None)
    assert solver("{accuracy: draft, method: auto}") == solver("accuracy: draft")
    assert (solver("method: tsit5").rtol, solver("method: tsit5").atol) == (1e-8, 1e-10)
    assert solver("{method: kvaerno5, rtol: 1e-6}").atol == pytest.approx(1e-8)
    assert solver("{method: rk4}").steps_per_cycle == 200
    assert solver("max_steps: 2e3").max_steps == 2000


# Starts


def one_mass(**changes: Any) -> dict[str, Any]:
    """A mass on springs k = (2 pi)^2 along x and z, with a contact below."""
    modes = [{"frequency": 1, "damping_ratio": 0, "mass": 1, "shape": {"m": axis}} for axis in ([1, 0, 0], [0, 0, 1])]
    contact = {"name": "c", "point": "m", "friction": 0.5, "tangential_stiffness": 10, "normal_stiffness": 20}
    return {
        "structure": {"modes": modes},
        "contacts": [contact | changes.pop("contact", {})],
        "excitation": {"frequency": 1, **changes.pop("excitation", {})},
        "study": {"kind": "transient", "cycles": 1},
        **changes,
    }


def push(*vector: float) -> dict[str, Any]:
    return {"constant_forces": [{"point": "m", "direction": vector, "amplitude": float(np.linalg.norm(vector))}]}


K = (2 * np.pi) ** 2


@pytest.mark.parametrize(
    ("preload", "force", "state", "displacement"),
    [
        (0.0, (1, 0, 4), STICK, (1 / (K + 10), 4 / (K + 20))),
        (0.0, (1, 0, -4), SEPARATION, (1 / K, -4 / K)),
        (3.0, (0.5, 0, -1), STICK, (0.5 / (K + 10), -1 / (K + 20))),
        (3.0, (0, 0, -20), SEPARATION, (0, (-20 + 3) / K)),
        (-1.0, (0, 0, 5), STICK, (0, (5 + 1) / (K + 20))),
        (-1.0, (0, 0, 1), SEPARATION, (0, 1 / K)),
    ],
)
def test_static_start(preload: float, force: tuple[float, ...], state: int, displacement: tuple[float, float]):
    scene = load_scene(one_mass(contact={"preload": preload}, excitation=push(*force), initial="static"))
    start = scene.model().start
    assert np.allclose(start.displacement, displacement, rtol=1e-13, atol=1e-15)
    assert start.state.tolist() == [state]
    assert np.allclose(start.slip, [[displacement[0] * (state == SEPARATION), 0]], atol=1e-15)


def test_static_start_of_a_frictionless_stop_slides():
    contact = {"friction": 0, "tangential_stiffness": 0, "preload": 1}
    start = load_scene(one_mass(contact=contact, excitation=push(3, 0, 0), initial="static")).model().start
    assert start.state.tolist() == [SLIP]
    assert np.allclose(start.slip, [[3 / K, 0]])


def test_static_start_held_by_a_contact_alone():
    scene = one_mass(excitation=push(0, 0, 5), initial="static", contact={"preload": -1})
    scene["structure"]["modes"][1]["frequency"] = 0
    assert np.allclose(load_scene(scene).model().start.displacement, [6 / 20, 0])
    scene["excitation"] = {"frequency": 1, **push(0, 0, -5)}
    assert "nothing holds" in problems(scene)[0][1]


def test_static_start_of_many_contacts_is_consistent():
    rng = np.random.default_rng(3)
    for _ in range(20):
        modes = [
            {
                "frequency": 1 + i,
                "damping_ratio": 0,
                "mass": 1,
                "shape": {f"p{j}": rng.normal(size=3) for j in range(5)},
            }
            for i in range(6)
        ]
        contacts = [
            {"name": f"c{j}", "point": f"p{j}", "friction": 1e6, "tangential_stiffness": 30,
             "normal_stiffness": 40, "preload": rng.normal()} for j in range(5)
        ]  # fmt: skip
        force = {"point": "p0", "direction": rng.normal(size=3), "amplitude": 30}
        scene = one_mass(structure={"modes": modes}, contacts=contacts, initial="static")
        scene["excitation"]["constant_forces"] = [force]
        model = load_scene(scene).model()
        motion = model.contact_shape @ model.start.displacement
        force = model.excitation.constant - model.structure.stiffness * model.start.displacement
        for contact, shape, (u1, u2, v), slip, state in zip(
            model.contacts, model.contact_shape, motion, model.start.slip, model.start.state, strict=True
        ):
            normal = max(0.0, contact.preload + contact.normal_stiffness * v)
            assert (state == SEPARATION) == (normal == 0)
            friction = contact.tangential_stiffness @ ([u1, u2] - slip)
            force = force - shape.T @ [*friction, normal - max(contact.preload, 0)]
        assert np.abs(force).max() < 1e-11


def test_given_start_opens_a_contact_and_says_what_has_no_effect():
    initial = {"modal_displacement": [0.1, -0.2], "slip": {"c": [0.3, 0]}}
    scene = load_scene(one_mass(contact={"preload": 1}, initial=initial))
    start = scene.model().start
    assert np.allclose(start.slip, [[0.1, 0]])
    assert any("initial.slip.c has no effect" in warning for warning in warnings_of(scene))
    assert start.state.tolist() == [-1]


@pytest.mark.parametrize(("share", "accepted"), [(1 - 1e-12, True), (1 + 1e-10, True), (1 + 1e-8, False)])
def test_given_start_on_the_cone(share: float, accepted: bool):
    slip = 0.5 * 2.0 / 10 * share
    scene = one_mass(contact={"preload": 2}, initial={"slip": {"c": [slip, 0]}})
    if accepted:
        accepted_slip = load_scene(scene).model().start.slip[0, 0]
        assert accepted_slip == (slip if share < 1 else pytest.approx(slip, rel=2e-9))
        assert 10 * accepted_slip <= 0.5 * 2.0
        assert not any("has no effect" in warning for warning in warnings_of(load_scene(scene)))
    else:
        assert "outside its friction cone" in problems(scene)[0][1]


def write_result(path: Path, **changes: Any) -> Path:
    values = {
        "final_modal_displacement": ("mode", [0.01, 0.02]),
        "final_modal_velocity": ("mode", [0.3, 0.4]),
        "final_slip": (("contact", "tangent"), [[0.002, 0.0]]),
        "final_contact_state": ("contact", [0]),
        "final_phase_deg": ((), 90.0),
    } | changes.pop("values", {})
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"mode": 2, "contact": 1, "tangent": 2} | changes.pop("dimensions", {})
        file.attrs["complete"] = changes.pop("complete", 1)
        names = file.create_variable("contact", ("contact",), dtype=h5netcdf.core.h5py.string_dtype())
        names[...] = changes.pop("names", ["c"])
        for name, (dimensions, value) in values.items():
            array = np.asarray(value)
            file.create_variable(name, (dimensions,) if isinstance(dimensions, str) else dimensions, data=array)
    return path


def test_start_from_a_result(tmp_path: Path):
    write_result(tmp_path / "result.nc")
    (tmp_path / "scene.yaml").write_text(yaml_text(one_mass(contact={"preload": 2}, initial={"from": "result.nc"})))
    scene = load_scene(tmp_path / "scene.yaml")
    start = scene.model().start
    assert np.array_equal(start.displacement, [0.01, 0.02])
    assert np.array_equal(start.velocity, [0.3, 0.4])
    assert np.array_equal(start.slip, [[0.002, 0]])
    assert start.state.tolist() == [STICK]
    assert start.phase == pytest.approx(np.pi / 2)
    assert str(tmp_path / "result.nc") in scene.resolved_yaml()


@pytest.mark.parametrize(
    ("contact", "values", "state", "slip"),
    [
        ({"preload": -2}, {}, SEPARATION, 0.01),
        ({"preload": 2}, {"final_contact_state": ("contact", [2])}, STICK, 0.01),
        ({"preload": 2, "friction": 0}, {}, SLIP, 0.01),
        ({"preload": -0.4}, {"final_contact_state": ("contact", [2])}, SEPARATION, 0.01),
        # on the cone but for the tolerance of that run: n = 2 + 20 * 0.02, mu n = 1.2
        (
            {"preload": 2},
            {"final_slip": (("contact", "tangent"), [[0.01 - 0.12 * (1 + 5e-7), 0]])},
            STICK,
            0.01 - 0.12,
        ),
    ],
)
def test_start_from_a_result_of_other_parameters(tmp_path: Path, contact: Any, values: Any, state: int, slip: float):
    path = write_result(tmp_path / "result.nc", values=values)
    start = load_scene(one_mass(contact=contact, initial={"from": path})).model().start
    assert start.state.tolist() == [state]
    assert np.allclose(start.slip, [[slip, 0]], rtol=1e-14)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"names": ["d"]}, "has other contacts: d"),
        ({"values": {"final_slip": (("contact", "tangent"), [[0.5, 0.0]])}}, "outside its friction cone"),
        ({"values": {"final_modal_velocity": ("mode", [np.nan, 0])}}, "not finite"),
        (
            {
                "dimensions": {"mode": 1},
                "values": {
                    "final_modal_displacement": ("mode", [0.0]),
                    "final_modal_velocity": ("mode", [0.0]),
                },
            },
            "has 1 mode, the scene has 2",
        ),
        (
            {"values": {"final_slip": (("contact", "tangent"), [[0.0]])}, "dimensions": {"tangent": 1}},
            "holds no final_slip of numbers along contact, tangent",
        ),
        (
            {"values": {"final_contact_state": ("mode", [0, 0])}},
            "holds no final_contact_state of numbers along contact",
        ),
        ({"values": {"final_modal_velocity": ("mode", [b"a", b"b"])}}, "holds no final_modal_velocity of numbers"),
        (
            {"values": {"mode_shape": (("contact", "mode"), [[0, 0]])}},
            "holds no mode_shape of numbers along point, axis",
        ),
    ],
)
def test_result_that_no_start_is(tmp_path: Path, changes: Any, rule: str):
    path = write_result(tmp_path / "result.nc", **changes)
    ((key, refusal),) = problems(one_mass(contact={"preload": 2}, initial={"from": str(path)}))
    assert key == "initial.from"
    assert rule in refusal


def test_a_result_that_lacks_a_part_of_its_state_is_no_start(tmp_path: Path):
    path = write_result(tmp_path / "result.nc")
    with h5netcdf.File(path, "a") as file:
        del file._h5group["final_slip"], file._h5group["final_phase_deg"]
    ((key, refusal),) = problems(one_mass(contact={"preload": 2}, initial={"from": str(path)}))
    assert key == "initial.from"
    assert refusal == "lacks final_slip, final_phase_deg"


def test_files_that_no_result_are(tmp_path: Path):
    path = tmp_path / "result.nc"
    path.write_bytes(b"nothing")
    assert "cannot be read as NetCDF-4" in problems(one_mass(initial={"from": str(path)}))[0][1]
    with h5netcdf.File(path, "w") as file:
        file.attrs["complete"] = 1
    assert "holds no final state" in problems(one_mass(initial={"from": str(path)}))[0][1]


# What check says


def test_describe_names_every_part():
    scene = load_scene(CONFIGS / "oscillator.yaml")
    report = describe(scene)
    assert report["structure"] == (
        "2 modes",
        "natural frequencies without contacts: 0.9, 1.1 Hz",
        "natural frequencies with every contact stuck: 1.41464, 1.59744 Hz",
        "damping ratio 0.02",
        "points: tip",
    )
    assert "same tangential stiffness" in report["left out or simplified"][0]
    assert "preload 3" in report["contacts"][0]
    assert "warnings" not in report


def test_describe_says_what_is_left_out_and_why():
    def said(**overrides: Any) -> tuple[str, ...]:
        changes = {key.replace("__", "."): value for key, value in overrides.items()}
        scene = load_scene(CONFIGS / "oscillator.yaml", changes)
        return describe(scene)["left out or simplified"]

    assert "sticks from start to end" in said(contacts__pad__preload=100)[0]
    assert "never touches" in said(contacts__pad__preload=-40)[0]
    assert said(contacts__pad__preload=100, solver__reduce=False) == ("nothing: solver.reduce is false",)


def test_describe_says_that_the_error_will_be_estimated():
    def said(name: str, *overrides: str) -> tuple[str, ...]:
        return describe(load_scene(CONFIGS / f"{name}.yaml", overrides)).get("accuracy", ())

    (line,) = said("oscillator", "solver={method: dopri8, rtol: 1e-9}")
    assert "second run (dopri8, rtol 1e-08, atol 1e-10), 0.6 of the time" in line
    assert said("oscillator", "solver={method: dopri8, rtol: 1e-9, estimate_error: false}") == ()
    assert said("bistable", "solver={method: dopri8, rtol: 1e-9}") == ()


def test_describe_says_what_is_promised_and_by_which_tolerances():
    def said(name: str, *overrides: str) -> str:
        return describe(load_scene(CONFIGS / f"{name}.yaml", overrides))["accuracy"][0]

    run = "promises a relative error of 1e-06 of the state at the end of the run, by tsit5, rtol "
    assert said("oscillator") == run + "1e-07, atol 1e-09"
    assert said("blade").startswith(run)
    assert said("blade").endswith("(most scenes do with rtol 1e-07)")
    assert said("bistable", "solver.accuracy=draft").startswith("promises a relative error of 1e-04 of a steady state")


def test_contacts_of_which_the_same_is_found_are_counted():
    disk = describe(load_scene(CONFIGS / "bladed_disk.yaml"))["left out or simplified"]
    straight = " moves straight along (1, 0) of its plane: one tangential component is modelled"
    assert disk == (f"contact s01, and 5 others alike,{straight}",)
    few = load_scene(CONFIGS / "bladed_disk.yaml", {"contacts.s01.friction": 0.0, "contacts.s23.friction": 0.1})
    lines = describe(few)["left out or simplified"]
    assert lines[0] == f"contact s12, and 4 others alike,{straight}"
    assert lines[1].startswith("contact s01 is a frictionless stop: ")


def test_describe_counts_points_and_names_the_method_at_the_lowest_frequency():
    def report(*overrides: str) -> dict[str, tuple[str, ...]]:
        return describe(load_scene(BASE, overrides))

    sweep = "study={direction: both, frequency: {from: 1, to: 2, step: 0.5}, kind: sweep}"
    headings = report(sweep, f"study.over.contacts.pad.preload={[float(k) for k in range(9)]}")
    _, study, points, *_ = headings["scene"]
    written = "direction both, frequency {from: 1.0, to: 2.0, step: 0.5}"
    assert study.startswith(f"study: kind sweep, {written}, over {{contacts.pad.preload: [0.0, 1.0, 2.0, …, 8.0]}}, ")
    assert points == "points: 3 frequencies x 9 values of contacts.pad.preload x 2 directions = 54 points"
    (advice,) = headings["method"]
    assert advice.startswith("tsit5: ")
    assert advice.endswith("(at 1 Hz, the lowest, where it asks most)")
    plain = report("study={kind: sweep, frequency: {values: [1, 2, 3]}}")["scene"]
    assert "points: 3 frequencies" in plain
    assert "over" not in " ".join(plain)
    one = report(
        "study={kind: sweep, frequency: {values: [1]}, over: {contacts.pad.preload: 2}, settle: {max_cycles: 1}}"
    )
    assert "points: 1 frequency x 1 value of contacts.pad.preload = 1 point" in one["scene"]
    assert "gives for contacts.pad.preload, which the study varies" in one["scene"][-1]
    assert one["cost"][0].startswith("about 1 point of 1 cycle of ")
    ranges = report("study={kind: bistable, frequency: {from: 1, to: 2}, harmonics: 0}")
    assert (
        "points: 41 frequencies x 2 directions = 82 points in the sweeps, and the search for the ends"
        in ranges["scene"]
    )
    assert "at 1 Hz" in ranges["method"][0]
    assert re.fullmatch(r"about 81 starts of \d+ cycles of .*s within each range that is found: .*s", ranges["cost"][1])
    ends_alone = report("study={kind: bistable, frequency: {from: 1, to: 2}, harmonics: 0, starts: 0}")
    assert not [line for line in ends_alone["cost"] if "starts" in line]
    jump = report("study={kind: jump, phases: [{frequency: 2, cycles: 3}, {frequency: 1.5, cycles: 3}]}")
    assert "at 1.5 Hz" in jump["method"][0]
    assert "method" not in report("study={kind: hbm, frequency: {from: 1, to: 2}, harmonics: 7}")


def test_describe_contacts():
    def line(**changes: Any) -> str:
        return contact_line(load_scene(one_mass(contact=changes)).model().contacts[0], {})

    assert "gap 0.1" in line(preload=-2)
    assert "frictionless stop" in line(friction=0, tangential_stiffness=0)
    assert "constant normal load 4" in line(normal_stiffness=0, preload=4)
    assert "stiffness [1, 2]," in line(tangential_stiffness=[1, 2])
    assert "stiffness [[2, 1], [1, 2]]," in line(tangential_stiffness=[[2, 1], [1, 2]])
    contact = load_scene(one_mass(contact={"preload": -2})).model().contacts[0]
    said = contact_line(contact, {"length": "mm", "force": "N"})
    assert "tangential stiffness 10 N/mm, normal stiffness 20 N/mm, gap 0.1 mm" in said
    report = describe(load_scene(one_mass(units={"length": "mm", "force": "N"}, contact={"preload": -2000})))
    assert report["scene"][0] == "units: length mm, force N, mass N s²/mm = t, time s"
    assert report["left out or simplified"][-1].endswith(" mm (gap 100 mm)")


def test_a_contact_with_a_wrong_normal_is_worth_a_warning():
    """Of a mass that moves along x alone; by default the normal is z."""
    mode = {"frequency": 1.0, "damping_ratio": 0.01, "mass": 1.0, "shape": {"tip": [1, 0, 0]}}
    pad = {
        "name": "pad",
        "point": "tip",
        "friction": 0.3,
        "tangential_stiffness": 5,
        "normal_stiffness": 0,
        "preload": 1,
    }
    force = {"point": "tip", "direction": [1, 0, 0], "amplitude": 1}
    scene = {
        "structure": {"modes": [mode]},
        "contacts": [pad],
        "excitation": {"frequency": 1.1, "forces": [force]},
        "study": {"kind": "transient", "cycles": 5},
    }
    wrong = {"contacts.pad.normal": [1, 0, 0], "contacts.pad.tangent": [0, 1, 0]}
    for changes, said in (
        (wrong, "in its plane, which is normal to (1, 0, 0): its normal load is constant, so it has no effect"),
        (wrong | {"contacts.pad.normal_stiffness": 3}, "(1, 0, 0): it never rubs, and acts as a stop"),
        ({}, ""),
    ):
        loaded = load_scene(scene, changes)
        warned = [line for line in warnings_of(loaded) if "no mode moves it" in line]
        assert [line.endswith(said) for line in warned] == ([True] if said else [])
    report = describe(load_scene(scene, wrong | {"contacts.pad.normal_stiffness": 3}))
    assert any("pad: tip against the ground, normal (1, 0, 0), friction 0.3" in line for line in report["contacts"])
    assert not any("moves straight" in line for lines in report.values() for line in lines)


def test_modes_far_above_the_excitation_are_worth_a_warning():
    assert list(warnings_of(load_scene(CONFIGS / "blade.yaml"))) == []
    (warning,) = warnings_of(load_scene(CONFIGS / "blade.yaml", ["structure.keep_modes=24"]))
    assert "330695 Hz" in warning
    assert "keep_modes" in warning
    sweep = "study={kind: sweep, frequency: {from: 500, to: 1000, step: 250}}"
    unused, *_, far = warnings_of(load_scene(CONFIGS / "blade.yaml", ["structure.keep_modes=24", sweep]))
    assert "excitation.frequency is not used" in unused
    assert "331 times the excitation" in far
    report = describe(load_scene(CONFIGS / "blade.yaml", [sweep]))
    assert report["excitation"][0].startswith("frequency set by the study")
    *_, far = warnings_of(load_scene(CONFIGS / "blade_response.yaml", ["structure.keep_modes=24"]))
    assert "367 times the excitation" in far


@pytest.mark.parametrize(("highest", "warned"), [(2000.0, True), (1050.0, False)])
def test_modes_that_cost_few_steps_are_kept_without_a_word(highest, warned):
    """A stop moves the mode at 1,000 Hz, so only the highest one may be left out."""
    stiffness = np.diag((2 * np.pi * np.array([9.0, 1000.0, highest])) ** 2).tolist()
    matrices = {"mass": np.eye(3).tolist(), "stiffness": stiffness, "damping_ratio": 0.01}
    stop = {"name": "stop", "point": "tip", "normal": [0, 1, 0], "friction": 0, "tangential_stiffness": 0}
    scene = {
        "structure": {"matrices": matrices | {"points": {"tip": {"x": 0, "y": 1, "z": 2}}}},
        "contacts": [stop | {"normal_stiffness": 1e7, "preload": 1}],
        "excitation": {"frequency": 10, "forces": [{"point": "tip", "direction": [1, 1, 1], "amplitude": 1}]},
        "study": {"kind": "transient", "cycles": 1},
    }
    found = [warning for warning in warnings_of(load_scene(scene)) if "costs steps" in warning]
    assert len(found) == warned


def test_an_excitation_far_above_all_modes_is_worth_a_warning():
    (warning,) = warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["excitation.frequency=8.73"]))
    assert warning.startswith("the excitation reaches 8.73 Hz, 7.94 times the highest mode: frequencies are in Hz")
    assert list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["excitation.frequency=4"]))) == []


def test_damping_of_a_body_that_nothing_holds():
    """Its frequency is 0, so that it has no share of critical damping."""
    matrices = {"mass": [[1]], "stiffness": [[0]], "damping": [[0.1]], "points": {"m": {"x": 0}}}
    scene = one_mass() | {"structure": {"matrices": matrices}}
    assert "damping: of free motions, of which there is no ratio" in describe(load_scene(scene))["structure"]


RING = [[200, -50, -50], [-50, 200, -50], [-50, -50, 200]]
"""Three masses in a ring, a disk of three sectors: one mode, and two of one frequency."""


@pytest.mark.parametrize(
    ("stiffness", "kept", "says"),
    [
        (
            RING,
            2,
            "2 parts modes 2 to 3, which have one frequency, 2.51646 Hz: which of them is kept is chance; 1 or 3",
        ),
        (np.diag([1.0, 1.0, 2.0]).tolist(), 1, "1 parts modes 1 to 2, which have one frequency, 0.159155 Hz"),
        (np.diag([0.0, 0.0, 2.0]).tolist(), 1, "1 parts modes 1 to 2, which have one frequency, 0 Hz"),
        (RING, 1, None),
        (RING, 3, None),
        (np.diag([1.0, 1.001, 2.0]).tolist(), 1, None),
    ],
)
def test_modes_of_one_frequency_that_are_kept_in_part_are_worth_a_warning(stiffness, kept, says):
    """Which of them that is, the numbering of the rows decides."""
    points = {"a": {"x": 0}, "b": {"x": 1}, "c": {"x": 2}}
    matrices = {"mass": np.eye(3).tolist(), "stiffness": stiffness, "damping_ratio": 0.02, "points": points}
    scene = {
        "structure": {"matrices": matrices, "keep_modes": kept},
        "excitation": {"frequency": 0.3, "forces": [{"point": "a", "direction": [1, 0, 0], "amplitude": 1}]},
        "study": {"kind": "transient", "cycles": 1},
    }
    found = [warning for warning in warnings_of(load_scene(scene)) if warning.startswith("structure.keep_modes: ")]
    assert len(found) == (says is not None)
    assert says is None or says in found[0]


@pytest.mark.parametrize(("stiffness", "kept"), [(1e6, None), (1e2, 1)])
def test_modes_that_contacts_move_are_not_to_spare(stiffness, kept):
    """A lap joint: two plates that move together below 0.2 Hz, and against each other at 450 Hz."""
    matrices = {"mass": [[1, 0], [0, 1]], "stiffness": [[4e6, -4e6], [-4e6, 4e6]], "damping": [[1, 0], [0, 1]]}
    contact = {"name": "joint", "point": "a", "against": "b", "normal": [0, 1, 0], "tangent": [1, 0, 0]}
    scene = {
        "structure": {"matrices": matrices | {"points": {"a": {"x": 0}, "b": {"x": 1}}}},
        "contacts": [
            contact | {"friction": 0.3, "tangential_stiffness": stiffness, "normal_stiffness": 0, "preload": 10}
        ],
        "excitation": {"frequency": 3, "forces": [{"point": "a", "direction": [1, 0, 0], "amplitude": 1}]},
        "study": {"kind": "transient", "cycles": 1},
    }
    found = [warning for warning in warnings_of(load_scene(scene)) if "costs steps" in warning]
    assert len(found) == (kept is not None)
    assert kept is None or f"structure.keep_modes: {kept} would reach 0 Hz; a study of kind tradeoff" in found[0]


@pytest.mark.parametrize(
    ("torque", "normal_stiffness", "kind", "warned"),
    [(0.8, 0, "hbm", True), (0.3, 0, "hbm", False), (0.8, 5, "hbm", False), (0.8, 0, "sweep", False)],
)
def test_a_body_that_friction_alone_may_not_hold_is_worth_a_warning(torque, normal_stiffness, kind, warned):
    """A rotor whose clutch bears 0.9 of a torque of 0.5 at most about a constant one; or one that a stop holds too."""
    matrices = {"mass": [[1, 0], [0, 0.4]], "stiffness": [[8, -8], [-8, 8]], "damping": [[0.1, -0.1], [-0.1, 0.1]]}
    clutch = {"name": "clutch", "point": "hub", "normal": [0, 1, 0], "tangent": [1, 0, 0], "friction": 0.3}
    stop = {"name": "stop", "point": "hub", "normal": [1, 0, 0], "tangent": [0, 1, 0], "friction": 0.0}
    stop |= {"tangential_stiffness": 0, "normal_stiffness": normal_stiffness, "preload": -1}
    clutch |= {"tangential_stiffness": 40, "normal_stiffness": 0, "preload": 3}
    force = {"point": "disk", "direction": [1, 0, 0]}
    scene = {
        "structure": {"matrices": matrices | {"points": {"hub": {"x": 0}, "disk": {"x": 1}}}},
        "contacts": [clutch, stop] if normal_stiffness else [clutch],
        "excitation": {"forces": [force | {"amplitude": 0.5}], "constant_forces": [force | {"amplitude": torque}]},
        "study": {"kind": kind, "frequency": {"from": 0.3, "to": 0.6} | ({} if kind == "hbm" else {"step": 0.1})},
    }
    assert any("it may drift" in warning for warning in warnings_of(load_scene(scene))) == warned


def test_a_force_that_leaves_the_rigid_body_alone_is_no_push():
    """Three masses in a row under constant forces that add up to none but for rounding."""
    stiffness = [[1, -1, 0], [-1, 3, -2], [0, -2, 2]]
    matrices = {"mass": [[1, 0, 0], [0, 1.7, 0], [0, 0, 2.3]], "stiffness": stiffness, "damping_ratio": 0.1}
    contact = {"name": "pad", "point": "b", "normal": [0, 1, 0], "tangent": [1, 0, 0], "friction": 0.3}
    contact |= {"tangential_stiffness": 1, "normal_stiffness": 0, "preload": 1e-3}
    pulls = {"a": 0.7, "b": -0.4, "c": -0.3}
    forces = [{"point": name, "direction": [1, 0, 0], "amplitude": size} for name, size in pulls.items()]
    scene = load_scene(
        {
            "structure": {"matrices": matrices | {"points": {"a": {"x": 0}, "b": {"x": 1}, "c": {"x": 2}}}},
            "contacts": [contact],
            "excitation": {"forces": forces[:1], "constant_forces": forces},
            "study": {"kind": "hbm", "frequency": {"from": 0.1, "to": 0.2}},
        }
    )
    assert 0 < abs(scene.model().excitation.constant[0]) < 1e-15
    assert not any("it may drift" in warning for warning in warnings_of(scene))


def inline(mass):
    points = {"tip": {"x": 0}}
    return {"matrices": {"mass": mass, "stiffness": [[1, 0], [0, 1]], "damping_ratio": 0.01, "points": points}}


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        (
            "study",
            {"kind": "sweep", "frequency": [1.0, 1.1]},
            "a mapping of keys (its keys: from, to, step, num, values)",
        ),
        ("structure", inline([2, 3]), "mass.1: 3: must be a list (Mass matrix, symmetric positive definite, by its"),
        ("excitation.forces", {"point": "tip", "amplitude": 1}, "must be a list (put - before it, as before each of"),
        ("excitation.forces", [{"direction": "x"}], "x: must be a list (Along x, y, z, such as [1, 0, 0]"),
        ("excitation.forces", [{"direction": {"x": 1}}], "direction: {x: 1}: must be a list (Along x, y, z"),
        ("initial", {"from": "r.nc", "at": {"frequency": [0.945]}}, "must be a number or text"),
        ("study.kind", "frf", "must be one of transient, jump, tradeoff, element, element_map, sweep, hbm, compare"),
    ],
)
def test_another_form_than_is_asked_for_is_answered_with_that_form(key, value, says):
    with pytest.raises(SceneError) as refused:
        load_scene(CONFIGS / "oscillator.yaml", {key: value})
    assert says in str(refused.value)
    assert "known:" not in str(refused.value)


def test_a_key_of_another_section_is_sent_there():
    def refused(key: str) -> str:
        with pytest.raises(SceneError, match=f"{key}: .*is no key here") as caught:
            load_scene(
                CONFIGS / f"{'two_contacts' if 'step' in key or 'refine' in key else 'oscillator'}.yaml", {key: 2}
            )
        return str(caught.value)

    assert "the frequency of one run is excitation.frequency" in refused("study.frequency")
    with pytest.raises(SceneError, match=r"study\.frequency: .*is no key here") as caught:
        load_scene(CONFIGS / "figure4.yaml", {"study.frequency": 2})
    assert "excitation.frequency" not in str(caught.value)
    assert "it is solver.accuracy" in refused("study.accuracy")
    assert "a gap is a negative preload" in refused("contacts.pad.gap")
    assert "each of forces and modal_force has its own" in refused("excitation.phase_deg")
    assert "it belongs in frequency" in refused("study.step")
    assert "it belongs beside frequency, not in it" in refused("study.frequency.refine")


def test_keys_that_change_nothing_are_named_unless_they_are_the_default(tmp_path: Path):
    static = {"initial": "static"}

    def unused(changes: Mapping[str, Any], scene: Path) -> list[str]:
        said = (line.split(" is not used: in a study of kind ") for line in warnings_of(load_scene(scene, changes)))
        return [": ".join(line) for line in said if len(line) == 2 and line[0] != "excitation.frequency"]

    oscillator = CONFIGS / "oscillator.yaml"
    balance = {"study": {"kind": "hbm", "frequency": {"from": 1.0, "to": 1.5}}}
    sweep = {"study": {"kind": "sweep", "frequency": {"values": [1.0]}}}
    tried = {"study": {"kind": "tradeoff"}}
    assert unused(static, oscillator) == unused(sweep | static, oscillator) == []
    assert unused(balance | static, oscillator) == ["initial: hbm study.start says where the curves begin"]
    rk4 = {"solver": {"method": "rk4"}}
    assert unused(balance | rk4, oscillator) == ["solver.method: hbm nothing is integrated in time"]
    assert unused(tried | rk4, oscillator) == ["solver.method: tradeoff all methods are tried"]
    quick = {"solver": {"max_steps": 5000, "estimate_error": False}}
    assert unused(tried | quick, oscillator) == unused(quick, oscillator) == []
    assert unused(sweep | quick, oscillator) == ["solver.estimate_error: sweep no error is estimated"]
    for scene in (oscillator, CONFIGS / "figure4.yaml"):
        for study in ({}, balance, tried) if scene == oscillator else ({},):
            written = tmp_path / "scene.yaml"
            written.write_text(load_scene(scene, study).resolved_yaml())
            assert unused({}, written) == [], "every default stands there"


def test_a_contact_under_prescribed_motion_has_neither_structure_nor_solver():
    """What such a scene names of a structure is not modelled, and `check` does not describe it."""
    body = {"modes": [{"frequency": 0.9, "damping_ratio": 0.01, "mass": 1.0, "shape": {"tip": [1, 0, 0]}}]}
    element = load_scene(
        CONFIGS / "figure4.yaml", {"structure": body, "solver.accuracy": "draft", "contacts.pad.point": "tip"}
    )
    says = "is not used: in a study of kind element the motion of the contact is given"
    assert list(warnings_of(element)) == [f"structure {says}", f"solver {says}"]
    implicit = load_scene(CONFIGS / "figure4.yaml", {"solver.method": "exponential"})
    assert list(warnings_of(implicit)) == [f"solver {says}"]
    report = describe(element)
    assert "structure" not in report
    assert not any("moves straight" in line for line in report["contacts"])
    assert not any(line.startswith(("solver", "start")) for line in report["scene"])
    assert any(line.startswith("solver") for line in describe(load_scene(CONFIGS / "figure7.yaml"))["scene"])


def test_steps_that_pass_over_a_resonance_are_worth_a_warning():
    """A mode of 0.1 % at 434.5 Hz is 0.87 Hz wide at half of its power."""

    def warnings(step: float, damping: float = 1e-3) -> list[str]:
        modes = {"modes": [{"frequency": 434.5, "damping_ratio": damping, "mass": 1.0, "shape": {"tip": [1, 0, 0]}}]}
        study = {"kind": "sweep", "frequency": {"from": 400, "to": 500, "step": step}}
        changes = {
            "structure": modes,
            "contacts": [],
            "excitation": {"modal_force": [{"amplitude": 1}]},
            "study": study,
        }
        return list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", changes)))

    (passed,) = warnings(10.0)
    assert "at 434.5 Hz is 0.87 Hz wide" in passed
    assert "steps of 10 Hz" in passed
    assert warnings(0.8) == warnings(10.0, 0.02) == []
    ends, passed = warnings(30.0)
    assert ends == "study.frequency: in steps of 30 Hz from 400 Hz the last is 490, not 500 Hz"
    (alone,) = warnings(300.0)
    assert alone.endswith("from 400 Hz the last is 400, not 500 Hz")
    assert "has no structural damping" in warnings(10.0, 0.0)[0]


def rod(keep_modes: int, clamped: bool) -> dict[str, Any]:
    """Twenty equal masses in a row, the first held by a spring or not; a contact sticks at the middle."""
    stiffness = 400 * (2 * np.eye(20) - np.eye(20, k=1) - np.eye(20, k=-1))
    stiffness[19, 19], stiffness[0, 0] = 400, 800 if clamped else 400
    inline = {"mass": np.eye(20) / 20, "stiffness": stiffness, "damping_ratio": 0.05, "points": {"tip": {"x": 9}}}
    return {"matrices": inline, "keep_modes": keep_modes}


@pytest.mark.parametrize("clamped", [True, False])
@pytest.mark.parametrize("kind", ["sweep", "hbm"])
def test_modes_left_out_that_make_a_contact_too_stiff_are_worth_a_warning(clamped, kind):
    def warnings(keep_modes: int) -> list[str]:
        span = {"from": 1.0, "to": 3.5} | ({"step": 0.1} if kind == "sweep" else {})
        pad = {"name": "pad", "point": "tip", "friction": 0.5, "tangential_stiffness": 1e4, "normal_stiffness": 0.0}
        force = {"point": "tip", "direction": [1, 0, 0], "amplitude": 1.0}
        changes = {
            "structure": rod(keep_modes, clamped),
            "contacts": [pad | {"preload": 1.0}],
            "excitation": {"forces": [force]},
            "study": {"kind": kind, "frequency": span},
        }
        return [line for line in warnings_of(load_scene(CONFIGS / "oscillator.yaml", changes)) if "put a" in line]

    own = rod(20, clamped)["matrices"]
    squared = np.linalg.eigvalsh(20 * (own["stiffness"] + np.diag(1e4 * (np.arange(20) == 9))))
    (line,) = warnings(3)
    told = float(re.search(r"all modes near ([\d.]+) Hz", line)[1])
    assert np.abs(np.sqrt(squared) / (2 * np.pi) / told - 1).min() < 0.005
    assert warnings(18) == warnings(20) == []


@pytest.mark.parametrize(
    ("kind", "more"),
    [("sweep", {}), ("compare", {}), ("optimum", {"along": {"contacts.pad.preload": {"from": 1, "to": 3, "num": 3}}})],
)
def test_a_light_mode_beside_a_heavily_damped_one_is_told_by_its_own_width(kind, more):
    """The search for the least peak, too, looks only about the largest points of its sweeps."""
    light = {"frequency": 1.513, "damping_ratio": 3e-4, "mass": 1.0, "shape": {"tip": [0.01, 0, 0]}}
    heavy = {"frequency": 1.0, "damping_ratio": 0.05, "mass": 1.0, "shape": {"tip": [1, 0, 0]}}
    study = {"kind": kind, "frequency": {"from": 0.8, "to": 1.8, "step": 0.05}, **more}
    changes = {"structure": {"modes": [heavy, light]}, "study": study}
    (passed,) = (line for line in warnings_of(load_scene(CONFIGS / "oscillator.yaml", changes)) if "steps of" in line)
    assert "at 1.513 Hz is 0.00091 Hz wide" in passed


def test_steps_that_pass_over_a_resonance_of_a_harmonic_are_worth_a_warning():
    """Twice the excitation's frequency passes the resonance at 0.9 Hz, which the excitation itself stays below."""

    def warnings(harmonic: int) -> list[str]:
        force = {"point": "tip", "direction": [1, 0, 0], "amplitude": 1.0, "harmonic": harmonic}
        study = {"kind": "sweep", "frequency": {"from": 0.41, "to": 0.47, "step": 0.03}}
        changes = {"contacts": [], "excitation": {"forces": [force]}, "study": study}
        return list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", changes)))

    (passed,) = warnings(2)
    assert "a resonance of harmonic 2 as at 0.45 Hz is 0.018 Hz wide" in passed
    assert warnings(1) == []


def test_damping_given_in_percent_and_a_result_of_gigabytes_are_worth_a_warning():
    (warning,) = warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["structure.modes.1.damping_ratio=2"]))
    assert warning.startswith("structure: damping ratio 2 of mode 2 at 1.1 Hz")
    (warning,) = warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["structure.modes.1.damping_ratio=0.5"]))
    assert warning.endswith("that is 50 % of critical; 1 % is 0.01")
    assert list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["structure.modes.1.damping_ratio=0.1"]))) == []
    (warning,) = warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["contacts.pad.friction=50"]))
    assert warning == "contacts.pad.friction: 50 times the normal load; 30 % is 0.3"
    long = ["study.cycles=100000", "study.samples_per_cycle=200"]
    (warning,) = warnings_of(load_scene(CONFIGS / "oscillator.yaml", [*long, "study.record_last=100000"]))
    assert warning.startswith("study: 20000001 samples make a result of 2.9 GB")
    assert list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", [*long, "study.record_last=10"]))) == []
    (warning,) = warnings_of(load_scene(CONFIGS / "figure12.yaml", ["study.phases.0.cycles=200000"]))
    assert "a longer run_up or a smaller samples_per_cycle" in warning
    assert "record_last" not in warning


def test_a_sweep_that_takes_hours_is_worth_a_warning():
    assert list(warnings_of(load_scene(CONFIGS / "figure10.yaml"))) == []
    (warning,) = warnings_of(load_scene(CONFIGS / "figure10.yaml", ["study.frequency.step=2e-6"]))
    assert re.match(r"study: 3825009 points take about [\d.]+ (h|days) on one core: timesim check tells", warning)


def test_a_first_axis_out_of_the_plane_of_contact_is_worth_a_warning():
    slanted = "contacts.pad.tangent=[1, 0, 1]"
    (warning,) = warnings_of(load_scene(CONFIGS / "oscillator.yaml", [slanted]))
    so = "the first axis is its part in the plane of contact, (1, 0, 0)"
    assert warning == f"contacts.pad.tangent is not perpendicular to the normal: {so}"
    rounded = ["contacts.pad.normal=[0.7, 0, 0.714]", "contacts.pad.tangent=[-0.714, 0, 0.7]"]
    assert list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", rounded))) == []


def test_numbers_of_samples_that_make_no_sense_are_worth_a_warning():
    (warning,) = warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["study.samples_per_cycle=7"]))
    assert warning.startswith("study: 7 samples of a cycle show little of its motion")
    assert list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", ["study.samples_per_cycle=8"]))) == []
    for name in ("figure10", "bistable", "one_slider"):
        (warning,) = warnings_of(load_scene(CONFIGS / f"{name}.yaml", ["study.time_samples=500000"]))
        assert warning.startswith("study.time_samples: 500000 samples of a period")
        assert list(warnings_of(load_scene(CONFIGS / f"{name}.yaml", ["study.time_samples=65536"]))) == []


def test_explicit_steps_that_stability_does_not_allow_are_worth_a_warning():
    """Of rk4 because they are too long for the closed contact, of an adaptive method because they are too many."""

    def warnings(solver: str, *overrides: str) -> list[str]:
        return list(warnings_of(load_scene(CONFIGS / "oscillator.yaml", [f"solver={solver}", *overrides])))

    stiff = "contacts.pad.normal_stiffness=1e6"
    (warning,) = warnings("{method: rk4}", stiff)
    assert warning.startswith(
        "solver.steps_per_cycle: 200 steps are fewer than the 218 that stability asks for at 1.39 "
    )
    assert warnings("{method: rk4}") == warnings("{method: rk4, steps_per_cycle: 400}", stiff) == []
    (warning,) = warnings("{method: dopri8, rtol: 1e-4}", "contacts.pad.normal_stiffness=1e14")
    assert warning.startswith(
        "solver.max_steps: 100000 steps a cycle are fewer than the 2.18e+06 that stability asks for"
    )
    assert warnings("{method: dopri8, rtol: 1e-4}", stiff) == warnings("{method: exponential}", stiff) == []


def test_a_budget_that_leaves_no_time_for_fine_runs_is_worth_a_warning():
    """Of 60 cycles a run takes some 30 ms, of 100,000 close to a minute."""
    assert list(warnings_of(load_scene(CONFIGS / "tradeoff.yaml"))) == []
    (warning,) = warnings_of(load_scene(CONFIGS / "tradeoff.yaml", ["study.cycles=100000"]))
    assert warning.startswith("study.budget: 60 s are little for fine runs, which take about ")


def test_a_contact_that_rounding_spoils_is_worth_a_warning():
    """The share of eps k / (m w^2) summed over two modes of 0.9 and 1.1 Hz, against what each accuracy promises."""

    def warnings(stiffness: float, accuracy: str) -> list[str]:
        changes = [f"contacts.pad.normal_stiffness={stiffness}", f"solver={{accuracy: {accuracy}}}"]
        found = warnings_of(load_scene(CONFIGS / "oscillator.yaml", changes))
        return [warning for warning in found if warning.startswith("contacts.")]

    (warning,) = warnings(1e13, "reference")
    assert warning.startswith(
        "contacts.pad is very stiff: rounding leaves an error of about 6e-05, more than the 1e-08 "
    )
    keeps = float(warning.partition("up to about ")[2].split()[0])
    assert len(warnings(1.1 * keeps, "reference")) == 1
    assert warnings(0.9 * keeps, "reference") == warnings(1e13, "draft") == []


def test_a_stop_that_is_hardly_ever_met_is_worth_a_warning():
    """Beside a contact that acts it cannot be proven to stay apart, and costs what a contact costs."""

    def warnings(gap: float) -> list[str]:
        scene = load_scene(CONFIGS / "two_contacts.yaml", {"contacts.shroud.preload": -40 * gap})
        assert len(describe(scene)["contacts"]) == 2
        return list(warnings_of(scene))

    (warning,) = warnings(3000.0)
    assert warning.startswith("contacts.shroud is unlikely ever to touch: its gap of 3000 is ")
    assert warnings(20.0) == []


def test_sets_of_values_that_make_no_scene_are_worth_a_warning():
    """A contact without normal stiffness needs a preload: two of the six sets are refused."""
    over = {"contacts.pad.normal_stiffness": [0, 20], "contacts.pad.preload": [3, 0, -1]}
    study = {"kind": "sweep", "frequency": {"values": [0.9]}, "over": over}
    (warning,) = (
        line for line in warnings_of(load_scene(CONFIGS / "oscillator.yaml", {"study": study})) if "over" in line
    )
    assert warning.startswith("study.over: 2 of 6 sets of values make no scene, and get no motion: ")
    for preload in (0, -1):
        place = f"contacts.pad.normal_stiffness 0, contacts.pad.preload {preload}"
        assert f"{place}: contacts.pad.preload must be > 0 where normal_stiffness is 0" in warning
    study["over"] = over | {"contacts.pad.normal_stiffness": [20]}
    assert not [
        line for line in warnings_of(load_scene(CONFIGS / "oscillator.yaml", {"study": study})) if "over" in line
    ]


def test_natural_frequencies_with_contacts_absent_and_stuck():
    """Springs (2 pi)^2 along x and z; stuck, 10 and 20 are added to them."""
    lines = describe(load_scene(one_mass()))["structure"]
    stuck = np.sqrt((2 * np.pi) ** 2 + np.array([10.0, 20.0])) / (2 * np.pi)
    assert lines[1] == "natural frequencies without contacts: 1, 1 Hz"
    assert lines[2] == f"natural frequencies with every contact closed and stuck: {stuck[0]:.6g}, {stuck[1]:.6g} Hz"


def test_a_free_body_and_contacts_that_are_open_at_rest_are_told_apart():
    """Two free masses, one of which a pad holds along x; what rounding leaves of a frequency is shown as 0."""
    k = 1e7 / 3
    matrices = {"mass": [[1, 0], [0, 1.1]], "stiffness": [[k, -k], [-k, k]], "damping_ratio": 0.01}
    matrices["points"] = {"tip": {"x": 0}, "end": {"x": 1}}
    contact = {"point": "tip", "normal": [1, 0, 0], "friction": 0.0, "tangential_stiffness": 0, "preload": -2}
    body = one_mass(contact=contact) | {"structure": {"matrices": matrices}}
    stop = body["contacts"][0]
    lines = describe(load_scene(body))["structure"]
    assert lines[1].startswith("natural frequencies without contacts: 0 (rigid body), ")
    assert lines[2].startswith("natural frequencies with every contact closed and stuck: 0.49")
    pad = stop | {"name": "pad", "point": "end", "normal": [0, 0, 1], "friction": 0.3, "preload": 1}
    pad["tangential_stiffness"] = 5
    lines = describe(load_scene(body | {"contacts": [stop, pad]}))["structure"]
    assert lines[2].startswith("natural frequencies with what carries a preload stuck (pad): 0.24")
    across = stop | {"normal": [0, 0, 1]}
    lines = describe(load_scene(body | {"contacts": [across]}))["structure"]
    assert lines[2].startswith("natural frequencies with every contact closed and stuck: 0 (rigid body), ")


def test_check_says_how_little_of_the_damping_ratio_a_body_has_that_contacts_hold():
    """Two masses joined by a spring and, as the ratio is of the modes, by a dashpot: a contact holds one of them."""
    matrices = {"mass": [[1, 0], [0, 1]], "stiffness": [[8, -8], [-8, 8]], "damping_ratio": 0.01}
    matrices["points"] = {"tip": {"x": 0}, "end": {"x": 1}}
    body = one_mass(contact={"point": "tip", "tangential_stiffness": 10}) | {"structure": {"matrices": matrices}}
    square, shape = np.linalg.eigh(np.array([[18.0, -8], [-8, 8]]))
    ratio = 0.01 * 4 * (shape[0, 0] - shape[1, 0]) ** 2 / (2 * np.sqrt(square[0]))
    own = f"{np.sqrt(square[0]) / (2 * np.pi):.6g} Hz"
    less = f"of rigid-body motions none: of the mode at {own} with every contact stuck it is {ratio:.2g}"
    assert f"damping ratio 0.01, {less}" in describe(load_scene(body))["structure"]
    held = matrices | {"stiffness": [[9, -8], [-8, 9]]}
    assert "damping ratio 0.01" in describe(load_scene(body | {"structure": {"matrices": held}}))["structure"]


def test_check_estimates_the_cost_of_each_phase():
    def said(name: str, *overrides: str) -> tuple[str, ...]:
        return describe(load_scene(CONFIGS / f"{name}.yaml", overrides)).get("cost", ())

    # 75 + 4.9 x 2.19 steps for stability, of 1.7 + 0.65 times the root of 2 modes x 1 contact µs each.
    (run, source) = said("oscillator")
    assert run == "about 60 cycles of 225 µs: 13 ms"
    assert "one core" in source
    assert said("oscillator", "study.cycles=10000000")[0] == "about 10000000 cycles of 225 µs: 37 min"
    assert said("oscillator", "study.cycles=1000000000")[0].endswith(": 2.6 days")
    sweep, balance, _ = said("figure10")
    assert sweep.startswith("about 774 points of ")
    assert sweep.endswith(" beside them (52 s in all if none settles in settle.max_cycles = 800): 15 s")
    # 7 ms, 2.5 for multipliers in 5 states, and 0.2 for 93 unknowns, of 256 samples; 0.8 of the first two go with them.
    assert balance == "about 9 curves of harmonic balance of 200 solutions of 9.7 ms: 18 s"
    assert "of 33 ms: 59 s" in said("figure10", "study.time_samples=1024")[1]
    auto = next(line for line in said("figure10", "study.harmonics=auto") if "9 curves" in line)
    assert auto.endswith(": 17 s, or up to 2500 if it takes many harmonics")
    assert said("figure10", "study.start=both_ends")[1].startswith("about 18 curves of")
    assert said("preload")[0].endswith(", and some 19 values more in the search for the least")
    assert said("two_contacts")[0].endswith(", and the search for jumps")
    assert said("two_contacts", "study.refine=null")[0].endswith(" s")
    assert said("figure7") == ()
    assert said("tradeoff")[0].endswith("ms a run at reference, of 60 s for all runs and their compilation")


def test_check_names_the_quicker_way_where_vibrations_decay_slowly():
    """A mode of 1 % at 0.9 Hz takes some 500 cycles of 1.4 Hz to a part in 1e8; one of 10 % a tenth of it."""

    def said(ratio: float, *overrides: str) -> str:
        study = "study={kind: sweep, frequency: {from: 1, to: 1.4, step: 0.001}}"
        damped = [f"structure.modes.{mode}.damping_ratio={ratio}" for mode in (0, 1)]
        return " ".join(describe(load_scene(CONFIGS / "oscillator.yaml", [study, *damped, *overrides]))["cost"])

    assert "about 16 cycles a point, Newton's method and" in said(0.01)
    assert "with study.periodic: shoot, as vibrations decay slowly" in said(0.01)
    assert "shoot" not in said(0.1)
    assert "shoot" not in said(0.01, "study.periodic=shoot")
    assert "shoot" not in said(0.01, "study.frequency.step=0.1")


def test_cycles_with_their_derivatives_take_far_longer():
    """With 12 modes and 2 contacts as long as some twenty others: Newton's method is quicker, but not free."""
    scene = load_scene(CONFIGS / "blade_response.yaml")
    model, solver = scene.model(), scene.solver()
    marched = seconds_a_cycle(model, solver, 725.0, marched=True)
    assert 20 < (seconds_a_derivative(model, solver, 725.0) - 0.002) / marched < 25
    assert "of 256 cycles of" in describe(scene)["cost"][0]
    eight = 9 * seconds_a_derivative(model, solver, 725.0) + 0.002
    assert f"and {1e3 * eight:.0f} ms beside them" in describe(scene)["cost"][0]


def test_cycles_to_settle_are_those_of_the_slowest_decay():
    model = load_scene(CONFIGS / "oscillator.yaml").model()
    decay = np.exp(-2 * np.pi * 0.02 * 0.9 / 1.35)  # of the first mode over a cycle at 1.35 Hz
    needed = cycles_to_settle(model, Criterion(1e-8, 2000), 1.35)
    assert decay**needed <= 1e-8 < decay ** (needed - 1)
    assert cycles_to_settle(model, Criterion(1e-8, 100), 1.35) == 100
    assert cycles_to_settle(model, Criterion(1e-8, 2000, SHOOT), 1.35) == 24
    undamped = load_scene(CONFIGS / "oscillator.yaml", ["structure.modes.0.damping_ratio=0"]).model()
    assert cycles_to_settle(undamped, Criterion(1e-8, 2000, NEVER), 1.35) == 2000
    assert cycles_to_settle(undamped, Criterion(1e-8, 2000), 1.35) == SLOW + 8


def test_nothing_moves_is_worth_a_warning():
    assert any("nothing will move" in warning for warning in warnings_of(load_scene(one_mass())))


def test_a_force_that_acts_on_nothing_is_worth_a_warning():
    forces = [{"point": "m", "direction": axis, "amplitude": 1} for axis in ([1, 0, 0], [0, 2, 0])]
    excitation = {"forces": forces, "constant_forces": [forces[1]]}
    assert list(warnings_of(load_scene(one_mass(excitation=excitation)))) == [
        f"excitation.{key} has no effect: no mode moves m along its direction"
        for key in ("forces.1", "constant_forces.0")
    ]
    forces[1]["amplitude"] = 0
    assert list(warnings_of(load_scene(one_mass(excitation=excitation)))) == []


def test_check_loads_no_jax():
    code = (
        "import sys; from timesim.study.registry import load_scene; from timesim.scene.report import describe;"
        f"describe(load_scene({str(CONFIGS / 'oscillator.yaml')!r}));"
        "heavy = ('jax', 'diffrax', 'equinox', 'xarray', 'matplotlib');"
        "print([name for name in sys.modules if name.split('.')[0] in heavy])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_json_schema_knows_the_keys():
    schema = json.loads(json.dumps(json_schema()))
    assert set(schema["properties"]) == {*parse(BASE)[0], "units"}
    contact = schema["$defs"]["ContactSection"]
    assert not contact["additionalProperties"]
    assert contact["properties"]["normal_stiffness"]["minimum"] == 0
    assert "from" in schema["$defs"]["InitialResult"]["properties"]
    assert "null" not in json.dumps(schema)
    assert schema["$defs"]["ExcitationSection"]["properties"]["frequency"]["exclusiveMinimum"] == 0
    assert schema["$defs"]["Range"]["properties"]["num"].items() >= {"minimum": 2, "maximum": 10_000}.items()


# Whatever is written


SCALARS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20))
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=8), inner, max_size=3)),
    max_leaves=8,
)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.dictionaries(st.text(max_size=12), VALUES, max_size=4))
def test_written_yaml_reads_back(data: dict[str, Any]):
    data = json.loads(json.dumps(data).replace("\\ud", "\\u0d"))
    read, _ = parse(yaml_text(data) or "{}")
    assert repr(read) == repr(data)


def leaves(data: Any, key: tuple[str, ...] = ()) -> list[str]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    below = [name for part, value in items for name in leaves(value, (*key, str(part)))]
    return [".".join(key), *below] if key else below


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.sampled_from(leaves(parse(BASE)[0]) + leaves(parse(MATRICES)[0])),
    VALUES,
    st.sampled_from([BASE, MATRICES]),
)
def test_any_value_at_any_key_is_accepted_or_refused_by_name(key: str, value: Any, base: str):
    refused: list[Any] = []
    try:
        load_scene(base, {key: value})
    except SceneError as error:
        refused = error.problems
    assert all(problem.rule and "\n" not in str(problem) for problem in refused)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.text(alphabet="ab:-[]{}&*!|>'\"# \n\t%,?1.e", max_size=60))
def test_any_text_is_read_or_refused(text: str):
    data = None
    with contextlib.suppress(RuleError):
        data = {"document": parse(text)[0]}
    assert data is None or parse(yaml_text(data))[0] == data


def test_the_width_of_a_search_for_ends_is_no_more_than_a_step_by_default():
    """Of a narrow range the step, a fortieth of it, is smaller than the usual width; what is given must be, too."""
    ends = {"kind": "bistable", "harmonics": 0, "frequency": {"from": 0.9470, "to": 0.9473}}
    scene = one_mass() | {"study": ends}
    study = load_scene(scene).file.study
    assert study.width == study.step == pytest.approx(0.0003 / 40)
    assert load_scene(one_mass() | {"study": ends | {"frequency": {"from": 0.9, "to": 1}}}).plan.sweep.refine == 1e-5
    rule = r"study\.width: 1e-05: must be at most the step of the sweeps, 7\.5e-06 Hz"
    with pytest.raises(SceneError, match=rule) as caught:
        load_scene(scene | {"study": ends | {"width": 1e-5}})
    assert "study.step is by default a fortieth of the range: give 1e-05 or more" in str(caught.value)
