"""What `timesim check` says of a scene: what would be modelled, what is left out, the method, warnings."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np
from pydantic import BaseModel

from timesim.fault import Problem
from timesim.hbm.scheme import NOTED
from timesim.model import cost
from timesim.model.contact_state import obeys_cone
from timesim.model.finding import contact_line, turning
from timesim.model.model import Model
from timesim.model.promise import PROMISE
from timesim.model.reduction import reduction_of
from timesim.model.solver import CLOSED_FORM, COMPANION, SHOOT, Solver, coarser
from timesim.result.label import counted, first_few, in_words
from timesim.scene.file import SceneFile
from timesim.scene.hbm import HbmPlan
from timesim.scene.resolution import Scene
from timesim.scene.study import SteadySection, StudySection, SweepPlan, SweepSection
from timesim.scene.text import value_text
from timesim.scene.transient import Schedule, TradeoffPlan

FAILING = 3  # sets of values without a scene that are named
LISTED = 6  # entries of a list that are all shown
LARGE_RESULT = 1.0  # gigabytes of samples
FASTER, NOTICED = 1.5, 3.0  # times, and seconds, from which on another way to settle is named
FEWEST_SAMPLES = 8  # of a cycle, between which its motion can be guessed
MOST_SAMPLES = 2**16  # of a period of a balance
STEPS_OF_WIDTH = 1.0  # widths of a resonance at half its power that a step may have
FAR_BELOW, FAR_ABOVE = 0.2, 100.0  # times the highest excitation frequency: a highest mode beyond is worth a warning
HEAVY = 0.15  # damping ratio above which a percentage is suspected


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
        report["cost"] = tuple(_cost_lines(scene, model))
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


def _cost_lines(scene: Scene, model: Model) -> Iterator[str]:
    """Roughly how long each phase of the study takes, and where the figures come from; empty if none is known."""
    study, plan, solver = scene.file.study, scene.plan, scene.solver()
    lines = []
    if isinstance(plan, Schedule):
        cycles = sum(cycles for _, cycles in plan.phases)
        total = cost.seconds(model, solver, cost.Work.of_run(plan.phases, estimated=False))
        lines.append(f"{counted(cycles, 'cycle')} of {_duration(total / cycles)}: {_duration(total)}")
    elif isinstance(study, SteadySection):
        sweep = study.sweep()
        cycles, own, beside, total = _sweep_cost(model, solver, sweep)
        each = f"{counted(cycles, 'cycle')} of {_duration(own)} and {_duration(beside)} beside them"
        lines.append(f"{counted(sweep.size, 'point')} of {each}: {_duration(total)}{study.search()}")
        shot = replace(sweep, criterion=replace(sweep.criterion, first_shot=SHOOT))
        fewer, _, _, less = _sweep_cost(model, solver, shot)
        if total > max(FASTER * less, NOTICED):
            why = "vibrations decay slowly; of several motions it may find another"
            few = f"{counted(fewer, 'cycle')} a point, Newton's method and {_duration(less)}"
            lines.append(f"{few} with study.periodic: shoot, as {why}")
    balance = _balance(plan)
    if balance is not None:
        curves = prod(map(len, balance.over.values())) * (1 + balance.both_ends)
        scheme, *finer = balance.schemes_for(model)
        if "harmonics" in balance.chosen:
            more = f", and up to {finer[-1].harmonics} harmonics where they are needed" if finer else ""
            yield f"{scheme}{more}; if those above make more than {NOTED:g} of the amplitude, the run says so"
        own = cost.seconds_a_solution(model, scheme.time_samples, stability=balance.stability)
        work = f"{cost.SOLUTIONS} solutions of {_duration(own)}"
        which = counted(curves, "curve")
        lines.append(f"{which} of harmonic balance of {work}: {_duration(curves * cost.SOLUTIONS * own)}")
    yield from (f"about {line}" for line in lines)
    if lines:
        yield "as measured on one core of a server (timesim/model/cost.py); a first run compiles before that"


def _sweep_cost(model: Model, solver: Solver, sweep: SweepPlan) -> tuple[int, float, float, float]:
    """The cycles that a point of a sweep marches, the seconds of one, those beside them, and those of all points.

    Cycles of Newton's method, and the one that is measured, take longer, by their derivatives.
    """
    whole = sweep.work(model)
    ((frequency, every),) = whole.phases
    cycles, own = round(every / sweep.size), cost.seconds_a_cycle(model, solver, frequency, whole.side_by_side)
    marched = int(min(cycles, sweep.criterion.first_shot))
    beside = cost.SETTLING + (1 + cycles - marched) * cost.seconds_a_derivative(model, solver, frequency)
    return marched, own, beside, sweep.size * (marched * own + beside)


def _balance(plan: Any) -> HbmPlan | None:
    """The harmonic balance that is the whole or a part of a study."""
    return plan if isinstance(plan, HbmPlan) else getattr(plan, "balance", None)


DURATIONS = (("h", 3600.0, 7200.0), ("min", 60.0, 120.0), ("s", 1.0, 1.0), ("ms", 1e-3, 1e-3), ("µs", 1e-6, 0.0))
"""Units of time: the seconds in one, and from how many seconds on it is used."""


def _duration(seconds: float) -> str:
    """A time with about two digits, in the unit that suits it."""
    unit, size = next((unit, size) for unit, size, least in DURATIONS if seconds >= least)
    number = seconds / size
    return f"{number:.{0 if number >= 10 else 1}f} {unit}"


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


# What is accepted but may not be intended


def warnings_of(scene: Scene) -> Iterator[str]:
    """What is accepted in a scene but may not be intended."""
    file = scene.file
    frequency = file.excitation.frequency if file.excitation else None
    if not file.study.requires:
        unused = ("structure", "excitation", "initial", *([] if file.study.uses_solver else ["solver"]))
        for key in (key for key in unused if key in scene.source.data):
            yield f"{key} is not used: in a study of kind {file.study.kind} the motion of the contact is given"
    elif frequency is not None and not file.study.uses_frequency:
        yield f"excitation.frequency is not used: in a study of kind {file.study.kind} its own frequencies rule"
    for contact in file.contacts:
        if contact.idle_stiffness and np.any(contact.stiffness_matrix()):
            yield f"contacts.{contact.name}.tangential_stiffness has no effect without friction"
    if not file.study.requires:
        return
    yield from _failing(scene)
    model = scene.model()
    yield from model.notes
    yield from _narrow(file.study, model)
    yield from _still_parts(file, model)
    yield from _large_numbers(file.study, scene.plan, model)
    highest = _highest_frequency(scene) * float(model.excitation.harmonic.max())
    ratio = float(model.structure.frequency[-1]) / highest if highest else 0.0
    if 0 < ratio < FAR_BELOW:
        far = f"the excitation reaches {highest:.6g} Hz, {1 / ratio:.3g} times the highest mode"
        yield f"{far}: frequencies are in Hz, and modes left out would answer there"
    if ratio > FAR_ABOVE and not hasattr(file.structure, "modes"):
        keep = max(1, int(np.sum(model.structure.frequency <= 20 * highest)))
        top = f"{model.structure.frequency[-1]:.6g} Hz, {ratio:.3g} times the excitation"
        reach = f"{model.structure.frequency[keep - 1]:.6g} Hz"
        advice = f"structure.keep_modes: {keep} would reach {reach}"
        yield f"the modes kept reach {top}, which costs steps; {advice}"


def _failing(scene: Scene) -> Iterator[str]:
    """Sets of values that make no scene; the others are computed all the same."""
    lost = [(values, found) for values, found in scene.tried if isinstance(found, Problem)]
    if lost:
        named = [f"{in_words(values)}: {problem.key} {problem.rule}" for values, problem in lost]
        few = "; ".join(first_few(named, FAILING, lambda left: f"and {left} more"))
        yield f"study.over: {len(lost)} of {len(scene.tried)} sets of values make no scene, and get no motion: {few}"


def _narrow(study: StudySection, model: Model) -> Iterator[str]:
    """Resonances, free or stuck, that the steps of a sweep may pass over."""
    if not isinstance(study, SweepSection):
        return
    swept = study.sweep().frequency
    zeta = np.nanmin(model.structure.damping_ratio, initial=np.inf)
    stuck = model.stuck_omega / (2 * np.pi) if obeys_cone(model).all() else np.zeros(0)
    natural = np.concatenate([model.structure.frequency, stuck])
    natural = natural[(natural > swept[0]) & (natural < swept[-1])]
    after = np.searchsorted(swept, natural)
    step, width = swept[after] - swept[after - 1], 2 * zeta * natural
    for place in np.flatnonzero(step > STEPS_OF_WIDTH * width)[:1]:
        peak = f"a resonance as at {natural[place]:.6g} Hz is {width[place]:.2g} Hz wide by its structural damping"
        yield f"study.frequency: {peak}; steps of {step[place]:.3g} Hz may miss its peak where no contact slips"


def _highest_frequency(scene: Scene) -> float:
    """Highest frequency of the time integration of a scene [Hz]; 0 where it has none."""
    study, plan = scene.file.study, scene.plan
    if isinstance(plan, Schedule):
        return max(frequency for frequency, _ in plan.phases)
    if isinstance(study, SteadySection):
        return float(study.sweep().frequency[-1])
    return plan.frequency if isinstance(plan, TradeoffPlan) else 0.0


def _large_numbers(study: StudySection, plan: Any, model: Model) -> Iterator[str]:
    structure = model.structure
    for mode in np.flatnonzero(structure.damping_ratio > HEAVY)[:1]:
        place, ratio = f"mode {mode + 1} at {structure.frequency[mode]:.6g} Hz", structure.damping_ratio[mode]
        so = "from 1 on it does not oscillate" if ratio > 1 - 1e-9 else f"that is {100 * ratio:.3g} % of critical"
        yield f"structure: damping ratio {ratio:.4g} of {place}: {so}; 1 % is 0.01"
    if isinstance(plan, Schedule):
        numbers = 6 * len(structure.points) + 2 * structure.num_modes + 8 * model.num_contacts
        gigabytes = 8e-9 * plan.num_samples * numbers
        if gigabytes > LARGE_RESULT:
            less = "a longer run_up" if hasattr(study, "run_up") else "record_last"
            advice = f"{less} or a smaller samples_per_cycle would do with less"
            yield f"study: {plan.num_samples} samples make a result of {gigabytes:.2g} GB; {advice}"
        if plan.samples_per_cycle < FEWEST_SAMPLES:
            so = "cycle_amplitude is that of the continuous motion all the same"
            yield f"study: {plan.samples_per_cycle} samples of a cycle show little of its motion; {so}"
    balance = _balance(plan)
    if balance is not None and balance.scheme.time_samples > MOST_SAMPLES:
        so = "each solution takes seconds; study.convergence tells how few are enough"
        yield f"study.time_samples: {balance.scheme.time_samples} samples of a period: {so}"


def _still_parts(file: SceneFile, model: Model) -> Iterator[str]:
    start, excitation = model.start, model.excitation
    if not any(np.any(part) for part in (excitation.cosine, excitation.sine, excitation.constant)):
        moving = np.any(start.displacement) or np.any(start.velocity) or np.any(start.slip)
        yield "no force acts" if moving else "no force acts and the start is at rest: nothing will move"
    if file.excitation is not None:
        yield from file.excitation.without_effect(model.structure)
    for contact, shape in zip(model.contacts, model.contact_shape, strict=True):
        if not np.any(shape):
            yield f"contacts.{contact.name} does not move in any mode"
    given = getattr(file.initial, "slip", {})
    for contact, slip in zip(model.contacts, start.slip, strict=True):
        if contact.name in given and not np.allclose(slip, given[contact.name], rtol=1e-8, atol=0.0):
            reason = "the contact starts separated or has no friction"
            yield f"initial.slip.{contact.name} has no effect: {reason}"
