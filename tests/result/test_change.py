"""Fingerprints of data, and the difference of two scenes in words."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from systems import oscillator

from timesim.result.change import fingerprint, scene_difference
from timesim.study.campaign import Chunk


def test_fingerprints_tell_data_apart_and_nothing_else():
    array = np.arange(4.0)
    same = [(array, array), (array, array.copy()), [np.arange(4.0), np.arange(4.0)]]
    assert len({fingerprint(pair) for pair in same}) == 1
    other = [(array, array.astype(int)), (array, array.reshape(2, 2)), (array,), (array, 0.0), (array, None)]
    found = [fingerprint(pair) for pair in (*other, (array, np.nextafter(array, 9)), same[0])]
    assert len(set(found)) == len(found)
    assert fingerprint({"a": ["b"]}) != fingerprint({"a": "b"})
    assert fingerprint("ab", "c") != fingerprint("a", "bc")
    assert fingerprint(1) != fingerprint(True) != fingerprint("True")


def test_what_has_no_text_is_refused():
    for value in (object(), np.array([{}]), {1, 2}, len):
        with pytest.raises(TypeError, match="no canonical text is known of"):
            fingerprint(value)


def varied(value: Any) -> Iterator[Any]:
    """The same data with one number, text or entry changed, in all places one after the other."""
    if is_dataclass(value) and not isinstance(value, type):
        for part in fields(value):
            for other in varied(getattr(value, part.name)):
                yield replace(value, **{part.name: other})
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            for other in varied(item):
                yield (*value[:i], other, *value[i + 1 :])
    elif isinstance(value, np.ndarray):
        for i in range(value.size):
            other = value.copy()
            other.flat[i] = np.nextafter(value.flat[i], np.inf) if value.dtype.kind == "f" else value.flat[i] + 1
            yield other
    elif isinstance(value, str | Path):
        yield type(value)(f"{value}'")
    else:
        yield "another" if value is None or isinstance(value, bool) else np.nextafter(value, np.inf)


def test_every_part_of_a_chunk_changes_its_fingerprint():
    chunk = Chunk("a", oscillator(3.0, 1.39), "b", 2)
    assert fingerprint(chunk) == fingerprint(Chunk("a", oscillator(3.0, 1.39), "b", 2))
    others = list(varied(chunk))
    assert len(others) > 30
    assert len({fingerprint(chunk), *map(fingerprint, others)}) == len(others) + 1


def test_a_difference_far_along_a_long_value_is_named():
    before, now = ([0.0] * 100, [0.0] * 99 + [1.0])
    change = scene_difference(f"study: {{values: {before}}}", f"study: {{values: {now}}}")
    assert change.startswith("study.values was [0.0, 0.0")
    assert len(change) < 200


def test_items_go_by_their_name_and_many_keys_are_counted():
    before = "contacts: [{name: pad, preload: 3, friction: 0.5}, {preload: 2}]\na: {b: 1, c: 2, d: 3}\n"
    now = "contacts: [{name: pad, preload: 4, friction: 0.5}, {preload: 1}]\na: {b: 2, c: 3, d: 4}\n"
    assert scene_difference(before, now) == (
        "contacts.pad.preload was 3, is 4; contacts.1.preload was 2, is 1; a.b was 1, is 2; a.c was 2, is 3; "
        "and 1 more keys"
    )
