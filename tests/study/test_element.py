"""A contact under prescribed motion: two independent methods against each other, studies, pictures, bad motions."""

import json
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from systems import CREEPING, contact, creeping, slipping_pair
from typer.testing import CliRunner

from timesim.cli import app
from timesim.element.cycle import ElementCycle, Transition
from timesim.element.elements import harmonic_elements
from timesim.element.loop import difference, loop_cycle
from timesim.element.motion import CYCLE, HarmonicMotion, SplineMotion
from timesim.element.state_by_state import steady_cycle
from timesim.fault import SceneError
from timesim.model.model import SEPARATION, SLIP, STICK
from timesim.model.solver import Solver
from timesim.orbit.extrapolation import limits
from timesim.result.netcdf import open_result
from timesim.study.element import summary
from timesim.study.element_map import MapMarch, elements_of
from timesim.study.registry import carry_out, load_scene, run

pytestmark = pytest.mark.long

CONFIGS = Path(__file__).parents[2] / "configs"
TABLE = json.loads((Path(__file__).parents[1] / "data/element_motions.json").read_text())["cases"]
FULL = np.array([[1.5, 0.4], [0.4, 0.8]])
PAD = {"name": "pad", "friction": 0.3, "tangential_stiffness": 1.0, "normal_stiffness": 1.0, "preload": 1.0}


def states(cycle):
    return [(item.before, item.after) for item in cycle.transitions]


def shares(cycle):
    """States that last for more than rounding."""
    return {stay.state for stay in cycle.stays if stay.stop > stay.start + 1e-9}


def assert_both_agree(pad, motion):
    """State by state and by the event loop, checked against each other."""
    cycle, other = steady_cycle(pad, motion), loop_cycle(pad, motion)
    found = difference(cycle, other)
    assert cycle.periodic
    assert other.periodic
    assert found.same_sequence
    assert found.angle < 1e-8
    assert found.coefficient < 1e-8
    assert found.dissipation < 1e-8
    assert cycle.work == pytest.approx(cycle.dissipation, abs=1e-10)
    return cycle, other


# The two ways ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_both_methods_agree_on_random_motions(count):
    """State by state and the event loop: all transitions, and the coefficients to 1e-8."""
    rng = np.random.default_rng(2024)
    seen, partly, parted, creeping = {False: Counter(), True: Counter()}, 0, 0, 0
    for number in range(count):
        full = number % 2 == 1
        cycle, other = assert_both_agree(*slipping_pair(rng, full))
        seen[full].update(states(other))
        partly += SLIP in shares(cycle) and len(shares(cycle)) > 1
        parted += SEPARATION in shares(cycle) and len(shares(cycle)) > 1
        creeping += other.num_cycles > 20
    print(f"{partly} slip for part of the cycle only, {parted} separate, {creeping} take more than 20 cycles: {seen}")
    assert partly >= 0.75 * count
    assert parted >= 0.3 * count
    every = {(STICK, SLIP), (SLIP, STICK), (SLIP, SEPARATION), (SEPARATION, STICK), (SEPARATION, SLIP)}
    assert all(set(counted) >= every for counted in seen.values())


def test_a_slip_that_lasts_for_rounding_alone_makes_no_other_sequence():
    """Of motion 83 above rounding decides, and with it the processor, whether the contact slips for 1e-9 rad."""
    rng = np.random.default_rng(2024)
    pad, motion = [slipping_pair(rng, number % 2 == 1) for number in range(84)][83]
    cycle, other = assert_both_agree(pad, motion)
    for length, same in [(2e-9, True), (1e-3, False)]:
        touch = (Transition(1.477, STICK, SLIP), Transition(1.477 + length, SLIP, STICK))
        slipping = replace(other, transitions=touch, dissipation=other.dissipation + 1e-2 * length)
        assert difference(cycle, slipping).same_sequence == same


@pytest.mark.parametrize("full", [False, True])
def test_stick_to_separation_where_both_guards_vanish(full):
    """Straight motion in phase with v along a principal axis: |f| and mu n reach zero at once."""
    K = FULL if full else np.eye(2)
    _, axes = np.linalg.eigh(K)
    A, B = 0.2 * np.abs(axes[:, 1]) if full else (0.3, 0.0)
    cycle, other = assert_both_agree(contact(K, 0.5), HarmonicMotion(A, B, 2.0))
    assert set(states(cycle)) == set(states(other)) == {(STICK, SEPARATION), (SEPARATION, STICK)}
    np.testing.assert_allclose(sorted(np.degrees(item.angle) for item in cycle.transitions), [210.0, 330.0], atol=1e-9)


