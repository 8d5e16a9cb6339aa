"""Energies that a step of collocation turns over, each the integral of its own power over the dense output.

The velocity of a mode is ``p = p_s + v``: p_s goes smoothly through the step, v rings freely. Gauss's rule integrates
what is smooth. A mode that is slow over the step is smooth altogether: it is the polynomial through the nodes. Of a
fast one p_s is its steady motion and its polynomial response to the polynomial of the force; the integrals of the rest,
v, have a closed form, however often it turns: with ``y' = v`` and ``v' = -d v - k y``

    integral of d v^2 = 1/2 (v^2 + k y^2) lost from start to end,
    V_m = [t^m y] - m Y_(m-1),  k Y_m = -[t^m v] + m V_(m-1) - d V_m

for the moments V_m and Y_m of v and y (quadrature of oscillating functions: L. N. G. Filon, On a quadrature formula for
trigonometric integrals, Proceedings of the Royal Society of Edinburgh 49 (1930) 38-47).
"""

import timesim.runtime  # noqa: F401  isort: skip

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from timesim.engine.barrier import apart
from timesim.engine.dense_output import evaluate
from timesim.engine.exponential.collocation import Inside
from timesim.engine.exponential.steady import Steady, diagonals
from timesim.engine.lanes import batch_first, batch_last, by_rows, over_lanes
from timesim.engine.law.rule import rule_of
from timesim.engine.step import Step
from timesim.engine.system import System, Work
from timesim.program import program

FAST = 1.0
"""k h^2 from which on a mode is fast: below it the recursion of the moments loses digits, and there is no need."""
NEAR = 1e-2
"""Share of k + n^2 by which a fast mode must be off resonance: its harmonics are divided by the distance."""
ROWS = 128  # steps at a time, as many as stay in the caches


