"""Overrides: new values for a scene by key path, as ``--set`` and ``over`` write them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from timesim.fault import Key, Problem, RuleError, SceneError, nearest
from timesim.scene.text import SceneSource, parse, plain

NAMED_BY_KEYS = {("study", "over"), ("study", "along"), ("study", "start", "at"), ("initial", "at")}
"""Mappings of the scene whose keys are key paths."""


def overridden(source: SceneSource, overrides: Mapping[str, Any] | Sequence[str]) -> SceneSource:
    """The source with new values; a missing mapping on the way to a key is made, and None takes a key out.

    Raises:
        SceneError: an override that is no assignment, or addresses nothing.
    """
    if not overrides:
        return source
    data = plain(source.data)  # not deepcopy: aliases share their values
    errors: list[Problem] = []
    keys = list(source.overridden)
    for given in overrides.items() if isinstance(overrides, Mapping) else overrides:
        try:
            path, value = given if isinstance(given, tuple) else _assignment(str(given))
            keys.append(_set(data, str(path), plain(value)))
        except RuleError as error:
            parts = given if isinstance(given, tuple) else str(given).partition("=")[::2]
            key, shown = (str(parts[0]).strip(), str(parts[1]).strip())
            errors.append(Problem("override", None, key, shown, error.rule, error.hint))
    if errors:
        raise SceneError(errors)
    return replace(source, data=data, overridden=tuple(keys))


def _assignment(text: str) -> tuple[str, Any]:
    path, equals, value = text.partition("=")
    if not equals or not path.strip() or not value.strip():
        raise RuleError((), "must be key.path=value", "as in contacts.pad.preload=5")
    return path.strip(), parse(value.strip())[0]


def _set(data: dict[str, Any], path: str, value: Any) -> Key:
    """Set a value in place, or take the key out; the key path that it has now."""
    place: Any = data
    key: list[str | int] = []
    rest: str | None = path
    while rest is not None:
        part, rest = _first(rest, place if tuple(key) in NAMED_BY_KEYS else None)
        step = _step(place, part)
        key.append(step)
        if value is None and isinstance(place, dict) and (rest is None or step not in place):
            place.pop(step, None)
            break
        if rest is None:
            place[step] = value
        elif isinstance(place, dict) and step not in place:
            place[step] = {}
        place = place[step]
    return tuple(key)


def _first(path: str, named: Any) -> tuple[str, str | None]:
    """The first part of a path and the rest, None where there is none.

    Args:
        path: what is left of a key path.
        named: the mapping it leads into if its keys are key paths themselves, else None.
    """
    if named is None:
        part, dot, rest = path.partition(".")
        return part, rest if dot else None
    known = [key for key in named if path.startswith(f"{key}.")] if isinstance(named, dict) else []
    part = max(known, key=len, default=path)
    return part, path[len(part) + 1 :] or None


def _step(place: Any, part: str) -> str | int:
    if isinstance(place, dict) and part:
        return part
    if not isinstance(place, list):
        rule = f"{part or 'an empty part'} stands below a value that has no keys"
        raise RuleError((), rule, "override the whole value")
    names = [str(item["name"]) for item in place if isinstance(item, dict) and "name" in item]
    found = [i for i, item in enumerate(place) if isinstance(item, dict) and item.get("name") == part]
    if found:
        return found[0]
    if part.isdecimal() and int(part) < len(place):
        return int(part)
    known = f"indices 0 to {len(place) - 1}" if place else "the list is empty"
    raise RuleError((), f"{part} is no item of the list", nearest(part, names) if names else known)
