"""What of a scene would be modelled, what is left out and why, by which method, and what it takes."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from timesim.model import cost
from timesim.model.contact_state import obeys_cone
from timesim.model.finding import contact_line, turning
from timesim.model.model import Model
from timesim.model.promise import PROMISE
from timesim.model.reduction import reduction_of
from timesim.model.solver import CLOSED_FORM, COMPANION, coarser
from timesim.result.label import counted
from timesim.scene.report.cost import cost_lines
from timesim.scene.report.warning import warnings_of
from timesim.scene.resolution import Scene
from timesim.scene.text import value_text
from timesim.scene.transient import Schedule, TradeoffPlan

LISTED = 6  # entries of a list that are all shown


def describe(scene: Scene) -> dict[str, tuple[str, ...]]:
    """What ``timesim check`` prints: what is modelled, what is left out and why, and warnings, lines by heading."""
    report = {"scene": tuple(_study_lines(scene))}
    if not scene.file.study.requires:
        report["contacts"] = tuple(contact_line(item.build()) for item in scene.file.contacts)
    else:
        model = scene.model()
        report["structure"] = tuple(_structure_lines(model))
        report["contacts"] = tuple(map(contact_line, model.contacts)) or ("none",)
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
    findings = reduction_of(model, [] if frequency is None else [frequency]).findings
    return findings or ("nothing: every mode, contact and direction is needed",)


def _method_lines(scene: Scene, model: Model) -> Iterator[str]:
    """The method of time integration and why it was chosen; contacts that are hard for explicit methods."""
    own = _own_frequency(scene, model)
    frequency = scene.file.study.lowest_frequency() if own is None else own
    if frequency is None:
        return
    if not isinstance(scene.plan, TradeoffPlan):
        solver, chosen = scene.solver(), scene.choice
        place = "" if own is not None else f" (at {frequency:g} Hz, the lowest, where it asks most)"
        steps = f"; stability asks about {cost.stable_steps(model, frequency):.3g} explicit steps a cycle{place}"
        why = "given" if chosen is None else chosen.why
        yield f"{solver.name}: {why}{'' if solver.name == CLOSED_FORM else steps}"
    if cost.slip_stiff(model, frequency):
        for contact, rate in zip(model.contacts, cost.slip_rates(model, frequency), strict=True):
            if rate > 0 and contact.friction <= cost.LITTLE_FRICTION:
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


def _structure_lines(model: Model) -> Iterator[str]:
    structure, frequency = model.structure, model.structure.frequency
    span = f"{frequency[0]:.6g} Hz" if frequency.size == 1 else f"{frequency[0]:.6g} to {frequency[-1]:.6g} Hz"
    yield f"{counted(frequency.size, 'mode')}, {span}"
    yield f"natural frequencies without contacts: {_listed(frequency)} Hz"
    if model.contacts and obeys_cone(model).all():
        yield f"natural frequencies with every contact stuck: {_listed(model.stuck_omega / (2 * np.pi))} Hz"
    if structure.damping.ndim == 2:
        yield "damping: a whole matrix, which the modes do not diagonalise"
    elif not np.any(structure.damping):
        yield "damping: none"
    elif not np.any(frequency):
        yield "damping: of free motions, of which there is no ratio"
    else:
        ratio = structure.damping_ratio[frequency > 0]
        low, high = ratio.min(), ratio.max()
        yield f"damping ratio {low:.4g}" + ("" if np.isclose(low, high, rtol=1e-9) else f" to {high:.4g}")
    yield f"points: {', '.join(structure.points)}"


def _listed(numbers: np.ndarray) -> str:
    """Ascending numbers, those between the first few and the last left out where there are many."""
    texts = [f"{number:.6g}" for number in numbers]
    return ", ".join(texts if len(texts) <= LISTED else (*texts[: LISTED - 2], "…", texts[-1]))


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
        yield f"units: {_keys(scene.file.units, ())}"
    yield f"study: {_keys(scene.file.study, ('kind', *written['study']))}"
    if extent := scene.file.study.extent():
        yield f"points: {extent}"
    if scene.file.study.uses_solver:
        yield f"solver: {_keys(scene.file.solver, written.get('solver', ()))}"
    if scene.file.study.requires:
        yield f"start: {initial if isinstance(initial, str) else _keys(initial, written['initial'])}"


def _keys(section: BaseModel, order: Iterable[str]) -> str:
    """The contents of a section, first the keys that the scene names, in their order."""
    values = section.model_dump(by_alias=True, exclude_none=True)
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
