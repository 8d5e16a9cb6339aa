"""The source of a scene: its plain data, the line of every key, and new values by key path."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from timesim.fault import Key, Problem, RuleError, SceneError, nearest
from timesim.result.argument import list_of, path_of
from timesim.result.label import EVERY
from timesim.scene.text import MAX_BYTES, MAX_DEPTH, parse, plain, value_text


@dataclass(frozen=True)
class SceneSource:
    """Plain data of a scene and the line of each key.

    Attributes:
        name: the file, as messages call it.
        folder: where relative paths in the scene begin.
        data: mappings, lists, text, numbers.
        lines: line of each key path that the file holds, from 1.
        overridden: key paths whose values do not come from the file.
    """

    name: str
    folder: Path
    data: dict[str, Any]
    lines: Mapping[Key, int] = field(default_factory=dict)
    overridden: tuple[Key, ...] = ()

    def line(self, key: Key) -> int | None:
        """Line of a key, or of the nearest key above it that the file holds."""
        return next((self.lines[key[:n]] for n in range(len(key), -1, -1) if key[:n] in self.lines), None)

    def problem(self, error: RuleError) -> Problem:
        """The error with its place, its key as a user writes it, and the value as text."""
        value = None if error.value is None else value_text(error.value)
        new = bool(self.lines) and error.key not in self.lines  # made on the way to a key that is set
        by_override = any(
            error.key[: len(key)] == key or (new and error.key and key[: len(error.key)] == error.key)
            for key in self.overridden
        )
        name = "override" if by_override else self.name
        line = None if by_override else error.line or self.line(error.key)
        return Problem(name, line, dotted(error.key, self.data), value, error.rule, error.hint)

    def error(self, errors: Iterable[RuleError]) -> SceneError:
        """All problems in the order of the file, one a key."""
        first = {error.key: error for error in reversed([*errors])}
        problems = [self.problem(error) for error in first.values()]
        return SceneError(sorted(problems, key=lambda problem: (problem.line or 0, problem.key)))

    def check_axes(self, places: Iterable[Key]) -> None:
        """Refuse a scalar that a study varies twice, as by the name of a contact and by its number."""
        known: dict[Key, Key] = {}
        for place in places:
            for key in addresses(self.data, str(place[-1])):
                other = known.setdefault(key, place)
                if other != place:
                    rule = f"is the same scalar as {'.'.join(map(str, other))}"
                    raise self.error([RuleError(("study", *place), rule, "name it once")])


def dotted(key: Key, data: Any) -> str:
    """Key path as text; an item of a list goes by its name where it has one of its own."""
    parts = []
    for part in key:
        siblings, data = data, _item(data, part)
        items = siblings if isinstance(siblings, list) else []
        names = [item.get("name") for item in items if isinstance(item, dict)]
        name = data.get("name") if isinstance(data, dict) and names else None
        parts.append(name if isinstance(name, str) and name and names.count(name) == 1 else str(part))
    return ".".join(parts)


def _item(data: Any, part: str | int) -> Any:
    if isinstance(data, dict):
        return data.get(part)
    return data[part] if isinstance(data, list) and isinstance(part, int) and part < len(data) else None


# Reading


def read(source: str | Path | Mapping[str, Any]) -> SceneSource:
    """Read a scene from what `timesim.load_scene` takes.

    Raises:
        SceneError: a file that cannot be read, text that is no YAML that a scene may be, or values of other types.
        ValueError: the source is none of these.
    """
    rule = "the path of a file, the text of one (of several lines) or a mapping"
    inline = isinstance(source, Mapping) or (isinstance(source, str) and "\n" in source)
    path = None if inline else path_of("the source of a scene", source, rule)
    folder = Path.cwd() if path is None else path.absolute().parent
    scene = SceneSource("scene" if path is None else str(path), folder, {})
    try:
        if isinstance(source, Mapping):
            return replace(scene, data=plain(source))
        value, lines = parse(str(source) if path is None else _content(path))
        if not isinstance(value, dict):
            hint = "the top level holds structure:, contacts:, study:, …"
            raise RuleError((), "must be a mapping of keys", hint, value, 1)
    except RuleError as error:
        raise SceneError([scene.problem(error)]) from None
    return replace(scene, data=value, lines=lines)


def _content(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(MAX_BYTES + 1)
    except OSError as error:
        rule = "no such file" if isinstance(error, FileNotFoundError) else f"cannot be read ({error.strerror})"
        raise RuleError((), rule, "give the path of a scene file") from None


def empty_values(data: Any, key: Key = ()) -> Iterator[RuleError]:
    """Keys without a value."""
    if data is None:
        name, hint = str(key[-1]) if key else "", "give one, or leave the key out"
        if ":" in name:
            hint = f"a space is missing: {name.partition(':')[0]}: {name.partition(':')[2]}"
        elif name[:1].isdecimal():
            hint = "a number takes a point for its decimals, and no comma"
        yield RuleError(key, "has no value", hint)
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for part, value in items:
        yield from empty_values(value, (*key, part))


# New values, as ``--set`` and ``over`` write them

NAMED_BY_KEYS = {("study", "over"), ("study", "along"), ("study", "start", "at"), ("initial", "at")}
"""Mappings of the scene whose keys are key paths."""


def overridden(source: SceneSource, overrides: Mapping[str, Any] | Iterable[str]) -> SceneSource:
    """The source with new values; mappings that are missing on the way to a key are added, and None removes a key.

    Raises:
        SceneError: an override that is no assignment, or addresses nothing.
        ValueError: the overrides are no mapping and no list.
    """
    data, errors, keys = source.data, [], list(source.overridden)
    rule = "a mapping, {'contacts.pad.preload': 5}, or a list, ['contacts.pad.preload=5']"
    pairs = overrides.items() if isinstance(overrides, Mapping) else list_of("overrides", overrides, rule)
    for given in pairs:
        try:
            path, value = given if isinstance(given, tuple) else _assignment(str(given))
            data, changed = _changed(data, str(path), plain(value))
            keys += changed
        except RuleError as error:
            parts = given if isinstance(given, tuple) else str(given).partition("=")[::2]
            path, shown = (str(part).strip() for part in parts)
            errors.append(Problem("override", None, path, shown, error.rule, error.hint))
    if errors:
        raise SceneError(errors)
    return replace(source, data=data, overridden=tuple(keys))


def _assignment(text: str) -> tuple[str, Any]:
    path, equals, value = text.partition("=")
    if not equals or not path.strip() or not value.strip():
        raise RuleError((), "must be key.path=value", "as in contacts.pad.preload=5")
    return path.strip(), parse(value.strip())[0]


def addresses(data: Mapping[str, Any], path: str) -> list[Key]:
    """Where a key path leads in the data of a scene; the path itself, as one part, where it leads nowhere."""
    try:
        return _changed(data, path, 0.0)[1]
    except RuleError:
        return [(path,)]


def _changed(place: Any, path: str, value: Any, above: Key = ()) -> tuple[Any, list[Key]]:
    """A copy of the data at a key with another value at a path below it, and the whole key paths of that value.

    Only what lies on the path is copied, since the rest may be large, and since an alias shares its value with others.
    """
    if len(above) > MAX_DEPTH:
        raise RuleError(above[:4], f"is nested deeper than {MAX_DEPTH} levels")
    part, rest = _first(path, place if above in NAMED_BY_KEYS else None)
    steps, keys = _steps(place, part), list[Key]()
    copy = place.copy()
    for step in steps:
        own = [(*above, step)]
        if isinstance(copy, dict) and value is None and (rest is None or step not in copy):
            copy.pop(step, None)
        elif rest is None:
            copy[step] = value
        else:
            below = copy.get(step, {}) if isinstance(copy, dict) else copy[step]
            copy[step], own = _changed(below, rest, value, own[0])
        keys += own
    return copy, keys


def _first(path: str, named: Any) -> tuple[str, str | None]:
    """The first part of a path and the rest, None where there is none.

    ``named``: the mapping that the path leads into, if its keys are key paths themselves, else None.
    """
    if named is None:
        part, dot, rest = path.partition(".")
        return part, rest if dot else None
    known = [key for key in named if path.startswith(f"{key}.")] if isinstance(named, dict) else []
    part = max(known, key=len, default=path)
    return part, path[len(part) + 1 :] or None


def _steps(place: Any, part: str) -> list[str] | list[int]:
    """The key or index that a part of a path names; a star, unless it is a name, names all items of a list."""
    if isinstance(place, dict) and part:
        return [part]
    if not isinstance(place, list):
        rule = f"{part or 'an empty part'} stands below a value that has no keys"
        raise RuleError((), rule, "override the whole value")
    names = [str(item["name"]) for item in place if isinstance(item, dict) and "name" in item]
    same = [i for i, item in enumerate(place) if isinstance(item, dict) and item.get("name") == part]
    if same:
        return same[:1]
    if part == EVERY and place:
        return list(range(len(place)))
    if part.isdecimal() and int(part) < len(place):
        return [int(part)]
    known = f"indices 0 to {len(place) - 1}" if place else "the list is empty"
    raise RuleError((), f"{part} is no item of the list", nearest(part, names) if names else known)
