"""The commands: the only module that prints or exits.

Exit status: 0 done; 1 the run failed, what was computed is saved and marked incomplete; 2 the scene or the call is
wrong, nothing was run.
"""

import gc
import io
import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from timesim.study.execution.interrupts import Signals
    from timesim.study.execution.progress import Standing

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

POINT = "DIR/show/AXIS=VALUE,..."
"""Where the point of a sweep goes that is shown."""
SECONDS_A_LINE = 60.0
"""Between two lines of progress where standard error is no terminal."""

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.yaml", help="The scene file.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite a result that is there.")]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY.PATH=VALUE", help="Another value for a key of the scene; may be repeated."),
]


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(version("timesim"))
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it and exit.")
    ] = False,
) -> None:
    """Event-driven time integration of structures with frictional contacts."""


def _stop(status: int, message: str) -> NoReturn:
    print(message, file=sys.stderr)
    raise typer.Exit(status)


@app.command()
def run(
    scene: SceneFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the run.")],
    overrides: Overrides = None,
    plots: Annotated[bool, typer.Option("--plots/--no-plots", help="Draw pictures.")] = True,
    force: Force = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run that was cut off.")] = False,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS|local", help="Run on a dask cluster, or on processes of this machine."),
    ] = None,
) -> None:
    """Run a scene and write result.nc, scene.yaml and pictures."""
    from timesim.picture.draw import KINDS
    from timesim.result import checkpoint
    from timesim.result.file import StoreError
    from timesim.result.folder import check_folder, locked_folder, prepare_folder
    from timesim.scene.report import warnings_of
    from timesim.study.execution.campaign import Execution, ExecutionError
    from timesim.study.execution.interrupts import Signals
    from timesim.study.registry import check_execution, picture_names

    loaded = _loaded(scene, overrides)
    try:
        execution = Execution(folder=output, resume=resume, cluster=cluster, notice=_notice)
        check_execution(loaded.kind, execution)
        before = (output, loaded.resolved_yaml(), loaded.data_fingerprint)
        if checkpoint.is_finished(*before, force=force, resume=resume):
            print(f"the result in {output} is complete: there is nothing to resume; timesim plot {output} draws it")
            return
        check_folder(output, overwrite=force or resume)
        with Signals() as signals, locked_folder(output):
            stale = picture_names(loaded.kind, KINDS)
            prepare_folder(output, loaded.resolved_yaml(), overwrite=force, source=scene, stale=stale)
            for warning in warnings_of(loaded):
                print(f"warning: {warning}", file=sys.stderr)
            _carry_out(loaded, execution, signals, plots=plots)
    except (StoreError, ExecutionError) as error:
        _stop(2, str(error))
    except KeyboardInterrupt:
        _stop(1, "interrupted before anything was run")


def _carry_out(loaded: Any, execution: Any, signals: "Signals", *, plots: bool) -> None:
    """Run the study, save its result and draw it."""
    from timesim.result import checkpoint, netcdf
    from timesim.result.file import StoreError
    from timesim.study.execution.processes import Processes
    from timesim.study.execution.progress import Standing
    from timesim.study.registry import carry_out, draw

    output = execution.folder
    standing = Standing(loaded.file.study.counts, execution.earlier())
    try:
        with _progress(standing), Processes() as processes:
            outcome = carry_out(loaded, replace(execution, progress=standing, processes=processes))
    except KeyboardInterrupt:
        _stop(1, f"interrupted before there was a result to save{_safe_chunks(output)}")
    signals.saving = True
    try:
        path = netcdf.save(outcome.groups, output / netcdf.RESULT_NAME)
    except StoreError as error:
        elsewhere = "".join(f"; {part}" for part in netcdf.save_elsewhere(outcome.groups, output))
        _stop(1, f"{error}{_safe_chunks(output)}{elsewhere}")
    finally:  # only now: a pipe may be closed
        for line in outcome.summary:
            print(line)
    faults, pictures = [], []
    try:
        if outcome.reason is None:
            checkpoint.clear(output)
        else:
            hint = checkpoint.way_on(output, outcome.reason, outcome.groups[""])
            faults.append(f"incomplete: {outcome.reason}\nwhat was computed is in {path}, marked complete = 0{hint}")
    except StoreError as error:
        faults.append(str(error))
    signals.saving = False
    try:
        pictures = draw(netcdf.joined(outcome.groups), output) if plots else []
    except (StoreError, KeyboardInterrupt) as error:
        saved = f"the result is saved; timesim plot {output} draws the pictures again"
        faults.append(f"{str(error) or 'interrupted'}\n{saved}")
    print(_written(path, pictures))
    if faults:
        _stop(1, "\n".join(faults))


@app.command()
def check(scene: SceneFile, overrides: Overrides = None) -> None:
    """Check a scene without running it, and say what would be modelled."""
    from timesim.scene.report import describe

    for heading, lines in describe(_loaded(scene, overrides)).items():
        print("\n  ".join([f"{heading}:", *lines]))


@app.command()
def warm() -> None:
    """Compile the programs of usual studies beforehand, so that first runs start as quickly as later ones."""
    from timesim.warm import warm_up

    print(warm_up())


@app.command()
def schema() -> None:
    """Print the JSON Schema of the scene file, for editors."""
    from timesim.study.registry import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
