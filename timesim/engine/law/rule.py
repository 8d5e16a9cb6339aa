"""Nodes of a step that is taken at all of them at once.

Source: E. Hairer & G. Wanner, Solving Ordinary Differential Equations II, section IV.5 (Radau IIA).
"""

import functools
from typing import NamedTuple

import numpy as np


class Rule(NamedTuple):
    """Radau's right-hand rule on [0, 1], and the start of the step as a further node.

    Attributes:
        nodes: 0 and the nodes of the rule, ascending, the last one 1, shape (s + 1,).
        monomials: coefficients of powers, lowest first, from values at the nodes, shape (s + 1, s + 1).
        slopes: derivatives at the nodes of the rule from values at all of them, shape (s, s + 1).
        integrals: integrals from 0 to the nodes of the rule from values at those, shape (s, s).
        hermite: coefficients of powers from values at all nodes, then rates there, shape (2 s + 2, 2 s + 2).
        share: integral of |prod (x - node)|.
        touch: largest value of its square, which multiplies the remainder of ``hermite``.
    """

    nodes: np.ndarray
    monomials: np.ndarray
    slopes: np.ndarray
    integrals: np.ndarray
    hermite: np.ndarray
    share: float
    touch: float


def radau_nodes(num: int) -> np.ndarray:
    """0 and so many nodes of Radau's right-hand rule on [0, 1], ascending, shape (num + 1,)."""
    from scipy.special import roots_jacobi

    inner = 0.5 * (1 + roots_jacobi(num - 1, 1.0, 0.0)[0]) if num > 1 else np.zeros(0)
    return np.concatenate([[0.0], inner, [1.0]])


@functools.cache
def rule_of(num: int) -> Rule:
    """The rule with so many nodes beside the start."""
    nodes = radau_nodes(num)
    power = np.arange(num + 1)
    monomials = np.linalg.inv(nodes[:, None] ** power)
    lowered = power * nodes[1:, None] ** np.maximum(power - 1, 0)
    own = nodes[1:, None] ** np.arange(num)
    integrals = (nodes[1:, None] ** np.arange(1, num + 1) / np.arange(1, num + 1)) @ np.linalg.inv(own)
    high = np.arange(2 * num + 2)
    values, rates = nodes[:, None] ** high, high * nodes[:, None] ** np.maximum(high - 1, 0)
    hermite = np.linalg.inv(np.concatenate([values, rates]))
    x = np.linspace(0, 1, 20_001)
    apart = np.abs(np.prod(x[:, None] - nodes, axis=1))
    share, touch = float(np.trapezoid(apart, x)), float(apart.max() ** 2)
    return Rule(nodes, monomials, lowered @ monomials, integrals, hermite, share, touch)
