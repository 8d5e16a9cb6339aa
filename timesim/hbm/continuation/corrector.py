"""Newton's method for one point of a curve of solutions ``r(x, p) = 0``, on a plane that cuts the curve.

With y = (x, p), each in units of its own, a solution is sought on the plane through a guess y0 with the normal b,

    r(y) = 0,    b . (y - y0) = 0

The Jacobian of both together, dr/dy bordered by the row b, is regular at a fold as well, where dr/dx is not (Keller
1977). From its LU factors follow the tangent t of the curve, ``dr/dy t = 0, b . t = 1``, and, by Cramer's rule, the
sign of det dr/dx, which changes at a fold.
"""

from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from timesim.hbm.continuation.bordered import Array, Bordered
from timesim.hbm.continuation.residual import Adaptive, Centred, NoSolutionError, Residual
from timesim.hbm.scheme import Controls

# A Newton step that is longer than this share of the one before asks for new derivatives.
CONTRACTION = 0.1
MAX_DAMPED, MAX_FULL = 60, 30  # iterations
MAX_ADAPTED = 8  # changes of the unknowns in use at one point
MAX_FAILURES = 6  # of such changes, after which 2 to this power of points are not asked
# Share of the parameter in the tangent at which a fold counts as met: its own error is of second order in it.
FLAT = 1e-6
MAX_FOLD = 12  # evaluations; at a corner the bracket only shrinks to a share of itself each time
# A Newton step this long, in units of the solution, leads nowhere.
MAX_STEP = 10.0
# Residual relative to the norm of x, its centre included, that is rounding, and the share of the size of x up to which
# it may be. Beyond it x has run away, as where constant forces drive a body that nothing holds.
ROUNDING, MOST_ROUNDING = 1e-14, 1e-6


@dataclass(frozen=True)
class CurvePoint:
    """A solution y = (x, p) in units, with the unit tangent, the sign of det dr/dx and the iterations that it took.

    `factors`: those by which the last of these stepped, unless the units are others now.
    """

    y: Array
    tangent: Array
    determinant: int
    iterations: int
    factors: Bordered | None = field(default=None, repr=False, compare=False)

    def rescaled(self, factor: float) -> "CurvePoint":
        """The point with another unit of x."""
        y, tangent = self.y.copy(), self.tangent.copy()
        y[:-1] *= factor
        tangent[:-1] *= factor
        return replace(self, y=y, tangent=tangent / np.linalg.norm(tangent), factors=None)

    @property
    def orientation(self) -> float:
        """Its sign stays the same along a curve, but for bifurcations (Allgower and Georg 2003, chapter 2)."""
        return self.determinant * float(self.tangent[-1])


