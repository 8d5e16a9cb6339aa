"""Basins of attraction where a response has two motions, sampled by an ensemble of starts; ranges of stuck offsets.

A start is a times the smaller motion plus b times the larger one: (0, 0) is rest, (1, 0) and (0, 1) are the motions. A
slip that a contact cannot have is set back onto its friction cone. A contact that sticks throughout keeps the offset
with which it began, so offsets are not unique: such contacts start with different ones, which shows their range.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from timesim.engine.law.table import law_class
from timesim.model.contact_state import contact_loads, obeys_cone, slip_follows_motion
from timesim.model.model import Model, Start
from timesim.orbit.settling import Chain, SteadyStates
from timesim.orbit.steady_state import SAME, Columns, Orbit, differ, orbit_of

SIDE = (-0.5, 1.5)  # shares of a motion at the ends of a side of the ensemble
PULL = 1 / (SIDE[1] * (SIDE[1] - 1))  # the farthest starts pull a contact to the edge of its cone
INSIDE = 1 - 1e-12  # share of the limit on which a force outside its cone is put: within rounding it would be outside
LOWER, UPPER, ANOTHER, IRREGULAR, NONE = 0, 1, 2, 3, -1


def shares(num: int) -> np.ndarray:
    """Shares of a motion in the starts along one side, shape (num,); 1 + 4 k of them hold 0 and 1."""
    return np.linspace(*SIDE, num)


def placed(
    model: Model, displacement: np.ndarray, velocity: np.ndarray, slip: np.ndarray, pull: np.ndarray | None = None
) -> Start:
    """A start whose friction forces lie inside their cones; the slip of a contact that is apart is its motion.

    ``pull``: force by which each contact of the cone is pulled aside, as a share of its friction limit, shape (C, 2).
    """
    loads = contact_loads(model, displacement, slip)
    if pull is not None:
        # The inverse of a stiffness that is 0, as that of a frictionless contact, counts as 0.
        most = np.where(obeys_cone(model), loads.limit, 0.0)[:, None]
        aside = np.linalg.pinv(model.tangential_stiffness) @ (pull * most)[:, :, None]
        loads = contact_loads(model, displacement, slip - aside[:, :, 0])
    state = law_class(model.contacts).start_states(model.contacts, loads.normal)
    follows = slip_follows_motion(state, model.friction)[:, None]
    kept = np.where(follows, loads.motion, loads.slip_in_cone(INSIDE))
    return Start(displacement, velocity, kept, state, model.start.phase)


def starts_between(model: Model, motions: Sequence[Orbit], num: int) -> list[Start]:
    """The whole ensemble; the share of the larger motion varies fastest."""
    ends = [orbit.end for orbit in motions]
    parts = [(end.displacement, end.velocity, end.slip) for end in ends]
    moves = sum(orbit.slip_share + orbit.separation_share for orbit in motions) > 0
    starts = []
    for a in shares(num):
        for b in shares(num):
            # At rest and at the motions themselves no contact is pulled.
            pull = np.where(moves[:, None], 0.0, PULL * np.array([a * (1 - a), b * (1 - b)]))
            displacement, velocity, slip = (a * x + b * y for x, y in zip(*parts, strict=True))
            starts.append(placed(model, displacement, velocity, slip, pull))
    return starts


def branch_of(orbit: Orbit, motions: Sequence[Orbit]) -> int:
    """Motion to which a start leads: `LOWER`, `UPPER`, `ANOTHER`, `IRREGULAR`; `NONE` if it failed or never settled."""
    if orbit.irregular:
        return IRREGULAR
    if orbit.reason is not None or not orbit.settled:
        return NONE
    return next((number for number, motion in enumerate(motions) if not differ(orbit, motion)), ANOTHER)


def explore(model: Model, steady: SteadyStates, ranges: Columns, num: int) -> dict[str, np.ndarray]:
    """Motions to which the ensemble of starts, ``num`` along each side, leads at the middle of each range, as arrays.

    The ranges are as `timesim.orbit.two_motions.ranges_of` gives them; ``steady`` is what computed their motions.
    """
    rows = []
    for place, (low, high) in enumerate(ranges["range"]):
        motions = [orbit_of(ranges, (place, side), model.start.phase) for side in (LOWER, UPPER)]
        starts = starts_between(model, motions, num)
        chains = [Chain(replace(model, start=start), (0.5 * (low + high),)) for start in starts]
        rows.append(_row([orbit for (orbit,) in steady(chains)], motions, (num, num)))
    return {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else ())}


def _row(orbits: Sequence[Orbit], motions: Sequence[Orbit], square: tuple[int, int]) -> dict[str, np.ndarray]:
    """The arrays of one range, the starts along the sides of a square."""
    branch = np.array([branch_of(orbit, motions) for orbit in orbits], dtype=np.int8)
    led = [[orbit for orbit, own in zip(orbits, branch, strict=True) if own == side] for side in (LOWER, UPPER)]
    low, high = np.stack([offsets([*own, motion]) for own, motion in zip(led, motions, strict=True)], axis=1)
    return {
        "start_branch": branch.reshape(square),
        "start_failure": np.array([orbit.reason or "" for orbit in orbits]).reshape(square),
        "start_cycles": np.array([orbit.cycles for orbit in orbits], dtype=np.int32).reshape(square),
        "start_amplitude": np.array([orbit.amplitude for orbit in orbits]).reshape(*square, -1, 3),
        "offset_low": low,
        "offset_high": high,
    }


def offsets(orbits: Sequence[Orbit]) -> np.ndarray:
    """Smallest and largest w of each contact over motions in which it sticks all the time, NaN without: (2, C, 2)."""
    slip = np.array([orbit.end.slip for orbit in orbits])
    sticks = np.array([orbit.slip_share + orbit.separation_share for orbit in orbits])[:, :, None] == 0
    ends = [np.min(slip, axis=0, initial=np.inf, where=sticks), np.max(slip, axis=0, initial=-np.inf, where=sticks)]
    return np.where(sticks.any(axis=0), ends, np.nan)


def unique(low: np.ndarray, high: np.ndarray, size: float) -> np.ndarray:
    """Whether an offset is the same over all starts, to a share of the size of the motion; True where it is NaN."""
    return ~(high - low > SAME * size)
