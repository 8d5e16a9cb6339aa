"""What of a scene would be modelled, what is left out and why, by which method, and what it takes."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from timesim.model import cost
from timesim.model.contact_state import obeys_cone
from timesim.model.finding import turning
from timesim.model.held import natural_modes
from timesim.model.model import CONE, GROUND, Contact, Model
from timesim.model.promise import PROMISE
from timesim.model.reduction import reduction_of
from timesim.model.solver import CLOSED_FORM, COMPANION, coarser
from timesim.result.label import BASE, attributes, counted, with_unit
from timesim.scene.report.cost import cost_lines
from timesim.scene.report.warning import asked_frequency, components, warnings_of
from timesim.scene.resolution import Scene
from timesim.scene.text import value_text
from timesim.scene.transient import Schedule, TradeoffPlan

LISTED = 6  # entries of a list that are all shown
ALIKE = 3  # contacts beside the first that are counted, not named, where the same is found of them
EPSILON = np.finfo(float).eps


def describe(scene: Scene) -> dict[str, tuple[str, ...]]:
    """What ``timesim check`` prints: what is modelled, what is left out and why, and warnings, lines by heading."""
    report = {"scene": tuple(_study_lines(scene))}
    if not scene.file.study.requires:
        report["contacts"] = tuple(contact_line(item.build(), scene.file.unit_names()) for item in scene.file.contacts)
    else:
        model = scene.model()
        report["structure"] = tuple(_structure_lines(model))
        report["contacts"] = tuple(contact_line(item, scene.file.unit_names()) for item in model.contacts) or ("none",)
        report["excitation"] = tuple(_excitation_lines(scene, model))
        report["accuracy"] = tuple(_accuracy_lines(scene, model))
        report["method"] = tuple(_method_lines(scene, model))
        report["left out or simplified"] = _left_out(scene, model)
        report["cost"] = tuple(cost_lines(scene, model))
    report["warnings"] = tuple(warnings_of(scene))
    return {heading: lines for heading, lines in report.items() if lines}


def _own_frequency(scene: Scene, model: Model) -> float | None:
    """The excitation's frequency [Hz]; None where the study sets it."""
    return model.excitation.frequency if scene.file.study.uses_frequency else None


def _left_out(scene: Scene, model: Model) -> tuple[str, ...]:
    if not scene.file.solver.reduce:
        return ("nothing: solver.reduce is false",)
    frequency = _own_frequency(scene, model)
    visited, units = [] if frequency is None else [frequency], scene.file.unit_names()
    findings = reduction_of(model, visited, units=units).findings
    return _together(findings, model) or ("nothing: every mode, contact and direction is needed",)


def _together(findings: Iterable[str], model: Model) -> tuple[str, ...]:
    """Findings, of many contacts of which the same is found one that counts the others."""
    alike, begins = dict[str, list[str]](), [f"contact {contact.name} " for contact in model.contacts]
    for line in findings:
        whose = max((words for words in begins if line.startswith(words)), key=len, default="")
        alike.setdefault(line.removeprefix(whose), []).append(whose)
    for rest, (first, *others) in list(alike.items()):
        if len(others) >= ALIKE:
            alike[rest] = [f"{first[:-1]}, and {len(others)} others alike, "]
    return tuple(whose + rest for rest, named in alike.items() for whose in named)


def _method_lines(scene: Scene, model: Model) -> Iterator[str]:
    """The method of time integration and why it was chosen; contacts that are hard for explicit methods."""
    own, frequency = _own_frequency(scene, model), asked_frequency(scene, model)
    if frequency is None:
        return
    if not isinstance(scene.plan, TradeoffPlan):
        solver, chosen = scene.solver(), scene.choice
        place = "" if own is not None else f" (at {frequency:g} Hz, the lowest, where it asks most)"
        steps = f"; stability asks about {cost.stable_steps(model, frequency):.3g} explicit steps a cycle{place}"
        why = "given" if chosen is None else chosen.why
        yield f"{solver.name}: {why}{'' if solver.name == CLOSED_FORM else steps}"
    if cost.slip_stiff(model, frequency):
        for contact, rate in zip(model.contacts, cost.stiff_rates(model, frequency), strict=True):
            if rate > 0:
                yield turning(contact, rate, rate / (cost.REACH * frequency))


