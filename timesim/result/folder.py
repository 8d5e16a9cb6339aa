"""The folder of a run: the resolved scene, the result and the pictures."""

import os
from collections.abc import Iterable
from pathlib import Path

from timesim.result.file import StoreError, write_whole
from timesim.result.netcdf import RESULT_NAME

SCENE_NAME = "scene.yaml"


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


def _check_scene_file(target: Path, scene: str, force: bool, source: Path | str | None) -> None:
    if not target.exists() or target.read_bytes() == scene.encode():
        return
    if source is not None and Path(source).exists() and target.samefile(source):
        raise StoreError(f"the run would overwrite its own scene file {target}; choose another folder")
    if not force:
        raise StoreError(f"{target} exists and is another scene; choose another folder or give --force")
