"""The dimensionless system: the force of the excitation at any phase of a cycle."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from systems import generated_model

from timesim.engine.system import excitation, system_of
from timesim.model.scales import scales_of


@pytest.mark.parametrize("phase", [0.0, 0.7])
def test_the_force_is_that_of_the_scene(phase: float):
    model = generated_model(1, 3, 2)
    model = replace(model, excitation=replace(model.excitation, harmonic=np.array([1, 4]), constant=np.arange(3.0)))
    load, scales = model.excitation, scales_of(model, 1.3)
    system = system_of(model, 1.3, phase)
    unit = model.structure.mass * scales.mode * scales.omega**2
    for angle in (0.0, 0.4, 3.0):
        turn = load.harmonic * (angle + phase)
        force = load.constant + np.cos(turn) @ load.cosine + np.sin(turn) @ load.sine
        found = np.asarray(excitation(system, jnp.asarray(angle))) * unit
        np.testing.assert_allclose(found, force, rtol=0, atol=1e-12 * np.abs(force).max())
