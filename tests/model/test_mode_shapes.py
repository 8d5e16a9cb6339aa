"""Coordinates of a motion in the modes of another structure, by what they move its points."""

import numpy as np
import pytest

import timesim
from timesim.fault import RuleError
from timesim.model.eigenmodes import modal_structure
from timesim.model.matrices import Matrices
from timesim.model.mode_shapes import ModeShapes
from timesim.model.model import Structure
from timesim.result.last_cycle import PeriodicMotion, periodic_motion
from timesim.result.state import saved_states, start_of

RNG = np.random.default_rng(3)
SHAPE = RNG.uniform(-1, 1, (2, 3, 5))
"""Of five modes at two points, which do not determine them in each axis alone."""


def structure(shape, points=("a", "b")):
    ones = np.ones(shape.shape[2])
    return Structure(np.arange(1.0, 1 + ones.size), ones, 0.02 * ones, points, shape)


def chain(mass, **points):
    stiffness = np.array([[60.0, -20.0, 0.0], [-20.0, 60.0, -30.0], [0.0, -30.0, 90.0]])
    points = points or {"a": {"x": 0, "z": 1}, "b": {"x": 2}}
    return modal_structure(Matrices(np.diag(mass), stiffness), points=points, damping_ratio=0.01)


def shapes_of(own):
    return ModeShapes(own.points, own.shape)


def test_the_same_modes_leave_coordinates_as_they_are():
    shapes = ModeShapes(("a", "b"), SHAPE)
    assert shapes.change(structure(SHAPE)) is None
    assert shapes.change(structure(SHAPE * (1 + 1e-9))) is None
    assert shapes.change(structure(SHAPE[::-1], ("b", "a"))) is None
    assert shapes.change(structure(np.concatenate([np.ones((1, 3, 5)), SHAPE]), ("new", "a", "b"))) is None


@pytest.mark.parametrize("num_points", [1, 2])
def test_modes_in_another_order_of_another_sign_and_scale_exchange_coordinates(num_points):
    """Also where the points have fewer components than there are modes."""
    shape, order, scale = SHAPE[:num_points], np.array([2, 0, 1, 4, 3]), np.array([1.0, -1.0, 2.0, -0.5, 1.0])
    names = ("a", "b")[:num_points]
    change = ModeShapes(names, shape).change(structure(shape[..., order] * scale, names))
    expected = np.zeros((5, 5))
    expected[np.arange(5), order] = 1 / scale
    np.testing.assert_allclose(change, expected, rtol=1e-12, atol=1e-12)


def test_a_motion_in_all_coordinates_is_carried_over():
    """By mass: ``q = Phi^T M Phi_0 q_0``; and the points move as before."""
    before, now = chain([1.3, 2.0, 1.1]), chain([1.1, 2.0, 1.6])
    change = shapes_of(before).change(now)
    rows = [(0, 0), (0, 2), (1, 0)]
    old, new = (np.array([own.shape[row] for row in rows]) for own in (before, now))
    np.testing.assert_allclose(change, new.T @ np.diag([1.1, 2.0, 1.6]) @ old, atol=1e-12)
    np.testing.assert_allclose(now.shape @ change, before.shape, atol=1e-12)


def test_other_modes_that_the_points_do_not_determine_are_refused():
    before, now = (chain(mass, a={"x": 0, "z": 1}) for mass in ([1.3, 2.0, 1.1], [1.1, 2.0, 1.6]))
    with pytest.raises(
        RuleError, match=r"has other modes.* mode \d moves a along [xz] by .* there, by .* in the scene"
    ):
        shapes_of(before).change(now)
    with pytest.raises(RuleError, match="has other modes"):  # the points move as no motion of these modes does
        ModeShapes(("a", "b"), SHAPE[..., :2]).change(structure(SHAPE[..., 2:4]))
    still = SHAPE * [1, 1, 0, 0, 1]
    with pytest.raises(RuleError, match="has other modes"):
        ModeShapes(("a", "b"), still).change(structure(still[..., ::-1]))


def test_the_mode_point_and_axis_that_differ_most_are_named():
    before = SHAPE[..., :2]
    now = before.copy()
    now[1, 2, 1] = before[1, 2, 1] + 3
    values = f"by {before[1, 2, 1]:.6g} there, by {now[1, 2, 1]:.6g} in the scene"
    with pytest.raises(RuleError, match=f"mode 2 moves b along z {values}"):
        ModeShapes(("a", "b"), before).change(structure(now))


