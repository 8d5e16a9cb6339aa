"""Coordinates that every result shares."""

from dataclasses import replace

import numpy as np
import pytest
import xarray
from systems import oscillator, oscillator_scene

import timesim
from timesim.result.coordinate import coordinates, over_keys, place_of_largest, rubs, runs


def test_they_are_those_of_the_dimensions_in_use():
    variables = {
        "amplitude": (("solution", "point", "axis"), np.zeros((7, 1, 3))),
        "harmonic_cos": (("solution", "harmonic", "point", "axis"), np.zeros((7, 4, 1, 3))),
        "slip": (("mode", "contact", "tangent"), np.zeros((2, 1, 2)), {"long_name": "slip"}),
    }
    along = coordinates(variables, oscillator(3.0, 1.0))
    dims, friction = along.pop("friction")
    assert dims == ("contact",)
    np.testing.assert_array_equal(friction, [0.5])
    bodies = {name: along.pop(name) for name in ("body_1", "body_2")}
    for (dims, names), joined in zip(bodies.values(), ("tip", "ground"), strict=True):
        assert dims == ("contact",)
        assert names.tolist() == [joined]
    assert {name: values.tolist() for name, values in along.items()} == {
        "point": ["tip"],
        "axis": ["x", "y", "z"],
        "harmonic": [0, 1, 2, 3],
        "mode": [1, 2],
        "contact": ["pad"],
        "tangent": ["t1", "t2"],
    }


def test_a_structure_without_contacts_has_text_as_their_names():
    model = replace(oscillator(3.0, 1.0), contacts=())
    contact = coordinates({"slip_share": (("contact",), np.zeros(0))}, model)["contact"]
    assert contact.dtype.kind == "U"
    assert contact.shape == (0,)


@pytest.mark.long
@pytest.mark.parametrize(
    "study",
    [
        pytest.param({"kind": "sweep", "frequency": {"values": [1.39]}}, marks=pytest.mark.slow),
        {"kind": "hbm", "frequency": {"from": 1.39, "to": 1.4}, "harmonics": 3, "stability": False},
    ],
)
def test_a_contact_that_rubs_for_some_values_of_a_result_is_no_stop(study):
    """The scene's own friction, and the first of the values, would make it one."""
    scene = oscillator_scene(3.0)
    scene["contacts"][0]["friction"] = 0.0
    data = timesim.run(scene | {"study": study | {"over": {"contacts.pad.friction": [0.0, 0.5]}}})
    assert rubs(data).all()


def test_values_with_others_between_them_are_in_runs_of_their_own():
    values = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    found = runs(values, np.array([True, True, False, False, True]))
    assert [run.tolist() for run in found] == [[1.0, 2.0], [16.0]]
    assert runs(values, np.zeros(5, dtype=bool)) == []


def test_of_bodies_that_move_alike_the_first_is_named():
    """Not the one that rounding makes largest; what has no amplitude does not count."""
    amplitude = np.full((2, 3, 3), 0.5)
    amplitude[:, :, 1] = 1 + 1e-9 * np.arange(3)
    amplitude[1, 0] = np.nan
    assert place_of_largest(amplitude) == (0, 1)
    amplitude[0, 2, 1] += 1e-5
    assert place_of_largest(amplitude) == (2, 1)
    assert place_of_largest(1e-9 * amplitude) == (2, 1)
    assert place_of_largest(np.full((1, 2, 3), np.nan)) == (0, 0)
    assert place_of_largest(np.zeros((2, 2, 3))) == (0, 0)


def test_the_scalar_along_which_a_curve_is_followed_is_none_that_it_is_followed_over():
    names = ("structure.modes.0.mass", "contacts.pad.preload", "frequency")
    data = xarray.Dataset({name: (("solution",), np.zeros(2)) for name in names})
    assert over_keys(data) == list(names[:2])
    assert over_keys(data.assign_attrs(along="contacts.pad.preload")) == [names[0]]
