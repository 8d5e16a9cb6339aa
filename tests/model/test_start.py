"""Starts on the edge of a friction cone, and from the end of another run."""

from dataclasses import replace

import numpy as np
import pytest
from systems import at_rest, oscillator, oscillator_scene

import timesim
from timesim.fault import RuleError
from timesim.model.contact_state import contact_loads
from timesim.model.model import SEPARATION, SLIP, STICK, Start
from timesim.model.start import given_start, resumed_start
from timesim.result.netcdf import save
from timesim.scene.report import warnings_of
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

ON_CONE = 0.5 * 3.0 / 20.0
"""|w| with which the pad of preload 3 bears mu n0 at rest."""


@pytest.mark.parametrize("excess", [0.0, 1e-16, 3.5e-11, 9e-10])
def test_a_start_off_its_cone_by_rounding_is_set_back_inside(excess: float):
    model, zero = oscillator(3.0, 1.39), np.zeros(2)
    given = np.array([[0.6, -0.8]]) * ON_CONE * (1 + excess)
    start = given_start(model, zero, zero, given)
    loads = contact_loads(model, zero, start.slip)
    assert np.all(loads.size <= loads.limit)
    np.testing.assert_allclose(start.slip, given, rtol=2e-9)


def test_a_start_off_its_cone_by_more_is_refused():
    model, zero = oscillator(3.0, 1.39), np.zeros(2)
    with pytest.raises(RuleError, match="outside its friction cone"):
        given_start(model, zero, zero, np.array([[ON_CONE * (1 + 1e-8), 0.0]]))


def test_an_equilibrium_beyond_all_numbers_is_refused():
    scene = oscillator_scene(3.0) | {"initial": "static", "contacts": []}
    for mode in scene["structure"]["modes"]:
        mode["mass"] = 5e-324
    scene["excitation"] |= {
        "frequency": 1.39,
        "constant_forces": [{"point": "tip", "direction": [1, 0, 0], "amplitude": 1}],
    }
    scene["study"] = {"kind": "transient", "cycles": 1}
    with pytest.raises(timesim.SceneError, match="a displacement exceeds the largest number"):
        timesim.run(scene)


def test_a_run_from_a_start_off_its_cone_by_rounding():
    """Outside the cone, by however little, the event loop would look for the transition in ever shorter steps."""
    study = {"kind": "transient", "cycles": 2}
    initial = {
        "modal_displacement": [0.0, 0.0],
        "modal_velocity": [0.3, 0.0],  # back into the cone
        "slip": {"pad": [-ON_CONE * (1 + 3.5e-11), 0.0]},
    }
    scene = oscillator_scene(3.0) | {"study": study, "initial": initial}
    scene["excitation"]["frequency"] = 1.39
    scene["solver"] = {"accuracy": "standard", "max_steps": 2000}
    result = timesim.run(scene)
    assert result.attrs["complete"] == 1


def test_contacts_of_another_run_go_by_their_names():
    """In an order that is not its own inverse."""
    model, zero = oscillator(3.0, 1.39), np.zeros(2)
    pads = tuple(replace(model.contacts[0], name=name) for name in ("one", "two", "three"))
    three = replace(model, contacts=pads, start=at_rest(2, 3))
    slip = np.array([[ON_CONE, 0.0], [0.0, 0.02], [0.01, 0.0]])
    end = Start(zero, zero, slip, np.array([SLIP, STICK, STICK]))
    start = resumed_start(three, end, ("two", "three", "one"))
    np.testing.assert_array_equal(start.slip, slip[[2, 0, 1]])
    assert start.state.tolist() == [STICK, SLIP, STICK]


def test_the_slip_of_another_run_is_turned_into_the_axes_of_the_contact():
    """It is a vector in the plane of contact; in other axes of that plane it has other components."""
    model = oscillator(3.0, 1.39)
    end = Start(np.zeros(2), np.zeros(2), np.array([[0.01, 0.02]]), np.array([STICK]))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    frames = model.contact_frames
    np.testing.assert_array_equal(resumed_start(model, end, ["pad"], None, frames).slip, end.slip)
    turned = resumed_start(model, end, ["pad"], None, quarter @ frames)
    np.testing.assert_allclose(turned.slip, [[0.02, -0.01]], atol=1e-15)
    tilted = quarter[[2, 0, 1]] @ frames
    with pytest.raises(RuleError, match=r"has another normal of contact pad, in whose plane it slipped: \["):
        resumed_start(model, end, ["pad"], None, tilted)
    apart = replace(end, displacement=np.array([-5.0, 0.0]), state=np.array([SEPARATION]))
    assert resumed_start(model, apart, ["pad"], None, tilted).state.tolist() == [SEPARATION]


