"""The scene file as a tree of sections: which keys there are, what each allows, and what each is in numbers.

A section's ``build`` makes its part of `timesim.model.model`; rules that need another section (a point, the number
of modes) are looked after there and raise `RuleError`. Frequencies in Hz, angles in degrees, the rest in any
consistent system of units.

The sections of the studies are in `timesim.scene.studies`.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Strict, Tag, model_validator

from timesim.fault import RuleError, nearest
from timesim.model import model
from timesim.model.solver import PRESETS, Solver
from timesim.model.start import given_start, static_start
from timesim.result.state import ResultSection, from_result
from timesim.scene.contact import ContactSection
from timesim.scene.excitation import ExcitationSection
from timesim.scene.section import Count, Number, Pair, Section, Text, Whole, refuse
from timesim.scene.structure import StructureSection
from timesim.scene.studies import StudySection


class StateSection(Section):
    """A start from a given state; what is not given is 0."""

    modal_displacement: tuple[Number, ...] | None = None
    """One a mode, in the scene's order of modes."""
    modal_velocity: tuple[Number, ...] | None = None
    """One a mode, in the scene's order of modes."""
    slip: dict[Text, Pair] = Field(default_factory=dict)
    """w of each contact, by its name."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not self.model_fields_set:
            raise refuse(
                "must name modal_displacement, modal_velocity or slip",
                hint="for a start at rest: initial: rest",
            )
        return self

    def build(self, physics: model.Model, order: np.ndarray, folder: Path) -> model.Start:
        """The state in ascending order of the modes."""
        displacement, velocity = (self._sorted(key, order) for key in ("modal_displacement", "modal_velocity"))
        names = [contact.name for contact in physics.contacts]
        for name in self.slip:
            if name not in names:
                raise RuleError(("slip", name), "must be a contact", nearest(name, names))
        slip = np.array([self.slip.get(name, (0.0, 0.0)) for name in names]).reshape(-1, 2)
        return given_start(physics, displacement, velocity, slip)

    def _sorted(self, key: str, order: np.ndarray) -> np.ndarray:
        values = getattr(self, key)
        if values is None:
            return np.zeros(order.size)
        if len(values) != order.size:
            raise RuleError((key,), f"must have {order.size} entries, one a mode, not {len(values)}", value=values)
        return np.array(values)[order]


class InitialResult(ResultSection):
    """A start from the end of another run, or from a point of a sweep."""

    def build(self, physics: model.Model, order: np.ndarray, folder: Path) -> model.Start:
        """State, slip, contact states and phase there."""
        try:
            return from_result(physics, folder / self.source, self.at)
        except RuleError as error:
            raise (error if error.key else RuleError(("from",), error.rule, error.hint, self.source)) from None


def _initial_kind(value: Any) -> str | None:
    if isinstance(value, dict | Section):
        return "<from>" if isinstance(value, InitialResult) or "from" in dict(value) else "<state>"
    return "<name>" if isinstance(value, str) else None


InitialSection = Annotated[
    Annotated[Literal["rest", "static"], Tag("<name>")]
    | Annotated[StateSection, Tag("<state>")]
    | Annotated[InitialResult, Tag("<from>")],
    Discriminator(
        _initial_kind,
        custom_error_type="rule",
        custom_error_message="must be rest, static, a state, or a mapping with the key from",
    ),
]


# Solver

ADAPTIVE = ("tsit5", "dopri5", "dopri8", "kvaerno5")
METHODS = (*ADAPTIVE, "rk4")


def _solver_defaults(given: Any) -> Any:
    if not isinstance(given, dict):
        return given
    if "method" not in given:
        return {"accuracy": "standard", **given}
    if given["method"] == "rk4":
        return {"steps_per_cycle": 200, **given}
    rtol = given.get("rtol", 1e-8)
    return {"rtol": rtol, "atol": rtol / 100 if isinstance(rtol, float) and rtol > 1e-300 else 1e-10, **given}


class SolverSection(Section):
    """How the equations are integrated: an accuracy, or a method with its own numbers."""

    accuracy: Literal["draft", "standard", "reference"] | None = None
    """A preset; standard by default."""
    method: Literal["tsit5", "dopri5", "dopri8", "kvaerno5", "rk4"] | None = None
    """In place of an accuracy; kvaerno5 for stiff contacts, rk4 with fixed steps for comparison."""
    rtol: Annotated[Number, Field(ge=1e-15, lt=1)] | None = None
    """Tolerance of a step relative to the state, 1e-8 by default."""
    atol: Annotated[Number, Field(gt=0, lt=1)] | None = None
    """Absolute tolerance as a multiple of the scene's own scale, rtol/100 by default."""
    steps_per_cycle: Annotated[Whole, Field(ge=200)] | None = None
    """Fixed steps of rk4, 200 by default."""
    reduce: Annotated[bool, Strict()] = True
    """Leave out what the scene cannot need."""
    max_steps: Count = 100_000
    """Budget of steps of one cycle."""

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, given: Any) -> Any:
        return _solver_defaults(given)

    @model_validator(mode="after")
    def _together(self) -> Self:
        if self.accuracy and self.method:
            raise refuse("excludes accuracy", key=("method",), hint="give one of the two", value=self.method)
        allowed = {"rk4": ("steps_per_cycle",), None: ()}.get(self.method, ("rtol", "atol"))
        owners = {"rtol": ", ".join(ADAPTIVE), "atol": ", ".join(ADAPTIVE), "steps_per_cycle": "rk4"}
        for key, owner in owners.items():
            if getattr(self, key) is not None and key not in allowed:
                hint = f"here {'method is ' + self.method if self.method else 'an accuracy rules'}"
                raise refuse(f"goes with method {owner} only", key=(key,), hint=hint, value=getattr(self, key))
        return self

    def build(self) -> Solver:
        """The method in numbers."""
        if self.steps_per_cycle is not None:
            numbers = Solver("rk4", 1e-8, 1e-10, longest=2 * np.pi / self.steps_per_cycle)
        elif self.method is not None:
            assert self.rtol is not None
            assert self.atol is not None
            numbers = Solver(self.method, self.rtol, self.atol)
        else:
            numbers = PRESETS[str(self.accuracy)]
        return replace(numbers, budget=self.max_steps, reduce=self.reduce)


class SceneFile(Section):
    """A scene: what is modelled, and what is to be computed of it."""

    title: Text = ""
    structure: StructureSection | None = None
    contacts: tuple[ContactSection, ...] = ()
    excitation: ExcitationSection | None = None
    initial: InitialSection = "rest"
    solver: SolverSection = Field(default_factory=SolverSection)
    study: StudySection

    def start(self, physics: model.Model, order: np.ndarray, folder: Path) -> model.Start:
        """State at the start, modes in ascending order; ``order`` is the scene's index of each."""
        if self.initial == "rest":
            return physics.start
        if isinstance(self.initial, str):
            return static_start(physics)
        return self.initial.build(physics, order, folder)


def json_schema() -> dict[str, Any]:
    """JSON Schema of the scene file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_without_null(SceneFile.model_json_schema())}


def _without_null(part: Any) -> Any:
    """The same without the null that stands for an optional key, which a file leaves out."""
    if isinstance(part, list):
        return [_without_null(item) for item in part if item != {"type": "null"}]
    if not isinstance(part, dict):
        return part
    made = {key: _without_null(item) for key, item in part.items() if key != "default" or item is not None}
    (one,) = made.pop("anyOf") if len(made.get("anyOf", ())) == 1 else ({},)
    return made | one
