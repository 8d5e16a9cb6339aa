"""A model in numbers: the relative motion at a contact in its own axes."""

from dataclasses import replace

import numpy as np
import pytest
from systems import generated_model

from timesim.model.model import Structure


def test_relative_motion_is_that_of_body_1_in_the_axes_of_the_contact():
    model = generated_model(0, 3, 2)
    first = replace(model.contacts[0], point="p2", against="p1")
    model = replace(model, contacts=(first, replace(model.contacts[1], point="p1", against="ground")))
    x = {point: model.structure.shape[model.structure.points.index(point)] for point in ("p1", "p2")}
    assert np.abs(first.frame - first.frame.T).max() > 0.1
    np.testing.assert_allclose(model.contact_shape[0], [axis @ (x["p2"] - x["p1"]) for axis in first.frame], atol=1e-14)
    np.testing.assert_allclose(model.contact_shape[1], [axis @ x["p1"] for axis in model.contacts[1].frame], atol=1e-14)


def test_the_slowest_decay_of_modes_that_the_damping_couples():
    """Two equal masses with a dashpot from each to the ground and a stronger one between them, unequal modal masses."""
    mass, omega, ground, between = np.array([1.0, 4.0]), 3.0, 0.02, 0.5
    damping = (ground * np.eye(2) + between * np.array([[1.0, -1.0], [-1.0, 1.0]])) * np.sqrt(np.outer(mass, mass))
    frequency = np.full(2, omega) / (2 * np.pi)
    coupled = Structure(frequency, mass, damping, (), np.zeros((0, 3, 2)))
    assert coupled.decay == pytest.approx(ground / 2, rel=1e-9)
    assert replace(coupled, damping=np.diag(damping)).decay == pytest.approx((ground + between) / 2)


@pytest.mark.parametrize("damping", [[0.02, 0.3, 0.0], [0.02, 30.0, 1.0], [0.0, 0.3, 0.0]])
def test_a_diagonal_damping_matrix_decays_as_its_modes(damping):
    """Overdamped ones too; a free body does not count."""
    body = Structure(np.array([1.0, 2.0, 0.0]), np.ones(3), np.array(damping), (), np.zeros((0, 3, 3)))
    assert replace(body, damping=np.diag(damping)).decay == pytest.approx(body.decay, rel=1e-9, abs=1e-12)
