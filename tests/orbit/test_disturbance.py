"""Motions that are unstable: where a search moves off them, how far, and to which motion that leads."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import timesim
from timesim.model.solver import PRESETS, Criterion
from timesim.orbit.disturbance import Departure
from timesim.orbit.search import Search, Task, after_measure, after_shot
from timesim.orbit.shooting import Shot
from timesim.orbit.threshold import DISTURBANCE, FARTHER, FARTHEST, GONE

STATE = np.array([1.0, 2.0, 0.5, 0.0])
FAST, SLOW = np.diag([1.0, 1.2, -1.5, 0.9]), np.diag([1.0, 1.001, 0.5, 0.9])  # of them the first is a free offset


@dataclass(frozen=True)
class Place:
    """A lane; contacts allow some ways off the motion."""

    vector: np.ndarray
    apart: np.ndarray
    control: SimpleNamespace
    allows: Callable[[np.ndarray], bool]
    size: float = 2.0

    def moved(self, vector):
        return replace(self, vector=vector) if self.allows(vector - STATE) else None


def at(vector, apart=(False,), *, rtol=1e-7, allows=lambda off: True):
    return Place(np.asarray(vector), np.array(apart), SimpleNamespace(rtol=rtol), allows)


def period_of(slope, end, *, complete=True):
    """A recorded period of the motion, with a derivative that is diagonal, the first entry a free offset."""
    moves = np.eye(len(slope))[:, 1:]
    return SimpleNamespace(
        start=end,
        end=end,
        cycles=2,
        complete=complete,
        closes=True,
        left=0.0,
        change=np.zeros(len(slope)),
        drift=np.zeros(len(slope)),
        returns=np.array([STATE + 1, STATE]),
        newton_step=lambda change: change,
        disturbances=moves,
        slope_of_disturbances=moves.T @ slope @ moves,
        is_unstable=bool(np.abs(np.diag(slope)[1:]).max() > 1),
    )


def off(slope, aside, **lane):
    """By how much the motion is moved, of its size, and a trajectory that lies aside from it."""
    departure = Departure(period_of(slope, at(STATE, **lane)), at(STATE + aside))
    return [(lane.vector - STATE) / 2.0 for lane in departure.disturbed()]


def test_it_is_moved_along_all_disturbances_by_their_growth_and_free_offsets_stay():
    there, back = off(FAST, np.zeros(4))
    np.testing.assert_allclose(np.abs(there), [0, 0.8 * DISTURBANCE, DISTURBANCE, 0.6 * DISTURBANCE])
    np.testing.assert_allclose(back, -there)


def test_a_disturbance_that_turns_as_it_grows_begins_with_its_first_large_entry():
    """Whatever the phase of its vector: here 1 and 0.5 i, of which the routine makes the larger entry real."""
    slope, turn = np.eye(4), np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    own = np.array([[0.0, 0.5], [1.0, 0.0]])
    slope[1:3, 1:3], slope[3, 3] = 1.2 * own @ turn @ np.linalg.inv(own), 0.0
    np.testing.assert_allclose(off(slope, np.zeros(4))[0], [0.0, DISTURBANCE, 0.0, 0.0], atol=1e-9)


def test_how_far_a_trajectory_is_off_counts_from_the_motion_that_a_step_of_newton_leads_to():
    recorded = period_of(SLOW, at(STATE))
    recorded.change = np.array([0.0, 2e-3, 0.0, 0.0])
    for aside, distance in ((2e-3, 0.0), (5e-3, 1.5e-3), (-1e-3, 1.5e-3)):
        departure = Departure(recorded, at(STATE + np.array([0.0, aside, 0.0, 0.0])))
        assert departure.off == pytest.approx(distance, abs=1e-15)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("aside", [(0.0, -0.15, -1e-9, 0.0), (0.0, -0.15, -1e-8, 1e-3), (0.0, 0.3, 0.0, 0.0)])
def test_how_far_it_is_moved_is_relative_to_the_state(aside, scale):
    """So is how far a trajectory is off, also near the limit from which on it is elsewhere."""
    found = []
    for size in (1.0, scale):
        motion, there = (replace(at(size * (STATE + way)), size=2.0 * size) for way in (np.zeros(4), np.array(aside)))
        departure = Departure(period_of(SLOW, motion), there)
        found.append((departure.off, *[(lane.vector / size - STATE) for lane in departure.disturbed()]))
    assert len(found[0]) == len(found[1])
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-6, atol=1e-15)


def test_what_grows_slowly_is_moved_farther_to_the_side_of_the_trajectory_and_farther_again():
    assert np.abs(off(SLOW, np.zeros(4))[0]).max() == pytest.approx(FARTHEST * 1.001**-200)
    for side in (1, -1):
        (moved,) = off(SLOW, side * np.array([0.0, 1e-3, 1e-9, 0.0]))
        hardly, _ = off(SLOW, side * np.array([0.0, 1e-6, 0.0, 0.0]))
        assert hardly[1] == moved[1] == pytest.approx(side * FARTHEST * 1.001**-200)
        (moved,) = off(SLOW, side * np.array([0.0, 0.08, 0.0, 0.0]))
        assert moved[1] == pytest.approx(side * FARTHER * 0.04)


def test_it_goes_the_other_way_where_contacts_do_not_allow_the_one_but_not_to_the_other_side():
    for side in (1, -1):
        allows = {"allows": lambda off, side=side: side * off[1] > 0}
        (moved,) = off(FAST, np.zeros(4), **allows)
        assert side * moved[1] > 0
        assert len(off(FAST, side * np.array([0.0, 1e-3, 0.0, 0.0]), **allows)) == 1
        assert side * off(FAST, -side * np.array([0.0, 1e-6, 0.0, 0.0]), **allows)[0][1] > 0
        assert not off(FAST, -side * np.array([0.0, 1e-3, 0.0, 0.0]), **allows)


@pytest.mark.parametrize("side", [1, -1])
def test_a_search_that_has_settled_on_an_unstable_motion_is_disturbed_once_and_marches_on(side):
    recorded = period_of(FAST, at(STATE, allows=lambda off: side * off[1] > 0))
    search = Search(0, 0, at(STATE), task=Task.MEASURE, cycles=30, period=2, returns=(STATE,))
    after = after_measure(search, recorded, PRESETS["standard"], Criterion())
    assert (after.task, after.cycles, after.period, after.returns, after.disturbed) == (Task.MARCH, 32, 0, (), True)
    assert side * (after.lane.vector - STATE)[1] > 0


@pytest.mark.parametrize(
    ("aside", "cycles", "apart", "moves"),
    [
        (1e-6, 100, (False,), True),
        (1.1 * GONE * 1.001**-900, 100, (False,), False),  # in 900 periods it will have left by itself
        (1.1 * GONE * 1.001**-900, 1000, (False,), True),
        (0.6, 100, (False,), False),  # it is elsewhere
        (1e-6, 100, (True,), False),
        (1e-6, 2000, (False,), False),  # no cycles are left
    ],
)
def test_a_search_beside_an_unstable_motion_is_moved_where_it_would_not_leave_within_its_budget(
    aside, cycles, apart, moves
):
    lane = at(STATE + 2 * np.array([0.0, aside, 0.0, 0.0]), apart)
    motion = at(STATE, rtol=1e-13)  # a finer one, of the shot alone
    search = Search(0, 0, lane, task=Task.SHOOT, shot=Shot(motion, 2), cycles=cycles - 2, attempts=1)
    after = after_shot(search, period_of(SLOW, motion), Criterion(max_cycles=1900))
    assert (after.task, after.cycles, after.disturbed) == (Task.MARCH, cycles, moves)
    assert after.lane.control is lane.control
    assert after.attempts == 1  # the next is at another period
    assert (after.lane is lane) != moves


def pairs_on_stops(couplings, study):
    """Pairs of equal bodies on stops that open, driven in step, each pair coupled by a spring, else apart."""
    size = 2 * len(couplings)
    stiffness = np.kron(np.diag(couplings), [[1, -1], [-1, 1]]) + 40 * np.eye(size)
    names = [f"b{i}" for i in range(size)]
    return {
        "structure": {
            "matrices": {
                "mass": np.eye(size).tolist(),
                "stiffness": stiffness.tolist(),
                "damping_ratio": 0.005,
                "points": {name: {"x": i} for i, name in enumerate(names)},
            }
        },
        "contacts": [
            {"name": name, "point": name, "normal": [1, 0, 0], "friction": 0, "preload": 0.2}
            | {"tangential_stiffness": 0, "normal_stiffness": 40}
            for name in names
        ],
        "excitation": {"forces": [{"point": name, "direction": [1, 0, 0], "amplitude": 3} for name in names]},
        "study": study,
    }


@pytest.mark.long
def test_bodies_that_begin_alike_do_not_end_on_an_unstable_motion():
    """Two that open from their stops in step: the motion out of step is in resonance at one and a half times 1.4 Hz.

    From rest they move alike, as on the unstable motion; from elsewhere they part. A harmonic balance knows of it, too.
    """
    scene = pairs_on_stops([60], {"kind": "sweep", "frequency": {"values": [1.4]}})
    for begin in ({}, {"initial": {"modal_displacement": [0.0, 0.1]}}):
        result = timesim.run(scene | begin)
        assert (result["settled"].item(), result["period"].item()) == (1, 2)
        np.testing.assert_allclose(result["amplitude"].sel(axis="x").values.ravel(), 0.183295, rtol=3e-6)
    curve = timesim.run(pairs_on_stops([60], {"kind": "hbm", "frequency": {"from": 1.399, "to": 1.401}}))
    assert not curve["stable"].values.any()


@pytest.mark.long
def test_all_bodies_leave_unstable_motions_though_those_of_one_pair_grow_faster():
    result = timesim.run(pairs_on_stops([60, 59], {"kind": "sweep", "frequency": {"values": [1.4]}}))
    assert result["settled"].item() == 1
    assert result["floquet_max"].item() < 1
    amplitude = result["amplitude"].sel(axis="x").values.ravel()
    np.testing.assert_allclose(amplitude, np.repeat([0.183295, 0.224782], 2), rtol=5e-6)


@pytest.mark.long
def test_a_motion_that_loses_its_stability_slowly_is_left_where_it_does():
    """Two equal bodies swing against each other on stops that close; at 1.1530 Hz their multiplier passes 1.

    Beyond, one swings farther than the other, ever more so up to 1.1539 Hz; there it jumps. At 1.155 Hz a disturbance
    of the equal swing still takes a thousand cycles to grow by itself.
    """
    scene = {
        "structure": {
            "matrices": {
                "mass": np.eye(2).tolist(),
                "stiffness": [[41, -1], [-1, 41]],
                "damping_ratio": 0.01,
                "points": {"a": {"x": 0}, "b": {"x": 1}},
            }
        },
        "contacts": [
            {"name": name, "point": name, "normal": [1, 0, 0], "friction": 0, "preload": -2}
            | {"tangential_stiffness": 0, "normal_stiffness": 40}
            for name in "ab"
        ],
        "excitation": {
            "forces": [
                {"point": "a", "direction": [1, 0, 0], "amplitude": 0.6},
                {"point": "b", "direction": [1, 0, 0], "amplitude": 0.6, "phase_deg": 180},
            ]
        },
        "study": {"kind": "sweep", "frequency": {"values": [1.1525, 1.1531, 1.1535, 1.156]}}
        | {"direction": "up", "refine": 1e-4},
    }
    result = timesim.run(scene)
    assert result["settled"].values.all()
    assert (result["floquet_max"].values < 1).all()
    a, b = result["amplitude"].sel(axis="x", direction="up").values.T
    assert abs(a / b - 1)[0] < 1e-6
    assert (np.diff(abs(a / b - 1)) > 0.05).all()
    low, high = (result[name].values.ravel() for name in ("jump_low", "jump_high"))
    assert (low[-1], high[-1]) == pytest.approx((1.1539, 1.1540), abs=1e-4)
    # The difference begins as a root does: over a width it may look like a jump.
    assert ((low[:-1] > 1.1529) & (high[:-1] < 1.1532)).all()