def test_modes_of_which_no_point_is_known_are_refused():
    with pytest.raises(RuleError, match="names no point of the scene") as error:
        ModeShapes(("a", "b"), SHAPE).change(structure(SHAPE, ("c", "d")))
    assert error.value.hint == "its points are a, b, those of the scene c, d"


# Runs that go on from a result

MATRICES = {
    "mass": [[1.0005, 0], [0, 1.0]],
    "stiffness": [[60, -20], [-20, 60]],
    "damping_ratio": 0.01,
    "points": {"a": {"x": 0, "z": 1}, "b": {"x": 1}},
}
SCENE = {
    "structure": {"matrices": MATRICES},
    "contacts": [
        {"name": "p", "point": "a", "friction": 0.4, "tangential_stiffness": 30, "normal_stiffness": 30, "preload": 2}
    ],
    "excitation": {"frequency": 1.35, "forces": [{"point": "b", "direction": [1, 0, 0], "amplitude": 3}]},
    "study": {"kind": "transient", "cycles": 2, "samples_per_cycle": 20},
}
LIGHTER = {"structure.matrices.mass": [[0.9995, 0], [0, 1.0]]}
"""By a thousandth, which turns the sign of a mode of two nearly equal entries: its largest is positive."""


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    path = tmp_path_factory.mktemp("ended") / "result.nc"
    result = timesim.run(SCENE)
    result.to_netcdf(path, engine="h5netcdf")
    return result, path


@pytest.mark.long
def test_a_run_goes_on_from_where_the_points_were(ended):
    end, path = ended
    for own, noted in ({}, False), (LIGHTER, True):
        scene = timesim.load_scene(SCENE | {"initial": {"from": str(path)}}, own)
        assert any("the motion of its points is carried over" in note for note in scene.model().notes) is noted
        begin = timesim.run(scene)
        for name in ("displacement", "velocity", "slip"):
            here, there = begin[name].isel(time=0), end[name].isel(time=-1)
            np.testing.assert_allclose(here, there, atol=1e-9 * float(np.abs(there).max()))
        assert int(begin["contact_state"][0, 0]) == int(end["contact_state"][-1, 0])


@pytest.mark.long
def test_a_result_without_shapes_is_taken_as_it_is_with_a_warning(ended, tmp_path):
    end, _ = ended
    end.drop_vars("mode_shape").to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    model = timesim.load_scene(SCENE | {"initial": {"from": str(tmp_path / "result.nc")}}, LIGHTER).model()
    np.testing.assert_array_equal(model.start.displacement, end["final_modal_displacement"])
    assert [note for note in model.notes if "does not hold the shapes of its modes" in note]


@pytest.mark.long
def test_a_result_of_other_modes_is_refused_by_its_key(ended):
    keep = {"structure": {"matrices": MATRICES | {"points": {"a": {"z": 1}}}}}
    scene = SCENE | keep | {"excitation": {"frequency": 1.35, "forces": []}, "initial": {"from": str(ended[1])}}
    with pytest.raises(timesim.SceneError, match=r"initial.from: .*has other modes.* mode 1 moves a along x by"):
        timesim.load_scene(scene)


@pytest.mark.long
def test_a_curve_begins_from_the_motion_of_the_points(ended):
    motion, now = periodic_motion(ended[1]), timesim.load_scene(SCENE, LIGHTER).model().structure
    before = timesim.load_scene(SCENE).model().structure
    for own, there in ((before, before), (now, before)):
        moved, expected = own.shape @ motion.guess(own).T, there.shape @ motion.modal.T
        np.testing.assert_allclose(moved, expected, atol=1e-12 * np.abs(expected).max())
    unknown = PeriodicMotion(motion.frequency, motion.modal)
    np.testing.assert_array_equal(unknown.guess(now), motion.modal)


@pytest.mark.long
def test_points_of_a_sweep_over_the_structure_have_modes_of_their_own(tmp_path):
    scale = {"kind": "sweep", "frequency": {"values": [1.3, 1.35]}, "over": {"structure.matrices.mass.0.0": [0.9, 1.2]}}
    scene = {**SCENE, "study": scale, "excitation": {"forces": SCENE["excitation"]["forces"]}}
    result = timesim.run(scene)
    assert result["mode_shape"].dims == ("structure.matrices.mass.0.0", "point", "axis", "mode")
    result.to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    states = saved_states(tmp_path / "result.nc")
    for mass in (0.9, 1.2):
        own = timesim.load_scene(scene, {"structure.matrices.mass.0.0": mass}).model()
        end = states.one({"structure.matrices.mass.0.0": mass, "frequency": 1.35})
        np.testing.assert_array_equal(start_of(own, states, end).displacement, end["final_modal_displacement"])
