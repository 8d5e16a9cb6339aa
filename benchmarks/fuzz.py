"""Does any scene, however strange, end in a traceback, in silence, or in a result that is wrong and does not say so?

    python benchmarks/fuzz.py --scenes 10000 --seed 1            # timesim check, all sorts of scenes
    python benchmarks/fuzz.py --run --scenes 300 --seed 1        # timesim run, small scenes of few sizes

Scenes are drawn from the JSON Schema of the scene file (tests/scenes.py). `check` and `run` are called as the command
does, in this process. Each call must end by exit status 0, 1 or 2 within a time limit; what is refused must be named
by file, line or key, with a rule; what was computed must be finite and, of a run through time, keep its energies; and
what is incomplete must say why. A scene that breaks one of these is kept below --keep, its fault in its first line.
"""

import argparse
import collections
import contextlib
import faulthandler
import re
import runpy
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from typer.testing import CliRunner

from timesim.cli import app
from timesim.scene.text import yaml_text
from timesim.study.registry import json_schema, load_scene

SCENES = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "scenes.py"))
SECONDS = {"check": 20, "run": 180}
"""Of the processor, for each call; a run may compile."""
SLOW = 20
RESIDUAL = {"draft": 1e-3, "standard": 1e-5, "reference": 1e-8}
"""Of the energy of a cycle, over the larger of its input and the peak of the stored energy."""
PLACED = re.compile(r"^(override|.*\.yaml)(:\d+)?: \S.*")


