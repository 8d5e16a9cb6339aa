"""Extremes of displacements over steps, on the dense output of whatever method has taken them.

In a step of collocation the modes are known at the nodes; in between, slow ones follow the polynomial through these.
The motion of the others is bounded by their vibration; where an extreme may depend on it, the step is followed in
parts.
"""

import timesim.runtime  # noqa: F401  isort: skip

import jax
import numpy as np

from timesim.engine import dense_output as hermite
from timesim.engine.exponential.collocation import Inside
from timesim.engine.exponential.parts import FINEST, in_parts, parts_of
from timesim.engine.exponential.steady import diagonals
from timesim.engine.law.rule import rule_of
from timesim.engine.step import Step
from timesim.engine.system import System

MISSED = 1e-2  # of the tolerance of a step: what a polynomial may leave out of the motion


def extremes(
    system: System, steps: Step, shape: np.ndarray, first: np.ndarray, rtol: float
) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value of some displacements over rows of steps, each of shape (R, X).

    Args:
        system, steps: the steps, numpy arrays whose first axis is theirs, and the system in which they were taken.
        shape: the displacements for a unit of each mode, shape (X, M).
        first: the first step of each row, ascending, 0 the first of them, shape (R,).
    """
    start, end = steps.start.q @ shape.T, steps.end.q @ shape.T
    if steps.inside is None:
        rates = (steps.start.p, steps.start_rate.p, steps.end.p, steps.end_rate.p)
        v0, a0, v1, a1 = (rate @ shape.T for rate in rates)
        sides = (start, v0, a0), (end, v1, a1)

        def formed(step: np.ndarray, place: np.ndarray) -> np.ndarray:
            one, other = (tuple(part[step, place] for part in side) for side in sides)
            return np.stack(hermite.quintic_coefficients(steps.h[step], one, other))

        within = hermite.quintic_bounds(steps.h[:, None], *sides)
        return hermite.extremes(formed, within, (start, end), first)[:2]
    missed = max(MISSED * rtol, FINEST) * max(np.abs(start).max(), np.abs(end).max())
    coefficients, doubt = _through_nodes(system, steps.inside, shape, missed)
    coefficients *= ((steps.h / steps.inside.h) ** np.arange(len(coefficients))[:, None])[..., None]
    doubt[doubt <= missed] = 0.0
    within = hermite.bounds(coefficients)
    low, high, rows = hermite.extremes(lambda *those: coefficients[:, *those], within, (start, end), first, doubt)
    if rows.size:
        row, some = hermite.rows_of(first, len(start)), jax.tree.map(lambda leaf: leaf[rows], steps)
        parts = parts_of(system, some, rtol)
        least, most = extremes(system, in_parts(system, some, parts), shape, np.flatnonzero(parts.first), rtol)
        np.minimum.at(low, row[rows], least)
        np.maximum.at(high, row[rows], most)
    return low, high


def _through_nodes(system: System, inside: Inside, shape: np.ndarray, missed: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacements as polynomials through the nodes, shape (power, N, X), and how far they may be off, (N, X).

    Where that is more than may be missed, modes that are better bounded by their vibration are left out.
    """
    rule, reach = rule_of(inside.q.shape[1] - 1), np.abs(shape).T
    through = np.concatenate([inside.q - inside.q[:, :1], inside.h[:, None, None] * inside.p], axis=1)
    # What the highest power does between the nodes is more than what the next one would, up to 8 rad in a step.
    off = rule.touch * np.abs(np.tensordot(through, rule.hermite[-1], (1, 0)))
    doubt = off @ reach
    if doubt.max() > missed:
        root = np.sqrt(diagonals(system)[0])
        # A free body has no vibration that bounds it, at rest either: 0/0 would be no number, and the extreme with it.
        bound = np.divide(inside.p, root, out=np.full_like(inside.p, np.inf), where=root > 0)
        swing = 2 * np.hypot(inside.q, bound).max(axis=1)
        rings = swing < off
        through = np.where(rings[:, None], 0.0, through)
        doubt = np.minimum(swing, off) @ reach
    coefficients = np.tensordot(rule.hermite, through @ shape.T, (1, 1))
    coefficients[0] = (
        inside.q[:, 0] @ shape.T if doubt.max() <= missed else np.where(rings, 0.0, inside.q[:, 0]) @ shape.T
    )
    return coefficients, doubt
