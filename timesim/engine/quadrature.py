"""Means over whole cycles of the loop: harmonics of the motion and power lost in the contacts.

Gauss-Legendre quadrature of the dense output, step by step: a transition always lies between two steps. A step whose
dense output is not the polynomial through its ends is taken in parts for which it is.
"""

import timesim.runtime  # noqa: F401  isort: skip

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from timesim.engine import dense_output as hermite
from timesim.engine.exponential.collocation import Inside, diagonals, state_inside
from timesim.engine.law.contact_law import ContactLaw, Motion, Scalar
from timesim.engine.step import Step
from timesim.engine.system import Point, System, Work, power_lost

# Six nodes of a step: over 2.8 rad of the highest harmonic, as with 20 steps a cycle, they leave 1e-10 of an integral.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(6)
NODE, WEIGHT = (1 + _POINTS) / 2, _WEIGHTS / 2  # as fractions of the step
ROWS = 1024  # nodes at which the law is evaluated at a time: a fixed number, so that it is compiled once
TURN = 2 * np.pi
FOLLOWED = 1e-9  # of the largest modal displacement: what a part may leave out
# Of a part, for its energies: nodes between its ends, and weights of all four, exact to the fifth power.
LOBATTO = (0.5 - 0.05**0.5, 0.5 + 0.05**0.5), (1 / 12, 5 / 12, 5 / 12, 1 / 12)


class Parts(NamedTuple):
    """Parts of steps that are short for the fastest mode.

    Attributes:
        whole: the step that each is part of.
        start, end: times since the start of that step, shape (N,).
        first, last: whether it begins or ends the step.
    """

    whole: Step
    start: np.ndarray
    end: np.ndarray
    first: np.ndarray
    last: np.ndarray


def parts_of(system: System, steps: Step) -> Parts:
    """Parts of all steps, in the order of time; steps are numpy arrays, their axis the first."""
    num = np.maximum(np.ceil(steps.h / _length_of_part(system, steps)), 1).astype(int)
    row = np.repeat(np.arange(num.size), num)
    part = np.arange(row.size) - np.repeat(np.cumsum(num) - num, num)
    start, end = (steps.h[row] * (part + side) / num[row] for side in (0, 1))
    return Parts(jax.tree.map(lambda rows: rows[row], steps), start, end, part == 0, part + 1 == num[row])


def _length_of_part(system: System, steps: Step) -> float:
    """Length up to which the quintic through both ends of a part follows every mode.

    A vibration ``a cos(omega t)`` leaves it by ``a (omega h)^6 / 46,080`` (Hairer, Norsett & Wanner, Solving Ordinary
    Differential Equations I, section II.6, for the interpolation error): a fast mode may be followed in few parts where
    it hardly moves. What decays fast of an overdamped mode is known by its velocity; the rest of it creeps.
    """
    stiffness, damping = (np.asarray(x) for x in diagonals(system))
    natural = np.sqrt(stiffness)
    rate = np.maximum(np.maximum(natural, damping), 1.0)
    ends = ((steps.start.q, steps.end.q), (steps.start.p, steps.end.p))
    q, p = (np.abs(np.concatenate(pair)).max(axis=0) for pair in ends)
    vibration = np.where(damping > 2 * natural, p / rate, np.maximum(q, p / rate))
    allowed = 46_080 * FOLLOWED * max(q.max(), (p / rate).max(), 1e-300) / np.maximum(vibration, 1e-300)
    return float((allowed ** (1 / 6) / rate).min())


def short_steps(system: System, steps: Step, *, energies: bool = False) -> Step:
    """Steps in parts so short that values and rates at both ends of each are as good as the flow inside.

    Args:
        system: in which the steps were taken.
        steps: numpy arrays, the first axis that of the steps.

    Keyword Args:
        energies: whether the parts are to hold the energies since the first of them.
    """
    if steps.inside is None or not len(steps.h):
        return steps
    parts = parts_of(system, steps)
    whole = parts.whole
    end, end_rate = _inside(system, whole, parts.end, powers=energies)
    work = None if end_rate.work is None else _works(system, parts, end_rate.work)
    end, end_rate = (eqx.tree_at(lambda y: y.work, y, None, is_leaf=lambda x: x is None) for y in (end, end_rate))
    before = jax.tree.map(lambda rows: np.roll(rows, 1, axis=0), (end, end_rate))
    start, start_rate = _chosen(parts.first, (whole.start, whole.start_rate), before)
    end, end_rate = _chosen(parts.last, (whole.end, whole.end_rate), (end, end_rate))
    end = eqx.tree_at(lambda y: y.work, end, work, is_leaf=lambda x: x is None)
    after = np.where(parts.last[:, None], whole.state_after, whole.state)
    where = lambda s: (s.time, s.h, s.start, s.start_rate, s.end, s.end_rate, s.state_after, s.inside)  # noqa: E731
    new = (whole.time + parts.start, parts.end - parts.start, start, start_rate, end, end_rate, after, None)
    short: Step = eqx.tree_at(where, whole, new, is_leaf=lambda x: x is None)
    return short


def _chosen(known: np.ndarray, own: Any, other: Any) -> Any:
    """One tree where a row is known, else the other."""
    return jax.tree.map(lambda a, b: np.where(known.reshape(-1, *[1] * (a.ndim - 1)), a, b), own, other)


