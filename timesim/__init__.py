"""Event-driven time integration of structures with frictional contacts."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from timesim.fault import SceneError
    from timesim.result.netcdf import open_result
    from timesim.scene.resolution import Scene
    from timesim.study.registry import load_scene, run

__all__ = ["Scene", "SceneError", "load_scene", "open_result", "run"]

_MODULES = {
    "Scene": "timesim.scene.resolution",
    "SceneError": "timesim.fault",
    "load_scene": "timesim.study.registry",
    "open_result": "timesim.result.netcdf",
    "run": "timesim.study.registry",
}


def __getattr__(name: str) -> Any:
    """Load what is asked for, and only that: the command line and workers need not pay for the rest."""
    if name not in _MODULES:
        raise AttributeError(f"module 'timesim' has no attribute {name!r}")
    globals()[name] = getattr(import_module(_MODULES[name]), name)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
