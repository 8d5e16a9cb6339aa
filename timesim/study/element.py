"""The `element` study: one contact under prescribed motion (sections 2 to 4 of the paper, figures 3 to 6).

The result is that of `state_by_state`. By default the event loop computes it again, and the result is marked incomplete
where the two do not agree. Where it comes to no steady cycle of its own the result stands, and says so.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from xarray import Dataset

from timesim.element.cycle import Coefficients, ElementCycle, Transition
from timesim.element.motion import CYCLE, PrescribedMotion
from timesim.element.state_by_state import steady_cycle
from timesim.model.model import STATE_NAMES, Contact
from timesim.result.checkpoint import INTERRUPTED
from timesim.result.dataset import Arrays, dataset
from timesim.result.label import counted, with_unit
from timesim.scene.element import ElementPlan
from timesim.scene.resolution import Scene
from timesim.study.execution.campaign import Execution
from timesim.study.outcome import Outcome, attributes

if TYPE_CHECKING:
    from timesim.element.loop import Difference, LoopCycle

# Above these the two ways do not agree: transitions [rad], forces relative to the largest mu n.
ANGLE, FORCE = 1e-6, 1e-8
METHOD = "state by state"
UNCHECKED = "cross_check_failure"


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run an element scene; marked incomplete where no cycle repeats, or where the event loop disagrees.

    Where no cycle can be followed to its end the result says why, and holds nothing else.
    """
    plan: ElementPlan = scene.plan
    contact, motion = plan.contact, plan.motion
    if plan.cross_check:
        import timesim.element.loop  # noqa: F401  JAX takes a second, which is not that of the run
    clock = time.perf_counter()
    try:
        cycle = steady_cycle(contact, motion)
    except RuntimeError as error:
        why = f"{error}; change a parameter a little, or sample the motion more smoothly"
        about = attributes(scene, METHOD, 0.0, time.perf_counter() - clock, why)
        return Outcome({"": dataset({}, {"angle": np.zeros(0)}, about)}, why)
    change = f"{cycle.residual:.1e} of the largest mu n from cycle to cycle; change a parameter a little"
    unsettled = f"after {counted(cycle.num_cycles, 'cycle')} the friction force still changes by {change}"
    reason = None if cycle.periodic else unsettled
    compared: dict[str, Any] = {}
    compiling, doubt = 0.0, None
    if plan.cross_check:
        compared, doubt, compiling = _cross_check(contact, motion, cycle)
        reason = reason or doubt
    about = attributes(scene, METHOD, compiling, time.perf_counter() - clock - compiling, reason) | compared
    execution.progress(1, 1)
    record = record_of(plan, cycle, about)
    told = {} if doubt else compared  # the reason says what does not agree
    return Outcome({"": record}, reason, tuple(summary(cycle, told, record["dissipation"].attrs)))


def _cross_check(
    contact: Contact, motion: PrescribedMotion, cycle: ElementCycle
) -> tuple[dict[str, Any], str | None, float]:
    """How far the event loop's result differs, as attributes, why it does not confirm the other, or None.

    Last is the time of compilation [s].
    """
    from timesim.element.loop import difference, loop_cycle

    clock, compiling = time.perf_counter(), 0.0
    try:
        loop_cycle(contact, motion, max_cycles=1)  # compiles its program
        compiling = time.perf_counter() - clock
        other = loop_cycle(contact, motion)
    except KeyboardInterrupt:
        return {}, f"{INTERRUPTED} in the cross check; cross_check: false leaves it out", compiling
    except RuntimeError as error:
        return {UNCHECKED: str(error)}, None, compiling
    if not other.periodic:
        change = f"{other.residual:.1e} of the largest mu n after {other.num_cycles:,}"
        why = f"the cycle of the event loop still changes by {change}"
        return {UNCHECKED: why}, None, compiling
    return *_compared(cycle, other, difference(cycle, other)), compiling


def _compared(cycle: ElementCycle, other: "LoopCycle", apart: "Difference") -> tuple[dict[str, Any], str | None]:
    """The difference as attributes, and what is wrong with it, or None."""
    compared = {
        "cross_check_cycles": other.num_cycles,
        "cross_check_angle_deg": float(np.degrees(apart.angle)),
        "cross_check_coefficients": apart.coefficient,
        "cross_check_dissipation": apart.dissipation,
    }
    if not apart.same_sequence:
        paths = [" ".join(_arrow(item) for item in c.transitions) or "none" for c in (cycle, other)]
        return compared, f"state by state finds the transitions {paths[0]}, the event loop {paths[1]}"
    force = max(apart.coefficient, apart.dissipation)
    if apart.telling > ANGLE or force > FORCE:
        far = f"{np.degrees(apart.angle):.1e} degree and by {force:.1e} of the largest mu n"
        return compared, f"state by state and the event loop differ by {far}"
    return compared, None


def _arrow(item: Transition) -> str:
    return f"{STATE_NAMES[item.before]}→{STATE_NAMES[item.after]}"


