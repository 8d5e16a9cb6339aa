"""Modes from matrices: against the modes written out, against closed forms, and files that are wrong."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from timesim.fault import RuleError, SceneError
from timesim.model import eigenmodes, matrices
from timesim.model.eigenmodes import modal_structure
from timesim.model.matrices import Matrices, read_matrices
from timesim.scene import structure as structure_sections
from timesim.scene.report import warnings_of
from timesim.study.registry import load_scene

DATA = Path(__file__).parents[1] / "data"


def chain(n: int, damping: Any = None) -> Matrices:
    """n unit masses between n + 1 unit springs: omega_k = 2 sin(k pi / (2 n + 2))."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return Matrices(np.eye(n), stiffness, damping)


POINTS = {"first": {"x": 0}, "second": {"z": 1}}


def scene(structure: dict[str, Any]) -> dict[str, Any]:
    return {
        "structure": structure,
        "excitation": {"frequency": 1},
        "study": {"kind": "transient", "cycles": 1},
    }


def files(path: Any, **changes: Any) -> dict[str, Any]:
    return scene({"file": path, "damping_ratio": 0.01, "points": POINTS, **changes})


def refusal(source: dict[str, Any]) -> tuple[str, str]:
    with pytest.raises(SceneError) as caught:
        load_scene(source)
    (problem,) = caught.value.problems
    return problem.key, f"{problem.rule} ({problem.hint})"


@pytest.mark.parametrize("form", [np.asarray, scipy.sparse.csc_matrix])
@pytest.mark.parametrize(("free", "keep"), [(False, 2), (True, 2), (True, 1)])
def test_the_flexibility_of_modes_left_out_is_the_whole_one_less_that_of_the_modes_kept(form, free, keep):
    """Also of a free body of which no vibration is kept."""
    stiffness = chain(6).stiffness - free * np.diag([1.0, 0, 0, 0, 0, 1])
    given, whole = (Matrices(kind(np.eye(6)), kind(stiffness)) for kind in (form, np.asarray))
    left = modal_structure(given, points=POINTS, damping_ratio=0.0, keep_modes=keep).left_out
    every = modal_structure(whole, points=POINTS, damping_ratio=0.0)
    shape = every.shape.reshape(6, 6)[:, keep:]
    assert left == pytest.approx((shape / every.omega[keep:] ** 2) @ shape.T, rel=2e-3, abs=1e-12)
    assert every.left_out is None


def test_what_is_kept_of_matrices_goes_with_the_number_of_modes_and_the_points():
    """As over an axis of a study, all values of which share what a file holds."""
    given = chain(6)
    for keep, names in ((2, list(POINTS)), (3, list(POINTS)), (2, list(POINTS)[::-1])):
        points = {name: POINTS[name] for name in names}
        own, fresh = (modal_structure(m, points=points, damping_ratio=0.0, keep_modes=keep) for m in (given, chain(6)))
        for name in ("frequency", "shape", "left_out"):
            np.testing.assert_array_equal(getattr(own, name), getattr(fresh, name))


def test_chain_has_its_closed_form():
    structure = modal_structure(chain(6), points=POINTS, damping_ratio=0.03)
    number = np.arange(1, 7)
    omega = 2 * np.sin(number * np.pi / 14)
    assert np.allclose(structure.omega, omega, rtol=1e-14)
    assert np.array_equal(structure.mass, np.ones(6))
    assert np.allclose(structure.damping, 0.06 * omega, rtol=1e-14)
    modes = np.sin(np.outer(number, number) * np.pi / 7) * np.sqrt(2 / 7)
    expected = modes * np.sign(modes[np.argmax(np.abs(modes) >= np.abs(modes).max(axis=0) - 1e-9, axis=0), number - 1])
    assert np.allclose(structure.shape[0, 0], expected[0], atol=1e-14)
    assert np.allclose(structure.shape[1, 2], expected[1], atol=1e-14)
    assert not np.any(structure.shape[0, 1:])


