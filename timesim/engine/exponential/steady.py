"""The motion that the excitation forces on each mode, and what of the structure couples the modes.

The excitation has its own steady motion in every mode, ``a_i cos(i theta) + b_i sin(i theta)``; where that would be far
larger than what the force does in a step (light damping, at resonance), the force is left to the polynomial of the
collocation instead. So is what couples the modes: a damping matrix that they do not diagonalise.
"""

from timesim.runtime import tree_class  # isort: skip

import jax.numpy as jnp
from jaxtyping import Array, Float

from timesim.engine.system import System

NEAR_RESONANCE = 1e-3  # of |k - i^2 + i d| in k + i^2: below it the force is taken into the polynomial


@tree_class
class Steady:
    """The motion that each harmonic of the excitation forces on each mode: cosine part a and sine part b.

    ``left`` is 1 where a force has no such motion and is left to the polynomial, else 0.
    """

    a: Float[Array, "harmonic mode"]
    b: Float[Array, "harmonic mode"]
    left: Float[Array, "harmonic mode"]

    @classmethod
    def of(cls, system: System) -> "Steady":
        stiffness, damping = diagonals(system)
        order = system.harmonic[:, None]
        reactance, loss = stiffness - order**2, damping * order
        square, size = reactance**2 + loss**2, (stiffness + order**2) * NEAR_RESONANCE
        near = square < size**2
        inverse = jnp.where(near, 0.0, 1 / jnp.where(near, 1.0, square))
        a = (reactance * system.cosine - loss * system.sine) * inverse
        b = (reactance * system.sine + loss * system.cosine) * inverse
        return cls(a, b, jnp.where(near, 1.0, 0.0))

    def motion(self, system: System, time: Float[Array, "*node 1"]) -> tuple[Array, Array]:
        """Displacement and velocity at times within the cycle."""
        order = system.harmonic[:, None]
        q = p = jnp.zeros((*time.shape[:-1], system.constant.shape[0]))
        for i in range(order.shape[0]):
            angle = order[i] * (time + system.phase)
            cosine, sine = jnp.cos(angle), jnp.sin(angle)
            q = q + self.a[i] * cosine + self.b[i] * sine
            p = p + order[i] * (self.b[i] * cosine - self.a[i] * sine)
        return q, p

    def remainder(self, system: System, time: Float[Array, "*node 1"]) -> Array:
        """Modal force at times within the cycle that the steady motion leaves to the polynomial."""
        force = jnp.broadcast_to(system.constant, (*time.shape[:-1], system.constant.shape[0]))
        for i in range(system.harmonic.shape[0]):
            angle = system.harmonic[i] * (time + system.phase)
            force = force + self.left[i] * (system.cosine[i] * jnp.cos(angle) + system.sine[i] * jnp.sin(angle))
        return force


def diagonals(system: System) -> tuple[Array, Array]:
    """Stiffness and damping of the modes that the flow is exact in."""
    damping = system.damping
    return system.stiffness, damping if damping.ndim == 1 else jnp.diagonal(damping)


def coupling(system: System, p: Float[Array, "*node mode"]) -> Array:
    """Modal force by which damping couples the modes: what the matrix adds to its diagonal."""
    damping = system.damping
    return jnp.zeros_like(p) if damping.ndim == 1 else -p @ (damping - jnp.diag(jnp.diagonal(damping))).T


def steady_of(system: System) -> Steady:
    """The motion that the excitation forces, from the ladder where there is one."""
    return Steady.of(system) if system.ladder is None else system.ladder.steady
