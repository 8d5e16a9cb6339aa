"""What every test runs with: double precision, and arrays whose shapes and types are checked where they are named."""

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
