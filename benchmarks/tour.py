"""Does the README's tour say what the scenes give, and how long does each scene take on a first and on a second run?

Run `python benchmarks/tour.py -o DIR`. Every command of the tour is run into DIR, then each claim of the README is
compared with the results: the numbers are read from README.md, so that text and check cannot part. A number is wrong
where it is not that of the result to its printed digits, or where the README no longer says the sentence; a number of
the tour that no claim covers is wrong too. Exit status 1 if anything is wrong.

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
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from timesim.model.model import SEPARATION, SLIP, STICK
from timesim.result.netcdf import read

ROOT = Path(__file__).parents[1]
README, REPORT = ROOT / "README.md", ROOT / "benchmarks" / "README.md"
MARKS = ("<!-- times of the tour -->", "<!-- end of the times -->")
LIMITS = (60.0, 30.0)  # seconds of a first and a second run that are wanted
OF_THE_PAPER = r"Table \d+|\d-DOF|figures? \d+(?:, \d+)*|\(\d\)"  # numbers that name something
SLIPS = "points with slip, or contact for a part of the cycle"
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
class Result:
    """What a run has left: the Datasets of its groups, what it has printed, and the number of its pictures."""

    groups: Mapping[str, Any]
    said: str
    pictures: int

    def printed(self, pattern: str) -> list[float]:
        """The numbers that the groups of a pattern match in what was printed; none where it does not match."""
        found = re.search(pattern, self.said)
        return [float(number) for number in found.groups()] if found else []


@dataclass(frozen=True)
class Claim:
    """A sentence of the README, with numbers in it or without.

    Attributes:
        row: name of the row whose result it is about.
        says: the sentence, white space as a blank, a # for each number.
        gives: the numbers that the result gives, in the order of the sentence; of one without, whether it is so.
    """

    row: str
    says: str
    gives: Callable[[Result], Any]


def of_run(result: Result) -> Any:
    """The Dataset of a study of one run, or the root of a result with groups."""
    return result.groups[""]


def size(result: Result) -> tuple[int, int]:
    """Cycles and transitions of a run."""
    return of_run(result).sizes["cycle"], of_run(result).sizes["event"]


def contact_cycles(result: Result) -> tuple[int, int]:
    """First and last cycle in which a contact closes; nothing unless it is open at the end."""
    data = of_run(result)
    closes = data["event_time"].values[data["event_from"].values == SEPARATION]
    if data["event_to"].values[-1] != SEPARATION:
        return ()
    first, last = np.searchsorted(data["cycle_start"].values, [closes[0], closes[-1]], side="right")
    return int(first), int(last)


def swings(result: Result) -> tuple[float, ...]:
    """A frequency, and the gearbox's amplitude there with the largest and the middle preload of the clutch."""
    at = of_run(result).sel(point="gearbox", axis="x").isel(direction=0, frequency=10)
    shares, drifts = at["slip_share"].values.squeeze(), at["drift"].values
    if not (shares[1] > 0.5 and shares[2] < 0.25 and drifts[1]):
        return ()
    return at["frequency"].item(), *at["amplitude"].values[:0:-1]


def schedule(result: Result) -> tuple[float, ...]:
    """Amplitude of x and frequency at the ends of the recorded phases, the amplitude alone at that of the last."""
    data = of_run(result)
    frequency, amplitude = data["cycle_frequency"].values, data["cycle_amplitude"].sel(point="tip", axis="x").values
    upper, lower, last = (*np.flatnonzero(np.diff(frequency))[-2:], len(frequency) - 1)
    return amplitude[upper], frequency[upper], amplitude[lower], frequency[lower], amplitude[last], frequency[last]


def written(result: Result, key: str) -> float:
    """The number of the first key of this name in the scene."""
    found = re.search(rf"{key}: ({NUMBER})", of_run(result).attrs["scene"])
    assert found is not None
    return float(found[1])


def unsettled(result: Result) -> tuple[float, ...]:
    """Span of a sweep in one direction, where no point settles any more, and the budget.

    Nothing where a point before does not settle.
    """
    data = of_run(result)
    frequency, settled = (data[name].values.ravel() for name in ("frequency", "settled"))
    from_here = int(np.flatnonzero(settled)[-1]) + 1
    if not settled[:from_here].all():
        return ()
    return frequency[0], frequency[-1], frequency[from_here], written(result, "max_cycles")


def states(result: Result) -> set[int]:
    """Contact states of a prescribed motion's cycle."""
    return set(map(int, of_run(result)["state"].values))


