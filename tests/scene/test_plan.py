"""What a scene hands to its study: frozen plans in numbers, and variants of its model."""

import dataclasses
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from bad_scenes import BASE, BISTABLE, ELEMENT, ELEMENT_MAP, HBM, JUMP, MATRICES, OPTIMUM, SWEEP, TRADEOFF

from timesim.fault import SceneError
from timesim.model.model import Model
from timesim.scene.resolution import Scene
from timesim.study.registry import load_scene

PRELOAD, FRICTION, STIFFNESS = (f"contacts.pad.{key}" for key in ("preload", "friction", "normal_stiffness"))


@pytest.mark.parametrize("text", [BASE, JUMP, ELEMENT, ELEMENT_MAP, HBM, BISTABLE, OPTIMUM, SWEEP, TRADEOFF])
def test_plans_are_frozen_and_hold_no_sections(text: str):
    plan = load_scene(text).plan
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(plan, dataclasses.fields(plan)[0].name, None)
    assert not [part for part in parts(plan) if "timesim.scene" in type(part).__module__ and not frozen(part)]


def parts(value: Any) -> Iterator[Any]:
    yield value
    inner = vars(value).values() if frozen(value) else value.values() if isinstance(value, Mapping) else ()
    for item in value if isinstance(value, tuple) else inner:
        yield from parts(item)


def frozen(value: Any) -> bool:
    return dataclasses.is_dataclass(value) and type(value).__dataclass_params__.frozen


def test_a_run_and_a_schedule_are_one_plan():
    run, schedule = load_scene(BASE).plan, load_scene(JUMP).plan
    assert (run.phases, run.run_up, run.first, run.samples_per_cycle) == (((1.39, 60),), 0, 50, 100)
    assert (schedule.phases, schedule.run_up, schedule.first) == (((0.8, 9), (0.9, 5), (0.95, 7)), 1, 9)
    assert schedule.edges()[1] == 0
    assert np.array_equal(schedule.cycle_frequency(), np.repeat([0.8, 0.9, 0.95], [9, 5, 7]))
    assert schedule.sample_times().size == 12 * 100 + 1


def test_the_parts_of_a_study_are_plans_of_their_own():
    bistable = load_scene(BISTABLE).plan
    assert bistable.sweep.directions == ("up", "down")
    assert bistable.sweep.frequency[[0, -1]] == pytest.approx([1.24, 1.27], abs=0)
    assert bistable.sweep.refine == bistable.width == 1e-4
    assert bistable.balance.both_ends
    assert bistable.balance.over == bistable.sweep.over == {PRELOAD: (1.0, 2.0)}
    assert load_scene(BISTABLE, ["study.harmonics=0"]).plan.balance is None
    compare = load_scene(SWEEP, {"study.kind": "compare", "study.harmonics": 5}).plan
    assert compare.balance.span == (0.9, pytest.approx(1.1))
    assert compare.balance.over == compare.sweep.over


def test_what_a_section_leaves_out_keeps_the_defaults_of_its_study():
    slow = load_scene(BISTABLE, {"study.settle": {"tolerance": 1e-9}})
    assert slow.plan.sweep.criterion.max_cycles == 5000
    assert slow.plan.sweep.criterion.tolerance == 1e-9
    assert "max_cycles: 5000" in slow.resolved_yaml()
    assert load_scene(SWEEP, {"study.settle": {"tolerance": 1e-9}}).plan.criterion.max_cycles == 2000


# Variants


def test_a_variant_is_the_scene_with_these_values():
    values = {PRELOAD: 1.5, "structure.modes.1.mass": 3.0, "excitation.forces.0.amplitude": -2.0}
    scene = load_scene(BASE, {"initial": "static"})
    varied, written = scene.variant(values), scene.with_overrides(values).model()
    assert same(varied, written)
    assert not same(varied, scene.model())
    assert scene.variant({}) is scene.model()
    with pytest.raises(SceneError, match=r"contacts\.pad\.friction: -1\.0: must be >= 0"):
        scene.variant({FRICTION: -1.0})
    with pytest.raises(SceneError, match="structure: is required for a model"):
        load_scene(ELEMENT).variant({FRICTION: 0.1})


def same(one: Model, other: Model) -> bool:
    return all(
        np.array_equal(getattr(a, field.name), getattr(b, field.name))
        for a, b in zip(model_parts(one), model_parts(other), strict=True)
        for field in dataclasses.fields(a)
    )


