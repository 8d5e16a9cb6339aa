"""The exact flow of modes between transitions, under forces that are polynomials of time.

A mode obeys ``z'' + d z' + k z = sum_m c_m (t / h)^m``. With J_0 its response to a unit impulse and J_(m+1) the
integral of J_m,

    z  = (1 - k J_1) z_0 + J_0 z'_0 + sum_m c_m m! h^-m J_(m+1),
    z' = -k J_0 z_0 + (1 - k J_1 - d J_0) z'_0 + sum_m c_m m! h^-m J_m.

The integrals are ``J_m = t^(m+1) psi_m(k t^2, d t)``, in real arithmetic for any mode: of a rigid body, underdamped,
critically damped or overdamped. ``psi_(m-1) + d t psi_m + k t^2 psi_(m+1) = 1 / m!`` links three of them;
it is used downwards from a series where t is short and upwards from the closed form where it is long. They take the
place of the phi functions of exponential integrators (M. Hochbruck & A. Ostermann, Exponential integrators, Acta
Numerica 19 (2010) 209-286).

Modes are the last axis.
"""

import timesim.runtime  # noqa: F401  isort: skip

import math
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from timesim.engine.barrier import apart

NUM_TERMS = 38  # of the series: (2 + sqrt 8)^38 / 38! = 2e-19
SHORT = 4.0  # k t^2, and d t, up to which the series is used


class Weights(NamedTuple):
    """The flow over a time t as numbers to multiply with, each of the shape of t and the modes.

    Attributes:
        q_q, q_p: displacement at the end for a unit of displacement and velocity at the start.
        p_q, p_p: velocity for the same.
        q_force, p_force: displacement and velocity for a unit of each coefficient of the force, lowest first.
    """

    q_q: Array
    q_p: Array
    p_q: Array
    p_p: Array
    q_force: tuple[Array, ...]
    p_force: tuple[Array, ...]


def weights(stiffness: Array, damping: Array, t: Array, h: Array, num: int) -> Weights:
    """The flow over a time t under forces with ``num`` coefficients of powers of a fraction of h.

    Stiffness and damping of the modes are not negative; the times t and h are of shapes that broadcast with those.
    """
    k, d = stiffness, damping
    psi = impulse_integrals(k * t * t, d * t, num + 1)
    impulse, step = t * psi[0], t * t * psi[1]
    share = t / h
    q_force = tuple(math.factorial(m) * share**m * t * t * psi[m + 1] for m in range(num))
    p_force = tuple(math.factorial(m) * share**m * t * psi[m] for m in range(num))
    rest = 1 - k * step
    return Weights(rest, impulse, -k * impulse, rest - d * impulse, q_force, p_force)


def impulse_integrals(a: Array, b: Array, num: int) -> list[Array]:
    """psi_0, ..., psi_(num - 1) of a = k t^2 and b = d t, elementwise."""
    short = (a <= SHORT) & (b <= SHORT)
    series = _by_series(jnp.where(short, a, 0.0), jnp.where(short, b, 0.0), num)
    # However long the time is: the closed form has the slow decay as the difference of two rates that are nearly equal.
    apart = ~short & (b > 2.5 * jnp.sqrt(a))
    upward = _upwards(jnp.where(short | apart, SHORT, a), jnp.where(short | apart, 1.0, b), num)
    creeping = _by_two_decays(jnp.where(apart, a, 1.0), jnp.where(apart, b, 4.0), num)
    parts = zip(series, upward, creeping, strict=True)
    return [jnp.where(short, x, jnp.where(apart, z, y)) for x, y, z in parts]


def _by_series(a: Array, b: Array, num: int) -> list[Array]:
    """Both highest by their power series, the others downwards."""
    down = [*_highest(a, b, num)]
    for m in range(num - 1, 0, -1):
        down.append(1 / math.factorial(m) - b * down[-1] - a * down[-2])
    return down[:0:-1]


@partial(apart, static=(2,))
def _highest(a: Array, b: Array, num: int) -> tuple[Array, Array]:
    """psi_num and psi_(num - 1)."""
    before, sigma = 0.0 * a, 1.0 + 0.0 * a
    first, second = 0.0 * a, 0.0 * a
    for j in range(NUM_TERMS):
        first = first + sigma * (1 / math.factorial(j + num))
        second = second + sigma * (1 / math.factorial(j + num + 1))
        before, sigma = sigma, -b * sigma - a * before
    return second, first


def _upwards(a: Array, b: Array, num: int) -> list[Array]:
    """From the closed form of the impulse; a is not small."""
    decay, square = jnp.exp(-0.5 * b), a - 0.25 * b * b
    turn = jnp.sqrt(jnp.abs(square))
    near = turn < 1e-2
    safe = jnp.where(near, 1.0, turn)
    # Where the mode is overdamped, exp(-b / 2) is taken into the hyperbolic functions: they alone would overflow.
    spread = jnp.where(square < 0, turn, 0.0)
    slow, fast = jnp.exp(spread - 0.5 * b), jnp.exp(-spread - 0.5 * b)
    sine = jnp.where(square < 0, 0.5 * (slow - fast), decay * jnp.sin(turn))
    cosine = jnp.where(square < 0, 0.5 * (slow + fast), decay * jnp.cos(turn))
    first = jnp.where(near, decay * (1 - square / 6 + square * square / 120), sine / safe)
    before, psi = cosine - 0.5 * b * first, [first]
    for m in range(num - 1):
        psi.append((1 / math.factorial(m) - before - b * psi[-1]) / a)
        before = psi[-2]
    return psi


def _by_two_decays(a: Array, b: Array, num: int) -> list[Array]:
    """Of an overdamped mode whose decays lie well apart, as divided differences of the phi functions of both."""
    fast = -0.5 * (b + jnp.sqrt(b * b - 4 * a))
    slow = a / fast  # as a difference of two large numbers it would lose its digits
    phi = [_phi(z, num) for z in (slow, fast)]
    return [(x - y) / (slow - fast) for x, y in zip(*phi, strict=True)]


def _phi(z: Array, num: int) -> list[Array]:
    """phi_0, ..., phi_(num - 1) of z <= 0."""
    short = z > -1.0
    small, large = jnp.where(short, z, 0.0), jnp.where(short, -1.0, z)
    top = sum(small**j * (1 / math.factorial(j + num - 1)) for j in range(18))
    down = [top]
    for k in range(num - 2, -1, -1):
        down.append(1 / math.factorial(k) + small * down[-1])
    up = [jnp.exp(large)]
    for k in range(num - 1):
        up.append((up[-1] - 1 / math.factorial(k)) / large)
    return [jnp.where(short, x, y) for x, y in zip(down[::-1], up, strict=True)]
