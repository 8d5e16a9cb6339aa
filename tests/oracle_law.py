"""The contact law of the oracle, written a second time and in another formulation than the program's.

Equations (the paper's 1 to 17, with the sign convention of `timesim.model.model`) in the dimensionless time ``tau
= frequency t`` and lengths in units of `typical_length`; forces of a contact in units of its own, so that
margins are of order one. Within a leg every contact keeps its state, so the vector field is smooth. In slip
the force is ``f = mu n e(alpha)`` with the angle ``alpha`` integrated:

    s = |w'| = (e . K u' - mu n') / (e . K e),        mu n alpha' = e_perp . (K u' - s K e)
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from timesim.model.model import SEPARATION, SLIP, STICK, Contact, Model

OFFSET = 1e-10
TIE = 0.5 * OFFSET
LOAD_FLOOR = 1e-9


class Motion(NamedTuple):
    """What is integrated: modal displacement and velocity, shape (M,), and slip angles [rad], shape (C,)."""

    displacement: Any
    velocity: Any
    angle: Any


class Scaled(NamedTuple):
    """A model in dimensionless form; forces of contact c in units of ``unit[c]`` (see `scale`)."""

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


def typical_length(model: Model, frequency: float) -> float:
    """A displacement typical of the modes: forces over the larger of stiffness and inertia."""
    structure, load, start = model.structure, model.excitation, model.start
    inertia = structure.mass * (2 * np.pi * frequency * load.harmonic[:, None]) ** 2
    amplitude = np.hypot(load.cosine, load.sine) / np.maximum(structure.stiffness, inertia)
    static = np.abs(load.constant) / np.maximum(structure.stiffness, structure.mass * (2 * np.pi * frequency) ** 2)
    begin = np.abs(start.displacement) + np.abs(start.velocity) / (2 * np.pi * frequency)
    return float(np.max(amplitude.sum(axis=0) + static + begin)) or 1.0


def scale(model: Model, frequency: float, length: float) -> Scaled:
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
    """Kinematics and forces of all contacts, each taken as closed."""

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


def field(t: jax.Array, motion: Motion, args: Leg) -> Motion:
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


def margins(motion: Motion, leg: Leg) -> jax.Array:
    """Distance of each contact from its next transition, of order one; negative beyond it. Shape (C,)."""
    p, now = leg.scaled, _contacts(motion, leg)
    rubs = p.friction > 0
    friction = jnp.where(rubs, p.friction, 1.0)
    stick = now.load - jnp.sqrt(_dot(now.trial, now.trial)) / friction
    slip = jnp.where(rubs, jnp.minimum(now.speed / p.speed, now.load), now.load)
    return jnp.select([leg.state == STICK, leg.state == SLIP], [stick, slip], -now.load)


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


def make_pad(c: int, motion: Motion, p: Scaled, slip: np.ndarray) -> Pad:
    place, rate = p.shape[c] @ motion.displacement, p.shape[c] @ motion.velocity
    load, growth = p.preload[c] + p.normal[c] * place[2], p.normal[c] * rate[2]
    return Pad(p.friction[c], p.tangential[c], place[:2], rate[:2], load, growth, slip[c], float(motion.angle[c]))


def _close(pad: Pad) -> tuple[int, np.ndarray, float]:
    """Contact begins: stuck from here where the limit grows faster than the trial force (15 to 17)."""
    if pad.friction == 0:
        return SLIP, pad.slip, pad.angle
    limit = pad.friction * pad.growth
    if np.linalg.norm(pad.stiffness @ pad.rate) < limit:
        return STICK, pad.place, pad.angle
    e = _slip_direction(pad.stiffness, pad.rate, limit)
    return SLIP, pad.slip, float(np.arctan2(e[1], e[0]))


def current_slip(state: int, pad: Pad) -> np.ndarray:
    if state == STICK:
        return pad.slip
    if state == SEPARATION or pad.friction == 0:
        return pad.place
    force = pad.friction * pad.load * np.array([np.cos(pad.angle), np.sin(pad.angle)])
    return pad.place - np.linalg.solve(pad.stiffness, force)


def transition(state: int, pad: Pad) -> tuple[int, np.ndarray, float]:
    """State after the one that ends here, with the slip it holds or the angle it slips along."""
    if state == SEPARATION:
        return _close(pad)
    if pad.load <= TIE and pad.growth < 0:
        return SEPARATION, pad.slip, pad.angle
    if state == STICK:
        force = pad.stiffness @ (pad.place - pad.slip)
        return SLIP, pad.slip, float(np.arctan2(force[1], force[0]))
    return STICK, current_slip(state, pad), pad.angle


def start_state(contact: Contact, given: int, load: float) -> int:
    if given >= 0:
        return given
    if load <= 0:
        return SEPARATION
    return STICK if contact.friction > 0 else SLIP
