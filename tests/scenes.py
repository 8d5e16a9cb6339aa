"""Scenes drawn from the JSON Schema of the scene file: what the schema allows, and what it does not.

`drawn` follows the schema alone: it knows no key by itself, so that a new one is drawn as soon as the program has it.
Names come from a short list and numbers from what is usual for their key, so that parts of a scene fit together now and
then. `repaired` makes them fit; `spoiled` puts something else in some place.
"""

import copy
from collections.abc import Iterator, Mapping
from typing import Any

from hypothesis import strategies as st

NAMES = ("tip", "rim")
CONTACTS = ("pad", "stop")
GRID = ("from", "to", "step")
VARIED = ("contacts.pad.preload", "contacts.pad.friction", "structure.modes.0.mass")
USUAL: dict[str, tuple[float, ...]] = {
    "frequency": (0.9, 1.1, 1.39, 0.97),
    "from": (0.9, 1.0, 1.3),
    "to": (1.4, 1.5, 1.31),
    "step": (0.1, 0.25),
    "damping_ratio": (0.02, 0.05, 0.0, 2.0),
    "mass": (1.0, 2.0, 0.1),
    "friction": (0.5, 0.3, 0.0, 10.0),
    "tangential_stiffness": (20.0, 1.0, 0.0),
    "normal_stiffness": (20.0, 1.0, 0.0),
    "preload": (3.0, -1.0, 0.0, 32.0),
    "amplitude": (1.0, 0.1, 0.0),
    "phase_deg": (0.0, 90.0, -45.0),
    "A": (1.0, 2.0, 0.0),
    "B": (0.5, 1.0, 0.0),
    "D": (0.5, 1.5, 0.0),
    "width": (1e-2, 1e-3),
    "starts": (0, 5),
    "rtol": (1e-5, 1e-7),
    "harmonic": (1, 2),
}
EXTREME = (0.0, -0.0, 5e-324, 1e-300, 1e-100, 1e-9, 1e9, 1e100, 1.1e100, 1e308, float("inf"), float("nan"), -1.0)
JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.sampled_from(["", "tip", "1e3 N", "ground", "a.b", "\t", "\N{SNOWMAN}", "=", "*a", "null", "0x10"]),
    st.sampled_from([10**400, -1, 0, 1, 10**9 + 1, *EXTREME]),
    st.just([]),
    st.just({}),
    st.lists(st.sampled_from(EXTREME), max_size=4),
    st.just({"name": "pad"}),
    st.just([[1.0, 0.0], [0.0]]),
)

Schema = Mapping[str, Any]


def drawn(schema: Schema, *, extreme: bool = True, bounds: Mapping[str, tuple[int, int]] | None = None) -> Any:
    """A strategy for what a schema allows.

    Args:
        schema: the whole of it, with its ``$defs``.

    Keyword Args:
        extreme: now and then numbers as large or small as the schema allows.
        bounds: least and largest value of whole numbers, or length of lists, by their key.
    """
    return _Drawer(schema["$defs"], extreme, bounds or {}).of(schema, "")


