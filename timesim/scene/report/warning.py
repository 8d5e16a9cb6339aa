"""What is accepted in a scene but may not be intended."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from timesim.fault import Problem
from timesim.model.contact_state import obeys_cone
from timesim.model.cost import EXPLICIT, SLIPPING, seconds_a_cycle, slip_steps, stable_steps
from timesim.model.held import damped_modes, springs
from timesim.model.model import Model
from timesim.model.promise import rounded
from timesim.model.reduction import distant_stops, reduction_of
from timesim.result.label import attributes, counted, first_few, in_words, with_unit
from timesim.scene.contact import ContactSection
from timesim.scene.file import SceneFile
from timesim.scene.hbm import HbmPlan, balance_of
from timesim.scene.integration import SolverSection
from timesim.scene.report.cost import duration, sweep_cost
from timesim.scene.resolution import Scene
from timesim.scene.study import SteadySection, StudySection, SweepSection
from timesim.scene.sweep import Optimum
from timesim.scene.transient import Schedule, TradeoffPlan
from timesim.scene.value import unit

FAILING = 3  # sets of values without a scene that are named
LARGE_RESULT = 1.0  # gigabytes of samples
FEWEST_SAMPLES = 8  # of a cycle, between which its motion can be guessed
LONG = 4 * 3600.0  # seconds that a study may take on one core
MOST_SAMPLES = 2**16  # of a period of a balance
STEPS_OF_WIDTH = 1.0  # widths of a resonance at half its power that a step may have
FAR_BELOW, FAR_ABOVE = 0.2, 100.0  # times the highest excitation frequency: a highest mode beyond is worth a warning
KEPT = 20.0  # times that frequency above which a mode may be left out
FEWER_STEPS = 0.9  # of the highest frequency kept, from which on modes that may be left out cost few steps
TRUNCATED = 0.01  # share by which the modes left out lower a resonance, from which on that is worth a warning
TAKES_PART = 1e-2  # share of a mode's stiffness that contacts add if it takes part in their motion
HEAVY = 0.15  # damping ratio above which a percentage is suspected
OBLIQUE = 0.01  # cosine of the angle to the normal that rounding of a direction does not make
ROUGH = 3.0  # friction coefficient above which the same is
STILL = 1e-9  # share of a contact's largest motion below which it does not move in its plane
ROUNDING = 1e-9  # share of the largest constant modal force that leaves a mode alone
FEW_RUNS = 4  # at reference for which a tradeoff should have time


def warnings_of(scene: Scene) -> Iterator[str]:
    """What is accepted in a scene but may not be intended."""
    file = scene.file
    yield from (f"{key} is not used: in a study of kind {file.study.kind} {why}" for key, why in _unused(scene))
    for contact in file.contacts:
        if contact.idle_stiffness and np.any(contact.stiffness_matrix()):
            yield f"contacts.{contact.name}.tangential_stiffness has no effect without friction"
        yield from _oblique(contact)
        if contact.friction > ROUGH:
            yield f"contacts.{contact.name}.friction: {contact.friction:g} times the normal load; 30 % is 0.3"
    if not file.study.requires:
        return
    yield from _failing(scene)
    model = scene.model()
    yield from model.notes
    yield from _narrow(file.study, model)
    yield from _still_parts(file, model)
    yield from _large_numbers(file.study, scene.plan, model)
    yield from _truncated(scene, model)
    yield from _steps(scene, model)
    yield from _long(scene, model)
    yield from _far_contacts(scene, model)
    if balance_of(scene.plan) is not None:
        yield from _unheld(model)
    highest = _highest_frequency(scene) * float(model.excitation.harmonic.max())
    ratio = float(model.structure.frequency[-1]) / highest if highest else 0.0
    if 0 < ratio < FAR_BELOW:
        far = f"the excitation reaches {highest:.6g} Hz, {1 / ratio:.3g} times the highest mode"
        yield f"{far}: frequencies are in Hz, and modes left out would answer there"
    if ratio > FAR_ABOVE and not hasattr(file.structure, "modes"):
        yield from _modes_to_spare(model, highest)


def _unused(scene: Scene) -> Iterator[tuple[str, str]]:
    """Keys that are given, other than by default, and change nothing, each with what rules instead."""
    study, given, plan = scene.file.study, scene.source.data, scene.plan
    usual, own = SolverSection.model_validate({}), scene.file.solver
    solver = [key for key in given.get("solver") or {} if getattr(own, key) != getattr(usual, key)]
    started = scene.file.initial != "rest"
    if not study.requires:
        idle = {"structure": "structure" in given, "excitation": "excitation" in given, "initial": started}
        idle["solver"] = bool(solver) and not study.uses_solver
        yield from ((key, "the motion of the contact is given") for key, found in idle.items() if found)
        return
    if "frequency" in (given.get("excitation") or {}) and not study.uses_frequency:
        yield "excitation.frequency", "its own frequencies rule"
    if isinstance(plan, HbmPlan) and started:
        yield "initial", "study.start says where the curves begin"
    for key in solver:
        if isinstance(plan, TradeoffPlan) and key not in ("max_steps", "estimate_error"):
            yield f"solver.{key}", "all methods are tried"
        elif isinstance(plan, HbmPlan) and plan.passing is None:
            yield f"solver.{key}", "nothing is integrated in time"
        elif key == "estimate_error" and not isinstance(plan, Schedule | TradeoffPlan):
            yield f"solver.{key}", "no error is estimated"


def _oblique(contact: ContactSection) -> Iterator[str]:
    """A first axis that is given out of the plane of contact, and the one that it stands for."""
    if contact.tangent is not None:
        frame = contact.frame()
        if abs(frame[2] @ unit(contact.tangent)) > OBLIQUE:
            first = f"the first axis is its part in the plane of contact, {components(frame[0])}"
            what = f"is not perpendicular to the normal: {first}"
            yield f"contacts.{contact.name}.tangent {what}"


def components(direction: np.ndarray) -> str:
    """Those of a direction along x, y, z."""
    return f"({', '.join(f'{x + 0.0:.3g}' for x in direction)})"


def asked_frequency(scene: Scene, model: Model) -> float | None:
    """Frequency at which a time integration asks most [Hz]: the excitation's or the lowest; None without one."""
    study = scene.file.study
    return model.excitation.frequency if study.uses_frequency else study.lowest_frequency()


