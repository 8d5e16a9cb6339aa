"""The state a run starts from: at rest, in equilibrium, as given, or where another run ended.

A contact whose state is left at -1 is separated if its normal load is not positive, else stuck, or as another law than
the cone says; the slip ``w`` of a separated contact is its motion ``u``, and so is that of a frictionless one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from timesim.fault import RuleError
from timesim.model.contact_state import (
    UNKNOWN,
    ContactLoads,
    contact_loads,
    contact_state,
    obeys_cone,
    slip_follows_motion,
)
from timesim.model.mode_shapes import SAME, ModeShapes
from timesim.model.model import SEPARATION, SLIP, STICK, Model, Start

ROUNDING = 1e-9
"""Share by which |f| may exceed mu n in a start. The event loop needs it inside: such a slip is set back by as much."""
RESULT_ROUNDING = 1e-6
"""The same where another run ended: its own tolerance. Such a slip is set back onto the cone."""
MAX_STATES = 200


def rest_start(num_modes: int, num_contacts: int) -> Start:
    """No displacement, no velocity, no slip."""
    zero = np.zeros(num_modes)
    return Start(zero, zero.copy(), np.zeros((num_contacts, 2)), np.full(num_contacts, UNKNOWN))


def given_start(physics: Model, displacement: np.ndarray, velocity: np.ndarray, slip: np.ndarray) -> Start:
    """The state as given; contact states follow from it.

    Raises:
        RuleError: a contact's friction force would lie outside its cone.
    """
    loads = contact_loads(physics, displacement, slip)
    follows = slip_follows_motion(contact_state(loads.normal, physics.friction), physics.friction)
    slip = _slip_in_cone(physics, loads, follows, "give the slip that the contact has in this state", ("slip",))
    return Start(displacement, velocity, slip, np.full(physics.num_contacts, UNKNOWN))


def _slip_in_cone(
    physics: Model,
    loads: ContactLoads,
    follows: np.ndarray,
    hint: str,
    key: tuple[str, ...] = (),
    *,
    rounding: float = ROUNDING,
    room: float = 1 - ROUNDING,
) -> np.ndarray:
    """The slip: the motion of contacts in `follows`, else as given, set back where rounding puts a force off its cone.

    Raises:
        RuleError: it is off by more.
    """
    for i in np.flatnonzero(~follows & (loads.size > loads.limit * (1 + rounding))):
        name = physics.contacts[i].name
        cone = f"|f| = {loads.size[i]:.6g} > mu n = {loads.limit[i]:.6g}"
        rule = f"contact {name} would start outside its friction cone: {cone}"
        raise RuleError((*key, name) if key else (), rule, hint)
    off_cone = loads.size > loads.limit
    inside = np.where(off_cone[:, None], loads.slip_in_cone(room), loads.slip)
    return np.where(follows[:, None], loads.motion, inside)


def static_start(physics: Model) -> Start:
    """Equilibrium under the constant forces: each contact open, or stuck from w = 0, as it comes out.

    Solves ``m omega^2 q = p + sum B^T g`` for an assumed set of closed contacts, and changes the set until it
    agrees with the normal loads: all that disagree at once; after a set comes back, the first of them only.

    Raises:
        RuleError: no set agrees, nothing restrains a mode of frequency 0, a displacement is too large for a number, or
            a contact leaves its cone.
    """
    closed = physics.preload > 0
    seen: set[bytes] = set()
    for _ in range(MAX_STATES):
        displacement, restrained = _equilibrium(physics, closed)
        loads = contact_loads(physics, displacement, np.zeros((physics.num_contacts, 2)))
        wrong = np.flatnonzero((loads.normal > 0) != closed)
        if not wrong.size:
            break
        change = wrong[:1] if closed.tobytes() in seen else wrong
        seen.add(closed.tobytes())
        closed[change] = ~closed[change]
    else:
        raise RuleError((), "finds no equilibrium: the contacts open and close in turn", "start from rest")
    if not restrained:
        raise RuleError((), "finds no equilibrium: nothing holds a mode of frequency 0", "start from rest")
    state = contact_state(loads.normal, physics.friction)
    follows = slip_follows_motion(state, physics.friction)
    hint = "the equilibrium slips: reduce the constant forces, or start from rest or a settled result"
    return Start(displacement, np.zeros_like(displacement), _slip_in_cone(physics, loads, follows, hint), state)


def _equilibrium(physics: Model, closed: np.ndarray) -> tuple[np.ndarray, bool]:
    """Displacement with these contacts closed, and whether no force acts on a motion that nothing restrains."""
    matrix = np.diag(physics.structure.stiffness)
    force = physics.excitation.constant.copy()
    shapes = physics.contact_shape
    for c in physics.summation_order:
        contact, shape = physics.contacts[c], shapes[c]
        carried = max(contact.preload, 0.0)
        if not closed[c]:
            force += shape[2] * carried
            continue
        matrix += shape[:2].T @ contact.tangential_stiffness @ shape[:2]
        matrix += contact.normal_stiffness * np.outer(shape[2], shape[2])
        force -= shape[2] * (contact.preload - carried)
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, np.sqrt(physics.structure.mass))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    loose = vectors[:, values <= 1e-12].T @ (force / scale)
    # A loose body is moved far along the force, which closes what can stop it.
    solved = (vectors / np.maximum(values, 1e-9)) @ (vectors.T @ (force / scale))
    with np.errstate(over="ignore"):
        displacement = solved / scale
    if not np.all(np.isfinite(displacement)):
        rule = "finds no equilibrium: a displacement exceeds the largest number"
        raise RuleError((), rule, "give masses and stiffnesses in units that suit the forces")
    return displacement, bool(np.all(np.abs(loose) <= 1e-12 * np.linalg.norm(force / scale)))


def resumed_start(
    physics: Model,
    end: Start,
    contacts: Sequence[str],
    shapes: ModeShapes | None = None,
    frames: np.ndarray | None = None,
    bodies: Sequence[tuple[str, str]] = (),
) -> Start:
    """The state that another run has ended in, adapted to a model.

    Args:
        physics: the model, with as many modes and the same contacts.
        end: that state, its phase included.
        contacts: names of the contacts in the order of `end`.
        shapes, frames, bodies: of its modes and contacts, frames of shape (C, 3, 3), where they are known; else they
            are taken for those of the model.

    Raises:
        RuleError: the state is one of another structure or of contacts with other bodies or normals, or lies outside a
            cone.
    """
    names, modes = [contact.name for contact in physics.contacts], physics.structure.num_modes
    if sorted(contacts) != sorted(names):
        hint = f"the scene has {', '.join(names) or 'none'}"
        raise RuleError((), f"has other contacts: {', '.join(contacts) or 'none'}", hint)
    if end.displacement.shape != (modes,) or end.velocity.shape != (modes,):
        own = end.displacement.size
        raise RuleError((), f"has {own} mode{'s' * (own != 1)}, the scene has {modes}")
    if not all(np.all(np.isfinite(value)) for value in (end.displacement, end.velocity, end.slip)):
        raise RuleError((), "holds a final state that is not finite")
    change = shapes.change(physics.structure) if shapes is not None else None
    if change is not None:
        end = replace(end, displacement=change @ end.displacement, velocity=change @ end.velocity)
    rows = [contacts.index(name) for name in names]
    slip, before = end.slip.reshape(-1, 2)[rows], end.state.astype(int).ravel()[rows]
    if bodies:
        _check_bodies(physics, [bodies[i] for i in rows], before)
    if frames is not None:
        slip = _turned(physics, slip, frames[rows], before)
    loads = contact_loads(physics, end.displacement, slip)
    rounding = ROUNDING * (np.abs(physics.preload) + np.abs(loads.normal - physics.preload))
    # One that slipped sticks where more friction, a larger load or less stiffness has left its force inside the cone.
    held = (before == SLIP) & (loads.size < loads.limit * (1 - RESULT_ROUNDING))
    state = contact_state(loads.normal, physics.friction, np.where(held, STICK, before), rounding=rounding)
    kept = np.where((state == SEPARATION) == (before == SEPARATION), before, UNKNOWN)
    state = np.where(obeys_cone(physics), state, kept)
    follows = slip_follows_motion(state, physics.friction) | (before == SEPARATION)
    hint = "its friction or preload was higher there, or its tangential stiffness lower"
    slip = _slip_in_cone(physics, loads, follows, hint, rounding=RESULT_ROUNDING, room=1.0)
    return replace(end, slip=slip, state=state)


def _check_bodies(physics: Model, bodies: Sequence[tuple[str, str]], before: np.ndarray) -> None:
    """Refuse the slip of a contact that joined others than in the model; where it was apart, its slip is its motion."""
    for contact, joined, state in zip(physics.contacts, bodies, before, strict=True):
        if state != SEPARATION and contact.friction > 0 and joined != (contact.point, contact.against):
            there, here = " and ".join(joined), f"{contact.point} and {contact.against}"
            rule = f"has contact {contact.name} between {there}, the scene between {here}: its slip is another"
            raise RuleError((), rule, "take the bodies of that result, or start from rest")


def _turned(physics: Model, slip: np.ndarray, frames: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Slips in the frames of the model's contacts; that of a contact that was apart follows from its motion anyway.

    Raises:
        RuleError: a contact that was closed has another normal.
    """
    turned = slip.copy()
    for i in np.flatnonzero(before != SEPARATION):
        turn = physics.contacts[i].frame @ frames[i].T
        if np.abs(turn - np.eye(3)).max() <= SAME:
            continue
        if np.abs(turn[2] - [0, 0, 1]).max() > SAME:
            normal = ", ".join(f"{part:.6g}" for part in frames[i, 2])
            rule = f"has another normal of contact {physics.contacts[i].name}, in whose plane it slipped: [{normal}]"
            raise RuleError((), rule, "take the normal of that result, or start from rest")
        turned[i] = turn[:2, :2] @ slip[i]
    return turned
