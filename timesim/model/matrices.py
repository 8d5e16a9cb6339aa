"""Modes from matrices: files of mass, stiffness and damping, and the eigenproblem ``K phi = omega^2 M phi``.

The modes are mass-normalised (``phi^T M phi = 1``), each with its largest entry positive. A damping matrix
``C`` becomes ``phi^T C phi``: its diagonal where the modes diagonalise it, else the whole of it (Rayleigh
damping and its kin are diagonal, Caughey and O'Kelly 1965; a dashpot between two masses is not).

SciPy is loaded only when there are matrices to read or to solve.
"""

import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from timesim.fault import FROM_SCENE, RuleError
from timesim.model.model import Structure

ARRAYS = {"mass": "M", "stiffness": "K", "damping": "C"}
AXES = "xyz"
MAX_DENSE = 2000
SYMMETRY = 1e-9
"""Largest difference of mirrored entries, as a share of the largest entry, that counts as rounding."""
SOFT, SHIFT = 1e-8, 1e-12
"""Eigenvalues below the former share of the largest lose digits to rounding, beside penalties as of clamps all of them;
inverse iteration finds them, the stiffness of free bodies being shifted by the latter."""
NEGATIVE = 1e-10
"""Eigenvalues down to minus this share of the largest are rounding of a free body's zero."""


@dataclass(frozen=True)
class Matrices:
    """Matrices of one structure, dense or sparse, shape (N, N); damping None where there is none.

    `solved` keeps modes, by the number of them, with their eigenvalues and those above that are known.
    """

    mass: Any
    stiffness: Any
    damping: Any = None
    notes: tuple[str, ...] = ()
    solved: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False, compare=False)


def read_matrices(source: Path | Mapping[str, Path]) -> Matrices:
    """Read mass, stiffness and, if it is there, damping.

    Args:
        source: a .npz or .mat file that holds them all by name, or a file (.mtx, .npz) for each.

    Raises:
        RuleError: a file that cannot be read, lacks a matrix, or holds something else under its name.
    """
    if isinstance(source, Mapping):
        return Matrices(**{name: _read_single(path, name) for name, path in source.items()})
    readers = {".npz": _read_npz, ".mat": _read_mat}
    if source.suffix.lower() not in readers:
        hint = "for Matrix Market write file: {mass: m.mtx, stiffness: k.mtx}"
        raise RuleError((), "must be a .npz or .mat file", hint, str(source))
    _check_present(source)
    arrays = readers[source.suffix.lower()](source)
    names = {name: next((key for key in (name, short) if key in arrays), None) for name, short in ARRAYS.items()}
    for name in ("mass", "stiffness"):
        if names[name] is None:
            rule = f"holds neither {name} nor {ARRAYS[name]}"
            raise RuleError((), rule, f"it holds {', '.join(sorted(arrays)) or 'nothing'}", str(source))
    matrices = {name: _numeric(arrays[key], f"{key} in {source.name}") for name, key in names.items() if key}
    spare = [short for name, short in ARRAYS.items() if name in arrays and short in arrays]
    unused = "{0} holds {1} besides the array of the full name; {1} is left alone"
    return Matrices(**matrices, notes=tuple(unused.format(source.name, short) for short in spare))


