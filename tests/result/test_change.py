"""Whatever changes in a scene shows: in its resolved text, in the fingerprint of the work, in what `--resume` refuses.

Scenes of all kinds of study name every key that a scene file may have; each value is changed by itself.
"""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import timesim
from timesim.result.change import fingerprint
from timesim.result.checkpoint import Manifest
from timesim.result.netcdf import save
from timesim.scene.section import Section
from timesim.study.execution.campaign import Execution
from timesim.study.registry import carry_out, load_scene

pytestmark = pytest.mark.long

Key = tuple[str | int, ...]

MODES = [
    {
        "frequency": 0.9,
        "damping_ratio": 0.02,
        "mass": 1.5,
        "shape": {"tip": [1, 1, 0.8], "side": [0.5, 0.1, 0.2], "back": [0, 0, 1]},
    },
    {
        "frequency": 1.1,
        "damping_ratio": 0.03,
        "mass": 0.5,
        "shape": {"tip": [1, -1, 0.6], "side": [0.3, -0.2, 0.4], "back": [0, 1, 0]},
    },
]
# So tight that it only sticks: what has to be run for a result is linear.
PAD = {
    "name": "pad",
    "point": "tip",
    "friction": 0.5,
    "tangential_stiffness": 20,
    "normal_stiffness": 20,
    "preload": 900,
}
LINEAR: dict[str, Any] = {
    "structure": {"modes": MODES},
    "contacts": [PAD],
    "excitation": {"modal_force": [{"amplitude": 1}, {"amplitude": 1}]},
}
RICH: dict[str, Any] = {
    "title": "every key",
    "units": {"length": "mm", "force": "N"},
    "structure": {"modes": MODES},
    "contacts": [
        PAD | {"preload": 3, "against": "side", "normal": [0, 0.1, 1], "tangent": [1, 0.2, 0]},
        PAD | {"name": "stop", "point": "side", "against": "ground", "tangential_stiffness": [20.0, 10.0]},
        PAD | {"name": "third", "tangential_stiffness": [[20.0, 1.0], [1.0, 10.0]], "law": {"name": "cone"}},
    ],
    "excitation": {
        "frequency": 1.2,
        "modal_force": [{"amplitude": 1.0, "phase_deg": 10.0}, {"amplitude": 0.5, "phase_deg": 20.0}],
        "forces": [{"point": "tip", "direction": [1, 0, 0.5], "amplitude": 0.3, "phase_deg": 5.0, "harmonic": 2}],
        "constant_forces": [{"point": "side", "direction": [0, 0, 1], "amplitude": 0.1}],
    },
    "initial": {
        "modal_displacement": [1e-3, 2e-3],
        "modal_velocity": [0.1, -0.1],
        "slip": {"pad": [1e-3, 2e-3], "stop": [0.0, 1e-3]},
    },
    "solver": {"accuracy": "draft", "reduce": False, "estimate_error": False, "max_steps": 5000},
}
MASS = [[2.0, 0.1, 0.0], [0.1, 1.0, 0.2], [0.0, 0.2, 1.5]]
STIFFNESS = [[50.0, -4.0, 1.0], [-4.0, 60.0, 2.0], [1.0, 2.0, 90.0]]
DAMPING = [[0.2, 0.01, 0.0], [0.01, 0.3, 0.0], [0.0, 0.0, 0.1]]
POINTS = {"tip": {"x": 0, "y": 1}, "side": {"z": 1, "x": 0}, "back": {"y": 0}}
INLINE = {"mass": MASS, "stiffness": STIFFNESS, "points": POINTS}
SETTLE = {"tolerance": 1e-6, "max_cycles": 300}
OVER = {"contacts.pad.preload": [1.0, 2.0], "contacts.pad.friction": {"from": 0.2, "to": 0.4, "num": 3}}
ONE = {"contacts.pad.preload": [900.0]}
BALANCE = {
    "harmonics": 5,
    "time_samples": 64,
    "stability": False,
    "convergence": True,
    "continuation": {"first_step": 0.01, "min_step": 1e-5, "max_step": 0.04, "max_points": 50, "tolerance": 1e-8},
}
SPACED = {"from": 0.8, "to": 1.6, "step": 0.1}
SWEEP = {"frequency": SPACED, "direction": "up", "settle": SETTLE, "periodic": "march", "refine": 1e-3}


