"""The table of all kinds of study, and the functions that load a scene and carry out its study.

To add a study, write a module with

- its section of the scene file, a `timesim.scene.study.StudySection` with a `kind` and a `plan`;
- ``study(scene, execution) -> Outcome``, which carries out `scene.plan` and returns Datasets made by
  `timesim.result.dataset.dataset`, giving a ``long_name`` to each variable that the package does not know;
- if it has pictures, a mapping from the name of a file to a function that draws a figure of the result;

and name them in a line of `STUDIES`. Reading and checking a scene loads all sections, so where all of this is in one
module, JAX and Matplotlib are imported inside functions.
"""

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from timesim.fault import warn
from timesim.result.netcdf import joined
from timesim.scene import file, resolution
from timesim.scene.report import warnings_of
from timesim.scene.resolution import Scene
from timesim.scene.study import StudySection
from timesim.study.execution.campaign import Execution, ExecutionError
from timesim.study.execution.interrupts import Interrupts
from timesim.study.execution.progress import Standing
from timesim.study.execution.worker import one_thread
from timesim.study.outcome import DOUBT, Outcome

if TYPE_CHECKING:
    import xarray

LOGGER = logging.getLogger("timesim")
SECONDS_A_LINE = 10.0  # of how far a run from Python is


@dataclass(frozen=True)
class Study:
    """References to the parts of a kind of study, as ``module:name``; a module is loaded when it is first needed.

    A leading dot stands for ``timesim``.

    Attributes:
        section: the class of its section of the scene file.
        run: the function ``(scene, execution) -> Outcome``.
        pictures: the mapping from the name of a file to a function that draws it; empty if there is none.
        in_chunks: whether it works in chunks of points, so that it can be resumed and spread over processes.
        in_curves: whether it keeps its finished curves, so that it can be resumed.
    """

    section: str
    run: str
    pictures: str = ""
    in_chunks: bool = False
    in_curves: bool = False


STUDIES = {
    "transient": Study(".scene.transient:Transient", ".study.transient:study", ".picture.transient:PICTURES"),
    "jump": Study(".scene.transient:Jump", ".study.transient:study", ".picture.jump:PICTURES"),
    "tradeoff": Study(".scene.transient:Tradeoff", ".study.tradeoff.study:study", ".picture.tradeoff:PICTURES"),
    "element": Study(".scene.element:Element", ".study.element:study", ".picture.element:PICTURES"),
    "element_map": Study(".scene.element:ElementMap", ".study.element_map:study", ".picture.element:MAP_PICTURES"),
    "sweep": Study(".scene.sweep:Sweep", ".study.sweep:study", ".picture.sweep:PICTURES", in_chunks=True),
    "hbm": Study(".scene.hbm:Hbm", ".study.hbm:study", ".picture.hbm:PICTURES", in_curves=True),
    "compare": Study(".scene.hbm:Compare", ".study.compare:study", ".picture.compare:PICTURES", in_chunks=True),
    "bistable": Study(".scene.sweep:Bistable", ".study.bistable:study", ".picture.bistable:PICTURES", in_chunks=True),
    "optimum": Study(".scene.sweep:Optimum", ".study.optimum.study:study", ".picture.optimum:PICTURES", in_chunks=True),
}


@cache
def _loaded(reference: str) -> Any:
    """The object at ``module:name``; a module with a leading dot is one of this package."""
    module, _, name = reference.partition(":")
    return getattr(import_module(module, "timesim"), name)


def sections() -> dict[str, type[StudySection]]:
    """The section of each kind of study."""
    return {kind: _loaded(study.section) for kind, study in STUDIES.items()}


def load_scene(source: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | Sequence[str] = ()) -> Scene:
    """Read, check and build a scene.

    Args:
        source: path of a scene file, the text of one (of several lines), or the same as a mapping.
        overrides: new values by key path, ``{"contacts.pad.preload": 5}`` or ``["contacts.pad.preload=5"]``;
            items of a list go by their name or by their index from 0.

    Raises:
        SceneError: all that is wrong with the scene, each with file, line, key path, value and rule.
    """
    return resolution.load_scene(source, overrides, kinds=sections())


def json_schema() -> dict[str, Any]:
    """JSON Schema of the scene file, for editors."""
    return file.json_schema(sections())


