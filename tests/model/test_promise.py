"""The tolerances that keep what a preset promises."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from systems import oscillator, scene

from timesim.model.cost import cycles_to_settle
from timesim.model.model import Structure
from timesim.model.promise import FINEST, GROWTH, LONGEST, growth, preset, remembered, tightened
from timesim.model.solver import NEVER, PRESETS, Criterion, Solver

pytestmark = pytest.mark.long

MANY_MODES = Path(__file__).parents[1] / "data" / "many_modes.yaml"


def test_memory_is_that_of_the_slowest_mode() -> None:
    model = oscillator(3.0, 1.39)
    decay = np.exp(-2 * np.pi * 0.02 * 0.9 / 1.39)  # of the lower mode in a cycle
    assert remembered(model, 1.39) == pytest.approx(1 / (1 - decay))
    undamped = replace(model, structure=replace(model.structure, damping=np.zeros(2)))
    stuck = model.stuck_rate / (2 * np.pi * 1.39)
    assert growth(undamped, 1.39, 60) == pytest.approx(GROWTH * 60 * stuck)
    assert growth(undamped, 1.39) == pytest.approx(GROWTH * LONGEST * stuck)


def test_an_overdamped_mode_creeps() -> None:
    """At a damping ratio of 50 it decays by 0.01 of its circular frequency, not by 50 times that."""
    model = oscillator(3.0, 1.39)
    body = model.structure
    creeping = replace(model, structure=replace(body, damping=2 * np.array([50.0, 0.5]) * body.mass * body.omega))
    slow = np.exp(-(50 - np.sqrt(50**2 - 1)) * 2 * np.pi * 0.9 / 1.39)
    assert remembered(creeping, 1.39) == pytest.approx(1 / (1 - slow))
    assert cycles_to_settle(creeping, Criterion(1e-8, 2000, NEVER), 1.39) == np.ceil(np.log(1e-8) / np.log(slow))


@pytest.mark.parametrize("between", [0.0, 0.3])
def test_a_free_body_settles_as_its_drag_sets_its_speed(between: float) -> None:
    """Two bodies on which drag acts, with and without a dashpot in between, one without any, and one on a spring."""
    drag = np.diag([0.02, 0.02, 0.0, 2.0])
    drag[:2, :2] += between * np.array([[1, -1], [-1, 1]])
    body = Structure(np.array([0, 0, 0, 1.0]), np.ones(4), drag, (), np.zeros((0, 3, 4)))
    model = replace(oscillator(3.0, 1.39), structure=body, contacts=())
    criterion = Criterion(1e-8, 2000, NEVER)
    assert cycles_to_settle(model, criterion, 1.39) == np.ceil(-np.log(1e-8) * 1.39 / 0.02)
    light = replace(model, structure=replace(body, damping=drag * 0))
    assert cycles_to_settle(light, criterion, 1.39) == 2000


def test_an_easy_scene_keeps_the_tolerances_of_the_preset_and_a_hard_one_gets_finer_ones() -> None:
    easy, hard = oscillator(3.0, 1.39), scene(MANY_MODES)
    frequency = hard.excitation.frequency
    assert frequency is not None
    for accuracy, solver in PRESETS.items():
        assert preset(accuracy, easy, 1.39, 60) == solver
    finer = preset("standard", hard, frequency, 30)
    assert finer.rtol == pytest.approx(1e-6 / growth(hard, frequency, 30), rel=0.05)
    assert finer.rtol < 0.3 * PRESETS["standard"].rtol
    assert finer.atol == pytest.approx(finer.rtol / 100)
    assert preset("standard", hard, frequency, 1).rtol == PRESETS["standard"].rtol


def test_tolerances_stop_above_rounding() -> None:
    solver = Solver("tsit5", 1e-7, 1e-9)
    assert tightened(solver, 0.123456) == Solver("tsit5", 1.2e-8, pytest.approx(1.2e-10))
    assert tightened(solver, 1e-20).rtol == FINEST
    assert tightened(solver, 3.0) == solver
    below = replace(solver, rtol=1e-14, atol=1e-16)
    assert tightened(below, 1e-3) == below
