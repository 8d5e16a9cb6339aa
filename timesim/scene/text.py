"""The text of a scene: YAML 1.2 read into plain data, with the line of every key, and what is wrong with it.

Only the core schema of YAML 1.2 (chapter 10.3) is read: ``2e6`` is a number, ``on`` and ``yes`` are text. A
scene needs no tags, so they are refused; anchors may be used, within limits that a bomb of aliases exceeds.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from timesim.fault import Key, Problem, RuleError, SceneError

MAX_BYTES = 8 * 1024**2
MAX_DEPTH = 32
MAX_VALUES = 500_000
HUGE = 10**300

_NULL = re.compile(r"~|null|Null|NULL|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+")
_OTHER_BASE = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_/-]*(\.[A-Za-z0-9_/-]+)*")
_UNPRINTABLE = re.compile("[\x7f-\x9f\u2028\u2029\ud800-\udfff\ufeff\ufffe\uffff]")


@dataclass(frozen=True)
class SceneSource:
    """Plain data of a scene and where each key of it stands.

    Attributes:
        name: the file, as messages call it.
        folder: what relative paths in the scene start from.
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

    def problem(self, fault: RuleError) -> Problem:
        """The fault with its place, its key as a user writes it, and the value as text."""
        value = None if fault.value is None else value_text(fault.value)
        by_override = any(fault.key[: len(key)] == key for key in self.overridden)
        name = "override" if by_override else self.name
        line = None if by_override else fault.line or self.line(fault.key)
        return Problem(name, line, dotted(fault.key, self.data), value, fault.rule, fault.hint)


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


def value_text(value: Any, width: int = 60) -> str:
    """A value as YAML writes it, shortened to fit a message."""
    text = _flow(value)
    return text if len(text) <= width else f"{text[: width - 1]}…"


def plain(value: Any, key: Key = ()) -> Any:
    """Data made in Python as YAML would have given it: arrays as lists, paths and keys as text.

    Raises:
        RuleError: a value of a type that no scene holds, or one nested without end.
    """
    if len(key) > MAX_DEPTH:
        raise RuleError(key[:4], f"is nested deeper than {MAX_DEPTH} levels")
    if isinstance(value, Mapping):
        return {str(part): plain(item, (*key, str(part))) for part, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple | range):
        return [plain(item, (*key, i)) for i, item in enumerate(value)]
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, str | bool | float):
        return value
    if isinstance(value, int):
        return value if abs(value) < HUGE else float("inf")
    raise RuleError(key, f"must be text, a number, a list or a mapping, not {type(value).__name__}")


