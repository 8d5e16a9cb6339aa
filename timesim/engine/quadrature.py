"""Means over whole cycles of the loop: harmonics of the motion and power lost in the contacts.

Gauss-Legendre quadrature of the dense output, step by step: a transition always lies between two steps. A step whose
dense output is not the polynomial through its ends is taken in parts for which it is.
"""

import timesim.runtime  # noqa: F401  isort: skip

import operator
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from timesim.engine import dense_output as hermite
from timesim.engine.exponential.collocation import Inside, modes_after, point_inside
from timesim.engine.exponential.flow import Weights, weights
from timesim.engine.exponential.steady import diagonals
from timesim.engine.law.contact_law import ContactLaw, Motion, Scalar
from timesim.engine.step import Step
from timesim.engine.system import Point, System, Work, power_lost

# Six nodes of a step: over 2.8 rad of the highest harmonic, as with 20 steps a cycle, they leave 1e-10 of an integral.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(6)
NODE, WEIGHT = (1 + _POINTS) / 2, _WEIGHTS / 2  # as fractions of the step
ROWS = 256  # nodes at which the law is evaluated at a time: a fixed number, so that it is compiled once
TURN = 2 * np.pi
FOLLOWED = 1e-3  # of the tolerance of a step: what a part may leave out of the motion
FINEST = 1e-9  # of the largest modal displacement, what it may leave out in any case
NO_PART = 1e-6  # of a part: rounding of its end
# Of a part, for its energies: nodes between its ends, and weights of all four, exact to the fifth power.
LOBATTO = (0.5 - 0.05**0.5, 0.5 + 0.05**0.5), (1 / 12, 5 / 12, 5 / 12, 1 / 12)


class Parts(NamedTuple):
    """Parts of steps that are short for the fastest mode.

    Attributes:
        step: number of the step that each is part of, shape (N,).
        start, end: times since the start of that step, shape (N,).
        first, last: whether it begins or ends the step.
    """

    step: np.ndarray
    start: np.ndarray
    end: np.ndarray
    first: np.ndarray
    last: np.ndarray


def parts_of(system: System, steps: Step, rtol: float) -> Parts:
    """Parts of all steps, in the order of time; steps are numpy arrays, their axis the first.

    The parts of a step that has been cut end where those of the whole one do, all but the last: many ends are the same.
    """
    assert steps.inside is not None
    whole = np.maximum(np.ceil(steps.inside.h / _length_of_part(system, steps, max(FOLLOWED * rtol, FINEST))), 1)
    num = np.maximum(np.ceil(steps.h * whole / steps.inside.h - NO_PART), 1).astype(int)
    step = np.repeat(np.arange(num.size), num)
    part = np.arange(step.size) - np.repeat(np.cumsum(num) - num, num)
    start, end = (steps.inside.h[step] * (part + side) / whole[step] for side in (0, 1))
    last = part + 1 == num[step]
    end = np.where(last, steps.h[step], end)
    return Parts(step, start, end, part == 0, last)


def _length_of_part(system: System, steps: Step, followed: float) -> float:
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
    allowed = 46_080 * followed * max(q.max(), (p / rate).max(), 1e-300) / np.maximum(vibration, 1e-300)
    return float((allowed ** (1 / 6) / rate).min())


def short_steps(system: System, steps: Step, rtol: float, *, energies: bool = False) -> Step:
    """Steps in parts so short that values and rates at both ends of each are as good as the flow inside.

    Args:
        system: in which the steps were taken.
        steps: numpy arrays, the first axis that of the steps.
        rtol: relative tolerance of the steps.

    Keyword Args:
        energies: whether the parts are to hold the energies since the first of them.
    """
    if steps.inside is None or not len(steps.h):
        return steps
    parts, system = parts_of(system, steps, rtol), system.single()
    ends = _modes_at(system, steps, parts)
    begins = _begun(parts.first, (steps.start.q, steps.start.p), ends)
    held = (steps.state, steps.time, steps.start, steps.inside)
    columns = ((parts.start, parts.end), (begins, ends))
    end, end_rate, work = _by_rows(_filled, (system, energies), columns, (held, parts.step))
    start, start_rate = _begun(parts.first, (steps.start, steps.start_rate), (end, end_rate))
    state = steps.state[parts.step]
    after = state.copy()
    _set(parts.last, (end, end_rate, after), (steps.end, steps.end_rate, steps.state_after))
    done = jax.tree.map(lambda each: np.cumsum(each, axis=0), work)
    end = eqx.tree_at(lambda y: y.work, end, done, is_leaf=lambda x: x is None)
    time, length = steps.time[parts.step] + parts.start, parts.end - parts.start
    rows = (steps.cycle[parts.step], time, length, start, start_rate, end, end_rate, state, after, None)
    where = lambda s: (s.cycle, s.time, s.h, s.start, s.start_rate, s.end, s.end_rate, s.state, s.state_after, s.inside)  # noqa: E731
    short: Step = eqx.tree_at(where, steps, rows, is_leaf=lambda x: x is None)
    return short


def _begun(first: np.ndarray, own: Any, ends: Any) -> Any:
    """What parts begin with: the first of each step with its own, others with the end of the part before."""
    begins = jax.tree.map(lambda rows: np.roll(rows, 1, axis=0), ends)
    _set(first, begins, own)
    return begins


