"""The text of a scene: YAML 1.2 read into plain data, with the line of every key, and what is wrong with it.

Only the core schema of YAML 1.2 (chapter 10.3) is read: ``2e6`` is a number, ``on`` and ``yes`` are text. A
scene needs no tags, so they are refused; anchors may be used, within limits that a bomb of aliases exceeds.
"""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML, events
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from timesim.fault import Key, RuleError
from timesim.result.label import WIDTH, shortened

MAX_BYTES = 8 * 1024**2
MAX_DEPTH = 32
MAX_VALUES = 500_000
HUGE = 10**300
SPECIAL = {"NaN": ".nan", "Infinity": ".inf", "-Infinity": "-.inf"}
"""Numbers that JSON and YAML write differently."""

_NULL = re.compile(r"~|null|Null|NULL|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+")
_OTHER_BASE = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_/-]*(\.[A-Za-z0-9_/-]+)*")
_UNPRINTABLE = re.compile("[\x7f-\x9f\u2028\u2029\ud800-\udfff\ufeff\ufffe\uffff]")


def value_text(value: Any) -> str:
    """A value as YAML writes it, shortened to fit a message."""
    return shortened(flow(value), WIDTH)


def plain(value: Any, key: Key = ()) -> Any:
    """Data from Python as YAML would give them: arrays as lists, paths and keys as text.

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


_HINTS = {
    "'\\t'": "use spaces, not tabs",
    "expected <block end>": "keys of one mapping begin in one column, and so do the items of one list",
    "expected ':'": "a colon is missing here or in the line before",
}
"""What to try, by words of the YAML library's message."""


def parse(content: bytes | str) -> tuple[Any, dict[Key, int]]:
    """Plain data of one YAML document and the line of each key path in it; bytes, as of a file, are limited in number.

    Raises:
        RuleError: what is wrong, with its line.
    """
    if isinstance(content, bytes) and len(content) > MAX_BYTES:
        hint = "keep large matrices in a .npz, .mat or .mtx file"
        raise RuleError((), f"is larger than {MAX_BYTES // 1024**2} MB", hint)
    reader = _Reader(_decoded(content) if isinstance(content, bytes) else content)
    try:
        return reader.document(), reader.lines
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        rule = " ".join(part for part in (error.context, error.problem) if part)
        hint = next((hint for words, hint in _HINTS.items() if words in rule), "")
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
    """Reads one document from the parser events of ruamel.

    ruamel's round-trip loader knows lines too. But it reports neither a tag on a plain scalar nor the key path of a
    duplicate key, it reads 1_0 as a number and 2001-01-01 as a date, which the core schema does not, and it recurses
    through nested text and aliases before their depth and size can be bounded.
    """

    def __init__(self, text: str):
        self.events: Iterator[Any] = YAML(typ="safe", pure=True).parse(text)
        self.lines: dict[Key, int] = {(): 1}
        self.anchors: dict[str, tuple[Any, int]] = {}
        self.num_values = 0
        self.most = max(MAX_VALUES, len(text))  # each value takes a letter: more of them are aliases

    def document(self) -> Any:
        next(self.events)
        start = next(self.events)
        if not isinstance(start, events.DocumentStartEvent):
            raise RuleError((), "is empty", "a scene needs structure:, excitation: and study:", line=1)
        if start.version not in (None, (1, 2)):
            version = ".".join(map(str, start.version))
            raise RuleError((), f"is YAML {version}", "write YAML 1.2, without a %YAML line", line=1)
        value = self.value(next(self.events), ())
        next(self.events)
        if isinstance(following := next(self.events), events.DocumentStartEvent):
            raise RuleError((), "holds more than one document", "keep one scene a file", line=_line(following))
        return value

    def value(self, event: Any, key: Key) -> Any:
        value: Any
        if isinstance(event, events.AliasEvent):
            return self.alias(event, key)
        if event.tag is not None and event.tag != "!":
            raise RuleError(key, f"has the tag {event.tag}", "a scene has no tags", line=_line(event))
        if len(key) > MAX_DEPTH:
            raise RuleError(key[:4], f"is nested deeper than {MAX_DEPTH} levels", line=_line(event))
        before = self.num_values
        self.count(1, event)
        if isinstance(event, events.MappingStartEvent):
            value = self.mapping(key)
        elif isinstance(event, events.SequenceStartEvent):
            value = self.sequence(key)
        else:
            value = scalar(event.value) if event.implicit[0] else event.value
        if event.anchor:
            self.anchors[event.anchor] = value, self.num_values - before
        return value

    def mapping(self, key: Key) -> dict[str, Any]:
        values: dict[str, Any] = {}
        while not isinstance(event := next(self.events), events.MappingEndEvent):
            if not isinstance(event, events.ScalarEvent) or event.tag not in (None, "!"):
                raise RuleError(key, "has a key that is not plain text", line=_line(event))
            below = (*key, event.value)
            if event.value == "<<" and event.implicit[0]:
                hint = "write its keys out; an alias stands for a whole value"
                raise RuleError(below, "is a merge key, which YAML 1.2 has not", hint, line=_line(event))
            if event.value in values:
                rule = f"stands twice (first in line {self.lines[below]})"
                raise RuleError(below, rule, "remove one", line=_line(event))
            self.lines[below] = _line(event)
            values[event.value] = self.value(next(self.events), below)
        return values

    def sequence(self, key: Key) -> list[Any]:
        values: list[Any] = []
        while not isinstance(event := next(self.events), events.SequenceEndEvent):
            below = (*key, len(values))
            self.lines[below] = _line(event)
            values.append(self.value(event, below))
        return values

    def alias(self, event: Any, key: Key) -> Any:
        if event.anchor not in self.anchors:
            raise RuleError(key, f"*{event.anchor} refers to no anchor that is complete before it", line=_line(event))
        value, size = self.anchors[event.anchor]
        self.count(size, event)
        return value

    def count(self, number: int, event: Any) -> None:
        self.num_values += number
        if self.num_values > self.most:
            raise RuleError((), f"holds more than {self.most} values, aliases written out", line=_line(event))


def _line(event: Any) -> int:
    return event.start_mark.line + 1


def scalar(text: str) -> Any:
    """The value of a plain scalar in the core schema of YAML 1.2."""
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
    """Plain data as YAML from which `parse` restores them exactly; numbers keep every digit."""
    return "".join(_block(data, 0))


def _block(data: Any, indent: int) -> Iterator[str]:
    for key, value in data.items() if isinstance(data, Mapping) else ((None, item) for item in data):
        head = " " * indent + ("-" if key is None else f"{_text(key)}:")
        if not isinstance(value, Mapping | list | tuple) or not value or len(flow(value)) < 100 - indent:
            yield f"{head} {flow(value)}\n"
            continue
        first, *others = _block(value, indent + 2)
        yield f"{head} {first.lstrip()}" if key is None else f"{head}\n{first}"
        yield from others


def flow(value: Any) -> str:
    """A value as YAML writes it in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_text(str(key))}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, str):
        return _text(value)
    text = json.dumps(value, default=str)
    return SPECIAL.get(text, text)


def _text(text: str) -> str:
    if _PLAIN.fullmatch(text) and isinstance(scalar(text), str):
        return text
    return _UNPRINTABLE.sub(lambda match: f"\\U{ord(match[0]):08x}", json.dumps(text, ensure_ascii=False))
