"""Contacts under prescribed motion, many of them side by side, each in units of its own."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from timesim.element.motion import CYCLE, PrescribedMotion
from timesim.engine.law.cone import ConeLaw, matrix_and_inverse
from timesim.model.contact_state import contact_state, require_cone
from timesim.model.model import SEPARATION, Contact


@dataclass(frozen=True)
class Elements:
    """N contacts under prescribed motion, in units of length and force of their own.

    Attributes:
        friction, normal_stiffness, preload: mu, k_v and n0, shape (N,).
        stiffness: K_u, shape (N, 2, 2).
        start, rate: (u1, u2, v) and its derivative at θ = 0, shape (N, 3).
        length: unit of length, the size of the motion, shape (N,) [length].
        force: unit of force, the largest limit force mu n of the cycle; another one where that is zero, shape (N,)
            [force].
    """

    friction: np.ndarray
    normal_stiffness: np.ndarray
    preload: np.ndarray
    stiffness: np.ndarray
    start: np.ndarray
    rate: np.ndarray
    length: np.ndarray
    force: np.ndarray

    @property
    def size(self) -> int:
        """N."""
        return self.friction.size

    @property
    def least_load(self) -> np.ndarray:
        """Least normal load of a harmonic motion, below zero where the contact would have to pull, shape (N,)."""
        return self.preload - self.normal_stiffness * np.hypot(self.start[:, 2], self.rate[:, 2])

    @property
    def start_state(self) -> np.ndarray:
        """State at θ = 0, where f = 0 in contact, shape (N,)."""
        load = self.preload + self.normal_stiffness * self.start[:, 2]
        reach = np.hypot(self.start[:, 2], self.rate[:, 2])
        floor = 1e-14 * (np.abs(self.preload) + self.normal_stiffness * reach)
        return contact_state(load, self.friction, SEPARATION, rounding=floor)

    def law(self) -> ConeLaw:
        """Their law, N contacts."""
        stiffness, compliance = matrix_and_inverse(self.stiffness)
        return ConeLaw(self.friction, stiffness, compliance, self.normal_stiffness, self.preload)

    def start_force(self, slip: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Friction force at θ = 0 of slips, shape (N, 2), in states, shape (N,); shape (N, 2)."""
        elastic = np.einsum("nij,nj->ni", self.stiffness, self.start[:, :2] - slip)
        return np.where(state[:, None] == SEPARATION, 0.0, elastic)

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
    size, one = np.abs(phasor), np.ones(len(phasor))
    mu, kv, n0 = (np.broadcast_to(np.asarray(x, float), len(phasor)) for x in (friction, normal_stiffness, preload))
    K = np.broadcast_to(np.asarray(stiffness, float), (len(phasor), 2, 2))
    return _in_own_units(Elements(mu, kv, n0, K, phasor.imag, phasor.real, one, one), size, size[:, 2])


def single_element(contact: Contact, motion: PrescribedMotion) -> Elements:
    """One contact under any motion."""
    require_cone([contact], "prescribed motion")
    closest = motion.evaluate(motion.normal_extremes)[0][2].max(keepdims=True)
    size = np.abs(motion.evaluate(np.linspace(0.0, CYCLE, 721))[0]).max(axis=1)[None]
    start, rate = (x[None] for x in motion.evaluate(0.0))
    mu, kv, n0 = np.array([[contact.friction], [contact.normal_stiffness], [contact.preload]], float)
    one = np.ones(1)
    return _in_own_units(Elements(mu, kv, n0, contact.tangential_stiffness[None], start, rate, one, one), size, closest)


def _in_own_units(given: Elements, size: np.ndarray, closest: np.ndarray) -> Elements:
    """Elements from those of the scene; ``size``: of u1, u2 and v, shape (N, 3); ``closest``: largest v."""
    tangential = size[:, :2].max(axis=1)
    length = np.where(tangential > 0, tangential, np.where(size[:, 2] > 0, size[:, 2], 1.0))
    limit = given.friction * np.maximum(given.preload + given.normal_stiffness * closest, 0.0)
    other = np.abs(given.preload) + given.normal_stiffness * length
    force = np.where(limit > 0, limit, np.where(other > 0, other, 1.0))
    ratio = length / force
    return replace(
        given,
        normal_stiffness=given.normal_stiffness * ratio,
        preload=given.preload / force,
        stiffness=given.stiffness * ratio[:, None, None],
        start=given.start / length[:, None],
        rate=given.rate / length[:, None],
        length=length,
        force=force,
    )
