"""Matrices of a structure, dense or sparse, and the files that hold them: ``.npz``, ``.mat`` and Matrix Market.

SciPy is loaded only when there are matrices to read.
"""

import io
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from timesim.fault import FROM_SCENE, RuleError

ARRAYS = {"mass": "M", "stiffness": "K", "damping": "C"}
ONE_EACH = "for a file of each matrix write file: {{mass: m{0}, stiffness: k{0}}}"
WRITERS = {
    ".mat": "save(..., '-v7') or scipy.io.savemat",
    ".mtx": "scipy.io.mmwrite",
    ".npz": "numpy.savez, or of one sparse matrix scipy.sparse.save_npz",
}
MARKET = re.compile(rb"(%%MatrixMarket)([^\n]*\n)((?:[ \t]*%[^\n]*\n|\s*\n)*)")
"""The header of a Matrix Market file: banner, kind, in capitals or not, and comments."""
NO_NUMBER = re.compile(rb"[^-+.\deEnaifNAIF\s]|[\d.][-+]")


@dataclass(frozen=True)
class Matrices:
    """Matrices of one structure, dense or sparse, shape (N, N); damping None where there is none.

    `solved` keeps modes, by the number of them, with their eigenvalues and those above that are known; `left_out` the
    static flexibility without them, by their number and the rows.
    """

    mass: Any
    stiffness: Any
    damping: Any = None
    notes: tuple[str, ...] = ()
    solved: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False, compare=False)
    left_out: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    def data(self) -> list[list[np.ndarray]]:
        """The numbers of each matrix: its entries, of a sparse one those that are not 0 and where they are."""
        given = (matrix for matrix in (self.mass, self.stiffness, self.damping) if matrix is not None)
        return [_entries(matrix) for matrix in given]


def _entries(matrix: Any) -> list[np.ndarray]:
    if isinstance(matrix, np.ndarray):
        return [matrix]
    columns = matrix.tocsc(copy=True)
    columns.sum_duplicates()
    columns.eliminate_zeros()
    return [columns.data, columns.indices, columns.indptr]


def read_matrices(source: Path | Mapping[str, Path]) -> Matrices:
    """Read mass, stiffness and, if it is there, damping.

    They come from a .npz or .mat file that holds them all by name, or from a file (.mtx, .npz) for each.

    Raises:
        RuleError: a file that cannot be read, lacks a matrix, or holds something else under its name.
    """
    if isinstance(source, Mapping):
        return Matrices(**{name: _read_single(path, name) for name, path in source.items()})
    readers = {".npz": _read_npz, ".mat": _read_mat}
    if source.suffix.lower() not in readers:
        hint = f"numpy.savez writes one; {ONE_EACH.format('.mtx')}"
        raise RuleError((), "must be a .npz or .mat file", hint, str(source))
    _check_present(source)
    arrays = readers[source.suffix.lower()](source)
    names = {name: next((key for key in (name, short) if key in arrays), None) for name, short in ARRAYS.items()}
    for name in ("mass", "stiffness"):
        if names[name] is None:
            rule = f"holds neither {name} nor {ARRAYS[name]}"
            hint = f"it holds {', '.join(sorted(arrays)) or 'nothing'}"
            raise RuleError((), rule, ONE_EACH.format(".npz") if "indptr" in arrays else hint, str(source))
    matrices = {name: numeric(arrays[key], f"{key} in {source.name}") for name, key in names.items() if key}
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
        hint = f"it may be truncated or of another kind: write it again, by {WRITERS[path.suffix.lower()]}"
        if isinstance(error, NotImplementedError) and path.suffix.lower() == ".mat":
            rule, hint = "is a MATLAB 7.3 file", "save it with save(..., '-v7')"
        elif "pickle" in str(error):
            rule = "holds pickled objects"
            hint = "save plain numeric arrays; sparse ones as .mat, or each by scipy.sparse.save_npz"
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
        return {name: _sound(arrays.get(name)) for name in names}


