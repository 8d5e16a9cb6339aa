"""The slip state of a contact under prescribed motion, integrated by the direction of its friction force.

With f = mu n e(alpha), e = (cos alpha, sin alpha), |f| = mu n holds exactly, and K_u^-1 times equation (11)
is

    mu n alpha' K_u^-1 e_perp + s e = u' - mu n' K_u^-1 e ,    s = |w'| ,

prime the derivative with respect to the angle theta. Its part along e_perp is an equation for alpha alone,

    mu n (e_perp . K_u^-1 e_perp) alpha' = e_perp . (u' - mu n' K_u^-1 e) ,

nothing is divided by n, and s = (e . K_u u' - mu n') / (e . K_u e) by equation (9). Where n -> 0 the left side
vanishes and the direction is the stable root of the right side, which Radau collocation takes as it comes: before
separation as the last node of the last step, after re-contact as the start (`contact_direction`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg.lapack import dgesv
from scipy.optimize import brentq

from timesim.element.motion import Array, PrescribedMotion
from timesim.engine.law.rule import radau_nodes

NUM_STAGES = 16
TOLERANCE = 1e-13  # of the last Legendre coefficients of alpha in a step, weighted by mu n over its largest value
FIRST_STEP, LONGEST_STEP = 0.5, 2.0
# Limit force, relative to its largest value, that is nothing: towards separation the direction may turn
# without end.
VANISHED = 1e-13
MAX_NEWTON = 12
MAX_STEPS = 2000


NODES = radau_nodes(NUM_STAGES)
BARYCENTRIC = 1 / np.prod(NODES[:, None] - NODES + np.eye(NODES.size), axis=1)
TO_LEGENDRE = np.linalg.inv(legendre.legvander(2 * NODES - 1, NUM_STAGES))
_DERIVATIVE = 2 * legendre.legval(2 * NODES - 1, legendre.legder(np.eye(NUM_STAGES + 1)), tensor=True).T @ TO_LEGENDRE
FROM_STAGES = np.ascontiguousarray(_DERIVATIVE[1:, 1:])
ORDERS = range(1, NUM_STAGES)
FINE = np.linspace(0.0, 1.0, 4 * NUM_STAGES + 1)
TO_FINE = legendre.legvander(2 * FINE - 1, NUM_STAGES) @ TO_LEGENDRE


@dataclass(frozen=True)
class Law:
    """What the friction law needs of a contact: f = K_u (u - w), |f| <= mu n, n = max(0, n0 + k_v v).

    Attributes:
        stiffness: K_u, shape (2, 2) [force/length]; zero for a frictionless stop.
        friction: mu.
        normal_stiffness: k_v [force/length].
        preload: n0 [force].
    """

    stiffness: Array
    friction: float
    normal_stiffness: float
    preload: float

    @property
    def frictionless(self) -> bool:
        """A stop: f = 0 and w = u, slip whenever n > 0."""
        return self.friction == 0.0

    @cached_property
    def compliance(self) -> Array:
        """K_u^-1, shape (2, 2) [length/force]; zero without friction, where it only meets f = 0."""
        return np.zeros((2, 2)) if self.frictionless else np.linalg.inv(self.stiffness)

    @cached_property
    def compliance_parts(self) -> tuple[float, complex]:
        """Mean and deviation of K_u^-1 over the directions [length/force]."""
        return _parts(self.compliance)

    @cached_property
    def stiffness_parts(self) -> tuple[float, complex]:
        """Mean and deviation of K_u over the directions [force/length]."""
        return _parts(self.stiffness)

    def load(self, y: Array) -> Array:
        """n0 + k_v v, below zero where the contact would have to pull, of motion of shape (3, ...) [force]."""
        return self.preload + self.normal_stiffness * y[2]

    def limit(self, y: Array, dy: Array) -> tuple[Array, Array]:
        """Limit force mu n >= 0 and its rate mu n' in contact, of motion and rate of shape (3, ...)."""
        return self.friction * np.maximum(self.load(y), 0.0), self.friction * self.normal_stiffness * dy[2]

    def slip_margin(self, alpha: Array | float, dy: Array) -> Array:
        """e . K_u u' - mu n' (12): positive in slip, and s times e . K_u e; shape (...)."""
        pull = np.tensordot(self.stiffness, dy[:2], 1)
        along = np.cos(alpha) * pull[0] + np.sin(alpha) * pull[1]
        return along - self.friction * self.normal_stiffness * dy[2]

    def slip_rate(self, alpha: Array, dy: Array) -> Array:
        """s = |w'| in slip [length/rad], shape (...)."""
        mean, deviation = self.stiffness_parts
        return self.slip_margin(alpha, dy) / (mean + (np.exp(-2j * alpha) * deviation).real)


