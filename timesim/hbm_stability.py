"""Stability of periodic solutions: Floquet multipliers of the linearised contact law.

Over one sample interval the modes move exactly for a contact force that varies linearly, and the law of
`timesim.period`, linearised about the solution, gives that force from the motion and from the elastic displacement d of
the contacts. The product of these maps over the period takes a disturbance of (q, q', d) to the next one. The memory
of the contacts is therefore a part of the state; the transitions need no jumps of their own, since the contact force
is continuous through all of them and their shift is in the derivatives of an interval. What is not captured are
disturbances so large that states occur which the solution does not have: full stick that a small push would free.
"""

import timesim.jax_setup  # noqa: F401  isort: skip

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray
from scipy.linalg import expm

from timesim.contact import Law, normal_load
from timesim.hbm import Balance
from timesim.period import Basis, basis_of, before_intervals, closed_period, intervals_of, motion_of
from timesim.period_tangent import slopes

# Multipliers beyond this count as unstable: those of an undamped structure lie on the circle, give or take the error
# of the samples.
BORDER = 1 + 1e-3
SAMPLES = 128


class _Step(eqx.Module):
    """The modes over an interval: x1 = keep x0 + first g0 + last g1, and what the contacts see of x."""

    keep: Float[Array, "state state"]
    first: Float[Array, "state force"]
    last: Float[Array, "state force"]
    see: Float[Array, "force state"]


def _step_of(balance: Balance, frequency: float, num_samples: int) -> _Step:
    """One interval; time in periods over 2 pi, forces on the contacts in units of their stiffness times length."""
    omega, structure = 2 * np.pi * frequency, balance.model.structure
    size, num_forces = structure.num_modes, 3 * balance.num_contacts
    damping = np.diag(balance.damping) if balance.damping.ndim == 1 else balance.damping
    span = 2 * np.pi / num_samples
    whole = np.zeros((2 * size + 2 * num_forces,) * 2)
    whole[:size, size : 2 * size] = np.eye(size) * span
    whole[size : 2 * size, :size] = -np.diag((structure.omega / omega) ** 2) * span
    whole[size : 2 * size, size : 2 * size] = -damping / omega * span
    whole[size : 2 * size, 2 * size : -num_forces] = balance.shape.T * (span / omega**2)
    whole[2 * size : -num_forces, -num_forces:] = np.eye(num_forces)
    flow = expm(whole)[: 2 * size]
    last = flow[:, -num_forces:]
    see = np.concatenate([balance.shape, np.zeros_like(balance.shape)], axis=1)
    keep, first = flow[:, : 2 * size], flow[:, 2 * size : -num_forces] - last
    return _Step(*(jnp.asarray(part) for part in (keep, first, last, see)))


@jax.jit
def _monodromy(
    law: Law, ratio: Float[Array, ""], step: _Step, basis: Basis, coefficient: Float[Array, "contact 3 coefficient"]
) -> Float[Array, "all all"]:
    """Product of the maps of (x, d) over the intervals of a period."""
    motion = motion_of(basis, coefficient)
    period = closed_period(law, motion)
    slope = slopes(law, before_intervals(period), intervals_of(motion))
    num_contacts = law.friction.shape[0]
    each = jnp.arange(num_contacts)
    spring = _spring(law) * ratio
    touching = (normal_load(law, motion.v) > 0) * law.normal_stiffness * ratio
    num_states = step.keep.shape[0]

    def blocks(small: Array) -> Array:
        """Block diagonal matrix of one block a contact."""
        rows, columns = small.shape[1:]
        whole = jnp.zeros((num_contacts, rows, num_contacts, columns)).at[each, :, each].set(small)
        return whole.reshape(num_contacts * rows, num_contacts * columns)

    def advance(state: tuple[Array, Array, Array, Array], at: tuple[Array, ...]) -> tuple[tuple[Array, ...], None]:
        """Columns of x, d, the contact force g and the motion y at the start of the interval, to its end."""
        x, d, g, y = state
        carry, change, load, open_ = at
        rising = change.at[:, :, 2].add(load)
        kept = blocks(carry) @ d - blocks(change) @ y
        press = jnp.zeros((num_contacts, 3, 3)).at[:, 2, 2].set(open_)
        # g1 = -K (kept + rising y1) - press y1, and y1 follows from g1.
        stiff = spring @ blocks(rising) + blocks(press)
        free = step.keep @ x + step.first @ g - step.last @ (spring @ kept)
        seen = jnp.eye(3 * num_contacts) + step.see @ step.last @ stiff
        y = jnp.linalg.solve(seen, step.see @ free)
        x, d = free - step.last @ (stiff @ y), kept + blocks(rising) @ y
        return (x, d, -spring @ d - blocks(press) @ y, y), None

    start = jnp.eye(num_states + 2 * num_contacts)
    x, d = start[:num_states], start[num_states:]
    y = step.see @ x
    press = blocks(jnp.zeros((num_contacts, 3, 3)).at[:, 2, 2].set(touching[-1]))
    begin = (x, d, -spring @ d - press @ y, y)
    (x, d, _, _), _ = jax.lax.scan(advance, begin, (slope.carry, slope.change, slope.load, touching))
    return jnp.concatenate([x, d])


def _spring(law: Law) -> Float[Array, "force displacement"]:
    """K_u of all contacts, from (d1, d2) to (f1, f2, 0), shape (3C, 2C)."""
    num_contacts = law.friction.shape[0]
    k11, k12, k22 = law.stiffness if len(law.stiffness) == 3 else (law.stiffness[0], 0.0, law.stiffness[0])
    each = jnp.arange(num_contacts)
    whole = jnp.zeros((num_contacts, 3, num_contacts, 2))
    for row, column, value in ((0, 0, k11), (0, 1, k12), (1, 0, k12), (1, 1, k22)):
        whole = whole.at[each, row, each, column].set(value)
    return whole.reshape(3 * num_contacts, 2 * num_contacts)


def floquet_multipliers(
    balance: Balance, x: NDArray[np.float64], frequency: float, *, samples: int = SAMPLES
) -> NDArray[np.complex128]:
    """Multipliers of a solution, largest first; a contact in full stick gives two that are 1.

    Args:
        balance: the equations solved.
        x: unknowns of `Balance`, shape (n,).
        frequency: of the excitation [Hz].

    Keyword Args:
        samples: of the period; second order.

    Returns:
        multipliers, shape (2M + 2C,).
    """
    step = _step_of(balance, frequency, samples)
    basis = basis_of(balance.setting.harmonics, samples)
    ratio = jnp.asarray(balance.force / balance.length)
    matrix = _monodromy(balance.law, ratio, step, basis, jnp.asarray(balance.coefficients(x)))
    multipliers = np.linalg.eigvals(np.asarray(matrix))
    return multipliers[np.argsort(-np.abs(multipliers))]
