"""The bound on friction between the directions of the contact plane that are tried: few of them prove nothing false."""

import numpy as np
import pytest
from simulation import simulate
from systems import excitation, pad, structure

from timesim.model import reduction
from timesim.model.model import Model, Start
from timesim.model.reduction import reduction_of

pytestmark = pytest.mark.long

FREQUENCY = 0.2


def released(angle_deg: float, strength: float) -> Model:
    """A free vibration along one direction of the contact plane; its friction force reaches 1 / `strength` of mu n.

    Without damping the bound is exact along that direction.
    """
    stiffness, friction, load, omega = 2.0, 0.5, 1.0, np.sqrt(1.0 + 2.0)
    angle = np.deg2rad(angle_deg)
    body = structure([1.0], [0.0], [[np.cos(angle), np.sin(angle), 0.0]])
    velocity = friction * load / stiffness * omega / strength
    start = Start(np.zeros(1), np.array([velocity]), np.zeros((1, 2)), np.array([-1]))
    still = excitation(FREQUENCY, [0.0], [0.0])
    return Model(body, (pad(friction, stiffness, 0.0, load),), still, start)


def slips(model: Model) -> bool:
    return bool(simulate(model, 2).sequence)


@pytest.mark.parametrize("directions", [6, 8, 720])
def test_a_motion_between_two_directions_is_not_proven_to_stick(directions: int, monkeypatch: pytest.MonkeyPatch):
    """Midway between two directions a force of the size of mu n shows by only cos(pi / directions) of it."""
    monkeypatch.setattr(reduction, "DIRECTIONS", directions)
    between = 180.0 / directions
    seen = np.cos(np.pi / directions)
    model = released(between, strength=0.5 * (1 + seen) - 1e-9)
    assert slips(model)
    assert reduction_of(model, [FREQUENCY]).live.tolist() == [0]


@pytest.mark.parametrize("angle", [0.0, 22.5, 100.0])
def test_few_directions_still_prove_what_is_far_inside_the_cone(angle: float, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reduction, "DIRECTIONS", 8)
    model = released(angle, strength=1.0 + np.pi / 8 + 0.01)
    assert reduction_of(model, [FREQUENCY]).stuck.tolist() == [0]
    assert not slips(model)
    assert reduction_of(released(angle, strength=1.0 + np.pi / 16), [FREQUENCY]).live.tolist() == [0]