def _check_present(path: Path) -> None:
    if not path.is_file():
        rule = "is no file" if path.exists() else "does not exist"
        raise RuleError((), rule, FROM_SCENE, str(path))


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Refuse a file that cannot be read: a damaged one raises whatever its bytes lead zlib, numpy or scipy into."""
    try:
        yield
    except Exception as error:
        rule = f"cannot be read ({' '.join(str(error).split())[:200] or type(error).__name__})"
        hint = "the file may be truncated; write it again"
        if isinstance(error, NotImplementedError) and path.suffix.lower() == ".mat":
            rule, hint = "is a MATLAB 7.3 file", "save it with save(..., '-v7')"
        elif "pickle" in str(error):
            rule, hint = "holds pickled objects", "save plain numeric arrays, sparse ones as .mat or .mtx"
        raise RuleError((), rule, hint, str(path)) from None


def _read_npz(path: Path) -> dict[str, Any]:
    wanted = [*ARRAYS, *ARRAYS.values()]
    if not zipfile.is_zipfile(path):
        raise RuleError((), "is no whole .npz archive", "it may be truncated; write it again", str(path))
    with _reading(path), path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
        return {key: archive[key] if key in wanted else None for key in archive.files}


def _read_mat(path: Path) -> dict[str, Any]:
    import scipy.io

    with _reading(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        names = [entry[0] for entry in scipy.io.whosmat(path)]
        wanted = [name for name in names if name in ARRAYS or name in ARRAYS.values()]
        arrays = scipy.io.loadmat(path, variable_names=wanted)
        return {name: arrays.get(name) for name in names}


def _read_single(path: Path, name: str) -> Any:
    _check_present(path)
    if path.suffix.lower() not in (".mtx", ".npz"):
        raise RuleError((name,), "must be a .mtx file, or a .npz file of scipy.sparse.save_npz", value=str(path))
    import scipy.io
    import scipy.sparse

    read = partial(scipy.io.mmread, spmatrix=False) if path.suffix.lower() == ".mtx" else scipy.sparse.load_npz
    try:
        with _reading(path):
            matrix = read(path)
        return _numeric(matrix, path.name)
    except RuleError as error:
        raise error.below(name) from None


def _numeric(matrix: Any, name: str) -> Any:
    """The matrix as float64, dense or CSC, once it is known to be real, square and finite."""
    sparse = hasattr(matrix, "tocsc")
    matrix = matrix.tocsc() if sparse else np.asarray(matrix)
    if matrix.dtype.kind not in "fiu":
        raise RuleError((), f"{name} must hold real numbers, not {matrix.dtype}")
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] == 0:
        raise RuleError((), f"{name} must be square, not {' x '.join(map(str, matrix.shape))}")
    matrix = matrix.astype(np.float64)
    if not np.all(np.isfinite(matrix.data if sparse else matrix)):
        with np.errstate(invalid="ignore"):
            row, column = _largest(matrix * 0)
        raise RuleError((), f"{name} must be finite, without NaN", f"row {row}, column {column}")
    return matrix


def _largest(matrix: Any) -> tuple[int, int]:
    """Row and column of the entry of largest size, or of the first NaN."""
    from scipy.sparse import coo_array

    entries = coo_array(matrix)
    at = np.argmax(np.abs(entries.data))
    return int(entries.row[at]), int(entries.col[at])


def modal_structure(
    matrices: Matrices,
    *,
    points: Mapping[str, Mapping[str, int]],
    damping_ratio: float | Sequence[float] | None = None,
    keep_modes: int | None = None,
) -> Structure:
    """The lowest modes of a structure, with their shapes at the points.

    Args:
        matrices: mass, stiffness and damping; rows are degrees of freedom.
        points: the row of each axis a point moves along.
        damping_ratio: of every mode, or one a mode kept; rules over a damping matrix.
        keep_modes: how many of the lowest modes; all by default.

    Raises:
        RuleError: matrices that no structure has, or a point, a count or a length that does not fit them.
    """
    mass, stiffness = _symmetric(matrices.mass, "mass"), _symmetric(matrices.stiffness, "stiffness")
    _check_sizes(mass.shape[0], stiffness, matrices.damping, points, keep_modes)
    num_modes = keep_modes or mass.shape[0]
    if num_modes not in matrices.solved:
        matrices.solved[num_modes] = _eigenmodes(mass, stiffness, num_modes)
    squared, modes = matrices.solved[num_modes]
    modes = modes * _signs(modes)
    omega = np.sqrt(squared[:num_modes])
    if damping_ratio is not None:
        damping = 2 * _ratios(damping_ratio, num_modes) * omega
    elif matrices.damping is not None:
        damping = _modal_damping(_symmetric(matrices.damping, "damping"), modes)
    else:
        rule = "is required where there is no damping matrix"
        raise RuleError(("damping_ratio",), rule, "0 for an undamped structure")
    shape = np.zeros((len(points), 3, num_modes))
    for point, rows in zip(shape, points.values(), strict=True):
        for axis, row in rows.items():
            point[AXES.index(axis)] = modes[row]
    return Structure(omega / (2 * np.pi), np.ones(num_modes), damping, tuple(points), shape)


def _symmetric(matrix: Any, name: str) -> Any:
    try:
        matrix = _numeric(matrix, f"the {name} matrix")
    except RuleError as error:
        raise error.below(name) from None
    difference, largest = abs(matrix - matrix.T).max(), abs(matrix).max()
    if difference > SYMMETRY * largest:
        rows = " and ".join(map(str, sorted(_largest(matrix - matrix.T))))
        hint = f"mirrored entries differ by up to {difference:.3g}, those of rows {rows}"
        raise RuleError((name,), f"the {name} matrix must be symmetric", hint)
    return (matrix + matrix.T) / 2


def _check_sizes(
    rows: int, stiffness: Any, damping: Any, points: Mapping[str, Mapping[str, int]], keep_modes: int | None
) -> None:
    for name, matrix in (("stiffness", stiffness), ("damping", damping)):
        if matrix is not None and matrix.shape != (rows, rows):
            size = " x ".join(map(str, matrix.shape))
            raise RuleError((name,), f"the {name} matrix must be {rows} x {rows} like the mass matrix, not {size}")
    for point, axes in points.items():
        for axis, row in axes.items():
            if row >= rows:
                raise RuleError(("points", point, axis), f"must be a row from 0 to {rows - 1}", value=row)
    if keep_modes is not None and keep_modes > rows:
        raise RuleError(("keep_modes",), f"must be at most {rows}, the number of rows", value=keep_modes)
    if rows > MAX_DENSE and keep_modes in (None, rows):
        rule = "is required" if keep_modes is None else f"must be less than {rows}"
        hint = "say how many of the lowest modes: Lanczos' method does not find all"
        raise RuleError(("keep_modes",), f"{rule} for a structure of {rows} rows", hint, keep_modes)


def _ratios(ratio: float | Sequence[float], num_modes: int) -> np.ndarray:
    values = np.atleast_1d(np.asarray(ratio, dtype=np.float64))
    if np.ndim(ratio) and values.size != num_modes:
        rule = f"must be one number, or one for each of the {num_modes} modes kept"
        raise RuleError(("damping_ratio",), rule, value=ratio)
    return np.broadcast_to(values, num_modes).copy()


def _signs(modes: np.ndarray) -> np.ndarray:
    """Signs that make the largest entry of each mode positive; of equal entries the first counts."""
    size = np.abs(modes)
    largest = np.argmax(size >= size.max(axis=0) * (1 - 1e-9), axis=0)
    return np.sign(modes[largest, np.arange(modes.shape[1])])


def _eigenmodes(mass: Any, stiffness: Any, num_modes: int) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues ``omega^2``, the lowest M and those above that are known, and mass-normalised modes, shape (N, M)."""
    if mass.shape[0] <= MAX_DENSE:
        squared, modes = _dense_eigenmodes(*(m.toarray() if hasattr(m, "toarray") else m for m in (mass, stiffness)))
    else:
        squared, modes = _sparse_eigenmodes(mass, stiffness, num_modes)
    largest, smallest = np.abs(squared).max(), squared.min()
    if smallest < -NEGATIVE * largest:
        hint = f"its lowest eigenvalue is omega^2 = {smallest:.6g}"
        raise RuleError(("stiffness",), "the stiffness matrix must have no negative eigenvalue", hint)
    # The mode of a body without any spring makes next to nothing of the matrix, which then bounds nothing.
    rounding = np.maximum(np.diag(_rounding(stiffness, modes)), np.finfo(float).eps ** 2 * largest)
    return np.where(np.logical_and.accumulate(squared <= rounding), 0.0, squared), modes[:, :num_modes]


