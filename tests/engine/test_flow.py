"""The exact flow of a mode against matrix exponentials."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.linalg import expm

from timesim.engine.exponential.flow import impulse_integrals, weights

pytestmark = pytest.mark.long

POWERS = 6

MODES = {
    "rigid body": (0.0, 0.0),
    "rigid body in a fluid": (0.0, 3.0),
    "undamped": (1.7, 0.0),
    "light": (1.7, 0.01),
    "just below critical": (2.0, 2 * np.sqrt(2.0) * (1 - 1e-9)),
    "nearly critical": (2.25, 3.0 * (1 - 5e-4)),
    "critical": (2.25, 3.0),
    "overdamped": (0.5, 9.0),
    "creeping": (1e-6, 40.0),
    "fast": (1.6e5, 8.0),
    "fast and overdamped": (400.0, 300.0),
}


@pytest.mark.parametrize("t", [1e-9, 1e-3, 0.3, 2.0, 9.0])
@pytest.mark.parametrize("mode", MODES)
def test_flow_is_that_of_the_matrix_exponential(mode: str, t: float) -> None:
    k, d = MODES[mode]
    h = 1.3 * t
    # z, z', and the powers of the fraction of h, each the derivative of the next but for a factor.
    matrix = np.zeros((2 + POWERS, 2 + POWERS))
    matrix[0, 1], matrix[1, 0], matrix[1, 1] = 1.0, -k, -d
    for m in range(1, POWERS):
        matrix[2 + m, 1 + m] = m / h
    for m in range(POWERS):
        forced = matrix.copy()
        forced[1, 2 + m] = 1.0
        exact = expm(forced * t)
        flow = weights(np.array(k), np.array(d), t, h, POWERS)
        np.testing.assert_allclose(flow.q_force[m], exact[0, 2], rtol=1e-11, atol=1e-14 * min(t * t, 1.0))
        np.testing.assert_allclose(flow.p_force[m], exact[1, 2], rtol=1e-11, atol=1e-14 * min(t, 1.0))
        ours = [[flow.q_q, flow.q_p], [flow.p_q, flow.p_p]]
        np.testing.assert_allclose(ours, exact[:2, :2], rtol=1e-10, atol=1e-12 * max(1.0, np.sqrt(k)))


def exact_integrals(a: float, b: float, num: int) -> list[Decimal]:
    """psi_0, ..., psi_(num - 1) of an overdamped mode, as divided differences of the phi functions of its decays."""
    with localcontext() as context:
        context.prec = 150
        middle, spread = Decimal(b) / 2, (Decimal(b) ** 2 / 4 - Decimal(a)).sqrt()
        phi = []
        for z in (spread - middle, -spread - middle):
            upward = [z.exp()]
            for m in range(num - 1):
                upward.append((upward[-1] - 1 / Decimal(math.factorial(m))) / z)
            phi.append(upward)
        return [(slow - fast) / (2 * spread) for slow, fast in zip(*phi, strict=True)]


@pytest.mark.parametrize("ratio", [1.2, 1.3, 2.0, 5.0, 50.0, 500.0, 1e5])
def test_the_slow_decay_of_an_overdamped_mode_keeps_its_digits(ratio: float) -> None:
    """However much faster the other one is: its rate is no difference of two that are nearly equal."""
    for decay in np.logspace(-3, 1.5, 19):
        a = (2 * ratio * decay) ** 2
        b = 2 * ratio * math.sqrt(a)
        ours = impulse_integrals(np.array(a), np.array(b), POWERS)
        error = [
            abs(float((Decimal(float(x)) - y) / y)) for x, y in zip(ours, exact_integrals(a, b, POWERS), strict=True)
        ]
        assert max(error[:3]) < 1e-14, (a, b)
        assert max(error) < 1e-12, (a, b)
