"""Contacts that keep their state, as parts of the structure: springs of those that stick, constant forces.

A stuck contact acts on body 1 by ``(-K_u (u - w0), -(n - max(n0, 0)))``: the springs K_u and k_v, and a force that is
constant. One that is apart acts by ``(0, max(n0, 0))``: the preload that the structure carries at rest, and now no
longer.
"""

import numpy as np

from timesim.model.model import Contact, Model


def springs(contact: Contact) -> np.ndarray:
    """Stiffness of a stuck contact in its axes, shape (3, 3)."""
    stiffness = np.zeros((3, 3))
    stiffness[:2, :2], stiffness[2, 2] = contact.tangential_stiffness, contact.normal_stiffness
    return stiffness


def constant_force(contact: Contact, slip: np.ndarray, *, stuck: bool) -> np.ndarray:
    """Constant part of the force on body 1 in the axes of a contact, shape (3,), stuck on a slip or apart."""
    if stuck:
        return np.append(contact.tangential_stiffness @ slip, -min(contact.preload, 0.0))
    return np.array([0.0, 0.0, max(contact.preload, 0.0)])


def natural_modes(model: Model, modes: np.ndarray, stuck: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Natural modes of a structure in some of its modes, K of them, with the springs of stuck contacts.

    Returns:
        circular frequencies, shape (K,) [rad/time], and shapes as columns, shape (K, K): unit vectors in the modes
        normalised to unit mass; None where they are these modes.
    """
    # They are singular vectors of the roots of all stiffnesses. Beside contacts 1e10 times as stiff as the structure
    # the eigenvalues of their sum leave six digits of a slow mode's square, these leave eleven of its frequency.
    omega = model.structure.omega[modes]
    if not stuck.size:
        return omega, None
    shape = model.contact_shape[:, :, modes] / np.sqrt(model.structure.mass[modes])
    roots = [np.diag(omega)]
    for c in stuck:
        stiffness, axes = np.linalg.eigh(springs(model.contacts[c]))
        roots.append((np.sqrt(np.maximum(stiffness, 0.0)) * axes).T @ shape[c])
    _, omega, rows = np.linalg.svd(np.concatenate(roots), full_matrices=False)
    return omega[::-1], rows[::-1].T


def damped_modes(model: Model, stuck: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`natural_modes` in all modes with shapes, and the width of each resonance at half its power, (M,) [rad/time]."""
    modes = np.arange(model.structure.num_modes)
    omega, shape = natural_modes(model, modes, stuck)
    shape = np.eye(modes.size) if shape is None else shape
    return omega, shape, np.maximum(np.einsum("im,ij,jm->m", shape, model.structure.decays, shape), 0.0)