class _Drawer:
    def __init__(self, definitions: Schema, extreme: bool, bounds: Mapping[str, tuple[int, int]]):
        self.definitions, self.extreme, self.bounds = definitions, extreme, bounds
        self.known: dict[tuple[str, str], Any] = {}

    def of(self, schema: Schema, key: str) -> Any:
        if "$ref" in schema:
            name = schema["$ref"].rpartition("/")[2]
            if (name, key) not in self.known:
                self.known[name, key] = self.of(self.definitions[name], key)
            return self.known[name, key]
        if "const" in schema:
            return st.just(schema["const"])
        if "enum" in schema:
            return st.sampled_from(schema["enum"])
        if options := schema.get("oneOf") or schema.get("anyOf"):
            return st.one_of(*(self.of(option, key) for option in options))
        return getattr(self, f"_{schema['type']}")(schema, key)

    def _boolean(self, schema: Schema, key: str) -> Any:
        return st.booleans()

    def _string(self, schema: Schema, key: str) -> Any:
        names = CONTACTS if key in ("name", "contact") else NAMES
        return st.sampled_from([*names, "ground"] if key == "against" else names)

    def _number(self, schema: Schema, key: str) -> Any:
        low, high = schema.get("minimum", -1e100), schema.get("maximum", 1e100)
        above, below = schema.get("exclusiveMinimum", -1e101), schema.get("exclusiveMaximum", 1e101)
        least, most = max(low, above, -5.0), min(high, below, 5.0)
        between = st.floats(least, most, exclude_min=least == above, exclude_max=most == below)
        usual = st.sampled_from(USUAL.get(key, (1.0, 0.5, 0.0, -0.3, 2.0)))
        wide = st.sampled_from([x for x in EXTREME if low <= x <= high])
        options = st.one_of(usual, usual, usual, between, *([wide] if self.extreme else []))
        return options.filter(lambda x: low <= x <= high and above < x < below)

    def _integer(self, schema: Schema, key: str) -> Any:
        low, high = schema.get("minimum", 0), schema.get("maximum", 10**9)
        own = self.bounds.get(key, (low, min(high, low + 12)))
        few = st.integers(max(low, own[0]), min(high, own[1]))
        return st.one_of(few, few, few, st.sampled_from([low, high])) if self.extreme else few

    def _array(self, schema: Schema, key: str) -> Any:
        least = schema.get("minItems", 0)
        low, high = self.bounds.get(key, (least, min(schema.get("maxItems", least + 2), least + 2)))
        items = self.of(schema["items"], key)
        return st.lists(items, min_size=max(least, low), max_size=max(least, high))

    def _object(self, schema: Schema, key: str) -> Any:
        if "properties" in schema:
            own = {name: self.of(part, name) for name, part in schema["properties"].items()}
            required = schema.get("required", ())
            kept = {name: own.pop(name) for name in required}
            return st.fixed_dictionaries(kept, optional=own)
        names = VARIED if key in ("over", "along") else NAMES
        values = self.of(schema["additionalProperties"], key)
        return st.dictionaries(st.sampled_from(names), values, min_size=schema.get("minProperties", 0), max_size=2)


# Parts that fit together


def repaired(scene: dict[str, Any]) -> dict[str, Any]:
    """The scene with names that exist, as many forces as modes, and no files: it may still break a rule."""
    scene = {"structure": {}, "excitation": {}, "contacts": []} | copy.deepcopy(scene)
    points, count = _structure(scene)
    if (
        scene["study"]["kind"] in ("element", "element_map", "hbm", "compare", "optimum", "bistable")
        and not scene["contacts"]
    ):
        scene["contacts"] = [{"friction": 0.5, "tangential_stiffness": 20.0, "normal_stiffness": 20.0, "preload": 3.0}]
    contacts = scene["contacts"] = scene["contacts"][:2]
    for name, contact in zip(CONTACTS, contacts, strict=False):
        _contact(contact, name, points)
    excitation = scene["excitation"]
    excitation.setdefault("frequency", 1.39)
    if scene["study"]["kind"] in ("hbm", "compare"):
        excitation["modal_force"] = [{"amplitude": 1.0}]
    if "modal_force" in excitation:
        excitation["modal_force"] = (excitation["modal_force"] + [{"amplitude": 1.0}] * count)[:count]
    for force in (*excitation.get("forces", ()), *excitation.get("constant_forces", ())):
        force["point"] = points[0]
        force["direction"] = [1.0, 0.5, *force["direction"][2:]]
    _start(scene, count)
    _study(scene)
    _solver(scene.setdefault("solver", {}))
    return scene


