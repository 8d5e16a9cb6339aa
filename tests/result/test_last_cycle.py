"""The motion of the last cycle of a result, by the phase of the excitation."""

from pathlib import Path

import numpy as np

from timesim.result.dataset import dataset
from timesim.result.last_cycle import periodic_motion
from timesim.result.netcdf import REQUIRED_ATTRIBUTES, TEXTS, save

FREQUENCY, PHASE, SAMPLES = 1.25, 0.4, 40


def test_coefficients_belong_to_the_phase_of_the_excitation(tmp_path: Path):
    time = np.arange(2 * SAMPLES + 1) / (SAMPLES * FREQUENCY)
    theta = PHASE + 2 * np.pi * FREQUENCY * time
    motion = np.stack([0.3 + 2 * np.cos(theta), np.sin(theta) - 0.5 * np.sin(2 * theta)], axis=1)
    variables = {
        "modal_displacement": (("time", "mode"), motion),
        "final_phase_deg": ((), np.array(np.rad2deg(PHASE))),
        "cycle_start": (("cycle",), np.arange(2) / FREQUENCY),
        "cycle_period": (("cycle",), np.full(2, 1 / FREQUENCY)),
    }
    path = save(
        dataset(variables, {"time": time}, dict.fromkeys(REQUIRED_ATTRIBUTES, 1) | dict.fromkeys(TEXTS, "")),
        tmp_path / "result.nc",
    )
    found = periodic_motion(path)
    expected = [[0.3, 0.0], [2.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, -0.5]]
    assert abs(found.frequency / FREQUENCY - 1) < 1e-12
    np.testing.assert_allclose(found.modal[:5], expected, atol=1e-12)
    np.testing.assert_allclose(found.modal[5:], 0, atol=1e-12)