def draw(
    data: "xarray.Dataset | xarray.DataTree", folder: Path | str, *, kind: str = "png", log: Collection[str] = ()
) -> list[Path]:
    """Write the pictures of a result into an existing folder; see `timesim.picture.draw.write`."""
    from timesim.picture.draw import write

    return write(data, folder, _pictures(data.attrs["study"]), kind=kind, log=log)


def picture_names(kind: str, files: Sequence[str] = ("png",)) -> list[str]:
    """Names of the picture files that `draw` may write for a kind of study, in some formats."""
    return [f"{name}.{file}" for file in files for name in _pictures(kind)]


def _pictures(kind: str) -> Mapping[str, Callable[..., Any]]:
    """The pictures of a kind of study by the name of their file; none of an unknown kind."""
    study = STUDIES.get(kind)
    return _loaded(study.pictures) if study and study.pictures else {}


def carry_out(scene: Scene, execution: Execution | None = None) -> Outcome:
    """Run the study of a scene, by default on threads of this machine and without checkpoints.

    Raises:
        ExecutionError: the study cannot be carried out in this way.
        StoreError: a checkpoint cannot be begun, or belongs to another scene.
    """
    execution = execution or Execution()
    check_execution(scene.kind, execution)
    with Interrupts() as interrupts:  # raised while jaxlib is imported, an interrupt is a segmentation fault
        study = _loaded(STUDIES[scene.kind].run)
    if interrupts.seen:
        raise KeyboardInterrupt
    with one_thread():
        return study(scene, execution)


def check_execution(kind: str, execution: Execution) -> None:
    """Refuse options of the execution that a kind of study cannot use.

    Raises:
        ExecutionError: naming the options.
    """
    resume = execution.resume and not STUDIES[kind].in_curves
    given = {"resume": resume, "cluster": execution.cluster, "workers": execution.workers}
    useless = [name for name, value in given.items() if value]
    if not STUDIES[kind].in_chunks and useless:
        resumed = useless == ["resume"]
        able = ", ".join(name for name, own in STUDIES.items() if own.in_chunks or (resumed and own.in_curves))
        rule = f"a study of kind {kind} is done in one go, not in chunks of points"
        raise ExecutionError(f"{' and '.join(useless)}: {rule}; leave it out ({able} can use it)")


def run(
    scene: Scene | str | Path | Mapping[str, Any],
    overrides: Mapping[str, Any] | None = None,
    *,
    cluster: str | None = None,
    workers: int | None = None,
) -> Any:
    """Run a scene and return its result, as ``timesim run`` writes it.

    Args:
        scene: a scene, or what `timesim.load_scene` takes: a path, a mapping or the text of one.
        overrides: new values by key path.
        cluster: address of the dask scheduler on which a study in chunks of points runs, or "local" for processes of
            this machine (a script that uses it must guard its start by ``if __name__ == "__main__":``).
        workers: threads, or processes of a local cluster; the processors of this machine by default.

    Returns:
        The result: an xarray Dataset, or a DataTree of a study with groups (`compare`, `bistable`). ``complete`` is 0
        in its attributes if the run ended early, with the reason as a warning. What ``timesim check`` warns of is a
        `SceneWarning`, and so is what ``timesim run`` warns of at its end, such as points that did not settle.

    Raises:
        SceneError: the scene is wrong.
        ExecutionError: the study cannot be carried out in this way.

    How far it is, and at its end what ``timesim run`` prints, go to the logger "timesim" as information:
    ``logging.basicConfig(level="INFO")`` shows them.
    """
    if not isinstance(scene, Scene):
        scene = load_scene(scene, () if overrides is None else overrides)
    elif overrides is not None:
        scene = scene.with_overrides(overrides)
    for text in warnings_of(scene):
        warn(text)
    standing = Standing(scene.file.study.counts)
    with standing.told(SECONDS_A_LINE, LOGGER.info):
        outcome = carry_out(scene, Execution(cluster=cluster, workers=workers, progress=standing))
    for line in outcome.summary:
        LOGGER.info(line)
        if line.startswith(DOUBT):
            warn(line.removeprefix(DOUBT))
    if outcome.reason is not None:
        warn(f"the run is incomplete: {outcome.reason}", RuntimeWarning)
    return joined(outcome.groups)
