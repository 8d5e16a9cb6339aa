"""Pseudo-arclength continuation of the solutions of ``r(x, p) = 0`` in a parameter p, around folds.

Any residual with its derivatives will do. Both x and p are measured in units of their own (see `Controls.size`), so
that a step is a step in either. From a point with the unit tangent t the next one is sought at the distance s,

    r(x, p) = 0,    t . ((x, p) - predicted) = 0

The predictor is of second order: the tangent, and how it has turned over the step before. The step follows the turn of
the tangent and the convergence of Newton's method (`timesim.hbm.continuation.corrector`). Folds are points of the curve
(`timesim.hbm.continuation.trace`).

H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems, in: P. H. Rabinowitz (ed.),
Applications of Bifurcation Theory (Academic Press 1977) 359-384, for the arclength; E. L. Allgower and K. Georg,
Introduction to Numerical Continuation Methods (SIAM 2003), chapters 2 and 6, for predictor and step.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from timesim.hbm.continuation.bordered import Array
from timesim.hbm.continuation.corner import STRAIGHT, around_corner
from timesim.hbm.continuation.corrector import Controls, Corrector, CurvePoint
from timesim.hbm.continuation.other_end import FromEnd, OtherEnd
from timesim.hbm.continuation.residual import NoSolutionError, Residual
from timesim.hbm.continuation.solutions import Curve, Ending, joined, part_of
from timesim.hbm.continuation.step import Step, predicted
from timesim.hbm.continuation.trace import Trace

# Lengths of a jump over a place where the residual is not smooth, as shares of the longest step, tried in turn; of the
# default one at least: such a place is as wide where steps are to be short.
JUMPS = (0.02, 0.06, 0.2, 0.6, 1.0)
# Share of the way over such a place that lies along the tangent behind it, where the way is long.
ALONG = 0.9
# Distance of two solutions that are one, relative to their size; and if their numbers of harmonics may differ.
SAME, MEET = 1e-5, 1e-3
# Longest step over which the orientation of the curve may change, as at a bifurcation: a longer one leads to another
# part of it, as beside a corner at which it turns back.
BRANCHING = 1e-6
# Iterations of Newton's method from which on the next step is shorter.
SLOW = 6
# Folds in a row that a curve has passed before, from which on it goes round and round.
ROUND = 2
# Size of a solution against that of the first one above which the curve goes to infinity.
UNBOUNDED = 1e10
# Growth of a step at most, and of one that is shorter than the first, as behind a corner.
GROWTH, CATCHING_UP = 1.6, 3.0


def follow(
    residual: Residual,
    guess: Array,
    start: float,
    stop: float,
    controls: Controls,
    *,
    behind: float | None = None,
    from_end: FromEnd | None = None,
) -> Curve:
    """Follow the solution near a guess from one value of the parameter to another, around folds.

    Args:
        guess: near a solution at `start`, shape (n,).
        start, stop: range of the parameter; the curve begins at `start`, which may be the larger.

    Keyword Args:
        behind: the other end of the range where the curve begins inside it; `start` by default. Such a curve may also
            end there, or where it began.
        from_end: begins to follow the curve from `stop` meanwhile, once this one takes long; where they meet it ends.

    Returns:
        The curve; if it could not be followed to its end, the part that could, with the reason and the place.

    Raises:
        ValueError: the range is empty or the guess is not a finite vector.
    """
    behind = start if behind is None else behind
    if not np.isfinite([start, stop, behind]).all() or stop in (start, behind):
        raise ValueError(f"continuation: the range must have two different finite ends, not {start} and {stop}")
    if guess.ndim != 1 or not np.isfinite(guess).all():
        raise ValueError(f"continuation: the guess must be a vector of finite numbers, not of shape {guess.shape}")
    tracker = _PathTracker(residual, guess, controls, start, stop, behind)
    tracker.other = OtherEnd(from_end, stop)
    try:
        return tracker.curve()
    finally:
        tracker.other.give_up()


def follow_both_ways(
    residual: Residual, guess: Array, start: float, ends: tuple[float, float], controls: Controls
) -> Curve:
    """Follow the solution near a guess inside a range to both sides: one curve, the second side's points reversed.

    This reaches isolated curves, which may be closed. Arguments and errors as in `follow`.
    """
    ahead = follow(residual, guess, start, ends[1], controls, behind=ends[0])
    if ahead.ending in (Ending.START, Ending.CLOSED, Ending.INTERRUPTED):
        return ahead
    try:
        back = follow(residual, ahead.x[0], start, ends[0], controls, behind=ends[1])
    except KeyboardInterrupt:
        message = f"{ahead.message}; {Ending.INTERRUPTED.value} on the other side"
        return replace(ahead, ending=Ending.INTERRUPTED, message=message)
    if back.ending is Ending.CLOSED:
        return back
    worse = ahead if back.complete else back
    whole = joined([part_of(back, slice(None, 0, -1)), ahead])
    return replace(whole, ending=worse.ending, message=worse.message)


class _PathTracker:
    """A curve while it is followed."""

    def __init__(self, residual: Residual, guess: Array, controls: Controls, start: float, stop: float, behind: float):
        self.corrector = Corrector(residual, controls, abs(stop - behind), guess)
        self.guess, self.controls = guess, controls
        self.start, self.stop, self.behind = start, stop, behind
        self.other = OtherEnd(None, stop)
        self.sign = float(np.sign(stop - start))
        self.ahead = np.append(np.zeros(guess.size), self.sign)  # normal of a plane of constant p
        self.trace = Trace(self.corrector, self.sign)
        self._around_corner = partial(around_corner, self.corrector, controls)
        self.reached = 0.0  # share of the range
        self.first_size = 0.0  # of the first solution

    def curve(self) -> Curve:
        """From the guess to the end."""
        if self.corrector.adaptive is not None:
            self.corrector.adaptive.begin(self.guess)
        try:
            point = self.corrector.damped_newton(self.corrector.in_units(self.guess, self.start), self.ahead)
        except NoSolutionError:
            return self._curve(Ending.START)
        point = self.corrector.adapted(point, self.ahead)
        adaptive, (x, p) = self.corrector.adaptive, self.corrector.unscaled(point.y)
        if adaptive is not None and self.corrector.failures and adaptive.refuses(x, p):
            return self._curve(Ending.START)
        self.corrector.recentre(x)
        self.first_size = self.corrector.size_of(x)
        self._keep(point)
        try:
            return self._curve(self._follow(point))
        except KeyboardInterrupt:
            return self._curve(Ending.INTERRUPTED)

    def _curve(self, ending: Ending) -> Curve:
        solutions = self.trace.solutions[: self.controls.max_points]
        place = self.controls.place.format(solutions[-1][1] if solutions else self.start)
        points = f"{len(solutions)} point{'s' * (len(solutions) != 1)}"
        message = f"continuation at {place}, after {points}: {ending.value}"
        return Curve.of(solutions, self.guess.size, ending, message, self.other.joined)

    def _keep(self, point: CurvePoint, moved: float = 0.0) -> None:
        self.trace.add(point, moved)
        p = self.corrector.unscaled(point.y)[1]
        self.reached = max(self.reached, (p - self.start) / (self.stop - self.start))
        self.other.count(self.corrector.num_in_use, p)
        if self.controls.watch is not None:
            reached = self.reached + self.other.reached / abs(self.stop - self.start)
            self.controls.watch(min(reached, 1.0), partial(self._curve, Ending.INTERRUPTED))

    def _follow(self, point: CurvePoint) -> Ending:
        """From the first point to the end; how the curve ends."""
        length, ending = self.controls.first_step, None
        before: tuple[CurvePoint, float] | None = None
        while ending is None:
            x = self.corrector.unscaled(point.y)[0]
            if not 0.6 < self.corrector.size_of(x) / self.corrector.x_unit < 1.6:
                factor, before = self.corrector.rescale(x), None
                point = point.rescaled(factor)
                self.trace.rescale(factor)
            step = self._step(point, before, length)
            if step is None or self.corrector.is_false_fold(point, step.point):
                if (finer := self.corrector.refined(point, self.ahead)) is not None:
                    point, before, length = finer, None, self.controls.first_step
                    continue
                if step is None:
                    return Ending.STEP
            adapted = self.corrector.adapted(step.point)
            step = replace(step, point=adapted, moved=adapted.y[-1] - step.point.y[-1])
            ending = self._take(point, step)
            before = None if step.corner else (point, step.length)
            point, length = step.point, step.next_length
        return ending

    def _step(self, point: CurvePoint, before: tuple[CurvePoint, float] | None, length: float) -> Step | None:
        """To the next point; None if there is none."""
        length = max(min(length, self._longest(point)), self.controls.min_step)
        while length >= self.controls.min_step:
            try:
                guess = predicted(point, before, length)
                new = self.corrector.simplified_newton(guess, point.tangent, known=point.factors)
            except NoSolutionError:
                if (step := self._around_corner(point, length)) is not None:
                    return step
                length /= 4
                continue
            turn = float(np.arccos(np.clip(point.tangent @ new.tangent, -1.0, 1.0)))
            # Of a step over which contacts that stuck come apart both ends may be flat: their tangents tell nothing.
            beside = bool(np.linalg.norm(new.y - guess) > length)
            elsewhere = beside or new.orientation * point.orientation < 0
            if turn > self.controls.turn * (0.5 if elsewhere else 2) or (elsewhere and length > BRANCHING):
                if (step := self._around_corner(point, length, new)) is not None:
                    return step
                length /= 3
                continue
            fastest = GROWTH if length > self.controls.first_step else CATCHING_UP
            growth = np.clip(np.sqrt(self.controls.turn / max(turn, 1e-9)), 0.5, fastest)
            if new.iterations > SLOW:
                growth = min(growth, 0.7)
            return Step(new, length, min(float(growth) * length, self.controls.max_step))
        return self._jump(point)

    def _longest(self, point: CurvePoint) -> float:
        """Length of arc that leads as far along the parameter as a step may from there."""
        if self.controls.longest is None:
            return np.inf
        x, p = self.corrector.unscaled(point.y)
        way = self.controls.longest(p, x) / self.corrector.p_unit
        return float(way / max(abs(point.tangent[-1]), 1e-300))

    def _jump(self, point: CurvePoint) -> Step | None:
        """Over a place where no short step succeeds; a point to which the way is not along its tangent is elsewhere.

        The derivatives may mean little where it starts: after the tangent, a change of the parameter alone is tried,
        the way it went before, with x a little larger or smaller.
        """
        ahead = self.ahead * (self.sign * self.trace.direction)
        longest = max(self.controls.max_step, Controls.max_step)
        for length in longest * np.array(JUMPS):
            guesses = [(point.y + length * point.tangent, point.tangent)]
            for factor in (1 + length, 1 - length, 1 + 4 * length):
                larger = point.y[:-1] + (factor - 1) * (point.y[:-1] - self.corrector.centre / self.corrector.x_unit)
                guesses.append((np.append(larger, point.y[-1] + length / 4 * ahead[-1]), ahead))
            for guess, normal in guesses:
                try:
                    new = self.corrector.full_newton(guess, normal)
                except NoSolutionError:
                    continue
                way = new.y - point.y
                distance = float(np.linalg.norm(way))
                near = distance <= 8 * length or ALONG * distance <= abs(way @ new.tangent) <= self.controls.max_step
                onwards = way[-1] * ahead[-1] > 0 and new.orientation * point.orientation >= 0
                if near and onwards and not self._is_known(new):
                    return Step(new, distance, length)
        return None

    def _is_known(self, point: CurvePoint) -> bool:
        """Whether the curve passed a point before."""
        rows = np.array([self.corrector.in_units(x, p) for x, p, *_ in self.trace.solutions])
        first, way = rows[:-1], np.diff(rows, axis=0)
        square = np.maximum(np.sum(way**2, axis=1), 1e-300)
        share = np.clip(np.sum((point.y - first) * way, axis=1) / square, 0.0, 1.0)
        distance = np.linalg.norm(first + share[:, None] * way - point.y, axis=1)
        return bool(np.any(distance <= STRAIGHT * np.sqrt(square)))

    def _take(self, before: CurvePoint, step: Step) -> Ending | None:
        """Keep the point that a step leads to, or the end of the range before it; how the curve ends, if it does."""
        point, inside = step.point, self.behind != self.start
        if inside and (again := self._start_again(before, point)) is not None:
            self._keep(again)
            return Ending.CLOSED
        if self._meets_other(before, point):
            return Ending.COMPLETE
        p = self.corrector.unscaled(point.y)[1]
        behind = Ending.COMPLETE if inside else Ending.LEFT
        for end, side, ending in ((self.stop, 1, Ending.COMPLETE), (self.behind, -1, behind)):
            if side * self.sign * (p - end) >= 0:
                last = self._between(before, point, end)
                if last is None:
                    return Ending.STEP
                self._keep(last)
                return ending
        self._keep(point, step.moved)
        if self.trace.again >= ROUND:
            return Ending.AGAIN
        if self.corrector.size_of(self.corrector.unscaled(point.y)[0]) > UNBOUNDED * self.first_size:
            return Ending.UNBOUNDED
        return Ending.POINTS if len(self.trace.solutions) >= self.controls.max_points else None

    def _meets_other(self, before: CurvePoint, after: CurvePoint) -> bool:
        """Whether the curve from the other end ends between two points; then this one goes on as that."""
        middle, places = self.other.middle, [self.corrector.unscaled(point.y)[1] for point in (before, after)]
        if middle is None or not self.sign * (places[0] - middle) < 0 <= self.sign * (places[1] - middle):
            return False
        if (last := self._between(before, after, middle)) is None:
            return False
        x, p = self.corrector.unscaled(last.y)
        rest = self.other.rest_from(x, p, MEET * self.corrector.size_of(x))
        if rest is None or len(self.trace.solutions) + len(rest) >= self.controls.max_points:
            return False
        self._keep(last)
        self.trace.solutions += rest
        self.other.joined = len(rest)
        return True

    def _start_again(self, before: CurvePoint, after: CurvePoint) -> CurvePoint | None:
        """The point where the curve began, if it comes through it again in the same direction."""
        start, solutions = self.start / self.corrector.p_unit, self.trace.solutions
        before_start, behind_start = ((point.y[-1] - start) * self.sign for point in (before, after))
        if len(solutions) < 4 or not before_start < 0 <= behind_start:
            return None
        last = self._between(before, after, self.start)
        if last is None:
            return None
        x = self.corrector.unscaled(last.y)[0]
        return last if np.linalg.norm(x - solutions[0][0]) < SAME * self.corrector.size_of(x) else None

    def _between(self, before: CurvePoint, after: CurvePoint, p: float) -> CurvePoint | None:
        """The solution at a value of the parameter between two points."""
        share = (p / self.corrector.p_unit - before.y[-1]) / (after.y[-1] - before.y[-1])
        guess = before.y + share * (after.y - before.y)
        guess[-1] = p / self.corrector.p_unit
        onwards = np.append(np.zeros(self.guess.size), np.sign(after.y[-1] - before.y[-1]))
        try:
            return self.corrector.damped_newton(guess, onwards)
        except NoSolutionError:
            return None
