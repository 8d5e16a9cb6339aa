"""Coordinates that every result shares."""

from dataclasses import replace

import numpy as np
from systems import oscillator

from timesim.result.coordinate import coordinates


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