def _accuracy_lines(scene: Scene, model: Model) -> Iterator[str]:
    """The promised error, the tolerances that keep it, and how the error is estimated."""
    if scene.promise is not None:
        end = "of the state at the end of the run" if isinstance(scene.plan, Schedule) else "of a steady state"
        numbers, least = scene.solver(), scene.file.solver.build()
        usual = numbers.rtol == least.rtol or not numbers.has_tolerance
        why = "" if usual else f" (most scenes do with rtol {least.rtol:g})"
        yield f"promises a relative error of {scene.promise:.0e} {end}, by {numbers}{why}"
    if isinstance(scene.plan, TradeoffPlan):
        plan = scene.plan
        own = ", ".join(f"{name} {plan.preset(name, model, scene.file.solver.max_steps)}" for name in PROMISE)
        yield f"methods and tolerances are tried for {plan.budget:g} s; of solver only max_steps is used"
        yield f"accuracies of this scene: {own}"
    if isinstance(scene.plan, Schedule) and scene.file.solver.estimate_error:
        coarse, way = coarser(scene.solver()), "the error at the end is estimated by"
        if coarse.name == CLOSED_FORM:
            yield f"{way} what rounding does to the natural frequencies"
        else:
            yield f"{way} a second run ({coarse}), {COMPANION:g} of the time of the first"


def contact_line(contact: Contact, units: Mapping[str, str]) -> str:
    """One contact in words: where, of what kind, its stiffness and its preload or gap, in units of the scene."""
    return f"{contact.name}: {', '.join(_contact_parts(contact, units))}"


def _contact_parts(contact: Contact, units: Mapping[str, str]) -> Iterator[str]:
    def size(name: str, number: str) -> str:
        return with_unit(number, attributes(name, units))

    if contact.point:
        yield f"{contact.point} against {'the ground' if contact.against == GROUND else contact.against}"
        yield f"normal {components(contact.frame[2])}"
    if contact.law != CONE:
        own = ", ".join(f"{key} {value:g}" for key, value in contact.law_parameters.items())
        yield f"law {contact.law}" + (f" ({own})" if own else "")
    if contact.friction == 0 and not np.any(contact.tangential_stiffness):
        yield "frictionless stop"
    else:
        (k11, k12), (k21, k22) = contact.tangential_stiffness
        diagonal = f"{k11:g}" if k11 == k22 else f"[{k11:g}, {k22:g}]"
        stiffness = diagonal if k12 == 0 else f"[[{k11:g}, {k12:g}], [{k21:g}, {k22:g}]]"
        yield f"friction {contact.friction:g}"
        yield f"tangential stiffness {size('normal_stiffness', stiffness)}"
    if contact.normal_stiffness == 0:
        yield f"constant normal load {size('preload', f'{contact.preload:g}')}"
        return
    yield f"normal stiffness {size('normal_stiffness', f'{contact.normal_stiffness:g}')}"
    if contact.preload < 0:
        yield f"gap {size('v', f'{-contact.preload / contact.normal_stiffness:g}')}"
    else:
        yield f"preload {size('preload', f'{contact.preload:g}')}"


def _structure_lines(model: Model) -> Iterator[str]:
    structure, frequency = model.structure, model.structure.frequency
    yield counted(frequency.size, "mode")
    yield from _natural_frequencies(model)
    if structure.damping.ndim == 2:
        yield "damping: a whole matrix, which the modes do not diagonalise"
    elif not np.any(structure.damping):
        yield "damping: none"
    elif not np.any(frequency):
        yield "damping: of free motions, of which there is no ratio"
    else:
        ratio = structure.damping_ratio[frequency > 0]
        low, high = ratio.min(), ratio.max()
        to = "" if np.isclose(low, high, rtol=1e-9) else f" to {high:.4g}"
        yield f"damping ratio {low:.4g}{to}{_of_held_body(model)}"
    yield f"points: {', '.join(structure.points)}"


def _of_held_body(model: Model) -> str:
    """What is left of the damping ratio of the modes in the lowest one of a body that contacts alone hold."""
    free, every = model.structure.omega, np.arange(model.num_contacts)
    least = np.sqrt(EPSILON) * free.max()
    if free.min() > least or not every.size or not obeys_cone(model).all():
        return ""
    omega, shape = natural_modes(model, np.arange(free.size), every)
    lowest = int(np.argmax(omega > least))
    assert shape is not None
    ratio = shape[:, lowest] @ model.structure.decays @ shape[:, lowest] / (2 * omega[lowest])
    own = f"{omega[lowest] / (2 * np.pi):.6g} Hz"
    return f", of rigid-body motions none: of the mode at {own} with every contact stuck it is {ratio:.2g}"


