"""Fourier coefficients of periodic motions, and the range that a motion covers."""

import tracemalloc

import numpy as np
import pytest

from timesim.orbit.fourier import (
    fourier_basis,
    fourier_coefficients,
    half_range,
    phase_deg,
    to_coefficients,
    to_phasors,
    weighted,
)

TURN = 2 * np.pi


def test_half_range_is_that_of_the_continuous_motion():
    rng = np.random.default_rng(0)
    phasor = rng.normal(size=(3, 6, 2, 3)) + 1j * rng.normal(size=(3, 6, 2, 3))
    theta = np.linspace(0, TURN, 20001)
    values = np.einsum("kh,sh...->ks...", np.exp(1j * np.outer(theta, np.arange(6))), phasor).real
    np.testing.assert_allclose(half_range(phasor), (values.max(0) - values.min(0)) / 2, rtol=1e-6)


@pytest.mark.parametrize("harmonics", [2, 3, 9, 60])
def test_half_range_finds_the_higher_of_crests_that_are_nearly_equal(harmonics: int):
    """Of two crests the lower one may have the higher sample; what does not move has none."""
    rng, theta = np.random.default_rng(5), np.linspace(0, TURN, 200 * harmonics + 1)
    phasor = rng.normal(size=(400, harmonics + 1)) + 1j * rng.normal(size=(400, harmonics + 1))
    phasor[:, 2:harmonics] *= 0.01
    values = np.exp(1j * np.outer(theta, np.arange(harmonics + 1))) @ phasor.T
    np.testing.assert_allclose(half_range(phasor), np.ptp(values.real, axis=0) / 2, rtol=2e-4)
    assert half_range(np.array([[0.3] + [0.0] * harmonics], dtype=complex)) == 0


def test_phasors_and_coefficients():
    coefficient = np.random.default_rng(1).normal(size=(2, 3, 9))
    np.testing.assert_array_equal(to_coefficients(to_phasors(coefficient)), coefficient)
    theta = np.linspace(0, TURN, 7)
    expected = (to_phasors(coefficient) @ np.exp(1j * np.outer(np.arange(5), theta))).real
    np.testing.assert_allclose(coefficient @ fourier_basis(theta, 9).T, expected, atol=1e-13)


def test_coefficients_of_samples():
    rng = np.random.default_rng(2)
    coefficient = rng.normal(size=(7, 2))
    phase, count = 0.7, 40
    theta = phase + 2 * np.pi * np.arange(1, count + 1) / count
    found = fourier_coefficients(fourier_basis(theta, 7) @ coefficient, phase)
    np.testing.assert_allclose(found[:7], coefficient, atol=1e-13)
    np.testing.assert_allclose(found[7:], 0, atol=1e-13)


@pytest.mark.parametrize("count", [16, 17])
def test_there_are_no_more_coefficients_than_samples(count):
    """What changes its sign from each of an even number to the next is a cosine of any size: it is left out."""
    samples = np.random.default_rng(4).normal(size=count)
    found = fourier_coefficients(samples, 0.3)
    assert len(found) <= count
    again = fourier_basis(0.3 + TURN * np.arange(1, count + 1) / count, len(found)) @ found
    left = samples - again
    np.testing.assert_allclose(left, left[0] * (-1.0) ** np.arange(count) if count % 2 == 0 else 0.0, atol=1e-13)


def test_the_phase_is_that_of_the_cosine():
    """Of a motion that is all rounding beside where the structure stands there is none."""
    begin, phase, count = 0.4, np.array([-170.0, 35.0, 120.0]), 64
    theta = begin + TURN * np.arange(1, count + 1) / count
    motion = np.cos(theta[:, None] + np.deg2rad(phase)) + 0.3 * np.sin(3 * theta)[:, None]
    for mean, size in ((0.5, 1.0), (1e3, 1.0), (1e3, 1e-3), (1.0, 1e-10)):
        phasor = to_phasors(fourier_coefficients(mean + size * motion, begin).T).T
        found = phase_deg(phasor[:, None])[0]
        np.testing.assert_allclose(found, phase if size > 1e-9 * mean else np.nan, atol=1e-6)


@pytest.mark.parametrize(("harmonics", "count"), [(1, 16), (3, 17), (4, 16), (9, 300)])
def test_weighted_harmonic_functions(harmonics, count):
    """As samples, and as whether something holds at them."""
    size = 2 * harmonics + 1
    basis = fourier_basis(TURN * np.arange(1, count + 1) / count, size)
    for weight in (np.random.default_rng(3).normal(size=count), np.arange(count) % 3 == 1, np.full(count, 2.5)):
        expected = fourier_coefficients(weight[:, None] * basis, 0.0)[:size]
        np.testing.assert_allclose(weighted(weight, size), expected, atol=1e-14)


def test_amplitudes_of_a_long_curve_take_little_memory():
    """1,000 solutions of 100 harmonics, whose samples as one array would take 78 MB, and more in the making."""
    phasor = np.zeros((1000, 101, 1, 3), complex)
    phasor[:, 1] = 1.0
    phasor[:, 100] = 0.01 * np.exp(1j * np.linspace(0, 6, 1000))[:, None, None]
    tracemalloc.start()
    found = half_range(phasor)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 60e6
    alone = [half_range(phasor[i : i + 1])[0] for i in (0, 500, 999)]
    np.testing.assert_array_equal(found[[0, 500, 999]], alone)