def _parts(matrix: Array) -> tuple[float, complex]:
    """Numbers m, d of a symmetric M: e . M e = m + Re z, e . M e_perp = Im z, where z = d exp(-2 i alpha)."""
    return (matrix[0, 0] + matrix[1, 1]) / 2, complex((matrix[0, 0] - matrix[1, 1]) / 2, matrix[0, 1])


def contact_direction(law: Law, dy: Array) -> tuple[float, float]:
    """Slip after re-contact: e and s >= 0 with (mu n' I + s K_u) e = K_u u', |e| = 1, in place of (18).

    Returns the angle of e [rad] and s [length/rad].
    """
    values, axes = np.linalg.eigh(law.stiffness)
    pull = axes.T @ (law.stiffness @ dy[:2])
    rate = law.friction * law.normal_stiffness * dy[2]
    s = 0.0
    for _ in range(50):
        e = pull / (rate + s * values)
        size = np.hypot(*e)
        step = (size - 1) * size**2 / (e @ (values * e / (rate + s * values)))
        s += step
        if step <= 1e-15 * s:
            break
    e = axes @ (pull / (rate + s * values))
    return float(np.arctan2(e[1], e[0])), s


@dataclass(frozen=True)
class SlipPath:
    """Direction of the friction force over one stay in slip, a polynomial alpha a step.

    Attributes:
        start, length: first angle and length of each step, shape (k,) [rad].
        alpha: direction at the nodes of each step, shape (k, NUM_STAGES + 1) [rad].
        stop: angle at which the path ends, inside the last step [rad].
        final: direction there [rad].
        stuck: the path ends because the slip speed falls to zero.
    """

    start: Array
    length: Array
    alpha: Array
    stop: float
    final: float
    stuck: bool


def constant_path(alpha: float, start: float, stop: float, stuck: bool) -> SlipPath:
    """Slip in a fixed direction: straight motion along a principal axis of K_u."""
    nodes = np.full((1, NUM_STAGES + 1), alpha)
    return SlipPath(np.array([start]), np.array([max(stop - start, 1e-300)]), nodes, stop, alpha, stuck)


def integrate_slip(
    law: Law, motion: PrescribedMotion, alpha: float, start: float, end: float, largest: float
) -> SlipPath:
    """Integrate alpha from `start` until the contact sticks, at most to `end`.

    Args:
        alpha: direction of the friction force at `start` [rad].
        start, end: angles; n > 0 between them, it may vanish at either [rad].
        largest: largest limit force mu n of the cycle, the scale of the tolerance [force].

    Raises:
        RuntimeError: the step length fell to nothing.
    """
    steps: list[tuple[float, float, Array]] = []
    theta, length = start, FIRST_STEP
    previous, share = None, 1.0
    # Where a gap hardly closes, n is a small difference, known to its rounding only.
    rounding = 4 * np.finfo(float).eps * (2 * law.friction * abs(law.preload) + largest)
    nothing, tolerance = max(VANISHED * largest, 4 * rounding), max(TOLERANCE, 100 * rounding / (largest or 1.0))
    parting = law.limit(*motion.evaluate(end))[0] <= nothing
    for _ in range(MAX_STEPS):
        length = min(length, share * (end - theta))
        guess = _predict(previous, length, alpha)
        solved, dy, weight = _collocate(law, motion, guess, alpha, theta, length)
        if weight <= nothing:
            steps.append((theta, end - theta, np.full(NUM_STAGES + 1, alpha)))
            return _path(steps, end, alpha, False)
        error = np.inf if solved is None else _error(solved) * weight / largest
        if solved is None or error > tolerance:
            singular = parting and length < 0.1 and length >= share * (end - theta) and error > 1e-6
            share = 0.75 if singular else share
            length *= 0.3 if error == np.inf else max(0.2, 0.9 * (tolerance / error) ** (1 / NUM_STAGES))
            continue
        steps.append((theta, length, solved))
        place = _sticking_place(law, motion, solved, dy, theta, length)
        if place is not None:
            return _path(steps, theta + place * length, _at(place, TO_LEGENDRE @ solved), True)
        if length == end - theta:
            return _path(steps, end, solved[-1], False)
        previous, alpha, theta = (solved, length), solved[-1], theta + length
        length = min(length * min(2.0, 0.9 * (tolerance / max(error, 1e-17)) ** (1 / NUM_STAGES)), LONGEST_STEP)
    raise RuntimeError(f"slip: no step of {length:.3g} rad can be taken at {np.degrees(theta):.12g} degrees")


