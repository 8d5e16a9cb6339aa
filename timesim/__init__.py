"""Event-driven time integration of structures with frictional contacts."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from timesim.fault import SceneError, SceneWarning
    from timesim.notebook import (
        contact,
        follow,
        integrate,
        matrices,
        modal_forces,
        modes,
        plot,
        point_force,
        settle,
        show,
        sweep,
        system,
    )
    from timesim.result.file import StoreError
    from timesim.result.netcdf import open_result
    from timesim.result.netcdf import open_result as open
    from timesim.scene.resolution import Scene
    from timesim.study.execution.worker import ExecutionError
    from timesim.study.registry import load_scene, run

__all__ = [
    "ExecutionError",
    "Scene",
    "SceneError",
    "SceneWarning",
    "StoreError",
    "contact",
    "follow",
    "integrate",
    "load_scene",
    "matrices",
    "modal_forces",
    "modes",
    "open",
    "open_result",
    "plot",
    "point_force",
    "run",
    "settle",
    "show",
    "sweep",
    "system",
]

_MODULES = {
    "ExecutionError": "timesim.study.execution.worker",
    "Scene": "timesim.scene.resolution",
    "SceneError": "timesim.fault",
    "SceneWarning": "timesim.fault",
    "StoreError": "timesim.result.file",
    "load_scene": "timesim.study.registry",
    "open_result": "timesim.result.netcdf",
    "run": "timesim.study.registry",
}
"""The module that defines each name; all others come from `timesim.notebook`."""


def __getattr__(name: str) -> Any:
    """Import a name when it is first used, so that the command line and workers do not pay for the rest."""
    if name == "__version__":
        return import_module("importlib.metadata").version("timesim")
    if name not in __all__:
        raise AttributeError(f"module 'timesim' has no attribute {name!r}")
    source = "open_result" if name == "open" else name
    value = getattr(import_module(_MODULES.get(source, "timesim.notebook")), source)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
