"""Where the trial force of a stuck contact leaves its friction cone: roots of trigonometric and other polynomials.

The cone is ``r1^2 + r2^2 <= r3^2`` of r = (f1, f2, mu n): section 3.1 of the paper.
"""

from collections.abc import Callable
from math import comb
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

Array = NDArray[Any]
CYCLE = 2 * np.pi
# Overshoot of |f|^2 - (mu n)^2, relative to the squares it is the difference of, that counts as touching.
TOUCH = 1e-14
CONE = np.array([1.0, 1.0, -1.0])


def wrap(theta: ArrayLike) -> Array:
    """Angles brought to [0, 2 pi) [rad]; what lies within rounding below 2 pi becomes 0."""
    angle = np.asarray(theta, float) % CYCLE
    return np.where(angle > CYCLE - 1e-13, 0.0, angle)


def harmonic_exit(mean: Array, cosine: Array, sine: Array, *, on_cone: bool) -> float:
    """Exit of r = mean + cosine cos t + sine sin t from the cone that it touches, or in which it lies, at t = 0."""
    return (_exit_from_cone if on_cone else _exit_from_inside)(mean, cosine, sine)


def _exit_from_cone(mean: Array, cosine: Array, sine: Array) -> float:
    """`harmonic_exit` on the cone.

    There r1^2 + r2^2 - r3^2 is (1 - cos t)(a + b cos t + c sin t), so the quartic's other roots are those of
    the second factor, and one of them at most is rising.
    """
    b = CONE @ (sine**2 - cosine**2)
    c = -2 * CONE @ (cosine * sine)
    a = b - 2 * CONE @ (mean * cosine)
    reach, floor = np.hypot(b, c), TOUCH * (mean @ mean + cosine @ cosine + sine @ sine)
    if a + reach <= floor:
        return np.inf
    if a + b > -floor and c > floor:
        return 0.0
    return float((np.arctan2(c, b) - np.arccos(np.clip(-a / reach, -1.0, 1.0))) % CYCLE)


def _exit_from_inside(mean: Array, cosine: Array, sine: Array) -> float:
    """`harmonic_exit` from inside."""

    def margin(t: Array) -> Array:
        # By r, not by the coefficients of its square: these lose (mu n)^2 where |K_u u| is much larger.
        t = np.asarray(t)
        r = (mean + cosine)[:, None] - np.outer(cosine, 2 * np.sin(t / 2) ** 2) + np.outer(sine, np.sin(t))
        return np.reshape(CONE @ r**2, t.shape)

    first, second = 2 * CONE @ (mean * (cosine - 1j * sine)), CONE @ (cosine - 1j * sine) ** 2 / 2
    constant = CONE @ (mean**2 + (cosine**2 + sine**2) / 2)
    roots = trigonometric_roots(np.array([constant, first, second]))
    floor = TOUCH * float(mean @ mean + cosine @ cosine + sine @ sine)
    return first_rise(margin, roots, CYCLE, floor)


def trigonometric_roots(coefficients: ArrayLike) -> Array:
    """Angles of all complex roots z = exp(i t) of ``Re sum_k coefficients[k] exp(i k t)``.

    They ascend in [0, 2 pi) [rad]. The real roots t are among them; a pair off the unit circle gives two angles that
    are no roots. The polynomial in z is solved by the eigenvalues of its companion matrix, leading coefficients at
    rounding level left out.
    """
    half = np.array(coefficients, complex)
    half[1:] /= 2
    while half.size > 1 and abs(half[-1]) <= 4 * np.finfo(float).eps * np.abs(half).max():
        half = half[:-1]
    return np.sort(wrap(np.angle(np.roots(np.concatenate([half[:0:-1], half[:1].real, np.conj(half[1:])])))))


def first_rise(margin: Callable[[Array], Array], candidates: Array, end: float, floor: float) -> float:
    """First place of [0, end) where `margin`, of fixed sign between the candidates, rises beyond `floor`."""
    inside = np.sort(candidates[(candidates > 0) & (candidates < end)])
    edges = np.concatenate([[0.0], inside, [end]])
    middle = (edges[1:] + edges[:-1]) / 2
    value = margin(middle)
    positive = np.flatnonzero(value > floor)
    if positive.size == 0:
        return np.inf
    k = positive[0]
    if k == 0 or value[k - 1] >= 0:
        return float(edges[k])
    return float(brentq(margin, middle[k - 1], middle[k], xtol=1e-15))


def cone_margin(r: Array) -> Array:
    """Coefficients of r1^2 + r2^2 - r3^2, ascending, shape (11, ...), of those of r, shape (6, ..., 3)."""
    margin = np.zeros((11, *r.shape[1:-1]))
    for k in range(6):
        margin[k : k + 6] += (r[k] * r) @ CONE
    return margin


def shifted(coefficients: Array, origin: float) -> Array:
    """Coefficients, ascending along the first axis, of the same polynomial about another origin."""
    power = range(len(coefficients))
    matrix = np.array([[comb(j, k) * origin ** max(j - k, 0) for j in power] for k in power])
    return matrix @ coefficients


def piece_exit(coefficients: Array, end: float, floor: float, on_cone: bool) -> float:
    """First exit on one piece, as `first_rise`; with `on_cone` the double root at 0 is divided out."""
    coefficients = coefficients.copy()
    coefficients[: 2 * on_cone] = 0.0
    roots = np.polynomial.polynomial.polyroots(coefficients[2 * on_cone :])
    return first_rise(lambda x: np.polynomial.polynomial.polyval(x, coefficients), roots.real, end, floor)