def model_parts(model: Model) -> tuple[Any, ...]:
    return (model.structure, *model.contacts, model.excitation, model.start)


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the eigenproblems that are solved."""
    sizes: list[int] = []
    eigh = scipy.linalg.eigh

    def counted(stiffness: np.ndarray, *arguments: Any) -> Any:
        sizes.append(len(stiffness))
        return eigh(stiffness, *arguments)

    monkeypatch.setattr(scipy.linalg, "eigh", counted)
    return sizes


CONTACT = {
    "name": "pad", "point": "m1", "friction": 0.5, "tangential_stiffness": 2.0, "normal_stiffness": 2.0, "preload": 1.0,
}  # fmt: skip


def of_matrices(over: Mapping[str, Any]) -> Scene:
    study = {"kind": "sweep", "frequency": {"values": [0.2]}, "over": over}
    return load_scene(MATRICES, {"contacts": [CONTACT], "excitation.frequency": None, "study": study})


def test_the_eigenproblem_is_solved_once_for_all_values(solved: list[int]):
    values = np.linspace(1.0, 3.0, 40).tolist()
    scene = of_matrices({PRELOAD: values, FRICTION: {"from": 0.1, "to": 0.5, "num": 50}})
    for value in values:
        assert scene.variant({PRELOAD: value}).contacts[0].preload == value
    assert solved == [2]


def test_the_eigenproblem_is_solved_for_each_value_of_the_structure(solved: list[int]):
    scene = of_matrices({"structure.matrices.stiffness.0.0": [2.0, 3.0], PRELOAD: [1.0, 2.0]})
    solved.clear()
    frequencies = [scene.variant({"structure.matrices.stiffness.0.0": k}).structure.frequency[0] for k in (2.0, 3.0)]
    assert solved == [2, 2]
    assert frequencies[0] < frequencies[1]


def test_a_result_is_read_once_for_all_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from timesim.result.state import SavedStates
    from timesim.scene import integration

    reads = []
    end = SavedStates(
        ("pad",),
        {"final_modal_displacement": np.zeros(2), "final_modal_velocity": np.zeros(2),
         "final_slip": np.zeros((1, 2)), "final_contact_state": np.zeros(1)},
        {},
        0.0,
    )  # fmt: skip
    monkeypatch.setattr(integration, "saved_states", lambda path: reads.append(path) or end)
    study = {"kind": "sweep", "frequency": {"values": [0.2]}, "over": {PRELOAD: [1.0, 2.0, 3.0]}}
    given = {"contacts": [CONTACT], "excitation.frequency": None, "study": study, "initial": {"from": "result.nc"}}
    scene = load_scene(MATRICES, given)
    assert scene.variant({PRELOAD: 2.0}).start.state.tolist() == [0]
    assert len(reads) == 1


# Combinations


def test_values_that_are_only_good_together_are_accepted():
    over = {STIFFNESS: [0.0], PRELOAD: [3.0]}
    scene = load_scene(SWEEP, {"contacts.pad.preload": -1.0, "study.over": over})
    assert scene.plan.over == {STIFFNESS: (0.0,), PRELOAD: (3.0,)}


def test_a_sweep_keeps_what_can_be_computed_and_refuses_what_never_can():
    over = {STIFFNESS: [0.0, 20.0], PRELOAD: [3.0, -1.0]}
    assert load_scene(SWEEP, {"study.over": over}).plan.over[PRELOAD] == (3.0, -1.0)
    with pytest.raises(SceneError, match=f"study.over: cannot hold {STIFFNESS} = 0, {PRELOAD} = -1 together"):
        load_scene(SWEEP, {"study.over": over, "study.kind": "compare", "study.harmonics": 5})
    with pytest.raises(SceneError, match=rf"study.over.{STIFFNESS}: 0\.0: {PRELOAD} must be > 0 where"):
        load_scene(SWEEP, {"contacts.pad.preload": -1.0, "study.over": {STIFFNESS: [0.0, 20.0]}})


def test_a_value_that_is_wrong_alone_is_named_alone():
    with pytest.raises(SceneError) as caught:
        load_scene(SWEEP, {"study.over": {PRELOAD: [1.0, 2.0], FRICTION: [0.5, -0.5]}})
    (problem,) = caught.value.problems
    assert (problem.key, problem.value, problem.rule) == (f"study.over.{FRICTION}", "-0.5", "must be >= 0")


def test_half_of_a_range_is_at_most_half_of_it_however_it_is_rounded():
    """1.4 - 1.3 is less than twice 0.05."""
    half = {"study.frequency": {"from": 1.3, "to": 1.4}, "study.step": 0.05}
    assert load_scene(BISTABLE, half).plan.sweep.frequency.tolist() == pytest.approx([1.3, 1.35, 1.4])
    least = {f"study.along.{PRELOAD}": {"from": 1.3, "to": 1.4, "num": 3}, "study.accuracy": 0.05}
    assert load_scene(OPTIMUM, least).plan.accuracy == 0.05


def test_resolved_scenes_write_the_defaults_that_depend_on_other_keys():
    written = {kind: load_scene(text, {f"study.{key}": None for key in keys}).resolved_yaml() for kind, text, keys in (
        ("transient", BASE, ("record_last",)),
        ("bistable", BISTABLE, ("step",)),
        ("optimum", OPTIMUM, ("accuracy",)),
        ("hbm", HBM, ("continuation",)),
    )}  # fmt: skip
    assert "record_last: 60" in written["transient"]
    assert f"step: {(1.27 - 1.24) / 40}" in written["bistable"]
    assert "accuracy: 0.004" in written["optimum"]
    wide = {"study.along": {PRELOAD: {"from": 1, "to": 60, "num": 6}}, "study.accuracy": None}
    assert "accuracy: 0.059\n" in load_scene(OPTIMUM, wide).resolved_yaml()
    assert "first_step: 0.01" in written["hbm"]
    for text in written.values():
        assert load_scene(text).resolved_yaml() == text


def test_paths_are_written_from_the_root(tmp_path: Path):
    np.savetxt(tmp_path / "cycle.csv", np.sin(2 * np.pi * np.arange(64) / 64), header="u1", comments="")
    (tmp_path / "scene.yaml").write_text(
        ELEMENT.replace("  A: 1.0\n  B: 0.5\n  phi_deg: 90\n", "  motion: cycle.csv\n")
    )
    written = load_scene(tmp_path / "scene.yaml").resolved_yaml()
    assert f'motion: "{tmp_path / "cycle.csv"}"' in written
    assert load_scene(written).resolved_yaml() == written


def test_schema_knows_the_keys_of_every_study():
    from timesim.study.registry import STUDIES, json_schema

    schema = json.loads(json.dumps(json_schema()))
    kinds = {
        part["properties"]["kind"]["const"] for part in schema["$defs"].values() if "kind" in part.get("properties", {})
    }
    assert kinds == set(STUDIES)
