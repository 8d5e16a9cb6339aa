"""Studies as functions of arrays: the same bits as scene files give, and arguments that are refused."""

import inspect
import logging
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

import timesim

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]


def oscillator(preload=3.0, **pad):
    """The oscillator of configs/oscillator.yaml."""
    file = timesim.load_scene(ROOT / "configs/oscillator.yaml").source.data
    modes, pads = file["structure"]["modes"], file["contacts"]
    frequency, ratio, mass = (np.array([mode[key] for mode in modes]) for key in ("frequency", "damping_ratio", "mass"))
    structure = timesim.modes(frequency, ratio, {"tip": [mode["shape"]["tip"] for mode in modes]}, mass=mass)
    given = {key: value for key, value in pads[0].items() if key not in {"name", "point", "preload"}}
    force = timesim.modal_forces([force["amplitude"] for force in file["excitation"]["modal_force"]])
    return timesim.system(structure, [timesim.contact("pad", "tip", preload=preload, **given | pad)], force)


M, K = np.diag([1.0, 2.0]), np.array([[80.0, -40.0], [-40.0, 40.0]])
FORCE = {"forces": [{"point": "tip", "direction": [1, 0, 0], "amplitude": 1.0}]}


PART = xarray.Dataset(attrs={"study": "sweep"})
"""A result without its variables."""


def one_mass():
    return timesim.modes([1.0], 0.1, {"tip": [[1, 0, 0]]})


def pad(point="tip", **given):
    whole = {"friction": 0.5, "tangential_stiffness": 20.0, "normal_stiffness": 20.0} | given
    return timesim.contact("pad", point, **whole)


def assert_same(one, other):
    assert set(one.variables) == set(other.variables)
    for name in one.variables:
        xarray.testing.assert_identical(one[name].drop_attrs(), other[name].drop_attrs())


def test_a_warning_names_the_line_of_the_caller():
    system = timesim.system(timesim.modes([1.0], 1.5, {"tip": [[1, 0, 0]]}), [], timesim.modal_forces([1.0]))
    with pytest.warns(timesim.SceneWarning, match="damping ratio") as said:
        timesim.integrate(system, 1.0, 2)
    assert {one.filename for one in said} == {__file__}


def test_a_run_from_arrays_gives_the_bits_of_the_scene_file(tmp_path):
    file = timesim.load_scene(ROOT / "configs/oscillator.yaml").source.data
    short = {"study.cycles": 5, "study.record_last": 2}
    expected = timesim.run(ROOT / "configs/oscillator.yaml", short)
    preload = file["contacts"][0]["preload"]
    found = timesim.integrate(oscillator(preload), file["excitation"]["frequency"], 5, record_last=2)
    assert_same(found, expected)
    assert timesim.plot(found, tmp_path / "new")


def test_what_the_command_prints_of_a_run_is_logged(caplog):
    assert not logging.getLogger("timesim").isEnabledFor(logging.INFO)  # nothing unless it is asked for
    with caplog.at_level(logging.INFO, "timesim"):
        timesim.integrate(oscillator(), frequency=1.39, cycles=1)
    assert any(line.startswith("1 cycle by ") for line in caplog.messages)


def test_matrices_are_those_of_a_scene():
    structure = timesim.matrices(M, K, {"tip": {"x": 1}}, damping_ratio=0.02, keep_modes=2)
    pad = timesim.contact("pad", "tip", friction=0.4, tangential_stiffness=20.0, normal_stiffness=0.0, preload=1.0)
    forces = [timesim.point_force("tip", [1, 0, 0], 1.0), timesim.point_force("tip", [1, 0, 0], 0.3, harmonic=3)]
    system = timesim.system(structure, [pad], forces)
    found = timesim.integrate(system, 0.8, 3)
    written = {"mass": M.tolist(), "stiffness": K.tolist(), "damping_ratio": 0.02, "points": {"tip": {"x": 1}}}
    scene = {
        "structure": {"matrices": written, "keep_modes": 2},
        "contacts": [{"name": "pad", "point": "tip", "friction": 0.4, "tangential_stiffness": 20, "normal_stiffness": 0,
                      "preload": 1}],
        "excitation": {"frequency": 0.8, "forces": [
            {"point": "tip", "direction": [1, 0, 0], "amplitude": 1},
            {"point": "tip", "direction": [1, 0, 0], "amplitude": 0.3, "harmonic": 3},
        ]},
        "study": {"kind": "transient", "cycles": 3},
    }  # fmt: skip
    assert_same(found, timesim.run(scene))


