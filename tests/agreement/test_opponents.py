"""The scipy opponent of the benchmarks gives the reference states and transitions (this needs no numba)."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
CASES = {"osc_n0=3_f=1.39": (3.0, 1.39), "osc_n0=-1_f=0.97": (-1.0, 0.97), "osc_n0=5_f=1.52": (5.0, 1.52)}


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    yield importlib.import_module
    for name in ("problems", "opponents_scipy"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("name", CASES)
def test_scipy_opponent_meets_the_reference(load, name: str):
    scipy_opponent: ModuleType = load("opponents_scipy")
    case = json.loads((ROOT / "tests" / "data" / "oscillator.json").read_text())["cases"][name]
    preload, frequency = CASES[name]
    model = load("problems").oscillator(preload)

    run = scipy_opponent.simulate(model, frequency, case["cycles"], rtol=1e-8, log=True)

    truth = np.array(case["state_end"])
    assert np.abs(np.concatenate([run.q, run.qdot]) - truth).max() < 2e-7 * np.abs(truth).max()
    assert run.num_events == case["n_events"]
    assert run.state.tolist() == case["modes_end"]
    first = np.array(case["events"])
    mine = np.array(run.events)[: len(first)]
    np.testing.assert_allclose(mine[:, 0], first[:, 0], atol=1e-6)
    np.testing.assert_array_equal(mine[:, 1:3], first[:, 1:])


def test_many_contacts_stick_slip_and_separate(load):
    """The problem is worth timing: in cycles 3 to 6 no contact is idle, and three of five separate."""
    problems = load("problems")
    frequency = problems.MANY_CONTACTS_FREQUENCY
    run = load("opponents_scipy").simulate(problems.many_contacts(), frequency, 6, rtol=1e-6, log=True)

    start, end = 2 / frequency, 6 / frequency
    share = np.zeros((5, 3))
    since = np.zeros(5)
    for time, contact, left, _ in [*run.events, *((end, c, run.state[c], -1) for c in range(5))]:
        share[contact, left] += max(time - max(since[contact], start), 0.0) / (end - start)
        since[contact] = time

    np.testing.assert_allclose(share.sum(axis=1), 1.0)
    assert ((share[:, 1] > 0.05) & (share[:, 1] < 0.97)).all(), share
    assert (share[:, 2] > 0.03).sum() == 3, share
    assert run.num_events > 6 * 12
