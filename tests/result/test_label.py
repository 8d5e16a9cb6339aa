"""The units that result files name are those of the numbers: a scene in other units of length, force and time tells."""

import warnings
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray
from systems import oscillator_scene

import timesim
from timesim.result.label import LABELS, attributes, counted, with_unit

LENGTH, FORCE, TIME = 8.0, 4.0, 0.5  # powers of two: no rounding
SIZE = {"length": LENGTH, "force": FORCE, "s": TIME, "Hz": 1 / TIME, "modal length": 1.0, "degree": 1.0, "1": 1.0}


def factor(units: str) -> float:
    """Of a number in these units, such as force*length."""
    above, *below = units.split("/")
    product = np.prod([SIZE[part] for part in above.split("*")])
    return float(product / np.prod([SIZE[part] for part in below]))


UNITS = {
    **dict.fromkeys(("frequency", "step", "width", "refine"), "Hz"),
    **dict.fromkeys(("A", "B", "D"), "length"),
    **dict.fromkeys(("tangential_stiffness", "normal_stiffness"), "force/length"),
    **dict.fromkeys(("preload", "accuracy"), "force"),
}
"""Of the numbers in a study or a contact, by the last part of their key; those of an optimum are preloads."""


def scaled(given: Any, key: str = "") -> Any:
    """Numbers in other units: all below a key that has some, whatever they are the parts of."""
    if isinstance(given, Mapping):
        own = (key if name in ("from", "to", "values") else name for name in given)
        return {
            name: scaled(item, part.rsplit(".", 1)[-1]) for part, (name, item) in zip(own, given.items(), strict=True)
        }
    if isinstance(given, list):
        return [scaled(item, key) for item in given]
    return given * factor(UNITS[key]) if key in UNITS else given


def in_other_units(scene: Mapping[str, Any]) -> dict[str, Any]:
    """Each length times `LENGTH`, each force times `FORCE`, each time times `TIME`; modal coordinates as they are."""
    changed = (
        dict(scene)
        | {"units": {"length": "mm", "force": "kN"}}
        | {name: scaled(scene[name]) for name in ("contacts", "study")}
    )
    if "structure" not in scene:
        return changed
    modes = [
        mode
        | {
            "frequency": mode["frequency"] / TIME,
            "mass": mode["mass"] * FORCE * LENGTH * TIME**2,
            "shape": {point: [LENGTH * x for x in row] for point, row in mode["shape"].items()},
        }
        for mode in scene["structure"]["modes"]
    ]
    load = scaled(scene["excitation"])
    load["modal_force"] = [row | {"amplitude": row["amplitude"] * FORCE * LENGTH} for row in load["modal_force"]]
    return changed | {"structure": {"modes": modes}, "excitation": load}


QUICK = {"settle": {"tolerance": 1e-5, "max_cycles": 400}}
BALANCE: dict[str, Any] = {"harmonics": 3, "time_samples": 64}
AXES = {
    "contacts.pad.preload": [1.0, 32.0],
    "contacts.pad.friction": [0.5],
    "contacts.pad.normal_stiffness": [20.0],
    "contacts.pad.tangential_stiffness": [20.0],
    "structure.modes.0.frequency": [0.9],
    "structure.modes.0.damping_ratio": [0.02],
    "excitation.modal_force.0.phase_deg": [0.0],
}
OVER = {"over": AXES}
RANGE = {"frequency": {"from": 1.245, "to": 1.265}, "step": 0.005, "width": 2e-3, "starts": 5}
ALONG = {"along": {"contacts.pad.preload": {"from": 3.0, "to": 4.4, "num": 3}}, "accuracy": 0.5}
MOTION = {"A": 1.0, "B": 0.5, "phi_deg": 60.0, "D": 0.4, "psi_deg": 20.0}
MAPS: dict[str, dict[str, Any]] = {
    "a, b": {"A": {"from": 0.5, "to": 1.0, "num": 2}, "B": [0.2, 0.5]},
    "d, phi_deg": {"D": [0.2, 0.4], "phi_deg": [30.0, 60.0]},
    "psi_deg, friction": {"psi_deg": [0.0, 20.0], "friction": [0.3, 0.5]},
    "normal_stiffness, preload": {"normal_stiffness": [10.0, 20.0], "preload": [1.0, 2.0]},
}
STUDIES: dict[str, dict[str, Any]] = {
    "transient": {"cycles": 6, "samples_per_cycle": 20},
    "jump": {"phases": [{"frequency": 1.1, "cycles": 2}, {"frequency": 1.0, "cycles": 2}], "samples_per_cycle": 8},
    "tradeoff": {"cycles": 3, "budget": 1e-3},
    "sweep": {"frequency": {"values": [1.1, 1.25]}, "direction": "both", "periodic": "shoot", "refine": 0.05}
    | QUICK
    | OVER,
    "hbm": {"frequency": {"from": 1.25, "to": 1.05}, "continuation": {"max_step": 0.2}} | BALANCE,
    "hbm with convergence": {"frequency": {"from": 1.25, "to": 1.2}, "convergence": True} | BALANCE,
    "compare": {"frequency": {"values": [1.05, 1.25]}} | QUICK | BALANCE,
    "bistable": RANGE | QUICK | BALANCE,
    "optimum": {"frequency": {"values": [1.41, 1.46, 1.51]}} | ALONG | QUICK,
    "element": MOTION | {"principal_axes": True, "samples": 36},
    **{f"element_map over {axes}": MOTION | own for axes, own in MAPS.items()},
}
PRELOAD = {"bistable": 2.0, "optimum": 3.0}
SLOW = ("bistable", "compare", "hbm with convergence")


