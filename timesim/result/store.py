"""Result files: NetCDF-4 that any NetCDF reader opens, written whole or not at all.

A `Record` is what a study hands over: named arrays with dimensions. `save` writes it with h5netcdf alone;
xarray, whose import and writer take most of a second, is loaded only where a Dataset is asked for.
"""

import io
import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from timesim.result import label

if TYPE_CHECKING:
    import xarray

RESULT_NAME = "result.nc"
SCENE_NAME = "scene.yaml"
REQUIRED_ATTRIBUTES = (
    "timesim_version",
    "scene",
    "study",
    "complete",
    "method",
    "compile_seconds",
    "run_seconds",
)

Variables = Mapping[str, tuple[tuple[str, ...], np.ndarray]]

_COMPRESS_ABOVE = 64 * 1024


class StoreError(Exception):
    """A result that cannot be written or read; the message names the file, the reason and what to do."""


@dataclass(frozen=True)
class Record:
    """Named arrays of a result, labels not yet attached.

    Attributes:
        variables: array of each variable with the names of its dimensions.
        coords: values along the dimensions that bear any, one-dimensional, each named as its dimension.
        attrs: attributes of the whole result: text or numbers.
    """

    variables: Variables
    coords: Mapping[str, np.ndarray] = field(default_factory=dict)
    attrs: Mapping[str, Any] = field(default_factory=dict)

    def dataset(self) -> "xarray.Dataset":
        """The same as an xarray Dataset in memory, every array with its `long_name` and `units`."""
        import xarray

        labelled = {name: (dims, array, _attributes(name, array)) for name, (dims, array) in self.variables.items()}
        coords = {name: ((name,), array, _attributes(name, array)) for name, array in self.coords.items()}
        return xarray.Dataset(labelled, coords, dict(self.attrs))


def labels(name: str) -> dict[str, Any]:
    """`timesim.result.label.attributes` of a name.

    Raises:
        StoreError: no result holds a variable of this name.
    """
    try:
        return label.attributes(name)
    except KeyError as error:
        raise StoreError(f"variable '{name}': not a name of result files; add it to timesim.result.label") from error


def record(variables: Variables, coords: Mapping[str, Any], attrs: Mapping[str, Any]) -> Record:
    """Checked record: known names, one length for each dimension, flags as integers.

    Args:
        variables: ``{name: (dimensions, array)}``; a dimension of length 0 is allowed.
        coords: ``{dimension: values}``, names or numbers.
        attrs: attributes of the whole result.

    Raises:
        StoreError: a name is unknown, or an array does not fit its dimensions.
    """
    arrays = {name: (tuple(dims), _stored(array)) for name, (dims, array) in variables.items()}
    made = Record(arrays, {name: _stored(values) for name, values in coords.items()}, dict(attrs))
    for name in (*made.variables, *made.coords):
        labels(name)
    sizes(made)
    return made


def dataset(variables: Variables, coords: Mapping[str, Any], attrs: Mapping[str, Any]) -> "xarray.Dataset":
    """`record` as an xarray Dataset."""
    return record(variables, coords, attrs).dataset()


def sizes(made: Record) -> dict[str, int]:
    """Length of every dimension of a record.

    Raises:
        StoreError: two arrays disagree, or an array has not the dimensions it is said to have.
    """
    found: dict[str, int] = {}
    own = {name: ((name,), values) for name, values in made.coords.items()}
    for name, (dims, array) in {**own, **made.variables}.items():
        if len(dims) != array.ndim:
            raise StoreError(f"variable '{name}': shape {array.shape} does not fit the dimensions {dims}")
        for dim, length in zip(dims, array.shape, strict=True):
            if found.setdefault(dim, length) != length:
                raise StoreError(f"variable '{name}': {length} values along '{dim}', elsewhere {found[dim]}")
    return found


def save(result: "Record | xarray.Dataset", path: Path | str) -> Path:
    """Write a result file; an interrupted or failed write leaves what was there before.

    Args:
        result: record or Dataset with all of `REQUIRED_ATTRIBUTES`.
        path: file to write; its folder must exist.

    Returns:
        The path of the file.

    Raises:
        StoreError: an attribute is missing, a name unknown, or the file cannot be written.
    """
    return save_groups({"": result}, path)