@pytest.mark.parametrize("name", ["blade.npz", "blade.mat"])
def test_blade_has_the_modes_written_out(name: str):
    written = load_scene(DATA / "blade_modes.yaml").model().structure
    loaded = load_scene(DATA / "blade_matrices.yaml", {"structure.file": name}).model().structure
    assert np.allclose(loaded.frequency, written.frequency, rtol=1e-9)
    assert loaded.points == written.points
    sign = np.sign(np.sum(loaded.shape * written.shape, axis=(0, 1)))
    assert np.allclose(loaded.shape * sign, written.shape, rtol=1e-7, atol=1e-7)
    assert np.allclose(loaded.damping, written.damping, rtol=1e-9)


def test_blade_has_all_its_modes():
    loaded = load_scene(DATA / "blade_matrices.yaml", ["structure.keep_modes=24"]).model().structure
    assert np.allclose(loaded.frequency, json.loads((DATA / "fe_modes.json").read_text())["cb_frequency_hz"], rtol=1e-9)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32 - 1), st.integers(2, 7))
def test_modes_solve_the_eigenproblem(seed: int, n: int):
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, n, n))
    mass, stiffness, damping = a @ a.T + n * np.eye(n), b @ b.T, c @ c.T
    points = {f"p{i}": {"y": i} for i in range(n)}
    structure = modal_structure(Matrices(mass, stiffness, damping), points=points)
    modes = structure.shape[:, 1]
    assert np.allclose(modes.T @ mass @ modes, np.eye(n), atol=1e-11)
    scale = np.abs(stiffness).max()
    assert np.allclose(stiffness @ modes, mass @ modes * structure.omega**2, atol=1e-11 * scale)
    assert np.all(np.diff(structure.frequency) >= 0)
    assert structure.damping.shape == (n, n)
    assert np.allclose(structure.damping, modes.T @ damping @ modes, atol=1e-11)
    assert np.all(modes[np.argmax(np.abs(modes), axis=0), np.arange(n)] > 0)


def test_proportional_damping_becomes_ratios_and_a_dashpot_stays_whole():
    base = chain(5)
    proportional = modal_structure(
        Matrices(base.mass, base.stiffness, 0.1 * base.stiffness + 0.2 * base.mass), points=POINTS
    )
    assert np.allclose(proportional.damping, 0.1 * proportional.omega**2 + 0.2, rtol=1e-12)
    dashpot = np.zeros((5, 5))
    dashpot[1, 1] = 0.3
    whole = modal_structure(Matrices(base.mass, base.stiffness, dashpot), points=POINTS, keep_modes=3)
    assert whole.damping.shape == (3, 3)
    assert np.linalg.matrix_rank(whole.damping, tol=1e-12) == 1
    rate = modal_structure(Matrices(base.mass, base.stiffness, dashpot), points=POINTS, damping_ratio=[0, 1, 2, 3, 4])
    assert np.allclose(rate.damping, 2 * np.arange(5) * rate.omega)


def test_proportional_damping_of_the_stiff_blade_is_diagonal():
    data = np.load(DATA / "blade.npz")
    damping = 1e-7 * data["stiffness"] + 3 * data["mass"]
    structure = modal_structure(Matrices(data["mass"], data["stiffness"], damping), points=POINTS, keep_modes=12)
    assert structure.damping.shape == (12,)


