"""Sections that say how a run is integrated: from which state, and by which method."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, Tag, model_validator

from timesim.fault import RuleError
from timesim.model.model import Model, Start
from timesim.model.solver import PRESETS, Solver
from timesim.model.start import given_start, static_start
from timesim.result.label import counted
from timesim.result.state import SavedStates, saved_states, start_notes, start_of
from timesim.scene.section import AsNumber, AsText, Section, by_form, form, refuse
from timesim.scene.value import ContactName, Count, FilePath, Number, Pair, Switch, Text, Whole


class StateSection(Section):
    """A start from a given state; what is not given is 0."""

    modal_displacement: tuple[Number, ...] | None = None
    """One a mode, in the scene's order of modes."""
    modal_velocity: tuple[Number, ...] | None = None
    """One a mode, in the scene's order of modes."""
    slip: dict[ContactName, Pair] = Field(default_factory=dict)
    """w of each contact, by its name."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not self.model_fields_set:
            hint = "for a start at rest: initial: rest"
            raise refuse("must name modal_displacement, modal_velocity or slip", hint=hint)
        return self

    def build(self, physics: Model, order: np.ndarray) -> Start:
        """The state, modes in ascending order; ``order`` is the scene's index of each."""
        displacement, velocity = (self._sorted(key, order) for key in ("modal_displacement", "modal_velocity"))
        slip = np.array([self.slip.get(contact.name, (0.0, 0.0)) for contact in physics.contacts]).reshape(-1, 2)
        return given_start(physics, displacement, velocity, slip)

    def _sorted(self, key: str, order: np.ndarray) -> np.ndarray:
        values = getattr(self, key)
        if values is None:
            return np.zeros(order.size)
        if len(values) != order.size:
            count = counted(order.size, "entry", "entries")
            raise RuleError((key,), f"must have {count}, one a mode, not {len(values)}", value=values)
        return np.array(values)[order]


NumberOrText = Annotated[AsNumber[Number] | AsText[Text], by_form("a number or text")]


class ResultSection(Section):
    """The motion at the end of another run, or at a point of a sweep."""

    source: FilePath = Field(alias="from")
    """Path of its result.nc, relative to the scene."""
    at: dict[Text, NumberOrText] = Field(default_factory=dict)
    """Which point of a sweep, by its axes: {frequency: 0.945, direction: up, contacts.pad.preload: -4}."""

    def refused(self, rule: str, hint: str = "") -> RuleError:
        """Why the result cannot be used, the key relative to the section."""
        return RuleError(("from",), rule, hint, self.source)


EndOfRun = tuple[SavedStates, Mapping[str, np.ndarray]]
"""The states of a result, and the arrays of the one that a run starts from."""


class InitialResult(ResultSection):
    """A start from the end of another run, or from a point of a sweep."""

    def read(self, folder: Path) -> EndOfRun:
        """State, slip, contact states and phase there."""
        try:
            states = saved_states(folder / self.source)
        except RuleError as error:
            raise self.refused(error.rule, error.hint) from None
        try:
            return states, states.one(self.at)
        except RuleError as error:
            raise error.below("at") from None

    def build(self, physics: Model, end: EndOfRun) -> Start:
        """The start of a model from that state."""
        try:
            return start_of(physics, *end)
        except RuleError as error:
            raise self.refused(error.rule, error.hint) from None

    def notes(self, physics: Model, end: EndOfRun, units: Mapping[str, str]) -> tuple[str, ...]:
        """Warnings of a start of a model in these units from that state."""
        return tuple(f"initial.from: {note}" for note in start_notes(physics, *end, units))


def _initial_form(value: Any) -> str | None:
    if form(value) == "<mapping>":
        return "<from>" if isinstance(value, InitialResult) or "from" in dict(value) else "<state>"
    return form(value)


InitialSection = Annotated[
    AsText[Literal["rest", "static"]]
    | Annotated[StateSection, Tag("<state>")]
    | Annotated[InitialResult, Tag("<from>")],
    by_form("rest, static, a state, or a mapping with the key from", _initial_form),
]


def start(initial: InitialSection, physics: Model, order: np.ndarray, end: EndOfRun | None) -> Start:
    """State at the start of a model at rest.

    ``order``: the scene's index of each mode; ``end``: what the section has read, where it starts from a result.
    """
    if isinstance(initial, StateSection):
        return initial.build(physics, order)
    if isinstance(initial, InitialResult):
        assert end is not None
        return initial.build(physics, end)
    return physics.start if initial == "rest" else static_start(physics)


ADAPTIVE = ("exponential", "tsit5", "dopri5", "dopri8", "kvaerno5")


class SolverSection(Section):
    """How the equations are integrated: an accuracy, or a method with its own numbers."""

    accuracy: Literal["draft", "standard", "reference"] | None = None
    """A preset; standard by default."""
    method: Literal["auto", "exponential", "tsit5", "dopri5", "dopri8", "kvaerno5", "rk4"] | None = None
    """auto, the default, goes with an accuracy: the fastest method for the scene. The others replace an accuracy; rk4
    has fixed steps and is there for comparison."""
    rtol: Annotated[Number, Field(ge=1e-15, lt=1)] | None = None
    """Tolerance of a step relative to the state, 1e-8 by default."""
    atol: Annotated[Number, Field(gt=0, lt=1)] | None = None
    """Absolute tolerance as a multiple of the scene's own scale, rtol/100 by default."""
    steps_per_cycle: Annotated[Whole, Field(ge=200)] | None = None
    """Fixed steps of rk4, 200 by default."""
    reduce: Switch = True
    """Leave out what cannot matter in the scene."""
    estimate_error: Switch = True
    """Estimate the error of a transient or a jump by a second, coarser run, which adds 0.6 of its time."""
    max_steps: Count = 100_000
    """Most steps of one cycle."""

    @model_validator(mode="after")
    def _together(self) -> Self:
        chosen = self.method in (None, "auto")
        if self.accuracy and not chosen:
            hint = "give one of the two, or method: auto"
            raise refuse("excludes accuracy", key=("method",), hint=hint, value=self.method)
        owners = {"rtol": ADAPTIVE, "atol": ADAPTIVE, "steps_per_cycle": ("rk4",)}
        for key, methods in owners.items():
            if (value := getattr(self, key)) is not None and self.method not in methods:
                hint = "here an accuracy rules" if chosen else f"here method is {self.method}"
                raise refuse(f"goes with method {', '.join(methods)} only", key=(key,), hint=hint, value=value)
        if chosen:
            return self.completed(accuracy="standard", method="auto")
        if self.method == "rk4":
            return self.completed(steps_per_cycle=200)
        rtol = self.rtol or 1e-8
        return self.completed(rtol=rtol, atol=rtol / 100)

    def build(self) -> Solver:
        """The method in numbers; where an accuracy is given, the numbers that suit an easy scene."""
        if self.steps_per_cycle is not None:
            numbers = Solver("rk4", 1e-8, 1e-10, longest=2 * np.pi / self.steps_per_cycle)
        elif self.accuracy is None:
            assert self.method is not None
            assert self.rtol is not None
            assert self.atol is not None
            numbers = Solver(self.method, self.rtol, self.atol)
        else:
            numbers = PRESETS[str(self.accuracy)]
        return replace(numbers, budget=self.max_steps, reduce=self.reduce)