@pytest.mark.parametrize("name", TABLE)
def test_table_by_both_methods(name):
    case = TABLE[name]
    A, B, D, phase = case["motion"]
    cycle, other = assert_both_agree(contact(), HarmonicMotion(A, B, D, np.pi / 2, np.radians(phase)))
    expected = sorted(case["transitions"])
    for found in (cycle.transitions, other.transitions):
        turned = sorted([(np.degrees(t.angle) - 90 + 1e-7) % 360 - 1e-7, t.before, t.after] for t in found)
        assert [item[1:] for item in turned] == [item[1:] for item in expected]
        np.testing.assert_allclose([t[0] for t in turned], [t[0] for t in expected], rtol=0, atol=1e-6)
    # In the table u1 = A cos t and u2 = B cos(t + 90 degrees): f_s goes with the cosine, f_c against the sine.
    cosine, sine = np.array([case["force_1"], case["force_2"]]).T
    for found in (cycle.coefficients, other):
        np.testing.assert_allclose(found.f_b, case["mean"], rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.f_s[0], cosine[0], rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.f_c[0], -sine[0], rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.f_s[1], -sine[1], rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.f_c[1], -cosine[1], rtol=0, atol=1e-8)
    assert other.dissipation == pytest.approx(case["dissipation"], abs=1e-9)
    assert cycle.dissipation == pytest.approx(case["dissipation"], abs=1e-9)


def test_a_cycle_with_too_many_steps_says_so():
    """A stiff contact with next to no friction turns with the motion: explicit steps are as short as it is stiff."""
    pad, motion = contact(1.0, 1e-5), HarmonicMotion(1.0, 0.7, 0.2, 1.0, 0.3)
    with pytest.raises(RuntimeError, match="in cycle 1: it takes more than 16,384 steps"):
        loop_cycle(pad, motion)


def test_event_loop_has_the_symmetries_of_the_law():
    """Scaling, another start of the angle, swapped axes and a turned frame, in the event loop alone."""
    rng = np.random.default_rng(17)
    for number in range(6):
        pad, motion = slipping_pair(rng, number % 2 == 1)
        base = loop_cycle(pad, motion)
        K, load = pad.tangential_stiffness, (pad.friction, pad.normal_stiffness, pad.preload)
        large = HarmonicMotion(1e6 * motion.A, 1e6 * motion.B, 1e6 * motion.D, motion.phi, motion.psi)
        scaled = loop_cycle(contact(1e-9 * K, load[0], 1e-9 * load[1], 1e-3 * load[2]), large)
        np.testing.assert_allclose(np.array([scaled.f_s, scaled.f_c]) * 1e3, [base.f_s, base.f_c], atol=1e-9)
        assert scaled.dissipation == pytest.approx(1e3 * base.dissipation, rel=1e-9, abs=1e-9)
        swap = np.array([[0.0, 1.0], [1.0, 0.0]])
        swapped = HarmonicMotion(motion.B, motion.A, motion.D, -motion.phi, motion.psi - motion.phi)
        other = loop_cycle(contact(swap @ K @ swap, *load), swapped)
        # The swapped motion starts elsewhere on the cycle: only its phase differs.
        np.testing.assert_allclose(other.f_s[::-1], base.f_s, atol=1e-9)
        np.testing.assert_allclose(other.f_c[::-1], base.f_c, atol=1e-9)
        assert other.dissipation == pytest.approx(base.dissipation, abs=1e-9)
        angles = [np.array([t.angle for t in c.transitions]) for c in (base, other)]
        turned = np.sort((angles[0] + motion.phi + 1e-9) % CYCLE)
        np.testing.assert_allclose(turned, np.sort((angles[1] + 1e-9) % CYCLE), atol=1e-8)


def test_event_loop_turns_with_the_frame():
    """Isotropic K_u: a straight motion along any direction has the force of the same motion along t1."""
    base = loop_cycle(contact(), HarmonicMotion(1.0, 0.0, 0.5, 0.0, 1.0))
    turned = loop_cycle(contact(), HarmonicMotion(0.6, 0.8, 0.5, 0.0, 1.0))
    np.testing.assert_allclose(turned.f_s, base.f_s[0] * np.array([0.6, 0.8]), atol=1e-10)
    np.testing.assert_allclose(turned.f_b, base.f_b[0] * np.array([0.6, 0.8]), atol=1e-10)
    assert turned.dissipation == pytest.approx(base.dissipation, rel=1e-10)