@pytest.mark.parametrize("masses", [[0.5, 0.3], [0.7, 0.1], [0.4, 0.9], [0.3, 0.7, 0.6]])
def test_damping_that_does_nothing_to_the_rigid_modes_kept_has_no_negative_eigenvalue(masses: list[float]):
    """In them it is rounding, of either sign."""
    num = len(masses)
    links = np.zeros((num, num))
    links[:2, :2] = [[1.0, -1.0], [-1.0, 1.0]]
    matrices = Matrices(np.diag(masses), 10 * links, 0.1 * links)
    found = modal_structure(matrices, points={"a": {"x": 0}}, keep_modes=num - 1)
    assert 0 <= found.damping.min() <= found.damping.max() < 1e-15
    for wrong in ({"stiffness": -matrices.stiffness}, {"damping": -matrices.damping}):
        with pytest.raises(RuleError, match="no negative eigenvalue") as raised:
            modal_structure(replace(matrices, **wrong), points={})
        assert "look for a wrong sign; the lowest" in raised.value.hint


def test_free_body_has_frequency_zero():
    stiffness = np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    structure = modal_structure(Matrices(np.diag([1.0, 2, 1]), stiffness), points=POINTS, damping_ratio=0.01)
    assert structure.frequency[0] == 0
    assert structure.damping[0] == 0
    assert np.all(structure.frequency[1:] > 0.1)


@pytest.mark.parametrize("unit", [1e-15, 1.0, 1e9])
def test_masses_may_be_in_any_unit(unit: float):
    """What counts as no mass is relative to the others."""
    plain, mass = chain(3), unit * np.array([[1.0, 1 - 1e-14, 0], [1 - 1e-14, 1, 0], [0, 0, 1]])
    found = modal_structure(Matrices(unit * plain.mass, unit * plain.stiffness), points={}, damping_ratio=0.0)
    np.testing.assert_allclose(found.omega, 2 * np.sin(np.arange(1, 4) * np.pi / 8))
    with pytest.raises(RuleError, match="the mass matrix must be positive definite"):
        modal_structure(Matrices(mass, unit * plain.stiffness), points={}, damping_ratio=0.0)


def test_two_free_bodies_have_frequency_zero_along_each_axis():
    """One of them without any spring, of which rounding leaves a frequency of 1e-32."""
    links = 1668.8 * np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]])
    stiffness, seeds = np.kron(links, np.eye(2)), (89, 141, 178)  # of 200 those where it does
    for masses in (np.random.default_rng(seed).uniform(0.3, 3, 3) for seed in seeds):
        mass = np.kron(np.diag(masses), np.eye(2))
        found = modal_structure(Matrices(mass, stiffness), points={}, damping_ratio=0.01)
        assert found.frequency[:4].tolist() == [0, 0, 0, 0]
        assert np.all(found.frequency[4:] > 1)


@pytest.mark.parametrize(("num", "penalty"), [(2, 1e16), (300, 1e12)])
def test_a_chain_that_a_penalty_clamps_is_no_free_body(num: int, penalty: float):
    """Rounding of the stiff spring is larger than the squares of the lowest frequencies, known all the same."""
    stiffness = 2 * np.eye(num) - np.eye(num, k=1) - np.eye(num, k=-1)
    stiffness[0, 0] = penalty
    found = modal_structure(Matrices(np.eye(num), stiffness), points={}, damping_ratio=0.0)
    exact = 2 * np.sin(np.arange(1, num) * np.pi / (2 * num))
    np.testing.assert_allclose(found.omega[:-1], exact, rtol=1e-9)


def test_a_free_chain_with_a_stiff_link_has_one_mode_of_frequency_zero():
    """The link joins two of its masses to one."""
    stiffness, mass = np.zeros((40, 40)), np.eye(39)
    for i in range(39):
        stiffness[i : i + 2, i : i + 2] += (1e8 if i == 19 else 1.0) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    found = modal_structure(Matrices(np.eye(40), stiffness), points={}, damping_ratio=0.0, keep_modes=39)
    mass[19, 19], rigid = 2.0, np.delete(np.eye(40), 20, axis=1)
    rigid[20, 19] = 1.0
    exact = scipy.linalg.eigvalsh(rigid.T @ stiffness @ rigid, mass)
    assert found.frequency[0] == 0
    np.testing.assert_allclose(found.omega[1:] ** 2, exact[1:], rtol=1e-6)