def scenes(folder: Path) -> dict[str, dict[str, Any]]:
    """A scene of each kind of study, of each kind of structure, start and solver."""
    result, other = str(folder / "sweep.nc"), str(folder / "again.nc")
    assert Path(other).exists()
    run = str(folder / "run.nc")
    matrices = {"structure": {"matrices": INLINE | {"damping": DAMPING}, "keep_modes": 1}}
    by_file = {"file": str(folder / "a.npz"), "damping_ratio": [0.01, 0.02], "points": POINTS, "keep_modes": 2}
    files = {name: str(folder / f"{name}.mtx") for name in ("mass", "stiffness", "damping")}
    held = {"from": result, "at": {"frequency": 0.9, "direction": "up"}}
    rk4 = {"solver": {"method": "rk4", "steps_per_cycle": 250, "reduce": True, "max_steps": 900}}
    own = {"solver": {"method": "dopri5", "rtol": 1e-6, "atol": 1e-8, "reduce": True, "max_steps": 900}}
    plain = {key: value for key, value in RICH.items() if key != "initial"}
    alone = {"contacts": [PAD | {"preload": 3}, PAD | {"name": "other", "preload": 2}]}
    forces = {"excitation": {"forces": RICH["excitation"]["forces"]}}
    pad = {"contacts": [PAD | {"preload": 3, "tangent": [1, 0.2, 0]}]}
    phases = [{"frequency": 1.2, "cycles": 4}, {"frequency": 1.3, "cycles": 5}]
    return {
        "transient": RICH | {"study": {"kind": "transient", "cycles": 6, "samples_per_cycle": 20, "record_last": 2}},
        "tradeoff": RICH
        | {"study": {"kind": "tradeoff", "cycles": 6, "error": 1e-4, "budget": 5.0, "amplitude": True}},
        "jump": LINEAR
        | own
        | {"initial": held}
        | {"study": {"kind": "jump", "phases": phases, "run_up": phases[:1], "samples_per_cycle": 20}},
        "sweep": plain | matrices | rk4 | forces | pad | {"study": {"kind": "sweep", "over": OVER} | SWEEP},
        "listed": RICH
        | {"structure": by_file}
        | {"study": {"kind": "sweep", "frequency": {"values": [1.0, 1.1]}, "direction": "independent"}},
        "static": LINEAR
        | forces
        | {"structure": {"file": files, "damping_ratio": 0.02, "points": POINTS, "keep_modes": 2}, "initial": "static"}
        | {"study": {"kind": "sweep", "frequency": {"values": [1.0, 1.1]}}},
        "hbm": LINEAR
        | {"study": BALANCE | {"kind": "hbm", "frequency": {"from": 0.8, "to": 1.2}, "start": held, "over": ONE}},
        "along": RICH
        | {"structure": {"matrices": INLINE | {"damping_ratio": 0.02}, "keep_modes": 2}}
        | {"study": {"kind": "hbm", "frequency": 1.2, "along": {"contacts.pad.preload": {"from": 1.0, "to": 2.0}}}},
        "compare": plain | {"study": {"kind": "compare", "over": OVER, "start": "linear"} | SWEEP | BALANCE},
        "bistable": plain
        | {
            "study": {
                "kind": "bistable",
                "frequency": {"from": 0.9, "to": 1.2},
                "width": 1e-4,
                "step": 0.02,
                "over": OVER,
                "settle": SETTLE,
                "periodic": "shoot",
                "starts": 5,
                "harmonics": 3,
                "time_samples": 64,
            }
        },
        "optimum": plain
        | {
            "study": {
                "kind": "optimum",
                "along": {"contacts.pad.preload": {"from": 1.0, "to": 3.0, "num": 4}},
                "frequency": {"from": 0.8, "to": 1.6, "num": 9},
                "accuracy": 0.1,
                "point": "tip",
                "axis": "x",
                "settle": SETTLE,
                "periodic": "march",
            }
        },
        "element": alone
        | {
            "study": {
                "kind": "element",
                "contact": "pad",
                "A": 0.5,
                "B": 0.2,
                "phi_deg": 20.0,
                "D": 0.1,
                "psi_deg": 30.0,
                "harmonics": 3,
                "principal_axes": True,
                "samples": 72,
                "cross_check": False,
            }
        },
        "motion": {"contacts": [PAD]}
        | {"study": {"kind": "element", "motion": {"from": run, "point": "tip", "against": "side"}}},
        "file": {"contacts": [PAD], "study": {"kind": "element", "motion": str(folder / "u.csv")}},
        "element_map": alone
        | {
            "study": {
                "kind": "element_map",
                "contact": "pad",
                "A": {"from": 0.1, "to": 0.5, "num": 3},
                "B": [0.1, 0.2],
                "phi_deg": 80.0,
                "D": 0.1,
                "psi_deg": 10.0,
                "friction": 0.4,
                "normal_stiffness": 15.0,
                "preload": 2.5,
            }
        },
    }


