"""The law of frictional contacts: force, slip rate, what ends a state and what follows it.

Notation (sections 2 and 3 of the paper, as corrected here)::

    f = K_u (u - w)                                 friction force on body 2             (1)
    n = n0 + k_v v                                  normal load while in contact         (2)
    stick       w' = 0,       |f| < mu n                                                 (3)
    slip        w' = s e,     f = mu n e,  |e| = 1,  s >= 0                              (4, 5)
                s = (e . K_u u' - mu n') / (e . K_u e)                                   (9, times mu n)
    separation  f = 0, w = u

The direction of slip is ``e = sign(n) K_u (u - w) / |K_u (u - w)|`` and the force is put on the cone exactly. Both
``w'`` and ``s`` stay bounded as n -> 0, where an angle of slip would be a singular variable. With the sign of n
the direction goes smoothly through n = 0, so that a trial step may overshoot a separation. Where the elastic
displacement vanishes altogether (n = 0) the direction is the one that solves
``(mu n' I + s K_u) e = K_u u'``, the only one with a bounded rate: it starts a slip after separation (17), and
ends a slip before it.

A vector of the contact plane is a tuple of its components, each an array over the contacts: two of them, or one where
all motion is straight. Everything is elementwise, which is what XLA fuses. Nothing here knows units: the law is
homogeneous, and the event loop uses it in dimensionless form.
"""

from timesim.runtime import Leaf  # isort: skip

from typing import TYPE_CHECKING, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from timesim.engine.barrier import apart
from timesim.model.model import SEPARATION, SLIP, STICK

if TYPE_CHECKING:
    Scalar: TypeAlias = Array
    State: TypeAlias = Array
else:
    Scalar = Float[Leaf, "*#contact"]
    State = Int[Leaf, "*#contact"]
Plane: TypeAlias = tuple[Scalar, ...]


class Law(eqx.Module):
    """Parameters of all contacts, each an array over the contacts.

    Attributes:
        friction: mu.
        stiffness: K_u: (k,) where it is isotropic in every contact, (k1, k2) along its principal axes, else
            (k11, k12, k22).
        compliance: its inverse in the same form; zero for a frictionless stop without stiffness.
        normal_stiffness: k_v.
        preload: n0.
    """

    friction: Scalar
    stiffness: tuple[Scalar, ...]
    compliance: tuple[Scalar, ...]
    normal_stiffness: Scalar
    preload: Scalar


class Motion(eqx.Module):
    """Relative motion of the contacts, in their own axes: u, v and their rates."""

    u: Plane
    v: Scalar
    du: Plane
    dv: Scalar


def dot(a: Plane, b: Plane) -> Scalar:
    """Scalar product in the contact plane."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def scaled(factor: Scalar, a: Plane) -> Plane:
    """A multiple of a vector."""
    return tuple(factor * x for x in a)


def where(condition: Bool[Array, "*#contact"], a: Plane, b: Plane) -> Plane:
    """One of two vectors."""
    return tuple(jnp.where(condition, x, y) for x, y in zip(a, b, strict=True))


def between(a: Plane, b: Plane) -> Plane:
    """a - b."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


def length(a: Plane) -> Scalar:
    """Length of a vector; its derivative at zero is zero, and one may divide by it."""
    return jnp.sqrt(jnp.maximum(dot(a, a), 1e-300))


def product(matrix: tuple[Scalar, ...], a: Plane) -> Plane:
    """A symmetric matrix of the plane times a vector; isotropic if it is one number, diagonal if it is two."""
    if len(matrix) == 1:
        return scaled(matrix[0], a)
    if len(matrix) == 2:
        return tuple(k * x for k, x in zip(matrix, a, strict=True))
    k11, k12, k22 = matrix
    return (k11 * a[0] + k12 * a[1], k12 * a[0] + k22 * a[1])