def test_large_sparse_structure():
    n, keep = 3000, 7
    off = np.full(n - 1, -1.0)
    stiffness = scipy.sparse.diags_array([off, np.full(n, 2.0), off], offsets=[-1, 0, 1])
    sparse = Matrices(scipy.sparse.eye_array(n), stiffness, 0.01 * stiffness)
    structure = modal_structure(sparse, points={"m": {"x": n // 3}}, keep_modes=keep)
    omega = 2 * np.sin(np.arange(1, keep + 1) * np.pi / (2 * n + 2))
    assert np.allclose(structure.omega, omega, rtol=1e-6)
    assert np.allclose(structure.damping, 0.01 * structure.omega**2, rtol=1e-5)
    with pytest.raises(RuleError, match="is required for a structure of 3000 rows"):
        modal_structure(sparse, points={"m": {"x": 0}}, damping_ratio=0)
    with pytest.raises(RuleError, match="must be less than 3000 for a structure of 3000 rows"):
        modal_structure(sparse, points={"m": {"x": 0}}, damping_ratio=0, keep_modes=n)
    with pytest.raises(RuleError, match="no negative eigenvalue"):
        modal_structure(Matrices(sparse.mass, stiffness - 0.1 * sparse.mass), points={}, damping_ratio=0, keep_modes=2)
    with pytest.raises(RuleError, match="positive definite"):
        modal_structure(Matrices(stiffness - sparse.mass, stiffness), points={}, damping_ratio=0, keep_modes=2)


def test_a_mode_that_the_solver_of_sparse_structures_misses_is_told(monkeypatch: pytest.MonkeyPatch):
    whole = chain(12)
    monkeypatch.setattr(eigenmodes, "MAX_DENSE", 4)
    monkeypatch.setattr(
        "scipy.sparse.linalg.eigsh", lambda *_, **__: (None, np.linalg.eigh(whole.stiffness)[1][:, 1:5])
    )
    given = Matrices(*map(scipy.sparse.csc_matrix, (whole.mass, whole.stiffness)))
    with pytest.raises(RuleError, match="the eigenvalue solver missed modes") as raised:
        modal_structure(given, points=POINTS, damping_ratio=0.0, keep_modes=3)
    assert raised.value.hint.startswith("4 lie below")
    assert raised.value.hint.endswith("gave 3; try another keep_modes")


def test_clamps_of_large_sparse_structures_may_be_of_any_stiffness():
    n, held, penalty = 2500, [0, 700, 1800], 1e20
    off, ends = np.full(n - 1, -1.0), np.zeros(n)
    ends[held] = penalty
    stiffness = scipy.sparse.diags_array([off, 2.0 + ends, off], offsets=[-1, 0, 1])
    found = modal_structure(Matrices(scipy.sparse.eye_array(n), stiffness), points={}, damping_ratio=0.0, keep_modes=6)
    parts = [2 * np.sin(np.arange(1, 7) * np.pi / (2 * length)) for length in (700, 1100, 700)]
    np.testing.assert_allclose(found.omega, np.sort(np.concatenate(parts))[:6], rtol=1e-9)


def cantilever(elements: int) -> Matrices:
    """Euler and Bernoulli's beam of length, bending stiffness and mass 1: deflection and slope of each node."""
    length, size = 1 / elements, 2 * elements + 2
    spring = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / length**3
    inertia = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) * length / 420
    scale, every = np.diag([1, length, 1, length]), 2 * np.arange(elements)[:, None, None]
    row, column = (np.broadcast_to(every + i, (elements, 4, 4)).ravel() for i in np.indices((4, 4)))

    def assembled(element: np.ndarray) -> scipy.sparse.csc_array:
        entries = np.tile((scale @ element @ scale).ravel(), elements)
        return scipy.sparse.coo_array((entries, (row, column)), (size, size)).tocsc()[2:, 2:]

    return Matrices(assembled(inertia), assembled(spring))


@pytest.mark.parametrize("elements", [500, 1100])
def test_a_finely_meshed_beam_is_no_free_body(elements: int):
    """Its eigenvalues span 13 powers of ten and more; 1,000 rows are solved as dense, 2,200 as sparse ones."""
    beam, tip = cantilever(elements), 2 * elements - 2
    beam = Matrices(beam.mass, beam.stiffness, 1e-3 * beam.stiffness)
    found = modal_structure(beam, points={"tip": {"x": tip}}, keep_modes=4)
    exact = np.array([1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349]) ** 2
    np.testing.assert_allclose(found.omega, exact, rtol=1e-5)
    np.testing.assert_allclose(found.damping, 1e-3 * exact**2, rtol=1e-4)
    np.testing.assert_allclose(np.abs(found.shape[0, 0]), 2.0, rtol=1e-5)
    sign = np.sign(found.shape[0, 0])
    dashpot = scipy.sparse.coo_array(([1e-3], ([tip], [tip])), beam.mass.shape).tocsc()
    whole = modal_structure(Matrices(beam.mass, beam.stiffness, beam.damping + dashpot), points={}, keep_modes=4)
    np.testing.assert_allclose(whole.damping - np.diag(found.damping), 4e-3 * np.outer(sign, sign), rtol=1e-4)


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("names", [("mass", "stiffness", "damping"), ("M", "K", "C")])
def test_mat_file(sparse: bool, names: tuple[str, ...], tmp_path: Path):
    base = chain(4)
    arrays = [base.mass, base.stiffness, 0.1 * base.stiffness]
    held = dict(zip(names, map(scipy.sparse.csc_array, arrays) if sparse else arrays, strict=True))
    scipy.io.savemat(tmp_path / "a.mat", held | {"notes": "left alone", "rows": np.array(["a", "b"], dtype=object)})
    loaded = load_scene(files(tmp_path / "a.mat"))
    assert np.allclose(loaded.model().structure.damping, 0.02 * loaded.model().structure.omega)
    assert any("damping matrix in the file is not" in warning for warning in warnings_of(loaded))
    source = files(tmp_path / "a.mat")
    del source["structure"]["damping_ratio"]
    structure = load_scene(source).model().structure
    assert np.allclose(structure.damping, 0.1 * structure.omega**2)


def test_matrix_market_and_sparse_npz(tmp_path: Path):
    base = chain(4)
    scipy.io.mmwrite(tmp_path / "m.mtx", scipy.sparse.coo_array(base.mass))
    scipy.io.mmwrite(tmp_path / "k.mtx", base.stiffness)
    scipy.sparse.save_npz(tmp_path / "c.npz", scipy.sparse.csr_array(0.1 * base.stiffness))
    source = files({"mass": "m.mtx", "stiffness": "k.mtx", "damping": "c.npz"})
    del source["structure"]["damping_ratio"]
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(source))
    loaded = load_scene(path)
    structure = loaded.model().structure
    assert np.allclose(structure.damping, 0.1 * structure.omega**2)
    again = load_scene(loaded.resolved_yaml())
    assert np.array_equal(again.model().structure.damping, structure.damping)


def test_a_file_is_read_once_for_all_values_of_an_axis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """And its eigenproblem is solved once, where the values do not change it."""
    read, solved = Mock(wraps=matrices.read_matrices), Mock(wraps=eigenmodes._eigenmodes)
    monkeypatch.setattr(structure_sections, "read_matrices", read)
    monkeypatch.setattr(eigenmodes, "_eigenmodes", solved)
    base = chain(3)
    np.savez(tmp_path / "a.npz", M=base.mass, K=base.stiffness)
    swept = {"kind": "sweep", "frequency": {"values": [0.1]}, "over": {"structure.damping_ratio": [0.01, 0.02, 0.03]}}
    scene = load_scene(files(tmp_path / "a.npz") | {"study": swept})
    ratios = [scene.variant({"structure.damping_ratio": ratio}).structure.damping_ratio[0] for ratio in (0.01, 0.03)]
    assert ratios == pytest.approx([0.01, 0.03])
    assert (read.call_count, solved.call_count) == (1, 1)
    assert scene.variant({"structure.keep_modes": 2}).structure.num_modes == 2
    assert (read.call_count, solved.call_count) == (1, 2)
    np.savez(tmp_path / "a.npz", M=2 * base.mass, K=base.stiffness)
    again = load_scene(files(tmp_path / "a.npz"))
    assert again.model().structure.frequency[0] == pytest.approx(scene.model().structure.frequency[0] / np.sqrt(2))


def test_both_names_are_worth_a_warning(tmp_path: Path):
    base = chain(3)
    np.savez(tmp_path / "a.npz", mass=base.mass, M=np.eye(2), K=base.stiffness)
    loaded = load_scene(files(tmp_path / "a.npz"))
    assert loaded.model().structure.num_modes == 3
    (warning,) = (warning for warning in warnings_of(loaded) if "left alone" in warning)
    assert "M is left alone" in warning


def good(path: Path, **changes: Any) -> Path:
    base = chain(3)
    np.savez(path, **({"mass": base.mass, "stiffness": base.stiffness} | changes))
    return path


def truncated(path: Path) -> Path:
    path.write_bytes(good(path).read_bytes()[:-100])
    return path


def damaged(path: Path) -> Path:
    content = bytearray(good(path).read_bytes())
    content[len(content) // 4 : len(content) // 2] = b"\xff" * (len(content) // 2 - len(content) // 4)
    path.write_bytes(content)
    return path


def truncated_member(path: Path) -> Path:
    with zipfile.ZipFile(good(path)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content[:100])
    return path


def single(path: Path) -> Path:
    with path.open("wb") as stream:
        np.save(stream, np.eye(3))
    return path


@pytest.mark.parametrize(
    ("write", "rule"),
    [
        (lambda path: path, "does not exist"),
        (lambda path: (path.mkdir(), path)[1], "is no file"),
        (lambda path: (path.write_bytes(b""), path)[1], "no whole .npz"),
        (lambda path: (path.write_bytes(b"not an archive"), path)[1], "no whole .npz"),
        (truncated, "no whole .npz"),
        (damaged, "cannot be read"),
        (truncated_member, "cannot be read"),
        (single, "no whole .npz"),
        (lambda path: good(path, mass=np.array([[1, None], [None, 1]], dtype=object)), "each by scipy.sparse.save_npz"),
        (lambda path: good(path, mass=np.eye(3)[:2]), "must be square, not 2 x 3"),
        (lambda path: good(path, mass=np.ones(3)), "must be square, not 3 (numpy.diag"),
        (lambda path: good(path, mass=np.zeros((0, 0))), "must be square, not 0 x 0"),
        (lambda path: good(path, mass=np.eye(4)), "must be 4 x 4 like the mass matrix, not 3 x 3"),
        (lambda path: good(path, mass=np.diag([1.0, np.nan, 1])), "must be finite, without NaN (row 1, column 1)"),
        (lambda path: good(path, mass=np.eye(3) * 1j), "not complex128 (of hysteretic damping take the real part"),
        (lambda path: good(path, mass=np.array([["a"]])), "real numbers"),
        (lambda path: good(path, mass=np.diag([1.0, 0, 1])), "; the diagonal of row 1 is 0)"),
        (lambda path: good(path, mass=np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]])), "condensed out first)"),
        (lambda path: good(path, stiffness=np.triu(chain(3).stiffness)), "must be symmetric (mirrored entries differ"),
        (
            lambda path: good(path, stiffness=np.eye(3) + 0.5 * np.eye(3, k=-2)),
            "by up to 0.5, those of rows 0 and 2; it is one triangle: A + A.T",
        ),
        (lambda path: good(path, stiffness=-np.eye(3)), "no negative eigenvalue"),
    ],
)
def test_npz_that_is_wrong(write: Any, rule: str, tmp_path: Path):
    key, loaded = refusal(files(write(tmp_path / "a.npz")))
    assert key == "structure.file"
    assert rule in loaded


