"""Finished work of a campaign, kept in the run folder: a file for each chunk, and a manifest of what they belong to.

    FOLDER/checkpoint/manifest.json        scene, version, and a fingerprint of every chunk
    FOLDER/checkpoint/NAME.npz             result of a chunk
    FOLDER/checkpoint/seconds              time that all of them took
    FOLDER/checkpoint/growing.nc           harmonic balance only: the result so far, with the curve being followed
    FOLDER/checkpoint/STAGE/…              the same for a later stage of the study

Every file appears whole or not at all. The manifest is written before the chunks and removed first, so that the folder
is consistent whenever a run is killed.
"""

import io
import json
import os
import time
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from glob import glob
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Self

import filelock
import numpy as np

from timesim.result.change import fingerprint, first_difference, scene_difference
from timesim.result.file import StoreError, write_whole
from timesim.result.label import counted
from timesim.result.netcdf import KEPT_NAME, RESULT_NAME, read

if TYPE_CHECKING:
    from xarray import Dataset

FOLDER_NAME = KEPT_NAME
MANIFEST_NAME = "manifest.json"
LOCK_NAME = ".lock"
SECONDS_NAME = "seconds"
GROWING_NAME = "growing.nc"

END = "final_modal_displacement"  # of a result that a start may be taken from
INTERRUPTED = "interrupted"  # the reason of an interrupted campaign begins with it

Result = Mapping[str, np.ndarray]
"""Result of a chunk: arrays by name."""

_OTHER_DATA = "other data, such as a file of matrices or a result that has changed"
_AGAIN = "choose another folder, or give --force to start anew"


@dataclass(frozen=True)
class Manifest:
    """What the chunks of a checkpoint belong to: the resolved scene, the fingerprint of each, and the version used."""

    identity: str
    chunks: Mapping[str, str]
    timesim: str = field(default_factory=lambda: version("timesim"))

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """The manifest in a folder; None if there is none.

        Raises:
            StoreError: it cannot be read.
        """
        path = folder / MANIFEST_NAME
        try:
            found = cls(**json.loads(path.read_text()))
            texts = [found.identity, found.timesim, *found.chunks.keys(), *found.chunks.values()]
            if not all(isinstance(text, str) for text in texts):
                raise TypeError("a value is no text")
            return found
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
            beside = counted(_count(folder), "chunk beside it belongs", "chunks beside it belong")
            lost = f"so it is not known what {beside} to, and nothing can be resumed"
            raise StoreError(f"{path} cannot be read ({error}), {lost}; {_AGAIN}") from error

    def change(self, now: "Manifest") -> str | None:
        """How it differs from another, in words; None if it does not."""
        if self.identity != now.identity:
            return f"is of another scene: {scene_difference(self.identity, now.identity)}"
        if self.timesim != now.timesim:
            return f"was begun by timesim {self.timesim}, this is {now.timesim}"
        if list(self.chunks) != list(now.chunks):
            return f"is cut into other chunks: {first_difference(list(self.chunks), list(now.chunks))}"
        other = [name for name, found in now.chunks.items() if found != self.chunks[name]]
        if other:
            return f"was begun with {_OTHER_DATA}: see chunk {other[0]}"
        return None


