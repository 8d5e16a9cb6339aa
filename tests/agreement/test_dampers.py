"""A damper between two masses that is far faster than all vibrations: it holds them together, to first order."""

from typing import Any

import numpy as np
import pytest

from timesim.model.choice import choice
from timesim.model.cost import Work
from timesim.scene.report import describe
from timesim.study.outcome import Outcome
from timesim.study.registry import carry_out, load_scene

pytestmark = pytest.mark.long

SPRING, MASSES, MIDDLE = 40.0, 4, 2
TOGETHER = np.array([[1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
"""Motion of the masses from that of three, the two in the middle being one."""


def chain(rate: float | None, study: dict[str, Any], accuracy: str = "standard") -> dict[str, Any]:
    """Four masses on springs, a pad under the first, a force on the last; without a rate the middle is one mass."""
    mass = np.eye(MASSES)
    stiffness = SPRING * (2 * np.eye(MASSES) - np.eye(MASSES, k=1) - np.eye(MASSES, k=-1))
    damping, last = 4e-3 * stiffness, MASSES - 1
    if rate is None:
        mass, stiffness, damping = (TOGETHER.T @ matrix @ TOGETHER for matrix in (mass, stiffness, damping))
        last -= 1
    else:
        pair = slice(MIDDLE - 1, MIDDLE + 1)
        damping[pair, pair] += rate * np.sqrt(SPRING) * np.array([[1, -1], [-1, 1]])
    matrices = {"mass": mass.tolist(), "stiffness": stiffness.tolist(), "damping": damping.tolist()}
    pad = {"name": "pad", "point": "free", "normal": [0, 0, 1], "friction": 0.4, "preload": 1.0}
    force = {"point": "driven", "direction": [1, 0, 0], "amplitude": 2.0}
    frequency = {} if study["kind"] == "sweep" else {"frequency": 0.9}
    return {
        "structure": {"matrices": matrices | {"points": {"free": {"x": 0}, "driven": {"x": last}}}},
        "contacts": [pad | {"tangential_stiffness": SPRING, "normal_stiffness": SPRING}],
        "excitation": frequency | {"forces": [force]},
        "solver": {"accuracy": accuracy},
        "study": study,
    }


RUN: dict[str, Any] = {"kind": "transient", "cycles": 60, "record_last": 1}


def amplitude(outcome: Outcome) -> np.ndarray:
    data = outcome.groups[""]
    name = "cycle_amplitude" if "cycle_amplitude" in data else "amplitude"
    return np.asarray(data[name].sel(axis="x").values)


def methods(rate: float | None, cycles: int) -> list[str]:
    model = load_scene(chain(rate, RUN)).model()
    work = Work.of_run(((0.9, cycles),), estimated=False)
    return [choice(accuracy, model, work, 100_000).solver.name for accuracy in ("draft", "standard", "reference")]


def test_the_method_by_the_rate_of_a_damper_between_modes() -> None:
    """Exact motion by modes spares nothing where damping between these is as fast as all else."""
    assert methods(None, 10**6) == ["dopri8", "dopri8", "dopri8"]
    assert methods(1e2, 10**6) == ["dopri8", "dopri8", "dopri8"]
    assert methods(1e4, 10**6) == ["kvaerno5", "kvaerno5", "dopri8"]
    # However short a run is, where explicit steps would be too many.
    assert methods(1e6, 1) == ["kvaerno5", "kvaerno5", "dopri8"]


@pytest.mark.parametrize(
    ("accuracy", "rate", "error"),
    [
        pytest.param("draft", 1e4, 2e-4, marks=pytest.mark.slow),
        pytest.param("draft", 1e6, 1e-4, marks=pytest.mark.slow),
        pytest.param("standard", 1e4, 2e-4, marks=pytest.mark.slow),
        ("standard", 1e6, 2e-6),
    ],
)
def test_a_damper_that_is_very_fast_holds_two_masses_together(accuracy: str, rate: float, error: float) -> None:
    """At 1e4 and 1e6 times the highest frequency; what it leaves falls with its rate."""
    one, scene = carry_out(load_scene(chain(None, RUN, "reference"))), load_scene(chain(rate, RUN, accuracy))
    assert describe(scene)["method"][0].startswith("kvaerno5: dampers that couple its modes are far faster")
    held = carry_out(scene)
    assert held.reason is None
    assert held.groups[""].attrs["estimated_error"] < {"draft": 1e-4, "standard": 1e-6}[accuracy]
    assert held.groups[""].sizes["event"] == one.groups[""].sizes["event"] > 70
    np.testing.assert_allclose(amplitude(held), amplitude(one), rtol=0, atol=error * amplitude(one).max())


@pytest.mark.slow
def test_a_sweep_settles_with_such_a_damper() -> None:
    study = {"kind": "sweep", "frequency": {"values": [0.5, 0.9, 1.3]}, "settle": {"tolerance": 1e-6}}
    held, one = (carry_out(load_scene(chain(rate, study))) for rate in (1e6, None))
    assert "kvaerno5" in held.groups[""].attrs["method"]
    assert held.reason is None
    assert held.groups[""].settled.values.all()
    np.testing.assert_allclose(amplitude(held), amplitude(one), rtol=1e-5)


def test_a_run_that_follows_a_damper_says_so() -> None:
    solver = {"solver": {"method": "tsit5", "rtol": 1e-5, "estimate_error": False}}
    outcome = carry_out(load_scene(chain(1e3, RUN | {"cycles": 2}) | solver))
    (line,) = (line for line in outcome.summary if "steps a cycle" in line)
    assert ": its damping is up to 2.24e+03 times as fast as the excitation" in line
    assert "vibrates" not in line


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "most"), [(1e4, 60_000), (1e6, 5_000)])
def test_a_tradeoff_recommends_the_method_that_does_not_follow_the_damper(rate: float, most: int) -> None:
    """With 1e6 no other method comes to its end in the budget of steps."""
    study = {"kind": "tradeoff", "cycles": 5, "error": 1e-4, "budget": 60}
    outcome = carry_out(load_scene(chain(rate, study) | {"solver": {"max_steps": most}}))
    data = outcome.groups[""]
    assert outcome.reason is None
    assert '"method": "kvaerno5"' in data.attrs["recommended"]
    best = np.nanargmin(np.where(data["error"] < 1e-4, data["seconds_a_cycle"], np.inf))
    assert data["method"].values[best] == "kvaerno5"
