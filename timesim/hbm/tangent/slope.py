"""Derivatives of the law over each interval of a period.

The law over one interval, `timesim.hbm.interval`, has 12 arguments and 8 results a contact and is differentiated
forward; where a contact slips all along there are 2 results, and little of the law is needed.
"""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Motion, Scalar
from timesim.hbm.interval import Interval, advance, sliding
from timesim.hbm.period import WHOLE, ClosedPeriod, part_of, starts_of
from timesim.program import program

Array64 = NDArray[np.float64]
Lanes = tuple[Callable[[ConeLaw, Array64], Array], int]
# Intervals that are differentiated side by side: of those in which the state changes, and of those that slip.
LANES, SLIPPING = 32, 128


class Slope(NamedTuple):
    """Derivatives of what the law gives over each interval: d at its end, and the forces put on both samples, R = 8.

    Attributes:
        by: d at its start, the change of u and its rates at both ends, each by components, and v at both ends and its
            rates there, shape (N, C, R, 12).
        active, sticks: as `_kinds` gives them.
    """

    by: Array64
    active: NDArray[np.bool_]
    sticks: NDArray[np.bool_]

    def of(self, places: NDArray[np.int64], contact: int, results: slice) -> tuple[Array64, Array64, Array64]:
        """`by_parts` of some of the results over some intervals of a contact."""
        return by_parts(self.by[places, contact, results])


def by_parts(by: Array64) -> tuple[Array64, Array64, Array64]:
    """`Slope.by`, by d, by u1 and u2, namely both rates and the change, and by v; (..., 2), (..., 2, 3), (..., 4)."""
    return by[..., :2], by[..., (4, 6, 2, 5, 7, 3)].reshape(*by.shape[:-1], 2, 3), by[..., 8:]


def interval_slopes(law: ConeLaw, period: ClosedPeriod) -> Slope:
    """Derivatives of the law over the intervals of a closed period."""
    of, (active, sticks) = intervals_of(period.motion), _kinds(law, period)
    arguments = (*starts_of(period), *of.change, *of.du0, *of.du1, of.v0, of.v1, of.dv0, of.dv1)
    slope, slips = np.zeros((*active.shape, 8, 12)), active & _slips(period)
    _put_slopes(slope, law, arguments, active & ~slips, (_slopes, LANES))
    _put_slopes(slope[:, :, :2], law, arguments, slips, (_slip_slopes, SLIPPING))
    for i in range(2):
        slope[..., i, i] += sticks
        slope[..., i, 2 + i] += sticks
    return Slope(slope, active, sticks)


def intervals_of(motion: Motion) -> Interval:
    """The intervals that end at each sample of a periodic motion with its rates, shape (N, C)."""
    change, du0 = tuple(u - before(u) for u in motion.u), tuple(map(before, motion.du))
    return Interval(change, du0, motion.du, before(motion.v), motion.v, before(motion.dv), motion.dv)


def before(samples: Scalar) -> Scalar:
    """The sample before each one of a period, along the first axis."""
    return samples[np.arange(len(samples)) - 1]  # so arrays of numpy remain such


def _kinds(law: ConeLaw, period: ClosedPeriod) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which intervals slip or change their state, and which stick all along, shape (N, C); the others are apart."""
    slip, apart = np.asarray(period.ends.slip), np.asarray(period.ends.separation)
    rubs, changes = np.asarray(law.friction) > 0, (apart > 0) & (apart < 1)
    active = changes | (rubs & (slip > 0))
    sticks = rubs & ~active & (apart == 0)
    # A contact that closes or opens at a sample changes its state within no interval.
    rests = ~active & ~sticks
    active |= (sticks & before(rests)) | (rests & before(sticks))
    return active, sticks & ~active


def _slips(period: ClosedPeriod) -> NDArray[np.bool_]:
    """Which intervals slip all along, as before them: nothing is put on the samples beside them, shape (N, C)."""
    ends = period.ends
    put = np.any([np.asarray(part) != 0 for part in (*ends.before, *ends.after)], axis=0)
    return (np.asarray(ends.slip) > WHOLE) & ~put


def _put_slopes(
    slope: Array64, law: ConeLaw, motion: tuple[Array | Array64, ...], chosen: NDArray[np.bool_], by: Lanes
) -> None:
    """Put the derivatives of R results over chosen intervals, by d at the start and by the motion; (N, C, R, 12).

    They are gathered, so that one program serves any number of samples and contacts: `by` are this, and its lanes.
    """
    (program_of, width), place = by, np.nonzero(chosen)
    arguments, count = np.stack([np.asarray(x)[place] for x in motion]), place[0].size
    for first in range(0, count, width):
        # The last lanes are filled up with the last interval.
        lanes = np.minimum(np.arange(first, first + width), count - 1)
        own = part_of(law, place[1][lanes])
        slope[place[0][lanes], place[1][lanes]] = np.asarray(program_of(own, arguments[:, lanes]))


def _forward(results: Callable[[Array], Array], arguments: Float[Array, "12 lane"]) -> Float[Array, "lane result 12"]:
    """Derivatives of results of each lane by its arguments."""

    def along(seed: Float[Array, " 12"]) -> Float[Array, "result lane"]:
        return jax.jvp(results, (arguments,), (jnp.broadcast_to(seed[:, None], arguments.shape),))[1]

    return jax.vmap(along, out_axes=2)(jnp.eye(len(arguments))).swapaxes(0, 1)


def _interval(x: Float[Array, "12 lane"]) -> Interval:
    return Interval((x[2], x[3]), (x[4], x[5]), (x[6], x[7]), *x[8:])


@program
def _slopes(law: ConeLaw, arguments: Float[Array, "12 lane"]) -> Float[Array, "lane 8 12"]:
    def results(x: Float[Array, "12 lane"]) -> Float[Array, "8 lane"]:
        end = advance(law, (x[0], x[1]), _interval(x))
        return jnp.stack([*end.d, *end.before, *end.after])

    return _forward(results, arguments)


@program
def _slip_slopes(law: ConeLaw, arguments: Float[Array, "12 lane"]) -> Float[Array, "lane 2 12"]:
    return _forward(lambda x: jnp.stack(sliding(law, (x[0], x[1]), _interval(x))[1].d), arguments)


def compile_slopes(law: ConeLaw) -> None:
    """Compile both, side by side: they take longer than all else of a balance."""

    def compiled(by: Lanes) -> None:
        program_of, width = by
        program_of(part_of(law, np.zeros(width, dtype=int)), np.zeros((12, width)))

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(compiled, ((_slopes, LANES), (_slip_slopes, SLIPPING))))