def test_npz_without_the_keys(tmp_path: Path):
    np.savez(tmp_path / "a.npz", mas=np.eye(3), K=np.eye(3))
    assert refusal(files(tmp_path / "a.npz")) == (
        "structure.file",
        "holds neither mass nor M (it holds K, mas)",
    )


def test_npz_of_one_sparse_matrix_in_place_of_all(tmp_path: Path):
    scipy.sparse.save_npz(tmp_path / "k.npz", scipy.sparse.eye_array(3).tocsc())
    rule = "holds neither mass nor M (for a file of each matrix write file: {mass: m.npz, stiffness: k.npz})"
    assert refusal(files(tmp_path / "k.npz")) == ("structure.file", rule)


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (None, "holds neither stiffness nor K (it holds mass)"),
        (b"", "cannot be read"),
        (b"MATLAB 5.0 MAT-file" + b" " * 200, "cannot be read"),
        (
            b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" + bytes(500),
            "is a MATLAB 7.3 file",
        ),
    ],
)
def test_mat_that_is_wrong(content: bytes | None, rule: str, tmp_path: Path):
    scipy.io.savemat(tmp_path / "a.mat", {"mass": np.eye(3)})
    if content is not None:
        (tmp_path / "a.mat").write_bytes(content)
    key, loaded = refusal(files(tmp_path / "a.mat"))
    assert key == "structure.file"
    assert rule in loaded


