"""Natural modes with stuck contacts, against the dense eigenvalue problem of the whole stiffness."""

from dataclasses import replace

import numpy as np
from systems import provable_model

from timesim.model.held import damped_modes, natural_modes
from timesim.model.model import Model

STUCK = np.array([1, 2])


def turned_stiffness() -> Model:
    """Four modes of unequal masses, three contacts whose K_u is no diagonal matrix; dampers couple the modes."""
    model = provable_model(314, 1e3)
    size = model.structure.stiffness.mean()
    matrix = size * np.array([[2.0, -0.7], [-0.7, 0.4]])
    return replace(
        model, contacts=tuple(replace(c, tangential_stiffness=matrix, normal_stiffness=size) for c in model.contacts)
    )


def held_matrix(model: Model, modes: np.ndarray) -> np.ndarray:
    """Stiffness of a structure with the stuck contacts in it, in modes of unit mass."""
    matrix = np.diag(model.structure.stiffness[modes])
    for c in STUCK:
        contact, shape = model.contacts[c], model.contact_shape[c][:, modes]
        matrix = matrix + shape[:2].T @ contact.tangential_stiffness @ shape[:2]
        matrix = matrix + contact.normal_stiffness * np.outer(shape[2], shape[2])
    return np.asarray(matrix / np.sqrt(np.outer(model.structure.mass[modes], model.structure.mass[modes])))


def test_natural_modes_with_stuck_contacts_solve_the_eigenproblem_of_the_modes_kept() -> None:
    model, modes = turned_stiffness(), np.array([0, 1, 3])
    omega, shape = natural_modes(model, modes, STUCK)
    matrix = held_matrix(model, modes)
    assert shape is not None
    np.testing.assert_allclose(omega, np.sqrt(np.linalg.eigvalsh(matrix)), rtol=1e-12)
    np.testing.assert_allclose(matrix @ shape, shape * omega**2, atol=1e-11 * omega.max() ** 2)
    np.testing.assert_allclose(shape.T @ shape, np.eye(3), atol=1e-13)


def test_the_width_of_a_resonance_is_twice_the_decay_of_its_free_vibration() -> None:
    model = turned_stiffness()
    omega, _, width = damped_modes(model, STUCK)
    matrix, light = held_matrix(model, np.arange(4)), 1e-6
    first_order = np.block([[np.zeros((4, 4)), np.eye(4)], [-matrix, -light * model.structure.decays]])
    rate = np.linalg.eigvals(first_order)
    rate = rate[rate.imag > 0]
    rate = rate[np.argsort(rate.imag)]
    np.testing.assert_allclose(omega, rate.imag, rtol=1e-9)
    np.testing.assert_allclose(light * width, -2 * rate.real, rtol=1e-6)