@pytest.mark.slow
def test_both_methods_agree_on_sampled_motions():
    """The same spline in both; three harmonics, closing several times a cycle."""
    theta = np.arange(96) * CYCLE / 96
    u1, u2 = np.sin(theta) + 0.2 * np.sin(3 * theta), 0.4 * np.cos(2 * theta)
    for v in (0.5 * np.cos(theta), 0.9 * np.sin(3 * theta) + 0.4 * np.cos(theta)):
        for K in (1.0, FULL):
            cycle, _ = assert_both_agree(contact(K, preload=0.6), SplineMotion(np.stack([u1, u2, v], axis=1)))
            assert len(cycle.transitions) >= 2


def test_difference_sees_a_wrong_result():
    pad, motion = contact(), HarmonicMotion(1.0, 0.2, 1.3, 1.0, 2.0)
    cycle, other = steady_cycle(pad, motion), loop_cycle(pad, motion)
    stiffer = steady_cycle(contact(1.0 + 1e-5), motion)
    assert difference(cycle, other).angle < 1e-10 < 1e-7 < difference(stiffer, other).angle
    assert difference(stiffer, other).coefficient > 1e-7
    assert not difference(steady_cycle(contact(preload=5.0), motion), other).same_sequence


# The studies -----------------------------------------------------------------------------------------


def scene(study, **pad):
    return {"contacts": [PAD | pad], "study": study}


def element(**keys):
    return {"kind": "element", "cross_check": False} | keys


def test_the_loop_area_and_the_work_of_slip_are_told_apart(monkeypatch):
    """They are equal where a cycle is closed, each being a check of the other."""
    for name, value in (("dissipation", 2.0), ("work", 3.0)):
        monkeypatch.setattr(ElementCycle, name, value)
    data = run(scene(element(A=1.0, B=0.2)))
    assert (float(data.dissipation), float(data.friction_work)) == (2.0, 3.0)


def test_a_check_that_comes_to_no_cycle_leaves_the_result_complete(monkeypatch):
    """Nothing speaks against the result then, and it says that nothing confirms it."""
    creeping = {"tangential_stiffness": [1.7626, 0.20896], "normal_stiffness": 0.0, "preload": 1.7576, "friction": 1.0}
    plan = element(A=1.0, B=1.0, phi_deg=322.92, cross_check=True)
    monkeypatch.setattr("timesim.element.loop.loop_cycle", partial(loop_cycle, max_cycles=3))
    data = run(scene(plan, **creeping))
    assert data.attrs["complete"] == 1
    assert "after 3" in data.attrs["cross_check_failure"]
    cycle = steady_cycle(contact(), HarmonicMotion(1.0, 0.2, 0.0))
    lines = list(summary(cycle, {"cross_check_failure": "no reason"}, {"units": "N*mm"}))
    assert any(line.startswith("dissipation ") and line.endswith(" N*mm (work of slip)") for line in lines)
    assert "not confirmed by a second way: no reason" in lines


def test_smooth_slip_takes_many_steps_and_is_confirmed():
    """2,600 of the method of order 5 at 1e-12, since the direction of slip follows the motion at k A / mu n = 66."""
    stiff = {"friction": 0.35, "tangential_stiffness": [[24.9, 5], [5, 18]], "preload": 0.55}
    plan = element(A=1.89, B=2.8, phi_deg=332.5, D=0.3, psi_deg=117, cross_check=True)
    data = run(scene(plan, **stiff))
    assert data.attrs["complete"] == 1
    assert data.attrs["cross_check_coefficients"] < 1e-8


def test_a_gap_of_the_amplitude_just_touches():
    """State by state nothing happens, in the event loop n is above zero for as long as rounding takes."""
    plan = element(A=1.0, B=0.8, phi_deg=30, D=0.5, psi_deg=90, cross_check=True)
    data = run(scene(plan, tangential_stiffness=2.0, preload=-0.5))
    assert data.attrs["complete"] == 1
    assert "cross_check_failure" not in data.attrs


