"""Motion, contact states and stability of the solutions of a curve, piece by piece.

The pieces follow from the curve alone, so that it is the same whoever evaluates them, and when. Most of them are known
while it grows: solutions by one scheme, in their order from one end of the range, but folds, which are found later.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.adaptive import AdaptiveBalance
from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Curve, joined, part_of
from timesim.hbm.curve.record import HbmCurve
from timesim.hbm.period import contact_forces
from timesim.hbm.scheme import coarsest
from timesim.hbm.stability import checked_multipliers, grows, sign_with_offsets_kept, with_offsets_kept
from timesim.orbit.fourier import half_range

PIECE = 64
"""Solutions that are evaluated at a time: one or two seconds of work where it takes long."""
OPEN = 16
"""Last solutions of a curve that grows among which a fold may still be found."""

Piece = tuple[Any, Curve]
"""A residual, and solutions of it that are evaluated together."""
Pieces = Callable[..., list[Piece]]
"""``pieces(curve, grows=...)``: those of a curve that can be evaluated before all of it is known."""
Evaluate = Callable[[Any, Curve], HbmCurve]
Signed = tuple[HbmCurve, NDArray[np.int64]]
"""Evaluated solutions, and the sign of det dr/dx of each with the offsets of contacts kept."""
Work = Callable[[Any, Curve], Signed]
"""What is done with a piece; a function of a module, as another process may do it."""
Each = Callable[[Work, Sequence[Piece]], list[Signed]]
"""Does it with each of some pieces."""


def each_here(work: Work, pieces: Sequence[Piece]) -> list[Signed]:
    """`Each` by this process."""
    return [work(*piece) for piece in pieces]


def by_schemes(balance: AdaptiveBalance, curve: Curve, evaluate: Evaluate, each: Each = each_here) -> HbmCurve:
    """The solutions of a curve evaluated each by its own scheme, with the harmonics of the finest of these.

    Contacts keep their offsets for the sign of the determinant (see `timesim.hbm.stability`).

    ``evaluate``: the solutions of the balance by one scheme; ``each``: does so with the pieces of the curve.
    """
    rows = list(_rows(balance, curve))
    order = np.argsort(np.concatenate([own for _, own in rows]))
    done = each(partial(signed, evaluate), [_piece(balance, curve, *own) for own in rows])
    most = balance.schemes[max(place for place, _ in rows)].harmonics
    found = part_of(joined([own.with_harmonics(most) for own, _ in done]), order)
    kept = with_offsets_kept(curve, np.concatenate([sign for _, sign in done])[order])
    again = np.flatnonzero(kept.fold != curve.fold)
    ones = [evaluate(*_piece(balance, kept, _place(balance, kept.x[i]), np.array([i]))) for i in again]
    newest = np.arange(kept.p.size)
    newest[again] = kept.p.size + np.arange(again.size)
    whole: HbmCurve = part_of(joined([found, *(own.with_harmonics(most) for own in ones)]), newest)
    return replace(whole, fold=kept.fold, branch=kept.branch, ending=curve.ending, message=curve.message)


def signed(evaluate: Evaluate, residual: Any, curve: Curve) -> Signed:
    """The solutions of a piece."""
    each = zip(curve.x, curve.p, curve.determinant, strict=True)
    sign = [sign_with_offsets_kept(residual.at(p), x, residual.frequency_at(p), int(own)) for x, p, own in each]
    known = np.array(sign, dtype=np.int64)
    return evaluate(residual, replace(curve, determinant=known)), known


def whole_pieces(balance: AdaptiveBalance, curve: Curve, *, grows: bool) -> list[Piece]:
    """Pieces of a curve that will be among those of the whole one: if it grows still, those that no more can join."""
    curve = part_of(curve, slice(None, -OPEN if grows else None))
    rows = [own for own in _rows(balance, curve) if not curve.fold[own[1]].any()]
    return [_piece(balance, curve, *own) for own in rows if not grows or own[1].size == PIECE]


def _rows(balance: AdaptiveBalance, curve: Curve) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Which solutions are evaluated together, and by which scheme."""
    places = np.array([_place(balance, x) for x in curve.x], dtype=int)
    ends = np.flatnonzero(~curve.backwards), np.flatnonzero(curve.backwards)[::-1]
    groups = [*(own[~curve.fold[own]] for own in ends), np.flatnonzero(curve.fold)]
    if not places.size:
        yield 0, np.zeros(0, dtype=np.intp)
    for place in np.unique(places)[::-1]:
        for group in groups:
            own = group[places[group] == place]
            for first in range(0, own.size, PIECE):
                yield int(place), own[first : first + PIECE]


def _place(balance: AdaptiveBalance, x: NDArray[np.float64]) -> int:
    """The scheme that a solution has asked for."""
    return coarsest(balance.schemes, x.reshape(balance.shape))


def _piece(balance: AdaptiveBalance, curve: Curve, place: int, rows: NDArray[np.intp]) -> Piece:
    own = part_of(curve, rows)
    return balance.residual_of(balance.schemes[place]), replace(own, x=own.x[:, balance.positions[place]])


def evaluated(balance: Balance, curve: Curve, *, stability: bool = True) -> HbmCurve:
    """Motion, contact states and stability of the solutions of a balance, in the units of the scene."""
    size, order = curve.p.size, balance.scheme.harmonics + 1
    motion, shape = balance.coefficients(curve.x), balance.model.structure.shape
    done = [contact_forces(balance.law, balance.basis, own) for own in motion]
    forces = np.array([own.coefficient for own in done])
    phasor = np.zeros((size, order, *shape.shape[:2]), complex)
    for i, (x, p) in enumerate(zip(curve.x, curve.p, strict=True)):
        phasor[i] = np.einsum("pam,hm->hpa", shape, balance.modes(x, forces[i], p))
    largest, unstable = np.full(size, np.nan + 0j), np.zeros(size, dtype=bool)
    if stability:
        multipliers = checked_multipliers(balance, curve.x, curve.p, curve.determinant)
        largest, unstable = multipliers[:, 0], grows(multipliers)
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
        floquet_max=np.abs(largest),
        floquet_phase_deg=np.degrees(np.abs(np.angle(largest))),
        closure=np.array([own.closure.max() for own in done]),
        ending=curve.ending,
        message=curve.message,
    )
