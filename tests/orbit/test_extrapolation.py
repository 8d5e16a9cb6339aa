"""Sums of changes to come, and limits of slowly converging sequences, against their closed forms."""

import numpy as np
import pytest

from timesim.orbit.extrapolation import limits, remaining


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.9, 0.999])
def test_changes_to_come_are_a_geometric_series(ratio):
    changes = 2e-3 * ratio ** np.arange(1, 40_000)
    assert remaining(2e-3, ratio) == pytest.approx(changes.sum(), rel=1e-9, abs=1e-300)


def test_changes_that_do_not_fall_have_no_sum():
    np.testing.assert_array_equal(remaining(np.full(2, 1e-9), np.array([1.0, 1.2])), [np.inf, np.inf])


@pytest.mark.parametrize("ratio", [0.3, 0.6, 0.95])
def test_a_geometric_sequence_leads_to_its_limit(ratio):
    limit, along = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, -0.2])
    terms = limit + along * ratio ** np.arange(4)[:, None]
    found, leads = limits(terms[None])
    assert leads[0]
    np.testing.assert_allclose(found[0], limit, rtol=1e-9)


def test_a_creeping_sequence_is_led_on_beyond_its_geometric_limit():
    """Changes of k^(-3/2) add up to twice what Aitken's extrapolation of a geometric sequence gives."""
    change = np.arange(1.0, 400_000.0) ** -1.5
    terms = np.cumsum(change)[200:204]
    left = change[204:].sum() + 2 / np.sqrt(change.size)
    found, leads = limits(terms[None, :, None])
    assert leads[0]
    assert found[0, 0] - terms[-1] == pytest.approx(left, rel=0.02)
    ratio = change[203] / change[202]
    assert float(remaining(change[203], ratio)) < 0.7 * left


def test_a_sequence_that_turns_leads_nowhere():
    angle = np.arange(4) * np.pi / 3
    spiral = 0.9 ** np.arange(4)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert not limits(spiral[None])[1][0]


def by_ratios(*ratios):
    """The last terms of a sequence whose changes fall by these ratios, one after the other."""
    changes = np.cumprod([2e-3, *ratios])
    return np.cumsum([1.0, *changes])[None, :, None], changes[-1]


@pytest.mark.parametrize(("before", "times"), [(0.902, 1.0), (0.898, 1.0), (0.895, 2.0), (0.885, 5.0)])
def test_a_ratio_that_hardly_changes_is_constant_and_one_that_rises_leads_to_five_times_as_much_at_most(before, times):
    """The rise is relative to the square of 0.1: of 0.5 it doubles what is to come, and above 0.8 it counts as 0.8."""
    terms, last = by_ratios(before, 0.9)
    found, leads = limits(terms)
    assert leads[0]
    assert found[0, 0] - terms[0, -1, 0] == pytest.approx(times * last * 0.9 / 0.1, rel=1e-9)


@pytest.mark.parametrize("ratios", [(0.1, 0.1), (-0.5, -0.5), (0.9, 0.5), (0.5, 0.9), (1.1, 1.1)])
def test_a_sequence_whose_ratio_is_small_or_changes_leads_nowhere(ratios):
    assert not limits(by_ratios(*ratios)[0])[1][0]
