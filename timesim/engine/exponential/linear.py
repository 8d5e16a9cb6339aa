"""The motion of a system without contacts, in closed form.

With the harmonics of the excitation and its constant among the unknowns, ``Y = (q, q', cosines, sines, 1)``, the
equations are ``Y' = A Y``, and ``Y(t + h) = exp(A h) Y(t)`` over any time: rigid-body, undamped, critically damped and
overdamped modes, damping that couples them and resonance are all the same to it [1]_. The exponential less one, E, is a
Taylor series over a short time, doubled by ``E(2h) = 2 E + E^2``: beside a mode a million times faster a slow
one keeps the digits that it would lose to the squares of the exponential itself [2]_. The energies are quadratic forms
of the state at the start of a step, doubled with it [1]_.

Only the dense output limits a step: it is as long as the quintic through its ends follows the motion. What decays fast
does so at the start alone: the first cycle goes by spans each as long as all before it, with steps of their own.

.. [1] C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Transactions on Automatic Control 23
   (1978) 395-404.
.. [2] C. Moler & C. Van Loan, Nineteen dubious ways to compute the exponential of a matrix, twenty-five years later,
   SIAM Review 45 (2003) 3-49, method 3.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Iterator
from functools import cached_property, reduce
from typing import NamedTuple

import jax
import numpy as np

from timesim.engine.event_loop import Batch, Reached, Rows, capacity
from timesim.engine.exponential.parts import FINEST
from timesim.engine.exponential.work import gauss
from timesim.engine.status import NOBODY, Status
from timesim.engine.step import PERIOD, Step
from timesim.engine.system import Point, System, Work
from timesim.model.solver import Solver

SHORT = 0.5  # of the norm of A h, up to which the series is used
NUM_TERMS = 14  # of it: 0.5^14 / 15! = 5e-17 of the first
NUM_NODES = 6  # of Gauss's rule for the energies over so short a time: 2e-16
LOOKS = 16  # of a cycle of the highest harmonic, at which the motion is looked at to choose the steps
FAST = 10.0  # times the highest harmonic, from which on a mode that hardly rings need not be followed
RUNGS = 4  # numbers of steps a cycle from one to twice as many: each asks for matrices of its own
QUINTICS = 20  # that follow a vibration for each step that stability asks for: 3.3 / (46,080 FINEST)^(1/6) = 17
ENOUGH = 0.7  # of the steps that there are, from which on fewer would not pay for other matrices
DEAD = 1e-13  # of the largest motion: one that has decayed to that is followed no closer


class Flow(NamedTuple):
    """What a time h does to a state.

    Attributes:
        moves: ``exp(A h) - 1`` of each block, shape (B, n, n), and of twice the time, of four times it, and so on.
        forms: quadratic forms of the energy put in and lost in damping over h, shape (2, B, n, n), if they are wanted.
    """

    moves: list[np.ndarray]
    forms: np.ndarray | None


def doubled(move: np.ndarray) -> np.ndarray:
    """``exp(2 A h) - 1`` from ``exp(A h) - 1``."""
    return 2 * move + move @ move


class LinearMotion:
    """The equations of a system without contacts, and its motion from any state.

    Modes that damping does not couple move each by itself: a state is that of blocks, which are of one mode each then,
    or of all of them. Each has its own load.

    Attributes:
        highest: multiple of the base frequency in the excitation.
        matrix: A of each block, shape (B, n, n); displacements and loads are in units in which its norm is about the
            fastest rate of a mode.
    """

    def __init__(self, system: System):
        self.system = system
        coupled, num = system.damping.ndim == 2, len(system.stiffness)
        blocks, size = (1, num) if coupled else (num, 1)
        self.rate = np.maximum(np.sqrt(system.stiffness), 1.0).reshape(blocks, size)
        self.drag = np.asarray(system.damping).reshape(blocks, size, size)
        force = np.concatenate([system.cosine, system.sine, system.constant[None]]).T.reshape(blocks, size, -1)
        self.highest = int(system.harmonic.max(initial=1.0))
        self.unit = max(float(np.abs(force).sum(axis=1).max() / self.rate.max()), 1.0)
        self.q, self.p, self.load = slice(size), slice(size, 2 * size), slice(2 * size, None)
        self.matrix = np.zeros((blocks, *(2 * size + force.shape[2],) * 2))
        self.matrix[:, self.q, self.p] = self.rate[:, None] * np.eye(size)
        back = system.stiffness.reshape(blocks, 1, size) / self.rate[:, None]
        self.matrix[:, self.p, self.q] = -back * np.eye(size)
        self.matrix[:, self.p, self.p], self.matrix[:, self.p, self.load] = -self.drag, force / self.unit
        turn = np.kron([[0.0, -1.0], [1.0, 0.0]], np.diag(system.harmonic))
        self.matrix[:, 2 * size : -1, 2 * size : -1] = turn
        self._flows: dict[tuple[int, bool], Flow] = {}

    def state(self, q: np.ndarray, p: np.ndarray, time: float) -> np.ndarray:
        """The state Y at a time within the cycle, shape (B, n)."""
        angle = self.system.harmonic * (time + self.system.phase)
        load = self.unit * np.concatenate([np.cos(angle), np.sin(angle), [1.0]])
        own = (self.rate * q.reshape(self.rate.shape), p.reshape(self.rate.shape))
        return np.concatenate([*own, np.broadcast_to(load, (len(self.rate), load.size))], axis=1)

    def modes(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacement, velocity and acceleration of the modes, each (N, M), of states along the last axis."""
        acceleration = self.matrix[:, self.p] @ states
        parts = (states[:, self.q] / self.rate[..., None], states[:, self.p], acceleration)
        q, p, dp = (part.reshape(self.rate.size, -1).T for part in parts)
        return q, p, dp

    def after(self, state: np.ndarray, time: float) -> np.ndarray:
        """The state after any time, at once."""
        return state + (self.flow(time, energies=False).moves[0] @ state[..., None])[..., 0]

    def flow(self, h: float, *, energies: bool = True) -> Flow:
        """What a time h does."""
        powers, doublings, short = self._series(h)
        move, one = reduce(np.add, powers[::-1]), np.eye(self.matrix.shape[1])  # the smallest first
        forms = self._energies(powers, short) if energies else None
        for _ in range(doublings):
            if forms is not None:
                forms = forms + (one + move).swapaxes(1, 2) @ forms @ (one + move)
            move = doubled(move)
        return Flow([move], forms)

    def _energies(self, powers: list[np.ndarray], short: float) -> np.ndarray:
        """Quadratic forms of the energies over a short time, by Gauss's rule on its series."""
        forms, one = np.zeros((2, *self.matrix.shape)), np.eye(self.matrix.shape[1])
        for x, weight in zip(*gauss(NUM_NODES), strict=True):
            inside = one + reduce(np.add, [x**k * powers[k - 1] for k in range(len(powers), 0, -1)])
            velocity = weight * short * inside[:, self.p].swapaxes(1, 2)
            forms[0] += velocity @ (self.matrix[:, self.p, self.load] @ inside[:, self.load])
            forms[1] += velocity @ (self.drag @ inside[:, self.p])
        return forms

    def _series(self, h: float) -> tuple[list[np.ndarray], int, float]:
        """Terms of ``exp(A s) - 1``, the largest first, of a short time s; how often it is doubled up to h; and s."""
        size = max(h * float(np.abs(self.matrix).sum(axis=1).max()) / SHORT, 1.0)
        doublings = int(np.ceil(np.log2(size)))
        short = h / 2.0**doublings
        powers = [short * self.matrix]
        for k in range(2, NUM_TERMS + 1):
            powers.append(powers[0] @ powers[-1] / k)
        return powers, doublings, short

    def steps(self, num: int, *, energies: bool = True) -> Flow:
        """What a step does of which a cycle has so many."""
        key = (num, energies)
        if key not in self._flows:
            self._flows[key] = self.flow(PERIOD / num, energies=energies)
        return self._flows[key]

    def path(self, flow: Flow, state: np.ndarray, count: int) -> np.ndarray:
        """The state before and after each of some steps, shape (B, n, count + 1)."""
        states = state[..., None]
        for level in range(int(np.ceil(np.log2(count + 1)))):
            if level == len(flow.moves):
                flow.moves.append(doubled(flow.moves[-1]))
            begun = states[..., : count + 1 - states.shape[2]]
            states = np.concatenate([states, begun + flow.moves[level] @ begun], axis=2)
        return states

    @cached_property
    def first_span(self) -> float:
        """Share 2^-k of a cycle within which the looks see what decays fastest."""
        decay = float(np.linalg.norm(self.drag, axis=(1, 2)).max())
        return float(2.0 ** -max(np.ceil(np.log2(max(decay, 1.0) / (LOOKS * self.highest))), 0.0))

    @cached_property
    def _sixth(self) -> tuple[float, np.ndarray]:
        """Fastest rate, and the matrix of the sixth derivatives in its units."""
        fastest = float(max(self.rate.max(), np.abs(self.drag).max(), self.highest))
        return fastest, np.linalg.matrix_power(self.matrix / fastest, 6)

    def steps_a_cycle(self, state: np.ndarray, cycles: float, rtol: float) -> float:
        """Steps of a cycle of which the quintics through both ends follow the motion over some cycles, or 2^-k of one.

        They may miss a share ``rtol`` of the largest mode in each cycle, of fast vibrations at least `FINEST`. A
        quintic misses ``h^6 |q^(6)| / 46,080`` (Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I,
        section II.6), and of a vibration that is shorter than the step about ``h^2 |q''| / 16``.
        """
        (fastest, sixth), looks, unit = self._sixth, LOOKS * self.highest, self.rate[..., None]
        spans = max(int(cycles), 1)
        states = self.path(self.steps(int(looks * spans / cycles), energies=False), state, looks * spans)[..., :-1]
        jet, by_cycle = sixth @ states, (self.rate.size, spans, looks)
        rate = np.maximum(unit, self.drag.diagonal(axis1=1, axis2=2)[..., None])
        bends = np.hypot(jet[:, self.q] / unit, jet[:, self.p] / rate).reshape(by_cycle).max(axis=2)
        size, rate = np.abs(states[:, self.q] / unit).reshape(by_cycle).max(axis=2), rate.reshape(-1, 1)
        largest = size.max(axis=0)
        whole = 46_080 * np.maximum(largest, max(DEAD * largest.max(), 1e-300))
        with np.errstate(divide="ignore"):
            follows = (whole / bends) ** (1 / 6) / fastest
            swings = np.sqrt(max(FINEST, rtol) / 2880 * whole / bends) * (rate / fastest) ** 3 / rate
            slow = (rtol * whole / size) ** (1 / 6) / self.highest
        rings = np.minimum(slow, np.maximum(max(FINEST, rtol) ** (1 / 6) * follows, swings))
        length = np.maximum(rtol ** (1 / 6) * follows, np.where(rate > FAST * self.highest, rings, 0.0))
        return float(PERIOD / length.min())