@dataclass(frozen=True)
class Checkpoint:
    """The finished chunks of a campaign, on disk.

    Attributes:
        lock: keeps other runs out of it.
        earlier: seconds spent on the chunks that were taken up.
        begun: when the work on the others began, by `time.monotonic`.
        writer: the thread that writes them.
    """

    folder: Path
    lock: filelock.BaseFileLock
    manifest: Manifest
    earlier: float = 0.0
    begun: float = field(default_factory=time.monotonic)
    # Only the main thread is interrupted, so a file that another thread writes is never cut off.
    writer: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "timesim-checkpoint"))

    def save(self, name: str, result: Result) -> None:
        """Keep the result of a chunk.

        Raises:
            StoreError: the disk is full, the folder is gone or may not be written, or an array holds objects.
        """
        self.writer.submit(self._write, name, result).result()

    def _write(self, name: str, result: Result) -> None:
        image = io.BytesIO()
        try:
            with zipfile.ZipFile(image, "w") as archive:
                for key, array in result.items():
                    with archive.open(f"{key}.npy", "w", force_zip64=True) as stream:
                        np.lib.format.write_array(stream, array, allow_pickle=False)
                archive.comment = self._seal(name, archive)
        except ValueError as error:
            raise StoreError(f"chunk {name}, '{key}': not an array of numbers or text: {error}") from error
        write_whole(self.folder / f"{name}.npz", image.getvalue())
        with suppress(OSError):  # only the time shown depends on it
            (self.folder / SECONDS_NAME).write_text(f"{self.earlier + time.monotonic() - self.begun:.3f}\n")

    def load(self, name: str, notice: Callable[[str], object]) -> Result | None:
        """The result of a chunk; None if it is not finished, or, with a notice, if its file is damaged."""
        path = self.folder / f"{name}.npz"
        try:
            # Read into memory first: numpy leaves open a file that it cannot read.
            image = io.BytesIO(path.read_bytes())
            with zipfile.ZipFile(image) as archive:
                if archive.comment != self._seal(name, archive):
                    raise StoreError("not as this run has written it")
            with np.load(image, allow_pickle=False) as arrays:
                return {key: arrays[key] for key in arrays.files}
        except FileNotFoundError:
            return None
        except Exception as error:  # a damaged file raises whatever zipfile and numpy make of it
            notice(f"{path} is damaged or cut off ({error}): it is computed again")
            return None

    def _seal(self, name: str, archive: zipfile.ZipFile) -> bytes:
        """Digest of the arrays of a chunk, by their checksums, and of what they belong to."""
        arrays = [(part.filename, part.file_size, part.CRC) for part in archive.infolist()]
        return fingerprint(self.manifest.identity, name, arrays).encode()

    def close(self) -> None:
        """Release the lock, so that another run may take it up."""
        self.writer.shutdown()
        self.lock.release()


def begin(run_folder: Path, manifest: Manifest, *, resume: bool, stage: str = "") -> tuple[Checkpoint, bool]:
    """The checkpoint of a campaign, or of a later stage of it, and whether it holds finished work to take up.

    Unless the run is resumed, finished work is removed.

    Raises:
        StoreError: it belongs to something else, another run is at work in it, or the folder cannot be written.
    """
    folder = run_folder / FOLDER_NAME / stage
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = locked(folder)
    except OSError as error:
        raise StoreError(f"checkpoint folder {folder} cannot be made: {error.strerror or error}") from error
    try:
        begun = _taken_up(folder, manifest, resume)
        return Checkpoint(folder, lock, manifest, _seconds(folder)), begun
    except BaseException:
        lock.release()
        raise


def locked(folder: Path) -> filelock.BaseFileLock:
    """The lock of a folder, held.

    Raises:
        StoreError: another run is at work in it.
    """
    lock = filelock.FileLock(folder / LOCK_NAME)
    try:
        lock.acquire(blocking=False)
    except filelock.Timeout:
        raise StoreError(f"another run is at work in {folder}; wait for it, or choose another folder") from None
    return lock


def _taken_up(folder: Path, manifest: Manifest, resume: bool) -> bool:
    before = Manifest.read(folder) if resume else None
    if resume:
        _refuse_orphans(folder)
    if before is None:
        _empty(folder)
        write_whole(folder / MANIFEST_NAME, json.dumps(asdict(manifest)).encode())
        return False
    if change := before.change(manifest):
        raise StoreError(f"the checkpoint in {folder} {change}; run what it was begun with, {_AGAIN}")
    return True


def _refuse_orphans(folder: Path) -> None:
    if (count := _count(folder)) and not (folder / MANIFEST_NAME).exists():
        chunks = counted(count, "chunk")
        lost = f"holds {chunks} but no {MANIFEST_NAME}, which says what chunks belong to: none can be taken up"
        raise StoreError(f"{folder} {lost}; put it back, {_AGAIN}")


def _count(folder: Path) -> int:
    return len(glob("*.npz", root_dir=folder))  # not that of a Path, which raises where a name is too long


def clear(run_folder: Path | str) -> None:
    """Remove the checkpoint of a run whose result is saved, or that is to start anew.

    Raises:
        StoreError: it cannot be removed, or another run is at work in it.
    """
    root = Path(run_folder) / FOLDER_NAME
    if not root.is_dir():
        return
    try:
        for folder in (*sorted(path.parent for path in root.glob(f"*/{LOCK_NAME}")), root):
            with locked(folder):
                _empty(folder)
                (folder / LOCK_NAME).unlink(missing_ok=True)
            if not any(folder.iterdir()):
                folder.rmdir()
    except OSError as error:
        raise StoreError(f"checkpoint folder {root} cannot be removed: {error.strerror or error}") from error