def test_sparse_matrices_and_a_constant_force():
    import scipy.sparse

    pull = [timesim.point_force("tip", [1, 0, 0], 2.0, harmonic=0), timesim.point_force("tip", [1, 0, 0], 1.0)]
    parts = [
        timesim.matrices(mass, stiffness, {"tip": {"x": 1}}, damping_ratio=0.02)
        for mass, stiffness in ((M, K), (scipy.sparse.csc_matrix(M), scipy.sparse.coo_array(K)))
    ]
    one, other = (timesim.settle(timesim.system(structure, [], pull), 0.8) for structure in parts)
    assert_same(one, other)
    mean = one["harmonic_amplitude"].sel(point="tip", axis="x", harmonic=0).item()
    assert mean == pytest.approx(np.linalg.solve(K, [0, 2.0])[1], rel=1e-12)


def test_forces_have_their_phases_in_degrees():
    """A constant force is the harmonic one as it stands at its phase."""
    one, other = timesim.modal_forces([1.0, 2.0], [10.0, -20.0])["modal_force"]
    assert (one, other) == ({"amplitude": 1.0, "phase_deg": 10.0}, {"amplitude": 2.0, "phase_deg": -20.0})
    assert [force["phase_deg"] for force in timesim.modal_forces([1.0, 2.0], 30.0)["modal_force"]] == [30.0, 30.0]
    (pull,) = timesim.point_force("tip", [1, 0, 0], 2.0, phase_deg=60.0, harmonic=0)["constant_forces"]
    assert pull["amplitude"] == pytest.approx(1.0)