def _set(known: np.ndarray, rows: Any, own: Any) -> None:
    """Put one row of each step where it is known."""
    for target, values in zip(jax.tree.leaves(rows), jax.tree.leaves(own), strict=True):
        target[known] = values


def _modes_at(system: System, steps: Step, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of the modes at the end of each part.

    The flow until there is the same for all steps of one length, and the dearest part: it is computed once.
    """
    inside = steps.inside
    assert inside is not None
    pairs, number = np.unique(parts.end + 1j * inside.h[parts.step], return_inverse=True)
    flow = _by_rows(_flows, (*diagonals(system), inside.force.shape[1]), (pairs.real, pairs.imag))
    held = (steps.time, steps.start, inside)
    found: tuple[np.ndarray, np.ndarray] = _by_rows(_modes, (system,), (parts.end,), (flow, number), (held, parts.step))
    return found


def _by_rows(function: Callable[..., Any], common: tuple, columns: tuple, *chosen: tuple[Any, np.ndarray]) -> Any:
    """A compiled function of rows, of as many at a time as it is compiled for.

    Args:
        function: of what is common, the rows, and the rows that are chosen.
        common: what all rows share.
        columns: rows as they are.
        chosen: rows, and which of them each row has. Chosen a few at a time they stay in the caches.
    """
    size, found = len(jax.tree.leaves(columns)[0]), []
    for first in range(0, size, ROWS):
        at = np.minimum(np.arange(first, first + ROWS), size - 1)
        rows = [*jax.tree.map(operator.itemgetter(at), columns)]
        rows += [jax.tree.map(operator.itemgetter(index[at]), table) for table, index in chosen]
        found.append(jax.tree.map(np.asarray, function(*common, *rows)))
    return jax.tree.map(lambda *rows: np.concatenate(rows)[:size], *found)


@partial(jax.jit, static_argnums=2)
def _flows(stiffness: Array, damping: Array, num: int, span: Array, h: Array) -> Weights:
    return weights(stiffness, damping, span[:, None], h[:, None], num)


@jax.jit
def _modes(system: System, *columns: Any) -> tuple[Array, Array]:
    def one(span: Array, flow: Weights, held: tuple[Array, Point, Inside]) -> tuple[Array, Array]:
        return modes_after(system, *held, span, flow)

    done: tuple[Array, Array] = jax.vmap(one)(*columns)
    return done


@partial(jax.jit, static_argnums=1)
def _filled(system: System, energies: bool, *columns: Any) -> tuple[Point, Point, Work | None]:
    """State and rate at the end of each part, and the energies in it if they are asked for, by Lobatto's rule."""

    def one(
        span: tuple[Array, Array], modes: tuple, held: tuple[Array, Array, Point, Inside]
    ) -> tuple[Point, Point, Work | None]:
        state, time, start, inside = held

        def at(since: Array, q: Array, p: Array, work: Work | None) -> tuple[Point, Point]:
            point = point_inside(system, (state, time, start), inside, since / inside.h, q, p)
            return point, system.field(state, time + since, Point(point.q, point.p, point.w, work))

        none = Work(jnp.zeros(()), jnp.zeros(()), jnp.zeros(state.shape)) if energies else None
        (q0, p0), (q1, p1) = modes
        end, rate = at(span[1], q1, p1, none)
        if not energies:
            return end, rate, None
        first, h = at(span[0], q0, p0, none)[1], span[1] - span[0]
        inner = (hermite.quintic(x, h, (q0, p0, first.p), (q1, p1, rate.p)) for x in LOBATTO[0])
        powers = [at(span[0] + x * h, q, p, none)[1].work for x, (q, p) in zip(LOBATTO[0], inner, strict=True)]
        powers = [first.work, *powers, rate.work]
        work: Work = jax.tree.map(lambda *each: h * sum(map(operator.mul, LOBATTO[1], each)), *powers)
        return end, Point(rate.q, rate.p, rate.w, None), work

    done: tuple[Point, Point, Work | None] = jax.vmap(one)(*columns)
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
    shape = (len(q), steps.state.shape[1])
    if 0 in shape:
        return np.zeros(shape)
    sides = list(zip(steps.start.w, steps.start_rate.w, steps.end.w, steps.end_rate.w, strict=True))
    w = tuple(_slip(steps.h, *side).reshape(shape) for side in sides)
    (*u, v), (*du, dv) = ([y @ axis.T for axis in system.shape] for y in (q, p))
    columns = (np.repeat(steps.state, NODE.size, axis=0), Motion((*u,), v, (*du,), dv), w)
    power: np.ndarray = _by_rows(_lost, (system.law,), columns)
    return power


def _slip(h: np.ndarray, w0: np.ndarray, dw0: np.ndarray, w1: np.ndarray, dw1: np.ndarray) -> Any:
    """One component of the slip at the nodes of steps of length h, shape (N, nodes, C)."""
    start, end = (w0[:, None], dw0[:, None]), (w1[:, None], dw1[:, None])
    return hermite.cubic(NODE[:, None], h[:, None, None], start, end)


@jax.jit
def _lost(law: ContactLaw, state: Any, motion: Motion, w: Any) -> Scalar:
    return power_lost(law.reaction(state, motion, w))
