"""Whether data or a scene have changed, and in what."""

import hashlib
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from itertools import islice, zip_longest
from typing import Any

import numpy as np

from timesim.fault import RuleError
from timesim.scene.text import parse, value_text

LISTED = 4  # differences that a message names


def fingerprint(*values: Any) -> str:
    """Digest of data that is the same whenever the data are, in any process."""
    digest = hashlib.sha256()
    for part in _parts(values):
        digest.update(f"{len(part)}:".encode())
        digest.update(part)
    return digest.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    """Pickles alone depend on which parts of the data are one object."""
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        yield f"array {value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    elif is_dataclass(value) and not isinstance(value, type):
        yield f"{type(value).__qualname__} {len(fields(value))}".encode()
        for part in fields(value):
            yield from _parts(getattr(value, part.name))
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)}".encode()
        for item in value.items():
            yield from _parts(item)
    elif isinstance(value, list | tuple):
        yield f"items {len(value)}".encode()
        for item in value:
            yield from _parts(item)
    else:
        yield pickle.dumps(value, protocol=5)


def named_differences(before: str, now: str) -> str:
    """The first keys in which two scenes differ, with both values; of other text, the first lines."""
    try:
        old, new = (dict(_leaves(parse(text)[0])) for text in (before, now))
    except RuleError:
        old, new = {}, {}
    keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    if not keys:
        return first_difference(before.splitlines(), now.splitlines())
    told = [f"{key} was {old.get(key, 'not given')}, is {new.get(key, 'not given')}" for key in islice(keys, LISTED)]
    return "; ".join(told) + (f"; and {len(keys) - LISTED} more keys" if len(keys) > LISTED else "")


def _leaves(data: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Key path and value of all that a scene holds; items of a list go by their name, or by their number."""
    if isinstance(data, dict) or (isinstance(data, list) and any(isinstance(item, dict) for item in data)):
        items = data.items() if isinstance(data, dict) else ((_name(item, i), item) for i, item in enumerate(data))
        for part, item in items:
            yield from _leaves(item, f"{key}.{part}" if key else str(part))
    else:
        yield key, value_text(data)


def _name(item: Any, i: int) -> str:
    return str(item.get("name", i)) if isinstance(item, dict) else str(i)


def first_difference(before: list[str], now: list[str]) -> str:
    """The first items in which two lists differ."""
    pairs = zip_longest(before, now, fillvalue="nothing")
    return next((f"'{old}' was there, now '{new}'" for old, new in pairs if old != new), "its text")