@cache
def gauss(num: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss's rule on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(num)
    return (1 + nodes) / 2, weights / 2


def has_fast_modes(system: System, longest: float) -> bool:
    """Whether a mode may be fast in steps up to a length."""
    return bool(np.any(np.asarray(diagonals(system)[0]) * longest**2 > FAST))


@program
def work_done(system: System, has_fast: bool, steps: Step, count: Int[Array, ""]) -> Work:
    """Energies in each of the first ``count`` steps, their axis the first; rows beyond are empty.

    ``has_fast``: whether modes may be fast in them.
    """
    size = steps.h.shape[0]
    rows, steady = min(ROWS, size), Steady.of(system)
    one = partial(_work, system, steady, has_fast)
    blank = jax.eval_shape(one, jax.tree.map(lambda leaf: leaf[0], steps))
    none = jax.tree.map(lambda leaf: jnp.zeros((size, *leaf.shape)), blank)

    def part(i: Array, done: Work) -> Work:
        first = jnp.minimum(i * rows, size - rows)
        own = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first, rows), steps)
        found = batch_first(over_lanes(one)(batch_last(own)))
        return jax.tree.map(lambda all_, some: jax.lax.dynamic_update_slice_in_dim(all_, some, first, 0), done, found)

    return jax.lax.fori_loop(0, (count + rows - 1) // rows, part, none)


def energy_lost(steps: Step) -> np.ndarray:
    """Energy lost in each contact over all steps, shape (C,); steps are numpy arrays, their axis the first."""
    return by_rows(_frictions, (), (steps,)).sum(axis=0) if steps.h.size else np.zeros(steps.state.shape[1])


@program
def _frictions(steps: Step) -> Array:
    return jax.vmap(_friction)(steps)


def _work(system: System, steady: Steady, has_fast: bool, step: Step) -> Work:
    """Energies in one step."""
    assert step.inside is not None
    inside = step.inside
    at, weight = gauss(inside.q.shape[0] + 1)
    tau, share = step.h / inside.h * jnp.asarray(at)[:, None], step.h * jnp.asarray(weight)
    turns = _turns(system, step.time + inside.h * tau)
    by_nodes = smooth = _velocity(tau, _through_nodes(inside, inside.q, inside.p), inside.h)
    if has_fast:
        fast = _fast(system, inside.h)
        answer = _answer(system, inside, fast)
        smooth = _forced(system, steady, turns, _velocity(tau, answer, inside.h), (by_nodes, fast))
    given, lost = _smooth(system, turns, share, smooth, by_nodes)
    if has_fast:
        more = _ringing(system, steady, step, answer, fast)
        given, lost = given + more[0], lost + more[1]
    return Work(given.sum(), lost.sum(), _friction(step))


@apart
def _turns(system: System, time: Array) -> tuple[Array, Array]:
    """Cosine and sine of the phase of each harmonic, (harmonic, node, 1)."""
    angle = system.harmonic[:, None, None] * (time + system.phase)
    return jnp.cos(angle), jnp.sin(angle)


@apart
def _velocity(tau: Array, coefficients: tuple[Array, ...], h: Array) -> Array:
    return evaluate(tau, coefficients)[1] / h


@apart
def _forced(
    system: System, steady: Steady, turns: tuple[Array, Array], answer: Array, slow: tuple[Array, Array]
) -> Array:
    """Velocity at places inside a step but for free vibration: of fast modes the forced one, of others all."""
    p, fast = slow
    for row in range(system.harmonic.shape[0]):
        cosine, sine = (part[row] for part in turns)
        answer = answer + system.harmonic[row] * (steady.b[row] * cosine - steady.a[row] * sine)
    return jnp.where(fast, answer, p)


@apart
def _smooth(system: System, turns: tuple[Array, Array], share: Array, p: Array, by_nodes: Array) -> tuple[Array, Array]:
    """Energy put into each mode and lost in its damping at a velocity that is smooth."""
    drive = jnp.broadcast_to(system.constant, p.shape)
    for row in range(system.harmonic.shape[0]):
        cosine, sine = (part[row] for part in turns)
        drive = drive + system.cosine[row] * cosine + system.sine[row] * sine
    lost = diagonals(system)[1] * (share[:, None] * p**2).sum(axis=0)
    if system.damping.ndim == 2:
        coupling = system.damping - jnp.diag(jnp.diagonal(system.damping))
        lost = lost + (share[:, None] * by_nodes * (by_nodes @ coupling.T)).sum(axis=0)
    return (share[:, None] * drive * p).sum(axis=0), lost


def _through_nodes(inside: Inside, x: Array, dx: Array) -> tuple[Array, ...]:
    """Coefficients of the polynomial through values and rates at the nodes."""
    hermite = jnp.asarray(rule_of(len(x) - 1).hermite)
    return x[0], *jnp.tensordot(hermite[1:], jnp.concatenate([x - x[:1], inside.h * dx]), 1)


@apart
def _friction(step: Step) -> Array:
    """Energy lost in each contact: force and slip are polynomials, the force that by which the modes are moved."""
    inside = step.inside
    assert inside is not None
    x, monomials = step.h / inside.h, jnp.asarray(rule_of(len(inside.q) - 1).monomials)
    power = np.arange(len(monomials))
    share = jnp.asarray(power / np.maximum(power[:, None] + power, 1))  # integral of f^m d w^n
    lost = jnp.zeros(step.state.shape)
    for f, w, end in zip(inside.f, inside.w, step.end.w, strict=True):
        force, slip = ((x**power)[:, None] * (monomials @ y) for y in (f, w - w[:1]))
        beside = end - w[0] - slip.sum(axis=0)  # of a step that is cut, which the flow ends
        lost = lost + (force * (share @ slip)).sum(axis=0) + force.sum(axis=0) * beside
    if inside.lost is not None:
        lost = lost + inside.h * (x ** (power + 1) / (power + 1)) @ (monomials @ inside.lost)
    return lost


def _fast(system: System, h: Array) -> Bool[Array, " mode"]:
    """Modes that ring within a step of length h."""
    stiffness, damping = diagonals(system)
    fast = (stiffness * h * h > FAST) & (stiffness * h > damping)
    for row in range(system.harmonic.shape[0]):
        order = system.harmonic[row]
        distance = (stiffness - order**2) ** 2 + (damping * order) ** 2
        fast = fast & (distance > (NEAR * (stiffness + order**2)) ** 2)
    return fast


@apart
def _answer(system: System, inside: Inside, fast: Bool[Array, " mode"]) -> tuple[Array, ...]:
    """Coefficients of the polynomial motion of fast modes under the polynomial of their force; 0 of others."""
    stiffness, damping = diagonals(system)
    h, size = inside.h, inside.force.shape[0]
    stiffness = jnp.where(fast, stiffness, 1.0)
    found = [jnp.zeros_like(stiffness)] * 2
    for m in range(size - 1, -1, -1):
        drag = damping * (m + 1) / h * found[0] + (m + 1) * (m + 2) / (h * h) * found[1]
        found = [jnp.where(fast, (inside.force[m] - drag) / stiffness, 0.0), *found]
    return tuple(found[:size])


@apart
def _ringing(
    system: System, steady: Steady, step: Step, answer: tuple[Array, ...], fast: Bool[Array, " mode"]
) -> tuple[Array, Array]:
    """What free vibration adds to the energy put into fast modes and lost in their damping."""
    assert step.inside is not None
    stiffness, damping = diagonals(system)
    h, x = step.inside.h, step.h / step.inside.h
    turns = _turns(system, step.time + step.h * jnp.array([[0.0], [1.0]]))
    (y0, v0), (y1, v1) = (
        _free(system, steady, (point, at, h), (turns[0][:, i], turns[1][:, i]), answer, fast)
        for i, (point, at) in enumerate(((step.start, jnp.zeros_like(x)), (step.end, x)))
    )
    lost = 0.5 * (v0**2 - v1**2 + stiffness * (y0**2 - y1**2))
    given = system.constant * (y1 - y0)
    safe = jnp.where(fast, stiffness, 1.0)
    power, last_v, last_y = jnp.ones_like(x), 0.0, 0.0
    for m in range(len(answer) - 1):
        started = 1.0 if m == 0 else 0.0
        moment = power * y1 - started * y0 - m / h * last_y
        lost = lost + 2 * damping * (m + 1) / h * answer[m + 1] * moment
        last_y = -(power * v1 - started * v0 - m / h * last_v + damping * moment) / safe
        power, last_v = power * x, moment
    for row in range(system.harmonic.shape[0]):
        order = system.harmonic[row]
        (c0, c1), (s0, s1) = (part[row, :, 0] for part in turns)
        # Integrals of cos(n t) v and sin(n t) v, as the real and the imaginary part of one.
        of_y = (c1 * y1 - c0 * y0, s1 * y1 - s0 * y0)
        of_v = (c1 * v1 - c0 * v0, s1 * v1 - s0 * v0)
        reactance, loss = jnp.where(fast, stiffness - order**2, 1.0), order * damping
        size = reactance**2 + loss**2
        above = (of_v[0] + damping * of_y[0] + order * of_y[1], of_v[1] + damping * of_y[1] - order * of_y[0])
        real = (above[0] * reactance - above[1] * loss) / size
        imaginary = (above[1] * reactance + above[0] * loss) / size
        real, imaginary = of_y[0] - order * imaginary, of_y[1] + order * real
        own = steady.b[row] * real - steady.a[row] * imaginary
        lost = lost + 2 * damping * order * own
        given = given + system.cosine[row] * real + system.sine[row] * imaginary
    return given, lost


def _free(
    system: System, steady: Steady, end: tuple, turns: tuple[Array, Array], answer: tuple, fast: Bool[Array, " mode"]
) -> tuple[Array, Array]:
    """Displacement and velocity of the free vibration of fast modes at an end of a step; 0 of others."""
    point, at, h = end
    z, dz = evaluate(at, answer)
    q, p = point.q - z, point.p - dz / h
    for row, (cosine, sine) in enumerate(zip(*turns, strict=True)):
        q = q - steady.a[row] * cosine - steady.b[row] * sine
        p = p - system.harmonic[row] * (steady.b[row] * cosine - steady.a[row] * sine)
    return jnp.where(fast, q, 0.0), jnp.where(fast, p, 0.0)