def _rounding(matrix: Any, modes: np.ndarray) -> np.ndarray:
    """What rounding may leave of the entries of a symmetric matrix in the modes, shape (M, M)."""
    return np.abs(modes).T @ (abs(matrix) @ np.abs(modes)) * np.finfo(float).eps * 10 * modes.shape[0]


def _dense_eigenmodes(mass: np.ndarray, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    import scipy.linalg

    try:
        squared, modes = scipy.linalg.eigh(stiffness, mass)
    except np.linalg.LinAlgError:
        raise _indefinite_mass(mass) from None
    if scipy.linalg.eigvalsh(mass / _outer_root(np.diag(mass)))[0] < 1e-13:
        raise _indefinite_mass(mass)
    low = squared < SOFT * squared[-1]
    if low.any():
        squared[low], modes[:, low] = _soft_modes(mass, stiffness, modes[:, low], SHIFT * squared[-1])
    return squared, modes


def _soft_modes(
    mass: np.ndarray, stiffness: np.ndarray, modes: np.ndarray, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """The lowest eigenvalues and modes, from approximate ones, by a step of inverse iteration and Rayleigh and Ritz."""
    import scipy.linalg

    moved = np.linalg.solve(stiffness + shift * mass, mass @ modes)
    moved /= np.linalg.norm(moved, axis=0)
    squared, shares = scipy.linalg.eigh(moved.T @ stiffness @ moved, moved.T @ mass @ moved)
    return squared, moved @ shares


def _outer_root(diagonal: np.ndarray) -> np.ndarray:
    return np.sqrt(np.outer(diagonal, diagonal))


def _indefinite_mass(mass: Any) -> RuleError:
    hint, diagonal = "a row without mass must be condensed out first", mass.diagonal()
    if diagonal[least := int(np.argmin(diagonal))] <= 0:
        hint += f"; the diagonal of row {least} is {diagonal[least]:.6g}"
    return RuleError(("mass",), "the mass matrix must be positive definite", hint)


def _sparse_eigenmodes(mass: Any, stiffness: Any, num_modes: int) -> tuple[np.ndarray, np.ndarray]:
    """Lanczos about a shift just below zero; Sylvester's law of inertia says that no mode is left out."""
    import scipy.sparse as sparse
    from scipy.sparse.linalg import eigsh

    mass, stiffness = sparse.csc_matrix(mass), sparse.csc_matrix(stiffness)
    if np.any(mass.diagonal() <= 0) or _num_negative(mass):
        raise _indefinite_mass(mass)
    scale = float(np.max(np.abs(stiffness.diagonal()) / mass.diagonal()))
    shift = -NEGATIVE * scale
    if _num_negative(stiffness - shift * mass):
        raise RuleError(("stiffness",), "the stiffness matrix must have no negative eigenvalue")
    size = min(mass.shape[0] - 1, num_modes + 1)
    squared, modes = eigsh(stiffness, size, mass, sigma=shift, v0=np.ones(mass.shape[0]), tol=0)
    order = np.argsort(squared)
    squared, modes = squared[order], modes[:, order]
    below = (squared[num_modes - 1] + squared[min(num_modes, size - 1)]) / 2
    expected = int(np.sum(squared < below))
    if num_modes < size and (count := _num_negative(stiffness - below * mass)) != expected:
        hint = f"{count} lie below omega^2 = {below:.6g}, Lanczos' method gave {expected}; try another keep_modes"
        raise RuleError(("keep_modes",), "the eigenvalue solver missed modes", hint, num_modes)
    return np.where(np.abs(squared) < -2 * shift, np.maximum(squared, 0), squared), modes


def _num_negative(matrix: Any) -> int:
    """Number of negative eigenvalues of a sparse symmetric matrix, from the signs of its L D L^T pivots."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    try:
        factor = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError:  # exactly singular
        return 1
    return int(np.sum(factor.U.diagonal() < 0))


def _modal_damping(damping: Any, modes: np.ndarray) -> np.ndarray:
    """Modal damping, shape (M,) where the modes diagonalise it, else (M, M)."""
    modal = modes.T @ (damping @ modes)
    modal = (modal + modal.T) / 2
    values = np.linalg.eigvalsh(modal)
    if values[0] < -max(NEGATIVE * values[-1], _rounding(damping, modes).max()):
        rule = "the damping matrix must have no negative eigenvalue"
        raise RuleError(("damping",), rule, f"in the modes kept: {values[0]:.6g}")
    diagonal = np.clip(np.diag(modal), 0, None)
    coupling = np.abs(modal - np.diag(np.diag(modal)))
    return diagonal if np.all(coupling <= _rounding(damping, modes) + 1e-10 * _outer_root(diagonal)) else modal