def _modes_to_spare(model: Model, highest: float) -> Iterator[str]:
    """Modes far above the excitation, which reaches so far [Hz], that the contacts hardly move."""
    own, structure = np.diag(model.with_contacts(np.zeros((model.structure.num_modes,) * 2))), model.structure
    needed = (structure.frequency <= KEPT * highest) | (own > TAKES_PART * structure.omega**2)
    keep = 1 + int(np.max(np.flatnonzero(needed), initial=0))
    if structure.frequency[keep - 1] < FEWER_STEPS * structure.frequency[-1]:
        top = f"{structure.frequency[-1]:.6g} Hz, {structure.frequency[-1] / highest:.3g} times the excitation"
        advice = f"structure.keep_modes: {keep} would reach {structure.frequency[keep - 1]:.6g} Hz"
        tells = "a study of kind tradeoff tells how many modes the answer needs"
        yield f"the modes kept reach {top}, which costs steps; {advice}; {tells}"


def _truncated(scene: Scene, model: Model) -> Iterator[str]:
    """A resonance with every contact stuck that the modes left out, which make the structure softer there, lower."""
    structure, left = model.structure, model.structure.left_out
    if left is None or not model.contacts or not obeys_cone(model).all():
        return
    from scipy.linalg import block_diag

    points = replace(structure, frequency=np.ones(len(left)), shape=np.eye(len(left)).reshape(-1, 3, len(left)))
    relative, shape = (
        own.contact_shape.reshape(3 * model.num_contacts, -1) for own in (replace(model, structure=points), model)
    )
    shape = shape / np.sqrt(structure.mass)
    stiff = block_diag(*map(springs, model.contacts))
    soft = stiff @ np.linalg.inv(np.eye(len(stiff)) + relative @ left @ relative.T @ stiff)
    kept, true = (
        np.sqrt(np.maximum(np.linalg.eigvalsh(np.diag(structure.omega**2) + shape.T @ own @ shape), 0.0)) / (2 * np.pi)
        for own in (stiff, (soft + soft.T) / 2)
    )
    kept, true = (own[true > STILL * true.max()] for own in (kept, true))  # no free motions
    balance = balance_of(scene.plan)
    highest = max(_highest_frequency(scene), *(balance.span if balance else (0.0,)))
    reach = max(highest * float(model.excitation.harmonic.max()), true.min(initial=np.inf))
    above = (kept / true - 1)[true <= reach]
    if above.max(initial=0.0) > TRUNCATED:
        place = int(np.argmax(above))
        put = f"with every contact stuck the modes kept put a resonance at {kept[place]:.4g} Hz"
        yield f"structure.keep_modes: {put}, all modes near {true[place]:.4g} Hz: more make it softer there"


