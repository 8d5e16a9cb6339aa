"""What tests ask of results of the oracle, and models in which plain events fail: the plain and the true result."""

from functools import cache

import numpy as np
from oracle import OracleResult, simulate, simulate_plainly
from systems import grazing_stop, two_stops

from timesim.model.model import SEPARATION, SLIP


def slips(result: OracleResult) -> bool:
    return bool(np.any((result.share[:, SLIP] >= 0.05) & (result.share[:, SLIP] <= 0.95)))


def separates(result: OracleResult) -> bool:
    """Some contact opens and closes in the last cycle."""
    return bool(np.any((result.share[:, SEPARATION] >= 0.01) & (result.share[:, SEPARATION] <= 0.99)))


@cache
def earliest_event_trap() -> tuple[OracleResult, OracleResult]:
    """Two contacts close within one step: the first in the list ends it, the earlier one stays open."""
    model = two_stops((0.021, 0.020))
    return simulate_plainly(model, 1.0, 10), simulate(model, 1.0, 10)


@cache
def double_crossing_trap() -> tuple[OracleResult, OracleResult]:
    """A contact that would close and open again within one step is never seen to close."""
    model = grazing_stop(0.999, 1e3)
    return simulate_plainly(model, 1.0, 6, rtol=1e-6), simulate(model, 1.0, 6)
