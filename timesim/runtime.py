"""JAX as this package needs it: double precision, loops compiled whole, and compiled programs that outlive the process.

Every module that uses JAX imports this one, itself or through another. ``import timesim`` alone does not: until
something runs, the process is left as it is.
"""

import hashlib
import itertools
import os
import platform
import re
import sys
import tempfile
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, fields
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, dataclass_transform

import numpy as np

from timesim.fault import warn_of_run

# XLA runs a loop over small buffers as one compiled function, and any other as a sequence of kernels, each of which
# costs more than the arithmetic in it. The event loop of one trajectory is 15 times faster as one function (measured;
# see benchmarks/README.md), but its record of steps is larger than XLA's own limit of 1 kB. Read by JAX's first use.
# What XLA's newer emitters write into one function takes LLVM a fifth longer for a balance, for transients hardly, and
# runs no faster (benchmarks/README.md). An option of this kind that a version of XLA does not know is ignored.
_LOOP_LIMIT = "xla_cpu_small_while_loop_byte_threshold"
_LOOP_FLAG = f"--xla_backend_extra_options={_LOOP_LIMIT}={2**23},xla_cpu_disable_new_fusion_emitters=true"
if _LOOP_LIMIT not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_LOOP_FLAG}".strip()
# XLA 0.10.1 takes LLVM's `prefer-no-gather` for an instruction that the processor lacks, and prints a page for each
# program that it loads from the folder. Errors reach Python as exceptions. Read when JAX is imported.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
KEEP = "TIMESIM_KEEP_PROGRAMS"
"""Set in the environment by a command, for itself and its worker processes."""
# A trajectory is one chain of small steps: on a graphics card, which JAX prefers where it finds one, each operation of
# each step waits for a launch. A process of a command is ours, so it computes on the processor unless told otherwise.
if KEEP in os.environ:
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
_STARTED_BY_OTHERS = "jax" in sys.modules

import jax  # noqa: E402

if TYPE_CHECKING:
    Leaf: TypeAlias = jax.Array
else:
    # What the host gives to a compiled function: made by numpy it costs no call of JAX.
    Leaf = jax.Array | np.ndarray

T = TypeVar("T")


@dataclass_transform(frozen_default=True, eq_default=False)
def tree_class(cls: type[T]) -> type[T]:
    """A frozen dataclass that JAX takes apart into its fields, those whose metadata say `static` aside.

    For what the host handles too: each attribute of an `equinox.Module` is looked up in Python, and to take one apart
    looks up all, which was a tenth of the time of a sweep.
    """
    own = dataclass(frozen=True, eq=False)(cls)
    parts = {part.name: bool(part.metadata.get("static")) for part in fields(own)}  # type: ignore[arg-type]
    names, static = ([name for name, aside in parts.items() if aside is kept] for kept in (False, True))
    values = attrgetter(*names, "__class__")  # of several names, so that it always gives a tuple

    def flatten(tree: Any) -> tuple[tuple, tuple]:
        return values(tree)[:-1], tuple([getattr(tree, name) for name in static])

    def unflatten(aside: tuple, leaves: Iterable) -> T:
        # Not by the constructor: JAX also puts together trees of what are no arrays.
        tree = object.__new__(own)
        tree.__dict__.update(zip(names, leaves, strict=True), **dict(zip(static, aside, strict=True)))
        return tree

    jax.tree_util.register_pytree_node(own, flatten, unflatten)
    return own


def with_parts(tree: T, **parts: Any) -> T:
    """A tree of a `tree_class` with other parts; of many at once too, which its annotations are not of."""
    assert parts.keys() <= tree.__dict__.keys()
    changed = object.__new__(type(tree))
    changed.__dict__.update(tree.__dict__, **parts)
    return changed


_SETTINGS: Any = jax.config
_IDENTITY = {"vendor_id", "cpu family", "model", "model name", "flags"}
_IDENTITY |= {"CPU implementer", "CPU architecture", "CPU variant", "CPU part", "Features"}  # so Linux on ARM
_MOST_PROBES = 10
"""Entries of the same small program from which on it is plain that no process meets those of another."""


