"""How long does a structure of each size compile, by each method?

    python benchmarks/compile_time.py --against DIR      # DIR: a checkout of what it was before

A generated structure (tests/zoo.py) runs for two cycles by `timesim run`, is swept over two frequencies, or has its
balance followed over a few, with an empty folder of compiled programs and again: CPU seconds of the first run beyond
those of the second, children included.
"""

import argparse
import runpy
import tempfile
from pathlib import Path

from start import ROOT, seconds

from timesim.scene.text import yaml_text

ZOO = runpy.run_path(str(ROOT / "tests" / "zoo.py"))
SIZES = ((2, 1), (20, 3), (20, 10), (50, 10), (100, 30))
SOLVERS = {
    "tsit5": {"method": "tsit5", "rtol": 1e-6, "atol": 1e-8},
    "dopri8": {"method": "dopri8", "rtol": 1e-8, "atol": 1e-10},
    "exponential, 3 nodes": {"method": "exponential", "rtol": 1e-4, "atol": 1e-6},
    "exponential, 5 nodes": {"method": "exponential", "rtol": 1e-7, "atol": 1e-9},
}
SWEEP, BALANCE = "sweep by ", "balance"
"""The first stands before the name of a solver."""
SEED = 8100


def scene(size: tuple[int, int], name: str) -> str:
    model, _ = ZOO["driven"](SEED, size)
    frequency, method = model.excitation.frequency, name.removeprefix(SWEEP)
    study: dict[str, object] = {"kind": "transient", "cycles": 2}
    if name == BALANCE:
        study = {"kind": "hbm", "frequency": {"from": frequency, "to": 1.01 * frequency}}
    elif name != method:
        settle = {"tolerance": 1e-3, "max_cycles": 8}
        study = {"kind": "sweep", "frequency": {"values": [frequency, 1.01 * frequency]}, "settle": settle}
    return yaml_text(ZOO["scene_of"](model) | {"study": study, "solver": SOLVERS.get(method, {})})


def compiling(text: str, root: Path, before: str | None = None) -> float:
    """CPU seconds that a first run takes beyond a second, after that of another scene where one is given."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scene.yaml")
        command = ("-m", "timesim", "run", str(file), "--force", "--no-plots", "-o", "{folder}")
        if before is not None:
            file.write_text(before)
            seconds(command, root, Path(folder))
        file.write_text(text)
        first, later = (seconds(command, root, Path(folder)) for _ in range(2))
    return first - later


def size_of(text: str) -> tuple[int, int]:
    """Modes and contacts."""
    modes, contacts = text.split("x")
    return int(modes), int(contacts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [*SOLVERS, *(SWEEP + name for name in SOLVERS), BALANCE]
    parser.add_argument("--against", type=Path, metavar="DIR", help="another checkout")
    parser.add_argument("--methods", nargs="+", choices=names, default=names)
    parser.add_argument("--sizes", nargs="+", metavar="MxC", default=[f"{m}x{c}" for m, c in SIZES])
    parser.add_argument("--after", metavar="MxC", help="size of a structure that has run before each")
    options = parser.parse_args()
    sizes = [size_of(text) for text in options.sizes]
    heads = [f"{m} x {c}" for m, c in sizes]
    print("\n".join(["| method | " + " | ".join(heads) + " |", "|---" * (1 + len(heads)) + "|"]), flush=True)
    for name in options.methods:
        for root in (ROOT, options.against and options.against.resolve()):
            if root is None:
                continue
            label = name if root == ROOT else f"{name}, {root.name}"
            before = scene(size_of(options.after), name) if options.after else None
            found = [f"{compiling(scene(size, name), root, before):.1f}" for size in sizes]
            print(f"| {label} | {' | '.join(found)} |", flush=True)


if __name__ == "__main__":
    main()
