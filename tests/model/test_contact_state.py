"""Which state a contact is in, and where its slip may be."""

from dataclasses import replace

import numpy as np
import pytest
from systems import oscillator

from timesim.model.contact_state import UNKNOWN, contact_loads, contact_state, slip_follows_motion, start_states
from timesim.model.model import SEPARATION, SLIP, STICK


@pytest.mark.parametrize(
    ("normal", "friction", "before", "after"),
    [
        (1.0, 0.5, UNKNOWN, STICK),
        (1.0, 0.0, UNKNOWN, SLIP),
        (0.0, 0.5, UNKNOWN, SEPARATION),
        (-1.0, 0.0, UNKNOWN, SEPARATION),
        (1.0, 0.5, SLIP, SLIP),
        (1.0, 0.0, STICK, SLIP),
        (0.0, 0.5, SLIP, SEPARATION),
        (1.0, 0.5, SEPARATION, STICK),
        (1e-12, 0.5, SEPARATION, SEPARATION),
        (1e-12, 0.5, STICK, STICK),
    ],
)
def test_the_state_follows_from_the_load(normal: float, friction: float, before: int, after: int) -> None:
    assert contact_state(normal, friction, before, rounding=1e-11) == after


def test_states_of_a_start_are_those_given_or_follow() -> None:
    """An open gap of 0.05 that a displacement of 0.1 along the normal (0.8 + 0.6) closes."""
    model = oscillator(-1.0, 0.97)
    assert start_states(model).tolist() == [SEPARATION]
    pressed = replace(model.start, displacement=np.array([0.1, 0.1]))
    assert start_states(replace(model, start=pressed)).tolist() == [STICK]
    given = replace(pressed, state=np.array([SLIP]))
    assert start_states(replace(model, start=given)).tolist() == [SLIP]


def test_a_slip_outside_the_cone_is_moved_onto_it() -> None:
    model = oscillator(3.0, 1.39)
    displacement = np.array([0.2, 0.1])
    loads = contact_loads(model, displacement, np.zeros((1, 2)))
    assert loads.size[0] > loads.limit[0] == pytest.approx(0.5 * (3.0 + 20.0 * 0.22))
    moved = contact_loads(model, displacement, loads.slip_in_cone())
    assert moved.size == pytest.approx(moved.limit)
    assert np.cross(np.append(moved.force[0], 0), np.append(loads.force[0], 0)) == pytest.approx(0)
    inside = contact_loads(model, 0.1 * displacement, np.array([[0.01, -0.02]]))
    np.testing.assert_array_equal(inside.slip_in_cone(), inside.slip)


def test_the_slip_of_what_is_apart_or_smooth_is_its_motion() -> None:
    states, friction = np.array([STICK, SLIP, SEPARATION, SLIP]), np.array([0.5, 0.5, 0.5, 0.0])
    assert slip_follows_motion(states, friction).tolist() == [False, False, True, True]