def normal_load(law: Law, v: Scalar) -> Scalar:
    """n0 + k_v v, negative where the bodies are apart (2)."""
    return law.preload + law.normal_stiffness * v


def slip_speed(law: Law, e: Plane, motion: Motion) -> Scalar:
    """s = |w'| while slipping along e (9); it falls through zero where the contact sticks (12)."""
    cone_rate = law.friction * law.normal_stiffness * motion.dv
    if len(law.stiffness) == 1:
        return dot(e, motion.du) - cone_rate * law.compliance[0]
    ke = product(law.stiffness, e)
    return (dot(ke, motion.du) - cone_rate) / jnp.maximum(dot(e, ke), 1e-150)


def incipient_direction(law: Law, motion: Motion, iterations: int = 7) -> Plane:
    """Direction of slip where n = 0: the e that solves (mu n' I + s K_u) e = K_u u', |e| = 1.

    Isotropic K_u: along u' (18). Otherwise |e| falls monotonically in s; Newton's method on 1 / |e| starts where one
    component alone has length 1, which lies left of the root, and converges from there without overshooting.
    """
    if len(law.stiffness) == 1:
        return scaled(1 / length(motion.du), motion.du)
    if len(law.stiffness) == 2:
        return _solved(law, law.stiffness, motion.du, motion.dv, iterations)
    c, s = _turn(law)
    (k11, k12, k22), (x, y) = law.stiffness, motion.du
    stiff = (k11 * c * c + 2 * k12 * c * s + k22 * s * s, k11 * s * s - 2 * k12 * c * s + k22 * c * c)
    e = _solved(law, stiff, (c * x + s * y, c * y - s * x), motion.dv, iterations)
    return (c * e[0] - s * e[1], s * e[0] + c * e[1])


def _turn(law: Law) -> tuple[Scalar, Scalar]:
    """Cosine and sine of the angle of the first principal axis of K_u."""
    k11, k12, k22 = law.stiffness
    angle = 0.5 * jnp.arctan2(2 * k12, k11 - k22)
    return jnp.cos(angle), jnp.sin(angle)


def _solved(law: Law, stiff: tuple[Scalar, ...], du: Plane, dv: Scalar, iterations: int) -> Plane:
    """The same along the principal axes of K_u."""
    stiff = tuple(jnp.maximum(k, 1e-150) for k in stiff)
    load = tuple(k * x for k, x in zip(stiff, du, strict=True))
    growth = law.friction * law.normal_stiffness * dv
    s = jnp.maximum(*((jnp.abs(p) - growth) / k for p, k in zip(load, stiff, strict=True)))
    for _ in range(iterations + 1):
        # Divisions are what it costs: one for each component, one for the step.
        below = tuple(growth + s * k for k in stiff)
        inverse = tuple(1 / jnp.where(x == 0, 1.0, x) for x in below)
        e = tuple(p * x for p, x in zip(load, inverse, strict=True))
        size = length(e)
        slope = sum(x * x * k * y for x, k, y in zip(e, stiff, inverse, strict=True))
        s = s + (size - 1) * size**2 / jnp.maximum(slope, 1e-150)
    return scaled(1 / size, e)


# Where |K_u (u - w)| is no larger than this many times its own departure from the cone, its direction means nothing:
# the last stages of a step that ends on n = 0. There the direction is the incipient one. Without the switch the
# error estimate sees noise, and a run into separation takes some ten steps more.
UNDIRECTED = 10.0
FORCE_FLOOR = 1e-13
# Time [rad of the excitation] from n = 0 within which the direction of a slip is rounding, and so is its speed: a slip
# that ends or begins there would stick for an instant. Not a share of n: it may be tiny for long under stiff contacts.
SINGULAR = 3e-8


