"""Modes from matrices of mass, stiffness and damping: the eigenproblem ``K phi = omega^2 M phi``.

The modes are mass-normalised (``phi^T M phi = 1``), each with its largest entry positive. A damping matrix
``C`` becomes ``phi^T C phi``: its diagonal where the modes diagonalise it, else the whole of it (Rayleigh
damping and its kin are diagonal, Caughey and O'Kelly 1965; a dashpot between two masses is not).

SciPy is loaded only when there are matrices to solve.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from timesim.fault import RuleError
from timesim.model.matrices import Matrices, largest_entry, numeric
from timesim.model.model import Structure
from timesim.model.scales import LARGEST

AXES = "xyz"
MAX_DENSE = 2000
SYMMETRY = 1e-9
"""Largest difference of mirrored entries, as a share of the largest entry, that counts as rounding."""
SOFT, SHIFT = 1e-8, 1e-12
"""Eigenvalues below the former share of the largest lose digits to rounding, beside penalties as of clamps all of them;
inverse iteration finds them, the stiffness of free bodies being shifted by the latter."""
SLOW = 1e-3
"""Share of the lowest eigenvalue that is left out that counts as static: a free body has a flexibility then."""
NEGATIVE = 1e-10
"""Eigenvalues down to minus this share of the largest are rounding of a free body's zero."""
ROUNDING = 10
"""Times what rounding of each entry of a matrix may make of an eigenvalue, up to which it counts as rounding. Those of
free chains and beams of 10 to 12,000 rows reach 1.3; those of clamped beams that reach 3 err by less than 1 %."""


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
        raise RuleError(
            ("damping_ratio",), rule, "0 for an undamped structure; a matrix in a file is called damping or C"
        )
    axes = {3 * i + AXES.index(axis): row for i, own in enumerate(points.values()) for axis, row in own.items()}
    place, rows = list(axes), list(axes.values())
    shape = np.zeros((3 * len(points), num_modes))
    shape[place] = modes[rows]
    left = None
    if num_modes < mass.shape[0]:
        if (key := (num_modes, *rows)) not in matrices.left_out:
            matrices.left_out[key] = _left_out(mass, stiffness, squared, modes, rows)
        left = np.zeros((3 * len(points),) * 2)
        left[np.ix_(place, place)] = matrices.left_out[key]
    shape = shape.reshape(-1, 3, num_modes)
    return Structure(omega / (2 * np.pi), np.ones(num_modes), damping, tuple(points), shape, left)


def _left_out(mass: Any, stiffness: Any, squared: np.ndarray, modes: np.ndarray, rows: list[int]) -> np.ndarray:
    """Static flexibility between rows of the modes that are not kept, shape (R, R)."""
    shift, unit = SLOW * squared[min(modes.shape[1], squared.size - 1)], np.zeros((mass.shape[0], len(rows)))
    unit[rows, np.arange(len(rows))] = 1.0
    if shift == 0:  # rigid-body motions are left out
        return np.zeros((len(rows),) * 2)
    moved = _solved(stiffness + shift * mass, unit)
    return np.asarray(moved[rows] - modes[rows] / (squared[: modes.shape[1]] + shift) @ modes[rows].T)


def _solved(matrix: Any, right: np.ndarray) -> np.ndarray:
    if not hasattr(matrix, "tocsc"):
        return np.linalg.solve(matrix, right)
    from scipy.sparse.linalg import splu

    return np.asarray(splu(matrix.tocsc()).solve(right))


def _symmetric(matrix: Any, name: str) -> Any:
    try:
        matrix = numeric(matrix, f"the {name} matrix")
    except RuleError as error:
        raise error.below(name) from None
    from scipy.sparse import coo_array, tril

    difference, largest = abs(matrix - matrix.T).max(), abs(matrix).max()
    if difference > SYMMETRY * largest:
        rows = " and ".join(map(str, sorted(largest_entry(matrix - matrix.T))))
        hint = f"mirrored entries differ by up to {difference:.3g}, those of rows {rows}"
        if not min(abs(tril(coo_array(half), -1)).max() for half in (matrix, matrix.T)):
            hint += "; it is one triangle: A + A.T with the diagonal once is whole"
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
        raise _indefinite_stiffness(f"; the lowest is omega^2 = {smallest:.6g}")
    # The mode of a body without any spring makes next to nothing of the matrix, which then bounds nothing.
    rounding = np.maximum(_rounding(stiffness, modes), np.finfo(float).eps ** 2 * largest)
    return np.where(np.logical_and.accumulate(squared <= rounding), 0.0, squared), modes[:, :num_modes]


