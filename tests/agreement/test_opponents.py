"""The opponents of the benchmarks are right, each to its order; those in numba are tested where it is."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
CASES = {"osc_n0=3_f=1.39": (3.0, 1.39), "osc_n0=-1_f=0.97": (-1.0, 0.97), "osc_n0=5_f=1.52": (5.0, 1.52)}


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    yield importlib.import_module
    for name in [name for name in sys.modules if name == "problems" or name.startswith("opponents")]:
        sys.modules.pop(name)


@pytest.mark.parametrize("name", CASES)
def test_scipy_opponent_meets_the_reference(load, name: str):
    scipy_opponent: ModuleType = load("opponents.scipy_events")
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
    run = load("opponents.scipy_events").simulate(problems.many_contacts(), frequency, 6, rtol=1e-6, log=True)

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


def test_scipy_as_most_write_it_meets_the_one_with_events(load):
    """Its error is that of the places where a contact stops slipping, which it steps over."""
    problems = load("problems")
    model = problems.oscillator(3.0)
    truth = load("opponents.scipy_events").simulate(model, 1.39, 3, rtol=1e-8)

    run = load("opponents.scipy_plain").simulate(model, 1.39, 3, method="RK45", rtol=1e-6, steps_per_cycle=50)

    assert truth.num_events > 5
    assert problems.error(run, truth) < 1e-4
    np.testing.assert_allclose(run.slip, truth.slip, atol=1e-4 * np.abs(truth.slip).max())
    assert run.state.tolist() == truth.state.tolist()


@pytest.mark.slow
@pytest.mark.parametrize(("preload", "frequency"), [(3.0, 1.39), (-1.0, 0.97)])
def test_opponents_in_numba_meet_the_others_at_their_order(load, preload: float, frequency: float):
    pytest.importorskip("numba")
    problems = load("problems")
    what = (problems.oscillator(preload), frequency, 6)
    truth = load("opponents.scipy_events").simulate(*what, rtol=1e-11, lag=3e-5)

    def error(name: str, settings: dict[str, float]) -> float:
        module, _, function = name.rpartition(".")
        return float(problems.error(getattr(load(module), function)(*what, **settings), truth))

    assert truth.num_events >= 10
    for name, finest, order in (
        ("opponents.numba_rk4.simulate", 400, 3.0),
        ("opponents.capture.capture", 3200, 1.0),
        ("opponents.capture.regularised", 12800, 1.0),
    ):
        coarse, fine = (error(name, {"steps_per_cycle": n}) for n in (finest // 4, finest))
        assert np.log(coarse / fine) / np.log(4) > order - 0.3, (name, coarse, fine)
    for rtol in (1e-4, 1e-6, 1e-8):
        assert error("opponents.tsit5.simulate", {"rtol": rtol}) < 30 * rtol


@pytest.mark.slow
def test_cvode_meets_the_others(load):
    pytest.importorskip("sksundae")
    problems = load("problems")
    what = (problems.oscillator(-1.0), 0.97, 6)
    run = load("opponents.cvode").simulate(*what, rtol=1e-8)
    assert problems.error(run, load("opponents.scipy_events").simulate(*what, rtol=1e-10)) < 1e-6
