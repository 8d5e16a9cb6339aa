"""Errors in a scene: rules broken at a key of a section, and problems with file and line as a user reads them."""

import sys
import traceback
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

Key = tuple[str | int, ...]


class RuleError(Exception):
    """One thing wrong with a scene, at its key; `SceneSource.problem` turns it into a `Problem` with file and line.

    Attributes:
        key: path of the key, relative to the section that refuses it.
        rule: what is allowed.
        hint: what to do, or "".
        value: the value refused; None if there is none to show.
        line: line of the file where that is known better than by the key.
    """

    def __init__(self, key: Key, rule: str, hint: str = "", value: Any = None, line: int | None = None):
        super().__init__(rule)
        self.key, self.rule, self.hint, self.value, self.line = key, rule, hint, value, line

    def below(self, *prefix: str | int) -> "RuleError":
        """The same error, its key seen from the section above."""
        return RuleError((*prefix, *self.key), self.rule, self.hint, self.value, self.line)


FROM_SCENE = "paths start at the scene's folder"
"""A hint where a file that a scene names does not exist."""


@dataclass(frozen=True)
class Problem:
    """One thing wrong with a scene, as the user reads it.

    Attributes:
        file: the file, or what stands for it ("override", "scene").
        line: line of the file, from 1; None where there is no file.
        key: dotted path of the key, as ``--set`` writes it; "" for the whole file.
        value: the value refused, as text; None if there is none.
        rule, hint: as of `RuleError`.
    """

    file: str
    line: int | None
    key: str
    value: str | None
    rule: str
    hint: str = ""

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        parts = [place, self.key, self.value, self.rule]
        text = ": ".join(part for part in parts if part)
        text = f"{text} ({self.hint})" if self.hint else text
        return "".join(letter if letter.isprintable() else " " for letter in text)


class SceneError(Exception):
    """A scene that cannot be run. The message lists every problem, a line each.

    Attributes:
        problems: what is wrong, in the order of the file.
    """

    def __init__(self, problems: Sequence[Problem]):
        self.problems = list(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class SceneWarning(UserWarning):
    """What is accepted in a scene but may not be intended, or what its result is to be doubted for."""


def warn(message: str, category: type[Warning] = SceneWarning) -> None:
    """Warn, at the line outside this package that led here."""
    frame = sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in (__package__, "importlib"):
        frame = frame.f_back
    seen = frame.f_globals.setdefault("__warningregistry__", {})
    warnings.warn_explicit(message, category, frame.f_code.co_filename, frame.f_lineno, registry=seen)


def warn_of_run(message: str) -> None:
    """Warn of what a run meets, not of its scene."""
    warn(message, RuntimeWarning)


def meant(word: str, known: Collection[str]) -> str:
    """A hint: the known word that is meant; empty where none is near, for rules that list them all."""
    hint = nearest(word, known)
    return hint if hint.startswith("did") else ""


def nearest(word: str, known: Collection[str]) -> str:
    """A hint: the known word that is meant, or all of them."""
    last = [one for one in known if one.endswith(f".{word}")]  # contacts.pad.preload, of preload
    close = last or (get_close_matches(word, list(known), n=1, cutoff=0.6) if isinstance(word, str) else [])
    return f"did you mean {close[0]}?" if close else f"known: {', '.join(known) or 'none'}"


def unforeseen(error: Exception) -> str:
    """What a user reads of an error that no command expects."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if Path(frame.filename).is_relative_to(Path(__file__).parent)]
    place = f"{own[-1].filename}:{own[-1].lineno}"  # at least that of the command
    what = f"timesim has failed: {type(error).__name__}: {' '.join(str(error).split())} ({place})"
    reason = "unless a file was changed or memory is short, this is an error of timesim"
    return f"{what}\n{reason}; `python -X dev -m timesim` in place of `timesim` shows the calls that led to it"
