"""Which guess leads Newton's method to a first solution, on structures that nobody has seen?

    python benchmarks/first_guess.py --seeds 100:140

The structures and loads of benchmarks/generated.py. At five frequencies of each range the guesses of
`timesim.hbm.first_guess` are tried in turn, by 13 harmonics and 256 samples, until one leads to a solution. A row a
structure, then how often it was which; in brackets CPU seconds, those of compiling among them.
"""

import argparse
import time
from collections import Counter

import numpy as np
from generated import STRUCTURE, loaded, span_of

from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Controls, solve
from timesim.hbm.first_guess import first_guesses
from timesim.hbm.scheme import Scheme
from timesim.model.model import Model

FREQUENCIES, SCHEME = 5, Scheme(13, 256)
KINDS = {"the linear": "linear", "a load": "load", "time": "march"}


def first(model: Model, frequency: float) -> tuple[str, float]:
    """The kind of guess that leads to a solution, and CPU seconds until it is known."""
    begin, balance = time.process_time(), Balance(model, frequency, SCHEME)
    for way, guess in first_guesses(balance, frequency, Controls()):
        if guess is not None and solve(balance, guess, frequency, Controls()) is not None:
            kind = next(kind for start, kind in KINDS.items() if way.startswith(start))
            return kind, time.process_time() - begin
    return "none", time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="100:140", help="first and one behind the last")
    kinds = Counter[str]()
    for seed in range(*map(int, parser.parse_args().seeds.split(":"))):
        model, free = STRUCTURE(seed)
        frequencies = np.geomspace(*span_of(model, free), FREQUENCIES)
        model = loaded(model, frequencies)
        found = [first(model, float(frequency)) for frequency in frequencies]
        kinds.update(kind for kind, _ in found)
        print(f"{seed}: " + ", ".join(f"{kind} ({seconds:.1f})" for kind, seconds in found), flush=True)
    print(", ".join(f"{kind} {number}" for kind, number in kinds.most_common()))


if __name__ == "__main__":
    main()