def test_steady_states_and_curves(tmp_path):
    point = timesim.settle(oscillator(), 1.39)
    assert abs(point["amplitude"].sel(point="tip", axis="x").item() - 0.15612878) < 1e-7
    row = timesim.sweep(oscillator(), [1.39])
    assert_same(row.isel(direction=0, frequency=0), point)
    short = timesim.settle(oscillator(), 1.39, tolerance=1e-9, max_cycles=20)
    assert short["cycles"] < point["cycles"]
    assert (short["settled"].item(), short.attrs["settle_tolerance"]) == (0, 1e-9)
    with pytest.raises(ValueError, match=r"a single direction: .* result.sel\(direction="):
        timesim.plot(row.isel(direction=0), tmp_path)
    assert timesim.plot(point, tmp_path / "point", log="amplitude")
    assert timesim.plot(row.isel(frequency=[0]), tmp_path)
    curve = timesim.follow(oscillator(), 1.38, 1.40)
    assert {"amplitude", "stable"} <= set(curve)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: timesim.modes([[1.0]], 0.1, {"tip": [[1, 0, 0]]}),
            r"frequency has shape \(1, 1\), it must have \(M,\): reshape or transpose it",
        ),
        (lambda: timesim.modes([1.0, 2.0], 0.1, {"tip": [[1, 0, 0]]}), r"shapes\['tip'\] .*\(2, 3\)"),
        (lambda: timesim.modes([1.0], [0.1, 0.2], {"tip": [[1, 0, 0]]}), "damping_ratio .* a number or one a mode"),
        (lambda: timesim.matrices(np.eye(2), np.eye(3), {}), r"stiffness has shape \(3, 3\), it must have \(2, 2\)"),
        (lambda: timesim.matrices(np.ones((2, 3)), np.eye(3), {}), r"mass has shape \(2, 3\)"),
        (lambda: oscillator(normal=[0, 1]), r"normal has shape \(2,\)"),
        (lambda: oscillator(tangential_stiffness=[1, 2, 3]), "tangential_stiffness has shape"),
        (lambda: pad(friction=-1), "contacts.pad.friction: -1: must be >= 0"),
        (lambda: pad(friction="much"), "contacts.pad.friction: much: must be a number"),
        (lambda: pad(tangential_stiffness="20 N"), "tangential_stiffness must be a number or an array of numbers"),
        (lambda: pad(tangential_stiffness=[[1, 2], [2, 1]]), "contacts.pad.tangential_stiffness: .* positive definite"),
        (lambda: timesim.modes([1.0], -0.1, {"tip": [[1, 0, 0]]}), "structure.modes.0.damping_ratio: -0.1: must be >="),
        (lambda: timesim.matrices(M, K, {"tip": {"w": 1}}), "structure.matrices.points.tip.w: .*known: x, y, z"),
        (lambda: timesim.matrices([[1, 0], [0]], K, {}), "mass must be a number or an array of numbers"),
        (lambda: timesim.point_force("tip", [0, 0, 0], 1.0), "excitation.forces.0.direction: .* zero vector"),
        (lambda: timesim.point_force("tip", [1, 0, 0], 1.0, harmonic=0.5), "excitation.forces.0.harmonic: 0.5"),
        (lambda: timesim.point_force("tip", [1, 0, 0], 1.0, harmonic=[1, 2]), "harmonic has shape .2,., .* a single"),
        (lambda: timesim.point_force("tip", [1, 0, 0], 1.0, harmonic=0, phase_deg=[0, 9]), "phase_deg: .0, 9.: .*num"),
        (lambda: timesim.point_force("tip", [1, 0, 0], 1.0, harmonic=0, phase_deg="90"), 'phase_deg: "90": .*quotes'),
        (lambda: timesim.point_force("tip", [1, 0, 0], "3", harmonic=0), "amplitude must be a number .* not '3'"),
        (lambda: timesim.modal_forces([np.nan]), "excitation.modal_force.0.amplitude: .nan: must be finite"),
        (lambda: timesim.system(one_mass(), [pad(point="rim")], FORCE), "contacts.pad.point: rim: must be a point of"),
        (lambda: timesim.system(one_mass(), [pad(), pad()], FORCE), "contacts.1.name: pad: must differ"),
        (lambda: timesim.system(one_mass(), pad(), FORCE), r"contacts must be a list, of one contact too"),
        (
            lambda: timesim.system(one_mass(), [pad()], [timesim.modal_forces([1])] * 2),
            "several modal_forces: give one",
        ),
        (
            lambda: timesim.system(one_mass(), [pad()], timesim.modal_forces([1, 1])),
            "must have 1 entry, one a mode, not",
        ),
        (lambda: timesim.system(one_mass(), [pad()], FORCE, solver={"accuracy": "fine"}), "solver.accuracy: fine"),
        (
            lambda: timesim.sweep(oscillator(), 1.39),
            r"frequency has shape \(\), .* \(F,\): give a list, such as \[1.39\]",
        ),
        (lambda: timesim.settle(oscillator(), [1.39]), "frequency has shape .* must be a single number"),
        (
            lambda: timesim.sweep(oscillator(), [1.39], over=["contacts.pad.preload"]),
            "over must be a mapping .* not .'contacts.pad.preload'.",
        ),
        (lambda: timesim.integrate(one_mass(), 1.0, 2), "system has no structure, its keys are modes"),
        (lambda: timesim.integrate("scene.yaml", 1.0, 2), "system must be what timesim.system returns .*not 'scene"),
        (lambda: timesim.follow(None, 1.0, 2.0), "system must be what timesim.system returns .*not None"),
        (lambda: timesim.system(one_mass(), None, FORCE), "contacts must be a list, .* not None"),
        (lambda: timesim.system(one_mass(), np.array(pad()), FORCE), "contacts must be a list, .* not array"),
        (lambda: timesim.modes([1.0], np.datetime64("2020"), {"tip": [[1, 0, 0]]}), "damping_ratio must be a number"),
        (lambda: timesim.system(one_mass(), [], None), r"excitation must be from timesim.modal_forces .* not None"),
        (
            lambda: timesim.system(one_mass(), [], [None]),
            r"excitation\[0\] must be from timesim.modal_forces .* not None",
        ),
        (lambda: timesim.modes([1.0], 0.1, np.eye(1, 3)), "shapes must be a mapping of points, .* not array"),
        (lambda: timesim.modes([1.0], 0.1, {1: [[1, 0, 0]]}), "shapes has the key 1, it must be text: '1'"),
        (lambda: timesim.matrices(M, K, {"m1": [0, 1]}), r"points\['m1'\] must be a mapping of rows .* not \[0, 1\]"),
        (lambda: timesim.show("nowhere", [("frequency", 1)]), "at must be a mapping of values"),
        (lambda: timesim.show("nowhere", "frequency=1"), "at must be a mapping of values .* not 'frequency=1'"),
        (lambda: timesim.plot(oscillator(), "nowhere"), "names no study: it must be a whole result"),
        (
            lambda: timesim.plot(
                xarray.Dataset(coords={"contacts.pad.friction": 0.1}, attrs={"study": "optimum"}), "nowhere"
            ),
            r"a single contacts.pad.friction: .* result.sel\({'contacts.pad.friction': \[",
        ),
        (lambda: timesim.modes([10**400], 0.1, {"tip": [[1, 0, 0]]}), "frequency must be a number or an array"),
        (lambda: timesim.modes(["0.9"], 0.1, {"tip": [[1, 0, 0]]}), r"frequency must be a number .*not \['0.9'\]"),
        (lambda: timesim.modes([True], 0.1, {"tip": [[1, 0, 0]]}), r"frequency must be a number .*not \[True\]"),
        (lambda: timesim.modal_forces(np.ma.masked_less([0, 1], 1)), r"amplitude is masked in part: .*filled\(0\)"),
        (lambda: timesim.point_force("tip", [1, 0, 0], 1.0, harmonic=False), "harmonic must be a number .*not False"),
        (lambda: timesim.integrate(oscillator(), 1.0, 2, initial=PART), 'initial is a result: save it, .*"from": "end'),
        (
            lambda: timesim.integrate(oscillator(), 1.0, 2, initial={"from": PART}),
            'initial is a result: save it, .*"from": "end',
        ),
        (lambda: timesim.integrate(oscillator(), 1.0, 2, initial="a/end.nc"), "initial: a/end.nc: .*{from: a/end.nc}"),
        (lambda: timesim.open(None), "path must be the path of a result file or of the folder of a run, not None"),
        (lambda: timesim.show(3, {"frequency": 1}), "path must be the path of a result file .* not 3"),
        (lambda: timesim.run(3), "the source of a scene must be the path of a file, .* not 3"),
        (lambda: timesim.load_scene(None), "the source of a scene must be .* a mapping, not None"),
        (lambda: timesim.run(oscillator(), 3), "overrides must be a mapping, .* not 3"),
        (lambda: timesim.load_scene(oscillator(), "study.cycles=5"), "overrides must be .* not 'study.cycles=5'"),
        (lambda: timesim.plot(PART, None), "folder must be the path of a folder, .* not None"),
        (lambda: timesim.plot(PART, "nowhere/", kind=None), "format must be one of png, pdf, svg, not None"),
        (lambda: timesim.plot(PART, "nowhere/", log=3), "log must be a list of amplitude and frequency, not 3"),
    ],
)
def test_wrong_arguments_are_named(call, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, timesim.SceneError), match=message):
        call()


