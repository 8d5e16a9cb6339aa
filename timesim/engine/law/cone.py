"""Coulomb friction with a tangential and a normal stiffness: the cone law.

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
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from timesim.engine.barrier import apart
from timesim.engine.law import slip_angle
from timesim.engine.law.contact_law import (
    ContactLaw,
    Motion,
    Plane,
    Reaction,
    Scalar,
    State,
    Within,
    dot,
    length,
    minus,
    product,
    scaled,
    where,
)
from timesim.engine.law.rule import Rule
from timesim.engine.tolerance import FORCE_FLOOR, NO_LOAD, SINGULAR, SOON, TOGETHER, VIOLATED
from timesim.model.contact_state import cone_states, contact_state, slip_follows_motion
from timesim.model.model import SEPARATION, SLIP, STICK, Contact
from timesim.model.scales import Scales

# Where |K_u (u - w)| is no larger than this many times its own departure from the cone, its direction means nothing:
# the last stages of a step that ends on n = 0. There the direction is the incipient one. Without the switch the
# error estimate sees noise, and a run into separation takes some ten steps more.
UNDIRECTED = 10.0
# Decay of a disturbed direction in a step up to which an explicit method follows it.
FOLLOWED = 2.5


class ConeLaw(ContactLaw):
    """Stick inside the friction cone, slip on it, separation where the normal load vanishes.

    Attributes:
        friction: mu.
        stiffness: K_u: (k,) where it is isotropic in every contact, (k1, k2) along its principal axes, else
            (k11, k12, k22).
        compliance: its inverse in the same form; zero for a frictionless stop without stiffness.
        normal_stiffness: k_v.
        preload: n0.
        step: length of the step whose derivative is sought, of contacts with a direction that it does not resolve, else
            0, see `felt_direction`; None elsewhere.
    """

    friction: Scalar
    stiffness: tuple[Scalar, ...]
    compliance: tuple[Scalar, ...]
    normal_stiffness: Scalar
    preload: Scalar
    step: Scalar | None = None

    @classmethod
    def of(cls, contacts: Sequence[Contact], scales: Scales, axes: np.ndarray | None = None) -> "ConeLaw":
        ratio = scales.length / scales.force
        stiffness = np.array([contact.tangential_stiffness for contact in contacts]).reshape(-1, 2, 2) * ratio
        rows = [(c.friction, c.normal_stiffness * ratio, c.preload / scales.force) for c in contacts]
        friction, normal_stiffness, preload = np.array(rows, dtype=float).reshape(-1, 3).T.copy()
        if axes is None:
            return cls(friction, *matrix_and_inverse(stiffness), normal_stiffness, preload)
        along = np.einsum("cax,cab,cbx->xc", axes, stiffness, axes)
        along = along[:1] if np.all(along == along[0]) else along
        inverse = np.divide(1.0, along, out=np.zeros_like(along), where=along > 0)
        return cls(friction, tuple(along), tuple(inverse), normal_stiffness, preload)

    start_states = staticmethod(cone_states)

    def disturbed(self, state: State, h: Scalar, ends: Sequence[tuple[Motion, Plane]]) -> "ConeLaw":
        # Where a contact opens or has just closed, any step is long at one end, and follows that well.
        return replace(self, step=jnp.where(jnp.minimum(*self.decays(state, h, ends)) > FOLLOWED, h, 0.0))

    def decays(self, state: State, h: Scalar, ends: Sequence[tuple[Motion, Plane]]) -> list[Scalar]:
        rates = [self._turning_rate(motion, slip_direction(self, motion, w, True)) for motion, w in ends]
        return [jnp.where(state == SLIP, h * rate, 0.0) for rate in rates]

    def _turning_rate(self, motion: Motion, e: Plane) -> Scalar:
        """At which a disturbed direction of slip e is led back to that of u'."""
        across = (-e[-1], e[0])
        limit = self.friction * jnp.abs(normal_load(self, motion.v))
        stiffness = dot(across, product(self.stiffness, across)) if len(e) == 2 else jnp.zeros_like(limit)
        return jnp.abs(slip_speed(self, e, motion)) * stiffness / jnp.maximum(limit, 1e-150)

    @apart
    def reaction(self, state: State, motion: Motion, w: Plane) -> Reaction:
        # In contact n is not clipped at 0: the field stays smooth for the trial step that ends beyond a separation.
        n = normal_load(self, motion.v)
        slips = state == SLIP
        e = felt_direction(self, motion, w, slips)
        sliding = jnp.where(slips, self.friction * n, 0.0)
        elastic = product(self.stiffness, minus(motion.u, w))
        f = where(state == STICK, elastic, scaled(sliding, e))
        dw = scaled(jnp.where(slips, slip_speed(self, e, motion), 0.0), e)
        return Reaction(f, jnp.where(state == SEPARATION, 0.0, n), dw)

    @apart
    def margins(self, state: State, motion: Motion, w: Plane) -> tuple[Scalar, Scalar]:
        # Stick ends on the cone (3), slip where n or the slip speed falls through zero (12, 13), separation where n
        # rises through zero (14). A frictionless contact has no speed that ends its slip: it cannot stick. Stick is
        # never without a load either, which is known better than the cone where K_u is far above k_v.
        n = normal_load(self, motion.v)
        cone = self.friction * n - length(product(self.stiffness, minus(motion.u, w)))
        speed = slip_speed(self, felt_direction(self, motion, w, state == SLIP), motion)
        singular = n < SINGULAR * jnp.abs(self.normal_stiffness * motion.dv)
        # What has opened with a load next to nothing has not closed: the loop would find no step that ends before.
        opened = jnp.where((n > 0) & self._opens(n, motion), 0.0, -n)
        first = jnp.where(state == STICK, cone, jnp.where(state == SLIP, n, opened))
        second = jnp.where((state == SLIP) & (self.friction > 0) & ~singular, speed, 1.0)
        return first, jnp.where(state == STICK, n / self._load_scale(), second)

    def successor(self, state: State, motion: Motion) -> State:
        # By the rates (section 3). Where stick or slip ends with n next to zero and falling, cone and separation are
        # reached at once and separation wins.
        sticks = length(product(self.stiffness, motion.du)) < self.friction * (self.normal_stiffness * motion.dv)
        opens = self._opens(normal_load(self, motion.v), motion)
        leaving = jnp.where(opens, SEPARATION, jnp.where(state == STICK, SLIP, STICK))
        return jnp.where(state == SEPARATION, jnp.where(sticks, STICK, SLIP), leaving)

    def _opens(self, n: Scalar, motion: Motion) -> Bool[Array, " contact"]:
        """Whether a normal load is next to nothing and falls, or the bodies are apart already."""
        dn = self.normal_stiffness * motion.dv
        load, force = self._load_scale(), self._load_scale() + self._friction_scale()
        falls = (dn < 0) & (n <= jnp.clip(-SOON * dn, TOGETHER * load, NO_LOAD * force))
        return falls | (n < -VIOLATED * load)

    def slip_at_transition(self, before: State, after: State, motion: Motion, w: Plane) -> Plane:
        # On the cone during and after slip, w = u during and after separation.
        w = self._slip(before, w, motion, slip_direction(self, motion, w, before == SLIP))
        return where(after == SEPARATION, motion.u, w)

    def placed(self, state: np.ndarray, motion: Motion, w: Plane) -> tuple[np.ndarray, tuple[np.ndarray, ...]] | None:
        # A contact that sticks slips where its force would lie outside the cone, one that slips sticks where the cone
        # runs ahead of the force.
        n, dn = normal_load(self, motion.v), self.normal_stiffness * motion.dv
        if not np.array_equal(contact_state(n, self.friction, state), state):
            return None
        u, du, before = (np.stack(part) for part in (motion.u, motion.du, w))
        K, C = (np.stack([part[i % len(part)] for i in range(len(w))]) for part in (self.stiffness, self.compliance))
        force = K * (u - before)
        size, limit = np.linalg.norm(force, axis=0), self.friction * n
        follows = slip_follows_motion(state, self.friction)
        on = force * (limit / np.where(size > 0, size, 1.0))
        runs_ahead = (on * (K * du)).sum(axis=0) < limit * self.friction * dn
        rubs = ((state == SLIP) & ~follows & (size > 0)) | ((state == STICK) & (size > limit))
        after = np.where(follows, u, np.where(rubs, u - C * on, before))
        return np.where(follows, state, np.where(rubs & ~runs_ahead, SLIP, STICK)), tuple(after)

    def inner(self, state: State, motion: Motion, w: Plane) -> Scalar:
        # All nodes of a step hang on it: after one iteration more than the first some directions are off by 0.1 rad.
        return slip_angle.angle_of(slip_direction(self, motion, w, state == SLIP, iterations=7))

    def collocated(self, state: State, w: Plane, motion: Motion, inner: Scalar, h: Scalar, rule: Rule) -> Within:
        n, du, dn = normal_load(self, motion.v), motion.du, self.normal_stiffness * motion.dv
        if len(w) == 2:
            slips = (state == SLIP) & (self.friction > 0)
            turning = slip_angle.Turning(self.friction, self.stiffness, n, dn, du)
            inner = slip_angle.newton_step(turning, slips, inner, h, rule)
        e = slip_angle.direction_of(inner[1:], len(w))
        slip = self._slip(state, w, motion, e)
        elastic = product(self.stiffness, minus(motion.u, slip))
        f = where(state == SLIP, scaled(self.friction * n, e), where(state == STICK, elastic, scaled(0.0 * n, e)))
        return Within(inner, f, jnp.where(state == SEPARATION, 0.0, n), slip)

    def slip_inside(self, state: State, w: Plane, motion: Motion, inner: Scalar) -> Plane:
        return self._slip(state, w, motion, slip_angle.direction_of(inner, len(w)))

    def _slip(self, state: State, w: Plane, motion: Motion, e: Plane) -> Plane:
        """w of contacts that slip along e: on the cone."""
        on_cone = minus(motion.u, product(self.compliance, scaled(self.friction * normal_load(self, motion.v), e)))
        return where(state == SLIP, on_cone, where(state == SEPARATION, motion.u, w))

    def scale(self, state: State) -> Scalar:
        # However stiff a contact is along its plane, its normal load is as exact.
        return self._load_scale() + jnp.where(state == STICK, self._friction_scale(), 0.0)

    def _load_scale(self) -> Scalar:
        return self.normal_stiffness + jnp.abs(self.preload)

    def _friction_scale(self) -> Scalar:
        return sum((jnp.abs(k) for k in self.stiffness), start=jnp.zeros(()))

    @staticmethod
    def stored_energy(
        contact: Contact, motion: np.ndarray, slip: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        # The normal spring is one-sided: its energy is (n^2 - max(n0, 0)^2) / (2 k_v) - max(n0, 0) v. Under a preload
        # it is k_v v^2 / 2 while n > 0; a difference of squares would leave nothing of a motion far below n0 / k_v.
        parts = []
        if contact.friction > 0:
            stretch = np.where(state[:, None] == SEPARATION, 0.0, motion[:, :2] - slip)
            parts.append(0.5 * np.einsum("ni,ij,nj->n", stretch, contact.tangential_stiffness, stretch))
        if contact.normal_stiffness > 0:
            k, v = contact.normal_stiffness, motion[:, 2]
            n = contact.preload + k * v
            preloaded = k * v**2 / 2 - np.minimum(n, 0.0) ** 2 / (2 * k)
            parts.append(preloaded if contact.preload > 0 else np.maximum(n, 0.0) ** 2 / (2 * k))
        return tuple(parts)


def matrix_and_inverse(stiffness: np.ndarray) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """K_u and its inverse as `ConeLaw` has them, along any axes, from matrices of shape (C, 2, 2).

    The inverse of a matrix that is zero is zero.
    """
    inverse, elastic = np.zeros_like(stiffness), stiffness.any(axis=(1, 2))
    inverse[elastic] = np.linalg.inv(stiffness[elastic])
    (k11, k12, k22), parts = ((m[:, 0, 0], m[:, 0, 1], m[:, 1, 1]) for m in (stiffness, inverse))
    return ((k11,), parts[:1]) if np.all(k12 == 0) and np.all(k11 == k22) else ((k11, k12, k22), parts)


def normal_load(law: ConeLaw, v: Scalar) -> Scalar:
    """n0 + k_v v, negative where the bodies are apart (2)."""
    return law.preload + law.normal_stiffness * v


def slip_speed(law: ConeLaw, e: Plane, motion: Motion) -> Scalar:
    """s = |w'| while slipping along e (9); it falls through zero where the contact sticks (12)."""
    cone_rate = law.friction * law.normal_stiffness * motion.dv
    if len(law.stiffness) == 1:
        return dot(e, motion.du) - cone_rate * law.compliance[0]
    ke = product(law.stiffness, e)
    return (dot(ke, motion.du) - cone_rate) / jnp.maximum(dot(e, ke), 1e-150)


def slip_direction(
    law: ConeLaw, motion: Motion, w: Plane, slips: Bool[Array, "*#contact"] | bool, iterations: int = 1
) -> Plane:
    """Unit vector e along which a contact slips, any vector of the others; ``iterations`` of `incipient_direction`."""
    trial, n = product(law.stiffness, minus(motion.u, w)), normal_load(law, motion.v)
    size = length(trial)
    off_cone = jnp.abs(size - law.friction * jnp.abs(n))
    directed = size > UNDIRECTED * off_cone + FORCE_FLOOR
    # Normalised after the choice: without a length the derivative would not be finite, whether it matters or not.
    chosen = where(directed, scaled(jnp.where(n < 0, -1.0, 1.0), trial), motion.du)
    along = scaled(1 / length(chosen), chosen)
    if len(law.stiffness) == 1:
        return along  # the incipient direction is that of u'

    def with_incipient() -> Plane:
        return where(directed, along, incipient_direction(law, motion, iterations))

    # Few steps see a contact so near to n = 0; of trajectories side by side both are computed.
    return jax.lax.cond((slips & ~directed).any(), with_incipient, lambda: along)


def felt_direction(law: ConeLaw, motion: Motion, w: Plane, slips: Bool[Array, "*#contact"]) -> Plane:
    """`slip_direction`, in the derivative of a step with as much of a disturbance as the step can follow.

    A disturbed direction is led back to that of u' at the rate ``s K_u / (mu n)``, which an explicit step does not
    resolve where a stiff contact carries little load, as before it opens: each would multiply the disturbance. Of that
    rate only what the step follows is taken, and as little of the disturbance is in the force, so that the impulse
    until it has died out stays the same. The rest of the direction is that of u'.
    """
    e = slip_direction(law, motion, w, slips)
    if law.step is None or len(e) == 1:
        return e
    along, motion_there = jax.lax.stop_gradient((e, motion))
    across, rate = (-along[1], along[0]), law._turning_rate(motion_there, along)
    follows = FOLLOWED / jnp.maximum(law.step * rate, FOLLOWED)
    speed = jnp.maximum(jnp.abs(slip_speed(law, along, motion_there)), 1e-150)
    led = dot(across, minus(motion.du, motion_there.du)) / speed
    change = (1 - follows) * (led - dot(across, e))
    return tuple(x + change * y for x, y in zip(e, across, strict=True))


def incipient_direction(law: ConeLaw, motion: Motion, iterations: int = 7) -> Plane:
    """Direction of slip where n = 0: the e that solves (mu n' I + s K_u) e = K_u u', |e| = 1.

    Isotropic K_u: along u' (18). Otherwise |e| falls monotonically in s; Newton's method on 1 / |e| starts where one
    component alone has length 1, which lies left of the root, and converges from there without overshooting.
    """
    if len(law.stiffness) == 1:
        return scaled(1 / length(motion.du), motion.du)
    if len(law.stiffness) == 2:
        return _along_principal_axes(law, law.stiffness, motion.du, motion.dv, iterations)
    (k11, k12, k22), (x, y) = law.stiffness, motion.du
    angle = 0.5 * jnp.arctan2(2 * k12, k11 - k22)  # of the first principal axis of K_u
    c, s = jnp.cos(angle), jnp.sin(angle)
    stiff = (k11 * c * c + 2 * k12 * c * s + k22 * s * s, k11 * s * s - 2 * k12 * c * s + k22 * c * c)
    e = _along_principal_axes(law, stiff, (c * x + s * y, c * y - s * x), motion.dv, iterations)
    return (c * e[0] - s * e[1], s * e[0] + c * e[1])


def _along_principal_axes(law: ConeLaw, stiff: tuple[Scalar, ...], du: Plane, dv: Scalar, iterations: int) -> Plane:
    """`incipient_direction` where K_u is diagonal."""
    # That of a stop without stiffness means nothing. One next to zero would do for it, but its inverse overflows in the
    # derivative where the point is about to turn back.
    stiff = tuple(jnp.where(k > 0, k, 1.0) for k in stiff)
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