def _structure(scene: dict[str, Any]) -> tuple[list[str], int]:
    structure = scene["structure"]
    if "matrices" in structure:
        inner = structure["matrices"]
        inner["mass"], inner["stiffness"] = [[2.0, 0.1], [0.1, 1.0]], [[60.0, -20.0], [-20.0, 50.0]]
        if "damping" in inner:
            inner.pop("damping_ratio", None)
            inner["damping"] = [[0.4, -0.1], [-0.1, 0.3]]
        else:
            inner["damping_ratio"] = 0.02
        inner["points"] = {"tip": {"x": 0, "z": 1}, "rim": {"y": 0}}
        structure.pop("keep_modes", None)
        return list(NAMES), 2
    modes = structure.get("modes") or [{"frequency": f, "damping_ratio": 0.02, "mass": 1.0} for f in (0.9, 1.1)]
    modes = modes[:2]
    for i, mode in enumerate(modes):
        given = [*mode.get("shape", {}).values(), [1.0, 1.0 - 2 * i, 0.8], [0.0, 1.0, -0.5]]
        mode["shape"] = dict(zip(NAMES, given, strict=False))
    scene["structure"] = {"modes": modes}
    return list(NAMES), len(modes)


def _contact(contact: dict[str, Any], name: str, points: list[str]) -> None:
    contact["name"] = name
    contact["point"] = points[0]
    contact.pop("law", None)
    contact.pop("tangent", None)
    if not any(contact.get("normal", (1,))):
        contact.pop("normal")
    if contact.get("against", "ground") != "ground":
        contact["against"] = points[1]
    K = contact["tangential_stiffness"]
    if K == 0:
        contact["friction"] = 0.0
    if contact["normal_stiffness"] == 0:
        contact["preload"] = 2.0
    if isinstance(K, list):
        contact["tangential_stiffness"] = [[20.0, 3.0], [3.0, 12.0]] if isinstance(K[0], list) else [20.0, 12.0]


def _start(scene: dict[str, Any], count: int) -> None:
    initial = scene.get("initial", "rest")
    if not isinstance(initial, dict):
        return
    if "from" in initial:
        scene["initial"] = "rest"
        return
    initial.pop("slip", None)
    for key in ("modal_displacement", "modal_velocity"):
        if key in initial:
            initial[key] = ([0.01 * value for value in initial[key]] + [0.0] * count)[:count]
    if not initial:
        scene["initial"] = "rest"


def _study(scene: dict[str, Any]) -> None:
    study, contacts = scene["study"], scene["contacts"]
    kind, frequency = study["kind"], study.get("frequency")
    if kind in ("element", "element_map"):
        del contacts[1:]
    for key in ("motion", "refine", "contact", "step", "point", "continuation"):
        study.pop(key, None)
    if isinstance(study.get("start"), dict):
        study["start"] = "linear"
    if "record_last" in study:
        study["record_last"] = min(study["record_last"], study["cycles"])
    if not contacts:
        study.pop("over", None)
    if isinstance(frequency, dict) and kind in ("sweep", "compare", "optimum"):
        listed = "values" in frequency
        study["frequency"] = (
            {"values": frequency["values"]} if listed else dict(zip(GRID, (0.9, 1.5, 0.3), strict=True))
        )
    if kind == "bistable":
        study["frequency"], study["width"] = {"from": 0.9, "to": 1.5}, 1e-3
    if kind == "hbm":
        study["frequency"] = 1.2 if study.get("along") else {"from": 0.9, "to": 1.5}
    if "along" in study:
        _along(study)
    if kind == "element_map":
        for key in [
            key for key in ("phi_deg", "psi_deg", "D", "friction", "preload", "normal_stiffness") if key in study
        ]:
            study[key] = 0.5
        study["A"], study["B"] = [0.1, 1.0, 2.0], {"from": 0.2, "to": 1.0, "num": 2}
    if kind == "element" and not {"A", "B", "D"} & set(study):
        study["A"] = 1.0


def _along(study: dict[str, Any]) -> None:
    """One scalar to vary, of which an optimum asks for three values at least."""
    study["along"] = dict([*study["along"].items(), (VARIED[0], {"from": 1.0, "to": 5.0})][:1])
    study.pop("over", None)
    study.pop("accuracy", None)
    study.pop("start", None)
    for ends in study["along"].values():
        if ends["to"] <= ends["from"]:
            ends["to"] = ends["from"] + 1.0
        if study["kind"] == "optimum":
            ends["num"] = max(3, ends.get("num", 3))


