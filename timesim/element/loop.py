"""The steady cycle of a contact by the event loop, marched from the start until a cycle repeats.

It shares the law with `timesim.element.state_by_state`, and nothing else: no closed form, no angle of slip, another
integration, other integrals. Their results must agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from timesim.element.cycle import ElementCycle, Transition, in_phase
from timesim.element.elements import single_element
from timesim.element.motion import CYCLE, PrescribedMotion
from timesim.element.prescribed import CAPACITY, PrescribedContacts, cycle_end, drive_of, record_cycle
from timesim.engine.method import step_method
from timesim.engine.solver import step_control
from timesim.engine.status import Status
from timesim.engine.step import Step
from timesim.model.model import SEPARATION, Contact
from timesim.model.solver import Solver

FINE = Solver("tsit5", 1e-12, 1e-12)
MAX_CYCLES = 1000
# Change of f from cycle to cycle, relative to the largest mu n, that is rounding; up to the second number a change that
# falls no further is rounding too.
ROUNDING, REPEATS = 1e-14, 1e-11
BRIEF = 1e-8
"""Angle [rad] that a state must last to count: a slip that only touches the cone was seen to last 1.4e-9."""
TOUCH = 1e-5
"""The same of a contact between two separations, of which n rises to 1e-11 of its amplitude at most: a gap of exactly
the amplitude closes for as long as a margin of 1e-12 takes."""

SLIGHT = 1e-8
"""Share of the largest mu n that counts as none, and of the forces that n is the sum of."""
STILL = 1e-8
"""Work of slip in a cycle, relative to mu n times the size of the motion, up to which it is what is left of a creep to
full stick."""


@dataclass(frozen=True)
class LoopCycle:
    """The steady cycle by the event loop; transitions, counts and residual as of `ElementCycle`.

    Attributes:
        f_b, f_s, f_c: coefficients of (19), each of shape (2,) [force].
        dissipation: work of friction in the cycle [force length].
    """

    transitions: tuple[Transition, ...]
    f_b: np.ndarray
    f_s: np.ndarray
    f_c: np.ndarray
    dissipation: float
    num_cycles: int
    residual: float

    @property
    def periodic(self) -> bool:
        """Whether the cycle repeats to rounding."""
        return self.residual <= REPEATS


@dataclass(frozen=True)
class Difference:
    """How far the two ways are apart.

    Attributes:
        same_sequence: whether the states follow one another alike.
        angle: largest difference of a transition [rad]; nan where the sequences differ.
        telling: the same of those between which the normal load of one that opens or closes changes, see `SLIGHT`.
        coefficient: largest difference of a coefficient of (19) relative to the largest mu n, f_b left out where
            the offset is free.
        dissipation: difference of the dissipation relative to mu n times the size of the motion.
    """

    same_sequence: bool
    angle: float
    telling: float
    coefficient: float
    dissipation: float


def loop_cycle(contact: Contact, motion: PrescribedMotion, *, max_cycles: int = MAX_CYCLES) -> LoopCycle:
    """March a contact through the prescribed motion by the event loop until its cycle repeats.

    Of the contact friction, K_u, k_v and n0 are used; its points and frame are not.

    Raises:
        RuntimeError: the loop ended early.
    """
    elements = single_element(contact, motion)
    dynamics = PrescribedContacts(elements.law(), drive_of(elements, motion))
    method, control = step_method(FINE), step_control(FINE, 1.0)
    state, slip, before = elements.start_state, elements.start[:, :2], np.inf
    force = elements.start_force(slip, state)
    for cycle in range(1, max_cycles + 1):
        end, steps, count = record_cycle(method, control, dynamics, tuple(slip.T), state)
        reached = cycle_end(elements, end)
        if not reached.good[0] or int(end.cycle) != 1:
            raise RuntimeError(f"the event loop ended early in cycle {cycle}: {_ending(Status(int(end.status)))}")
        following = elements.start_force(reached.slip, reached.state)
        residual, force = float(np.hypot(*(following - force)[0])), following
        settled = residual <= ROUNDING or (residual <= REPEATS and residual > before / 2)
        same, slip, state, before = reached.state[0] == state[0], reached.slip, reached.state, residual
        if settled and same:
            break
    f_s, f_c = in_phase(reached.first[0], motion.phase)
    log, work = transitions(steps, int(count)), float(reached.dissipation[0])
    return LoopCycle(log, reached.mean[0], f_s, f_c, work, cycle, residual)


def _ending(status: Status) -> str:
    """Why a cycle was not finished."""
    too_many = f"it takes more than {CAPACITY:,} steps, as where slip is very stiff"
    return status.reason.format(budget=FINE.budget) or too_many


def transitions(steps: Step, count: int) -> tuple[Transition, ...]:
    """Transitions of recorded steps."""
    before, after = (np.asarray(part)[:count, 0] for part in (steps.state, steps.state_after))
    angle = (np.asarray(steps.time) + np.asarray(steps.h))[:count]
    changes = np.flatnonzero(before != after)
    return tuple(Transition(float(angle[i] % CYCLE), int(before[i]), int(after[i])) for i in changes)


def difference(cycle: ElementCycle, other: LoopCycle) -> Difference:
    """How far two results for the same contact and motion are apart."""
    load = max(cycle.largest_limit, SLIGHT * cycle.force_scale) or 1.0
    reach = np.hypot(*cycle.motion.amplitude) or 1.0
    first, second = (_lasting(c.transitions) for c in (cycle, other))
    if cycle.offset_free and abs(other.dissipation) <= STILL * load * reach:
        second = [item for item in second if SEPARATION in (item.before, item.after)]
    # One right at the seam may stand at either end of the list.
    turns = range(-1, 2) if len(first) == len(second) else ()
    pairings = [list(zip(first, second[turn:] + second[:turn], strict=True)) for turn in turns]
    alike = [pairs for pairs in pairings if all((a.before, a.after) == (b.before, b.after) for a, b in pairs)]
    options = [max((abs(_apart(a.angle, b.angle)) for a, b in pairs), default=0.0) for pairs in alike]
    best = alike[int(np.argmin(options))] if alike else []
    telling = [abs(_apart(a.angle, b.angle)) for a, b in best if not _grazes(cycle, a, b, SLIGHT * load)]
    ours = cycle.coefficients
    pairs = [(ours.f_s, other.f_s), (ours.f_c, other.f_c)]
    pairs += [] if cycle.offset_free else [(ours.f_b, other.f_b)]
    return Difference(
        bool(options),
        min(options, default=np.nan),
        max(telling, default=0.0),
        max(float(np.abs(a - b).max()) for a, b in pairs) / load,
        abs(cycle.dissipation - other.dissipation) / (load * reach),
    )


def _grazes(cycle: ElementCycle, one: Transition, other: Transition, limit: float) -> bool:
    """Whether n hardly changes between two angles at which a contact opens or closes: less than a limit of mu n."""
    trial = cycle.law.load(cycle.motion.evaluate([one.angle, other.angle])[0])
    return SEPARATION in (one.before, one.after) and cycle.law.friction * float(np.ptp(trial)) <= limit


def _lasting(transitions: Sequence[Transition]) -> list[Transition]:
    """The transitions in order, but for a state that lasts no longer than rounding and leads back to the one before.

    After shakedown the force of a stuck contact just reaches its cone: rounding decides whether that counts as slip.
    """
    kept: list[Transition] = []
    for item in sorted(transitions, key=lambda item: item.angle):
        if kept and _brief(kept[-1], item):
            kept.pop()
        else:
            kept.append(item)
    return kept[1:-1] if len(kept) > 1 and _brief(kept[-1], kept[0]) else kept


def _brief(begin: Transition, end: Transition) -> bool:
    """Whether a state that two transitions enclose, in the order of the cycle, is none but for rounding."""
    back = (begin.before, begin.after) == (end.after, end.before)
    return back and (end.angle - begin.angle) % CYCLE < (TOUCH if begin.before == SEPARATION else BRIEF)


def _apart(a: float, b: float) -> float:
    return (a - b + np.pi) % CYCLE - np.pi
