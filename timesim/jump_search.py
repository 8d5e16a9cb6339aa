"""Jumps along a sweep: where the motion leaves the branch that it was on, and at what frequency exactly.

Over one step of the sweep the amplitude changes by far more than over those beside it. A bisection that carries the
motion of the old branch over ever smaller steps of frequency tells a jump from a steep slope, and gives its frequency.
"""

import timesim.jax_setup  # noqa: F401  isort: skip

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from timesim.crew import halted
from timesim.model import Model
from timesim.solver import Solver
from timesim.steady import Chain, Criterion, Orbit, steady_states

STANDS_OUT = 4.0  # a jump changes the amplitude by so many times what the steps beside it do,
AT_LEAST = 0.03  # and by this share of the largest amplitude
STAYS = 0.5  # of the change remains, however small the step, if it is a jump
HALVINGS = 6  # after which a slope would have told itself apart


class Jump(NamedTuple):
    """Frequencies [Hz] between which the motion jumps, ascending."""

    low: float
    high: float


def jumps_of(
    model: Model,
    frequencies: Sequence[float],
    orbits: Sequence[Orbit],
    solver: Solver,
    criterion: Criterion,
    refine: float | None,
) -> Iterator[Jump]:
    """The jumps between consecutive points of a chain.

    Args:
        model: the scene.
        frequencies: in the order of the sweep [Hz].
        orbits: at them.
        solver, criterion: as those of the sweep.
        refine: width [Hz] to which each is bisected; None leaves it at the step of the sweep.
    """
    stands_out = STANDS_OUT if refine is None else 1.0  # a bisection tells a slope apart
    for k in suspects(np.array([orbit.amplitude.ravel() for orbit in orbits]), stands_out):
        if refine is None:
            yield Jump(*sorted((frequencies[k], frequencies[k + 1])))
            continue
        ends = (frequencies[k], frequencies[k + 1])
        found = bisect(model, ends, (orbits[k], orbits[k + 1]), solver, criterion, refine)
        if found is not None:
            yield Jump(*sorted(found[:2]))


def suspects(amplitude: np.ndarray, stands_out: float = STANDS_OUT) -> np.ndarray:
    """Steps of a sweep over which the amplitude changes by far more than over those beside them.

    Args:
        amplitude: of all points along all axes, shape (F, X).
        stands_out: how many times as much.

    Returns:
        Positions of the points before the steps.
    """
    if len(amplitude) < 3:
        return np.zeros(0, dtype=int)
    largest = np.nanmax(np.abs(amplitude), initial=1e-300)
    change = np.max(np.abs(np.diff(amplitude, axis=0)), axis=1, initial=0.0) / largest
    around = np.concatenate([[np.nan], change, [np.nan]])
    beside = np.fmax(around[:-2], around[2:])
    with np.errstate(invalid="ignore"):
        return np.flatnonzero((change > AT_LEAST) & (change >= stands_out * beside))


def bisect(
    model: Model,
    ends: tuple[float, float],
    orbits: tuple[Orbit, Orbit],
    solver: Solver,
    criterion: Criterion,
    width: float,
) -> tuple[float, float, Orbit, Orbit] | None:
    """Narrow the step at which the motion leaves its branch.

    Args:
        model: the scene.
        ends: frequency of the last point on the branch, and of the first one beyond it [Hz].
        orbits: the motions there.
        solver, criterion: as those of the sweep.
        width: wanted distance of the ends [Hz].

    Returns:
        The narrowed ends and the motions there; None if the change shrinks with the step: it is a slope, no jump.
    """
    (near, far), (on, beyond) = ends, orbits
    first = _distance(on, beyond)
    halvings = 0
    while abs(far - near) > width:
        middle = 0.5 * (near + far)
        if middle in (near, far):
            break
        started = replace(model, start=on.end)
        (orbit,) = steady_states([Chain(started, (middle,))], solver, criterion, halted=halted)[0]
        if orbit.reason is not None:
            return None
        if _distance(on, orbit) < _distance(beyond, orbit):
            near, on = middle, orbit
        else:
            far, beyond = middle, orbit
        halvings += 1
        if halvings >= HALVINGS and _distance(on, beyond) < STAYS * first:
            return None
    return near, far, on, beyond


def _distance(one: Orbit, other: Orbit) -> float:
    return float(np.max(np.abs(one.amplitude - other.amplitude), initial=0.0))
