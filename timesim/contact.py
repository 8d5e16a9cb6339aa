"""The law of frictional contacts: force, slip rate, what ends a state and what follows it.

Notation (sections 2 and 3 of the paper, as corrected here). Every array has the contact as its first axis; the
tangential plane is the last one, of length 2, or of length 1 where the motion of every contact is straight::

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

Nothing here knows units: the law is homogeneous, and the event loop uses it in dimensionless form.
"""

import timesim.jax_setup  # noqa: F401  isort: skip

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from timesim.model import SEPARATION, SLIP, STICK

Plane = Float[Array, "contact tangent"]
Scalar = Float[Array, " contact"]
State = Int[Array, " contact"]


class Law(eqx.Module):
    """Parameters of all contacts.

    Attributes:
        friction: mu.
        stiffness: K_u, one number a contact where it is isotropic, else a 2 x 2 matrix.
        normal_stiffness: k_v.
        preload: n0.
    """

    friction: Scalar
    stiffness: Float[Array, " contact"] | Float[Array, "contact 2 2"]
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
    return jnp.sum(a * b, axis=-1)


def norm(a: Plane) -> Scalar:
    """Length in the contact plane, with derivative zero at zero."""
    square = dot(a, a)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def elastic_force(law: Law, stretch: Plane) -> Plane:
    """K_u times a stretch u - w."""
    if law.stiffness.ndim == 1:
        return law.stiffness[:, None] * stretch
    return law.stiffness[:, :, 0] * stretch[:, :1] + law.stiffness[:, :, 1] * stretch[:, 1:]


def stretch_of(law: Law, force: Plane) -> Plane:
    """The stretch u - w that a friction force belongs to, zero for a frictionless contact."""
    if law.stiffness.ndim == 1:
        soft = law.stiffness == 0
        return jnp.where(soft[:, None], 0.0, force / jnp.where(soft, 1.0, law.stiffness)[:, None])
    (a, b), (c, d) = ((law.stiffness[:, i, j] for j in range(2)) for i in range(2))
    det = a * d - b * c
    soft = det == 0
    inverse = jnp.where(soft, 0.0, 1 / jnp.where(soft, 1.0, det))
    x, y = force[:, 0], force[:, 1]
    return jnp.stack([(d * x - b * y) * inverse, (a * y - c * x) * inverse], axis=-1)


def normal_load(law: Law, v: Scalar) -> Scalar:
    """n0 + k_v v, negative where the bodies are apart (2)."""
    return law.preload + law.normal_stiffness * v


def slip_speed(law: Law, e: Plane, motion: Motion) -> Scalar:
    """s = |w'| while slipping along e (9); it falls through zero where the contact sticks (12)."""
    ke = elastic_force(law, e)
    stiff = dot(e, ke)
    driven = dot(ke, motion.du) - law.friction * law.normal_stiffness * motion.dv
    return jnp.where(stiff > 0, driven / jnp.where(stiff > 0, stiff, 1.0), 1.0)


def incipient_direction(law: Law, motion: Motion, iterations: int = 7) -> Plane:
    """Direction of slip where n = 0: the e that solves (mu n' I + s K_u) e = K_u u', |e| = 1.

    Isotropic K_u: along u' (18). Otherwise |e| falls monotonically in s; Newton's method on 1 / |e| starts where one
    component alone has length 1, which lies left of the root, and converges from there without overshooting.
    """
    if law.stiffness.ndim == 1:
        return _unit(motion.du)
    axes = _principal_axes(law)
    stiff = jnp.stack([dot(x, elastic_force(law, x)) for x in axes], axis=-1)
    stiff = jnp.where(stiff > 0, stiff, 1.0)
    load = stiff * jnp.stack([dot(x, motion.du) for x in axes], axis=-1)
    growth = (law.friction * law.normal_stiffness * motion.dv)[:, None]
    s = jnp.max((jnp.abs(load) - growth) / stiff, axis=-1)
    for _ in range(iterations):
        below = growth + s[:, None] * stiff
        below = jnp.where(below == 0, 1.0, below)
        e = load / below
        square = dot(e, e)
        slope = dot(e, e * stiff / below)
        s = s + jnp.where(slope > 0, (jnp.sqrt(square) - 1) * square / jnp.where(slope > 0, slope, 1.0), 0.0)
    below = growth + s[:, None] * stiff
    e = load / jnp.where(below == 0, 1.0, below)
    return _unit(e[:, :1] * axes[0] + e[:, 1:] * axes[1])


def _unit(a: Plane) -> Plane:
    """The vector at length 1; the first axis where it has none."""
    length = norm(a)
    still = (length == 0)[:, None]
    return jnp.where(still, jnp.eye(1, a.shape[-1])[0], a / jnp.where(still, 1.0, length[:, None]))