@pytest.mark.parametrize(
    ("A", "D", "pad"),
    [
        (1.0, 0.1, {"friction": 0.3, "normal_stiffness": 3.0, "preload": -0.3}),
        (3.0, 1.0000000000000002, {"friction": 0.25, "normal_stiffness": 1.0, "preload": -1.0}),
    ],
    ids=["rounded product", "last bit"],
)
def test_a_touch_by_rounding_is_none(A, D, pad):
    """-0.3 + 3 * 0.1 is 5.6e-17; the forces of the event loop are no more than that either."""
    plan = element(A=A, B=0.5, phi_deg=90, D=D, cross_check=True)
    data = run(scene(plan, tangential_stiffness=2.0, **pad))
    assert (data.attrs["complete"], data.attrs["touches"]) == (1, 0)
    assert not data.force.values.any()


def test_a_graze_is_confirmed_though_its_angle_is_badly_known():
    """n falls 4e-10 below zero about 240 degrees: its zeros are at 240 +- 0.00081 degrees, where its slope is 6e-5."""
    graze = {"friction": 0.25, "tangential_stiffness": 2.0, "normal_stiffness": 1.0, "preload": 4.0}
    data = run(scene(element(A=3, D=4.0000000004, psi_deg=30, cross_check=True), **graze))
    assert data.attrs["complete"] == 1
    opens = data.transition_angle_deg.values[data.transition_to.values == SEPARATION]
    assert opens == pytest.approx(240 - np.degrees(np.sqrt(2e-10)), abs=1e-7)
    assert data.attrs["cross_check_angle_deg"] > np.degrees(1e-6), "or it would be confirmed without a word"


def test_element_result():
    plan = element(A=1.0, B=0.2, phi_deg=60, D=0.3, psi_deg=150, harmonics=5, principal_axes=True)
    data = run(scene(plan | {"cross_check": True}))
    cycle = steady_cycle(contact(), HarmonicMotion(1.0, 0.2, 0.3, np.pi / 3, 5 * np.pi / 6))
    np.testing.assert_allclose(data.f_s, cycle.coefficients.f_s)
    np.testing.assert_allclose(data.effective_stiffness, cycle.coefficients.f_s / [1.0, 0.2])
    np.testing.assert_allclose(data.transition_angle_deg, np.degrees([item.angle for item in cycle.transitions]))
    assert float(data.dissipation) == pytest.approx(float(data.friction_work), abs=1e-12)
    assert data.attrs["complete"] == 1
    assert data.attrs["cross_check_angle_deg"] < 1e-8
    assert data.attrs["compile_seconds"] > 0
    assert run(scene(plan)).attrs["compile_seconds"] == 0, "nothing is compiled without the cross check"
    assert data.sizes["harmonic"] == 6
    assert data.force.dims == ("angle", "tangent")
    np.testing.assert_allclose(data.attrs["phase_deg"], [0.0, 60.0], atol=1e-12)
    # The loop area is the sum over the axes of pi f_c (amplitude), along whatever axes.
    for prefix, amplitude in (("", data.attrs["amplitude"]), ("principal_", data.principal_amplitude.values)):
        area = np.pi * np.sum(data[f"{prefix}f_c"].values * np.abs(amplitude))
        assert area == pytest.approx(float(data.dissipation), rel=1e-9)
    expected = np.hypot(*data.force.values.T) <= 0.3 * data.normal_load.values + 1e-12
    assert expected.all()


@pytest.mark.parametrize(("A", "B", "phi_deg"), [(0.39, 0.2, 90), (0.38, 0.2, 60), (0.398, 0.1, 90), (0.398, 0.3, 90)])
def test_what_is_left_of_a_creep_does_not_contradict_full_stick(A, B, phi_deg):
    """The event loop's last cycle still slips, by no more than rounding."""
    study = {"kind": "element", "A": A, "B": B, "phi_deg": phi_deg}
    data = run(scene(study, friction=0.4, normal_stiffness=0.0))
    assert data.attrs["offset_free"] == 1
    assert data.attrs["complete"] == 1
    assert data.attrs["cross_check_coefficients"] < 1e-8


def test_full_stick_says_that_its_offset_is_free():
    data = run(scene(element(A=0.1, B=0.1, phi_deg=90)))
    assert data.attrs["offset_free"] == 1
    np.testing.assert_allclose(data.effective_stiffness, 1.0, atol=1e-14)
    assert data.sizes["event"] == 0
    said = carry_out(load_scene(scene(element(A=0.1, B=0.1, phi_deg=90, cross_check=True)))).summary[-1]
    assert re.fullmatch("the event loop agrees to [0-9.e-]+ of the largest mu n in the coefficients", said)


