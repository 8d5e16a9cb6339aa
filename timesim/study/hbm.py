"""The `hbm` study: response curves by harmonic balance, one or several for each set of values of the further axes."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

from xarray import Dataset

from timesim.hbm.branches import warm_up
from timesim.hbm.convergence import convergence
from timesim.result.file import StoreError
from timesim.result.state import SavedStates
from timesim.scene.hbm import HbmPlan
from timesim.scene.resolution import Scene
from timesim.scene.study import combinations
from timesim.study.curves.collection import Curves
from timesim.study.curves.follow import follow_all
from timesim.study.curves.kept import kept_curves
from timesim.study.execution.campaign import INTERRUPTED, Execution
from timesim.study.execution.progress import Phases
from timesim.study.outcome import Outcome, attributes
from timesim.study.summary.curve import curve_lines

NOT_BEGUN = "not begun"


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run an hbm scene; the result is marked incomplete where a curve could not be followed to its end."""
    data, curves, reason = followed(scene, scene.plan, execution)
    return Outcome({"": data}, reason, tuple(curve_lines(data, curves.notes)))


def followed(
    scene: Scene, plan: HbmPlan, execution: Execution, passing: SavedStates | None = None, stage: str = ""
) -> tuple[Dataset, Curves, str | None]:
    """All curves of a scene, those through the points of a sweep too: the result, they, and why some are not whole.

    ``passing``: a sweep whose settled points are to be passed too; ``stage``: as of `Execution.checkpoint`.
    """
    curves = Curves(scene, plan)
    phases = Phases(execution.progress, {"curves": len(curves.values), "convergence": int(plan.convergence)})
    phases["curves"](0, 1, "harmonic balance, compiling")
    compiling = _warmed_up(scene, plan)
    phases["curves"](0, 1, "harmonic balance")
    with kept_curves(execution, scene.resolved_yaml(), _sets(curves), stage) as kept:
        clock = time.perf_counter() - kept.earlier
        reason = follow_all(curves, replace(execution, progress=phases["curves"]), kept, passing)
    if plan.convergence:
        phases["convergence"](0, 1, "convergence of the balance")
    try:
        refined = convergence(curves.to_refine(), curves.scheme) if plan.convergence and reason is None else None
    except KeyboardInterrupt:
        refined, reason = None, f"{INTERRUPTED} while harmonics and time samples were refined"
    seconds = time.perf_counter() - clock
    attrs = attributes(scene, str(curves.scheme), compiling, seconds, reason, integrated=False)
    if curves.notes:
        attrs["notes"] = "\n".join(curves.notes)
    return curves.record(attrs, refined), curves, reason


def _sets(curves: Curves) -> list[Any]:
    """What the curves of each set of values are determined by beside the scene: files that it names."""
    plan, states = curves.plan, curves.plan.passing
    arrays = {name: array.astype(str) for name, array in states[0].arrays.items()} if states else {}
    return [(curves.scene.variant(values), plan.motion, arrays) for values in curves.values]


def followed_behind(
    scene: Scene, plan: HbmPlan, execution: Execution, passing: SavedStates | None = None
) -> tuple[Dataset, Curves, str | None]:
    """`followed` as the last stage of a study: where it is not to be begun, what the study has computed stays."""
    try:
        return followed(scene, plan, execution, passing, "balance")
    except KeyboardInterrupt:  # while it compiled
        return left_out(scene, plan, f"{INTERRUPTED}, {NOT_BEGUN}")
    except StoreError as error:
        return left_out(scene, plan, str(error))


def left_out(scene: Scene, plan: HbmPlan, reason: str = NOT_BEGUN) -> tuple[Dataset, Curves, str | None]:
    """The same where nothing is followed."""
    curves = Curves(scene, plan)
    attrs = attributes(scene, str(curves.scheme), 0.0, 0.0, reason, integrated=False)
    return curves.record(attrs), curves, reason


def compile_beside(scene: Scene, plan: HbmPlan) -> None:
    """Begin to compile what `followed` takes, which meets what fails again, while something else runs."""
    ThreadPoolExecutor(1).submit(_warmed_up, scene, plan)


def _warmed_up(scene: Scene, plan: HbmPlan) -> float:
    """Seconds that it took to compile what the curves take."""
    clock, model = time.perf_counter(), scene.variant(next(combinations(plan.over)))
    warm_up(model, plan.span[0], plan.schemes_for(model)[0], stability=plan.stability)
    return time.perf_counter() - clock