def _solver(solver: dict[str, Any]) -> None:
    """An accuracy, or a method with its own numbers."""
    if "accuracy" in solver or solver.get("method", "auto") == "auto":
        solver.pop("method", None)
        unused = ("rtol", "atol", "steps_per_cycle")
    else:
        unused = ("rtol", "atol") if solver["method"] == "rk4" else ("steps_per_cycle",)
    for key in unused:
        solver.pop(key, None)


# And what does not


def spoiled(scene: dict[str, Any], places: list[float], junk: list[Any]) -> dict[str, Any]:
    """The scene with something else in some of its places, each place a share of all of them."""
    scene = copy.deepcopy(scene)
    for share, value in zip(places, junk, strict=True):
        found = list(_places(scene))
        holder, key = found[int(share * len(found)) % len(found)]
        if value == "take out" and isinstance(holder, dict):
            holder.pop(key)
        elif value == "twice" and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[key]))
        elif value == "misspelt" and isinstance(holder, dict):
            holder[f"{key}s"] = holder.pop(key)
        else:
            holder[key] = copy.deepcopy(value)
        if not isinstance(scene, dict) or not scene:
            break
    return scene


def _places(part: Any) -> Iterator[tuple[Any, Any]]:
    items = part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ()
    for key, value in list(items):
        yield part, key
        yield from _places(value)


def any_scene(schema: Schema) -> Any:
    """Scenes of all sorts: as the schema draws them, repaired, and spoiled in one to three places."""
    whole = drawn(schema)
    good = whole.map(repaired)
    wrong = st.one_of(JUNK, st.sampled_from(["take out", "twice", "misspelt"]))
    spoil = st.integers(1, 3).flatmap(
        lambda count: st.tuples(
            good,
            st.lists(st.floats(0, 1, exclude_max=True), min_size=count, max_size=count),
            st.lists(wrong, min_size=count, max_size=count),
        )
    )
    return st.one_of(whole, good, spoil.map(lambda parts: spoiled(*parts)))


# Scenes that are run


FEW = {
    "cycles": (1, 6),
    "samples_per_cycle": (2, 40),
    "max_cycles": (1, 60),
    "num": (2, 3),
    "values": (1, 3),
    "A": (1, 2),
    "B": (1, 2),
    "samples": (36, 60),
    "harmonics": (1, 5),
    "harmonic": (1, 1),
    "modes": (2, 2),
    "contacts": (0, 1),
    "phases": (1, 2),
    "max_steps": (20_000, 20_000),
}
"""Few cycles, points and sizes, so that a run is short and its compiled programs serve the next one."""
SOLVERS = (
    {"accuracy": "draft"},
    {"accuracy": "standard"},
    {"method": "exponential", "rtol": 1e-6},
    {"method": "kvaerno5", "rtol": 1e-5},
    {"accuracy": "draft", "reduce": False},
)


def small_scene(schema: Schema) -> Any:
    """Scenes that fit together, are of few sizes and take little time; one in four has an extreme number."""
    parts = st.tuples(drawn(schema, extreme=False, bounds=FEW), st.sampled_from(SOLVERS), st.none() | _EXTREME_PLACES)
    return parts.map(lambda drawn: _small(*drawn))


_EXTREME_PLACES = st.tuples(
    st.sampled_from(["friction", "tangential_stiffness", "normal_stiffness", "preload", "mass", "damping_ratio"]),
    st.sampled_from([1e-12, 1e-6, 1e6, 1e12]),
)


def _small(scene: dict[str, Any], solver: dict[str, Any], extreme: tuple[str, float] | None) -> dict[str, Any]:
    scene = repaired(scene)
    scene["solver"] = dict(solver, max_steps=20_000)
    study = scene["study"]
    if study["kind"] in ("element", "element_map"):
        scene["solver"] = {"accuracy": "draft"}
    if study["kind"] == "bistable":
        study |= {"step": 0.15, "width": 0.05, "starts": 5 if study.get("starts") else 0}
    study.pop("time_samples", None)
    if extreme is not None:
        key, value = extreme
        holders = scene["structure"].get("modes", []) if key in ("mass", "damping_ratio") else scene["contacts"]
        for holder in holders:
            holder[key] = value
    return scene