def test_no_contact_gives_zero():
    data = run(scene(element(D=0.4), preload=-0.5))
    assert (float(data.dissipation), data.attrs["touches"]) == (0.0, 0)
    assert not data.force.values.any()
    assert np.isnan(data.effective_stiffness.values).all()


def test_disagreement_marks_the_result_incomplete(monkeypatch):
    from timesim.element import loop as element_loop

    honest = element_loop.loop_cycle
    other = lambda pad, motion, **more: honest(contact(1.001), motion, **more)  # noqa: E731
    monkeypatch.setattr(element_loop, "loop_cycle", other)
    outcome = carry_out(load_scene(scene(element(A=1.0, B=0.2, phi_deg=60, cross_check=True))))
    assert "differ by" in (outcome.reason or "")
    assert not any("agrees" in line for line in outcome.summary)
    data = outcome.groups[""]
    assert data.attrs["complete"] == 0
    assert data.attrs["cross_check_coefficients"] > 1e-6


def test_states_that_change_without_end_make_the_result_incomplete(monkeypatch, tmp_path):
    from timesim.element import state_by_state

    monkeypatch.setattr(state_by_state, "MAX_TRANSITIONS", 2)
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(scene(element(A=1.0, B=0.2, phi_deg=60)), indent=1))
    done = CliRunner().invoke(app, ["run", str(path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 1, done.output
    assert "more than 2 transitions in a cycle" in " ".join(done.output.split())
    data = open_result(tmp_path / "out")
    assert data.attrs["complete"] == 0
    assert "change a parameter a little" in data.attrs["reason"]


def test_motion_from_a_file(tmp_path):
    theta = np.arange(240) * CYCLE / 240
    rows = np.stack([np.sin(theta), 0.2 * np.sin(theta + 1), 1.3 * np.sin(theta + 2)], axis=1)
    np.savetxt(tmp_path / "motion.csv", rows, delimiter=",", header="u1,u2,v", comments="")
    np.savez(tmp_path / "motion.npz", u=rows[:, :2], v=rows[:, 2])
    exact = run(scene(element(A=1.0, B=0.2, phi_deg=np.degrees(1), D=1.3, psi_deg=np.degrees(2))))
    for name in ("motion.csv", "motion.npz"):
        path = tmp_path / "scene.yaml"
        text = json.dumps(scene(element(motion=name)), indent=1)
        path.write_text(text)
        loaded = load_scene(path)
        data = run(loaded)
        np.testing.assert_allclose(data.f_s, exact.f_s, atol=1e-9)
        np.testing.assert_allclose(data.transition_angle_deg, exact.transition_angle_deg, atol=1e-5)
        assert str(tmp_path / name) in loaded.resolved_yaml()
    np.savez(tmp_path / "motion.npz", u=rows[:, :2], v=1.01 * rows[:, 2])
    assert load_scene(path).data_fingerprint != loaded.data_fingerprint


def test_motion_from_a_result(tmp_path):
    """The motion of a point of a settled run gives the forces that the run had there."""
    source = load_scene(CONFIGS / "oscillator.yaml", ["study.cycles=150", "study.record_last=2"])
    from timesim.result.netcdf import save
    from timesim.study.registry import carry_out

    before = carry_out(source).groups
    save(before, tmp_path / "result.nc")
    pad = {"friction": 0.5, "tangential_stiffness": 20.0, "normal_stiffness": 20.0, "preload": 3.0}
    motion = {"from": str(tmp_path / "result.nc"), "point": "tip"}
    data = run(scene(element(motion=motion, samples=400), **pad))
    recorded = before[""].contact_force.values[-201:-1, 0]
    # Both at equal angles of the cycle; the offset of a stuck contact is that of its own start.
    np.testing.assert_allclose(data.normal_load.values[::2], recorded[:, 2], atol=1e-6)
    np.testing.assert_allclose(data.force.values[::2], recorded[:, :2], atol=2e-4)


def test_a_cycle_of_a_result_that_does_not_close_is_refused(tmp_path):
    """After three cycles from rest the motion still grows: closed by force, it would be another one."""
    source = load_scene(CONFIGS / "oscillator.yaml", ["study.cycles=3", "study.record_last=2"])
    from timesim.result.netcdf import save
    from timesim.study.registry import carry_out

    save(carry_out(source).groups, tmp_path / "result.nc")
    motion = {"from": str(tmp_path / "result.nc"), "point": "tip"}
    with pytest.raises(SceneError, match=r"study\.motion: .*ends 0\.\d+ of the motion's range from where it begins"):
        load_scene(scene(element(motion=motion)))


def test_element_map_against_single_elements():
    for pad, study in (
        ({}, {"A": {"from": 0, "to": 1.5, "num": 3}, "B": [0.0, 0.3, 1.0], "D": 0.5, "psi_deg": 45}),
        ({"preload": -0.4}, {"A": [0.5, 1.0], "psi_deg": [0, 100, 200], "B": 0.3, "D": 1.2}),
        ({}, {"A": 1.0, "B": 0.2, "D": 0.4, "preload": [0.5, 2.0, 9.0], "friction": [0.1, 0.6]}),
    ):
        loaded = load_scene(scene({"kind": "element_map"} | study, **pad))
        data = run(loaded)
        assert data.settled.all()
        first, second = data.dissipation.dims
        keys = {"a": "A", "b": "B"}
        for one in data[first].values:
            for two in data[second].values:
                values = {key: x for key, x in study.items() if np.isscalar(x)}
                values |= {keys.get(first, first): float(one), keys.get(second, second): float(two)}
                law = {key: values.pop(key) for key in ("preload", "friction") if key in values}
                single = run(scene(element(**{"phi_deg": 90.0} | values), **pad | law))
                found = data.sel({first: one, second: two})
                for name in ("f_s", "f_c") if single.attrs["offset_free"] else ("f_b", "f_s", "f_c"):
                    np.testing.assert_allclose(found[name], single[name], atol=1e-6)
                np.testing.assert_allclose(found.dissipation, single.dissipation, atol=1e-6)


def test_a_map_knows_the_law_of_the_cone_only():
    """As the scene says; from Python too."""
    plan = load_scene(scene({"kind": "element_map", "A": [0.5, 1.0], "B": [0.1, 0.2]})).plan
    with pytest.raises(ValueError, match=r"prescribed motion knows the law \w+ only, not another"):
        elements_of(replace(plan, contact=replace(plan.contact, law="another")))


def test_map_carries_creep_to_its_limit():
    """Circles just within reach of the cone: cycles of ever smaller slips."""
    study = {"kind": "element_map", "A": [0.38, 0.5], "B": [0.2, 0.26], "D": 0.0}
    data = run(scene(study, friction=0.4))
    assert data.settled.all()
    assert int(data.cycles.max()) < 100


def test_a_map_says_why_and_where_points_failed():
    study = {"kind": "element_map", "A": [0.0, 1.0], "B": [0.05, 0.9], "D": 0.2, "psi_deg": 40}
    pad = {"friction": 0.5, "tangential_stiffness": [[20, 5], [5, 12]], "normal_stiffness": 20, "preload": 3}
    outcome = carry_out(load_scene(scene(study, **pad), {"solver.max_steps": 130}))
    assert np.isnan(outcome.groups[""].dissipation.values).tolist() == [[False, True], [True, True]]
    why = "the budget of 130 steps a cycle is spent (3 points, the first at A = 0, B = 0.9). Raise solver.max_steps"
    assert outcome.reason == f"the event loop ended early at 3 of 4 points, NaN in the result: {why}"


@pytest.mark.slow
def test_map_ends_creep_where_the_march_does():
    """As state by state finds it: at the border of the offsets of full stick, not within."""
    pairs = [creeping(seed) for seed in CREEPING]
    law = np.array([(pad.friction, pad.normal_stiffness, pad.preload) for pad, _ in pairs]).T
    angle = np.array([0.0, np.pi / 2])
    path = np.array([motion.evaluate(angle)[0] for _, motion in pairs])  # sine and cosine parts: of rest, a quarter on
    phasor = path[:, :, 1] + 1j * path[:, :, 0]
    elements = harmonic_elements(*law, np.array([pad.tangential_stiffness for pad, _ in pairs]), phasor)
    found = MapMarch(elements, np.zeros((len(pairs), 2)), Solver("tsit5", 1e-7, 1e-9)).run()
    assert found["settled"].all()
    assert found["offset_free"].all()
    expected = [steady_cycle(*pair).coefficients.f_b for pair in pairs]
    np.testing.assert_allclose((found["f_b"] - expected) / elements.force[:, None], 0.0, atol=1e-6)


def test_a_map_marks_what_all_but_sticks():
    """Ellipses whose longer half axis is mu n: they stick with f_b = 0 alone, which creep hardly nears."""
    study = {"kind": "element_map", "A": [0.1, 0.2, 0.3, 0.39], "B": [0.3, 0.4], "D": 0.0}
    data = run(scene(study, friction=0.4))
    border = data.sel(b=0.4)
    assert (border.offset_free | ~border.settled.astype(bool)).all()
    slipping = run(scene(study | {"A": [0.45, 0.6]}, friction=0.4))
    assert slipping.settled.all()
    assert not slipping.offset_free.any()


def test_the_progress_of_a_map_moves_with_every_batch(monkeypatch):
    """From the first cycle on, never back, and to its end only with the last point."""
    monkeypatch.setattr("timesim.study.element_map.BATCH", 4)
    plan = load_scene(
        scene({"kind": "element_map", "A": {"from": 0.1, "to": 1.5, "num": 6}, "B": [0.2, 0.5], "D": 0.5})
    ).plan
    told = []
    MapMarch(*elements_of(plan), Solver("tsit5", 1e-7, 1e-9)).run(
        lambda done, total, text: told.append((done, total, text))
    )
    shares = [done / total for done, total, _ in told]
    assert shares == sorted(shares)
    assert 0 < shares[0] < shares[1] < 1
    assert all(share < 1 for share, (_, _, text) in zip(shares, told, strict=True) if ", 0 of 12" not in text)
    assert shares[-1] == 1


def test_limits_of_sequences():
    n = np.arange(1, 5)[:, None]
    geometric = np.array([2.0, -1.0]) + 0.8**n * np.array([0.3, 0.4])
    turning = np.stack([np.cos(n[:, 0]), np.sin(n[:, 0])], axis=1)
    found, leads = limits(np.stack([geometric, turning]))
    assert leads.tolist() == [True, False]
    np.testing.assert_allclose(found[0], [2.0, -1.0], atol=1e-12)


@pytest.mark.slow
def test_map_batches_do_not_matter(monkeypatch):
    from timesim.study import element_map

    loaded = load_scene(scene({"kind": "element_map", "A": [0.5, 1.0, 1.5], "B": [0.1, 0.2, 0.3], "D": 0.5}))
    elements, phase = elements_of(loaded.plan)
    whole = MapMarch(elements, phase, loaded.solver()).run()
    monkeypatch.setattr(element_map, "BATCH", 4)
    parts = MapMarch(elements, phase, loaded.solver()).run()
    np.testing.assert_allclose(parts["f_s"], whole["f_s"], atol=1e-12)
    np.testing.assert_array_equal(parts["cycles"], whole["cycles"])


def test_elements_that_never_touch_are_zero():
    phasor = np.array([[1.0, 0.5j, 0.3], [1.0, 0.5j, 1.5]])
    elements = harmonic_elements(0.3, 1.0, -0.5, np.eye(2), phasor)
    found = MapMarch(elements, np.array([[0.0, np.pi / 2]] * 2), load_scene(scene(element(A=1))).solver()).run()
    assert (found["dissipation"][0], found["transitions"][0]) == (0.0, 0)
    assert found["dissipation"][1] > 0


# Scenes, commands, pictures --------------------------------------------------------------------------

FIGURES = ("figure4", "figure5", "figure6a", "figure6b", "figure6c", "figure6d")


@pytest.mark.parametrize("name", FIGURES)
def test_scenes_of_the_figures(name):
    data = run(load_scene(CONFIGS / f"{name}.yaml", ["study.cross_check=false"]))
    order = np.argsort(data.transition_angle_deg.values)
    to = data.transition_to.values[order].tolist()
    parts = SEPARATION in to
    assert parts == (name in ("figure5", "figure6d"))
    assert {STICK, SLIP} <= set(to)
    if name == "figure5":
        start = to.index(SEPARATION)
        assert to[start + 1 :] + to[: start + 1] == [SLIP, STICK, SLIP, SEPARATION]
    if name == "figure6a":
        force = data.force.values
        np.testing.assert_allclose(force[:360], -force[360:], atol=1e-9)


@pytest.mark.parametrize("name", ["figure7", "figure8"])
def test_scenes_of_the_maps(name, tmp_path):
    few = ["study.A.num=5", "study.B.num=5"]
    data = run(load_scene(CONFIGS / f"{name}.yaml", few))
    assert data.f_s.shape == (5, 5, 2)
    assert data.settled.all()
    assert (data.dissipation.values[1:, 1:] > 0).all()
    # Straight motion: nothing happens across it.
    np.testing.assert_allclose(data.f_c.sel(b=0.0, tangent="t2"), 0.0, atol=1e-9)


def test_command_writes_result_and_pictures(tmp_path):
    runner = CliRunner()
    done = runner.invoke(app, ["run", str(CONFIGS / "figure5.yaml"), "-o", str(tmp_path / "a")])
    assert done.exit_code == 0, done.output
    assert "slip→separation" in done.output
    assert "the event loop agrees" in done.output
    assert {path.name for path in (tmp_path / "a").glob("*.png")} == {"force_path.png", "hysteresis.png", "cycle.png"}
    assert open_result(tmp_path / "a").attrs["study"] == "element"
    few = ["--set", "study.A.num=5", "--set", "study.B.num=4"]
    done = runner.invoke(app, ["run", str(CONFIGS / "figure7.yaml"), "-o", str(tmp_path / "b"), *few])
    assert done.exit_code == 0, done.output
    assert {path.name for path in (tmp_path / "b").glob("*.png")} == {"surfaces.png", "contours.png"}
    again = runner.invoke(app, ["run", str(tmp_path / "a/scene.yaml"), "-o", str(tmp_path / "c"), "--no-plots"])
    assert again.exit_code == 0, again.output


def test_pictures_of_cycles_without_transitions(tmp_path):
    from timesim.study.registry import draw

    for plan in (element(A=0.1), element(A=1.0, B=1.0, phi_deg=90), element(D=0.3)):
        assert len(draw(run(scene(plan)), tmp_path)) == 3


def test_check_loads_no_jax():
    code = (
        "import sys; from timesim.scene.report import describe; from timesim.study.registry import load_scene;"
        f"[describe(load_scene({str(CONFIGS)!r} + '/' + name)) for name in ('figure4.yaml', 'figure7.yaml')];"
        "sys.exit('jax' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# Motions that mean nothing ---------------------------------------------------------------------------


def bad_motion(tmp_path, rows):
    np.savetxt(tmp_path / "motion.csv", rows, delimiter=",", header="u1,u2,v", comments="")
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(scene(element(motion="motion.csv")), indent=1))
    return path


def test_file_with_a_jump_or_too_few_samples_is_refused(tmp_path):
    theta = np.arange(100) * CYCLE / 100
    smooth = np.stack([np.sin(theta), np.cos(theta), 0 * theta], axis=1)
    jump = smooth.copy()
    jump[50:, 0] += 0.7
    for rows, rule in ((jump, "u1 jumps"), (smooth[:10], "at least"), (smooth[:60], "jumps")):
        path = bad_motion(tmp_path, rows)
        with pytest.raises(SceneError, match=rule):
            load_scene(path)
        refused = CliRunner().invoke(app, ["run", str(path), "-o", str(tmp_path / "out")])
        assert refused.exit_code == 2
        assert "study.motion" in refused.output
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("study", "pad", "key"),
    [
        (element(A=1.0), {"normal_stiffness": 0.0, "preload": 0.0}, "contacts.pad.preload"),
        (element(motion="none.csv"), {}, "study.motion"),
        (element(A=1.0, motion="none.csv"), {}, "study.A"),
        (element(), {}, "study"),
        (element(A=-1.0), {}, "study.A"),
        (element(A=1.0, contact="pod"), {}, "study.contact"),
        ({"kind": "element_map", "A": [1, 2]}, {}, "study"),
        ({"kind": "element_map", "A": [2, 1], "B": [1, 2]}, {}, "study.A"),
        ({"kind": "element_map", "A": {"from": 1, "to": 0, "num": 5}, "B": [1, 2]}, {}, "study.A.to"),
        ({"kind": "element_map", "A": [1, 2], "normal_stiffness": [0, 1]}, {"preload": -1.0}, "study.normal_stiffness"),
    ],
)
def test_scenes_that_mean_nothing_are_refused(study, pad, key, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(scene(study, **pad), indent=1))
    refused = CliRunner().invoke(app, ["run", str(path), "-o", str(tmp_path / "out")])
    assert refused.exit_code == 2
    assert f": {key}: " in refused.output
