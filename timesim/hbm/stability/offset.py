"""The sign of the determinant of a balance as disturbances see it, with the offsets of contacts kept.

The number of real multipliers above 1 is odd where the determinant is negative. That is exact, unlike the multipliers,
in which the samples leave an error. But a contact that sticks keeps its slip, hence the offset g of its force, which
the balance chooses anew for each motion x (`timesim.hbm.stuck_offset`), and of

    det (r_x + r_g g_x) = det r_x  det (1 + r_x^-1 r_g g_x)

only the first factor concerns disturbances; the other one turns the curve.
"""

import timesim.runtime  # noqa: F401  isort: skip

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from timesim.hbm.balance import Array, Balance
from timesim.hbm.continuation import Curve


def sign_with_offsets_kept(balance: Balance, x: Array, frequency: float, sign: int) -> int:
    """Sign of det dr/dx at a solution whose contacts keep their offsets, from that where these follow the motion.

    At a fold, where that is 0, it stays so.
    """
    if sign == 0 or not balance.has_offset(x):
        return sign
    _, by_x, _ = balance.linearised(x, frequency, keep_offsets=True)
    return by_x.sign * int(np.linalg.slogdet(by_x.matrix)[0])


def with_offsets_kept(curve: Curve, sign: NDArray[np.int64]) -> Curve:
    """A curve with these signs of det dr/dx, shape (S,), and no fold where nothing but an offset turns it."""
    sign, fold, inner = sign.copy(), curve.fold.copy(), np.flatnonzero(~curve.fold)
    by_offset = (sign * curve.determinant)[inner]
    for i in np.flatnonzero(fold):
        after = int(np.searchsorted(inner, i))
        if 0 < after < inner.size and by_offset[after] != by_offset[after - 1]:
            fold[i], sign[i] = False, sign[inner[after]]
    return replace(curve, fold=fold, determinant=sign)
