"""A model in numbers: the relative motion at a contact in its own axes."""

from dataclasses import replace

import numpy as np
from systems import generated_model


def test_relative_motion_is_that_of_body_1_in_the_axes_of_the_contact():
    model = generated_model(0, 3, 2)
    first = replace(model.contacts[0], point="p2", against="p1")
    model = replace(model, contacts=(first, replace(model.contacts[1], point="p1", against="ground")))
    x = {point: model.structure.shape[model.structure.points.index(point)] for point in ("p1", "p2")}
    assert np.abs(first.frame - first.frame.T).max() > 0.1
    np.testing.assert_allclose(model.contact_shape[0], [axis @ (x["p2"] - x["p1"]) for axis in first.frame], atol=1e-14)
    np.testing.assert_allclose(model.contact_shape[1], [axis @ x["p1"] for axis in model.contacts[1].frame], atol=1e-14)
