"""How long does a run take to start: the first time, with an empty cache of compiled programs, and every later time?

Run `python benchmarks/start.py`. CPU seconds of whole processes, medians of five of each in turn, so that all meet the
same load of the machine; beside them the ratio to `python -c "import jax, xarray"`, which whoever uses JAX pays anyway.
`--against DIR` runs the commands by another checkout as well.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
IMPORTS = ("-c", "import jax, xarray")
RUN = ("-m", "timesim", "run", "configs/oscillator.yaml", "--force", "-o", "{folder}")
COMMANDS = {
    'python -c "import jax, xarray"': IMPORTS,
    "timesim run configs/oscillator.yaml --no-plots": (*RUN, "--no-plots"),
    "timesim run configs/oscillator.yaml": RUN,
    "timesim check configs/oscillator.yaml": ("-m", "timesim", "check", "configs/oscillator.yaml"),
    "timesim --help": ("-m", "timesim", "--help"),
}


def seconds(arguments: tuple[str, ...], root: Path, cache: Path) -> float:
    """CPU seconds of a Python process with its children, by the package of a checkout."""
    # Bytecode is kept, as it is of an installed package.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment = kept | {"PYTHONPATH": str(root), "TIMESIM_CACHE": str(cache)}
    command = [sys.executable, *(word.format(folder=cache / "run") for word in arguments)]
    process = subprocess.Popen(command, cwd=root, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    said = process.stderr.read().decode()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(command)}: exit status {process.returncode}\n{said}")
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, metavar="DIR", help="another checkout")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    checkouts = {"": ROOT} | ({f", {options.against.name}": options.against.resolve()} if options.against else {})
    with tempfile.TemporaryDirectory() as folder:
        caches = {root: Path(folder, str(number)) for number, root in enumerate(checkouts.values())}
        tasks = {
            f"{name}{label}": (arguments, root, caches[root])
            for label, root in checkouts.items()
            for name, arguments in COMMANDS.items()
            if root == ROOT or arguments != IMPORTS
        }
        first = {name: seconds(*task) for name, task in tasks.items()}
        rounds = [{name: seconds(*task) for name, task in tasks.items()} for _ in range(options.repeats)]
    later = {name: statistics.median(one[name] for one in rounds) for name in tasks}
    unit = next(iter(later.values()))
    print("| command | first, CPU s | later, CPU s | by the imports |\n|---|---|---|---|")
    for name, value in later.items():
        print(f"| `{name}` | {first[name]:.2f} | {value:.2f} | {value / unit:.2f} |")


if __name__ == "__main__":
    main()
