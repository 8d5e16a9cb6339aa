"""The folder of a run: the resolved scene, the result, the pictures, and a lock while a run is at work in it."""

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from timesim.result import checkpoint
from timesim.result.file import StoreError, write_whole
from timesim.result.netcdf import RESULT_NAME

SCENE_NAME = "scene.yaml"
SHOW_NAME = "show"
"""Folder below that of a run, for the points of its sweep that are shown."""

LISTED = 3  # other files that a message names


def check_folder(folder: Path | str, *, overwrite: bool = False) -> None:
    """Refuse a run folder that holds a result or other files, or that cannot be a folder; changes nothing on disk.

    Raises:
        StoreError: with the reason and what to do.
    """
    path = Path(folder)
    # Of os.path, as those of pathlib raise where a folder may not be searched or a name is too long.
    if os.path.exists(path / RESULT_NAME) and not overwrite:
        raise StoreError(f"{path / RESULT_NAME} exists; choose another folder or give --force to overwrite it")
    part = next(part for part in (path, *path.absolute().parents) if os.path.exists(part))
    if not part.is_dir():
        raise StoreError(f"{path} cannot be a run folder: {part} is a file; choose another folder")
    if not os.access(part, os.W_OK | os.X_OK):
        read_only = os.statvfs(part).f_flag & os.ST_RDONLY
        why = f"the file system of {part} is read-only" if read_only else f"no permission in {part}"
        raise StoreError(f"{path} cannot be written: {why}; choose another folder")
    run = (path / RESULT_NAME, path / checkpoint.FOLDER_NAME / checkpoint.MANIFEST_NAME)
    if part == path and not any(file.exists() for file in run):
        _refuse_other_files(path)


def check_point_folder(folder: Path | str, result: Path, *, overwrite: bool = False) -> None:
    """The same for a point of a sweep, with the result file of the sweep: it takes the place of no run.

    Raises:
        StoreError: with the reason and what to do.
    """
    path, own = Path(folder), result.absolute().parent
    if os.path.exists(path / SCENE_NAME) or (os.path.isdir(path) and os.path.isdir(own) and path.samefile(own)):
        raise StoreError(f"{path} is the folder of a run; choose another for a point of its sweep")
    check_folder(path, overwrite=overwrite)


def made_folder(folder: Path) -> Path:
    """The folder, created if missing.

    Raises:
        StoreError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"folder {folder} cannot be made ({error.strerror or error}): give another one") from None
    return folder


def _refuse_other_files(path: Path) -> None:
    own = {SCENE_NAME, checkpoint.LOCK_NAME, checkpoint.FOLDER_NAME}
    others = sorted(item.name for item in path.iterdir() if item.name not in own and item.suffix != ".part")
    if others:
        named = ", ".join(others[:LISTED]) + (", ..." if len(others) > LISTED else "")
        raise StoreError(f"{path} holds other files ({named}) and no run; choose a new or an empty folder")


@contextmanager
def locked_folder(folder: Path | str) -> Iterator[Path]:
    """The folder of a run, created if missing and locked against other runs.

    Raises:
        StoreError: another run is at work in it, or it cannot be made.
    """
    path, new = Path(folder), not os.path.exists(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = checkpoint.locked(path)
    except OSError as error:
        raise StoreError(f"run folder {path} cannot be made: {error.strerror or error}") from error
    try:
        yield path
    finally:
        with suppress(OSError):
            (path / checkpoint.LOCK_NAME).unlink()
        lock.release()
        if new:
            with suppress(OSError):  # it is not empty
                path.rmdir()


def prepare_folder(
    folder: Path, scene: str, *, overwrite: bool = False, source: Path | None = None, stale: Iterable[str] = ()
) -> None:
    """Write the resolved scene, which has passed its checks, into the folder of a run.

    Args:
        overwrite: the folder may hold another run, whose checkpoint and pictures are removed; its result stays until
            the new one replaces it.
        source: file that the scene was read from; never overwritten by another text.
        stale: names of the pictures to remove.

    Raises:
        StoreError: the scene would overwrite another one, or the folder cannot be written.
    """
    target = folder / SCENE_NAME
    _check_scene_file(target, scene, overwrite, source)
    if overwrite:
        checkpoint.clear(folder)
        _remove(folder, stale)
    write_whole(target, scene.encode())


def prepare_point_folder(folder: Path, *, stale: Iterable[str]) -> None:
    """Make the folder of a point of a sweep, or remove pictures of an earlier one, of these names, from it.

    Raises:
        StoreError: the folder cannot be made or written.
    """
    _remove(made_folder(folder), stale)


def _remove(folder: Path, pictures: Iterable[str]) -> None:
    """Remove pictures, and the points of its sweep that were shown, from a folder."""
    try:
        for name in pictures:
            (folder / name).unlink(missing_ok=True)
        _remove_shown(folder / SHOW_NAME)
    except OSError as error:
        raise StoreError(f"pictures in {folder} cannot be removed: {error.strerror or error}") from error


def _remove_shown(folder: Path) -> None:
    """Remove the points of a sweep that were shown, and no other files in their folder."""
    for point in folder.iterdir() if folder.is_dir() else ():
        if (point / RESULT_NAME).exists():
            shutil.rmtree(point)
    with suppress(OSError):  # there is none, or it holds something else
        folder.rmdir()


def _check_scene_file(target: Path, scene: str, overwrite: bool, source: Path | None) -> None:
    if not target.exists() or target.read_bytes() == scene.encode():
        return
    if source is not None and source.exists() and target.samefile(source):
        raise StoreError(f"the run would overwrite its own scene file {target}; choose another folder")
    if not overwrite:
        raise StoreError(f"{target} exists and is another scene; choose another folder or give --force")