@pytest.mark.parametrize(
    ("call", "instead"),
    [
        (
            lambda: timesim.modes(np.array([1.0 + 0j]), 0.1, {"tip": [[1, 0, 0]]}),
            "frequency must be of real numbers, not complex128: take the real part",
        ),
        (
            lambda: timesim.matrices(M, K * (1 + 0.02j), {"tip": {"x": 1}}),
            "stiffness must be of real .*give damping or damping_ratio",
        ),
        (lambda: timesim.modal_forces([1 + 1j, 1j]), "amplitude must be of real .*as phase_deg"),
        (lambda: timesim.point_force("tip", [1, 0, 0], 1j), "amplitude must be of real .*as phase_deg"),
    ],
)
def test_complex_values_are_refused_and_not_cut_to_their_real_part(call, instead):
    with pytest.raises(ValueError, match=instead):
        call()


def test_what_is_wrong_with_a_file_is_an_error_of_the_package(tmp_path):
    file = tmp_path / "file"
    file.write_text("no result")
    for call, message in (
        (lambda: timesim.open(tmp_path / "none.nc"), "no result file at"),
        (lambda: timesim.show(file, {"frequency": 1.0}), "cannot be read as a result file"),
        (lambda: timesim.plot(PART, file), r"folder .* cannot be made \(File exists\): give another one"),
        (lambda: timesim.plot(PART, tmp_path), "the result lacks what picture response shows .*'amplitude'"),
    ):
        with pytest.raises(timesim.StoreError, match=message):
            call()
    code = "import sys, timesim; timesim.StoreError; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_examples_of_the_readme_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    section = (ROOT / "README.md").read_text().split("From Python")[1]
    from_file, from_arrays = re.findall(r"```python\n(.*?)```", section, re.S)
    names = {}
    for code in (from_file, from_arrays):
        exec(compile(code.replace("configs/", f"{ROOT}/configs/"), "README.md", "exec"), names)
    assert re.fullmatch(r"0\.\d+ \d+ transitions\n", capsys.readouterr().out)
    assert names["run"].sizes["cycle"] == 5
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 7


def test_help_names_types_as_they_are_written():
    signature = str(inspect.signature(timesim.contact))
    assert "tangential_stiffness: 'ArrayLike'" in signature
    assert "_typing" not in signature + str(inspect.signature(timesim.sweep))