def scene(name: str) -> dict[str, Any]:
    """A scene of each kind of study, as small as shows every variable."""
    kind = name.split()[0]
    given = oscillator_scene(preload=PRELOAD.get(kind, 1.0), phase_deg=40.0) | {"solver": {"accuracy": "draft"}}
    if kind.startswith("element"):
        given = {key: given[key] for key in ("contacts", "solver")}
    elif kind in ("transient", "tradeoff"):
        given["excitation"] |= {"frequency": 1.1}
    return given | {"study": {"kind": kind} | STUDIES[name]}


@cache
def groups(name: str) -> list[tuple[xarray.Dataset, xarray.Dataset]]:
    """The parts of a result, each beside that of the same scene in other units."""
    with warnings.catch_warnings():
        # Of a tradeoff one run is made, as which of several are the quickest would depend on the machine.
        warnings.filterwarnings("ignore", "the run is incomplete: no two runs of the whole scene", RuntimeWarning)
        results = [timesim.run(given) for given in (scene(name), in_other_units(scene(name)))]
    parts = [
        [node.to_dataset() for node in result.subtree] if isinstance(result, xarray.DataTree) else [result]
        for result in results
    ]
    return list(zip(*parts, strict=True))


def assert_in_its_units(one: xarray.Dataset, other: xarray.Dataset, name: str) -> None:
    variable, values = one[name], other[name].values
    units = variable.attrs.get("units")
    assert other[name].attrs.get("units") == (units and units.replace("length", "mm").replace("force", "kN"))
    assert variable.attrs["long_name"]
    if variable.dtype.kind != "f":
        np.testing.assert_array_equal(values, variable, err_msg=name)
        return
    by = factor(variable.attrs["units"])
    if name in ("closure", "seconds_a_cycle", "seconds_scatter", "compile_seconds_before"):  # of rounding; times
        return
    # A difference of motions that are nearly the same: known to their rounding.
    if name in ("settled_to", "cycle_amplitude_error", "relative_difference"):
        np.testing.assert_allclose(values, variable, rtol=1e-3, atol=1e-12)
        return
    size = np.abs((one["energy_input"] if name == "energy_residual" else variable).values)
    largest = np.max(size, initial=0.0, where=np.isfinite(size)) * by
    np.testing.assert_allclose(values, variable * by, rtol=0, atol=1e-9 * float(largest), err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in STUDIES])
def test_every_variable_has_the_units_that_it_names(name: str):
    seen = set()
    for one, other in groups(name):
        assert set(one.variables) == set(other.variables)
        for variable in map(str, one.variables):
            assert_in_its_units(one, other, variable)
            seen |= {one[variable].attrs.get("units")} if one[variable].size else set()
    assert len(seen - {None}) >= 2


@pytest.mark.long
@pytest.mark.slow
def test_no_label_is_left_over():
    """A name of the table that no study writes, or that the scenes above do not show."""
    written = {str(variable) for name in STUDIES for one, _ in groups(name) for variable in one.variables}
    assert set(LABELS) - written == set()


def test_a_number_has_the_unit_that_the_scene_names():
    for named, units in ((None, "force/length"), ({"force": "N"}, "N/length"), ({"length": "mm"}, "force/mm")):
        assert attributes("effective_stiffness", named)["units"] == units
        assert with_unit("2", attributes("effective_stiffness", named)) == "2"
    assert with_unit("2", attributes("effective_stiffness", {"length": "mm", "force": "kgforce"})) == "2 kgforce/mm"


def test_energy_and_power_in_newtons_and_metres_are_in_joules_and_watts():
    for named, units in (({"length": "m", "force": "N"}, ("J", "W")), ({"length": "mm"}, ("force*mm", "force*mm/s"))):
        assert tuple(attributes(name, named)["units"] for name in ("dissipation", "dissipated_power")) == units


def test_one_of_a_thing_is_not_several():
    assert counted(1, "point") == "1 point"
    assert counted(0, "frequency", "frequencies") == "0 frequencies"


def test_names_are_short_enough_for_an_axis_and_what_explains_them_stands_apart():
    assert max(len(attributes(name)["long_name"]) for name in LABELS) <= 70
    amplitude = attributes("amplitude", {"length": "mm"})
    assert (amplitude["long_name"], amplitude["units"]) == ("displacement amplitude", "mm")
    assert amplitude["comment"].startswith("(max - min)/2 over a period")
    assert "comment" not in attributes("displacement")
