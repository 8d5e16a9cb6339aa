"""From a scene file to a scene that can be run: overrides, all problems with their places, the resolved text.

Nothing here loads JAX. The kinds of study are passed in as an argument.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from timesim.fault import Problem, RuleError, SceneError
from timesim.model.choice import Choice, choice
from timesim.model.cost import Work
from timesim.model.model import CONE, Contact, Excitation, Model, Structure
from timesim.model.promise import PROMISE
from timesim.model.scales import out_of_range
from timesim.model.solver import Solver
from timesim.model.start import rest_start
from timesim.result.change import fingerprint
from timesim.scene.file import NO_NUMBER, Kinds, SceneFile, SceneParts, parsed, rule_errors
from timesim.scene.hbm import balance_of
from timesim.scene.integration import EndOfRun, InitialResult, start
from timesim.scene.source import SceneSource, empty_values, overridden, read
from timesim.scene.structure import BuiltStructure, ExcitationSection, Files, FileSection
from timesim.scene.study import Context, SteadySection, combinations
from timesim.scene.text import yaml_text
from timesim.scene.transient import Schedule

NO_FORCE = ExcitationSection()


@dataclass(frozen=True)
class Scene:
    """A scene that has passed every check: its data with the overrides, its sections, the known kinds of study."""

    source: SceneSource
    file: SceneFile
    kinds: Kinds = field(repr=False)

    def __reduce__(self) -> tuple[Any, ...]:  # the type of a file is made anew in each process
        return _restored, (self.source, self.kinds, self._built)

    @property
    def kind(self) -> str:
        return self.file.study.kind

    @property
    def plan(self) -> Any:
        """What the study computes, in numbers: the frozen dataclass that its section builds."""
        return self._built.plan

    @property
    def promise(self) -> float | None:
        """Relative error that the accuracy promises; None if a method is given or nothing is integrated in time."""
        accuracy = self.file.solver.accuracy
        in_time = isinstance(self.plan, Schedule) or isinstance(self.file.study, SteadySection)
        return PROMISE[accuracy] if accuracy is not None and in_time else None

    @cached_property
    def choice(self) -> Choice | None:
        """The solver chosen for its accuracy, the same at all its points; None where `promise` is None."""
        accuracy, study = self.file.solver.accuracy, self.file.study
        if self.promise is None or accuracy is None:
            return None
        if isinstance(study, SteadySection):
            work = study.sweep().work(self.model())
        else:
            work = Work.of_run(self.plan.phases, estimated=self.file.solver.estimate_error)
        return choice(accuracy, self.model(), work, self.file.solver.max_steps, reduce=self.file.solver.reduce)

    def solver(self) -> Solver:
        """How it is integrated, in numbers; for an accuracy, those that keep its promise."""
        numbers = self.file.solver.build()
        if self.choice is None:
            return numbers
        own = self.choice.solver
        return replace(numbers, name=own.name, rtol=own.rtol, atol=own.atol)

    def model(self) -> Model:
        """What is modelled, in numbers.

        Raises:
            SceneError: the scene has no structure, as one of a contact under prescribed motion.
        """
        return self.variant({})

    def variant(self, values: Mapping[str, float]) -> Model:
        """The model with other scalars, by key path as in a study's ``over``.

        Only what depends on the sections that the keys lie in is built anew, the eigenproblem of a structure only for
        keys below ``structure``.

        Raises:
            SceneError: the scene cannot have these values, or it has no structure.
        """
        built = self._built
        if not values and built.model is not None:
            return built.model
        source, changed = overridden(self.source, values), {key.partition(".")[0] for key in values}
        sections = _sections(source, changed)
        file = self.file.model_copy(update={part: getattr(sections, part) for part in changed})
        build = _Build(file, source.folder, self._files, built, changed)
        structure = build.structure()
        model = build.model(structure, build.end())
        if structure is None and not build.errors:
            build.errors.append(RuleError(("structure",), "is required for a model"))
        if model is None or build.errors:
            raise source.error(build.errors)
        return model

    @cached_property
    def tried(self) -> tuple[tuple[dict[str, float], int | Problem], ...]:
        """All sets of values with which it has to be valid: how many modes each has, or why it is no scene."""
        axes = self.file.study.must_hold()
        return tuple((values, self._tried(values)) for values in (combinations(axes) if axes else ()))

    def _tried(self, values: Mapping[str, float]) -> int | Problem:
        try:
            return self.variant(values).structure.num_modes
        except SceneError as error:
            return error.problems[0]

    @cached_property
    def _files(self) -> Files:
        """Matrices that have been read; all variants have the same ones, even if a file changes meanwhile."""
        return {}

    @cached_property
    def _built(self) -> "_Built":
        build = _Build(self.file, self.source.folder, self._files)
        structure, end = build.structure(), build.end()
        plan, model = build.plan(structure), build.model(structure, end)
        if build.errors:
            raise self.source.error(build.errors)
        matrices = [matrices.data() for matrices in self._files.values()]
        data = fingerprint(matrices, None if end is None else end[1], *build.read)
        return _Built(plan, structure, end, model, self.file.study.lowest_frequency(), data)

    @property
    def data_fingerprint(self) -> str:
        """Digest of the matrices, states and motions read from other files, the same on any machine."""
        return self._built.data

    def resolved_yaml(self) -> str:
        """The scene with overrides and defaults written out; runs from any folder."""
        context = {"folder": self.source.folder}
        return yaml_text(self.file.model_dump(by_alias=True, exclude_none=True, context=context))

    def with_overrides(self, overrides: Mapping[str, Any] | Sequence[str]) -> "Scene":
        """The same scene with other values; see `load_scene`."""
        return _scene(overridden(self.source, overrides), self.kinds)


def load_scene(
    source: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | Sequence[str] = (), *, kinds: Kinds
) -> Scene:
    """Read, check and build a scene of one of these kinds of study; see `timesim.load_scene`."""
    return _scene(overridden(read(source), overrides), kinds)


def _scene(source: SceneSource, kinds: Kinds) -> Scene:
    file, refused = parsed(source.data, kinds)
    errors = [*empty_values(source.data), *refused]
    if file is None or errors:
        raise source.error(errors)
    scene = Scene(source, file, kinds)
    scene._built  # noqa: B018  shows what the sections alone cannot see
    source.check_axes(file.study.varied())
    _check_combinations(scene)
    if not any(str(place[-1]).startswith("structure.") for place in file.study.varied()):
        scene._files.clear()  # they may be large
    return scene


def check_parts(parts: Mapping[str, Any]) -> None:
    """Check parts of a scene by themselves, without the names of others that they use.

    Raises:
        SceneError: all that is wrong with them.
    """
    _sections(read(parts), parts)


def _sections(source: SceneSource, parts: Iterable[str]) -> SceneParts:
    """Some parts of a scene from its data; names of points and contacts are not looked up."""
    try:
        return SceneParts.model_validate({part: source.data[part] for part in parts})
    except ValidationError as error:
        raise source.error(rule_errors(error, SceneParts)) from None


def _restored(source: SceneSource, kinds: Kinds, built: "_Built") -> Scene:
    """A scene that another process has checked already."""
    file, _ = parsed(source.data, kinds)
    assert file is not None
    scene = Scene(source, file, kinds)
    scene.__dict__["_built"] = built
    return scene


def _check_combinations(scene: Scene) -> None:
    """Refuse values of which a combination makes no scene; where the study keeps failed points, of which none does."""
    study, valid = scene.file.study, [(values, found) for values, found in scene.tried if isinstance(found, int)]
    good = {item for values, _ in valid for item in values.items()}
    counts, motion = {found for _, found in valid}, getattr(balance_of(scene.plan), "motion", None)
    if motion is not None and valid:
        counts.add(motion.modal.shape[1])
    if len(counts) > 1 and (motion is not None or isinstance(study, SteadySection)):
        key = next(place for place in study.varied() if str(place[-1]).startswith("structure."))
        of = "each point has their state" if motion is None else f"study.start has {motion.modal.shape[1]}"
        rule, hint = f"must not change the number of modes, as {of}", "run a study for each number"
        raise scene.source.error([RuleError(("study", *key), rule, hint)])
    for values, found in scene.tried:
        if isinstance(found, Problem) and not (study.keeps_failures and good.issuperset(values.items())):
            raise scene.source.error([_refused(scene, values, found)])


def _refused(scene: Scene, values: Mapping[str, float], problem: Problem) -> RuleError:
    """Why a combination of values is refused: names the value that is refused on its own, or else all of them."""
    places = {place[-1]: ("study", *place) for place in scene.file.study.varied()}
    for key, value in values.items():
        try:
            scene.variant({key: value})
        except SceneError as error:
            own = error.problems[0]
            if own.key == key and own.rule in NO_NUMBER:
                return RuleError(places[key], "is no number of the scene", "vary a key whose value is one number")
            rule = own.rule if own.key == key else f"{own.key} {own.rule}"
            return RuleError(places[key], rule, own.hint, value)
    all_values = ", ".join(f"{key} = {value:g}" for key, value in values.items())
    rule = f"cannot hold {all_values} together: {problem.key} {problem.rule}"
    return RuleError(("study", "over"), rule, problem.hint)


# What needs more than one section


@dataclass(frozen=True)
class _Built:
    """A scene in numbers, None for what it lacks.

    `end` is what `initial` has read from another run, `lowest` the lowest frequency of the study [Hz], `data` the
    fingerprint of all that was read.
    """

    plan: Any
    structure: BuiltStructure | None
    end: EndOfRun | None
    model: Model | None
    lowest: float | None
    data: str


class _Build:
    """Builds what a scene file describes, and collects what is wrong with each part of it.

    ``files`` holds the matrices that have been read, ``known`` is the same but for the sections that have ``changed``.
    """

    def __init__(
        self, file: SceneFile, folder: Path, files: Files, known: _Built | None = None, changed: Collection[str] = ()
    ):
        self.file, self.folder, self.files, self.known, self.changed = file, folder, files, known, set(changed)
        self.errors: list[RuleError] = []
        self.read: list[Any] = []  # by the plan, from other files

    def unchanged(self, *parts: str) -> _Built | None:
        """What is known, if none of these sections has changed."""
        return None if self.changed.intersection(parts) else self.known

    @contextmanager
    def under(self, *key: str | int) -> Iterator[None]:
        try:
            yield
        except RuleError as error:
            self.errors.append(error.below(*key))

    def plan(self, structure: BuiltStructure | None) -> Any:
        study, contacts, method = self.file.study, self.file.contacts, self.file.solver.method
        if study.explicit_only and method in ("kvaerno5", "exponential"):
            rule = f"must be an explicit method in a study of kind {study.kind}"
            self.errors.append(RuleError(("solver", "method"), rule, "tsit5 or dopri8, or an accuracy", method))
        if (study.cone_only or self.file.initial == "static") and contacts and contacts[0].law_name != CONE:
            where = f"in a study of kind {study.kind}" if study.cone_only else "where initial is static"
            rule = f"must be {CONE} {where}"
            self.errors.append(RuleError(("contacts", 0, "law"), rule, value=contacts[0].law_name))
        frequency = self.file.excitation.frequency if self.file.excitation is not None else None
        with self.under("study"):
            num_modes = None if structure is None else structure[0].num_modes
            return study.plan(Context(contacts, frequency, self.folder, num_modes, self.read))

    def structure(self) -> BuiltStructure | None:
        if (known := self.unchanged("structure")) is not None:
            return known.structure
        section = self.file.structure
        with self.under("structure"):
            if isinstance(section, FileSection):
                return section.build(self.folder, self.files)
            return None if section is None else section.build()

    def end(self) -> EndOfRun | None:
        """What `initial` reads from another run."""
        if (known := self.unchanged("initial")) is not None:
            return known.end
        if not isinstance(self.file.initial, InitialResult):
            return None
        with self.under("initial"):
            return self.file.initial.read(self.folder)

    def contacts(self) -> tuple[Contact, ...]:
        if (known := self.unchanged("contacts")) is not None and known.model is not None:
            return known.model.contacts
        return tuple(contact.build() for contact in self.file.contacts)

    def excitation(self, structure: Structure, order: np.ndarray) -> Excitation | None:
        if (known := self.unchanged("structure", "excitation")) is not None and known.model is not None:
            return known.model.excitation
        with self.under("excitation"):
            return (self.file.excitation or NO_FORCE).build(structure, order)

    def model(self, built: BuiltStructure | None, end: EndOfRun | None) -> Model | None:
        """The model with its start; None without a structure."""
        if built is None:
            return None
        (structure, order, notes), initial = built, self.file.initial
        contacts, excitation = self.contacts(), self.excitation(structure, order)
        rest, driven = rest_start(order.size, len(contacts)), excitation or NO_FORCE.build(structure, order)
        model = Model(structure, contacts, driven, rest, notes)
        if excitation is not None:
            self.errors += self.file.study.problems(model)
        failed = {error.key[0] for error in self.errors}
        if "initial" in failed or (initial == "static" and "excitation" in failed):
            return model
        with self.under("initial"):
            model = replace(model, start=start(initial, model, order, end))
            if end is not None and isinstance(initial, InitialResult):
                more = initial.notes(model, end, self.file.unit_names())
                model = replace(model, notes=(*notes, *more))
        if not self.errors:
            study = self.file.study
            lowest = study.lowest_frequency() if self.known is None else self.known.lowest
            frequency = model.excitation.frequency if study.uses_frequency else lowest
            self.errors += out_of_range(model, frequency or structure.frequency[-1] or 1.0)
        return model