def save_groups(groups: "Mapping[str, Record | xarray.Dataset]", path: Path | str) -> Path:
    """Write a result file with groups, each with its own dimensions and coordinates.

    In an xarray DataTree a coordinate of the root hides a variable of that name in a group: the root of a
    comparison must leave `frequency`, a variable of `hbm`, to its groups.

    Args:
        groups: results by group name; ``""`` is the root and bears `REQUIRED_ATTRIBUTES`.
        path: file to write; its folder must exist.

    Returns:
        The path of the file.

    Raises:
        StoreError: an attribute is missing, a name unknown, or the file cannot be written.
    """
    records = {name: _as_record(result) for name, result in groups.items()}
    missing = [name for name in REQUIRED_ATTRIBUTES if "" not in records or name not in records[""].attrs]
    if missing:
        raise StoreError(f"result file {path}: attribute missing: {', '.join(missing)}")
    write_whole(Path(path), _netcdf(records))
    return Path(path)


def open_result(path: Path | str) -> "xarray.Dataset":
    """Result of a run as a Dataset in memory; the file is closed again.

    Of a result with groups this is the root; `open_groups` has all of it.

    Args:
        path: result file, or the folder of a run.

    Raises:
        StoreError: no such file, not a result of timesim, or cut off.
    """
    return read(path)[""].dataset()


def open_groups(path: Path | str) -> "xarray.DataTree":
    """Result with groups as a tree of Datasets in memory.

    Args:
        path: result file, or the folder of a run.

    Raises:
        StoreError: no such file, not a result of timesim, or cut off.
    """
    return tree(read(path))


def tree(records: Mapping[str, Record]) -> "xarray.DataTree":
    """Records by group name as a tree of Datasets in memory."""
    import xarray

    return xarray.DataTree.from_dict({f"/{name}": made.dataset() for name, made in records.items()})


def whole(records: Mapping[str, Record]) -> "xarray.Dataset | xarray.DataTree":
    """A result in memory: a Dataset, or a tree of them where it has groups."""
    return records[""].dataset() if set(records) == {""} else tree(records)


def read(path: Path | str) -> dict[str, Record]:
    """Result as records by group name, ``""`` the root; does not load xarray.

    Args:
        path: result file, or the folder of a run.

    Raises:
        StoreError: no such file, not a result of timesim, or cut off.
    """
    import h5netcdf

    file = Path(path) / RESULT_NAME if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise StoreError(f"no result file at {file}; give a file or the folder of a finished run")
    try:
        with h5netcdf.File(file, "r", decode_vlen_strings=True) as source:
            groups = {"": _read_group(source)} | {name: _read_group(group) for name, group in source.groups.items()}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise StoreError(f"{file} cannot be read as a result file (cut off or not NetCDF-4): {error}") from error
    missing = [name for name in REQUIRED_ATTRIBUTES if name not in groups[""].attrs]
    if missing:
        raise StoreError(f"{file} is not a result of timesim: it has no attribute {', '.join(missing)}")
    return groups


def check_folder(folder: Path | str, force: bool = False) -> None:
    """Refuse a run folder that already holds a result or cannot be a folder; touches nothing.

    Raises:
        StoreError: with the reason and what to do.
    """
    path = Path(folder)
    if (path / RESULT_NAME).exists() and not force:
        raise StoreError(f"{path / RESULT_NAME} exists; choose another folder or give --force to overwrite it")
    for part in (path, *path.parents):
        if part.exists():
            if not part.is_dir():
                raise StoreError(f"{path} cannot be a run folder: {part} is a file; choose another folder")
            if not os.access(part, os.W_OK | os.X_OK):
                read_only = os.statvfs(part).f_flag & os.ST_RDONLY
                why = f"the file system of {part} is read-only" if read_only else f"no permission in {part}"
                raise StoreError(f"{path} cannot be written: {why}; choose another folder")
            return


