"""An independent oracle for time histories: diffrax's own `diffeqsolve` with one `Event`, a leg per set of states.

It shares the data classes of `timesim.model` with the program under test and nothing else: the contact law, the
decision after a transition and the loop are written here a second time, in another formulation.

Equations (DESIGN section 1; paper, equations 1 to 17) in the dimensionless time ``tau = frequency t`` and lengths in
units of `_length`; forces of a contact in units of its own `unit`. Within a leg every contact keeps its state, so the
vector field is smooth. In slip the force is ``f = mu n e(alpha)`` with the angle ``alpha`` integrated:

    s = |w'| = (e . K u' - mu n') / (e . K e),        mu n alpha' = e_perp . (K u' - s K e)

A leg ends where the smallest margin over all contacts falls through ``-OFFSET``. The one scalar condition takes the
earliest transition of several; the offset keeps a margin that starts at zero (slip to stick: margin and rate both
vanish; re-contact) armed and from firing again. Steps are kept below a fraction of the period, so that two crossings
of one margin within a step would have to lie closer than that.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import timesim.jax_setup  # noqa: F401, I001  (double precision, before JAX is used)
import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from scipy.optimize import brentq

from timesim.model import SEPARATION, SLIP, STICK, Contact, Model

OFFSET = 1e-10
TIE = 0.5 * OFFSET
# The root finder has one tolerance for time and value: times to 1e-14 cycles, margins to 2e-11, which rounding of a
# stiff contact still allows.
WEIGHT = 5e-4
LOAD_FLOOR = 1e-9
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


class Motion(NamedTuple):
    """What is integrated: modal displacement and velocity, shape (M,), and slip angles [rad], shape (C,)."""

    displacement: Any
    velocity: Any
    angle: Any


class Scaled(NamedTuple):
    """A model in dimensionless form; forces of contact c in units of ``unit[c]`` (see `_scale`)."""

    stiffness: Any
    damping: Any
    harmonic: Any
    cosine: Any
    sine: Any
    constant: Any
    shape: Any
    reaction: Any
    friction: Any
    tangential: Any
    normal: Any
    preload: Any
    speed: Any


class Leg(NamedTuple):
    """What is constant in a leg: the scaled model, phase at its start [rad], states (C,), slip (C, 2)."""

    scaled: Scaled
    phase: Any
    state: Any
    slip: Any


def _length(model: Model, frequency: float) -> float:
    """A displacement typical of the modes, for tolerances: forces over the larger of stiffness and inertia."""
    structure, load, start = model.structure, model.excitation, model.start
    inertia = structure.mass * (2 * np.pi * frequency * load.harmonic[:, None]) ** 2
    amplitude = np.hypot(load.cosine, load.sine) / np.maximum(structure.stiffness, inertia)
    static = np.abs(load.constant) / np.maximum(
        structure.stiffness, structure.mass * (2 * np.pi * frequency) ** 2
    )
    begin = np.abs(start.displacement) + np.abs(start.velocity) / (2 * np.pi * frequency)
    return float(np.max(amplitude.sum(axis=0) + static + begin)) or 1.0


def _scale(model: Model, frequency: float, length: float) -> Scaled:
    structure, load, contacts = model.structure, model.excitation, model.contacts
    mass, damping, shape = structure.mass, structure.damping, model.contact_shape
    matrix = np.diag(damping) if damping.ndim == 1 else damping
    preload = np.array([contact.preload for contact in contacts])
    normal = np.array([contact.normal_stiffness for contact in contacts]) * length
    reach = np.max(np.abs(shape), axis=(1, 2), initial=0.0)
    unit = np.abs(preload) + normal * reach
    tangential = np.array([contact.tangential_stiffness for contact in contacts]).reshape(-1, 2, 2)
    force = mass * frequency**2 * length
    return Scaled(
        stiffness=structure.stiffness / (mass * frequency**2),
        damping=matrix / (mass[:, None] * frequency),
        harmonic=load.harmonic.astype(float),
        cosine=load.cosine / force,
        sine=load.sine / force,
        constant=load.constant / force,
        shape=shape,
        reaction=shape * unit[:, None, None] / force,
        friction=np.array([contact.friction for contact in contacts]),
        tangential=tangential * length / unit[:, None, None],
        normal=normal / unit,
        preload=preload / unit,
        speed=2 * np.pi * reach,
    )


def _direction(angle: jax.Array) -> jax.Array:
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


def _rows(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    return jnp.einsum("cij,cj->ci", matrix, vector)


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.sum(a * b, axis=-1)


class Contacts(NamedTuple):
    """Kinematics and forces of all contacts, each taken as in contact; contact first in every shape."""

    rate: Any
    load: Any
    trial: Any
    speed: Any
    turn: Any


def _contacts(motion: Motion, leg: Leg) -> Contacts:
    """Velocity (u1, u2, v), normal load, trial force K (u - w), slip speed and angular rate of the slip."""
    p = leg.scaled
    place, rate = p.shape @ motion.displacement, p.shape @ motion.velocity
    load = p.preload + p.normal * place[:, 2]
    e = _direction(motion.angle)
    across = jnp.stack([-e[:, 1], e[:, 0]], axis=-1)
    pull, push = _rows(p.tangential, rate[:, :2]), _rows(p.tangential, e)
    rubs = p.friction > 0
    speed = (_dot(e, pull) - p.friction * p.normal * rate[:, 2]) / jnp.where(rubs, _dot(e, push), 1.0)
    # Near separation the angle is stiff (rate ~ 1/n); the floor bounds the number of steps through n = 0.
    limit = jnp.where(rubs, p.friction, 1.0) * jnp.maximum(load, LOAD_FLOOR)
    turn = _dot(across, pull - speed[:, None] * push) / limit
    return Contacts(rate, load, _rows(p.tangential, place[:, :2] - leg.slip), speed, turn)


def _field(t: jax.Array, motion: Motion, args: Leg) -> Motion:
    p, now = args.scaled, _contacts(motion, args)
    slips = (args.state == SLIP) & (p.friction > 0)
    sliding = (p.friction * now.load)[:, None] * _direction(motion.angle)
    tangential = jnp.where((args.state == STICK)[:, None], now.trial, jnp.where(slips[:, None], sliding, 0.0))
    normal = jnp.where(args.state == SEPARATION, 0.0, now.load) - jnp.maximum(p.preload, 0.0)
    reaction = -jnp.concatenate([tangential, normal[:, None]], axis=1)
    phase = p.harmonic * (2 * jnp.pi * t + args.phase)
    external = jnp.cos(phase) @ p.cosine + jnp.sin(phase) @ p.sine + p.constant
    internal = jnp.einsum("cjm,cj->m", p.reaction, reaction)
    acceleration = external + internal - p.damping @ motion.velocity - p.stiffness * motion.displacement
    return Motion(motion.velocity, acceleration, jnp.where(slips, now.turn, 0.0))


def _margins(motion: Motion, leg: Leg) -> jax.Array:
    """Distance of each contact from its next transition, of order one; negative beyond it. Shape (C,)."""
    p, now = leg.scaled, _contacts(motion, leg)
    rubs = p.friction > 0
    friction = jnp.where(rubs, p.friction, 1.0)
    stick = now.load - jnp.sqrt(_dot(now.trial, now.trial)) / friction
    slip = jnp.where(rubs, jnp.minimum(now.speed / p.speed, now.load), now.load)
    return jnp.select([leg.state == STICK, leg.state == SLIP], [stick, slip], -now.load)


def _earliest(t: jax.Array, y: Motion, args: Leg, **kwargs: object) -> jax.Array:
    del t, kwargs
    return WEIGHT * (jnp.min(_margins(y, args), initial=1.0) + OFFSET)


def _margin_of(contact: int, t: jax.Array, y: Motion, args: Leg, **kwargs: object) -> jax.Array:
    del t, kwargs
    return WEIGHT * (_margins(y, args)[contact] + OFFSET)


_ROOT = optx.Bisection(rtol=1e-15, atol=1e-14, flip=True)
_EARLIEST = dfx.Event(_earliest, _ROOT, direction=False)


class Controls(NamedTuple):
    """Solver settings: tolerances, the largest step [cycles] and the first; arrays, lest each value compile anew."""

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
        dfx.ODETerm(_field),
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


_margins_compiled = eqx.filter_jit(_margins)


def _slip_direction(stiffness: np.ndarray, rate: np.ndarray, growth: float) -> np.ndarray:
    """Unit e with ``(growth I + s K) e = K rate`` and s >= 0: where slip begins at zero load (17)."""
    value, vector = np.linalg.eigh(stiffness)
    b = vector.T @ rate

    def excess(s: float) -> float:
        return float(np.linalg.norm(value * b / (growth + s * value))) - 1.0

    top = float(np.linalg.norm(rate))
    low = 0.0 if growth > 0 else 0.5 * top
    s = top if excess(top) >= 0 else brentq(excess, low, top, xtol=1e-15 * top, rtol=1e-14)
    e = vector @ (value * b / (growth + s * value))
    return e / np.linalg.norm(e)


class Pad(NamedTuple):
    """One contact at one instant, as numbers of the scaled model."""

    friction: float
    stiffness: np.ndarray
    place: np.ndarray
    rate: np.ndarray
    load: float
    growth: float
    slip: np.ndarray
    angle: float


def _pad(c: int, motion: Motion, p: Scaled, slip: np.ndarray) -> Pad:
    place, rate = p.shape[c] @ motion.displacement, p.shape[c] @ motion.velocity
    load, growth = p.preload[c] + p.normal[c] * place[2], p.normal[c] * rate[2]
    return Pad(
        p.friction[c], p.tangential[c], place[:2], rate[:2], load, growth, slip[c], float(motion.angle[c])
    )


def _close(pad: Pad) -> tuple[int, np.ndarray, float]:
    """Contact begins: stuck from here where the limit grows faster than the trial force (15 to 17)."""
    if pad.friction == 0:
        return SLIP, pad.slip, pad.angle
    limit = pad.friction * pad.growth
    if np.linalg.norm(pad.stiffness @ pad.rate) < limit:
        return STICK, pad.place, pad.angle
    e = _slip_direction(pad.stiffness, pad.rate, limit)
    return SLIP, pad.slip, float(np.arctan2(e[1], e[0]))


def _current_slip(state: int, pad: Pad) -> np.ndarray:
    if state == STICK:
        return pad.slip
    if state == SEPARATION or pad.friction == 0:
        return pad.place
    force = pad.friction * pad.load * np.array([np.cos(pad.angle), np.sin(pad.angle)])
    return pad.place - np.linalg.solve(pad.stiffness, force)


def _transition(state: int, pad: Pad) -> tuple[int, np.ndarray, float]:
    """State after the one that ends here, with the slip it holds or the angle it slips along."""
    if state == SEPARATION:
        return _close(pad)
    if pad.load <= TIE and pad.growth < 0:
        return SEPARATION, pad.slip, pad.angle
    if state == STICK:
        force = pad.stiffness @ (pad.place - pad.slip)
        return SLIP, pad.slip, float(np.arctan2(force[1], force[0]))
    return STICK, _current_slip(state, pad), pad.angle


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
    after, slip, angle = _transition(before, _pad(c, now.motion, scaled, now.slip))
    state, slips, angles = now.state.copy(), now.slip.copy(), now.motion.angle.copy()
    state[c], slips[c], angles[c] = after, slip, angle
    moved = Instant(now.time, now.motion._replace(angle=angles), state, slips)
    return moved, Transition(now.time, c, before, after)


def _settle(now: Instant, fired: np.ndarray, scaled: Scaled) -> tuple[Instant, list[Transition]]:
    """Switch the contact with the least margin, then each further one whose margin is used up at this instant."""
    del fired
    log: list[Transition] = []
    while len(log) < 3 * now.state.size:
        margins = np.asarray(_margins_compiled(now.motion, Leg(scaled, np.asarray(0.0), now.state, now.slip)))
        if log and np.all(margins + OFFSET > 0):
            return now, log
        now, entry = _switch(now, int(np.argmin(margins)), scaled)
        log.append(entry)
    raise OracleError(f"transitions chase one another at {now.time} cycles: {log}")


def _start_state(contact: Contact, given: int, load: float) -> int:
    if given >= 0:
        return given
    if load <= 0:
        return SEPARATION
    return STICK if contact.friction > 0 else SLIP


def _begin(model: Model, scaled: Scaled, frequency: float, length: float) -> Instant:
    start = model.start
    slip = start.slip.reshape(-1, 2) / length
    motion = Motion(start.displacement / length, start.velocity / (length * frequency), np.zeros(len(slip)))
    pads = [_pad(c, motion, scaled, slip) for c in range(len(slip))]
    state = [
        _start_state(contact, int(given), pad.load)
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
    slip = [
        _current_slip(int(end.state[c]), _pad(c, end.motion, scaled, end.slip)) for c in range(initial.size)
    ]
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
    length = _length(model, frequency)
    scaled = _scale(model, frequency, length)
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

    The steps are as long as the error allows. Loses transitions where two contacts switch within a step, and where
    one contact switches twice (diffrax issues 639 and 507); for tests that show this, not for use.
    """
    conditions = [partial(_margin_of, c) for c in range(model.num_contacts)]
    event = (
        dfx.Event(conditions[0], _ROOT, direction=False)
        if len(conditions) == 1
        else dfx.Event(conditions, optx.Newton(1e-12, 1e-12), direction=[False] * len(conditions))
    )
    advance = partial(
        _advance, controls=_controls(rtol, 1e-2 * rtol, 1.0, 1e-3), event=event, solver=dfx.Dopri8()
    )
    return _integrate(model, frequency, cycles, advance, _switch_flagged, cycles)