def test_mat_cut_off_anywhere_is_refused(tmp_path: Path):
    content = (DATA / "blade.mat").read_bytes()
    for size in range(0, len(content) // 2, len(content) // 20):
        (tmp_path / "a.mat").write_bytes(content[:size])
        assert refusal(files(tmp_path / "a.mat"))[0] == "structure.file"


def test_cell_array_is_no_matrix(tmp_path: Path):
    scipy.io.savemat(tmp_path / "a.mat", {"mass": np.array([1, "b"], dtype=object), "stiffness": np.eye(2)})
    assert "real numbers" in refusal(files(tmp_path / "a.mat"))[1]


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        ("%%MatrixMarket matrix coordinate real general\n2 2 2\n1 1 1\n", "cannot be read"),
        ("nothing", "cannot be read"),
        ("%%MatrixMarket matrix coordinate real general\n2 3 1\n1 1 1\n", "must be square, not 2 x 3"),
        ("%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1 1\n", "real numbers"),
        ("%%MatrixMarket matrix coordinate pattern general\n1 1 1\n1 1\n", "where entries are, not what"),
        ("%%MatrixMarket Matrix Coordinate Pattern General\n1 1 1\n1 1\n", "where entries are, not what"),
        (
            "%%MatrixMarket matrix coordinate real general\n% a\n\n1 1 1\n1 1 3,6\n",
            "line 5 is not of plain numbers: 1 1 3,6",
        ),
        ("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 3.6+106\n", "line 3 is not of plain numbers"),
        ("%%MatrixMarket matrix array real general\n1 1\n3.6\0", "line 3 is not of plain numbers: 3.6"),
        ("%%MatrixMarket matrix coordinate real symmetric\n2 2 4\n1 1 2\n2 2 2\n1 2 1\n2 1 1\n", "entry twice"),
        ("%%MatrixMarket matrix coordinate real general\n2000000000000 2000000000000 1\n1 1 1\n", "cannot be read"),
        ("%%MatrixMarket matrix coordinate real general\n2 2 3\n1 1 2\n2 1 1\n2 2 2\n", "; it is one triangle"),
    ],
)
def test_matrix_market_that_is_wrong(content: str, rule: str, tmp_path: Path):
    (tmp_path / "m.mtx").write_text(content)
    scipy.io.mmwrite(tmp_path / "k.mtx", np.eye(2))
    key, loaded = refusal(files({"mass": tmp_path / "m.mtx", "stiffness": tmp_path / "k.mtx"}))
    assert key == "structure.file.mass"
    assert rule in loaded


