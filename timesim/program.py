"""Compiled programs: functions of arrays that are traced and compiled once for the shapes and types of their arguments.

JAX can keep what XLA has compiled, but finds it by the traced program: each process imports what tracing takes, traces
and lowers, for longer than the rest of a short run lasts. What a command compiles is therefore kept ready to run, under
two names: one of the lowered program, and one, a link, of all that this depends on: the function, the structure, static
parts, shapes and types of its arguments, the sources of this package, the versions of what it is built on, and the
settings of JAX and XLA in the environment. If anything is wrong with what is kept, the program is compiled. Only
commands do so: in a notebook a function or a constant may be another than the sources say.
"""

from timesim import runtime  # isort: skip

import hashlib
import os
import pickle
import sys
import threading
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from importlib.metadata import version
from itertools import compress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np
from jax.experimental.serialize_executable import deserialize_and_load, serialize

P = ParamSpec("P")
T = TypeVar("T")

MOST_BYTES = 2**28
"""Of all that is kept; what was used last stays."""
_BUILT_ON = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")
LOADED: list[dict[tuple, Any]] = []
"""Of each function, the programs that are ready in this process."""
_ARRAYS = (np.ndarray, jax.Array, np.generic)


class _Hits(threading.local):
    """How many programs this thread has met in the cache of JAX itself."""

    number = 0


_HITS = _Hits()


def _count(event: str, **_: Any) -> None:
    _HITS.number += event.endswith("/cache_hits")


jax.monitoring.register_event_listener(_count)


def program(function: Callable[P, T]) -> Callable[P, T]:
    """The function, compiled: its arguments may be any trees; leaves that are no arrays are static."""

    def flat(form: tuple, *arrays: jax.Array) -> T:
        (tree, static), left = form, iter(arrays)
        args, kwargs = jax.tree.unflatten(tree, [next(left) if leaf is None else leaf for leaf in static])
        return function(*args, **kwargs)

    flat.__name__ = flat.__qualname__ = function.__name__  # the name of the program
    ready: dict[tuple, Any] = {}
    LOADED.append(ready)
    traced = jax.jit(flat, static_argnums=0, keep_unused=True)  # so that the lowered program names all of them
    locks: dict[tuple, threading.Lock] = {}

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        leaves, tree = jax.tree.flatten((args, kwargs))
        kept = [isinstance(leaf, _ARRAYS) for leaf in leaves]
        arrays = list(compress(leaves, kept))
        form = tree, tuple(None if own else leaf for leaf, own in zip(leaves, kept, strict=True))
        if runtime.READY is None or any(isinstance(leaf, jax.core.Tracer) for leaf in arrays):
            return traced(form, *arrays)
        key = form, tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in arrays)
        if (run := ready.get(key)) is None:
            with locks.setdefault(key, threading.Lock()):
                if (run := ready.get(key)) is None:
                    base = runtime.READY / f"{function.__module__}.{function.__name__}"
                    run = ready[key] = _ready(base, key, traced, arrays)
        try:
            return jax.block_until_ready(run(*arrays))
        except jax.errors.JaxRuntimeError:  # it was kept, and is not whole
            ready[key] = traced.lower(form, *arrays).compile()
            return ready[key](*arrays)

    return call


def _ready(base: Path, key: tuple, traced: Any, arrays: list) -> Any:
    """The program for arguments like these: as it is kept, else compiled and kept."""
    asked = _named(base, f"{_sources()} {key}")
    if (loaded := _loaded(asked, arrays)) is not None:
        return loaded
    lowered = traced.lower(key[0], *arrays)
    own = _named(base, f"{lowered.as_text()} {lowered.out_tree} {key[1]}")
    if (loaded := _loaded(own, arrays)) is None:
        hits, loaded = _HITS.number, lowered.compile()
        if _HITS.number > hits:
            return loaded  # from JAX's own cache: XLA would write it without some of its kernels
        with suppress(Exception):
            _keep(own, loaded)
    if " at 0x" not in str(key):  # a function, known by its place in the memory of this process
        with suppress(OSError):
            asked.unlink(missing_ok=True)
            asked.symlink_to(own.name)
    return loaded


def _named(base: Path, text: str) -> Path:
    described = f"{sys.version} {_settings()} {text}"
    return base.with_name(f"{base.name}-{hashlib.sha256(described.encode()).hexdigest()}")


def _loaded(path: Path, arrays: list) -> Any:
    """The program that is kept there; None where there is none, or none that is sound."""
    with suppress(Exception):
        binary, result = pickle.loads(zlib.decompress(path.read_bytes()))
        loaded = deserialize_and_load(binary, jax.tree.structure((tuple(arrays), {})), jax.tree.structure(result))
        with suppress(OSError):
            os.utime(path)
        return loaded
    return None


def _keep(path: Path, compiled: Any) -> None:
    """Keep a program, and let those go that were not used for the longest time."""
    binary, _, tree = serialize(compiled)
    path.parent.mkdir(exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}")
    part.write_bytes(zlib.compress(pickle.dumps((binary, jax.tree.unflatten(tree, range(tree.num_leaves)))), 1))
    part.replace(path)
    total = 0
    for entry in sorted(path.parent.iterdir(), key=lambda entry: -entry.lstat().st_mtime):
        total += entry.lstat().st_size
        if total > MOST_BYTES:
            entry.unlink(missing_ok=True)


@cache
def _sources() -> str:
    """Digest of the sources of the package."""
    whole = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        whole.update(source.read_bytes())
    return whole.hexdigest()


@cache
def _settings() -> str:
    """Versions, and what JAX and XLA are told by the environment."""
    told = sorted(item for item in os.environ.items() if item[0].startswith(("JAX_", "XLA_")))
    return f"{[version(name) for name in _BUILT_ON]} {told}"
