"""Response curves by harmonic balance: motion, contact states, folds and stability of the solutions along them.

The balance is `timesim.hbm.balance`, the way along the curve `timesim.hbm.continuation`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from timesim.hbm.adaptive import AdaptiveBalance
from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Controls, Curve, Elsewhere, Ending, follow, follow_both_ways, part_of
from timesim.hbm.curve.evaluation import (
    Piece,
    Pieces,
    Signed,
    Work,
    by_schemes,
    each_here,
    evaluated,
    signed,
    whole_pieces,
)
from timesim.hbm.curve.record import HbmCurve, Watch
from timesim.hbm.first_guess import curve_near
from timesim.hbm.hidden import steps_to_resolve
from timesim.hbm.scheme import Scheme
from timesim.model.model import Model
from timesim.orbit.fourier import Array


class Aside(Protocol):
    """Other processes that take a part of the work on a curve that takes long."""

    def each(self, work: Work, pieces: Sequence[Piece], /) -> list[Signed]:
        """The pieces of the whole curve, some of which may have been evaluated meanwhile."""

    def known(self, work: Work, pieces: Sequence[Piece], /) -> list[Signed]:
        """Those that have been evaluated, as they are; the others by this process."""

    def part(self, model: Model, start: float, first: float, last: float) -> Elsewhere:
        """Begin `part_of_curve`."""

    def meanwhile(self, start: float, work: Work, pieces: Pieces, so_far: Callable[[], Curve], /) -> None:
        """What of the curve that begins there may be evaluated while it grows; called at each of its solutions."""


def watched(balance: AdaptiveBalance, controls: Controls, watch: Watch, evaluate: Callable[..., HbmCurve]) -> Controls:
    """Steps of a continuation whose curve is watched while it grows; its solutions are evaluated as by `finished`."""

    def given(so_far: Callable[[], Curve], last: int = 0) -> HbmCurve:
        return by_schemes(balance, part_of(so_far(), slice(-last, None)), partial(evaluate, stability=False))

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
            contacts stuck, absent or half as stiff, then under a load that grows from zero while damping leaves, then
            the motion to which a time integration settles.
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
    balance, steps = _resolving(model, start, schemes_of(scheme), controls or Controls())
    place = start if begin is None else begin
    if watch is not None:
        steps = watched(balance, steps, watch, evaluated)
    from_end, to_end = None, steps
    if aside is not None:
        from_end = partial(aside.part, model, start, stop)
        to_end = _evaluated_meanwhile(balance, steps, partial(aside.meanwhile, start), stability)

    def followed(first: Array) -> Curve:
        if start < place < stop or stop < place < start:
            return follow_both_ways(balance, first, place, (start, stop), steps)
        if np.isclose(place, stop, rtol=1e-9, atol=0.0):
            return follow(balance, first, stop, start, steps)
        return follow(balance, first, start, stop, to_end, from_end=from_end)

    curve = curve_near(balance, place, place, steps, guess, followed)
    return finished(balance, curve, evaluated, stability, aside)


def part_of_curve(
    model: Model, start: float, first: float, last: float, schemes: Sequence[Scheme], controls: Controls, watch: Watch
) -> Curve:
    """The curve from one frequency to another, in the unknowns of the `hbm_curve` that begins at `start`."""
    balance, steps = _resolving(model, start, schemes, controls)
    steps = watched(balance, steps, watch, evaluated)
    return curve_near(balance, first, first, steps, None, lambda x: follow(balance, x, first, last, steps))


def _balance_of(model: Model, start: float, schemes: Sequence[Scheme]) -> AdaptiveBalance:
    return AdaptiveBalance(lambda own: Balance(model, start, own), schemes, model.num_contacts)


def _resolving(
    model: Model, start: float, schemes: Sequence[Scheme], controls: Controls
) -> tuple[AdaptiveBalance, Controls]:
    """The balance along the frequency, and steps that show resonances which its unknowns do not."""
    balance = _balance_of(model, start, schemes)
    return balance, replace(controls, longest=steps_to_resolve(model, balance))


def _evaluated_meanwhile(
    balance: AdaptiveBalance, controls: Controls, meanwhile: Callable[..., None], stability: bool
) -> Controls:
    """Steps of a continuation whose solutions are evaluated while it goes on."""
    own, work = controls.watch, partial(signed, partial(evaluated, stability=stability))

    def watch(share: float, so_far: Callable[[], Curve]) -> None:
        if own is not None:
            own(share, so_far)
        meanwhile(work, partial(whole_pieces, balance), so_far)

    return replace(controls, watch=watch)


def left_part(
    model: Model, start: float, part: Curve, schemes: Sequence[Scheme], *, stability: bool, aside: Aside
) -> HbmCurve:
    """A `part_of_curve` that a curve was interrupted before it met, as another curve that was interrupted."""
    balance = _balance_of(model, start, schemes)
    place = part.message.split(": ")[0]
    message = f"{place} from the other end of the range: {Ending.INTERRUPTED.value}"
    cut = replace(part, ending=Ending.INTERRUPTED, message=message)
    return finished(balance, cut, evaluated, stability, aside)


def schemes_of(scheme: Scheme | Sequence[Scheme] | None) -> Sequence[Scheme]:
    """One or several schemes; the default is one."""
    return (scheme or Scheme(),) if scheme is None or isinstance(scheme, Scheme) else scheme


def finished(
    balance: AdaptiveBalance,
    curve: Curve,
    evaluate: Callable[..., HbmCurve],
    stability: bool,
    aside: Aside | None = None,
) -> HbmCurve:
    """`by_schemes`; where an interrupt came or comes meanwhile without the multipliers that are not known, as they
    take long.
    """
    each, known = (each_here, each_here) if aside is None else (aside.each, aside.known)
    if not stability or curve.ending is not Ending.INTERRUPTED:
        try:
            return by_schemes(balance, curve, partial(evaluate, stability=stability), each)
        except KeyboardInterrupt:
            done = curve.message.replace(": complete: ", ": ")
            curve = replace(curve, ending=Ending.INTERRUPTED, message=f"{done}; {Ending.INTERRUPTED.value}")
    found = by_schemes(balance, curve, partial(evaluate, stability=False), known)
    if stability and (left := np.isnan(found.floquet_max)).any():
        found = replace(found, message=f"{found.message} before {'the' if left.all() else 'all'} multipliers")
    return found


def _check_range(start: float, stop: float) -> None:
    for name, value in (("from", start), ("to", stop)):
        if not np.isfinite(value) or value <= 0:
            raise ValueError(f"hbm: frequency.{name} must be a positive number of Hz, not {value}")
    if start == stop:
        hint = "use a sweep for one point"
        raise ValueError(f"hbm: frequency.from and frequency.to must differ, not both {start}; {hint}")
