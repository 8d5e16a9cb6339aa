"""Does the README's tour say what the scenes give, and how long does each scene take on a first and on a second run?

Run `python benchmarks/tour.py -o DIR`. Every command of the tour is run into DIR, then each claim of the README is
compared with the results: the numbers are read from README.md, so that text and check cannot part. A number is wrong
where it differs from the result by more than a unit of its last printed digit, or where the README no longer says the
sentence. A number of the tour that no claim covers is wrong too. Exit status 1 if anything is wrong.

`--check` compares with results that are in DIR already. `--times` runs every scene twice, first with an empty cache of
compiled programs, and writes wall and CPU seconds of both into benchmarks/README.md, with the load of the machine.
"""

import argparse
import os
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import timesim

ROOT = Path(__file__).parents[1]
README, REPORT = ROOT / "README.md", ROOT / "benchmarks" / "README.md"
MARKS = ("<!-- times of the tour -->", "<!-- end of the times -->")
LIMITS = (60.0, 30.0)  # seconds of a first and a second run that are wanted
NUMBER = r"-?\d+(?:\.\d+)?(?:e-?\d+)?"


# The commands of the tour


@dataclass(frozen=True)
class Row:
    """A scene of the tour: the name of its folder, and what follows `timesim run`."""

    name: str
    arguments: tuple[str, ...]


def rows(text: str) -> list[Row]:
    """The scenes of the table, one for each command and for each further scene named beside it."""
    table = text.split("## A tour by scenes")[1].split("\n\n")[1]
    found = []
    for line in table.splitlines()[2:]:
        for quoted in re.findall(r"`([^`]+)`", line.split("|")[1]):
            words = shlex.split(quoted)
            if words[:2] == ["timesim", "run"]:
                name = Path(words[words.index("-o") + 1]).name
                arguments = [word for word in words[2:] if word not in ("-o", f"runs/{name}")]
            else:
                name, arguments = Path(quoted).stem, [f"configs/{quoted}"]
            found.append(Row(name, tuple(arguments)))
    return found


def run(row: Row, folder: Path, environment: dict[str, str]) -> tuple[float, float]:
    """Run a scene as a user does; wall and CPU seconds."""
    command = [sys.executable, "-m", "timesim", "run", *row.arguments, "-o", str(folder / row.name), "--force"]
    before, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    seconds, after = time.perf_counter() - wall, resource.getrusage(resource.RUSAGE_CHILDREN)
    (folder / f"{row.name}.txt").write_text(done.stdout)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: exit status {done.returncode}\n{done.stderr}")
    return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


# The claims


@dataclass(frozen=True)
class Claim:
    """A sentence of the README with numbers in it.

    Attributes:
        row: name of the row whose result it is about.
        says: the sentence, white space as a blank, a # for each number.
        gives: the numbers that the result gives, in the order of the sentence.
    """

    row: str
    says: str
    gives: Callable[[Any], Any]


def amplitude(data: Any, cycle: int, axis: str) -> float:
    """Amplitude of the tip at the end of a cycle counted from the last."""
    return float(data["cycle_amplitude"].sel(point="tip", axis=axis)[cycle])


def end_of_phase(data: Any, axis: str, *wanted: int) -> Iterator[float]:
    """Amplitude of the tip at the ends of the last phases of constant frequency, and their frequency."""
    frequency = data["cycle_frequency"].values
    ends = [*np.flatnonzero(np.diff(frequency)), len(frequency) - 1]
    for place in wanted:
        yield float(data["cycle_amplitude"].sel(point="tip", axis=axis)[ends[place]])
        yield float(frequency[ends[place]])


def contact_cycles(data: Any) -> tuple[float, float]:
    """First and last cycle, from 1, in which a contact closes."""
    closes = data["event_time"].values[data["event_from"].values == 2]
    start, period = data["cycle_start"].values[0], data["cycle_period"].values[0]
    return tuple(int((when - start) / period) + 1 for when in (closes[0], closes[-1]))


def unsettled(data: Any) -> np.ndarray:
    """Frequencies at which a sweep in one direction did not settle [Hz]."""
    return data["frequency"].values[data["settled"].squeeze().values == 0]


def peaks(data: Any, preload: float) -> tuple[float, float]:
    """Largest amplitude of x of the time integration's sweep for a preload, and where it is [Hz]."""
    own = data["sweep"].to_dataset()["amplitude"].sel({"contacts.pad.preload": preload, "point": "tip", "axis": "x"})
    values = own.squeeze().values
    return float(values.max()), float(data["sweep"]["frequency"].values[values.argmax()])


def judged(data: Any) -> tuple[int, float]:
    """Points of a comparison with slip or contact for a part of the cycle, and the largest difference there."""
    numbers = re.search(rf"({NUMBER}) points with slip.*?at most ({NUMBER}) of", data.attrs["verdict"])
    assert numbers is not None
    return int(numbers[1]), float(numbers[2])


def folds(data: Any) -> np.ndarray:
    """Folds of the balance, ascending [Hz]."""
    hbm = data["hbm"].to_dataset(inherit=False)
    return np.sort(hbm["frequency"].values[hbm["fold"].values > 0])


CLAIMS: tuple[Claim, ...] = ()


def spaced(text: str) -> str:
    """The text with every stretch of white space as a blank."""
    return re.sub(r"\s+", " ", text)