def _principal_axes(law: Law) -> tuple[Plane, Plane]:
    angle = 0.5 * jnp.arctan2(2 * law.stiffness[:, 0, 1], law.stiffness[:, 0, 0] - law.stiffness[:, 1, 1])
    axis = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
    return axis, jnp.stack([-axis[:, 1], axis[:, 0]], axis=-1)


# Where |K_u (u - w)| is no larger than this many times its own departure from the cone, its direction means nothing:
# the last stages of a step that ends on n = 0. There the direction is the incipient one. Without the switch the
# error estimate sees noise, and a run into separation takes some ten steps more.
UNDIRECTED = 10.0
FORCE_FLOOR = 1e-13


def slip_direction(law: Law, motion: Motion, w: Plane) -> Plane:
    """Unit vector e along which a contact slips."""
    trial = elastic_force(law, motion.u - w)
    n = normal_load(law, motion.v)
    size = norm(trial)
    off_cone = jnp.abs(size - law.friction * jnp.abs(n))
    directed = size > UNDIRECTED * off_cone + FORCE_FLOOR
    along = jnp.where(n < 0, -1.0, 1.0)[:, None] * trial / jnp.where(directed, size, 1.0)[:, None]
    return jnp.where(directed[:, None], along, incipient_direction(law, motion, iterations=3))


class Reaction(eqx.Module):
    """What the contacts do at an instant: friction force f, normal load n >= 0 as it enters, and slip rate w'."""

    f: Plane
    n: Scalar
    dw: Plane


def reaction(law: Law, state: State, motion: Motion, w: Plane) -> Reaction:
    """Forces and slip rate of each contact in its state (1 to 5).

    In contact n is not clipped at 0: the field stays smooth for the trial step that ends beyond a separation.
    """
    n = normal_load(law, motion.v)
    e = slip_direction(law, motion, w)
    stick, slip = (state == STICK)[:, None], (state == SLIP)[:, None]
    f = jnp.where(
        stick, elastic_force(law, motion.u - w), jnp.where(slip, (law.friction * n)[:, None] * e, 0.0)
    )
    dw = jnp.where(slip, slip_speed(law, e, motion)[:, None] * e, 0.0)
    return Reaction(f, jnp.where(state == SEPARATION, 0.0, n), dw)


def margins(law: Law, state: State, motion: Motion, w: Plane) -> Float[Array, "contact 2"]:
    """Distance to the end of the state: positive inside, zero at the transition, dimension of K_u u or of u'.

    Stick ends on the cone (3), slip where n or the slip speed falls through zero (12, 13), separation where n rises
    through zero (14). The second column is used by slip alone.
    """
    n = normal_load(law, motion.v)
    cone = law.friction * n - norm(elastic_force(law, motion.u - w))
    # Only an odd power of n is a guard in slip; the speed is none for a frictionless contact, which cannot stick.
    speed = slip_speed(law, slip_direction(law, motion, w), motion)
    first = jnp.where(state == STICK, cone, jnp.where(state == SLIP, n, -n))
    second = jnp.where((state == SLIP) & (law.friction > 0), speed, 1.0)
    return jnp.stack([first, second], axis=-1)


def margin_scale(law: Law) -> Float[Array, "contact 2"]:
    """Size of the margins for motions of size 1, to compare them with zero."""
    stiffness = law.stiffness if law.stiffness.ndim == 1 else jnp.abs(law.stiffness).sum(axis=(1, 2))
    force = stiffness + law.normal_stiffness + jnp.abs(law.preload)
    return jnp.stack([force, jnp.ones_like(force)], axis=-1)


def successor(law: Law, state: State, motion: Motion, w: Plane, *, tiny: float) -> State:
    """State of a contact that has reached a transition, decided by the rates (section 3).

    Where stick ends with n = 0 (within ``tiny``, relative to the size of the load), cone and separation are reached
    at once and separation wins; likewise at the end of a slip.
    """
    n = normal_load(law, motion.v)
    dn = law.normal_stiffness * motion.dv
    empty = (n <= tiny * margin_scale(law)[:, 0]) & (dn < 0)
    sticks = norm(elastic_force(law, motion.du)) < law.friction * dn
    leaving = jnp.where(empty, SEPARATION, jnp.where(state == STICK, SLIP, STICK))
    arriving = jnp.where(sticks, STICK, SLIP)
    return jnp.where(state == SEPARATION, arriving, leaving)


def slip_at_transition(law: Law, before: State, after: State, motion: Motion, w: Plane) -> Plane:
    """w with which a contact enters a state: on the cone after slip, w = u after or during separation."""
    n = normal_load(law, motion.v)
    on_cone = motion.u - stretch_of(law, (law.friction * n)[:, None] * slip_direction(law, motion, w))
    w = jnp.where(((before == SLIP) & (after == STICK))[:, None], on_cone, w)
    return jnp.where(((before == SEPARATION) | (after == SEPARATION))[:, None], motion.u, w)
