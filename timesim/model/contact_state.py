"""Which state a contact is in at a given motion, load and slip, and which slip goes with it (equations 1 to 5).

A contact is apart where its normal load n is not positive; one that touches sticks, unless it is known to slip or has
no friction. The slip w of a contact that is apart, or that has no friction, is its motion u. That of one that sticks
may be anything that leaves its force in the cone, ``|K_u (u - w)| <= mu n``. That is the law of the cone.
Another law says itself in which state its contacts start, and nothing here limits their slip.

Elementwise in numpy; C counts contacts.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from timesim.model.model import CONE, SEPARATION, SLIP, STICK, Contact, Model

UNKNOWN = -1
"""Stands for a state that follows from the motion."""


def contact_state(
    normal: ArrayLike, friction: ArrayLike, before: ArrayLike = UNKNOWN, *, rounding: ArrayLike = 0.0
) -> np.ndarray:
    """State of contacts under a normal load.

    Args:
        normal: n0 + k_v v [force].
        friction: mu.
        before: state in which they were, or `UNKNOWN`. One that slips goes on slipping as long as it touches.
        rounding: load [force] up to which a contact that was apart stays so.
    """
    touches = np.asarray(normal) > np.where(np.equal(before, SEPARATION), rounding, 0.0)
    slips = np.equal(before, SLIP) | np.equal(friction, 0)
    return np.where(touches, np.where(slips, SLIP, STICK), SEPARATION)


def slip_follows_motion(state: ArrayLike, friction: ArrayLike) -> np.ndarray:
    """Whether the slip w is the motion u: of a contact that is apart, or has no friction."""
    return np.equal(state, SEPARATION) | np.equal(friction, 0)


def cone_states(contacts: Sequence[Contact], normal: np.ndarray) -> np.ndarray:
    """States in which contacts of the cone law start under a normal load [force], shape (C,)."""
    return contact_state(normal, np.array([contact.friction for contact in contacts], dtype=float))


def start_states(model: Model, rule: Callable[[Sequence[Contact], np.ndarray], np.ndarray] = cone_states) -> np.ndarray:
    """State of each contact at the start of a model, shape (C,): as given, else by the rule of its law."""
    given = np.asarray(model.start.state, dtype=int)
    normal = model.preload + model.normal_stiffness * (model.contact_shape[:, 2] @ model.start.displacement)
    return np.where(given == UNKNOWN, rule(model.contacts, normal), given)


@dataclass(frozen=True)
class ContactLoads:
    """Motions and forces of the contacts of a model at a displacement and a slip.

    Attributes:
        motion: u, shape (C, 2).
        slip: w, shape (C, 2).
        force: friction force K_u (u - w) of a contact that sticks, shape (C, 2).
        normal: n0 + k_v v, negative where the bodies are apart, shape (C,).
        limit: mu max(n, 0), infinite under another law than the cone, shape (C,).
    """

    motion: np.ndarray
    slip: np.ndarray
    force: np.ndarray
    normal: np.ndarray
    limit: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """|f|, shape (C,)."""
        return np.linalg.norm(self.force, axis=1)

    def slip_in_cone(self, room: float = 1.0) -> np.ndarray:
        """The slip, moved towards u where |f| exceeds its limit, to a share ``room`` of it, shape (C, 2)."""
        size, limit = self.size, room * self.limit
        excess = np.where(size > limit, 1 - limit / np.where(size > 0, size, 1.0), 0.0)
        return self.slip + (self.motion - self.slip) * excess[:, None]


def contact_loads(model: Model, displacement: np.ndarray, slip: np.ndarray) -> ContactLoads:
    """Motions and forces of the contacts at a modal displacement, shape (M,), and a slip, shape (C, 2)."""
    relative = model.contact_shape @ displacement
    normal = model.preload + model.normal_stiffness * relative[:, 2]
    force = np.einsum("cij,cj->ci", model.tangential_stiffness, relative[:, :2] - slip)
    limit = np.where(obeys_cone(model), model.friction * np.maximum(normal, 0.0), np.inf)
    return ContactLoads(relative[:, :2], slip, force, normal, limit)


def obeys_cone(model: Model) -> np.ndarray:
    """Whether each contact obeys the law of the cone, shape (C,)."""
    return np.array([contact.law == CONE for contact in model.contacts], dtype=bool)


def require_cone(contacts: Iterable[Contact], what: str) -> None:
    """Refuse contacts of another law where only the friction cone is implemented.

    Raises:
        ValueError: a contact obeys another law.
    """
    for contact in contacts:
        if contact.law != CONE:
            raise ValueError(f"contact {contact.name}: {what} knows the law {CONE} only, not {contact.law}")
