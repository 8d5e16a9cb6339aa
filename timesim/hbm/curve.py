"""Response curves by harmonic balance: motion, contact states, folds and stability of the solutions along them.

The balance is `timesim.hbm.balance`, the way along the curve `timesim.hbm.continuation`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.adaptive import AdaptiveBalance
from timesim.hbm.balance import Balance
from timesim.hbm.continuation import (
    Controls,
    Curve,
    Elsewhere,
    Ending,
    follow,
    follow_both_ways,
    joined,
    part_of,
)
from timesim.hbm.first_guess import curve_near
from timesim.hbm.period import contact_forces
from timesim.hbm.scheme import Scheme, coarsest
from timesim.hbm.stability import checked_multipliers, grows, sign_with_offsets_kept, with_offsets_kept
from timesim.model.model import Model
from timesim.orbit.fourier import Array, half_range, phase_deg, to_phasors

PIECE = 128
"""Solutions that are evaluated at a time: one to three seconds of work where it takes long."""


@dataclass(frozen=True)
class HbmCurve:
    """Periodic solutions along a curve; S solutions, P points, C contacts, harmonics 0 ... H, harmonic 0 the mean.

    Attributes:
        parameter: that of the continuation, shape (S,): the frequency, or a scalar of the scene.
        frequency: of the excitation, shape (S,) [Hz].
        stable: whether disturbances die out, shape (S,).
        fold: whether the frequency turns here, unless the offset of a contact that sticks turns it, shape (S,).
        branch: folds passed before, shape (S,).
        amplitude: (max - min) / 2 of the continuous motion along x, y, z, shape (S, P, 3) [length].
        harmonic_cos, harmonic_sin: Fourier coefficients, shape (S, H + 1, P, 3) [length].
        slip_share, separation_share: of the period, shape (S, C).
        contact_motion: Fourier coefficients 1, cos, sin, ... of (u1, u2, v), shape (S, C, 3, 2H + 1) [length].
        contact_force: of (f1, f2, n), shape (S, C, 3, 2H + 1) [force].
        floquet_max: largest modulus of a Floquet multiplier, shape (S,); NaN where none was computed.
        closure: change of the elastic displacement over the period relative to its tolerance, shape (S,); at most 1
            where the hysteresis loop of every contact is closed.
        ending: why it ended.
        message: the same with the place.
    """

    parameter: Array
    frequency: Array
    stable: NDArray[np.bool_]
    fold: NDArray[np.bool_]
    branch: NDArray[np.int64]
    amplitude: Array
    harmonic_cos: Array
    harmonic_sin: Array
    slip_share: Array
    separation_share: Array
    contact_motion: Array
    contact_force: Array
    floquet_max: Array
    closure: Array
    ending: Ending
    message: str

    @property
    def complete(self) -> bool:
        """Whether the whole range was followed."""
        return self.ending.complete

    def with_harmonics(self, count: int) -> "HbmCurve":
        """The same with more harmonics, which are zero."""

        def longer(part: Array, axis: int, size: int) -> Array:
            return np.pad(part, [(0, size - part.shape[axis] if i == axis else 0) for i in range(part.ndim)])

        return replace(
            self,
            harmonic_cos=longer(self.harmonic_cos, 1, count + 1),
            harmonic_sin=longer(self.harmonic_sin, 1, count + 1),
            contact_motion=longer(self.contact_motion, 3, 2 * count + 1),
            contact_force=longer(self.contact_force, 3, 2 * count + 1),
        )

    @property
    def harmonic_amplitude(self) -> Array:
        """Amplitude of each harmonic, shape (S, H + 1, P, 3); harmonic 0 is the signed mean [length]."""
        amplitude = np.hypot(self.harmonic_cos, self.harmonic_sin)
        amplitude[:, 0] = self.harmonic_cos[:, 0]
        return amplitude

    @property
    def phase_deg(self) -> Array:
        """Phase of the first harmonic against the excitation, shape (S, P, 3) [degree]; NaN along axes that rest."""
        return phase_deg(self.harmonic_cos - 1j * self.harmonic_sin)

    @property
    def dissipated_power(self) -> Array:
        """Power lost in each contact, f times the integral of f . u' over a period, shape (S, C) [force length/time].

        Truncation leaves it exact: of the force, only the harmonics that the motion has do work on it.
        """
        u, f = (to_phasors(part[:, :, :2]) for part in (self.contact_motion, self.contact_force))
        work = -np.pi * np.sum(np.arange(u.shape[-1]) * (f.conj() * u).imag, axis=(2, 3))
        return self.frequency[:, None] * np.where(self.slip_share > 0, work, 0.0)


SoFar = Callable[..., HbmCurve]
"""Gives the solutions so far of a curve that grows; or the last ones, if it is told how many."""
Watch = Callable[[float, SoFar], None]
"""Takes in the share of the range that a curve has reached, and what gives its solutions so far."""


class Aside(Protocol):
    """Other processes that take a part of the work on a curve that takes long."""

    def part(self, model: Model, start: float, first: float, last: float) -> Elsewhere:
        """Begin `part_of_curve`."""

    def each(self, function: Callable[..., HbmCurve], pieces: Sequence[tuple[Any, Curve]], /) -> list[HbmCurve]:
        """A function of a module of some residuals and solutions of each."""


Each = Callable[[Callable[..., HbmCurve], Sequence[tuple[Any, Curve]]], list[HbmCurve]]
"""As `Aside.each`."""


def watched(controls: Controls, watch: Watch, evaluate: Callable[[Curve], HbmCurve]) -> Controls:
    """Steps of a continuation whose curve is watched while it grows."""

    def given(so_far: Callable[[], Curve], last: int = 0) -> HbmCurve:
        return evaluate(part_of(so_far(), slice(-last, None)))

    return replace(controls, watch=lambda share, so_far: watch(share, partial(given, so_far)))


def hbm_curve(
    model: Model,
    start: float,
    stop: float,
    *,
    scheme: Scheme | Sequence[Scheme] | None = None,
    controls: Controls | None = None,
    guess: Array | None = None,
    begin: float | None = None,
    stability: bool = True,
    watch: Watch | None = None,
    aside: Aside | None = None,
) -> HbmCurve:
    """Follow the periodic response of a model in frequency, around folds.

    Args:
        model: the scene; a frequency of its excitation is not used.
        start, stop: range [Hz]; the curve begins at `start`, which may be the larger.

    Keyword Args:
        scheme: harmonics and time samples; or several, with more and more harmonics, of which each solution takes the
            first that leaves out little enough.
        controls: steps of the continuation.
        guess: modal displacement at `begin` by its Fourier coefficients 1, cos, sin, ..., shape (2K + 1, M), of a
            time integration for instance: so isolated branches are reached. By default the linear response with the
            contacts stuck, absent or half as stiff, then under a load that grows from zero, then the motion to which a
            time integration settles.
        begin: frequency [Hz] in the range from which the curve is followed to both sides, or from one end to the other;
            by default it begins at `start`.
        stability: compute Floquet multipliers; without them stability follows from the sign of the determinant alone.
        watch: called while the curve grows; what it raises ends it.
        aside: processes that follow the curve from `stop` meanwhile, and evaluate its solutions, if that takes long.

    Returns:
        The curve; if the continuation fails, the part before, with the reason and the place in `message`.

    Raises:
        ValueError: the range, the scheme or the excitation does not allow a balance.
    """
    _check_range(start, stop)
    balance = AdaptiveBalance(lambda own: Balance(model, start, own), schemes_of(scheme), model.num_contacts)
    steps, place = controls or Controls(), start if begin is None else begin
    if watch is not None:
        steps = _watched_by_schemes(balance, steps, watch)
    from_end = None if aside is None else partial(aside.part, model, start, stop)

    def followed(first: Array) -> Curve:
        if start < place < stop or stop < place < start:
            return follow_both_ways(balance, first, place, (start, stop), steps)
        if np.isclose(place, stop, rtol=1e-9, atol=0.0):
            return follow(balance, first, stop, start, steps)
        return follow(balance, first, start, stop, steps, from_end=from_end)

    curve = curve_near(balance, place, place, steps, guess, followed)
    return finished(balance, curve, evaluated, stability, each_here if aside is None else aside.each)


def part_of_curve(
    model: Model, start: float, first: float, last: float, schemes: Sequence[Scheme], controls: Controls, watch: Watch
) -> Curve:
    """The curve from one frequency to another, in the unknowns of the `hbm_curve` that begins at `start`."""
    balance = AdaptiveBalance(lambda own: Balance(model, start, own), schemes, model.num_contacts)
    steps = _watched_by_schemes(balance, controls, watch)
    return curve_near(balance, first, first, steps, None, lambda x: follow(balance, x, first, last, steps))


def _watched_by_schemes(balance: AdaptiveBalance, controls: Controls, watch: Watch) -> Controls:
    """`watched` where each solution is evaluated by its own scheme."""
    return watched(controls, watch, lambda curve: by_schemes(balance, curve, partial(evaluated, stability=False)))


def left_part(model: Model, start: float, part: Curve, schemes: Sequence[Scheme], *, stability: bool) -> HbmCurve:
    """A `part_of_curve` that a curve was interrupted before it met, as another curve that was interrupted."""
    balance = AdaptiveBalance(lambda own: Balance(model, start, own), schemes, model.num_contacts)
    place = part.message.split(": ")[0]
    message = f"{place} from the other end of the range: {Ending.INTERRUPTED.value}"
    cut = replace(part, ending=Ending.INTERRUPTED, message=message)
    return finished(balance, cut, evaluated, stability)


def each_here(function: Callable[..., HbmCurve], pieces: Sequence[tuple[Any, Curve]]) -> list[HbmCurve]:
    """`Aside.each` by this process."""
    return [function(*piece) for piece in pieces]


def schemes_of(scheme: Scheme | Sequence[Scheme] | None) -> Sequence[Scheme]:
    """One or several schemes; the default is one."""
    return (scheme or Scheme(),) if scheme is None or isinstance(scheme, Scheme) else scheme


def finished(
    balance: AdaptiveBalance, curve: Curve, evaluate: Callable[..., HbmCurve], stability: bool, each: Each = each_here
) -> HbmCurve:
    """`by_schemes`; without multipliers, which take long, where an interrupt came or comes meanwhile."""
    if not stability or curve.ending is not Ending.INTERRUPTED:
        try:
            return by_schemes(balance, curve, partial(evaluate, stability=stability), each)
        except KeyboardInterrupt:
            curve = replace(curve, ending=Ending.INTERRUPTED, message=f"{curve.message}; {Ending.INTERRUPTED.value}")
    cut = replace(curve, message=f"{curve.message} before the multipliers")
    return by_schemes(balance, cut, partial(evaluate, stability=False))


def by_schemes(
    balance: AdaptiveBalance, curve: Curve, evaluate: Callable[[Any, Curve], HbmCurve], each: Each = each_here
) -> HbmCurve:
    """The solutions of a curve evaluated each by its own scheme, with the harmonics of the finest of these.

    Contacts keep their offsets for the sign of the determinant (see `timesim.hbm.stability`).

    Args:
        balance, curve: what was followed, and the solutions.
        evaluate: the solutions of the balance by one scheme.
        each: does so with the pieces of the curve, which are the same ones whoever does it.
    """
    places = np.array([coarsest(balance.schemes, x.reshape(balance.shape)) for x in curve.x], dtype=int)
    used = np.unique(places)[::-1] if places.size else np.zeros(1, dtype=int)
    sign = curve.determinant.copy()
    for i, place in enumerate(places):
        family, x = balance.residual_of(balance.schemes[place]), curve.x[i, balance.positions(place)]
        sign[i] = sign_with_offsets_kept(family.at(curve.p[i]), x, family.frequency_at(curve.p[i]), sign[i])
    curve = with_offsets_kept(curve, sign)
    rows, pieces = [], []
    for place in used:
        own = np.flatnonzero(places == place)
        for first in range(0, own.size or 1, PIECE):
            rows.append(own[first : first + PIECE])
            piece = part_of(curve, rows[-1])
            pieces.append(
                (balance.residual_of(balance.schemes[place]), replace(piece, x=piece.x[:, balance.positions(place)]))
            )
    done = [own.with_harmonics(balance.schemes[used[0]].harmonics) for own in each(evaluate, pieces)]
    whole: HbmCurve = part_of(joined(done), np.argsort(np.concatenate(rows)))
    return replace(whole, branch=curve.branch)


def _check_range(start: float, stop: float) -> None:
    for name, value in (("from", start), ("to", stop)):
        if not np.isfinite(value) or value <= 0:
            raise ValueError(f"hbm: frequency.{name} must be a positive number of Hz, not {value}")
    if start == stop:
        raise ValueError(
            f"hbm: frequency.from and frequency.to must differ, not both {start}; use a sweep for one point"
        )


def evaluated(balance: Balance, curve: Curve, *, stability: bool = True) -> HbmCurve:
    """Motion, contact states and stability of the solutions of a balance, in the units of the scene."""
    size, order = curve.p.size, balance.scheme.harmonics + 1
    motion, shape = balance.coefficients(curve.x), balance.model.structure.shape
    done = [contact_forces(balance.law, balance.basis, own) for own in motion]
    forces = np.array([own.coefficient for own in done])
    phasor = np.zeros((size, order, *shape.shape[:2]), complex)
    for i, (x, p) in enumerate(zip(curve.x, curve.p, strict=True)):
        phasor[i] = np.einsum("pam,hm->hpa", shape, balance.modes(x, forces[i], p))
    largest, unstable = np.full(size, np.nan), np.zeros(size, dtype=bool)
    if stability:
        multipliers = checked_multipliers(balance, curve.x, curve.p, curve.determinant)
        largest, unstable = np.abs(multipliers[:, 0]), grows(multipliers)
    return HbmCurve(
        parameter=curve.p,
        frequency=curve.p,
        stable=(curve.determinant > 0) & ~unstable,
        fold=curve.fold,
        branch=curve.branch,
        amplitude=half_range(phasor),
        harmonic_cos=phasor.real,
        harmonic_sin=-phasor.imag,
        slip_share=np.array([own.slip for own in done]).reshape(size, balance.num_contacts),
        separation_share=np.array([own.separation for own in done]).reshape(size, balance.num_contacts),
        contact_motion=motion * balance.length,
        contact_force=forces.reshape(motion.shape) * balance.force,
        floquet_max=largest,
        closure=np.array([own.closure.max() for own in done]),
        ending=curve.ending,
        message=curve.message,
    )