def _empty(folder: Path) -> None:
    (folder / MANIFEST_NAME).unlink(missing_ok=True)
    for pattern in ("*.npz", SECONDS_NAME, GROWING_NAME, ".*.part"):
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)


def is_finished(run_folder: Path | str, scene: str, data: str = "", *, force: bool, resume: bool) -> bool:
    """Whether a run folder, if it exists, holds the complete result of a resolved scene.

    ``data`` is the fingerprint of what the scene has read from other files. With ``force`` its contents may be
    overwritten, with ``resume`` they are to be taken up.

    Raises:
        StoreError: the folder holds an unfinished run and neither is given, another run is at work in it, or a run of
            another scene, or of other data, is to be resumed.
    """
    folder = Path(run_folder)
    if force and resume:
        raise StoreError("force starts anew and resume goes on with what is there; give one of them")
    if resume:
        return _is_whole(folder, scene, data)
    if force:
        return False
    _refuse_orphans(folder / FOLDER_NAME)
    if done := chunks_done(folder):
        with suppress(OSError):
            lock = locked(folder)  # it is not cut off where another run is at work
            (folder / LOCK_NAME).unlink()
            lock.release()
        hint = "give --resume to go on, or --force to start anew"
        raise StoreError(f"{folder} holds a run that was cut off, {counted(done, 'chunk')} done; {hint}")
    return False


def chunks_done(run_folder: Path | str) -> int:
    """Number of finished chunks of an unfinished run."""
    folder = Path(run_folder) / FOLDER_NAME
    return _count(folder) if os.path.exists(folder / MANIFEST_NAME) else 0


def seconds_worked(run_folder: Path | str, stage: str | None = None) -> float:
    """Seconds that the finished chunks of a run took, or those of one of its stages."""
    root = Path(run_folder) / FOLDER_NAME
    folders = [path.parent for path in root.rglob(SECONDS_NAME)] if stage is None else [root / stage]
    return sum(map(_seconds, folders))


def _seconds(folder: Path) -> float:
    with suppress(OSError, ValueError):
        return float((folder / SECONDS_NAME).read_text())
    return 0.0


def resuming_helps(run_folder: Path | str, reason: str) -> bool:
    """Whether a run that ended early would get further if resumed: chunks are missing, or it was interrupted later.

    Where no chunk was finished it would begin anew.
    """
    folders = [path.parent for path in (Path(run_folder) / FOLDER_NAME).rglob(MANIFEST_NAME)]
    missing = any(
        not os.path.exists(folder / f"{name}.npz")
        for folder in folders
        if (manifest := Manifest.read(folder))
        for name in manifest.chunks
    )
    return any(map(_count, folders)) and (missing or INTERRUPTED in reason)


def way_on(run_folder: Path | str, reason: str, data: "Dataset") -> str:
    """How a run that ended early is gone on with, for its message; empty where it can only be run again.

    ``data``: its result, of which one run has a state at its end and no further points.
    """
    if resuming_helps(run_folder, reason):
        return "; --resume goes on with it"
    if INTERRUPTED in reason and END in data and data[END].dims == ("mode",):
        return "; another scene goes on from there with initial: {from: ...}"
    return ""


def _is_whole(folder: Path, scene: str, data: str) -> bool:
    """Whether the result of this scene is complete, for a run that is to be resumed."""
    attrs = read(folder)[""].attrs if os.path.exists(folder / RESULT_NAME) else {}
    manifest = Manifest.read(folder / FOLDER_NAME)
    for path, begun in ((RESULT_NAME, attrs.get("scene")), (FOLDER_NAME, manifest.identity if manifest else None)):
        if begun is not None and begun != scene:
            change = scene_difference(begun, scene)
            raise StoreError(f"{folder / path} is of another scene: {change}; run what it was begun with, {_AGAIN}")
    complete = bool(attrs.get("complete"))
    if complete and attrs.get("data_fingerprint", data) != data:  # results of earlier versions do not say
        raise StoreError(f"{folder / RESULT_NAME} is of {_OTHER_DATA}; run what it was begun with, {_AGAIN}")
    return complete
