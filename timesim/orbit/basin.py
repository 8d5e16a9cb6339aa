"""An ensemble of starts where a response has two motions: which of them leads to which, and what stays free.

The starts are sums of the two motions with rest as origin: a times the smaller one plus b times the larger one, so
(0, 0) is rest, (1, 0) and (0, 1) are the motions themselves. A slip that a contact cannot have is set back onto its
friction cone. A contact that sticks all the time keeps the offset that it was left with: such offsets are not unique,
and what they range over is seen if the starts have different ones, so those of such contacts are given some.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from timesim.model.contact_state import slip_follows_motion, start_states
from timesim.model.model import Model, Start
from timesim.orbit.settling import Chain, SteadyStates
from timesim.orbit.steady_state import SAME, Columns, Orbit, differ, orbit_of

SIDE = (-0.5, 1.5)
PULL = 1 / (SIDE[1] * (SIDE[1] - 1))  # the farthest starts pull a contact to the edge of its cone
INSIDE = 1 - 1e-12
LOWER, UPPER, ANOTHER, NONE = 0, 1, 2, -1


def shares(num: int) -> np.ndarray:
    """Shares of a motion in the starts along one side, shape (num,); 1 + 4 k of them hold 0 and 1."""
    return np.linspace(*SIDE, num)


def placed(
    model: Model, displacement: np.ndarray, velocity: np.ndarray, slip: np.ndarray, pull: np.ndarray | None = None
) -> Start:
    """A start with the slip set back onto the friction cones; that of a separated contact is its motion.

    Args:
        model: the scene; displacement, velocity, slip: the state.
        pull: friction force by which each contact is pulled aside, over what it bears at most, shape (C, 2).
    """
    phase, states = model.start.phase, np.full(model.num_contacts, -1)
    start = Start(displacement, velocity, slip, states, phase)
    state, kept = start_states(replace(model, start=start)), slip.copy()
    for i, contact in enumerate(model.contacts):
        u1, u2, v = model.contact_shape[i] @ displacement
        u, limit = np.array([u1, u2]), contact.friction * max(contact.preload + contact.normal_stiffness * v, 0.0)
        if slip_follows_motion(state[i], contact.friction):
            kept[i] = u
            continue
        aside = np.zeros(2) if pull is None else pull[i] * limit
        force = contact.tangential_stiffness @ (u - slip[i]) + aside
        size = float(np.linalg.norm(force))
        # Within rounding of the cone a start would count as outside of it.
        share = min(1.0, INSIDE * limit / size) if size else 1.0
        if share < 1 or aside.any():
            kept[i] = u - np.linalg.solve(contact.tangential_stiffness, share * force)
    return Start(displacement, velocity, kept, state, phase)


def starts_between(model: Model, motions: Sequence[Orbit], num: int) -> list[Start]:
    """All starts, the share of the larger motion fastest."""
    ends = [orbit.end for orbit in motions]
    parts = [(end.displacement, end.velocity, end.slip) for end in ends]
    moves = sum(orbit.slip_share + orbit.separation_share for orbit in motions) > 0
    starts = []
    for a in shares(num):
        for b in shares(num):
            # None at rest and at the motions themselves.
            pull = np.where(moves[:, None], 0.0, PULL * np.array([a * (1 - a), b * (1 - b)]))
            displacement, velocity, slip = (a * x + b * y for x, y in zip(*parts, strict=True))
            starts.append(placed(model, displacement, velocity, slip, pull))
    return starts


def branch_of(orbit: Orbit, motions: Sequence[Orbit]) -> int:
    """Which of the two motions a start has led to."""
    if orbit.reason is not None or not orbit.settled:
        return NONE
    return next((number for number, motion in enumerate(motions) if not differ(orbit, motion)), ANOTHER)


def explore(model: Model, steady: SteadyStates, ranges: Columns, num: int) -> dict[str, np.ndarray]:
    """What has become of the starts at the middle of each range, as arrays.

    Args:
        model: the scene.
        steady: gives steady states as those of the ranges.
        ranges: the ranges and their motions, as `timesim.orbit.two_motions.ranges_of` gives them.
        num: starts along each side.
    """
    rows = []
    for place, (low, high) in enumerate(ranges["range"]):
        motions = [orbit_of(ranges, (place, side), model.start.phase) for side in (LOWER, UPPER)]
        starts = starts_between(model, motions, num)
        chains = [Chain(replace(model, start=start), (0.5 * (low + high),)) for start in starts]
        rows.append(_row([orbit for (orbit,) in steady(chains)], motions, num))
    points, contacts = len(model.structure.points), model.num_contacts
    shapes = {
        "start_branch": (num, num),
        "start_cycles": (num, num),
        "start_amplitude": (num, num, points, 3),
        "offset_low": (2, contacts, 2),
        "offset_high": (2, contacts, 2),
    }
    return {name: np.array([row[name] for row in rows]).reshape(len(rows), *own) for name, own in shapes.items()}


def _row(orbits: Sequence[Orbit], motions: Sequence[Orbit], num: int) -> dict[str, np.ndarray]:
    """What has become of the starts of one range."""
    branch = np.array([branch_of(orbit, motions) for orbit in orbits], dtype=np.int8)
    led = [[orbit for orbit, own in zip(orbits, branch, strict=True) if own == side] for side in (LOWER, UPPER)]
    ends = [list(offsets([*own, motion])) for own, motion in zip(led, motions, strict=True)]
    low, high = (np.array([[pair[i] for pair in own] for own in ends]) for i in (0, 1))
    return {
        "start_branch": branch.reshape(num, num),
        "start_cycles": np.array([orbit.cycles for orbit in orbits], dtype=np.int32),
        "start_amplitude": np.array([orbit.amplitude for orbit in orbits]),
        "offset_low": low,
        "offset_high": high,
    }


def offsets(orbits: Sequence[Orbit]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Smallest and largest w (t1, t2) of each contact over motions in which it sticks all the time; NaN without."""
    slip = np.array([orbit.end.slip for orbit in orbits])
    moves = np.array([orbit.slip_share + orbit.separation_share for orbit in orbits]) > 0
    for i in range(slip.shape[1]):
        stuck = slip[~moves[:, i], i]
        yield (stuck.min(axis=0), stuck.max(axis=0)) if len(stuck) else (np.full(2, np.nan), np.full(2, np.nan))


def unique(low: np.ndarray, high: np.ndarray, size: float) -> np.ndarray:
    """Whether an offset is the same over all starts, to a share of the size of the motion; True where it is NaN."""
    return ~(high - low > SAME * size)
