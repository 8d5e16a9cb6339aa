"""Result files: NetCDF-4, read and written by xarray."""

import io
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

import numpy as np

from timesim.result.argument import path_of, shown
from timesim.result.file import StoreError, write_whole

if TYPE_CHECKING:
    import xarray

RESULT_NAME = "result.nc"
KEPT_NAME = "checkpoint"  # folder beside it while its run goes on
TEXTS = ("timesim_version", "scene", "study", "method")
REQUIRED_ATTRIBUTES = (*TEXTS, "complete", "compile_seconds", "run_seconds")

LONGEST = 120  # letters of a message of xarray that are passed on
_COMPRESS_ABOVE = 64 * 1024  # bytes of an array
_COMPRESSION = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


def save(result: "xarray.Dataset | Mapping[str, xarray.Dataset]", path: Path | str) -> Path:
    """Write a result file into an existing folder; an interrupted or failed write leaves an earlier file unchanged.

    Args:
        result: a Dataset, or Datasets by the name of their group, ``""`` the root, which has the
            `REQUIRED_ATTRIBUTES`.
        path: file to write, which is returned.

    Raises:
        StoreError: an attribute is missing, or the file cannot be written.
    """
    import xarray

    groups = {"": result} if isinstance(result, xarray.Dataset) else result
    missing = [name for name in REQUIRED_ATTRIBUTES if "" not in groups or name not in groups[""].attrs]
    if missing:
        raise StoreError(f"result file {path}: attribute missing: {', '.join(missing)}")
    try:
        content = _content(groups)
    except MemoryError as error:
        raise StoreError(f"{path} cannot be written: the memory does not suffice to pack it") from error
    write_whole(Path(path), content)
    return Path(path)


def save_elsewhere(groups: "Mapping[str, xarray.Dataset]", folder: Path) -> list[str]:
    """Save a result that `save` could not write into its folder: among the temporary files, and without its samples.

    Returns:
        What of it is in which file, in words; nothing where there is no room for any of it.
    """
    saved = []
    with suppress(OSError, StoreError):
        whole = save(groups, Path(tempfile.gettempdir()) / f"timesim-{uuid4().hex}.nc")
        saved.append(f"the whole of it is in {whole}: move it before temporary files are removed")
    if "time" in groups[""].dims:
        root = groups[""].isel(time=slice(0, 0))
        reason = "; ".join(filter(None, (root.attrs.get("reason"), "its samples are left out, for which was no room")))
        with suppress(StoreError):
            part = save({**groups, "": root.assign_attrs(complete=0, reason=reason)}, folder / RESULT_NAME)
            saved.append(f"all but its samples is in {part}, marked complete = 0")
    return saved


def open_result(path: Path | str) -> "xarray.Dataset | xarray.DataTree":
    """Load the result of a run into memory, by its file or the folder of the run.

    Returns:
        A Dataset, or a DataTree of a result with groups. A coordinate of the tree's root hides a variable of that
        name in a group from ``tree[group]``, not from ``tree[group].to_dataset(inherit=False)``.

    Raises:
        StoreError: no such file, not a result of timesim, or cut off.
    """
    groups = read(path)
    try:
        return joined(groups)
    except ValueError as error:
        raise StoreError(f"{result_file(path)} is no whole result: {' '.join(str(error).split())[:LONGEST]}") from error


def joined(groups: "Mapping[str, xarray.Dataset]") -> "xarray.Dataset | xarray.DataTree":
    """Datasets by the name of their group as one object: the Dataset of the root alone, or a DataTree."""
    import xarray

    if set(groups) == {""}:
        return groups[""]
    return xarray.DataTree.from_dict({f"/{name}": data for name, data in groups.items()})


def result_file(path: Path | str) -> Path:
    """The result file of a run, by its own path or by the folder of the run."""
    given = path_of("path", path, "the path of a result file or of the folder of a run")
    # Of os.path, as those of pathlib raise where a folder may not be searched or a name is too long.
    return given / RESULT_NAME if os.path.isdir(given) else given


def read(path: Path | str) -> "dict[str, xarray.Dataset]":
    """Datasets of a result by the name of their group, ``""`` the root; see `open_result`."""
    import xarray

    file = result_file(path)
    if not os.path.isfile(file):
        hint = "give a file or the folder of a finished run"
        if os.path.isdir(file.parent / KEPT_NAME):
            hint = "the run there has not finished; if it was cut off, `timesim run --resume` goes on with it"
        raise StoreError(f"no result file at {file}; {hint}")
    try:
        groups = {}
        for name, data in xarray.open_groups(file, engine="h5netcdf").items():
            with data:
                groups[name.strip("/")] = data.load()
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise StoreError(f"{file} cannot be read as a result file (cut off or not NetCDF-4): {error}") from error
    attrs = groups[""].attrs
    missing = [name for name in REQUIRED_ATTRIBUTES if name not in attrs]
    if missing:
        raise StoreError(f"{file} is not a result of timesim: it has no attribute {', '.join(missing)}")
    wrong = [name for name in TEXTS if not isinstance(attrs[name], str)]
    if np.ndim(attrs["complete"]) or attrs["complete"] not in (0, 1):
        wrong.append("complete")
    if wrong:
        raise StoreError(f"{file} is not a result of timesim: its attribute {wrong[0]} is {shown(attrs[wrong[0]])}")
    return groups


def _content(groups: "Mapping[str, xarray.Dataset]") -> bytes:
    """The bytes of a file. They are made in memory since HDF5 reports a full disk late, and not always as an error."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    image = io.BytesIO()
    with h5netcdf.File(image, "w") as file:
        for name, data in groups.items():
            target = H5NetCDFStore(file.create_group(name) if name else file)
            data.dump_to_store(target, encoding={key: _encoding(array) for key, array in data.variables.items()})
    return image.getvalue()


def _encoding(variable: "xarray.Variable") -> dict[str, object]:
    numbers = variable.dtype.kind not in "UO"
    return {"_FillValue": None} | (_COMPRESSION if numbers and variable.nbytes > _COMPRESS_ABOVE else {})
