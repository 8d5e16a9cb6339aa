"""Files that appear whole or not at all, also when power fails."""

import os
from contextlib import suppress
from pathlib import Path
from uuid import uuid4


class StoreError(Exception):
    """A file of a run that cannot be written or read; the message names the file, the reason and what to do."""


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, flush it to the disk, and only then rename it.

    Raises:
        StoreError: the disk is full, the folder is missing or may not be written.
    """
    temporary = path.with_name(f".{path.name}.{uuid4().hex}.part")
    try:
        with open(temporary, "xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if not isinstance(error, OSError):
            raise
        kept = "; what was there is unchanged" if path.exists() else ""
        raise StoreError(f"{path} cannot be written: {error.strerror or error}{kept}") from error
