"""Arc-length continuation on curves with closed forms, and how it fails."""

import re
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from timesim.hbm.continuation import (
    Controls,
    Curve,
    Ending,
    corner,
    follow,
    follow_both_ways,
    other_end,
    solve,
    tracker,
)
from timesim.hbm.continuation.corrector import Corrector
from timesim.hbm.continuation.trace import Trace
from timesim.hbm.continuation.tracker import _PathTracker

CONTROLS = Controls(size=0.1)


@dataclass
class Cubic:
    """x^3 - 3 x = p / unit, the second unknown a copy of the first: folds at p = +-2 unit."""

    unit: float = 1.0
    length: float = 1.0
    places: list[float] = field(default_factory=list)

    def value(self, x, p):
        self.places.append(p)
        y = x / self.length
        return np.array([y[0] ** 3 - 3 * y[0] - p / self.unit, y[1] - y[0]]) * self.length

    def linearised(self, x, p):
        y = x[0] / self.length
        return (
            self.value(x, p),
            np.array([[3 * y**2 - 3, 0.0], [-1.0, 1.0]]),
            np.array([-self.length / self.unit, 0]),
        )


class Circle:
    """x^2 + p^2 = 1: from p = 0 the curve turns at 1 and comes back."""

    def value(self, x, p):
        return np.array([x[0] ** 2 + p**2 - 1])

    def linearised(self, x, p):
        return self.value(x, p), np.array([[2 * x[0]]]), np.array([2 * p])


class Kink:
    """x = 1 + |p| / 2: the tangent turns at once."""

    def value(self, x, p):
        return np.array([x[0] - 1 - abs(p) / 2])

    def linearised(self, x, p):
        return self.value(x, p), np.eye(1), np.array([-0.5 if p > 0 else 0.5])


class Wall:
    """x = 0, as long as p stays below a half: beyond, there is no residual."""

    def value(self, x, p):
        return x.copy() if p < 0.5 else np.array([np.nan])

    def linearised(self, x, p):
        return self.value(x, p), np.eye(1), np.zeros(1)