def _natural_frequencies(model: Model) -> Iterator[str]:
    """Without contacts, with those stuck that carry a preload, and with all of them closed and stuck."""
    free = model.structure.frequency
    # A stiffness below the rounding of the highest mode's is none.
    least = np.sqrt(EPSILON) * free.max()
    yield f"natural frequencies without contacts: {_listed(free, least)}"
    if not model.contacts or not obeys_cone(model).all():
        return
    loaded = np.flatnonzero(model.preload > 0)
    every = np.arange(model.num_contacts)
    if 0 < loaded.size < every.size:
        names = ", ".join(model.contacts[c].name for c in loaded)
        yield f"natural frequencies with what carries a preload stuck ({names}): {_stuck(model, loaded, least)}"
    how = "stuck" if loaded.size == every.size else "closed and stuck"
    yield f"natural frequencies with every contact {how}: {_stuck(model, every, least)}"


def _stuck(model: Model, contacts: np.ndarray, least: float) -> str:
    omega, _ = natural_modes(model, np.arange(model.structure.num_modes), contacts)
    return _listed(omega / (2 * np.pi), max(least, omega.size * EPSILON * omega.max()))


def _listed(frequency: np.ndarray, least: float) -> str:
    """Ascending frequencies [Hz], those up to the least a rigid body's, those between the first few and the last left
    out where there are many."""
    rigid = int(np.count_nonzero(frequency <= least))
    free = f"0 ({'rigid body' if rigid == 1 else f'{rigid} rigid-body motions'})"
    texts = [*([free] if rigid else []), *(f"{number:.6g}" for number in frequency[rigid:])]
    return ", ".join(texts if len(texts) <= LISTED else (*texts[: LISTED - 2], "…", texts[-1])) + " Hz"


def _excitation_lines(scene: Scene, model: Model) -> Iterator[str]:
    excitation, own = model.excitation, _own_frequency(scene, model)
    frequency = "set by the study" if own is None else f"{own:g} Hz"
    acting = np.any(excitation.cosine, axis=1) | np.any(excitation.sine, axis=1)
    harmonics = ", ".join(map(str, excitation.harmonic[acting])) or "none"
    yield f"frequency {frequency}, harmonics {harmonics}"
    if np.any(excitation.constant):
        yield "constant forces"


def _study_lines(scene: Scene) -> Iterator[str]:
    if scene.file.title:
        yield scene.file.title
    written, initial = scene.source.data, scene.file.initial
    if scene.file.units is not None:
        names = scene.file.unit_names()
        yield f"units: {_keys(scene.file.units, ())}{_mass(**names) if len(names) == len(BASE) else ''}, time s"
    yield f"study: {_keys(scene.file.study, ('kind', *written['study']))}"
    if extent := scene.file.study.extent():
        yield f"points: {extent}"
    if scene.file.study.uses_solver:
        yield f"solver: {_keys(scene.file.solver, written.get('solver', ()))}"
    if scene.file.study.requires:
        yield f"start: {initial if isinstance(initial, str) else _keys(initial, written['initial'])}"
    if varied := [str(place[-1]) for place in scene.file.study.varied()]:
        yield f"below stands what the scene itself gives for {', '.join(varied)}, which the study varies"


def _mass(length: str, force: str) -> str:
    """The unit of mass that goes with those of length and force: not that of the scale where these are N and mm."""
    name = {("m", "N"): "kg", ("mm", "N"): "t", ("m", "kN"): "t", ("mm", "kN"): "kt"}.get((length, force))
    return f", mass {force} s²/{length}" + (f" = {name}" if name else "")


def _keys(section: BaseModel, order: Iterable[str]) -> str:
    """The contents of a section that are not empty, first the keys that the scene names, in their order."""
    dumped = section.model_dump(by_alias=True, exclude_none=True)
    values = {key: value for key, value in dumped.items() if value not in ({}, [], ())}
    keys = dict.fromkeys([key for key in order if key in values] + list(values))
    return ", ".join(f"{key} {_brief(values[key])}" for key in keys)


def _brief(value: Any) -> str:
    """A value in YAML, without the middle of long lists."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_brief(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        items = [_brief(item) for item in (value if len(value) <= LISTED else (*value[:3], value[-1]))]
        return "[" + ", ".join(items if len(value) <= LISTED else (*items[:3], "…", items[3])) + "]"
    return value_text(value)