def prepare_folder(
    folder: Path | str,
    scene: str,
    force: bool = False,
    source: Path | str | None = None,
    stale: Iterable[str] = (),
    resume: bool = False,
) -> Path:
    """Make the folder of a run with the resolved scene in it; for when the scene is known to be good.

    Args:
        folder: the folder, made with its parents where it is missing.
        scene: the resolved scene as YAML.
        force: allow a folder with a result. The old result stays until `save` replaces it.
        source: file the scene was read from; never overwritten by a different text.
        stale: names of earlier pictures, removed under `force` since they show another run.
        resume: allow a folder with a result of the same scene.

    Returns:
        The folder.

    Raises:
        StoreError: a result is there and `force` is not given, the scene would overwrite another file of the
            user's, or the folder cannot be written.
    """
    check_folder(folder, force or resume)
    path, target = Path(folder), Path(folder) / SCENE_NAME
    _check_scene_file(target, scene, force, source)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if force:
            for name in stale:
                (path / name).unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(f"run folder {path} cannot be made: {error.strerror or error}") from error
    write_whole(target, scene.encode())
    return path


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file so that it appears whole or not at all, also when power fails.

    Raises:
        StoreError: the disk is full, the folder is missing or may not be written.
    """
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            os.fchmod(stream.fileno(), 0o666 & ~_umask())
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        if temporary is not None:
            with suppress(OSError):
                os.unlink(temporary)
        if not isinstance(error, OSError):
            raise
        kept = "; what was there is unchanged" if path.exists() else ""
        raise StoreError(f"{path} cannot be written: {error.strerror or error}{kept}") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _check_scene_file(target: Path, scene: str, force: bool, source: Path | str | None) -> None:
    if not target.exists() or target.read_bytes() == scene.encode():
        return
    if source is not None and Path(source).exists() and target.samefile(source):
        raise StoreError(f"the run would overwrite its own scene file {target}; choose another folder")
    if not force:
        raise StoreError(f"{target} exists and is another scene; choose another folder or give --force")


def _stored(values: Any) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype.kind == "b":
        return array.astype(np.int8)
    return array.astype(object).astype(str) if array.dtype.kind in "OT" else array


def _as_record(result: "Record | xarray.Dataset") -> Record:
    if isinstance(result, Record):
        return record(result.variables, result.coords, result.attrs)
    variables = {str(name): (tuple(map(str, v.dims)), v.values) for name, v in result.data_vars.items()}
    coords = {str(name): v.values for name, v in result.coords.items()}
    return record(variables, coords, {str(name): value for name, value in result.attrs.items()})


def _netcdf(records: Mapping[str, Record]) -> memoryview:
    """The file's bytes. Made in memory: HDF5 reports a full disk late, and not always as an error."""
    import h5netcdf

    image = io.BytesIO()
    with h5netcdf.File(image, "w") as target:
        for name, made in records.items():
            _write_group(target.create_group(name) if name else target, made)
    return image.getbuffer()


def _write_group(group: Any, made: Record) -> None:
    for name, value in made.attrs.items():
        group.attrs[name] = int(value) if isinstance(value, bool | np.bool_) else value
    for dim, length in sizes(made).items():
        group.dimensions[dim] = length
    for name, values in made.coords.items():
        _write_variable(group, name, (name,), values)
    for name, (dims, array) in made.variables.items():
        _write_variable(group, name, dims, array)


def _write_variable(group: Any, name: str, dims: tuple[str, ...], array: np.ndarray) -> None:
    import h5py

    if array.dtype.kind == "U":
        variable = group.create_variable(name, dims, h5py.string_dtype())
        variable[...] = array.astype(object)
    else:
        pack = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        options = pack if array.nbytes > _COMPRESS_ABOVE else {}
        variable = group.create_variable(name, dims, array.dtype, data=array, **options)
    for key, value in _attributes(name, array).items():
        variable.attrs[key] = value


def _attributes(name: str, array: np.ndarray) -> dict[str, Any]:
    """The labels of an array; its flags are of its own type, as the CF conventions ask."""
    found = labels(name)
    flags = {"flag_values": found["flag_values"].astype(array.dtype)} if "flag_values" in found else {}
    return found | flags


def _read_group(group: Any) -> Record:
    arrays = {name: (tuple(v.dimensions), _loaded(v)) for name, v in group.variables.items()}
    coords = {name: array for name, (dims, array) in arrays.items() if dims == (name,)}
    variables = {name: entry for name, entry in arrays.items() if name not in coords}
    return Record(variables, coords, {name: _plain(value) for name, value in group.attrs.items()})


def _loaded(variable: Any) -> np.ndarray:
    values = np.asarray(variable[...])
    return values.astype(str) if values.dtype.kind == "O" else values


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