def test_both_folds_and_branches():
    curve = follow(Cubic(), np.array([-3.0, -3.0]), -10.0, 10.0, CONTROLS)
    assert curve.complete, curve.message
    np.testing.assert_allclose(curve.p[curve.fold], [2.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(curve.x[curve.fold][:, 0], [-1.0, 1.0], atol=1e-4)
    np.testing.assert_allclose(curve.x[:, 0] ** 3 - 3 * curve.x[:, 0], curve.p, atol=1e-7)
    assert curve.p[0] == -10.0
    assert curve.p[-1] == pytest.approx(10.0, abs=1e-12)
    assert set(curve.branch) == {0, 1, 2}
    np.testing.assert_array_equal(curve.branch[curve.fold], [0, 1])
    middle = (curve.branch == 1) & ~curve.fold
    assert np.all(np.abs(curve.x[middle, 0]) < 1)
    np.testing.assert_array_equal(curve.determinant[~curve.fold], np.where(middle, -1, 1)[~curve.fold])


def test_folds_with_one_point_between_them():
    """It goes back by less than the noise of samples, the curve between it and the next one by more."""
    controls = Controls(size=0.1, max_step=0.05)
    curve = follow(Cubic(unit=7e-6, length=0.0035), np.full(2, -0.1625), -1.0, 1.0, controls)
    assert curve.complete, curve.message
    np.testing.assert_allclose(curve.p[curve.fold], [1.4e-5, -1.4e-5], rtol=1e-6)
    np.testing.assert_array_equal(curve.determinant[~curve.fold], np.where(curve.branch == 1, -1, 1)[~curve.fold])


def test_a_fold_beside_a_point_with_the_tangent_of_earlier_derivatives():
    """The farthest point lies behind the fold, but its tangent and determinant are those from before it."""
    corrector = Corrector(Cubic(), CONTROLS, 20.0, np.full(2, -1.0))

    def point(y):
        return corrector.simplified_newton(corrector.in_units(np.full(2, y), y**3 - 3 * y), np.array([1.0, 1.0, 0.0]))

    trace, earlier = Trace(corrector, 1.0), point(-1.05)
    behind = replace(point(-0.98), tangent=earlier.tangent, determinant=earlier.determinant)
    for own in (point(-1.2), behind, point(-0.9)):
        trace.add(own)
    ((x, p),) = [(x, p) for x, p, fold, _ in trace.solutions if fold]
    assert p == pytest.approx(2.0, abs=1e-9)
    np.testing.assert_allclose(x, -1.0, atol=1e-4)
    np.testing.assert_allclose([own[0] for own, *_ in trace.solutions], [-1.2, -1.0, -0.98, -0.9], atol=1e-4)
    assert [sign for *_, sign in trace.solutions] == [1, 0, -1, -1]


def test_a_fold_that_is_not_found_between_solutions_is_not_the_one_before(monkeypatch):
    """With one solution between both the first one lies between its neighbours as well."""
    corrector = Corrector(Cubic(), CONTROLS, 20.0, np.full(2, -1.0))
    trace = Trace(corrector, 1.0)
    extreme = trace._extreme
    monkeypatch.setattr(
        trace, "_extreme", lambda *pair: None if corrector.unscaled(pair[1].y)[0][0] > 1 else extreme(*pair)
    )
    for x in (-1.2, 0.98, 1.3, 1.6):
        guess = corrector.in_units(np.full(2, x), x**3 - 3 * x)
        trace.add(corrector.simplified_newton(guess, np.array([1.0, 1.0, -1.0 if abs(x) < 1 else 1.0])))
    folds = [(x[0], p) for x, p, fold, _ in trace.solutions if fold]
    np.testing.assert_allclose(folds, [(-1.0, 2.0), (0.98, 0.98**3 - 3 * 0.98)], atol=1e-4)


@dataclass
class Watched(Circle):
    """Remembers how large the residual was wherever it was asked for, and where derivatives were."""

    sizes: list[float] = field(default_factory=list)
    derived: list[float] = field(default_factory=list)

    def value(self, x, p):
        r = super().value(x, p)
        self.sizes.append(abs(r[0]))
        return r

    def linearised(self, x, p):
        done = super().linearised(x, p)
        self.derived.append(self.sizes[-1])
        return done


class OtherProcess:
    """Follows a curve at once, in this process; one that failed has none."""

    share = 1.0

    def __init__(self, curve: Curve | None):
        self.ended, self.given_up = curve, False

    def curve(self) -> Curve | None:
        return self.ended

    def give_up(self) -> None:
        self.given_up = True


@pytest.mark.parametrize("ends", [(-10.0, 10.0), (10.0, -10.0), (-10.0, 12.0)])
def test_a_curve_that_takes_long_is_followed_from_both_ends(monkeypatch, ends):
    """The middle lies between the folds, where three solutions are: it is met when it is passed for the third time."""
    monkeypatch.setattr(other_end, "WORK", 2)
    start, stop = ends
    guesses = {p: np.full(2, 3.0 * np.sign(p)) for p in ends}
    alone = follow(Cubic(), guesses[start], start, stop, CONTROLS)
    asked, shares = [], []

    def from_end(middle: float) -> OtherProcess:
        asked.append((middle, OtherProcess(follow(Cubic(), guesses[stop], stop, middle, CONTROLS))))
        return asked[-1][1]

    watched = replace(CONTROLS, watch=lambda share, _: shares.append(share))
    both = follow(Cubic(), guesses[start], start, stop, watched, from_end=from_end)
    ((middle, other),) = asked
    assert abs(middle) < 2
    assert not other.given_up
    assert both.complete
    assert len(shares) < both.p.size < alone.p.size + 10
    assert shares[-1] == 1.0
    assert both.p[[0, -1]].tolist() == [start, stop]
    np.testing.assert_allclose(both.p[both.fold], alone.p[alone.fold], rtol=1e-9)
    assert np.count_nonzero(both.fold) == 2
    for x, p, fold, sign in zip(both.x, both.p, both.fold, both.determinant, strict=True):
        assert abs(x[0] ** 3 - 3 * x[0] - p) < 1e-7
        assert sign == (0 if fold else np.sign(3 * x[0] ** 2 - 3))
    way = np.diff(both.x[:, 0]) * np.sign(stop - start)
    assert np.all(way > 0)  # no solution twice


def test_folds_that_lie_in_the_part_from_the_other_end(monkeypatch):
    """They are passed in the other order there; what is done meanwhile counts as reached."""
    monkeypatch.setattr(other_end, "WORK", 2)
    begun, seen = [], []

    def from_end(middle: float) -> OtherProcess:
        begun.append(middle)
        return OtherProcess(follow(Cubic(), np.full(2, 2.1), 3.0, middle, CONTROLS))

    watched = replace(CONTROLS, watch=lambda share, so_far: seen.append((share, so_far().p[-1])))
    both = follow(Cubic(), np.full(2, -2.5), -10.0, 3.0, watched, from_end=from_end)
    assert both.complete
    x, (middle,) = both.x[:, 0], begun
    assert middle < -2
    assert np.all(np.diff(x) > 0)
    np.testing.assert_allclose(both.p[both.fold], [2.0, -2.0], atol=1e-9)
    np.testing.assert_array_equal(both.determinant, np.where(both.fold, 0, np.sign(np.abs(x) - 1)))
    assert both.p[~both.backwards][-1] == pytest.approx(middle)
    np.testing.assert_allclose(*np.array([(share, (p + 10 + 3 - middle) / 13) for share, p in seen[:-1]]).T)


def test_both_parts_of_a_range_of_frequencies_have_as_many_resonances():
    """Those of harmonics, at a natural frequency far above divided by their orders."""
    asked: list[float] = []
    other = other_end.OtherEnd(lambda middle: asked.append(middle) or OtherProcess(None), 200.0)
    other.count(other_end.WORK, 100.0)
    (middle,), resonances = asked, 1e5 / np.arange(1, 2000)
    low, high = (np.count_nonzero((resonances > a) & (resonances < b)) for a, b in ((100, middle), (middle, 200)))
    assert low == pytest.approx(high, abs=1)
    assert low + high > 400


def test_a_curve_goes_on_alone_where_the_other_end_does_not_lead_to_it(monkeypatch):
    monkeypatch.setattr(other_end, "WORK", 20)
    alone = follow(Cubic(), np.full(2, -3.0), -10.0, 10.0, CONTROLS)
    lost = follow(Cubic(), np.full(2, 3.0), 10.0, 5.0, replace(CONTROLS, max_points=3))
    elsewhere = replace(follow(Cubic(), np.full(2, 3.0), 10.0, 0.0, CONTROLS))
    elsewhere = replace(elsewhere, x=elsewhere.x + 0.1)
    for curve in (None, lost, elsewhere):
        other = OtherProcess(curve)
        for_all = follow(Cubic(), np.full(2, -3.0), -10.0, 10.0, CONTROLS, from_end=lambda _: other)  # noqa: B023
        assert other.given_up
        np.testing.assert_array_equal(for_all.x, alone.x)
        assert for_all.message == alone.message
    few = replace(CONTROLS, max_points=alone.p.size - 2)
    whole = follow(Cubic(), np.full(2, -3.0), -10.0, 10.0, few, from_end=lambda middle: OtherProcess(half_from(middle)))
    assert whole.ending is Ending.POINTS


def half_from(middle: float) -> Curve:
    return follow(Cubic(), np.full(2, 3.0), 10.0, middle, CONTROLS)


def test_the_predictor_is_of_second_order():
    """With equal steps its error, the residual where Newton's method begins, falls with the third power of the step."""
    errors = []
    for step in (0.02, 0.01, 0.005):
        circle = Watched()
        controls = Controls(size=0.1, first_step=step, max_step=step, tolerance=1e-12)
        curve = follow(circle, np.array([0.8]), -0.6, 0.6, controls)
        begun = [size for before, size in pairwise(circle.sizes) if before <= 1e-12 < size]
        assert len(begun) == pytest.approx(curve.p.size, abs=3)
        errors.append(np.median(begun))
        # Those of the solution before are good for a first step.
        assert np.median(circle.derived) < 0.2 * errors[-1]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(3, abs=0.2)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(3, abs=0.2)


def test_no_step_is_longer_than_allowed():
    controls = Controls(size=0.1, max_step=0.02)
    curve = follow(Circle(), np.array([1.0]), 0.0, 0.999, controls)
    units = np.stack([curve.x[:, 0], curve.p / 0.999], axis=1)
    assert np.linalg.norm(np.diff(units, axis=0), axis=1).max() < 0.025


@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_units_do_not_matter(scale):
    plain = follow(Cubic(), np.array([-3.0, -3.0]), -10.0, 10.0, CONTROLS)
    scaled = follow(
        Cubic(unit=1 / scale, length=scale),
        np.full(2, -3.0 * scale),
        -10 / scale,
        10 / scale,
        Controls(size=0.1 * scale),
    )
    assert scaled.p.size == plain.p.size
    np.testing.assert_allclose(scaled.p * scale, plain.p, rtol=1e-6, atol=1e-7)


class Ledge:
    """x = tanh(p / width): flat but for a small part of the range."""

    width = 1e-3

    def value(self, x, p):
        return x - np.tanh(p / self.width)

    def linearised(self, x, p):
        return self.value(x, p), np.eye(1), np.array([(np.tanh(p / self.width) ** 2 - 1) / self.width])


@pytest.mark.parametrize("start", [-1.0, 1.0])
def test_no_step_leads_from_one_flat_part_to_another(start):
    curve = follow(Ledge(), np.array([start]), start, -start, CONTROLS)
    assert curve.complete
    assert np.sum(np.abs(curve.x[:, 0]) < 0.9) > 10


def test_either_direction():
    back = follow(Cubic(), np.array([3.0, 3.0]), 10.0, -10.0, CONTROLS)
    assert back.complete
    np.testing.assert_allclose(back.p[back.fold], [-2.0, 2.0], atol=1e-9)


def test_a_corner_is_passed():
    curve = follow(Kink(), np.array([1.5]), -1.0, 1.0, CONTROLS)
    assert curve.complete, curve.message
    assert not curve.fold.any()
    assert curve.p.size < 200


def test_no_corner_is_looked_for_ahead_of_a_long_step():
    tracker = _PathTracker(Kink(), np.array([1.5]), CONTROLS, -1.0, 1.0, -1.0)
    point = tracker.corrector.damped_newton(tracker.corrector.in_units(np.array([1.002]), -0.004), tracker.ahead)
    assert corner.around_corner(tracker.corrector, CONTROLS, point, 0.01) is not None
    tracker.corrector.residual = None
    assert corner.around_corner(tracker.corrector, CONTROLS, point, 0.02) is None


class Reversal:
    """p = x up to x = 0, then p = -3 x: the curve turns by more than a right angle at once; y = x + p goes along."""

    def __init__(self):
        self.evaluations = 0

    def value(self, x, p):
        self.evaluations += 1
        return np.array([(x[0] if x[0] < 0 else -3 * x[0]) - p, x[0] + p - x[1]])

    def linearised(self, x, p):
        return self.value(x, p), np.array([[1.0 if x[0] < 0 else -3.0, 0.0], [1.0, -1.0]]), np.array([-1.0, 1.0])


def test_a_corner_at_which_the_curve_turns_back():
    """It is a fold; no solution lies ahead of the last tangent, and the line behind the corner tells where to go on."""
    residual = Reversal()
    curve = follow(residual, np.array([-1.0, -2.0]), -1.0, 1.0, CONTROLS)
    assert curve.ending is Ending.LEFT
    assert curve.fold.sum() == 1
    assert abs(curve.p[curve.fold][0]) < 1e-5
    assert curve.x[:, 0].max() > 0.3
    assert residual.evaluations < 3 * curve.p.size


class RuggedReversal(Reversal):
    """The same with p = x (0.3 sin(8 log x) - 3) behind: no line from there meets the tangent at the corner itself."""

    def value(self, x, p):
        behind = x[0] * (0.3 * np.sin(8 * np.log(max(x[0], 1e-300))) - 3)
        return np.array([(x[0] if x[0] < 0 else behind) - p, x[0] + p - x[1]])

    def linearised(self, x, p):
        turn = 8 * np.log(max(x[0], 1e-300))
        slope = 0.3 * np.sin(turn) + 2.4 * np.cos(turn) - 3
        return self.value(x, p), np.array([[1.0 if x[0] < 0 else slope, 0.0], [1.0, -1.0]]), np.array([-1.0, 1.0])


def test_a_corner_that_cannot_be_approached_is_crossed():
    """As where a contact comes to stick all along, whose offset changes in another way in each direction."""
    curve = follow(RuggedReversal(), np.array([-1.0, -2.0]), -1.0, 1.0, CONTROLS)
    assert curve.ending is Ending.LEFT
    assert curve.fold.sum() == 1
    assert abs(curve.p[curve.fold][0]) < 1e-3
    assert curve.x[:, 0].max() > 0.3


@dataclass
class Zigzag:
    """As x grows from each whole number to the next, p goes straight between two of these places."""

    places: np.ndarray

    def value(self, x, p):
        i = self.part(x[0])
        return np.array([self.places[i] + (x[0] - i) * (self.places[i + 1] - self.places[i]) - p])

    def linearised(self, x, p):
        i = self.part(x[0])
        return self.value(x, p), np.array([[self.places[i + 1] - self.places[i]]]), -np.ones(1)

    def part(self, x):
        return np.clip(np.floor(x), 0, self.places.size - 2).astype(int)


@pytest.mark.parametrize("seed", range(40))
def test_corners_of_any_turn_are_passed_in_their_order(seed):
    """Wherever the steps before have come to: a correction that is longer than its step may be that of a corner."""
    rng = np.random.default_rng(seed)
    slopes = rng.uniform(0.2, 3, size=6) * rng.choice([1, 1, -1], size=6)
    slopes[0] = slopes[-1] = 1 + abs(slopes[0])
    places = np.append(0.0, np.cumsum(slopes))
    places[[0, -1]] = min(places[0], places[1:-1].min() - 0.5), max(places[-1], places[1:-1].max() + 0.5)
    zigzag, slopes = Zigzag(places), np.diff(places)
    curve = follow(zigzag, np.zeros(1), places[0], places[-1], Controls(size=1.0, max_step=0.05))
    assert curve.complete, curve.message
    x = curve.x[:, 0]
    assert np.all(np.diff(x) > -1e-6)
    turns = 1 + np.flatnonzero(slopes[1:] * slopes[:-1] < 0)
    assert np.count_nonzero(curve.fold) == turns.size
    np.testing.assert_allclose(x[curve.fold], turns, atol=0.01)
    clear = np.abs(x - np.round(x)) > 0.01
    np.testing.assert_array_equal(curve.determinant[clear], np.sign(slopes[zigzag.part(x)])[clear])


class NarrowReturn:
    """|x - m| + m = 0, m = p / 10^4 + p |p| / 2: x = 0 up to p = 0, then back along x = 2 m, at first next to it."""

    def value(self, x, p):
        middle = 1e-4 * p + p * abs(p) / 2
        return np.abs(x - middle) + middle

    def linearised(self, x, p):
        side, slope = np.sign(x - (1e-4 * p + p * abs(p) / 2)), 1e-4 + abs(p)
        return self.value(x, p), side[:, None], slope * (1 - side)


def test_a_curve_does_not_turn_back_on_its_own_way():
    """Behind the corner a step that lands on the way that led there changes the orientation: it is too long."""
    curve = follow(NarrowReturn(), np.array([0.0]), -1.0, 1.0, CONTROLS)
    assert curve.ending is Ending.LEFT
    assert curve.fold.sum() == 1
    assert curve.x[-1, 0] == pytest.approx(-1.0002, abs=1e-6)


class BentReturn:
    """The same along x = 3 p^2: the tangent leads to the side of the way back."""

    def value(self, x, p):
        return NarrowReturn().value(x - 3 * p**2, p)

    def linearised(self, x, p):
        r, by_x, by_p = NarrowReturn().linearised(x - 3 * p**2, p)
        return r, by_x, by_p - by_x[0] * 6 * p


def test_the_way_to_a_corner_does_not_lead_to_the_one_behind_it():
    tracker = _PathTracker(BentReturn(), np.array([3.0]), Controls(size=1.0), -1.0, 1.0, -1.0)
    at = tracker.corrector.in_units(np.array([3 * 0.05**2]), -0.05)
    point = tracker.corrector.damped_newton(at, tracker.ahead)
    assert point.orientation > 0
    landed = tracker.corrector.simplified_newton(point.y + 0.02 * point.tangent, point.tangent)
    assert landed.orientation < 0
    assert corner._at_corner(tracker.corrector, tracker.controls, point, 0.02 / 0.95, point.tangent) is None


@dataclass
class Waver:
    """p - place = x - 3/2 x exp(-x^2 / width^2): the parameter goes back on the way by 0.4 of the width."""

    width: float
    place: float

    def value(self, x, p):
        return x * (1 - 1.5 * np.exp(-((x / self.width) ** 2))) - (p - self.place)

    def linearised(self, x, p):
        square = (x[0] / self.width) ** 2
        return self.value(x, p), np.array([[1 - 1.5 * (1 - 2 * square) * np.exp(-square)]]), -np.ones(1)


@pytest.mark.parametrize(
    ("width", "reach", "place", "folds"),
    [(1e-6, 1.0, 0.0, 0), (1e-3, 1.0, 0.0, 2), (1e-6, 0.01, 0.0, 2), (1e-6, 0.01, 1.0, 0)],
)
def test_what_goes_back_by_less_than_the_noise_of_samples_is_no_fold(width, reach, place, folds):
    """Relative to the range, and to the parameter, which may be far larger."""
    steps = {name: width / reach / share for name, share in (("first_step", 20), ("min_step", 1e4), ("max_step", 10))}
    controls = Controls(size=reach, max_points=200, tolerance=1e-14 / reach, **steps)
    curve = follow(Waver(width, place), np.array([-5 * width]), place - 5 * width, place + reach, controls)
    assert curve.ending is Ending.POINTS
    assert curve.x[-1, 0] > 5 * width
    assert np.any(np.diff(curve.p) < 0)
    assert curve.fold.sum() == folds
    between = (np.cumsum(curve.fold) == 1) & ~curve.fold
    np.testing.assert_array_equal(curve.determinant[~curve.fold], np.where(between, -1, 1)[~curve.fold])


def test_a_curve_that_comes_back_says_so():
    curve = follow(Circle(), np.array([1.0]), 0.0, 2.0, CONTROLS)
    assert curve.ending is Ending.LEFT
    assert not curve.complete
    assert "turned back" in curve.message
    assert curve.p[curve.fold] == pytest.approx(1.0, abs=1e-9)
    assert curve.x[-1, 0] == pytest.approx(-1.0)


class Isola:
    """(x - 3)^2 + p^2 = 1: closed, so that no end of a wider range leads to it."""

    def value(self, x, p):
        return np.array([(x[0] - 3) ** 2 + p**2 - 1])

    def linearised(self, x, p):
        return self.value(x, p), np.array([[2 * (x[0] - 3)]]), np.array([2 * p])


@pytest.mark.parametrize("start", [0.3, -0.8])
def test_a_closed_curve_is_found_from_inside(start):
    curve = follow_both_ways(Isola(), np.array([3.9]), start, (-2.0, 2.0), CONTROLS)
    assert curve.ending is Ending.CLOSED
    assert curve.complete
    np.testing.assert_allclose(np.sort(curve.p[curve.fold]), [-1.0, 1.0], atol=1e-9)
    assert curve.x.min() == pytest.approx(2.0, abs=5e-3)
    np.testing.assert_allclose(curve.x[0], curve.x[-1], rtol=1e-6)
    turned = np.unwrap(np.arctan2(curve.x[:, 0] - 3, curve.p))
    assert abs(turned[-1] - turned[0]) == pytest.approx(2 * np.pi, rel=1e-5)


def test_a_curve_that_goes_round_and_round_ends(monkeypatch):
    """As one does that a step has led onto a closed branch, which it did not begin on."""
    monkeypatch.setattr(_PathTracker, "_start_again", lambda *_: None)
    curve = follow(Isola(), np.array([3.9]), 0.3, 2.0, CONTROLS, behind=-2.0)
    assert curve.ending is Ending.AGAIN
    assert not curve.complete
    assert "closed branch" in curve.message
    assert curve.fold.sum() == 4


@pytest.mark.parametrize(("start", "guess"), [(5.0, 2.3), (0.0, 0.01), (0.0, 1.7)])
def test_from_inside_the_range_the_curve_is_the_same(start, guess):
    curve = follow_both_ways(Cubic(), np.full(2, guess), start, (-10.0, 10.0), CONTROLS)
    assert curve.complete
    assert sorted([curve.p[0], curve.p[-1]]) == pytest.approx([-10.0, 10.0])
    np.testing.assert_allclose(np.sort(curve.p[curve.fold]), [-2.0, 2.0], atol=1e-9)
    assert set(curve.branch) == {0, 1, 2}
    np.testing.assert_array_equal(curve.branch[curve.fold], [0, 1])
    assert np.all(np.diff(curve.x[:, 0]) * np.sign(curve.x[-1, 0]) > 0)


def test_from_inside_the_range_the_side_that_fails_says_why():
    """The other one reaches the end of the range."""
    for ends in ((-1.0, 1.0), (1.0, -1.0)):
        curve = follow_both_ways(Wall(), np.array([0.0]), 0.0, ends, CONTROLS)
        assert curve.ending is Ending.STEP
        assert f"{curve.p.max():.10g}" in curve.message
        assert curve.p.min() == -1.0


def test_the_side_that_closes_the_curve_is_the_whole_of_it(monkeypatch):
    """Where the other one fails on the way, its points are passed again."""
    whole, part = (follow(Isola(), np.array([3.9]), 0.3, stop, CONTROLS, behind=-2.0) for stop in (2.0, 0.5))
    assert (whole.ending, part.ending) == (Ending.CLOSED, Ending.COMPLETE)
    sides = iter([replace(part, ending=Ending.STEP), whole])
    monkeypatch.setattr(tracker, "follow", lambda *_, **__: next(sides))
    curve = follow_both_ways(Isola(), np.array([3.9]), 0.3, (-2.0, 2.0), CONTROLS)
    np.testing.assert_array_equal(curve.x, whole.x)
    assert curve.ending is Ending.CLOSED


def test_an_interrupt_as_the_other_side_begins_keeps_the_first(monkeypatch):
    first = follow(Kink(), np.array([1.0]), 0.0, 1.0, CONTROLS)

    def interrupted(*args, **_):
        if args[3] == 1.0:
            return first
        raise KeyboardInterrupt

    monkeypatch.setattr(tracker, "follow", interrupted)
    curve = follow_both_ways(Kink(), np.array([1.0]), 0.0, (-1.0, 1.0), CONTROLS)
    assert curve.ending is Ending.INTERRUPTED
    assert curve.message.endswith("interrupted on the other side")
    np.testing.assert_array_equal(curve.p, first.p)


def test_no_step_that_is_to_be_taken_is_below_the_shortest():
    """Its length would not be tried at all, and the curve end where it turns."""
    stiff = replace(CONTROLS, first_step=0.06, max_step=0.06, min_step=0.06)
    curve = follow(Isola(), np.array([3.9]), 0.3, 2.0, stiff, behind=-2.0)
    assert curve.ending is Ending.CLOSED


class Interrupted(Kink):
    """Someone presses Ctrl-C on the way."""

    def value(self, x, p):
        if p > 0.2:
            raise KeyboardInterrupt
        return super().value(x, p)


def test_an_interrupt_keeps_what_there_is():
    curve = follow(Interrupted(), np.array([1.5]), -1.0, 1.0, CONTROLS)
    assert curve.ending is Ending.INTERRUPTED
    assert 0.1 < curve.p[-1] <= 0.2
    assert not curve.complete


def test_failure_keeps_what_there_is_and_says_where():
    curve = follow(Wall(), np.array([0.0]), 0.0, 1.0, CONTROLS)
    assert curve.ending is Ending.STEP
    assert 0.49 < curve.p[-1] < 0.5
    assert f"{curve.p[-1]:.10g}" in curve.message
    assert "min_step" in curve.message


def test_no_solution_at_the_start():
    curve = follow(Circle(), np.array([1.0]), 3.0, 4.0, CONTROLS)
    assert curve.ending is Ending.START
    assert curve.p.size == 0
    assert "no solution at the start" in curve.message
    assert "3" in curve.message


class Pole:
    """x = 1 / (1 - p): no curve goes through p = 1, and none turns back."""

    def value(self, x, p):
        return (1 - p) * x - 1

    def linearised(self, x, p):
        return self.value(x, p), np.array([[1 - p]]), -x


def test_a_curve_that_goes_to_infinity_ends():
    curve = follow(Pole(), np.array([1.0]), 0.0, 2.0, CONTROLS)
    assert curve.ending is Ending.UNBOUNDED
    assert not curve.complete
    assert abs(curve.x[-1, 0]) > 1e10 > abs(curve.x[-2, 0])
    assert "without damping" in curve.message


class Pushed:
    """A motion about a mean of `far`."""

    def __init__(self, far):
        self.far = far

    def centre(self, x):
        return np.array([x[0], 0.0])

    def value(self, x, p):
        return np.array([x[0] / self.far - 1, x[1] - 1 - p])

    def linearised(self, x, p):
        return self.value(x, p), np.diag([1 / self.far, 1.0]), np.array([0.0, -1.0])


@pytest.mark.parametrize(("far", "solved"), [(1e6, True), (1e10, False)])
@pytest.mark.parametrize("tolerance", [1e-9, 1e-3])
def test_a_motion_that_is_lost_in_the_rounding_of_its_mean_is_no_solution(far, solved, tolerance):
    curve = follow(Pushed(far), np.zeros(2), 0.0, 1.0, Controls(tolerance=tolerance))
    assert curve.complete == solved
    assert solved or (curve.p.size, curve.ending) == (0, Ending.START)


def test_the_number_of_points_is_bounded():
    curve = follow(Cubic(), np.array([-3.0, -3.0]), -10.0, 10.0, Controls(size=0.1, max_points=7))
    assert curve.ending is Ending.POINTS
    assert curve.p.size == 7
    assert "max_points" in curve.message


def test_solve_at_one_place():
    solution = solve(Cubic(), np.array([2.5, 2.5]), 2.0, CONTROLS)
    assert solution is not None
    np.testing.assert_allclose(solution[0], 2.0, atol=1e-8)
    assert solution[1] == 1
    assert solve(Circle(), np.array([1.0]), 2.0, CONTROLS) is None


class Combined:
    """Equations that Newton's method only solves with shorter steps, combined by a matrix."""

    def __init__(self, matrix):
        self.matrix, self.places = np.array(matrix), []

    def value(self, x, p):
        self.places.append(x)
        return self.matrix @ np.array([np.arctan(x[0] - p) + x[1] / 10, x[1] ** 3 + x[1] - x[0] ** 2 - 1])

    def linearised(self, x, p):
        slope = 1 / (1 + (x[0] - p) ** 2)
        matrix = self.matrix @ np.array([[slope, 0.1], [-2 * x[0], 3 * x[1] ** 2 + 1]])
        return self.value(x, p), matrix, self.matrix @ np.array([-slope, 0.0])


@pytest.mark.parametrize("matrix", [[[1.0, 1e4], [0.0, 1.0]], [[1e4, 0.0], [0.0, 1.0]], [[1e-4, 1.0], [1.0, 1.0]]])
def test_shorter_steps_do_not_depend_on_how_equations_are_combined(matrix):
    plain, combined = Combined(np.eye(2)), Combined(matrix)
    for residual in (plain, combined):
        assert solve(residual, np.array([6.0, -3.0]), 1.0, Controls(tolerance=1e-10)) is not None
    assert 15 < len(plain.places) < 30
    np.testing.assert_allclose(plain.places, combined.places, rtol=0, atol=1e-7)


@pytest.mark.parametrize("seed", range(12))
def test_the_sign_of_the_determinant(seed):
    """Of linear equations, whatever rows the factorisation swaps."""
    matrix = np.random.default_rng(seed).normal(size=(4, 4))

    class Linear:
        def value(self, x, p):
            return matrix @ x - p

        def linearised(self, x, p):
            return self.value(x, p), matrix, -np.ones(4)

    solution = solve(Linear(), np.zeros(4), 1.0, CONTROLS)
    assert solution is not None
    assert solution[1] == np.sign(np.linalg.det(matrix))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"size": 0.0}, "size and tolerance must be positive, not 0.0"),
        ({"min_step": 0.1, "max_step": 0.01}, "not 0.1, 0.01, 0.01"),
        ({"max_points": 1}, "max_points must be at least 2"),
    ],
)
def test_wrong_controls_are_refused(change, said):
    with pytest.raises(ValueError, match=said):
        Controls(**{"size": 0.1, **change})


