"""What each ``study.kind`` runs. Loads the modules of a study only when it runs: checking a scene needs none of them.

To add a study: its section in `timesim.study_section`, a module with a function ``study(scene, progress)`` named here,
and its pictures in `timesim.plot`.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from timesim.config import Scene, load_scene
from timesim.store import Record

if TYPE_CHECKING:
    import xarray

MODULES = {
    "transient": "timesim.transient",
    "element": "timesim.element",
    "element_map": "timesim.element_map",
}

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Outcome:
    """What a study has computed.

    Attributes:
        groups: the records of the result file by group, ``""`` the root.
        reason: why the run ended early; None if it is complete.
        summary: what a user wants to know at once, a line each.
    """

    groups: Mapping[str, Record]
    reason: str | None
    summary: tuple[str, ...] = ()


def carry_out(scene: Scene, progress: Progress | None = None) -> Outcome:
    """Run the study of a scene.

    Args:
        scene: the scene.
        progress: called with the units of work done and their number.
    """
    outcome: Outcome = import_module(MODULES[scene.file.study.kind]).study(scene, progress)
    return outcome


def run(scene: Scene | str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | None = None) -> "xarray.Dataset":
    """Run a scene and return its result, as ``timesim run`` writes it.

    Args:
        scene: a scene, or what `timesim.load_scene` takes: a path, a mapping or the text of one.
        overrides: new values by key path.

    Returns:
        The result; ``complete`` is 0 in its attributes if the run ended early, with the reason as a warning.

    Raises:
        SceneError: the scene is wrong.
    """
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    outcome = carry_out(loaded.with_overrides(overrides) if overrides else loaded)
    if outcome.reason is not None:
        warnings.warn(f"the run is incomplete: {outcome.reason}", RuntimeWarning, stacklevel=2)
    return outcome.groups[""].dataset()


def attributes(scene: Scene, method: str, compiling: float, running: float, reason: str | None) -> dict[str, Any]:
    """Attributes of every result file; ``reason``: why the run ended early, None if it is complete."""
    from importlib.metadata import version

    told = {
        "timesim_version": version("timesim"),
        "scene": scene.resolved_yaml(),
        "title": scene.file.title,
        "study": scene.file.study.kind,
        "complete": int(reason is None),
        "method": method,
        "compile_seconds": compiling,
        "run_seconds": running,
    }
    return told if reason is None else told | {"reason": reason}
