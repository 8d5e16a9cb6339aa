"""The oracle against independent computations: the tests that rely on it are only as good as these."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracle import OracleResult, simulate
from oracle_traps import (
    double_crossing_trap,
    double_crossing_truth,
    earliest_event_trap,
    earliest_event_truth,
    separates,
    slips,
)
from scipy.optimize import brentq
from systems import (
    GENERATED_CYCLES,
    circular,
    circular_radius,
    den_hartog,
    den_hartog_amplitude,
    generated_models,
    grazing_stop,
    inclined,
    jenkins,
    oscillator,
    scene,
    two_degrees,
    two_stops,
)

from timesim.model.model import GROUND, SLIP, STICK, Model

pytestmark = pytest.mark.long

DATA = Path(__file__).parents[1] / "data"


def run(model: Model, cycles: float, **settings: Any) -> OracleResult:
    assert model.excitation.frequency is not None
    return simulate(model, model.excitation.frequency, cycles, **settings)


def reference(name: str) -> dict[str, Any]:
    return json.loads((DATA / name).read_text())


# --- reference computations: DOP853 with located events, rtol 1e-12 ---


@pytest.mark.parametrize(
    ("case", "preload", "frequency", "count"),
    [
        ("osc_n0=3_f=1.39", 3.0, 1.39, 235),
        ("osc_n0=-1_f=0.97", -1.0, 0.97, 119),
        ("osc_n0=5_f=1.52", 5.0, 1.52, 232),
    ],
)
def test_oscillator_of_table_1(case: str, preload: float, frequency: float, count: int) -> None:
    truth = reference("oscillator.json")["cases"][case]
    result = run(oscillator(preload, frequency), truth["cycles"])
    events = np.array(truth["events"])
    assert len(result.event_time) == truth["n_events"] == count
    np.testing.assert_allclose(np.r_[result.displacement, result.velocity], truth["state_end"], atol=2e-8, rtol=0)
    np.testing.assert_allclose(result.event_time[: len(events)], events[:, 0], atol=1e-7, rtol=0)
    np.testing.assert_array_equal(result.event_from[: len(events)], events[:, 2])
    np.testing.assert_array_equal(result.state, truth["modes_end"])


@pytest.mark.slow
def test_twenty_modes_and_three_contacts() -> None:
    truth = reference("many_modes_truth.json")
    result = run(scene(DATA / "many_modes.yaml"), truth["cycles"])
    events = np.array(truth["events"])
    first = slice(len(events))
    log = np.stack([result.event_contact[first], result.event_from[first], result.event_to[first]], axis=1)
    assert len(result.event_time) == truth["n_events"] == 328
    np.testing.assert_allclose(np.r_[result.displacement, result.velocity], truth["state_end"], atol=2e-9, rtol=0)
    np.testing.assert_allclose(result.event_time[first], events[:, 0], atol=1e-8, rtol=0)
    np.testing.assert_array_equal(log, events[:, 1:])


@pytest.mark.slow
def test_blade_in_newtons_and_metres() -> None:
    truth = reference("blade_truth.json")["cases"]["slip_720Hz"]["transient"]
    result = run(scene(DATA / "blade_modes.yaml"), truth["cycles"])
    displacement, velocity = (
        np.array(truth["final_modal_displacement"]),
        np.array(truth["final_modal_velocity"]),
    )
    assert len(result.event_time) == truth["events"] == 625
    # One of the 625 times differs by 3.24e-7 cycles at any tolerance; the states after it agree.
    late = np.abs(result.event_time * 720 - truth["all_event_cycles"])
    assert np.sort(late)[-2] < 1e-8
    assert late.max() < 1e-6
    np.testing.assert_allclose(result.displacement, displacement, atol=1e-8 * abs(displacement).max(), rtol=0)
    np.testing.assert_allclose(result.velocity, velocity, atol=1e-8 * abs(velocity).max(), rtol=0)
    np.testing.assert_allclose(result.slip, truth["final_slip"], atol=1e-8 * 2e-5, rtol=0)


# --- closed forms and steady amplitudes by other codes ---


@pytest.mark.parametrize(
    ("force", "omega", "radius"),
    [(0.5, 1.2, 1.0748621048), (0.5, 1.4, 0.5928662659), (1.0, 1.5, 0.8466794784), (0.2, 1.3, 0.3844017135)],
)
def test_circular_motion_is_the_closed_form(force: float, omega: float, radius: float) -> None:
    result = run(circular(force, omega), 250)
    assert circular_radius(force, omega) == pytest.approx(radius, abs=1e-9)
    assert np.hypot(*result.displacement) == pytest.approx(radius, abs=1e-9)
    assert result.share[0, SLIP] == pytest.approx(1.0, abs=1e-12)
    # The slider runs on a circle of radius sqrt(R^2 - delta^2).
    assert np.hypot(*result.slip[0]) == pytest.approx(np.sqrt(radius**2 - 0.3**2), abs=1e-9)


def test_circular_motion_that_sticks() -> None:
    assert np.isnan(circular_radius(0.2, 1.0))
    result = run(circular(0.2, 1.0), 300)
    assert result.share[0, STICK] == 1.0
    assert result.event_time.max(initial=0.0) < 20 * 2 * np.pi
    # Full stick keeps an offset of the slider, which moves the centre of the circle by k_t w / (k + k_t).
    centre = 0.5 * result.slip[0]
    assert np.hypot(*centre) > 0.01
    assert np.hypot(*(result.displacement - centre)) == pytest.approx(0.1999600120, abs=1e-9)


def resume(model: Model, result: OracleResult, cycles: float) -> Model:
    """The same model, started where `result` stopped after `cycles`."""
    start = replace(
        model.start,
        displacement=result.displacement,
        velocity=result.velocity,
        slip=result.slip,
        state=result.state,
        phase=2 * np.pi * (cycles % 1.0),
    )
    return replace(model, start=start)


def steady_amplitude(model: Model, settle: float) -> tuple[float, OracleResult]:
    """Half of peak to peak of mode 1, by the zeros of its velocity."""
    settled = run(model, settle)
    resumed = resume(model, settled, settle)

    def velocity(part: float) -> float:
        return float(run(resumed, part).velocity[0])

    samples = np.linspace(0.01, 1.01, 13)
    values = [velocity(part) for part in samples]
    turns = [
        brentq(velocity, samples[k], samples[k + 1], xtol=1e-9)
        for k in range(len(values) - 1)
        if values[k] * values[k + 1] < 0
    ]
    extremes = [run(resumed, part).displacement[0] for part in turns]
    return 0.5 * float(max(extremes) - min(extremes)), settled


@pytest.mark.parametrize(("omega", "amplitude"), [(1.2, 1.360172), (1.4, 0.745880)])
def test_jenkins_element(omega: float, amplitude: float) -> None:
    measured, settled = steady_amplitude(jenkins(omega), 200)
    assert 0.1 < settled.share[0, SLIP] < 0.9
    assert measured == pytest.approx(amplitude, abs=1e-6)


@pytest.mark.parametrize(("omega", "amplitude"), [(1.3, 1.654722), (1.4, 0.893366)])
def test_inclined_contact(omega: float, amplitude: float) -> None:
    measured, settled = steady_amplitude(inclined(omega), 150)
    assert 0.05 < settled.share[0, SLIP] < 0.95
    assert measured == pytest.approx(amplitude, rel=1e-5)


def test_normal_load_that_varies() -> None:
    measured, settled = steady_amplitude(two_degrees(80.0, 3.5), 120)
    assert 0.3 < settled.share[0, SLIP] < 0.9
    assert measured == pytest.approx(29.987567, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("omega", "friction", "soft", "stiff"),
    [(1.25, 0.4, 1.503682, 1.487547), (1.5, 0.3, 0.731456, 0.724399)],
)
def test_coulomb_friction_is_the_limit(omega: float, friction: float, soft: float, stiff: float) -> None:
    exact = den_hartog_amplitude(omega, friction)
    for stiffness, amplitude in ((1e3, soft), (1e4, stiff)):
        measured, _ = steady_amplitude(den_hartog(omega, friction, stiffness), 60)
        assert measured == pytest.approx(amplitude, rel=1e-4)
        assert measured == pytest.approx(exact, rel=0.6 / np.sqrt(stiffness))


# --- the oracle on its own terms ---


def test_a_run_may_be_cut_anywhere() -> None:
    model = oscillator(-1.0, 0.97)
    whole, parts = run(model, 7.3), run(model, 2.6)
    rest = run(resume(model, parts, 2.6), 4.7)
    assert len(parts.event_time) + len(rest.event_time) == len(whole.event_time) > 10
    np.testing.assert_allclose(rest.displacement, whole.displacement, atol=1e-10, rtol=0)
    np.testing.assert_allclose(rest.slip, whole.slip, atol=1e-9, rtol=0)


def test_two_contacts_of_half_stiffness_act_as_one() -> None:
    """Both reach every transition at the same instant."""
    model = oscillator(-1.0, 0.97)
    half = replace(
        model.contacts[0],
        tangential_stiffness=0.5 * model.contacts[0].tangential_stiffness,
        normal_stiffness=10.0,
        preload=-0.5,
    )
    start = replace(model.start, slip=np.zeros((2, 2)), state=np.array([-1, -1]))
    one, two = run(model, 15), run(replace(model, contacts=(half, half), start=start), 15)
    assert len(two.event_time) == 2 * len(one.event_time) > 40
    np.testing.assert_allclose(two.event_time[::2], one.event_time, atol=1e-9, rtol=0)
    np.testing.assert_allclose(two.displacement, one.displacement, atol=1e-9, rtol=0)


def describe(name: str, model: Model, result: OracleResult) -> str:
    shares = "; ".join("/".join(f"{100 * part:.0f}" for part in share) for share in result.share)
    joined = sum(contact.against != GROUND for contact in model.contacts)
    events = len(result.event_time)
    return f"{name}: {events} transitions, {joined} point to point, stick/slip/separation % {shares}"


def anisotropic(model: Model) -> bool:
    return any(abs(contact.tangential_stiffness[0, 1]) > 0 for contact in model.contacts)


def test_generated_models_cover_what_scenes_may_hold() -> None:
    models = list(generated_models().values())
    contacts = [contact for model in models for contact in model.contacts]
    assert len(models) >= 24
    assert {model.num_contacts for model in models} == {1, 2, 3, 4, 5}
    assert {model.structure.num_modes for model in models} == {2, 3, 4, 5, 6}
    assert sum(map(anisotropic, models)) > len(models) / 2
    assert sum(abs(contact.tangential_stiffness[0, 1]) > 0 for contact in contacts) > len(contacts) / 2
    assert sum(contact.against != GROUND for contact in contacts) >= 10
    assert sum(contact.preload < 0 for contact in contacts) >= 10
    assert any(contact.friction == 0 for contact in contacts)
    assert any(contact.normal_stiffness == 0 for contact in contacts)
    assert sum(model.structure.damping.ndim == 2 for model in models) >= 4
    for model in models:
        for contact in model.contacts:
            np.testing.assert_allclose(contact.frame @ contact.frame.T, np.eye(3), atol=1e-14)
            if contact.friction > 0:
                assert np.linalg.eigvalsh(contact.tangential_stiffness)[0] > 0


@pytest.mark.slow
def test_generated_models_slip_and_separate() -> None:
    results = {}
    for name, model in generated_models().items():
        results[name] = run(model, GENERATED_CYCLES)
        print(describe(name, model, results[name]))
    assert all(map(slips, results.values()))
    assert 3 * sum(map(separates, results.values())) >= len(results)


@pytest.mark.slow
def test_generated_models_do_not_hang_on_the_tolerance() -> None:
    for name, model in generated_models().items():
        fine = run(model, GENERATED_CYCLES)
        loose = run(model, GENERATED_CYCLES, rtol=1e-9, atol_relative=1e-11, steps_per_cycle=130)
        scale = np.abs(fine.displacement).max()
        assert np.abs(loose.displacement - fine.displacement).max() < 1e-8 * scale, name
        assert len(loose.event_time) == len(fine.event_time), name
        np.testing.assert_array_equal(loose.event_contact, fine.event_contact, err_msg=name)
        np.testing.assert_array_equal(loose.event_to, fine.event_to, err_msg=name)


# --- the traps of plain events ---


# Plain events have two programs of their own.
@pytest.mark.slow
@pytest.mark.parametrize("trap", [earliest_event_trap, double_crossing_trap])
def test_plain_events_fail(trap: Callable[[], tuple[OracleResult, OracleResult]]) -> None:
    plain, true = trap()
    scale = np.abs(true.displacement).max()
    print(
        len(plain.event_time),
        "of",
        len(true.event_time),
        "transitions,",
        plain.displacement,
        true.displacement,
    )
    assert len(plain.event_time) < len(true.event_time)
    assert np.abs(plain.displacement - true.displacement).max() > 0.1 * scale
    if trap is earliest_event_trap:  # the first of the list is right: only the overtaken one is lost
        np.testing.assert_allclose(plain.displacement[0], true.displacement[0], rtol=1e-5)


def test_truth_of_the_earliest_event_trap() -> None:
    """The two masses do not know of each other, so each must move as in a pair of equals."""
    true = earliest_event_truth()
    alone = [simulate(two_stops((gap, gap)), 1.0, 10) for gap in (0.021, 0.020)]
    np.testing.assert_allclose(true.displacement, [alone[0].displacement[0], alone[1].displacement[1]], atol=1e-10)
    for contact in (0, 1):
        times = true.event_time[true.event_contact == contact]
        own = alone[contact].event_time[alone[contact].event_contact == contact]
        np.testing.assert_allclose(times, own, atol=1e-9)


def test_truth_of_the_double_crossing_trap() -> None:
    true = double_crossing_truth()
    fine = simulate(grazing_stop(0.999, 1e3), 1.0, 6, steps_per_cycle=2000)
    assert len(true.event_time) == len(fine.event_time)
    np.testing.assert_allclose(true.event_time, fine.event_time, atol=1e-9)
    np.testing.assert_allclose(true.displacement, fine.displacement, atol=1e-9)