def processor() -> str:
    """Name of this machine's processor and of the instructions that XLA may use on it, good as the name of a folder."""
    try:
        with open("/proc/cpuinfo") as cores:
            first = list(itertools.takewhile(str.strip, cores))
        described = "".join(line for line in first if line.split(":")[0].strip() in _IDENTITY)
    except OSError:
        described = platform.processor()
    limit = re.findall(r"--xla_cpu_max_isa=(\w+)", os.environ.get("XLA_FLAGS", ""))[-1:]
    return "-".join([platform.machine(), *limit, hashlib.sha256(described.encode()).hexdigest()[:12]])


def cache_folder() -> Path:
    """Folder of compiled programs: in ``TIMESIM_CACHE``, else the user's cache folder, one for each kind of processor.

    A program compiled for one processor may stop another with an illegal instruction, and JAX does not tell them apart.
    """
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("TIMESIM_CACHE") or Path(home) / "timesim") / processor()


def _check_start() -> None:
    """Warn where JAX was used before: of its precision, and of loops that are not compiled whole."""
    from jax.extend.backend import get_compile_options

    if not _SETTINGS.jax_enable_x64:
        warn_of_run(
            "JAX was imported before, with single precision: timesim switches the whole process to double precision. "
            "Call jax.config.update('jax_enable_x64', True) yourself to be rid of this warning."
        )
    if _LOOP_LIMIT.encode() not in get_compile_options(num_replicas=1, num_partitions=1).SerializeAsString():
        warn_of_run(
            "JAX was used before timesim could set an option of XLA: a single trajectory takes up to 15 times longer. "
            f"Start Python with XLA_FLAGS={_LOOP_FLAG}, or import timesim.runtime before JAX is used."
        )


def _check_platform() -> None:
    """Warn where JAX prefers a graphics card, and nobody said that it should."""
    if jax.default_backend() != "cpu" and not _SETTINGS.jax_platforms:
        warn_of_run(
            f"JAX computes on '{jax.default_backend()}': the steps of a trajectory follow each other, and each would "
            "wait for the card. Start Python with JAX_PLATFORMS=cpu, or name the card there to be rid of this warning."
        )


def _keep_programs() -> Path | None:
    """Keep compiled programs in the folder; warn where they do not stay, or are never met again.

    Returns where `timesim.program` is to keep them, which it does for commands; None where JAX does it.
    """
    if _SETTINGS.jax_compilation_cache_dir or not _SETTINGS.jax_enable_compilation_cache:
        return None  # set by the host
    folder = cache_folder()
    ours = KEEP in os.environ and jax.default_backend() == "cpu"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason: str | None = str(error)
    else:
        reason = None if ours else _kept_by_jax(folder)
    if reason:
        warn_of_run(
            f"compiled programs are not kept in {folder}: {reason}. Each run compiles its own, which takes minutes; "
            "name another folder by TIMESIM_CACHE, or empty this one."
        )
    return folder / "ready" if ours and not reason else None


def _kept_by_jax(folder: Path) -> str | None:
    """Have JAX keep programs; why that is of no use, or None."""
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    # A bounded cache is the one that JAX guards with a file lock, so two runs may share it.
    jax.config.update("jax_compilation_cache_max_size", 2 * 1024**3)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    reason = _lost(folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    return reason


def _lost(folder: Path) -> str | None:
    """Why the folder is of no use, tried by a small program; None where it is kept, or was."""
    hits: list[str] = []
    jax.monitoring.register_event_listener(lambda event, **_: hits.append(event) if "cache_hits" in event else None)
    name = f"probe_{jax.__version__.replace('.', '_')}"

    def probe(x: float) -> float:
        return x + 1

    probe.__name__ = name
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        jax.jit(probe)(1.0)
    entries = len(list(folder.glob(f"*{name}*-cache")))
    if hits or 0 < entries < _MOST_PROBES:
        return None
    return "; ".join(str(item.message) for item in said) or f"{entries} entries of one program, none of them met again"


if _STARTED_BY_OTHERS:
    _check_start()
jax.config.update("jax_enable_x64", True)
_check_platform()
READY = _keep_programs()
"""Folder of programs that are ready to run; None where `timesim.program` keeps none."""
