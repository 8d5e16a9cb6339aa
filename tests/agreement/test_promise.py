"""The promise of the presets and the estimated error on generated structures, whose seeds were chosen after both."""

import runpy
from functools import cache
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.long

BENCHMARK = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "promise.py"))
SEEDS = range(4000, 4020)


@cache
def runs() -> list[dict[str, Any]]:
    return [row for size in BENCHMARK["SIZES"] for seed in SEEDS for row in BENCHMARK["rows"](seed, size)]


@pytest.mark.slow
def test_estimate_is_within_a_factor_of_ten_on_nine_of_ten() -> None:
    known = [row for row in runs() if row["sure"] < 0.1 * row["true"]]
    near = [row for row in known if 0.1 < row["estimated"] / row["true"] < 10]
    assert len(known) >= 60
    assert len(near) >= 0.9 * len(known)


@pytest.mark.slow
def test_promise_is_kept_or_its_breach_is_said() -> None:
    judged = [row for row in runs() if row["sure"] < 0.3 * row["promised"]]
    broken = [row for row in judged if row["true"] > row["promised"]]
    print(*broken, sep="\n")
    assert len(judged) >= 60
    assert len(broken) <= 0.03 * len(judged)
