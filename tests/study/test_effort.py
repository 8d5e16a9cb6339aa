"""Why a run took many steps, in its summary."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import systems
from xarray import Dataset

from timesim.model.cost import steps_for
from timesim.model.model import Model
from timesim.model.solver import PRESETS, Solver
from timesim.study.registry import carry_out, load_scene
from timesim.study.summary.effort import effort_lines, sweep_effort_lines

pytestmark = pytest.mark.long

OSCILLATOR = Path(__file__).parents[2] / "configs" / "oscillator.yaml"
VIBRATES = "with its contacts stuck the structure vibrates up to"
TURNS = "contact pad slips under so little load that the direction of slip turns fast"


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, None),
        ({"contacts.pad.normal_stiffness": 1e5, "contacts.pad.tangential_stiffness": 1e4}, VIBRATES),
        ({"contacts.pad.friction": 1e-3}, TURNS),
    ],
)
def test_the_summary_names_what_asks_for_many_steps(changes: dict[str, Any], why: str | None) -> None:
    study = {"study.cycles": 6, "study.record_last": 2}
    outcome = carry_out(load_scene(OSCILLATOR, study | changes | {"solver.estimate_error": False}))
    found = [line for line in outcome.summary if "steps a cycle" in line]
    steps = outcome.groups[""]["cycle_steps"].values
    if why is None:
        assert not found
        assert np.all((steps > 50) & (steps < 100))
    else:
        (line,) = found
        assert f"{steps.max()} in cycle {steps.argmax() + 1}, where" in line
        assert "asks for about 80: " in line
        assert [why in line for why in (VIBRATES, TURNS)] == [why == VIBRATES, why == TURNS]


def cycles(steps: list[int], events: int) -> Dataset:
    """Cycles of 1 s with the transitions of two contacts in the second, the last one without samples."""
    count = len(steps)
    return Dataset(
        {
            "cycle_steps": ("cycle", steps),
            "cycle_start": ("cycle", np.arange(count, dtype=float)),
            "cycle_period": ("cycle", np.ones(count)),
            "cycle_frequency": ("cycle", np.ones(count)),
            "event_time": ("event", 1 + np.linspace(0.1, 0.9, events)),
            "event_contact": ("event", np.arange(events) % 3 % 2),
            "contact_force": (("time", "contact", "component"), np.zeros((0, 2, 3))),
            "contact_state": (("time", "contact"), np.zeros((0, 2))),
            "modal_velocity": (("time", "mode"), np.zeros((0, 1))),
        },
        {"time": np.zeros(0), "cycle": np.arange(1, count + 1), "contact": ["pad", "stop"]},
    )


def soft() -> Model:
    """A mass of 1 Hz with two contacts that add nothing to its stiffness."""
    body = systems.structure([(2 * np.pi) ** 2], [0.1], [[1, 0, 0]])
    return Model(
        body, (systems.pad(0.3, 1e-3, 0.0, 1.0),) * 2, systems.excitation(1.0, [1.0], [0.0]), systems.at_rest(1, 2)
    )


def test_transitions_that_accumulate() -> None:
    (line,) = effort_lines(cycles([75, 5000, 80], 900), soft(), PRESETS["standard"])
    assert line == (
        "1.72e+03 steps a cycle, 5000 in cycle 2, where its tolerance asks for about 80: "
        "900 transitions in it, 600 of contact pad"
    )


@pytest.mark.parametrize("steps", [[5000, 75, 80], [75, 80, 5000]])
def test_transitions_of_another_cycle_are_no_cause(steps: list[int]) -> None:
    (line,) = effort_lines(cycles(steps, 900), soft(), PRESETS["standard"])
    assert line.endswith(": neither stiffness nor transitions nor little normal load account for them")


def test_vibrations_are_counted_in_a_cycle_of_the_frequency_of_its_phase() -> None:
    data = cycles([75, 5000, 80], 9)
    (line,) = effort_lines(data.assign(cycle_frequency=("cycle", [1.0, 0.01, 1.0])), soft(), PRESETS["standard"])
    assert line.endswith(f": {VIBRATES} 100 times in a cycle")


def test_what_has_no_known_cause_is_said_to_have_none() -> None:
    (line,) = effort_lines(cycles([75, 5000, 80], 9), soft(), PRESETS["standard"])
    assert line.endswith(": neither stiffness nor transitions nor little normal load account for them")


def test_usual_cycles_and_fixed_steps_are_not_spoken_of() -> None:
    assert not [*effort_lines(cycles([75, 500, 80], 9), soft(), PRESETS["standard"])]
    assert not [*effort_lines(cycles([75, 5000, 80], 9), soft(), Solver("rk4", 0.0, 0.0, longest=2 * np.pi / 5000))]
    assert not [*effort_lines(cycles([], 9), soft(), PRESETS["standard"])]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, None),
        pytest.param(
            {"contacts.pad.normal_stiffness": 1e6, "contacts.pad.tangential_stiffness": 1e6},
            VIBRATES,
            marks=pytest.mark.slow,
        ),
        ({"contacts.pad.friction": 1e-3}, TURNS),
    ],
)
def test_a_sweep_says_where_its_cycles_take_many_steps_and_why(changes: dict[str, Any], why: str | None) -> None:
    study = {"kind": "sweep", "frequency": {"values": [0.9, 1.0]}, "over": {"contacts.pad.preload": [1, 3]}}
    scene = load_scene(OSCILLATOR, {"study": study} | changes)
    outcome, usual = carry_out(scene), steps_for(scene.solver())[0]
    data = outcome.groups[""]
    found = [line for line in outcome.summary if "ten times the steps" in line]
    assert np.all(data["cycle_steps"] > 50)
    if why is None:
        assert not found
        # At the lighter preload the contact slips and opens in each cycle, at the other one it sticks.
        np.testing.assert_array_equal(data["cycle_transitions"].values.squeeze(), [[4, 4], [0, 0]])
        return
    (line,) = found
    steps = data["cycle_steps"].values
    preload, _, frequency = np.unravel_index(np.argmax(steps), steps.shape)
    place = f"contacts.pad.preload {[1, 3][preload]}, {[0.9, 1][frequency]} Hz: {why}"
    assert line.startswith(f"{np.count_nonzero(steps >= 10 * usual)} points take ten times the steps")
    assert f"the most, {steps.max():.0f} a cycle where it asks for about {round(usual, -1):.0f}, at {place}" in line


def test_a_point_whose_motion_asks_for_no_more_steps_has_been_shot_with_finer_ones() -> None:
    """The tolerance of settling asks for them, not the motion."""
    study = {"kind": "sweep", "frequency": {"values": [0.9, 1.0]}, "settle": {"tolerance": 1e-8}}
    scene = load_scene(OSCILLATOR, {"study": study})
    dims = ("direction", "frequency")
    steps, transitions = np.array([[80.0, 1500.0]]), np.array([[[4.0], [4.0]]])
    data = Dataset(
        {"cycle_steps": (dims, steps), "cycle_transitions": ((*dims, "contact"), transitions)},
        {"direction": ["independent"], "frequency": [0.9, 1.0], "contact": ["pad"]},
    )
    (line,) = sweep_effort_lines(data, scene)
    assert line.startswith("1 point takes ten times the steps that the tolerance asks for; the most, 1500 a cycle")
    assert line.endswith("shooting takes finer steps where the noise of the usual ones is above settle.tolerance")


def test_points_without_steps_are_not_spoken_of() -> None:
    linear = load_scene(OSCILLATOR, {"contacts": [], "study": {"kind": "sweep", "frequency": {"values": [0.9]}}})
    outcome = carry_out(linear)
    assert outcome.groups[""]["cycle_steps"].item() == 0
    assert not [line for line in outcome.summary if "steps" in line]
