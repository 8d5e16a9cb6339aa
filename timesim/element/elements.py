"""Contacts under prescribed motion, many of them side by side, in the units of the scene."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from timesim.element.motion import CYCLE, Motion
from timesim.model.contact_state import contact_state, require_cone
from timesim.model.model import SEPARATION, Contact


@dataclass(frozen=True)
class Elements:
    """Contacts under prescribed motion, N of them side by side.

    Attributes:
        friction, normal_stiffness, preload: mu, k_v and n0, shape (N,).
        stiffness: K_u, shape (N, 2, 2).
        start, rate: (u1, u2, v) and its derivative at θ = 0, shape (N, 3) [length].
        length: unit of length, the size of the motion, shape (N,) [length].
        limit: largest limit force mu n of the cycle, shape (N,) [force]; zero without contact or friction.
    """

    friction: np.ndarray
    normal_stiffness: np.ndarray
    preload: np.ndarray
    stiffness: np.ndarray
    start: np.ndarray
    rate: np.ndarray
    length: np.ndarray
    limit: np.ndarray

    @property
    def size(self) -> int:
        """How many."""
        return self.friction.size

    @property
    def isotropic(self) -> bool:
        """Whether every K_u is a multiple of the unit matrix."""
        K = self.stiffness
        return bool(np.all(K[:, 0, 1] == 0) and np.all(K[:, 0, 0] == K[:, 1, 1]))

    @property
    def live(self) -> np.ndarray:
        """Which of them can have a friction force at all, shape (N,)."""
        return self.limit > 0

    @property
    def force(self) -> np.ndarray:
        """Unit of force, shape (N,) [force]."""
        other = np.abs(self.preload) + self.normal_stiffness * self.length
        return np.where(self.live, self.limit, np.where(other > 0, other, 1.0))

    @property
    def start_state(self) -> np.ndarray:
        """State at θ = 0, where f = 0 in contact, shape (N,)."""
        stiffness = self.normal_stiffness
        load = self.preload + stiffness * self.start[:, 2]
        floor = 1e-14 * (np.abs(self.preload) + stiffness * np.hypot(self.start[:, 2], self.rate[:, 2]))
        return contact_state(load, self.friction, SEPARATION, rounding=floor)

    def pick(self, rows: np.ndarray) -> "Elements":
        """Some of them."""
        return replace(self, **{item.name: getattr(self, item.name)[rows] for item in fields(self)})


def harmonic_elements(
    friction: Any, normal_stiffness: Any, preload: Any, stiffness: np.ndarray, phasor: np.ndarray
) -> Elements:
    """Contacts under harmonic motion.

    Args:
        friction, normal_stiffness, preload: numbers or arrays of shape (N,).
        stiffness: K_u, shape (2, 2) or (N, 2, 2).
        phasor: (u1, u2, v) = Im(phasor exp(i θ)), shape (N, 3) [length].
    """
    count = len(phasor)
    mu, kv, n0 = (np.broadcast_to(np.asarray(x, float), (count,)) for x in (friction, normal_stiffness, preload))
    size = np.abs(phasor)
    length = np.where(np.any(size[:, :2] > 0, axis=1), size[:, :2].max(axis=1), size[:, 2])
    limit = mu * np.maximum(n0 + kv * size[:, 2], 0.0)
    K = np.broadcast_to(np.asarray(stiffness, float), (count, 2, 2))
    return Elements(mu, kv, n0, K, phasor.imag, phasor.real, np.where(length > 0, length, 1.0), limit)


def single_element(contact: Contact, motion: Motion) -> Elements:
    """One contact under any motion."""
    require_cone([contact], "prescribed motion")
    extremes, _ = motion.crossings(np.array([0.0, 0.0, 1.0]), 0.0, rate=True)
    angles = np.linspace(0.0, CYCLE, 721)
    v = motion.evaluate(np.append(extremes, 0.0))[0][2]
    y = np.abs(motion.evaluate(angles)[0]).max(axis=1)
    length = y[:2].max() if np.any(y[:2]) else y[2]
    limit = contact.friction * max(contact.preload + contact.normal_stiffness * v.max(), 0.0)
    start, rate = motion.evaluate(0.0)
    numbers = (contact.friction, contact.normal_stiffness, contact.preload, contact.tangential_stiffness)
    column = [np.asarray(x, float)[None] for x in (*numbers, start, rate, length or 1.0, limit)]
    return Elements(*column)
