"""The steady state of a linear scene against its closed form, mode by mode."""

from dataclasses import replace

import numpy as np
import pytest
from systems import oscillator

from timesim.model.model import Excitation
from timesim.model.solver import PRESETS
from timesim.orbit.linear import linear_orbit, slowest_decay
from timesim.orbit.settling import Chain, first_lane

FREQUENCY, HARMONIC, PHASE = 0.7, np.array([1, 2, 5]), 0.4


def lane_apart():
    """The oscillator under three harmonics and a constant force, its contact too far away to touch."""
    model, rng = oscillator(-1e6, FREQUENCY), np.random.default_rng(4)
    load = Excitation(FREQUENCY, HARMONIC, *rng.normal(size=(2, 3, 2)), rng.normal(size=2))
    start = replace(model.start, phase=PHASE)
    return first_lane(Chain(replace(model, excitation=load, start=start), (FREQUENCY,)), PRESETS["standard"])


def test_the_response_to_several_harmonics():
    """q_h = p_h / (omega^2 - (h Omega)^2 + i h Omega d), harmonic by harmonic."""
    lane = lane_apart()
    body, load = lane.model.structure, lane.model.excitation
    orbit = linear_orbit(lane)
    assert orbit is not None
    omega = 2 * np.pi * FREQUENCY * HARMONIC[:, None]
    phasor = (load.cosine - 1j * load.sine) / (body.stiffness - omega**2 + 1j * omega * body.damping)
    turn = np.exp(1j * HARMONIC * PHASE)[:, None]
    mean = load.constant / body.stiffness
    np.testing.assert_allclose(orbit.end.displacement, mean + (turn * phasor).real.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(orbit.end.velocity, (1j * omega * turn * phasor).real.sum(axis=0), rtol=1e-12)
    angle = 2 * np.pi * np.arange(20000) / 20000
    q = (np.exp(1j * np.outer(angle, HARMONIC)) @ phasor).real
    x = q @ body.shape[0].T
    np.testing.assert_allclose(orbit.amplitude[0], np.ptp(x, axis=0) / 2, rtol=1e-6)
    assert orbit.settled
    assert orbit.separation_share[0] == 1
    every = np.zeros((10, 2), complex)
    every[np.append(0, HARMONIC)] = np.vstack([mean, phasor])
    np.testing.assert_allclose(orbit.phasor[:, 0], every @ body.shape[0].T, rtol=0, atol=1e-12 * np.abs(mean).max())
    assert orbit.dissipated_power.tolist() == [0]


@pytest.mark.parametrize("ratio", [1e-3, 0.5, 3.0, 50.0])
def test_the_slowest_decay_is_that_of_its_largest_multiplier(ratio):
    """Also of an overdamped mode, which creeps back: by its damping alone it would be gone within a cycle."""
    lane = lane_apart()
    body = lane.model.structure
    model = replace(lane.model, structure=replace(body, damping=2 * np.array([ratio, 0.9]) * body.omega))
    lane = first_lane(Chain(model, (FREQUENCY,)), PRESETS["standard"])
    orbit = linear_orbit(lane)
    assert orbit is not None
    assert slowest_decay(lane) == pytest.approx(-np.log(np.abs(orbit.floquet[0])), rel=1e-9)


def test_its_multipliers_are_those_of_the_free_modes():
    lane = lane_apart()
    body = lane.model.structure
    orbit = linear_orbit(lane)
    assert orbit is not None
    decay = body.damping / 2
    root = -decay + 1j * np.sqrt(body.stiffness - decay**2)
    exact = np.exp(np.concatenate([root, root.conj()]) / FREQUENCY)
    np.testing.assert_allclose(np.sort_complex(orbit.floquet), np.sort_complex(exact), rtol=1e-12)
    assert np.all(np.diff(np.abs(orbit.floquet)) <= 1e-15)
    assert slowest_decay(lane) == pytest.approx(-np.log(np.abs(orbit.floquet[0])), rel=1e-12)


def test_a_motion_without_damping_is_no_steady_state():
    """Two masses with a dashpot between them: what rounding leaves of damping in their common motion is none."""
    model = oscillator(-1e6, FREQUENCY)
    body = model.structure
    for stiffness in np.linspace(1.0, 9.0, 17):
        omega, modes = np.linalg.eigh(np.array([[stiffness, -1.0], [-1.0, stiffness]]))
        damping = modes.T @ np.array([[0.1, -0.1], [-0.1, 0.1]]) @ modes
        damping[0, 1] = damping[1, 0]
        coupled = replace(body, frequency=np.sqrt(np.maximum(omega, 0.0)) / (2 * np.pi), damping=damping)
        for own in (coupled, replace(coupled, damping=np.abs(np.diag(damping)) + 1e-17)):
            lane = first_lane(Chain(replace(model, structure=own), (FREQUENCY,)), PRESETS["standard"])
            assert linear_orbit(lane) is None