def _path(steps: list[tuple[float, float, Array]], stop: float, final: float, stuck: bool) -> SlipPath:
    start, length, alpha = zip(*steps, strict=True)
    return SlipPath(np.array(start), np.array(length), np.array(alpha), stop, float(final), stuck)


def _predict(previous: tuple[Array, float] | None, length: float, alpha: float) -> Array:
    """First guess of alpha at the stages: the step before, carried on, or the starting value."""
    if previous is None or length > 1.5 * previous[1]:
        return np.full(NUM_STAGES, alpha)
    weights = BARYCENTRIC / (1 + NODES[1:, None] * (length / previous[1]) - NODES)
    return (weights @ previous[0]) / weights.sum(1)


def _collocate(
    law: Law, motion: PrescribedMotion, alpha: Array, alpha0: float, start: float, length: float
) -> tuple[Array | None, Array, float]:
    """Solve the collocation equations of one step by Newton's method.

    Returns alpha at `NODES` (None: no convergence), the motion's rate there, and the largest limit force of the step.
    """
    y, dy = motion.evaluate(start + length * NODES)
    limit, limit_rate = law.limit(y[:, 1:], dy[:, 1:])
    mean, deviation = law.compliance_parts
    velocity = dy[0, 1:] + 1j * dy[1, 1:]
    last = 1e-4  # as if one iteration had gone before: a first change of 2e-8 is then the last one needed
    for _ in range(MAX_NEWTON):
        turn = np.exp(-1j * alpha)
        pull, twist = velocity * turn, deviation * turn * turn
        weight = limit * (mean - twist.real) / length
        rate = FROM_STAGES @ (alpha - alpha0)
        residual = weight * rate - pull.imag + limit_rate * twist.imag
        jacobian = weight[:, None] * FROM_STAGES
        diagonal = pull.real - 2 * (limit_rate * twist.real + limit * rate / length * twist.imag)
        jacobian.flat[:: NUM_STAGES + 1] += diagonal
        _, _, step, singular = dgesv(jacobian, residual)
        change = np.abs(step).max()
        if singular or not change < 10.0:
            break
        alpha = alpha - step
        if change <= 1e-13 or change**3 <= 1e-15 * last**2:
            return np.concatenate([[alpha0], alpha]), dy, limit.max()
        last = change
    return None, dy, limit.max()


def _at(place: float, series: Array) -> float:
    """Value at one place of [0, 1] of a step's Legendre series."""
    x = 2 * place - 1
    row = [1.0, x]
    for k in ORDERS:
        row.append(((2 * k + 1) * x * row[k] - k * row[k - 1]) / (k + 1))
    return float(np.dot(row, series))


def _error(alpha: Array) -> float:
    """Size of the last Legendre coefficients of a step, which bound what the dense polynomial leaves out."""
    tail = np.abs(TO_LEGENDRE[-2:] @ alpha)
    return float(max(tail[1], 0.1 * tail[0]))


def _sticking_place(
    law: Law, motion: PrescribedMotion, alpha: Array, dy: Array, start: float, length: float
) -> float | None:
    """Where in the step, of [0, 1], the slip speed falls through zero first; None where it does not."""
    fine = TO_FINE @ law.slip_margin(alpha, dy)
    negative = np.flatnonzero(fine[1:] < 0)
    if negative.size == 0:
        return _sticking_dip(fine)
    k = negative[0]
    if fine[k] <= 0:
        return float(FINE[k])
    series = TO_LEGENDRE @ alpha

    def margin(x: float) -> float:
        return float(law.slip_margin(_at(x, series), motion.evaluate(start + x * length)[1]))

    if margin(FINE[k]) * margin(FINE[k + 1]) > 0:
        return float(FINE[k + 1])
    return float(brentq(margin, FINE[k], FINE[k + 1], xtol=1e-15, rtol=1e-15))


def _sticking_dip(fine: Array) -> float | None:
    """As `_sticking_place`, for a dip below zero between fine points, by a parabola about the lowest."""
    k = int(np.argmin(fine[1:-1])) + 1
    bend = fine[k - 1] - 2 * fine[k] + fine[k + 1]
    slope = (fine[k + 1] - fine[k - 1]) / 2
    if bend <= 0 or abs(slope) > bend or fine[k] - slope**2 / (2 * bend) >= 0:
        return None
    root = (-slope - np.sqrt(slope**2 - 2 * bend * fine[k])) / bend
    return float(FINE[k] + root * FINE[1])