def _rounding(matrix: Any, modes: np.ndarray) -> np.ndarray:
    """What rounding may leave of the diagonal of a symmetric matrix in the modes, shape (M,)."""
    size = np.abs(modes)
    return np.asarray((size * (abs(matrix) @ size)).sum(axis=0) * np.finfo(float).eps * ROUNDING)


def _dense_eigenmodes(mass: np.ndarray, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    import scipy.linalg

    if np.any(mass.diagonal() < 1 / LARGEST):
        raise _indefinite_mass(mass)
    try:
        squared, modes = scipy.linalg.eigh(stiffness, mass)
    except np.linalg.LinAlgError:
        raise _indefinite_mass(mass) from None
    if scipy.linalg.eigvalsh(mass / _outer_root(np.diag(mass)))[0] < 1e-13:
        raise _indefinite_mass(mass)
    largest = np.abs(squared).max()
    low = squared < SOFT * largest
    if low.any():
        squared[low], modes[:, low] = _soft_modes(mass, stiffness, modes[:, low], SHIFT * largest)
    return squared, modes


def _soft_modes(mass: Any, stiffness: Any, modes: np.ndarray, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """The lowest eigenvalues and modes, from approximate ones, by a step of inverse iteration and Rayleigh and Ritz."""
    import scipy.linalg

    moved = _solved(stiffness + shift * mass, mass @ modes)
    moved /= np.linalg.norm(moved, axis=0)
    squared, shares = scipy.linalg.eigh(moved.T @ stiffness @ moved, moved.T @ mass @ moved)
    return squared, moved @ shares


def _outer_root(diagonal: np.ndarray) -> np.ndarray:
    return np.sqrt(np.outer(diagonal, diagonal))


def _indefinite_mass(mass: Any) -> RuleError:
    hint, diagonal = "a row without mass must be condensed out first", mass.diagonal()
    if diagonal[least := int(np.argmin(diagonal))] < 1 / LARGEST:
        hint += f"; the diagonal of row {least} is {diagonal[least]:.6g}"
    return RuleError(("mass",), "the mass matrix must be positive definite", hint)


def _indefinite_stiffness(found: str = "") -> RuleError:
    hint = f"a spring k adds k to two entries of the diagonal and -k between them: look for a wrong sign{found}"
    return RuleError(("stiffness",), "the stiffness matrix must have no negative eigenvalue", hint)


def _sparse_eigenmodes(mass: Any, stiffness: Any, num_modes: int) -> tuple[np.ndarray, np.ndarray]:
    """Lanczos about a shift just below zero; Sylvester's law of inertia says that no mode is left out."""
    import scipy.sparse as sparse
    from scipy.sparse.linalg import eigsh

    mass, stiffness = sparse.csc_matrix(mass), sparse.csc_matrix(stiffness)
    if np.any(mass.diagonal() < 1 / LARGEST) or _num_negative(mass):
        raise _indefinite_mass(mass)
    scale = float(np.median(np.abs(stiffness.diagonal()) / mass.diagonal()))
    shift = -NEGATIVE * scale
    if _num_negative(stiffness - shift * mass):
        raise _indefinite_stiffness()
    size = min(mass.shape[0] - 1, num_modes + 1)
    _, modes = eigsh(stiffness, size, mass, sigma=shift, v0=np.ones(mass.shape[0]), tol=0)
    squared, modes = _soft_modes(mass, stiffness, modes, -shift)
    # Where modes of one frequency are kept in part, there is nothing to count between the kept and the next one.
    apart = np.flatnonzero(np.diff(squared) > _rounding(stiffness, modes)[1:])
    expected = int(apart.max(initial=-1)) + 1
    below = squared[max(expected - 1, 0) : expected + 1].mean()
    if expected and (count := _num_negative(stiffness - below * mass)) != expected:
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
    rounding = _rounding(damping, modes)
    if values[0] < -max(NEGATIVE * values[-1], rounding.max()):
        rule = "the damping matrix must have no negative eigenvalue"
        raise RuleError(("damping",), rule, f"look for a wrong sign; the lowest in the modes kept is {values[0]:.6g}")
    diagonal = np.clip(np.diag(modal), 0, None)
    coupling = np.abs(modal - np.diag(np.diag(modal)))
    return diagonal if np.all(coupling <= _outer_root(rounding) + 1e-10 * _outer_root(diagonal)) else modal