def _works(system: System, parts: Parts, last: Work) -> Work:
    """Energies since the first part at the end of each, from the powers there: by Lobatto's rule."""
    length, steps = parts.end - parts.start, jax.tree.map(lambda rows: rows[parts.first], parts.whole)
    first: Work = jax.tree.map(lambda rows: np.roll(rows, 1, axis=0), last)
    begun = _inside(system, steps, np.zeros(len(steps.h)), powers=True)[1].work
    for rows, own in zip(jax.tree.leaves(first), jax.tree.leaves(begun), strict=True):
        rows[parts.first] = own
    inner = [_inside(system, parts.whole, parts.start + x * length, powers=True)[1].work for x in LOBATTO[0]]

    def energy(*powers: np.ndarray) -> np.ndarray:
        mean = sum(share * power for share, power in zip(LOBATTO[1], powers, strict=True))
        done: np.ndarray = np.cumsum(mean * length.reshape(-1, *[1] * (powers[0].ndim - 1)), axis=0)
        return done

    whole: Work = jax.tree.map(energy, first, *inner, last)
    return whole


def _inside(system: System, own: Step, span: np.ndarray, *, powers: bool = False) -> tuple[Point, Point]:
    """State and rate at a time after the start of each step; the rates with the powers or without."""
    assert own.inside is not None
    columns = (own.state, own.time, own.start, own.inside, span / own.inside.h)
    found = []
    for first in range(0, len(span), ROWS):
        rows = jax.tree.map(lambda c: c[np.minimum(np.arange(first, first + ROWS), len(span) - 1)], columns)  # noqa: B023
        found.append(jax.tree.map(np.asarray, _points_and_rates(system, powers, *rows)))
    joined: tuple[Point, Point] = jax.tree.map(lambda *rows: np.concatenate(rows)[: len(span)], *found)
    return joined


@partial(jax.jit, static_argnums=1)
def _points_and_rates(system: System, powers: bool, *columns: Any) -> tuple[Point, Point]:
    def one(state: Array, time: Array, start: Point, inside: Inside, x: Array) -> tuple[Point, Point]:
        point = state_inside(system, (state, time, start), inside, x)
        work = Work(jnp.zeros(()), jnp.zeros(()), jnp.zeros(state.shape)) if powers else None
        point = Point(point.q, point.p, point.w, work)
        return point, system.field(state, time + x * inside.h, point)

    done: tuple[Point, Point] = jax.vmap(one)(*columns)
    return done


def means(system: System, steps: Step, cycles: int, harmonics: int) -> tuple[np.ndarray, np.ndarray]:
    """Means over all steps of some cycles, dimensionless.

    Args:
        system: in which the steps were taken.
        steps: numpy arrays, the first axis that of the steps.
        cycles: how many they make up.
        harmonics: of the modal displacement, beside its mean.

    Returns:
        phasors of the modal displacement, ``q = Re sum_h phasor_h exp(i h phase of the excitation)``, shape (H + 1, M),
        and the power lost in each contact, shape (C,).
    """
    steps = jax.tree.map(lambda rows: rows[steps.h > 0], steps)
    angle, q, p, h = _nodes(steps)
    share = (h * WEIGHT).ravel() / (TURN * cycles)
    turn = np.exp(-1j * np.outer(np.arange(harmonics + 1), angle + float(system.phase)))
    phasor = (turn * share) @ q
    phasor[1:] *= 2
    return phasor, share @ _power(system, steps, q, p)


def _nodes(steps: Step) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Angle, modal displacement and velocity at the nodes of all steps, and the length of each step, shape (N, 1)."""
    h = steps.h[:, None]
    angle = (steps.time[:, None] + h * NODE).ravel()
    start, end = (
        [part[:, None] for part in (y.q, y.p, dy.p)]
        for y, dy in ((steps.start, steps.start_rate), (steps.end, steps.end_rate))
    )
    q, p = (part.reshape(angle.size, -1) for part in hermite.quintic(NODE[:, None], h[:, None], (*start,), (*end,)))
    return angle, q, p, h


def _power(system: System, steps: Step, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Power lost in each contact at the nodes of all steps, shape (N, C)."""
    power = np.zeros((len(q), steps.state.shape[1]))
    if not power.size:
        return power
    sides = list(zip(steps.start.w, steps.start_rate.w, steps.end.w, steps.end_rate.w, strict=True))
    w = tuple(_slip(steps.h, *side).reshape(power.shape) for side in sides)
    (*u, v), (*du, dv) = ([y @ axis.T for axis in system.shape] for y in (q, p))
    columns = (np.repeat(steps.state, NODE.size, axis=0), Motion((*u,), v, (*du,), dv), w)
    for first in range(0, len(q), ROWS):
        part = jax.tree.map(lambda column: _padded(column[first : first + ROWS]), columns)  # noqa: B023
        power[first : first + ROWS] = np.asarray(_lost(system.law, *part))[: len(power) - first]
    return power


def _padded(rows: np.ndarray) -> np.ndarray:
    whole = np.zeros((ROWS, *rows.shape[1:]), rows.dtype)
    whole[: len(rows)] = rows
    return whole


def _slip(h: np.ndarray, w0: np.ndarray, dw0: np.ndarray, w1: np.ndarray, dw1: np.ndarray) -> Any:
    """One component of the slip at the nodes of steps of length h, shape (N, nodes, C)."""
    start, end = (w0[:, None], dw0[:, None]), (w1[:, None], dw1[:, None])
    return hermite.cubic(NODE[:, None], h[:, None, None], start, end)


@jax.jit
def _lost(law: ContactLaw, state: Any, motion: Motion, w: Any) -> Scalar:
    return power_lost(law.reaction(state, motion, w))