def slip_direction(law: Law, motion: Motion, w: Plane) -> Plane:
    """Unit vector e along which a contact slips."""
    trial = product(law.stiffness, between(motion.u, w))
    n = normal_load(law, motion.v)
    size = length(trial)
    off_cone = jnp.abs(size - law.friction * jnp.abs(n))
    directed = size > UNDIRECTED * off_cone + FORCE_FLOOR
    if len(law.stiffness) == 1:
        # The incipient direction is that of u': normalising after the choice saves a root and a division.
        chosen = where(directed, scaled(jnp.where(n < 0, -1.0, 1.0), trial), motion.du)
        return scaled(1 / length(chosen), chosen)
    along = scaled(jnp.where(n < 0, -1.0, 1.0) / size, trial)
    return where(directed, along, incipient_direction(law, motion, iterations=1))


class Reaction(eqx.Module):
    """What the contacts do at an instant: friction force f, normal load n as it enters, slip rate w'."""

    f: Plane
    n: Scalar
    dw: Plane


@apart
def reaction(law: Law, state: State, motion: Motion, w: Plane) -> Reaction:
    """Forces and slip rate of each contact in its state (1 to 5).

    In contact n is not clipped at 0: the field stays smooth for the trial step that ends beyond a separation.
    """
    n = normal_load(law, motion.v)
    e = slip_direction(law, motion, w)
    slips = state == SLIP
    sliding = jnp.where(slips, law.friction * n, 0.0)
    elastic = product(law.stiffness, between(motion.u, w))
    f = where(state == STICK, elastic, scaled(sliding, e))
    dw = scaled(jnp.where(slips, slip_speed(law, e, motion), 0.0), e)
    return Reaction(f, jnp.where(state == SEPARATION, 0.0, n), dw)


@apart
def margins(law: Law, state: State, motion: Motion, w: Plane) -> tuple[Scalar, Scalar]:
    """Distance to the end of the state: positive inside, zero at the transition; a force, and a speed.

    Stick ends on the cone (3), slip where n or the slip speed falls through zero (12, 13), separation where n rises
    through zero (14). The second one belongs to slip alone, and not to a frictionless contact, which cannot stick.
    """
    n = normal_load(law, motion.v)
    cone = law.friction * n - length(product(law.stiffness, between(motion.u, w)))
    speed = slip_speed(law, slip_direction(law, motion, w), motion)
    singular = n < SINGULAR * jnp.abs(law.normal_stiffness * motion.dv)
    first = jnp.where(state == STICK, cone, jnp.where(state == SLIP, n, -n))
    return first, jnp.where((state == SLIP) & (law.friction > 0) & ~singular, speed, 1.0)


def force_scale(law: Law) -> Scalar:
    """Size of the contact forces for motions of size one, to compare a margin with zero."""
    tangential = sum((jnp.abs(k) for k in law.stiffness), start=jnp.zeros(()))
    return tangential + law.normal_stiffness + jnp.abs(law.preload)


def successor(law: Law, state: State, motion: Motion, *, tiny: Scalar) -> State:
    """State of a contact that has reached a transition, decided by the rates (section 3).

    Where stick or slip ends with n <= ``tiny`` and falling, cone and separation are reached at once and separation
    wins.
    """
    n = normal_load(law, motion.v)
    dn = law.normal_stiffness * motion.dv
    sticks = length(product(law.stiffness, motion.du)) < law.friction * dn
    leaving = jnp.where((n <= tiny) & (dn < 0), SEPARATION, jnp.where(state == STICK, SLIP, STICK))
    return jnp.where(state == SEPARATION, jnp.where(sticks, STICK, SLIP), leaving)


def slip_at_transition(law: Law, before: State, after: State, motion: Motion, w: Plane) -> Plane:
    """w with which a contact goes on: on the cone during and after slip, w = u during and after separation."""
    sliding = law.friction * normal_load(law, motion.v)
    on_cone = between(motion.u, product(law.compliance, scaled(sliding, slip_direction(law, motion, w))))
    w = where(before == SLIP, on_cone, w)
    return where((before == SEPARATION) | (after == SEPARATION), motion.u, w)
