"""Transients and steady amplitudes against closed forms and computations by other codes.

The states at the end, the transitions and the amplitudes of `tests/data` come from DOP853 with located events; the
steady amplitudes from closed forms and from time integration by other codes (see `tests/systems.py`).
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulation import FINE, REFERENCE, Trace, follow, relative_error, simulate, slip_share
from systems import (
    circular,
    circular_radius,
    den_hartog,
    den_hartog_amplitude,
    inclined,
    jenkins,
    two_degrees,
)

from timesim.engine.trajectory import Phase, Run
from timesim.model.choice import choice
from timesim.model.cost import Work
from timesim.model.model import STATE_NAMES, Model
from timesim.model.solver import PRESETS, Solver
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

DATA = Path(__file__).parents[1] / "data"
CONFIGS = Path(__file__).parents[2] / "configs"
ALLOWED = {"reference": 1e-8, "standard": 1e-6, "draft": 1e-4}
# Of many modes; the reference has 13 stages, which take twice as long to compile as seven.
SOLVERS = [
    pytest.param(FINE, id="fine"),
    pytest.param(REFERENCE, id="reference", marks=pytest.mark.slow),
    pytest.param(Solver("exponential", 1e-9, 1e-11), id="exponential", marks=pytest.mark.slow),
]


COLLOCATION = Solver("exponential", 1e-8, 1e-10)


def truth(name: str) -> dict[str, Any]:
    return json.loads((DATA / name).read_text())


# --- the oscillator of Table 1, by every preset ---

OSCILLATOR = {
    "osc_n0=3_f=1.39": (3, 1.39, 235),
    "osc_n0=-1_f=0.97": (-1, 0.97, 119),
    "osc_n0=5_f=1.52": (5, 1.52, 232),
}


def oscillator(case: str) -> Model:
    preload, frequency, _ = OSCILLATOR[case]
    changes = {"contacts.pad.preload": preload, "excitation.frequency": frequency}
    return load_scene(CONFIGS / "oscillator.yaml", changes).model()


@pytest.mark.parametrize("accuracy", list(ALLOWED))
@pytest.mark.parametrize("case", list(OSCILLATOR))
def test_oscillator_of_table_1(case: str, accuracy: str) -> None:
    true, trace = truth("oscillator.json")["cases"][case], simulate(oscillator(case), 60, PRESETS[accuracy])
    error = relative_error(trace.motion, true["state_end"])
    print(f"{case}, {accuracy}: error {error:.1e}, {trace.num_steps / 60:.0f} steps a cycle")
    assert error < ALLOWED[accuracy]
    assert len(trace.log.time) == true["n_events"] == OSCILLATOR[case][2]
    np.testing.assert_array_equal(trace.run.state, true["modes_end"])
    first = np.array(true["events"])
    np.testing.assert_array_equal(trace.log.contact[: len(first)], first[:, 1])
    np.testing.assert_array_equal(trace.log.before[: len(first)], first[:, 2])
    if accuracy == "reference":
        np.testing.assert_allclose(trace.log.time[: len(first)], first[:, 0], atol=1e-7, rtol=0)


@pytest.mark.parametrize("case", list(OSCILLATOR))
def test_amplitude_of_the_oscillator(case: str) -> None:
    """The reference is the largest of 4000 samples a cycle: good to 1e-6, and never too large."""
    true = truth("oscillator.json")["cases"][case]["amplitude"]
    amplitude = simulate(oscillator(case), 61, REFERENCE).amplitude[60, 0]
    np.testing.assert_allclose(amplitude, true, rtol=1e-6)
    assert np.all(amplitude > np.array(true) * (1 - 1e-9))


def test_settled_amplitudes_of_the_oscillator() -> None:
    for case, amplitude in zip(OSCILLATOR, (0.15612878, 0.28839155, 0.15680399), strict=True):
        last = simulate(oscillator(case), 400, PRESETS["standard"]).amplitude[-1, 0, 0]
        assert last == pytest.approx(amplitude, abs=6e-9 + 1e-7 * amplitude)


@pytest.mark.parametrize("case", list(OSCILLATOR))
def test_oscillator_by_collocation(case: str) -> None:
    true, trace = truth("oscillator.json")["cases"][case], simulate(oscillator(case), 60, COLLOCATION)
    assert relative_error(trace.motion, true["state_end"]) < 1e-7
    assert len(trace.log.time) == true["n_events"]
    first = np.array(true["events"])
    assert [row[:2] for row in trace.sequence[: len(first)]] == [tuple(row) for row in first[:, 1:].astype(int)]
    np.testing.assert_allclose(trace.log.time[: len(first)], first[:, 0], atol=1e-6, rtol=0)
    assert trace.energy_residual < 1e-7


# --- 20 modes and three contacts ---


@pytest.mark.parametrize("solver", SOLVERS)
def test_twenty_modes_and_three_contacts(solver: Solver) -> None:
    true = truth("many_modes_truth.json")
    trace = simulate(load_scene(DATA / "many_modes.yaml").model(), true["cycles"], solver)
    first = np.array(true["events"])
    assert len(trace.log.time) == true["n_events"] == 328
    assert trace.sequence[: len(first)] == [tuple(row) for row in first[:, 1:].astype(int)]
    np.testing.assert_allclose(trace.log.time[: len(first)], first[:, 0], atol=1e-7, rtol=0)
    np.testing.assert_array_equal(trace.run.state, true["modes_end"])
    assert relative_error(trace.motion, true["state_end"]) < 1e-7
    assert trace.energy_residual < 1e-8


# --- the blade: newtons, metres, two shroud contacts ---

SOURCES = ("blade_modes.yaml", "blade.npz", "blade.mat")


@cache
def blade_truth() -> dict[str, Any]:
    return truth("blade_truth.json")["cases"]


def blade(case: str, source: str, **more: Any) -> Model:
    given = {key: value for key, value in blade_truth()[case]["set"].items() if value is not None}
    changes = given | more
    if source.endswith(".yaml"):
        return load_scene(DATA / source, changes).model()
    return load_scene(DATA / "blade_matrices.yaml", changes | {"structure.file": source}).model()


def assert_agrees(trace: Trace, case: str, *, state: float, velocity: float, time: float) -> None:
    """Compare with the truth of a case: states relative to the largest, times but one to ``time`` [cycles]."""
    true, model = blade_truth()[case]["transient"], trace.run.model
    names = [contact.name for contact in model.contacts]
    for kind, own, allowed in (
        ("displacement", trace.run.displacement, state),
        ("velocity", trace.run.velocity, velocity),
    ):
        found = np.einsum("pam,m->pa", model.structure.shape, own)
        error = relative_error(found, [true[f"final_{kind}"][p] for p in model.structure.points])
        print(f"{case}, {trace.run.solver}: {kind} to {error:.1e}")
        assert error < allowed
    slip = np.array(true["final_slip"])
    assert relative_error(trace.run.slip, slip) < 10 * state
    assert [STATE_NAMES[s] for s in trace.run.state] == true["final_contact_state"]
    sequence = [(names[c], STATE_NAMES[b], STATE_NAMES[a]) for c, b, a in trace.sequence]
    assert sequence[:10] == [tuple(event[2:]) for event in true["first_events"]]
    assert len(sequence) == true["events"]
    assert sequence[-1] == tuple(true["last_event"][2:])
    late = np.abs(trace.log.time * blade_truth()[case]["frequency"] - true["all_event_cycles"])
    # One time of the truth itself moves by 4e-7 (all modes: 7e-7) cycles with its tolerance; the states do not.
    assert np.sort(late)[-2] < time
    assert late.max() < 1e-6 + time
    last = np.array(true["last_cycle"]["amplitude"])
    assert relative_error(trace.amplitude[-1, model.structure.points.index("tip")], last) < 1e-6


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize(
    ("case", "count"), [("slip_720Hz", 625), ("separation_640Hz", 623)], ids=["slips", "separates"]
)
def test_blade(case: str, count: int, source: str, solver: Solver) -> None:
    trace = simulate(blade(case, source), 80, solver)
    assert len(trace.log.time) == count
    assert_agrees(trace, case, state=1e-7, velocity=1e-7, time=1e-8)
    assert trace.energy_residual < 1e-8


def test_blade_slips_by_the_shares_of_the_truth() -> None:
    """So that the agreement is not one of a stuck blade; a share of the truth is a count of 4000 samples."""
    for case in ("slip_720Hz", "separation_640Hz"):
        true = blade_truth()[case]["transient"]["last_cycle"]["share_stick_slip_separation"]
        trace = simulate(blade(case, "blade_modes.yaml"), 80, FINE)
        slip = slip_share(trace, 79 / blade_truth()[case]["frequency"])
        np.testing.assert_allclose(slip, [true["left"][1], true["right"][1]], atol=1e-3)
        assert np.any((slip > 0.05) & (slip < 0.95))


@pytest.mark.slow
def test_blade_with_all_modes_by_the_method_of_a_short_run() -> None:
    """331 kHz: the stiff one, at the steps that stability asks for; the fastest modes are the least exact."""
    model = blade("all_24_modes_720Hz", "blade.npz", **{"structure.keep_modes": 24})
    short = Work.of_run(((720.0, 20),), estimated=True)
    assert (choice("standard", model, short, 100_000).solver.name, model.structure.num_modes) == ("tsit5", 24)
    trace = simulate(model, 20, PRESETS["standard"])
    assert len(trace.log.time) == 151
    assert_agrees(trace, "all_24_modes_720Hz", state=1e-5, velocity=1e-3, time=5e-5)


@pytest.mark.slow
def test_blade_with_all_modes_by_collocation() -> None:
    """It knows the fastest modes exactly: where explicit steps leave 1e-5 and 1e-3 it leaves 1e-10 and 3e-9."""
    model = blade("all_24_modes_720Hz", "blade.npz", **{"structure.keep_modes": 24})
    trace = simulate(model, 20, Solver("exponential", 1e-10, 1e-12))
    assert len(trace.log.time) == 151
    assert_agrees(trace, "all_24_modes_720Hz", state=1e-8, velocity=1e-7, time=1e-6)


# --- steady amplitudes: closed forms and other codes ---


def steady(model: Model, cycles: int, *, settled: float = 1e-8) -> np.ndarray:
    """Amplitude along x, y, z of the last cycle, which is that of the cycle ten before: the motion has settled."""
    amplitude = simulate(model, cycles, FINE).amplitude[:, 0]
    np.testing.assert_allclose(amplitude[-1], amplitude[-11], rtol=settled)
    return amplitude[-1]


@pytest.mark.parametrize(
    ("force", "omega", "radius"),
    [
        (0.5, 0.8, 0.8224980778),
        (0.5, 1.0, 10.0026997328),
        (0.5, 1.2, 1.0748621048),
        (0.5, 1.5, 0.4917039499),
        (0.2, 1.2, 0.3670149316),
        (0.2, 1.5, 0.3321073803),
        (1.0, 1.1, 4.4653853589),
        (1.0, 1.4, 1.0747637970),
    ],
)
def test_circular_motion_is_the_closed_form(force: float, omega: float, radius: float) -> None:
    """Both components slip for ever, on the cone and not on a box around it."""
    exact = circular_radius(force, omega)
    assert exact == pytest.approx(radius, abs=1e-10)
    trace = simulate(circular(force, omega), 450, REFERENCE)
    np.testing.assert_allclose(trace.amplitude[-1, 0, :2], exact, rtol=1e-8)
    assert slip_share(trace, trace.run.time / 2) == pytest.approx(1.0)
    per_cycle = np.array(trace.totals.work)[-1] - np.array(trace.totals.work)[-2]
    assert per_cycle[2] == pytest.approx(2 * np.pi * 0.3 * np.sqrt(exact**2 - 0.3**2), rel=1e-8)


@pytest.mark.parametrize(
    ("omega", "amplitude"),
    [(0.8, 0.435691), (1.0, 6.210109), (1.1, 2.344376), (1.2, 1.360172), (1.3, 0.965336), (1.4, 0.745880)],
)
def test_jenkins_element(omega: float, amplitude: float) -> None:
    """The truth has six decimals."""
    assert steady(jenkins(omega), 400)[0] == pytest.approx(amplitude, rel=1e-6, abs=6e-7)


@pytest.mark.parametrize(
    ("omega", "friction", "soft", "stiff"),
    [
        (0.8, 0.4, 2.478451, 2.494429),
        (1.1, 0.5, 3.614288, 3.577909),
        (1.25, 0.4, 1.503682, 1.487547),
        (1.5, 0.3, 0.731456, 0.724399),
    ],
)
def test_rigid_coulomb_friction_is_the_limit(omega: float, friction: float, soft: float, stiff: float) -> None:
    """Den Hartog's closed form is approached as the root of the stiffness falls."""
    exact = den_hartog_amplitude(omega, friction)
    found = [steady(den_hartog(omega, friction, k), 80, settled=1e-5)[0] for k in (1e3, 1e4)]
    np.testing.assert_allclose(found, [soft, stiff], rtol=2e-6)
    away = np.abs(np.array(found) - exact)
    assert away[1] < 0.01 * exact
    assert np.log10(away[0] / away[1]) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(("omega", "amplitude"), [(1.2, 0.356815), (1.3, 1.654722), (1.4, 0.893366)])