@pytest.mark.parametrize("change", ["friction", "preload", "tangential_stiffness"])
def test_a_contact_that_slipped_sticks_where_its_force_is_inside_the_cone_now(change: str):
    """As one that went on slipping its force would jump to mu n, and its slip with it."""
    model, zero = oscillator(3.0, 1.39), np.zeros(2)
    end = Start(zero, zero, np.array([[0.6, -0.8]]) * ON_CONE, np.array([SLIP]))
    assert resumed_start(model, end, ["pad"]).state.tolist() == [SLIP]
    pad = model.contacts[0]
    more = {"friction": 0.6, "preload": 3.3, "tangential_stiffness": 0.9 * pad.tangential_stiffness}[change]
    start = resumed_start(replace(model, contacts=(replace(pad, **{change: more}),)), end, ["pad"])
    assert start.state.tolist() == [STICK]
    np.testing.assert_array_equal(start.slip, end.slip)


def test_a_run_with_more_preload_goes_on_without_a_jump(tmp_path):
    """The friction force goes on from where it was, and the energies of each cycle balance."""
    scene, file = oscillator_scene(3.0), tmp_path / "result.nc"
    scene["excitation"]["frequency"] = 1.39
    scene["study"] = {"kind": "transient", "cycles": 8, "record_last": 8}
    first = timesim.run(scene)
    assert first["final_contact_state"].item() == SLIP
    save(first, file)
    scene["contacts"][0]["preload"] = 4.5
    second = timesim.run(scene | {"initial": {"from": str(file)}})
    before, after = (
        run["contact_force"].sel(component=["t1", "t2"]).values[place] for run, place in ((first, -1), (second, 0))
    )
    np.testing.assert_allclose(after, before, atol=1e-6 * np.abs(before).max())
    assert np.abs(second["energy_residual"]).max() < 1e-6 * second.attrs["peak_stored_energy"]


def test_a_slip_between_other_bodies_is_refused(tmp_path):
    scene, file = oscillator_scene(3.0), tmp_path / "result.nc"
    for mode in scene["structure"]["modes"]:
        mode["shape"] |= {"end": [0.2, 0.1, 0.3]}
    scene["excitation"]["frequency"] = 1.39
    scene["units"] = {"length": "m"}
    scene["study"] = {"kind": "transient", "cycles": 1}
    pad, initial = scene["contacts"][0], {"from": str(file)}
    result = timesim.run(scene)
    assert (result["body_1"].values.tolist(), result["body_2"].values.tolist()) == (["tip"], ["ground"])
    save(result, file)
    for change, joined in (({"point": "end"}, "end and ground"), ({"against": "end"}, "tip and end")):
        rule = f"has contact pad between tip and ground, the scene between {joined}: its slip is another"
        with pytest.raises(timesim.SceneError, match=rule):
            timesim.run(scene | {"contacts": [pad | change], "initial": initial})
    timesim.run(scene | {"contacts": [pad | {"point": "end", "friction": 0}], "initial": initial})
    scene["units"] = {"length": "mm"}
    note = "initial.from: length is in m in the result and in mm in the scene: nothing is converted"
    assert note in warnings_of(load_scene(scene | {"initial": initial}))


@pytest.mark.parametrize("study", ["transient", "sweep"])
def test_a_run_goes_on_in_other_axes_of_the_plane_of_contact(study: str, tmp_path):
    scene, file = oscillator_scene(3.0), tmp_path / "result.nc"
    scene["contacts"][0] |= {"tangent": [1, 0, 0]}
    scene["excitation"]["frequency"] = 1.39
    once = {"kind": "transient", "cycles": 1, "samples_per_cycle": 8}
    first = once if study == "transient" else {"kind": "sweep", "frequency": {"values": [1.39]}}
    save(timesim.run(scene | {"study": first}), file)
    initial = {"from": str(file)} | ({} if study == "transient" else {"at": {"frequency": 1.39}})
    here = timesim.run(scene | {"study": once, "initial": initial})
    scene["contacts"][0] |= {"tangent": [0, 1, 0]}
    there = timesim.run(scene | {"study": once, "initial": initial})
    assert float(abs(here.slip).max()) > 1e-3
    np.testing.assert_allclose(there.displacement, here.displacement, atol=1e-6 * float(abs(here.displacement).max()))
