"""JAX as this package needs it: double precision and a compilation cache that outlives the process.

Import this before anything else that imports JAX.
"""

import os
import tempfile
from pathlib import Path

import jax


def cache_folder() -> Path | None:
    """Folder of compiled programs: ``TIMESIM_CACHE``, else the user's cache folder; None if it cannot be written."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(os.environ.get("TIMESIM_CACHE") or Path(home) / "timesim")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


jax.config.update("jax_enable_x64", True)
if (_folder := cache_folder()) is not None:
    jax.config.update("jax_compilation_cache_dir", str(_folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    # A bounded cache is the one that JAX guards with a file lock, so two runs may share it.
    jax.config.update("jax_compilation_cache_max_size", 2 * 1024**3)
