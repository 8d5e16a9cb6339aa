"""The package as a whole: which module may import which, who prints, and every scene in `configs`."""

import ast
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from timesim.study.registry import load_scene

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "timesim"
SOURCES = sorted(PACKAGE.rglob("*.py"))

# From the bottom to the top: a part may import those before it.
ORDER = (
    "fault",
    "runtime",
    "program",
    "model",
    "engine",
    "orbit",
    "element",
    "hbm",
    "result",
    "scene",
    "picture",
    "study",
    "warm",
    "notebook",
    "cli",
)
RIM = ("timesim", "timesim.__main__")


def name_of(source: Path) -> str:
    """Dotted name of a module."""
    parts = source.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(source): source for source in SOURCES}


def imports(path: Path) -> set[str]:
    """Modules of the package that a module imports, inside functions, for type checks only and by name included."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "timesim":
            below = {f"{node.module}.{alias.name}" for alias in node.names} & set(NAMES)
            found |= below or {str(node.module)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & set(NAMES)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value} & set(NAMES) - {"timesim"}
    return found - {name_of(path)}


GRAPH = {name: imports(source) for name, source in NAMES.items()}


def test_packages_import_downwards():
    for name, below in GRAPH.items():
        if name in RIM:
            continue
        place = ORDER.index(name.split(".")[1])
        against = {other for other in below - {"timesim"} if ORDER.index(other.split(".")[1]) > place}
        assert not against, f"{name} imports {sorted(against)}"
        assert "timesim" not in below, f"{name} imports the whole package"


def test_imports_go_round_in_no_circle():
    settled: set[str] = set()
    while rest := [name for name in GRAPH if name not in settled]:
        ready = [name for name in rest if GRAPH[name] <= settled]
        assert ready, f"imports go round in a circle among {rest}"
        settled.update(ready)


@cache
def body(name: str) -> list[ast.stmt]:
    return ast.parse(NAMES[name].read_text()).body


def first_of(name: str, wanted: tuple[str, ...], seen: set[str]) -> str | None:
    """The first of some modules that a module of the package loads where it is imported before all others."""
    seen.add(name)
    for node in body(name):
        if not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
        loaded = [f"{module}.{alias.name}".strip(".") for alias in node.names] + [module] * bool(module)
        for target in loaded:
            if target in wanted or target.split(".")[0] in wanted:
                return target
            if target in NAMES and target not in seen and (found := first_of(target, wanted, seen)):
                return found
    return None


def test_whoever_uses_jax_has_it_as_the_package_needs_it():
    """The runtime comes before JAX, which it would otherwise take for that of another user in the same process."""
    wanted = ("timesim.runtime", "jax", "equinox", "diffrax", "optimistix", "jaxtyping")
    for name in NAMES:
        assert name == "timesim.runtime" or first_of(name, wanted, set()) in {None, "timesim.runtime"}, name


def test_a_folder_can_be_taken_in_at_a_glance():
    for folder in {source.parent for source in SOURCES} - {PACKAGE}:
        modules = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
        room = 15 - (folder.name == "study")  # for the study that the README tells how to add
        assert len(modules) <= room, f"{folder.name} has {len(modules)} modules"
        assert ast.get_docstring(ast.parse((folder / "__init__.py").read_text())), folder


def test_a_module_holds_one_concept_and_a_function_fits_on_a_screen():
    for source in SOURCES:
        assert len(source.read_text().splitlines()) <= 350, source
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                size = body[-1].end_lineno - body[0].lineno + 1 if body else 0
                assert size <= 45, f"{source}: {node.name} has {size} lines"


def test_only_the_commands_print_or_exit():
    for source in SOURCES:
        calls = {
            ast.unparse(node.func) for node in ast.walk(ast.parse(source.read_text())) if isinstance(node, ast.Call)
        }
        if source != PACKAGE / "cli.py":
            assert not calls & {"print", "sys.exit", "exit", "quit", "typer.Exit"}, source


def test_private_parts_of_libraries_are_left_alone():
    for source in SOURCES:
        assert not re.search(r"jax\._src|equinox\.internal|diffrax\._", source.read_text()), source


def test_benchmarks_import_what_there_is():
    for source in (ROOT / "benchmarks").rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("timesim"):
                module = import_module(str(node.module))
                missing = [alias.name for alias in node.names if not hasattr(module, alias.name)]
                assert all(f"{node.module}.{name}" in NAMES for name in missing), f"{source}: {missing}"


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
