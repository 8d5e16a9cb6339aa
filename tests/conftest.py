"""What every test runs with: double precision, and arrays whose shapes and types are checked where they are named."""

from jaxtyping import install_import_hook

# The modules of the event loop; they are loaded here, before anything else loads them unchecked.
CHECKED = (
    "timesim.contact",
    "timesim.guard",
    "timesim.hermite",
    "timesim.history",
    "timesim.integrate",
    "timesim.method",
    "timesim.solver",
    "timesim.system",
    "timesim.trajectory",
)

with install_import_hook(list(CHECKED), "beartype.beartype"):
    import timesim.jax_setup  # isort: skip
    import timesim.trajectory  # noqa: F401
