"""The whole scene file: the tree of its sections, its JSON Schema, and what pydantic refuses in plain words.

A section's `build` or `plan` gives its part in numbers; rules that need another section (a point, the number of modes)
are checked there and raise `RuleError`. Frequencies are in Hz, angles in degrees, the rest in any consistent system of
units.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any, get_args, get_origin

from pydantic import AfterValidator, BeforeValidator, Field, Tag, ValidationError, create_model
from pydantic.fields import FieldInfo

from timesim.fault import RuleError, meant, nearest
from timesim.scene.contact import Contacts
from timesim.scene.integration import InitialSection, SolverSection
from timesim.scene.section import Section, by_form, refuse
from timesim.scene.structure import ExcitationSection, StructureSection, point_names
from timesim.scene.study import StudySection
from timesim.scene.value import Text

Kinds = Mapping[str, type[StudySection]]
"""The section of each kind of study."""


def _letters(name: str) -> str:
    if not name.isalpha():
        raise refuse(
            "must be the name of a unit, letters only", hint="such as m, mm, N, kN, lbf; rad, Nm where it turns"
        )
    return name


UnitName = Annotated[Text, AfterValidator(_letters)]


class UnitsSection(Section):
    """Units that the scene is written in, with which results and pictures are labelled; time is in s."""

    length: UnitName | None = None
    """Such as m or mm."""
    force: UnitName | None = None
    """Such as N or kN; the unit of mass is that which goes with both."""


class SceneParts(Section):
    """What a scene holds besides its study."""

    title: Text = ""
    units: UnitsSection | None = None
    structure: StructureSection | None = None
    contacts: Contacts = ()
    excitation: ExcitationSection | None = None
    initial: InitialSection = "rest"
    solver: SolverSection = Field(default_factory=lambda: SolverSection.model_validate({}))

    def unit_names(self) -> dict[str, str]:
        """Units that the scene names, by their quantities: ``{"length": "mm"}``."""
        return {} if self.units is None else self.units.model_dump(exclude_none=True)


class SceneFile(SceneParts):
    """A scene: what is modelled, and what is computed."""

    study: StudySection


@cache
def file_type(kinds: tuple[tuple[str, type[StudySection]], ...]) -> type[SceneFile]:
    """The scene file where these kinds of study are known, the items of `Kinds`."""
    names = [name for name, _ in kinds]

    def known(value: Any) -> Any:
        if isinstance(value, dict) and (kind := value.get("kind")) not in names:
            choice = f"one of {', '.join(names)}"
            if "kind" not in value:
                raise refuse("is required", key=("kind",), hint=choice)
            raise refuse(f"must be {choice}", key=("kind",), hint=meant(str(kind), names), value=kind)
        return value

    members = reduce(or_, [Annotated[section, Tag(f"<{name}>")] for name, section in kinds])
    study = Annotated[members, by_form("a mapping of keys with a kind", _kind), BeforeValidator(known)]
    return create_model("SceneFile", __base__=SceneFile, study=(study, ...))


def _kind(value: Any) -> str | None:
    if isinstance(value, StudySection):
        return f"<{value.kind}>"
    return f"<{value['kind']}>" if isinstance(value, dict) else None


def parsed(data: Mapping[str, Any], kinds: Kinds) -> tuple[SceneFile | None, list[RuleError]]:
    """The sections of a scene from its plain data, or None, and all that is wrong with them."""
    tree = file_type(tuple(kinds.items()))
    structure, contacts = data.get("structure"), data.get("contacts")
    listed = contacts if isinstance(contacts, list) else ()
    names = {
        "points": point_names(structure),
        "contacts": [item["name"] for item in listed if isinstance(item, dict) and isinstance(item.get("name"), str)],
    }
    missing = list(_missing(data, kinds))
    try:
        file = tree.model_validate(data, context=names)
    except ValidationError as error:
        return None, rule_errors(error, tree, missing)
    return None if missing else file, missing


def _missing(data: Mapping[str, Any], kinds: Kinds) -> Iterator[RuleError]:
    """Keys that the kind of study needs and the scene does not have."""
    study = data.get("study")
    kind = str(study.get("kind")) if isinstance(study, dict) else ""
    for key in kinds[kind].requires if kind in kinds else ():
        *above, last = key.split(".")
        section = data.get(above[0]) if above else data
        if isinstance(section, Mapping) and last not in section:
            yield RuleError((*above, last), f"{RULES['missing']} in a study of kind {kind}")


def json_schema(kinds: Kinds) -> dict[str, Any]:
    """JSON Schema of the scene file, for editors."""
    schema = file_type(tuple(kinds.items())).model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_for_editors(schema)}


BOUNDS = {"ge": "minimum", "le": "maximum"}
"""Names in JSON Schema of bounds that pydantic writes by its own names, where a validator runs before them."""


def _for_editors(part: Any) -> Any:
    """The same with the bounds named as in JSON Schema, and without the null of a key that may be left out."""
    if isinstance(part, list):
        return [_for_editors(item) for item in part if item != {"type": "null"}]
    if not isinstance(part, dict):
        return part
    given = {BOUNDS.get(key, key): item for key, item in part.items() if key != "default" or item is not None}
    kept = {key: _for_editors(item) for key, item in given.items()}
    (one,) = kept.pop("anyOf") if len(kept.get("anyOf", ())) == 1 else ({},)
    return kept | one


# What pydantic refuses

RULES = {
    "missing": "is required",
    "extra_forbidden": "is no key here",
    "float_type": "must be a number",
    "finite_number": "must be finite",
    "int_type": "must be a whole number",
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "tuple_type": "must be a list",
    "dict_type": "must be a mapping of keys",
    "model_type": "must be a mapping of keys",
    "literal_error": "must be {expected}",
    "greater_than": "must be > {gt:g}",
    "greater_than_equal": "must be >= {ge:g}",
    "less_than": "must be < {lt:g}",
    "less_than_equal": "must be <= {le:g}",
}


ELSEWHERE = {
    ("<transient>", "frequency"): "the frequency of one run is excitation.frequency",
    ("<tradeoff>", "frequency"): "the frequency of one run is excitation.frequency",
    ("study", "accuracy"): "it is solver.accuracy",
    ("study", "method"): "it is solver.method",
    ("contacts", "gap"): "a gap is a negative preload, -normal_stiffness times its width",
    ("contacts", "mu"): "did you mean friction?",
    ("contacts", "kt"): "did you mean tangential_stiffness?",
    ("contacts", "kn"): "did you mean normal_stiffness?",
    ("contacts", "n0"): "did you mean preload?",
    ("contacts", "N0"): "did you mean preload?",
    ("structure", "M"): "did you mean mass?",
    ("structure", "K"): "did you mean stiffness?",
    ("structure", "C"): "did you mean damping?",
    ("excitation", "amplitude"): "each of forces, constant_forces and modal_force has its own",
    ("excitation", "phase_deg"): "each of forces and modal_force has its own",
}
"""What is said of keys of another section or name, by the section, or the tag of its kind, and the key."""
OTHER_NAMES = {
    "rk45": "dopri5 is this pair of Dormand and Prince",
    "ode45": "dopri5 is this pair of Dormand and Prince",
    "dop853": "dopri8 is of this order",
}
"""What is said of methods that other programs name otherwise."""
NO_NUMBER = {RULES[kind] for kind in ("string_type", "bool_type", "tuple_type", "dict_type", "model_type")}
"""Rules that any number breaks, whatever its value."""


def rule_errors(error: ValidationError, tree: type[SceneParts], missing: Iterable[RuleError] = ()) -> list[RuleError]:
    """All that pydantic refuses; a required key that is only misspelt is not reported as missing too.

    ``tree``: the sections that were validated; ``missing``: keys that are required for another reason.
    """
    errors = [_rule_error(details, tree) for details in error.errors(include_url=False) if not _miscounted(details)]
    meant = [(*error.key[:-1], error.hint) for error in errors if error.rule == RULES["extra_forbidden"]]
    return [
        error
        for error in (*errors, *missing)
        if not error.rule.startswith(RULES["missing"])
        or (*error.key[:-1], f"did you mean {error.key[-1]}?") not in meant
    ]


def _miscounted(details: Any) -> bool:
    """Whether a list is called too short only because pydantic does not count the entries that it refuses."""
    return details["type"] == "too_short" and len(details["input"]) >= details["ctx"]["min_length"]


def _rule_error(details: Any, tree: type[SceneParts]) -> RuleError:
    """One of pydantic's error details, as the rule it breaks and the key as the file has it."""
    context, kind = details.get("ctx", {}), details["type"]
    located = [part for part in details["loc"] if part != "[key]" and not str(part).startswith("<")]
    key = (*located, *context.get("key", ()))
    value = None if details["loc"][-1:] == ("[key]",) else details["input"]
    if kind == "rule":
        rule = context.get("rule", details["msg"])
        number = _as_number(value) if "a number" in rule else ""
        return RuleError(key, rule, context.get("hint") or number, _shown(context, value))
    if kind in ("too_short", "too_long"):
        return RuleError(key, _length_rule(context), value=value)
    rule = RULES.get(kind, details["msg"]).format(**context)
    hint = _hint(kind, details["loc"], value, context, tree)
    return RuleError(key, rule, hint, None if kind == "missing" else value)