def _steps(scene: Scene, model: Model) -> Iterator[str]:
    """Explicit steps that are too long or too many where the contacts are closed; a tradeoff without time for them."""
    frequency, solver, plan = asked_frequency(scene, model), scene.solver(), scene.plan
    if isinstance(plan, TradeoffPlan):
        finest = plan.preset("reference", model, solver.budget)
        needed = FEW_RUNS * plan.cycles * seconds_a_cycle(model, finest, plan.frequency)
        if needed > plan.budget:
            so = "what is known of the errors comes from the finest of them; give it more, or fewer cycles"
            yield f"study.budget: {plan.budget:g} s are little for fine runs, which take about {needed:.2g} s: {so}"
        return
    if frequency is None or solver.name not in EXPLICIT:
        return
    asked, fixed = stable_steps(model, frequency), round(2 * np.pi / solver.longest)
    stability = f"{asked:.3g} that stability asks for at {frequency:.6g} Hz"
    if solver.name == "rk4" and asked > fixed:
        so = "the motion may grow without bound where contacts are closed"
        yield f"solver.steps_per_cycle: {fixed} steps are fewer than the {stability}: {so}"
    elif asked > solver.budget:
        advice = "method: exponential does without them, and a smaller structure.keep_modes may too"
        yield f"solver.max_steps: {solver.budget} steps a cycle are fewer than the {stability}; {advice}"
    elif solver.name != "rk4" and SLIPPING * (turns := slip_steps(model, frequency)) > solver.budget:
        slip = f"{turns:.2g} that the direction of slip may ask for at {frequency:.6g} Hz"
        advice = "method: exponential does without them"
        yield f"solver.max_steps: {solver.budget} steps a cycle are fewer than the {slip}; {advice}"


def _far_contacts(scene: Scene, model: Model) -> Iterator[str]:
    """Contacts so stiff that rounding spoils the accuracy, and stops so far away that they only cost time."""
    frequency, units = asked_frequency(scene, model), scene.file.unit_names()
    if frequency is None:
        return
    live, promise = reduction_of(model, [frequency]).live, scene.promise
    for c in sorted(live):
        stiffness, error = rounded(model, c, frequency)
        if promise is not None and error > promise:
            most = with_unit(f"{stiffness * promise / error:.1e}", attributes("normal_stiffness", units))
            so = f"rounding leaves an error of about {error:.0e}, more than the {promise:.0e} promised"
            yield f"contacts.{model.contacts[c].name} is very stiff: {so}; a stiffness up to about {most} keeps that"
    for contact, times in distant_stops(model, live):
        gap = with_unit(f"{-contact.preload / contact.normal_stiffness:g}", attributes("v", units))
        so = f"its gap of {gap} is {times:.3g} times as wide as the structure moves there without contacts"
        yield f"contacts.{contact.name} is unlikely ever to touch: {so}; without it a run is quicker"


def _failing(scene: Scene) -> Iterator[str]:
    """Sets of values that make no scene; the others are computed all the same."""
    lost = [(values, found) for values, found in scene.tried if isinstance(found, Problem)]
    if lost:
        named = [f"{in_words(values)}: {problem.key} {problem.rule}" for values, problem in lost]
        few = "; ".join(first_few(named, FAILING, lambda left: f"and {left} more"))
        yield f"study.over: {len(lost)} of {len(scene.tried)} sets of values make no scene, and get no motion: {few}"


