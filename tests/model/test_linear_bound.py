"""Bounds on linear motion, each by itself, against the same bounds in displacements and velocities."""

import numpy as np
import pytest

from timesim.model.linear_bound import Oscillation, envelopes

PHASES = np.exp(1j * np.linspace(0, 2 * np.pi, 4001))
OUTPUT = np.array([[[1.0, 0.2, -0.4], [0.3, -1.0, 0.1], [-0.2, 0.5, 0.7]]])
OFFSET = np.array([[0.3, -0.1, 0.2]])
ROWS = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [0.5, -0.3, 0.4]])
NUM = 3


def coupled(seed: int) -> Oscillation:
    """Stiffness and damping that no modes share, forces of two harmonics with phases, constant forces, a start."""
    rng = np.random.default_rng(seed)
    root, dampers = rng.uniform(-1, 1, (2, NUM, NUM))
    wave = rng.uniform(-1, 1, (2, NUM)) + 1j * rng.uniform(-1, 1, (2, NUM))
    constant, displacement, velocity = rng.uniform(-1, 1, (3, NUM))
    stiffness, damping = root @ root.T + np.diag([1.0, 4.0, 9.0]), 0.3 * dampers @ dampers.T + 0.1 * np.eye(NUM)
    return Oscillation(stiffness, damping, np.array([1, 3]), wave, constant, displacement, velocity)


def steady(system: Oscillation, omega: float) -> np.ndarray:
    """Complex amplitudes (q, q') of each harmonic as columns."""
    columns = []
    for order, force in zip(system.harmonic * omega, system.wave, strict=True):
        q = np.linalg.solve(system.stiffness - order**2 * np.eye(NUM) + 1j * order * system.damping, force)
        columns.append(np.concatenate([q, 1j * order * q]))
    return np.array(columns).T


def free_vibration(system: Oscillation) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rates and displacements of the complex modes, their shares in a state (q, q'), and the start off its rest."""
    matrix = np.block([[np.zeros((NUM, NUM)), np.eye(NUM)], [-system.stiffness, -system.damping]])
    rate, shape = np.linalg.eig(matrix)
    start = np.concatenate([system.displacement - np.linalg.solve(system.stiffness, system.constant), system.velocity])
    return rate, shape[:NUM], np.linalg.inv(shape), start


def rest(system: Oscillation) -> np.ndarray:
    return np.asarray(ROWS @ (OUTPUT[0] @ np.linalg.solve(system.stiffness, system.constant) + OFFSET[0]))


@pytest.mark.parametrize("seed", range(4))
def test_bounds_at_one_frequency_are_those_by_the_energy_and_by_complex_modes(seed: int) -> None:
    system, omega = coupled(seed), 1.3
    by_energy, by_modes = envelopes(system, OUTPUT, OFFSET, omega)[0]
    waves, row = steady(system, omega), ROWS @ OUTPUT[0]
    swing = rest(system) + np.abs(row @ waves[:NUM]).sum(axis=1)
    _, shape, share, start = free_vibration(system)

    def speed(state: np.ndarray) -> np.ndarray:
        """Root of twice the energy of states, columns."""
        q, p = state[:NUM], state[NUM:]
        return np.asarray(np.sqrt((q * (system.stiffness @ q)).sum(axis=0) + (p * p).sum(axis=0)))

    most = sum(speed(np.outer(wave, PHASES).real).max() for wave in waves.T) + speed(start[:, None])[0]
    reach = np.sqrt((row.T * np.linalg.solve(system.stiffness, row.T)).sum(axis=0))
    np.testing.assert_allclose(by_energy.highest(ROWS), swing + reach * most, rtol=1e-5)
    # Of a mode and its conjugate the larger half axes add up, at whatever phase the waves start.
    free = np.abs(share @ start) + 0.5 * (np.abs(share @ waves) + np.abs(share @ waves.conj())).sum(axis=1)
    np.testing.assert_allclose(by_modes.highest(ROWS), swing + np.abs(row @ shape) @ free, rtol=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_for_every_schedule_adds_the_largest_force_over_the_decay_of_each_complex_mode(seed: int) -> None:
    system = coupled(seed)
    ((bound,),) = envelopes(system, OUTPUT, OFFSET, None)
    rate, shape, share, start = free_vibration(system)
    push = (np.abs(share[:, NUM:] @ system.wave.T) + np.abs(share[:, NUM:] @ system.wave.conj().T)).sum(axis=1) / 2
    free = np.abs(share @ start) - push / rate.real
    expected = rest(system) + np.abs(ROWS @ OUTPUT[0] @ shape) @ free
    np.testing.assert_allclose(bound.highest(ROWS), expected, rtol=1e-10)


@pytest.mark.parametrize("omega", [None, 2.0])
def test_a_free_vibration_in_one_complex_mode_is_bounded_by_its_amplitude(omega: float | None) -> None:
    system = coupled(0)
    rate, shape, _, _ = free_vibration(system)
    mode = int(np.argmax(rate.imag))
    q, p = shape[:, mode].real, (rate[mode] * shape[:, mode]).real
    none = np.zeros(NUM)
    alone = Oscillation(system.stiffness, system.damping, np.array([1]), none[None] * 0j, none, q, p)
    highest = envelopes(alone, OUTPUT, 0 * OFFSET, omega)[0][-1].highest(ROWS)
    np.testing.assert_allclose(highest, np.abs(ROWS @ OUTPUT[0] @ shape[:, mode]), rtol=1e-10)
