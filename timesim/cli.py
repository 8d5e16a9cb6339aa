"""The commands: the only module that prints or exits.

Exit status: 0 done; 1 the run failed, what was computed is saved and marked incomplete; 2 the scene or the call is
wrong, nothing was run.
"""

import json
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Event-driven time integration of structures with frictional contacts.",
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.yaml", help="The scene file.")]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY.PATH=VALUE", help="Another value for a key of the scene; may be repeated."),
]


def _stop(status: int, message: str) -> NoReturn:
    print(message, file=sys.stderr)
    raise typer.Exit(status)


@app.command()
def run(
    scene: SceneFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the run.")],
    overrides: Overrides = None,
    plots: Annotated[bool, typer.Option("--plots/--no-plots", help="Draw pictures.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a result that is there.")] = False,
) -> None:
    """Run a scene and write result.nc, scene.yaml and pictures."""
    from timesim import plot, store
    from timesim.study import carry_out

    loaded = _loaded(scene, overrides)
    kind = loaded.file.study.kind
    try:
        store.check_folder(output, force)
        store.prepare_folder(output, loaded.resolved_yaml(), force, source=scene, stale=plot.picture_names(kind))
    except store.StoreError as error:
        _stop(2, str(error))
    for warning in loaded.warnings():
        print(f"warning: {warning}", file=sys.stderr)
    with _terminated(), _progress(kind) as progress:
        outcome = carry_out(loaded, progress)
    try:
        path = store.save_groups(outcome.groups, output / store.RESULT_NAME)
        pictures = plot.draw(outcome.groups[""].dataset(), output) if plots else []
    except store.StoreError as error:
        _stop(1, str(error))
    for line in outcome.summary:
        print(line)
    print(f"result: {path}" + (f" and {len(pictures)} pictures" if pictures else ""))
    if outcome.reason is not None:
        _stop(1, f"incomplete: {outcome.reason}\nwhat was computed is in {path}, marked complete = 0")


@app.command()
def check(scene: SceneFile, overrides: Overrides = None) -> None:
    """Check a scene without running it, and say what would be modelled."""
    from timesim.check import describe

    for heading in describe(_loaded(scene, overrides)):
        print(f"{heading.title}:")
        for line in heading.lines:
            print(f"  {line}")


@app.command()
def schema() -> None:
    """Print the JSON Schema of the scene file, for editors."""
    from timesim.config import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
def plot(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
) -> None:
    """Draw the pictures of a run again."""
    from timesim import plot as pictures
    from timesim import store

    try:
        for path in pictures.draw(store.open_result(folder), folder):
            print(path)
    except store.StoreError as error:
        _stop(2, str(error))


def _loaded(scene: Path, overrides: list[str] | None) -> Any:
    from timesim.config import SceneError, load_scene

    try:
        return load_scene(scene, overrides or ())
    except SceneError as error:
        _stop(2, str(error))


@contextmanager
def _terminated() -> Iterator[None]:
    """Let a termination end a run as an interrupt does: with what it has."""

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _progress(kind: str) -> Iterator[Callable[[int, int], None] | None]:
    """A bar with rate and time left, where somebody is watching."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(kind, total=None, rate="")

        def show(done: int, number: int) -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed:.3g}/s" if speed else ""
            bar.update(task, completed=done, total=number, rate=rate)

        yield show


def main() -> None:
    """Entry point of the ``timesim`` command."""
    app()
