"""The units that result files name are those of the numbers: a scene in other units of length, force and time tells."""

from typing import Any

import numpy as np
from systems import oscillator_scene

import timesim

LENGTH, FORCE, TIME = 8.0, 4.0, 0.5  # powers of two: no rounding
SIZE = {"length": LENGTH, "force": FORCE, "s": TIME, "Hz": 1 / TIME, "modal length": 1.0, "degree": 1.0, "1": 1.0}


def factor(units: str) -> float:
    """Of a number in these units, such as force*length."""
    above, *below = units.split("/")
    product = np.prod([SIZE[part] for part in above.split("*")])
    return float(product / np.prod([SIZE[part] for part in below]))


def in_other_units(scene: dict[str, Any]) -> dict[str, Any]:
    """Each length times `LENGTH`, each force times `FORCE`, each time times `TIME`; modal coordinates as they are."""
    modes = [
        mode
        | {
            "frequency": mode["frequency"] / TIME,
            "mass": mode["mass"] * FORCE * LENGTH * TIME**2,
            "shape": {point: [LENGTH * x for x in row] for point, row in mode["shape"].items()},
        }
        for mode in scene["structure"]["modes"]
    ]
    size = {"tangential_stiffness": FORCE / LENGTH, "normal_stiffness": FORCE / LENGTH, "preload": FORCE}
    contacts = [contact | {key: contact[key] * by for key, by in size.items()} for contact in scene["contacts"]]
    load = dict(scene["excitation"])
    load["modal_force"] = [row | {"amplitude": row["amplitude"] * FORCE * LENGTH} for row in load["modal_force"]]
    if "frequency" in load:
        load["frequency"] /= TIME
    return scene | {"structure": {"modes": modes}, "contacts": contacts, "excitation": load}


def test_every_variable_has_the_units_that_it_names():
    study = {"kind": "transient", "cycles": 6, "samples_per_cycle": 20}
    scene = oscillator_scene(preload=1.0, phase_deg=40.0) | {"study": study, "solver": {"accuracy": "draft"}}
    scene["excitation"] |= {"frequency": 1.1}
    one, other = timesim.run(scene), timesim.run(in_other_units(scene))
    seen = set()
    for name, variable in one.variables.items():
        units = variable.attrs.get("units")
        assert units == other[name].attrs.get("units")
        if variable.dtype.kind != "f":
            np.testing.assert_array_equal(other[name], variable, err_msg=str(name))
            continue
        assert units is not None, name
        seen.add(units)
        expected = variable.values * factor(units)
        size = np.abs(one["energy_input"] if name == "energy_residual" else variable).max() * factor(units)
        np.testing.assert_allclose(other[name], expected, rtol=0, atol=1e-9 * float(size), err_msg=str(name))
    assert len(seen) >= 7