def linear_batches(system: System, start: Point, cycles: int, solver: Solver) -> Iterator[Batch]:
    """Steps through some cycles from the start of one, a batch at a time, or until one asks for too many.

    The system, of numpy arrays, is without contacts. The tolerance of the solver is what the quintics may leave of the
    motion, its budget that of explicit steps a cycle.
    """
    motion, room, num, done = LinearMotion(system), capacity(system, 0), 2 * LOOKS, 0.0
    state, work, like = motion.state(start.q, start.p, 0.0), np.zeros((2, 1)), _Like.of(start)
    while done < cycles:
        ahead = min(max(room // num, 1), cycles - done) if done >= 1 else done or motion.first_span
        wanted, part = motion.steps_a_cycle(state, ahead, solver.rtol), min(ahead, 1)
        if not wanted * part <= QUINTICS * solver.budget:
            status = Status.BUDGET if np.isfinite(state).all() else Status.NOT_FINITE
            yield like.batch(motion, state[..., None], (int(done * num), num), work[:, :0], status)
            return
        least = max(wanted * part, LOOKS)
        if not ENOUGH * num * part <= least <= num * part:
            num = int(np.ceil(2 ** (np.ceil(RUNGS * np.log2(least)) / RUNGS)) / part)
        flow, first, end = motion.steps(num), int(num * done), int(num * (done + min(max(room // num, 1), ahead)))
        while first < end:
            states = motion.path(flow, state, min(room, end - first))
            assert flow.forms is not None
            each = ((flow.forms @ states) * states).sum(axis=(1, 2))[:, :-1]
            work = work[:, -1:] + np.cumsum(each, axis=1)
            batch = like.batch(motion, states, (first, num), work, Status.RUNNING)
            yield batch
            first += states.shape[2] - 1
            state = motion.state(batch.now.point.q, batch.now.point.p, float(batch.now.time))
        done = end / num


def linear_leap(system: System, start: Point, cycles: int) -> Reached:
    """Where a trajectory is some cycles later than at the start of one; arguments as of `linear_batches`."""
    motion = LinearMotion(system)
    end = motion.after(motion.state(start.q, start.p, 0.0), PERIOD * cycles)
    return reached(motion, end, (cycles, 0.0), start, Status.RUNNING)


class _Like(NamedTuple):
    """Templates of steps, energies and states: to make each anew by its class takes as long as all else."""

    step: Step
    work: Work
    point: Point

    @classmethod
    def of(cls, point: Point) -> "_Like":
        zero, none, state = np.zeros(()), np.zeros((), dtype=int), np.zeros(0, dtype=int)
        step = Step(none, zero, zero, point, point, point, point, state, state)
        return cls(step, Work(zero, zero, np.zeros(0)), point)

    def batch(
        self, motion: LinearMotion, states: np.ndarray, place: tuple[int, int], work: np.ndarray, status: Status
    ) -> Batch:
        """Steps between states; ``place``: number of the first of them, and how many a cycle has."""
        (q, p, dp), (first, num) = motion.modes(states), place
        index = first + np.arange(len(q) - 1)
        w = [np.zeros((len(q), *part.shape)) for part in self.point.w]
        start, end = ([part[side] for part in (q, p, *w, p, dp, *w)] for side in (slice(-1), slice(1, None)))
        state, length = np.zeros((index.size, 0), dtype=int), np.full(index.size, PERIOD / num)
        step = _made(self.step, [index // num, PERIOD * (index % num) / num, length, *start, *end, state, state])
        last = first + index.size
        now = reached(motion, states[..., -1], (last // num, PERIOD * (last % num) / num), self.point, status)
        return Batch(step, _made(self.work, [*work, state.astype(float)]), now)


def reached(motion: LinearMotion, state: np.ndarray, place: tuple[int, float], like: Point, status: Status) -> Reached:
    """Where a trajectory stands in a state, in a cycle and at a time within it."""
    q, p, _ = motion.modes(state[..., None])
    cycle, time = (np.asarray(part) for part in place)
    point = _made(like, [q[0], p[0], *like.w])
    return Reached(cycle, time, point, np.zeros(0, dtype=int), np.asarray(status.value), np.asarray(NOBODY))


def _made(like: Rows, leaves: list[np.ndarray]) -> Rows:
    """The same with other leaves."""
    return jax.tree.unflatten(jax.tree.structure(like), leaves)