def _unheld(model: Model) -> Iterator[str]:
    """Rigid bodies that a constant force, with the others, pushes by more than the friction that alone holds them."""
    excited, shape = model.excitation, model.contact_shape
    held = (model.friction * np.maximum(model.preload, 0.0)) @ np.linalg.norm(shape[:, :2], axis=1)
    supported = np.any(shape[model.normal_stiffness > 0, 2] != 0, axis=0)
    pushed = np.abs(excited.constant) > ROUNDING * np.abs(excited.constant).max(initial=0.0)
    if ((model.structure.frequency == 0) & pushed & ~supported & (excited.largest > held)).any():
        pushed = "with the others they push the structure by more than the friction that alone holds it"
        so = "it may drift, and harmonic balance knows only motions that repeat; a sweep tells"
        yield f"excitation.constant_forces: {pushed}: {so}"


def _narrow(study: StudySection, model: Model) -> Iterator[str]:
    """Resonances, free or stuck, of a harmonic of the excitation that the steps of a sweep may pass over."""
    if not isinstance(study, SweepSection | Optimum):
        return
    swept, given = study.sweep().frequency, study.frequency
    if given.listed is None and (last := swept[-1]) < given.spacing[1] * (1 - 1e-9):
        first, to, step = given.spacing
        yield f"study.frequency: in steps of {step:g} Hz from {first:g} Hz the last is {last:.6g}, not {to:g} Hz"
    own, wide = _resonances(model)
    harmonic = model.excitation.harmonic[:, None]
    natural, width = own / harmonic, wide / harmonic
    after = np.searchsorted(swept, natural)
    inside = (natural > swept[0]) & (natural < swept[-1])
    passed = np.where(inside, np.diff(swept, prepend=0.0, append=0.0)[after], 0.0)
    if not np.any(passed > STEPS_OF_WIDTH * width):
        return
    place = np.unravel_index(np.argmax(passed / np.maximum(width, 1e-300)), passed.shape)
    of = f" of harmonic {harmonic[place[0], 0]}" if harmonic[place[0], 0] > 1 else ""
    damped = f"is {width[place]:.2g} Hz wide by its structural damping" if width[place] else "has no structural damping"
    peak = f"a resonance{of} as at {natural[place]:.6g} Hz {damped}"
    yield f"study.frequency: {peak}; steps of {passed[place]:.3g} Hz may miss its peak where no contact slips"


def _resonances(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies without contacts and with all of them stuck, and their widths at half the power [Hz]."""
    contacts = np.arange(model.num_contacts)
    stuck = (contacts[:0], contacts) if obeys_cone(model).all() else (contacts[:0],)
    found = [damped_modes(model, own) for own in stuck]
    natural, width = (np.concatenate([own[part] for own in found]) / (2 * np.pi) for part in (0, 2))
    return natural, width


def _highest_frequency(scene: Scene) -> float:
    """Highest frequency of the time integration of a scene [Hz]; 0 where it has none."""
    study, plan = scene.file.study, scene.plan
    if isinstance(plan, Schedule):
        return max(frequency for frequency, _ in plan.phases)
    if isinstance(study, SteadySection):
        return float(study.sweep().frequency[-1])
    return plan.frequency if isinstance(plan, TradeoffPlan) else 0.0


def _long(scene: Scene, model: Model) -> Iterator[str]:
    study = scene.file.study
    if isinstance(study, SteadySection):
        *_, seconds = sweep_cost(model, scene.solver(), study.sweep())
        if seconds > LONG:
            so = "timesim check tells how that adds up; --resume goes on with a run that is cut off"
            yield f"study: {counted(study.sweep().size, 'point')} take about {duration(seconds)} on one core: {so}"


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
    balance = balance_of(plan)
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
        elif contact.friction > 0 and not np.any(np.abs(shape[:2]) > STILL * np.abs(shape).max()):
            loaded = contact.normal_stiffness > 0
            so = "it never rubs, and acts as a stop" if loaded else "its normal load is constant, so it has no effect"
            plane = f"its plane, which is normal to {components(contact.frame[2])}"
            yield f"contacts.{contact.name}: no mode moves it in {plane}: {so}"
    given = getattr(file.initial, "slip", {})
    for contact, slip in zip(model.contacts, start.slip, strict=True):
        if contact.name in given and not np.allclose(slip, given[contact.name], rtol=1e-8, atol=0.0):
            reason = "the contact starts separated or has no friction"
            yield f"initial.slip.{contact.name} has no effect: {reason}"
