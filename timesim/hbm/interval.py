"""The contact law over one interval between two samples, from the elastic displacement at its start.

The law is that of `engine.law.cone`, the motion (u, v) the cubic through its values and rates at both samples. With the
elastic displacement ``d = u - w``, the friction force ``f = K_u d``, the force ``F`` of a contact that kept its slip,
and primes for rates along the interval,

    stick       f = F, up to where |F| - mu n rises through zero
    slip        f = mu n e,   e' = (1 - e e^T) z / (mu n),   z = (u' - mu n' C e) / (e_t . C e_t),   C = K_u^-1,
                up to where its speed, linear between those at its start and at the end of the interval, is zero
    separation  f = 0; slip that starts with contact does so along the incipient direction

where ``e_t`` is normal to ``e``. The contact may close or open, begin to slip and stop within the interval, in this
order. For an isotropic K_u the direction of slip follows in closed form: ``z = K_u u'``, and over an interval ``e``
turns towards it without further error, however small n is. For others the part of C that is not isotropic is evaluated
midway, of the whole and of its halves, which leaves an error of the fourth power of its length.

Sums over samples miss what happens between them: a curve of solutions would be a staircase of the width of the samples.
Where the first two rates of a force change by J1 and J2, at the share s of an interval (its width the unit of time),
the trapezoidal rule errs by ``J1 B2(s) / 2 - J2 B3(s) / 6`` and in its first moment about that place by
``-J1 B3(s) / 3``, with Bernoulli's polynomials B2 and B3 (Euler and Maclaurin; F. W. J. Olver, Asymptotics and Special
Functions (Academic Press 1974), chapter 8). Both are put on the two samples beside it. The error is of third order.
Over the slip with which a contact opens a rate goes evenly from one to the other.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Iterator
from functools import reduce
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient

from timesim.engine.barrier import apart
from timesim.engine.law.cone import ConeLaw, incipient_direction, slip_speed
from timesim.engine.law.contact_law import Motion, Plane, Scalar, dot, length, minus, product, scaled, where
from timesim.hbm.path import Cubic, Flag, Path, Window, cubic_through, direction_of, quotient, summit, turned, window_of

# Excess of |F| over mu n, relative to it, up to which a contact at rest on its cone does not slip: rounding.
GRAZING = 1e-11
# Relative shortfall of |f| below mu n up to which a contact is on its cone.
ON_CONE = 1e-9


class Interval(NamedTuple):
    """Motion from one sample to the next, time in units of the interval.

    Attributes:
        change: of u.
        du0, du1: rate of u at both ends.
        v0, v1: v at both ends.
        dv0, dv1: its rate there.
    """

    change: Plane
    du0: Plane
    du1: Plane
    v0: Scalar
    v1: Scalar
    dv0: Scalar
    dv1: Scalar


Force = tuple[Scalar, Scalar, Scalar]
"""f1, f2, n."""


class IntervalEnd(NamedTuple):
    """What the law gives over an interval.

    Attributes:
        d: elastic displacement at its end.
        slip, separation: the shares of it spent so.
        before, after: forces to be added to the samples at its start and its end.
    """

    d: Plane
    slip: Scalar
    separation: Scalar
    before: Force
    after: Force


class _Slip(eqx.Module):
    """Slip within an interval, from `start` to `end`, if it `slides` at all.

    Attributes:
        fresh: it begins with contact.
        follows: it goes on from the interval before.
        first, last: its directions at both ends.
        speed, growth: its speed at the start and the rate of it.
        d: elastic displacement at the end of the interval.
    """

    slides: Flag
    fresh: Flag
    follows: Flag
    start: Scalar
    end: Scalar
    first: Plane
    last: Plane
    speed: Scalar
    growth: Scalar
    d: Plane


def _path(law: ConeLaw, interval: Interval) -> tuple[Path, Cubic]:
    """The path over an interval, and the normal load along it where it is positive."""
    ends = zip(interval.change, interval.du0, interval.du1, strict=True)
    u = tuple(cubic_through(jnp.zeros_like(change), change, *rates) for change, *rates in ends)
    v = cubic_through(interval.v0, interval.v1 - interval.v0, interval.dv0, interval.dv1)
    load = v.scaled(law.normal_stiffness)
    load = Cubic(load.c0 + law.preload, load.c1, load.c2, load.c3)
    return Path(u, load.scaled(law.friction), v, minus(interval.du1, interval.du0)), load


def sliding(law: ConeLaw, d: Plane, interval: Interval) -> tuple[Flag, IntervalEnd]:
    """Whether a contact plainly slips all along, as before, and its end if so: a quarter of the work of `advance`.

    It is closed all along, leaves the cone at once, and has not come to rest at the end.
    """
    path, _ = _path(law, interval)
    none, one = jnp.zeros_like(d[0]), jnp.ones_like(d[0])
    force, rates = product(law.stiffness, d), product(law.stiffness, interval.du0)
    first = direction_of(force, rates)
    last = turned(law, path, first, none, one)
    leaves = (length(force) > (1 - ON_CONE) * path.limit.value(none)) & (dot(first, rates) > path.limit.rate(none))
    slips = leaves & (bounds_of_load(law, interval)[0] > 0) & (law.friction > 0)
    slips &= slip_speed(law, last, path.rates(one)) >= 0
    end = product(law.compliance, scaled(path.limit.value(one), last))
    return slips, IntervalEnd(end, one, none, (none,) * 3, (none,) * 3)


def bounds_of_load(law: ConeLaw, interval: Interval) -> tuple[Scalar, Scalar]:
    """Bounds of the normal load, where it is positive, over an interval: of its control points (S. Bernstein)."""
    v = (interval.v0, interval.v0 + interval.dv0 / 3, interval.v1 - interval.dv1 / 3, interval.v1)
    return tuple(law.preload + law.normal_stiffness * reduce(pick, v) for pick in (jnp.minimum, jnp.maximum))


def advance(law: ConeLaw, d: Plane, interval: Interval) -> IntervalEnd:
    """The law over one interval, from the elastic displacement at its start."""
    path, load = _path(law, interval)
    window = window_of(load)
    slip = _slip(law, d, path, window)
    before, after = _added(_kinks(law, d, path, load, window, slip))
    slides = jnp.where(law.friction > 0, slip.end - slip.start, window.end - window.start)
    share = jnp.where(slip.slides | (law.friction == 0), slides, 0.0)
    return IntervalEnd(slip.d, share, window.separation, before, after)


def unchanging(law: ConeLaw, d: Plane, interval: Interval) -> tuple[Flag, IntervalEnd]:
    """Whether a contact plainly sticks, is apart, or is closed without friction all along, and its end if so.

    A cubic lies within the hull of its four control points (S. Bernstein). Where they do not tell, `advance` does.
    """
    ends = zip(d, interval.change, interval.du0, interval.du1, strict=True)
    path = [(x, x + rate0 / 3, x + change - rate1 / 3, x + change) for x, change, rate0, rate1 in ends]
    pull = [length(product(law.stiffness, place)) for place in zip(*path, strict=True)]
    least, most = bounds_of_load(law, interval)
    sticks = reduce(jnp.maximum, pull) < (1 - ON_CONE) * law.friction * least
    apart, free = most < 0, (law.friction == 0) & (least > 0)
    none = jnp.zeros_like(least)
    held = where(sticks, tuple(x[-1] for x in path), (none, none))
    end = IntervalEnd(held, jnp.where(free, 1.0, none), jnp.where(apart, 1.0, none), (none,) * 3, (none,) * 3)
    return sticks | apart | free, end


class _Trial(eqx.Module):
    """F, the force of a contact that keeps its slip since it closed or since the start of the interval."""

    law: ConeLaw
    path: Path
    base: Plane


@apart
def _excess(trial: _Trial, t: Scalar) -> tuple[Scalar, Scalar, Plane]:
    """|F| - mu n, its rate, and the direction of F."""
    elastic, rates = (product(trial.law.stiffness, x) for x in (trial.path.at(t), trial.path.rates(t).du))
    force = tuple(b + f for b, f in zip(trial.base, elastic, strict=True))
    e, limit = direction_of(force, rates), trial.path.limit
    return length(force) - limit.value(t), dot(e, rates) - limit.rate(t), e


def _slip(law: ConeLaw, d: Plane, path: Path, window: Window) -> _Slip:
    """Where in an interval a contact slips, and the elastic displacement at its end."""
    a, b, rubs = window.start, window.end, (law.friction > 0) & (window.end > window.start)
    at_start, rates = path.at(a), path.rates(a)
    force = where(window.closes, scaled(jnp.zeros_like(a), d), product(law.stiffness, d))
    trial = _Trial(law, path, minus(force, product(law.stiffness, at_start)))
    excess, growth, _ = _excess(trial, a)
    # Where contact begins F is rounding, without a direction.
    taking_up = length(product(law.stiffness, rates.du)) - path.limit.rate(a)
    excess = jnp.where(window.closes, 0.0, jnp.minimum(excess, 0.0))
    growth = jnp.where(window.closes, taking_up, growth)
    on_cone = window.closes | (excess > -ON_CONE * path.limit.value(a))
    at_once = rubs & on_cone & (growth > 0)
    slides, start = _onset(trial, path, window, excess, growth, at_once)
    slides, fresh = rubs & (slides | at_once), at_once & window.closes
    # A motion that vanishes has no direction, and no derivative of one.
    moving = where(dot(rates.du, rates.du) > 1e-280, rates.du, (jnp.ones_like(a),) * 2)
    incipient = incipient_direction(law, Motion(moving, rates.v, moving, rates.dv))
    first = where(fresh, incipient, _excess(trial, start)[2])

    def direction(t: Scalar) -> Plane:
        return turned(law, path, first, start, jnp.where(slides, t, start))

    speed = slip_speed(law, first, path.rates(start))
    final = slip_speed(law, direction(b), path.rates(b))
    span = jnp.where(slides & (b > start), b - start, 1.0)
    loss = jnp.where(slides & (speed > 0) & (final < 0) & (b == 1), (speed - final) / span, 0.0)
    end = jnp.where(loss > 0, start + quotient(speed, loss), b)
    last = direction(end)
    stuck = where(window.closes, scaled(jnp.zeros_like(a), d), d)
    slid = product(law.compliance, scaled(path.limit.value(end), last))
    until_end = minus(path.at(b), path.at(jnp.where(slides, end, a)))
    finish = tuple(x + y for x, y in zip(where(slides, slid, stuck), until_end, strict=True))
    finish = where((b == 1) & rubs, finish, scaled(jnp.zeros_like(a), d))
    return _Slip(slides, fresh, at_once & ~fresh, start, end, first, last, speed, (final - speed) / span, finish)


@apart
def _onset(
    trial: _Trial, path: Path, window: Window, excess: Scalar, growth: Scalar, at_once: Flag
) -> tuple[Flag, Scalar]:
    """Whether the trial force leaves the cone in a window, and where it does first.

    It does so before the maximum of its excess, or before the end of the window if the excess still grows there; in
    between lies the root of a parabola, which Newton's method improves.
    """
    a, b = window.start, window.end
    _, _, e = _excess(trial, (a + b) / 2)
    along = path.limit.scaled(jnp.asarray(-1.0))
    for x, u in zip(product(trial.law.stiffness, e), path.u, strict=True):
        along = along.plus(u.scaled(x))
    top, inside = summit(along)
    top, curvature = _highest(trial, path, top)
    latest, rising, _ = _excess(trial, b)
    falls = inside & (top > a) & (top < b) & (rising < 0) & (b == 1)
    high = jnp.where(falls, top, b)
    highest = jnp.where(falls, _excess(trial, high)[0], latest)
    slides = highest > GRAZING * path.limit.value(high)
    width = high - a
    place = a + width * _rising_root(highest - excess - growth * width, growth * width / 2, excess)
    # Close to a touch of the cone the parabola at the summit tells, where Newton's method would halve the way only.
    touches = falls & (highest > 0) & (highest < -excess) & (curvature < 0)
    half = jnp.sqrt(jnp.where(touches, 2 * highest, 1.0) / jnp.where(touches, -curvature, 1.0))
    place = jnp.where(touches, jnp.clip(top - half, a, high), place)
    for _ in range(2):
        place = stop_gradient(place)
        value, rate, _ = _excess(trial, place)
        sought = slides & ~at_once & (rate > 0)
        place = jnp.clip(place - jnp.where(sought, quotient(value, rate), 0.0), stop_gradient(a), stop_gradient(high))
    return slides, jnp.where(at_once | ~slides, a, place)


def _highest(trial: _Trial, path: Path, place: Scalar) -> tuple[Scalar, Scalar]:
    """Where the excess has its maximum near a place, by Newton's method, and its curvature there.

    It must be met: slip that begins beside it does so with a length of its own, at which the forces would jump.
    """
    place, curvature = stop_gradient(place), jnp.zeros_like(place)
    for _ in range(3):
        _, rate, e = _excess(trial, place)
        stiffness = trial.law.stiffness
        pull, elastic = product(stiffness, path.rates(place).du), product(stiffness, path.at(place))
        force = length(tuple(b + f for b, f in zip(trial.base, elastic, strict=True)))
        bend = dot(e, product(stiffness, path.curvature(place)))
        turning = quotient(dot(pull, pull) - dot(e, pull) ** 2, force)
        curvature = bend + turning - path.limit.curvature(place)
        step = jnp.where(curvature < 0, quotient(rate, curvature), 0.0)
        place = stop_gradient(jnp.clip(place - step, 0.0, 1.0))
    return place, stop_gradient(curvature)


def _rising_root(rise: Scalar, half_slope: Scalar, start: Scalar) -> Scalar:
    """Root of ``rise t^2 + 2 half_slope t + start`` through which it rises, given start <= 0 and a positive end."""
    root = jnp.sqrt(jnp.maximum(half_slope**2 - rise * start, 1e-300))
    ahead = half_slope > 0
    late = quotient(root - half_slope, jnp.where(ahead, 1.0, rise))
    early = -start / jnp.where(ahead, half_slope + root, 1.0)
    return jnp.clip(jnp.where(ahead, early, late), 0.0, 1.0)


Kink = tuple[Scalar, Flag, Force, Force]
"""Where in the interval, whether at all, and the changes J1 and J2 of the first two rates of (f1, f2, n)."""


@apart
def _kinks(law: ConeLaw, d: Plane, path: Path, load: Cubic, window: Window, slip: _Slip) -> list[Kink]:
    """What the rates of the forces do where the contact closes, begins to slip, ceases to, and opens."""
    rubs, none = law.friction > 0, jnp.zeros_like(window.start)
    place, gap = window.start, window.gap
    pull = product(law.stiffness, path.rates(place).du)
    bend = product(law.stiffness, path.curvature(place))
    on_cone = (scaled(f, slip.first) for f in (path.limit.rate(place), path.limit.curvature(place)))
    grips = ~slip.fresh
    acts = jnp.where(rubs, 1.0, 0.0)
    first, second = (scaled(acts, where(grips, s, c)) for s, c in zip((pull, bend), on_cone, strict=True))
    closing = ((*first, load.rate(place)), (*second, load.curvature(place)))
    gone = where(gap < place, direction_of(d, slip.first), slip.last)
    against = jnp.where(rubs, -law.friction, 0.0)
    leaving, bent = (scaled(against * x, gone) for x in (load.rate(gap), load.curvature(gap)))
    begins = slip.slides & ~slip.fresh & ~slip.follows
    ends = slip.slides & (slip.end < window.end)
    last = begins & window.opens & (gap >= place)
    lost, back = (product(law.stiffness, e) for e in (slip.first, slip.last))
    held, bent_held = (product(law.stiffness, x) for x in (path.rates(slip.start).du, path.curvature(slip.start)))
    slows = scaled(-slip.speed, lost)
    turn = tuple(-x - y - z for x, y, z in zip(leaving, held, slows, strict=True))
    onset = minus(scaled(jnp.where(last, 0.0, -slip.growth), lost), scaled(jnp.where(last, 1.0, 0.0), bent_held))
    bent = scaled(jnp.where(last, 0.0, 1.0), bent)
    return [
        (place, window.closes, *closing),
        (slip.start, begins, (*slows, none), (*onset, none)),
        (slip.end, ends, (none,) * 3, (*scaled(slip.growth, back), none)),
        (gap, window.opens, (*leaving, -load.rate(gap)), (*bent, -load.curvature(gap))),
        *_spread(slip.start, gap, last, turn),
    ]


def _spread(start: Scalar, end: Scalar, happens: Flag, change: Plane) -> Iterator[Kink]:
    """A change of the first rate that is spread evenly over a part of the interval: Simpson's rule, exact here.

    The last slip before a contact opens may be as short as it likes, and its force turns from that in stick to that at
    the opening: as two changes of the second rate, each as large as the slip is short, both would be rounding.
    """
    none = jnp.zeros_like(start)
    for place, weight in ((start, 1 / 6), ((start + end) / 2, 4 / 6), (end, 1 / 6)):
        yield place, happens, (*scaled(weight * jnp.ones_like(start), change), none), (none,) * 3


def _added(kinks: list[Kink]) -> tuple[Force, Force]:
    """What kinks inside an interval add to the samples before and after it."""
    before = after = (jnp.zeros_like(kinks[0][0]),) * 3
    for s, happens, first, second in kinks:
        b2, b3 = jnp.where(happens, s * (s - 1) + 1 / 6, 0.0), jnp.where(happens, s * (s - 0.5) * (s - 1), 0.0)
        total = tuple(x * b2 / 2 - y * b3 / 6 for x, y in zip(first, second, strict=True))
        moment = scaled(b3 / 3, first)
        before = tuple(x + (1 - s) * y + z for x, y, z in zip(before, total, moment, strict=True))
        after = tuple(x + s * y - z for x, y, z in zip(after, total, moment, strict=True))
    return before, after
