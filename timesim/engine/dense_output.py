"""Dense output of a step: the polynomial through values and rates at both of its ends.

The displacement is known with two derivatives at each end, which gives a quintic with error O(h^6), whatever the
method; the slip of a contact is known with one, which gives a cubic, and a quintic with the end of another step.
Polynomials and their values may be numpy or JAX arrays; extremes are sought by numpy.

Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, section II.6.
"""

from collections.abc import Callable
from functools import cache, reduce
from math import comb
from typing import Any

import numpy as np

# A step is a small part of the fastest oscillation; in each quarter of it a velocity changes sign at most once.
PARTS = 4
NUM_NEWTON = 5  # steps that find such a turn: of a quarter two digits by the first guess, then twice as many by each


def quintic(x: Any, h: Any, start: tuple[Any, Any, Any], end: tuple[Any, Any, Any]) -> tuple[Any, Any]:
    """Value and rate at a fraction x of a step of length h, from (value, rate, second derivative) at its ends."""
    value, rate = evaluate(x, quintic_coefficients(h, start, end))
    return value, rate / h


def quintic_coefficients(
    h: Any, start: tuple[Any, Any, Any], end: tuple[Any, Any, Any], jump: Any = None
) -> tuple[Any, ...]:
    """Coefficients of 1, x, x^2, ... of `quintic`.

    ``jump`` is the change of the value, where the caller knows it better than as a difference: in a step of 1e-10
    the rate would be six digits of rounding.
    """
    (q0, p0, a0), (q1, p1, a1) = start, end
    v0, b0, v1, b1 = h * p0, h * h * a0, h * p1, h * h * a1
    jump = q1 - q0 if jump is None else jump
    c3 = 10 * jump - 6 * v0 - 4 * v1 - 1.5 * b0 + 0.5 * b1
    c4 = -15 * jump + 8 * v0 + 7 * v1 + 1.5 * b0 - b1
    c5 = 6 * jump - 3 * (v0 + v1) - 0.5 * (b0 - b1)
    return q0, v0, 0.5 * b0, c3, c4, c5


def cubic_coefficients(h: Any, start: tuple[Any, Any], end: tuple[Any, Any]) -> tuple[Any, ...]:
    """Coefficients of 1, x, x^2, x^3 of the cubic over a step of length h, from (value, rate) at its ends."""
    (w0, d0), (w1, d1) = start, end
    jump = w1 - w0
    return w0, h * d0, 3 * jump - h * (2 * d0 + d1), -2 * jump + h * (d0 + d1)


def through_third(
    x: Any, h: Any, start: tuple[Any, Any], end: tuple[Any, Any], place: Any, third: tuple[Any, Any]
) -> Any:
    """The cubic over a step, and what makes it the quintic through a third value and rate at ``place`` outside [0, 1].

    Where ``place`` is no number the cubic alone.
    """
    within, there = cubic_coefficients(h, start, end), np.nan_to_num(place, nan=2.0)
    value, rate = evaluate(there, within)
    bump = (there * (1 - there)) ** 2  # it and its rate vanish at both ends
    share = (third[0] - value) / bump
    slope = (h * third[1] - rate) / bump - share * 2 * (1 - 2 * there) / (there * (1 - there))
    added = np.where(np.isnan(place), 0.0, share + slope * (x - there))
    return evaluate(x, within)[0] + (x * (1 - x)) ** 2 * added


def evaluate(x: Any, coefficients: tuple[Any, ...]) -> tuple[Any, Any]:
    """Value and derivative of a polynomial by its coefficients of 1, x, x^2, ..."""
    value, rate = coefficients[-1], 0.0
    for coefficient in coefficients[-2::-1]:
        rate = rate * x + value
        value = value * x + coefficient
    return value, rate


def quintic_bounds(h: Any, start: tuple[Any, Any, Any], end: tuple[Any, Any, Any]) -> tuple[np.ndarray, np.ndarray]:
    """`bounds` of quintics that are not formed, arguments as of `quintic`."""
    (q0, p0, a0), (q1, p1, a1) = start, end
    third, sixth = h / 5, h * h / 20
    v0, v1 = third * p0, third * p1
    second, fifth = q0 + v0, q1 - v1
    inner = (second, second + v0 + sixth * a0, fifth - v1 + sixth * a1, fifth)
    return reduce(np.minimum, (q0, q1, *inner)), reduce(np.maximum, (q0, q1, *inner))