def jumps(result: Result) -> tuple[float, float]:
    """Where the motions of a sweep up and of one down are lost: the frequencies next to it where each still is."""
    data = of_run(result)
    up, down = (data.sel(direction=name) for name in ("up", "down"))
    return float(down["jump_high"].squeeze()), float(up["jump_low"].squeeze())


def doubled(result: Result) -> tuple[float, ...]:
    """The point of a sweep that is of several cycles: frequency, cycles, amplitude, and that of the balance there."""
    sweep, hbm = result.groups["sweep"].isel(direction=0), result.groups["hbm"]
    (at,) = np.flatnonzero(sweep["period"].values > 1)
    frequency, largest = sweep["frequency"].values[at], hbm["amplitude"].max(("point", "axis")).values
    stable, height = (np.interp(frequency, hbm["frequency"].values, y) for y in (hbm["stable"].values, largest))
    return frequency, sweep["period"].values[at], sweep["amplitude"].values[at].max(), 0 if stable else height


def folds(result: Result) -> np.ndarray:
    """Folds of the balance, ascending [Hz]."""
    hbm = result.groups["hbm"]
    return np.sort(hbm["frequency"].values[hbm["fold"].values > 0])


def scheme(result: Result) -> tuple[float, ...]:
    """Harmonics of a comparison, points that prove something, and the largest difference there."""
    judged = rf"(\d+) {SLIPS}, they differ by at most ({NUMBER}) "
    return (*result.printed(r"(\d+) harmonics"), *result.printed(judged))


CLAIMS = (
    Claim("a", "near its best preload: # cycles, # transitions", size),
    Claim("b", "it closes for a part of cycles # to #, then stays open", contact_cycles),
    Claim("blade", "with two shroud contacts: # cycles, # transitions", size),
    Claim("figure11", "for nine preloads, and the jump at n0 = #,", lambda result: written(result, "preload")),
    Claim("f12", "a jump at n0 = # by the paper's schedule", lambda result: written(result, "preload")),
    Claim(
        "f12",
        "upper branch, # at # Hz; jump to # at # Hz; stays on the lower one, #, when # Hz is set again",
        schedule,
    ),
    Claim(
        "response",
        "the blade from # to # Hz: a broad top between the free and the stuck resonance; from # Hz on the motion does "
        "not settle in # cycles and is marked so, with the band of its amplitude",
        unsettled,
    ),
    Claim(
        "disk",
        "but at # Hz, where the motion is unstable and repeats after # cycles instead, by # in place of # mm",
        doubled,
    ),
    Claim("clutch", "at # Hz the gearbox swings by # rad under a clutch that sticks nearly always, by # under", swings),
    Claim("two", "up and down differ between # and # Hz", jumps),
    Claim("two", "Hz, both jumps bisected", lambda result: of_run(result).attrs["jumps_bisected"]),
    Claim(
        "a", "leaves `result.nc` (NetCDF-4; xarray opens it), seven pictures and", lambda result: result.pictures == 7
    ),
    Claim("f4", "stick and slip (figure 4 of the paper)", lambda result: states(result) == {STICK, SLIP}),
    Claim("figure5", "with separation (5)", lambda result: states(result) == {STICK, SLIP, SEPARATION}),
    Claim("f7", "over two amplitudes, with a preload", lambda result: written(result, "preload") > 0),
    Claim("figure8", "with a preload and with a gap (figures 7, 8)", lambda result: written(result, "preload") < 0),
    Claim(
        "f10",
        "| # harmonics; at # points with slip, or contact for a part of the cycle, both methods differ by at most #",
        scheme,
    ),
    Claim(
        "f10",
        "| n0 = 3: # (n0 = 5: #) |",
        lambda result: [
            *result.printed(rf"preload 3: peak ({NUMBER})"),
            *result.printed(rf"preload 5: peak ({NUMBER})"),
        ],
    ),
    Claim(
        "f10",
        "| fully stuck, peak # at # Hz |",
        lambda result: result.printed(
            rf"preload 32: peak ({NUMBER}) of tip x at ({NUMBER}) Hz; no fold.*full stick throughout"
        ),
    ),
    Claim("figure11", "# Hz, a fold; swept up, the motion is lost there", lambda result: folds(result)[-1]),
    Claim("figure11", "# Hz, a fold; swept down, the motion lives to it", lambda result: folds(result)[0]),
    Claim(
        "softening",
        "a range of a quarter of its steps' width (# to # Hz, in steps of # Hz)",
        lambda result: [
            *of_run(result)["range"].values.ravel(),
            *np.diff(result.groups["sweep"]["frequency"].values)[:1],
        ],
    ),
)
"""What the README says of the results; what it quotes of the console is compared in `printed_blocks`."""


