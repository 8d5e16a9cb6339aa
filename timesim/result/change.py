"""Whether data or a scene have changed, and where."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from itertools import zip_longest
from pathlib import PurePath
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from timesim.result.label import WIDTH, counted, first_few, shortened

LISTED = 4  # differences that a message names


def fingerprint(*values: Any) -> str:
    """Digest of data by their canonical text: the same whenever the data are, in any process.

    Raises:
        TypeError: an object other than numbers, text, paths, arrays, sequences, mappings and dataclasses of these.
    """
    return hashlib.sha256(json.dumps(values, default=_canonical).encode()).hexdigest()


def _canonical(value: Any) -> Any:
    """How an object that JSON does not know is written in the canonical text."""
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        return ["array", value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()]
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__qualname__, {part.name: getattr(value, part.name) for part in fields(value)}]
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"no canonical text is known of a {type(value).__qualname__}")


def scene_difference(before: str, now: str) -> str:
    """The first keys in which two scenes differ, with both values; for text that is no scene, the first lines."""
    try:
        old, new = (dict(_leaves(YAML(typ="safe", pure=True).load(text))) for text in (before, now))
    except (YAMLError, ValueError, RecursionError):
        old, new = {}, {}
    keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    if not keys:
        return first_difference(before.splitlines(), now.splitlines())
    changes = [f"{key} was {_shown(old, key)}, is {_shown(new, key)}" for key in keys]
    return "; ".join(first_few(changes, LISTED, lambda left: f"and {counted(left, 'more key')}"))


def _leaves(data: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Key path and value of everything in a scene; items of a list go by their name or their number."""
    if isinstance(data, list) and any(isinstance(item, dict) for item in data):
        data = {str(item.get("name", i)) if isinstance(item, dict) else i: item for i, item in enumerate(data)}
    if isinstance(data, dict):
        for part, item in data.items():
            yield from _leaves(item, f"{key}.{part}" if key else str(part))
    else:
        yield key, data if isinstance(data, str) else json.dumps(data, default=str)


def _shown(leaves: Mapping[str, str], key: str) -> str:
    return shortened(leaves.get(key, "not given"), WIDTH)


def first_difference(before: list[str], now: list[str]) -> str:
    """The first items in which two lists differ."""
    pairs = zip_longest(before, now, fillvalue="nothing")
    return next((f"'{old}' was there, now '{new}'" for old, new in pairs if old != new), "its text")
