"""What the equations keep, the studies keep: jumps, ranges, the least peak and elements in other units, mirrored."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zoo
from systems import oscillator

from timesim.model.model import Model
from timesim.study.registry import carry_out, load_scene

MASS, LENGTH, TIME = 3e4, 2e-5, 7e3
"""Units that are as many times smaller, so that numbers are as many times larger."""
STIFFNESS, FORCE = MASS / TIME**2, MASS * LENGTH / TIME**2


def in_other_units(model: Model) -> Model:
    """The same model in units of mass, length and time of other sizes, its modes normalised otherwise each."""
    body, load = model.structure, model.excitation
    share = 10.0 ** np.linspace(-3, 2, body.num_modes)  # of the modal masses
    body = replace(
        body,
        frequency=body.frequency / TIME,
        mass=body.mass * MASS * share,
        damping=body.damping * MASS / TIME * share,
        shape=body.shape * np.sqrt(share),
    )
    force = FORCE * np.sqrt(share)
    load = replace(load, frequency=None, cosine=load.cosine * force, sine=load.sine * force)
    contacts = tuple(
        replace(
            contact,
            tangential_stiffness=contact.tangential_stiffness * STIFFNESS,
            normal_stiffness=contact.normal_stiffness * STIFFNESS,
            preload=contact.preload * FORCE,
        )
        for contact in model.contacts
    )
    return replace(model, structure=body, excitation=load, contacts=contacts)


def mirrored(scene: dict[str, Any], turn: float) -> dict[str, Any]:
    """The scene with x for -x, and the phase of the excitation turned [degrees]."""
    scene = deepcopy(scene)
    for mode in scene["structure"]["modes"]:
        mode["shape"] = {name: [-x, y, z] for name, (x, y, z) in mode["shape"].items()}
    for contact in scene["contacts"]:
        for axis in ("normal", "tangent"):
            contact[axis][0] *= -1
        if not np.isscalar(stiffness := contact["tangential_stiffness"]):  # t2 = n x t1 is not mirrored, but turned
            contact["tangential_stiffness"] = (stiffness * np.array([[1, -1], [-1, 1]])).tolist()
    for force in scene["excitation"]["modal_force"]:
        force["phase_deg"] += turn
    return scene


def result(scene: dict[str, Any], study: dict[str, Any], **more: Any) -> Any:
    outcome = carry_out(load_scene(scene | {"study": study} | more))
    assert outcome.reason is None
    return outcome.groups[""]


def span(low: float, high: float, step: float, unit: float = 1.0) -> dict[str, float]:
    return {"from": low / unit, "to": high / unit, "step": step / unit}


@pytest.mark.long
def test_a_schedule_in_other_units_and_mirrored():
    model = zoo.with_full_stiffness(zoo.driven(704, (2, 1))[0], 704)
    given = float(model.excitation.frequency or 0.0)

    def of(scene: dict[str, Any], unit: float = 1.0) -> Any:
        phases = [{"frequency": share * given / unit, "cycles": 10} for share in (1.0, 1.03, 0.98)]
        scene = scene | {"excitation": {"modal_force": scene["excitation"]["modal_force"]}}
        return result(scene, {"kind": "jump", "phases": phases}, solver={"accuracy": "reference"})

    scene = zoo.scene_of(model)
    first, other, image = of(scene), of(zoo.scene_of(in_other_units(model)), TIME), of(mirrored(scene, 0.0))
    assert first.sizes["event"] > 20
    size = float(first["cycle_amplitude"].max())
    for one, length, time in ((other, LENGTH, TIME), (image, 1.0, 1.0)):
        np.testing.assert_allclose(one["event_time"] / time, first["event_time"], rtol=1e-8)
        np.testing.assert_allclose(one["cycle_amplitude"] / length, first["cycle_amplitude"], atol=1e-8 * size)


@pytest.mark.long
def test_a_range_with_two_motions_in_other_units_and_mirrored():
    model = oscillator(-4.0, 0.94)

    def of(scene: dict[str, Any], unit: float = 1.0) -> Any:
        frequency = span(0.938, 0.95, 0.003, unit)
        step, settle = frequency.pop("step"), {"tolerance": 1e-9, "max_cycles": 3000}
        more = {"step": step, "width": 1e-4 / unit, "starts": 0, "harmonics": 0, "settle": settle}
        return result(scene, {"kind": "bistable", "frequency": frequency, **more})

    scene = zoo.scene_of(replace(model, excitation=replace(model.excitation, frequency=None)))
    first, other, image = of(scene), of(zoo.scene_of(in_other_units(model)), TIME), of(mirrored(scene, 77.0))
    assert first["range"].shape == (1, 2)
    for one, length, time in ((other, LENGTH, TIME), (image, 1.0, 1.0)):
        np.testing.assert_allclose(one["range"] * time, first["range"], rtol=1e-9)
        for name in ("amplitude_lower", "amplitude_upper", "jump_from", "jump_to"):
            np.testing.assert_allclose(one[name] / length, first[name], rtol=1e-6)


@pytest.mark.long
def test_the_least_peak_in_other_units_and_mirrored():
    model = oscillator(3.0, 1.39)

    def of(scene: dict[str, Any], force: float = 1.0, unit: float = 1.0) -> Any:
        (name,) = [contact["name"] for contact in scene["contacts"]]
        along = {f"contacts.{name}.preload": {"from": 3.2 * force, "to": 4.4 * force, "num": 3}}
        more = {"accuracy": 0.1 * force, "frequency": span(1.38, 1.5, 0.03, unit), "periodic": "shoot"}
        return result(scene, {"kind": "optimum", "along": along, **more})

    scene = zoo.scene_of(replace(model, excitation=replace(model.excitation, frequency=None)))
    first, other, image = of(scene), of(zoo.scene_of(in_other_units(model)), FORCE, TIME), of(mirrored(scene, 77.0))
    for one, length, force in ((other, LENGTH, FORCE), (image, 1.0, 1.0)):
        np.testing.assert_allclose(one["peak"] / length, first["peak"], rtol=1e-6)
        np.testing.assert_allclose(one["optimum"] / force, first["optimum"], rtol=1e-4)


@pytest.mark.parametrize("preload", [1.0, 0.0, -0.3])
def test_an_element_in_other_units_and_mirrored(preload: float):
    stiffness, force = np.array([[2.0, 0.6], [0.6, 1.0]]), STIFFNESS * LENGTH

    def of(K: np.ndarray, k: float, length: float, phi: float) -> Any:
        pad = {"name": "pad", "friction": 0.6, "tangential_stiffness": (k * K).tolist(), "normal_stiffness": k}
        sizes = {key: length * size for key, size in {"A": 1.5, "B": 0.7, "D": 0.8}.items()}
        study = {"kind": "element", **sizes, "phi_deg": phi, "psi_deg": 110, "harmonics": 5, "cross_check": False}
        return result({"contacts": [pad | {"preload": k * length * preload}]}, study)

    first, other = of(stiffness, 1.0, 1.0, 50), of(stiffness, STIFFNESS, LENGTH, 50)
    image = of(stiffness * [[1, -1], [-1, 1]], 1.0, 1.0, 50 + 180)  # t2 for -t2
    assert first.sizes["event"] > 1
    for name in ("f_b", "f_s", "f_c", "force_cos", "force_sin", "force"):
        np.testing.assert_allclose(other[name] / force, first[name], atol=1e-10)
        turned = [1, 1] if name in ("f_s", "f_c") else [1, -1]  # those are in phase with the motion
        np.testing.assert_allclose(image[name] * turned, first[name], atol=1e-10)
    np.testing.assert_allclose(other["dissipation"] / (force * LENGTH), first["dissipation"], rtol=1e-10)
    np.testing.assert_allclose(image["dissipation"], first["dissipation"], rtol=1e-10)
