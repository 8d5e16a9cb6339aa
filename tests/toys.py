"""Work in chunks whose results are known: what tests of campaigns run, here and in processes that are killed."""

import hashlib
import itertools
import math
import os
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from timesim.result.dataset import dataset
from timesim.scene.resolution import Scene
from timesim.study.execution.campaign import Chunk, Execution, carry_through
from timesim.study.execution.worker import UnfinishedError, halted
from timesim.study.outcome import Outcome, attributes

SCENE = "title: toy\nstudy: {kind: sweep, frequency: {from: 0.8, to: 1.6, step: 0.1}}\n"


@dataclass(frozen=True)
class Toy:
    """One chunk's work: a few steps of a map without stable orbits, which no rounding forgives.

    Attributes:
        name: of the chunk, for the log.
        start: start of the map where no chunk comes before.
        seconds: how long it takes.
        log: file that gets the name when the work begins.
        fault: "raise", "interrupt", "kill" (once: `log` with the suffix .killed says it has happened), "halt", "stay"
            until it is halted, "part", which then says what there is of it, or "deaf" until `log` with the suffix .over
            is there.
    """

    name: str
    start: np.ndarray
    seconds: float = 0.0
    log: Path | None = None
    fault: str = ""


def work(toy: Toy, before: Mapping[str, np.ndarray] | None) -> dict[str, np.ndarray]:
    if toy.log is not None:
        with toy.log.open("a") as stream:
            stream.write(f"{toy.name}\n")
    _fail(toy)
    if next(BEGUN) >= LAST:
        time.sleep(120)
        raise TimeoutError("nobody has killed this process")
    time.sleep(toy.seconds)
    x = toy.start if before is None else before["x"]
    for _ in range(50):
        x = 3.99 * x * (1 - x)
    return {"x": x, "first": x[0], "settled": x > 0.5, "name": np.array(toy.name)}


def _fail(toy: Toy) -> None:
    if toy.fault == "raise":
        raise ArithmeticError(f"{toy.name} has no solution")
    if toy.fault == "interrupt":
        os.kill(os.getpid(), signal.SIGINT)
    if toy.fault == "halt":
        os.kill(os.getpid(), signal.SIGINT)
    if toy.fault in ("halt", "stay"):
        while not halted():
            time.sleep(0.001)
        raise KeyboardInterrupt
    if toy.fault == "part":
        while not halted():
            time.sleep(0.001)
        raise UnfinishedError({"x": toy.start}, 1)
    while toy.fault == "deaf" and not Path(f"{toy.log}.over").exists():
        time.sleep(0.01)
    if toy.fault == "kill" and not (mark := Path(f"{toy.log}.killed")).exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)


def chains(
    count: int, length: int, *, seconds: float = 0.0, log: Path | None = None, faults: Mapping[str, str] | None = None
) -> list[Chunk]:
    """Chunks c-CHAIN-LINK, each of two points, with what goes wrong by name."""
    made = []
    for chain in range(count):
        start = np.random.default_rng(chain).uniform(size=5)
        for link in range(length):
            name, after = f"c-{chain}-{link}", f"c-{chain}-{link - 1}" if link else None
            toy = Toy(name, start, seconds, log, (faults or {}).get(name, ""))
            made.append(Chunk(name, toy, after, size=2))
    return made


def expected(chunks: Sequence[Chunk]) -> dict[str, dict[str, np.ndarray]]:
    """The results, computed without the campaign."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for chunk in chunks:
        clean = Toy(chunk.payload.name, chunk.payload.start)
        found[chunk.name] = work(clean, found[chunk.after] if chunk.after else None)
    return found


def digest(results: Mapping[str, Mapping[str, np.ndarray]]) -> str:
    """Of every bit of the results and of their order."""
    found = hashlib.sha256()
    for name, result in results.items():
        for key, array in result.items():
            array = np.asarray(array)
            found.update(f"{name} {key} {array.dtype.str} {array.shape}".encode() + array.tobytes())
    return found.hexdigest()


def study(scene: Scene, execution: Execution) -> Outcome:
    """Stands for a study in chunks: one chain over the frequencies of a sweep."""
    frequency = scene.plan.frequency
    fault = {f"c-0-{FAULTY[1]}": FAULTY[0]} if FAULTY else {}
    chunks = chains(1, len(frequency), faults=fault)
    results, reason = carry_through(chunks, work, execution, identity=scene.resolved_yaml())
    values = [float(results[chunk.name]["first"]) if chunk.name in results else np.nan for chunk in chunks]
    about = attributes(scene, "toy", 0.0, 0.0, reason)
    made = dataset({"cycles": (("frequency",), np.array(values))}, {"frequency": frequency}, about)
    return Outcome({"": made}, reason)


FAULTY: list[Any] = []
"""What goes wrong in `study`, and in which link."""

BEGUN = itertools.count()
LAST: float = math.inf
"""Chunks that this process goes on with; those begun after them never come to an end."""


def main(folder: str, resume: str, last: str) -> None:
    """A campaign in a process of its own."""
    global LAST
    LAST = float(last)
    chunks = chains(5, 16, seconds=0.01, log=Path(folder) / "log.txt")
    print("begun", flush=True)
    execution = Execution(folder=Path(folder), resume=resume == "resume", workers=2, notice=lambda text: None)
    results, reason = carry_through(chunks, work, execution, identity=SCENE)
    print(reason, digest(results))


if __name__ == "__main__":
    main(*sys.argv[1:])