def _shown(context: Mapping[str, Any], value: Any) -> Any:
    if "rule" in context and context["value"] is not None:
        return context["value"]
    return None if context.get("key") or isinstance(value, Section | dict) else value


def _length_rule(context: Mapping[str, Any]) -> str:
    bound, actual = context.get("min_length", context.get("max_length")), context["actual_length"]
    number = {1: "at least 1 entry", 2: "2 entries", 3: "3 entries"}[bound]
    return f"must have {number}, not {actual}"


def _hint(
    kind: str, location: Sequence[str | int], value: Any, context: Mapping[str, Any], tree: type[SceneParts]
) -> str:
    if kind == "extra_forbidden":
        places = [(str(part), str(location[-1])) for part in location[:2]]
        instead = next((ELSEWHERE[place] for place in places if place in ELSEWHERE), "") or _neighbour(location, tree)
        return instead or nearest(str(location[-1]), _fields_at(location[:-1], tree))
    if kind == "missing" and (field := _fields_at(location[:-1], tree).get(str(location[-1]))):
        return _described(field)
    if kind == "literal_error":
        if str(value).endswith(".nc"):
            return f"a result is given as {{from: {value}}}"
        if (name := str(value).lower()) in OTHER_NAMES:
            return OTHER_NAMES[name]
        return meant(value, str(context["expected"]).replace(" or ", ", ").replace("'", "").split(", "))
    if kind == "model_type" and str(value).endswith((".npz", ".mat", ".mtx")):
        return f"a file is given as structure: {{file: {value}, ...}}"
    if kind in ("dict_type", "model_type") and (fields := _fields_at(location, tree)):
        return f"its keys: {', '.join(fields)}"
    if kind == "tuple_type" and isinstance(value, dict) and value and all(part.isdecimal() for part in value):
        return "not in the scene: give all of it there before one of its entries is set or varied"
    if kind == "tuple_type":
        of_mappings = isinstance(value, dict) and _fields_at([*location, 0], tree)
        return "put - before it, as before each of several" if of_mappings else _above(location, tree)
    if kind == "string_type" and isinstance(value, int | float):
        return "put it in quotes"
    if kind == "float_type":
        return _as_number(value)
    if kind == "int_type" and isinstance(value, str):
        return "without quotes and unit"
    return ""