@pytest.mark.parametrize(("start", "stop"), [(1.0, 1.0), (0.0, np.inf)])
def test_a_range_needs_two_ends(start, stop):
    with pytest.raises(ValueError, match="two different finite ends"):
        follow(Circle(), np.array([1.0]), start, stop, CONTROLS)


def test_a_guess_must_be_finite():
    with pytest.raises(ValueError, match="finite numbers"):
        follow(Circle(), np.array([np.nan]), 0.0, 1.0, CONTROLS)


class Growing:
    """x^3 - 0.06 x + 4 x' = p, where x' = share x, or 0 as long as it is not in use: then there are two folds."""

    def __init__(self, share, wall=np.inf):
        self.share, self.wall, self.count = share, wall, 1

    @property
    def active(self):
        return np.arange(self.count)

    def begin(self, x):
        self.count = 1

    def adapt(self, x, p):
        return False

    def refine(self):
        more, self.count = self.count == 1, 2
        return more

    def restore(self):
        self.count = 1

    def refuses(self, x, p):
        return False

    def value(self, x, p):
        if self.count == 1:
            return np.array([x[0] ** 3 - 0.06 * x[0] - p if p < self.wall else np.nan])
        return np.array([x[0] ** 3 - 0.06 * x[0] + 4 * x[1] - p, x[1] - self.share * x[0]])

    def linearised(self, x, p):
        slope = 3 * x[0] ** 2 - 0.06
        matrix = [[slope, 4.0], [-self.share, 1.0]] if self.count == 2 else [[slope]]
        return self.value(x, p), np.array(matrix), np.array([-1.0, 0.0][: self.count])