class Corrector:
    """Newton's method for a residual in units, y = (x / x_unit, p / p_unit)."""

    def __init__(self, residual: Residual, controls: Controls, p_unit: float, x: Array):
        """For solutions about as large as x."""
        self.residual, self.controls, self.p_unit = residual, controls, p_unit
        self.adaptive = residual if isinstance(residual, Adaptive) else None
        self.centred = residual if isinstance(residual, Centred) else None
        self.size, self.centre = x.size, np.zeros(x.size)
        self.recentre(x)
        self.x_unit = self.size_of(x)
        self.failures = self.unasked = 0  # of `adapted`: in a row, and points that it lets pass

    @property
    def num_in_use(self) -> int:
        """Unknowns in use."""
        return self.size if self.adaptive is None else self.adaptive.active.size

    def recentre(self, x: Array) -> None:
        """Measure solutions about the centre of one from now on."""
        if self.centred is not None:
            self.centre = self.centred.centre(x)

    def size_of(self, x: Array) -> float:
        """By which a solution is measured."""
        return max(self.controls.size, float(np.linalg.norm(x - self.centre)))

    def in_units(self, x: Array, p: float) -> Array:
        """y of a point."""
        return np.append(x / self.x_unit, p / self.p_unit)

    def unscaled(self, y: Array) -> tuple[Array, float]:
        """x and p of a point."""
        return y[:-1] * self.x_unit, float(y[-1] * self.p_unit)

    def rescale(self, x: Array) -> float:
        """Measure x by the size of a solution from now on; the unit before, in units of the one that holds now."""
        before, self.x_unit = self.x_unit, self.size_of(x)
        return before / self.x_unit

    def simplified_newton(
        self, guess: Array, normal: Array, *, fresh: bool = False, known: Bordered | None = None
    ) -> CurvePoint:
        """Solution near a good guess on the plane through it; its tangent points to the side of the normal.

        Derivatives are kept as long as the steps contract fast with them; `fresh` evaluates them anew at the solution,
        for an exact tangent. A first step by those `known` from a solution nearby saves evaluations.

        Raises:
            NoSolutionError: the steps grow, or there are too many.
        """
        y = guess = self._in_use(guess)
        if known is not None and known.row.size == self._gathered(y).size:
            y = y + self._step(known, self._value(y), 0.0)
        before, outdated = np.inf, True
        for count in range(self.controls.max_newton + 1):
            if outdated:
                r, factors = self._bordered(y, normal)
            else:
                r = self._value(y)
            if self._vanishes(r, y):
                if fresh and count:
                    factors = self._bordered(y, normal)[1]
                return self._point(y, factors, count)
            step = self._step(factors, r, float(normal @ (guess - y)))
            size = float(np.linalg.norm(step))
            if not np.isfinite(size) or size > 2 * before:
                break
            y, before, outdated = y + step, size, size > CONTRACTION * before
        raise NoSolutionError

    def full_newton(self, guess: Array, normal: Array) -> CurvePoint:
        """The same where the residual is hardly smooth: new derivatives at each step, and steps may grow.

        Raises:
            NoSolutionError: a step is far too long, or there are too many.
        """
        y = guess = self._in_use(guess)
        for count in range(MAX_FULL):
            r, factors = self._bordered(y, normal)
            if self._vanishes(r, y):
                return self._point(y, factors, count)
            step = self._step(factors, r, float(normal @ (guess - y)))
            if not float(np.linalg.norm(step)) < MAX_STEP:
                break
            y = y + step
        raise NoSolutionError

    def linear_ahead(self, point: CurvePoint, length: float) -> CurvePoint:
        """Where derivatives some way ahead of a point lead, on the plane across its tangent, and the tangent there.

        Its direction keeps the orientation (see `CurvePoint.orientation`), and may lead back.

        Raises:
            NoSolutionError: they are singular.
        """
        ahead = self._in_use(point.y + length * point.tangent)
        r, factors = self._bordered(ahead, point.tangent)
        found = self._point(ahead + self._step(factors, r, 0.0), factors, 0)
        return replace(found, tangent=-found.tangent) if found.orientation * point.orientation < 0 else found

    def adapted(self, point: CurvePoint, normal: Array | None = None) -> CurvePoint:
        """A solution by as many unknowns as it asks for, on the plane through it, normal to its tangent by default.

        Where there is none with them it stays what it is, and the next points are not asked, more and more of them.
        """
        if self.adaptive is None or self.unasked > 0:
            self.unasked -= 1
            return point
        known = {self.num_in_use: point}
        for _ in range(MAX_ADAPTED):
            before = self.num_in_use
            if not self.adaptive.adapt(*self.unscaled(point.y)):
                break
            if self.num_in_use in known:  # neither solution asks for its own number: that with more stays
                if self.num_in_use < before:
                    self.adaptive.restore()
                else:
                    point = known[self.num_in_use]
                break
            try:
                new = self.newton_near(point.y, point.tangent if normal is None else normal)
                if new.orientation * point.orientation < 0:  # a fold of one of them lies between
                    raise NoSolutionError
                known[self.num_in_use] = point = new
            except NoSolutionError:
                self.adaptive.restore()
                self.failures = min(self.failures + 1, MAX_FAILURES)
                self.unasked = 2**self.failures
                return point
        self.failures = 0
        return point

    def refined(self, point: CurvePoint, ahead: Array) -> CurvePoint | None:
        """The solution at the same p by more unknowns, its tangent along the curve as before; None if there is none."""
        if self.adaptive is None:
            return None
        steps = 0
        while self.adaptive.refine():
            steps += 1
            with suppress(NoSolutionError):
                new = self.newton_near(point.y, ahead)
                return new if new.orientation * point.orientation > 0 else replace(new, tangent=-new.tangent)
        for _ in range(steps):
            self.adaptive.restore()
        return None

    def is_false_fold(self, before: CurvePoint, after: CurvePoint) -> bool:
        """Whether the curve turns between two points, but would not by a few more unknowns."""
        if before.tangent[-1] * after.tangent[-1] > 0 or self.adaptive is None or not self.adaptive.refine():
            return False
        determinant = after.determinant
        with suppress(NoSolutionError):
            determinant = self.newton_near(after.y, after.tangent).determinant
        self.adaptive.restore()
        return determinant != after.determinant

    def newton_near(self, guess: Array, normal: Array) -> CurvePoint:
        """Solution near a guess that is good in most cases, as by a few more unknowns than those of a solution.

        Raises:
            NoSolutionError: as of `damped_newton`, which takes over where derivatives do not hold for long.
        """
        try:
            return self.simplified_newton(guess, normal, fresh=True)
        except NoSolutionError:
            return self.damped_newton(guess, normal)

    def damped_newton(self, guess: Array, normal: Array) -> CurvePoint:
        """Solution on the plane through a poor guess: steps are halved until the next is shorter, or taken in full.

        The next one by the derivatives at hand: unlike the residual, it does not depend on how stiff contacts are
        against the structure (the natural monotonicity test of Deuflhard, Newton Methods for Nonlinear Problems, 2004).

        Raises:
            NoSolutionError: neither leads to a solution.
        """
        try:
            return self._damped_newton(guess, normal)
        except NoSolutionError:
            return self.full_newton(guess, normal)

    def _damped_newton(self, guess: Array, normal: Array) -> CurvePoint:
        y = self._in_use(guess)
        r, factors = self._bordered(y, normal)
        for count in range(MAX_DAMPED):
            if self._vanishes(r, y):
                return self._point(y, factors, count)
            step = self._step(factors, r, 0.0)
            for share in 0.5 ** np.arange(12):
                onwards = self._step(factors, self._value(y + share * step), 0.0)
                if np.linalg.norm(onwards) < (1 - 0.25 * share) * np.linalg.norm(step):
                    break
            else:
                raise NoSolutionError
            y = y + share * step
            r, factors = self._bordered(y, normal)
        raise NoSolutionError

    def fold_between(self, low: CurvePoint, high: CurvePoint) -> CurvePoint:
        """The point between two others at which the parameter turns, which it does where the cubic through them does.

        Raises:
            NoSolutionError: Newton's method fails, or the curve turns by more than a right angle: no cubic does.
        """
        if low.tangent @ high.tangent <= 0:
            raise NoSolutionError
        first, normal = low, low.tangent
        for _ in range(MAX_FOLD):
            begin, length = (low.y - first.y) @ normal, (high.y - low.y) @ normal
            change, *rates = high.y - low.y, *(length / (x.tangent @ normal) * x.tangent for x in (low, high))
            bend, third = 3 * change - 2 * rates[0] - rates[1], rates[0] + rates[1] - 2 * change
            # p' has one root inside, since it differs in sign at both ends.
            slope, half, lead = rates[0][-1], bend[-1], 3 * third[-1]
            root = slope / (np.sign(slope) * np.sqrt(max(half**2 - lead * slope, 0.0)) - half)
            t = float(np.clip(root, 0.02, 0.98))
            guess = low.y + t * (rates[0] + t * (bend + t * third))
            guess += (begin + t * length - (guess - first.y) @ normal) * normal
            point = self.simplified_newton(guess, normal, fresh=True)
            if abs(point.tangent[-1]) < FLAT:
                return point
            low, high = (point, high) if point.tangent[-1] * low.tangent[-1] > 0 else (low, point)
        return min(low, high, key=lambda point: abs(point.tangent[-1]))

    def _vanishes(self, r: Array, y: Array) -> bool:
        x = self.unscaled(y)[0]
        waves = x if self.centred is None else x - self.centred.centre(x)  # about its own centre, wherever it has gone
        size, rounding = max(self.controls.size, float(np.linalg.norm(waves))), ROUNDING * float(np.linalg.norm(x))
        near = bool(np.linalg.norm(r) <= self.controls.tolerance * size + rounding)
        return near and rounding <= MOST_ROUNDING * size

    def _in_use(self, y: Array) -> Array:
        """A vector whose other unknowns are zero."""
        return y if self.adaptive is None else self._spread(self._gathered(y))

    def _gathered(self, y: Array) -> Array:
        """The unknowns in use, and the parameter."""
        return y if self.adaptive is None else np.append(y[:-1][self.adaptive.active], y[-1])

    def _spread(self, own: Array) -> Array:
        """All unknowns and the parameter, from those in use."""
        if self.adaptive is None:
            return own
        y = np.zeros(self.size + 1)
        y[:-1][self.adaptive.active], y[-1] = own[:-1], own[-1]
        return y

    def _point(self, y: Array, factors: Bordered, count: int) -> CurvePoint:
        tangent, sign = factors.tangent()
        return CurvePoint(y, self._spread(tangent), sign, count, factors)

    def _value(self, y: Array) -> Array:
        return self.residual.value(*self.unscaled(self._gathered(y)))

    def _bordered(self, y: Array, normal: Array) -> tuple[Array, Bordered]:
        """r, and the derivatives of r / x_unit by y with `normal` as the last row."""
        try:
            r, by_x, by_p = self.residual.linearised(*self.unscaled(self._gathered(y)))
            return r, Bordered(by_x, by_p * (self.p_unit / self.x_unit), self._gathered(normal))
        except np.linalg.LinAlgError:
            raise NoSolutionError from None

    def _step(self, factors: Bordered, r: Array, off_plane: float) -> Array:
        return self._spread(factors.solve(-r / self.x_unit, off_plane))