def test_exponents_of_fortran_and_decimals_of_integers_are_read_whole(tmp_path: Path):
    """SciPy's own reader takes 2.5 for 2.5D+01, and 3 for 3.0e1 in a file of integers."""
    (tmp_path / "m.mtx").write_text(
        "%%MatrixMarket matrix coordinate Integer general\n% symmetric pattern\n2 2 3\n1 1 2.0e1\n1 1 10.\n2 2 10"
    )
    (tmp_path / "k.mtx").write_text("%%MatrixMarket matrix array real symmetric\n2 2\n2.5D+01\n-1.d0\n25d0")
    read = read_matrices({"mass": tmp_path / "m.mtx", "stiffness": tmp_path / "k.mtx"})
    assert np.array_equal(read.mass.toarray(), np.diag([30.0, 10.0]))
    assert np.array_equal(read.stiffness, [[25.0, -1.0], [-1.0, 25.0]])


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"indices": np.array([0, 1, 5])}, "cannot be read (indices must be < 3)"),
        ({"indices": np.array([0, -1, 2])}, "cannot be read (indices must be >= 0)"),
        ({"format": "coo", "coords": np.array([[0, 1, 2]]), "shape": (3,)}, "must be square, not 3 (numpy.diag"),
        ({"format": ""}, "scipy.sparse.save_npz)"),
    ],
)
def test_sparse_npz_that_is_wrong(changes: dict[str, Any], rule: str, tmp_path: Path):
    """Indices beyond the rows would be written to memory that is not the matrix'."""
    whole = {"format": "csr", "indptr": np.arange(4), "indices": np.arange(3), "data": np.ones(3), "shape": (3, 3)}
    np.savez(tmp_path / "m.npz", **whole | {"_is_array": True} | changes)
    key, loaded = refusal(files({"mass": tmp_path / "m.npz", "stiffness": tmp_path / "m.npz"}))
    assert key == "structure.file.mass"
    assert rule in loaded