def bounds(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values between which polynomials stay on [0, 1], by their coefficients of 1, x, x^2, ..., shape (power, ...).

    They are the extremes of their control points (G. Farin, Curves and Surfaces for CAGD, on the convex hull of the
    Bernstein form).
    """
    control = np.tensordot(control_points(len(coefficients)), coefficients, 1)
    return control.min(axis=0), control.max(axis=0)


def extremes(
    formed: Callable[[np.ndarray, np.ndarray], np.ndarray],
    within: tuple[np.ndarray, np.ndarray],
    ends: tuple[np.ndarray, np.ndarray],
    first: np.ndarray,
    doubt: Any = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least and largest values over rows of steps, of polynomials of the fraction of each step.

    Few steps hold an extreme: the others stay between values that the ends of steps reach.

    Args:
        formed: coefficients of 1, x, x^2, ..., shape (power, n), of the polynomials of n steps at n of the X places.
        within: values between which each polynomial stays, each of shape (N, X).
        ends: values at the ends of the steps, each of shape (N, X).
        first: the first step of each row, ascending, 0 the first of them, shape (R,).
        doubt: how far each polynomial may be off, shape (N, X).

    Returns:
        two arrays of shape (R, X), and the steps that may lie beyond these but are in doubt.
    """
    low, high = np.minimum.reduceat(np.minimum(*ends), first), np.maximum.reduceat(np.maximum(*ends), first)
    row = rows_of(first, len(ends[0]))
    beyond = (within[0] - doubt < low[row]) | (within[1] + doubt > high[row])
    known = beyond & (doubt == 0)
    step, place = np.nonzero(known)
    least, most = _between(formed(step, place))
    np.minimum.at(low, (row[step], place), least)
    np.maximum.at(high, (row[step], place), most)
    return low, high, np.flatnonzero((beyond & ~known).any(axis=1))


def rows_of(first: np.ndarray, size: int) -> np.ndarray:
    """Number of the row of each of so many steps, from the first step of each row."""
    return np.repeat(np.arange(first.size), np.diff(first, append=size))


@cache
def control_points(num: int) -> np.ndarray:
    """Matrix of the Bernstein coefficients on [0, 1] from ``num`` coefficients of 1, x, x^2, ..., shape (num, num)."""
    return np.array([[comb(i, j) / comb(num - 1, j) for j in range(num)] for i in range(num)])


def _between(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value on [0, 1] of polynomials, coefficients of shape (power, N)."""
    rates = coefficients[1:] * np.arange(1, len(coefficients))[:, None]
    nodes = np.linspace(0.0, 1.0, PARTS + 1)
    values = np.vander(nodes, len(coefficients), increasing=True) @ coefficients
    slopes = np.vander(nodes, len(rates), increasing=True) @ rates
    low, high = values.min(axis=0), values.max(axis=0)
    part, which = np.nonzero(slopes[:-1] * slopes[1:] < 0)
    ends = (nodes[part], slopes[part, which]), (nodes[part + 1], slopes[part + 1, which])
    turning = _turning(*ends, coefficients[:, which], rates[:, which])
    np.minimum.at(low, which, turning)
    np.maximum.at(high, which, turning)
    return low, high


def _turning(left: Any, right: Any, coefficients: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Value where the rate vanishes between two places, each given with its rate, by Newton steps that stay there."""
    (low, falls), (high, rises) = left, right
    bends = rates[1:] * np.arange(1, len(rates))[:, None]
    x = low - falls * (high - low) / (rises - falls)
    for _ in range(NUM_NEWTON):
        powers = np.multiply.accumulate(np.broadcast_to(x, (len(bends), x.size)))
        rate = rates[0] + np.einsum("pn,pn->n", rates[1:], powers)
        bend = bends[0] + np.einsum("pn,pn->n", bends[1:], powers[:-1])
        before = rate * falls > 0
        low, high = np.where(before, x, low), np.where(before, high, x)
        x = np.clip(x - rate / np.where(bend == 0, np.inf, bend), low, high)
    return np.asarray(evaluate(x, (*coefficients,))[0])