def _as_number(value: Any) -> str:
    """How a number is written that is given as text; empty of what is no text."""
    if not isinstance(value, str):
        return ""
    percent = value.rstrip().endswith("%")
    return "as a share: 1 % is 0.01" if percent else "without quotes and unit, with a point for the decimals"


def _neighbour(location: Sequence[str | int], tree: type[SceneParts]) -> str:
    """Where a key belongs that stands one section too high or too low."""
    *above, key = location
    for name in _fields_at(above, tree):
        if key in _fields_at([*above, name], tree):
            return f"it belongs in {name}"
    for i, outer in reversed([*enumerate(above)]):
        fields = _fields_at(above[:i], tree)
        if outer in fields and key in fields:
            return f"it belongs beside {outer}, not in it"
    return ""


def _described(field: FieldInfo) -> str:
    return (field.description or "").rstrip(".").replace("\n", " ")


def _above(location: Sequence[str | int], tree: type[SceneParts]) -> str:
    """What is said of the last key on the way to a location."""
    fields = (_fields_at(location[:i], tree).get(str(part)) for i, part in enumerate(location))
    return next((_described(field) for field in reversed([*fields]) if field), "")


def _fields_at(location: Sequence[str | int], kind: Any) -> dict[str, FieldInfo]:
    """The keys that are allowed in the section at a location below another, each with its description."""
    for part in location:
        kind = _below(kind, part)
    sections = [item for item in _options(kind) if isinstance(item, type) and issubclass(item, Section)]
    return {field.alias or name: field for section in sections[:1] for name, field in section.model_fields.items()}


def _below(kind: Any, part: str | int) -> Any:
    for option in _options(kind):
        if isinstance(option, type) and issubclass(option, Section):
            fields = {field.alias or name: field.annotation for name, field in option.model_fields.items()}
            if part in fields:
                return fields[part]
        elif isinstance(part, str) and Tag(part) in getattr(option, "__metadata__", ()):
            return option
        elif get_origin(option) in (tuple, dict) and not str(part).startswith("<"):
            return get_args(option)[0 if get_origin(option) is tuple else 1]
    return None


def _options(kind: Any) -> list[Any]:
    """Members of a union, however wrapped; a tagged one is given both wrapped and unwrapped."""
    if get_origin(kind) is Annotated:
        inner = _options(get_args(kind)[0])
        return [kind, *inner] if any(isinstance(item, Tag) for item in kind.__metadata__) else inner
    if get_origin(kind) in (tuple, dict) or isinstance(kind, type):
        return [kind]
    return [option for member in get_args(kind) for option in _options(member)]
