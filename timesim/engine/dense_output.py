"""Dense output of a step: the polynomial through values and rates at both of its ends.

The displacement is known with two derivatives at each end, which gives a quintic with error O(h^6), whatever the
method; the slip of a contact is known with one, which gives a cubic. The functions take numpy or JAX arrays.

Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, section II.6.
"""

from typing import Any


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


def cubic(x: Any, h: Any, start: tuple[Any, Any], end: tuple[Any, Any]) -> Any:
    """Value at a fraction x of a step of length h, from (value, rate) at its ends."""
    return evaluate(x, cubic_coefficients(h, start, end))[0]


def cubic_coefficients(h: Any, start: tuple[Any, Any], end: tuple[Any, Any]) -> tuple[Any, ...]:
    """Coefficients of 1, x, x^2, x^3 of `cubic`."""
    (w0, d0), (w1, d1) = start, end
    jump = w1 - w0
    return w0, h * d0, 3 * jump - h * (2 * d0 + d1), -2 * jump + h * (d0 + d1)


def evaluate(x: Any, coefficients: tuple[Any, ...]) -> tuple[Any, Any]:
    """Value and derivative of a polynomial by its coefficients of 1, x, x^2, ..."""
    value, rate = coefficients[-1], 0.0
    for coefficient in coefficients[-2::-1]:
        rate = rate * x + value
        value = value * x + coefficient
    return value, rate
