"""States that a result holds: the one that is asked for, and what is refused."""

import numpy as np
import pytest

from timesim.fault import RuleError
from timesim.result.state import SavedStates

FREQUENCY = np.array([1.0, 1.1, 1.2])
POINTS = SavedStates(
    (), {"failure": np.array(["", "no motion", ""]), "cycles": np.arange(3)}, {"frequency": FREQUENCY}, 0.0
)


@pytest.mark.parametrize("asked", [1.2, 1.2 * (1 + 1e-12)])
def test_a_point_is_the_one_at_the_value_asked_for(asked: float):
    assert POINTS.one({"frequency": asked})["cycles"] == 2


def test_a_value_between_two_points_is_refused():
    with pytest.raises(RuleError, match=r"must be a frequency of the result"):
        POINTS.one({"frequency": 1.15})


def test_a_point_that_failed_is_refused_with_its_reason():
    with pytest.raises(RuleError, match="a point that could not be computed: no motion"):
        POINTS.one({"frequency": 1.1})


def test_one_point_must_be_named():
    with pytest.raises(RuleError, match="must name the frequency of a point of the sweep"):
        POINTS.one({})
