"""Bodies that nothing holds are named as such, and no others."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from xarray import Dataset

from timesim.fault import SceneError
from timesim.model.solver import NEVER, SHOOT, Criterion
from timesim.orbit.settling import Chain, steady_states
from timesim.result.state import settled_points, states_in
from timesim.study.registry import carry_out, load_scene
from timesim.study.summary.transient import drift_lines

pytestmark = pytest.mark.long

RUNNER = {
    "name": "runner", "point": "sled", "friction": 0.3, "tangential_stiffness": 100, "normal_stiffness": 0, "preload": 1
}  # fmt: skip


def sled(
    study: dict[str, Any], constant: float, frequency: float = 0.0, shaken: float = 0.2, **changes: Any
) -> dict[str, Any]:
    """A mass on a plane, shaken and pushed along it."""
    push = {"point": "sled", "direction": [1, 0, 0]}
    mode = {"frequency": frequency, "damping_ratio": 0.0, "mass": 1.0, "shape": {"sled": [1, 0, 0]}}
    return {
        "units": {"length": "mm"},
        "structure": {"modes": [mode]},
        "contacts": [RUNNER],
        "excitation": {
            "forces": [push | {"amplitude": shaken}],
            "constant_forces": [push | {"amplitude": constant}],
        },
        "solver": {"accuracy": "draft"},
        "study": study,
    } | changes


FREE = {
    "matrices": {
        "mass": [[1, 0], [0, 1]], "stiffness": [[1, -1], [-1, 1]], "damping": [[0.1, 0], [0, 0.1]],
        "points": {"sled": {"x": 0}, "other": {"x": 1}},
    }
}  # fmt: skip
RUN = {"kind": "transient", "cycles": 20}
SWEEP = {"kind": "sweep", "frequency": {"values": [1.0, 1.2]}, "settle": {"max_cycles": 600}}


def drifts(scene: dict[str, Any], frequency: float = 1.0) -> list[str]:
    if scene["study"]["kind"] == "transient":
        scene["excitation"]["frequency"] = frequency
    return [line for line in carry_out(load_scene(scene)).summary if "drift" in line]


def test_a_sled_that_creeps_ahead_in_a_run():
    (line,) = drifts(sled(RUN, 0.25))
    assert line.startswith("the body drifts, in the last cycle sled x by 0.028")
    assert "mm: nothing holds it" in line


def test_a_free_body_on_the_run():
    (line,) = drifts(sled(RUN, 0.25, structure=FREE, contacts=[]))
    assert line.startswith("the body drifts, in the last cycle sled x by 1.09")


@pytest.mark.parametrize(
    "scene",
    [
        sled(RUN, 0.1, shaken=0.05),
        sled(RUN, 0.0),
        sled(RUN, 0.25, frequency=0.3),
        sled({"kind": "transient", "cycles": 2}, 0.25),
    ],
)
def test_what_is_held_does_not_drift(scene: dict[str, Any]):
    """By its contact, without a push, by a spring; nor is a run of two cycles judged."""
    assert drifts(scene) == []


def moved_on(steps: np.ndarray, vibration: float = 1.0, samples: int = 4) -> list[str]:
    """The line on a run whose point vibrates and moves on by a step each cycle."""
    time = np.arange(steps.size * samples + 1) / samples
    way = np.interp(time, np.arange(steps.size + 1), np.concatenate([[0.0], np.cumsum(steps)]))
    x = np.outer(way + vibration * np.sin(2 * np.pi * time), [1.0, 0.0, 0.0])[:, None]
    data = Dataset(
        {"displacement": (("time", "point", "axis"), x)}, {"point": ["sled"], "axis": list("xyz")}, {"complete": 1}
    )
    plan: Any = SimpleNamespace(phases=[(1.0, steps.size)], samples_per_cycle=samples)
    return list(drift_lines(data, plan, np.zeros(1)))


@pytest.mark.parametrize(
    ("steps", "drifts"),
    [
        (np.append(np.full(4, 0.3), np.full(4, 0.1)), True),  # as it began does not matter
        (0.3 * 0.98 ** np.arange(8), True),
        (0.3 * 0.95 ** np.arange(8), False),  # it comes to rest
        (np.append(np.full(7, 0.1), -0.1), False),
        (np.full(8, 1e-3), False),  # of a vibration of 2
        (np.full(8, 3e-3), True),
        (np.full(2400, 1.0), True),  # however far it has come
    ],
)
def test_a_body_drifts_if_it_moves_on_evenly_over_half_of_a_run(steps: np.ndarray, drifts: bool):
    lines = moved_on(steps)
    assert lines == [f"the body drifts, in the last cycle sled x by {steps[-1]:.4g}: nothing holds it"] * drifts


def test_points_of_a_sweep_that_drift():
    outcome = carry_out(load_scene(sled(SWEEP, 0.25)))
    (line,) = [line for line in outcome.summary if "drift" in line]
    assert line.startswith("2 points drift, sled x by 0.0279")
    assert line.endswith("mm a cycle, as nothing holds the body (variable drift): between 1 and 1.2 Hz")
    assert not any("did not settle" in line for line in outcome.summary)
    whole = outcome.groups[""]
    for known, drifts in ((whole, True), (whole.drop_vars("drift"), False)):  # which results of earlier versions lack
        assert (len(list(settled_points(states_in(known), {}))) == 0) == drifts
    data = whole.isel(direction=0, frequency=0).sel(point="sled", axis="x")
    assert data["settled"] == 1
    last = sled(RUN | {"cycles": 160, "record_last": 1}, 0.25)
    last["excitation"]["frequency"] = 1.0
    x = carry_out(load_scene(last)).groups[""]["displacement"].values[:, 0, 0]
    np.testing.assert_allclose(data["drift"], x[-1] - x[0], rtol=1e-6)
    seen = x - np.linspace(0, x[-1] - x[0], x.size)
    np.testing.assert_allclose(data["amplitude"], np.ptp(seen) / 2, rtol=1e-4)
    np.testing.assert_allclose(data["phase_deg"], np.rad2deg(np.angle(np.fft.rfft(seen[:-1])[1])), atol=1e-3)


def test_a_bumper_between_two_points_of_a_body_does_not_hold_it():
    """Not even where rounding leaves a little of their relative motion as the body moves on as a whole."""
    modes = [
        {"frequency": 0.0, "damping_ratio": 0.0, "mass": 1, "shape": {"sled": [0.1 + 0.2, 0, 0], "other": [0.3, 0, 0]}},
        {"frequency": 0.9, "damping_ratio": 0.05, "mass": 1, "shape": {"sled": [0.4, 0, 0], "other": [-0.2, 0, 0]}},
    ]
    bumper = {
        "name": "bumper", "point": "sled", "against": "other", "normal": [1, 0, 0], "friction": 0,
        "tangential_stiffness": 0, "normal_stiffness": 40, "preload": 0,
    }  # fmt: skip
    lines = carry_out(load_scene(sled(SWEEP, 0.25, structure={"modes": modes}, contacts=[RUNNER, bumper]))).summary
    assert any(line.startswith("2 points drift") for line in lines)
    assert not any("did not settle" in line for line in lines)


def test_points_of_a_sweep_that_settle_late_do_not_drift():
    late = SWEEP | {"settle": {"max_cycles": 20}}
    lines = carry_out(load_scene(sled(late, 0.25, frequency=0.1))).summary
    assert any("did not settle" in line for line in lines)
    assert not any("drift" in line for line in lines)


def test_the_loss_of_a_body_does_not_depend_on_how_far_it_has_come():
    def lost(place: float) -> float:
        start = {"modal_displacement": [place], "modal_velocity": [0], "slip": {"runner": [place, 0]}}
        study = SWEEP | {"frequency": {"values": [1.0]}}
        outcome = carry_out(load_scene(sled(study, 0.25, solver={"accuracy": "standard"}, initial=start)))
        return outcome.groups[""]["dissipated_power"].item()

    np.testing.assert_allclose(lost(40), lost(0), rtol=1e-8)


def clutch(**changes: Any) -> dict[str, Any]:
    """Two disks of a rotor, one on a shaft with a third, whose clutch slips under a moment that never stops."""
    moment = {"direction": [1, 0, 0]}
    return {
        "structure": {
            "matrices": {
                "mass": [[2, 0, 0], [0, 0.7, 0], [0, 0, 0.5]],
                "stiffness": [[0, 0, 0], [0, 300, -300], [0, -300, 300]],
                "damping": [[0.4, 0, 0], [0, 0.45, -0.15], [0, -0.15, 0.15]],
                "points": {"engine": {"x": 0}, "gear": {"x": 1}, "wheel": {"x": 2}},
            }
        },
        "contacts": [RUNNER | {"point": "engine", "against": "gear", "tangential_stiffness": 4000, "preload": 5}],
        "excitation": {
            "forces": [moment | {"point": "wheel", "amplitude": 1.2}],
            "constant_forces": [
                moment | {"point": "engine", "amplitude": 2.6}, moment | {"point": "gear", "amplitude": -0.1}
            ],
        },
        "study": {"kind": "sweep", "frequency": {"values": [3.0, 5.0]}, "settle": {"max_cycles": 3000}},
    } | changes  # fmt: skip


SLIPPING = [
    (0.0740665320, [1.19753015, 1.18107092, 1.18107092], [0.00078663, 0.00402153, 0.00182819]),
    (0.6740911018, [0.75235676, 0.66352432, 0.66352432], [0.00043354, 0.01539904, 0.02004229]),
]
"""Power lost in the clutch, and drift and amplitude of the disks at 3 and 5 Hz, by an explicit scheme of second order
with a return map, 32,000 steps a cycle, extrapolated."""


@pytest.mark.parametrize("first", [SHOOT, NEVER])
def test_a_clutch_that_slides_on_settles(first: float):
    """By marching and by shooting."""
    scene = load_scene(clutch())
    chain = Chain(scene.model(), tuple(scene.plan.frequency))
    (orbits,) = steady_states([chain], scene.solver(), Criterion(max_cycles=3000, first_shot=first))
    means = [[1.8579e-4, 2.50381e-3, 2.50381e-3], [-2.27797e-3, 4.90146e-3, 4.90146e-3]]
    for orbit, (lost, drift, amplitude), mean in zip(orbits, SLIPPING, means, strict=True):
        assert orbit.period == 1
        assert orbit.cycles < (50 if first == SHOOT else 600)
        assert orbit.dissipated_power[0] == pytest.approx(lost, rel=1e-6)
        np.testing.assert_allclose(orbit.drift[:, 0], drift, rtol=1e-7)
        np.testing.assert_allclose(orbit.amplitude[:, 0], amplitude, atol=2e-8)
        np.testing.assert_allclose(orbit.phasor[0, :, 0].real, mean, atol=5e-8)  # wherever they have come


BRAKE = RUNNER | {"name": "brake", "point": "engine", "tangential_stiffness": 500, "preload": 100}


def test_a_rotor_that_is_held_or_shaken_to_and_fro_settles():
    """Held by a brake, whose friction is more than the moment; and without a moment that drives it on."""
    shaken = clutch()
    del shaken["excitation"]["constant_forces"]
    held = clutch(contacts=[*clutch()["contacts"], BRAKE])
    held["study"]["frequency"] = {"values": [3.0]}
    for scene in (held, shaken):
        assert (carry_out(load_scene(scene)).groups[""]["settled"].values == 1).all()


def test_a_body_slides_on_along_a_frictionless_floor_as_fast_as_its_drag_allows():
    """Its bouncing under weight repeats; the speed is the push over the drag, along both axes of the floor."""
    push, size = np.array([0.8, 0.5]), np.zeros((3, 3))
    forces = [{"direction": [0, 0, 1], "amplitude": 9.81}, {"direction": [*push, 0], "amplitude": np.hypot(*push)}]
    scene = {
        "structure": {
            "matrices": {
                "mass": np.eye(3), "stiffness": size, "damping": np.diag([0.3, 0.3, 2]),
                "points": {"body": {"x": 0, "y": 1, "z": 2}},
            }
        },
        "contacts": [
            {"name": "floor", "point": "body", "friction": 0, "tangential_stiffness": 0, "normal_stiffness": 2000}
        ],
        "excitation": {
            "forces": [{"point": "body", "direction": [1, 0.3, 1], "amplitude": 20}],
            "constant_forces": [{"point": "body"} | force for force in forces],
        },
        "study": {"kind": "sweep", "frequency": {"values": [2.0, 5.0]}, "periodic": "shoot"},
    }  # fmt: skip
    data = carry_out(load_scene(scene)).groups[""].isel(direction=0).sel(point="body")
    assert (data["settled"].values == 1).all()
    assert data["separation_share"].values.max() > 0.1
    speed = (data["drift"] * data["frequency"]).transpose("frequency", "axis").values
    np.testing.assert_allclose(speed, np.tile([*push / 0.3, 0], (2, 1)), rtol=1e-7, atol=1e-12)


@pytest.mark.slow
def test_harmonic_balance_says_that_the_body_drifts():
    scene = clutch(study={"kind": "compare", "frequency": {"values": [3.0, 4.0]}, "stability": False})
    outcome = carry_out(load_scene(scene))
    assert outcome.reason.endswith("time integration, whose body drifts, as nothing holds it")
    (line,) = [line for line in outcome.summary if "which the balance cannot show" in line]
    assert line == "at 2 points the body drifts, as nothing holds it, which the balance cannot show: 3 to 4 Hz"


@pytest.mark.parametrize("preload", [pytest.param(5, marks=pytest.mark.slow), 1000])
@pytest.mark.parametrize("push", [pytest.param(-2.6, marks=pytest.mark.slow), -3.3])
def test_harmonic_balance_finds_no_motion_of_a_body_that_is_pushed_away(preload: float, push: float):
    """Where the clutch slips all along, and where it sticks: with a mean of 5e13 there seemed to be one."""
    scene = clutch(study={"kind": "hbm", "frequency": {"from": 3.0, "to": 3.1}, "harmonics": 3, "stability": False})
    scene["contacts"][0]["preload"] = preload
    scene["excitation"]["constant_forces"][1]["amplitude"] = push
    outcome = carry_out(load_scene(scene))
    repeats = preload == 1000 and push == -2.6
    assert (outcome.groups[""].sizes["solution"] > 0) == repeats
    assert (outcome.reason is None) == repeats
    if repeats:
        assert np.abs(outcome.groups[""]["harmonic_cos"].sel(harmonic=0)).max() < 1
    else:
        assert outcome.reason.endswith("time integration, whose body drifts, as nothing holds it")


def pair(study: dict[str, Any], constant: float, **changes: Any) -> dict[str, Any]:
    """Two bodies in the plane that a spring and a contact join, and nothing else: a slow dashpot drags them."""
    spring = np.kron([[3.1, 0.37], [0.37, 2.3]], [[1, -1], [-1, 1]])
    mass = np.diag([1.3, 0.7, 1.3, 0.7])
    matrices = {"mass": mass.tolist(), "stiffness": spring.tolist(), "damping": (0.02 * spring + 0.05 * mass).tolist()}
    contact = {
        "name": "joint", "point": "a", "against": "b", "normal": [1, 0.3, 0], "tangent": [0, 1, 0], "friction": 0.4,
        "tangential_stiffness": 1.7, "normal_stiffness": 2.3, "preload": 1,
    }  # fmt: skip
    shaken = {"point": "a", "direction": [1, 0.2, 0], "amplitude": 1}
    return {
        "structure": {"matrices": matrices | {"points": {"a": {"x": 0, "y": 2}, "b": {"x": 1, "y": 3}}}},
        "contacts": [contact],
        "excitation": {
            "forces": [shaken],
            "constant_forces": [{"point": "b", "direction": [1, 0, 0], "amplitude": constant}],
        },
        "study": study,
    } | changes


def test_a_contact_within_a_free_body_does_not_hold_it_by_rounding():
    """The body moves on by the speed at which its drag balances the push, and has no equilibrium."""
    outcome = carry_out(load_scene(pair({"kind": "sweep", "frequency": {"values": [0.2, 0.3]}}, 0.3)))
    assert any(line.startswith("2 points drift") for line in outcome.summary)
    drift = outcome.groups[""].isel(direction=0)["drift"].transpose("frequency", "point", "axis").values
    np.testing.assert_allclose(drift[..., 0], np.outer(0.3 / (0.05 * 2) / np.array([0.2, 0.3]), [1, 1]), rtol=1e-7)
    still = pair(RUN, 0.3, initial="static")
    still["excitation"]["frequency"] = 0.3
    with pytest.raises(SceneError, match="nothing holds"):
        load_scene(still)


def test_a_balance_of_a_free_body_follows_its_curve_to_the_end():
    """Its mean is free and stays where it is: held by the rounding of a contact within the body it came to 2e18."""
    study = {"kind": "hbm", "frequency": {"from": 0.2, "to": 0.5}, "harmonics": 5, "stability": False}
    scene = pair(study, 0.3)
    del scene["excitation"]["constant_forces"]
    outcome = carry_out(load_scene(scene))
    assert outcome.reason is None
    assert np.abs(outcome.groups[""]["harmonic_cos"].sel(harmonic=0)).max() < 1
