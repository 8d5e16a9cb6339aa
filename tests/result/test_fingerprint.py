"""Fingerprints of data, and the difference of two scenes in words."""

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pytest

from timesim.result.change import fingerprint, scene_difference


@dataclass(frozen=True)
class One:
    value: float


@dataclass(frozen=True)
class Other:
    value: float


def test_fingerprints_differ_where_data_differ_and_nowhere_else():
    array = np.arange(4.0)
    same = [(array, array), (array, array.copy()), [np.arange(4.0), np.arange(4.0)]]
    assert len({fingerprint(pair) for pair in same}) == 1
    other = [(array, array.astype(int)), (array, array.reshape(2, 2)), (array,), (array, 0.0), (array, None)]
    found = [fingerprint(pair) for pair in (*other, (array, np.nextafter(array, 9)), same[0])]
    assert len(set(found)) == len(found)
    assert fingerprint(np.zeros(2)) != fingerprint(np.zeros(2, dtype=int))
    assert fingerprint(One(1.0)) == fingerprint(One(1.0)) != fingerprint(Other(1.0))
    mapped = [fingerprint(MappingProxyType({"a": value})) for value in (1, 1, 2)]
    assert mapped[0] == mapped[1] != mapped[2]
    assert fingerprint({"a": ["b"]}) != fingerprint({"a": "b"})
    assert fingerprint("ab", "c") != fingerprint("a", "bc")
    assert fingerprint(1) != fingerprint(True) != fingerprint("True")


def test_what_has_no_text_is_refused():
    for value in (object(), np.array([{}]), {1, 2}, len):
        with pytest.raises(TypeError, match="no canonical text is known of"):
            fingerprint(value)


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
        "and 1 more key"
    )