def off(printed: str, value: float) -> bool:
    """Whether a number differs from a value by more than a unit of its last digit."""
    mantissa, _, exponent = printed.partition("e")
    unit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return not abs(float(printed) - value) <= unit * (1 + 1e-9) * (0 if "." not in printed and not exponent else 1)


def faults(text: str, folder: Path) -> Iterator[str]:
    """What is wrong with the claims, and with the numbers of the tour."""

    @cache
    def result(name: str) -> Any:
        return timesim.open_result(folder / name)

    known, covered = spaced(text), []
    for claim in CLAIMS:
        pattern = re.escape(claim.says).replace(re.escape("#"), f"({NUMBER})")
        found = list(re.finditer(pattern, known))
        if len(found) != 1:
            yield f"the README says {len(found)} times: {claim.says}"
            continue
        covered.append(found[0].span())
        values = np.atleast_1d(np.asarray(claim.gives(result(claim.row)), dtype=float))
        printed = found[0].groups()
        if len(values) != len(printed):
            yield f"{claim.row}: {claim.says}: the result gives {len(values)} numbers"
        for number, value in zip(printed, values, strict=False):
            verdict = "wrong" if off(number, value) else "right"
            print(f"{claim.row:12} {number:>12} {value:14.8g}  {verdict}  {claim.says[:70]}")
            if verdict == "wrong":
                yield f"{claim.row}: {found[0][0]}: {number} is {value:.8g}"
    yield from _unclaimed(known, covered)


def _unclaimed(known: str, covered: list[tuple[int, int]]) -> Iterator[str]:
    """Numbers in what the tour says of its scenes that no claim covers."""
    start = known.index("## A tour by scenes")
    table = known[start : known.index("`timesim check SCENE", start)]
    for cell in re.finditer(r"\| (`timesim run [^|]*)\|([^|]*)\|", table):
        for number in re.finditer(r"(?<![\w.])-?\d[\w.]*", cell[2]):
            place = start + cell.start(2) + number.start()
            if not any(first <= place < last for first, last in covered):
                yield f"nothing checks {number[0]} in: {cell[2].strip()}"


def printed_blocks(text: str, folder: Path) -> Iterator[str]:
    """Lines that the README quotes of the console and that the runs do not print, to a unit of their last digits."""
    said = {path.stem: spaced(path.read_text()) for path in folder.glob("*.txt")}
    for block in re.findall(r"(?:^    .+\n)+", text, re.M):
        lines = block.strip().splitlines()
        if not re.match(r"\s*(two motions|least peak)", lines[0]):
            continue
        for line in lines:
            pattern = re.sub(r"\\?" + NUMBER, f"({NUMBER})", re.escape(line.strip()).replace(r"\-", "-"))
            texts = [match for words in said.values() for match in re.finditer(pattern.replace(r"\ ", " "), words)]
            own = re.findall(NUMBER, line)
            if not any(all(not off(a, float(b)) for a, b in zip(own, found.groups(), strict=True)) for found in texts):
                yield f"no run prints: {line.strip()}"


# The times


def timed(row: Row, folder: Path) -> tuple[float, ...]:
    """Wall and CPU seconds of a first run, nothing compiled, and of a second one."""
    with tempfile.TemporaryDirectory() as empty:
        environment = {**os.environ, "TIMESIM_CACHE": empty}
        return (*run(row, folder, environment), *run(row, folder, environment))


def report(times: dict[str, tuple[float, ...]], load: tuple[float, float]) -> str:
    """The table of the times."""
    lines = [
        f"{os.cpu_count()} processors; load of the machine {load[0]:.1f} before and {load[1]:.1f} after.",
        "",
        "| scene | first run, wall s | CPU s | second run, wall s | CPU s |",
        "|---|---|---|---|---|",
    ]
    for name, numbers in times.items():
        cells = [f"{number:.1f}" for number in numbers]
        for place, limit in ((0, LIMITS[0]), (2, LIMITS[1])):
            cells[place] += " (too long)" if numbers[place] > limit else ""
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the runs")
    parser.add_argument("--check", action="store_true", help="run nothing: compare with the results in DIR")
    parser.add_argument("--times", action="store_true", help="run everything twice and write the table of times")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="run these rows alone")
    options = parser.parse_args()
    text, load = README.read_text(), os.getloadavg()[0]
    options.output.mkdir(parents=True, exist_ok=True)
    times = {}
    for row in rows(text):
        if options.check or (options.only and row.name not in options.only):
            continue
        if options.times:
            times[" ".join(row.arguments)] = timed(row, options.output)
        else:
            run(row, options.output, dict(os.environ))
        print(
            f"{row.name:12} {' '.join(f'{number:.1f}' for number in times.get(' '.join(row.arguments), ()))}",
            flush=True,
        )
    if options.times:
        table = report(times, (load, os.getloadavg()[0]))
        print(table)
        if not options.only:
            before, _, rest = REPORT.read_text().partition(MARKS[0])
            REPORT.write_text(f"{before}{MARKS[0]}\n\n{table}\n\n{MARKS[1]}{rest.partition(MARKS[1])[2]}")
    wrong = [*faults(text, options.output), *printed_blocks(text, options.output)]
    for fault in wrong:
        print(f"WRONG  {fault}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