@pytest.mark.parametrize(("share", "folds"), [(0.02, 0), (0.001, 2)])
def test_a_fold_that_is_none_with_more_unknowns_is_none(share, folds):
    residual = Growing(share)
    curve = follow(residual, np.array([-1.5, 0.0]), -2.0, 2.0, CONTROLS)
    assert curve.complete, curve.message
    assert np.count_nonzero(curve.fold) == folds
    assert residual.count == (2 if folds == 0 else 1)
    assert np.all(curve.determinant[~curve.fold] == 1) == (folds == 0)


class Turned(Growing):
    """x = p, or with fewer unknowns p = 3 - 2 x: the curve passes the same point the other way."""

    def adapt(self, x, p):
        before, self.count = self.count, 1
        return before == 2

    def restore(self):
        self.count = 2

    def value(self, x, p):
        return np.array([x[0] - p, x[1]]) if self.count == 2 else np.array([3 - 2 * x[0] - p])

    def linearised(self, x, p):
        matrix = [[1.0, 0.0], [0.0, 1.0]] if self.count == 2 else [[-2.0]]
        return self.value(x, p), np.array(matrix), np.array([-1.0, 0.0][: self.count])


def test_fewer_unknowns_do_not_lead_to_the_other_side_of_a_fold():
    residual = Turned(0.0)
    residual.restore()
    corrector = Corrector(residual, CONTROLS, 1.0, np.array([1.0, 0.0]))
    point = corrector.damped_newton(np.array([1.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    assert corrector.adapted(point) is point
    assert residual.count == 2


class Undecided(Growing):
    """One that asks for the other number of unknowns each time."""

    def adapt(self, x, p):
        self.count = 3 - self.count
        return True

    def restore(self):
        self.count = 3 - self.count


@pytest.mark.parametrize("count", [1, 2])
def test_where_each_number_of_unknowns_asks_for_the_other_the_larger_stays(count):
    residual = Undecided(0.02)
    residual.count = count
    corrector = Corrector(residual, CONTROLS, 1.0, np.array([1.0, 0.02]))
    point = corrector.damped_newton(np.array([1.0, 0.02, 1.0]), np.array([0.0, 0.0, 1.0]))
    adapted = corrector.adapted(point)
    assert residual.count == 2
    assert (adapted is point) == (count == 2)
    x, p = corrector.unscaled(adapted.y)
    np.testing.assert_allclose(residual.value(x, p), 0.0, atol=1e-9)


def test_where_the_way_ends_more_unknowns_lead_on():
    residual = Growing(0.02, wall=-1.0)
    curve = follow(residual, np.array([-1.5, 0.0]), -2.0, 2.0, CONTROLS)
    assert curve.complete, curve.message
    assert np.all(curve.x[curve.p < -1.0, 1] == 0)
    np.testing.assert_allclose(curve.x[curve.p > -0.9, 1], 0.02 * curve.x[curve.p > -0.9, 0], atol=1e-7)
    assert curve.p.size < 200


def test_a_false_fold_that_more_unknowns_do_not_lead_past_is_passed_without_them(monkeypatch):
    monkeypatch.setattr(Corrector, "refined", lambda *given: None)
    residual = Growing(0.02)
    curve = follow(residual, np.array([-1.5, 0.0]), -2.0, 2.0, CONTROLS)
    assert curve.complete, curve.message
    assert np.count_nonzero(curve.fold) == 2
    assert residual.count == 1


def test_more_unknowns_that_lead_nowhere_are_given_back():
    residual = Growing(np.nan, wall=-1.0)
    curve = follow(residual, np.array([-1.5, 0.0]), -2.0, 2.0, CONTROLS)
    assert curve.ending is Ending.STEP
    assert residual.count == 1


@dataclass
class CloseBranches:
    """y^3 - 3 y = p with x = 1 + y / 50: a third branch that ends at p = -1.5 a little above the first."""

    width: float = 0.02

    def value(self, x, p):
        y = (x - 1) / self.width
        return (y**3 - 3 * y - p) * (self.width if y[0] < 1 or p < -1.5 else np.nan)

    def linearised(self, x, p):
        return self.value(x, p), np.array([[3 * ((x[0] - 1) / self.width) ** 2 - 3]]), np.array([-self.width])


class Hole:
    """x = p but for a small part of the range, where there is nothing."""

    def value(self, x, p):
        return np.where(0.5 < p < 0.51, np.nan, x - p)

    def linearised(self, x, p):
        return self.value(x, p), np.eye(1), np.array([-1.0])


@pytest.mark.parametrize("max_step", [0.2, Controls.max_step, 0.008, 0.003])
def test_how_wide_a_place_is_jumped_over_does_not_follow_from_how_short_steps_are_to_be(max_step):
    controls = Controls(size=0.1, first_step=max_step / 5, max_step=max_step)
    curve = follow(Hole(), np.zeros(1), 0.0, 1.0, controls)
    assert curve.complete, curve.message
    assert np.abs(np.diff(curve.p)).max() < max(max_step, 0.03)


def test_a_curve_does_not_jump_to_where_it_has_been():
    """At the end of the third branch the first is near, ahead and of the same orientation: it would begin again."""
    controls = Controls(size=0.1, max_points=400)
    curve = follow(CloseBranches(), np.array([0.94]), -10.0, 10.0, controls)
    assert curve.ending is Ending.STEP
    assert np.count_nonzero(curve.fold) == 2
    assert curve.p[-1] == pytest.approx(-1.5, abs=1e-3)


@dataclass
class Interior(CloseBranches):
    """The first branch ends before its fold, next to the second, which leads back; the third is not there."""

    def value(self, x, p):
        y = (x[0] - 1) / self.width
        return np.array([(y**3 - 3 * y - p) * (self.width if y < -1.3 or abs(y) < 1 else np.nan)])


def test_a_curve_does_not_jump_to_where_it_would_go_back():
    """On the second branch the parameter may rise too, but with another orientation."""
    curve = follow(Interior(), np.array([0.94]), -10.0, 10.0, Controls(size=0.1, max_points=400))
    assert curve.ending is Ending.STEP
    assert curve.p[-1] == pytest.approx(3 * 1.3 - 1.3**3, abs=1e-3)
    assert np.all(curve.determinant == 1)


class Moving:
    """x^3 - slope x + x' = p, where x' = shift, or 0 as long as it is not in use: for x up to a place."""

    def __init__(self, slope, place, shift):
        self.slope, self.place, self.shift, self.count = slope, place, shift, 1

    @property
    def active(self):
        return np.arange(self.count)

    def begin(self, x):
        self.count = 1

    def adapt(self, x, p):
        before, self.count = self.count, 1 + int(x[0] > self.place)
        return self.count != before

    def refine(self):
        return False

    def restore(self):
        self.count = 1

    def refuses(self, x, p):
        return False

    def value(self, x, p):
        force = x[0] ** 3 - self.slope * x[0] - p
        return np.array([force] if self.count == 1 else [force + x[1], x[1] - self.shift])

    def linearised(self, x, p):
        slope = 3 * x[0] ** 2 - self.slope
        matrix = [[slope, 1.0], [0.0, 1.0]] if self.count == 2 else [[slope]]
        return self.value(x, p), np.array(matrix), np.array([-1.0, 0.0][: self.count])


@pytest.mark.parametrize("shift", [-0.05, 0.05])
@pytest.mark.parametrize("place", [-0.3, -0.1, 0.0, 0.1, 0.3])
@pytest.mark.parametrize(("slope", "folds"), [(-0.5, 0), (0.06, 2)])
def test_other_unknowns_that_move_the_parameter_make_no_folds(slope, folds, place, shift):
    """Nor do they hide any: the two are 0.011 apart, on either side of the place or both on one."""
    controls = Controls(size=0.1, max_step=0.01)
    curve = follow(Moving(slope, place, shift), np.array([-1.5, 0.0]), -2.0, 2.0, controls)
    assert curve.complete, curve.message
    assert np.count_nonzero(curve.fold) == folds
    assert np.abs(np.diff(curve.p)).max() < 0.06
    middle = curve.branch == 1
    np.testing.assert_array_equal(curve.determinant[~curve.fold], np.where(middle, -1, 1)[~curve.fold])


class Late(Moving):
    """The same, but only from a second place on is there a solution with x'."""

    def __init__(self):
        super().__init__(-0.5, -0.3, 0.05)
        self.asked = 0

    def adapt(self, x, p):
        self.asked += self.count == 1 and x[0] > self.place
        return super().adapt(x, p)

    def value(self, x, p):
        return super().value(x, p) * (np.nan if self.count == 2 and x[0] < 0.1 else 1.0)


@pytest.mark.parametrize("strict", [False, True])
def test_no_curve_begins_where_more_unknowns_have_no_solution_if_that_is_refused(strict):
    residual = Late()
    residual.refuses = lambda x, p: strict
    curve = follow(residual, np.array([0.0, 0.0]), 0.0, 2.0, Controls(size=0.1, max_step=0.01))
    assert curve.ending is (Ending.START if strict else Ending.COMPLETE)


def test_other_unknowns_that_have_no_solution_yet_are_asked_for_again():
    """After two points, then four, ...: in vain, each of them would cost more than the point itself."""
    residual = Late()
    curve = follow(residual, np.array([-1.5, 0.0]), -2.0, 2.0, Controls(size=0.1, max_step=0.01))
    assert curve.complete, curve.message
    in_vain = np.count_nonzero((curve.x[:, 0] > -0.3) & (curve.x[:, 0] < 0.1))
    assert 3 <= residual.asked <= np.log2(in_vain) + 2
    assert not curve.fold.any()
    later = curve.x[:, 0] > 0.1 + (0.1 + 0.3)
    np.testing.assert_allclose(curve.x[later, 1], 0.05)
    assert np.all(curve.x[curve.x[:, 0] < 0.1, 1] == 0)


def test_what_ends_a_curve_names_keys_with_their_section():
    keys = [word for ending in Ending for word in re.findall(r"[\w.]*(?:min_|max_)\w+", ending.value)]
    assert {"continuation.min_step", "continuation.max_step", "continuation.max_points"} <= set(keys)
