"""An independent oracle for time histories: diffrax's own `diffeqsolve` with one `Event`, leg after leg.

It shares the data classes of `timesim.model.model` with the program under test and nothing else; the contact law
is in `oracle_law`, what follows a transition and the loop are written here.

A leg ends where the smallest margin over all contacts falls through ``-OFFSET``. The one scalar condition
takes the earliest transition of several; the offset keeps a margin that starts at zero (slip to stick:
margin and rate both vanish; re-contact) armed and from firing again. Steps are kept below a fraction of the
period, so that two crossings of one margin within a step would have to lie closer than that.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from oracle_law import (
    OFFSET,
    Leg,
    Motion,
    Scaled,
    current_slip,
    field,
    make_pad,
    margins,
    scale,
    start_state,
    transition,
    typical_length,
)

import timesim.runtime  # noqa: F401  (double precision, before any array is made)
from timesim.model.model import Model

# The root finder has one tolerance for time and value: times to 1e-14 cycles, margins to 2e-11, which the
# rounding of a stiff contact still allows.
WEIGHT = 5e-4
STEPS_PER_CYCLE = 200
MAX_LEGS_PER_CYCLE = 1000


class OracleError(RuntimeError):
    """The oracle could not carry a run to its end."""


@dataclass(frozen=True)
class OracleResult:
    """State at the end and all transitions, in the units of the model.

    Attributes:
        displacement, velocity: modal, shape (M,).
        slip: w of each contact, shape (C, 2); equal to u where the contact is apart or frictionless.
        state: state of each contact, shape (C,).
        event_time: times of the transitions, ascending, shape (E,).
        event_contact, event_from, event_to: their contacts and states, shape (E,).
        share: share of the last cycle in stick, slip and separation, shape (C, 3).
    """

    displacement: np.ndarray
    velocity: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    event_time: np.ndarray
    event_contact: np.ndarray
    event_from: np.ndarray
    event_to: np.ndarray
    share: np.ndarray


def _earliest(t: jax.Array, y: Motion, args: Leg, **kwargs: object) -> jax.Array:
    del t, kwargs
    return WEIGHT * (jnp.min(margins(y, args), initial=1.0) + OFFSET)


def _margin_of(contact: int, t: jax.Array, y: Motion, args: Leg, **kwargs: object) -> jax.Array:
    del t, kwargs
    return WEIGHT * (margins(y, args)[contact] + OFFSET)


_ROOT: Any = optx.Bisection(rtol=1e-15, atol=1e-14, flip=True)
_EARLIEST = dfx.Event(_earliest, _ROOT, direction=False)


class Controls(NamedTuple):
    """Tolerances, the largest step [cycles] and the first; arrays, lest each value compile anew."""

    rtol: np.ndarray
    atol: np.ndarray
    largest: np.ndarray
    first: np.ndarray


def _controls(*values: float) -> Controls:
    return Controls(*(np.asarray(value) for value in values))


@eqx.filter_jit
def _advance(
    motion: Motion,
    leg: Leg,
    span: jax.Array,
    controls: Controls,
    event: dfx.Event,
    solver: dfx.AbstractSolver,
) -> tuple[jax.Array, Motion, jax.Array, jax.Array]:
    """Integrate until a transition or for `span` cycles: time spent, motion, condition mask, success."""
    solution = dfx.diffeqsolve(
        dfx.ODETerm(field),
        solver,
        0.0,
        span,
        jnp.minimum(controls.first, span),
        motion,
        leg,
        stepsize_controller=dfx.PIDController(
            rtol=controls.rtol, atol=controls.atol, dtmax=controls.largest, pcoeff=0.4, icoeff=0.3
        ),
        event=event,
        max_steps=2**24,
        throw=False,
    )
    end = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
    fired = jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(solution.event_mask)])
    return solution.ts[-1], end, fired, dfx.is_okay(solution.result)


_margins_compiled = eqx.filter_jit(margins)


class Instant(NamedTuple):
    """Where a run stands between two legs; numpy throughout."""

    time: float
    motion: Motion
    state: np.ndarray
    slip: np.ndarray


class Transition(NamedTuple):
    """One entry of the log; time in cycles."""

    time: float
    contact: int
    before: int
    after: int


def _switch(now: Instant, c: int, scaled: Scaled) -> tuple[Instant, Transition]:
    before = int(now.state[c])
    after, slip, angle = transition(before, make_pad(c, now.motion, scaled, now.slip))
    state, slips, angles = now.state.copy(), now.slip.copy(), now.motion.angle.copy()
    state[c], slips[c], angles[c] = after, slip, angle
    moved = Instant(now.time, now.motion._replace(angle=angles), state, slips)
    return moved, Transition(now.time, c, before, after)


def _settle(now: Instant, fired: np.ndarray, scaled: Scaled) -> tuple[Instant, list[Transition]]:
    """Switch the contact with the least margin, then each further one whose margin is used up by now."""
    del fired
    log: list[Transition] = []
    while len(log) < 3 * now.state.size:
        leg = Leg(scaled, np.asarray(0.0), now.state, now.slip)
        left = np.asarray(_margins_compiled(now.motion, leg))
        if log and np.all(left + OFFSET > 0):
            return now, log
        now, entry = _switch(now, int(np.argmin(left)), scaled)
        log.append(entry)
    raise OracleError(f"transitions chase one another at {now.time} cycles: {log}")


def _begin(model: Model, scaled: Scaled, frequency: float, length: float) -> Instant:
    start = model.start
    slip = start.slip.reshape(-1, 2) / length
    motion = Motion(start.displacement / length, start.velocity / (length * frequency), np.zeros(len(slip)))
    pads = [make_pad(c, motion, scaled, slip) for c in range(len(slip))]
    state = [
        start_state(contact, int(given), pad.load)
        for contact, given, pad in zip(model.contacts, start.state, pads, strict=True)
    ]
    force = [pad.stiffness @ (pad.place - pad.slip) for pad in pads]
    angle = np.array([np.arctan2(f[1], f[0]) for f in force])
    return Instant(0.0, motion._replace(angle=angle), np.array(state, dtype=int), slip)


Advance = Callable[[Motion, Leg, np.ndarray], tuple[Any, Motion, Any, Any]]
Switch = Callable[[Instant, np.ndarray, Scaled], tuple[Instant, list[Transition]]]


def _run(
    now: Instant,
    scaled: Scaled,
    phase: float,
    cycles: float,
    advance: Advance,
    switch: Switch,
    longest: float,
) -> tuple[Instant, list[Transition]]:
    """Leg after leg; `switch` takes the contacts whose conditions ended a leg into their next states.

    No leg is longer than `longest` cycles: the later in a leg, the coarser is the time of its end.
    """
    log: list[Transition] = []
    for _ in range(int(MAX_LEGS_PER_CYCLE * max(cycles, 1))):
        leg = Leg(scaled, np.asarray(phase + 2 * np.pi * (now.time % 1.0)), now.state, now.slip)
        span = min(longest, cycles - now.time)
        spent, motion, fired, okay = advance(now.motion, leg, np.asarray(span))
        if not okay:
            raise OracleError(f"the leg from {now.time} cycles with states {now.state} failed")
        now = now._replace(time=now.time + float(spent), motion=Motion(*(np.array(leaf) for leaf in motion)))
        if np.any(fired):
            now, entries = switch(now, np.asarray(fired), scaled)
            log += entries
        elif cycles - now.time < 1e-12 * cycles:
            return now, log
    raise OracleError(f"more than {MAX_LEGS_PER_CYCLE} transitions a cycle, at {now.time} cycles")


def _switch_flagged(now: Instant, fired: np.ndarray, scaled: Scaled) -> tuple[Instant, list[Transition]]:
    now, entry = _switch(now, int(np.argmax(fired)), scaled)
    return now, [entry]


def _shares(initial: np.ndarray, log: list[Transition], cycles: float) -> np.ndarray:
    share, since = np.zeros((initial.size, 3)), max(cycles - 1.0, 0.0)
    for c in range(initial.size):
        own = [entry for entry in log if entry.contact == c]
        bounds = np.clip([0.0, *(entry.time for entry in own), cycles], since, cycles)
        for state, length in zip([initial[c], *(entry.after for entry in own)], np.diff(bounds), strict=True):
            share[c, state] += length / (cycles - since)
    return share


def _result(
    initial: np.ndarray, end: Instant, log: list[Transition], scaled: Scaled, length: float, frequency: float
) -> OracleResult:
    slip = [current_slip(int(end.state[c]), make_pad(c, end.motion, scaled, end.slip)) for c in range(initial.size)]
    table = np.array(log, dtype=float).reshape(-1, 4)
    contact, before, after = table[:, 1:].astype(int).T
    return OracleResult(
        displacement=end.motion.displacement * length,
        velocity=end.motion.velocity * length * frequency,
        slip=np.array(slip).reshape(-1, 2) * length,
        state=end.state,
        event_time=table[:, 0] / frequency,
        event_contact=contact,
        event_from=before,
        event_to=after,
        share=_shares(initial, log, end.time),
    )


def _integrate(
    model: Model, frequency: float, cycles: float, advance: Advance, switch: Switch, longest: float
) -> OracleResult:
    length = typical_length(model, frequency)
    scaled = scale(model, frequency, length)
    begin = _begin(model, scaled, frequency, length)
    end, log = _run(begin, scaled, model.start.phase, cycles, advance, switch, longest)
    return _result(begin.state, end, log, scaled, length, frequency)


def simulate(
    model: Model,
    frequency: float,
    cycles: float,
    *,
    rtol: float = 1e-10,
    atol_relative: float = 1e-12,
    steps_per_cycle: int = STEPS_PER_CYCLE,
) -> OracleResult:
    """Integrate `model` under its excitation with base `frequency` [Hz] for `cycles` periods.

    Args:
        model: structure, contacts, excitation and start.
        frequency: base frequency [Hz]; the one in the excitation is not read.
        cycles: periods to integrate.
        rtol: relative tolerance of a step.
        atol_relative: absolute tolerance as a multiple of the displacement that the forces suggest.
        steps_per_cycle: no step is longer than a period divided by this.

    Raises:
        OracleError: if a leg fails or transitions accumulate.
    """
    controls = _controls(rtol, atol_relative, 1.0 / steps_per_cycle, 0.01 / steps_per_cycle)
    advance = partial(_advance, controls=controls, event=_EARLIEST, solver=dfx.Tsit5())
    return _integrate(model, frequency, cycles, advance, _settle, 1.0)


def simulate_plainly(model: Model, frequency: float, cycles: float, *, rtol: float = 1e-8) -> OracleResult:
    """The same physics with diffrax's events as its documentation shows them: one condition a contact.

    The steps are as long as the error allows. Loses transitions where two contacts switch within a step, and
    where one contact switches twice (diffrax#639, diffrax#507); for tests that show this, not for use.
    """
    conditions = [partial(_margin_of, c) for c in range(model.num_contacts)]
    event = (
        dfx.Event(conditions[0], _ROOT, direction=False)
        if len(conditions) == 1
        else dfx.Event(conditions, optx.Newton(1e-12, 1e-12), direction=[False] * len(conditions))
    )
    advance = partial(_advance, controls=_controls(rtol, 1e-2 * rtol, 1.0, 1e-3), event=event, solver=dfx.Dopri8())
    return _integrate(model, frequency, cycles, advance, _switch_flagged, cycles)