KINDS = (
    "transient", "tradeoff", "jump", "sweep", "listed", "static", "hbm", "along", "compare", "bistable", "optimum",
    "element", "motion", "file", "element_map",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that the scenes read, each twice: another path is another scene."""
    from scipy.io import mmwrite

    made = tmp_path_factory.mktemp("files")
    study = {"kind": "sweep", "frequency": {"values": [0.9, 1.0]}, "direction": "both"}
    for name in ("sweep", "again"):
        save(timesim.run(LINEAR | {"study": study}), made / f"{name}.nc")
    once = {"excitation": LINEAR["excitation"] | {"frequency": 0.9}}
    for name in ("run", "rerun"):
        # The motion at an end of the cycle closes: the start of a run of the sweep's own state.
        begun = {"initial": {"from": str(made / "sweep.nc"), "at": {"frequency": 0.9, "direction": "up"}}}
        transient = {"kind": "transient", "cycles": 1, "samples_per_cycle": 64}
        save(timesim.run(LINEAR | once | begun | {"study": transient}), made / f"{name}.nc")
    for name in ("a", "b"):
        np.savez(made / f"{name}.npz", mass=MASS, stiffness=STIFFNESS)
    for name, matrix in (("mass", MASS), ("stiffness", STIFFNESS), ("damping", DAMPING)):
        mmwrite(made / f"{name}.mtx", np.array(matrix))
        mmwrite(made / f"{name}2.mtx", np.array(matrix))
    angle = 2 * np.pi * np.arange(64) / 64
    for name in ("u", "w"):
        np.savetxt(made / f"{name}.csv", np.c_[np.sin(angle)], header="u1", comments="", delimiter=",")
    return made


def leaves(data: Any, key: Key = ()) -> Iterator[Key]:
    """Key path of every value."""
    if isinstance(data, dict | list):
        for part, item in data.items() if isinstance(data, dict) else enumerate(data):
            yield from leaves(item, (*key, part))
    else:
        yield key


def at(data: Any, key: Key) -> Any:
    for part in key:
        data = data[part]
    return data


WORDS = (
    "another title", "tip", "side", "back", "ground", "down", "up", "march", "shoot", "reference", "dopri8",
    "tsit5", "both_ends", "y", "other", "pad", "renamed", "rest",
)  # fmt: skip
PATHS = {"sweep.nc": "again.nc", "run.nc": "rerun.nc", "a.npz": "b.npz", ".mtx": "2.mtx", "u.csv": "w.csv"}


def others(value: Any) -> list[Any]:
    """Values of the same type, near first."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int):
        return [value + step for step in (1, -1, 2, 4, 16)]
    if isinstance(value, float):
        return [
            other for other in (value * 1.01, value + 0.01, value * 0.99, value - 0.1, value + 0.1) if other != value
        ]
    moved = [value.replace(old, new) for old, new in PATHS.items() if value.endswith(old)]
    return moved or [word for word in WORDS if word != value]


def changed(scene: dict[str, Any], key: Key, value: Any) -> dict[str, Any]:
    """The scene with another value; a matrix stays symmetric."""
    other = deepcopy(scene)
    at(other, key[:-1])[key[-1]] = value
    if len(key) > 2 and all(isinstance(part, int) for part in key[-2:]):
        at(other, key[:-2])[key[-1]][key[-2]] = value
    return other


def named(scene: dict[str, Any], key: Key) -> str:
    """Key path as messages write it: items of a list by name, those of a list of numbers not at all."""
    parts: list[str] = []
    for depth, part in enumerate(key):
        item = at(scene, key[: depth + 1])
        if isinstance(part, int) and not isinstance(item, dict):
            break
        parts.append(str(item.get("name", part)) if isinstance(part, int) else part)
    return ".".join(parts)


# What no other value by itself makes a scene of: a choice that other keys go with, a name that other parts use, and
# the law, since all contacts obey one.
FIXED: set[Key] = {
    ("study", "kind"),
    ("contacts", 0, "name"),
    ("contacts", 1, "name"),
    ("contacts", 2, "law", "name"),
}
TOGETHER: dict[str, set[Key]] = {
    "sweep": {("solver", "method")},
    "listed": {("structure", "keep_modes")},
    "along": {("structure", "keep_modes")},
}


# Of scenes of which others have the rest too: what only they have. Reading a text of all that a scene holds is slow.
ONLY = (
    dict.fromkeys(("tradeoff", "hbm", "compare", "bistable", "optimum", "motion", "file", "element_map"), ("study",))
    | dict.fromkeys(("listed", "along"), ("structure", "study"))
    | {"static": ("structure", "initial"), "jump": ("initial", "solver", "study")}
)


@pytest.mark.parametrize("name", KINDS)
def test_every_value_shows_in_the_resolved_scene(name: str, folder: Path):
    given = scenes(folder)[name]
    before = load_scene(given).resolved_yaml()
    assert load_scene(deepcopy(given)).resolved_yaml() == before
    unchanged = []
    for key in (key for key in leaves(given) if key[0] in ONLY.get(name, given)):
        for value in others(at(given, key)):
            try:
                now = load_scene(changed(given, key, value)).resolved_yaml()
            except timesim.SceneError:
                continue
            assert now != before, key
            said = Manifest(before, {}).change(Manifest(now, {}))
            assert said is not None
            # A name tells the items of a list apart: another one is another item.
            assert f"{named(given, key)} was" in said or key[-1] == "name", (key, said)
            break
        else:
            unchanged.append(key)
    assert set(unchanged) <= FIXED | TOGETHER.get(name, set())


def test_the_scenes_name_every_key(folder: Path):
    """Another key of the scene file is to be added to the scenes above."""
    seen: set[tuple[str, str]] = set()

    def look(part: Any) -> None:
        if isinstance(part, Section):
            seen.update((type(part).__name__, key) for key in part.model_fields_set)
            for key in type(part).model_fields:
                look(getattr(part, key))
        elif isinstance(part, dict | tuple | list):
            for item in part.values() if isinstance(part, dict) else part:
                look(item)

    def kinds(section: type[Section]) -> Iterator[type[Section]]:
        below = section.__subclasses__()
        yield from (kind for item in below for kind in kinds(item))
        if not below:
            yield section

    for name in KINDS:
        look(load_scene(scenes(folder)[name]).file)
    # Those of `timesim` alone: other tests may make sections of their own.
    every = {
        (kind.__name__, key) for kind in kinds(Section) for key in kind.model_fields if "timesim" in kind.__module__
    }
    # The law of the cone is never written out; `tests/scene/test_law.py` has another.
    assert every - seen == {("LawSection", "name")}


# --- the work of chunks ---------------------------------------------------------------------------------


class _CapturedError(Exception):
    """The chunks of a study, when they are about to be worked on."""


def payload(monkeypatch: pytest.MonkeyPatch, scene: dict[str, Any]) -> list[Any]:
    """The first payload of each type that a study in chunks makes."""
    kind = scene["study"]["kind"]
    module = import_module(f"timesim.study.{kind}{'.search' * (kind == 'optimum')}")

    def capture(chunks: Any, *args: Any, **kwargs: Any) -> None:
        raise _CapturedError({type(chunk.payload): chunk.payload for chunk in reversed(chunks)})

    monkeypatch.setattr(module, "carry_through", capture)
    with pytest.raises(_CapturedError) as caught:
        carry_out(load_scene(scene), Execution(notice=lambda text: None))
    return list(caught.value.args[0].values())


def variations(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """The data with each of its parts changed by itself."""
    if is_dataclass(data) and not isinstance(data, type):
        for item in fields(data):
            for name, part in variations(getattr(data, item.name), f"{path}.{item.name}"):
                yield name, _with(data, item.name, part)
    elif isinstance(data, np.ndarray):
        for index in np.ndindex(data.shape):
            other = data.copy()
            other[index] = other[index] + 1 if data.dtype.kind in "iu" else np.nextafter(other[index], 9e9)
            yield f"{path}{list(index)}", other
        yield f"{path} reshaped", data[..., None]
    elif isinstance(data, tuple):
        for i, item in enumerate(data):
            yield from ((name, (*data[:i], part, *data[i + 1 :])) for name, part in variations(item, f"{path}.{i}"))
        if data:
            yield f"{path} shorter", data[:-1]
    elif isinstance(data, bool):
        yield path, not data
    elif isinstance(data, int | float):
        yield path, data + 1 if isinstance(data, int) else np.nextafter(data, 9e9).item()
    elif isinstance(data, str) or data is None:
        yield path, "another" if data is None else data + "x"


def _with(data: Any, name: str, value: Any) -> Any:
    """A dataclass with another value of one field, whatever it checks when it is made."""
    other = replace(data)
    object.__setattr__(other, name, value)
    return other


@pytest.mark.parametrize("kind", ["sweep", "bistable", "optimum"])
def test_every_number_of_the_work_changes_its_fingerprint(kind: str, monkeypatch: pytest.MonkeyPatch):
    study: dict[str, Any] = {"kind": kind, "settle": SETTLE}
    study |= {
        "sweep": {"frequency": SPACED, "direction": "both", "refine": 1e-3},
        "bistable": {"frequency": {"from": 0.9, "to": 1.2}, "harmonics": 0},
        "optimum": {
            "frequency": SPACED,
            "along": {"contacts.pad.preload": {"from": 800.0, "to": 900.0, "num": 3}},
            "point": "tip",
        },
    }[kind]
    for work in payload(monkeypatch, LINEAR | {"study": study}):
        before, count = fingerprint(work), 0
        assert fingerprint(deepcopy(work)) == before
        for path, other in variations(work):
            assert fingerprint(other) != before, path
            count += 1
        assert count > 80
