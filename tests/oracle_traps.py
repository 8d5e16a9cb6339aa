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
def earliest_event_truth() -> OracleResult:
    """Two contacts that close one soon after the other."""
    return simulate(two_stops((0.021, 0.020)), 1.0, 10)


@cache
def earliest_event_trap() -> tuple[OracleResult, OracleResult]:
    """They close within one step: the first in the list ends it, the earlier one stays open."""
    return simulate_plainly(two_stops((0.021, 0.020)), 1.0, 10), earliest_event_truth()


@cache
def double_crossing_truth() -> OracleResult:
    """A contact that closes and soon opens again."""
    return simulate(grazing_stop(0.999, 1e3), 1.0, 6)


@cache
def double_crossing_trap() -> tuple[OracleResult, OracleResult]:
    """It would do so within one step, and is never seen to close."""
    return simulate_plainly(grazing_stop(0.999, 1e3), 1.0, 6, rtol=1e-6), double_crossing_truth()