def _read_single(path: Path, name: str) -> Any:
    _check_present(path)
    import scipy.sparse

    readers = {".npz": scipy.sparse.load_npz, ".mtx": _read_market}
    if path.suffix.lower() not in readers:
        rule, hint = "must be a .mtx file, or a .npz file of scipy.sparse.save_npz", "scipy.io.mmwrite writes a .mtx"
        raise RuleError((name,), rule, hint, str(path))
    try:
        with _reading(path):
            matrix = _sound(readers[path.suffix.lower()](path))
        return numeric(matrix, path.name)
    except RuleError as error:
        raise error.below(name) from None


def _read_market(path: Path) -> Any:
    """A matrix from a Matrix Market file; exponents may be written with a D, as Fortran does.

    SciPy's reader passes over what follows a number: it takes 3 for 3,6 and 3.6 for 3.6D+06 or 3.6+106, the whole part
    of a number that is called an integer, and where the last line has no end it reads on behind its memory.
    """
    import scipy.io

    text = path.read_bytes()
    header = MARKET.match(text)
    if header is None:
        raise ValueError("its first line is no %%MatrixMarket header")
    banner, kind, comments = header[1], header[2].lower().replace(b"integer", b"real"), header[3]
    body = text[header.end() :].translate(bytes.maketrans(b"Dd", b"EE"))
    if b"pattern" in kind:
        raise ValueError("a pattern says where entries are, not what they are")
    if odd := NO_NUMBER.search(body):
        line = text.count(b"\n", 0, header.end() + odd.end())
        written = text.splitlines()[line].decode(errors="replace").strip()
        raise ValueError(f"line {line + 1} is not of plain numbers: {written[:60]}")
    matrix = scipy.io.mmread(io.BytesIO(banner + kind + comments + body + b"\n"), spmatrix=False)
    if b"symmetric" in kind and hasattr(matrix, "tocsc") and matrix.tocsc().nnz < matrix.nnz:
        raise ValueError("it is called symmetric and gives an entry twice: one triangle is enough")
    return matrix


def _sound(matrix: Any) -> Any:
    """The same matrix, CSC if it is sparse; indices beyond its rows would lead SciPy into foreign memory."""
    if not hasattr(matrix, "tocsc"):
        return matrix
    if hasattr(matrix, "check_format"):
        matrix.check_format()
    return matrix.tocsc() if matrix.ndim == 2 else matrix.toarray()


def numeric(matrix: Any, name: str) -> Any:
    """The matrix as float64, dense or CSC.

    Raises:
        RuleError: it is not real, square and finite; it is called ``name``.
    """
    sparse = hasattr(matrix, "tocsc")
    matrix = matrix.tocsc() if sparse else np.asarray(matrix)
    if matrix.dtype.kind not in "fiu":
        hint = "of hysteretic damping take the real part, and half the loss factor as damping_ratio"
        raise RuleError((), f"{name} must hold real numbers, not {matrix.dtype}", hint * (matrix.dtype.kind == "c"))
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] == 0:
        shape = " x ".join(map(str, matrix.shape)) or "a single number"
        hint = "numpy.diag makes a matrix of its diagonal" if max(matrix.shape, default=0) == matrix.size > 1 else ""
        if matrix.size == 0:
            hint = "it is empty: leave it out where there is none"
        raise RuleError((), f"{name} must be square, not {shape}", hint)
    matrix = matrix.astype(np.float64)
    if not np.all(np.isfinite(matrix.data if sparse else matrix)):
        with np.errstate(invalid="ignore"):
            row, column = largest_entry(matrix * 0)
        raise RuleError((), f"{name} must be finite, without NaN", f"row {row}, column {column}")
    return matrix


def largest_entry(matrix: Any) -> tuple[int, int]:
    """Row and column of the entry of largest size, or of the first NaN."""
    from scipy.sparse import coo_array

    entries = coo_array(matrix)
    at = np.argmax(np.abs(entries.data))
    return int(entries.row[at]), int(entries.col[at])
