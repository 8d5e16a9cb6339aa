"""Starts of an ensemble: the friction forces with which their contacts begin."""

from dataclasses import replace

import numpy as np
from systems import oscillator

from timesim.orbit.two_motions.basin import placed


def test_a_start_pulls_a_contact_by_a_share_of_its_friction_limit() -> None:
    """The limit is that of the normal load at the start; a force outside the cone is put back onto it."""
    model, stiffness = oscillator(3.0, 1.39), np.array([[20.0, 6.0], [6.0, 30.0]])
    model = replace(model, contacts=(replace(model.contacts[0], tangential_stiffness=stiffness),))
    q = np.array([0.05, -0.02])
    u, v = np.split(model.contact_shape[0] @ q, [2])
    limit = 0.5 * (3.0 + 20.0 * v[0])
    for pull, expected in (((0.5, -0.2), (0.5, -0.2)), ((3.0, 4.0), (0.6, 0.8))):
        start = placed(model, q, np.zeros(2), u[None], np.array([pull]))
        np.testing.assert_allclose(stiffness @ (u - start.slip[0]), limit * np.array(expected), rtol=1e-10)