def spaced(text: str) -> str:
    """The text with every stretch of white space as a blank."""
    return re.sub(r"\s+", " ", text)


def off(printed: str, value: float) -> bool:
    """Whether a number is not the value to its printed digits; a whole number is exact."""
    mantissa, _, exponent = printed.partition("e")
    unit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return not abs(float(printed) - value) <= (0.51 * unit if "." in printed or exponent else 0.0)


def sentence(claim: Claim, known: str) -> re.Match[str] | None:
    """Where the README says it; nothing unless it does so once."""
    pattern = re.escape(claim.says).replace(re.escape("#"), f"({NUMBER})")
    found = list(re.finditer(pattern, known))
    return found[0] if len(found) == 1 else None


def faults_of_the_text(text: str) -> Iterator[str]:
    """Claims that the README does not make, and numbers in what the tour says of its scenes that no claim covers."""
    known = spaced(text)
    found = {claim.says: sentence(claim, known) for claim in CLAIMS}
    yield from (f"the README does not say once: {says}" for says, place in found.items() if place is None)
    covered = [place.span() for place in found.values() if place is not None]
    start = known.index("## A tour by scenes")
    table = known[start : known.index("`timesim check SCENE", start)]
    for cell in re.finditer(r"\| (`timesim run [^|]*)\|([^|]*)\|", table):
        kept = re.sub(OF_THE_PAPER, lambda name: "." * len(name[0]), cell[2])
        for number in re.finditer(r"(?<![\w.])-?\d[\w.]*", kept):
            place = start + cell.start(2) + number.start()
            if not any(first <= place < last for first, last in covered):
                yield f"nothing checks {number[0]} in: {cell[2].strip()}"


def faults_of_the_results(text: str, folder: Path, only: Sequence[str]) -> Iterator[str]:
    """Claims that the results do not bear out: those of some rows, of all by default."""

    @cache
    def result(name: str) -> Result:
        if not (printed := folder / f"{name}.txt").exists():
            sys.exit(f"{folder} has no run of {name}: run it without --check, or with --only {name}")
        said = spaced(printed.read_text())
        return Result(read(folder / name), said, len(list((folder / name).glob("*.png"))))

    for claim in (claim for claim in CLAIMS if not only or claim.row in only):
        found = sentence(claim, spaced(text))
        printed = (found.groups() or ("1",)) if found else ()  # 1: true
        values = np.atleast_1d(np.asarray(claim.gives(result(claim.row)), dtype=float))
        if len(values) != len(printed):
            yield f"{claim.row}: {claim.says}: the result gives {len(values)} numbers, the README {len(printed)}"
        for number, value in zip(printed, values, strict=False):
            verdict = "wrong" if off(number, value) else "right"
            print(f"{claim.row:12} {number:>12} {value:14.8g}  {verdict}  {claim.says[:70]}")
            if verdict == "wrong":
                yield f"{claim.row}: {claim.says}: {number} is {value:.8g}"


def printed_blocks(text: str, folder: Path) -> Iterator[str]:
    """Lines that the README quotes of the console and that no run prints, to their printed digits."""
    said = [spaced(path.read_text()) for path in folder.glob("*.txt")]
    for block in re.findall(r"(?:^    .+\n)+", text, re.M):
        lines = [line.strip() for line in block.splitlines()]
        for line in lines if re.match("two motions|least peak", lines[0]) else ():
            pattern = f"({NUMBER})".join(map(re.escape, re.split(NUMBER, line)))
            found = (match.groups() for words in said for match in re.finditer(pattern, words))
            quoted = re.findall(NUMBER, line)
            right = any(not any(map(off, quoted, map(float, numbers))) for numbers in found)
            print(f"console      {'right' if right else 'wrong'}  {line}")
            if not right:
                yield f"no run prints: {line}"


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
    parser.add_argument("--only", nargs="+", metavar="NAME", default=(), help="run and check these rows alone")
    options = parser.parse_args()
    text, load = README.read_text(), os.getloadavg()[0]
    options.output.mkdir(parents=True, exist_ok=True)
    times = {}
    if options.times:  # as pip leaves it: else a run compiles a thousand modules where Python is told to keep none
        folders = (str(ROOT / "timesim"), sysconfig.get_path("purelib"))
        subprocess.run([sys.executable, "-m", "compileall", "-q", *folders], stdout=subprocess.DEVNULL)
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
    said = [faults_of_the_results(text, options.output, options.only)]
    if not options.only:
        said.append(printed_blocks(text, options.output))
    wrong = [*faults_of_the_text(text), *chain(*said)]
    for fault in wrong:
        print(f"WRONG  {fault}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