def plot(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run, or its result file.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Folder of the pictures; that of the run by default."),
    ] = None,
    kind: Annotated[str, typer.Option("--format", metavar="png|pdf|svg", help="Format of the files.")] = "png",
    log: Annotated[
        list[str] | None,
        typer.Option(metavar="amplitude|frequency", help="Draw its axes logarithmic; may be repeated."),
    ] = None,
) -> None:
    """Draw the pictures of a run again."""
    from timesim.result.file import StoreError
    from timesim.result.folder import made_folder
    from timesim.result.netcdf import open_result, result_file
    from timesim.study.registry import draw

    try:
        result = open_result(folder)
        place = made_folder(output) if output else result_file(folder).parent
    except StoreError as error:
        _stop(2, str(error))
    try:
        pictures = draw(result, place, kind=kind, log=log or ())
        nothing = "there is nothing to draw: no point of the result was computed"
        print("\n".join(map(str, pictures)) or nothing)
    except ValueError as error:
        _stop(2, f"--{error}")
    except StoreError as error:
        _stop(1, str(error))


@app.command()
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run with a sweep, or its result file.")],
    at: Annotated[
        list[str] | None,
        typer.Option("--at", metavar="AXIS=VALUE", help="The point, by the axes of the sweep; may be repeated."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="DIR", help=f"Folder of its result; {POINT} by default.")
    ] = None,
    force: Force = False,
) -> None:
    """Compute the motion at a point of a sweep again, print what it does and draw it: loops, orbit, contact states."""
    from timesim.fault import RuleError, SceneError
    from timesim.picture.draw import KINDS
    from timesim.result import netcdf
    from timesim.result.file import StoreError
    from timesim.result.folder import SHOW_NAME, check_point_folder, prepare_point_folder
    from timesim.study.point import point_again
    from timesim.study.registry import draw, picture_names

    own = netcdf.result_file(folder)
    try:
        if output:
            check_point_folder(output, own, overwrite=force)
        point = point_again(folder, _asked(at or ()))
    except RuleError as error:
        value = "..." if error.value is None else error.value
        asked = f"--at {error.key[0]}={value}" if error.key else str(folder)
        _stop(2, f"{asked}: {error.rule} ({error.hint})")
    except (StoreError, SceneError) as error:
        _stop(2, str(error))
    print(*point.table, sep="\n")
    place = output or own.parent / SHOW_NAME / point.name
    try:
        prepare_point_folder(place, stale=picture_names("transient", KINDS))
        own = netcdf.save(point.motion, place / netcdf.RESULT_NAME)
        pictures = draw(point.motion, place)
    except StoreError as error:
        _stop(1, str(error))
    print(_written(own, pictures))
    if point.reason is not None:
        _stop(1, f"incomplete: {point.reason}")


def _asked(texts: Sequence[str]) -> dict[str, float | str]:
    """A value along each of some axes."""
    asked: dict[str, float | str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            _stop(2, f"--at {text}: write it as AXIS=VALUE, such as frequency=0.945")
        if name in asked:
            _stop(2, f"--at {text}: {name} is given already, as {asked[name]}; show one point after the other")
        asked[name] = value
        with suppress(ValueError):
            asked[name] = float(value)
    return asked


def _loaded(scene: Path, overrides: list[str] | None) -> Any:
    from timesim.fault import SceneError
    from timesim.study.registry import load_scene

    try:
        return load_scene(scene, overrides or ())
    except SceneError as error:
        _stop(2, str(error))


def _safe_chunks(output: Path) -> str:
    """What remains on disk where the result could not be saved."""
    from timesim.result import checkpoint
    from timesim.result.label import counted

    done = counted(checkpoint.chunks_done(output), "finished chunk is", "finished chunks are")
    folder = output / checkpoint.FOLDER_NAME
    return "" if done.startswith("0 ") else f"; {done} safe in {folder}, and --resume goes on from there"


def _written(result: Path, pictures: Sequence[Path]) -> str:
    """Where the result is, and how many pictures were drawn beside it."""
    return f"result: {result}" + (f" and {len(pictures)} picture{'s' * (len(pictures) > 1)}" if pictures else "")


def _notice(text: str) -> None:
    print(f"note: {text}", file=sys.stderr)


@contextmanager
def _progress(standing: "Standing") -> Iterator[None]:
    """A bar on a terminal, otherwise a line a minute."""
    if sys.stderr is not None and sys.stderr.isatty():
        with _bar(standing):
            yield
        return
    with standing.told(SECONDS_A_LINE, lambda line: print(line, file=sys.stderr, flush=True)):
        yield


def _bar(standing: "Standing") -> AbstractContextManager[Any]:
    from rich.console import Console
    from rich.live import Live
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    def drawn() -> Table:
        line = Table.grid(padding=(0, 1))
        words = Text(standing.line(), no_wrap=True, overflow="ellipsis")
        line.add_row(ProgressBar(total=1.0, completed=standing.share, width=20), words)
        return line

    return Live(get_renderable=drawn, console=Console(stderr=True), transient=True)


def main() -> None:
    """Entry point of the ``timesim`` command."""
    # Imports and traces leave half a million objects that stay alive. At Python's own threshold the garbage collector
    # visits them so often that a second run of configs/oscillator.yaml takes 4.4 s of processor time instead of 3.8.
    gc.set_threshold(50_000)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a letter that a terminal lacks ends no run
            stream.reconfigure(errors="replace")
    # Compiled programs kept on disk save the next run 1 s (see `timesim.program`).
    os.environ.setdefault("TIMESIM_KEEP_PROGRAMS", "1")
    # xarray imports dask, if installed, with its first Dataset: 0.3 s. A module that is None is not imported.
    if not any(word.startswith("--cluster") for word in sys.argv):
        sys.modules.setdefault("dask", None)  # type: ignore[arg-type]
    from timesim.fault import unforeseen

    try:
        app()
    except Exception as error:
        if sys.flags.dev_mode:
            raise
        sys.exit(unforeseen(error))
