"""Steps of a sweep over which the amplitude stands out."""

import numpy as np
import pytest

from timesim.orbit.jump import suspects


def test_the_fall_from_the_top_of_a_lightly_damped_resonance_stands_out():
    """By a factor of 165, where the amplitude has risen by a third over the step before."""
    up = np.array([5.52, 7.1, 9.63, 13.268, 0.0803, 0.0779, 0.0756])
    assert suspects(up[:, None]).tolist() == [3]
    assert suspects(np.stack([up, 0.4 * up, np.zeros(7)], axis=1)[::-1]).tolist() == [2]


@pytest.mark.parametrize("width", [0.01, 0.1, 1.0])
def test_a_resonance_between_points_does_not(width):
    """Wherever its top is, unless half-way between two points, where the rises beside that stand out."""
    for top in np.linspace(-0.3, 0.3, 9):
        response = np.abs(1 / (np.arange(-12, 13) - top + 1j * width))
        assert suspects(response[:, None]).size == 0, top


def test_a_change_that_is_small_beside_the_largest_amplitude_does_not():
    """However still the amplitude is beside it."""
    assert suspects(np.ones((9, 2))).size == 0
    for size, stands_out in ((0.02, []), (0.04, [3])):
        step = 1 + size * (np.arange(9) > 3)
        assert suspects(step[:, None]).tolist() == stands_out
