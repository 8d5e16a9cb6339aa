"""A contact law of the tests: a frictionless stop whose damping grows with its load (Hunt & Crossley 1975).

    n = (n0 + k_v v) (1 + c v')

Contact begins and ends where n0 + k_v v = 0, so n has no jump there.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from timesim.engine.law.contact_law import ContactLaw, Motion, Plane, Reaction, Scalar, State
from timesim.model.model import SEPARATION, SLIP, Contact
from timesim.model.scales import Scales


class HuntCrossley(ContactLaw):
    """The parameter ``damping`` of a contact is c [time/length]."""

    damping: Scalar
    normal_stiffness: Scalar
    preload: Scalar

    @classmethod
    def of(cls, contacts: Sequence[Contact], scales: Scales, axes: np.ndarray | None = None) -> "HuntCrossley":
        damping = np.array([c.law_parameters["damping"] for c in contacts]) * (scales.length * scales.omega)
        stiffness = np.array([c.normal_stiffness for c in contacts]) * (scales.length / scales.force)
        return cls(damping, stiffness, np.array([c.preload for c in contacts]) / scales.force)

    @staticmethod
    def start_states(contacts: Sequence[Contact], normal: np.ndarray) -> np.ndarray:
        return np.where(normal > 0, SLIP, SEPARATION)

    def _load(self, motion: Motion) -> Scalar:
        return self.preload + self.normal_stiffness * motion.v

    def reaction(self, state: State, motion: Motion, w: Plane) -> Reaction:
        load = jnp.where(state == SEPARATION, 0.0, self._load(motion))
        drag = load * self.damping * motion.dv
        none = tuple(jnp.zeros_like(u) for u in motion.u)
        return Reaction(none, load + drag, motion.du, drag * motion.dv)

    def margins(self, state: State, motion: Motion, w: Plane) -> tuple[Scalar, Scalar]:
        load = self._load(motion)
        return jnp.where(state == SEPARATION, -load, load), jnp.ones_like(load)

    def successor(self, state: State, motion: Motion) -> State:
        return jnp.where(state == SEPARATION, SLIP, SEPARATION)

    def slip_at_transition(self, before: State, after: State, motion: Motion, w: Plane) -> Plane:
        return motion.u

    def scale(self, state: State) -> Scalar:
        return self.normal_stiffness + jnp.abs(self.preload)

    @staticmethod
    def stored_energy(
        contact: Contact, motion: np.ndarray, slip: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        closed = max(contact.preload, 0.0)
        load = np.maximum(contact.preload + contact.normal_stiffness * motion[:, 2], 0.0)
        return ((load**2 - closed**2) / (2 * contact.normal_stiffness) - closed * motion[:, 2],)
