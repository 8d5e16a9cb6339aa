"""States that a result holds: the one that is asked for, and what is refused."""

import numpy as np
import pytest

from timesim.fault import RuleError
from timesim.result.state import SavedStates, settled_points

FREQUENCY = np.array([1.0, 1.1, 1.2])
POINTS = SavedStates(
    (), {"failure": np.array(["", "no motion", ""]), "cycles": np.arange(3)}, {"frequency": FREQUENCY}, 0.0
)


@pytest.mark.parametrize("asked", [1.2, 1.2 * (1 + 1e-12)])
def test_a_point_is_the_one_at_the_value_asked_for(asked: float):
    assert POINTS.one({"frequency": asked})["cycles"] == 2


def test_points_close_together_are_told_apart():
    """As those of a sweep across a jump, a part in ten million apart."""
    close = SavedStates((), {"cycles": np.arange(3)}, {"frequency": 1 + 1e-7 * np.arange(3)}, 0.0)
    for i, value in enumerate(close.axes["frequency"]):
        assert close.one({"frequency": float(value)})["cycles"] == i


@pytest.mark.parametrize("asked", [1e-3, 1.5, 2.0001, 9e9])
def test_a_wide_axis_makes_no_other_value_the_same(asked: float):
    wide = SavedStates((), {"cycles": np.arange(4)}, {"contacts.pad.preload": np.array([1e10, -2.0, 1.0, 2.0])}, 0.0)
    assert wide.one({"contacts.pad.preload": 1.0})["cycles"] == 2
    with pytest.raises(RuleError, match=r"must be a contacts.pad.preload of the result"):
        wide.one({"contacts.pad.preload": asked})


def test_a_value_that_rounding_keeps_from_zero_is_zero():
    axis = SavedStates((), {"cycles": np.arange(13)}, {"excitation.phase": -42.3 + 4.7 * np.arange(13)}, 0.0)
    assert abs(axis.axes["excitation.phase"][9]) > 7e-15
    assert axis.one({"excitation.phase": 0.0})["cycles"] == 9
    with pytest.raises(RuleError, match=r"must be an excitation.phase of the result"):
        axis.one({"excitation.phase": 7.0})


def test_a_value_between_two_points_is_refused():
    with pytest.raises(RuleError, match=r"must be a frequency of the result"):
        POINTS.one({"frequency": 1.15})


def test_of_many_values_the_two_beside_the_one_asked_for_are_named():
    many = SavedStates((), {"cycles": np.arange(20)}, {"frequency": 1 + np.arange(20) / 10}, 0.0)
    for asked, beside in ((1.26, "1.2 and 1.3"), (1.31, "1.3 and 1.4"), (3.5, "2.8 and 2.9")):
        with pytest.raises(RuleError) as error:
            many.one({"frequency": asked})
        assert error.value.hint == f"it has 20 from 1 to 2.9, next to it {beside}"


@pytest.mark.parametrize(("sizes", "listed"), [((3, 4), True), ((2, 7), False)])
def test_of_points_of_which_one_must_be_named_a_dozen_are_listed(sizes: tuple[int, int], listed: bool):
    names = ("contacts.pad.preload", "frequency")
    axes = {name: np.arange(1.0, 1 + size) for name, size in zip(names, sizes, strict=True)}
    with pytest.raises(RuleError) as error:
        SavedStates((), {"cycles": np.zeros(sizes)}, axes, 0.0).one({})
    assert ("match: " in error.value.hint) == listed
    if listed:
        every = "; ".join(f"contacts.pad.preload {a + 1}, frequency {b + 1}" for a, b in np.ndindex(*sizes))
        assert error.value.hint == f"12 match: {every}"


def test_a_point_that_failed_is_refused_with_its_reason():
    with pytest.raises(RuleError, match="a point that could not be computed: no motion"):
        POINTS.one({"frequency": 1.1})


def test_a_point_that_a_run_did_not_come_to_is_refused():
    arrays = {"failure": np.array(["", ""]), "final_modal_displacement": np.array([[1.0, 2.0], [np.nan, np.nan]])}
    states = SavedStates((), arrays, {"frequency": FREQUENCY[:2]}, 0.0)
    assert states.one({"frequency": 1.0})["final_modal_displacement"].tolist() == [1.0, 2.0]
    with pytest.raises(RuleError, match="names a point that the run did not come to"):
        states.one({"frequency": 1.1})


def test_one_point_must_be_named():
    with pytest.raises(RuleError, match="must name the frequency of a point of the sweep"):
        POINTS.one({})


def test_motions_that_repeat_each_cycle_with_contacts_that_do_not_only_stick_are_settled_points():
    """Not what failed, has not settled, repeats after two cycles, only sticks, or drifts."""
    frequency = np.arange(1.0, 9.0)
    arrays = {
        "failure": np.array([["", "no motion", "", "", "", "", "", ""]]),
        "settled": np.array([[1, 1, 0, 1, 1, 1, 1, 1]]),
        "period": np.array([[1, 1, 1, 2, 1, 1, 1, 1]]),
        "slip_share": np.array([[0.2, 0.2, 0.2, 0.2, 0.0, 0.0, 0.0, 0.2]])[..., None],
        "separation_share": np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.3, 0.0]])[..., None],
        "drift": np.zeros((1, 8, 1, 3)),
    }
    arrays["drift"][0, 7, 0, 1] = -0.1
    states = SavedStates(("pad",), arrays, {"direction": np.array(["up"]), "frequency": frequency}, 0.0)
    assert [place for place, _ in settled_points(states, {"direction": "up"})] == [1.0, 6.0, 7.0]
    assert [place for place, _ in settled_points(states, {"frequency": 7.0})] == [7.0]


def test_a_contact_that_sticks_beside_one_that_stays_apart_makes_a_motion_no_settled_point():
    """Its offset is free; where all stay apart there is none."""
    arrays = {
        "failure": np.array(["", ""]),
        "settled": np.ones(2),
        "period": np.ones(2),
        "slip_share": np.zeros((2, 2)),
        "separation_share": np.array([[1.0, 0.0], [1.0, 1.0]]),
    }
    states = SavedStates(("stop", "pad"), arrays, {"frequency": FREQUENCY[:2]}, 0.0)
    assert [place for place, _ in settled_points(states, {})] == [1.1]
