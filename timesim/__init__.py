"""Event-driven time integration of structures with frictional contacts."""

from timesim.config import Scene, SceneError, load_scene
from timesim.store import open_result
from timesim.study import run

__all__ = ["Scene", "SceneError", "load_scene", "open_result", "run"]
