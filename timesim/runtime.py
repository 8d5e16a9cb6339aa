"""JAX as this package needs it: double precision and a compilation cache that outlives the process.

Import this before anything else that imports JAX.
"""

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

# XLA runs a loop over small buffers as one compiled function, and any other as a sequence of kernels, each of which
# costs more than the arithmetic in it. The event loop of one trajectory is 15 times faster as one function (measured;
# see benchmarks/README.md), but its record of steps is larger than XLA's own limit of 1 kB. Read when JAX starts.
_LOOP_LIMIT = "xla_cpu_small_while_loop_byte_threshold"
if _LOOP_LIMIT not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_extra_options={_LOOP_LIMIT}={2**23}".strip()
    )

import jax  # noqa: E402

if TYPE_CHECKING:
    Leaf: TypeAlias = jax.Array
else:
    # What the host gives to a compiled function: made by numpy it costs no call of JAX.
    Leaf = jax.Array | np.ndarray


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