def test_inclined_contact(omega: float, amplitude: float) -> None:
    assert steady(inclined(omega), 400)[0] == pytest.approx(amplitude, rel=1e-5)


# Each way with what 300 cycles at each frequency are to give; at 1.2850, next to the fold, the rest of the way there
# has not quite died away.
UP = {1.2700: 0.515553, 1.2800: 0.558662, 1.2825: None, 1.2850: 0.663109, 1.2875: 1.791025}
DOWN = {1.2900: None, 1.2800: 1.874119, 1.2700: 1.981046, 1.2600: None, 1.2575: 2.011290, 1.2550: 0.469796}


@pytest.mark.parametrize("way", [UP, DOWN], ids=["up", "down"])
def test_jump_of_the_inclined_contact(way: dict[float, float | None]) -> None:
    phases = [Phase(omega / (2 * np.pi), 300) for omega in way]
    trace = follow(Run(inclined(next(iter(way))), phases, PRESETS["standard"]))
    for amplitude, found in zip(way.values(), trace.amplitude[299::300, 0, 0], strict=True):
        assert amplitude is None or found == pytest.approx(amplitude, rel=3e-5)


# Amplitudes of `two_degrees` along the tangent and the normal by (force, omega): six decimals, computed by another
# time integration.
TWO_DEGREES = {
    (10, 4.0): (5.852057, 0.036761),
    (50, 3.5): (10.974332, 0.163600),
    (80, 3.0): (10.451682, 0.238514),
    (80, 3.5): (29.987567, 0.261759),
    (80, 4.0): (21.985107, 0.294086),
    (300, 3.0): (82.238182, 0.894427),
    (300, 3.5): (202.980752, 0.981597),
}


@pytest.mark.parametrize("load", TWO_DEGREES, ids=lambda load: "-".join(map(str, load)))
def test_normal_load_that_varies(load: tuple[float, float]) -> None:
    tangential, normal = TWO_DEGREES[load]
    np.testing.assert_allclose(steady(two_degrees(*load), 250), [tangential, 0.0, normal], rtol=1e-6, atol=6e-7)