def summary(cycle: ElementCycle, compared: dict[str, Any], energy: Mapping[str, Any]) -> Iterator[str]:
    """The lines of the summary; ``energy``: attributes with the unit of an energy."""
    if UNCHECKED in compared:
        yield f"not confirmed by a second way: {compared[UNCHECKED]}"
    if not cycle.touches:
        yield "the bodies never touch: every force is zero"
        return
    angles = ", ".join(f"{_arrow(t)} {np.degrees(t.angle):.6f}°" for t in cycle.transitions)
    states = {stay.state for stay in cycle.stays if stay.stop > stay.start}
    yield f"transitions: {angles or 'none, ' + ' and '.join(STATE_NAMES[s] for s in sorted(states)) + ' all the cycle'}"
    yield f"steady to {cycle.residual:.1e} of the largest mu n in {counted(cycle.num_cycles, 'cycle')}"
    if cycle.offset_free:
        yield "full stick: w, and with it f_b, may keep another offset; here that of a start with f = 0"
    area, work = (with_unit(f"{size:.9g}", energy) for size in (cycle.dissipation, cycle.work))
    yield f"dissipation {area} a cycle (loop area), {work} (work of slip)"
    if "cross_check_angle_deg" in compared:
        angles = f"{compared['cross_check_angle_deg']:.1e}° in the transitions and " if cycle.transitions else ""
        forces = f"{compared['cross_check_coefficients']:.1e} of the largest mu n in the coefficients"
        yield f"the event loop agrees to {angles}{forces}"


def record_of(plan: ElementPlan, cycle: ElementCycle, about: dict[str, Any]) -> Dataset:
    """The result file, with attributes that are known already."""
    contact, motion = plan.contact, cycle.motion
    about = about | {
        "contact": contact.name,
        "friction": contact.friction,
        "normal_stiffness": contact.normal_stiffness,
        "preload": contact.preload,
        "amplitude": motion.amplitude,
        "phase_deg": np.degrees(motion.phase),
        "cycles": cycle.num_cycles,
        "residual": cycle.residual,
        "offset_free": int(cycle.offset_free),
        "touches": int(cycle.touches),
    }
    theta = np.arange(plan.samples) * CYCLE / plan.samples
    variables = cycle_variables(cycle, contact, theta) | coefficient_variables(cycle, plan)
    return dataset(variables, {"angle": np.degrees(theta)}, about)


def cycle_variables(cycle: ElementCycle, contact: Contact, theta: np.ndarray) -> Arrays:
    """The cycle over the angle, its transitions, the first cycle from the start with f = 0."""
    motion = cycle.motion.evaluate(theta)[0]
    first, angles = steady_cycle(contact, cycle.motion, max_cycles=1), [item.angle for item in cycle.transitions]
    return {
        "u": (("angle", "tangent"), motion[:2].T),
        "v": (("angle",), motion[2]),
        "force": (("angle", "tangent"), cycle.force(theta).T),
        "normal_load": (("angle",), cycle.normal_load(theta)),
        "slip": (("angle", "tangent"), cycle.slip(theta).T),
        "state": (("angle",), cycle.state(theta).astype(np.int8)),
        "first_force": (("angle", "tangent"), first.force(theta).T),
        "transition_force": (("event", "tangent"), cycle.force(np.array(angles)).T.reshape(-1, 2)),
        **_log("transition", "event", cycle.transitions),
        **_log("history", "run_event", cycle.history),
    }


def _log(name: str, dim: str, transitions: Sequence[Transition]) -> Arrays:
    """Transitions by their angles and states."""
    return {
        f"{name}_angle_deg": ((dim,), np.degrees([item.angle for item in transitions])),
        f"{name}_from": ((dim,), np.array([item.before for item in transitions], np.int8)),
        f"{name}_to": ((dim,), np.array([item.after for item in transitions], np.int8)),
    }


def coefficient_variables(cycle: ElementCycle, plan: ElementPlan) -> Arrays:
    """Fourier coefficients, energy, stiffness and damping."""

    def along(part: Coefficients, axis: str, prefix: str = "") -> Arrays:
        names = ("f_b", "f_s", "f_c", "effective_stiffness", "effective_damping")
        return {prefix + name: ((axis,), getattr(part, name)) for name in names}

    cosine, sine = cycle.harmonics(plan.harmonics)
    variables = along(cycle.coefficients, "tangent") | {
        "force_cos": (("harmonic", "tangent"), cosine),
        "force_sin": (("harmonic", "tangent"), sine),
        "dissipation": ((), np.array(cycle.dissipation)),
        "friction_work": ((), np.array(cycle.work)),
    }
    if not plan.principal_axes:
        return variables
    principal = cycle.principal_coefficients
    return variables | {
        **along(principal, "principal", "principal_"),
        "principal_amplitude": (("principal",), principal.amplitude),
        "principal_phase_deg": (("principal",), np.degrees(principal.phase)),
        "principal_direction": (("principal", "tangent"), principal.axes),
    }