def read_file(path: Path) -> SceneSource:
    """Read a scene file.

    Raises:
        SceneError: a file that cannot be read, or is no YAML that a scene may be.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except OSError as error:
        rule = "no such file" if isinstance(error, FileNotFoundError) else f"cannot be read ({error.strerror})"
        raise SceneError([Problem(str(path), None, "", None, rule, "give the path of a scene file")]) from None
    return read_text(content, str(path), path.absolute().parent)


def read_text(content: bytes | str, name: str, folder: Path) -> SceneSource:
    """Read the text of a scene; see `read_file`."""
    source = SceneSource(name, folder, {})
    try:
        value, lines = parse(content)
        if not isinstance(value, dict):
            raise RuleError(
                (),
                "must be a mapping of keys",
                "the top level holds structure:, contacts:, study:, …",
                value,
                1,
            )
    except RuleError as fault:
        raise SceneError([source.problem(fault)]) from None
    return replace(source, data=value, lines=lines)


def parse(content: bytes | str) -> tuple[Any, dict[Key, int]]:
    """Plain data of one YAML document and the line of each key path in it.

    Raises:
        RuleError: what is wrong, with its line.
    """
    if len(content) > MAX_BYTES:
        raise RuleError(
            (),
            f"is larger than {MAX_BYTES // 1024**2} MB",
            "keep large matrices in a .npz, .mat or .mtx file",
        )
    reader = _Reader(_decoded(content) if isinstance(content, bytes) else content)
    try:
        return reader.document(), reader.lines
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        rule = " ".join(part for part in (error.context, error.problem) if part)
        hint = "use spaces, not tabs" if "'\\t'" in rule else ""
        raise RuleError((), f"is no YAML: {rule}", hint, line=mark.line + 1 if mark else None) from None
    except (YAMLError, ValueError) as error:
        raise RuleError((), f"is no YAML: {' '.join(str(error).split())}") from None


def _decoded(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise RuleError((), "is not UTF-8 text", "save the scene as UTF-8", line=line) from None


class _Reader:
    """Walks the events of one document; the nesting is bounded before anything recurses."""

    def __init__(self, text: str):
        self.events: Iterator[Any] = YAML(typ="safe", pure=True).parse(text)
        self.lines: dict[Key, int] = {(): 1}
        self.anchors: dict[str, tuple[Any, int]] = {}
        self.num_values = 0

    def document(self) -> Any:
        next(self.events)
        start = next(self.events)
        if not isinstance(start, DocumentStartEvent):
            raise RuleError((), "is empty", "a scene needs structure:, excitation: and study:", line=1)
        if start.version not in (None, (1, 2)):
            raise RuleError(
                (),
                f"is YAML {'.'.join(map(str, start.version))}",
                "write YAML 1.2, without a %YAML line",
                line=1,
            )
        value = self.value(next(self.events), ())
        next(self.events)
        if isinstance(following := next(self.events), DocumentStartEvent):
            raise RuleError((), "holds more than one document", "keep one scene a file", line=_line(following))
        return value

    def value(self, event: Any, key: Key) -> Any:
        if isinstance(event, AliasEvent):
            return self.alias(event, key)
        if event.tag is not None and event.tag != "!":
            raise RuleError(key, f"has the tag {event.tag}", "a scene has no tags", line=_line(event))
        if len(key) > MAX_DEPTH:
            raise RuleError(key[:4], f"is nested deeper than {MAX_DEPTH} levels", line=_line(event))
        before = self.num_values
        self.count(1, event)
        value = self.content(event, key)
        if event.anchor:
            self.anchors[event.anchor] = value, self.num_values - before
        return value

    def content(self, event: Any, key: Key) -> Any:
        if isinstance(event, MappingStartEvent):
            return self.mapping(key)
        if isinstance(event, SequenceStartEvent):
            return self.sequence(key)
        return scalar(event.value) if event.implicit[0] else event.value

    def mapping(self, key: Key) -> dict[str, Any]:
        found: dict[str, Any] = {}
        while not isinstance(event := next(self.events), MappingEndEvent):
            if not isinstance(event, ScalarEvent) or event.tag not in (None, "!"):
                raise RuleError(key, "has a key that is not plain text", line=_line(event))
            below = (*key, event.value)
            if event.value in found:
                raise RuleError(
                    below,
                    f"stands twice (first in line {self.lines[below]})",
                    "remove one",
                    line=_line(event),
                )
            self.lines[below] = _line(event)
            found[event.value] = self.value(next(self.events), below)
        return found

    def sequence(self, key: Key) -> list[Any]:
        found: list[Any] = []
        while not isinstance(event := next(self.events), SequenceEndEvent):
            below = (*key, len(found))
            self.lines[below] = _line(event)
            found.append(self.value(event, below))
        return found

    def alias(self, event: Any, key: Key) -> Any:
        if event.anchor not in self.anchors:
            raise RuleError(key, f"*{event.anchor} refers to no anchor that is complete before it", line=_line(event))
        value, size = self.anchors[event.anchor]
        self.count(size, event)
        return value

    def count(self, number: int, event: Any) -> None:
        self.num_values += number
        if self.num_values > MAX_VALUES:
            raise RuleError((), f"holds more than {MAX_VALUES} values, aliases written out", line=_line(event))


def _line(event: Any) -> int:
    return event.start_mark.line + 1


def scalar(text: str) -> Any:
    """Value of plain text in the core schema of YAML 1.2."""
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    if len(text) < 200 and (_INT.fullmatch(text) or _OTHER_BASE.fullmatch(text)):
        return int(text, 0) if _OTHER_BASE.fullmatch(text) else int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return float(text.replace(".", "")) if _SPECIAL.fullmatch(text) else text


def yaml_text(data: Mapping[str, Any]) -> str:
    """Plain data as YAML that `parse` reads back as it was; numbers keep every digit."""
    return "".join(_block(data, 0))


def _block(data: Any, indent: int) -> Iterator[str]:
    for key, value in data.items() if isinstance(data, Mapping) else ((None, item) for item in data):
        head = " " * indent + ("-" if key is None else f"{_text(key)}:")
        if not isinstance(value, Mapping | list | tuple) or not value or len(_flow(value)) < 100 - indent:
            yield f"{head} {_flow(value)}\n"
            continue
        first, *others = _block(value, indent + 2)
        yield f"{head} {first.lstrip()}" if key is None else f"{head}\n{first}"
        yield from others


def _flow(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_text(str(key))}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str):
        return _text(value)
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    return _special(value) if isinstance(value, float) and not np.isfinite(value) else str(value)


def _special(value: float) -> str:
    return ".nan" if np.isnan(value) else f"{'-' if value < 0 else ''}.inf"


def _text(text: str) -> str:
    if _PLAIN.fullmatch(text) and isinstance(scalar(text), str):
        return text
    return _UNPRINTABLE.sub(lambda found: f"\\U{ord(found[0]):08x}", json.dumps(text, ensure_ascii=False))
