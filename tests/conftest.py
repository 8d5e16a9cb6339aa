"""What every test runs with: double precision, and arrays whose shapes and types are checked where they are named."""

import contextlib
import ctypes
import gc
import os
import signal
from collections.abc import Iterator

import pytest
from jaxtyping import install_import_hook

# The modules of the event loop; they are loaded here, before anything else loads them unchecked.
CHECKED = (
    "timesim.engine.law.contact_law",
    "timesim.engine.law.cone",
    "timesim.engine.guard",
    "timesim.engine.dense_output",
    "timesim.engine.history",
    "timesim.engine.event_loop",
    "timesim.engine.step",
    "timesim.engine.method",
    "timesim.engine.solver",
    "timesim.engine.system",
    "timesim.engine.trajectory",
)

with install_import_hook(list(CHECKED), "beartype.beartype"):
    import timesim.runtime  # isort: skip
    import timesim.engine.trajectory

import jax  # noqa: E402
import scipy.linalg  # noqa: E402, F401
from threadpoolctl import threadpool_limits  # noqa: E402

from timesim.program import LOADED  # noqa: E402

THREADS = threadpool_limits(1, "blas")
"""Of products of matrices, as in a study: workers have a core each."""
LARGE = 1.0e9
"""Resident bytes of a worker above which compiled programs are let go, also those that the next module asks for."""


def resident() -> int:
    """Bytes of memory that this process holds; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as numbers:
            return int(numbers.read().split()[1]) * 4096
    except OSError:
        return 0


def give_back() -> None:
    """Let the C library return what is free: after a compilation it keeps most (1.9 GB in use fell to 0.5)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


@pytest.fixture(scope="session", autouse=True)
def _programs(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Programs are kept as the commands keep them: a worker takes those of the other, and its own again, untraced.

    Only in this run, since what the tests add to the package, a contact law for one, is no part of a program's name.
    """
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    timesim.runtime.READY = shared / "programs"


@pytest.fixture(scope="module", autouse=True)
def _memory_after_a_module() -> Iterator[None]:
    yield
    give_back()


@pytest.fixture(autouse=True)
def _memory_after_a_test() -> Iterator[None]:
    yield
    if resident() > LARGE:
        give_back()
    if resident() > LARGE:
        jax.clear_caches()
        for programs in LOADED:
            programs.clear()
        gc.collect()
        give_back()


@pytest.fixture(autouse=True)
def _interrupts() -> Iterator[None]:
    """Ctrl-C interrupts, also where a shell has started the tests in its background and lets it be ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
