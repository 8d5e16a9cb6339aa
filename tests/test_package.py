"""The package as a whole: which module may import which, who prints, and every scene in `configs`."""

import ast
import re
from pathlib import Path

import pytest

from timesim.config import load_scene

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "timesim").glob("*.py"))


def imports(path: Path, *, at_top: bool = False) -> set[str]:
    """Modules of the package that a module imports, at its top only or anywhere."""
    tree = ast.parse(path.read_text())
    nodes = tree.body if at_top else ast.walk(tree)
    found = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("timesim"):
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {name.name.split(".")[1] for name in node.names if name.name.startswith("timesim.")}
    return found & {source.stem for source in SOURCES}


def test_imports_point_one_way():
    graph = {source.stem: imports(source, at_top=True) for source in SOURCES}
    settled: list[str] = []
    while rest := [name for name in graph if name not in settled]:
        ready = [name for name in rest if graph[name] <= set(settled)]
        assert ready, f"imports go round in a circle among {rest}"
        settled += ready


def test_the_rim_is_not_imported_by_the_core():
    core = {"contact", "guard", "hermite", "integrate", "method", "model", "system", "reduction"}
    rim = {"config", "schema", "study", "cli", "store", "plot", "check"}
    for source in SOURCES:
        if source.stem in core:
            assert not imports(source) & rim, source
        if source.stem not in ("cli", "__main__"):
            assert "cli" not in imports(source), source


def test_only_the_commands_print_or_exit():
    for source in SOURCES:
        calls = {
            ast.unparse(node.func) for node in ast.walk(ast.parse(source.read_text())) if isinstance(node, ast.Call)
        }
        if source.stem != "cli":
            assert not calls & {"print", "sys.exit", "exit", "quit", "typer.Exit"}, source


def test_private_parts_of_libraries_are_left_alone():
    for source in SOURCES:
        assert not re.search(r"jax\._src|equinox\.internal|diffrax\._", source.read_text()), source


def test_every_scene_in_configs_is_good_and_commented():
    scenes = sorted((ROOT / "configs").glob("*.yaml"))
    assert len(scenes) >= 2
    for path in scenes:
        assert load_scene(path).file.title, path
        assert "#" in path.read_text(), path


@pytest.mark.parametrize("name", ["oscillator", "blade"])
def test_the_transient_scenes_run(name: str):
    import timesim

    result = timesim.run(ROOT / "configs" / f"{name}.yaml", {"study.cycles": 3, "study.record_last": 1})
    assert result.attrs["complete"] == 1
    assert result.sizes["event"] > 0
    assert float(abs(result["energy_residual"]).max()) < 1e-6 * float(abs(result["energy_input"]).max())
