"""What a study has computed, and the attributes of every result file."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from timesim.scene.resolution import Scene

if TYPE_CHECKING:
    from xarray import Dataset

FELT = 0.5  # seconds
DOUBT = "warning: "
"""Begins a line of a summary that says that numbers of the result may be wrong; from Python it is a warning."""


@dataclass(frozen=True)
class Outcome:
    """What a study has computed.

    Attributes:
        groups: the Datasets of the result file by group, ``""`` the root.
        reason: why the run ended early; None if it is complete.
        summary: the lines that the command prints.
    """

    groups: "Mapping[str, Dataset]"
    reason: str | None
    summary: tuple[str, ...] = ()


def unit_names(scene: Scene) -> dict[str, str]:
    """Attributes of a Dataset that name the scene's own units, by which `timesim.result.dataset.dataset` labels it."""
    return {f"{quantity}_unit": name for quantity, name in scene.file.unit_names().items()}


def took(attrs: Mapping[Any, Any]) -> str:
    """The time of a run in words, apart from that of compilation where it can be felt."""
    compiling, running = attrs["compile_seconds"], f"in {attrs['run_seconds']:.2f} s"
    return f"{running}, after {compiling:.1f} s of compilation" if compiling > FELT else running


def attributes(
    scene: Scene, method: str, compiling: float, running: float, reason: str | None, *, integrated: bool = True
) -> dict[str, Any]:
    """Attributes of every result file.

    ``reason``: why the run ended early, None if it is complete; ``integrated``: whether it is one of time integration,
    whose tolerances and promise are none of harmonic balance.
    """
    attrs = {
        "timesim_version": version("timesim"),
        "scene": scene.resolved_yaml(),
        "data_fingerprint": scene.data_fingerprint,
        "title": scene.file.title,
        **unit_names(scene),
        "study": scene.kind,
        "complete": int(reason is None),
        "method": method,
        "compile_seconds": compiling,
        "run_seconds": running,
    }
    if integrated and scene.choice is not None:
        solver = scene.solver()
        attrs["promised_error"] = scene.promise
        attrs |= {"rtol": solver.rtol, "atol": solver.atol} if solver.has_tolerance else {}
        attrs["method_choice"] = f"{solver.name}: {scene.choice.why}"
    return attrs if reason is None else attrs | {"reason": reason}
