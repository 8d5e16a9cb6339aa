"""Lightly damped structures in metres and newtons: what repeats settles, in few cycles, to what is asked for."""

from dataclasses import replace

import numpy as np
import pytest
from systems import at_rest, excitation

from timesim.model.model import GROUND, Contact, Model, Structure
from timesim.model.solver import NEVER, PRESETS, SHOOT, SLOW, Criterion
from timesim.orbit.settling import Chain, steady_states

pytestmark = pytest.mark.long

STANDARD = PRESETS["standard"]
ROOTS = np.array([1.87510407, 4.69409113, 7.85475744, 10.99554073, 14.13716839, 17.27875953])


def beam(preload: float, force: float = 1.0, damping_ratio: float = 0.002) -> Model:
    """A steel cantilever of 500 x 20 x 6 mm in six bending modes, a friction damper of 2 MN/m halfway, a force [N] at
    the tip. The damper presses across the motion, so its load stays at the preload [N].

    Modes of a cantilever, with unit modal masses: R. D. Blevins, *Formulas for Natural Frequency and Mode Shape*.
    """
    length, mass = 0.5, 7850 * 0.02 * 0.006 * 0.5
    bending = 2.1e11 * 0.02 * 0.006**3 / 12
    omega = ROOTS**2 * np.sqrt(bending / (mass * length**3))
    ratio = (np.sinh(ROOTS) - np.sin(ROOTS)) / (np.cosh(ROOTS) + np.cos(ROOTS))
    at = np.outer([1.0, 0.5], ROOTS)
    shape = np.zeros((2, 3, ROOTS.size))
    shape[:, 0] = (np.cosh(at) - np.cos(at) - ratio * (np.sinh(at) - np.sin(at))) / np.sqrt(mass)
    body = Structure(omega / (2 * np.pi), np.ones(ROOTS.size), 2 * damping_ratio * omega, ("tip", "middle"), shape)
    damper = Contact("damper", "middle", GROUND, np.eye(3), 0.3, 2e6 * np.eye(2), 0.0, preload)
    load = replace(excitation(1.0, force * shape[0, 0], np.zeros(ROOTS.size)), frequency=None)
    return Model(body, (damper,), load, at_rest(ROOTS.size, 1))


def settled(model, frequencies, first_shot=SLOW, solver=STANDARD, **criterion):
    (orbits,) = steady_states([Chain(model, tuple(frequencies))], solver, Criterion(first_shot=first_shot, **criterion))
    return orbits


def stuck_amplitude(model, frequency):
    """Of the tip, in closed form, with the spring of the damper in the structure."""
    body, omega = model.structure, 2 * np.pi * frequency
    tip, middle = body.shape[:, 0]
    K = np.diag(body.stiffness) + 2e6 * np.outer(middle, middle)
    q = np.linalg.solve(K - omega**2 * np.eye(len(K)) + 1j * omega * np.diag(body.damping), model.excitation.cosine[0])
    return abs(tip @ q)


@pytest.mark.parametrize(("first_shot", "most"), [(SHOOT, 20), (SLOW, 260), (NEVER, 260)])
def test_a_beam_whose_damper_sticks_settles(first_shot, most):
    """Marching leaves 1e-8 to 2e-7 of noise a cycle, which its slow decay multiplies by 250: it does not settle so."""
    model, frequencies = beam(50.0), (90.0, 110.0)
    for frequency, orbit in zip(frequencies, settled(model, frequencies, first_shot), strict=True):
        assert orbit.period == 1
        assert orbit.cycles < most
        assert orbit.settled_to < 1e-8
        assert orbit.slip_share[0] == 0
        assert orbit.amplitude[0, 0] == pytest.approx(stuck_amplitude(model, frequency), rel=1e-6)


@pytest.mark.slow
def test_a_beam_whose_damper_slips_settles_to_what_is_asked_for():
    """At its first resonance, and finer than the tolerance of the steps allows: they are made finer."""
    model = beam(5.0, 5.0)
    rough, fine = (settled(model, [19.5], SHOOT, tolerance=tolerance)[0] for tolerance in (1e-6, 1e-9))
    truth = settled(model, [19.5], SHOOT, replace(STANDARD, rtol=1e-11, atol=1e-13), tolerance=1e-10)[0]
    assert all(orbit.slip_share[0] > 0.9 for orbit in (rough, fine, truth))
    assert fine.settled_to < 1e-9 < rough.settled_to < 1e-6
    assert fine.cycles < 40
    assert fine.amplitude[0, 0] == pytest.approx(truth.amplitude[0, 0], rel=1e-8)


def overtone(damping_ratio: float, share: float, frequency: float) -> Model:
    """A mass on a slider, and a mode of three times the frequency that the slider hardly drives."""
    omega = 2 * np.pi * np.array([1.0, 3 * frequency])
    shape = np.zeros((1, 3, 2))
    shape[0, 0] = 1.0, share
    body = Structure(omega / (2 * np.pi), np.ones(2), 2 * np.array([0.05, damping_ratio]) * omega, ("mass",), shape)
    pad = Contact("pad", "mass", GROUND, np.eye(3), 0.5, 10.0 * np.eye(2), 0.0, 1.0)
    return Model(body, (pad,), replace(excitation(1.0, [1.0, 0.0], [0.0, 0.0]), frequency=None), at_rest(2, 1))


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_a_slow_change_below_a_fast_one_is_not_taken_for_settled(tolerance):
    """The mass settles in 25 cycles; the overtone, which takes thousands, moves by 7e-5 of it and little in a cycle."""
    model, fine = overtone(1e-4, 1e-5, 0.9), replace(STANDARD, rtol=1e-11, atol=1e-13)
    (orbit,) = settled(model, [0.9], tolerance=tolerance)
    (truth,) = settled(model, [0.9], SHOOT, fine, tolerance=1e-10)
    assert 0.2 < orbit.slip_share[0] < 0.3
    assert orbit.settled_to < tolerance
    largest = np.abs(truth.end.displacement).max()
    np.testing.assert_allclose(orbit.end.displacement, truth.end.displacement, rtol=0, atol=2e-6 * largest)
