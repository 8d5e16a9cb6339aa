"""What each ``study.kind`` runs. Loads the modules of a study only when it runs: checking a scene needs none of them.

To add a study: its section in `timesim.scene.studies`, a module with a function ``study(scene, progress)`` named here
in `MODULES`, or one ``study(scene, means)`` in `CAMPAIGNS` if it works in chunks, and its pictures in `picture.draw`.
"""

import warnings
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from timesim.result.netcdf import joined
from timesim.scene.resolution import Scene, load_scene
from timesim.study.campaign import Means, MeansError
from timesim.study.outcome import Outcome

MODULES = {
    "transient": "timesim.study.transient",
    "jump": "timesim.study.transient",
    "element": "timesim.study.element",
    "element_map": "timesim.study.element_map",
    "hbm": "timesim.study.hbm",
}

CAMPAIGNS = {
    "sweep": "timesim.study.sweep",
    "compare": "timesim.study.compare",
    "bistable": "timesim.study.bistable",
    "optimum": "timesim.study.optimum",
}


def carry_out(scene: Scene, means: Means | None = None) -> Outcome:
    """Run the study of a scene.

    Args:
        scene: the scene.
        means: how; threads of this machine and no checkpoints by default.

    Raises:
        MeansError: the study cannot be carried out by these means.
        StoreError: a checkpoint cannot be begun, or it is not of this scene.
    """
    means, kind = means or Means(), scene.file.study.kind
    check_means(kind, means)
    in_chunks = kind in CAMPAIGNS
    module = import_module(CAMPAIGNS[kind] if in_chunks else MODULES[kind])
    outcome: Outcome = module.study(scene, means if in_chunks else means.progress)
    return outcome


def check_means(kind: str, means: Means) -> None:
    """Refuse means that make no difference to a kind of study.

    Raises:
        MeansError: naming what must be left out.
    """
    given = {"resume": means.resume, "cluster": means.cluster, "workers": means.workers}
    useless = [name for name, value in given.items() if value]
    if kind not in CAMPAIGNS and useless:
        rule = f"a {kind} study is done in one go, not in chunks of points"
        raise MeansError(f"{' and '.join(useless)}: {rule}; leave it out ({', '.join(CAMPAIGNS)} can use it)")


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

    Keyword Args:
        cluster: address of a dask scheduler that a study in chunks of points is carried out on, or "local" for
            processes of this machine (a script that asks for it starts below ``if __name__ == "__main__":``).
        workers: threads, or processes of a local cluster; the processors of this machine by default.

    Returns:
        The result: an xarray Dataset, or a DataTree of a study with groups (`compare`). ``complete`` is 0 in its
        attributes if the run ended early, with the reason as a warning.

    Raises:
        SceneError: the scene is wrong.
        MeansError: the study cannot be carried out by these means.
    """
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    means = Means(cluster=cluster, workers=workers)
    outcome = carry_out(loaded.with_overrides(overrides) if overrides else loaded, means)
    if outcome.reason is not None:
        warnings.warn(f"the run is incomplete: {outcome.reason}", RuntimeWarning, stacklevel=2)
    return joined(outcome.groups)
