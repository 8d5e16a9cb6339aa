"""Every dependency is declared where it is imported, and nothing is declared that is not."""

import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
MODULES = {"ruamel.yaml": "ruamel", "scikit-sundae": "sksundae"}
"""Top modules of distributions that bear another name."""

TOOLS = {"pytest-xdist", "beartype", "ruff", "mypy", "timesim"}
"""Used without an import; beartype is named to jaxtyping by text."""


def modules(requirements: list[str]) -> set[str]:
    """Modules that requirements stand for."""
    names = {re.split(r"[\[<>=!~ ]", requirement)[0] for requirement in requirements} - TOOLS
    return {MODULES.get(name, name.replace("-", "_")) for name in names}


def imported(folder: str) -> set[str]:
    """Top modules of other projects that a folder imports, inside functions, or names as text (xarray's engines)."""
    sources = list((ROOT / folder).rglob("*.py"))
    own = {name for path in sources for name in (path.stem, path.parent.name)} | {"timesim", "agreement"}
    found = set()
    for path in sources:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add((node.module or "").split(".")[0])
            elif isinstance(node, ast.keyword) and node.arg == "engine" and isinstance(node.value, ast.Constant):
                found.add(node.value.value)
    return found - own - sys.stdlib_module_names


def test_the_package_imports_what_it_declares():
    assert imported("timesim") == modules(PROJECT["dependencies"]) | modules(EXTRAS["cluster"])


def test_tests_and_benchmarks_import_what_is_declared():
    package = modules(PROJECT["dependencies"]) | modules(EXTRAS["cluster"])
    assert imported("tests") - package == modules(EXTRAS["test"])
    assert imported("benchmarks") - package - {"pyHarm", "oracle"} == modules(EXTRAS["bench"])
