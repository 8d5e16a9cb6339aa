"""From a scene file to a scene that can be run: overrides, every problem with its place, the resolved text.

The sections themselves are in `timesim.scene.file`. Nothing here loads JAX.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from timesim.fault import Key, Problem, RuleError, SceneError
from timesim.model.model import Excitation, Model
from timesim.model.solver import Solver
from timesim.model.start import rest_start
from timesim.scene.axis import axis_values
from timesim.scene.file import SceneFile, json_schema
from timesim.scene.override import overridden
from timesim.scene.rule import NO_NUMBER, rule_errors
from timesim.scene.text import SceneSource, plain, read_file, read_text, yaml_text

__all__ = ["Scene", "json_schema", "load_scene"]

FAR_ABOVE = 100.0
"""Modes from matrices above this multiple of the highest excitation frequency are worth a warning."""


@dataclass(frozen=True)
class Scene:
    """A scene that has passed every check.

    Attributes:
        source: the text it comes from, with the overrides applied.
        file: the sections of the scene file.
    """

    source: SceneSource
    file: SceneFile

    @property
    def path(self) -> Path | None:
        """The scene file; None for a scene made in Python."""
        return Path(self.source.name) if self.source.lines and Path(self.source.name).is_file() else None

    def model(self) -> Model:
        """What is modelled, in numbers.

        Raises:
            SceneError: the scene has no structure, as that of a contact under prescribed motion.
        """
        if self._model is None:
            raise SceneError([self.source.problem(RuleError(("structure",), "is required for a model"))])
        return self._model

    def solver(self) -> Solver:
        """How it is integrated, in numbers."""
        return self.file.solver.build()

    @cached_property
    def _model(self) -> Model | None:
        build = _Build(self.file, self.source.folder)
        model = build.model()
        if build.errors:
            raise _scene_error(self.source, build.errors)
        return model

    def resolved_yaml(self) -> str:
        """The scene with overrides and defaults written out; runs from any folder."""
        return yaml_text(self._resolved.model_dump(by_alias=True, exclude_none=True))

    @property
    def _resolved(self) -> SceneFile:
        absolute = {}
        for key in ("structure", "initial", "study"):
            section = getattr(self.file, key)
            if hasattr(section, "absolute"):
                absolute[key] = section.absolute(self.source.folder)
        return self.file.model_copy(update=absolute)

    def with_overrides(self, overrides: Mapping[str, Any] | Sequence[str]) -> "Scene":
        """The same scene with other values; see `load_scene`."""
        return _scene(overridden(self.source, overrides))

    def variant(self, values: Mapping[str, float]) -> Model:
        """The model with other scalars, by key path as in a study's ``over``.

        Raises:
            SceneError: the scene cannot have these values.
        """
        return replace(self, source=overridden(self.source, values))._rebuilt()

    def _rebuilt(self) -> Model:
        try:
            file = SceneFile.model_validate(self.source.data)
        except ValidationError as error:
            raise _scene_error(self.source, rule_errors(error)) from None
        return Scene(self.source, file).model()

    def warnings(self) -> list[str]:
        """What is accepted but may not be meant."""
        return list(_warnings(self.file, self._model))


def load_scene(source: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | Sequence[str] = ()) -> Scene:
    """Read, check and build a scene.

    Args:
        source: path of a scene file, the text of one (of several lines), or the same as a mapping.
        overrides: new values by key path, ``{"contacts.pad.preload": 5}`` or ``["contacts.pad.preload=5"]``;
            items of a list go by their name or by their index from 0.

    Raises:
        SceneError: all that is wrong with the scene, each with file, line, key path, value and rule.
    """
    return _scene(overridden(_read(source), overrides))


def _read(source: str | Path | Mapping[str, Any]) -> SceneSource:
    if isinstance(source, Mapping):
        empty = SceneSource("scene", Path.cwd(), {})
        try:
            return replace(empty, data=plain(source))
        except RuleError as error:
            raise SceneError([empty.problem(error)]) from None
    if isinstance(source, str) and "\n" in source:
        return read_text(source, "scene", Path.cwd())
    return read_file(Path(source))


def _scene(source: SceneSource) -> Scene:
    empty = list(_empty_values(source.data))
    try:
        file = SceneFile.model_validate(source.data)
    except ValidationError as error:
        raise _scene_error(source, [*empty, *rule_errors(error)]) from None
    if empty:
        raise _scene_error(source, empty)
    scene = Scene(source, file)
    scene._model  # noqa: B018  builds it, which finds what the sections cannot see
    _check_over(scene)
    return scene


def _check_over(scene: Scene) -> None:
    """Each value of each axis must make a scene, the other axes left as they are."""
    problems, study = [], scene.file.study
    scalars = {("over", key): axis_values(given) for key, given in getattr(study, "over", {}).items()}
    scalars |= {("along", key): ends.values() for key, ends in getattr(study, "along", {}).items()}
    for (axis, key), values in scalars.items():
        for value in values:
            try:
                scene.variant({key: value})
            except SceneError as error:
                problems.append(scene.source.problem(_refused(error.problems[0], axis, key, value)))
                break
    if problems:
        raise SceneError(problems)


def _refused(own: Problem, axis: str, key: str, value: float) -> RuleError:
    """What a variant is refused for, said of the axis that has asked for it."""
    if own.key == key and own.rule in NO_NUMBER:
        return RuleError(("study", axis, key), "is no number of the scene")
    rule = own.rule if own.key == key else f"{own.key} {own.rule}"
    return RuleError(("study", axis, key), rule, own.hint, value)


def _scene_error(source: SceneSource, errors: Sequence[RuleError]) -> SceneError:
    """All problems in the order of the file, one a key."""
    first = {error.key: error for error in reversed(errors)}
    problems = [source.problem(error) for error in first.values()]
    return SceneError(sorted(problems, key=lambda problem: (problem.line or 0, problem.key)))


def _empty_values(data: Any, key: Key = ()) -> Iterator[RuleError]:
    if data is None:
        yield RuleError(key, "has no value", "give one, or leave the key out")
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for part, value in items:
        yield from _empty_values(value, (*key, part))


# What only the whole scene tells


class _Build:
    """Builds the parts of a model in their order and collects what is wrong with each."""

    def __init__(self, file: SceneFile, folder: Path):
        self.file, self.folder = file, folder
        self.errors: list[RuleError] = []

    @contextmanager
    def under(self, *key: str | int) -> Iterator[None]:
        try:
            yield
        except RuleError as error:
            self.errors.append(error.below(*key))

    def model(self) -> Model | None:
        self.check_study()
        self.check_names()
        if self.file.structure is None:
            return None
        self.check_points(self.file.structure.point_names)
        built = None
        with self.under("structure"):
            built = self.file.structure.build(self.folder)
        if built is None or self.errors:
            return None
        structure, order, notes = built
        excitation = _no_force(order.size)
        if self.file.excitation is not None:
            with self.under("excitation"):
                excitation = self.file.excitation.build(structure, order)
        contacts = tuple(contact.build() for contact in self.file.contacts)
        model = Model(structure, contacts, excitation, rest_start(order.size, len(contacts)), notes)
        with self.under("initial"):
            model = replace(model, start=self.file.start(model, order, self.folder))
        self.errors += self.file.study.fits(model)
        return model

    def check_study(self) -> None:
        study = self.file.study
        for key in study.requires:
            *above, last = key.split(".")
            parent = getattr(self.file, above[0]) if above else self.file
            if parent is not None and getattr(parent, last) is None:
                self.errors.append(RuleError((*above, last), f"is required for a {study.kind} study"))
        if study.explicit_only and self.file.solver.method == "kvaerno5":
            rule = f"must be an explicit method in an {study.kind} study"
            self.errors.append(RuleError(("solver", "method"), rule, "tsit5 or dopri8, or an accuracy", "kvaerno5"))
        self.errors += [error.below("study") for error in study.problems(self.file.contacts, self.folder)]

    def check_names(self) -> None:
        names = [contact.name for contact in self.file.contacts]
        for i, name in enumerate(names):
            with self.under("contacts", i):
                if name in names[:i]:
                    raise RuleError(("name",), "must differ from the other contacts'", value=name)

    def check_points(self, points: Sequence[str]) -> None:
        for i, contact in enumerate(self.file.contacts):
            with self.under("contacts", i):
                contact.check_points(points)
        if self.file.excitation is not None:
            self.errors += [error.below("excitation") for error in self.file.excitation.check_points(points)]


def _no_force(num_modes: int) -> Excitation:
    zero = np.zeros((1, num_modes))
    return Excitation(None, np.array([1]), zero, zero.copy(), zero[0].copy())


def _warnings(file: SceneFile, model: Model | None) -> Iterator[str]:
    frequency = file.excitation.frequency if file.excitation else None
    if frequency is not None and not file.study.uses_frequency:
        yield f"excitation.frequency is not used: the frequencies of the {file.study.kind} study rule"
    for contact in file.contacts:
        if contact.friction == 0 and np.any(contact.stiffness_matrix()):
            yield f"contacts.{contact.name}.tangential_stiffness has no effect without friction"
    if model is None:
        return
    yield from model.notes
    yield from _still_parts(file, model)
    highest = (frequency or 0.0) * model.excitation.harmonic.max()
    ratio = model.structure.frequency[-1] / highest if highest else 0.0
    if ratio > FAR_ABOVE and not hasattr(file.structure, "modes"):
        keep = max(1, int(np.sum(model.structure.frequency <= 20 * highest)))
        top = f"{model.structure.frequency[-1]:.6g} Hz, {ratio:.3g} times the excitation"
        reach = f"{model.structure.frequency[keep - 1]:.6g} Hz"
        advice = f"structure.keep_modes: {keep} would reach {reach}"
        yield f"the modes kept reach {top}, which costs steps; {advice}"


def _still_parts(file: SceneFile, model: Model) -> Iterator[str]:
    start, excitation = model.start, model.excitation
    if not any(np.any(part) for part in (excitation.cosine, excitation.sine, excitation.constant)):
        moving = np.any(start.displacement) or np.any(start.velocity) or np.any(start.slip)
        yield "no force acts" if moving else "no force acts and the start is at rest: nothing will move"
    for idle in file.excitation.without_effect(model.structure) if file.excitation else ():
        yield f"excitation.{'.'.join(map(str, idle.key))} {idle.rule}"
    for contact, shape in zip(model.contacts, model.contact_shape, strict=True):
        if not np.any(shape):
            yield f"contacts.{contact.name} does not move in any mode"
    given = getattr(file.initial, "slip", {})
    for contact, slip in zip(model.contacts, start.slip, strict=True):
        if contact.name in given and not np.array_equal(slip, given[contact.name]):
            reason = "the contact starts separated or has no friction"
            yield f"initial.slip.{contact.name} has no effect: {reason}"
