"""The motion of the last cycle of a result, by the phase of the excitation."""

from pathlib import Path

import numpy as np
import pytest

from timesim.model.model import GROUND
from timesim.result.dataset import dataset
from timesim.result.last_cycle import periodic_motion
from timesim.result.motion import read_result_motion
from timesim.result.netcdf import REQUIRED_ATTRIBUTES, TEXTS, read, save

FREQUENCY, PHASE, SAMPLES = 1.25, 0.4, 40


def saved(folder: Path, time: np.ndarray, theta: np.ndarray, starts: list[float], periods: list[float]) -> Path:
    """The result of a run with a phase of the excitation at each time, and with cycles of these starts and periods."""
    motion = np.stack([0.3 + 2 * np.cos(theta), np.sin(theta) - 0.5 * np.sin(2 * theta)], axis=1)
    points = np.stack([np.outer(np.cos(theta), [1, 2, 3]), np.outer(np.sin(theta), [0.1, 0.2, 0.4])], axis=1)
    variables = {
        "modal_displacement": (("time", "mode"), motion),
        "displacement": (("time", "point", "axis"), points),
        "final_phase_deg": ((), np.array(np.rad2deg(PHASE))),
        "cycle_start": (("cycle",), np.array(starts)),
        "cycle_period": (("cycle",), np.array(periods)),
    }
    coords = {"time": time, "point": ["tip", "root"]}
    attrs = dict.fromkeys(REQUIRED_ATTRIBUTES, 1) | dict.fromkeys(TEXTS, "")
    return save(dataset(variables, coords, attrs), folder / "result.nc")


def test_coefficients_belong_to_the_phase_of_the_excitation_and_the_frequency_to_the_last_cycle(tmp_path: Path):
    """The cycle before is one of another frequency."""
    last = 2.0 + np.arange(SAMPLES + 1) / (SAMPLES * FREQUENCY)
    time = np.concatenate([2.0 * np.arange(SAMPLES) / SAMPLES, last])
    theta = PHASE + 2 * np.pi * np.arange(2 * SAMPLES + 1) / SAMPLES
    found = periodic_motion(saved(tmp_path, time, theta, [0.0, 2.0], [2.0, 1 / FREQUENCY]))
    expected = [[0.3, 0.0], [2.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, -0.5]]
    assert abs(found.frequency / FREQUENCY - 1) < 1e-12
    np.testing.assert_allclose(found.modal[:5], expected, atol=1e-12)
    np.testing.assert_allclose(found.modal[5:], 0, atol=1e-12)


def test_a_run_that_ends_within_a_cycle_has_no_phase_at_the_end_of_its_last_whole_one(tmp_path: Path):
    time = np.arange(SAMPLES + 5) / (SAMPLES * FREQUENCY)
    path = saved(tmp_path, time, PHASE + 2 * np.pi * FREQUENCY * time, [0.0], [1 / FREQUENCY])
    with pytest.raises(ValueError, match="it does not end with a whole cycle"):
        periodic_motion(path)


@pytest.mark.parametrize(("against", "share"), [(GROUND, 0.0), ("root", 1.0)])
def test_the_motion_of_a_contact_is_that_of_its_point_relative_to_the_other_in_its_axes(
    against: str, share: float, tmp_path: Path
):
    theta = PHASE + 2 * np.pi * np.arange(SAMPLES + 1) / SAMPLES
    path = saved(tmp_path, theta - PHASE, theta, [0.0], [2 * np.pi])
    frame = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    found = read_result_motion(path, "tip", against, frame).samples
    own, other = np.cos(theta[:-1, None]) * [2, 3, 1], np.sin(theta[:-1, None]) * [0.2, 0.4, 0.1]
    np.testing.assert_allclose(found, own - share * other, atol=1e-14)


@pytest.mark.parametrize(("missed", "closes"), [(0.9e-3, True), (1.1e-3, False)])
def test_a_motion_along_one_axis_closes_by_its_own_range(missed: float, closes: bool, tmp_path: Path):
    theta = 2 * np.pi * np.arange(SAMPLES + 1) / SAMPLES
    path = saved(tmp_path, theta, theta, [0.0], [2 * np.pi])
    data = read(path)[""]
    data["displacement"][:] = 0.0
    data["displacement"][:, 0, 0] = np.cos(theta)
    data["displacement"][-1, 0, 0] += 2 * missed
    save(data, path)
    if closes:
        assert np.ptp(read_result_motion(path, "tip", GROUND, np.eye(3)).samples[:, 0]) == pytest.approx(2)
    else:
        with pytest.raises(ValueError, match=f"ends {missed:.2g} of the motion's range from where it begins"):
            read_result_motion(path, "tip", GROUND, np.eye(3))