def test_a_sparse_matrix_of_a_mat_file_whose_indices_lie_beyond_its_rows(tmp_path: Path):
    stiffness = scipy.sparse.csc_array(np.eye(3))
    stiffness.indices[2] = 7
    scipy.io.savemat(tmp_path / "a.mat", {"M": np.eye(3), "K": stiffness})
    assert "cannot be read (indices must be < 3)" in refusal(files(tmp_path / "a.mat"))[1]


@pytest.mark.parametrize(
    ("damping", "rule"),
    [
        (np.zeros((0, 0)), "must be square, not 0 x 0 (it is empty: leave it out"),
        (np.ones((1, 3)), "must be square, not 1 x 3 (numpy.diag"),
    ],
)
def test_damping_of_a_mat_file_that_is_no_matrix(damping: np.ndarray, rule: str, tmp_path: Path):
    scipy.io.savemat(tmp_path / "a.mat", {"M": np.eye(3), "K": np.eye(3), "C": damping})
    assert rule in refusal(files(tmp_path / "a.mat"))[1]


def test_other_kinds_of_file_are_refused(tmp_path: Path):
    assert "must be a .npz or .mat file" in refusal(files("a.mtx"))[1]
    (tmp_path / "m.npy").write_bytes(b"")
    key, loaded = refusal(files({"mass": tmp_path / "m.npy", "stiffness": "k.mtx"}))
    assert key == "structure.file.mass"
    assert "must be a .mtx file" in loaded
