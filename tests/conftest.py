"""What every test runs with: double precision, and arrays whose shapes and types are checked where they are named."""

import signal
from collections.abc import Iterator

import pytest
from jaxtyping import install_import_hook

# The modules of the event loop; they are loaded here, before anything else loads them unchecked.
CHECKED = (
    "timesim.engine.contact_law",
    "timesim.engine.contact",
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
    import timesim.engine.trajectory  # noqa: F401


@pytest.fixture(autouse=True)
def _interrupts() -> Iterator[None]:
    """Ctrl-C interrupts, also where a shell has started the tests in its background and lets it be ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
