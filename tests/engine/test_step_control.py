"""What bounds the length of a step: the error of every part of the state, that of the slip by itself too."""

from dataclasses import replace

import numpy as np
import pytest
from simulation import Trace, simulate
from systems import at_rest, excitation, pad, structure

from timesim.engine.solver import Solver
from timesim.model.model import SLIP, Model

RTOL = (1e-4, 1e-5, 1e-6, 1e-7)


def heavy_body_on_a_soft_pad() -> Model:
    """A body driven along an ellipse by forces, which a soft pad hardly feels.

    The pad's force follows the direction of the motion within a hundredth of a cycle, while the body moves smoothly:
    the steps that are short enough for the body are far too long for the slip.
    """
    natural, stiffness = 0.3, 1e-6
    body = structure([natural**2] * 2, [0.02 * natural] * 2, [[1, 0, 0], [0, 1, 0]])
    load = excitation(1 / (2 * np.pi), [1.0, 0.0], [0.0, 0.5])
    contact = pad(0.3, stiffness, 0.0, 0.05 * stiffness / 0.3)
    return Model(body, (contact,), load, at_rest(2, 1))


@pytest.fixture(scope="module")
def exact() -> Trace:
    return simulate(heavy_body_on_a_soft_pad(), 3, Solver("dopri8", 1e-13, 1e-15))


def test_the_body_hardly_feels_the_pad(exact: Trace):
    alone = simulate(replace(heavy_body_on_a_soft_pad(), contacts=(), start=at_rest(2, 0)), 3)
    assert np.abs(exact.motion - alone.motion).max() < 1e-5 * np.abs(exact.motion).max()
    assert exact.run.state.tolist() == [SLIP]


@pytest.mark.parametrize("rtol", RTOL)
def test_the_error_of_the_slip_alone_shortens_the_step(exact: Trace, rtol: float):
    """The dissipation adds up the slip of all steps; the slip at the end forgets earlier errors."""
    found = simulate(heavy_body_on_a_soft_pad(), 3, Solver("tsit5", rtol, rtol / 100))
    dissipated, truth = found.totals.work[-1][2], exact.totals.work[-1][2]
    assert abs(dissipated / truth - 1) < rtol
    assert np.abs(found.run.slip - exact.run.slip).max() < rtol * np.abs(exact.run.slip).max()
    assert found.sequence == exact.sequence
