"""Arguments of the functions that a user calls, as what they must be."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from timesim.result.label import WIDTH, shortened


def shown(value: Any) -> str:
    """A value as Python writes it, shortened to fit a message."""
    return shortened(" ".join(repr(value).split()), WIDTH)


def path_of(name: str, value: Any, rule: str) -> Path:
    """The argument as a path; `rule`: what it must be."""
    if not isinstance(value, str | os.PathLike):
        raise ValueError(f"{name} must be {rule}, not {shown(value)}")
    return Path(value)


def list_of(name: str, value: Any, rule: str) -> list[Any]:
    """The argument as a list, of the items of any iterable that is neither text nor a mapping."""
    try:  # an array of no dimensions, or a sparse matrix, counts as iterable and is not
        if not isinstance(value, Mapping | str | bytes):
            return list(value)
    except TypeError:
        pass
    raise ValueError(f"{name} must be {rule}, not {shown(value)}")


def mapping_of(name: str, value: Any, rule: str) -> dict[str, Any]:
    """The argument as a dictionary with names as keys."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be {rule}, not {shown(value)}")
    for key in value:
        if not isinstance(key, str):
            raise ValueError(f"{name} has the key {key!r}, it must be text: {str(key)!r}")
    return dict(value)
