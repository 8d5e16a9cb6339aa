"""Stability of periodic solutions: Floquet multipliers of the linearised law, and the sign of the determinant."""

from timesim.hbm.stability.multipliers import checked_multipliers, floquet_multipliers, grows
from timesim.hbm.stability.offset import sign_with_offsets_kept, with_offsets_kept
