"""Event-driven time integration of structures with frictional contacts."""

from timesim.fault import SceneError
from timesim.result.netcdf import open_result
from timesim.scene.resolution import Scene
from timesim.study.registry import load_scene, run

__all__ = ["Scene", "SceneError", "load_scene", "open_result", "run"]
