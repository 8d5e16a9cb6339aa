"""The angle of the direction of slip over a step: an equation without a division by n.

With ``f = mu n e``, ``e = (cos alpha, sin alpha)``, and the slip speed eliminated from ``f' = K_u (u' - s e)``,

    mu n (e . K_u e) alpha' = det(K_u) (e x u') - mu n' ((K_u e)^perp . e),

where ``a x b = a_1 b_2 - a_2 b_1`` and the last factor is ``(k_1 - k_2) sin(alpha) cos(alpha)`` along the principal
axes of K_u. At n = 0 the left side vanishes, and what remains is the direction in which a slip starts or ends (equation
18 for isotropic K_u): a step may reach it, where an explicit one meets a rate without bound.
"""

import timesim.runtime  # noqa: F401  isort: skip

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from timesim.engine.barrier import apart, matmul
from timesim.engine.law.contact_law import Plane, Scalar
from timesim.engine.law.rule import Rule

MOST_TURN = 1.0  # of a correction [rad]


class Turning(NamedTuple):
    """What turns the slip at the nodes of a step, arrays of shape (node, contact).

    Attributes:
        friction: mu.
        stiffness: K_u along its principal axes, one number where it is isotropic.
        n, dn: normal load and its rate.
        du: rate of the tangential motion.
    """

    friction: Scalar
    stiffness: tuple[Scalar, ...]
    n: Scalar
    dn: Scalar
    du: Plane


def angle_of(e: Plane) -> Scalar:
    """Angle of a direction; of straight motion, 0 or pi. That of none is 0, and its derivative finite."""
    sine = e[1] if len(e) == 2 else jnp.zeros_like(e[0])
    return jnp.arctan2(sine, jnp.where((e[0] == 0) & (sine == 0), 1.0, e[0]))


@partial(apart, static=(1,))
def direction_of(angle: Scalar, size: int) -> Plane:
    """The inverse of `angle_of`."""
    return (jnp.cos(angle), jnp.sin(angle))[:size]


def newton_step(
    turning: Turning, slips: Bool[Array, " contact"], angle: Float[Array, "node contact"], h: Scalar, rule: Rule
) -> Float[Array, "node contact"]:
    """A step of Newton's method on the angles at the nodes of contacts that slip; the first row is the start's."""
    mu, stiffness, n, dn, du = turning
    n = jnp.maximum(n, 0.0)
    own = angle[1:]
    cosine, sine = direction_of(own, 2)
    along, across = cosine * du[0] + sine * du[1], cosine * du[1] - sine * du[0]
    slopes = matmul(jnp.asarray(rule.slopes), angle - angle[:1])
    k1, k2 = stiffness[0], stiffness[-1]
    # Over k_1, so that neither a stiff contact nor a soft one leaves the range of numbers.
    ratio = k2 / jnp.where(k1 > 0, k1, 1.0)
    along_k = cosine**2 + ratio * sine**2
    drift = h * mu * (1 - ratio) * dn
    value = mu * n * along_k * slopes - h * k2 * across + drift * sine * cosine
    turn = 2 * mu * n * slopes * (ratio - 1) * sine * cosine + h * k2 * along + drift * (cosine**2 - sine**2)
    num = own.shape[0]
    matrix = [[mu * n[j] * along_k[j] * rule.slopes[j, k + 1] for k in range(num)] for j in range(num)]
    matrix = [[entry + turn[j] if j == k else entry for k, entry in enumerate(row)] for j, row in enumerate(matrix)]
    # The derivative of the matrix counts for nothing, as the step is next to none where a derivative is taken.
    change = jnp.stack(solved(jax.lax.stop_gradient(matrix), [value[j] for j in range(num)]))
    change = jnp.where(slips & jnp.isfinite(change), jnp.clip(change, -MOST_TURN, MOST_TURN), 0.0)
    return jnp.concatenate([angle[:1], own - change])


def solved(matrix: list[list[Array]], right: list[Array]) -> list[Array]:
    """Solution of small systems side by side, by elimination without exchange of rows."""
    matrix, right, num = [list(row) for row in matrix], list(right), len(right)
    for j in range(num):
        pivot = 1 / jnp.where(matrix[j][j] == 0, 1.0, matrix[j][j])
        for i in range(j + 1, num):
            factor = matrix[i][j] * pivot
            right[i] = right[i] - factor * right[j]
            for k in range(j + 1, num):
                matrix[i][k] = matrix[i][k] - factor * matrix[j][k]
    solution: list[Array] = [right[0]] * num
    for j in range(num - 1, -1, -1):
        rest = right[j]
        for k in range(j + 1, num):
            rest = rest - matrix[j][k] * solution[k]
        solution[j] = rest / jnp.where(matrix[j][j] == 0, 1.0, matrix[j][j])
    return solution