class Late(BaseException):
    """The time limit has passed."""


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Interrupts after a time of the processor, and ends the process, with a traceback, after ten times that."""

    def interrupt(*_: Any) -> None:
        raise Late

    before = signal.signal(signal.SIGPROF, interrupt)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    faulthandler.dump_traceback_later(10 * seconds, exit=True)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGPROF, before)


def called(*arguments: Any, limit: float) -> tuple[int | None, str, str, str]:
    """Exit status, what was printed, what was complained of, and the traceback, "" if there is none."""
    try:
        with limited(limit), warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    except Late:
        return None, "", "", f"not done within {limit:g} CPU seconds"
    if isinstance(done.exception, Late):
        return None, done.stdout, done.stderr, f"not done within {limit:g} CPU seconds"
    fault = ""
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        fault = "".join(traceback.format_exception(done.exception)[-6:]) + repr(done.exception).splitlines()[0]
    elif seen:
        fault = f"warning: {seen[0].category.__name__}: {seen[0].message} ({seen[0].filename}:{seen[0].lineno})"
    return done.exit_code, done.stdout, done.stderr, fault


def refused_well(complaint: str) -> str:
    """What is wrong with a refusal; empty if each line of it names a place and a rule."""
    lines = complaint.splitlines()
    bad = [line for line in lines if not PLACED.match(line)]
    return f"a refusal without a place: {bad[0]}" if bad else "" if lines else "a refusal without a word"


def fault_of_check(path: Path) -> tuple[str, str]:
    """How `check` ends, and what is wrong with that."""
    status, said, complaint, fault = called("check", path, limit=SECONDS["check"])
    if fault:
        return str(status), fault
    if status == 2:
        return "2", refused_well(complaint)
    if status != 0 or complaint or not said.startswith("scene:"):
        return str(status), f"exit status {status} with {complaint or said!r}"
    return "0", same_again(path)


def same_again(path: Path) -> str:
    """What is wrong with the scene as it is written out in a run folder; empty if it reads back as the same scene."""
    scene = load_scene(path)
    again = load_scene(scene.resolved_yaml() + "\n")
    return "" if again.resolved_yaml() == scene.resolved_yaml() else "written out it is another scene"


def fault_of_run(path: Path) -> tuple[str, str]:
    """How `run` ends, and what is wrong with that."""
    with tempfile.TemporaryDirectory() as folder:
        output, pictures = Path(folder) / "run", "--plots" if path.stat().st_size % 5 == 0 else "--no-plots"
        status, _, complaint, fault = called("run", path, "-o", output, pictures, limit=SECONDS["run"])
        if fault:
            return str(status), fault
        if status == 2:
            return "2", refused_well(complaint)
        if status not in (0, 1):
            return str(status), f"exit status {status}: {complaint}"
        return str(status), fault_of_result(output, status, complaint)


def fault_of_result(folder: Path, status: int, complaint: str) -> str:
    """What is wrong with the result of a run that ended with this status."""
    import timesim

    result = timesim.open_result(folder)
    complete = result.attrs["complete"]
    if complete != 1 - status:
        return f"exit status {status} with complete = {complete}"
    if status and not result.attrs.get("reason"):
        return f"incomplete without a reason: {complaint}"
    if result.attrs["study"] not in ("transient", "jump"):
        return "" if status else fault_of_values(result)
    data = {name: result[name].values for name in result.data_vars}
    for name, values in data.items():
        unknown = name == "cycle_amplitude_error" and np.isnan(result.attrs["estimated_error"])  # and the run says so
        if values.dtype.kind == "f" and not unknown and not np.all(np.isfinite(values)):
            return f"{name} is not finite"
    size = max(np.abs(data["energy_input"]).max(initial=0.0), result.attrs["peak_stored_energy"])
    left = np.abs(data["energy_residual"]).max(initial=0.0)
    accuracy = load_scene(folder / "scene.yaml").file.solver.accuracy
    bound = RESIDUAL[accuracy] if accuracy else 1e-2
    return f"energy residual {left / size:.1e}, above {bound:g} of {accuracy}" if left > bound * size else ""


def fault_of_values(result: Any) -> str:
    """What is wrong with the values of a complete result: amplitudes of all that has settled are finite."""
    groups = [group.to_dataset() for group in result.subtree] if hasattr(result, "subtree") else [result]
    for group in groups:
        for name in ("amplitude", "harmonic_amplitude", "f_s", "dissipation"):
            if name in group and "failure" not in group and not np.all(np.isfinite(group[name].values)):
                return f"{name} is not finite in a complete result"
    return ""


def kind_of(scene: Any) -> str:
    study = scene.get("study") if isinstance(scene, dict) else None
    kind = study.get("kind") if isinstance(study, dict) else None
    return kind if isinstance(kind, str) and kind.isascii() else "none"


def fuzz(scenes: Any, judge: Callable[[Path], tuple[str, str]], number: int, first: int, keep: Path) -> None:
    """Judge a number of scenes, count how they end, and keep those with a fault."""
    ends: collections.Counter[tuple[str, str]] = collections.Counter()
    faults: collections.Counter[str] = collections.Counter()
    clock, slowest = time.perf_counter(), [0.0, ""]
    keep.mkdir(parents=True, exist_ok=True)
    path = keep / "now.yaml"

    @seed(first)
    @settings(
        max_examples=number,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
    )
    @given(scenes)
    def one(scene: Any) -> None:
        path.write_text(yaml_text(scene) if isinstance(scene, dict) else f"{scene}\n")
        start = time.process_time()
        status, fault = judge(path)
        seconds = time.process_time() - start
        if seconds > SLOW:
            print(f"{kind_of(scene)} took {seconds:.0f} CPU s: exit status {status}", flush=True)
        if seconds > slowest[0]:
            slowest[:] = [seconds, path.read_text()]
        ends[kind_of(scene), status] += 1
        if fault:
            name = re.sub(r"[^a-z]+", "_", fault.strip().splitlines()[-1].lower())[:60]
            faults[name] += 1
            if faults[name] <= 3:
                note = "".join(f"# {line}\n" for line in fault.strip().splitlines())
                (keep / f"{name}_{faults[name]}.yaml").write_text(note + path.read_text())
                print(f"{name}: {fault.strip().splitlines()[-1]}", flush=True)
        count = sum(ends.values())
        if count % max(1, number // 20) == 0:
            print(f"{count} scenes, {time.perf_counter() - clock:.0f} s, {sum(faults.values())} faults", flush=True)

    one()
    (keep / "slowest.yaml").write_text(f"# {slowest[0]:.1f} CPU s\n{slowest[1]}")
    kinds, states = (sorted({end[i] for end in ends}) for i in (0, 1))
    print("\n| study | " + " | ".join(f"exit status {state}" for state in states) + " |")
    print("|---|" + "---|" * len(states))
    for kind in kinds:
        print(f"| {kind} | " + " | ".join(str(ends[kind, state]) for state in states) + " |")
    print(
        f"\n{sum(ends.values())} scenes, seed {first}, {time.perf_counter() - clock:.0f} s, slowest {slowest[0]:.1f} s"
    )
    print(f"{sum(faults.values())} faults: {dict(faults)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--run", action="store_true", help="whole runs of small scenes")
    parser.add_argument("--keep", type=Path, default=Path("runs/fuzz"))
    options = parser.parse_args()
    schema = json_schema()
    scenes = SCENES["small_scene"](schema) if options.run else SCENES["any_scene"](schema)
    fuzz(scenes, fault_of_run if options.run else fault_of_check, options.scenes, options.seed, options.keep)


if __name__ == "__main__":
    main()
